//! Names of guidance states and of the reasons that move guidance between them; telemetry and log share them.

use crate::named;

named! {
    /// Where guidance is. The numbers are telemetry (`NAMED_VALUE_FLOAT` "gd_state") and never change meaning.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default, PartialOrd, Ord)]
    #[repr(u8)]
    pub enum GuidanceState {
        /// Something needed is missing; nothing is sent to the vehicle.
        #[default]
        Standby = 0 => "standby",
        /// All inputs are good; waiting to be engaged; nothing is sent to the vehicle.
        Ready = 1 => "ready",
        /// Handing over: streams zero setpoints while the vehicle arms, takes off and changes to its external mode.
        Engaging = 2 => "engaging",
        /// The pilot's action is sent.
        Guided = 3 => "guided",
        /// Zero setpoints are sent while a named condition lasts, or at the goal.
        Hold = 4 => "hold",
        /// The vehicle was ordered to land.
        Land = 5 => "land",
    }
}

impl GuidanceState {
    /// The state of a telemetry number.
    pub fn from_code(code: u8) -> Option<Self> {
        Self::ALL.get(usize::from(code)).copied()
    }
}

named! {
    /// A named condition that guidance acts on. The value is the bit in [`Reasons`].
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
    #[repr(u8)]
    pub enum Reason {
        /// No valid depth frame within the age limit.
        StaleFrame = 0 => "stale frame",
        /// A frame arrived and was refused (size, sensor, checksum, range, pose, stamp).
        BadFrame = 1 => "bad frame",
        /// Position or attitude older than the age limit, or never received.
        StaleTelemetry = 2 => "stale telemetry",
        /// The vehicle's heartbeat is missing.
        LinkLost = 3 => "link lost",
        /// A value that decides motion is NaN or infinite.
        NotFinite = 4 => "not finite",
        /// The vehicle left its external mode by itself or by another's command.
        ModeLost = 5 => "vehicle mode lost",
        /// The vehicle is disarmed.
        Disarmed = 6 => "disarmed",
        /// The loop missed steps.
        Slip = 7 => "slip",
        /// Outside the permitted region.
        Geofence = 8 => "geofence",
        /// Within the goal's radius.
        GoalReached = 9 => "goal reached",
        /// No goal is set.
        NoGoal = 10 => "no goal",
        /// An operator disengaged guidance.
        Operator = 11 => "operator",
        /// The hand-over did not finish in time or was refused.
        HandoverFailed = 12 => "hand-over failed",
        /// Battery below its limit.
        LowBattery = 13 => "low battery",
        /// The vehicle itself reports a failsafe.
        VehicleFailsafe = 14 => "vehicle failsafe",
        /// The flight took longer than its limit.
        TimeLimit = 15 => "time limit",
        /// The detector took the actor's explanations for those of an attack; the vehicle is being stopped.
        Attack = 16 => "attack",
        /// The detector had no verdict on the flying actor for too long; the vehicle is being stopped.
        NoVerdict = 17 => "no verdict",
        /// The recovery pilot flies in the actor's place.
        Recovering = 18 => "recovering",
        /// The actor was about to fly into something; the vehicle is being stopped.
        CollisionCourse = 19 => "collision course",
        /// The depth frames show nothing where something must be seen.
        BlindSensor = 20 => "blind sensor",
        /// The picture, or a part of it, stays as it is although the vehicle moves.
        FrozenSensor = 21 => "frozen sensor",
        /// The pose in the frames' header is not the vehicle's.
        ImplausiblePose = 22 => "implausible pose",
        /// The picture does not move as the vehicle does: mirrored, turned, or of another place.
        InconsistentPicture = 23 => "inconsistent picture",
        /// The vehicle did not get nearer to the goal for too long.
        NoProgress = 24 => "no progress",
        /// Position or attitude arrive so rarely that little is left to the age limit. A warning: nothing is held for it.
        SlowTelemetry = 26 => "slow telemetry",
        /// A person has the vehicle: guidance does not take it by itself.
        PilotInCommand = 27 => "pilot in command",
        /// A frame arrived that was not made with the sensor's key.
        UnauthenticatedFrame = 28 => "unauthenticated frame",
        /// The actor did not bring the vehicle on along the guard's way; the vehicle is being stopped.
        LedAstray = 29 => "led astray",
        /// The actor and the guard's planner went on turning apart; the vehicle is being stopped.
        Disagreement = 30 => "disagreement",
        /// The depth frames are rough, as no surface is; the vehicle is being stopped.
        RoughPicture = 31 => "rough picture",
        /// The second sensor is configured and nothing usable came from it for too long.
        SecondSensorSilent = 32 => "second sensor silent",
        /// The second sensor saw something nearer than the depth frames show there.
        SensorsDisagree = 33 => "sensors disagree",
        /// The depth frames show surfaces beneath the ground that they show nearer by: something stands there, and nearer than it is shown.
        BeneathGround = 34 => "beneath the ground",
    }
}

/// A set of [`Reason`]s.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Reasons(pub u64);

impl Reasons {
    /// The empty set.
    pub const NONE: Self = Self(0);

    /// A set of one.
    pub const fn of(reason: Reason) -> Self {
        Self(1 << reason as u8)
    }

    /// Adds `reason` when `present`.
    #[must_use]
    pub const fn with_if(self, present: bool, reason: Reason) -> Self {
        if present {
            Self(self.0 | 1 << reason as u8)
        } else {
            self
        }
    }

    /// The set whose bits are these two words, the lower first.
    pub const fn from_words([low, high]: [u32; 2]) -> Self {
        Self((high as u64) << 32 | low as u64)
    }

    /// Its bits as two words, the lower first.
    pub const fn words(self) -> [u32; 2] {
        [self.0 as u32, (self.0 >> 32) as u32]
    }

    /// Whether `reason` is in the set.
    pub const fn contains(self, reason: Reason) -> bool {
        self.0 & (1 << reason as u8) != 0
    }

    /// Whether any reason of `other` is in this set.
    pub const fn intersects(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }

    /// Both sets together.
    #[must_use]
    pub const fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Whether the set is empty.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The reasons in the set, in the order of their bits.
    pub fn iter(self) -> impl Iterator<Item = Reason> {
        Reason::ALL.into_iter().filter(move |r| self.contains(*r))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{AlarmCause, AlarmResponse, Verdict};

    #[test]
    fn codes_and_bits_match_their_positions() {
        for (i, s) in GuidanceState::ALL.into_iter().enumerate() {
            assert_eq!(GuidanceState::from_code(i as u8), Some(s));
            assert_eq!(s as usize, i);
        }
        assert_eq!(GuidanceState::from_code(6), None);
        assert!(Verdict::ALL.iter().enumerate().all(|(i, v)| *v as usize == i));
        assert!(AlarmCause::ALL.iter().enumerate().all(|(i, c)| *c as usize == i));
        assert!(AlarmResponse::ALL.iter().enumerate().all(|(i, r)| *r as usize == i));
        assert!(
            Reason::ALL.is_sorted_by(|a, b| (*a as u8) < (*b as u8)),
            "a bit of its own"
        );
    }

    #[test]
    fn a_set_holds_what_was_put_in() {
        let set = Reasons::of(Reason::Slip)
            .with_if(true, Reason::NoGoal)
            .with_if(false, Reason::Geofence);
        assert!(set.iter().eq([Reason::Slip, Reason::NoGoal]));
        assert!(set.intersects(Reasons::of(Reason::Slip)) && !set.intersects(Reasons::of(Reason::Geofence)));
    }

    #[test]
    fn a_set_s_two_words_are_its_bits_low_then_high() {
        let set = Reasons(0x0123_4567_89AB_CDEF);
        assert_eq!(set.words(), [0x89AB_CDEF, 0x0123_4567]);
        assert_eq!(Reasons::from_words(set.words()), set);
    }
}
