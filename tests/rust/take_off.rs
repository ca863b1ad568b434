//! What the pilots make of a take-off: nothing. Frames taken on the ground show the ground at the vehicle's own height.

use vigil_detector::FrozenDetector;
use vigil_firmware::FirmwareConfig;
use vigil_sim::SimConfig;
use vigil_tests::fly_watched;
use vigil_types::{AlarmResponse, GuidanceState, PilotKind, StepReport};
use vigil_world::{Course, Outcome};

/// Nothing but ground; the vehicle stands with its nose to the goal.
const FIELD: &str = r#"
name = "empty field"
start = { heading_deg = 14.04 }
goal = { north_m = 20.0, east_m = 5.0 }
bounds = { north_m = [-10.0, 30.0], east_m = [-20.0, 20.0], top_m = 6.0 }
"#;

/// The reports of a flight from the ground to the goal.
fn fly(change: impl FnOnce(&mut FirmwareConfig)) -> Vec<StepReport> {
    let course = Course::from_toml_str(FIELD, "empty field").expect("a course");
    let (outcome, reports) = fly_watched(&SimConfig::new(course, 7), change);
    assert_eq!(outcome, Some(Outcome::Success));
    reports
}

/// The vehicle's heading and speed ahead in the steps of a flight in which `flies`.
fn motion(reports: &[StepReport], flies: impl Fn(&StepReport) -> bool) -> Vec<(f32, f32)> {
    let steps = reports.iter().filter(|report| flies(report)).filter_map(|report| {
        let yaw_rad = report.telemetry.attitude?.attitude.yaw_rad();
        let velocity = report.telemetry.kinematics?.velocity_ned_m_s.to_heading(yaw_rad);
        Some((yaw_rad.to_degrees(), velocity.x))
    });
    steps.collect()
}

fn flown_straight(motion: &[(f32, f32)], seconds: usize) {
    assert!(motion.len() > 20 * seconds, "{} steps", motion.len());
    let first_deg = motion[0].0;
    let turned_deg = motion
        .iter()
        .map(|(yaw, _)| (yaw - first_deg).abs())
        .fold(0.0, f32::max);
    let back_m_s = motion.iter().map(|(_, ahead)| -ahead).fold(0.0, f32::max);
    assert!(turned_deg < 10.0, "turned by {turned_deg}°");
    assert!(back_m_s < 0.15, "backwards at {back_m_s} m/s");
}

#[test]
fn after_a_take_off_on_an_empty_field_the_geometric_pilot_flies_straight_to_the_goal() {
    let reports = fly(|config| config.pilot.kind = PilotKind::Geometric);
    let guided = motion(&reports, |report| report.state == GuidanceState::Guided);
    flown_straight(&guided, 10);
    // Straight there: 20.6 m at 1.5 m/s, and the time to get going.
    assert!(guided.len() < 17 * 20, "{} steps", guided.len());
}

#[test]
fn after_a_take_off_the_recovery_pilot_flies_straight_to_the_goal() {
    // A detector without weights gives everything the score 0.5: the alarm comes with its first verdict, and stays.
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("detector.safetensors");
    let mut undecided = FrozenDetector::built_in().expect("a detector");
    undecided.params.fill(0.0);
    undecided.save(&file).expect("written");
    let reports = fly(|config| {
        config.pilot.kind = PilotKind::Actor;
        (config.detector.enabled, config.detector.file) = (Some(true), Some(file));
        config.detector.threshold = Some(0.4);
    });
    let recovery = motion(&reports, |report| {
        report.state == GuidanceState::Guided
            && report
                .alarm
                .is_some_and(|alarm| alarm.response == AlarmResponse::Recovery)
    });
    flown_straight(&recovery, 20);
}

#[test]
fn no_pilot_is_asked_and_nothing_is_judged_before_the_vehicle_is_handed_over() {
    let reports = fly(|config| {
        config.pilot.kind = PilotKind::Actor;
        config.detector.enabled = Some(true);
    });
    let begun = reports
        .iter()
        .position(|report| report.state == GuidanceState::Guided)
        .expect("guided");
    assert!(begun > 40, "it has to climb first");
    assert!(
        reports[..begun]
            .iter()
            .all(|r| r.action.is_none() && r.judgement.is_none())
    );
    assert!(reports[begun..].iter().all(|r| r.action.is_some()));
}
