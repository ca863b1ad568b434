//! Wires: seen where a cylinder would be, within what the pages say; touched; flown around.

#[path = "common/flown.rs"]
mod flown;

use flown::fly;
use glamx::Vec3;
use vigil_sim::world::{
    Course, LIDAR_BEAMS, LIDAR_FIRINGS, Lidar, LidarConfig, Outcome, World, beam_direction_frd, draw,
};
use vigil_types::{Attitude, NedVector};

fn course(wires: &str) -> Course {
    let text = format!(
        "name = \"test\"\ngoal = {{ north_m = 12.0, east_m = 0.0 }}\n\
         bounds = {{ north_m = [-3.0, 15.0], east_m = [-6.0, 6.0], top_m = 6.0 }}\n{wires}"
    );
    Course::from_toml_str(&text, "test.toml").unwrap_or_else(|e| panic!("{e}"))
}

fn wire(from_m: [f32; 3], to_m: [f32; 3], radius_m: f32) -> String {
    format!("[[wire]]\nfrom_m = {from_m:?}\nto_m = {to_m:?}\nradius_m = {radius_m:?}\n")
}

/// How near a ray from a place comes to a wire's axis, away from its ends, and how far along it does.
fn nearest(at: NedVector, direction: NedVector, [from, to]: [NedVector; 2]) -> Option<(f32, f32)> {
    let [at, d, from, to] = [at, direction, from, to].map(|v| Vec3::from(v.to_array()));
    let (u, w) = (to - from, at - from);
    let (a, b, c, e, f) = (d.dot(d), d.dot(u), u.dot(u), d.dot(w), u.dot(w));
    let [range_m, share] = [b * f - c * e, a * f - b * e].map(|x| x / (a * c - b * b));
    let gap_m = (w + range_m * d - share * u).length();
    ((0.02..0.98).contains(&share) && range_m > 0.0).then_some((gap_m, range_m))
}

#[test]
fn a_beam_meets_a_wire_where_it_meets_a_cylinder_and_misses_it_where_it_falls_beside() {
    let at = NedVector::new(0.5, 0.3, -1.4);
    let mut lidar = Lidar::new(LidarConfig::default(), 1).expect("valid");
    for (from_m, to_m, radius_m) in [
        ([3.0, -2.0, 1.4], [3.4, 2.5, 1.7], 0.05),
        ([2.0, 0.1, 0.3], [2.0, 0.1, 3.0], 0.02),
        ([4.0, -3.0, 0.6], [1.5, 2.0, 2.4], 0.005),
        ([9.0, 3.0, 3.0], [3.0, 0.0, 1.0], 0.01),
    ] {
        let world = World::new(&course(&wire(from_m, to_m, radius_m)));
        let empty = World::new(&course(""));
        let ends = [from_m, to_m].map(|[n, e, h]| NedVector::new(n, e, -h));
        let without = lidar.cast(&empty, at, Attitude::LEVEL_NORTH).to_vec();
        let seen = lidar.cast(&world, at, Attitude::LEVEL_NORTH);
        let (mut met, mut beside) = (0, 0);
        for beam in 0..LIDAR_BEAMS {
            let direction = beam_direction_frd(beam / LIDAR_FIRINGS, beam % LIDAR_FIRINGS);
            let direction = Attitude::LEVEL_NORTH.to_ned(direction);
            let Some((gap_m, range_m)) = nearest(at, direction, ends) else {
                continue;
            };
            if gap_m < 0.92 * radius_m {
                // However flat the wire is met, a range is off by less than ten radii.
                assert!((seen[beam] - range_m).abs() < 10.0 * radius_m, "{beam}");
                met += 1;
            } else if gap_m > 1.08 * radius_m {
                assert_eq!(seen[beam], without[beam], "{beam}");
                beside += 1;
            }
        }
        assert!(met > 5 && beside > 1000, "{radius_m}: {met} {beside}");
    }
}

#[test]
fn who_flies_through_a_wire_collides_and_who_flies_over_it_does_not() {
    let across = course(&wire([6.0, -4.0, 1.0], [6.0, 4.0, 1.0], 0.005));
    // Every 6 mm.
    let straight_at = |course, height_m: f32| fly(course, &[[0.0, 0.0, -height_m], [12.0, 0.0, -height_m]], 6.0, 1).0;
    assert_eq!(straight_at(&across, 1.09), Some(Outcome::Collision));
    assert_eq!(straight_at(&across, 1.5), Some(Outcome::Success));
    // A wire's end, wholly within the body.
    let end = course(&wire([6.0, 0.0, 1.55], [6.0, 0.0, 1.45], 0.005));
    assert_eq!(straight_at(&end, 1.5), Some(Outcome::Collision));
    assert!((World::new(&across).clearance_m(NedVector::new(5.0, 1.0, -1.0)) - 0.995).abs() < 1e-3);
}

#[test]
fn a_way_leads_around_the_wires_at_flight_height_alone_and_pictures_have_them() {
    let blocking = course(&wire([6.0, -6.0, 1.5], [6.0, 3.0, 1.6], 0.02));
    let way = blocking.corridor().expect("around its end");
    assert!(way.iter().any(|[_, east_m]| *east_m > 3.8), "{way:?}");
    assert!(blocking.straight_line_is_blocked());
    let across = |from_m, to_m| course(&wire([6.0, -6.0, from_m], [6.0, 6.0, to_m], 0.02)).corridor();
    assert_eq!(across(1.5, 1.5), None);
    assert!(across(2.5, 2.5).is_some() && across(0.5, 0.5).is_some());
    // One that rises is passed where it is low.
    let way = across(0.2, 4.0).expect("below or above");
    assert!(way.iter().any(|[_, east_m]| east_m.abs() > 1.0), "{way:?}");
    assert_ne!(draw(&blocking, &[]), draw(&course(""), &[]));
    let again = Course::from_toml_str(&blocking.to_toml_string().expect("writable"), "again");
    assert_eq!(again.expect("readable"), blocking);
    assert_eq!(blocking.shown_solids().len(), 1);
    let rising = course(&wire([6.0, -6.0, 0.0], [6.0, 6.0, 3.0], 0.02));
    assert_eq!(rising.shown_solids().len(), 16);
}
