//! Bytes that must not be obeyed, and cannot do harm.

use crate::testing::*;
use crate::tests::plans::{MISSION, RALLY, item, waypoint};
use proptest::prelude::*;
use vigil_mavlink::framing::{CommandForm, FramingCounters, packets};

#[test]
fn arming_with_nonsense_is_denied() {
    let mut b = Bench::new();
    for p in [f32::NAN, f32::INFINITY, -1.0, 0.5, 2.0] {
        assert_eq!(b.ask(400, &[p]), DENIED);
    }
    assert!(!b.status().armed);
}

#[test]
fn bad_setpoints_are_counted_and_do_not_keep_offboard_alive() {
    let mut b = Bench::airborne();
    b.fly(API, SCRIPT, [0.5, 0.0, 0.0], 200);
    b.stream(API, SCRIPT, [f32::INFINITY, 0.0, 0.0]);
    b.run_ms(1_100);
    let status = b.status();
    assert!(status.refusals.setpoint_value >= 8, "{status:?}");
    assert_eq!(status.mode, FlightMode::Hold);
    let offset = local_setpoint(0x5C7, |m| m.coordinate_frame = MavFrame::MAV_FRAME_LOCAL_OFFSET_NED);
    b.send(API, SCRIPT, &offset);
    assert_eq!(b.status().refusals.setpoint_form, 1);
}

#[test]
fn damaged_truncated_and_garbage_bytes_are_counted_and_the_next_packet_is_heard() {
    let mut b = Bench::new();
    let arm = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    let good = command(SCRIPT, 400, arm, LONG);
    let mut damaged = good.clone();
    damaged[12] ^= 0x40;
    b.send_raw(API, &damaged);
    b.send_raw(API, &good[..good.len() - 3]);
    b.send_raw(API, &[0x55; 300]);
    b.send_raw(API, &[]);
    let framing = b.status().framing;
    assert_eq!((framing.bad_crc, framing.truncated), (1, 1));
    assert!(framing.garbage_bytes >= 300);
    assert!(!b.status().armed);
    let mut behind_garbage = vec![0xFD, 0x03, 0xFE];
    behind_garbage.extend_from_slice(&good);
    b.send_raw(API, &behind_garbage);
    assert!(b.status().armed);
}

#[test]
fn a_link_that_does_not_exist_is_ignored() {
    let mut b = Bench::with(EndpointConfig::companion_only());
    let heartbeat = b.packet(COMPANION, &message!(HEARTBEAT));
    b.send_raw(LinkId(1), &heartbeat);
    b.send_raw(LinkId(255), &heartbeat);
    assert_eq!(b.status().framing.packets, 0);
}

#[test]
fn a_caller_that_never_transmits_costs_bounded_memory() {
    let mut endpoint = crate::Endpoint::new(EndpointConfig::default()).expect("valid");
    let view = Bench::new().view();
    for ms in 0..60_000_u64 {
        endpoint.step(ms * 1_000_000, &view);
    }
    assert!(endpoint.status().dropped > 0);
    let mut bytes = 0;
    endpoint.transmit(|_, _, datagram| bytes += datagram.len());
    assert!(bytes <= 256 * 1024);
}

/// Messages of the services, where their target fields are, and how much of them is sent.
const MESSAGES: [(u32, usize, usize); 16] = [
    (FILE_TRANSFER_PROTOCOL_DATA::ID, 1, 100),
    (LOG_REQUEST_LIST_DATA::ID, 4, 6),
    (LOG_REQUEST_DATA_DATA::ID, 10, 12),
    (LOG_ERASE_DATA::ID, 0, 2),
    (SERIAL_CONTROL_DATA::ID, 79, 100),
    (REQUEST_EVENT_DATA::ID, 4, 6),
    (MISSION_REQUEST_PARTIAL_LIST_DATA::ID, 4, 9),
    (MISSION_WRITE_PARTIAL_LIST_DATA::ID, 4, 9),
    (MISSION_ITEM_DATA::ID, 32, 38),
    (MISSION_REQUEST_DATA::ID, 2, 9),
    (MISSION_SET_CURRENT_DATA::ID, 2, 9),
    (MISSION_REQUEST_LIST_DATA::ID, 0, 9),
    (MISSION_COUNT_DATA::ID, 2, 9),
    (MISSION_ACK_DATA::ID, 0, 9),
    (MISSION_REQUEST_INT_DATA::ID, 2, 9),
    (MISSION_ITEM_INT_DATA::ID, 32, 38),
];

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn any_payloads_of_files_logs_shell_events_and_plans_are_survived(
        packets in prop::collection::vec(
            (prop::sample::select(&MESSAGES[..]), 0..18_u8, prop::collection::vec(any::<u8>(), 100), 0..40_usize),
            1..80,
        ),
    ) {
        let mut b = Bench::airborne();
        let taken = MavMissionResult::MAV_MISSION_ACCEPTED;
        prop_assert_eq!(b.upload(MISSION, &[waypoint((10.0, 2.0), 5.0)]), taken);
        for ((id, target_at, len), opcode, mut payload, more) in packets {
            payload[target_at..target_at + 2].copy_from_slice(&[1, 1]);
            if id == FILE_TRANSFER_PROTOCOL_DATA::ID {
                // Session, an operation that there is, a size that fits.
                payload[5] &= 3;
                payload[6] = opcode;
                payload[7] &= 0x3F;
            } else if id == MISSION_COUNT_DATA::ID {
                // Few kinds and small counts, so that uploads do begin.
                payload[0] &= 3;
                payload[1] = 0;
                payload[4] = payload[4] & 1 | 1;
            }
            b.sent.clear();
            b.send_raw(API, &raw(SCRIPT, id, &payload[..(len + more).min(100)]));
            b.run_ms(20);
            // A shell line may answer in several packets; nothing answers without bound.
            prop_assert!(b.sent.len() < 200, "{}", b.sent.len());
        }
        prop_assert!(b.status().armed && b.status().dropped == 0);
        b.run_ms(6_000);
        prop_assert_eq!(b.status().mode, FlightMode::Hold);
        prop_assert_eq!(b.download(MISSION).len(), 1);
        prop_assert!((b.height_m() - 3.0).abs() < 0.5);
        // The protocols still work.
        prop_assert_eq!(b.upload(RALLY, &[item(5100, [0.0; 4], (1.0, 1.0), 0.0)]), taken);
    }
}

/// What a field may hold at the worst, and on either side of what it should.
const EXTREMES: [f32; 13] = {
    let [nan, infinity, low] = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY];
    let (most, least, tiny) = (f32::MAX, f32::MIN, f32::MIN_POSITIVE);
    [
        nan, infinity, low, most, least, tiny, 1.9e16, -1.0, -2.0, 0.5, 1.0, 255.0, 65_536.0,
    ]
};
const EXTREME_INTEGERS: [i32; 6] = [i32::MIN, i32::MAX, -1, 1, 900_000_001, -1_800_000_001];
const FRAMES: [u8; 25] = [
    0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 99, 255,
];

/// The commands of the dialect, and one number that it does not have.
fn commands() -> impl Iterator<Item = u16> {
    let is_known = |number: &u16| {
        let packet = command(SCRIPT, *number, [0.0; 7], LONG);
        packets(&packet, &mut FramingCounters::default()).any(|packet| packet.message().is_ok())
    };
    (0..u16::MAX).filter(is_known).chain([65_000])
}

impl Bench {
    /// Sends a packet, lets three milliseconds pass, and looks after the vehicle; how many answers to commands came.
    fn survives(&mut self, packet: &[u8], what: &dyn core::fmt::Debug) -> usize {
        self.sent.clear();
        self.send_raw(API, packet);
        self.run_ms(3);
        let is_finite = self.position_m().iter().all(|p| p.is_finite());
        assert!(is_finite, "{what:?}: {:?}", self.command);
        // A stream at its highest rate, a list of parameters, files: nothing answers without bound.
        assert!(self.sent.len() < 400, "{what:?}: {} packets", self.sent.len());
        self.sent.iter().filter(|s| s.ack.is_some()).count()
    }
}

#[test]
fn every_command_of_the_dialect_is_answered_once_with_extremes_in_every_parameter() {
    let mut count = 0;
    for number in commands() {
        count += 1;
        let mut b = Bench::airborne();
        for extreme in EXTREMES {
            for place in 0..8 {
                let mut params = [0.0; 7];
                match params.get_mut(place) {
                    Some(param) => *param = extreme,
                    None => params = [extreme; 7],
                }
                let answers = b.survives(&command(SCRIPT, number, params, LONG), &(number, params));
                assert_eq!(answers, 1, "{number} {params:?}");
            }
        }
        for (i, frame) in FRAMES.into_iter().enumerate() {
            let extreme = EXTREMES[i % EXTREMES.len()];
            let x = EXTREME_INTEGERS[i % EXTREME_INTEGERS.len()];
            let y = EXTREME_INTEGERS[i / 5 % EXTREME_INTEGERS.len()];
            let packet = command(SCRIPT, number, [extreme; 7], CommandForm::Int { frame, x, y });
            let answers = b.survives(&packet, &(number, frame, extreme, x, y));
            assert_eq!(answers, 1, "{number} {frame}");
        }
        b.run_ms(200);
    }
    assert!(count > 150, "{count} commands: what does the dialect have?");
}

#[test]
fn every_command_of_the_dialect_as_a_mission_item_is_answered_with_extremes_in_every_field() {
    for number in commands() {
        let mut b = Bench::airborne();
        let plain = item(number, [0.0; 4], (1.0, 1.0), 5.0);
        let mut items = Vec::new();
        for extreme in EXTREMES {
            for place in 0..4 {
                let mut item = plain;
                item.params[place] = extreme;
                items.push(item);
            }
            items.push(crate::plan::PlanItem { z: extreme, ..plain });
        }
        items.extend(EXTREME_INTEGERS.map(|x| crate::plan::PlanItem { x, ..plain }));
        items.extend(EXTREME_INTEGERS.map(|y| crate::plan::PlanItem { y, ..plain }));
        items.extend(FRAMES.map(|frame| crate::plan::PlanItem { frame, ..plain }));
        for item in items {
            for kind in 0..3 {
                let answer = b.upload(kind, &[item]);
                if answer == MavMissionResult::MAV_MISSION_ACCEPTED && kind == 0 {
                    assert!(matches!(b.set_mode(API, SCRIPT, 4, 4), ACCEPTED | REJECTED));
                    b.run_ms(60);
                    assert!(b.position_m().iter().all(|p| p.is_finite()), "{item:?}");
                }
            }
        }
    }
}

/// Setpoints first of all; but whatever the dialect has, with extreme numbers at every place where a field can begin.
#[test]
fn every_message_of_the_dialect_is_survived_with_extremes_in_every_field() {
    use vigil_mavlink::mavlink::Message;
    let integers = EXTREME_INTEGERS.map(i32::to_le_bytes);
    let patterns = [&EXTREMES.map(f32::to_le_bytes)[..], &integers].concat();
    for id in (0..13_000).filter(|id| MavMessage::default_message_from_id(*id).is_some()) {
        let mut b = Bench::airborne();
        b.send_velocity(API, SCRIPT, [0.0; 3]);
        b.set_mode(API, SCRIPT, 6, 0);
        for pattern in &patterns {
            for at in (0..64).step_by(4) {
                let mut payload = [0; 64];
                payload[at..at + 4].copy_from_slice(pattern);
                b.sent.clear();
                b.send_raw(API, &raw(SCRIPT, id, &payload));
            }
            b.survives(&raw(SCRIPT, id, &pattern.repeat(16)), &(id, pattern));
        }
        b.run_ms(100);
    }
}

#[test]
fn every_setpoint_of_every_frame_and_mask_with_extremes_is_flown_or_refused_with_a_reason() {
    let mut b = Bench::airborne();
    for (i, mask) in (0..4096_u16).enumerate() {
        let frame = FRAMES[i % FRAMES.len()];
        let extreme = EXTREMES[i % EXTREMES.len()];
        for (id, values) in [
            (SET_POSITION_TARGET_LOCAL_NED_DATA::ID, [extreme; 11]),
            (SET_POSITION_TARGET_LOCAL_NED_DATA::ID, [1.0; 11]),
            (SET_POSITION_TARGET_GLOBAL_INT_DATA::ID, [extreme; 11]),
        ] {
            let mut payload = vec![0; 4];
            values.iter().for_each(|v| payload.extend_from_slice(&v.to_le_bytes()));
            payload.extend_from_slice(&mask.to_le_bytes());
            payload.extend_from_slice(&[1, 1, frame]);
            let before = b.status().refusals;
            b.survives(&raw(SCRIPT, id, &payload), &(id, frame, mask, extreme));
            let after = b.status().refusals;
            let refused = after.setpoint_form + after.setpoint_value - before.setpoint_form - before.setpoint_value;
            assert!(refused <= 1);
            if refused == 0 {
                let flown = b.set_mode(API, SCRIPT, 6, 0) == ACCEPTED;
                assert!(flown || b.status().failsafe.is_some() || b.status().mode != FlightMode::Offboard);
            }
        }
    }
    assert!(b.texts().len() < 10);
}
