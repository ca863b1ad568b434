//! What makes a course usable, beyond its syntax.

use crate::world::course::Course;
use crate::world::mover::{ColumnOutline, MAX_MOVER_SPEED_M_S, Mover};
use crate::world::solid::Solid;
use crate::world::vehicle::VEHICLE;
use core::ops::RangeInclusive;

/// More obstacles than this is a mistake in the file.
pub const MAX_OBSTACLES: usize = 1000;
/// The same for wires, of which a tree has several.
pub const MAX_WIRES: usize = 10_000;
/// No coordinate or size may exceed this; single precision keeps 0.1 mm up to there.
pub const MAX_COORDINATE_M: f32 = 1000.0;

/// What is wrong with one field of a course.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{field}`: {problem}")]
pub struct FieldProblem {
    /// Dotted path, as in the file.
    pub field: String,
    /// What is wrong and what would be right.
    pub problem: String,
}

pub(super) fn problem<T>(field: impl Into<String>, problem: impl Into<String>) -> Result<T, FieldProblem> {
    Err(FieldProblem {
        field: field.into(),
        problem: problem.into(),
    })
}

/// `expected` says what a value must be, in words.
pub(super) fn within(field: &str, value: f32, range: RangeInclusive<f32>, expected: &str) -> Result<(), FieldProblem> {
    match range.contains(&value) {
        true => Ok(()),
        false => problem(field, format!("is {value}, must be {expected}")),
    }
}

pub(super) fn coordinate(field: &str, value: f32) -> Result<(), FieldProblem> {
    let expected = format!("a number within ±{MAX_COORDINATE_M} m");
    within(field, value, -MAX_COORDINATE_M..=MAX_COORDINATE_M, &expected)
}

pub(super) fn angle(field: &str, value: f32) -> Result<(), FieldProblem> {
    within(field, value, -360.0..=360.0, "within ±360 degrees")
}

/// The ends of what lies along a line: two places; `other` says what the second must be.
pub(super) fn ends<const N: usize>(table: &str, [from, to]: [[f32; N]; 2], other: &str) -> Result<(), FieldProblem> {
    let mut apart_m2 = 0.0_f32;
    for k in 0..N {
        coordinate(&format!("{table}.from_m[{k}]"), from[k])?;
        coordinate(&format!("{table}.to_m[{k}]"), to[k])?;
        apart_m2 += (to[k] - from[k]).powi(2);
    }
    if apart_m2.sqrt() >= 0.01 {
        return Ok(());
    }
    let same = format!("is the same point as from_m, must be {other}");
    problem(format!("{table}.to_m"), same)
}

fn size(field: &str, value: f32) -> Result<(), FieldProblem> {
    let expected = format!("a size from 0.01 to {MAX_COORDINATE_M} m");
    within(field, value, 0.01..=MAX_COORDINATE_M, &expected)
}

/// Checks fields of a table in turn, each by its own name.
macro_rules! check_fields {
    ($of:expr, $table:expr, $($check:ident: $($field:ident)+),+) => {{
        let table = $table;
        $($($check(&format!("{table}.{}", stringify!($field)), $of.$field)?;)+)+
    }};
}
pub(super) use check_fields;

impl Course {
    /// Checks every value, and that start and goal are free and within bounds. Flyability is [`Course::corridor`]'s matter.
    ///
    /// # Errors
    /// The first field that is wrong.
    pub fn check(&self) -> Result<(), FieldProblem> {
        self.check_frame()?;
        self.check_numbers()?;
        self.check_obstacles()?;
        self.check_places()
    }

    fn check_frame(&self) -> Result<(), FieldProblem> {
        if self.name.contains(char::is_control) {
            return problem("name", "holds a control character");
        }
        for (name, value, (low, high), unit) in [
            ("flight_height_m", self.flight_height_m, (0.5, 100.0), "m"),
            ("goal_radius_m", self.goal_radius_m, (0.1, 100.0), "m"),
            ("time_limit_s", self.time_limit_s, (1.0, 3600.0), "s"),
        ] {
            within(name, value, low..=high, &format!("from {low} to {high} {unit}"))?;
        }
        let b = &self.bounds;
        for (name, range) in [("north_m", b.north_m), ("east_m", b.east_m)] {
            for (i, value) in range.into_iter().enumerate() {
                coordinate(&format!("bounds.{name}[{i}]"), value)?;
            }
            if range[0] >= range[1] {
                let order = format!("is {range:?}, must be [lowest, highest]");
                return problem(format!("bounds.{name}"), order);
            }
        }
        let ceiling = self.ceiling_height_m.map(|ceiling_m| ("ceiling_height_m", ceiling_m));
        for (name, top_m) in [("bounds.top_m", b.top_m)].into_iter().chain(ceiling) {
            coordinate(name, top_m)?;
            let height_m = self.flight_height_m;
            let least_m = ((height_m + VEHICLE.height_m) * 1e3).round() / 1e3;
            let expected = format!("at least {least_m} m: the flight height of {height_m} m and the vehicle's height");
            within(name, top_m, least_m..=f32::INFINITY, &expected)?;
        }
        Ok(())
    }

    fn check_numbers(&self) -> Result<(), FieldProblem> {
        let lists = [
            ("column", self.columns.len()),
            ("box", self.boxes.len()),
            ("wall", self.walls.len()),
            ("overhang", self.overhangs.len()),
            ("mesh", self.meshes.len()),
            ("mover", self.movers.len()),
        ];
        let count: usize = lists.iter().map(|(_, n)| n).sum();
        let longest = lists.iter().max_by_key(|(_, n)| n).map_or("", |(name, _)| name);
        for (field, count, what, limit) in [
            (longest, count, "obstacles", MAX_OBSTACLES),
            ("wire", self.wires.len(), "wires", MAX_WIRES),
        ] {
            if count > limit {
                return problem(field, format!("there are {count} {what}, at most {limit} are allowed"));
            }
        }
        Ok(())
    }

    fn check_obstacles(&self) -> Result<(), FieldProblem> {
        for (i, c) in self.columns.iter().enumerate() {
            check_fields!(c, format!("column[{i}]"), coordinate: north_m east_m, size: radius_m height_m);
        }
        for (i, b) in self.boxes.iter().enumerate() {
            let table = format!("box[{i}]");
            check_fields!(b, table, coordinate: north_m east_m, size: length_m width_m height_m, angle: yaw_deg);
        }
        for (i, w) in self.walls.iter().enumerate() {
            let table = format!("wall[{i}]");
            ends(&table, [w.from_m, w.to_m], "another")?;
            check_fields!(w, table, size: thickness_m height_m);
        }
        for (i, o) in self.overhangs.iter().enumerate() {
            let table = format!("overhang[{i}]");
            check_fields!(o, &table, coordinate: north_m east_m, size: length_m width_m bottom_m,
                angle: yaw_deg, size: top_m);
            let expected = format!("at least 0.01 m above bottom_m of {}", o.bottom_m);
            let above = o.bottom_m + 0.01..=f32::INFINITY;
            within(&format!("{table}.top_m"), o.top_m, above, &expected)?;
        }
        self.wires.iter().enumerate().try_for_each(|(i, w)| w.check(i))?;
        let mut meshes = self.meshes.iter().enumerate();
        meshes.try_for_each(|(i, m)| m.check(i, &self.bounds))?;
        self.movers.iter().enumerate().try_for_each(|(i, m)| m.check(i))
    }

    fn check_places(&self) -> Result<(), FieldProblem> {
        check_fields!(self.start, "start", coordinate: north_m east_m, angle: heading_deg);
        check_fields!(self.goal, "goal", coordinate: north_m east_m);
        for (i, c) in self.checkpoints.iter().enumerate() {
            check_fields!(c, format!("checkpoint[{i}]"), coordinate: north_m east_m, angle: heading_deg);
        }
        let places = [
            ("start", self.start.north_m, self.start.east_m),
            ("goal", self.goal.north_m, self.goal.east_m),
        ];
        for (name, north_m, east_m) in places {
            if !self.bounds.contains_plan(north_m, east_m) {
                return problem(name, format!("[{north_m}, {east_m}] is outside of `bounds`"));
            }
        }
        // The column of air from the ground to above flight height must be free where the vehicle takes off and lands.
        let top_m = self.flight_height_m + VEHICLE.height_m;
        let lists: [(&str, Vec<Solid>); 6] = [
            ("column", self.columns.iter().map(|o| o.solid()).collect()),
            ("box", self.boxes.iter().map(|o| o.solid()).collect()),
            ("wall", self.walls.iter().map(|o| o.solid()).collect()),
            ("overhang", self.overhangs.iter().map(|o| o.solid()).collect()),
            ("wire", self.wires.iter().map(|w| w.solid(0.0, top_m)).collect()),
            ("mover", self.movers.iter().map(Mover::track).collect()),
        ];
        for (kind, solids) in &lists {
            for (i, solid) in solids.iter().enumerate().filter(|(_, s)| s.bottom_m() < top_m) {
                for (name, north_m, east_m) in places {
                    let gap_m = solid.plan_distance_m(north_m, east_m) - VEHICLE.radius_m;
                    if gap_m <= 0.0 {
                        let covers = format!("covers the {name} at [{north_m}, {east_m}]; move one of them");
                        return problem(format!("{kind}[{i}]"), covers);
                    }
                }
            }
        }
        for (i, mesh) in self.meshes.iter().enumerate() {
            for (name, north_m, east_m) in places {
                if mesh.covers(north_m, east_m, top_m) {
                    let reach_m = VEHICLE.radius_m;
                    let near = format!(
                        "is nearer to the {name} at [{north_m}, {east_m}] than the vehicle's radius of {reach_m} m, \
                         below {top_m} m; move one of them"
                    );
                    return problem(format!("mesh[{i}]"), near);
                }
            }
        }
        Ok(())
    }
}

impl Mover {
    fn check(&self, i: usize) -> Result<(), FieldProblem> {
        let expected = "another; what stands still is a column or a box";
        ends(&format!("mover[{i}]"), [self.from_m, self.to_m], expected)?;
        let field = |name: &str| format!("mover[{i}].{name}");
        let pace = format!("from 0.01 to {MAX_MOVER_SPEED_M_S} m/s");
        within(&field("speed_m_s"), self.speed_m_s, 0.01..=MAX_MOVER_SPEED_M_S, &pace)?;
        let share = "a share of the way to and fro, from 0 to 1";
        within(&field("phase"), self.phase, 0.0..=1.0, share)?;
        size(&field("height_m"), self.height_m)?;
        match (self.shape.column, self.shape.cuboid) {
            (Some(ColumnOutline { radius_m }), None) => size(&field("shape.column.radius_m"), radius_m),
            (None, Some(outline)) => {
                check_fields!(outline, field("shape.box"), size: length_m width_m, angle: yaw_deg);
                Ok(())
            }
            _ => problem(field("shape"), "one of `column` and `box` is needed"),
        }
    }
}
