//! The flight log, recorded and downloaded.

use crate::testing::*;
use vigil_mavlink::MavMessage;
use vigil_mavlink::common::*;

fn list(b: &mut Bench) -> Vec<LOG_ENTRY_DATA> {
    b.sent.clear();
    let request = LOG_REQUEST_LIST_DATA {
        start: 0,
        end: u16::MAX,
        target_system: 1,
        target_component: 1,
    };
    b.send(API, SCRIPT, &MavMessage::LOG_REQUEST_LIST(request));
    b.run_ms(50);
    b.messages(API)
        .filter_map(|m| match m {
            MavMessage::LOG_ENTRY(e) => Some(e.clone()),
            _ => None,
        })
        .collect()
}

fn request_data(b: &mut Bench, id: u16, ofs: u32, count: u32) {
    b.sent.clear();
    let request = LOG_REQUEST_DATA_DATA {
        ofs,
        count,
        id,
        target_system: 1,
        target_component: 1,
    };
    b.send(API, SCRIPT, &MavMessage::LOG_REQUEST_DATA(request));
}

fn data(b: &Bench) -> Vec<LOG_DATA_DATA> {
    b.messages(API)
        .filter_map(|m| match m {
            MavMessage::LOG_DATA(d) => Some(d.clone()),
            _ => None,
        })
        .collect()
}

fn fly(b: &mut Bench) {
    b.take_off();
    b.run_ms(2_000);
    assert_eq!(b.command_long(API, SCRIPT, 21, [f32::NAN; 7]), ACCEPTED);
    b.run_until(30, "landing", |b| !b.status().armed);
    b.run_ms(200);
}

fn erase(b: &mut Bench) {
    let message = LOG_ERASE_DATA {
        target_system: 1,
        target_component: 1,
    };
    b.send(API, SCRIPT, &MavMessage::LOG_ERASE(message));
}

#[test]
fn a_flight_is_recorded_from_arming_to_disarming_and_downloads_whole() {
    let mut b = Bench::new();
    let none = list(&mut b);
    assert_eq!((none.len(), none[0].num_logs), (1, 0), "no logs are told, too");
    fly(&mut b);
    let logs = list(&mut b);
    assert_eq!((logs.len(), logs[0].id, logs[0].num_logs), (1, 0, 1));
    request_data(&mut b, 0, 0, u32::MAX);
    b.run_ms(2_000);
    let parts = data(&b);
    let mut log = Vec::new();
    for part in &parts {
        assert_eq!((part.id, part.ofs as usize), (0, log.len()));
        log.extend_from_slice(&part.data[..usize::from(part.count)]);
    }
    assert_eq!(log.len(), logs[0].size as usize);
    let text = String::from_utf8(log).expect("text");
    let mut lines = text.lines();
    let columns: Vec<&str> = lines.next().expect("columns").split(',').collect();
    let records: Vec<Vec<&str>> = lines
        .filter(|l| !l.starts_with('#'))
        .map(|l| l.split(',').collect())
        .collect();
    assert!(records.iter().all(|r| r.len() == columns.len()));
    let numbers = |name: &str| {
        let column = columns.iter().position(|c| *c == name).expect(name);
        records
            .iter()
            .map(|r| r[column].parse::<f64>().expect("number"))
            .collect::<Vec<_>>()
    };
    let times = numbers("time_s");
    assert!(times.windows(2).all(|w| (w[1] - w[0] - 0.1).abs() < 2e-3));
    let highest_m = -numbers("down_m").into_iter().fold(0.0, f64::min);
    assert!((highest_m - 2.5).abs() < 0.3, "{highest_m}");
    let modes: Vec<&str> = records.iter().map(|r| r[1]).collect();
    for mode in ["takeoff", "hold", "land"] {
        assert!(modes.contains(&mode));
    }
    assert!(
        text.contains("# armed\n") || text.contains("# take-off to 2.5 m\n"),
        "{text}"
    );
    assert!(!numbers("throttle").iter().all(|t| *t == 0.0));
}

#[test]
fn a_client_gets_the_piece_it_asks_for_and_can_stop() {
    let mut b = Bench::new();
    fly(&mut b);
    let size = list(&mut b)[0].size;
    request_data(&mut b, 0, 180, 100);
    b.run_ms(20);
    let sizes: Vec<_> = data(&b).iter().map(|d| (d.ofs, d.count)).collect();
    assert_eq!(sizes, [(180, 90), (270, 10)]);
    // Behind the end, and of a log that is not there: an empty piece.
    for (id, ofs) in [(0, size), (0, u32::MAX), (7, 0), (u16::MAX, 5)] {
        request_data(&mut b, id, ofs, 90);
        b.run_ms(20);
        let got = data(&b);
        assert_eq!((got.len(), got[0].id, got[0].count), (1, id, 0));
    }
    request_data(&mut b, 0, 0, size);
    b.run_ms(5);
    let end = LOG_REQUEST_END_DATA {
        target_system: 1,
        target_component: 1,
    };
    b.send(API, SCRIPT, &MavMessage::LOG_REQUEST_END(end));
    let before = data(&b).len();
    b.run_ms(100);
    assert_eq!(data(&b).len(), before);
}

#[test]
fn logs_are_few_and_the_one_being_written_survives_an_erase() {
    let mut b = Bench::new();
    for _ in 0..6 {
        assert_eq!(b.arm(), ACCEPTED);
        b.run_ms(300);
        assert_eq!(b.disarm(0.0), ACCEPTED);
        b.run_ms(200);
    }
    assert_eq!(list(&mut b).len(), 4);
    assert_eq!(b.arm(), ACCEPTED);
    b.run_ms(300);
    // A download of a log that is erased ends.
    request_data(&mut b, 0, 0, u32::MAX);
    erase(&mut b);
    b.run_ms(100);
    let logs = list(&mut b);
    assert_eq!((logs.len(), logs[0].num_logs), (1, 1));
    assert!(logs[0].size > 300);
    assert_eq!(b.disarm(0.0), ACCEPTED);
    b.run_ms(200);
    erase(&mut b);
    assert_eq!(list(&mut b)[0].num_logs, 0);
}

#[test]
fn a_log_is_streamed_while_it_is_written_until_the_client_has_enough() {
    let mut b = Bench::new();
    assert_eq!(b.command_long(API, SCRIPT, 2510, [0.0; 7]), ACCEPTED);
    assert_eq!(b.arm(), ACCEPTED);
    b.run_ms(2_000);
    let streamed = |b: &Bench| -> Vec<(u16, Vec<u8>)> {
        let data = b.messages(API).filter_map(|m| match m {
            MavMessage::LOGGING_DATA(m) => Some((m.sequence, m.data[..usize::from(m.length)].to_vec())),
            _ => None,
        });
        data.collect()
    };
    let packets = streamed(&b);
    assert!(
        packets
            .iter()
            .enumerate()
            .all(|(i, (sequence, _))| usize::from(*sequence) == i)
    );
    let text: Vec<u8> = packets.into_iter().flat_map(|(_, bytes)| bytes).collect();
    let text = String::from_utf8(text).expect("a text");
    assert!(text.starts_with("time_s,mode,landed"), "{text}");
    assert!(
        (17..=22).contains(&text.lines().filter(|l| l.contains(",hold,")).count()),
        "{text}"
    );
    assert_eq!(b.command_long(API, SCRIPT, 2511, [0.0; 7]), ACCEPTED);
    let before = streamed(&b).len();
    b.run_ms(1_000);
    assert_eq!(streamed(&b).len(), before);
}
