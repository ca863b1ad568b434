//! The guidance computer's own parameters: <https://mavlink.io/en/services/parameter.html>.
//!
//! A fixed table; who made it looks for changes after each step's packets ([`Parameters::take_changed`]). A value that is
//! not accepted changes nothing, and the answer holds the value in force.

use crate::autopilot::Flavour;
use crate::framing::Zeroed;
use heapless::Vec;
use mavlink::MessageData;
use mavlink::dialects::common::{
    MavMessage, MavParamType, PARAM_REQUEST_LIST_DATA, PARAM_REQUEST_READ_DATA, PARAM_SET_DATA, PARAM_VALUE_DATA,
};
use vigil_types::{Choice, ParameterSpec};

/// Parameters that a table holds.
pub const MAX_PARAMETERS: usize = 16;
/// Bytes of a parameter's name on the wire.
const NAME_LEN: usize = 16;
/// MAV_PARAM_TYPE numbers.
const INT32: u8 = 6;
const REAL32: u8 = 9;

/// A parameter's value; its type never changes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ParameterValue {
    /// MAV_PARAM_TYPE_REAL32.
    Real(f32),
    /// MAV_PARAM_TYPE_INT32.
    Integer(i32),
}

impl ParameterValue {
    /// The value as a number.
    pub fn as_f64(self) -> f64 {
        match self {
            Self::Real(v) => v.into(),
            Self::Integer(v) => v.into(),
        }
    }

    /// The value as an f32.
    pub fn as_f32(self) -> f32 {
        self.as_f64() as f32
    }

    /// The choice that the value is the number of; `None` when it is none.
    pub fn as_choice<T: Choice>(self) -> Option<T> {
        match self {
            Self::Integer(v) => T::from_code(v),
            Self::Real(_) => None,
        }
    }

    /// As PX4 and its clients put it on the wire, whole numbers bytewise, and its type.
    pub const fn on_wire(self) -> (f32, MavParamType) {
        match self {
            Self::Real(v) => (v, MavParamType::MAV_PARAM_TYPE_REAL32),
            Self::Integer(v) => (f32::from_bits(v as u32), MavParamType::MAV_PARAM_TYPE_INT32),
        }
    }
}

/// One parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameter {
    /// Name, at most 16 characters.
    pub name: &'static str,
    /// Value in force.
    pub value: ParameterValue,
    /// Least value accepted.
    pub least: f32,
    /// Greatest value accepted.
    pub greatest: f32,
    /// May be changed while guidance flies.
    pub in_flight: bool,
}

impl Parameter {
    /// A row of the table of parameters with its value in force; `None` when it has no MAVLink name or no numbers.
    pub fn of(spec: &ParameterSpec, value: ParameterValue) -> Option<Self> {
        let (mavlink, range) = (spec.mavlink?, spec.range()?);
        Some(Self {
            name: mavlink.name,
            value,
            least: range.least as f32,
            greatest: range.greatest as f32,
            in_flight: mavlink.in_flight,
        })
    }

    /// The value of its type and within its limits that a number stands for.
    fn accepted(&self, number: f64) -> Result<ParameterValue, ValueError> {
        let (least, greatest) = (self.least, self.greatest);
        // A file has decimals, the limits are the floats next to them.
        let rounded = number as f32;
        // NaN is in no range.
        if !(least..=greatest).contains(&rounded) {
            return Err(ValueError::OutOfRange { least, greatest });
        }
        match self.value {
            ParameterValue::Real(_) => Ok(ParameterValue::Real(rounded)),
            ParameterValue::Integer(_) if libm::trunc(number) == number => Ok(ParameterValue::Integer(number as i32)),
            ParameterValue::Integer(_) => Err(ValueError::NotWhole),
        }
    }
}

/// Why a value from a file is no value of a parameter.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum ValueError {
    /// There is no parameter of that name.
    #[error("there is no parameter of that name")]
    NoSuchName,
    /// The value is not within the limits.
    #[error("allowed: {least} to {greatest}")]
    OutOfRange {
        /// Least value.
        least: f32,
        /// Greatest value.
        greatest: f32,
    },
    /// An integer parameter takes whole numbers.
    #[error("it takes whole numbers")]
    NotWhole,
}

/// A request of the parameter protocol.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum ParameterRequest {
    List,
    /// Of one parameter: the one of that index or, where it is -1, of that name.
    One {
        name: [u8; NAME_LEN],
        index: i16,
        /// To be set: the value field's bytes, and its MAV_PARAM_TYPE.
        set: Option<([u8; 4], u8)>,
    },
}

impl ParameterRequest {
    /// The request in a packet's payload.
    pub fn from_payload(message_id: u32, payload: &[u8]) -> Option<Self> {
        let field = Zeroed(payload);
        Some(match message_id {
            PARAM_REQUEST_LIST_DATA::ID => Self::List,
            PARAM_REQUEST_READ_DATA::ID => {
                let index = i16::from_le_bytes(field.bytes(0)).max(-1);
                let name = if index < 0 { field.bytes(4) } else { [0; NAME_LEN] };
                Self::One { name, index, set: None }
            }
            PARAM_SET_DATA::ID => {
                let (name, set) = (field.bytes(6), Some((field.bytes(0), field.u8(22))));
                Self::One { name, index: -1, set }
            }
            _ => return None,
        })
    }
}

/// The table.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Parameters {
    all: Vec<Parameter, MAX_PARAMETERS>,
    changed: bool,
}

impl Parameters {
    /// A table of `parameters`; those beyond [`MAX_PARAMETERS`] are left out.
    pub fn new(parameters: impl IntoIterator<Item = Parameter>) -> Self {
        Self {
            all: parameters.into_iter().take(MAX_PARAMETERS).collect(),
            changed: false,
        }
    }

    /// The value of the parameter of that name.
    pub fn value_of(&self, name: &str) -> Option<ParameterValue> {
        self.all.iter().find(|p| p.name == name).map(|p| p.value)
    }

    /// All parameters, in the table's order.
    pub fn all(&self) -> &[Parameter] {
        &self.all
    }

    /// The value of the type and within the limits of the parameter of that name, as a file gives it.
    ///
    /// # Errors
    /// What is wrong: no such name, not a whole number, out of range.
    pub fn check(&self, name: &str, value: f64) -> Result<ParameterValue, ValueError> {
        let parameter = self.all.iter().find(|p| p.name == name).ok_or(ValueError::NoSuchName)?;
        parameter.accepted(value)
    }

    /// Whether a value was set since the last call.
    pub fn take_changed(&mut self) -> bool {
        core::mem::take(&mut self.changed)
    }

    /// The place of the parameter of that index or, where it is -1, of that name, as the wire has it: filled with zeros.
    pub(crate) fn find(&self, name: &[u8; NAME_LEN], index: i16) -> Option<usize> {
        match usize::try_from(index) {
            Ok(place) => (place < self.all.len()).then_some(place),
            Err(_) => {
                let has_name = |p: &Parameter| Zeroed(p.name.as_bytes()).bytes::<NAME_LEN>(0) == *name;
                self.all.iter().position(has_name)
            }
        }
    }

    /// Sets a parameter if type and value are right; else says why it was not set.
    pub(crate) fn set(
        &mut self,
        index: usize,
        raw: [u8; 4],
        mav_type: u8,
        flavour: Flavour,
        flying: bool,
    ) -> Result<(), &'static str> {
        let Some(parameter) = self.all.get_mut(index) else {
            return Ok(());
        };
        let number = match (parameter.value, mav_type, flavour) {
            (ParameterValue::Real(_), REAL32, _) | (ParameterValue::Integer(_), INT32, Flavour::ArduPilot) => {
                f32::from_le_bytes(raw).into()
            }
            (ParameterValue::Integer(_), INT32, Flavour::Px4) => i32::from_le_bytes(raw).into(),
            _ => return Err("wrong type"),
        };
        let value = parameter.accepted(number).map_err(|_| "out of range")?;
        if value == parameter.value {
            return Ok(());
        }
        if flying && !parameter.in_flight {
            return Err("not in flight");
        }
        parameter.value = value;
        self.changed = true;
        Ok(())
    }

    /// PARAM_VALUE of a parameter. PX4 and its clients put integers bytewise into the value's field, ArduPilot and its clients
    /// by conversion.
    pub(crate) fn value(&self, index: usize, flavour: Flavour) -> Option<MavMessage> {
        let parameter = self.all.get(index)?;
        let (param_value, param_type) = match (parameter.value, flavour) {
            (ParameterValue::Integer(v), Flavour::ArduPilot) => (v as f32, MavParamType::MAV_PARAM_TYPE_INT32),
            (value, Flavour::Px4 | Flavour::ArduPilot) => value.on_wire(),
        };
        Some(MavMessage::PARAM_VALUE(PARAM_VALUE_DATA {
            param_value,
            // A table's length and places fit 16 bits.
            param_count: self.all.len() as u16,
            param_index: index as u16,
            param_id: parameter.name.into(),
            param_type,
        }))
    }
}
