//! Component metadata: what the guidance computer's parameters mean, as two files of JSON that a client reads by MAVLink FTP.
//! <https://mavlink.io/en/services/component_information.html>, <https://mavlink.io/en/services/ftp.html>
//!
//! The files never change and nothing can be written, so a repeated request gets the same answer without being remembered.
//! There is no metadata of events: the guidance computer sends none.

use super::{Service, Step};
use crate::autopilot::command_number::REQUEST_MESSAGE;
use crate::core::Core;
use crate::crc::crc32;
use crate::framing::{Packet, Zeroed, filled};
use crate::message;
use crate::operator::{ReplyTo, result};
use crate::report::time_boot_ms;
use heapless::Vec;
use mavlink::MessageData;
use mavlink::dialects::common::{COMPONENT_METADATA_DATA, FILE_TRANSFER_PROTOCOL_DATA, MavFtpErr};
use vigil_types::{Datagrams, Nanos, Reasons};

/// Without a component's number: the component that names the file has it.
const GENERAL_URI: &str = "mftp:///general.json";
/// Bytes of FILE_TRANSFER_PROTOCOL before the data, and of the data at most.
const HEADER: usize = 15;
const MAX_DATA: usize = 239;
/// Requests that one step answers; a client waits for each answer, or sends a handful.
const REQUESTS: usize = 16;
/// Open files of all clients; one more takes the place of the one unused for longest.
const SESSIONS: usize = 8;
/// Packets of a burst, and of all bursts in a step: 10 KB/s, which a telemetry radio carries.
const BURST_PACKETS: u8 = 32;
const BURST_PACKETS_PER_STEP: usize = 2;

/// MAV_FTP_OPCODE numbers, which a match takes.
const NONE: u8 = 0;
const TERMINATE_SESSION: u8 = 1;
const RESET_SESSIONS: u8 = 2;
const OPEN_FILE_RO: u8 = 4;
const READ_FILE: u8 = 5;
const CREATE_FILE: u8 = 6;
const RENAME: u8 = 13;
const CALC_FILE_CRC32: u8 = 14;
const BURST_READ_FILE: u8 = 15;
const ACK: u8 = 128;
const NAK: u8 = 129;

#[derive(Debug)]
struct File {
    name: &'static [u8],
    content: &'static [u8],
    crc32: u32,
}

const fn file(name: &'static [u8], content: &'static [u8]) -> File {
    let crc32 = crc32(content);
    File { name, content, crc32 }
}

const GENERAL: File = file(b"general.json", include_bytes!("metadata/general.json"));
const PARAMETERS: File = file(b"parameters.json", include_bytes!("metadata/parameters.json"));
static FILES: [File; 2] = [GENERAL, PARAMETERS];

/// A request; of a burst, the one that its next packet answers.
#[derive(Debug, Clone, Copy)]
struct Request {
    from: ReplyTo,
    sequence: u16,
    session: u8,
    opcode: u8,
    /// Of the data, or how much is to be read.
    size: usize,
    offset: u32,
    /// The file whose path is the data.
    file: Option<&'static File>,
}

type Data = Vec<u8, MAX_DATA>;
/// What is acknowledged, or the error of a NAK.
type Answer = Result<Data, MavFtpErr>;

impl Request {
    /// What was cut from the payload reads as zeros, as MAVLink 2 says.
    fn from_payload(payload: &[u8], from: ReplyTo) -> Self {
        let field = Zeroed(payload);
        let size = usize::from(field.u8(7));
        let data: [u8; MAX_DATA] = field.bytes(HEADER);
        // A path ends with the data or with a zero; clients leave one slash, two or none before it.
        let path = data.get(..size).unwrap_or(&data).split(|byte| *byte == 0).next();
        let path = path.unwrap_or_default();
        let slashes = path.iter().take_while(|byte| **byte == b'/').count();
        Self {
            from,
            sequence: field.u16(3),
            session: field.u8(5),
            opcode: field.u8(6),
            size,
            offset: field.u32(11),
            file: FILES.iter().find(|file| path.get(slashes..) == Some(file.name)),
        }
    }

    fn read(&self, file: &File) -> Answer {
        let rest = file.content.get(self.offset as usize..).unwrap_or_default();
        let size = if self.size == 0 { MAX_DATA } else { self.size };
        match rest.get(..size).unwrap_or(rest) {
            [] => Err(MavFtpErr::MAV_FTP_ERR_EOF),
            piece => data(piece),
        }
    }
}

fn data(bytes: &[u8]) -> Answer {
    Data::from_slice(bytes).map_err(|_| MavFtpErr::MAV_FTP_ERR_INVALIDDATASIZE)
}

/// An open file. Its number is the client's choice and counts for that client: MAVSDK ignores the number that a server gives,
/// pymavlink wants its own back.
#[derive(Debug, Clone)]
struct Session {
    client: ReplyTo,
    number: u8,
    file: &'static File,
    /// The burst's next packet, and how many are left.
    burst: Option<(Request, u8)>,
}

#[derive(Debug, Clone, Default)]
pub(crate) struct MetadataService {
    requests: Vec<Request, REQUESTS>,
    /// The one unused for longest is the first.
    sessions: Vec<Session, SESSIONS>,
}

impl MetadataService {
    fn keep(&mut self, session: Session) {
        if self.sessions.is_full() {
            self.sessions.remove(0);
        }
        let _ = self.sessions.push(session);
    }

    /// `None` where the answer follows as a burst.
    fn answer(&mut self, request: &Request) -> Option<Answer> {
        let is_asked_for = |s: &Session| s.client == request.from && s.number == request.session;
        let file = request.file.ok_or(MavFtpErr::MAV_FTP_ERR_FILENOTFOUND);
        Some(match request.opcode {
            _ if request.size > MAX_DATA => Err(MavFtpErr::MAV_FTP_ERR_INVALIDDATASIZE),
            NONE => data(&[]),
            // A session that is not there has ended: a repetition is answered as the first was.
            TERMINATE_SESSION | RESET_SESSIONS => {
                let all = request.opcode == RESET_SESSIONS;
                self.sessions
                    .retain(|s| s.client != request.from || (!all && s.number != request.session));
                data(&[])
            }
            OPEN_FILE_RO => file.and_then(|file| {
                self.sessions.retain(|s| !is_asked_for(s));
                self.keep(Session {
                    client: request.from,
                    number: request.session,
                    file,
                    burst: None,
                });
                data(&(file.content.len() as u32).to_le_bytes())
            }),
            CALC_FILE_CRC32 => file.and_then(|file| data(&file.crc32.to_le_bytes())),
            READ_FILE | BURST_READ_FILE => match self.sessions.iter().position(is_asked_for) {
                Some(at) => {
                    let mut session = self.sessions.remove(at);
                    let is_burst = request.opcode == BURST_READ_FILE;
                    let answer = request.read(session.file);
                    if is_burst {
                        session.burst = Some((*request, BURST_PACKETS));
                    }
                    self.keep(session);
                    return (!is_burst).then_some(answer);
                }
                None => Err(MavFtpErr::MAV_FTP_ERR_INVALIDSESSION),
            },
            CREATE_FILE..=RENAME => Err(MavFtpErr::MAV_FTP_ERR_FILEPROTECTED),
            _ => Err(MavFtpErr::MAV_FTP_ERR_UNKNOWNCOMMAND),
        })
    }

    /// Sends a packet of the burst that waited longest. What follows the end of the file, NAK with EndOfFile, ends it.
    fn send_of_a_burst(&mut self, core: &mut Core, out: &mut Datagrams) {
        let Some(at) = self.sessions.iter().position(|session| session.burst.is_some()) else {
            return;
        };
        let mut session = self.sessions.remove(at);
        if let Some((mut request, left)) = session.burst.take() {
            let answer = request.read(session.file);
            send(core, out, &request, &answer, left == 1 && answer.is_ok());
            if let (Ok(sent), 2..) = (answer, left) {
                request.sequence = request.sequence.wrapping_add(1);
                request.offset = request.offset.saturating_add(sent.len() as u32);
                session.burst = Some((request, left - 1));
            }
        }
        self.keep(session);
    }
}

impl Service for MetadataService {
    fn hear(&mut self, core: &mut Core, now_ns: Nanos, packet: &Packet<'_>, from: ReplyTo) -> bool {
        let me = (core.sender.system_id, core.sender.component_id);
        if let Some(command) = packet.command() {
            let is_for_me = (command.target_system, command.target_component) == me;
            let asked = command.param(1) == Some(COMPONENT_METADATA_DATA::ID as f32);
            if !(is_for_me && asked && command.number == REQUEST_MESSAGE) {
                return false;
            }
            core.acknowledge(from, command.number, result::ACCEPTED, Reasons::NONE);
            let (time_boot_ms, file_crc, uri) = (time_boot_ms(now_ns), GENERAL.crc32, GENERAL_URI.into());
            core.reply(from.link, &message!(COMPONENT_METADATA, time_boot_ms, file_crc, uri));
            return true;
        }
        if packet.message_id() != FILE_TRANSFER_PROTOCOL_DATA::ID {
            return false;
        }
        let [system, component] = Zeroed(packet.payload()).bytes(1);
        let request = Request::from_payload(packet.payload(), from);
        if (system, component) == me && self.requests.push(request).is_err() {
            core.counters.replies_dropped += 1;
        }
        true
    }

    fn speak(&mut self, core: &mut Core, _: &Step<'_>, out: &mut Datagrams) {
        for request in &core::mem::take(&mut self.requests) {
            if let Some(answer) = self.answer(request) {
                send(core, out, request, &answer, false);
            }
        }
        for _ in 0..BURST_PACKETS_PER_STEP {
            self.send_of_a_burst(core, out);
        }
    }
}

fn send(core: &mut Core, out: &mut Datagrams, to: &Request, answer: &Answer, ends_burst: bool) {
    let (opcode, data) = match answer {
        Ok(data) => (ACK, data.as_slice()),
        Err(error) => (NAK, &[*error as u8][..]),
    };
    let fields = [0, to.from.system, to.from.component]
        .into_iter()
        .chain(to.sequence.wrapping_add(1).to_le_bytes())
        .chain([to.session, opcode, data.len() as u8, to.opcode, ends_burst.into(), 0])
        .chain(to.offset.to_le_bytes())
        .chain(data.iter().copied());
    let payload: [u8; HEADER + MAX_DATA] = filled(fields);
    let (link, id) = (to.from.link, FILE_TRANSFER_PROTOCOL_DATA::ID);
    core.sender.payload(out, link, id, &payload);
}
