//! Flight modes and their PX4 numbers: `custom_mode = main << 16 | sub << 24`.

const MAIN_POSITION: u8 = 3;
const MAIN_AUTO: u8 = 4;
const MAIN_OFFBOARD: u8 = 6;

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
    /// POSCTL: flown by sticks, that is MANUAL_CONTROL.
    Position,
    /// OFFBOARD: obeys the setpoints of its owner.
    Offboard,
}

/// What a DO_SET_MODE or SET_MODE asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Requested {
    Flown(FlightMode),
    /// A mode that needs a pilot's sticks, by its PX4 name.
    Manual(&'static str),
    Unknown,
}

impl FlightMode {
    /// What a mode command can ask for.
    const COMMANDED: [Self; 7] = [
        Self::Hold,
        Self::Takeoff,
        Self::Land,
        Self::Return,
        Self::Mission,
        Self::Position,
        Self::Offboard,
    ];

    /// Every mode.
    pub(crate) const ALL: [Self; 8] = [
        Self::Hold,
        Self::Takeoff,
        Self::Land,
        Self::Return,
        Self::Mission,
        Self::Orbit,
        Self::Position,
        Self::Offboard,
    ];

    const fn px4(self) -> (u8, u8) {
        match self {
            Self::Takeoff => (MAIN_AUTO, 2),
            Self::Hold => (MAIN_AUTO, 3),
            Self::Mission => (MAIN_AUTO, 4),
            Self::Return => (MAIN_AUTO, 5),
            Self::Land => (MAIN_AUTO, 6),
            Self::Offboard => (MAIN_OFFBOARD, 0),
            Self::Position => (MAIN_POSITION, 0),
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
            Self::Position => "position",
            Self::Offboard => "offboard",
        }
    }
}

impl Requested {
    /// Reads a main and sub mode.
    pub fn from_px4(main: u8, sub: u8) -> Self {
        match (main, sub) {
            (1, _) => Self::Manual("manual"),
            (2, _) => Self::Manual("altitude"),
            (MAIN_POSITION, 0) => Self::Flown(FlightMode::Position),
            (MAIN_POSITION, _) => Self::Manual("position"),
            (5, _) => Self::Manual("acro"),
            (7, _) => Self::Manual("stabilized"),
            (MAIN_OFFBOARD, _) => Self::Flown(FlightMode::Offboard),
            // AUTO without a sub mode, and READY, wait where they are.
            (MAIN_AUTO, 0 | 1) => Self::Flown(FlightMode::Hold),
            (MAIN_AUTO, _) => FlightMode::COMMANDED
                .into_iter()
                .find(|mode| mode.px4() == (main, sub))
                .map_or(Self::Unknown, Self::Flown),
            _ => Self::Unknown,
        }
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
        for mode in FlightMode::COMMANDED {
            assert_eq!(Requested::from_custom_mode(mode.custom_mode()), Requested::Flown(mode));
        }
        assert_eq!(Requested::from_px4(2, 0), Requested::Manual("altitude"));
        assert_eq!(Requested::from_px4(4, 9), Requested::Unknown);
        assert_eq!(Requested::from_px4(0, 0), Requested::Unknown);
    }
}
