use super::*;
use crate::{MavHeader, MavMessage, common::*, message};
use mavlink::{MAVLinkV1MessageRaw, MAVLinkV2MessageRaw, MavlinkVersion};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

const HEADER: MavHeader = MavHeader {
    system_id: 1,
    component_id: 191,
    sequence: 42,
};

fn heartbeat() -> MavMessage {
    message!(
        HEARTBEAT,
        custom_mode = 0x0006_0000,
        mavtype = MavType::MAV_TYPE_QUADROTOR,
        autopilot = MavAutopilot::MAV_AUTOPILOT_PX4,
        base_mode = MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED,
        system_status = MavState::MAV_STATE_ACTIVE,
        mavlink_version = 3
    )
}

fn bytes_of(message: &MavMessage) -> Vec<u8> {
    encode((1, 191), HEADER.sequence, message)
}

fn arm() -> Vec<u8> {
    let (command, target_system, target_component) = (MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, 1, 1);
    let message = message!(COMMAND_LONG, param1 = 1.0, command, target_system, target_component);
    bytes_of(&message)
}

/// A packet of the message number 12 900 000, which no dialect has.
fn unknown() -> Vec<u8> {
    let [a, b, c, _] = 12_900_000u32.to_le_bytes();
    vec![0xFD, 3, 0, 0, 1, 9, 8, a, b, c, 1, 2, 3, 0x55, 0xAA]
}

fn scan(bytes: &[u8]) -> (Vec<Packet<'_>>, FramingCounters) {
    let mut counters = FramingCounters::default();
    let found = packets(bytes, &mut counters).collect();
    (found, counters)
}

#[test]
fn a_renumbered_packet_is_the_one_with_that_number_from_the_start() {
    let mut packet = arm();
    renumber(&mut packet, 200);
    let (found, counters) = scan(&packet);
    assert_eq!((found[0].sequence(), counters.bad_crc), (200, 0));
    renumber(&mut packet, HEADER.sequence);
    assert_eq!(packet, arm());
    let mut foreign = unknown();
    renumber(&mut foreign, 200);
    assert_eq!(foreign, unknown(), "its checksum could not be made right again");
}

#[test]
fn bytes_are_those_of_the_crates_own_serializer() {
    for message in [
        heartbeat(),
        message!(STATUSTEXT, text = "guidance: hold (stale frame)".into()),
        message!(COMMAND_ACK),
    ] {
        let mut raw = MAVLinkV2MessageRaw::new();
        raw.serialize_message(HEADER, &message);
        assert_eq!(bytes_of(&message), raw.raw_bytes());
    }
}

#[test]
fn a_datagram_of_several_packets_yields_each_in_order() {
    let datagram = [bytes_of(&heartbeat()), arm(), bytes_of(&heartbeat())].concat();
    let (found, counters) = scan(&datagram);
    assert_eq!(found.iter().map(Packet::message_id).collect::<Vec<_>>(), [0, 76, 0]);
    let three = FramingCounters {
        packets: 3,
        ..Default::default()
    };
    assert_eq!(counters, three);
    let first = &found[0];
    assert_eq!((first.is_signed(), first.version()), (false, MavlinkVersion::V2));
    assert_eq!((first.system_id(), first.component_id()), (1, 191));
    assert_eq!((first.message().unwrap(), first.header()), (heartbeat(), HEADER));
    assert_eq!(found.iter().map(Packet::raw).collect::<Vec<_>>().concat(), datagram);
}

#[test]
fn mavlink_1_packets_are_understood() {
    let mut raw = MAVLinkV1MessageRaw::new();
    raw.serialize_message(HEADER, &heartbeat());
    let (found, counters) = scan(raw.raw_bytes());
    assert_eq!(found[0].message().unwrap(), heartbeat());
    assert_eq!((found[0].version(), counters.packets), (MavlinkVersion::V1, 1));
}

#[test]
fn garbage_is_skipped_and_counted() {
    let datagram = [b"ab\xFD\x01 no packet \xFE\x02".to_vec(), arm(), vec![1, 2, 3]].concat();
    let (found, counters) = scan(&datagram);
    assert_eq!(found.len(), 1);
    assert_eq!(counters.packets, 1);
    assert_eq!(counters.garbage_bytes as usize, datagram.len() - arm().len());
}

#[test]
fn an_altered_packet_is_one_bad_crc_and_the_next_is_found() {
    let mut altered = arm();
    altered[14] ^= 0xFD;
    let (datagram, good) = ([altered, bytes_of(&heartbeat())].concat(), bytes_of(&heartbeat()));
    let (found, counters) = scan(&datagram);
    assert_eq!(found.iter().map(|p| p.raw()).collect::<Vec<_>>(), [&good[..]]);
    assert_eq!((counters.bad_crc, counters.truncated), (1, 0));
}

#[test]
fn a_packet_cut_by_the_end_of_its_datagram_is_truncated() {
    let whole = arm();
    for len in 1..whole.len() {
        let (found, counters) = scan(&whole[..len]);
        assert_eq!((found.len(), counters.truncated), (0, 1), "{len}");
    }
}

#[test]
fn an_unknown_message_is_yielded_raw_and_counted() {
    let datagram = [unknown(), bytes_of(&heartbeat())].concat();
    let (found, counters) = scan(&datagram);
    assert_eq!(found.len(), 2);
    assert_eq!((found[0].message_id(), found[0].is_known()), (12_900_000, false));
    assert_eq!(found[0].payload(), [1, 2, 3]);
    assert!(found[0].message().is_err() && found[0].target().is_none());
    assert_eq!((counters.unknown_message, counters.packets), (1, 2));
}

#[test]
fn a_packet_with_an_unknown_incompatibility_flag_is_discarded() {
    let mut packet = arm();
    packet[2] = 0x04;
    let (found, counters) = scan(&packet);
    assert_eq!((found.len(), counters.incompatible), (0, 1));
}

#[test]
fn a_command_of_unknown_number_can_be_read_and_answered() {
    let mut payload = [0u8; 33];
    payload[..4].copy_from_slice(&2.5f32.to_le_bytes());
    payload[28..30].copy_from_slice(&54_321u16.to_le_bytes());
    (payload[30], payload[31], payload[32]) = (1, 191, 3);
    let mut out = [0; MAX_PACKET_LEN];
    let len = serialize_payload(HEADER, 76, &payload, &mut out).unwrap();
    let (found, _) = scan(&out[..len]);
    assert!(found[0].message().is_err(), "the crate has no such command");
    let command = Command {
        target_component: 191,
        ..Command::to_autopilot(1, 54_321, [2.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], 3)
    };
    assert_eq!(found[0].command(), Some(command));

    let ack = CommandAck {
        command: command.number,
        result: 3,
        target_system: 255,
        target_component: 190,
        ..Default::default()
    };
    let len = ack.serialize(HEADER, &mut out).unwrap();
    let (found, counters) = scan(&out[..len]);
    assert_eq!((found[0].command_ack(), counters.bad_crc), (Some(ack), 0));
    assert_eq!(found[0].target(), Some((255, 190)));
}

#[test]
fn commands_read_raw_equal_those_of_the_crates_parser() {
    let int = COMMAND_INT_DATA {
        param1: -1.0,
        param2: 1.0,
        param3: 0.0,
        param4: f32::NAN,
        x: 473_977_420,
        y: -200_000,
        z: -3.5,
        command: MavCmd::MAV_CMD_DO_REPOSITION,
        target_system: 1,
        target_component: 191,
        frame: MavFrame::MAV_FRAME_LOCAL_NED,
        ..Default::default()
    };
    let bytes = bytes_of(&MavMessage::COMMAND_INT(int));
    let (found, _) = scan(&bytes);
    let c = found[0].command().unwrap();
    assert_eq!((c.number, c.frame()), (192, 1));
    let params = [0, 2, 4, 5, 7].map(|number| c.param(number));
    assert_eq!(params, [None, Some(1.0), None, None, Some(-3.5)]);
    let (lat, lon) = c.latitude_longitude_deg().unwrap();
    assert!((lat - 47.397742).abs() < 1e-9 && (lon + 0.02).abs() < 1e-9);
    assert!((c.local_x_y_m().unwrap().1 + 20.0).abs() < 1e-5);
    assert_eq!(found[0].target(), Some((1, 191)));
}

#[test]
fn a_command_survives_the_way_to_bytes_and_back() {
    let long = Command::to_autopilot(3, 54_321, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0], 2);
    let int = Command {
        form: CommandForm::Int {
            frame: 6,
            x: -7,
            y: 473_977_420,
        },
        ..long
    };
    let mut out = [0; MAX_PACKET_LEN];
    let len = long.serialize(HEADER, &mut out).unwrap();
    assert_eq!(scan(&out[..len]).0[0].command(), Some(long));
    let len = int.serialize(HEADER, &mut out).unwrap();
    let read = scan(&out[..len]).0[0].command().unwrap();
    assert_eq!((read.form, read.number), (int.form, int.number));
    assert_eq!(read.params[6], int.params[6]);
}

#[test]
fn trailing_zeros_that_were_cut_read_as_zero() {
    let command = MavCmd::MAV_CMD_COMPONENT_ARM_DISARM;
    let bytes = bytes_of(&message!(COMMAND_LONG, param1 = 1.0, command));
    let (found, _) = scan(&bytes);
    assert!(found[0].payload().len() < 33);
    let c = found[0].command().unwrap();
    assert_eq!((c.number, c.target_system, c.param(7)), (400, 0, Some(0.0)));
}

#[test]
fn the_target_of_a_message_that_does_not_parse_is_found_by_its_layout() {
    // MISSION_ITEM_INT (73): target_system at byte 32, target_component at 33, command (u16) at 30.
    let mut payload = [0u8; 38];
    payload[28..30].copy_from_slice(&7u16.to_le_bytes());
    payload[30..32].copy_from_slice(&54_321u16.to_le_bytes());
    (payload[32], payload[33]) = (1, 190);
    let packet = encode_payload((1, 191), 0, 73, &payload).unwrap();
    let (found, _) = scan(&packet);
    assert!(found[0].message().is_err());
    assert_eq!(found[0].target(), Some((1, 190)));
    let bytes = bytes_of(&heartbeat());
    assert_eq!(scan(&bytes).0[0].target(), None);
}

#[test]
fn what_cannot_be_serialised_is_an_error() {
    use SerializeError::*;
    let short = serialize(HEADER, &heartbeat(), &mut [0; 8]);
    assert!(matches!(short, Err(BufferTooSmall { available: 8, .. })));
    let far = MavHeader {
        system_id: 300,
        ..HEADER
    };
    for (header, id, payload, error) in [
        (far, 0, &[1; 9][..], SystemId(300)),
        (HEADER, 12_900_000, &[1], UnknownMessage(12_900_000)),
        (HEADER, 0, &[1; 300], PayloadTooLong(300)),
    ] {
        assert_eq!(serialize_payload(header, id, payload, &mut [0; 600]), Err(error));
    }
}

#[test]
fn a_stream_may_be_cut_anywhere() {
    let all = [
        b"x\xFDy".to_vec(),
        arm(),
        bytes_of(&heartbeat()),
        b"\xFE".to_vec(),
        arm(),
        arm(),
    ]
    .concat();
    for chunk in [1, 2, 7, 40, 1000] {
        let (mut framer, mut counters, mut ids) = (StreamFramer::default(), FramingCounters::default(), Vec::new());
        for part in all.chunks(chunk) {
            framer.feed(part, &mut counters, |p| ids.push(p.message_id()));
        }
        // A false start marker may swallow bytes until its supposed end is here, then they are searched again.
        framer.feed(&[0; 300], &mut counters, |p| ids.push(p.message_id()));
        assert_eq!(ids, [76, 0, 76, 76], "chunks of {chunk}");
    }
}

#[test]
fn a_long_stream_in_one_piece_is_read_in_fixed_memory() {
    let all = arm().repeat(500);
    let (mut framer, mut counters, mut n) = (StreamFramer::default(), FramingCounters::default(), 0);
    framer.feed(&all, &mut counters, |_| n += 1);
    assert_eq!((n, counters.packets, counters.garbage_bytes), (500, 500, 0));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, rng_seed: RngSeed::Fixed(1), ..ProptestConfig::default() })]

    /// Any bytes: no panic, and every byte belongs to exactly one packet or is counted as garbage.
    #[test]
    fn no_bytes_are_lost_or_counted_twice(bytes in proptest::collection::vec(prop_oneof![3 => any::<u8>(), 1 => Just(0xFD), 1 => Just(0xFE)], 0..700)) {
        let (found, counters) = scan(&bytes);
        let in_packets: usize = found.iter().map(|p| p.raw().len()).sum();
        prop_assert_eq!(in_packets + counters.garbage_bytes as usize, bytes.len());
        for p in &found {
            let _ = (p.message(), p.command(), p.command_ack(), p.target());
        }
    }

    /// Valid packets with altered bytes: never a panic, never an altered packet passed off as the original.
    #[test]
    fn an_altered_known_packet_is_never_yielded(at in 0usize..200, to in any::<u8>()) {
        let original = [arm(), bytes_of(&heartbeat()), arm()].concat();
        let mut altered = original.clone();
        let at = at % altered.len();
        prop_assume!(altered[at] != to);
        altered[at] = to;
        let (found, _) = scan(&altered);
        for p in found.iter().filter(|p| p.is_known()) {
            prop_assert!(original.windows(p.raw().len()).any(|w| w == p.raw()));
        }
    }

    /// The stream framer finds what the datagram scanner finds, however the bytes are cut.
    #[test]
    fn stream_and_datagram_agree_on_valid_packets(order in proptest::collection::vec(0u8..3, 1..20), chunk in 1usize..400) {
        let bytes: Vec<u8> = order.iter().flat_map(|k| match k { 0 => arm(), 1 => bytes_of(&heartbeat()), _ => unknown() }).collect();
        let ids: Vec<u32> = scan(&bytes).0.iter().map(Packet::message_id).collect();
        let (mut framer, mut counters, mut streamed) = (StreamFramer::default(), FramingCounters::default(), Vec::new());
        for part in bytes.chunks(chunk) {
            framer.feed(part, &mut counters, |p| streamed.push(p.message_id()));
        }
        prop_assert_eq!(streamed, ids);
    }
}
