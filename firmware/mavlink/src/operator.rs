//! Commands of an operator to the guidance computer.

use crate::autopilot::command_number::{DO_REPOSITION, NAV_LAND};
use crate::framing::{Command, CommandForm};
use crate::vehicle::Vehicle;
use vigil_types::{OperatorRequest, RequestOutcome};

const NAV_GUIDED_ENABLE: u16 = 92;

/// MAV_RESULT numbers.
pub(crate) mod result {
    pub const ACCEPTED: u8 = 0;
    pub const TEMPORARILY_REJECTED: u8 = 1;
    pub const DENIED: u8 = 2;
    pub const UNSUPPORTED: u8 = 3;
    pub const IN_PROGRESS: u8 = 5;
    pub const COMMAND_INT_ONLY: u8 = 8;
    pub const UNSUPPORTED_MAV_FRAME: u8 = 9;

    const NAMES: [&str; 11] = [
        "ACCEPTED",
        "TEMPORARILY_REJECTED",
        "DENIED",
        "UNSUPPORTED",
        "FAILED",
        "IN_PROGRESS",
        "CANCELLED",
        "COMMAND_LONG_ONLY",
        "COMMAND_INT_ONLY",
        "UNSUPPORTED_MAV_FRAME",
        "NOT_IN_CONTROL",
    ];

    /// The protocol's name.
    pub fn name(result: u8) -> &'static str {
        NAMES.get(usize::from(result)).unwrap_or(&"a result that is not known")
    }
}

/// A request that waits for guidance's answer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PendingRequest {
    pub(crate) request: OperatorRequest,
    /// It has [`LET_GO`].
    pub(crate) lets_go: bool,
    pub(crate) command: u16,
    pub(crate) reply: ReplyTo,
}

impl PendingRequest {
    /// What is asked.
    pub fn request(&self) -> OperatorRequest {
        self.request
    }

    pub(crate) fn name(&self) -> Option<&'static str> {
        match self.request {
            OperatorRequest::Disengage => Some("disengage"),
            _ => request_name(self.command),
        }
    }
}

/// Who asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct ReplyTo {
    pub link: u8,
    pub system: u8,
    pub component: u8,
}

/// MAV_RESULT of an outcome.
pub(crate) fn result_of(outcome: RequestOutcome) -> u8 {
    match outcome {
        RequestOutcome::Accepted => result::ACCEPTED,
        RequestOutcome::TemporarilyRejected => result::TEMPORARILY_REJECTED,
        RequestOutcome::Denied | RequestOutcome::TooFar { .. } => result::DENIED,
    }
}

/// Parameter 2 of a NAV_GUIDED_ENABLE that disengages: the vehicle is to hold by itself, so that it does when the setpoints end.
pub const LET_GO: f32 = 1.0;

/// What a command asks, or the MAV_RESULT of one that asks nothing.
pub(crate) fn decode(command: &Command, vehicle: &Vehicle) -> Result<OperatorRequest, u8> {
    match command.number {
        NAV_GUIDED_ENABLE => match command.param(1) {
            Some(on) if on > 0.5 => Ok(OperatorRequest::Engage),
            Some(_) => Ok(OperatorRequest::Disengage),
            None => Err(result::DENIED),
        },
        NAV_LAND => Ok(OperatorRequest::Land),
        DO_REPOSITION => reposition(command, vehicle),
        _ => Err(result::UNSUPPORTED),
    }
}

/// What a command is called where it is refused; `None` for one that guidance does not know.
pub(crate) fn request_name(command: u16) -> Option<&'static str> {
    match command {
        NAV_GUIDED_ENABLE => Some("engage"),
        NAV_LAND => Some("landing"),
        DO_REPOSITION => Some("goal"),
        _ => None,
    }
}

/// Why a command that asks nothing was refused, for a person.
pub(crate) fn why(mav_result: u8) -> &'static str {
    match mav_result {
        result::TEMPORARILY_REJECTED => "the vehicle has not reported where its origin is",
        result::COMMAND_INT_ONLY => "send it as COMMAND_INT, a float does not hold a latitude",
        result::UNSUPPORTED_MAV_FRAME => "frames LOCAL_NED, GLOBAL and GLOBAL_RELATIVE_ALT are known",
        _ => "its parameters name nothing",
    }
}

/// The goal of a DO_REPOSITION. COMMAND_LONG is refused: a float holds a latitude to half a metre.
fn reposition(command: &Command, vehicle: &Vehicle) -> Result<OperatorRequest, u8> {
    const LOCAL_NED: u8 = 1;
    const GLOBAL: [u8; 2] = [0, 5];
    const GLOBAL_RELATIVE_ALT: [u8; 2] = [3, 6];
    let CommandForm::Int { frame, x, y } = command.form else {
        return Err(result::COMMAND_INT_ONLY);
    };
    // The largest integer stands for "no value".
    if x == i32::MAX || y == i32::MAX {
        return Err(result::DENIED);
    }
    let altitude_m = command.param(7);
    if frame == LOCAL_NED {
        let (north_m, east_m) = command.local_x_y_m().ok_or(result::DENIED)?;
        return Ok(OperatorRequest::Goal {
            north_m,
            east_m,
            height_m: altitude_m.map(|down_m| -down_m),
        });
    }
    let relative = GLOBAL_RELATIVE_ALT.contains(&frame);
    if !relative && !GLOBAL.contains(&frame) {
        return Err(result::UNSUPPORTED_MAV_FRAME);
    }
    let origin = vehicle.origin.ok_or(result::TEMPORARILY_REJECTED)?;
    let (latitude_deg, longitude_deg) = command.latitude_longitude_deg().ok_or(result::DENIED)?;
    if latitude_deg.abs() > 90.0 || longitude_deg.abs() > 180.0 {
        return Err(result::DENIED);
    }
    let (north_m, east_m) = origin.north_east_m(latitude_deg, longitude_deg);
    Ok(OperatorRequest::FixedGoal {
        north_m,
        east_m,
        height_m: altitude_m.map(|up_m| {
            if relative {
                up_m + vehicle.home_height_m()
            } else {
                (f64::from(up_m) - origin.altitude_m) as f32
            }
        }),
    })
}
