//! The geometric pilot in small worlds drawn by hand.

mod common;

use common::{Flight, Scene, beam, block, ceiling, column, fly};
use vigil_policy::{GeometricConfig, GeometricPilot};

fn flight(scene: &Scene, start_yaw_rad: f32, goal: (f32, f32), limit_s: f32) -> Flight {
    let mut pilot = Box::new(GeometricPilot::new(GeometricConfig::default()));
    fly(scene, pilot.as_mut(), start_yaw_rad, goal, limit_s)
}

const CLEAR_M: f32 = 0.33;

#[test]
fn open_space_is_flown_straight_at_cruise_speed() {
    let f = flight(&Scene::default(), 0.0, (20.0, 0.0), 30.0);
    f.assert_arrived(CLEAR_M);
    assert!(f.time_s < 15.0, "{} s", f.time_s);
    assert!(f.positions.iter().all(|p| p.y.abs() < 0.2));
}

#[test]
fn a_goal_behind_is_turned_to_before_flying() {
    let f = flight(&Scene::default(), 0.0, (-15.0, 1.0), 40.0);
    f.assert_arrived(CLEAR_M);
    assert!(f.positions.iter().all(|p| p.x < 1.0));
}

#[test]
fn a_goal_just_behind_is_not_flown_to_backward() {
    // At the recovery pilot's speed: there the field outweighs the seeking.
    let mut pilot = Box::new(GeometricPilot::new(GeometricConfig {
        cruise_m_s: 0.8,
        ..GeometricConfig::default()
    }));
    let f = fly(&Scene::default(), pilot.as_mut(), 0.0, (-3.0, 0.2), 40.0);
    assert!(f.reached);
    // A turn by 150° takes more than three seconds.
    assert!(f.positions.iter().take(60).all(|p| p.x > -0.2));
}

#[test]
fn columns_walls_dead_ends_gaps_and_forests_are_passed() {
    let trap = [
        block([10.0, 10.3], [-4.0, 4.0]),
        block([3.0, 10.0], [-4.3, -4.0]),
        block([3.0, 10.0], [4.0, 4.3]),
    ];
    let gap_of_two_metres = [block([8.0, 8.3], [-12.0, 2.0]), block([8.0, 8.3], [4.0, 12.0])];
    let mut forest = Vec::new();
    for i in 0..6_i16 {
        for j in -4..5_i16 {
            let shift = if i % 2 == 0 { 0.0 } else { 1.2 };
            forest.push(column(4.0 + 2.4 * f32::from(i), 2.4 * f32::from(j) + shift, 0.1));
        }
    }
    for (solids, goal_east_m, limit_s) in [
        (vec![column(6.0, 0.0, 0.3)], 0.0, 30.0),
        (vec![block([8.0, 8.3], [-6.0, 3.0])], 0.0, 40.0),
        (trap.to_vec(), 0.0, 60.0),
        (gap_of_two_metres.to_vec(), 0.0, 40.0),
        (forest, 5.0, 60.0),
    ] {
        flight(&Scene::new(solids), 0.0, (20.0, goal_east_m), limit_s).assert_arrived(CLEAR_M);
    }
}

#[test]
fn what_lies_below_or_above_is_no_obstacle() {
    let scene = Scene::new([
        beam([5.0, 7.0], [-10.0, 10.0], [0.0, 1.0]),
        beam([9.0, 11.0], [-10.0, 10.0], [2.0, 4.0]),
        ceiling(2.3),
    ]);
    let f = flight(&scene, 0.0, (20.0, 0.0), 30.0);
    assert!(f.reached && f.time_s < 15.5, "{} s", f.time_s);
    assert!(f.positions.iter().all(|p| p.y.abs() < 0.3));
}
