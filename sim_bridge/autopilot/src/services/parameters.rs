//! The parameter protocol, integers bytewise as in PX4, <https://mavlink.io/en/services/parameter.html>; PREFLIGHT_STORAGE: keeping
//! parameters, and their defaults again, <https://mavlink.io/en/messages/common.html#MAV_CMD_PREFLIGHT_STORAGE>; and all of them as one
//! file, `@PARAM/param.pck`: what ground stations fetch instead of a list, and store to set many at once,
//! <https://mavlink.io/en/services/ftp.html#param-pck>, format: libraries/AP_Filesystem/README.md of ArduPilot.
//!
//! `_HASH_CHECK` is no parameter but a digest of all of them, by which a ground station knows that what it has kept is
//! current: it comes before a list, and set to its own value it ends one.

use crate::service::prelude::*;
use crate::vehicle_parameters::{ParameterError, ParameterValue, Parameters, parameter_table};
use vigil_mavlink::crc::crc32_on;
use vigil_mavlink::mavlink::types::CharArray;

pub(super) const COMMANDS: &[(u16, Handler)] = &[(PREFLIGHT_STORAGE, store)];

/// Pause between the values of a list: a burst would overrun a client's socket buffer.
const LIST_PAUSE_NS: Nanos = 5_000_000;

const HASH_CHECK: &str = "_HASH_CHECK";

#[derive(Debug, Default)]
pub(crate) struct ParameterService {
    /// Lists that are being sent, with the next index. At most one per link: a new request starts the link's list anew.
    listings: Vec<(LinkId, usize)>,
    due_ns: Nanos,
}

impl Service for ParameterService {
    fn receive(&mut self, packet: &Packet<'_>, source: Source, core: &mut Core) {
        if core.read::<PARAM_REQUEST_LIST_DATA>(packet).is_some() {
            core.outbox.send(source.link, &hash_message(core));
            self.listings.retain(|(link, _)| *link != source.link);
            self.listings.push((source.link, 0));
            self.due_ns = core.now_ns;
        } else if let Some(m) = core.read::<PARAM_REQUEST_READ_DATA>(packet) {
            let by_name = m.param_id.to_str().ok().filter(|_| m.param_index < 0);
            let index = match by_name {
                Some(HASH_CHECK) => return core.outbox.send(source.link, &hash_message(core)),
                Some(name) => Parameters::index_of(name),
                None => usize::try_from(m.param_index).ok(),
            };
            match index.and_then(|index| value_message(core, index)) {
                Some(message) => core.outbox.send(source.link, &message),
                None => {
                    let error = MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST;
                    refuse(core, source, m.param_id, m.param_index, error);
                }
            }
        } else if let Some(m) = core.read::<PARAM_SET_DATA>(packet) {
            if m.param_id.to_str() != Ok(HASH_CHECK) {
                return set(&m, source, core);
            }
            if m.param_value.to_bits() == hash(core) {
                self.listings.retain(|(link, _)| *link != source.link);
            }
            core.outbox.send(source.link, &hash_message(core));
        }
    }

    fn due_ns(&self) -> Nanos {
        self.listings.first().map_or(Nanos::MAX, |_| self.due_ns)
    }

    fn step(&mut self, core: &mut Core) {
        self.due_ns = core.now_ns + LIST_PAUSE_NS;
        for (link, next) in &mut self.listings {
            if let Some(message) = value_message(core, *next) {
                core.outbox.send(*link, &message);
            }
            *next += 1;
        }
        self.listings.retain(|(_, next)| *next < parameter_table().len());
    }
}

/// PARAM_VALUE of the parameter at `index`.
pub(super) fn value_message(core: &Core, index: usize) -> Option<MavMessage> {
    let (info, value) = core.parameters.at(index)?;
    Some(message_of(info.name, index as u16, value.on_wire()))
}

fn message_of(name: &str, param_index: u16, (param_value, param_type): (f32, MavParamType)) -> MavMessage {
    let (param_id, param_count) = (name.into(), parameter_table().len() as u16);
    message!(PARAM_VALUE, param_value, param_count, param_index, param_id, param_type)
}

/// PX4's digest: a CRC over the names and values in the order of the index.
fn hash(core: &Core) -> u32 {
    core.parameters.all().fold(0, |crc, (info, value)| {
        crc32_on(crc32_on(crc, info.name.as_bytes()), &value.on_wire().0.to_le_bytes())
    })
}

fn hash_message(core: &Core) -> MavMessage {
    let value = (f32::from_bits(hash(core)), MavParamType::MAV_PARAM_TYPE_UINT32);
    // It has no place among the parameters.
    message_of(HASH_CHECK, u16::MAX, value)
}

/// Counts a refusal and answers the sender.
fn refuse(core: &mut Core, source: Source, param_id: CharArray<16>, param_index: i16, error: MavParamError) {
    core.refusals.parameter += 1;
    core.outbox
        .send_to(source, message!(PARAM_ERROR, param_index, param_id, error));
}

/// Sets and sends everybody the value in force. A refusal sends the sender the value that stays and why, for clients that
/// know PARAM_ERROR and, as a text, for people.
fn set(m: &PARAM_SET_DATA, source: Source, core: &mut Core) {
    let name = m.param_id.to_str().unwrap_or("");
    let index = Parameters::index_of(name);
    let outcome = match (index, m.param_type) {
        (None, _) => Err(ParameterError::Unknown(name.to_owned())),
        (Some(index), MavParamType::MAV_PARAM_TYPE_INT32) => core
            .parameters
            .set(index, ParameterValue::Integer(m.param_value.to_bits() as i32)),
        (Some(index), MavParamType::MAV_PARAM_TYPE_REAL32) => {
            core.parameters.set(index, ParameterValue::Real(m.param_value))
        }
        (Some(index), _) => Err(ParameterError::WrongType(parameter_table()[index].name)),
    };
    let message = index.and_then(|index| value_message(core, index));
    let Err(error) = outcome else {
        if let Some(message) = message {
            core.outbox.send_all(&message);
        }
        return;
    };
    let code = match error {
        ParameterError::Unknown(_) => MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST,
        ParameterError::WrongType(_) => MavParamError::MAV_PARAM_ERROR_TYPE_MISMATCH,
        ParameterError::Fixed(_) => MavParamError::MAV_PARAM_ERROR_READ_ONLY,
        ParameterError::OutOfRange { .. } => MavParamError::MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE,
    };
    // The error first: a client that knows it would take the unchanged value for a lost packet and try again.
    refuse(core, source, m.param_id, index.map_or(-1, |i| i as i16), code);
    if let Some(message) = message {
        core.outbox.send(source.link, &message);
    }
    core.warn_refused(&error.to_string());
}

const PREFLIGHT_STORAGE: u16 = 245;
/// MAV_PREFLIGHT_STORAGE_ACTION_*.
const READ: f32 = 0.0;
const WRITE: f32 = 1.0;
const RESET: f32 = 2.0;
const RESET_CALIBRATION: f32 = 3.0;
const RESET_ALL: f32 = 4.0;

fn store(command: &Command, _source: Source, core: &mut Core) -> Answer {
    if core.commander.armed {
        return Err(Refusal::REJECTED.saying("parameter storage denied: armed"));
    }
    match command.param(1) {
        // Whatever is set is kept at once, where the simulator keeps anything (`--state`); calibrations change nothing.
        Some(READ | WRITE | RESET_CALIBRATION) => Ok(()),
        Some(RESET | RESET_ALL) => {
            core.parameters.reset();
            core.inform("parameters reset to their defaults");
            Ok(())
        }
        _ => Err(Refusal::DENIED),
    }
}

/// Longest file that is taken: all parameters with their defaults are far below it.
pub(super) const MAX_STORED: usize = 65_536;
/// Its path, behind which options may follow: `?start=N&count=N&withdefaults=1`.
const PATH: &str = "@PARAM/param.pck";
/// The first word of the file, without and with defaults.
const MAGIC: u16 = 0x671B;
const MAGIC_WITH_DEFAULTS: u16 = 0x671C;
/// AP_PARAM_INT32 and AP_PARAM_FLOAT.
const INT32: u8 = 3;
const FLOAT: u8 = 4;
/// Flag of an entry: its default follows, because it differs.
const HAS_DEFAULT: u8 = 1;

/// Whether a path is the file's.
pub(super) fn is_packed(path: &str) -> bool {
    path.strip_prefix('/').unwrap_or(path) == PATH
}

/// The file that a path names; `None` if it names another.
pub(super) fn read_packed(path: &str, core: &Core) -> Option<Vec<u8>> {
    let (path, options) = path.split_once('?').unwrap_or((path, ""));
    if !is_packed(path) {
        return None;
    }
    let option = |name: &str| {
        let mut options = options.split('&').filter_map(|option| option.split_once('='));
        let (_, value) = options.find(|(key, _)| *key == name)?;
        value.parse::<usize>().ok()
    };
    let with_defaults = option("withdefaults") == Some(1);
    let total = parameter_table().len();
    let start = option("start").unwrap_or(0).min(total);
    let count = option("count").filter(|count| *count > 0).unwrap_or(total);
    let count = count.min(total - start);
    let magic = if with_defaults { MAGIC_WITH_DEFAULTS } else { MAGIC };
    let mut file = Vec::with_capacity(16 * count);
    for word in [magic, count as u16, total as u16] {
        file.extend_from_slice(&word.to_le_bytes());
    }
    let mut last = "";
    for (info, value) in core.parameters.all().skip(start).take(count) {
        // A name repeats the beginning of the one before; lengths are of four bits, the second less one.
        let same = info.name.bytes().zip(last.bytes()).take_while(|(a, b)| a == b);
        let common = same.count().min(15).min(info.name.len() - 1);
        let rest = info.name.as_bytes().get(common..).unwrap_or_default();
        let kind = match value {
            ParameterValue::Integer(_) => INT32,
            ParameterValue::Real(_) => FLOAT,
        };
        let tells_default = with_defaults && value != info.default;
        let flags = if tells_default { HAS_DEFAULT } else { 0 };
        file.push(kind | flags << 4);
        file.push(common as u8 | ((rest.len() - 1) as u8) << 4);
        file.extend_from_slice(rest);
        file.extend_from_slice(&value.on_wire().0.to_le_bytes());
        if tells_default {
            file.extend_from_slice(&info.default.on_wire().0.to_le_bytes());
        }
        last = info.name;
    }
    Some(file)
}

/// A parameter of a stored file: name, type, bits of the value.
type Stored = (String, u8, [u8; 4]);

/// The parameters of a stored file; `None` if it is not one. Its third word is its own length or anything: clients differ.
fn parse(file: &[u8]) -> Option<Vec<Stored>> {
    let word = |at: usize| Some(u16::from_le_bytes([*file.get(at)?, *file.get(at + 1)?]));
    if !matches!(word(0)?, MAGIC | MAGIC_WITH_DEFAULTS) {
        return None;
    }
    let count = usize::from(word(2)?);
    let mut rest = file.get(6..)?;
    let mut stored: Vec<Stored> = Vec::new();
    while let [first, after_first @ ..] = rest {
        // Zeros between entries fill up packets.
        if *first == 0 {
            rest = after_first;
            continue;
        }
        let (lengths, behind) = after_first.split_first()?;
        let (common, own) = (usize::from(lengths & 15), usize::from(lengths >> 4) + 1);
        let (name_end, behind) = behind.split_at_checked(own)?;
        let (value, behind) = behind.split_first_chunk::<4>()?;
        let before = stored.last().map_or("", |(name, ..)| name.as_str());
        let name = before.get(..common)?.to_owned() + core::str::from_utf8(name_end).ok()?;
        stored.push((name, first & 15, *value));
        rest = match first >> 4 & HAS_DEFAULT {
            0 => behind,
            _ => behind.get(4..)?,
        };
    }
    (stored.len() == count).then_some(stored)
}

/// Sets what a stored file says: all of it, or nothing where it is no such file or a value is refused. Sends everybody what changed.
pub(super) fn store_packed(file: &[u8], core: &mut Core) -> Result<(), ()> {
    let mut parameters = core.parameters.clone();
    let outcome = parse(file)
        .ok_or_else(|| "it is not one".to_owned())
        .and_then(|stored| {
            for (name, kind, value) in &stored {
                let index = Parameters::index_of(name).ok_or(format!("there is no parameter {name}"))?;
                let value = match *kind {
                    INT32 => ParameterValue::Integer(i32::from_le_bytes(*value)),
                    FLOAT => ParameterValue::Real(f32::from_le_bytes(*value)),
                    _ => return Err(format!("{name} is of another type")),
                };
                parameters.set(index, value).map_err(|error| error.to_string())?;
            }
            Ok(())
        });
    if let Err(why) = outcome {
        core.warn_refused(&format!("parameter file refused: {why}"));
        return Err(());
    }
    let before = std::mem::replace(&mut core.parameters, parameters);
    for index in 0..parameter_table().len() {
        if core.parameters.at(index) != before.at(index)
            && let Some(message) = value_message(core, index)
        {
            core.outbox.send_all(&message);
        }
    }
    Ok(())
}
