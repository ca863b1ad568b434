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

#[test]
fn both_methods_and_all_vector_widths_give_the_same_bits() {
    let mut hits = 0;
    for family in Family::ALL {
        for seed in 0..12 {
            let mut world = World::new(&generate(family, seed));
            let mut reference = Lidar::new(LidarConfig::default(), 1)
                .expect("valid")
                .with_method(Method::Reference);
            for (i, pose) in poses().enumerate() {
                world.set_time_ns(i as u64 * 3_700_000_000);
                let expected = bits(reference.cast(&world, pose.0, pose.1));
                hits += expected.iter().filter(|r| f32::from_bits(**r).is_finite()).count();
                let mut frame = DepthFrame::EMPTY;
                reference.capture(&world, &shot(pose, i as u64), &mut frame);
                for simd in Simd::available() {
                    let mut fast = Lidar::new(LidarConfig::default(), 1).expect("valid");
                    fast.simd = simd;
                    assert_eq!(
                        bits(fast.cast(&world, pose.0, pose.1)),
                        expected,
                        "{family} {seed} {pose:?} {simd:?}"
                    );
                    let mut other = DepthFrame::EMPTY;
                    fast.capture(&world, &shot(pose, i as u64), &mut other);
                    assert!(frame == other, "{family} {seed} {pose:?} {simd:?}");
                }
            }
        }
    }
    assert!(hits > 1_000_000, "{hits}");
}

#[test]
fn a_thinned_sensor_sees_what_its_beams_meet() {
    for every in Lidar::EVERY {
        for seed in 0..12 {
            let world = World::new(&generate(Family::Validation, seed));
            let sensor = || Lidar::new(LidarConfig::default(), 1).expect("valid").every(every);
            let (mut fast, mut reference) = (sensor(), sensor().with_method(Method::Reference));
            for pose in poses() {
                let expected = bits(reference.cast(&world, pose.0, pose.1));
                assert_eq!(
                    bits(fast.cast(&world, pose.0, pose.1)),
                    expected,
                    "{every} {seed} {pose:?}"
                );
            }
        }
    }
}
