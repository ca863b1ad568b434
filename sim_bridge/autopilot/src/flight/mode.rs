//! Flight modes and their PX4 numbers: `custom_mode = main << 16 | sub << 24`.

use vigil_mavlink::common::MavStandardMode::{self as Standard, *};
use vigil_types::named;

const MAIN_MANUAL: u8 = 1;
const MAIN_ALTITUDE: u8 = 2;
const MAIN_POSITION: u8 = 3;
const MAIN_AUTO: u8 = 4;
const MAIN_ACRO: u8 = 5;
const MAIN_OFFBOARD: u8 = 6;
const MAIN_STABILIZED: u8 = 7;

named! {
    /// The modes that the vehicle flies, with their names in status texts.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
    pub enum FlightMode {
        /// AUTO.LOITER: holds its position, or goes to one and holds there.
        #[default]
        Hold => "hold",
        /// AUTO.TAKEOFF: climbs straight up, then Hold.
        Takeoff => "takeoff",
        /// AUTO.LAND: descends straight down until on the ground.
        Land => "land",
        /// AUTO.RTL: climbs, flies home or to a rally point, lands.
        Return => "return",
        /// AUTO.MISSION: flies the mission, then Hold.
        Mission => "mission",
        /// POSCTL.ORBIT: circles a point. Entered by DO_ORBIT alone, because it needs a point.
        Orbit => "orbit",
        /// AUTO.FOLLOW_TARGET: keeps its place beside what FOLLOW_TARGET reports.
        Follow => "follow",
        /// POSCTL: sticks command velocities.
        Position => "position",
        /// ALTCTL: sticks command tilt and climb.
        Altitude => "altitude",
        /// STABILIZED: sticks command tilt and thrust.
        Stabilized => "stabilized",
        /// MANUAL: on a multicopter the same as STABILIZED.
        Manual => "manual",
        /// ACRO: sticks command body rates and thrust.
        Acro => "acro",
        /// OFFBOARD: obeys the setpoints of its owner.
        Offboard => "offboard",
    }
}

impl FlightMode {
    /// Whether a mode command can ask for it: an orbit needs a point.
    pub(crate) const fn is_commanded(self) -> bool {
        !matches!(self, Self::Orbit)
    }

    /// Whether it is flown by sticks.
    pub(crate) const fn needs_sticks(self) -> bool {
        matches!(
            self,
            Self::Position | Self::Altitude | Self::Stabilized | Self::Manual | Self::Acro
        )
    }

    /// The highest throttle stick, −1 to 1, at which it is armed; PX4's.
    pub(crate) const fn arming_throttle(self) -> f32 {
        match self {
            Self::Position | Self::Altitude => 0.2,
            _ => -0.8,
        }
    }

    /// Whether it goes on when the position is lost.
    pub(crate) const fn is_flown_without_position(self) -> bool {
        matches!(self, Self::Land) || (self.needs_sticks() && !matches!(self, Self::Position))
    }

    /// Main and sub mode, `vehicle_status.nav_state`, name and the standard mode that it is, all as PX4 has them.
    pub(crate) const fn px4(self) -> (u8, u8, u8, &'static str, Standard) {
        const NONE: Standard = MAV_STANDARD_MODE_NON_STANDARD;
        match self {
            Self::Takeoff => (MAIN_AUTO, 2, 17, "Takeoff", MAV_STANDARD_MODE_TAKEOFF),
            Self::Hold => (MAIN_AUTO, 3, 4, "Hold", NONE),
            Self::Mission => (MAIN_AUTO, 4, 3, "Mission", MAV_STANDARD_MODE_MISSION),
            Self::Return => (MAIN_AUTO, 5, 5, "Return", MAV_STANDARD_MODE_SAFE_RECOVERY),
            Self::Land => (MAIN_AUTO, 6, 18, "Land", MAV_STANDARD_MODE_LAND),
            Self::Offboard => (MAIN_OFFBOARD, 0, 14, "Offboard", NONE),
            Self::Follow => (MAIN_AUTO, 8, 19, "Follow Target", NONE),
            Self::Position => (MAIN_POSITION, 0, 2, "Position", MAV_STANDARD_MODE_POSITION_HOLD),
            Self::Altitude => (MAIN_ALTITUDE, 0, 1, "Altitude", MAV_STANDARD_MODE_ALTITUDE_HOLD),
            Self::Stabilized => (MAIN_STABILIZED, 0, 15, "Stabilized", NONE),
            Self::Manual => (MAIN_MANUAL, 0, 0, "Manual", NONE),
            Self::Acro => (MAIN_ACRO, 0, 10, "Acro", NONE),
            Self::Orbit => (MAIN_POSITION, 1, 21, "Orbit", MAV_STANDARD_MODE_ORBIT),
        }
    }

    /// The standard mode that it is, if any.
    pub(crate) const fn standard(self) -> Standard {
        self.px4().4
    }

    /// HEARTBEAT's `custom_mode`.
    pub fn custom_mode(self) -> u32 {
        let (main, sub, ..) = self.px4();
        u32::from(main) << 16 | u32::from(sub) << 24
    }

    /// What a main and sub mode ask for, if it is flown.
    pub(crate) fn from_px4(main: u8, sub: u8) -> Option<Self> {
        // Modes without sub modes ignore theirs, as PX4 does, POSCTL all but SLOW; AUTO without one is MISSION.
        let sub = match (main, sub) {
            (MAIN_AUTO, 0) => return Some(Self::Mission),
            (MAIN_AUTO, _) | (MAIN_POSITION, 2) => sub,
            _ => 0,
        };
        let is_wanted = |mode: &Self| mode.is_commanded() && (mode.px4().0, mode.px4().1) == (main, sub);
        Self::ALL.into_iter().find(is_wanted)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modes_have_the_numbers_of_px4() {
        assert_eq!(FlightMode::Offboard.custom_mode(), 0x0006_0000);
        assert_eq!(FlightMode::Hold.custom_mode(), 0x0304_0000);
        for mode in FlightMode::ALL.into_iter().filter(|mode| mode.is_commanded()) {
            let (main, sub, ..) = mode.px4();
            assert_eq!(FlightMode::from_px4(main, sub), Some(mode));
        }
        assert_eq!(FlightMode::from_px4(2, 0), Some(FlightMode::Altitude));
        // An orbit needs a point.
        assert_eq!(FlightMode::from_px4(3, 1), Some(FlightMode::Position));
        assert_eq!(FlightMode::from_px4(4, 0), Some(FlightMode::Mission));
        for (main, sub) in [(3, 2), (4, 1), (4, 9)] {
            assert_eq!(FlightMode::from_px4(main, sub), None);
        }
        assert_eq!(FlightMode::from_px4(0, 0), None);
    }
}
