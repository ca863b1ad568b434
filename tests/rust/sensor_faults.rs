//! Every fault of the depth sensor holds the vehicle, by the name of what is wrong, before it touches anything.

use vigil_firmware::FirmwareConfig;
use vigil_sim::world::{Family, generate};
use vigil_tests::{Pair, airborne};
use vigil_types::{GuidanceState, Reason, Reasons, StepReport};

const SEED: u64 = 4203;
/// Steps of a story: 12 s.
const STEPS: usize = 240;

/// The flight at its end, everything that was wrong while guidance flew, and its last state.
fn fly(fault: &str, plausibility: bool) -> (Pair, Reasons, GuidanceState) {
    let mut config = airborne(generate(Family::Validation, SEED), SEED);
    config.sensor_fault = Some(fault.parse().unwrap());
    let mut firmware = FirmwareConfig::to_goal(config.course.goal_ned_m());
    firmware.plausibility = plausibility;
    if !plausibility {
        // The control: the guard would stop before what a wrong picture leads into.
        firmware.detector.guard = Some(false);
    }
    let mut pair = Pair::of(&config, &firmware);
    let reports = pair.fly(STEPS, |_, _| true);
    let flies = |r: &&StepReport| matches!(r.state, GuidanceState::Guided | GuidanceState::Hold);
    let flown = reports.iter().filter(flies);
    let reasons = flown.fold(Reasons::NONE, |all, r| all.union(r.reasons));
    (pair, reasons, reports[reports.len() - 1].state)
}

/// The fault holds the vehicle, and is among what was found.
fn holds(fault: &str, reasons: &[Reason], plausibility: bool) -> Pair {
    let (pair, found, state) = fly(fault, plausibility);
    let is_named = reasons.iter().any(|reason| found.contains(*reason));
    assert!(is_named, "{fault}: {:?}", found.iter().collect::<Vec<_>>());
    assert_eq!((pair.outcome(), state), (None, GuidanceState::Hold), "{fault}");
    pair
}

/// The fault stops the vehicle and is named by one of these; without the check it does neither.
fn held(fault: &str, reasons: &[Reason]) {
    let speed_m_s = holds(fault, reasons, true).speed_m_s();
    assert!(speed_m_s < 0.2, "{fault}: still at {speed_m_s} m/s");
    let (pair, found, state) = fly(fault, false);
    let is_named = reasons.iter().any(|reason| found.contains(*reason));
    assert!(!is_named, "{fault}: named by nobody else");
    let goal_m = pair.simulator.goal_distance_m();
    let flies_on = pair.outcome().is_some() || state != GuidanceState::Hold;
    assert!(flies_on, "{fault}: without the check it flies on, {goal_m} m to go");
}

#[test]
fn a_dead_sensor_is_blind() {
    for fault in ["zeros@4", "ones@4", "dead-left@4", "dead-right@4", "dead-bottom@4"] {
        held(fault, &[Reason::BlindSensor]);
    }
}

#[test]
fn a_frozen_picture_is_frozen_whole_in_part_and_under_noise() {
    for fault in [
        "frozen",
        "frozen@4",
        "frozen-left@4",
        "frozen-right@4",
        "stuck-columns@4",
    ] {
        held(fault, &[Reason::FrozenSensor]);
    }
    // Fresh noise on an old picture: which of the two shows first depends on the way flown.
    held("frozen-noisy@4", &[Reason::FrozenSensor, Reason::InconsistentPicture]);
}

#[test]
fn a_sensor_that_sits_wrong_is_found_by_the_way_its_picture_moves() {
    for fault in ["mirrored", "mirrored@4", "shifted", "turned"] {
        held(fault, &[Reason::InconsistentPicture]);
    }
}

#[test]
fn a_pose_that_is_not_the_vehicle_s_is_implausible() {
    for fault in ["far-position@4", "displaced-position@4", "frozen-pose@4"] {
        held(fault, &[Reason::ImplausiblePose]);
    }
}

#[test]
fn stamps_and_poses_that_no_valid_frame_has_need_no_judge() {
    let stories = [
        ("delayed@4", Reason::StaleFrame),
        ("frozen-stamp@4", Reason::BadFrame),
        ("earlier-stamp@4", Reason::BadFrame),
        ("bad-quaternion@4", Reason::BadFrame),
    ];
    for (fault, reason) in stories {
        holds(fault, &[reason], false);
    }
}
