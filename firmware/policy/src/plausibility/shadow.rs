//! The shadow of what stands on the ground: behind a true obstacle the ground is not seen, whatever range the obstacle is shown at.
//!
//! What is shown farther away than it is lies, where a ray leads down, beneath the ground that the lowest rows of the same picture
//! show: a surface there, seen through the ground, is none. Where those rows show no ground nothing can be known, which is no good word
//! for the picture.

use super::blindness::{STRIP, STRIPS};
use super::count;
use super::picture::{COLS, Directions, Picture, ROWS, Seen};
use vigil_types::{Attitude, FrdVector, NedVector};

/// Rays at least this steep, the sine of 21°, show what ground there is; depths are counted in bins, metres.
const STEEP: f32 = 0.36;
const BIN_M: f32 = 0.1;
const BINS: usize = 80;
/// Cells of three neighbouring bins that make a ground.
const LEAST_GROUND: u16 = 40;
/// The ground may lie this much higher, or lower, than home, metres: else nothing is said. Of a wall that fills the view the lowest
/// rays show as much depth.
const HIGHER_M: f32 = 0.5;
const LOWER_M: f32 = 3.0;
/// Rays that fall less, and surfaces farther off, metres, tell nothing.
const LEAST_FALL: f32 = 0.05;
const FAR_M: f32 = 40.0;
/// How far beneath the ground a surface must lie: metres, and for each metre of the way there, which a falling ground and a tilt that is
/// estimated wrong make.
const BENEATH_M: f32 = 0.25;
const BENEATH_PART: f32 = 0.08;
/// Cells of a strip beneath the ground, and such strips, that make a picture implausible; and pictures of the last ones.
const BENEATH_CELLS: u16 = 6;
const BENEATH_STRIPS: usize = 2;
const RAISE_PICTURES: u32 = 8;
const LAST_PICTURES: u32 = 10;
/// Pictures in a row that show a ground and nothing beneath it, after which it ends; raised so often in a flight it stays.
const CLEAR_PICTURES: u8 = 40;
const LAST_RAISE: u8 = 2;

/// Whether pictures show what the ground would hide.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Shadow {
    /// Whether the last one shows surfaces beneath the ground; `None` where no ground is seen, or none near the height of home.
    pub(super) is_beneath: Option<bool>,
    /// The last pictures, the newest lowest: set where the ground was seen through.
    seen_through: u32,
    agreeing: u8,
    pub(super) is_raised: bool,
    raises: u8,
}

impl Shadow {
    /// Takes a picture of a vehicle in flight.
    pub(super) fn note(&mut self, picture: &Picture, directions: &Directions, attitude: Attitude, height_m: f32) {
        self.is_beneath = is_beneath(picture, directions, attitude, height_m);
        let seen_through = u32::from(self.is_beneath == Some(true));
        self.seen_through = (self.seen_through << 1 | seen_through) & ((1 << LAST_PICTURES) - 1);
        count(&mut self.agreeing, self.is_beneath == Some(false));
        if self.is_raised {
            self.is_raised = self.raises >= LAST_RAISE || self.agreeing < CLEAR_PICTURES;
        } else if self.seen_through.count_ones() >= RAISE_PICTURES {
            self.is_raised = true;
            self.raises = self.raises.saturating_add(1);
        }
    }

    /// A picture of which nothing can be said; what was raised stays.
    pub(super) fn skip(&mut self) {
        (self.is_beneath, self.seen_through, self.agreeing) = (None, 0, 0);
    }
}

/// [`Shadow::is_beneath`] of a picture taken so high above home.
fn is_beneath(picture: &Picture, directions: &Directions, attitude: Attitude, height_m: f32) -> Option<bool> {
    let down = attitude.to_frd(NedVector::new(0.0, 0.0, 1.0));
    let ground_m = ground_m(picture, directions, down, height_m)?;
    let mut beneath = [0_u16; STRIPS];
    for (falls, range_m, column) in falling(picture, directions, down, LEAST_FALL) {
        let is_beneath = falls * range_m > ground_m + BENEATH_M + BENEATH_PART * range_m;
        if let Some(cells) = beneath
            .get_mut(column / STRIP)
            .filter(|_| is_beneath && range_m < FAR_M)
        {
            *cells += 1;
        }
    }
    let strips = beneath.iter().filter(|cells| **cells >= BENEATH_CELLS).count();
    Some(strips >= BENEATH_STRIPS)
}

/// Depth of the ground below the sensor as the steepest rays show it, but no less than it is by the height above home: what they show
/// most of, the lowest of it.
fn ground_m(picture: &Picture, directions: &Directions, down: FrdVector, height_m: f32) -> Option<f32> {
    let mut depths = [0_u16; BINS];
    let lowest_m = (height_m - HIGHER_M).max(0.0);
    for (falls, range_m, _) in falling(picture, directions, down, STEEP) {
        let bin = (falls * range_m - lowest_m) / BIN_M;
        if let Some(cells) = depths.get_mut(bin as usize).filter(|_| bin >= 0.0) {
            *cells += 1;
        }
    }
    let (mut most, mut bin) = (LEAST_GROUND, None);
    for (i, bins) in depths.windows(3).enumerate() {
        let cells = bins.iter().sum::<u16>();
        if cells >= most {
            (most, bin) = (cells, Some(i));
        }
    }
    let seen_m = lowest_m + (bin? as f32 + 1.5) * BIN_M;
    (seen_m <= height_m + LOWER_M).then(|| seen_m.max(height_m))
}

/// Surfaces along rays that fall by at least so much a metre: the fall, the range in metres and the column.
fn falling(
    picture: &Picture,
    directions: &Directions,
    down: FrdVector,
    least: f32,
) -> impl Iterator<Item = (f32, f32, usize)> {
    (0..ROWS).flat_map(move |row| {
        (0..COLS).filter_map(move |column| {
            let falls = directions.falls(down, row, column);
            if falls >= least
                && let Seen::Surface(range_m) = picture.at(row * COLS + column)
            {
                Some((falls, range_m, column))
            } else {
                None
            }
        })
    })
}
