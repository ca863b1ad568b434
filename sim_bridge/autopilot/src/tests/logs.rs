//! The flight log, recorded and downloaded.

use crate::testing::*;
use std::collections::BTreeMap;
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
    b.all::<LOG_ENTRY_DATA>(API)
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
    b.all::<LOG_DATA_DATA>(API)
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
    // What a ground station names `.ulg` is one: read by its documentation.
    let ulog = Ulog::read(&log);
    assert_eq!(ulog.info["sys_name"], b"Vigil");
    assert_eq!(ulog.parameters, crate::parameter_table().len());
    let places = ulog.topic("vehicle_local_position");
    let times: Vec<u64> = places.iter().map(|(at_us, _)| *at_us).collect();
    assert!(times.windows(2).all(|w| (w[1] - w[0]).abs_diff(100_000) < 2_000));
    let highest_m = places.iter().map(|(_, fields)| -fields["z"]).fold(0.0, f64::max);
    assert!((highest_m - 2.5).abs() < 0.3, "{highest_m}");
    let states: Vec<f64> = ulog
        .topic("vehicle_status")
        .iter()
        .map(|(_, fields)| fields["nav_state"])
        .collect();
    for mode in [17.0, 4.0, 18.0] {
        assert!(states.contains(&mode), "{mode}: {states:?}");
    }
    assert!(
        ulog.texts
            .iter()
            .any(|text| text.starts_with("take-off to 2.") || text == "armed"),
        "{:?}",
        ulog.texts
    );
    assert!(
        ulog.topic("actuator_motors")
            .iter()
            .any(|(_, fields)| fields["control"] > 0.2)
    );
    let attitude = &ulog.topic("vehicle_attitude")[5].1;
    assert!((attitude["q"].abs() - 1.0).abs() < 0.01, "level, to the north");
}

/// A ULog as its documentation describes it: <https://docs.px4.io/main/en/dev_log/ulog_file_format.html>.
#[derive(Default)]
struct Ulog {
    info: BTreeMap<String, Vec<u8>>,
    parameters: usize,
    formats: BTreeMap<String, Vec<(String, String)>>,
    names: BTreeMap<u16, String>,
    data: Vec<(u16, Vec<u8>)>,
    texts: Vec<String>,
}

impl Ulog {
    fn read(bytes: &[u8]) -> Self {
        assert_eq!(&bytes[..7], b"ULog\x01\x12\x35", "magic");
        let mut ulog = Self::default();
        let mut rest = &bytes[16..];
        let mut first = true;
        let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).expect("text");
        while !rest.is_empty() {
            let size = usize::from(u16::from_le_bytes([rest[0], rest[1]]));
            let (kind, payload) = (rest[2], &rest[3..3 + size]);
            assert_eq!(kind == b'B', std::mem::take(&mut first), "flags come first, once");
            match kind {
                b'B' => assert_eq!(payload, [0; 40]),
                b'F' => {
                    let format = text(payload);
                    let (name, fields) = format.split_once(':').expect("a format");
                    let fields = fields.split_terminator(';').map(|field| {
                        let (kind, name) = field.split_once(' ').expect("a field");
                        (kind.to_owned(), name.to_owned())
                    });
                    ulog.formats.insert(name.to_owned(), fields.collect());
                }
                b'I' | b'P' => {
                    let (key, value) = payload[1..].split_at(usize::from(payload[0]));
                    let key = text(key);
                    let (_, name) = key.split_once(' ').expect("a key");
                    match kind {
                        b'P' => ulog.parameters += 1,
                        _ => drop(ulog.info.insert(name.to_owned(), value.to_vec())),
                    }
                }
                b'A' => drop(
                    ulog.names
                        .insert(u16::from_le_bytes([payload[1], payload[2]]), text(&payload[3..])),
                ),
                b'D' => ulog
                    .data
                    .push((u16::from_le_bytes([payload[0], payload[1]]), payload[2..].to_vec())),
                b'L' => ulog.texts.push(text(&payload[9..])),
                other => panic!("message {other}"),
            }
            rest = &rest[3 + size..];
        }
        ulog
    }

    /// Time and fields of every message of a topic; of an array its first element.
    fn topic(&self, name: &str) -> Vec<(u64, BTreeMap<String, f64>)> {
        let (number, _) = self.names.iter().find(|(_, topic)| *topic == name).expect("logged");
        let messages = self.data.iter().filter(|(of, _)| of == number).map(|(_, bytes)| {
            let (mut at, mut fields, mut time_us) = (0, BTreeMap::new(), 0);
            for (kind, field) in &self.formats[name] {
                let size = match kind.as_str() {
                    "uint64_t" => {
                        time_us = u64::from_le_bytes(bytes[at..at + 8].try_into().expect("eight"));
                        8
                    }
                    "uint8_t" | "bool" => {
                        fields.insert(field.clone(), f64::from(bytes[at]));
                        1
                    }
                    kind => {
                        let float = f32::from_le_bytes(bytes[at..at + 4].try_into().expect("four"));
                        fields.insert(field.clone(), f64::from(float));
                        if kind == "float" { 4 } else { 16 }
                    }
                };
                at += size;
            }
            assert_eq!(at, bytes.len(), "{name} is as long as its fields");
            (time_us, fields)
        });
        messages.collect()
    }
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
    assert_eq!(b.ask(2510, &[]), ACCEPTED);
    assert_eq!(b.arm(), ACCEPTED);
    b.run_ms(2_000);
    let streamed = |b: &Bench| -> Vec<(u16, Vec<u8>)> {
        let data = b
            .all::<LOGGING_DATA_DATA>(API)
            .into_iter()
            .map(|m| (m.sequence, m.data[..usize::from(m.length)].to_vec()));
        data.collect()
    };
    let packets = streamed(&b);
    assert!(
        packets
            .iter()
            .enumerate()
            .all(|(i, (sequence, _))| usize::from(*sequence) == i)
    );
    let log: Vec<u8> = packets.into_iter().flat_map(|(_, bytes)| bytes).collect();
    let firsts = b
        .all::<LOGGING_DATA_DATA>(API)
        .into_iter()
        .map(|m| (usize::from(m.length), usize::from(m.first_message_offset)));
    // Who joins in the middle finds the next message where the packet says.
    let (mut at, firsts) = (0, firsts.collect::<Vec<_>>());
    for (i, (length, first)) in firsts.iter().enumerate() {
        assert!(*first == 255 || *first < *length);
        if i > 0 && *first != 255 {
            let (size, kind) = (
                u16::from_le_bytes([log[at + first], log[at + first + 1]]),
                log[at + first + 2],
            );
            assert!(size < 200 && b"FIPADL".contains(&kind), "{i}: {kind}");
        }
        at += length;
    }
    let records = log.windows(5).filter(|w| w[2] == b'D' && w[3..] == [3, 0]).count();
    assert!((17..=22).contains(&records), "{records}");
    assert_eq!(b.ask(2511, &[]), ACCEPTED);
    let before = streamed(&b).len();
    b.run_ms(1_000);
    assert_eq!(streamed(&b).len(), before);
}
