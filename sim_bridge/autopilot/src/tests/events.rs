//! Events, by packets.

use crate::testing::*;

/// Number without the component.
fn ids(b: &Bench) -> Vec<u32> {
    b.all::<EVENT_DATA>(API).iter().map(|e| e.id - (1 << 24)).collect()
}

fn request(b: &mut Bench, first_sequence: u16, last_sequence: u16) {
    b.sent.clear();
    b.tell(message!(REQUEST_EVENT, first_sequence, last_sequence));
}

#[test]
fn a_flight_is_reported_in_order_and_without_gaps() {
    let mut b = Bench::new();
    b.take_off();
    b.run_ms(50);
    assert_eq!(b.command_long(API, SCRIPT, 21, [f32::NAN; 7]), ACCEPTED);
    b.run_until(30, "landing", |b| !b.status().armed);
    b.run_ms(50);
    // Armed, mode take-off, took off, mode hold, mode land, landed, disarmed, mode hold.
    assert_eq!(ids(&b), [1, 3, 7, 3, 3, 8, 2, 3]);
    let events = b.all::<EVENT_DATA>(GCS);
    assert!(events.windows(2).all(|w| w[1].sequence == w[0].sequence + 1));
    assert!(events.is_sorted_by_key(|event| event.event_time_boot_ms));
    // The argument of the first mode change: take-off, main 4, sub 2.
    assert_eq!(events[1].arguments[..4], [0, 0, 4, 2]);
}

#[test]
fn a_lost_stream_is_a_critical_event() {
    let mut b = Bench::airborne();
    b.fly(API, SCRIPT, [0.0; 3], 200);
    b.run_ms(100);
    b.sent.clear();
    b.stop_stream(SCRIPT);
    b.run_ms(1_100);
    let failsafe = b
        .all::<EVENT_DATA>(API)
        .into_iter()
        .find(|e| e.id == 1 << 24 | 4)
        .expect("sent");
    assert_eq!((failsafe.log_levels, failsafe.arguments[0]), (0x22, 1));
}

#[test]
fn lost_events_are_sent_again_and_too_old_ones_named() {
    let mut b = Bench::new();
    for _ in 0..40 {
        assert_eq!(b.arm(), ACCEPTED);
        b.run_ms(30);
        assert_eq!(b.disarm(0.0), ACCEPTED);
        b.run_ms(30);
    }
    let all = b.all::<EVENT_DATA>(API);
    let last = all.last().expect("many").clone();
    request(&mut b, last.sequence - 1, last.sequence);
    let again = b.all::<EVENT_DATA>(API);
    assert_eq!(again, all[all.len() - 2..]);
    assert!(b.all::<EVENT_DATA>(GCS).is_empty(), "only the asker gets them");
    // What is kept no longer, and what has not happened yet.
    for sequence in [1, last.sequence + 1] {
        request(&mut b, sequence, sequence);
        let error = b.one::<RESPONSE_EVENT_ERROR_DATA>();
        assert_eq!((error.sequence, error.target_system), (sequence, 245));
        assert_eq!(error.sequence_oldest_available, last.sequence - 63);
    }
    // A range without end is bounded.
    request(&mut b, last.sequence, last.sequence.wrapping_sub(1));
    assert!(b.sent.len() <= 65, "{}", b.sent.len());
}

#[test]
fn the_last_sequence_is_reported_with_a_reset_at_the_start_only() {
    let mut b = Bench::with(EndpointConfig::default());
    b.run_ms(3_000);
    let all = b.all::<CURRENT_EVENT_SEQUENCE_DATA>(API).into_iter();
    let sequences: Vec<_> = all.map(|c| (c.sequence, c.flags.bits())).collect();
    assert!(sequences.len() >= 3);
    assert_eq!(sequences[0].1, 1);
    assert!(sequences[1..].iter().all(|(_, flags)| *flags == 0));
    let last = b.all::<EVENT_DATA>(API).last().expect("the checks were sent").sequence;
    assert_eq!(sequences.last().map(|t| t.0), Some(last));
}

#[test]
fn checks_are_run_on_request_and_name_what_fails() {
    let mut b = Bench::new();
    assert_eq!(b.ask(401, &[]), ACCEPTED);
    assert_eq!(ids(&b), [100, 200]);
    assert_eq!(b.command_long(API, SCRIPT, 185, [1.0; 7]), DENIED, "nothing flies");
    assert_eq!(b.arm(), ACCEPTED);
    assert_eq!(b.command_long(API, SCRIPT, 185, [1.0; 7]), ACCEPTED);
    assert_eq!(b.disarm(0.0), ACCEPTED);
    b.run_ms(50);
    b.sent.clear();
    assert_eq!(b.ask(401, &[]), ACCEPTED);
    let sent = b.all::<EVENT_DATA>(API);
    assert_eq!(ids(&b), [100, 101, 200]);
    // Chunk, error bits, warning bits, groups that can arm: none.
    assert_eq!(sent[0].arguments[..13], [0, 2, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
}
