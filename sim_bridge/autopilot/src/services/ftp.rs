//! File transfer over the vehicle's files in memory. <https://mavlink.io/en/services/ftp.html>
//!
//! A session's number is the client's choice and counts per client: clients exist that ignore the number a server gives
//! (MAVSDK) and that want theirs back (pymavlink), and this suits both.

use crate::files::{FileError, FileSystem};
use crate::service::prelude::*;
use crate::services::parameters::{MAX_STORED, is_packed, read_packed, store_packed};
use vigil_mavlink::common::MavFtpOpcode as Opcode;
use vigil_mavlink::crc::crc32;

/// Bytes of data in a packet.
const MAX_DATA: usize = 239;
const HEADER: usize = 12;
/// Open files of one client, and of all.
const MAX_CLIENT_SESSIONS: usize = 4;
const MAX_SESSIONS: usize = 16;
/// A session that was not used for so long makes room for a new one: its client has vanished.
const SESSION_IDLE_NS: Nanos = 10_000_000_000;
/// Pace of a burst: a faster one would overrun a client's socket buffer.
const BURST_PAUSE_NS: Nanos = 1_000_000;
const BURST_PACKETS_AT_ONCE: u16 = 2;
/// Packets of one burst, about 35 kB as in PX4; the client asks for the next.
const BURST_PACKETS: u16 = 146;
/// Answers kept for a repeated request, one per client, and for how long: a repetition comes within a second.
const MAX_ANSWERS: usize = 8;
const ANSWER_KEPT_NS: Nanos = 2_000_000_000;

/// A request.
struct Request<'a> {
    sequence: u16,
    session: u8,
    opcode: u8,
    offset: usize,
    /// `size` of the header: of the data, or of what is to be read.
    size: usize,
    data: &'a [u8],
}

impl<'a> Request<'a> {
    fn read(payload: &'a [u8; 251]) -> Self {
        let [s0, s1, session, opcode, size, _, _, _, o0, o1, o2, o3, data @ ..] = payload;
        let size = usize::from(*size);
        Self {
            sequence: u16::from_le_bytes([*s0, *s1]),
            session: *session,
            opcode: *opcode,
            offset: u32::from_le_bytes([*o0, *o1, *o2, *o3]) as usize,
            size,
            data: data.get(..size).unwrap_or(data),
        }
    }

    /// The two texts of the data, the second empty where there is one: each ends at its zero or with the data.
    fn texts(&self) -> Result<(&'a str, &'a str), FileError> {
        let mut parts = self.data.split(|byte| *byte == 0);
        let mut text = || core::str::from_utf8(parts.next().unwrap_or_default()).map_err(|_| FileError::BadPath);
        Ok((text()?, text()?))
    }

    fn path(&self) -> Result<&'a str, FileError> {
        self.texts().map(|(path, _)| path)
    }
}

/// The data of an acknowledgement.
type Reply = Vec<u8>;

fn number(value: u32) -> Reply {
    value.to_le_bytes().to_vec()
}

/// Why a request is not acknowledged: the error code and, of FAILERRNO, the number.
#[derive(Debug, Clone, Copy)]
struct Nak(MavFtpErr, Option<u8>);

impl From<MavFtpErr> for Nak {
    fn from(error: MavFtpErr) -> Self {
        Self(error, None)
    }
}

impl From<FileError> for Nak {
    /// The numbers of errno are those of Linux, as clients of PX4's simulation know them.
    fn from(error: FileError) -> Self {
        let errno = |number| Self(MavFtpErr::MAV_FTP_ERR_FAILERRNO, Some(number));
        match error {
            FileError::NotFound => MavFtpErr::MAV_FTP_ERR_FILENOTFOUND.into(),
            FileError::Exists => MavFtpErr::MAV_FTP_ERR_FILEEXISTS.into(),
            FileError::Protected => MavFtpErr::MAV_FTP_ERR_FILEPROTECTED.into(),
            FileError::NotADirectory => errno(20),
            FileError::IsADirectory => errno(21),
            FileError::BadPath => errno(22),
            FileError::NoSpace => errno(28),
            FileError::NotEmpty => errno(39),
        }
    }
}

#[derive(Debug, Clone, Copy)]
struct Burst {
    offset: usize,
    /// Bytes per packet.
    size: usize,
    sequence: u16,
    packets_left: u16,
}

/// An open file.
#[derive(Debug)]
struct Session {
    client: Source,
    number: u8,
    path: String,
    /// What is read or written instead of a file of that path: made when it was opened.
    made: Option<Vec<u8>>,
    writes: bool,
    used_ns: Nanos,
    burst: Option<Burst>,
}

/// The last answer to a client that must not be worked out twice: request, answer, and when.
type Answer = ([u8; 251], [u8; 251], Nanos);

#[derive(Default)]
pub(crate) struct Ftp {
    sessions: Vec<Session>,
    answers: Vec<(Source, Answer)>,
    due_ns: Nanos,
}

impl Service for Ftp {
    fn receive(&mut self, packet: &Packet<'_>, source: Source, core: &mut Core) {
        let Some(message) = core.read::<FILE_TRANSFER_PROTOCOL_DATA>(packet) else {
            return;
        };
        let now_ns = core.now_ns;
        if let Some((_, (asked, payload, at_ns))) = self.answers.iter().find(|(client, _)| *client == source)
            && *asked == message.payload
            && now_ns.saturating_sub(*at_ns) < ANSWER_KEPT_NS
        {
            return send(core, source, *payload);
        }
        let request = Request::read(&message.payload);
        let outcome = self.handle(&request, source, core);
        if outcome.is_err() {
            core.refusals.file += 1;
        }
        let Some(outcome) = outcome.transpose() else {
            return;
        };
        let sequence = request.sequence.wrapping_add(1);
        // The offset comes back too: pymavlink knows by it which piece of an upload is acknowledged.
        let offset = request.offset as u32;
        let header = (sequence, request.session, request.opcode, offset);
        let payload = encode(header, outcome, false);
        if acts_once(request.opcode) {
            let answer = (message.payload, payload, now_ns);
            keep(&mut self.answers, MAX_ANSWERS, source, answer);
        }
        send(core, source, payload);
    }

    fn due_ns(&self) -> Nanos {
        let burst = self.sessions.iter().find_map(|s| s.burst);
        burst.map_or(Nanos::MAX, |_| self.due_ns)
    }

    fn step(&mut self, core: &mut Core) {
        self.due_ns = core.now_ns + BURST_PAUSE_NS;
        for session in &mut self.sessions {
            for _ in 0..BURST_PACKETS_AT_ONCE {
                session.send_burst_packet(core);
            }
        }
    }
}

/// Whether a repetition of the request would find another state than the first.
fn acts_once(opcode: u8) -> bool {
    use Opcode::*;
    [
        MAV_FTP_OPCODE_TERMINATESESSION,
        MAV_FTP_OPCODE_REMOVEFILE,
        MAV_FTP_OPCODE_CREATEDIRECTORY,
        MAV_FTP_OPCODE_REMOVEDIRECTORY,
        MAV_FTP_OPCODE_RENAME,
    ]
    .iter()
    .any(|once| *once as u8 == opcode)
}

fn encode(
    (sequence, session, request_opcode, offset): (u16, u8, u8, u32),
    outcome: Result<Reply, Nak>,
    burst_complete: bool,
) -> [u8; 251] {
    let (opcode, data) = match outcome {
        Ok(data) => (Opcode::MAV_FTP_OPCODE_ACK, data),
        Err(Nak(error, errno)) => {
            let data = [error as u8].into_iter().chain(errno).collect();
            (Opcode::MAV_FTP_OPCODE_NAK, data)
        }
    };
    let mut payload = [0; 251];
    let size = data.len().min(MAX_DATA);
    let complete = u8::from(burst_complete);
    payload[..2].copy_from_slice(&sequence.to_le_bytes());
    payload[2..7].copy_from_slice(&[session, opcode as u8, size as u8, request_opcode, complete]);
    payload[8..HEADER].copy_from_slice(&offset.to_le_bytes());
    payload[HEADER..HEADER + size].copy_from_slice(&data[..size]);
    payload
}

fn send(core: &mut Core, client: Source, payload: [u8; 251]) {
    core.outbox.send_to(client, message!(FILE_TRANSFER_PROTOCOL, payload));
}

impl Ftp {
    /// What a request comes to; `None` where the answer follows as a burst.
    fn handle(&mut self, request: &Request<'_>, client: Source, core: &mut Core) -> Result<Option<Reply>, Nak> {
        use Opcode::*;
        if request.size > MAX_DATA {
            return Err(MavFtpErr::MAV_FTP_ERR_INVALIDDATASIZE.into());
        }
        let is = |opcode: Opcode| request.opcode == opcode as u8;
        let now_s = core.unix_time_s();
        let done = |()| Reply::new();
        let reply = if is(MAV_FTP_OPCODE_NONE) {
            done(())
        } else if is(MAV_FTP_OPCODE_TERMINATESESSION) {
            let index = self.find(client, request.session)?;
            let session = self.sessions.remove(index);
            if let Some(stored) = session.made.filter(|_| session.writes) {
                store_packed(&stored, core).map_err(|()| MavFtpErr::MAV_FTP_ERR_FAIL)?;
            }
            done(())
        } else if is(MAV_FTP_OPCODE_RESETSESSION) {
            self.sessions.retain(|s| s.client != client);
            done(())
        } else if is(MAV_FTP_OPCODE_LISTDIRECTORY) || is(MAV_FTP_OPCODE_LISTDIRECTORYWITHTIME) {
            list(&core.files, request, is(MAV_FTP_OPCODE_LISTDIRECTORYWITHTIME))?
        } else if is(MAV_FTP_OPCODE_OPENFILERO) {
            let path = request.path()?;
            let made = read_packed(path, core);
            let size = match &made {
                Some(made) => made.len(),
                None => core.files.read(path)?.len(),
            };
            self.open(request, client, core.now_ns)?.made = made;
            number(size as u32)
        } else if is(MAV_FTP_OPCODE_CREATEFILE) || is(MAV_FTP_OPCODE_OPENFILEWO) {
            self.open_for_writing(request, client, core)?
        } else if is(MAV_FTP_OPCODE_READFILE) {
            let session = self.session(client, request.session, core.now_ns)?;
            session.read(&core.files, request.offset, request.size)?
        } else if is(MAV_FTP_OPCODE_BURSTREADFILE) {
            self.begin_burst(request, client, core)?;
            return Ok(None);
        } else if is(MAV_FTP_OPCODE_WRITEFILE) {
            self.write(request, client, core)?
        } else if is(MAV_FTP_OPCODE_REMOVEFILE) {
            core.files.remove_file(request.path()?).map(done)?
        } else if is(MAV_FTP_OPCODE_CREATEDIRECTORY) {
            core.files.make_directory(request.path()?, now_s).map(done)?
        } else if is(MAV_FTP_OPCODE_REMOVEDIRECTORY) {
            core.files.remove_directory(request.path()?).map(done)?
        } else if is(MAV_FTP_OPCODE_TRUNCATEFILE) {
            core.files.truncate(request.path()?, request.offset, now_s).map(done)?
        } else if is(MAV_FTP_OPCODE_RENAME) {
            let (from, to) = request.texts()?;
            core.files.rename(from, to).map(done)?
        } else if is(MAV_FTP_OPCODE_CALCFILECRC) {
            let path = request.path()?;
            match read_packed(path, core) {
                Some(made) => number(crc32(&made)),
                None => number(crc32(core.files.read(path)?)),
            }
        } else {
            return Err(MavFtpErr::MAV_FTP_ERR_UNKNOWNCOMMAND.into());
        };
        Ok(Some(reply))
    }

    fn begin_burst(&mut self, request: &Request<'_>, client: Source, core: &Core) -> Result<(), Nak> {
        let session = self.session(client, request.session, core.now_ns)?;
        session.read(&core.files, request.offset, 1)?;
        session.burst = Some(Burst {
            offset: request.offset,
            size: match request.size {
                0 => MAX_DATA,
                size => size,
            },
            sequence: request.sequence,
            packets_left: BURST_PACKETS,
        });
        self.due_ns = core.now_ns;
        Ok(())
    }

    /// Opens a file to write it: one that is there already, or a new one.
    fn open_for_writing(&mut self, request: &Request<'_>, client: Source, core: &mut Core) -> Result<Reply, Nak> {
        let exists = request.opcode == Opcode::MAV_FTP_OPCODE_OPENFILEWO as u8;
        let now_s = core.unix_time_s();
        let path = request.path()?;
        if is_packed(path) {
            // It takes effect as a whole when the session ends.
            let session = self.open(request, client, core.now_ns)?;
            (session.writes, session.made) = (true, Some(Vec::new()));
            return Ok(number(0));
        }
        self.make_room(client, request.session, core.now_ns)?;
        core.files.open_for_writing(path, exists, now_s)?;
        self.open(request, client, core.now_ns)?.writes = true;
        Ok(number(core.files.read(path)?.len() as u32))
    }

    fn write(&mut self, request: &Request<'_>, client: Source, core: &mut Core) -> Result<Reply, Nak> {
        let now_s = core.unix_time_s();
        let session = self.session(client, request.session, core.now_ns)?;
        if !session.writes {
            return Err(FileError::Protected.into());
        }
        if let Some(made) = &mut session.made {
            let end = request.offset.saturating_add(request.data.len());
            if end > MAX_STORED {
                return Err(FileError::NoSpace.into());
            }
            made.resize(made.len().max(end), 0);
            made[request.offset..end].copy_from_slice(request.data);
        } else {
            core.files.write(&session.path, request.offset, request.data, now_s)?;
        }
        Ok(number(request.data.len() as u32))
    }

    fn find(&self, client: Source, number: u8) -> Result<usize, Nak> {
        let is_it = |s: &Session| s.client == client && s.number == number;
        let index = self.sessions.iter().position(is_it);
        index.ok_or(MavFtpErr::MAV_FTP_ERR_INVALIDSESSION.into())
    }

    fn session(&mut self, client: Source, number: u8, now_ns: Nanos) -> Result<&mut Session, Nak> {
        let index = self.find(client, number)?;
        let session = &mut self.sessions[index];
        session.used_ns = now_ns;
        Ok(session)
    }

    /// Makes sure that a session can be opened. One of the same number gives way, then the one idle for longest.
    fn make_room(&mut self, client: Source, number: u8, now_ns: Nanos) -> Result<(), Nak> {
        self.sessions.retain(|s| s.client != client || s.number != number);
        let own = self.sessions.iter().filter(|s| s.client == client).count();
        if own < MAX_CLIENT_SESSIONS && self.sessions.len() < MAX_SESSIONS {
            return Ok(());
        }
        let only_own = own >= MAX_CLIENT_SESSIONS;
        let oldest = (0..self.sessions.len())
            .filter(|i| !only_own || self.sessions[*i].client == client)
            .min_by_key(|i| self.sessions[*i].used_ns)
            .filter(|i| now_ns.saturating_sub(self.sessions[*i].used_ns) >= SESSION_IDLE_NS);
        let oldest = oldest.ok_or(MavFtpErr::MAV_FTP_ERR_NOSESSIONSAVAILABLE)?;
        self.sessions.remove(oldest);
        Ok(())
    }

    /// Opens what a request names.
    fn open(&mut self, request: &Request<'_>, client: Source, now_ns: Nanos) -> Result<&mut Session, Nak> {
        let (number, path) = (request.session, request.path()?);
        self.make_room(client, number, now_ns)?;
        self.sessions.push(Session {
            client,
            number,
            path: path.to_owned(),
            made: None,
            writes: false,
            used_ns: now_ns,
            burst: None,
        });
        self.session(client, number, now_ns)
    }
}

impl Session {
    fn read(&self, files: &FileSystem, offset: usize, size: usize) -> Result<Reply, Nak> {
        let content = match &self.made {
            Some(made) => made,
            None => files.read(&self.path)?,
        };
        let rest = content.get(offset..).filter(|rest| !rest.is_empty());
        let rest = rest.ok_or(MavFtpErr::MAV_FTP_ERR_EOF)?;
        Ok(rest.get(..size).unwrap_or(rest).to_vec())
    }

    /// The next packet of a burst; behind the end of the file that is a NAK with EOF, which ends it.
    fn send_burst_packet(&mut self, core: &mut Core) {
        let Some(burst) = self.burst.take() else {
            return;
        };
        let sequence = burst.sequence.wrapping_add(1);
        let packets_left = burst.packets_left.saturating_sub(1);
        let outcome = self.read(&core.files, burst.offset, burst.size);
        let is_complete = outcome.is_ok() && packets_left == 0;
        if let Ok(data) = &outcome {
            self.burst = (packets_left > 0).then_some(Burst {
                offset: burst.offset + data.len(),
                sequence,
                packets_left,
                ..burst
            });
        }
        self.used_ns = core.now_ns;
        let opcode = Opcode::MAV_FTP_OPCODE_BURSTREADFILE as u8;
        let header = (sequence, self.number, opcode, burst.offset as u32);
        send(core, self.client, encode(header, outcome, is_complete));
    }
}

/// As many entries from number `offset` as fit: type, name, and of a file its size, each with a zero behind. With times
/// a directory also has a size (0).
fn list(files: &FileSystem, request: &Request<'_>, with_times: bool) -> Result<Reply, Nak> {
    let mut data = Vec::with_capacity(MAX_DATA);
    for (name, entry) in files.list(request.path()?)?.into_iter().skip(request.offset) {
        let (kind, size) = entry.size().map_or(('D', 0), |size| ('F', size));
        let line = match (with_times, entry.size()) {
            (true, _) => format!("{kind}{name}\t{size}\t{}\0", entry.modified_s),
            (false, Some(_)) => format!("{kind}{name}\t{size}\0"),
            (false, None) => format!("{kind}{name}\0"),
        };
        if data.len() + line.len() > MAX_DATA {
            break;
        }
        data.extend_from_slice(line.as_bytes());
    }
    if data.is_empty() {
        return Err(MavFtpErr::MAV_FTP_ERR_EOF.into());
    }
    Ok(data)
}
