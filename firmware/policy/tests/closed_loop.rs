//! The geometric pilot in small worlds drawn by hand.

mod common;

use common::{Flight, Scene, block, column, fly};
use vigil_policy::{GeometricConfig, GeometricPilot};

fn flight(scene: &Scene, start_yaw_rad: f32, goal: (f32, f32), limit_s: f32) -> Flight {
    let mut pilot = Box::new(GeometricPilot::new(GeometricConfig::default()));
    fly(scene, pilot.as_mut(), start_yaw_rad, goal, limit_s)
}

#[track_caller]
fn arrives(f: &Flight) {
    assert!(f.reached, "not there after {} s, at {:?}", f.time_s, f.positions.last());
    assert!(f.least_clearance_m > 0.33, "came within {} m", f.least_clearance_m);
}

#[test]
fn open_space_is_flown_straight_at_cruise_speed() {
    let f = flight(&Scene::default(), 0.0, (20.0, 0.0), 30.0);
    arrives(&f);
    assert!(f.time_s < 15.0, "{} s", f.time_s);
    assert!(f.positions.iter().all(|p| p.y.abs() < 0.2));
}

#[test]
fn a_goal_behind_is_turned_to_before_flying() {
    let f = flight(&Scene::default(), 0.0, (-15.0, 1.0), 40.0);
    arrives(&f);
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
fn a_column_dead_ahead_is_passed_on_either_side() {
    arrives(&flight(&Scene::new([column(6.0, 0.0, 0.3)]), 0.0, (20.0, 0.0), 30.0));
}

#[test]
fn a_wall_across_the_way_is_flown_around() {
    arrives(&flight(
        &Scene::new([block([8.0, 8.3], [-6.0, 3.0])]),
        0.0,
        (20.0, 0.0),
        40.0,
    ));
}

#[test]
fn a_dead_end_is_left_again() {
    let trap = [
        block([10.0, 10.3], [-4.0, 4.0]),
        block([3.0, 10.0], [-4.3, -4.0]),
        block([3.0, 10.0], [4.0, 4.3]),
    ];
    arrives(&flight(&Scene::new(trap), 0.0, (20.0, 0.0), 60.0));
}

#[test]
fn a_gap_of_two_metres_is_found_and_passed() {
    let gap = [block([8.0, 8.3], [-12.0, 2.0]), block([8.0, 8.3], [4.0, 12.0])];
    arrives(&flight(&Scene::new(gap), 0.0, (20.0, 0.0), 40.0));
}

#[test]
fn what_lies_below_or_above_is_no_obstacle() {
    let mut scene = Scene::new([
        common::Solid::Block {
            north: [5.0, 7.0],
            east: [-10.0, 10.0],
            up: [0.0, 1.0],
        },
        common::Solid::Block {
            north: [9.0, 11.0],
            east: [-10.0, 10.0],
            up: [2.0, 4.0],
        },
    ]);
    scene.ceiling_up = Some(2.3);
    let f = flight(&scene, 0.0, (20.0, 0.0), 30.0);
    assert!(f.reached && f.time_s < 15.5, "{} s", f.time_s);
    assert!(f.positions.iter().all(|p| p.y.abs() < 0.3));
}

#[test]
fn a_forest_of_thin_columns_is_crossed() {
    let mut columns = Vec::new();
    for i in 0..6_i16 {
        for j in -4..5_i16 {
            let shift = if i % 2 == 0 { 0.0 } else { 1.2 };
            columns.push(column(4.0 + 2.4 * f32::from(i), 2.4 * f32::from(j) + shift, 0.1));
        }
    }
    arrives(&flight(&Scene::new(columns), 0.0, (20.0, 5.0), 60.0));
}
