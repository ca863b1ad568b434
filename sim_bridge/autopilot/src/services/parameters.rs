//! The parameter protocol, integers bytewise as in PX4. <https://mavlink.io/en/services/parameter.html>
//!
//! `_HASH_CHECK` is no parameter but a digest of all of them, by which a ground station knows that what it has kept is
//! current: it comes before a list, and set to its own value it ends one.

use crate::service::prelude::*;
use crate::vehicle_parameters::{ParameterError, ParameterValue, Parameters};
use vigil_mavlink::crc::crc32_on;
use vigil_mavlink::mavlink::types::CharArray;

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
        self.listings.retain(|(_, next)| *next < Parameters::count());
    }
}

/// PARAM_VALUE of the parameter at `index`.
pub(super) fn value_message(core: &Core, index: usize) -> Option<MavMessage> {
    let (info, value) = core.parameters.at(index)?;
    let (param_value, param_type) = match value {
        ParameterValue::Int32(v) => (f32::from_bits(v as u32), MavParamType::MAV_PARAM_TYPE_INT32),
        ParameterValue::Real32(v) => (v, MavParamType::MAV_PARAM_TYPE_REAL32),
    };
    Some(MavMessage::PARAM_VALUE(PARAM_VALUE_DATA {
        param_value,
        param_count: Parameters::count() as u16,
        param_index: index as u16,
        param_id: info.name.into(),
        param_type,
    }))
}

/// PX4's digest: a CRC over the names and values in the order of the index.
fn hash(core: &Core) -> u32 {
    core.parameters.all().fold(0, |crc, (info, value)| {
        crc32_on(crc32_on(crc, info.name.as_bytes()), &value.to_le_bytes())
    })
}

fn hash_message(core: &Core) -> MavMessage {
    MavMessage::PARAM_VALUE(PARAM_VALUE_DATA {
        param_value: f32::from_bits(hash(core)),
        param_count: Parameters::count() as u16,
        // It has no place among the parameters.
        param_index: u16::MAX,
        param_id: HASH_CHECK.into(),
        param_type: MavParamType::MAV_PARAM_TYPE_UINT32,
    })
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
            .set(index, ParameterValue::Int32(m.param_value.to_bits() as i32)),
        (Some(index), MavParamType::MAV_PARAM_TYPE_REAL32) => {
            core.parameters.set(index, ParameterValue::Real32(m.param_value))
        }
        (Some(index), _) => Err(ParameterError::WrongType(crate::parameter_table()[index].name)),
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
