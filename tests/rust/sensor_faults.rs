//! Every fault of the depth sensor holds the vehicle, by the name of what is wrong, before it touches anything.

use vigil_firmware::FirmwareConfig;
use vigil_sim::world::{Family, generate};
use vigil_sim::{SimConfig, Start};
use vigil_tests::Pair;
use vigil_types::{GuidanceState, Reason, Reasons};

const SEED: u64 = 4203;
/// Steps of a story: 12 s.
const STEPS: usize = 240;

#[derive(Default)]
struct End {
    /// Everything that was wrong while guidance flew.
    reasons: Reasons,
    state: GuidanceState,
    speed_m_s: f32,
    ended: bool,
    goal_m: f32,
}

fn fly(fault: &str, plausibility: bool) -> End {
    let mut config = SimConfig::new(generate(Family::Validation, SEED), SEED);
    config.start = Start::Airborne;
    config.sensor_fault = Some(fault.parse().unwrap());
    let mut firmware = FirmwareConfig::to_goal(config.course.goal_ned_m());
    firmware.plausibility = plausibility;
    if !plausibility {
        // The control: the guard would stop before what a wrong picture leads into.
        firmware.detector.guard = Some(false);
    }
    let mut pair = Pair::of(&config, &firmware);
    let mut end = End::default();
    for _ in 0..STEPS {
        pair.simulate();
        let report = pair.decide(true);
        end.state = report.state;
        if matches!(report.state, GuidanceState::Guided | GuidanceState::Hold) {
            end.reasons = end.reasons.union(report.reasons);
        }
    }
    end.speed_m_s = pair.simulator.truth().velocity_ned_m_s.norm();
    end.ended = pair.simulator.ending().is_some();
    end.goal_m = pair.simulator.goal_distance_m();
    end
}

/// The fault stops the vehicle and is named by one of these; without the judge it does neither.
fn held(fault: &str, reasons: &[Reason]) {
    let end = fly(fault, true);
    assert!(
        reasons.iter().any(|reason| end.reasons.contains(*reason)),
        "{fault}: {:?}",
        end.reasons.iter().collect::<Vec<_>>()
    );
    assert!(
        !end.ended && end.state == GuidanceState::Hold,
        "{fault}: {:?}, ended {}",
        end.state,
        end.ended
    );
    assert!(end.speed_m_s < 0.2, "{fault}: still at {} m/s", end.speed_m_s);
    let unjudged = fly(fault, false);
    assert!(
        reasons.iter().all(|reason| !unjudged.reasons.contains(*reason)),
        "{fault}: named by nobody else"
    );
    assert!(
        unjudged.ended || unjudged.state != GuidanceState::Hold,
        "{fault}: without the judge it flies on, {} m to go",
        unjudged.goal_m
    );
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
        let end = fly(fault, false);
        assert!(
            end.reasons.contains(reason),
            "{fault}: {:?}",
            end.reasons.iter().collect::<Vec<_>>()
        );
        assert!(!end.ended && end.state == GuidanceState::Hold, "{fault}");
    }
}
