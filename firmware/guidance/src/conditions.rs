//! The named conditions: what each one means, demands, and how it clears.

use vigil_types::{Nanos, Reason, Reasons};

const SECOND_NS: Nanos = 1_000_000_000;

/// What a condition demands while it is present. In order of precedence.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Demand {
    /// Land.
    Land,
    /// Hold: zero setpoints.
    Hold,
    /// Ends the flight: back to standby.
    End,
    /// Delays engaging.
    Wait,
    /// The recovery pilot's action is sent instead of the actor's.
    Recover,
    /// Nothing but to be reported.
    Warn,
}

/// One named condition.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Condition {
    /// Its name.
    pub reason: Reason,
    /// What it demands in flight.
    pub demand: Demand,
    /// Whether it keeps guidance from becoming ready.
    pub blocks_ready: bool,
    /// When it is present. `{field}` stands for the threshold in the configuration.
    pub present: &'static str,
    /// When it clears.
    pub clears: &'static str,
}

macro_rules! conditions {
    ($($reason:ident, $demand:ident, $blocks_ready:literal: $present:literal; $clears:literal;)+) => {
        [$(Condition {
            reason: Reason::$reason,
            demand: Demand::$demand,
            blocks_ready: $blocks_ready,
            present: $present,
            clears: $clears,
        }),+]
    };
}

/// All conditions, in the order of [`Reason`].
pub static CONDITIONS: [Condition; 34] = conditions! {
    // Reason, demand, whether it keeps guidance from ready: when it is present; when it clears.
    StaleFrame, Hold, true: "no valid depth frame yet, or the newest is older than {frame_age_limit}";
        "a fresh valid frame";
    BadFrame, Hold, true: "a frame was refused in this step (size, sensor, checksum, range, pose, stamp)";
        "a step in which no frame is refused";
    StaleTelemetry, Hold, true: "position or attitude never received, or older than {telemetry_age_limit}";
        "both fresh";
    LinkLost, Hold, true: "no heartbeat of the vehicle yet, or the last is older than {heartbeat_age_limit}";
        "a heartbeat";
    NotFinite, Hold, true:
        "a received position, velocity, attitude or rate, or the pilot's action, is NaN or infinite, or the pilot gave no action although it could";
        "all finite";
    ModeLost, Hold, false: "guided, hold: the vehicle is not in its external mode";
        "it is again; or the end of the flight";
    Disarmed, End, false: "guided, hold, land: the vehicle says that it is disarmed"; "at once in standby";
    Slip, Hold, true: "{slip_limit} or more steps missed within {slip_window}"; "fewer missed within the window";
    Geofence, Hold, true:
        "outside the permitted region (if one is configured); below its least height only in guided and hold";
        "0.5 m inside";
    GoalReached, Hold, false:
        "guided, hold: horizontally within {goal_radius} of the goal; with at-goal *land* demands landing after {goal_dwell}";
        "another goal; the end of the flight";
    NoGoal, Hold, true: "no goal was given"; "a goal";
    Operator, Hold, false: "an operator disengaged, or ordered to land (then it demands landing)"; "an operator engages";
    HandoverFailed, Wait, false:
        "the vehicle refused or did not answer, or the hand-over took longer than {handover_limit} and a second a metre of climb";
        "after {handover_pause}; an operator engages";
    LowBattery, Land, true: "the vehicle reports less charge than {battery_limit}";
        "more charge, but a landing that began goes on";
    VehicleFailsafe, Hold, false: "the vehicle's heartbeat says CRITICAL, EMERGENCY or FLIGHT_TERMINATION";
        "it says otherwise";
    TimeLimit, Land, false: "the flight is longer than the configured limit (none by default)"; "the end of the flight";
    Attack, Hold, false:
        "{raise_count} of the last {raise_window} verdicts on the flying actor were *attack*, and the policy is *stop* or *recover*";
        "*recover*: slower than {stopped}, at the latest after {stop_limit}; *stop*: {alarm_clear_steps} clean steps in a row (the verdict is clean, the picture not rough, the actor on no collision course), after each further alarm of a flight twice as many";
    NoVerdict, Hold, false:
        "no verdict on the flying actor for more than {unknown_limit} steps, and the policy is *stop* or *recover*";
        "as *attack*";
    Recovering, Recover, false:
        "the policy is *recover*, and *attack*, *no verdict*, *collision course*, *led astray*, *disagreement* or *rough picture* has stopped the vehicle";
        "{alarm_clear_steps} clean steps in a row, after each further alarm of a flight twice as many; where the guard raised it, an operator's engage; the end of the flight";
    CollisionCourse, Hold, false:
        "the recovery pilot saw the flying actor's action run into something in {guard_steps} consecutive steps, or its own in {recovery_guard_steps}, and the policy is *stop* or *recover*";
        "*recover*: as *attack*; *stop*: an operator engages; the end of the flight";
    BlindSensor, Hold, true:
        "the frames show zeros for ranges, or over 15° or more of the view no return where the ground must be seen";
        "3 frames in a row that show it";
    FrozenSensor, Hold, false:
        "in flight the picture, or a part of it, stays as it was although the vehicle moved";
        "a picture that fits an earlier one and the way flown since; after the second time in a flight, the end of the flight";
    ImplausiblePose, Hold, true:
        "the pose in the frame's header is more than 2 m or 15° from the telemetry's, or does not move as it does; or in flight the vehicle's position jumped";
        "10 frames in a row whose pose fits";
    InconsistentPicture, Hold, false:
        "in flight the picture does not move as the vehicle does: it jumps, parts of it vanish, or it moves as a mirrored or a turned sensor's would, or one's of another width";
        "as *frozen sensor*; of such a sensor the end of the flight";
    NoProgress, Hold, false:
        "{no_progress_limit} in *guided* did not bring the vehicle {no_progress_gain} nearer to the goal than it had been before; with no-progress *land* it demands landing after {no_progress_dwell}";
        "another goal; an operator engages; the end of the flight";
    SlowTelemetry, Warn, false:
        "position or attitude arrive more than {slow_telemetry} apart on average, half of the age that is *stale telemetry*";
        "both arrive faster";
    PilotInCommand, Wait, false:
        "standby, ready: a person took the vehicle over, or *auto* would fly one that is where *auto* does not take it ([below](#where-auto-engages))";
        "an operator engages; where nobody took it over also a state of the vehicle in which *auto* takes it";
    UnauthenticatedFrame, Hold, true:
        "frame keys are configured, and a frame in this step was not made with one of them";
        "a step without such a frame";
    LedAstray, Hold, false:
        "the flying actor fell more than {astray} behind a vehicle that flies at {way_speed} along the way that the recovery pilot plans, what it had gained on it before not counted; and the policy is *stop* or *recover*";
        "as *collision course*";
    Disagreement, Hold, false:
        "the yaw outputs of the flying actor and the recovery pilot were more than {apart} (of 3) apart, for {disagreement} longer than they were not; and the policy is *stop* or *recover*";
        "as *collision course*";
    RoughPicture, Hold, false:
        "in `detector.raise_count` of the last `detector.raise_window` frames fewer than {smooth_share} of the cells of 4 × 4 pixels in which something is seen showed one surface, or a part of the picture was torn or moved; and the policy is *stop* or *recover*";
        "as *collision course*";
    SecondSensorSilent, Hold, true: "`second_sensor` is on, and nothing usable came from it for 0.3 s, or ever";
        "a report of it that can be used";
    SensorsDisagree, Hold, true:
        "in the air, in 3 of the second sensor's last 5 reports something was nearer, by more than 0.5 m, than the depth frames show in that direction";
        "15 reports in a row that agree; after the second time in a flight, the end of the flight";
    BeneathGround, Hold, false:
        "while the vehicle obeys setpoints: in 8 of the last 10 frames, over 15° or more of the view, surfaces lie beneath the ground that the lowest rows show: nearer obstacles are shown farther away, or the ground falls away";
        "40 frames in a row that show the ground and nothing beneath it; after the second time in a flight, the end of the flight";
};

/// Window in which missed steps are counted.
pub const SLIP_WINDOW_NS: Nanos = SECOND_NS;
/// Hover at the goal before landing.
pub const GOAL_DWELL_NS: Nanos = 2 * SECOND_NS;
/// Hover after no progress before landing for it.
pub const NO_PROGRESS_DWELL_NS: Nanos = 10 * SECOND_NS;
/// How much nearer to the goal than ever before counts as nearer, metres.
pub const NO_PROGRESS_GAIN_M: f32 = 1.0;
/// Longest hand-over, take-off included.
pub const HANDOVER_LIMIT_NS: Nanos = 60 * SECOND_NS;
/// How long a failed hand-over blocks the next.
pub const HANDOVER_PAUSE_NS: Nanos = 5 * SECOND_NS;
/// Consecutive steps without a verdict that the actor may fly: the detector's window is ten steps long.
pub const UNKNOWN_LIMIT: u16 = 10;
/// The vehicle counts as stopped below this speed, metres per second.
pub const STOPPED_M_S: f32 = 0.2;
/// Longest stop before the recovery pilot flies on: gusts may keep the vehicle from ever standing still.
pub const STOP_LIMIT_NS: Nanos = 3 * SECOND_NS;
/// Metres inside the fence at which [`Reason::Geofence`] clears.
pub const FENCE_CLEAR_MARGIN_M: f32 = 0.5;

/// The conditions that demand `demand` in flight.
pub fn demanding(demand: Demand) -> Reasons {
    collect(|c| c.demand == demand)
}

/// The conditions that keep guidance from becoming ready.
pub fn blocking_ready() -> Reasons {
    collect(|c| c.blocks_ready)
}

fn collect(of: impl Fn(&Condition) -> bool) -> Reasons {
    CONDITIONS
        .iter()
        .fold(Reasons::NONE, |set, c| set.with_if(of(c), c.reason))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_reason_has_its_condition_at_its_place() {
        assert!(CONDITIONS.iter().map(|c| c.reason).eq(Reason::ALL));
    }
}
