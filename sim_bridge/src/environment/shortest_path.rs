//! The length of the shortest free path to the goal from everywhere on a course: what the training reward goes by, and what a
//! critic may know. Progress along the straight line punishes the only path out of a dead end; progress along this one does not.

use crate::world::{Course, Lattice, VEHICLE};

/// Grid spacing, metres.
const CELL_M: f32 = 0.2;
/// Half of the band of heights that the vehicle needs around its flight height, metres.
pub(super) const HALF_BAND_M: f32 = 0.3;
/// A path keeps this from every solid beside the vehicle's radius, metres.
const MARGIN_M: f32 = 0.05;
/// Below this clearance a metre of the path counts as more, up to [`NARROW_FACTOR`] times more where it is narrowest.
const WIDE_M: f32 = 0.9;
const NARROW_FACTOR: f32 = 1.5;
/// What a metre counts where the vehicle does not fit: the path out of there, so that the length is known everywhere.
const COVERED_FACTOR: f32 = 3.0;

/// The length of the shortest free path past what stands still, metres, on a grid over the course's bounds.
#[derive(Debug, Clone, PartialEq)]
pub struct ShortestPath {
    lattice: Lattice,
    /// By north, then east.
    length_m: Vec<f32>,
}

impl ShortestPath {
    /// Searches the course once, from the goal outwards (Dijkstra 1959). Movers are not obstacles here.
    pub fn new(course: &Course) -> Self {
        let b = &course.bounds;
        let count = |range: [f32; 2]| ((range[1] - range[0]) / CELL_M).ceil() as usize + 1;
        let lattice = Lattice {
            cell_m: CELL_M,
            cells: [count(b.north_m), count(b.east_m)],
            origin_m: [b.north_m[0], b.east_m[0]],
        };
        let to_bounds_m = |cell| {
            let [north_m, east_m] = lattice.point(cell);
            let along_m = (north_m - b.north_m[0]).min(b.north_m[1] - north_m);
            along_m.min(east_m - b.east_m[0]).min(b.east_m[1] - east_m)
        };
        let mut clearances_m = lattice.values(to_bounds_m);
        for solid in &course.solids_in_band(HALF_BAND_M) {
            // Beyond `WIDE_M`, and a cell more for rounding, a solid changes nothing.
            lattice.near(solid, WIDE_M + CELL_M, |cell, distance_m| {
                let clearance_m = &mut clearances_m[lattice.number(cell)];
                *clearance_m = clearance_m.min(distance_m);
            });
        }
        // With a closed cell around all, so that every cell has eight beside it.
        let width = lattice.cells[1] + 2;
        let framed = |(row, column): (usize, usize)| (row + 1) * width + column + 1;
        // One more for the vectors of `spread`.
        let mut factors = vec![f32::INFINITY; (lattice.cells[0] + 2) * width + 1];
        let mut lengths_m = factors.clone();
        let mut into = factors.clone();
        for (cell, clearance_m) in lattice.all().zip(&clearances_m) {
            let place = framed(cell);
            factors[place] = factor(*clearance_m);
            if *clearance_m >= VEHICLE.radius_m + MARGIN_M {
                into[place] = factors[place];
            }
        }
        let goal = framed(lattice.nearest([course.goal.north_m, course.goal.east_m]));
        lengths_m[goal] = 0.0;
        // Where the vehicle fits first; then, from there, the rest, so that no path leads through a wall.
        spread(&mut lengths_m, &factors, &into, width, vec![goal]);
        let mut beside = vec![false; into.len()];
        for (n, length_m) in lengths_m.iter().enumerate() {
            into[n] = if length_m.is_finite() {
                f32::INFINITY
            } else {
                factors[n]
            };
            if into[n].is_finite() {
                for row in [n - width, n, n + width] {
                    beside[row - 1..=row + 1].fill(true);
                }
            }
        }
        let known = (0..into.len()).filter(|n| beside[*n] && lengths_m[*n].is_finite());
        let known = known.collect();
        spread(&mut lengths_m, &factors, &into, width, known);
        Self {
            length_m: lattice.values(|cell| lengths_m[framed(cell)]),
            lattice,
        }
    }

    /// The length of the path from a place, metres; narrow passages count as longer. Interpolated between the grid's points.
    pub fn length_m(&self, north_m: f32, east_m: f32) -> f32 {
        let axis = |axis: usize, at_m: f32| {
            let last = self.lattice.cells[axis] - 1;
            let at = ((at_m - self.lattice.origin_m[axis]) / CELL_M).clamp(0.0, last as f32);
            let low = (at as usize).min(last.saturating_sub(1));
            (low, (low + 1).min(last), at - low as f32)
        };
        let ((i0, i1, u), (j0, j1, v)) = (axis(0, north_m), axis(1, east_m));
        let at = |i: usize, j: usize| self.length_m[self.lattice.number((i, j))];
        let mix = |a: f32, b: f32, share: f32| a + share * (b - a);
        mix(mix(at(i0, j0), at(i0, j1), v), mix(at(i1, j0), at(i1, j1), v), u)
    }
}

/// Settles the cells of which `into`, the factor of going there, is finite, from those that are `known`, in rising order of
/// [`CELL_M`], the shortest step: no order within one changes a length. A row has `width` cells; those at the edge stay closed.
fn spread(lengths_m: &mut [f32], factors: &[f32], into: &[f32], width: usize, known: Vec<usize>) {
    const DIAGONAL_M: f32 = CELL_M * core::f32::consts::SQRT_2;
    // Half of the steps to the three rows beside a cell, a vector each: never to itself and beyond.
    const STEPS_M: [[f32; 4]; 3] = [
        [0.5 * DIAGONAL_M, 0.5 * CELL_M, 0.5 * DIAGONAL_M, f32::INFINITY],
        [0.5 * CELL_M, f32::INFINITY, 0.5 * CELL_M, f32::INFINITY],
        [0.5 * DIAGONAL_M, 0.5 * CELL_M, 0.5 * DIAGONAL_M, f32::INFINITY],
    ];
    let mut rising: Vec<Vec<(f32, u32)>> = Vec::new();
    let put = |rising: &mut Vec<Vec<_>>, length_m: f32, n: usize| {
        let place = (length_m * (1.0 / CELL_M)) as usize;
        if place >= rising.len() {
            // As long as a front: they hardly ever grow.
            rising.resize_with(place + 1, || Vec::with_capacity(256));
        }
        rising[place].push((length_m, n as u32));
    };
    for n in known {
        put(&mut rising, lengths_m[n], n);
    }
    let mut place = 0;
    while place < rising.len() {
        let Some((length_m, n)) = rising[place].pop() else {
            place += 1;
            continue;
        };
        let n = n as usize;
        if length_m > lengths_m[n] {
            continue;
        }
        for (row, steps_m) in [n - width, n, n + width].into_iter().zip(STEPS_M) {
            let lengths_m: &mut [f32; 4] = lengths_m[row - 1..].first_chunk_mut().expect("framed");
            let into: &[f32; 4] = into[row - 1..].first_chunk().expect("framed");
            let through_m: [f32; 4] = core::array::from_fn(|k| length_m + steps_m[k] * (factors[n] + into[k]));
            // Mostly none is shorter, which one comparison says.
            if !(0..4).fold(false, |any, k| any | (through_m[k] < lengths_m[k])) {
                continue;
            }
            for k in 0..3 {
                if through_m[k] < lengths_m[k] {
                    lengths_m[k] = through_m[k];
                    put(&mut rising, through_m[k], row - 1 + k);
                }
            }
        }
    }
}

/// What a metre counts at a clearance of the vehicle's centre.
fn factor(clearance_m: f32) -> f32 {
    let least_m = VEHICLE.radius_m + MARGIN_M;
    if clearance_m < least_m {
        return COVERED_FACTOR;
    }
    let lack = ((WIDE_M - clearance_m) / (WIDE_M - least_m)).max(0.0);
    1.0 + NARROW_FACTOR * lack
}

#[cfg(test)]
mod tests {
    use super::*;

    fn course(walls: &str) -> Course {
        crate::testing::field(0.0, 8.0, walls)
    }

    #[test]
    fn in_an_open_field_the_way_is_the_straight_line() {
        let path = ShortestPath::new(&course(""));
        assert!((path.length_m(0.0, 0.0) - 20.0).abs() < 0.05);
        assert!(path.length_m(20.0, 0.0) < 0.05);
        // On a grid of eight directions at most 8 % longer.
        let aslant = path.length_m(10.0, 5.0) / 125.0_f32.sqrt();
        assert!((1.0..1.09).contains(&aslant), "{aslant}");
    }

    #[test]
    fn in_a_dead_end_the_way_leads_back_out() {
        let pocket = r#"wall = [
    { from_m = [12.0, -3.0], to_m = [12.0, 3.0], thickness_m = 0.2, height_m = 3.0 },
    { from_m = [8.0, -3.0], to_m = [12.0, -3.0], thickness_m = 0.2, height_m = 3.0 },
    { from_m = [8.0, 3.0], to_m = [12.0, 3.0], thickness_m = 0.2, height_m = 3.0 },
]"#;
        let path = ShortestPath::new(&course(pocket));
        assert!(path.length_m(11.0, 0.0) > path.length_m(9.0, 0.0) + 0.5);
        assert!(path.length_m(9.0, 0.0) > path.length_m(7.0, 0.0) + 0.5);
        // Inside the wall the length is known too, and no shorter than beside it.
        assert!(path.length_m(12.0, 0.0) > path.length_m(13.0, 0.0));
        assert!(path.length_m(12.0, 0.0).is_finite());
    }

    #[test]
    fn what_can_be_flown_under_is_not_in_the_way() {
        let beam = |bottom_m: f32| {
            course(&format!(
                "overhang = [{{ north_m = 10.0, east_m = 0.0, length_m = 0.5, width_m = 14.0, \
                 bottom_m = {bottom_m:?}, top_m = 4.0 }}]"
            ))
        };
        assert!((ShortestPath::new(&beam(2.0)).length_m(0.0, 0.0) - 20.0).abs() < 0.05);
        assert!(ShortestPath::new(&beam(1.2)).length_m(0.0, 0.0) > 21.0);
    }
}
