//! All parameters as one file, `@PARAM/param.pck`: what ground stations fetch instead of a list, and store to set many at once.
//! <https://mavlink.io/en/services/ftp.html#param-pck>, format: libraries/AP_Filesystem/README.md of ArduPilot.

use crate::service::prelude::*;
use crate::services::parameters::value_message;
use crate::vehicle_parameters::{ParameterValue, Parameters};

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
pub(super) fn is_it(path: &str) -> bool {
    path.strip_prefix('/').unwrap_or(path) == PATH
}

/// The file that a path names; `None` if it names another.
pub(super) fn read(path: &str, core: &Core) -> Option<Vec<u8>> {
    let (path, options) = path.split_once('?').unwrap_or((path, ""));
    if !is_it(path) {
        return None;
    }
    let option = |name: &str| {
        let mut options = options.split('&').filter_map(|option| option.split_once('='));
        let (_, value) = options.find(|(key, _)| *key == name)?;
        value.parse::<usize>().ok()
    };
    let with_defaults = option("withdefaults") == Some(1);
    let total = Parameters::count();
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
            ParameterValue::Int32(_) => INT32,
            ParameterValue::Real32(_) => FLOAT,
        };
        let tells_default = with_defaults && value != info.default;
        let flags = if tells_default { HAS_DEFAULT } else { 0 };
        file.push(kind | flags << 4);
        file.push(common as u8 | ((rest.len() - 1) as u8) << 4);
        file.extend_from_slice(rest);
        file.extend_from_slice(&value.to_le_bytes());
        if tells_default {
            file.extend_from_slice(&info.default.to_le_bytes());
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
pub(super) fn store(file: &[u8], core: &mut Core) -> Result<(), ()> {
    let mut parameters = core.parameters.clone();
    let outcome = parse(file)
        .ok_or_else(|| "it is not one".to_owned())
        .and_then(|stored| {
            for (name, kind, value) in &stored {
                let index = Parameters::index_of(name).ok_or(format!("there is no parameter {name}"))?;
                let value = match *kind {
                    INT32 => ParameterValue::Int32(i32::from_le_bytes(*value)),
                    FLOAT => ParameterValue::Real32(f32::from_le_bytes(*value)),
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
    for index in 0..Parameters::count() {
        if core.parameters.at(index) != before.at(index)
            && let Some(message) = value_message(core, index)
        {
            core.outbox.send_all(&message);
        }
    }
    Ok(())
}
