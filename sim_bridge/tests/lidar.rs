//! What the depth image shows, checked by marching through the course's distance field, which shares nothing with the caster.

use vigil_sim::world::{Course, Family, Lidar, LidarConfig, Shot, Solid, World, generate, ring_row};
use vigil_types::{
    Attitude, DEPTH_COLS, DEPTH_ROWS, DepthFrame, FrdVector, NedVector, column_bearing_rad, row_elevation_rad,
};

/// Range along a pixel's ray by sphere tracing; `None` beyond `max_m`.
fn march_m(course: &Course, solids: &[Solid], from: NedVector, direction: NedVector, max_m: f32) -> Option<f32> {
    let mut t = 0.0;
    for _ in 0..20_000 {
        let distance_m = surface_distance_m(course, solids, from + direction * t);
        if distance_m < 2e-4 {
            return Some(t);
        }
        t += distance_m;
        if t > max_m {
            return None;
        }
    }
    Some(t)
}

/// Distance from a point to the nearest surface: obstacle, ground or ceiling.
fn surface_distance_m(course: &Course, solids: &[Solid], at: NedVector) -> f32 {
    let ceiling_m = course.ceiling_height_m.map_or(f32::INFINITY, |c| (c + at.z).max(0.0));
    let planes_m = (-at.z).max(0.0).min(ceiling_m);
    solids.iter().map(|s| s.distance_m(at)).fold(planes_m, f32::min)
}

fn pixel_direction_frd(row: usize, col: usize) -> FrdVector {
    let (e, b) = (row_elevation_rad(row as f32), column_bearing_rad(col as f32));
    FrdVector::new(e.cos() * b.cos(), e.cos() * b.sin(), -e.sin())
}

fn shot(position_ned_m: NedVector, attitude: Attitude, sequence: u64) -> Shot {
    Shot {
        stamp_ns: sequence * 50_000_000,
        sequence,
        sensor_id: 3,
        ..Shot::at(position_ned_m, attitude)
    }
}

fn poses() -> [(NedVector, Attitude); 3] {
    [
        ([0.0, 0.0, -1.5], [0.0; 3]),
        ([2.0, 0.5, -1.4], [0.15, -0.2, 0.5]),
        ([1.0, -1.0, -1.7], [-0.3, 0.1, -0.7]),
    ]
    .map(|([n, e, d], [roll, pitch, yaw])| (NedVector::new(n, e, d), Attitude::from_euler_rad(roll, pitch, yaw)))
}

/// Level above the start.
fn above_start(height_m: f32, sequence: u64) -> Shot {
    shot(NedVector::new(0.0, 0.0, -height_m), Attitude::LEVEL_NORTH, sequence)
}

fn capture(config: LidarConfig, seed: u64, course: &Course, shot: &Shot) -> Box<DepthFrame> {
    let mut frame = Box::new(DepthFrame::EMPTY);
    Lidar::new(config, seed)
        .expect("valid")
        .capture(&World::new(course), shot, &mut frame);
    frame
}

fn range_m(frame: &DepthFrame, row: usize, col: usize) -> f32 {
    frame.range_m(row, col).expect("in the image")
}

fn open_field() -> Course {
    let mut course = generate(Family::Training, 0);
    course.clear_obstacles();
    course.ceiling_height_m = None;
    course
}

#[test]
fn an_ideal_sensors_measured_rows_show_the_true_ranges() {
    let (mut compared, mut silhouettes) = (0, 0);
    for seed in 0..4 {
        let course = generate(Family::Validation, seed);
        let solids = course.solids();
        for (position, attitude) in poses() {
            let frame = capture(LidarConfig::ideal(), 0, &course, &shot(position, attitude, 0));
            assert_eq!(frame.check(3), Ok(()));
            for row in (0..DEPTH_ROWS).step_by(10) {
                for col in (0..DEPTH_COLS).step_by(5) {
                    let direction = attitude.to_ned(pixel_direction_frd(row, col));
                    let truth = march_m(&course, &solids, position, direction, 60.0).unwrap_or(100.0);
                    let seen = range_m(&frame, row, col);
                    compared += 1;
                    if (truth - seen).abs() > 0.01 + 1e-3 * truth {
                        silhouettes += 1;
                    }
                }
            }
        }
    }
    // A ray along a silhouette may count as a hit for one and as a miss for the other; the gap filler also acts at single pixels.
    assert!(compared > 7000, "{compared}");
    assert!(silhouettes * 500 < compared, "{silhouettes} of {compared}");
}

#[test]
fn no_range_appears_in_mid_air() {
    let (mut between, mut on_surface, mut phantoms) = (0, 0, 0);
    for seed in 0..6 {
        let course = generate(Family::Validation, seed);
        let solids = course.solids();
        for (position, attitude) in poses() {
            let frame = capture(LidarConfig::ideal(), 0, &course, &shot(position, attitude, 0));
            for row in (1..DEPTH_ROWS - 1).step_by(2) {
                for col in (0..DEPTH_COLS).step_by(3) {
                    let seen = range_m(&frame, row, col);
                    if seen >= 100.0 {
                        continue;
                    }
                    between += 1;
                    let point = position + attitude.to_ned(pixel_direction_frd(row, col)) * seen;
                    // A pixel's own size is allowed: half a pitch up or down may be where the surface ends.
                    let allowed_m = 0.02 + 0.0082 * seen;
                    if surface_distance_m(&course, &solids, point) <= allowed_m {
                        on_surface += 1;
                        continue;
                    }
                    let (above, below) = (range_m(&frame, row - 1, col), range_m(&frame, row + 1, col));
                    let lies_between = (above.min(below) - 1e-3..=above.max(below) + 1e-3).contains(&seen);
                    if !lies_between || (seen - above).abs().min((seen - below).abs()) > 0.11 {
                        phantoms += 1;
                    }
                }
            }
        }
    }
    assert!(between > 30_000, "{between}");
    assert!(on_surface * 1000 > between * 990, "{on_surface} of {between}");
    assert!(phantoms * 10_000 < between, "{phantoms} phantoms of {between}");
}

#[test]
fn the_ground_between_two_rings_is_interpolated_onto_the_ground() {
    let course = open_field();
    let frame = capture(LidarConfig::ideal(), 0, &course, &above_start(1.5, 0));
    for row in 70..DEPTH_ROWS - 1 {
        let expected = 1.5 / -row_elevation_rad(row as f32).sin();
        let seen = range_m(&frame, row, 128);
        assert!(
            (seen - expected).abs() < 2e-3 * expected,
            "row {row}: {seen} instead of {expected}"
        );
    }
    assert_eq!(range_m(&frame, 10, 128), 100.0, "the sky returns nothing");
}

#[test]
fn nothing_beyond_the_maximum_range_returns_and_what_is_nearer_than_the_minimum_is_shown_at_it() {
    let config = LidarConfig {
        max_range_m: 12.0,
        min_range_m: 1.0,
        ..LidarConfig::ideal()
    };
    let frame = capture(config, 0, &open_field(), &above_start(1.5, 0));
    assert!(frame.depth.iter().all(|d| *d <= 0.1201 || *d == 1.0));
    assert!(frame.depth.iter().any(|d| *d > 0.1 && *d < 0.12));
    let low = capture(config, 0, &open_field(), &above_start(0.4, 0));
    assert_eq!(range_m(&low, 126, 128), 1.0);
}

#[test]
fn noise_has_the_configured_size_and_no_bias() {
    let course = open_field();
    let pose = above_start(1.5, 0);
    let ideal = capture(LidarConfig::ideal(), 0, &course, &pose);
    for sigma_m in [0.02, 0.04] {
        let config = LidarConfig {
            range_noise_sigma_m: sigma_m,
            dropout_probability: 0.0,
            ..LidarConfig::default()
        };
        let noisy = capture(config, 9, &course, &pose);
        let rows = (ring_row(45)..DEPTH_ROWS).step_by(2);
        let pixels = rows.flat_map(|row| (0..DEPTH_COLS).map(move |col| (row, col)));
        let error = |(row, col)| f64::from(range_m(&noisy, row, col) - range_m(&ideal, row, col));
        let errors: Vec<f64> = pixels.map(error).collect();
        let n = errors.len() as f64;
        let mean = errors.iter().sum::<f64>() / n;
        let sigma = (errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / n).sqrt();
        assert!(mean.abs() < 5.0 * f64::from(sigma_m) / n.sqrt(), "{mean}");
        assert!((sigma / f64::from(sigma_m) - 1.0).abs() < 0.05, "{sigma}");
    }
}

#[test]
fn the_seed_and_the_frames_number_fix_every_bit() {
    let course = generate(Family::Training, 2);
    let pose = |sequence| above_start(1.5, sequence);
    let config = LidarConfig::default();
    let frame = capture(config, 1, &course, &pose(7));
    assert_eq!(frame, capture(config, 1, &course, &pose(7)));
    assert_ne!(frame.depth, capture(config, 1, &course, &pose(8)).depth);
    assert_ne!(frame.depth, capture(config, 2, &course, &pose(7)).depth);
    // Order does not matter: the seventh frame of a flight is the seventh frame taken alone.
    let mut sensor = Lidar::new(config, 1).expect("valid");
    let world = World::new(&course);
    let mut last = Box::new(DepthFrame::EMPTY);
    for sequence in 0..8 {
        sensor.capture(&world, &pose(sequence), &mut last);
    }
    assert_eq!(frame, last);
}

#[test]
fn a_config_that_makes_no_sense_is_refused_by_field() {
    type Change = fn(&mut LidarConfig);
    let cases: [(Change, &str); 4] = [
        (|c| c.range_noise_sigma_m = f32::NAN, "`range_noise_sigma_m` is NaN"),
        (|c| c.dropout_probability = 1.5, "`dropout_probability` is 1.5"),
        (|c| c.max_range_m = 400.0, "`max_range_m` is 400"),
        (|c| c.min_range_m = 0.0, "`min_range_m` is 0"),
    ];
    for (change, expected) in cases {
        let mut config = LidarConfig::default();
        change(&mut config);
        let error = Lidar::new(config, 0).err().expect("must be refused").to_string();
        assert!(error.starts_with(&format!("lidar: {expected}")), "{error}");
    }
}
