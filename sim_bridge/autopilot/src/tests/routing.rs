//! What passes between links, and that the vehicle answers for nobody else.

use crate::testing::*;

fn forwarded(b: &Bench, link: LinkId) -> Vec<(ComponentId, MavMessage)> {
    let others = b.sent.iter().filter(|s| s.link == link && s.from != VEHICLE);
    others.filter_map(|s| Some((s.from, s.message.clone()?))).collect()
}

const ARM: MavCmd = MavCmd::MAV_CMD_COMPONENT_ARM_DISARM;

fn command_to(target_system: u8, target_component: u8, command: MavCmd) -> MavMessage {
    message!(COMMAND_LONG, param1 = 1.0, command, target_system, target_component)
}

#[test]
fn a_script_sees_the_companions_heartbeat_texts_and_values() {
    let mut b = Bench::new();
    b.send(ONBOARD, COMPANION, &message!(HEARTBEAT));
    let value = message!(NAMED_VALUE_FLOAT, name = "gd_state".into(), value = 3.0);
    b.send(ONBOARD, COMPANION, &value);
    for link in [API, GCS] {
        let seen = forwarded(&b, link);
        assert_eq!(seen.len(), 2);
        assert!(seen.iter().all(|(from, _)| *from == COMPANION));
        assert_eq!(seen[1].1, value);
    }
    assert!(forwarded(&b, ONBOARD).is_empty(), "not back where it came from");
}

#[test]
fn a_command_for_the_companion_reaches_it_and_the_vehicle_does_not_answer() {
    let mut b = Bench::new();
    b.send(ONBOARD, COMPANION, &message!(HEARTBEAT));
    b.sent.clear();
    let command = command_to(1, 191, MavCmd::MAV_CMD_NAV_GUIDED_ENABLE);
    b.send(API, SCRIPT, &command);
    assert_eq!(forwarded(&b, ONBOARD), [(SCRIPT, command)]);
    assert!(b.sent.iter().all(|s| s.ack.is_none()));
    assert!(forwarded(&b, GCS).is_empty());
    // To everybody it is passed on, and the vehicle neither arms nor answers, as PX4 does not.
    b.send(API, SCRIPT, &command_to(0, 0, ARM));
    assert!(b.sent.iter().all(|s| s.ack.is_none()) && !b.status().armed);
    // Its acknowledgement goes back to the script alone.
    b.sent.clear();
    let ack = message!(
        COMMAND_ACK,
        command = MavCmd::MAV_CMD_NAV_GUIDED_ENABLE,
        target_system = SCRIPT.system,
        target_component = SCRIPT.component
    );
    b.send(ONBOARD, COMPANION, &ack);
    assert_eq!(forwarded(&b, API), [(COMPANION, ack)]);
    assert!(forwarded(&b, GCS).is_empty());
}

#[test]
fn a_command_for_a_component_nobody_saw_goes_nowhere_and_stays_unanswered() {
    let mut b = Bench::new();
    b.send(API, SCRIPT, &command_to(1, 154, ARM));
    assert!(b.sent.iter().all(|s| s.ack.is_none()));
    assert!(forwarded(&b, ONBOARD).is_empty());
    assert!(!b.status().armed);
    // Another system's vehicle neither.
    b.send(API, SCRIPT, &command_to(2, 1, ARM));
    assert!(!b.status().armed);
}

#[test]
fn an_unknown_message_is_passed_on_byte_for_byte() {
    let mut b = Bench::new();
    // Message 60 000 in MAVLink 2 framing; its checksum cannot be known here.
    let packet = [0xFD, 2, 0, 0, 7, 1, 191, 0x60, 0xEA, 0x00, 0xAA, 0xBB, 0x12, 0x34];
    b.send_raw(ONBOARD, &packet);
    for link in [API, GCS] {
        assert!(b.sent.iter().any(|s| s.link == link && s.raw == packet));
    }
}

#[test]
fn a_packet_that_claims_to_be_the_vehicle_is_dropped() {
    let mut b = Bench::new();
    b.send(API, VEHICLE, &message!(HEARTBEAT));
    assert_eq!(b.status().refusals.own_identity, 1);
    assert!(b.sent.is_empty());
}

#[test]
fn each_link_counts_its_own_sequence() {
    let mut b = Bench::new();
    b.run_ms(2_000);
    for link in [ONBOARD, API, GCS] {
        let sequence: Vec<u8> = b.sent.iter().filter(|s| s.link == link).map(|s| s.raw[4]).collect();
        assert!(sequence.len() > 10);
        assert!(sequence.windows(2).all(|w| w[1] == w[0].wrapping_add(1)));
    }
}

#[test]
fn a_flood_on_one_link_does_not_become_one_on_the_others() {
    let mut b = Bench::new();
    // 20 000 broadcasts a second by a station, and twenty by the companion.
    for _ in 0..1000 {
        (0..20).for_each(|_| b.send(GCS, STATION, &message!(HEARTBEAT)));
        b.run_ms(1);
        if b.now_ns.is_multiple_of(50_000_000) {
            b.send(ONBOARD, COMPANION, &message!(HEARTBEAT));
        }
    }
    let from = |link, id| forwarded(&b, link).iter().filter(|(from, _)| *from == id).count();
    assert_eq!(from(API, COMPANION), 20);
    assert_eq!(from(GCS, COMPANION), 20);
    assert!((1000..1400).contains(&from(ONBOARD, STATION)));
    assert!(b.status().refusals.crowded_out > 18_000);
}
