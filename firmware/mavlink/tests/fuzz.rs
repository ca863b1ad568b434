//! Any bytes from anybody: nothing panics, nothing altered is obeyed, what goes out is well formed.

mod common;

use common::{Bench, GROUND_STATION, bytes_of, command_long, messages, reposition};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use vigil_mavlink::common::*;
use vigil_mavlink::{Flavour, MavHeader, MavMessage};
use vigil_types::GuidanceState::{Engaging, Hold, Land, Standby};
use vigil_types::{Reasons, VehicleRequest};

const VEHICLE: MavHeader = MavHeader {
    system_id: 1,
    component_id: 1,
    sequence: 9,
};

/// One packet of everything that the companion reads.
fn corpus() -> Vec<Vec<u8>> {
    let mut packets: Vec<Vec<u8>> = [
        MavMessage::HEARTBEAT(HEARTBEAT_DATA {
            autopilot: MavAutopilot::MAV_AUTOPILOT_PX4,
            mavlink_version: 3,
            ..Default::default()
        }),
        MavMessage::LOCAL_POSITION_NED(LOCAL_POSITION_NED_DATA {
            x: 1.0,
            vz: 2.0,
            ..Default::default()
        }),
        MavMessage::ATTITUDE(ATTITUDE_DATA {
            yaw: 1.0,
            yawspeed: 0.1,
            ..Default::default()
        }),
        MavMessage::ATTITUDE_QUATERNION(ATTITUDE_QUATERNION_DATA {
            q1: 1.0,
            yawspeed: 0.1,
            ..Default::default()
        }),
        MavMessage::EXTENDED_SYS_STATE(EXTENDED_SYS_STATE_DATA {
            landed_state: MavLandedState::MAV_LANDED_STATE_IN_AIR,
            ..Default::default()
        }),
        MavMessage::SYS_STATUS(SYS_STATUS_DATA {
            battery_remaining: 50,
            ..Default::default()
        }),
        MavMessage::HOME_POSITION(HOME_POSITION_DATA {
            latitude: 1,
            z: 1.0,
            ..Default::default()
        }),
        MavMessage::GPS_GLOBAL_ORIGIN(GPS_GLOBAL_ORIGIN_DATA {
            altitude: 1,
            ..Default::default()
        }),
        MavMessage::COMMAND_ACK(COMMAND_ACK_DATA {
            command: MavCmd::MAV_CMD_COMPONENT_ARM_DISARM,
            target_system: 1,
            target_component: 191,
            ..Default::default()
        }),
        MavMessage::TIMESYNC(TIMESYNC_DATA {
            ts1: 5,
            ..Default::default()
        }),
    ]
    .iter()
    .map(|m| bytes_of(VEHICLE, m))
    .collect();
    packets.push(bytes_of(
        GROUND_STATION,
        &command_long(MavCmd::MAV_CMD_NAV_GUIDED_ENABLE, (1, 191), 1.0),
    ));
    packets.push(bytes_of(
        GROUND_STATION,
        &reposition(MavFrame::MAV_FRAME_LOCAL_NED, 1, 2, -3.0),
    ));
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
