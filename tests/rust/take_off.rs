//! What the pilots make of a take-off: nothing. Frames taken on the ground show the ground at the vehicle's own height.

use vigil_detector::FrozenDetector;
use vigil_firmware::FirmwareConfig;
use vigil_mavlink::common::MavCmd;
use vigil_sim::world::{Course, Family, Outcome, generate};
use vigil_sim::{SimConfig, Start};
use vigil_tests::ground::{Request, STATION, command, packet};
use vigil_tests::{Pair, airborne, fly_monitored, reasons};
use vigil_types::{AlarmResponse, EngagePolicy, GuidanceState, NedVector, PilotKind, StepReport};

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
    let (outcome, reports) = fly_monitored(&SimConfig::new(course, 7), change);
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
    let turns_deg = motion.iter().map(|(yaw, _)| (yaw - first_deg).abs());
    let turned_deg = turns_deg.fold(0.0, f32::max);
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
fn after_a_take_off_in_which_nobody_is_asked_the_recovery_pilot_flies_straight_to_the_goal() {
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
        let recovers = report.alarm.is_some_and(|a| a.response == AlarmResponse::Recovery);
        recovers && report.state == GuidanceState::Guided
    });
    flown_straight(&recovery, 20);
    // No pilot was asked and nothing scored before the vehicle was handed over.
    let begun = reports.iter().position(|r| r.state == GuidanceState::Guided);
    let (before, guided) = reports.split_at(begun.expect("guided"));
    assert!(before.len() > 40, "it has to climb first");
    assert!(before.iter().all(|r| r.action.is_none() && r.judgement.is_none()));
    assert!(guided.iter().all(|r| r.action.is_some()));
}

/// A flight of 50 s that begins with a hover at `height_m` ends at the course's goal at 2 m; the greatest height at which it flew ahead.
fn from_a_hover(seed: u64, height_m: f32, kind: PilotKind) -> f32 {
    let mut simulation = airborne(generate(Family::Validation, seed), seed);
    // A hover at 6 m is above the ceilings that some courses have.
    (simulation.course.bounds.top_m, simulation.course.ceiling_height_m) = (20.0, None);
    simulation.course.time_limit_s = 50.0;
    // The course's own goal is as high as the hover: its judgement of arrivals does not count here.
    simulation.course.flight_height_m = height_m;
    let above = simulation.course.goal_ned_m();
    let goal = NedVector::new(above.x, above.y, -2.0);
    let (outcome, reports) = fly_monitored(&simulation, |config| {
        *config = FirmwareConfig::to_goal(goal);
        config.pilot.kind = kind;
    });
    let mut highest_ahead_m = 0.0_f32;
    for report in &reports {
        if let (Some(k), Some(setpoint)) = (report.telemetry.kinematics, report.setpoint)
            && setpoint.velocity_m_s.x.abs() > 0.1
        {
            highest_ahead_m = highest_ahead_m.max(-k.position_ned_m.z);
        }
    }
    let last = reports.last().and_then(|report| report.telemetry.kinematics);
    let left_m = last.map_or(f32::INFINITY, |k| (k.position_ned_m - goal).norm());
    // The course ends flights by its own goal, as high as the hover; here they end by time.
    assert!(
        outcome == Some(Outcome::TimeOut) && left_m < 1.0,
        "{seed} {kind:?}: {outcome:?} {left_m} m before the goal"
    );
    highest_ahead_m
}

/// Hovering above what stands there, a pilot sees nothing at its own height. On its way down it would fly into it from above.
#[test]
fn a_goal_far_below_or_above_is_flown_to_at_its_own_height() {
    for seed in [1, 2, 3] {
        for kind in [PilotKind::Actor, PilotKind::Geometric] {
            let highest_ahead_m = from_a_hover(seed, 6.0, kind);
            assert!(highest_ahead_m < 3.1, "{seed} {kind:?}: ahead at {highest_ahead_m} m");
        }
    }
    from_a_hover(4, 0.7, PilotKind::Actor);
}

/// A script arms and takes off to 2 m itself, and engages guidance once it hovers.
#[test]
fn a_script_takes_off_by_itself_and_hands_over() {
    for seed in [7, 8] {
        let above_sea_m = 2.0 + vigil_autopilot::geo::ORIGIN.altitude_m as f32;
        let mut pair = Pair::with(Family::Validation, seed, |simulation, firmware| {
            (simulation.start, firmware.engage) = (Start::Ground, EngagePolicy::Command);
        });
        let asked = |number, what, parameters| packet(STATION, number, &command(what, parameters));
        let arm = asked(0, MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, [1.0, 0.0, 0.0, 0.0]);
        let take_off = asked(1, MavCmd::MAV_CMD_NAV_TAKEOFF, [0.0, 0.0, 0.0, above_sea_m]);
        let engage = packet(STATION, 2, &Request::Engage.message(1));
        let reports = pair.fly(800, |pair, step| {
            match step {
                59 => pair.simulator.receive(0, &arm),
                63 => pair.simulator.receive(0, &take_off),
                300 => assert!(pair.to_firmware.push(0, &engage)),
                _ => {}
            }
            true
        });
        // How long guidance flew in the 25 s thereafter, steps, and for what it held.
        let handed_over = &reports[300..];
        let guided = handed_over.iter().filter(|r| r.state == GuidanceState::Guided).count();
        let mut holds = handed_over.to_vec();
        holds.retain(|r| r.state == GuidanceState::Hold);
        let held_for: Vec<_> = reasons(&holds).iter().collect();
        assert!(guided > 200, "{seed}: guided {guided}, held for {held_for:?}");
    }
}
