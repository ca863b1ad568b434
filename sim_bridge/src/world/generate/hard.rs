//! The hard family: walls across the arena with narrow doors, pockets, dense columns, low roofs, and obstacles that move.

use super::{Area, Builder, Kind, Obstacle, cm, wall};
use crate::world::course::Overhang;
use crate::world::mover::{BoxOutline, ColumnOutline, Mover, MoverShape};
use crate::world::solid::radians;
use core::ops::Range;
use rand::RngExt;

/// The hall that the arena is in: its walls' distances from home. There is no way but through the doors.
const HALF_WIDTH_M: f32 = 9.0;
const BACK_M: f32 = -3.5;
const FRONT_M: f32 = 24.0;
const HALL_HEIGHT_M: f32 = 3.5;
const DOOR_WIDTH_M: Range<f32> = 1.6..2.2;
/// A door lies at least this far to the side of the one before it.
const DOOR_OFFSET_M: Range<f32> = 3.0..7.0;
/// No door lies further from the middle.
const DOOR_EAST_M: f32 = 6.0;

/// Where obstacles lie that no wall is.
const AREA: Area = [3.0..18.0, -7.0..7.0];

/// One of three layouts, each with doors, a pocket or columns in the straight way, and movers.
pub(super) fn fill(b: &mut Builder) {
    b.gap_m = 1.8;
    b.course.bounds.east_m = [-HALF_WIDTH_M - 0.5, HALF_WIDTH_M + 0.5];
    if b.chance(0.2) {
        b.course.ceiling_height_m = Some(b.length(3.0..4.0));
    }
    // What a course must have comes first: obstacles are taken back from the end.
    let lay_out: fn(&mut Builder) = b.pick(&[rooms, pockets, thicket]);
    lay_out(b);
}

/// Three walls with doors, obstacles going to and fro before them.
fn rooms(b: &mut Builder) {
    for door in walls(b, &[6.0, 10.8, 15.6]) {
        guard(b, &door);
    }
    patrols(b, 0..2);
    b.scatter(Kind::LowOverhang, 0..2, &AREA);
    b.scatter(Kind::Column, 4..8, &AREA);
}

/// Two walls with doors and pockets between them.
fn pockets(b: &mut Builder) {
    behind_pockets(b, &[8.0, 15.5], 6..12);
}

/// One wall with a door in a thicket of columns, a pocket before it.
fn thicket(b: &mut Builder) {
    let north_m = b.length(9.0..12.0);
    behind_pockets(b, &[north_m], 24..36);
}

/// Walls with doors, each behind a pocket.
fn behind_pockets(b: &mut Builder, north_m: &[f32], columns: Range<usize>) {
    let doors = walls(b, north_m);
    let mut from_m = [0.0, 0.0];
    for door in &doors {
        let door_m = [door.north_m, door.east_m];
        pocket(b, from_m, door_m);
        from_m = door_m;
    }
    guard(b, &doors[doors.len() - 1]);
    patrols(b, 1..3);
    b.scatter(Kind::LowOverhang, 1..3, &AREA);
    b.scatter(Kind::Column, columns, &AREA);
}

/// The opening of a wall.
struct Door {
    north_m: f32,
    east_m: f32,
    /// Metres north per metre east along its wall.
    slope: f32,
}

/// The hall and walls across it about these distances north, each with one door, offset from the door before it.
fn walls(b: &mut Builder, north_m: &[f32]) -> Vec<Door> {
    let mut doors: Vec<Door> = Vec::new();
    let corners = [
        [BACK_M, -HALF_WIDTH_M],
        [FRONT_M, -HALF_WIDTH_M],
        [FRONT_M, HALF_WIDTH_M],
        [BACK_M, HALF_WIDTH_M],
    ];
    let mut parts: Vec<Obstacle> = (0..4)
        .map(|k| wall(corners[k], corners[(k + 1) % 4], 0.2, HALL_HEIGHT_M))
        .collect();
    for at_m in north_m {
        let before_m = doors.last().map_or(0.0, |d| d.east_m);
        let aside_m = b.length(DOOR_OFFSET_M);
        // To either side, if there is room, and towards the middle if not.
        let side = if b.chance(0.5) { 1.0 } else { -1.0 };
        let wished_m = before_m + side * aside_m;
        let east_m = cm(if wished_m.abs() <= DOOR_EAST_M {
            wished_m
        } else {
            before_m - side * aside_m
        });
        let east_m = east_m.clamp(-DOOR_EAST_M, DOOR_EAST_M);
        let slope = b.rng.random_range(-0.06..0.06);
        let north_m = cm(at_m + b.rng.random_range(-0.3..0.3));
        let door = Door { north_m, east_m, slope };
        parts.extend(wall_with(b, &door));
        doors.push(door);
    }
    // Walls and doors are where they are by construction: nothing was placed before them.
    b.place_together(&parts);
    doors
}

/// The parts of a wall with a door.
fn wall_with(b: &mut Builder, door: &Door) -> Vec<Obstacle> {
    let width_m = b.length(DOOR_WIDTH_M);
    let thickness_m = b.length(0.1..0.3);
    let height_m = b.length(2.6..3.5);
    let at = |east_m: f32| [cm(door.north_m + door.slope * (east_m - door.east_m)), cm(east_m)];
    let between = |west_m: f32, east_m: f32| wall(at(west_m), at(east_m), thickness_m, height_m);
    let mut parts = vec![
        between(-HALF_WIDTH_M, door.east_m - 0.5 * width_m),
        between(door.east_m + 0.5 * width_m, HALF_WIDTH_M),
    ];
    if b.chance(0.5) {
        parts.push(Obstacle::Overhang(Overhang {
            north_m: door.north_m,
            east_m: door.east_m,
            length_m: cm(width_m + 0.2),
            width_m: thickness_m,
            bottom_m: b.length(2.0..2.3),
            top_m: height_m,
            yaw_deg: cm(libm::atan2f(1.0, door.slope).to_degrees()),
        }));
    }
    parts
}

/// Three walls in the straight way between two points, open towards the first: a dead end.
fn pocket(b: &mut Builder, from_m: [f32; 2], to_m: [f32; 2]) {
    b.try_to_place(|b| {
        let f = b.rng.random_range(0.3..0.8);
        let bearing = libm::atan2f(to_m[1] - from_m[1], to_m[0] - from_m[0]);
        let heading = bearing + radians(b.rng.random_range(-25.0..25.0));
        let (s, c) = (libm::sinf(heading), libm::cosf(heading));
        let half_m = 0.5 * b.length(2.4..4.0);
        let depth_m = b.length(1.4..2.6);
        let height_m = b.length(2.2..3.5);
        let middle_m = [0, 1].map(|k| from_m[k] + f * (to_m[k] - from_m[k]));
        // A point so far ahead of the back wall's middle and so far to its right.
        let at = |ahead_m: f32, right_m: f32| {
            [
                cm(middle_m[0] + ahead_m * c - right_m * s),
                cm(middle_m[1] + ahead_m * s + right_m * c),
            ]
        };
        let (left, right) = (at(0.0, -half_m), at(0.0, half_m));
        let parts = [
            (left, right),
            (left, at(-depth_m, -half_m)),
            (right, at(-depth_m, half_m)),
        ]
        .map(|(from_m, to_m)| wall(from_m, to_m, 0.15, height_m));
        b.place_together(&parts)
    });
}

/// A mover that goes to and fro before or behind a door, along its wall.
fn guard(b: &mut Builder, door: &Door) {
    b.try_to_place(|b| {
        let side = if b.chance(0.5) { 1.0 } else { -1.0 };
        let away_m = side * b.rng.random_range(0.8..1.8);
        let (left_m, right_m) = (b.rng.random_range(1.6..3.5), b.rng.random_range(1.6..3.5));
        let at = |aside_m: f32| {
            [
                cm(door.north_m + away_m + door.slope * aside_m),
                cm(door.east_m + aside_m),
            ]
        };
        place_mover(b, at(-left_m), at(right_m))
    });
}

/// Movers on straight ways anywhere.
fn patrols(b: &mut Builder, count: Range<usize>) {
    for _ in 0..b.rng.random_range(count) {
        b.try_to_place(|b| {
            let [north_m, east_m] = b.point(&AREA);
            let half_m = 0.5 * b.rng.random_range(3.0..6.0);
            let heading = b.rng.random_range(0.0..core::f32::consts::PI);
            let (s, c) = (libm::sinf(heading), libm::cosf(heading));
            let at = |along_m: f32| [cm(north_m + along_m * c), cm(east_m + along_m * s)];
            place_mover(b, at(-half_m), at(half_m))
        });
    }
}

fn place_mover(b: &mut Builder, from_m: [f32; 2], to_m: [f32; 2]) -> bool {
    let mut shape = MoverShape::default();
    if b.chance(0.6) {
        let radius_m = b.length(0.2..0.4);
        shape.column = Some(ColumnOutline { radius_m });
    } else {
        shape.cuboid = Some(BoxOutline {
            length_m: b.length(0.4..0.9),
            width_m: b.length(0.3..0.6),
            yaw_deg: cm(b.rng.random_range(0.0..180.0)),
        });
    }
    let mover = Mover {
        from_m,
        to_m,
        speed_m_s: b.length(0.3..0.8),
        phase: cm(b.rng.random_range(0.0..1.0)),
        height_m: b.length(1.9..2.6),
        shape,
    };
    b.place(Obstacle::Mover(mover))
}
