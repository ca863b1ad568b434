//! A short memory of obstacles around the vehicle: a grid in NED that moves along with it.
//!
//! The LiDAR sees 120°; what the vehicle passes is beside it, unseen. The grid keeps it, forgets what the vehicle has
//! left behind by more than half the grid's side, and frees a cell again when rays are seen to pass through it.

use crate::geometric::range_scan::{BAND_HALF_HEIGHT_M, Scan};
use crate::smaller;
use vigil_types::NedVector;

/// Edge of a cell in metres.
pub const CELL_M: f32 = 0.25;
/// Cells along one side; the grid covers ±12 m.
pub const SIDE: usize = 96;
/// Cells of the grid.
pub const CELLS: usize = SIDE * SIDE;

/// Clearance is exact up to this many cells and reported as this beyond it.
const CLEARANCE_LIMIT_CELLS: usize = 6;
const CLEARANCE_LIMIT_SQUARED: u8 = (CLEARANCE_LIMIT_CELLS * CLEARANCE_LIMIT_CELLS) as u8;

/// What a surface adds to a cell's score, and the score from which on it is an obstacle.
pub const HIT: i8 = 4;
/// What it adds when the range may be wrong by a metre: rays outvote a surface that is not there again and again.
pub const DOUBTFUL_HIT: i8 = 2;
/// The most a score can be: a cell is free again after as many rays.
pub const SCORE_LIMIT: i8 = 12;
/// Farther surfaces are left to later frames.
pub const MARK_RANGE_M: f32 = 11.0;
/// Nearer than this, the band of heights is not wholly within the vertical field of view (0.35 m / tan 30°, and tilt):
/// a ray there does not prove that a cell is free.
const FREE_FROM_M: f32 = 1.0;
/// A ray proves cells free up to this far before its surface.
const FREE_SHORT_OF_SURFACE_M: f32 = 0.4;
/// What was seen at a height that is farther from the vehicle's than this is not at its own: the bands of both do not touch, metres.
const LEVEL_M: f32 = 2.0 * BAND_HALF_HEIGHT_M;
/// The grid is moved when the vehicle is this many cells off its middle.
const RECENTRE_CELLS: u32 = 8;

/// A cell by its column (north) and row (east) within the grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cell {
    /// Cells north of the grid's south-western corner.
    pub north: i32,
    /// Cells east of it.
    pub east: i32,
}

impl Cell {
    /// Index into the grid's arrays, if the cell is within the grid.
    #[inline]
    pub fn index(self) -> Option<usize> {
        let side = 0..SIDE as i32;
        (side.contains(&self.north) && side.contains(&self.east))
            .then(|| self.north as usize * SIDE + self.east as usize)
    }

    /// The cell so many farther north and east.
    #[inline]
    pub fn moved(self, north: i32, east: i32) -> Self {
        Self {
            north: self.north + north,
            east: self.east + east,
        }
    }

    /// The cell of an index.
    #[inline]
    pub fn of_index(index: usize) -> Self {
        Self {
            north: (index / SIDE) as i32,
            east: (index % SIDE) as i32,
        }
    }
}

/// The grid. Fixed size, no allocation.
#[derive(Debug, Clone)]
pub struct OccupancyGrid {
    /// Cell coordinates (NED divided by [`CELL_M`]) of the grid's south-western corner; `None` before the first frame.
    corner: Option<(i32, i32)>,
    /// How far down (NED metres) the vehicle was when the first of what is remembered was seen.
    level_m: f32,
    /// Evidence of an obstacle; 0 is free or never seen, [`HIT`] and more is an obstacle.
    score: [i8; CELLS],
    /// Squared distance to the nearest obstacle, in cells, at most [`CLEARANCE_LIMIT_SQUARED`].
    clearance_squared: [u8; CELLS],
    /// Alternates which sectors' rays free cells, to halve the work.
    parity: bool,
}

impl Default for OccupancyGrid {
    /// An empty memory.
    fn default() -> Self {
        Self {
            corner: None,
            level_m: 0.0,
            score: [0; CELLS],
            clearance_squared: [CLEARANCE_LIMIT_SQUARED; CELLS],
            parity: false,
        }
    }
}

impl OccupancyGrid {
    /// Forgets everything.
    pub fn clear(&mut self) {
        self.corner = None;
        self.score.fill(0);
        self.clearance_squared.fill(CLEARANCE_LIMIT_SQUARED);
    }

    /// NED metres (north, east) of the grid's south-western corner; `None` while nothing was entered.
    pub fn corner_ned_m(&self) -> Option<(f32, f32)> {
        self.corner.map(|(n, e)| (n as f32 * CELL_M, e as f32 * CELL_M))
    }

    /// Evidence of an obstacle by cell, [`SIDE`] rows from south to north of [`SIDE`] cells from west to east: 0 is free or never
    /// seen, from [`HIT`] on an obstacle.
    pub fn scores(&self) -> &[i8; CELLS] {
        &self.score
    }

    /// The cell of a NED position; it may lie outside the grid.
    pub fn cell_of(&self, north_m: f32, east_m: f32) -> Cell {
        let (n0, e0) = self.corner.unwrap_or((0, 0));
        // `as` saturates, and a corner is a few cells from a finite position.
        Cell {
            north: floor(north_m / CELL_M).saturating_sub(n0),
            east: floor(east_m / CELL_M).saturating_sub(e0),
        }
    }

    /// NED metres (north, east) of a cell's middle.
    pub fn middle_of(&self, cell: Cell) -> (f32, f32) {
        let (n0, e0) = self.corner.unwrap_or((0, 0));
        (
            (cell.north.saturating_add(n0) as f32 + 0.5) * CELL_M,
            (cell.east.saturating_add(e0) as f32 + 0.5) * CELL_M,
        )
    }

    /// Moves the grid so that the vehicle is near its middle. Returns whether it moved: indices of cells then changed. A vehicle that
    /// climbs or descends forgets what it saw at another height: it is neither ahead, nor free there.
    pub fn follow(&mut self, position_ned_m: NedVector) -> bool {
        if self.corner.is_some() && (position_ned_m.z - self.level_m).abs() > LEVEL_M {
            self.clear();
        }
        if self.corner.is_none() {
            self.level_m = position_ned_m.z;
        }
        let half = SIDE as i32 / 2;
        let vehicle = self.cell_of(position_ned_m.x, position_ned_m.y);
        let (north, east) = (vehicle.north.saturating_sub(half), vehicle.east.saturating_sub(half));
        match self.corner {
            Some(_) if north.unsigned_abs() <= RECENTRE_CELLS && east.unsigned_abs() <= RECENTRE_CELLS => false,
            Some((n0, e0)) => {
                shift(&mut self.score, north, east);
                self.corner = Some((n0.saturating_add(north), e0.saturating_add(east)));
                self.measure_clearance();
                true
            }
            None => {
                self.corner = Some((north, east));
                true
            }
        }
    }

    /// Enters what a scan shows from `position_ned_m` with heading `yaw_rad`.
    /// A surface adds `hit` to its cell's score, unless `passing` says of its place (north, east) that something moves there.
    pub fn observe(
        &mut self,
        scan: &Scan,
        hit: i8,
        position_ned_m: NedVector,
        yaw_rad: f32,
        passing: impl Fn(f32, f32) -> bool,
    ) {
        let (sin, cos) = (libm::sinf(yaw_rad), libm::cosf(yaw_rad));
        let to_ned = |x: f32, y: f32| (cos * x - sin * y, sin * x + cos * y);
        let (n0, e0) = self.corner.unwrap_or((0, 0));
        // Rays first, surfaces after: a ray that grazes a wall must not erase it.
        self.parity = !self.parity;
        let directions = scan.direction_forward.iter().zip(&scan.direction_right);
        for ((&dx, &dy), &range_m) in directions.zip(&scan.range_m).skip(usize::from(self.parity)).step_by(2) {
            let (north, east) = to_ned(dx, dy);
            let reach_m = smaller(range_m - FREE_SHORT_OF_SURFACE_M, MARK_RANGE_M);
            let steps = ((reach_m - FREE_FROM_M) / CELL_M).max(0.0) as usize;
            // Cells in 16.16 fixed point: a step is one addition, a cell one shift.
            let (mut n, mut e) = (
                fixed((position_ned_m.x + north * FREE_FROM_M) / CELL_M - n0 as f32),
                fixed((position_ned_m.y + east * FREE_FROM_M) / CELL_M - e0 as f32),
            );
            let (step_n, step_e) = (fixed(north), fixed(east));
            for _ in 0..steps {
                let cell = Cell {
                    north: n >> 16,
                    east: e >> 16,
                };
                if let Some(score) = cell.index().and_then(|i| self.score.get_mut(i)) {
                    *score = (*score - 1).max(0);
                }
                n = n.wrapping_add(step_n);
                e = e.wrapping_add(step_e);
            }
        }
        for (x, y, range_m) in scan.points() {
            if range_m < MARK_RANGE_M {
                let (north, east) = to_ned(x, y);
                let (north_m, east_m) = (position_ned_m.x + north, position_ned_m.y + east);
                if !passing(north_m, east_m)
                    && let Some(score) = self.score_at(north_m, east_m)
                {
                    *score = score.saturating_add(hit).min(SCORE_LIMIT);
                }
            }
        }
    }

    /// Takes what is remembered within this distance of a place for free.
    pub fn forget_around(&mut self, north_m: f32, east_m: f32, radius_m: f32) {
        let (from, to) = (
            self.cell_of(north_m - radius_m, east_m - radius_m),
            self.cell_of(north_m + radius_m, east_m + radius_m),
        );
        let side = |i: i32| i.clamp(0, SIDE as i32 - 1);
        for north in side(from.north)..=side(to.north) {
            for east in side(from.east)..=side(to.east) {
                let cell = Cell { north, east };
                let (n, e) = self.middle_of(cell);
                if libm::hypotf(n - north_m, e - east_m) < radius_m
                    && let Some(score) = cell.index().and_then(|i| self.score.get_mut(i))
                {
                    *score = 0;
                }
            }
        }
    }

    fn score_at(&mut self, north_m: f32, east_m: f32) -> Option<&mut i8> {
        let index = self.cell_of(north_m, east_m).index()?;
        self.score.get_mut(index)
    }

    /// Computes each cell's distance to the nearest obstacle, exactly, from the scores: along columns, then along rows.
    pub fn measure_clearance(&mut self) {
        // No sum below can overflow; those that saturate or wrap are written so because a checked one keeps the loop from being vectorised.
        /// Obstacles farther aside than this change nothing.
        const ASIDE: usize = CLEARANCE_LIMIT_CELLS - 1;
        let rows = self.score.as_chunks::<SIDE>().0;
        // A step of the chain along the columns is a whole row of cells side by side; along a row it would be a single cell.
        let mut along = [[0; SIDE]; SIDE];
        let mut distance = [CLEARANCE_LIMIT_CELLS as u8; SIDE];
        for (row, out) in rows.iter().zip(&mut along) {
            go_on_from_obstacles(&mut distance, row);
            *out = distance;
        }
        distance = [CLEARANCE_LIMIT_CELLS as u8; SIDE];
        for (row, out) in rows.iter().zip(&mut along).rev() {
            go_on_from_obstacles(&mut distance, row);
            for (o, d) in out.iter_mut().zip(&distance) {
                let least = (*o).min(*d);
                *o = least.wrapping_mul(least);
            }
        }
        let mut padded = [CLEARANCE_LIMIT_SQUARED; SIDE + 2 * ASIDE];
        for (row, out) in along.iter().zip(self.clearance_squared.as_chunks_mut::<SIDE>().0) {
            for (to, from) in padded.iter_mut().skip(ASIDE).zip(row) {
                *to = *from;
            }
            let mut least = [CLEARANCE_LIMIT_SQUARED; SIDE];
            for (k, shifted) in padded.windows(SIDE).enumerate() {
                let aside = k.abs_diff(ASIDE) as u8;
                let aside = aside * aside;
                for (o, a) in least.iter_mut().zip(shifted) {
                    *o = (*o).min(a.saturating_add(aside));
                }
            }
            *out = least;
        }
    }

    /// One around home with obstacles at these places, north and east.
    #[cfg(test)]
    pub(crate) fn of(places: impl IntoIterator<Item = (f32, f32)>) -> alloc::boxed::Box<Self> {
        let mut grid = alloc::boxed::Box::<Self>::default();
        grid.follow(NedVector::ZERO);
        for (north_m, east_m) in places {
            grid.occupy(north_m, east_m);
        }
        grid.measure_clearance();
        grid
    }

    /// Enters an obstacle at a NED position.
    #[cfg(test)]
    pub(crate) fn occupy(&mut self, north_m: f32, east_m: f32) {
        if let Some(score) = self.score_at(north_m, east_m) {
            *score = SCORE_LIMIT;
        }
    }

    /// Squared clearance in cells by index; 0 outside the grid.
    #[inline]
    pub fn clearance_squared(&self, index: usize) -> u8 {
        self.clearance_squared.get(index).copied().unwrap_or(0)
    }

    /// Squared clearance in cells at a NED position, as of the last [`OccupancyGrid::measure_clearance`]: between the middles of
    /// its cell and of the nearest obstacle's, at most 36, which is also the answer outside the grid.
    pub fn clearance_squared_at(&self, north_m: f32, east_m: f32) -> u8 {
        match self.cell_of(north_m, east_m).index() {
            Some(index) => self.clearance_squared(index),
            None => CLEARANCE_LIMIT_SQUARED,
        }
    }
}

/// One row farther: distances along the columns to the last obstacle passed, cells, at most [`CLEARANCE_LIMIT_CELLS`].
#[inline]
fn go_on_from_obstacles(distance: &mut [u8; SIDE], row: &[i8; SIDE]) {
    for (d, score) in distance.iter_mut().zip(row) {
        let farther = d.saturating_add(1).min(CLEARANCE_LIMIT_CELLS as u8);
        *d = if *score >= HIT { 0 } else { farther };
    }
}

/// Moves a grid's content so that cell (i + north, j + east) becomes (i, j); what enters is 0.
pub(crate) fn shift<T: Copy + Default>(grid: &mut [T; CELLS], north: i32, east: i32) {
    let (rows, columns) = (north.unsigned_abs() as usize, east.unsigned_abs() as usize);
    if rows >= SIDE || columns >= SIDE {
        grid.fill(T::default());
        return;
    }
    if north > 0 {
        grid.copy_within(rows * SIDE.., 0);
    } else if north < 0 {
        grid.copy_within(..(SIDE - rows) * SIDE, rows * SIDE);
    }
    for (i, row) in grid.as_chunks_mut::<SIDE>().0.iter_mut().enumerate() {
        let entered = if north > 0 { i >= SIDE - rows } else { i < rows };
        if entered {
            row.fill(T::default());
        } else if east > 0 {
            row.rotate_left(columns);
            row.iter_mut().rev().take(columns).for_each(|c| *c = T::default());
        } else if east < 0 {
            row.rotate_right(columns);
            row.iter_mut().take(columns).for_each(|c| *c = T::default());
        }
    }
}

/// The next integer below; saturates. (libm's `floorf` costs several times as much and this runs thousands of times a step.)
#[inline]
fn floor(x: f32) -> i32 {
    let truncated = x as i32;
    if x < truncated as f32 {
        truncated.saturating_sub(1)
    } else {
        truncated
    }
}

/// 16.16 fixed point; saturates.
#[inline]
fn fixed(x: f32) -> i32 {
    (x * 65_536.0) as i32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_seen_at_another_height_is_forgotten() {
        let mut grid = OccupancyGrid::default();
        grid.follow(NedVector::new(0.0, 0.0, -6.0));
        grid.occupy(3.0, 0.0);
        for z in [-6.3, -5.7, -5.4, -6.6] {
            grid.follow(NedVector::new(0.0, 0.0, z));
            assert!(occupied(&mut grid, 3.0, 0.0), "keeping its height, {z}");
        }
        assert!(
            grid.follow(NedVector::new(0.0, 0.0, -5.2)),
            "a search in it is worth nothing"
        );
        assert!(!occupied(&mut grid, 3.0, 0.0));
        grid.occupy(3.0, 0.0);
        grid.follow(NedVector::new(0.0, 0.0, -4.8));
        assert!(occupied(&mut grid, 3.0, 0.0), "seen from 5.2 m");
    }

    /// Nothing moves.
    const STILL: fn(f32, f32) -> bool = |_, _| false;
    use crate::geometric::range_scan::SECTORS;

    /// A scan that sees one surface straight ahead and nothing elsewhere.
    fn ahead(range_m: f32) -> Scan {
        let mut scan = Scan::EMPTY;
        // Directions a degree apart, so that rays differ.
        for (i, (x, y)) in scan
            .direction_forward
            .iter_mut()
            .zip(&mut scan.direction_right)
            .enumerate()
        {
            let bearing = (i as f32 - 63.5) * 0.0164;
            (*x, *y) = (libm::cosf(bearing), libm::sinf(bearing));
        }
        for i in SECTORS / 2 - 1..=SECTORS / 2 {
            scan.forward_m[i] = range_m;
            scan.right_m[i] = 0.0;
            scan.range_m[i] = range_m;
        }
        scan
    }

    fn at(north: f32, east: f32) -> NedVector {
        NedVector::new(north, east, -1.5)
    }

    fn occupied(memory: &mut OccupancyGrid, north: f32, east: f32) -> bool {
        memory.measure_clearance();
        memory.clearance_squared_at(north, east) == 0
    }

    #[test]
    fn what_was_seen_stays_when_the_vehicle_turns_away_and_passes() {
        let mut memory = OccupancyGrid::default();
        memory.follow(at(0.0, 0.0));
        memory.observe(&ahead(4.0), HIT, at(0.0, 0.0), 0.0, STILL);
        assert!(occupied(&mut memory, 4.1, 0.1));
        for step in 0..100_i16 {
            let here = at(0.05 * f32::from(step), 1.0);
            memory.follow(here);
            memory.observe(&Scan::EMPTY, HIT, here, 1.0, STILL);
        }
        assert!(occupied(&mut memory, 4.1, 0.1));
    }

    #[test]
    fn what_is_seen_through_is_forgotten() {
        let mut memory = OccupancyGrid::default();
        memory.follow(at(0.0, 0.0));
        memory.observe(&ahead(4.0), HIT, at(0.0, 0.0), 0.0, STILL);
        for _ in 0..2 * SCORE_LIMIT {
            memory.observe(&ahead(9.0), HIT, at(0.0, 0.0), 0.0, STILL);
        }
        assert!(!occupied(&mut memory, 4.1, 0.1));
        assert!(occupied(&mut memory, 9.1, 0.1));
    }

    #[test]
    fn a_ray_proves_nothing_about_cells_nearer_than_the_view_reaches() {
        let mut memory = OccupancyGrid::default();
        memory.follow(at(0.0, 0.0));
        memory.observe(&ahead(0.6), HIT, at(0.0, 0.0), 0.0, STILL);
        for _ in 0..50 {
            memory.observe(&ahead(9.0), HIT, at(0.0, 0.0), 0.0, STILL);
        }
        assert!(occupied(&mut memory, 0.6, 0.0));
    }

    #[test]
    fn the_grid_moves_with_the_vehicle_and_keeps_what_it_still_covers() {
        let mut memory = OccupancyGrid::default();
        memory.follow(at(100.0, -50.0));
        memory.observe(&ahead(5.0), HIT, at(100.0, -50.0), 0.0, STILL);
        for (north, east) in [(103.0, -52.5), (104.0, -46.0), (98.0, -45.0)] {
            memory.follow(at(north, east));
            assert!(occupied(&mut memory, 105.1, -49.9), "at {north}, {east}");
            assert!(!occupied(&mut memory, 105.1, -48.9));
        }
        memory.follow(at(130.0, -50.0));
        memory.follow(at(100.0, -50.0));
        assert!(!occupied(&mut memory, 105.1, -49.9));
    }

    #[test]
    fn clearance_is_the_distance_to_the_nearest_obstacle() {
        let mut memory = OccupancyGrid::default();
        memory.follow(at(0.0, 0.0));
        let obstacles = [(3_i32, 4_i32), (40, 50), (41, 52), (60, 20), (60, 27)];
        for (north, east) in obstacles {
            let index = Cell { north, east }.index().expect("within the grid");
            memory.score[index] = HIT;
        }
        memory.measure_clearance();
        for index in 0..CELLS {
            let cell = Cell::of_index(index);
            let nearest = obstacles
                .iter()
                .map(|(n, e)| (cell.north - n).pow(2) + (cell.east - e).pow(2))
                .min()
                .expect("some");
            let expected = nearest.min(i32::from(CLEARANCE_LIMIT_SQUARED));
            assert_eq!(i32::from(memory.clearance_squared(index)), expected, "{cell:?}");
        }
    }

    #[test]
    fn positions_and_cells_agree_on_both_sides_of_the_origin() {
        let mut memory = OccupancyGrid::default();
        memory.follow(at(-3.1, 0.2));
        for north in [-9.9_f32, -0.3, -0.01, 0.0, 0.24, 0.26, 7.0] {
            let (n, e) = memory.middle_of(memory.cell_of(north, -north));
            assert!((n - north).abs() <= 0.5 * CELL_M + 1e-5 && (e + north).abs() <= 0.5 * CELL_M + 1e-5);
        }
    }

    #[test]
    fn a_position_far_away_or_not_finite_is_survived() {
        let mut memory = OccupancyGrid::default();
        for bad in [1e30, -1e30, f32::NAN, f32::INFINITY] {
            memory.follow(at(bad, bad));
            memory.observe(&ahead(3.0), HIT, at(bad, 0.0), bad, STILL);
            memory.measure_clearance();
        }
    }
}
