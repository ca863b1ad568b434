//! What a ground station says to the guidance computer.

use vigil_mavlink::common::{MavAutopilot, MavCmd, MavFrame, MavMessage};
pub use vigil_mavlink::framing::encode as packet;
use vigil_mavlink::message;

/// A request of an operator to component 191.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Request {
    /// Fly to this place, metres north and east of home; the height stays.
    Goal([f32; 2]),
    /// Land here.
    Land,
    /// Take the vehicle and fly.
    Engage,
    /// Give it back: it holds by itself.
    LetGo,
}

/// System and component that ground stations have.
pub const STATION: (u8, u8) = (255, 190);

/// A command of a ground station to the autopilot of system 1, with the first and the later parameters.
pub fn command(command: MavCmd, [param1, param2, param3, param7]: [f32; 4]) -> MavMessage {
    message!(
        COMMAND_LONG,
        param1,
        param2,
        param3,
        param7,
        command,
        target_system = 1,
        target_component = 1
    )
}

/// DO_SET_MODE to PX4's AUTO with this sub-mode: 3 is a ground station's hold, 4 the mission.
pub fn set_auto_mode(sub_mode: f32) -> MavMessage {
    command(MavCmd::MAV_CMD_DO_SET_MODE, [129.0, 4.0, sub_mode, 0.0])
}

/// A heartbeat of such an autopilot, or of somebody who has none.
pub fn heartbeat(autopilot: MavAutopilot) -> MavMessage {
    message!(HEARTBEAT, autopilot, mavlink_version = 3)
}

impl Request {
    /// The message to the guidance computer of a system.
    pub fn message(self, system: u8) -> MavMessage {
        const GUIDANCE: u8 = 191;
        let (target_system, target_component) = (system, GUIDANCE);
        let long =
            |command, param1, param2| message!(COMMAND_LONG, param1, param2, command, target_system, target_component);
        match self {
            Self::Goal([north_m, east_m]) => message!(
                COMMAND_INT,
                param1 = -1.0,
                param4 = f32::NAN,
                x = (north_m * 1e4) as i32,
                y = (east_m * 1e4) as i32,
                z = f32::NAN,
                command = MavCmd::MAV_CMD_DO_REPOSITION,
                target_system,
                target_component,
                frame = MavFrame::MAV_FRAME_LOCAL_NED
            ),
            Self::Land => long(MavCmd::MAV_CMD_NAV_LAND, 0.0, 0.0),
            Self::Engage => long(MavCmd::MAV_CMD_NAV_GUIDED_ENABLE, 1.0, 0.0),
            Self::LetGo => long(MavCmd::MAV_CMD_NAV_GUIDED_ENABLE, 0.0, 1.0),
        }
    }
}
