//! The transition table: data, not code.

use vigil_types::GuidanceState::{self, Engaging, Guided, Hold, Land, Ready, Standby};
use vigil_types::named;

named! {
    /// A named condition of a transition; [`Guard::name`] is what the documentation calls it.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum Guard {
        /// The autopilot started anew.
        VehicleRestarted => "vehicle restarted",
        /// The motors are disarmed.
        MotorsOff => "motors off",
        /// A condition that demands landing is present.
        LandDemanded => "land demanded",
        /// The vehicle was landing and is now in another mode.
        LandingTakenOver => "landing taken over",
        /// An operator wants to fly, and nothing demands landing.
        Reengaged => "re-engaged",
        /// While it was being taken, the vehicle was disarmed, or went into a mode that no hand-over leads to.
        HandOverTaken => "hand-over taken over",
        /// The hand-over failed.
        HandoverFailed => "hand-over failed",
        /// An operator disengaged.
        Disengaged => "disengaged",
        /// The hand-over is done, no condition demands hold.
        HandedOver => "handed over",
        /// The hand-over is done, a condition demands hold.
        HandedOverUnclear => "handed over, not clear",
        /// A condition demands hold.
        HoldDemanded => "hold demanded",
        /// The vehicle is in its own failsafe hold, guidance engages by itself, and everything else has been clear long enough.
        FailsafeHoldRegainable => "failsafe hold regainable",
        /// The vehicle has been out of its external mode for long enough, and it is not a failsafe hold to be regained.
        VehicleTaken => "vehicle taken over",
        /// No condition has demanded hold for long enough.
        ClearLongEnough => "clear long enough",
        /// Nothing that guidance needs has been missing for long enough.
        InputsGood => "inputs good",
        /// Something that guidance needs is missing.
        InputsMissing => "inputs missing",
        /// An operator wants to fly, or the policy does, no person has the vehicle and home had its time to come; no failed hand-over has to be
        /// waited for.
        EngageWanted => "engage wanted",
    }
}

named! {
    /// Whether guidance still wants to fly after a transition.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum Intent {
        /// As before.
        Keep => "kept",
        /// Only an operator's engage brings it back.
        Clear => "cleared",
        /// Kept by the policy *auto*; an operator's engage is spent with the policy *command*.
        Spend => "kept by *auto*, cleared by *command*",
        /// As [`Intent::Spend`], and the policy *auto* wants to fly again when all that ended the flight was a vehicle that was
        /// unreachable and came back disarmed: that was the restart itself.
        Renew => "kept by *auto*, also when the restart itself disarmed the vehicle; cleared by *command*",
    }
}

/// One row: from any of `from`, when `when` holds, to `to`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Transition {
    /// States in which the row counts.
    pub from: &'static [GuidanceState],
    /// The condition.
    pub when: Guard,
    /// The state afterwards.
    pub to: GuidanceState,
    /// Whether guidance still wants to fly afterwards.
    pub intent: Intent,
    /// Why.
    pub why: &'static str,
}

macro_rules! rows {
    ($([$($from:ident),+] $when:ident => $to:ident, $intent:ident: $why:literal;)+) => {
        [$(Transition {
            from: &[$($from),+],
            when: Guard::$when,
            to: $to,
            intent: Intent::$intent,
            why: $why,
        }),+]
    };
}

/// All transitions in order of precedence: in each step the first row whose state and condition fit is taken, at most one.
/// What ends a flight comes before landing, landing before hold, hold before guided.
pub static TRANSITIONS: [Transition; 17] = rows! {
    [Standby, Ready, Engaging, Guided, Hold, Land] VehicleRestarted => Standby, Renew:
        "nothing of the hand-over is left";
    [Engaging] HandOverTaken => Standby, Clear: "somebody else has the vehicle";
    [Guided, Hold, Land] MotorsOff => Standby, Clear: "the flight is over; nobody but an operator may arm again";
    [Engaging, Guided, Hold] LandDemanded => Land, Clear: "on the ground is safer than in the air";
    [Land] LandingTakenOver => Standby, Clear: "somebody else has the vehicle";
    [Land] Reengaged => Engaging, Keep: "an operator may go around";
    [Engaging] HandoverFailed => Standby, Spend:
        "the vehicle does not obey; with the policy auto it is asked again after a pause";
    [Engaging] Disengaged => Hold, Keep: "the vehicle may be in the air";
    [Engaging] HandedOver => Guided, Keep: "armed, in the air, in its external mode, all inputs good";
    [Engaging] HandedOverUnclear => Hold, Keep: "the vehicle obeys, but an input is bad";
    [Guided] HoldDemanded => Hold, Keep: "a bad input is never answered with the last command";
    [Hold] FailsafeHoldRegainable => Engaging, Keep: "what made the vehicle hold is over";
    [Hold] VehicleTaken => Standby, Clear: "somebody else has the vehicle";
    [Hold] ClearLongEnough => Guided, Keep: "every condition has cleared";
    [Standby] InputsGood => Ready, Keep: "everything needed is here";
    [Ready] InputsMissing => Standby, Spend: "something needed is missing; an operator's engage is not kept for later";
    [Ready] EngageWanted => Engaging, Keep: "take the vehicle";
};
