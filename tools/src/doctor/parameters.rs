//! The autopilots' parameters that decide whether a flight by a guidance computer ends well when something fails.
//!
//! PX4: <https://docs.px4.io/main/en/advanced_config/parameter_reference>;
//! ArduPilot: <https://ardupilot.org/copter/docs/parameters.html>.

use super::finding::Severity::{self, Failure, Good, Warning};
use vigil_mavlink::Flavour;

/// A parameter, and how its value is graded.
pub(crate) struct Row {
    pub name: &'static str,
    pub unit: &'static str,
    pub wanted: &'static str,
    /// Why, and what to do.
    pub why: &'static str,
    pub grade: fn(f32) -> Severity,
}

/// What PX4 has from 1.18 on, and what it had before in its place.
pub(crate) const STICKS_BY_SPEED: &str = "MAN_OVERRIDE_SPD";
pub(crate) const BEFORE_BY_SPEED: [&str; 2] = ["COM_RC_OVERRIDE", "COM_RCL_EXCEPT"];

/// The fastest mission that is stopped within the 11 m that are looked ahead, rounded down (docs/just-stop.md).
const GUARDED_M_S: f32 = 5.3;
const TOO_FAST: &str = "--duty just-stop and fly-around look 11 m ahead: a faster mission is not stopped in time, and is said to be unguarded";

/// Whether a bit of a parameter that is a set is on.
fn has_bit(value: f32, bit: u32) -> bool {
    value >= 0.0 && value as u32 & bit != 0
}

/// How long a vehicle may keep to its last setpoint.
fn grade_silence_s(limit_s: f32) -> Severity {
    match limit_s {
        s if s <= 1.0 => Good,
        s if s <= 5.0 => Warning,
        _ => Failure,
    }
}

const PX4: [Row; 6] = [
    Row {
        name: "COM_OF_LOSS_T",
        unit: "s",
        wanted: "at most 1 s",
        why: "the vehicle keeps to its last setpoint for so long when the guidance computer falls silent",
        grade: grade_silence_s,
    },
    Row {
        name: "COM_OBL_RC_ACT",
        unit: "",
        wanted: "5 (hold) or 4 (land)",
        why: "what follows a lost setpoint stream, as when the firmware is killed: 3, and 0 to 2 without sticks, return at RTL_RETURN_ALT through \
              whatever is there; below 0 nothing follows, 6 and 7 let the vehicle fall: param set COM_OBL_RC_ACT 5",
        grade: |v| match v as i32 {
            4 | 5 => Good,
            3 => Warning,
            _ => Failure,
        },
    },
    Row {
        name: STICKS_BY_SPEED,
        unit: "",
        wanted: "above 0",
        why: "without it the pilot's sticks do not end OFFBOARD; only the mode switch does",
        grade: |v| if v > 0.0 { Good } else { Warning },
    },
    Row {
        name: "COM_RC_OVERRIDE",
        unit: "",
        wanted: "bit 1 on (add 2)",
        why: "without it the pilot's sticks do not end OFFBOARD; only the mode switch does",
        grade: |v| if has_bit(v, 2) { Good } else { Warning },
    },
    Row {
        name: "COM_RCL_EXCEPT",
        unit: "",
        wanted: "bit 2 on (add 4) where sticks may fall silent",
        why: "without it OFFBOARD ends in the failsafe of lost sticks when those that were there at arming fall silent",
        grade: |v| if has_bit(v, 4) { Good } else { Warning },
    },
    Row {
        name: "MPC_XY_CRUISE",
        unit: "m/s",
        wanted: "at most 5.3 m/s (5.0 with fly-around) where missions are guarded",
        why: TOO_FAST,
        grade: |v| if v <= GUARDED_M_S { Good } else { Warning },
    },
];

const ARDUPILOT: [Row; 5] = [
    Row {
        name: "GUID_TIMEOUT",
        unit: "s",
        wanted: "at most 1 s",
        why: "the vehicle flies on by its last setpoint for so long when the guidance computer falls silent; Vigil sets 0.5 s when it takes \
              the vehicle, unless set otherwise",
        grade: grade_silence_s,
    },
    Row {
        name: "WPNAV_SPEED",
        unit: "cm/s",
        wanted: "at most 530 cm/s (500 with fly-around) where missions are guarded",
        why: TOO_FAST,
        grade: |v| if v <= 100.0 * GUARDED_M_S { Good } else { Warning },
    },
    Row {
        name: "FS_EKF_ACTION",
        unit: "",
        wanted: "1 (land), 2 (altitude hold) or 3",
        why: "at 0 nothing follows when the estimator fails, and setpoints are flown by a position that is wrong",
        grade: |v| if v > 0.0 { Good } else { Warning },
    },
    Row {
        name: "ARMING_CHECK",
        unit: "",
        wanted: "1 (all)",
        why: "at 0 the vehicle arms whatever is wrong with it",
        grade: |v| if v == 0.0 { Warning } else { Good },
    },
    Row {
        name: "RC_OVERRIDE_TIME",
        unit: "s",
        wanted: "0 to 3 s",
        why: "how long sticks sent by MAVLink count after the last of them: below 0 a program that died holds them for ever",
        grade: |v| match v {
            v if v < 0.0 => Failure,
            v if v <= 3.0 => Good,
            _ => Warning,
        },
    },
];

/// The rows of an autopilot.
pub(crate) fn of(flavour: Flavour) -> std::slice::Iter<'static, Row> {
    match flavour {
        Flavour::Px4 => PX4.iter(),
        Flavour::ArduPilot => ARDUPILOT.iter(),
    }
}
