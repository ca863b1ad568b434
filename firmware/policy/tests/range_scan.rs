//! What the pilot makes of single frames, against geometry worked out by hand.

mod common;

use common::{Scene, beam, block, ceiling, column, frame_of, input};
use vigil_policy::geometric::range_scan::{BAND_HALF_HEIGHT_M, SECTORS};
use vigil_policy::{RangeScan, Scan};
use vigil_types::{Attitude, DEPTH_COLS, DEPTH_ROWS, DepthFrame, HeadingVector, NedVector};

const AT: NedVector = NedVector::new(0.0, 0.0, -1.5);

fn scan_of(scene: &Scene, attitude: Attitude) -> Scan {
    let frame = frame_of(scene, AT, attitude);
    RangeScan::new().observe(&input(&frame, attitude)).clone()
}

/// Every point seen lies on a solid's surface, within `tolerance_m` horizontally.
#[track_caller]
fn all_on_surfaces(scan: &Scan, scene: &Scene, yaw_rad: f32, tolerance_m: f32) {
    for (x, y, _) in scan.points() {
        let ned = HeadingVector::new(x, y, 0.0).to_ned(yaw_rad);
        let off = scene.distance(AT + ned);
        assert!(off < tolerance_m, "point {x}, {y} is {off} m from any surface");
    }
}

#[test]
fn a_column_is_seen_at_its_distance_and_bearing() {
    let scene = Scene::new([column(5.0, 2.0, 0.25)]);
    let scan = scan_of(&scene, Attitude::LEVEL_NORTH);
    let nearest = scan.nearest_within(1.0).expect("a column");
    let off_m = nearest.distance_m - (29.0_f32.sqrt() - 0.25);
    let off_rad = nearest.bearing_rad - (2.0_f32 / 5.0).atan();
    assert!(off_m.abs() < 0.02 && off_rad.abs() < 0.02, "{nearest:?}");
    // Its width: 2·asin(0.25/5.385) = 5.3° of 120°, in 128 sectors 5.7.
    let seen = scan.points().count();
    assert!((5..=7).contains(&seen), "{seen} sectors");
    all_on_surfaces(&scan, &scene, 0.0, 0.05);
    assert_eq!(scan.nearest_within(0.2), None);
}

#[test]
fn floor_and_ceiling_are_not_obstacles_however_the_vehicle_tilts() {
    let scene = Scene::new([ceiling(2.2)]);
    for (roll, pitch) in [
        (0.0, 0.0),
        (0.0, -0.35),
        (0.0, 0.35),
        (0.4, 0.0),
        (-0.3, -0.3),
        (0.25, 0.2),
    ] {
        let scan = scan_of(&scene, Attitude::from_euler_rad(roll, pitch, 1.0));
        assert_eq!(scan.points().count(), 0, "roll {roll}, pitch {pitch}");
    }
}

#[test]
fn a_tilted_vehicle_sees_the_walls_where_they_are() {
    let scene = Scene::new([
        block([4.0, 4.5], [-3.0, 2.0]),
        column(2.0, 2.5, 0.2),
        block([-3.0, 3.0], [-4.0, -3.0]),
    ]);
    let level = scan_of(&scene, Attitude::LEVEL_NORTH).points().count();
    for (roll, pitch) in [(0.0, -0.3), (0.0, 0.25), (0.3, 0.0), (-0.2, -0.2), (0.15, 0.2)] {
        let scan = scan_of(&scene, Attitude::from_euler_rad(roll, pitch, 0.0));
        all_on_surfaces(&scan, &scene, 0.0, 0.12);
        assert!(scan.points().count() + 6 > level, "roll {roll}, pitch {pitch}");
    }
}

#[test]
fn the_band_decides_what_the_vehicle_must_avoid() {
    let tilted = Attitude::from_euler_rad(0.05, -0.1, 0.0);
    let sees = |low: f32, high: f32| {
        let scene = Scene::new([beam([3.0, 3.5], [-5.0, 5.0], [low, high])]);
        scan_of(&scene, tilted).points().count() > 0
    };
    let band = BAND_HALF_HEIGHT_M;
    assert!(!sees(0.0, 1.5 - band - 0.05), "a box below the band");
    assert!(sees(0.0, 1.5 - band + 0.15), "a box that reaches into it");
    assert!(!sees(1.5 + band + 0.05, 4.0), "a beam above the band");
    assert!(sees(1.5 + band - 0.15, 4.0), "a beam that reaches into it");
}

#[test]
fn isolated_pixels_are_not_a_surface_but_three_together_are() {
    let mut frame = Box::new(DepthFrame::EMPTY);
    let middle = (DEPTH_ROWS / 2) * DEPTH_COLS;
    for col in (10..250).step_by(8) {
        frame.depth[middle + col] = 0.02;
        frame.depth[middle - DEPTH_COLS + col + 1] = 0.02;
    }
    let mut surroundings = RangeScan::new();
    let scan = surroundings.observe(&input(&frame, Attitude::LEVEL_NORTH));
    assert_eq!(scan.points().count(), 0);
    frame.depth[middle + DEPTH_COLS + 10] = 0.021;
    let scan = surroundings.observe(&input(&frame, Attitude::LEVEL_NORTH));
    assert_eq!(scan.points().count(), 1);
    assert!((scan.range_m[5] - 2.1).abs() < 0.01, "{}", scan.range_m[5]);
}

#[test]
fn a_wall_with_dropouts_stays_a_wall() {
    let scene = Scene::new([block([4.0, 4.5], [-20.0, 20.0])]);
    let mut frame = frame_of(&scene, AT, Attitude::LEVEL_NORTH);
    // Every third pixel lost, scattered.
    for (i, pixel) in frame.depth.iter_mut().enumerate() {
        if (i * 2_654_435_761) % 97 < 33 {
            *pixel = 1.0;
        }
    }
    let mut surroundings = RangeScan::new();
    let scan = surroundings.observe(&input(&frame, Attitude::LEVEL_NORTH));
    assert_eq!(scan.points().count(), SECTORS);
    all_on_surfaces(scan, &scene, 0.0, 0.05);
}

#[test]
fn yaw_and_motion_since_capture_are_corrected() {
    let scene = Scene::new([column(6.0, 1.0, 0.3), block([3.0, 4.0], [-4.0, -3.0])]);
    let frame = frame_of(&scene, AT, Attitude::LEVEL_NORTH);
    let yaw = 0.35;
    let mut late = input(&frame, Attitude::from_euler_rad(0.0, 0.1, yaw));
    late.now_ns += 80_000_000;
    late.velocity_m_s = NedVector::new(1.5, 0.2, 0.0).to_heading(yaw);
    let moved = NedVector::new(0.12, 0.016, 0.0);
    let mut surroundings = RangeScan::new();
    let scan = surroundings.observe(&late);
    assert!(scan.points().count() > 8);
    for (x, y, range_m) in scan.points() {
        let ned = AT + moved + HeadingVector::new(x, y, 0.0).to_ned(yaw);
        assert!(scene.distance(ned) < 0.05, "{ned:?}");
        assert!((x.hypot(y) - range_m).abs() < 1e-4);
    }
}
