//! Commands and acknowledgements read from raw payloads: the crate's parser refuses a command number that it does not
//! know, but such a command must be answered UNSUPPORTED. <https://mavlink.io/en/services/command.html>

use crate::framing::{SerializeError, Zeroed, filled, serialize_payload};
use mavlink::dialects::common::{COMMAND_ACK_DATA, COMMAND_INT_DATA, COMMAND_LONG_DATA};
use mavlink::{MavHeader, MessageData};

/// How a command came.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CommandForm {
    /// COMMAND_LONG: all parameters are floats.
    Long {
        /// Counts repetitions of the same command from 0.
        confirmation: u8,
    },
    /// COMMAND_INT: parameters 5 and 6 are integers in a named frame.
    Int {
        /// MAV_FRAME.
        frame: u8,
        /// Latitude in 1e-7 degrees, or local x in 1e-4 metres.
        x: i32,
        /// Longitude in 1e-7 degrees, or local y in 1e-4 metres.
        y: i32,
    },
}

/// A COMMAND_LONG or COMMAND_INT.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Command {
    /// MAV_CMD as a number, known or not.
    pub number: u16,
    /// System addressed; 0 is all.
    pub target_system: u8,
    /// Component addressed; 0 is all.
    pub target_component: u8,
    /// Parameters 1 to 7. In a COMMAND_INT parameters 5 and 6 are NaN here: read them from [`Command::form`].
    pub params: [f32; 7],
    /// What differs between the two forms.
    pub form: CommandForm,
}

impl Command {
    pub(super) fn from_payload(message_id: u32, payload: &[u8]) -> Option<Self> {
        let p = Zeroed(payload);
        // Wire order of both: largest fields first, then in the order of definition.
        let (x, y, form) = match message_id {
            COMMAND_LONG_DATA::ID => (p.f32(16), p.f32(20), CommandForm::Long { confirmation: p.u8(32) }),
            COMMAND_INT_DATA::ID => (
                f32::NAN,
                f32::NAN,
                CommandForm::Int {
                    frame: p.u8(32),
                    x: p.i32(16),
                    y: p.i32(20),
                },
            ),
            _ => return None,
        };
        Some(Self {
            number: p.u16(28),
            target_system: p.u8(30),
            target_component: p.u8(31),
            params: [p.f32(0), p.f32(4), p.f32(8), p.f32(12), x, y, p.f32(24)],
            form,
        })
    }

    /// A COMMAND_LONG to component 1 (the autopilot) of `system`.
    pub const fn to_autopilot(system: u8, number: u16, params: [f32; 7], confirmation: u8) -> Self {
        Self {
            number,
            target_system: system,
            target_component: 1,
            params,
            form: CommandForm::Long { confirmation },
        }
    }

    /// Writes the command as a MAVLink 2 packet and returns its length.
    ///
    /// # Errors
    /// [`SerializeError`].
    pub fn serialize(&self, header: MavHeader, out: &mut [u8]) -> Result<usize, SerializeError> {
        let [p1, p2, p3, p4, p5, p6, p7] = self.params.map(f32::to_le_bytes);
        let (message_id, x, y, last) = match self.form {
            CommandForm::Long { confirmation } => (COMMAND_LONG_DATA::ID, p5, p6, confirmation),
            CommandForm::Int { frame, x, y } => (COMMAND_INT_DATA::ID, x.to_le_bytes(), y.to_le_bytes(), frame),
        };
        let numbers = [p1, p2, p3, p4, x, y, p7].into_iter().flatten();
        let addressed = [self.target_system, self.target_component, last];
        // What a COMMAND_INT has behind them is zero, and cut.
        let payload: [u8; 33] = filled(numbers.chain(self.number.to_le_bytes()).chain(addressed));
        serialize_payload(header, message_id, &payload, out)
    }

    /// Parameter `number` (1 to 7), or `None` where there is no such parameter, it is NaN, or it is the integer of a
    /// COMMAND_INT.
    pub fn param(&self, number: usize) -> Option<f32> {
        self.params.get(number.checked_sub(1)?).copied().filter(|p| !p.is_nan())
    }

    /// MAV_FRAME of the position; COMMAND_LONG has none and means global (0).
    pub fn frame(&self) -> u8 {
        match self.form {
            CommandForm::Long { .. } => 0,
            CommandForm::Int { frame, .. } => frame,
        }
    }

    /// Latitude and longitude in degrees, when parameters 5 and 6 are meant as such. `None` if they are NaN.
    pub fn latitude_longitude_deg(&self) -> Option<(f64, f64)> {
        match self.form {
            CommandForm::Long { .. } => Some((f64::from(self.param(5)?), f64::from(self.param(6)?))),
            CommandForm::Int { x, y, .. } => Some((f64::from(x) * 1e-7, f64::from(y) * 1e-7)),
        }
    }

    /// Local x and y in metres, when parameters 5 and 6 are meant as such. `None` if they are NaN.
    pub fn local_x_y_m(&self) -> Option<(f32, f32)> {
        match self.form {
            CommandForm::Long { .. } => Some((self.param(5)?, self.param(6)?)),
            CommandForm::Int { x, y, .. } => Some(((f64::from(x) * 1e-4) as f32, (f64::from(y) * 1e-4) as f32)),
        }
    }
}

/// A COMMAND_ACK.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CommandAck {
    /// MAV_CMD as a number, known or not.
    pub command: u16,
    /// MAV_RESULT as a number.
    pub result: u8,
    /// Per cent, or 255 when unknown.
    pub progress: u8,
    /// Result detail, command-specific.
    pub result_param2: i32,
    /// System that sent the command.
    pub target_system: u8,
    /// Component that sent the command.
    pub target_component: u8,
}

impl CommandAck {
    pub(super) fn from_payload(message_id: u32, payload: &[u8]) -> Option<Self> {
        let p = Zeroed(payload);
        (message_id == COMMAND_ACK_DATA::ID).then(|| Self {
            command: p.u16(0),
            result: p.u8(2),
            progress: p.u8(3),
            result_param2: p.i32(4),
            target_system: p.u8(8),
            target_component: p.u8(9),
        })
    }

    pub(crate) fn payload(&self) -> [u8; 10] {
        let [c0, c1] = self.command.to_le_bytes();
        let [p0, p1, p2, p3] = self.result_param2.to_le_bytes();
        let (system, component) = (self.target_system, self.target_component);
        [c0, c1, self.result, self.progress, p0, p1, p2, p3, system, component]
    }

    /// Writes the acknowledgement as a MAVLink 2 packet and returns its length.
    ///
    /// # Errors
    /// [`SerializeError`].
    pub fn serialize(&self, header: MavHeader, out: &mut [u8]) -> Result<usize, SerializeError> {
        serialize_payload(header, COMMAND_ACK_DATA::ID, &self.payload(), out)
    }
}
