use super::cast::cast_ray;
use super::*;
use crate::world::{Family, generate};

fn poses() -> impl Iterator<Item = (NedVector, Attitude)> {
    (0..12).map(|k| {
        let f = k as f32;
        (
            NedVector::new(1.7 * f, 4.0 * libm::sinf(f), -0.2 - 0.2 * f),
            Attitude::from_euler_rad(
                0.4 * libm::sinf(2.0 * f),
                0.5 * libm::sinf(3.0 * f),
                6.0 * libm::sinf(f),
            ),
        )
    })
}

fn bits(ranges: &Ranges) -> Vec<u32> {
    ranges.iter().map(|r| r.to_bits()).collect()
}

impl Lidar {
    /// The simple way to cast: every beam by itself.
    fn cast_one_by_one(&mut self, world: &World, (position_ned_m, attitude): (NedVector, Attitude)) -> &Ranges {
        self.scene.place(world, position_ned_m, attitude);
        let b = &self.beams;
        for (ring, firing) in (0..b.rings).flat_map(|ring| (0..b.firings).map(move |firing| (ring, firing))) {
            let (elevation, bearing) = (
                (b.sin_elevation[ring], b.cos_elevation[ring]),
                (b.sin_bearing[firing], b.cos_bearing[firing]),
            );
            let direction = self.scene.rotation.beam(elevation.0, elevation.1, bearing.0, bearing.1);
            self.ranges[ring * b.firings + firing] = cast_ray(&self.scene, direction);
        }
        &self.ranges
    }
}

/// A sensor of one beam in `every` has the same ranges ray by ray and strip by strip, and the same image, on all vector widths. How many rays
/// met something.
fn both_methods_agree(world: &mut World, every: usize, what: &str) -> usize {
    let sensor = || Lidar::new(LidarConfig::default(), 1).expect("valid").every(every);
    let (mut fast, mut reference, mut hits) = (sensor(), sensor(), 0);
    let (mut frame, mut expected_frame) = (Box::new(DepthFrame::EMPTY), Box::new(DepthFrame::EMPTY));
    for (i, pose) in (0..).zip(poses()) {
        world.set_time_ns(i * 3_700_000_000);
        let expected = bits(reference.cast_one_by_one(world, pose));
        hits += expected.iter().filter(|r| f32::from_bits(**r).is_finite()).count();
        reference.measure(i);
        reference.project(&mut expected_frame);
        for simd in Simd::available() {
            fast.simd = simd;
            let ranges = bits(fast.cast(world, pose.0, pose.1));
            assert_eq!(ranges, expected, "{what} {every} {simd:?} {pose:?}");
            fast.measure(i);
            fast.project(&mut frame);
            assert!(frame.depth == expected_frame.depth, "{what} {every} {simd:?} {pose:?}");
        }
    }
    hits
}

#[test]
fn both_methods_and_all_vector_widths_give_the_same_bits_and_thinned_sensors_see_what_their_beams_meet() {
    let mut hits = 0;
    for (family, seed) in Family::ALL
        .iter()
        .flat_map(|family| (0..4).map(move |seed| (*family, seed)))
    {
        let mut world = World::new(&generate(family, seed));
        let thinned = if family == Family::Validation { 4 } else { 1 };
        for every in &Lidar::EVERY[..thinned] {
            hits += both_methods_agree(&mut world, *every, &format!("{family} {seed}"));
        }
    }
    assert!(hits > 1_000_000, "{hits}");
}

/// So many triangles, up to so large, anywhere around.
fn soup(seed: u64, count: usize, size_m: f32) -> Vec<[NedVector; 3]> {
    let mut bits = seed;
    let mut next = |wide: f32| {
        bits = split_mix(bits);
        wide * ((bits >> 40) as f32 / (1u64 << 24) as f32 - 0.5)
    };
    let mut triangle = || {
        let at = NedVector::new(10.0 + next(30.0), next(24.0), -3.0 + next(5.0));
        [0; 3].map(|_| at + NedVector::new(next(size_m), next(size_m), next(size_m)))
    };
    (0..count).map(|_| triangle()).collect()
}

fn world_of(triangles: &[[NedVector; 3]]) -> World {
    let mut course = generate(Family::Validation, 1);
    course.clear_obstacles();
    course
        .meshes
        .push(crate::world::Mesh::of_triangles(triangles).expect("a mesh"));
    World::new(&course)
}

/// The ranges are parry's within a millimetre; at a rim, or along a surface, one of those that its rays have a four hundredth of a pixel aside.
#[test]
fn rays_meet_triangles_where_parry_says() {
    use parry3d::query::{Ray, RayCast};
    let (mut met, mut aside, mut wrong) = (0, 0, 0);
    for (seed, count, size_m) in [(1, 4000, 1.0), (2, 300, 8.0), (3, 40, 40.0), (4, 20_000, 0.2)] {
        let triangles = soup(seed, count, size_m);
        let world = world_of(&triangles);
        let points = triangles.iter().flatten().map(|p| p.to_array().into()).collect();
        let numbers = (0..count as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let theirs = parry3d::shape::TriMesh::new(points, numbers).expect("a mesh");
        let mut lidar = Lidar::new(LidarConfig::default(), 1).expect("valid");
        for (position_ned_m, attitude) in poses() {
            let ranges = *lidar.cast(&world, position_ned_m, attitude);
            for (beam, ours_m) in ranges.into_iter().enumerate().step_by(31) {
                let ours_m = ours_m.min(100.0);
                let direction = attitude.to_ned(beam_direction_frd(beam / LIDAR_FIRINGS, beam % LIDAR_FIRINGS));
                let range_m = |off: [f32; 3]| {
                    let direction = direction + NedVector::new(off[0], off[1], off[2]);
                    let ray = Ray::new(position_ned_m.to_array().into(), direction.to_array().into());
                    let ground_m = match direction.z > 0.0 {
                        true => -position_ned_m.z / direction.z,
                        false => f32::INFINITY,
                    };
                    // Nobody sees farther, and how far the ground is along a level ray is nobody's matter.
                    theirs
                        .cast_local_ray(&ray, 1e6, false)
                        .unwrap_or(f32::INFINITY)
                        .min(ground_m)
                        .min(100.0)
                };
                let agrees = |theirs_m: f32| ours_m == theirs_m || (ours_m - theirs_m).abs() < 1e-3 + 1e-5 * theirs_m;
                met += 1;
                if agrees(range_m([0.0; 3])) {
                    continue;
                }
                aside += 1;
                let around = [-2e-5, 0.0, 2e-5];
                let near = around
                    .iter()
                    .flat_map(|x| around.iter().flat_map(|y| around.map(|z| [*x, *y, z])));
                let near_m: Vec<f32> = near.map(range_m).collect();
                let (least_m, most_m) = near_m
                    .iter()
                    .fold((f32::INFINITY, 0.0_f32), |(l, m), r| (l.min(*r), m.max(*r)));
                let along = least_m - 1e-3 <= ours_m && ours_m <= most_m + 1e-3 && most_m - least_m < 1.0;
                wrong += usize::from(!along && !near_m.iter().any(|r| agrees(*r)));
            }
        }
    }
    assert!(met > 20_000 && aside < met / 500, "{met} {aside}");
    assert_eq!(wrong, 0, "of {met}, {aside} aside");
}

#[test]
fn triangles_are_met_the_same_ray_by_ray_and_strip_by_strip_on_all_vector_widths() {
    for (seed, count, size_m) in [(1, 4000, 1.0), (2, 300, 8.0), (3, 40, 40.0), (4, 20_000, 0.2)] {
        let mut world = world_of(&soup(seed, count, size_m));
        for every in Lidar::EVERY.into_iter().take(if seed < 3 { 4 } else { 1 }) {
            both_methods_agree(&mut world, every, &format!("triangles {seed}"));
        }
    }
}

#[test]
fn dropouts_are_filled_and_leave_no_holes() {
    let world = World::new(&generate(Family::Validation, 3));
    let config = LidarConfig {
        range_noise_sigma_m: 0.0,
        ..LidarConfig::default()
    };
    let mut sensor = Lidar::new(config, 4).expect("valid");
    let mut ideal_sensor = Lidar::new(LidarConfig::ideal(), 4).expect("valid");
    let (mut lost, mut holes, mut returns) = (0, 0, 0);
    let (mut frame, mut ideal) = (Box::new(DepthFrame::EMPTY), Box::new(DepthFrame::EMPTY));
    for k in 0..20 {
        let place = NedVector::new(0.2 * k as f32, 0.0, -1.5);
        let pose = Shot {
            sequence: k,
            ..Shot::at(place, Attitude::LEVEL_NORTH)
        };
        sensor.capture(&world, &pose, &mut frame);
        ideal_sensor.capture(&world, &pose, &mut ideal);
        let [all, left] = [&ideal_sensor, &sensor].map(|s| s.inverse.iter().filter(|q| **q > 0.0).count());
        returns += all;
        lost += all - left;
        let both = frame.depth.iter().zip(&ideal.depth);
        holes += both.filter(|(f, i)| **f == 1.0 && **i < 1.0).count();
    }
    let share = lost as f64 / returns as f64;
    assert!((share - 0.01).abs() < 0.001, "{share}");
    assert!(holes < lost / 20, "{holes} holes left by {lost} lost beams");
}
