//! The path to the goal around remembered obstacles: an A* search over the memory's grid, a slice per step.
//!
//! The search runs from the goal to the vehicle, so that each settled cell knows its next cell towards the goal. A goal
//! outside the grid enters through the grid's border, each border cell at its straight distance to the goal. Costs are
//! integers and the open list is an array of buckets threaded through fixed arrays: no allocation, bounded work, and the
//! same way for the same input on any machine.

use crate::geometric::occupancy_grid::{CELL_M, CELLS, Cell, OccupancyGrid, SIDE};
use vigil_types::NedVector;

/// Cost of one cell straight ahead; a diagonal costs 14. One unit is [`CELL_M`] / 10.
const STRAIGHT: u32 = 10;
const DIAGONAL: u32 = 14;
/// Extra cost of each cell off the path found before: a new path must be some 10 % shorter to replace it.
const OFF_PATH: u32 = 1;
/// The vehicle's middle does not go nearer to an obstacle than this by choice: its radius of 0.30 m and 0.15 m.
pub const LETHAL_CLEARANCE_M: f32 = 0.45;
/// Clearance from which on more is no better.
const WANTED_CLEARANCE_M: f32 = 1.25;
/// What the narrowest passage costs more than an open one, per metre.
const NARROW_FACTOR: f32 = 5.0;
/// Cost factor within [`LETHAL_CLEARANCE_M`], where only the ends of the path may lie.
const LETHAL_FACTOR: u16 = 20 << FACTOR_SHIFT;
/// Around vehicle and goal, cells within [`LETHAL_CLEARANCE_M`] of an obstacle may be passed: cells, squared.
const END_RADIUS_SQUARED: i32 = 9;
/// Cost factors are in quarters: 2 bits after the point.
const FACTOR_SHIFT: u32 = 2;
/// Squared clearances that have a factor of their own.
const FACTORS: usize = 64;

const BUCKETS: usize = 8192;
const NO_CELL: u16 = u16::MAX;
const UNREACHED: u16 = u16::MAX;
/// Direction code of a cell where the path ends.
const END: u8 = 8;
/// Flag beside the direction: the cell's cost is final.
const SETTLED: u8 = 0x80;
/// Longest path kept, in cells.
pub const PATH_POINTS: usize = 320;

/// Eight neighbours: (north, east, cost).
const NEIGHBOURS: [(i32, i32, u32); 8] = [
    (1, 0, STRAIGHT),
    (1, 1, DIAGONAL),
    (0, 1, STRAIGHT),
    (-1, 1, DIAGONAL),
    (-1, 0, STRAIGHT),
    (-1, -1, DIAGONAL),
    (0, -1, STRAIGHT),
    (1, -1, DIAGONAL),
];

/// Where a search stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Search {
    /// Slices remain.
    Working,
    /// Just ended: the path was replaced.
    Found,
    /// Just ended: no path leads to the goal.
    NoPath,
}

/// The search and the last path found.
#[derive(Debug, Clone)]
pub struct PathPlanner {
    /// Cost from the goal to each cell.
    cost: [u16; CELLS],
    /// Direction code towards the goal, and [`SETTLED`].
    towards: [u8; CELLS],
    /// Doubly linked open lists, one per bucket of estimated total cost.
    next: [u16; CELLS],
    previous: [u16; CELLS],
    bucket: [u16; BUCKETS],
    /// Lowest bucket that may hold a cell.
    lowest: usize,
    /// Estimated total cost of bucket 0.
    base: u32,
    /// Whether a search is under way. Ended where the grid was moved beneath it; the last path stays.
    pub(super) working: bool,
    vehicle: Cell,
    goal: Cell,
    /// Cost factor by squared clearance, in quarters; 0 where nothing passes.
    factor: [u16; FACTORS],
    /// Squared clearance below which only the ends of a path may lie.
    lethal_squared: u8,
    on_path: [bool; CELLS],
    points: [(f32, f32); PATH_POINTS],
    len: usize,
}

impl PathPlanner {
    /// No path yet.
    pub fn new() -> Self {
        let mut path = Self {
            cost: [UNREACHED; CELLS],
            towards: [END; CELLS],
            next: [NO_CELL; CELLS],
            previous: [NO_CELL; CELLS],
            bucket: [NO_CELL; BUCKETS],
            lowest: 0,
            base: 0,
            working: false,
            vehicle: Cell { north: 0, east: 0 },
            goal: Cell { north: 0, east: 0 },
            factor: [0; FACTORS],
            lethal_squared: 0,
            on_path: [false; CELLS],
            points: [(0.0, 0.0); PATH_POINTS],
            len: 0,
        };
        for (squared, factor) in path.factor.iter_mut().enumerate() {
            let clearance_m = libm::sqrtf(squared as f32) * CELL_M;
            if clearance_m < LETHAL_CLEARANCE_M {
                path.lethal_squared = squared as u8 + 1;
                *factor = if squared == 0 { 0 } else { LETHAL_FACTOR };
            } else {
                let lack = ((WANTED_CLEARANCE_M - clearance_m) / (WANTED_CLEARANCE_M - LETHAL_CLEARANCE_M)).max(0.0);
                *factor = ((1.0 + NARROW_FACTOR * lack * lack) * (1 << FACTOR_SHIFT) as f32) as u16;
            }
        }
        path
    }

    /// Forgets the path and the search.
    pub fn clear(&mut self) {
        self.working = false;
        self.len = 0;
    }

    /// The last path found, from the vehicle to the goal (or to the grid's border), as NED (north, east) metres.
    pub fn points(&self) -> &[(f32, f32)] {
        self.points.get(..self.len).unwrap_or(&[])
    }

    /// Begins a search from the vehicle's position to the goal's.
    pub fn start(&mut self, memory: &OccupancyGrid, position_ned_m: NedVector, goal_ned_m: NedVector) {
        self.cost.fill(UNREACHED);
        self.towards.fill(END);
        self.bucket.fill(NO_CELL);
        self.lowest = BUCKETS - 1;
        self.working = true;
        self.vehicle = memory.cell_of(position_ned_m.x, position_ned_m.y);
        self.goal = memory.cell_of(goal_ned_m.x, goal_ned_m.y);
        self.mark_path(memory);
        if interior(self.goal) {
            // The goal may lie within an obstacle's cell: any free cell around it will do.
            let goal = self.goal;
            let around = (-2..=2).flat_map(|north| (-2..=2).map(move |east| goal.moved(north, east)));
            self.open_ends(memory, around);
        } else {
            let last = SIDE as i32 - 2;
            let border = (1..=last).flat_map(|i| [(1, i), (last, i), (i, 1), (i, last)]);
            self.open_ends(memory, border.map(|(north, east)| Cell { north, east }));
        }
    }

    /// Settles up to `budget` cells of the search that is under way.
    pub fn advance(&mut self, memory: &OccupancyGrid, budget: usize) -> Search {
        for _ in 0..budget {
            let Some(index) = self.take_lowest() else {
                self.working = false;
                return Search::NoPath;
            };
            let cell = Cell::of_index(index);
            if cell == self.vehicle {
                self.working = false;
                self.keep_path(memory);
                return Search::Found;
            }
            let cost = u32::from(self.cost.get(index).copied().unwrap_or(UNREACHED));
            for (towards, &(north, east, length)) in (0_u8..).zip(&NEIGHBOURS) {
                // From the neighbour, the path leads back here: the opposite direction.
                let towards = (towards + 4) % 8;
                let neighbour = cell.moved(north, east);
                let Some(index) = neighbour.index() else { continue };
                if self.towards.get(index).is_none_or(|t| t & SETTLED != 0) {
                    continue;
                }
                let factor = self.factor_of(memory, index, neighbour);
                if factor == 0 {
                    continue;
                }
                let is_on_path = self.on_path.get(index) == Some(&true);
                let off_path = if is_on_path { 0 } else { OFF_PATH };
                let through = cost + ((length * factor) >> FACTOR_SHIFT) + off_path;
                self.open(index, neighbour, through, towards);
            }
        }
        Search::Working
    }

    /// Opens the cells where a path may end, each at its straight distance from the goal.
    fn open_ends(&mut self, memory: &OccupancyGrid, cells: impl Iterator<Item = Cell> + Clone) {
        // Costs count from the nearest end, so that a goal kilometres away costs no more bits.
        let (goal, vehicle) = (self.goal, self.vehicle);
        let nearest = cells.clone().map(|c| octile(c, goal)).min().unwrap_or(0);
        let total = |c: Cell| (octile(c, goal) - nearest).saturating_add(octile(c, vehicle));
        self.base = cells.clone().map(total).min().unwrap_or(0);
        for cell in cells {
            let Some(index) = cell.index() else { continue };
            if self.factor_of(memory, index, cell) != 0 {
                self.open(index, cell, octile(cell, goal) - nearest, END);
            }
        }
    }

    /// Enters a cell into the open list at this cost, or moves it there if it is in the list at a higher one.
    fn open(&mut self, index: usize, cell: Cell, cost: u32, towards: u8) {
        let (Ok(cost16), Some(known)) = (u16::try_from(cost), self.cost.get(index).copied()) else {
            return;
        };
        if cost16 >= known {
            return;
        }
        if known != UNREACHED {
            self.unlink(index, self.bucket_of(u32::from(known), cell));
        }
        let bucket = self.bucket_of(cost, cell);
        self.lowest = self.lowest.min(bucket);
        let Some(head) = self.bucket.get_mut(bucket) else {
            return;
        };
        let following = core::mem::replace(head, index as u16);
        put(&mut self.previous, usize::from(following), index as u16);
        put(&mut self.next, index, following);
        put(&mut self.previous, index, NO_CELL);
        put(&mut self.cost, index, cost16);
        put(&mut self.towards, index, towards);
    }

    /// Bucket of an open cell: its estimated total cost above the least possible one.
    #[inline]
    fn bucket_of(&self, cost: u32, cell: Cell) -> usize {
        let total = cost + octile(cell, self.vehicle);
        (total.saturating_sub(self.base) as usize).min(BUCKETS - 1)
    }

    fn unlink(&mut self, index: usize, bucket: usize) {
        let previous = self.previous.get(index).copied().unwrap_or(NO_CELL);
        let next = self.next.get(index).copied().unwrap_or(NO_CELL);
        put(&mut self.previous, usize::from(next), previous);
        if previous == NO_CELL {
            put(&mut self.bucket, bucket, next);
        } else {
            put(&mut self.next, usize::from(previous), next);
        }
    }

    /// Takes an open cell of least estimated total cost and settles it.
    fn take_lowest(&mut self) -> Option<usize> {
        let (skipped, head) = self
            .bucket
            .get(self.lowest..)?
            .iter()
            .copied()
            .enumerate()
            .find(|&(_, head)| head != NO_CELL)?;
        self.lowest += skipped;
        let index = usize::from(head);
        self.unlink(index, self.lowest);
        if let Some(t) = self.towards.get_mut(index) {
            *t |= SETTLED;
        }
        Some(index)
    }

    /// Cost factor of a cell, in quarters; 0 where the vehicle must not go.
    #[inline]
    fn factor_of(&self, memory: &OccupancyGrid, index: usize, cell: Cell) -> u32 {
        if !interior(cell) {
            return 0;
        }
        let squared = memory.clearance_squared(index);
        let factor = u32::from(self.factor.get(usize::from(squared)).copied().unwrap_or(0));
        if squared >= self.lethal_squared {
            return factor;
        }
        let (to_vehicle, to_goal) = (squared_distance(cell, self.vehicle), squared_distance(cell, self.goal));
        if to_vehicle <= 2 {
            // The vehicle is here, whatever the memory says.
            u32::from(LETHAL_FACTOR)
        } else if to_vehicle <= END_RADIUS_SQUARED || to_goal <= END_RADIUS_SQUARED {
            factor
        } else {
            0
        }
    }

    /// Walks from the vehicle to the end of the path and keeps the cells' middles.
    fn keep_path(&mut self, memory: &OccupancyGrid) {
        self.len = 0;
        let mut cell = self.vehicle;
        for point in &mut self.points {
            let Some(&towards) = cell.index().and_then(|i| self.towards.get(i)) else {
                break;
            };
            *point = memory.middle_of(cell);
            self.len += 1;
            let Some(&(north, east, _)) = NEIGHBOURS.get(usize::from(towards & !SETTLED)) else {
                break;
            };
            cell = cell.moved(north, east);
        }
    }

    /// Marks the cells of the last path and their neighbours, for the search to prefer.
    fn mark_path(&mut self, memory: &OccupancyGrid) {
        self.on_path.fill(false);
        for &(north_m, east_m) in self.points.iter().take(self.len) {
            let cell = memory.cell_of(north_m, east_m);
            for (north, east) in NEIGHBOURS.iter().map(|n| (n.0, n.1)).chain([(0, 0)]) {
                if let Some(index) = cell.moved(north, east).index() {
                    put(&mut self.on_path, index, true);
                }
            }
        }
    }
}

/// Whether a cell is within the grid and not of its outermost frame, which the search never enters.
#[inline]
fn interior(cell: Cell) -> bool {
    let inner = 1..SIDE as i32 - 1;
    inner.contains(&cell.north) && inner.contains(&cell.east)
}

fn squared_distance(a: Cell, b: Cell) -> i32 {
    let (dn, de) = (a.north.saturating_sub(b.north), a.east.saturating_sub(b.east));
    dn.saturating_mul(dn).saturating_add(de.saturating_mul(de))
}

/// Writes an item; an index out of range (such as [`NO_CELL`]) writes nothing.
#[inline]
fn put<T>(items: &mut [T], index: usize, value: T) {
    if let Some(slot) = items.get_mut(index) {
        *slot = value;
    }
}

/// Length of the shortest path over free cells.
fn octile(a: Cell, b: Cell) -> u32 {
    let (dn, de) = (a.north.abs_diff(b.north), a.east.abs_diff(b.east));
    let (long, short) = (dn.max(de), dn.min(de));
    (long - short)
        .saturating_mul(STRAIGHT)
        .saturating_add(short.saturating_mul(DIAGONAL))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::boxed::Box;

    fn at(north: f32, east: f32) -> NedVector {
        NedVector::new(north, east, -1.5)
    }

    fn wall(north: f32, east: core::ops::Range<f32>) -> impl Iterator<Item = (f32, f32)> {
        let count = ((east.end - east.start) / CELL_M) as usize;
        (0..count).map(move |i| (north, east.start + CELL_M * i as f32))
    }

    fn search(path: &mut PathPlanner, memory: &OccupancyGrid, goal: (f32, f32)) -> Search {
        path.start(memory, at(0.0, 0.0), at(goal.0, goal.1));
        path.advance(memory, usize::MAX)
    }

    fn found(memory: &OccupancyGrid, goal: (f32, f32)) -> Box<PathPlanner> {
        let mut path = Box::new(PathPlanner::new());
        assert_eq!(search(&mut path, memory, goal), Search::Found);
        path
    }

    fn length_m(path: &PathPlanner) -> f32 {
        path.points()
            .windows(2)
            .map(|p| (p[0].0 - p[1].0).hypot(p[0].1 - p[1].1))
            .sum()
    }

    #[test]
    fn without_obstacles_the_way_is_straight_and_ends_at_the_goal() {
        let path = found(&OccupancyGrid::of([]), (8.0, 0.1));
        assert!((length_m(&path) - 8.0).abs() < 0.8, "{}", length_m(&path));
        let end = path.points().last().expect("a path");
        assert!((end.0 - 8.0).abs() < 0.8 && end.1.abs() < 0.8, "{end:?}");
    }

    #[test]
    fn a_goal_beyond_the_grid_is_approached_through_its_border_however_far() {
        let memory = OccupancyGrid::of(wall(4.0, -6.0..2.0));
        let mut path = Box::new(PathPlanner::new());
        for goal in [(20.0, 0.0), (400.0, 0.0), (90_000.0, 0.0)] {
            assert_eq!(search(&mut path, &memory, goal), Search::Found);
            let end = path.points().last().expect("a path");
            assert!(end.0 > 11.0 && end.1.abs() < 6.0, "{goal:?}: {end:?}");
            assert!(path.points().iter().any(|p| p.0 > 3.5 && p.1 > 2.2), "around the right");
        }
    }

    #[test]
    fn no_cell_of_the_way_is_too_near_to_an_obstacle() {
        let memory = OccupancyGrid::of(wall(4.0, -6.0..-1.0).chain(wall(4.0, 1.0..6.0)).chain([(7.0, 0.0)]));
        let path = found(&memory, (9.0, 0.0));
        for &(north, east) in path.points() {
            assert!(f32::from(memory.clearance_squared_at(north, east)).sqrt() * CELL_M >= LETHAL_CLEARANCE_M);
        }
        let length_m = length_m(&path);
        assert!(length_m < 11.0, "through the gap, not around: {length_m}");
    }

    #[test]
    fn an_enclosed_vehicle_has_no_way() {
        let ring = (0..628_u16).map(|i| {
            let a = 0.01 * f32::from(i);
            (3.0 * libm::cosf(a), 3.0 * libm::sinf(a))
        });
        let memory = OccupancyGrid::of(ring);
        let mut path = Box::new(PathPlanner::new());
        assert_eq!(search(&mut path, &memory, (9.0, 0.0)), Search::NoPath);
    }

    #[test]
    fn slices_find_the_same_way_as_one_go() {
        let memory = OccupancyGrid::of(wall(4.0, -6.0..2.0).chain(wall(7.0, -1.0..8.0)));
        let whole = found(&memory, (20.0, -3.0));
        let mut sliced = Box::new(PathPlanner::new());
        sliced.start(&memory, at(0.0, 0.0), at(20.0, -3.0));
        let mut slices = 0;
        while sliced.advance(&memory, 100) == Search::Working {
            slices += 1;
        }
        assert!(slices > 5);
        assert!(whole.points() == sliced.points() && !whole.points().is_empty());
    }

    #[test]
    fn of_two_equal_ways_the_one_taken_before_is_kept() {
        // The wall reaches farther left at first, so the path goes right.
        let mut path = found(&OccupancyGrid::of(wall(4.0, -4.0..2.5)), (9.0, 0.0));
        let right = |path: &PathPlanner| path.points().iter().any(|p| p.1 > 2.0);
        assert!(right(&path));
        // Seen wholly, left would be a little shorter: not enough to turn around.
        let seen = OccupancyGrid::of(wall(4.0, -2.75..3.25));
        assert_eq!(search(&mut path, &seen, (9.0, 0.0)), Search::Found);
        assert!(right(&path));
        assert!(!right(&found(&seen, (9.0, 0.0))));
    }

    #[test]
    fn the_way_is_as_short_as_a_plain_dijkstra_search_says() {
        let memory = OccupancyGrid::of(
            wall(3.0, -3.0..6.0)
                .chain(wall(6.0, -8.0..1.0))
                .chain([(1.5, -3.0), (8.0, 3.0)]),
        );
        let path = found(&memory, (9.0, 4.0));
        let found = path.cost[path.vehicle.index().expect("inside")];

        // Bellman-Ford over the same costs, from the same ends, until nothing changes.
        let mut cost = std::vec![u32::MAX; CELLS];
        for north in -2..=2 {
            for east in -2..=2 {
                let cell = path.goal.moved(north, east);
                cost[cell.index().expect("inside")] = octile(cell, path.goal);
            }
        }
        loop {
            let mut changed = false;
            for index in 0..CELLS {
                let cell = Cell::of_index(index);
                let factor = path.factor_of(&memory, index, cell);
                if factor == 0 {
                    continue;
                }
                for (north, east, length) in NEIGHBOURS {
                    let from = cell.moved(north, east).index();
                    let before = from.map_or(u32::MAX, |i| cost[i]);
                    if before != u32::MAX {
                        let through = before + ((length * factor) >> FACTOR_SHIFT) + OFF_PATH;
                        changed |= through < cost[index];
                        cost[index] = cost[index].min(through);
                    }
                }
            }
            if !changed {
                break;
            }
        }
        assert_eq!(u32::from(found), cost[path.vehicle.index().expect("inside")]);
    }
}
