//! What differs between autopilots: mode numbers and the form of the hand-over's commands.

use vigil_types::{VehicleMode, named};

/// MAV_CMD numbers that the guidance computer sends.
pub(crate) mod command_number {
    pub const NAV_LAND: u16 = 21;
    pub const NAV_TAKEOFF: u16 = 22;
    pub const DO_SET_MODE: u16 = 176;
    pub const DO_REPOSITION: u16 = 192;
    pub const COMPONENT_ARM_DISARM: u16 = 400;
    pub const SET_MESSAGE_INTERVAL: u16 = 511;
    pub const REQUEST_MESSAGE: u16 = 512;

    /// Name for a person.
    pub fn name(number: u16) -> &'static str {
        match number {
            NAV_LAND => "landing",
            NAV_TAKEOFF => "take-off",
            DO_SET_MODE => "change of mode",
            DO_REPOSITION => "stop",
            COMPONENT_ARM_DISARM => "arming",
            _ => "command",
        }
    }
}

/// MAV_MODE_FLAG_CUSTOM_MODE_ENABLED: `custom_mode` means something.
const CUSTOM_MODE_ENABLED: u8 = 1;

named! {
    /// Which autopilot flies the vehicle.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
    pub enum Flavour {
        /// PX4, or a vehicle that speaks like it.
        #[default]
        Px4 => "PX4",
        /// ArduPilot's Copter.
        ArduPilot => "ArduPilot",
    }
}

impl Flavour {
    /// The flavour that a heartbeat's MAV_AUTOPILOT names; `None` for generic and others.
    pub const fn of_autopilot(mav_autopilot: u8) -> Option<Self> {
        match mav_autopilot {
            3 => Some(Self::ArduPilot),
            12 => Some(Self::Px4),
            _ => None,
        }
    }

    /// The mode of a heartbeat.
    pub const fn mode(self, base_mode: u8, custom_mode: u32) -> VehicleMode {
        if base_mode & CUSTOM_MODE_ENABLED == 0 {
            return VehicleMode::Other;
        }
        match self {
            Self::Px4 => px4_mode(custom_mode),
            Self::ArduPilot => copter_mode(custom_mode),
        }
    }

    /// DO_SET_MODE's parameters 1 to 3 for the mode that obeys setpoints, that which flies the mission, or else that in which the vehicle
    /// brakes and holds its position by itself.
    pub const fn mode_params(self, mode: VehicleMode) -> [f32; 3] {
        match (self, mode) {
            // MAV_MODE_FLAG armed | custom, and PX4's OFFBOARD, or its AUTO's MISSION or LOITER.
            (Self::Px4, VehicleMode::External) => [129.0, 6.0, 0.0],
            (Self::Px4, VehicleMode::Mission) => [129.0, 4.0, 4.0],
            (Self::Px4, _) => [129.0, 4.0, 3.0],
            // Copter's GUIDED, AUTO or BRAKE.
            (Self::ArduPilot, VehicleMode::External) => [1.0, 4.0, 0.0],
            (Self::ArduPilot, VehicleMode::Mission) => [1.0, 3.0, 0.0],
            (Self::ArduPilot, _) => [1.0, 17.0, 0.0],
        }
    }

    /// Command parameters of which those of these numbers, from 1, are used.
    pub fn params(self, used: &[(usize, f32)]) -> [f32; 7] {
        let mut params = match self {
            Self::Px4 => [f32::NAN; 7],
            Self::ArduPilot => [0.0; 7],
        };
        for (number, value) in used {
            if let Some(param) = number.checked_sub(1).and_then(|i| params.get_mut(i)) {
                *param = *value;
            }
        }
        params
    }
}

/// PX4: `main << 16 | sub << 24` (px4_custom_mode.h).
const fn px4_mode(custom_mode: u32) -> VehicleMode {
    const OFFBOARD: u8 = 6;
    const AUTO: u8 = 4;
    let [_, _, main, sub] = custom_mode.to_le_bytes();
    match (main, sub) {
        (OFFBOARD, _) => VehicleMode::External,
        (AUTO, 2) => VehicleMode::Takeoff,
        (AUTO, 3) => VehicleMode::Hold,
        (AUTO, 4) => VehicleMode::Mission,
        (AUTO, 5) => VehicleMode::Return,
        (AUTO, 6) => VehicleMode::Land,
        _ => VehicleMode::Other,
    }
}

/// Copter mode numbers: <https://ardupilot.org/copter/docs/parameters.html#fltmode1>.
const fn copter_mode(custom_mode: u32) -> VehicleMode {
    match custom_mode {
        3 => VehicleMode::Mission,
        4 => VehicleMode::External,
        // BRAKE. LOITER and POSHOLD hold their position too, but by a person's sticks.
        17 => VehicleMode::Hold,
        // RTL, SMART_RTL, AUTO_RTL.
        6 | 21 | 27 => VehicleMode::Return,
        9 => VehicleMode::Land,
        _ => VehicleMode::Other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modes_are_distinguished() {
        use VehicleMode::*;
        let px4 = |main: u32, sub: u32| main << 16 | sub << 24;
        for (flavour, custom_mode, mode) in [
            (Flavour::Px4, px4(6, 0), External),
            (Flavour::Px4, px4(4, 3), Hold),
            (Flavour::Px4, px4(4, 2), Takeoff),
            (Flavour::Px4, px4(4, 4), Mission),
            (Flavour::Px4, px4(4, 5), Return),
            (Flavour::Px4, px4(4, 6), Land),
            (Flavour::Px4, px4(3, 0), Other),
            (Flavour::ArduPilot, 4, External),
            (Flavour::ArduPilot, 3, Mission),
            (Flavour::ArduPilot, 17, Hold),
            (Flavour::ArduPilot, 6, Return),
            (Flavour::ArduPilot, 9, Land),
            (Flavour::ArduPilot, 0, Other),
            // LOITER, POSHOLD and ALT_HOLD are flown by sticks.
            (Flavour::ArduPilot, 5, Other),
            (Flavour::ArduPilot, 16, Other),
            (Flavour::ArduPilot, 2, Other),
            (Flavour::ArduPilot, px4(4, 0), Other),
        ] {
            assert_eq!(flavour.mode(0x81, custom_mode), mode, "{flavour:?} {custom_mode:#x}");
        }
        let without_the_flag = Flavour::Px4.mode(0x80, px4(6, 0));
        assert_eq!(without_the_flag, Other, "the number means nothing");
    }
}
