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

fn shot((position_ned_m, attitude): (NedVector, Attitude), sequence: u64) -> Shot {
    Shot {
        stamp_ns: sequence * 50_000_000,
        sequence,
        sensor_id: 3,
        ..Shot::at(position_ned_m, attitude)
    }
}

fn bits(ranges: &Ranges) -> Vec<u32> {
    ranges.iter().map(|r| r.to_bits()).collect()
}

impl Lidar {
    /// The simple way to cast: every beam walks parry's tree.
    fn cast_by_tree(&mut self, world: &World, position_ned_m: NedVector, attitude: Attitude) -> &Ranges {
        self.scene.place(world, position_ned_m, attitude);
        let b = &self.beams;
        for (ring, firing) in (0..b.rings).flat_map(|ring| (0..b.firings).map(move |firing| (ring, firing))) {
            let (elevation, bearing) = (
                (b.sin_elevation[ring], b.cos_elevation[ring]),
                (b.sin_bearing[firing], b.cos_bearing[firing]),
            );
            let direction = self.scene.rotation.beam(elevation.0, elevation.1, bearing.0, bearing.1);
            self.ranges[ring * b.firings + firing] = cast_ray(world, position_ned_m, &self.scene, direction);
        }
        &self.ranges
    }
}

#[test]
fn both_methods_and_all_vector_widths_give_the_same_bits() {
    let mut hits = 0;
    for family in Family::ALL {
        for seed in 0..4 {
            let mut world = World::new(&generate(family, seed));
            let mut reference = Lidar::new(LidarConfig::default(), 1).expect("valid");
            for (i, pose) in poses().enumerate() {
                world.set_time_ns(i as u64 * 3_700_000_000);
                let expected = bits(reference.cast_by_tree(&world, pose.0, pose.1));
                hits += expected.iter().filter(|r| f32::from_bits(**r).is_finite()).count();
                let mut expected_frame = Box::new(DepthFrame::EMPTY);
                reference.measure(i as u64);
                reference.project(&mut expected_frame);
                for simd in Simd::available() {
                    let mut fast = Lidar::new(LidarConfig::default(), 1).expect("valid");
                    fast.simd = simd;
                    let ranges = bits(fast.cast(&world, pose.0, pose.1));
                    assert_eq!(ranges, expected, "{family} {seed} {pose:?} {simd:?}");
                    let mut frame = Box::new(DepthFrame::EMPTY);
                    fast.capture(&world, &shot(pose, i as u64), &mut frame);
                    let is_same = frame.depth == expected_frame.depth;
                    assert!(is_same, "{family} {seed} {pose:?} {simd:?}");
                }
            }
        }
    }
    assert!(hits > 1_000_000, "{hits}");
}

/// A sensor of one beam in `every` has the same ranges ray by ray and strip by strip, on all vector widths.
fn both_methods_agree(world: &World, every: usize, what: &str) {
    let sensor = || Lidar::new(LidarConfig::default(), 1).expect("valid").every(every);
    let (mut fast, mut reference) = (sensor(), sensor());
    for pose in poses() {
        let expected = bits(reference.cast_by_tree(world, pose.0, pose.1));
        for simd in Simd::available() {
            fast.simd = simd;
            let ranges = bits(fast.cast(world, pose.0, pose.1));
            assert_eq!(ranges, expected, "{what} {every} {simd:?} {pose:?}");
        }
    }
}

#[test]
fn a_thinned_sensor_sees_what_its_beams_meet() {
    for every in Lidar::EVERY {
        for seed in 0..4 {
            let world = World::new(&generate(Family::Validation, seed));
            both_methods_agree(&world, every, &format!("course {seed}"));
        }
    }
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
        let world = world_of(&soup(seed, count, size_m));
        for every in Lidar::EVERY.into_iter().take(if seed < 3 { 4 } else { 1 }) {
            both_methods_agree(&world, every, &format!("triangles {seed}"));
        }
    }
}
