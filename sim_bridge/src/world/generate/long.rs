//! Courses to far goals: arenas of a family, one behind the other.

use super::{CLEAR_GOAL_M, GOAL_DOWNRANGE_M, GOAL_OFFSET_M, cm, generate};
use crate::world::check::MAX_OBSTACLES;
use crate::world::course::{Column, Course, Family, Wall};
use crate::world::solid::Solid;
use crate::world::split_mix;
use crate::world::wire::Wire;

/// Nearest and farthest goal of a long course, metres.
pub const LONG_GOAL_M: core::ops::RangeInclusive<f32> = 5.0..=400.0;
/// Beyond the goal the course goes on for this long.
const BEYOND_GOAL_M: f32 = 5.0;
/// Seeds of arenas in a row: apart from all that anybody asks for.
const ARENA_SEEDS: u64 = 1 << 63;

/// A course of a family whose goal is `goal_north_m` north of home: the arenas that [`generate`] makes, each beginning at the goal
/// of the one before, the last one cut where the goal is. So its density is the family's at any length; bounds, checkpoints
/// and time limit grow with it. The same arguments give the same course on every machine, and every course has a
/// [`Course::corridor`].
///
/// The distance is taken to be within [`LONG_GOAL_M`]. [`Family::Hard`] has halls with no way out, and is not put in a row: `None`.
pub fn generate_long(family: Family, seed: u64, goal_north_m: f32) -> Option<Course> {
    if family == Family::Hard {
        return None;
    }
    let goal_north_m = cm(goal_north_m.clamp(*LONG_GOAL_M.start(), *LONG_GOAL_M.end()));
    let arenas = (goal_north_m / GOAL_DOWNRANGE_M).ceil() as u64;
    // Between the arena's number and the mark is room for 55 bits.
    let course_seed = if seed >> 55 == 0 { seed } else { split_mix(seed) };
    let arena_seed = |k: u64| ARENA_SEEDS | (course_seed << 8) | k;
    let mut course = generate(family, arena_seed(0));
    course.name = format!("{family} {seed}, {goal_north_m} m");
    course.seed = seed;
    // To one side and back again, so that all lie between two lines.
    let side = course.goal.east_m.signum();
    keep_sides_within(&mut course.walls, arenas == 1);
    for k in 1..arenas {
        let mut arena = generate(family, arena_seed(k));
        let (turns, wanted) = (arena.goal.east_m.signum(), if k % 2 == 0 { side } else { -side });
        if turns != wanted {
            mirror(&mut arena);
        }
        keep_sides_within(&mut arena.walls, k + 1 == arenas);
        let offset_m = if k % 2 == 0 { 0.0 } else { side * GOAL_OFFSET_M };
        append(&mut course, arena, k as f32 * GOAL_DOWNRANGE_M, offset_m);
    }
    let last_share = goal_north_m / GOAL_DOWNRANGE_M - (arenas - 1) as f32;
    let share_aside = if arenas % 2 == 1 { last_share } else { 1.0 - last_share };
    course.goal.north_m = goal_north_m;
    course.goal.east_m = cm(side * GOAL_OFFSET_M * share_aside);
    course.bounds.north_m[1] = goal_north_m + BEYOND_GOAL_M;
    course.bounds.east_m[0] += (side * GOAL_OFFSET_M).min(0.0);
    course.bounds.east_m[1] += (side * GOAL_OFFSET_M).max(0.0);
    course.time_limit_s *= (goal_north_m / GOAL_DOWNRANGE_M).max(1.0);
    course.checkpoints.retain(|c| c.north_m < goal_north_m);
    finish(course)
}

/// The walls along an arena's sides reach into its neighbours: they end where it ends.
fn keep_sides_within(walls: &mut [Wall], is_last: bool) {
    for wall in walls {
        let [from_m, to_m] = [&mut wall.from_m, &mut wall.to_m];
        if from_m[0] < 0.0 && to_m[0] > GOAL_DOWNRANGE_M {
            from_m[0] = from_m[0].max(0.0);
            to_m[0] = if is_last { to_m[0] } else { GOAL_DOWNRANGE_M };
        }
    }
}

/// North and east of all checkpoints and obstacles; of walls and wires those of both ends.
fn places(course: &mut Course) -> impl Iterator<Item = (&mut f32, &mut f32)> {
    let checkpoints = course.checkpoints.iter_mut().map(|c| (&mut c.north_m, &mut c.east_m));
    let columns = course.columns.iter_mut().map(|c| (&mut c.north_m, &mut c.east_m));
    let boxes = course.boxes.iter_mut().map(|b| (&mut b.north_m, &mut b.east_m));
    let overhangs = course.overhangs.iter_mut().map(|o| (&mut o.north_m, &mut o.east_m));
    let wires = course.wires.iter_mut().flat_map(|w| [&mut w.from_m, &mut w.to_m]);
    let walls = course.walls.iter_mut().flat_map(|w| [&mut w.from_m, &mut w.to_m]);
    let ends = wires.map(|[n, e, _]| (n, e)).chain(walls.map(|[n, e]| (n, e)));
    checkpoints.chain(columns).chain(boxes).chain(overhangs).chain(ends)
}

/// East becomes west.
fn mirror(course: &mut Course) {
    course.goal.east_m = -course.goal.east_m;
    places(course).for_each(|(_, east_m)| *east_m = -*east_m);
    let checkpoints = course.checkpoints.iter_mut().map(|c| &mut c.heading_deg);
    let boxes = course.boxes.iter_mut().map(|b| &mut b.yaw_deg);
    let overhangs = course.overhangs.iter_mut().map(|o| &mut o.yaw_deg);
    (checkpoints.chain(boxes).chain(overhangs)).for_each(|heading_deg| *heading_deg = -*heading_deg);
}

/// Adds an arena's obstacles and checkpoints, moved.
fn append(course: &mut Course, mut arena: Course, north_m: f32, east_m: f32) {
    for (n, e) in places(&mut arena) {
        (*n, *e) = (cm(*n + north_m), cm(*e + east_m));
    }
    course.checkpoints.append(&mut arena.checkpoints);
    course.columns.append(&mut arena.columns);
    course.boxes.append(&mut arena.boxes);
    course.overhangs.append(&mut arena.overhangs);
    course.walls.append(&mut arena.walls);
    course.wires.append(&mut arena.wires);
}

/// Leaves the goal clear, takes away what lies beyond the course, and what is nearest to the goal until there is a way to it.
fn finish(mut course: Course) -> Option<Course> {
    let goal = course.goal;
    let end_m = goal.north_m + BEYOND_GOAL_M;
    let from_goal_m = move |solid: &Solid| solid.plan_distance_m(goal.north_m, goal.east_m);
    let stays = move |solid: &Solid, clear_m: f32| from_goal_m(solid) >= clear_m && solid.centre_ned_m().x < end_m;
    let mut clear_m = CLEAR_GOAL_M;
    for _ in 0..MAX_OBSTACLES {
        course.columns.retain(|o| stays(&o.solid(), clear_m));
        course.boxes.retain(|o| stays(&o.solid(), clear_m));
        course.walls.retain(|o| stays(&o.solid(), clear_m));
        course.overhangs.retain(|o| stays(&o.solid(), clear_m));
        // Branches stay with their trunks.
        let grows_from = |w: &Wire, c: &Column| w.from_m[..2] == [c.north_m, c.east_m];
        let columns = &course.columns;
        (course.wires).retain(|w| stays(&w.part([0.0, 1.0]), clear_m) && columns.iter().any(|c| grows_from(w, c)));
        if course.has_corridor() {
            break;
        }
        // The cut went through an arena's way.
        let nearest_m = course.solids().iter().map(from_goal_m).fold(f32::INFINITY, f32::min);
        clear_m = nearest_m + 0.01;
    }
    Some(course)
}
