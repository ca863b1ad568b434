//! A surface in the plan view: the squares that it crosses between two heights, as boxes.

use super::Surface;
use crate::world::course::Course;
use crate::world::mover::Mover;
use crate::world::solid::Solid;
use crate::world::wire::Wire;

/// Side of a square; wider where the plan would need more than [`MAX_SQUARES`].
const SQUARE_M: f32 = 0.1;
const MAX_SQUARES: f32 = 1e6;

type Polygon = Vec<[f32; 3]>;

/// The part of a polygon on one side of a plane square to an axis: where `sign` times the coordinate is at most `limit` (Sutherland and
/// Hodgman 1974).
fn clip(polygon: &Polygon, axis: usize, sign: f32, limit: f32, kept: &mut Polygon) {
    kept.clear();
    for (i, to) in polygon.iter().enumerate() {
        let from = &polygon[(i + polygon.len() - 1) % polygon.len()];
        let [before, after] = [from, to].map(|p| limit - sign * p[axis]);
        if (before < 0.0) != (after < 0.0) {
            let share = before / (before - after);
            kept.push(core::array::from_fn(|k| from[k] + share * (to[k] - from[k])));
        }
        if after >= 0.0 {
            kept.push(*to);
        }
    }
}

impl Surface {
    /// Boxes from `low_m` to `high_m` above ground over all squares that the surface crosses between these heights, those of a row that adjoin
    /// as one.
    pub(crate) fn boxes(&self, low_m: f32, high_m: f32) -> Vec<Solid> {
        let (low, high) = self.extent_ned_m();
        let area_m2 = (high[0] - low[0]) * (high[1] - low[1]);
        let square_m = SQUARE_M.max((area_m2 / MAX_SQUARES).sqrt());
        let [rows, columns] = [0, 1].map(|k| ((high[k] - low[k]) / square_m) as usize + 1);
        let index = |k: usize, at_m: f32, count: usize| (((at_m - low[k]) / square_m).max(0.0) as usize).min(count - 1);
        let mut crossed = vec![false; rows * columns];
        let (mut part, mut other) = (Polygon::new(), Polygon::new());
        for triangle in self.triangles() {
            part.clear();
            part.extend(triangle);
            clip(&part, 2, 1.0, -low_m, &mut other);
            clip(&other, 2, -1.0, high_m, &mut part);
            let (south, north) = span(&part, 0);
            for row in index(0, south, rows)..=index(0, north, rows) {
                let row_m = low[0] + row as f32 * square_m;
                clip(&part, 0, -1.0, -row_m, &mut other);
                let mut strip = Polygon::new();
                clip(&other, 0, 1.0, row_m + square_m, &mut strip);
                let (west, east) = span(&strip, 1);
                if west <= east {
                    let squares = row * columns + index(1, west, columns)..=row * columns + index(1, east, columns);
                    crossed[squares].fill(true);
                }
            }
        }
        let mut boxes = Vec::new();
        for (row, squares) in crossed.chunks(columns).enumerate() {
            let mut column = 0;
            for run in squares.chunk_by(|a, b| a == b) {
                if run[0] {
                    let middle = column as f32 + 0.5 * run.len() as f32;
                    let at = (low[0] + (row as f32 + 0.5) * square_m, low[1] + middle * square_m);
                    let size_m = [square_m, run.len() as f32 * square_m];
                    boxes.push(Solid::cuboid(at, size_m, [low_m, high_m], 0.0));
                }
                column += run.len();
            }
        }
        boxes
    }
}

/// Lowest and highest coordinate; the lowest above the highest where there is nothing.
fn span(polygon: &Polygon, axis: usize) -> (f32, f32) {
    let along = polygon.iter().map(|p| p[axis]);
    along.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), x| {
        (low.min(x), high.max(x))
    })
}

impl Course {
    /// The course's meshes as whoever searches a way in the plan view has them: boxes over the squares of 10 cm that they cross no farther than
    /// this above and below the flight height.
    pub(crate) fn mesh_boxes(&self, half_band_m: f32) -> Vec<Solid> {
        let [low_m, high_m] = self.band_m(half_band_m);
        let surfaces = self.meshes.iter().filter_map(|mesh| mesh.surface());
        surfaces
            .flat_map(|surface| surface.boxes(low_m.max(0.0), high_m))
            .collect()
    }

    /// The heights this far below and above the flight height.
    pub(crate) fn band_m(&self, half_band_m: f32) -> [f32; 2] {
        [self.flight_height_m - half_band_m, self.flight_height_m + half_band_m]
    }

    /// What stands in the plan view of a corridor.
    pub fn corridor_solids(&self) -> Vec<Solid> {
        self.plan_solids(self.corridor_reach_m())
    }

    /// What is shown in space: as in a corridor's plan, but wires whole, in pieces.
    pub fn shown_solids(&self) -> Vec<Solid> {
        let mut solids = self.solids();
        solids.extend(self.mesh_boxes(self.corridor_reach_m()));
        solids.extend(self.wires.iter().flat_map(Wire::boxes));
        solids
    }

    /// [`solids`](Self::solids), then [`mesh_boxes`](Self::mesh_boxes) and what of the wires lies at these heights.
    pub(crate) fn plan_solids(&self, half_band_m: f32) -> Vec<Solid> {
        let mut solids = self.solids();
        solids.extend(self.mesh_boxes(half_band_m));
        let [low_m, high_m] = self.band_m(half_band_m);
        solids.extend(self.wires.iter().filter_map(|wire| wire.between(low_m, high_m)));
        solids
    }

    /// What of [`plan_solids`](Self::plan_solids) reaches into these heights.
    pub(crate) fn solids_in_band(&self, half_band_m: f32) -> Vec<Solid> {
        let (mut solids, band_m) = (self.plan_solids(half_band_m), self.band_m(half_band_m));
        solids.retain(|solid| solid.reaches_into(band_m));
        solids
    }

    /// The movers whose ways reach into these heights.
    pub(crate) fn movers_in_band(&self, half_band_m: f32) -> impl Iterator<Item = &Mover> {
        let band_m = self.band_m(half_band_m);
        self.movers.iter().filter(move |m| m.track().reaches_into(band_m))
    }
}
