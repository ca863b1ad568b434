//! What every generated course promises.

use std::sync::LazyLock;
use vigil_sim::world::{
    Course, Family, HARD_CORRIDOR_MARGIN_M, Mover, Overhang, Solid, VEHICLE, Wall, World, generate, generate_long,
};

const SEEDS: u64 = 150;

/// The courses of a family, made once for all tests.
fn courses(family: Family) -> impl Iterator<Item = &'static Course> {
    static ALL: LazyLock<[Vec<Course>; 5]> =
        LazyLock::new(|| Family::ALL.map(|family| (0..SEEDS).map(|seed| generate(family, seed)).collect()));
    ALL[family as usize].iter()
}

/// Plan distance from a point to the nearest obstacle that reaches into the band of heights around the flight height.
fn plan_clearance_m(course: &Course, north_m: f32, east_m: f32) -> f32 {
    let half_m = 0.5 * VEHICLE.height_m + course.corridor_margin_m();
    let band = (course.flight_height_m - half_m)..(course.flight_height_m + half_m);
    let solids = course.corridor_solids();
    let in_band = solids
        .iter()
        .filter(|s| s.bottom_m() < band.end && s.top_m() > band.start);
    in_band
        .map(|s| s.plan_distance_m(north_m, east_m))
        .fold(f32::INFINITY, f32::min)
}

/// Points along a path, so many steps a stretch.
fn along(path: &[[f32; 2]], steps: u8) -> impl Iterator<Item = [f32; 2]> {
    path.windows(2).flat_map(move |ends| {
        let share = move |k: u8| f32::from(k) / f32::from(steps);
        (0..=steps).map(move |k| [0, 1].map(|i| ends[0][i] + share(k) * (ends[1][i] - ends[0][i])))
    })
}

/// Where a mover is in 64 steps of a period.
fn places(mover: &Mover) -> impl Iterator<Item = Solid> {
    let step_ns = (mover.period_s() * 1e9 / 64.0) as u64;
    (0..64).map(move |k| mover.solid_at(step_ns * k))
}

#[test]
fn every_course_has_a_corridor_that_keeps_its_margin() {
    for course in Family::ALL.into_iter().flat_map(courses) {
        let path = course
            .corridor()
            .unwrap_or_else(|| panic!("{} has no path", course.name));
        assert_eq!(path.first(), Some(&[course.start.north_m, course.start.east_m]));
        assert_eq!(path.last(), Some(&[course.goal.north_m, course.goal.east_m]));
        for at in along(&path, 40) {
            assert!(course.bounds.contains_plan(at[0], at[1]));
            let clearance_m = plan_clearance_m(course, at[0], at[1]);
            let is_kept = clearance_m >= VEHICLE.radius_m + course.corridor_margin_m() - 0.01;
            assert!(is_kept, "{}: {clearance_m} m at {at:?}", course.name);
        }
    }
}

#[test]
fn every_course_is_valid_with_a_free_start_and_goal_and_survives_its_file() {
    for course in Family::ALL.into_iter().flat_map(courses) {
        course.check().unwrap_or_else(|e| panic!("{}: {e}", course.name));
        let text = course.to_toml_string().expect("writable");
        assert_eq!(&Course::from_toml_str(&text, "again").expect("readable"), course);
        let world = World::new(course);
        assert!(world.clearance_m(course.start_ned_m()) > 1.0);
        assert!(world.clearance_m(course.goal_ned_m()) > VEHICLE.radius_m);
    }
}

#[test]
fn the_same_seed_gives_the_same_course_and_others_differ() {
    for family in Family::ALL {
        assert_eq!(generate(family, 5), generate(family, 5));
        assert_ne!(generate(family, 5).solids(), generate(family, 6).solids());
    }
    let of = |family| generate(family, 5).solids();
    assert_ne!(of(Family::Training), of(Family::Validation));
}

#[test]
fn the_goal_is_the_papers_on_either_side() {
    let right = courses(Family::Validation).filter(|c| c.goal.east_m > 0.0).count() as f64 / SEEDS as f64;
    assert!((0.35..0.65).contains(&right), "{right}");
    assert!(courses(Family::Training).all(|c| c.goal.north_m == 20.0 && c.goal.east_m.abs() == 5.0));
}

#[test]
fn a_validation_course_has_every_kind_of_obstacle_and_blocks_the_straight_way() {
    let (mut blocked, mut complete) = (0, 0);
    for course in courses(Family::Validation) {
        blocked += u32::from(course.straight_line_is_blocked());
        let (columns, boxes, walls) = (course.columns.len(), course.boxes.len(), course.walls.len());
        let kinds = [columns, boxes, walls, course.overhangs.len()];
        complete += u32::from(kinds.iter().all(|n| *n > 0));
        assert!(kinds.iter().sum::<usize>() >= 8, "{}: {kinds:?}", course.name);
    }
    let most = 0.9 * SEEDS as f64;
    assert!(
        f64::from(blocked) >= most,
        "{blocked} of {SEEDS} straight lines are blocked"
    );
    assert!(f64::from(complete) >= most, "{complete} of {SEEDS} have all kinds");
}

/// Doors: gaps between two walls in one line, by the walls' ends that face each other.
fn doors(course: &Course) -> Vec<([f32; 2], f32)> {
    let across: Vec<_> = course
        .walls
        .iter()
        .filter(|w| w.from_m[1] == -9.0 || w.to_m[1] == 9.0)
        .filter(|w| w.from_m[1] != w.to_m[1] && (w.to_m[1] - w.from_m[1]).abs() < 17.0)
        .collect();
    across
        .chunks(2)
        .map(|pair| {
            let (a, b) = (pair[0].to_m, pair[1].from_m);
            let middle = [0, 1].map(|k| 0.5 * (a[k] + b[k]));
            (middle, (a[0] - b[0]).hypot(a[1] - b[1]))
        })
        .collect()
}

#[test]
fn a_hard_course_leads_through_narrow_doors_that_lie_aside_of_each_other() {
    let (mut two_or_more, mut lintels) = (0, 0);
    for course in courses(Family::Hard) {
        let (doors, name) = (doors(course), &course.name);
        assert!((1..=3).contains(&doors.len()), "{name}: {doors:?}");
        two_or_more += usize::from(doors.len() >= 2);
        let mut before_m = 0.0;
        for (middle, width_m) in &doors {
            assert!((1.58..=2.22).contains(width_m), "{name}: a door of {width_m} m");
            assert!((middle[1] - before_m).abs() > 1.0, "{name}: {doors:?}");
            before_m = middle[1];
            // A lintel is flown under: it hangs above the height that the corridor needs.
            let above = |o: &&Overhang| o.bottom_m >= 1.9 && o.solid().plan_distance_m(middle[0], middle[1]) < 0.0;
            lintels += course.overhangs.iter().filter(above).count();
        }
        // No path around: with the doors walled up there is none.
        let mut closed = course.clone();
        closed.walls.extend(doors.iter().map(|(middle, _)| Wall {
            from_m: [middle[0], middle[1] - 1.2],
            to_m: [middle[0], middle[1] + 1.2],
            thickness_m: 0.3,
            height_m: 3.0,
        }));
        assert!(closed.corridor().is_none(), "{name} has a path around its doors");
        assert!(course.straight_line_is_blocked());
    }
    assert!(two_or_more > 60 && lintels > 60, "{two_or_more} {lintels}");
}

#[test]
fn a_hard_course_can_be_flown_whenever_one_leaves() {
    for course in courses(Family::Hard).take(25) {
        for depart_s in [0.0, 4.7, 21.3, 60.0] {
            let arrival_s = course
                .earliest_arrival_s(depart_s)
                .unwrap_or_else(|| panic!("{}: no path from {depart_s} s on", course.name));
            assert!(arrival_s > depart_s + 14.0, "{}: {arrival_s} s", course.name);
        }
    }
}

#[test]
fn no_mover_keeps_any_point_of_the_way_for_good() {
    let mut blocked_at_times = 0;
    for course in courses(Family::Hard) {
        let path = course.corridor().expect("a path");
        let needed_m = VEHICLE.radius_m + HARD_CORRIDOR_MARGIN_M;
        for mover in &course.movers {
            let solids: Vec<Solid> = places(mover).collect();
            for at in along(&path, 20) {
                let is_clear = |s: &&Solid| s.plan_distance_m(at[0], at[1]) >= needed_m;
                let clear = solids.iter().filter(is_clear).count();
                blocked_at_times += usize::from(clear < 64);
                assert!(
                    clear >= 16,
                    "{}: {at:?} is free for {clear}/64 of the time",
                    course.name
                );
            }
        }
    }
    // The movers do get in the way.
    assert!(blocked_at_times > 1000, "{blocked_at_times}");
}

#[test]
fn movers_run_into_nothing_and_keep_away_from_start_and_goal() {
    let mut count = 0;
    for course in courses(Family::Hard) {
        count += course.movers.len();
        let solids = course.solids();
        for mover in &course.movers {
            assert!(mover.speed_m_s <= vigil_sim::world::MAX_MOVER_SPEED_M_S);
            for solid in places(mover) {
                let gap_m = solids.iter().map(|s| s.plan_gap_m(&solid)).fold(9.0, f32::min);
                assert!(gap_m > 0.2, "{}: {gap_m} m", course.name);
                assert!(solid.plan_distance_m(0.0, 0.0) > 2.4);
                assert!(solid.plan_distance_m(course.goal.north_m, course.goal.east_m) > 1.9);
            }
        }
    }
    assert!(count as u64 >= SEEDS, "{count}");
}

#[test]
fn a_dense_course_has_a_third_more_obstacles_than_a_validation_course() {
    let mean = |family| courses(family).map(|c| c.solids().len()).sum::<usize>() as f64 / SEEDS as f64;
    let (dense, validation) = (mean(Family::Dense), mean(Family::Validation));
    assert!(dense > 1.33 * validation, "{dense} against {validation}");
}

#[test]
fn a_forest_course_has_trees_with_thin_branches_apart_from_each_other_where_one_flies() {
    let (mut trees, mut branches, mut in_the_way, mut blocked) = (0, 0, 0, 0);
    for course in courses(Family::Forest) {
        let trunks = &course.columns;
        for wire in &course.wires {
            let trunk = trunks.iter().find(|c| [c.north_m, c.east_m] == wire.from_m[..2]);
            assert!(trunk.is_some_and(|c| wire.from_m[2] < c.height_m) && (0.005..=0.025).contains(&wire.radius_m));
        }
        let (wires, plan) = (&course.wires, course.corridor_solids());
        let branches_in_the_way = &plan[course.solids().len()..];
        // What ends at these heights, within a rounding, may be in the way or not.
        let within = |s: &&Solid| s.bottom_m() < 2.19 && s.top_m() > 0.81;
        for part in branches_in_the_way.iter().filter(within) {
            // The next tree but its own.
            let mut gaps_m: Vec<f32> = trunks.iter().map(|c| c.solid().plan_gap_m(part)).collect();
            gaps_m.sort_by(f32::total_cmp);
            assert!(gaps_m[1] > 1.9, "{}: {gaps_m:?}", course.name);
        }
        (trees, branches) = (trees + trunks.len(), branches + wires.len());
        in_the_way += branches_in_the_way.len();
        blocked += usize::from(course.straight_line_is_blocked());
    }
    let mean = |count: usize| count as f64 / SEEDS as f64;
    println!(
        "{} trees, {} branches, {} at flight height",
        mean(trees),
        mean(branches),
        mean(in_the_way)
    );
    assert!(mean(trees) > 15.0 && mean(branches) > 70.0 && mean(in_the_way) > 15.0);
    assert!(mean(blocked) > 0.9, "{blocked}");
}

/// Reported by the note on courses (docs/courses.md).
#[test]
fn figures_of_the_families() {
    for family in Family::ALL {
        let (mut blocked, mut obstacles, mut detour) = (0, 0, 0.0);
        for course in courses(family) {
            blocked += usize::from(course.straight_line_is_blocked());
            obstacles += course.solids().len() + course.movers.len();
            let path = course.corridor().expect("a path");
            let length: f32 = path
                .windows(2)
                .map(|l| (l[1][0] - l[0][0]).hypot(l[1][1] - l[0][1]))
                .sum();
            detour += f64::from(length) / 425f64.sqrt();
        }
        let n = SEEDS as f64;
        println!(
            "{family}: {:.0} % of straight lines blocked, {:.1} obstacles, path {:.3} x the straight line",
            100.0 * blocked as f64 / n,
            obstacles as f64 / n,
            detour / n
        );
        assert!(detour / n >= 1.0);
    }
}

#[test]
fn a_long_course_is_its_arenas_in_a_row_with_a_way_through_and_limits_that_grow_with_it() {
    let lengths = [(1, 30.0), (2, 60.0), (3, 61.5), (4, 150.0), (5, 222.22), (6, 300.0)];
    let forests = [(7, 61.5), (8, 400.0)].map(|of| (Family::Forest, of));
    let of_validation = lengths.map(|of| (Family::Validation, of));
    for (family, (seed, goal_m)) in of_validation.into_iter().chain(forests) {
        let course = generate_long(family, seed, goal_m).expect("not hard");
        course.check().unwrap_or_else(|e| panic!("{}: {e}", course.name));
        let text = course.to_toml_string().expect("writable");
        assert_eq!(Course::from_toml_str(&text, "again").expect("readable"), course);
        assert_eq!(course, generate_long(family, seed, goal_m).expect("again"));
        assert_eq!(course.goal.north_m, goal_m);
        assert!(course.goal.east_m.abs() <= 5.0);
        assert!(course.bounds.contains_plan(goal_m + 4.0, course.goal.east_m));
        assert!(course.corridor().is_some() && course.straight_line_is_blocked());
        assert!((course.time_limit_s - 90.0 * goal_m / 20.0).abs() < 0.1);
        let in_order = course.checkpoints.windows(2).all(|c| c[0].north_m < c[1].north_m);
        let spacing_m = goal_m / (course.checkpoints.len() as f32 + 1.0);
        assert!(in_order && (4.0..8.0).contains(&spacing_m), "{spacing_m}");

        // As dense as the family, along all of its length.
        let obstacles_in = |course: &Course, from_m: f32, to_m: f32| {
            let centres = course.solids().into_iter().map(|s| s.centre_ned_m().x);
            centres.filter(|north_m| (from_m..to_m).contains(north_m)).count() as f32
        };
        let usual = courses(family).map(|c| obstacles_in(c, 0.0, 20.0)).sum::<f32>() / SEEDS as f32;
        let here = obstacles_in(&course, 0.0, goal_m) * 20.0 / goal_m;
        assert!(
            (0.5 * usual..1.7 * usual).contains(&here),
            "{}: {here} of {usual}",
            course.name
        );
    }
    assert_eq!(generate_long(Family::Hard, 1, 100.0), None);
    let solids = |seed| generate_long(Family::Validation, seed, 100.0).map(|course| course.solids());
    for other in [2, 1 + (1 << 55), 1 + (1 << 63)] {
        assert_ne!(solids(1), solids(other), "{other}");
    }
}
