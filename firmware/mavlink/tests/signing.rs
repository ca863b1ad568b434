//! Signing against packets that pymavlink signed, and what is refused.

use vigil_mavlink::common::MavCmd;
use vigil_mavlink::framing::{FramingCounters, MAX_PACKET_LEN, Packet, encode, packets};
use vigil_mavlink::message;
use vigil_mavlink::signing::{
    MAX_STREAMS, Refusal, Refusal::*, SIGNATURE_LEN, Signing, SigningKey, SigningMemory, Timestamp, UNITS_PER_SECOND,
    timestamp_of_unix_ns,
};

const NOW: Timestamp = 37_000_000_000_000;
const MINUTE: Timestamp = 60 * UNITS_PER_SECOND;

fn key(first: u8) -> SigningKey {
    SigningKey(std::array::from_fn(|i| first + i as u8))
}

fn signing(first: u8, link_id: u8) -> Signing {
    Signing::new(key(first), link_id, SigningMemory::default())
}

/// One line of the file that `tests/data/sign_with_pymavlink.py` wrote.
struct Vector {
    what: &'static str,
    link_id: u8,
    timestamp: Timestamp,
    unsigned: Vec<u8>,
    signed: Vec<u8>,
}

fn vectors() -> Vec<Vector> {
    let hex = |text: &str| -> Vec<u8> {
        (0..text.len())
            .step_by(2)
            .map(|i| u8::from_str_radix(&text[i..i + 2], 16).unwrap())
            .collect()
    };
    include_str!("data/signed_by_pymavlink.txt")
        .lines()
        .map(|line| {
            let fields: Vec<&'static str> = line.split(' ').collect();
            let [what, link_id, timestamp, unsigned, signed] = fields[..] else {
                panic!("{line}");
            };
            Vector {
                what,
                link_id: link_id.parse().unwrap(),
                timestamp: timestamp.parse().unwrap(),
                unsigned: hex(unsigned),
                signed: hex(signed),
            }
        })
        .collect()
}

/// The one packet in `bytes`.
fn with_packet<T>(bytes: &[u8], take: impl FnOnce(&Packet<'_>) -> T) -> T {
    let packet = packets(bytes, &mut FramingCounters::default()).next().unwrap();
    assert_eq!(packet.raw().len(), bytes.len());
    take(&packet)
}

fn verdict(verifier: &mut Signing, now: Timestamp, bytes: &[u8]) -> Result<(), Refusal> {
    with_packet(bytes, |packet| verifier.verify(now, packet, false))
}

/// A command that would be obeyed.
fn unsigned(i: u32, sender: (u8, u8)) -> Vec<u8> {
    let (command, param1, param7) = (MavCmd::MAV_CMD_NAV_GUIDED_ENABLE, 1.0, i as f32);
    let (target_system, target_component) = (1, 191);
    let message = message!(COMMAND_LONG, param1, param7, command, target_system, target_component);
    encode(sender, i as u8, &message)
}

fn signed(signer: &mut Signing, now: Timestamp, packet: &[u8]) -> Vec<u8> {
    let mut out = [0; MAX_PACKET_LEN + SIGNATURE_LEN];
    let len = signer.sign(now, packet, &mut out).unwrap();
    out[..len].to_vec()
}

fn from_ground(signer: &mut Signing, now: Timestamp, i: u32) -> Vec<u8> {
    signed(signer, now, &unsigned(i, (255, 190)))
}

#[test]
fn packets_signed_by_pymavlink_are_accepted_and_those_of_another_key_are_not() {
    let mut verifier = signing(0, 0);
    let mut accepted = 0;
    for v in vectors() {
        let expected = match v.what {
            "right" => Ok(()),
            _ => Err(WrongSignature),
        };
        assert_eq!(verdict(&mut verifier, NOW, &v.signed), expected, "{}", v.timestamp);
        accepted += u32::from(expected.is_ok());
    }
    assert_eq!((accepted, vectors().len()), (120, 150));
    assert_eq!(
        verifier.memory().streams.len(),
        3,
        "link 0 and 3 of one station, and another system"
    );
}

#[test]
fn signing_gives_the_bytes_that_pymavlink_gives() {
    for v in vectors() {
        let first = if v.what == "right" { 0 } else { 1 };
        let ours = signed(&mut signing(first, v.link_id), v.timestamp, &v.unsigned);
        assert_eq!(ours, v.signed);
    }
}

#[test]
fn of_a_thousand_packets_each_all_right_ones_are_accepted_and_no_others() {
    let mut station = signing(0, 0);
    let mut stranger = signing(1, 0);
    let mut verifier = signing(0, 1);
    let mut heard = Vec::new();
    let at = |i: u32| NOW + u64::from(i) * 5_000;
    for i in 0..1000 {
        let right = from_ground(&mut station, at(i), i);
        assert_eq!(verdict(&mut verifier, at(i), &right), Ok(()));
        heard.push(right);
        assert_eq!(verdict(&mut verifier, at(i), &unsigned(i, (255, 190))), Err(Unsigned));
        let foreign = from_ground(&mut stranger, at(i) + 1, i);
        assert_eq!(verdict(&mut verifier, at(i), &foreign), Err(WrongSignature));
        // A signer of the right key, whose clock is ahead.
        let future = from_ground(&mut signing(0, 0), at(i) + MINUTE + 1_000, i);
        assert_eq!(verdict(&mut verifier, at(i), &future), Err(FromTheFuture));
    }
    for packet in &heard {
        assert_eq!(verdict(&mut verifier, at(1000), packet), Err(Replayed));
    }
    // Every byte counts, the signature's own too.
    let right = from_ground(&mut station, at(1001), 1001);
    let mut refused = 0;
    for byte in 10..right.len() {
        let mut altered = right.clone();
        altered[byte] ^= 0x40;
        for packet in packets(&altered, &mut FramingCounters::default()) {
            let verdict = verifier.verify(at(1001), &packet, false);
            assert_eq!(verdict, Err(WrongSignature), "byte {byte}");
            refused += 1;
        }
    }
    // The thirteen altered bytes of the signature; alterations before it do not pass the checksum.
    assert_eq!(refused, 13);
    assert_eq!(
        verdict(&mut verifier, at(1001), &right),
        Ok(()),
        "and the packet itself is right"
    );
}

#[test]
fn each_stream_has_its_own_time_and_a_new_one_may_lag_a_minute() {
    let mut verifier = signing(0, 0);
    let mut heard = |now, sender, at: Timestamp| {
        let packet = signed(&mut signing(0, 7), at, &unsigned(0, sender));
        verdict(&mut verifier, now, &packet)
    };
    assert_eq!(heard(NOW, (255, 190), NOW), Ok(()));
    // Another component, half a minute behind: its own stream.
    assert_eq!(heard(NOW, (255, 191), NOW - MINUTE / 2), Ok(()));
    assert_eq!(heard(NOW, (255, 191), NOW - MINUTE / 2), Err(Replayed));
    assert_eq!(heard(NOW, (254, 190), NOW - MINUTE - 1), Err(Outdated));
    // A stream that is known may lag as far as it likes, as long as it goes forward.
    assert_eq!(heard(NOW + 10 * MINUTE, (255, 191), NOW), Ok(()));
}

#[test]
fn what_was_received_before_a_restart_is_refused_after_it() {
    let mut station = signing(0, 0);
    let mut verifier = signing(0, 1);
    let heard: Vec<_> = (0..50)
        .map(|i| from_ground(&mut station, NOW + u64::from(i), i))
        .collect();
    for packet in &heard {
        assert_eq!(verdict(&mut verifier, NOW, packet), Ok(()));
    }
    let stored = verifier.memory().clone();

    let mut forgetful = signing(0, 1);
    assert_eq!(
        verdict(&mut forgetful, NOW, &heard[49]),
        Ok(()),
        "without the memory it would be accepted"
    );

    let mut restarted = Signing::new(key(0), 1, stored.clone());
    for packet in &heard {
        assert_eq!(verdict(&mut restarted, NOW, packet), Err(Replayed));
    }
    let next = from_ground(&mut station, NOW + 60, 50);
    assert_eq!(verdict(&mut restarted, NOW + 60, &next), Ok(()));

    // Stored ahead: what came between the storing and the end is refused too.
    let ahead = stored.ahead(&SigningMemory::default(), NOW, 2 * UNITS_PER_SECOND);
    let mut killed = Signing::new(key(0), 1, ahead);
    assert_eq!(verdict(&mut killed, NOW + 60, &next), Err(Replayed));
    let after = from_ground(&mut station, NOW + 3 * UNITS_PER_SECOND, 51);
    assert_eq!(verdict(&mut killed, NOW + 3 * UNITS_PER_SECOND, &after), Ok(()));
}

/// Who has the key, and each of whose packets is further ahead than the one before.
#[test]
fn nobody_carries_the_clock_ahead_packet_by_packet() {
    let mut verifier = signing(0, 0);
    let step = 55 * UNITS_PER_SECOND;
    for i in 1..=20 {
        let at = NOW + u64::from(i) * step;
        let packet = from_ground(&mut signing(0, 0), at, i);
        let expected = if i == 1 { Ok(()) } else { Err(FromTheFuture) };
        assert_eq!(verdict(&mut verifier, NOW, &packet), expected, "{i}");
    }
    // Others are heard as before, a new one too, and what is sent bears the clock's time.
    for component in [191, 192] {
        let packet = signed(&mut signing(0, 0), NOW + 1, &unsigned(0, (255, component)));
        assert_eq!(verdict(&mut verifier, NOW + 1, &packet), Ok(()));
    }
    let sent = from_ground(&mut verifier, NOW + 2, 0);
    assert_eq!(verdict(&mut signing(0, 0), NOW - MINUTE + 2, &sent), Ok(()));
}

#[test]
fn sent_timestamps_only_grow_whatever_the_clock_does() {
    let mut signer = signing(0, 0);
    let mut verifier = signing(0, 0);
    for (i, clock) in [NOW, NOW, NOW - MINUTE / 2, 0, NOW + 5].into_iter().enumerate() {
        let packet = from_ground(&mut signer, clock, i as u32);
        assert_eq!(verdict(&mut verifier, NOW, &packet), Ok(()), "packet {i}");
    }
    // A clock that begins at zero goes on where the memory ends.
    let mut restarted = Signing::new(key(0), 0, signer.memory().clone());
    let packet = from_ground(&mut restarted, 0, 9);
    assert_eq!(verdict(&mut verifier, NOW, &packet), Ok(()));
}

#[test]
fn senders_beyond_the_table_are_refused_and_those_in_it_go_on() {
    let mut verifier = signing(0, 0);
    let from = |component: usize, at| signed(&mut signing(0, 0), at, &unsigned(0, (9, component as u8)));
    for component in 0..MAX_STREAMS {
        assert_eq!(verdict(&mut verifier, NOW, &from(component, NOW)), Ok(()));
    }
    assert_eq!(
        verdict(&mut verifier, NOW, &from(MAX_STREAMS, NOW)),
        Err(TooManyStreams)
    );
    assert_eq!(verdict(&mut verifier, NOW, &from(0, NOW + 1)), Ok(()));
    // Later the oldest gives way. What it sent stays refused, whatever the clock does.
    let later = NOW + MINUTE + 1;
    assert_eq!(verdict(&mut verifier, later, &from(MAX_STREAMS, later)), Ok(()));
    assert_eq!(verdict(&mut verifier, NOW, &from(1, NOW)), Err(Outdated));
    assert_eq!(verdict(&mut verifier, later, &from(0, NOW + 1)), Err(Replayed));
}

#[test]
fn what_cannot_be_signed_is_said() {
    let mut signer = signing(0, 0);
    let packet = unsigned(0, (1, 191));
    let mut out = [0; 400];
    assert!(signer.sign(NOW, &packet, &mut out[..packet.len() + 12]).is_err());
    let len = signer.sign(NOW, &packet, &mut out).unwrap();
    let twice = out[..len].to_vec();
    assert!(signer.sign(NOW, &twice, &mut out).is_err());
    assert!(signer.sign(NOW, &[0xFE, 0, 0, 1, 1, 0, 0, 0], &mut out).is_err());
    assert!(signer.sign(NOW, &[], &mut out).is_err());
}

#[test]
fn the_protocols_epoch_is_2015() {
    assert_eq!(timestamp_of_unix_ns(1_420_070_400_000_000_000), 0);
    assert_eq!(timestamp_of_unix_ns(1_420_070_401_000_000_000), UNITS_PER_SECOND);
    assert_eq!(timestamp_of_unix_ns(0), 0);
}

#[test]
fn the_key_is_not_shown() {
    assert_eq!(format!("{:?}", key(65)), "SigningKey(..)");
    assert!(!format!("{:?}", signing(65, 0)).contains("65"));
}
