//! What every generated course promises.

use vigil_world::{CORRIDOR_MARGIN_M, Course, Family, VEHICLE, World, generate};

const SEEDS: u64 = 150;

fn courses(family: Family) -> impl Iterator<Item = Course> {
    (0..SEEDS).map(move |seed| generate(family, seed))
}

/// Plan distance from a point to the nearest obstacle that reaches into the band of heights around the flight height.
fn plan_clearance_m(course: &Course, north_m: f32, east_m: f32) -> f32 {
    let half_m = 0.5 * VEHICLE.height_m + CORRIDOR_MARGIN_M;
    let band = (course.flight_height_m - half_m)..(course.flight_height_m + half_m);
    let solids = course.solids();
    let in_band = solids
        .iter()
        .filter(|s| s.bottom_m() < band.end && s.top_m() > band.start);
    in_band
        .map(|s| s.plan_distance_m(north_m, east_m))
        .fold(f32::INFINITY, f32::min)
}

#[test]
fn every_course_has_a_corridor_that_keeps_its_margin() {
    for family in Family::ALL {
        for course in courses(family) {
            let way = course
                .corridor()
                .unwrap_or_else(|| panic!("{} has no way", course.name));
            assert_eq!(way.first(), Some(&[course.start.north_m, course.start.east_m]));
            assert_eq!(way.last(), Some(&[course.goal.north_m, course.goal.east_m]));
            for leg in way.windows(2) {
                let steps = 40;
                for k in 0..=steps {
                    let f = k as f32 / steps as f32;
                    let at = [0, 1].map(|i| leg[0][i] + f * (leg[1][i] - leg[0][i]));
                    assert!(course.bounds.contains_plan(at[0], at[1]));
                    let clearance_m = plan_clearance_m(&course, at[0], at[1]);
                    assert!(
                        clearance_m >= VEHICLE.radius_m + CORRIDOR_MARGIN_M - 0.01,
                        "{}: {clearance_m} m at {at:?}",
                        course.name
                    );
                }
            }
        }
    }
}

#[test]
fn every_course_is_valid_and_survives_its_file() {
    for family in Family::ALL {
        for course in courses(family) {
            course.check().unwrap_or_else(|e| panic!("{}: {e}", course.name));
            let text = course.to_toml_string().expect("writable");
            assert_eq!(Course::from_toml_str(&text, "again").expect("readable"), course);
        }
    }
}

#[test]
fn the_same_seed_gives_the_same_course_and_others_differ() {
    for family in Family::ALL {
        assert_eq!(generate(family, 5), generate(family, 5));
        assert_ne!(generate(family, 5).solids(), generate(family, 6).solids());
    }
    assert_ne!(
        generate(Family::Training, 5).solids(),
        generate(Family::Validation, 5).solids()
    );
}

#[test]
fn the_goal_is_the_papers_on_either_side() {
    let right = courses(Family::Validation).filter(|c| c.goal.east_m > 0.0).count() as f64 / SEEDS as f64;
    assert!((0.35..0.65).contains(&right), "{right}");
    assert!(courses(Family::Training).all(|c| c.goal.north_m == 20.0 && c.goal.east_m.abs() == 5.0));
}

#[test]
fn a_validation_course_has_every_kind_of_obstacle_and_blocks_the_straight_way() {
    let mut blocked = 0;
    let mut complete = 0;
    for course in courses(Family::Validation) {
        blocked += usize::from(course.straight_line_is_blocked());
        let kinds = [
            course.columns.len(),
            course.boxes.len(),
            course.walls.len(),
            course.overhangs.len(),
        ];
        complete += usize::from(kinds.iter().all(|n| *n > 0));
        assert!(kinds.iter().sum::<usize>() >= 8, "{}: {kinds:?}", course.name);
    }
    assert!(
        blocked as f64 >= 0.9 * SEEDS as f64,
        "{blocked} of {SEEDS} straight lines are blocked"
    );
    assert!(
        complete as f64 >= 0.9 * SEEDS as f64,
        "{complete} of {SEEDS} have all kinds"
    );
}

#[test]
fn the_start_is_free_and_the_vehicle_can_stand_there() {
    for family in Family::ALL {
        for course in courses(family) {
            let world = World::new(&course);
            assert!(world.clearance_m(course.start_ned_m()) > 1.0);
            assert!(world.clearance_m(course.goal_ned_m()) > VEHICLE.radius_m);
        }
    }
}

/// Reported by the note on courses (docs/courses.md).
#[test]
fn figures_of_the_families() {
    for family in Family::ALL {
        let (mut blocked, mut obstacles, mut detour) = (0, 0, 0.0);
        for course in courses(family) {
            blocked += usize::from(course.straight_line_is_blocked());
            obstacles += course.solids().len();
            let way = course.corridor().expect("a way");
            let length: f32 = way
                .windows(2)
                .map(|l| (l[1][0] - l[0][0]).hypot(l[1][1] - l[0][1]))
                .sum();
            detour += f64::from(length) / 425f64.sqrt();
        }
        let n = SEEDS as f64;
        println!(
            "{family}: {:.0} % of straight lines blocked, {:.1} obstacles, way {:.3} x the straight line",
            100.0 * blocked as f64 / n,
            obstacles as f64 / n,
            detour / n
        );
        assert!(detour / n >= 1.0);
    }
}
