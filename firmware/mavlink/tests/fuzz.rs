//! Any bytes from anybody: nothing panics, nothing altered is obeyed, what goes out is well formed.

mod common;

use common::peer::Peer;
use common::{Bench, Flight, GROUND_STATION, VEHICLE, bytes_of, command_long, messages, raw_command, reposition};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use vigil_mavlink::common::*;
use vigil_mavlink::framing::{CommandForm, FramingCounters, encode_payload, packets};
use vigil_mavlink::mavlink::Message;
use vigil_mavlink::{Flavour, MavHeader, MavMessage, message};
use vigil_types::GuidanceState::{Engaging, Guided, Hold, Land, Standby};
use vigil_types::{Reasons, VehicleRequest};

/// One packet of everything that the companion reads.
fn corpus() -> Vec<Vec<u8>> {
    let autopilot = MavAutopilot::MAV_AUTOPILOT_PX4;
    let landed_state = MavLandedState::MAV_LANDED_STATE_IN_AIR;
    let (command, target_system, target_component) = (MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, 1, 191);
    let mut packets: Vec<Vec<u8>> = [
        message!(HEARTBEAT, autopilot, mavlink_version = 3),
        message!(LOCAL_POSITION_NED, x = 1.0, vz = 2.0),
        message!(ATTITUDE, yaw = 1.0, yawspeed = 0.1),
        message!(ATTITUDE_QUATERNION, q1 = 1.0, yawspeed = 0.1),
        message!(EXTENDED_SYS_STATE, landed_state),
        message!(SYS_STATUS, battery_remaining = 50),
        message!(HOME_POSITION, latitude = 1, z = 1.0),
        message!(GPS_GLOBAL_ORIGIN, altitude = 1),
        message!(COMMAND_ACK, command, target_system, target_component),
        message!(TIMESYNC, ts1 = 5),
    ]
    .iter()
    .map(|m| bytes_of(VEHICLE, m))
    .collect();
    let asked = [
        command_long(MavCmd::MAV_CMD_NAV_GUIDED_ENABLE, (1, 191), 1.0),
        reposition(MavFrame::MAV_FRAME_LOCAL_NED, 1, 2, -3.0),
    ];
    packets.extend(asked.iter().map(|m| bytes_of(GROUND_STATION, m)));
    packets
}

/// A whole life with these datagrams: none is a request, everything sent can be parsed.
fn live(flavour: Flavour, datagrams: &[Vec<u8>]) -> u64 {
    let mut b = Bench::new(flavour);
    let mut requests = 0;
    let asks = [
        (Standby, VehicleRequest::None),
        (Engaging, VehicleRequest::FlyExternal { takeoff_height_m: 3.0 }),
        (Hold, VehicleRequest::None),
        (Land, VehicleRequest::Land),
    ];
    for (n, datagram) in datagrams.iter().enumerate() {
        // In turn on the vehicle's link and on two others.
        b.companion.receive(b.now_ns, (n % 3) as u8, datagram);
        while b.companion.take_request().is_some() {
            requests += 1;
        }
        let (state, request) = asks[n / 3 % asks.len()];
        b.step(state, Reasons::NONE, request);
        messages(&b.sent);
    }
    requests
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, rng_seed: RngSeed::Fixed(1), ..ProptestConfig::default() })]

    #[test]
    fn any_bytes_are_survived(datagrams in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..300), 1..40)) {
        live(Flavour::Px4, &datagrams);
    }

    /// Valid packets with a byte altered, cut or inserted: the checksum catches them, so that none is obeyed. (16 bits
    /// catch every single altered byte, and all but one in 65 536 of the rest: the seed is fixed.)
    #[test]
    fn altered_packets_are_not_obeyed(
        alterations in proptest::collection::vec((0usize..12, 0usize..300, any::<u8>(), 0u8..3), 1..60),
        ardupilot in any::<bool>(),
    ) {
        let corpus = corpus();
        let datagrams: Vec<Vec<u8>> = alterations
            .iter()
            .map(|(which, at, byte, how)| {
                let mut packet = corpus[*which].clone();
                let at = at % packet.len();
                match how {
                    0 => packet[at] ^= (*byte).max(1),
                    1 => packet.truncate(at),
                    // Before the start marker a byte would be harmless garbage, and behind the end it would not be in it.
                    _ => packet.insert(at.max(1), packet[at.max(1)].wrapping_add(byte | 1)),
                }
                packet
            })
            .collect();
        let flavour = if ardupilot { Flavour::ArduPilot } else { Flavour::Px4 };
        prop_assert_eq!(live(flavour, &datagrams), 0);
    }

    /// Valid packets in any order: nothing panics, and only the two requests of the corpus are requests.
    #[test]
    fn valid_packets_in_any_order_are_survived(order in proptest::collection::vec(0usize..12, 1..80)) {
        let corpus = corpus();
        let datagrams: Vec<Vec<u8>> = order.iter().map(|i| corpus[*i].clone()).collect();
        let expected = order.iter().filter(|i| **i >= 10).count() as u64;
        prop_assert_eq!(live(Flavour::ArduPilot, &datagrams), expected);
    }
}

/// What a field may hold at the worst, and on either side of what it should.
const EXTREMES: [f32; 12] = [
    f32::NAN,
    f32::INFINITY,
    f32::NEG_INFINITY,
    f32::MAX,
    f32::MIN,
    f32::MIN_POSITIVE,
    1.9e16,
    -1.0,
    0.5,
    1.0,
    255.0,
    65_536.0,
];
const EXTREME_INTEGERS: [i32; 6] = [i32::MIN, i32::MAX, -1, 1, 900_000_001, -1_800_000_001];

/// The commands of the dialect.
fn commands() -> impl Iterator<Item = u16> {
    let is_known = |number: &u16| {
        let packet = raw_command(*number, [0.0; 7], CommandForm::Long { confirmation: 0 });
        packets(&packet, &mut FramingCounters::default()).any(|packet| packet.message().is_ok())
    };
    (0..u16::MAX).filter(is_known)
}

impl Flight {
    /// A step after a datagram: how many commands were answered. What is sent parses, and leads nowhere that is no place.
    fn survives(&mut self, datagram: &[u8], what: &dyn core::fmt::Debug) -> usize {
        self.companion.receive(self.now_ns, 0, datagram);
        let output = self.step();
        assert!(output.setpoint.is_none_or(|s| s.is_finite()), "{what:?}: {output:?}");
        assert!(
            self.peer.north_m.is_finite() && self.peer.height_m.is_finite(),
            "{what:?}"
        );
        let is_ack = |m: &&(MavHeader, MavMessage)| matches!(m.1, MavMessage::COMMAND_ACK(_));
        messages(&self.sent).iter().filter(is_ack).count()
    }
}

/// Of a whole flight, so that guidance is asked whatever the companion takes for a request.
#[test]
fn every_command_of_the_dialect_is_answered_once_with_extremes_in_every_parameter() {
    let mut count = 0;
    for number in commands() {
        count += 1;
        let mut f = Flight::new(Flavour::Px4, Peer::on_the_ground(Flavour::Px4));
        f.until(Guided);
        for (i, extreme) in EXTREMES.into_iter().enumerate() {
            for place in 0..8 {
                let mut params = [0.0; 7];
                match params.get_mut(place) {
                    Some(param) => *param = extreme,
                    None => params = [extreme; 7],
                }
                let frame = (8 * i + place) as u8 % 24;
                let x = EXTREME_INTEGERS[place % EXTREME_INTEGERS.len()];
                let y = EXTREME_INTEGERS[(i + place) % EXTREME_INTEGERS.len()];
                for form in [CommandForm::Long { confirmation: 0 }, CommandForm::Int { frame, x, y }] {
                    let answers = f.survives(&raw_command(number, params, form), &(number, params, form));
                    assert_eq!(answers, 1, "{number} {params:?} {form:?}");
                }
            }
        }
    }
    assert!(count > 150, "{count} commands: what does the dialect have?");
}

/// From the vehicle itself and from a station: extreme numbers at every place where a field can begin.
#[test]
fn every_message_of_the_dialect_is_survived_with_extremes_in_every_field() {
    let patterns = EXTREMES.map(f32::to_le_bytes).into_iter();
    let patterns: Vec<[u8; 4]> = patterns.chain(EXTREME_INTEGERS.map(i32::to_le_bytes)).collect();
    for id in (0..13_000).filter(|id| MavMessage::default_message_from_id(*id).is_some()) {
        for from in [VEHICLE, GROUND_STATION] {
            let mut f = Flight::new(Flavour::Px4, Peer::on_the_ground(Flavour::Px4));
            f.until(Guided);
            for pattern in &patterns {
                let packet = |payload: &[u8]| encode_payload(from, 0, id, payload).expect("fits");
                for at in (0..60).step_by(4) {
                    let mut payload = [0; 64];
                    payload[at..at + 4].copy_from_slice(pattern);
                    f.companion.receive(f.now_ns, 0, &packet(&payload));
                }
                f.survives(&packet(&pattern.repeat(16)), &(id, from, pattern));
            }
        }
    }
}
