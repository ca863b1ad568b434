//! Whether the sensor sees anything: zeros, ranges of anywhere, no return at all, or strips of the view without the ground.

use super::LOW_M;
use super::picture::{COLS, CellCounts, Directions, Picture, ROWS};
use vigil_types::{Attitude, NedVector};

/// The ground must be seen where its range is below this, metres; and it is at the height of home.
const GROUND_M: f32 = 15.0;
/// Higher than this the ground may be too far to be seen at all.
const HIGH_M: f32 = 0.4 * GROUND_M;
/// Columns of cells that are checked together: 7.5°.
pub(super) const STRIP: usize = 4;
pub(super) const STRIPS: usize = COLS / STRIP;
/// Strips without a ground that make a sensor blind, and cells of zeros, with many of them, and of ranges of anywhere that do.
const BLIND_STRIPS: usize = 2;
const BLIND_ZEROS: usize = ROWS * COLS / 50;
const BLIND_HOLES: usize = ROWS * COLS / 3;
const BLIND_WILD: usize = ROWS * COLS / 4;
/// Cells of a strip that must show the ground before its absence says anything.
const LEAST_GROUND: u16 = 8;
/// Frames in a row that make a sensor blind, and that make it see again.
pub(super) const BLIND_FRAMES: u8 = 2;
pub(super) const SEEING_FRAMES: u8 = 3;

/// Whether zeros or ranges of anywhere are too many for a sensor that sees.
pub(super) fn lacks_ranges(CellCounts { zeros, holes, wild, .. }: CellCounts) -> bool {
    zeros >= BLIND_ZEROS || holes >= BLIND_HOLES || wild >= BLIND_WILD
}

/// Whether a picture, taken at this attitude and, where it is known, height, is a blind sensor's.
pub(super) fn sees_nothing(
    picture: &Picture,
    counts: CellCounts,
    directions: &Directions,
    attitude: Attitude,
    height_m: Option<f32>,
) -> bool {
    let down = attitude.to_frd(NedVector::new(0.0, 0.0, 1.0));
    let low = height_m.is_none_or(|height_m| height_m < HIGH_M);
    let ground_m = height_m.filter(|height_m| (LOW_M..HIGH_M).contains(height_m));
    let mut returns = false;
    let (mut expected, mut missing) = ([0_u16; STRIPS], [0_u16; STRIPS]);
    for (row, cells) in picture.rows().iter().enumerate() {
        let strips = cells
            .as_chunks::<STRIP>()
            .0
            .iter()
            .zip(expected.iter_mut().zip(&mut missing));
        for (strip, (cells, (expected, missing))) in strips.enumerate() {
            returns |= cells.iter().any(|inverse| *inverse != 0.0);
            let Some(ground_m) = ground_m else { continue };
            let falls = directions.falls(down, row, strip * STRIP + STRIP / 2);
            if falls * GROUND_M > ground_m {
                *expected += STRIP as u16;
                *missing += cells.iter().filter(|inverse| **inverse == 0.0).count() as u16;
            }
        }
    }
    let strips = expected.iter().zip(&missing);
    let dead = strips
        .filter(|(expected, missing)| **expected >= LEAST_GROUND && **missing * 2 > **expected)
        .count();
    lacks_ranges(counts) || (low && !returns) || dead >= BLIND_STRIPS
}
