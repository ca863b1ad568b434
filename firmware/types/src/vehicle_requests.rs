//! What guidance asks of the vehicle, what an operator asks of guidance, and the answers: the seam between guidance and
//! the link, whatever protocol or autopilot is behind it.

use crate::{Nanos, NedVector, named};

/// What an operator asks of guidance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum OperatorRequest {
    /// Take the vehicle and fly to the goal.
    Engage,
    /// Stop flying: hover until engaged again or until the vehicle's mode is changed.
    Disengage,
    /// Land where the vehicle is.
    Land,
    /// Fly to this place from now on. Until the flight begins it moves with home, which an autopilot may set anew when it
    /// is armed.
    Goal {
        /// Metres north of home.
        north_m: f32,
        /// Metres east of home.
        east_m: f32,
        /// Metres above home; `None` keeps the height flown now.
        height_m: Option<f32>,
    },
    /// Fly to this place from now on, wherever home is: a place on the globe.
    FixedGoal {
        /// Metres north of the local origin.
        north_m: f32,
        /// Metres east of the local origin.
        east_m: f32,
        /// Metres above the local origin; `None` keeps the height flown now.
        height_m: Option<f32>,
    },
}

/// What became of an [`OperatorRequest`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RequestOutcome {
    /// It is done or begun.
    Accepted,
    /// Not now: guidance's reasons tell what is missing.
    TemporarilyRejected,
    /// Never: its values are not permitted.
    Denied,
    /// A goal farther from home than the configuration allows; metres, rounded up and down.
    TooFar {
        /// How far it is.
        distance_m: u32,
        /// What is allowed.
        limit_m: u32,
    },
}

/// What guidance asks of the vehicle in this step; the link repeats, tracks and translates it for the autopilot.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum VehicleRequest {
    /// Nothing; an unfinished request is dropped.
    #[default]
    None,
    /// Arm, take off and obey setpoints, as far as the vehicle does not already.
    FlyExternal {
        /// Height to take off to when it is on the ground, metres above the local origin.
        takeoff_height_m: f32,
    },
    /// Land.
    Land,
    /// Stop by its own means and hold its position.
    Hold {
        /// Why, of a flight that is somebody else's and is guarded; `None` where guidance lets go of the vehicle.
        cause: Option<StopCause>,
        /// Where it can come to rest, metres north and east in the local frame, for an autopilot that takes a place; `None` leaves that
        /// to it.
        place_m: Option<(f32, f32)>,
    },
    /// Go on with its mission.
    Resume,
}

/// Why a guarded vehicle is stopped.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum StopCause {
    /// Something lies so many metres ahead on its course.
    Obstacle {
        /// Metres.
        ahead_m: f32,
    },
    /// It moves, and nobody can see where to: no frame that can be believed, or no position.
    Blind,
    /// It moves where the sensor does not look.
    Unseen,
}

named! {
    /// What people read of a guarded flight, once each time it begins.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum GuardNotice {
        /// The vehicle flies and never reported where it is: it is not guarded.
        Unguarded => "not guarded: the vehicle does not tell its position",
        /// It is so fast that it cannot be stopped before what is seen.
        TooFast => "not guarded: faster than it can be stopped before what is seen",
        /// Its position jumped: what was seen before is forgotten.
        Jumped => "the position jumped: what was seen before is forgotten",
        /// Its mission was stopped, and guidance flies it around what is there.
        FliesAround => "flying around it to the mission's next place",
        /// It goes on with its mission.
        HandedBack => "handed back: the mission goes on",
        /// Guidance could not take it, or the mission's next place is not known: it stays where it was stopped.
        StaysStopped => "not flown around: guidance cannot take it, or the mission's next place is unknown",
    }
}

/// How it stands with the vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct VehicleStatus {
    /// How far it is with the hand-over.
    pub handover: HandoverProgress,
    /// How often the autopilot was seen to start anew.
    pub restarts: u32,
    /// How long ago the autopilot started, by its own clock; `None` when it has not reported it.
    pub up_ns: Option<Nanos>,
    /// Home in the local frame; `None` when the vehicle has not reported it, and then the local origin stands for it.
    pub home_ned_m: Option<NedVector>,
    /// Mean time between the last positions or attitudes, whichever is longer; `None` before there were enough.
    pub telemetry_interval_ns: Option<Nanos>,
}

/// How far the vehicle is with [`VehicleRequest::FlyExternal`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum HandoverProgress {
    /// Nothing was asked.
    #[default]
    Idle,
    /// Begun.
    InProgress {
        /// The autopilot wants (or at least bears) zero setpoints at this stage.
        stream_setpoints: bool,
    },
    /// Armed, in the air and in its external mode, by its own telemetry.
    Done,
    /// Refused, or not answered; the link has said why.
    Failed,
}
