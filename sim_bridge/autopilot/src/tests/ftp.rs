//! File transfer, by packets.

use crate::testing::*;
use vigil_mavlink::crc::crc32;

const RESET: u8 = 2;
const LIST: u8 = 3;
const OPEN: u8 = 4;
const READ: u8 = 5;
const CREATE: u8 = 6;
const WRITE: u8 = 7;
const REMOVE: u8 = 8;
const MKDIR: u8 = 9;
const RMDIR: u8 = 10;
const OPEN_WRITE: u8 = 11;
const TRUNCATE: u8 = 12;
const RENAME: u8 = 13;
const CRC: u8 = 14;
const BURST: u8 = 15;
const LIST_TIME: u8 = 16;
const TERMINATE: u8 = 1;
const FAIL: u8 = 1;
const EOF: u8 = 6;
const INVALID_SESSION: u8 = 4;
const NO_SESSIONS: u8 = 5;
const NOT_FOUND: u8 = 10;
const PROTECTED: u8 = 9;
const EXISTS: u8 = 8;
const UNKNOWN: u8 = 7;

#[derive(Debug, Clone, PartialEq)]
struct Reply {
    sequence: u16,
    session: u8,
    is_ack: bool,
    request_opcode: u8,
    offset: u32,
    data: Vec<u8>,
}

impl Reply {
    fn error(&self) -> u8 {
        assert!(!self.is_ack, "{self:?}");
        self.data[0]
    }

    fn number(&self) -> u32 {
        assert!(self.is_ack && self.data.len() == 4, "{self:?}");
        u32::from_le_bytes([self.data[0], self.data[1], self.data[2], self.data[3]])
    }
}

/// A client that numbers its requests.
pub(super) struct Client {
    id: ComponentId,
    link: LinkId,
    sequence: u16,
}

impl Client {
    pub(super) fn new() -> Self {
        Self {
            id: SCRIPT,
            link: API,
            sequence: 65_530,
        }
    }

    fn send(&mut self, b: &mut Bench, opcode: u8, session: u8, offset: u32, size: usize, data: &[u8]) {
        self.sequence = self.sequence.wrapping_add(1);
        self.repeat(b, opcode, session, offset, size, data);
    }

    fn repeat(&self, b: &mut Bench, opcode: u8, session: u8, offset: u32, size: usize, data: &[u8]) {
        let mut payload = [0; 251];
        payload[0..2].copy_from_slice(&self.sequence.to_le_bytes());
        payload[2..5].copy_from_slice(&[session, opcode, size as u8]);
        payload[8..12].copy_from_slice(&offset.to_le_bytes());
        payload[12..12 + data.len()].copy_from_slice(data);
        b.sent.clear();
        let message = message!(FILE_TRANSFER_PROTOCOL, target_system = 1, target_component = 1, payload);
        b.send(self.link, self.id, &message);
    }

    fn replies(&self, b: &Bench) -> Vec<Reply> {
        let read = |f: FILE_TRANSFER_PROTOCOL_DATA| {
            let (p, target) = (&f.payload, (f.target_system, f.target_component));
            assert_eq!(target, (self.id.system, self.id.component));
            Reply {
                sequence: u16::from_le_bytes([p[0], p[1]]),
                session: p[2],
                is_ack: p[3] == 128,
                request_opcode: p[5],
                offset: u32::from_le_bytes([p[8], p[9], p[10], p[11]]),
                data: p[12..12 + usize::from(p[4])].to_vec(),
            }
        };
        b.all(self.link).into_iter().map(read).collect()
    }

    fn only_reply(&self, b: &Bench, opcode: u8, session: u8) -> Reply {
        let replies = self.replies(b);
        assert_eq!(replies.len(), 1, "{replies:?}");
        let reply = replies[0].clone();
        let header = (reply.sequence, reply.session, reply.request_opcode);
        assert_eq!(header, (self.sequence.wrapping_add(1), session, opcode));
        reply
    }

    fn ask(&mut self, b: &mut Bench, opcode: u8, session: u8, offset: u32, data: &[u8]) -> Reply {
        self.send(b, opcode, session, offset, data.len(), data);
        self.only_reply(b, opcode, session)
    }

    fn read(&mut self, b: &mut Bench, session: u8, offset: u32, size: usize) -> Reply {
        self.send(b, READ, session, offset, size, &[]);
        self.only_reply(b, READ, session)
    }

    /// All entries, asked for until the end.
    fn list(&mut self, b: &mut Bench, opcode: u8, path: &str) -> Vec<String> {
        let mut entries: Vec<String> = Vec::new();
        loop {
            let reply = self.ask(b, opcode, 0, entries.len() as u32, path.as_bytes());
            if !reply.is_ack {
                assert_eq!(reply.error(), EOF);
                return entries;
            }
            let text = String::from_utf8(reply.data).expect("text");
            assert!(text.ends_with('\0'));
            entries.extend(text.split_terminator('\0').map(str::to_owned));
        }
    }

    /// A whole file, by single reads until the end.
    pub(super) fn download(&mut self, b: &mut Bench, session: u8, path: &str) -> Vec<u8> {
        let size = self.ask(b, OPEN, session, 0, path.as_bytes()).number();
        let mut got = Vec::new();
        loop {
            let reply = self.read(b, session, got.len() as u32, 239);
            if !reply.is_ack {
                assert_eq!((reply.error(), got.len()), (EOF, size as usize));
                return got;
            }
            assert_eq!(reply.offset as usize, got.len());
            got.extend(reply.data);
        }
    }

    fn upload(&mut self, b: &mut Bench, path: &str, content: &[u8]) {
        assert!(self.ask(b, CREATE, 0, 0, path.as_bytes()).is_ack);
        for (i, chunk) in content.chunks(239).enumerate() {
            let reply = self.ask(b, WRITE, 0, 239 * i as u32, chunk);
            assert_eq!((reply.number() as usize, reply.offset as usize), (chunk.len(), 239 * i));
        }
        assert!(self.ask(b, TERMINATE, 0, 0, &[]).is_ack);
    }
}

fn sample(len: usize) -> Vec<u8> {
    (0..len).map(|i| (i * 31 + i / 251) as u8).collect()
}

#[test]
fn a_file_that_was_written_reads_back_with_its_checksum() {
    let (mut b, mut c) = (Bench::new(), Client::new());
    let content = sample(1_000);
    c.upload(&mut b, "/data.bin", &content);
    assert_eq!(c.ask(&mut b, CRC, 0, 0, b"data.bin").number(), crc32(&content));
    assert_eq!(c.download(&mut b, 7, "data.bin\0"), content);
    assert_eq!(c.ask(&mut b, WRITE, 7, 0, b"x").error(), PROTECTED);
    // A burst behind the end is refused at once; MAVSDK reads files in bursts in tests/python/ground_services.py.
    c.send(&mut b, BURST, 7, 1_000, 239, &[]);
    assert_eq!(c.only_reply(&b, BURST, 7).error(), EOF);
    assert!(c.ask(&mut b, TERMINATE, 7, 0, &[]).is_ack);
    assert_eq!(c.read(&mut b, 7, 0, 10).error(), INVALID_SESSION);
}

#[test]
fn directories_list_in_pieces_with_sizes_and_times() {
    let config = EndpointConfig {
        started_ns: 1_000_000_000,
        ..EndpointConfig::default()
    };
    let (mut b, mut c) = (Bench::with(config), Client::new());
    let own = c.list(&mut b, LIST_TIME, "/");
    assert!(own.contains(&"Detc\t0\t1767225601".to_owned()), "{own:?}");
    assert!(c.ask(&mut b, MKDIR, 0, 0, b"/d").is_ack);
    assert!(c.list(&mut b, LIST, "/d").is_empty());
    for i in 0..40 {
        assert!(c.ask(&mut b, MKDIR, 0, 0, format!("d/folder{i:02}").as_bytes()).is_ack);
    }
    c.upload(&mut b, "d/file", b"12345");
    let plain = c.list(&mut b, LIST, "/d");
    assert_eq!(plain.len(), 41);
    assert_eq!((plain[0].as_str(), plain[1].as_str()), ("Ffile\t5", "Dfolder00"));
    let timed = c.list(&mut b, LIST_TIME, "/d");
    let unix_s = 1_767_225_600 + b.now_ns / 1_000_000_000;
    assert_eq!(timed[0], format!("Ffile\t5\t{unix_s}"));
    assert!(timed[1].starts_with("Dfolder00\t0\t17672256"));
    assert_eq!(c.ask(&mut b, LIST, 0, 0, b"nowhere").error(), NOT_FOUND);
}

#[test]
fn files_are_renamed_cut_removed_and_never_overwritten_by_a_rename() {
    let (mut b, mut c) = (Bench::new(), Client::new());
    c.upload(&mut b, "a", b"abcdef");
    c.upload(&mut b, "b", b"other");
    assert_eq!(c.ask(&mut b, RENAME, 0, 0, b"a\0b\0").error(), EXISTS);
    assert!(c.ask(&mut b, RENAME, 0, 0, b"a\0c").is_ack);
    assert!(c.ask(&mut b, TRUNCATE, 0, 3, b"c").is_ack);
    assert_eq!(c.ask(&mut b, OPEN_WRITE, 1, 0, b"c").number(), 3);
    assert_eq!(c.ask(&mut b, WRITE, 1, 3, b"XY").number(), 2);
    assert_eq!(c.ask(&mut b, CRC, 0, 0, b"c").number(), crc32(b"abcXY"));
    assert!(c.ask(&mut b, REMOVE, 0, 0, b"c").is_ack);
    assert_eq!(c.ask(&mut b, WRITE, 1, 5, b"Z").error(), NOT_FOUND);
    assert_eq!(c.ask(&mut b, REMOVE, 0, 0, b"c").error(), NOT_FOUND);
    assert!(c.ask(&mut b, MKDIR, 0, 0, b"dir").is_ack);
    assert_eq!(c.ask(&mut b, MKDIR, 0, 0, b"dir").error(), EXISTS);
    let reply = c.ask(&mut b, REMOVE, 0, 0, b"dir");
    assert_eq!((reply.error(), reply.data[1]), (2, 21), "errno: is a directory");
    assert!(c.ask(&mut b, RMDIR, 0, 0, b"dir").is_ack);
}

#[test]
fn a_repeated_request_gets_the_same_answer_once_done() {
    let (mut b, mut c) = (Bench::new(), Client::new());
    for (opcode, data) in [(MKDIR, &b"once"[..]), (RENAME, b"once\0twice"), (RMDIR, b"twice")] {
        let first = c.ask(&mut b, opcode, 0, 0, data);
        assert!(first.is_ack);
        b.run_ms(500);
        c.repeat(&mut b, opcode, 0, 0, data.len(), data);
        assert_eq!(c.only_reply(&b, opcode, 0), first);
    }
    // Another client's request is its own even if it looks the same.
    let mut station = Client::new();
    (station.id, station.link, station.sequence) = (STATION, GCS, c.sequence - 1);
    assert_eq!(station.ask(&mut b, RMDIR, 0, 0, b"twice").error(), NOT_FOUND);
}

#[test]
fn two_clients_use_the_same_session_number_without_harm() {
    let (mut b, mut c, mut station) = (Bench::new(), Client::new(), Client::new());
    (station.id, station.link) = (STATION, GCS);
    c.upload(&mut b, "one", b"first");
    c.upload(&mut b, "two", b"second");
    assert_eq!(c.ask(&mut b, OPEN, 0, 0, b"one").number(), 5);
    assert_eq!(station.ask(&mut b, OPEN, 0, 0, b"two").number(), 6);
    assert_eq!(c.read(&mut b, 0, 0, 100).data, b"first");
    assert_eq!(station.read(&mut b, 0, 0, 100).data, b"second");
    assert!(station.ask(&mut b, RESET, 0, 0, &[]).is_ack);
    assert_eq!(station.read(&mut b, 0, 0, 100).error(), INVALID_SESSION);
    assert_eq!(c.read(&mut b, 0, 0, 100).data, b"first");
}

#[test]
fn sessions_are_few_and_those_of_a_vanished_client_are_given_to_others() {
    let (mut b, mut c) = (Bench::new(), Client::new());
    c.upload(&mut b, "f", b"content");
    for session in 0..4 {
        assert!(c.ask(&mut b, OPEN, session, 0, b"f").is_ack);
    }
    assert_eq!(c.ask(&mut b, OPEN, 4, 0, b"f").error(), NO_SESSIONS);
    b.run_ms(9_000);
    assert!(c.read(&mut b, 0, 0, 9).is_ack);
    b.run_ms(1_500);
    assert!(c.ask(&mut b, OPEN, 4, 0, b"f").is_ack, "session 1 was idle for 10 s");
    assert_eq!(c.read(&mut b, 1, 0, 9).error(), INVALID_SESSION);
    assert!(c.read(&mut b, 0, 0, 9).is_ack);
}

#[test]
fn nonsense_is_refused_and_changes_nothing() {
    let (mut b, mut c) = (Bench::new(), Client::new());
    let before = c.list(&mut b, LIST, "/");
    for opcode in [17, 100, 128, 129, 255] {
        assert_eq!(c.ask(&mut b, opcode, 0, 0, b"x").error(), UNKNOWN);
    }
    for opcode in 1..=16 {
        c.send(&mut b, opcode, 200, u32::MAX, 250, &[0xFF; 239]);
        if opcode != RESET {
            assert_eq!(c.only_reply(&b, opcode, 200).error(), 3, "size beyond the packet");
        }
        for data in [&[0xFF; 20][..], b"", b"\0", b"../../../etc/passwd", b"a\tb"] {
            c.send(&mut b, opcode, 200, u32::MAX, data.len(), data);
            let replies = c.replies(&b);
            assert_eq!(replies.len(), 1);
            // The root may be listed by an empty path; nothing else is acknowledged.
            let sensible = opcode == RESET || opcode == LIST || opcode == LIST_TIME;
            assert!(sensible || !replies[0].is_ack, "{opcode} {data:?} {:?}", replies[0]);
        }
    }
    assert_eq!(c.list(&mut b, LIST, "/"), before);
    assert!(b.status().refusals.file > 80);
}

#[test]
fn a_stored_parameter_file_sets_all_of_it_or_nothing() {
    fn packed(entries: &[(&str, u8, [u8; 4])]) -> Vec<u8> {
        let mut file = Vec::new();
        for word in [0x671B, entries.len() as u16, 0] {
            file.extend_from_slice(&u16::to_le_bytes(word));
        }
        for (name, kind, value) in entries {
            file.extend_from_slice(&[*kind, (name.len() as u8 - 1) << 4]);
            file.extend_from_slice(name.as_bytes());
            file.extend_from_slice(value);
        }
        file
    }
    fn store(b: &mut Bench, c: &mut Client, file: &[u8]) -> Reply {
        assert!(c.ask(b, CREATE, 0, 0, b"@PARAM/param.pck").is_ack);
        for (index, piece) in file.chunks(20).enumerate() {
            assert!(c.ask(b, WRITE, 0, index as u32 * 20, piece).is_ack);
        }
        c.ask(b, TERMINATE, 0, 0, &[])
    }
    let value = |b: &Bench, name: &str| b.endpoint.saved().parameters.get(name).copied();
    let (mut b, mut c) = (Bench::new(), Client::new());
    let radius = ("NAV_ACC_RAD", 4, 3.5_f32.to_le_bytes());
    let action = ("GF_ACTION", 3, 3_i32.to_le_bytes());
    assert!(store(&mut b, &mut c, &packed(&[action, radius])).is_ack);
    let both = |b: &Bench| (value(b, "NAV_ACC_RAD"), value(b, "GF_ACTION"));
    assert_eq!(both(&b), (Some(3.5), Some(3.0)));
    b.sent.clear();
    let other = ("NAV_ACC_RAD", 4, 9.0_f32.to_le_bytes());
    for bad in [
        packed(&[other, ("NO_SUCH", 4, [0; 4])]),
        packed(&[other, ("GF_ACTION", 3, 99_i32.to_le_bytes())]),
        packed(&[("NAV_ACC_RAD", 3, [9, 0, 0, 0])]),
        packed(&[radius])[..12].to_vec(),
        b"nonsense".to_vec(),
    ] {
        // Texts of refusals are few a second.
        b.run_ms(1000);
        assert_eq!(store(&mut b, &mut c, &bad).error(), FAIL);
    }
    assert_eq!(both(&b), (Some(3.5), Some(3.0)));
    b.assert_said("parameter file refused");
    // A client may fetch some alone: here is how many. All of them are read by pymavlink in tests/python/ground_habits.py.
    assert_eq!(c.download(&mut b, 5, "@PARAM/param.pck?start=10&count=5")[2..4], [5, 0]);
    assert_eq!(c.ask(&mut b, OPEN, 6, 0, b"@PARAM/other").error(), NOT_FOUND);
    // What was fetched may be stored again.
    let file = c.download(&mut b, 3, "@PARAM/param.pck?withdefaults=1");
    b.set_parameter("NAV_ACC_RAD", ParameterValue::Real(1.0));
    assert!(store(&mut b, &mut c, &file).is_ack);
    assert_eq!(value(&b, "NAV_ACC_RAD"), Some(3.5));
}
