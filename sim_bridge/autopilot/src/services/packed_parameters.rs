//! All parameters as one file, `@PARAM/param.pck`: what ground stations of ArduPilot fetch instead of a list.
//! <https://mavlink.io/en/services/ftp.html#param-pck>, format: libraries/AP_Filesystem/README.md of ArduPilot.

use crate::core::Core;
use crate::vehicle_parameters::{ParameterValue, Parameters};

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

/// The file that a path names; `None` if it names another.
pub(super) fn read(path: &str, core: &Core) -> Option<Vec<u8>> {
    let path = path.strip_prefix('/').unwrap_or(path);
    let (path, options) = path.split_once('?').unwrap_or((path, ""));
    if path != PATH {
        return None;
    }
    let option = |name: &str| {
        let mut options = options.split('&').filter_map(|option| option.split_once('='));
        options
            .find(|(key, _)| *key == name)
            .and_then(|(_, value)| value.parse::<usize>().ok())
    };
    let with_defaults = option("withdefaults") == Some(1);
    let total = Parameters::count();
    let start = option("start").unwrap_or(0).min(total);
    let count = option("count")
        .filter(|count| *count > 0)
        .unwrap_or(total)
        .min(total - start);
    let magic = if with_defaults { MAGIC_WITH_DEFAULTS } else { MAGIC };
    let mut file = Vec::with_capacity(16 * count);
    for word in [magic, count as u16, total as u16] {
        file.extend_from_slice(&word.to_le_bytes());
    }
    let mut last = "";
    for (info, value) in (start..start + count).filter_map(|index| core.parameters.at(index)) {
        // A name repeats the beginning of the one before; lengths are of four bits, the second less one.
        let common = info
            .name
            .bytes()
            .zip(last.bytes())
            .take_while(|(a, b)| a == b)
            .count()
            .min(15)
            .min(info.name.len() - 1);
        let rest = info.name.as_bytes().get(common..).unwrap_or_default();
        let bytes = |value| match value {
            ParameterValue::Int32(value) => (INT32, value.to_le_bytes()),
            ParameterValue::Real32(value) => (FLOAT, value.to_le_bytes()),
        };
        let (kind, value_bytes) = bytes(value);
        let tells_default = with_defaults && value != info.default;
        let flags = if tells_default { HAS_DEFAULT } else { 0 };
        file.push(kind | flags << 4);
        file.push(common as u8 | ((rest.len() - 1) as u8) << 4);
        file.extend_from_slice(rest);
        file.extend_from_slice(&value_bytes);
        if tells_default {
            file.extend_from_slice(&bytes(info.default).1);
        }
        last = info.name;
    }
    Some(file)
}
