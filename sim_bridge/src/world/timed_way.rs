//! Is there a way past the movers? A search over place and time.

use crate::world::corridor::Grid;
use crate::world::course::Course;
use vigil_types::Nanos;

/// Speed along the grid's axes that the search grants the vehicle; √2 of it diagonally, still less than it can fly.
const SPEED_M_S: f32 = 1.0;

/// A set of a grid's cells, 64 to a word.
#[derive(Clone)]
struct Cells {
    words_per_row: usize,
    words: Vec<u64>,
}

impl Cells {
    fn none(grid: &Grid) -> Self {
        let words_per_row = grid.lattice.cells[1].div_ceil(64);
        Self {
            words_per_row,
            words: vec![0; words_per_row * grid.lattice.cells[0]],
        }
    }

    fn place(&self, (i, j): (usize, usize)) -> (usize, u64) {
        (i * self.words_per_row + j / 64, 1 << (j % 64))
    }

    fn insert(&mut self, cell: (usize, usize)) {
        let (word, bit) = self.place(cell);
        self.words[word] |= bit;
    }

    fn remove(&mut self, cell: (usize, usize)) {
        let (word, bit) = self.place(cell);
        self.words[word] &= !bit;
    }

    fn contains(&self, cell: (usize, usize)) -> bool {
        let (word, bit) = self.place(cell);
        self.words[word] & bit != 0
    }

    /// Puts into `out` every cell of this set, and all eight neighbours, that are also in `free`. `wide` is working storage.
    fn spread(&self, free: &Self, wide: &mut Self, out: &mut Self) {
        let n = self.words_per_row;
        for (row, wide_row) in self.words.chunks(n).zip(wide.words.chunks_mut(n)) {
            for (k, wide_word) in wide_row.iter_mut().enumerate() {
                let (left, right) = (
                    if k > 0 { row[k - 1] >> 63 } else { 0 },
                    row.get(k + 1).map_or(0, |w| w << 63),
                );
                *wide_word = row[k] | row[k] << 1 | left | row[k] >> 1 | right;
            }
        }
        for (at, out_word) in out.words.iter_mut().enumerate() {
            let above = at.checked_sub(n).map_or(0, |k| wide.words[k]);
            let below = wide.words.get(at + n).copied().unwrap_or(0);
            *out_word = (wide.words[at] | above | below) & free.words[at];
        }
    }
}

impl Course {
    /// When a vehicle that leaves the start at `depart_s` of simulated time can be at the goal, if it moves at about 1 m/s or
    /// waits, knows every mover's way, and keeps [`Course::corridor_margin_m`] from everything, movers included; `None` if that
    /// takes longer than the time limit. So a course for which this is `Some` can be flown, whatever its movers do.
    pub fn earliest_arrival_s(&self, depart_s: f32) -> Option<f32> {
        let grid = Grid::new(self, &self.solids_in_the_way());
        let (start, goal) = (
            grid.lattice.nearest([self.start.north_m, self.start.east_m]),
            grid.lattice.nearest([self.goal.north_m, self.goal.east_m]),
        );
        let step_s = grid.lattice.cell_m / SPEED_M_S;
        let mut free = Cells::none(&grid);
        let cells = grid.lattice.all().filter(|cell| grid.is_free(*cell));
        cells.for_each(|cell| free.insert(cell));
        let (mut reached, mut wide, mut next) = (Cells::none(&grid), Cells::none(&grid), Cells::none(&grid));
        reached.insert(start);
        let movers: Vec<_> = self.movers_in_band(self.corridor_reach_m()).collect();
        let mut passed_s = 0.0;
        for step in 0u32.. {
            passed_s = step as f32 * step_s;
            if passed_s > self.time_limit_s {
                return None;
            }
            let at_ns = (f64::from(depart_s + passed_s) * 1e9) as Nanos;
            for mover in &movers {
                // What it may move before the next look is kept free too.
                let clearance_m = grid.clearance_m + mover.speed_m_s * step_s;
                grid.lattice
                    .near(&mover.solid_at(at_ns), clearance_m, |cell, _| reached.remove(cell));
            }
            if reached.contains(goal) {
                break;
            }
            if step == 0 && !(reached.contains(start) && free.contains(start)) {
                return None;
            }
            reached.spread(&free, &mut wide, &mut next);
            core::mem::swap(&mut reached, &mut next);
        }
        Some(depart_s + passed_s)
    }
}

#[cfg(test)]
mod tests {
    use crate::world::Course;

    /// A wall across the arena with a door of 2 m, and what moves behind it.
    fn course(movers: &str) -> Course {
        let wall = r#"family = "hard"
wall = [
    { from_m = [10.0, -8.0], to_m = [10.0, -1.0], thickness_m = 0.2, height_m = 3.0 },
    { from_m = [10.0, 1.0], to_m = [10.0, 8.0], thickness_m = 0.2, height_m = 3.0 },
]
"#;
        crate::testing::field(0.0, 8.0, &format!("{wall}{movers}"))
    }

    fn in_front_of_the_door(to_east_m: f32, phase: f32) -> Course {
        course(&format!(
            "[[mover]]\nfrom_m = [10.9, -0.2]\nto_m = [10.9, {to_east_m:?}]\nspeed_m_s = 0.2\nphase = {phase}\nheight_m = 2.5\n             shape = {{ box = {{ length_m = 0.6, width_m = 2.4 }} }}\n"
        ))
    }

    #[test]
    fn without_movers_the_arrival_is_the_distance_at_one_metre_a_second() {
        let arrival_s = course("").earliest_arrival_s(5.0).expect("a way");
        assert!((arrival_s - 25.0).abs() < 0.2, "{arrival_s}");
    }

    #[test]
    fn a_mover_that_leaves_the_door_is_waited_for() {
        // It comes to the door when the vehicle does, after 10 s, and goes 4 m aside again at 0.2 m/s.
        let arrival_s = in_front_of_the_door(3.8, 0.75).earliest_arrival_s(0.0).expect("a way");
        assert!((24.0..45.0).contains(&arrival_s), "{arrival_s}");
        // Half a period apart from that, the door is open.
        let at_once_s = in_front_of_the_door(3.8, 0.25).earliest_arrival_s(0.0).expect("a way");
        assert!((at_once_s - 20.0).abs() < 0.5, "{at_once_s}");
    }

    #[test]
    fn a_mover_that_never_leaves_the_door_closes_the_way() {
        let course = in_front_of_the_door(0.2, 0.0);
        assert!(course.corridor().is_some());
        assert_eq!(course.earliest_arrival_s(0.0), None);
    }
}
