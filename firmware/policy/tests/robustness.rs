//! What the pilot does with inputs that no healthy flight gives it, and with the same inputs twice.

mod common;

use common::{Scene, block, column, fly, frame_of, input};
use vigil_policy::{GeometricConfig, GeometricPilot, Pilot, PilotInput};
use vigil_types::{ACTION_LIMIT, Action, Attitude, DepthFrame, GoalRelative, HeadingVector, NedVector};

fn pilot() -> Box<GeometricPilot> {
    Box::new(GeometricPilot::new(GeometricConfig::default()))
}

fn scene() -> Scene {
    Scene::new([column(5.0, 0.3, 0.4), block([8.0, 8.3], [-3.0, 5.0])])
}

fn within_limits(a: Action) -> bool {
    a.is_finite() && (0.0..=ACTION_LIMIT).contains(&a.forward_m_s) && a.yaw.abs() <= ACTION_LIMIT
}

#[test]
fn after_a_reset_nothing_of_the_first_flight_is_left() {
    let mut used = pilot();
    let first = Scene::new([block([4.0, 5.0], [-9.0, 2.0])]);
    fly(&first, used.as_mut(), 0.0, (14.0, 2.0), 6.0);
    used.reset();
    let again = fly(&scene(), used.as_mut(), 0.3, (14.0, 2.0), 20.0);
    let fresh = fly(&scene(), pilot().as_mut(), 0.3, (14.0, 2.0), 20.0);
    assert!(again.actions == fresh.actions);
}

#[test]
fn a_position_that_jumps_makes_the_memory_void() {
    let mut jumped = pilot();
    fly(&scene(), jumped.as_mut(), 0.0, (14.0, 0.0), 3.0);
    let elsewhere = NedVector::new(300.0, -80.0, -1.5);
    let mut frame = frame_of(&Scene::default(), elsewhere, Attitude::LEVEL_NORTH);
    let mut fresh = pilot();
    for sequence in 1000..1010 {
        frame.header.sequence = sequence;
        let after = jumped.decide(&input(&frame, Attitude::LEVEL_NORTH));
        assert_eq!(after, fresh.decide(&input(&frame, Attitude::LEVEL_NORTH)));
    }
}

#[test]
fn any_frame_and_any_pose_give_an_action_within_limits() {
    let mut pilot = pilot();
    let mut frame = Box::new(DepthFrame::EMPTY);
    let mut noise = 1_u32;
    let mut next = || {
        noise ^= noise << 13;
        noise ^= noise >> 17;
        noise ^= noise << 5;
        noise as f32 / u32::MAX as f32
    };
    for step in 0..120_u64 {
        let fill = [0.0, 1.0, next(), 0.002][step as usize % 4];
        let speckle = next();
        for pixel in frame.depth.iter_mut() {
            *pixel = if next() < speckle { next() } else { fill };
        }
        let huge = if step % 10 == 9 { 1e9 } else { 3.0 };
        frame.header.sequence = step;
        frame.header.stamp_ns = step * 50_000_000;
        frame.header.position_ned_m = NedVector::new(huge * next(), -huge * next(), -1.5);
        frame.header.attitude = Attitude::from_euler_rad(next() - 0.5, 3.0 * next() - 1.5, 7.0 * next());
        let action = pilot.decide(&PilotInput {
            now_ns: if step % 7 == 0 {
                0
            } else {
                step * 50_000_000 + 20_000_000
            },
            depth: &frame,
            goal: GoalRelative::new(10.0 * huge * next(), 6.2 * next() - 3.1),
            attitude: Attitude::from_euler_rad(0.5 * next(), next() - 0.5, 7.0 * next()),
            velocity_m_s: HeadingVector::new(4.0 * next() - 2.0, 2.0 * next() - 1.0, 0.0),
            height_m: 1.5,
        });
        assert!(within_limits(action), "step {step}: {action:?}");
    }
}

#[test]
fn a_wall_before_the_nose_is_never_flown_at() {
    let scene = Scene::new([block([0.75, 1.0], [-20.0, 20.0])]);
    let frame = frame_of(&scene, NedVector::new(0.0, 0.0, -1.5), Attitude::LEVEL_NORTH);
    let mut pilot = pilot();
    for _ in 0..40 {
        let action = pilot.decide(&input(&frame, Attitude::LEVEL_NORTH));
        assert!(action.forward_m_s <= 0.3, "{action:?}");
    }
}

#[test]
fn an_enclosed_vehicle_turns_and_looks_and_touches_nothing() {
    let cage = [
        block([2.0, 2.2], [-2.2, 2.2]),
        block([-2.2, -2.0], [-2.2, 2.2]),
        block([-2.0, 2.0], [-2.2, -2.0]),
        block([-2.0, 2.0], [2.0, 2.2]),
    ];
    let flight = fly(&Scene::new(cage), pilot().as_mut(), 0.0, (14.0, 2.0), 25.0);
    let least_m = flight.least_clearance_m;
    assert!(!flight.reached && least_m > 0.35, "{least_m}");
    assert!(flight.actions.iter().all(|a| within_limits(*a)));
    assert!(flight.actions.iter().filter(|a| a.yaw.abs() > 1.49).count() > 100);
}
