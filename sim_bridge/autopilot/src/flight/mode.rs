//! Flight modes and their PX4 numbers: `custom_mode = main << 16 | sub << 24`.

const MAIN_MANUAL: u8 = 1;
const MAIN_ALTITUDE: u8 = 2;
const MAIN_POSITION: u8 = 3;
const MAIN_AUTO: u8 = 4;
const MAIN_ACRO: u8 = 5;
const MAIN_OFFBOARD: u8 = 6;
const MAIN_STABILIZED: u8 = 7;

/// The modes that the vehicle flies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FlightMode {
    /// AUTO.LOITER: holds its position, or goes to one and holds there.
    #[default]
    Hold,
    /// AUTO.TAKEOFF: climbs straight up, then Hold.
    Takeoff,
    /// AUTO.LAND: descends straight down until on the ground.
    Land,
    /// AUTO.RTL: climbs, flies home or to a rally point, lands.
    Return,
    /// AUTO.MISSION: flies the mission, then Hold.
    Mission,
    /// POSCTL.ORBIT: circles a point. Entered by DO_ORBIT alone, because it needs a point.
    Orbit,
    /// AUTO.FOLLOW_TARGET: keeps its place beside what FOLLOW_TARGET reports.
    Follow,
    /// POSCTL: sticks command velocities.
    Position,
    /// ALTCTL: sticks command tilt and climb.
    Altitude,
    /// STABILIZED: sticks command tilt and thrust.
    Stabilized,
    /// MANUAL: on a multicopter the same as STABILIZED.
    Manual,
    /// ACRO: sticks command body rates and thrust.
    Acro,
    /// OFFBOARD: obeys the setpoints of its owner.
    Offboard,
}

/// What a DO_SET_MODE or SET_MODE asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Requested {
    Flown(FlightMode),
    Unknown,
}

impl FlightMode {
    /// Every mode.
    pub(crate) const ALL: [Self; 13] = [
        Self::Hold,
        Self::Takeoff,
        Self::Land,
        Self::Return,
        Self::Mission,
        Self::Orbit,
        Self::Follow,
        Self::Position,
        Self::Altitude,
        Self::Stabilized,
        Self::Manual,
        Self::Acro,
        Self::Offboard,
    ];

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

    /// Whether it goes on when the position is lost.
    pub(crate) const fn is_flown_without_position(self) -> bool {
        matches!(
            self,
            Self::Land | Self::Altitude | Self::Stabilized | Self::Manual | Self::Acro
        )
    }

    const fn px4(self) -> (u8, u8) {
        match self {
            Self::Takeoff => (MAIN_AUTO, 2),
            Self::Hold => (MAIN_AUTO, 3),
            Self::Mission => (MAIN_AUTO, 4),
            Self::Return => (MAIN_AUTO, 5),
            Self::Land => (MAIN_AUTO, 6),
            Self::Offboard => (MAIN_OFFBOARD, 0),
            Self::Follow => (MAIN_AUTO, 8),
            Self::Position => (MAIN_POSITION, 0),
            Self::Altitude => (MAIN_ALTITUDE, 0),
            Self::Stabilized => (MAIN_STABILIZED, 0),
            Self::Manual => (MAIN_MANUAL, 0),
            Self::Acro => (MAIN_ACRO, 0),
            Self::Orbit => (MAIN_POSITION, 1),
        }
    }

    /// HEARTBEAT's `custom_mode`.
    pub fn custom_mode(self) -> u32 {
        let (main, sub) = self.px4();
        u32::from(main) << 16 | u32::from(sub) << 24
    }

    /// Name in status texts.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Hold => "hold",
            Self::Takeoff => "takeoff",
            Self::Land => "land",
            Self::Return => "return",
            Self::Mission => "mission",
            Self::Orbit => "orbit",
            Self::Follow => "follow",
            Self::Position => "position",
            Self::Altitude => "altitude",
            Self::Stabilized => "stabilized",
            Self::Manual => "manual",
            Self::Acro => "acro",
            Self::Offboard => "offboard",
        }
    }
}

impl Requested {
    /// Reads a main and sub mode.
    pub fn from_px4(main: u8, sub: u8) -> Self {
        // Modes without sub modes ignore theirs, as PX4 does; AUTO without one, and READY, wait where they are.
        let sub = match (main, sub) {
            (MAIN_AUTO, 0 | 1) => return Self::Flown(FlightMode::Hold),
            (MAIN_AUTO | MAIN_POSITION, sub) => sub,
            _ => 0,
        };
        FlightMode::ALL
            .into_iter()
            .find(|mode| mode.is_commanded() && mode.px4() == (main, sub))
            .map_or(Self::Unknown, Self::Flown)
    }

    /// Reads a HEARTBEAT-style custom mode.
    pub fn from_custom_mode(custom_mode: u32) -> Self {
        let [_, _, main, sub] = custom_mode.to_le_bytes();
        Self::from_px4(main, sub)
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
            assert_eq!(Requested::from_custom_mode(mode.custom_mode()), Requested::Flown(mode));
        }
        assert_eq!(Requested::from_px4(2, 0), Requested::Flown(FlightMode::Altitude));
        assert_eq!(Requested::from_px4(3, 1), Requested::Unknown, "an orbit needs a point");
        assert_eq!(Requested::from_px4(4, 9), Requested::Unknown);
        assert_eq!(Requested::from_px4(0, 0), Requested::Unknown);
    }
}
