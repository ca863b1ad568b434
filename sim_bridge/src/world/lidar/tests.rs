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

/// The simple way: every beam walks parry's tree.
fn cast_by_tree(world: &World, (sensor_ned_m, attitude): (NedVector, Attitude)) -> Vec<u32> {
    let (beams, mut scene) = (BeamTable::new(1), Scene::new());
    scene.place(world, sensor_ned_m, attitude);
    let range_m = |beam: usize| {
        let (ring, firing) = (beam / LIDAR_FIRINGS, beam % LIDAR_FIRINGS);
        let (sin_elevation, cos_elevation) = (beams.sin_elevation[ring], beams.cos_elevation[ring]);
        let (sin_bearing, cos_bearing) = (beams.sin_bearing[firing], beams.cos_bearing[firing]);
        let direction = scene
            .rotation
            .beam(sin_elevation, cos_elevation, sin_bearing, cos_bearing);
        cast::cast_ray(world, sensor_ned_m, &scene, direction)
    };
    (0..LIDAR_BEAMS).map(|beam| range_m(beam).to_bits()).collect()
}

#[test]
fn tiles_and_all_vector_widths_give_the_bits_of_parrys_tree() {
    let mut hits = 0;
    for family in Family::ALL {
        for seed in 0..12 {
            let mut world = World::new(&generate(family, seed));
            for (i, pose) in poses().enumerate() {
                world.set_time_ns(i as u64 * 3_700_000_000);
                let expected = cast_by_tree(&world, pose);
                hits += expected.iter().filter(|r| f32::from_bits(**r).is_finite()).count();
                let mut frames = Simd::available().into_iter().map(|simd| {
                    let mut lidar = Lidar::new(LidarConfig::default(), 1).expect("valid");
                    lidar.simd = simd;
                    let cast = bits(lidar.cast(&world, pose.0, pose.1));
                    assert_eq!(cast, expected, "{family} {seed} {pose:?} {simd:?}");
                    let mut frame = DepthFrame::EMPTY;
                    lidar.capture(&world, &shot(pose, i as u64), &mut frame);
                    frame
                });
                let first = frames.next().expect("a portable one");
                assert!(frames.all(|frame| frame == first), "{family} {seed} {pose:?}");
            }
        }
    }
    assert!(hits > 1_000_000, "{hits}");
}
