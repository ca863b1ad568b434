//! When a flight ends, and how.

#[path = "common/flown.rs"]
mod flown;

use flown::fly;
use vigil_sim::world::{Course, Outcome, Referee, World};
use vigil_types::{Attitude, NedVector};

const LEVEL: Attitude = Attitude::LEVEL_NORTH;
const MS: u64 = 1_000_000;

fn course(obstacles: &str) -> Course {
    let text = format!(
        r#"
name = "test"
time_limit_s = 30.0
goal = {{ north_m = 20.0, east_m = 0.0 }}
bounds = {{ north_m = [-4.0, 26.0], east_m = [-10.0, 10.0], top_m = 6.0 }}
checkpoint = [
    {{ north_m = 5.0, east_m = 0.0, heading_deg = 0.0 }},
    {{ north_m = 15.0, east_m = 0.0, heading_deg = 0.0 }},
]
{obstacles}
"#
    );
    Course::from_toml_str(&text, "test").expect("valid")
}

fn with_wall(thickness_m: f32) -> Course {
    course(&format!(
        "[[wall]]\nfrom_m = [10.0, -5.0]\nto_m = [10.0, 5.0]\nthickness_m = {thickness_m:?}\nheight_m = 3.0"
    ))
}

/// The verdict on a vehicle that is shown once, at rest.
fn shown(course: &Course, at: NedVector, attitude: Attitude) -> Option<Outcome> {
    Referee::new(course).observe(&World::new(course), 0, at, attitude, NedVector::ZERO)
}

#[test]
fn a_straight_flight_over_an_open_field_succeeds_at_the_goals_rim() {
    let way = [[0.0, 0.0, 0.0], [0.0, 0.0, -1.5], [20.0, 0.0, -1.5]];
    let (outcome, at, referee) = fly(&course(""), &way, 1.5, 4);
    assert_eq!(outcome, Some(Outcome::Success));
    assert!((at.x - 19.0).abs() < 0.02, "{at:?}");
    assert_eq!(referee.checkpoints_passed(), 2);
    let duration_s = referee.duration_s().expect("ended");
    assert!((duration_s - (1.5 + 19.0) / 1.5).abs() < 0.1, "{duration_s}");
}

#[test]
fn a_wall_in_the_way_is_hit_when_the_rim_touches_it() {
    let (outcome, at, referee) = fly(&with_wall(0.2), &[[0.0, 0.0, -1.5], [20.0, 0.0, -1.5]], 1.5, 4);
    assert_eq!(outcome, Some(Outcome::Collision));
    assert!((at.x - (10.0 - 0.1 - 0.3)).abs() < 0.02, "{at:?}");
    assert_eq!(referee.checkpoints_passed(), 1);
}

#[test]
fn a_thin_wall_is_not_tunnelled_however_rarely_the_truth_is_shown() {
    for period_ms in [1, 20, 100, 1000] {
        let way = [[0.0, 0.0, -1.5], [20.0, 0.0, -1.5]];
        let (outcome, ..) = fly(&with_wall(0.02), &way, 15.0, period_ms);
        assert_eq!(outcome, Some(Outcome::Collision), "every {period_ms} ms");
    }
}

#[test]
fn a_column_is_passed_at_35_cm_from_its_rim_and_an_overhang_flown_under_but_neither_is_flown_through() {
    let column = "[[column]]\nnorth_m = 10.0\neast_m = 0.0\nradius_m = 0.5\nheight_m = 3.0";
    let beam = "[[overhang]]\nnorth_m = 10.0\neast_m = 0.0\nlength_m = 0.4\nwidth_m = 8.0\ntop_m = 3.0\nbottom_m = ";
    for (obstacle, east_m, expected) in [
        (column.to_owned(), 0.85, None),
        (column.to_owned(), 0.75, Some(Outcome::Collision)),
        (format!("{beam}1.65"), 0.0, None),
        (format!("{beam}1.55"), 0.0, Some(Outcome::Collision)),
    ] {
        let way = [[0.0, east_m, -1.5], [18.0, east_m, -1.5]];
        assert_eq!(fly(&course(&obstacle), &way, 1.5, 4).0, expected, "{obstacle} {east_m}");
    }
}

/// A mover that crosses the way to the goal at 10 m north, east to west and back, at 1 m/s.
fn with_mover(phase: f32) -> Course {
    course(&format!(
        "[[mover]]\nfrom_m = [10.0, 4.0]\nto_m = [10.0, -4.0]\nspeed_m_s = 1.0\nphase = {phase:?}\nheight_m = 3.0\n\
         shape = {{ column = {{ radius_m = 0.3 }} }}"
    ))
}

#[test]
fn a_vehicle_that_hovers_is_hit_by_a_mover_when_their_rims_meet() {
    // Once with truths every millisecond, once so rarely that the mover passes the vehicle between two of them.
    for period_ms in [1, 3000] {
        let course = with_mover(0.0);
        let mut world = World::new(&course);
        let mut referee = Referee::new(&course);
        let at = NedVector::new(10.0, 0.0, -1.5);
        let hit_ms = (0..20_000).step_by(period_ms).find(|now_ms| {
            world.set_time_ns(now_ms * MS);
            let outcome = referee.observe(&world, now_ms * MS, at, LEVEL, NedVector::ZERO);
            outcome.is_some()
        });
        assert_eq!(referee.outcome(), Some(Outcome::Collision), "every {period_ms} ms");
        let hit_ms = hit_ms.expect("hit");
        if period_ms == 1 {
            // 4 m apart at first, 0.6 m when they touch.
            assert!((3390..=3410).contains(&hit_ms), "{hit_ms}");
        } else {
            assert_eq!(hit_ms, 6000);
        }
    }
}

#[test]
fn the_same_flight_passes_before_the_mover_or_hits_it_as_its_phase_says() {
    // At 1.5 m/s the vehicle is at the mover's line after 6.7 s; a period is 16 s. Brute force decides: the least distance
    // between two upright cylinders over time.
    let (mut hits, mut passes) = (0, 0);
    for k in 0..32 {
        let course = with_mover(k as f32 / 32.0);
        let place = |ms: u64| NedVector::new(1.5e-3 * ms as f32, 0.0, -1.5);
        let least_m = (0..12_000)
            .map(|ms| course.movers[0].solid_at(ms * MS).plan_distance_m(place(ms).x, 0.0) - 0.3)
            .fold(f32::INFINITY, f32::min);
        for period_ms in [1, 50, 500] {
            let mut world = World::new(&course);
            let mut referee = Referee::new(&course);
            for ms in (0..=12_000).step_by(period_ms) {
                world.set_time_ns(ms * MS);
                let velocity = NedVector::new(1.5, 0.0, 0.0);
                referee.observe(&world, ms * MS, place(ms), LEVEL, velocity);
            }
            // Truths are tested every 0.1 m of both ways together, so a touch that is less deep may be missed.
            let expected = (least_m < 0.0).then_some(Outcome::Collision);
            if least_m.abs() > 0.02 {
                let outcome = referee.outcome();
                assert_eq!(outcome, expected, "phase {k}/32, every {period_ms} ms: {least_m}");
            }
        }
        *(if least_m < 0.0 { &mut hits } else { &mut passes }) += 1;
    }
    assert!(hits >= 3 && passes >= 10, "{hits} {passes}");
}

#[test]
fn a_tilted_vehicle_reaches_higher_than_a_level_one() {
    let low = course("ceiling_height_m = 2.0");
    let at = NedVector::new(3.0, 0.0, -1.85);
    assert_eq!(shown(&low, at, LEVEL), None);
    let tilted = Attitude::from_euler_rad(0.4, 0.0, 0.0);
    assert_eq!(shown(&low, at, tilted), Some(Outcome::Collision));
}

#[test]
fn a_soft_landing_is_no_collision_and_a_fall_is() {
    let c = course("");
    let way = [[3.0, 0.0, -1.5], [3.0, 0.0, -0.05]];
    assert_eq!(fly(&c, &way, 0.5, 4).0, None);
    assert_eq!(fly(&c, &way, 4.0, 4).0, Some(Outcome::Collision));
    let on_its_side = Attitude::from_euler_rad(1.5, 0.0, 0.0);
    let outcome = shown(&c, NedVector::new(3.0, 0.0, -0.2), on_its_side);
    assert_eq!(outcome, Some(Outcome::Collision));
}

#[test]
fn leaving_sideways_or_upwards_is_out_of_bounds_and_so_is_no_position() {
    let c = course("");
    for beyond in [[3.0, 12.0, -1.5], [3.0, 0.0, -8.0]] {
        let (outcome, ..) = fly(&c, &[[3.0, 0.0, -1.5], beyond], 2.0, 4);
        assert_eq!(outcome, Some(Outcome::OutOfBounds));
    }
    let nowhere = NedVector::new(f32::NAN, 0.0, -1.5);
    assert_eq!(shown(&c, nowhere, LEVEL), Some(Outcome::OutOfBounds));
}

#[test]
fn hovering_past_the_time_limit_is_a_time_out_counted_from_the_first_truth() {
    let c = course("");
    let world = World::new(&c);
    let mut referee = Referee::new(&c);
    let at = NedVector::new(3.0, 0.0, -1.5);
    let start = 1_000_000 * MS;
    let mut observe = |ms: u64, at| referee.observe(&world, start + ms * MS, at, LEVEL, NedVector::ZERO);
    assert_eq!((observe(0, at), observe(29_999, at)), (None, None));
    assert_eq!(observe(30_000, at), Some(Outcome::TimeOut));
    // What comes after the end changes nothing.
    assert_eq!(observe(30_001, c.goal_ned_m()), Some(Outcome::TimeOut));
    assert!((referee.duration_s().expect("ended") - 30.0).abs() < 1e-6);
}
