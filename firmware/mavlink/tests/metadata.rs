//! Component metadata as clients fetch them; the files hold exactly what the table of parameters says.
//! `UPDATE_METADATA=1 cargo test --release -p vigil-mavlink --test metadata` writes them.

mod common;

use common::{Bench, GROUND_STATION, ME, command_long};
use std::{env, fs, path::Path};
use vigil_mavlink::common::MavCmd;
use vigil_mavlink::crc::crc32;
use vigil_mavlink::{Flavour, MavMessage, message};
use vigil_types::parameters::{ALL, Kind, Preset};
use vigil_types::{GuidanceState, ParameterSpec, Reasons, VehicleRequest};

const TERMINATE: u8 = 1;
const OPEN: u8 = 4;
const READ: u8 = 5;
const CRC: u8 = 14;
const BURST: u8 = 15;
const OTHER: (u8, u8) = (254, 190);

/// What an answer says: sequence number, session, offset, whether it ends a burst, and the data or a NAK's error.
type Answer = (u16, u8, u32, bool, Result<Vec<u8>, u8>);

impl Bench {
    fn answers(&mut self) -> Vec<((u8, u8), Answer)> {
        let sent = self.step(GuidanceState::Ready, Reasons::NONE, VehicleRequest::None);
        let answers = only!(sent, FILE_TRANSFER_PROTOCOL).map(|m| {
            let (p, client) = (m.payload, (m.target_system, m.target_component));
            let data = p[12..12 + usize::from(p[4])].to_vec();
            let outcome = if p[3] == 128 { Ok(data) } else { Err(data[0]) };
            let offset = u32::from_le_bytes([p[8], p[9], p[10], p[11]]);
            let sequence = u16::from_le_bytes([p[0], p[1]]);
            (client, (sequence, p[2], offset, p[6] == 1, outcome))
        });
        answers.collect()
    }

    /// Takes a request: its session, opcode, size, offset and data.
    fn request(&mut self, client: (u8, u8), (session, opcode, size, offset): (u8, u8, u8, u32), data: &[u8]) {
        let mut payload = [0; 251];
        payload[..5].copy_from_slice(&[7, 0, session, opcode, size]);
        payload[8..12].copy_from_slice(&offset.to_le_bytes());
        payload[12..12 + data.len()].copy_from_slice(data);
        let (target_system, target_component) = ME;
        let message = message!(FILE_TRANSFER_PROTOCOL, target_system, target_component, payload);
        self.hear(client, &message);
    }

    /// The answer's data or error.
    fn ask(&mut self, client: (u8, u8), head: (u8, u8, u8, u32), data: &[u8]) -> Result<Vec<u8>, u8> {
        self.request(client, head, data);
        let (to, (sequence, session, offset, _, outcome)) = self.answers().remove(0);
        assert_eq!((to, sequence, session, offset), (client, 8, head.0, head.3));
        outcome
    }

    fn open(&mut self, client: (u8, u8), session: u8, path: &str) -> Result<Vec<u8>, u8> {
        self.ask(client, (session, OPEN, path.len() as u8, 0), path.as_bytes())
    }

    /// Reads an open file until what follows its end is refused.
    fn read_all(&mut self, client: (u8, u8), session: u8) -> Vec<u8> {
        let mut content = Vec::new();
        while let Ok(piece) = self.ask(client, (session, READ, 200, content.len() as u32), &[]) {
            content.extend(piece);
        }
        content
    }
}

fn file(name: &str) -> Vec<u8> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/services/metadata");
    fs::read(folder.join(name)).unwrap()
}

#[test]
fn a_client_asks_where_the_metadata_are_and_reads_them_in_pieces() {
    let mut computer = Bench::new(Flavour::Px4);
    let mut request = command_long(MavCmd::MAV_CMD_REQUEST_MESSAGE, ME, 397.0);
    computer.hear(GROUND_STATION, &request);
    if let MavMessage::COMMAND_LONG(m) = &mut request {
        m.param1 = 148.0;
    }
    computer.hear(GROUND_STATION, &request);
    let sent = computer.step(GuidanceState::Ready, Reasons::NONE, VehicleRequest::None);
    let acks: Vec<_> = only!(sent.clone(), COMMAND_ACK).map(|m| m.result as u8).collect();
    assert_eq!(acks, [0, 3], "ACCEPTED, and UNSUPPORTED for another message");
    let metadata = only!(sent, COMPONENT_METADATA).next().unwrap();
    assert_eq!(metadata.uri.to_str(), Ok("mftp:///general.json"));
    assert_eq!(metadata.file_crc, crc32(&file("general.json")));

    // Two at once, in sessions of the same number, with the paths that clients make of the address.
    for (client, name, path) in [
        (GROUND_STATION, "general.json", "/general.json"),
        (OTHER, "parameters.json", "//parameters.json"),
    ] {
        let len = (file(name).len() as u32).to_le_bytes().to_vec();
        assert_eq!(computer.open(client, 3, path), Ok(len));
        let crc = computer.ask(client, (0, CRC, path.len() as u8, 0), path.as_bytes());
        assert_eq!(crc, Ok(crc32(&file(name)).to_le_bytes().to_vec()));
    }
    assert_eq!(computer.read_all(OTHER, 3), file("parameters.json"));
    assert_eq!(computer.read_all(GROUND_STATION, 3), file("general.json"));
}

#[test]
fn a_burst_brings_the_file_a_few_packets_a_step_and_its_repetition_the_same() {
    let mut computer = Bench::new(Flavour::Px4);
    computer.open(GROUND_STATION, 0, "parameters.json").unwrap();
    let burst = |computer: &mut Bench, size, offset| -> Vec<Answer> {
        computer.request(GROUND_STATION, (0, BURST, size, offset), &[]);
        let steps: Vec<_> = (0..40).map(|_| computer.answers()).collect();
        assert!(steps.iter().all(|answers| answers.len() <= 2));
        steps.into_iter().flatten().map(|(_, answer)| answer).collect()
    };
    let whole = burst(&mut computer, 0, 0);
    assert_eq!(burst(&mut computer, 0, 0), whole);
    let mut content: Vec<u8> = Vec::new();
    for (number, (sequence, _, offset, ends, outcome)) in (8..).zip(&whole) {
        assert_eq!((*sequence, *offset as usize, *ends), (number, content.len(), false));
        content.extend(outcome.iter().flatten());
    }
    assert_eq!(whole.last().unwrap().4, Err(6), "behind the end");
    assert_eq!(content, file("parameters.json"));
    // One of small packets ends before the file, and says so.
    let part = burst(&mut computer, 20, 100);
    assert_eq!((part.len(), part[30].3, part[31].3), (32, false, true));
}

#[test]
fn what_there_is_not_and_what_makes_no_sense_is_refused_and_nothing_panics() {
    let mut computer = Bench::new(Flavour::Px4);
    let refused = |computer: &mut Bench, head, data: &[u8]| computer.ask(GROUND_STATION, head, data).unwrap_err();
    for path in ["", "/", "general.jso", "general.jsonx", "../general.json", "etc/passwd"] {
        assert_eq!(computer.open(GROUND_STATION, 0, path), Err(10), "{path}");
    }
    assert_eq!(refused(&mut computer, (0, OPEN, 12, 0), &[]), 10, "cut off");
    assert_eq!(refused(&mut computer, (0, OPEN, 240, 0), b"general.json"), 3);
    assert_eq!(refused(&mut computer, (0, READ, 9, 0), &[]), 4, "not open");
    computer.open(GROUND_STATION, 0, "general.json").unwrap();
    assert_eq!(computer.ask(OTHER, (0, READ, 9, 0), &[]), Err(4), "another's");
    for offset in [file("general.json").len() as u32, u32::MAX] {
        assert_eq!(refused(&mut computer, (0, READ, 9, offset), &[]), 6);
        assert_eq!(refused(&mut computer, (0, BURST, 9, offset), &[]), 6);
    }
    for (opcode, error) in [(3, 7), (6, 9), (7, 9), (11, 9), (13, 9), (16, 7), (128, 7), (255, 7)] {
        assert_eq!(refused(&mut computer, (0, opcode, 12, 0), b"general.json"), error);
    }
    // What is terminated twice has ended, and so has what eight others took the place of.
    for _ in 0..2 {
        assert_eq!(computer.ask(GROUND_STATION, (0, TERMINATE, 0, 0), &[]), Ok(vec![]));
    }
    for session in 1..=9 {
        computer.open(GROUND_STATION, session, "general.json").unwrap();
    }
    let open: Vec<u8> = (0..12)
        .filter(|session| computer.ask(GROUND_STATION, (*session, READ, 9, 0), &[]).is_ok())
        .collect();
    assert_eq!(open, [2, 3, 4, 5, 6, 7, 8, 9]);
    for (opcode, size) in (0..=255).zip([0, 1, 239, 240, 255].into_iter().cycle()) {
        computer.request(GROUND_STATION, (9, opcode, size, 1 << 31), &[0xFF; 239]);
        computer.answers();
    }
}

/// A row as <https://github.com/mavlink/mavlink/blob/master/component_metadata/parameter.schema.json> has it. Rust's escapes are
/// JSON's, for what the table contains.
fn described(row: &ParameterSpec) -> Option<String> {
    let (name, range) = (row.mavlink?.name, row.range()?);
    let group = row.key.split_once('.').map_or("guidance", |(section, _)| section);
    let (kind, words) = match row.kind {
        Kind::Choice(words) => ("Int32", words),
        Kind::Switch => ("Int32", &[][..]),
        _ => ("Float", &[][..]),
    };
    let default = match row.default {
        Preset::Number(number) => format!("\"default\":{number},"),
        Preset::Choice(number) => format!("\"default\":{number},"),
        Preset::Switch(on) => format!("\"default\":{},", u8::from(on)),
        Preset::Absent(_) => String::new(),
    };
    let value = |(number, (word, text)): (usize, &(&str, &str))| {
        format!("{{\"value\":{number},\"description\":{:?}}}", format!("{word}: {text}"))
    };
    let values: Vec<_> = words.iter().enumerate().map(value).collect();
    let (unit, least, greatest, text) = (range.unit, range.least, range.greatest, row.text);
    Some(format!(
        "{{\"name\":{name:?},\"type\":{kind:?},\"group\":{group:?},\"shortDesc\":{text:?},\"units\":{unit:?},\
         {default}\"min\":{least},\"max\":{greatest},\"values\":[{}]}}",
        values.join(",")
    ))
}

#[test]
fn the_files_hold_the_table_of_parameters() {
    let rows: Vec<_> = ALL.iter().filter_map(described).collect();
    // QGroundControl takes no version but 1.
    let parameters = format!("{{\"version\":1,\"parameters\":[\n{}\n]}}\n", rows.join(",\n"));
    let crc = crc32(parameters.as_bytes());
    let general = format!(
        "{{\"version\":1,\"vendorName\":\"Vigil\",\"modelName\":\"guidance computer\",\"metadataTypes\":[\n\
         {{\"type\":1,\"uri\":\"mftp:///parameters.json\",\"fileCrc\":{crc}}}\n]}}\n"
    );
    for (name, expected) in [("parameters.json", parameters), ("general.json", general)] {
        if env::var_os("UPDATE_METADATA").is_some() {
            let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/services/metadata");
            fs::write(folder.join(name), &expected).unwrap();
        }
        assert_eq!(file(name), expected.as_bytes(), "{name}: UPDATE_METADATA=1 writes it");
    }
}
