//! Courses seen by other sensors: their point clouds and depth images, cast by a ray caster of its own and projected, are held against
//! the frame that the LiDAR model takes from the same place.

#[path = "common/rays.rs"]
mod rays;

use vigil_sensors::{Counts, Mount, Pinhole, ProjectionError, Projector, Resolution, View};
use vigil_sim::world::{Family, Lidar, LidarConfig, Shot, World, generate};
use vigil_types::{
    Attitude, DEPTH_COLS, DEPTH_PIXELS, DEPTH_ROWS, DepthFrame, FrdVector, NedVector, column_bearing_rad,
    row_elevation_rad,
};

const REACH_M: f64 = 60.0;

/// The direction of an elevation and a bearing, radians.
fn towards(elevation: f32, bearing: f32) -> FrdVector {
    let (e, b) = (elevation, bearing);
    FrdVector::new(e.cos() * b.cos(), e.cos() * b.sin(), -e.sin())
}

struct Scene {
    world: World,
    position: NedVector,
    attitude: Attitude,
    lidar: Box<DepthFrame>,
}

/// A course from above its start, the vehicle rolled and pitched as in flight, seen by the LiDAR model without noise.
fn scene(seed: u64) -> Scene {
    let course = generate(Family::Validation, seed);
    let world = World::new(&course);
    let start = course.start_ned_m();
    let position = NedVector::new(start.x, start.y, -course.flight_height_m);
    let attitude = Attitude::from_euler_rad(0.06, -0.08, 0.2);
    let mut lidar = Box::new(DepthFrame::EMPTY);
    Lidar::new(LidarConfig::ideal(), seed).expect("a sensor").capture(
        &world,
        &Shot::at(position, attitude),
        &mut lidar,
    );
    Scene {
        world,
        position,
        attitude,
        lidar,
    }
}

impl Scene {
    /// The point that a sensor measures along `direction` of its own axes; they are turned into the vehicle's by `turn` and sit at
    /// `offset`.
    fn point(&self, (offset, turn): (FrdVector, Attitude), direction: FrdVector) -> FrdVector {
        let in_world = self.attitude.to_ned(rays::in_vehicle(turn, direction));
        let from = self.position + self.attitude.to_ned(offset);
        let met = rays::cast(&self.world, from, in_world).filter(|(range_m, _)| *range_m < REACH_M);
        met.map_or(FrdVector::ZERO, |(range_m, _)| {
            direction * (range_m as f32 / direction.norm())
        })
    }

    /// Whether all beams around a pixel's centre, two pixels to every side, meet the same solid.
    fn is_inside_a_surface(&self, row: usize, col: usize) -> bool {
        let met = |dr: f32, dc: f32| {
            let direction = towards(row_elevation_rad(row as f32 + dr), column_bearing_rad(col as f32 + dc));
            rays::cast(&self.world, self.position, self.attitude.to_ned(direction)).map(|(_, what)| what)
        };
        let here = met(0.0, 0.0);
        let sides = [-2.0, 0.0, 2.0];
        sides.iter().all(|dr| sides.iter().all(|dc| met(*dr, *dc) == here))
    }
}

/// How an image compares with the LiDAR model's, over the pixels inside surfaces within reach of both that `counts` picks.
#[derive(Debug)]
struct Agreement {
    median_m: f32,
    within_03_m: f32,
    /// Share of the model's returns that the image lacks, and of the model's open pixels in which it shows something.
    missing: f32,
    invented: f32,
}

fn agreement(scene: &Scene, depth: &[f32; DEPTH_PIXELS], counts: impl Fn(usize, usize) -> bool) -> Agreement {
    let (mut errors_m, mut missing, mut invented, mut open) = (Vec::new(), 0, 0, 0);
    for row in (2..DEPTH_ROWS - 2).step_by(3) {
        for col in (2..DEPTH_COLS - 2).step_by(3) {
            if !counts(row, col) || !scene.is_inside_a_surface(row, col) {
                continue;
            }
            let (ours, theirs) = (depth[row * DEPTH_COLS + col], scene.lidar.depth[row * DEPTH_COLS + col]);
            match (ours < 1.0, theirs < 1.0) {
                (true, true) => errors_m.push((ours - theirs).abs() * 100.0),
                (false, true) => missing += 1,
                (true, false) => invented += 1,
                (false, false) => {}
            }
            open += usize::from(theirs >= 1.0);
        }
    }
    errors_m.sort_by(f32::total_cmp);
    assert!(errors_m.len() > 800, "{} pixels", errors_m.len());
    let n = errors_m.len();
    Agreement {
        median_m: errors_m[n / 2],
        within_03_m: errors_m.iter().filter(|e| **e <= 0.3).count() as f32 / n as f32,
        missing: missing as f32 / (n + missing) as f32,
        invented: invented as f32 / open.max(1) as f32,
    }
}

fn is_good(a: &Agreement) -> bool {
    a.median_m < 0.03 && a.within_03_m > 0.97 && a.missing < 0.02 && a.invented < 0.02
}

/// Directions of a turning scanner: `rings` over ±`half_height_deg`, `firings` over all around.
fn scanner(rings: usize, firings: usize, half_height_deg: f32) -> impl Iterator<Item = FrdVector> {
    (0..rings).flat_map(move |ring| {
        let elevation = (half_height_deg - (ring as f32 + 0.5) * 2.0 * half_height_deg / rings as f32).to_radians();
        (0..firings).map(move |firing| {
            let bearing = ((firing as f32 + 0.3) * 360.0 / firings as f32 - 180.0).to_radians();
            towards(elevation, bearing)
        })
    })
}

#[test]
fn a_scanners_point_cloud_becomes_the_image_that_the_lidar_model_takes() {
    for (rings, half_height_deg) in [(128, 45.0), (64, 45.0), (64, 32.0)] {
        for seed in [7, 8, 9] {
            let scene = scene(seed);
            let offset = FrdVector::new(0.08, 0.0, -0.05);
            let turn = Attitude::from_euler_rad(0.0, 0.05, 0.0);
            let mount = Mount::new(offset, turn).unwrap();
            let resolution = Resolution::of_degrees(360.0 / 1024.0, 2.0 * half_height_deg / rings as f32).unwrap();
            let mut projector = Projector::new(resolution);
            let points = scanner(rings, 1024, half_height_deg).map(|d| scene.point((offset, turn), d));
            let counts = projector.add_points(&mount, points);
            assert_eq!(counts.total() as usize, rings * 1024);
            assert!(
                counts.out_of_view > counts.used,
                "a third of the turn, at most, is in view: {counts:?}"
            );
            let mut depth = [1.0; DEPTH_PIXELS];
            projector.finish(&mut depth);
            let agreement = agreement(&scene, &depth, |row, _| row < 118);
            println!("{rings} rings over {half_height_deg}°, course {seed}: {agreement:?}");
            assert!(is_good(&agreement), "{rings} rings, course {seed}: {agreement:?}");
        }
    }
}

#[test]
fn a_cameras_depth_image_becomes_the_part_of_the_image_that_it_sees() {
    // A camera as wide as many (87° × 58°), of usual and of low resolution.
    for (width, height) in [(424, 240), (160, 90)] {
        for seed in [7, 8, 9] {
            let scene = scene(seed);
            let focal = 0.5 * width as f32 / 43.5f32.to_radians().tan();
            let centre = [0.5 * width as f32 - 0.5, 0.5 * height as f32 - 0.5];
            let camera = Pinhole::new([width, height], [focal; 2], centre).unwrap();
            let ray = |pixel: usize| {
                let (u, v) = ((pixel % width) as f32, (pixel / width) as f32);
                FrdVector::new(focal, u - centre[0], v - centre[1])
            };
            let depth_mm = |pixel: usize| {
                let point = scene.point((FrdVector::ZERO, Attitude::LEVEL_NORTH), ray(pixel));
                (point.x * 1000.0).round() as u16
            };
            let depth_mm: Vec<u16> = (0..width * height).map(depth_mm).collect();
            let mut projector = Projector::new(camera.resolution().unwrap());
            let mut depth = [1.0; DEPTH_PIXELS];
            let counts = projector
                .add_depth_units(&Mount::STRAIGHT, &camera, &depth_mm, 0.001)
                .unwrap();
            assert_eq!(counts.total() as usize, width * height);
            projector.finish(&mut depth);
            let (across, down) = (43.0f32, 26.0f32);
            let sees = |row: usize, col: usize| {
                let (e, b) = (row_elevation_rad(row as f32), column_bearing_rad(col as f32));
                (b.to_degrees().abs() < across - 1.0) && (e.tan() / b.cos()).atan().to_degrees().abs() < down - 1.0
            };
            let agreement = agreement(&scene, &depth, sees);
            println!("{width} x {height}, course {seed}: {agreement:?}");
            assert!(is_good(&agreement), "{width} x {height}, course {seed}: {agreement:?}");
            // Outside the camera's view nothing is made up.
            for (pixel, value) in depth.iter().enumerate() {
                if column_bearing_rad((pixel % DEPTH_COLS) as f32).to_degrees().abs() > 44.5 {
                    assert_eq!(*value, 1.0);
                }
            }
            // Metres say the same as millimetres.
            let depth_m: Vec<f32> = depth_mm.iter().map(|mm| f32::from(*mm) * 0.001).collect();
            let mut again = [1.0; DEPTH_PIXELS];
            projector.add_depth_m(&Mount::STRAIGHT, &camera, &depth_m).unwrap();
            projector.finish(&mut again);
            assert_eq!(depth, again);
        }
    }
}

#[test]
fn two_cameras_side_by_side_see_the_whole_width_as_one() {
    let camera = Pinhole::new([320, 240], [200.0; 2], [159.5, 119.5]).unwrap();
    let mut projector = Projector::new(camera.resolution().unwrap());
    let wall = vec![4.0; 320 * 240];
    for yaw_deg in [-35.0f32, 35.0] {
        let turn = Attitude::from_euler_rad(0.0, 0.0, yaw_deg.to_radians());
        let mount = Mount::new(FrdVector::ZERO, turn).unwrap();
        projector.add_depth_m(&mount, &camera, &wall).unwrap();
    }
    let mut depth = [1.0; DEPTH_PIXELS];
    projector.finish(&mut depth);
    let view = View::of(&depth).unwrap();
    let [left, right] = view.across_deg;
    assert!(left < -59.9 && right > 59.9 && view.is_whole(), "{view}");
    projector.add_depth_m(&Mount::STRAIGHT, &camera, &wall).unwrap();
    projector.finish(&mut depth);
    let one = View::of(&depth).unwrap();
    let ([left, _], [_, top]) = (one.across_deg, one.up_deg);
    assert!(
        !one.is_whole() && (left + 38.6).abs() < 0.5 && (top - 30.0).abs() < 0.5,
        "{one}"
    );
}

#[test]
fn what_is_no_measurement_is_counted_by_its_name_and_leaves_no_mark() {
    let mut projector = Projector::new(Resolution::of_degrees(1.0, 1.0).unwrap());
    let ahead = |x: f32| FrdVector::new(x, 0.0, 0.0);
    let given = [f32::NAN, f32::INFINITY, 0.0, 0.05, -3.0, 100.0, 1e30];
    let counts = projector.add_points(&Mount::STRAIGHT, given.map(ahead));
    let sorted = |counts: Counts| [counts.impossible, counts.no_return, counts.too_near];
    assert_eq!(sorted(counts), [2, 3, 1], "{counts:?}");
    assert_eq!((counts.out_of_view, counts.used), (1, 0), "{counts:?}");
    let camera = Pinhole::new([4, 2], [4.0; 2], [1.5, 0.5]).unwrap();
    let depth_m = [0.0, -1.0, f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.01, 200.0, 0.0];
    let counts = projector.add_depth_m(&Mount::STRAIGHT, &camera, &depth_m).unwrap();
    assert_eq!(sorted(counts), [3, 4, 1], "{counts:?}");
    let mut depth = [0.5; DEPTH_PIXELS];
    assert_eq!(projector.finish(&mut depth), 0);
    assert!(depth.iter().all(|v| *v == 1.0) && View::of(&depth).is_none());
    for pixels in [0, 7, 9] {
        let wrong = projector.add_depth_units(&Mount::STRAIGHT, &camera, &vec![1000; pixels], 0.001);
        let error = ProjectionError::ImageSize {
            pixels,
            width: 4,
            height: 2,
        };
        assert_eq!(wrong, Err(error));
    }
    assert!(Resolution::of_degrees(0.0, 1.0).is_err() && Resolution::of_degrees(1.0, f32::NAN).is_err());
}

#[test]
fn a_thin_pole_before_a_wall_stays_and_the_next_picture_begins_empty() {
    let mut projector = Projector::new(Resolution::of_degrees(0.5, 0.5).unwrap());
    let wall = |y: i32, z: i32| FrdVector::new(20.0, y as f32 * 0.1, z as f32 * 0.1);
    let all = (-100..100).flat_map(|y| (-50..50).map(move |z| wall(y, z)));
    let pole = (-50..50).map(|z| FrdVector::new(5.0, 0.01, z as f32 * 0.02));
    projector.add_points(&Mount::STRAIGHT, pole.chain(all));
    let mut depth = [1.0; DEPTH_PIXELS];
    projector.finish(&mut depth);
    let middle = &depth[64 * DEPTH_COLS..65 * DEPTH_COLS];
    assert!((middle[128] - 0.05).abs() < 1e-3, "{}", middle[128]);
    let thick = middle.iter().filter(|v| **v < 0.1).count();
    assert!((1..=3).contains(&thick), "{thick} columns");
    assert!(
        middle.iter().all(|v| *v < 0.051 || *v > 0.199),
        "nothing between pole and wall"
    );
    assert_eq!(projector.finish(&mut depth), 0);
}
