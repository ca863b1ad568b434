//! The seeded course generator: the paper's arena, filled differently by each family.
//!
//! Every family flies from home to a goal 20 m north and 5 m to one side (docs/paper.md, "Arena"). All lengths are rounded to
//! centimetres, so that a course written to a file and read back is the same course.

use crate::world::course::{Bounds, BoxObstacle, Checkpoint, Column, Course, Family, GoalPoint, Overhang, Start, Wall};
use crate::world::mover::Mover;
use crate::world::solid::{Solid, radians};
use crate::world::wire::Wire;
mod forest;
mod hard;
mod long;

pub use long::{LONG_GOAL_M, generate_long};

use core::ops::Range;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Distance of the goal along the arena (docs/paper.md, "Arena").
const GOAL_DOWNRANGE_M: f32 = 20.0;
/// Distance of the goal to either side (docs/paper.md, "Arena").
const GOAL_OFFSET_M: f32 = 5.0;
/// No obstacle comes nearer to the start than this.
const CLEAR_START_M: f32 = 2.5;
/// No obstacle comes nearer to the goal than this.
const CLEAR_GOAL_M: f32 = 2.0;
/// Tries per obstacle before it is left out.
const PLACEMENT_TRIES: usize = 40;
/// A mover's track keeps this distance from everything, so that it runs into nothing.
const MOVER_GAP_M: f32 = 0.3;
/// Departures, in simulated seconds, from which a course with movers is checked to be flyable.
const CHECKED_DEPARTURES_S: [f32; 2] = [0.0, 13.0];

/// Between these heights obstacles keep the smallest gap.
const IN_THE_WAY_M: [f32; 2] = [0.8, 2.2];

/// Makes the course of a family and seed. The same arguments give the same course on every machine, and every course has a
/// [`Course::corridor`].
pub fn generate(family: Family, seed: u64) -> Course {
    let mut builder = Builder::new(family, seed);
    match family {
        Family::Training => training(&mut builder),
        Family::Validation => lay_out(&mut builder),
        Family::Hard => hard::fill(&mut builder),
        Family::Dense => dense(&mut builder),
        Family::Forest => forest::fill(&mut builder),
    }
    builder.finish()
}

/// Scattered obstacles at a density drawn per course, from open ground to denser than validation, columns above all; gaps of
/// at least 2.0 to 2.6 m.
fn training(b: &mut Builder) {
    b.gap_m = b.length(2.0..2.6);
    if b.chance(0.4) {
        b.side_walls(8.0..10.0);
    }
    if b.chance(0.2) {
        b.course.ceiling_height_m = Some(b.length(3.5..5.0));
    }
    for along in [0.2..0.4, 0.4..0.6, 0.6..0.8] {
        if b.chance(0.6) {
            let kind = b.pick(&[Kind::Column, Kind::Column, Kind::Box, Kind::Wall, Kind::LowOverhang]);
            b.block_line(kind, along);
        }
    }
    let most_columns = b.pick(&[8, 16, 26]);
    let area = [3.5..18.5, -8.0..8.0];
    for (kind, count) in [
        (Kind::Wall, 0..4),
        (Kind::Box, 0..6),
        (Kind::Beam, 0..2),
        (Kind::LowOverhang, 0..3),
        (Kind::LowBox, 0..3),
        (Kind::Column, 4..most_columns),
    ] {
        b.scatter(kind, count, &area);
    }
}

/// Validation's layouts with gaps from 1.8 m, filled up with columns, boxes and walls wherever there is room.
fn dense(b: &mut Builder) {
    b.gap_m = 1.8;
    lay_out(b);
    let area = [3.0..18.5, -7.5..7.5];
    b.scatter(Kind::Wall, 2..5, &area);
    b.scatter(Kind::Box, 3..7, &area);
    b.scatter(Kind::Column, 20..40, &area);
}

/// One of four layouts that training does not have, each denser; gaps are the builder's, from 2 m for validation.
fn lay_out(b: &mut Builder) {
    if b.chance(0.5) {
        b.side_walls(7.5..9.0);
    }
    if b.chance(0.3) {
        b.course.ceiling_height_m = Some(b.length(3.0..4.5));
    }
    // Every kind of obstacle occurs in every validation course, so these come before the layout fills the space.
    let area = [4.0..17.5, -6.5..6.5];
    for kind in [Kind::Wall, Kind::Box, Kind::LowOverhang, Kind::Beam, Kind::Column] {
        b.scatter(kind, 1..2, &area);
    }
    let lay_out: fn(&mut Builder) = b.pick(&[thin_columns, screens, yard, rows]);
    lay_out(b);
}

/// Thin columns close together.
fn thin_columns(b: &mut Builder) {
    b.block_line(Kind::Column, 0.25..0.5);
    b.block_line(Kind::Column, 0.6..0.8);
    let area = [3.5..18.0, -6.5..6.5];
    b.scatter(Kind::Column, 18..28, &area);
}

/// Walls across the way, one behind the other, each to be passed at a side.
fn screens(b: &mut Builder) {
    let count = b.rng.random_range(3..5);
    for k in 0..count {
        let along = (k as f32 + 0.7) / (count as f32 + 0.4);
        b.block_line(Kind::Wall, along - 0.03..along + 0.03);
    }
    let area = [3.5..18.0, -7.0..7.0];
    b.scatter(Kind::Wall, 2..5, &area);
    b.scatter(Kind::Column, 3..8, &area);
}

/// Containers standing about, some under low roofs.
fn yard(b: &mut Builder) {
    b.block_line(Kind::Box, 0.3..0.5);
    b.block_line(Kind::LowOverhang, 0.6..0.8);
    let area = [3.5..18.0, -7.0..7.0];
    b.scatter(Kind::Box, 5..9, &area);
    b.scatter(Kind::LowOverhang, 1..3, &area);
    b.scatter(Kind::LowBox, 1..3, &area);
    b.scatter(Kind::Column, 2..6, &area);
}

/// Staggered rows of columns, 2.6 to 3.4 m apart: a plantation seen at an angle.
fn rows(b: &mut Builder) {
    let spacing_m = b.rng.random_range(2.6..3.4);
    let row_m = b.rng.random_range(2.8..3.6);
    let shift_m = b.rng.random_range(0.0..spacing_m);
    let mut north_m = 4.0;
    let mut odd = false;
    while north_m < 17.5 {
        let mut east_m = -7.0 + if odd { 0.5 * spacing_m } else { 0.0 } + 0.3 * shift_m;
        while east_m < 7.0 {
            if b.chance(0.88) {
                let column = Column {
                    north_m: cm(north_m + b.rng.random_range(-0.25..0.25)),
                    east_m: cm(east_m + b.rng.random_range(-0.25..0.25)),
                    radius_m: b.length(0.15..0.35),
                    height_m: b.length(2.2..4.0),
                };
                b.place(Obstacle::Column(column));
            }
            east_m += spacing_m;
        }
        north_m += row_m;
        odd = !odd;
    }
    b.block_line(Kind::Column, 0.3..0.7);
}

/// What can be scattered.
#[derive(Clone, Copy)]
enum Kind {
    Column,
    /// Taller than the flight height: to be flown around.
    Box,
    /// Lower than the flight height by the corridor's margin: may be flown over.
    LowBox,
    Wall,
    /// A roof or slab across the flight height: to be flown around.
    LowOverhang,
    /// A beam high enough to be flown under.
    Beam,
}

#[derive(Clone, Copy)]
enum Obstacle {
    Column(Column),
    Box(BoxObstacle),
    Wall(Wall),
    Overhang(Overhang),
    Wire(Wire),
    Mover(Mover),
}

impl Obstacle {
    /// Its geometry; a mover's is its whole track, a wire's what of it is in the way or, where none is, the box around it.
    fn solid(&self) -> Solid {
        match self {
            Self::Column(o) => o.solid(),
            Self::Box(o) => o.solid(),
            Self::Wall(o) => o.solid(),
            Self::Overhang(o) => o.solid(),
            Self::Wire(o) => o.solid(IN_THE_WAY_M[0], IN_THE_WAY_M[1]),
            Self::Mover(o) => o.track(),
        }
    }
}

fn wall(from_m: [f32; 2], to_m: [f32; 2], thickness_m: f32, height_m: f32) -> Obstacle {
    Obstacle::Wall(Wall {
        from_m,
        to_m,
        thickness_m,
        height_m,
    })
}

/// Where obstacles' centres may lie, north and east.
type Area = [Range<f32>; 2];

struct Builder {
    rng: ChaCha8Rng,
    course: Course,
    /// What was placed, in order, to be taken back from the end if there is no way through. What belongs together, as the
    /// parts of a wall with a door, comes and goes together.
    placed: Vec<Vec<(Obstacle, Solid)>>,
    /// Smallest gap between neighbouring obstacles.
    gap_m: f32,
}

impl Builder {
    fn new(family: Family, seed: u64) -> Self {
        // The families must not share layouts, so each has its own stream.
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(1 + family as u64);
        let side = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
        let goal = GoalPoint {
            north_m: GOAL_DOWNRANGE_M,
            east_m: side * GOAL_OFFSET_M,
        };
        let goal_bearing_deg = libm::atan2f(goal.east_m, goal.north_m).to_degrees();
        let checkpoints = [0.25, 0.5, 0.75]
            .map(|f| Checkpoint {
                north_m: cm(f * goal.north_m),
                east_m: cm(f * goal.east_m),
                heading_deg: cm(goal_bearing_deg),
            })
            .to_vec();
        let course = Course {
            name: format!("{family} {seed}"),
            family: Some(family),
            seed,
            start: Start {
                heading_deg: cm(rng.random_range(-20.0..20.0)),
                ..Start::default()
            },
            goal,
            bounds: Bounds {
                north_m: [-4.0, 25.0],
                east_m: [-12.0, 12.0],
                top_m: 6.0,
            },
            checkpoints,
            ..Course::default()
        };
        Self {
            rng,
            course,
            placed: Vec::new(),
            gap_m: 2.0,
        }
    }

    fn chance(&mut self, probability: f64) -> bool {
        self.rng.random_bool(probability)
    }

    fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[self.rng.random_range(0..from.len())]
    }

    /// A length in centimetres' steps.
    fn length(&mut self, range: Range<f32>) -> f32 {
        cm(self.rng.random_range(range))
    }

    /// Long walls along both sides of the arena.
    fn side_walls(&mut self, distance_m: Range<f32>) {
        let height_m = self.length(2.5..4.0);
        for side in [-1.0, 1.0] {
            let east_m = side * self.length(distance_m.clone());
            self.place(wall([-3.5, east_m], [24.5, east_m], 0.2, height_m));
        }
    }

    /// Draws until what was drawn has found room, [`PLACEMENT_TRIES`] times at most.
    fn try_to_place(&mut self, mut draw_and_place: impl FnMut(&mut Self) -> bool) {
        (0..PLACEMENT_TRIES).any(|_| draw_and_place(self));
    }

    /// Places up to a drawn number of obstacles of a kind.
    fn scatter(&mut self, kind: Kind, count: Range<usize>, area: &Area) {
        for _ in 0..self.rng.random_range(count) {
            self.try_to_place(|b| {
                let [north_m, east_m] = b.point(area);
                let yaw_deg = cm(b.rng.random_range(0.0..180.0));
                let obstacle = b.obstacle(kind, north_m, east_m, yaw_deg);
                b.place(obstacle)
            });
        }
    }

    fn point(&mut self, area: &Area) -> [f32; 2] {
        area.clone().map(|range| self.length(range))
    }

    /// A place near the straight line to the goal, north and east, at a drawn share of it, and a heading across it.
    fn on_the_line(&mut self, along: Range<f32>) -> (f32, f32, f32) {
        let (goal_north_m, goal_east_m) = (self.course.goal.north_m, self.course.goal.east_m);
        let length_m = libm::hypotf(goal_north_m, goal_east_m);
        let f = self.rng.random_range(along);
        let aside_m = self.rng.random_range(-0.4..0.4);
        let north_m = cm(f * goal_north_m - aside_m * goal_east_m / length_m);
        let east_m = cm(f * goal_east_m + aside_m * goal_north_m / length_m);
        let across_deg = 90.0 + libm::atan2f(goal_east_m, goal_north_m).to_degrees();
        let yaw_deg = cm(across_deg + self.rng.random_range(-30.0..30.0));
        (north_m, east_m, yaw_deg)
    }

    /// Places an obstacle across the straight line to the goal, at a drawn share of it.
    fn block_line(&mut self, kind: Kind, along: Range<f32>) {
        self.try_to_place(|b| {
            let (north_m, east_m, yaw_deg) = b.on_the_line(along.clone());
            let obstacle = b.obstacle(kind, north_m, east_m, yaw_deg);
            b.place(obstacle)
        });
    }

    fn obstacle(&mut self, kind: Kind, north_m: f32, east_m: f32, yaw_deg: f32) -> Obstacle {
        match kind {
            Kind::Column => Obstacle::Column(Column {
                north_m,
                east_m,
                radius_m: self.length(0.15..0.55),
                height_m: self.length(2.2..4.5),
            }),
            Kind::Box | Kind::LowBox => Obstacle::Box(BoxObstacle {
                north_m,
                east_m,
                length_m: self.length(0.6..2.6),
                width_m: self.length(0.6..1.8),
                height_m: match kind {
                    Kind::LowBox => self.length(0.3..0.75),
                    _ => self.length(1.8..3.2),
                },
                yaw_deg,
            }),
            Kind::Wall => {
                let half_m = 0.5 * self.length(2.0..4.5);
                let yaw_rad = radians(yaw_deg);
                let (s, c) = (libm::sinf(yaw_rad), libm::cosf(yaw_rad));
                let end = |along_m: f32| [cm(north_m + along_m * c), cm(east_m + along_m * s)];
                wall(end(-half_m), end(half_m), self.length(0.1..0.3), self.length(2.2..3.5))
            }
            Kind::LowOverhang => self.overhang((north_m, east_m, yaw_deg), [0.8..1.5, 1.0..3.0, 0.4..1.5, 0.7..1.6]),
            Kind::Beam => self.overhang((north_m, east_m, yaw_deg), [2.25..2.7, 2.0..6.0, 0.2..0.6, 0.2..0.6]),
        }
    }

    /// One whose height above ground, length, width and thickness are drawn from ranges.
    fn overhang(&mut self, (north_m, east_m, yaw_deg): (f32, f32, f32), ranges: [Range<f32>; 4]) -> Obstacle {
        let [bottom_m, length_m, width_m, thickness_m] = ranges;
        let bottom_m = self.length(bottom_m);
        Obstacle::Overhang(Overhang {
            north_m,
            east_m,
            length_m: self.length(length_m),
            width_m: self.length(width_m),
            bottom_m,
            top_m: cm(bottom_m + self.rng.random_range(thickness_m)),
            yaw_deg,
        })
    }

    /// Adds an obstacle if it leaves start and goal clear and the smallest gap to every other open.
    fn place(&mut self, obstacle: Obstacle) -> bool {
        self.place_together(&[obstacle])
    }

    /// Adds obstacles that belong together, all or none; they may touch each other.
    fn place_together(&mut self, obstacles: &[Obstacle]) -> bool {
        let goal = self.course.goal;
        let group: Vec<(Obstacle, Solid)> = obstacles.iter().map(|o| (*o, o.solid())).collect();
        if group.iter().any(|one| {
            one.1.plan_distance_m(0.0, 0.0) < CLEAR_START_M
                || one.1.plan_distance_m(goal.north_m, goal.east_m) < CLEAR_GOAL_M
                || self.placed.iter().flatten().any(|other| self.crowds(one, other))
        }) {
            return false;
        }
        self.placed.push(group);
        true
    }

    /// Whether two obstacles are nearer to each other than allowed. What is flown over or under needs no room beside it, and a
    /// mover makes room itself.
    fn crowds(&self, (a, a_solid): &(Obstacle, Solid), (b, b_solid): &(Obstacle, Solid)) -> bool {
        let moves = |o: &Obstacle| matches!(o, Obstacle::Mover(_));
        let gap_m = if moves(a) || moves(b) {
            MOVER_GAP_M
        } else if a_solid.reaches_into(IN_THE_WAY_M) && b_solid.reaches_into(IN_THE_WAY_M) {
            self.gap_m
        } else {
            0.1
        };
        // Around what is far off there is no need to go.
        let extent_m = |solid: &Solid| {
            let (north_m, east_m) = solid.plan_half_extents_m();
            north_m + east_m
        };
        let reach_m = extent_m(a_solid) + extent_m(b_solid);
        let [a, b] = [a_solid, b_solid].map(Solid::centre_ned_m);
        if libm::hypotf(a.x - b.x, a.y - b.y) > reach_m + gap_m + 0.01 {
            return false;
        }
        a_solid.plan_gap_m(b_solid) < gap_m
    }

    fn is_flyable(&self) -> bool {
        let arrives = |depart_s: &f32| self.course.earliest_arrival_s(*depart_s).is_some();
        self.course.has_corridor() && (self.course.movers.is_empty() || CHECKED_DEPARTURES_S.iter().all(arrives))
    }

    /// Takes obstacles back, the last first, until there is a way through.
    fn finish(mut self) -> Course {
        loop {
            self.course.clear_obstacles();
            for (obstacle, _) in self.placed.iter().flatten() {
                match *obstacle {
                    Obstacle::Column(o) => self.course.columns.push(o),
                    Obstacle::Box(o) => self.course.boxes.push(o),
                    Obstacle::Wall(o) => self.course.walls.push(o),
                    Obstacle::Overhang(o) => self.course.overhangs.push(o),
                    Obstacle::Wire(o) => self.course.wires.push(o),
                    Obstacle::Mover(o) => self.course.movers.push(o),
                }
            }
            if self.is_flyable() || self.placed.pop().is_none() {
                return self.course;
            }
        }
    }
}

/// Rounds to centimetres (or hundredths of a degree).
fn cm(value: f32) -> f32 {
    (value * 100.0).round() / 100.0
}
