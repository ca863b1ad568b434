//! Is there a path? A search on a grid at flight height.

use crate::world::course::{Course, Family};
use crate::world::solid::Solid;
use crate::world::vehicle::VEHICLE;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Free space that a corridor keeps around the vehicle's solid, to the sides, above and below.
pub const CORRIDOR_MARGIN_M: f32 = 0.6;
/// The same for courses of [`Family::Hard`], whose narrowest door is 1.6 m wide.
pub const HARD_CORRIDOR_MARGIN_M: f32 = 0.3;
/// Grid spacing of the search; wider where the bounds would need more than [`MAX_CELLS`].
const CELL_M: f32 = 0.2;
/// The same for courses of [`Family::Hard`]: what is left of a door of 1.6 m without the margins is 0.4 m wide.
const HARD_CELL_M: f32 = 0.1;
/// Bounds the memory of a search to 10 MB.
const MAX_CELLS: f32 = 1e6;

/// Points of a plan view at equal distances; numbered by north, then east.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Lattice {
    pub(crate) cell_m: f32,
    /// North, east.
    pub(crate) cells: [usize; 2],
    pub(crate) origin_m: [f32; 2],
}

impl Lattice {
    pub(crate) fn point(&self, (i, j): (usize, usize)) -> [f32; 2] {
        [
            self.origin_m[0] + i as f32 * self.cell_m,
            self.origin_m[1] + j as f32 * self.cell_m,
        ]
    }

    pub(crate) fn number(&self, (i, j): (usize, usize)) -> usize {
        i * self.cells[1] + j
    }

    /// All of them, in the order of their numbers.
    pub(crate) fn all(&self) -> impl Iterator<Item = (usize, usize)> + use<> {
        let [north, east] = self.cells;
        (0..north).flat_map(move |i| (0..east).map(move |j| (i, j)))
    }

    /// A value for each, in the order of their numbers.
    pub(crate) fn values<T>(&self, of: impl Fn((usize, usize)) -> T) -> Vec<T> {
        self.all().map(of).collect()
    }

    pub(crate) fn nearest(&self, point: [f32; 2]) -> (usize, usize) {
        let index = |axis: usize| {
            let cell = ((point[axis] - self.origin_m[axis]) / self.cell_m).round().max(0.0) as usize;
            cell.min(self.cells[axis] - 1)
        };
        (index(0), index(1))
    }

    /// Calls `cell` for each point that is nearer to a solid than `reach_m`, with its distance.
    pub(crate) fn near(&self, solid: &Solid, reach_m: f32, mut cell: impl FnMut((usize, usize), f32)) {
        let centre = solid.centre_ned_m();
        let (half_north_m, half_east_m) = solid.plan_half_extents_m();
        let rows = self.span(0, centre.x, half_north_m + reach_m);
        let columns = self.span(1, centre.y, half_east_m + reach_m);
        let distance_m = solid.plan_distances_m();
        for i in rows {
            for j in columns.clone() {
                let [north_m, east_m] = self.point((i, j));
                let distance_m = distance_m(north_m, east_m);
                if distance_m < reach_m {
                    cell((i, j), distance_m);
                }
            }
        }
    }

    /// Points along an axis within `reach_m` of `centre_m`.
    fn span(&self, axis: usize, centre_m: f32, reach_m: f32) -> core::ops::Range<usize> {
        let count = self.cells[axis];
        let low = ((centre_m - reach_m - self.origin_m[axis]) / self.cell_m).max(0.0) as usize;
        let high = ((centre_m + reach_m - self.origin_m[axis]) / self.cell_m).max(0.0) as usize + 2;
        low.min(count)..high.min(count)
    }
}

/// Free cells of a course's plan view.
pub(crate) struct Grid {
    pub(crate) lattice: Lattice,
    /// What a cell's centre keeps from every solid.
    pub(crate) clearance_m: f32,
    free: Vec<bool>,
}

impl Grid {
    /// Marks as free what keeps the vehicle's radius and the margin from every solid and from the bounds.
    pub(crate) fn new(course: &Course, solids: &[Solid]) -> Self {
        let b = &course.bounds;
        let area_m2 = (b.north_m[1] - b.north_m[0]) * (b.east_m[1] - b.east_m[0]);
        let finest_m = match course.family {
            Some(Family::Hard) => HARD_CELL_M,
            _ => CELL_M,
        };
        let cell_m = finest_m.max((area_m2 / MAX_CELLS).sqrt());
        // Half a cell's diagonal more, so that the way between two neighbouring cells keeps the margin too.
        let clearance_m = VEHICLE.radius_m + course.corridor_margin_m() + 0.5 * core::f32::consts::SQRT_2 * cell_m;
        let cells = |range: [f32; 2]| ((range[1] - range[0]) / cell_m) as usize + 1;
        let lattice = Lattice {
            cell_m,
            cells: [cells(b.north_m), cells(b.east_m)],
            origin_m: [b.north_m[0], b.east_m[0]],
        };
        let edge = (clearance_m / cell_m).ceil() as usize;
        let inside = |k: usize, count: usize| k >= edge && k + edge < count;
        let [north, east] = lattice.cells;
        let mut free = lattice.values(|(i, j)| inside(i, north) && inside(j, east));
        for solid in solids {
            lattice.near(solid, clearance_m, |cell, _| free[lattice.number(cell)] = false);
        }
        Self {
            lattice,
            clearance_m,
            free,
        }
    }

    pub(crate) fn is_free(&self, cell: (usize, usize)) -> bool {
        self.free[self.lattice.number(cell)]
    }

    /// Free neighbours with the step's cost in tenths of a cell; diagonals only between two free orthogonal neighbours.
    fn neighbours(&self, (i, j): (usize, usize)) -> impl Iterator<Item = ((usize, usize), u32)> + '_ {
        const STEPS: [(isize, isize); 8] = [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)];
        let [north, east] = self.lattice.cells;
        let at = move |di: isize, dj: isize| {
            let (i, j) = (i.checked_add_signed(di)?, j.checked_add_signed(dj)?);
            (i < north && j < east && self.is_free((i, j))).then_some((i, j))
        };
        STEPS.into_iter().filter_map(move |(di, dj)| {
            let to = at(di, dj)?;
            if di != 0 && dj != 0 {
                at(di, 0)?;
                at(0, dj)?;
                return Some((to, 14));
            }
            Some((to, 10))
        })
    }

    /// Whether a [`search`](Self::search) finds a path: its diagonals only shorten paths of single steps, so those decide. What was looked at
    /// is no longer free.
    fn joins(&mut self, start: (usize, usize), goal: (usize, usize)) -> bool {
        let mut open = vec![start];
        while let Some(cell) = open.pop() {
            let number = self.lattice.number(cell);
            if !core::mem::take(&mut self.free[number]) {
                continue;
            }
            if cell == goal {
                return true;
            }
            // Free cells keep away from the grid's edge. The last is tried first: the path to the goal.
            let (i, j) = cell;
            let rows = if goal.0 > i { [i - 1, i + 1] } else { [i + 1, i - 1] };
            let columns = if goal.1 > j { [j - 1, j + 1] } else { [j + 1, j - 1] };
            open.extend([(rows[0], j), (i, columns[0]), (i, columns[1]), (rows[1], j)]);
        }
        false
    }

    /// A* with the octile distance. Ties are broken by cell number, so the path is the same everywhere.
    fn search(&self, start: (usize, usize), goal: (usize, usize)) -> Option<Vec<(usize, usize)>> {
        if !self.is_free(start) || !self.is_free(goal) {
            return None;
        }
        let number = |cell| self.lattice.number(cell);
        let east = self.lattice.cells[1];
        let estimate = |(i, j): (usize, usize)| {
            let (di, dj) = (i.abs_diff(goal.0) as u32, j.abs_diff(goal.1) as u32);
            10 * di.max(dj) + 4 * di.min(dj)
        };
        let mut cost = vec![u32::MAX; self.free.len()];
        let mut from = vec![u32::MAX; self.free.len()];
        let mut open = BinaryHeap::new();
        cost[number(start)] = 0;
        open.push(Reverse((estimate(start), number(start) as u32)));
        while let Some(Reverse((total, n))) = open.pop() {
            let cell = (n as usize / east, n as usize % east);
            let so_far = cost[n as usize];
            if total > so_far + estimate(cell) {
                continue;
            }
            if cell == goal {
                let mut path = vec![cell];
                let mut at = n;
                while from[at as usize] != u32::MAX {
                    at = from[at as usize];
                    path.push((at as usize / east, at as usize % east));
                }
                path.reverse();
                return Some(path);
            }
            for (next, step) in self.neighbours(cell) {
                let k = number(next);
                if so_far + step < cost[k] {
                    cost[k] = so_far + step;
                    from[k] = n;
                    open.push(Reverse((so_far + step + estimate(next), k as u32)));
                }
            }
        }
        None
    }
}

/// Whether a straight line keeps `enough_m` from every solid in the plan view, looked at every 5 cm.
fn line_keeps(solids: &[Solid], from: [f32; 2], to: [f32; 2], enough_m: f32) -> bool {
    const PACE_M: f32 = 0.05;
    let length_m = libm::hypotf(to[0] - from[0], to[1] - from[1]);
    let paces = (length_m / PACE_M).ceil().max(1.0) as usize;
    solids.iter().all(|solid| {
        let distance_m = solid.plan_distances_m();
        let mut pace = 0;
        while pace <= paces {
            let f = pace as f32 / paces as f32;
            let spare_m = distance_m(from[0] + f * (to[0] - from[0]), from[1] + f * (to[1] - from[1])) - enough_m;
            if spare_m < 0.0 {
                return false;
            }
            // No distance falls by more than the path: what is spare here needs no look on so much of it; 1 mm for rounding.
            pace += 1 + ((spare_m - 1e-3).max(0.0) / PACE_M) as usize;
        }
        true
    })
}

impl Course {
    /// Free space that this course's corridor keeps: [`HARD_CORRIDOR_MARGIN_M`] in the hard family, [`CORRIDOR_MARGIN_M`] in
    /// all others.
    pub fn corridor_margin_m(&self) -> f32 {
        match self.family {
            Some(Family::Hard) => HARD_CORRIDOR_MARGIN_M,
            _ => CORRIDOR_MARGIN_M,
        }
    }

    /// What reaches into the heights at which a corridor is free.
    pub(crate) fn solids_in_the_way(&self) -> Vec<Solid> {
        self.solids_in_band(self.corridor_reach_m())
    }

    /// How far above and below the flight height a corridor is free.
    pub(crate) fn corridor_reach_m(&self) -> f32 {
        0.5 * VEHICLE.height_m + self.corridor_margin_m()
    }

    /// A path from start to goal at flight height as `[north, east]` points, along which the vehicle's solid keeps
    /// [`Course::corridor_margin_m`] from every obstacle that stands still (and from the ceiling); `None` if the search finds
    /// none. Movers are the matter of [`Course::earliest_arrival_s`].
    pub fn corridor(&self) -> Option<Vec<[f32; 2]>> {
        let solids = self.solids_in_the_way();
        let (grid, [start, goal]) = self.corridor_grid(&solids)?;
        let cells = grid.search(grid.lattice.nearest(start), grid.lattice.nearest(goal))?;
        let mut points = vec![start];
        points.extend(cells.iter().map(|cell| grid.lattice.point(*cell)));
        points.push(goal);
        Some(self.shortened(&solids, &points))
    }

    /// Whether there is a [`corridor`](Self::corridor).
    pub(crate) fn has_corridor(&self) -> bool {
        self.corridor_grid(&self.solids_in_the_way())
            .is_some_and(|(mut grid, ends)| {
                let [start, goal] = ends.map(|end| grid.lattice.nearest(end));
                grid.joins(start, goal)
            })
    }

    /// The grid of a corridor, and its start and goal; none where the height allows none.
    fn corridor_grid(&self, solids: &[Solid]) -> Option<(Grid, [[f32; 2]; 2])> {
        let reach_m = self.corridor_reach_m();
        let top_m = self
            .ceiling_height_m
            .map_or(self.bounds.top_m, |c| c.min(self.bounds.top_m));
        let ends = [
            [self.start.north_m, self.start.east_m],
            [self.goal.north_m, self.goal.east_m],
        ];
        (self.flight_height_m + reach_m <= top_m).then(|| (Grid::new(self, solids), ends))
    }

    /// Replaces stretches of a path by straight lines where these keep the margin.
    fn shortened(&self, solids: &[Solid], points: &[[f32; 2]]) -> Vec<[f32; 2]> {
        let enough_m = VEHICLE.radius_m + self.corridor_margin_m();
        let mut kept = vec![points[0]];
        let mut at = 0;
        while at + 1 < points.len() {
            // Doubling, then halving back: the furthest reachable point is found in few line checks.
            let mut reach = at + 1;
            let mut step = 1;
            while step > 0 {
                let next = (reach + step).min(points.len() - 1);
                if next > reach && line_keeps(solids, points[at], points[next], enough_m) {
                    reach = next;
                    step *= 2;
                } else {
                    step /= 2;
                }
            }
            kept.push(points[reach]);
            at = reach;
        }
        kept
    }

    /// Whether the vehicle, flying straight from start to goal at flight height, would touch an obstacle.
    pub fn straight_line_is_blocked(&self) -> bool {
        let half_m = 0.5 * VEHICLE.height_m;
        let hit = self.solids_in_band(half_m);
        let from = [self.start.north_m, self.start.east_m];
        let to = [self.goal.north_m, self.goal.east_m];
        !line_keeps(&hit, from, to, VEHICLE.radius_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::field;

    fn course(obstacles: &str) -> Course {
        field(5.0, 10.0, obstacles)
    }

    fn wall(from: [f32; 2], to: [f32; 2], height_m: f32) -> String {
        format!("[[wall]]\nfrom_m = {from:?}\nto_m = {to:?}\nthickness_m = 0.2\nheight_m = {height_m:?}\n")
    }

    #[test]
    fn an_open_field_is_flown_straight() {
        let c = course("");
        let path = c.corridor().expect("open");
        assert_eq!(path, vec![[0.0, 0.0], [20.0, 5.0]]);
        assert!(!c.straight_line_is_blocked());
    }

    #[test]
    fn a_wall_right_across_or_a_ceiling_too_low_leaves_no_way_and_a_low_wall_does() {
        assert!(course("ceiling_height_m = 1.9").corridor().is_none());
        assert!(course(&wall([10.0, -10.0], [10.0, 10.0], 3.0)).corridor().is_none());
        assert!(course(&wall([10.0, -10.0], [10.0, 10.0], 0.7)).corridor().is_some());
    }

    #[test]
    fn a_gap_counts_only_when_vehicle_and_margins_fit() {
        let gap = |width: f32| {
            course(&(wall([10.0, -10.0], [10.0, -width / 2.0], 3.0) + &wall([10.0, width / 2.0], [10.0, 10.0], 3.0)))
        };
        assert!(gap(1.7).corridor().is_none());
        assert!(gap(2.5).straight_line_is_blocked() && gap(2.5).corridor().is_some());
    }

    #[test]
    fn whether_there_is_a_way_is_known_without_it() {
        use crate::world::generate;
        for (family, seed) in Family::ALL
            .into_iter()
            .flat_map(|family| (0..20).map(move |seed| (family, seed)))
        {
            let mut c = generate(family, seed);
            assert!(c.has_corridor() && c.corridor().is_some(), "{family} {seed}");
            c.walls.push(crate::world::Wall {
                from_m: [3.0 + 0.7 * seed as f32, -12.0],
                to_m: [3.0 + 0.7 * seed as f32, 9.0 + 0.1 * seed as f32],
                thickness_m: 0.2,
                height_m: 3.0,
            });
            assert_eq!(c.has_corridor(), c.corridor().is_some(), "{family} {seed}");
        }
    }

    #[test]
    fn a_high_beam_is_flown_under_and_a_low_one_is_not() {
        let beam = |bottom: f32| {
            course(&format!(
                "[[overhang]]\nnorth_m = 10.0\neast_m = 0.0\nlength_m = 0.5\nwidth_m = 20.0\nbottom_m = {bottom:?}\ntop_m = 4.0\n"
            ))
        };
        assert!(beam(2.4).corridor().is_some());
        assert!(beam(1.8).corridor().is_none());
        assert!(beam(1.2).straight_line_is_blocked());
        assert!(!beam(1.8).straight_line_is_blocked());
    }

    #[test]
    fn the_largest_bounds_are_searched_too() {
        let mut c = course("");
        c.bounds.north_m = [-1000.0, 1000.0];
        c.bounds.east_m = [-1000.0, 1000.0];
        (c.goal.north_m, c.goal.east_m) = (900.0, -900.0);
        assert!(c.corridor().is_some());
    }
}
