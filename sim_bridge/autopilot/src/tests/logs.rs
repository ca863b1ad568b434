//! The flight log, recorded and downloaded.

use crate::testing::*;

fn list(b: &mut Bench) -> Vec<LOG_ENTRY_DATA> {
    b.sent.clear();
    b.tell(message!(LOG_REQUEST_LIST, end = u16::MAX));
    b.run_ms(50);
    b.all::<LOG_ENTRY_DATA>(API)
}

fn request_data(b: &mut Bench, id: u16, ofs: u32, count: u32) {
    b.sent.clear();
    b.tell(message!(LOG_REQUEST_DATA, ofs, count, id));
}

fn fly(b: &mut Bench) {
    b.take_off();
    b.run_ms(2_000);
    assert_eq!(b.command_long(API, SCRIPT, 21, [f32::NAN; 7]), ACCEPTED);
    b.run_until(30, "landing", |b| !b.status().armed);
    b.run_ms(200);
}

#[test]
fn a_client_gets_the_piece_it_asks_for_and_can_stop() {
    let mut b = Bench::new();
    fly(&mut b);
    let texts = b.texts();
    let size = list(&mut b)[0].size;
    request_data(&mut b, 0, 0, size);
    b.run_ms(2_000);
    let pieces = b
        .all::<LOG_DATA_DATA>(API)
        .into_iter()
        .map(|d| d.data[..usize::from(d.count)].to_vec());
    let log = pieces.collect::<Vec<_>>().concat();
    assert_eq!(log.len(), size as usize);
    // Also those of one step, and those that it ends with.
    let last = texts.last().map_or("", String::as_str);
    assert!(last.starts_with("disarmed"), "{texts:?}");
    for text in texts.iter().skip_while(|text| !text.starts_with("armed")) {
        assert!(log.windows(text.len()).any(|w| w == text.as_bytes()), "{text}");
    }
    request_data(&mut b, 0, 180, 100);
    b.run_ms(20);
    let sizes: Vec<_> = b.all::<LOG_DATA_DATA>(API).iter().map(|d| (d.ofs, d.count)).collect();
    assert_eq!(sizes, [(180, 90), (270, 10)]);
    // Behind the end, and of a log that is not there: an empty piece.
    for (id, ofs) in [(0, size), (0, u32::MAX), (7, 0), (u16::MAX, 5)] {
        request_data(&mut b, id, ofs, 90);
        b.run_ms(20);
        let got = b.all::<LOG_DATA_DATA>(API);
        assert_eq!((got.len(), got[0].id, got[0].count), (1, id, 0));
    }
    request_data(&mut b, 0, 0, size);
    b.run_ms(5);
    b.tell(message!(LOG_REQUEST_END));
    let before = b.all::<LOG_DATA_DATA>(API).len();
    b.run_ms(100);
    assert_eq!(b.all::<LOG_DATA_DATA>(API).len(), before);
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
    b.tell(message!(LOG_ERASE));
    b.run_ms(100);
    let logs = list(&mut b);
    assert_eq!((logs.len(), logs[0].num_logs), (1, 1));
    assert!(logs[0].size > 300);
    assert_eq!(b.disarm(0.0), ACCEPTED);
    b.run_ms(200);
    b.tell(message!(LOG_ERASE));
    assert_eq!(list(&mut b)[0].num_logs, 0);
}

#[test]
fn a_log_is_streamed_while_it_is_written_until_the_client_has_enough() {
    let mut b = Bench::new();
    assert_eq!(b.ask(2510, &[]), ACCEPTED);
    assert_eq!(b.arm(), ACCEPTED);
    b.run_ms(2_000);
    let packets = b.all::<LOGGING_DATA_DATA>(API);
    assert!((0..).zip(&packets).all(|(i, m)| m.sequence == i));
    let pieces = packets.iter().map(|m| m.data[..usize::from(m.length)].to_vec());
    let log = pieces.collect::<Vec<_>>().concat();
    // Who joins in the middle finds the next message where the packet says.
    let mut at = 0;
    for (i, m) in packets.iter().enumerate() {
        let (length, first) = (usize::from(m.length), usize::from(m.first_message_offset));
        assert!(first == 255 || first < length);
        if i > 0 && first != 255 {
            let (low, high, kind) = (log[at + first], log[at + first + 1], log[at + first + 2]);
            let size = u16::from_le_bytes([low, high]);
            assert!(size < 200 && b"FIPADL".contains(&kind), "{i}: {kind}");
        }
        at += length;
    }
    let records = log.windows(5).filter(|w| w[2] == b'D' && w[3..] == [3, 0]).count();
    assert!((17..=22).contains(&records), "{records}");
    assert_eq!(b.ask(2511, &[]), ACCEPTED);
    let before = b.count(API, LOGGING_DATA_DATA::ID);
    b.run_ms(1_000);
    assert_eq!(b.count(API, LOGGING_DATA_DATA::ID), before);
}
