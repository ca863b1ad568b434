//! The estimate from which a motion is taken drifts, as one on GPS and barometer does. What it may have drifted between two pictures
//! explains a misfit and convicts no sensor; and a sensor that is turned on its mount must differ from a drift.

use super::motion::{Found, Map, cost, look, sigma_m};
use super::picture::{COLS, Directions, Picture};
use vigil_types::{FrdVector, Nanos};

/// How far an estimate drifts, metres and metres a second, as real ones do in one second of twenty (a PX4 in SIH); and at the most, metres.
const DRIFT_M: f32 = 0.02;
const DRIFT_M_S: f32 = 0.2;
const MOST_DRIFT_M: f32 = 0.5;
/// A mean cost below this needs no drift to explain it; and fewer samples tell of none.
const FITS_WELL: f32 = 0.5;
const LEAST_SAMPLES: f32 = 40.0;
/// The step of the differences that say what a shift does to the errors, metres.
const PROBE_M: f32 = 0.05;
/// Errors beyond so many standard deviations are no drift's.
const OUTLIER: f32 = 4.0;

/// What the estimate may have drifted in a time, metres.
pub(super) fn allowed_drift_m(passed_ns: Nanos) -> f32 {
    (DRIFT_M + DRIFT_M_S * (passed_ns as f32 * 1e-9)).min(MOST_DRIFT_M)
}

/// Two pictures, and the cells of the first that are looked for in the second.
pub(super) struct Pair<'a, I> {
    pub directions: &'a Directions,
    pub from: &'a Picture,
    pub to: &'a Picture,
    pub cells: I,
}

impl<I: Iterator<Item = (usize, usize)> + Clone> Pair<'_, I> {
    /// The motion with the drift that explains the second picture best, of at most so many metres: the shift of least squares, if the
    /// motion alone does not fit and it fits better.
    pub(super) fn without_drift(&self, map: &Map, allowed_m: f32) -> Map {
        let (samples, costs) = self.costs(map);
        if samples < LEAST_SAMPLES || costs < FITS_WELL * samples {
            return *map;
        }
        let shifted = map.shifted(self.drift(map, allowed_m));
        if self.costs(&shifted).1 < costs { shifted } else { *map }
    }

    fn error(&self, cell: (usize, usize), map: &Map) -> Option<(f32, f32)> {
        let seen = self.from.at(cell.0 * COLS + cell.1);
        match look(self.directions, cell, seen, map, self.to).0 {
            Found::Surface { error_m, range_m } => Some((error_m, range_m)),
            Found::Nothing { .. } | Found::Unknown => None,
        }
    }

    /// Samples that show a surface in both, and what the motion costs them.
    fn costs(&self, map: &Map) -> (f32, f32) {
        let errors = self.cells.clone().filter_map(|cell| self.error(cell, map));
        errors.fold((0.0, 0.0), |(samples, costs), (error_m, range_m)| {
            (samples + 1.0, costs + cost(error_m, range_m))
        })
    }

    /// One step of Gauss and Newton from no shift, damped by what is allowed, in the second picture's axes.
    pub(super) fn drift(&self, map: &Map, allowed_m: f32) -> FrdVector {
        if allowed_m <= 0.0 {
            return FrdVector::ZERO;
        }
        let axes =
            [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)].map(|(x, y, z)| FrdVector::new(x, y, z) * PROBE_M);
        let probes = axes.map(|axis| map.shifted(axis));
        let mut squares = Squares::<3>::default();
        for cell in self.cells.clone() {
            let seen = self.from.at(cell.0 * COLS + cell.1);
            let found = |map: &Map| look(self.directions, cell, seen, map, self.to).0;
            squares.add(found(map), probes.each_ref().map(found), 1.0);
        }
        // What is allowed is as sure as that there is no drift.
        let per_probe = PROBE_M / allowed_m;
        let [x, y, z] = squares
            .solved([per_probe * per_probe; 3])
            .map_or([0.0; 3], |solved| solved.causes);
        let shift = FrdVector::new(x, y, z) * PROBE_M;
        let most = allowed_m / shift.norm().max(allowed_m);
        shift * most
    }
}

/// The least squares of what a motion leaves, in standard deviations: how much of some causes, in the steps in which they were
/// tested, explains it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Squares<const CAUSES: usize> {
    normal: [[f32; CAUSES]; CAUSES],
    right: [f32; CAUSES],
    left: f32,
    samples: f32,
}

/// The causes' shares, and the information on each that the others leave.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Solved<const CAUSES: usize> {
    causes: [f32; CAUSES],
    information: [f32; CAUSES],
    /// By how much the squares fall, if nothing was known before.
    gain: f32,
}

impl<const CAUSES: usize> Default for Squares<CAUSES> {
    fn default() -> Self {
        Self {
            normal: [[0.0; CAUSES]; CAUSES],
            right: [0.0; CAUSES],
            left: 0.0,
            samples: 0.0,
        }
    }
}

impl<const CAUSES: usize> Squares<CAUSES> {
    /// Takes a sample: how it is found by the motion, and with each cause by a step to this side (1 or −1). Where one of them shows no
    /// surface, or another one, it shows nothing.
    pub(super) fn add(&mut self, found: Found, tested: [Found; CAUSES], side: f32) {
        let Found::Surface { error_m, range_m } = found else {
            return;
        };
        let per_m = 1.0 / sigma_m(range_m);
        let slopes = tested.map(|found| match found {
            Found::Surface { error_m: there_m, .. } => side * (there_m - error_m) * per_m,
            Found::Nothing { .. } | Found::Unknown => f32::INFINITY,
        });
        let error = error_m * per_m;
        if error.abs() < OUTLIER && slopes.iter().all(|slope| slope.abs() < OUTLIER) {
            for ((row, right), slope) in self.normal.iter_mut().zip(&mut self.right).zip(slopes) {
                row.iter_mut()
                    .zip(slopes)
                    .for_each(|(sum, other)| *sum += slope * other);
                *right -= slope * error;
            }
            self.left += error * error;
            self.samples += 1.0;
        }
    }

    pub(super) fn add_all(&mut self, other: &Self) {
        let others = other.normal.as_flattened().iter().chain(&other.right);
        let others = others.chain([&other.left, &other.samples]);
        self.sums().zip(others).for_each(|(sum, other)| *sum += other);
    }

    pub(super) fn fade(&mut self, keep: f32) {
        self.sums().for_each(|sum| *sum *= keep);
    }

    fn sums(&mut self) -> impl Iterator<Item = &mut f32> {
        let sums = self.normal.as_flattened_mut().iter_mut().chain(&mut self.right);
        sums.chain([&mut self.left, &mut self.samples])
    }

    /// `None` where some cause cannot be known. What is known before, as information on each cause being none, is added.
    pub(super) fn solved(&self, known: [f32; CAUSES]) -> Option<Solved<CAUSES>> {
        let mut normal = self.normal;
        for (i, (row, known)) in normal.iter_mut().zip(known).enumerate() {
            *row.get_mut(i)? += known;
        }
        let inverse = inverse(normal)?;
        let dot = |a: &[f32; CAUSES], b: &[f32; CAUSES]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
        let causes = inverse.each_ref().map(|row| dot(row, &self.right));
        let mut information = [0.0; CAUSES];
        for (i, (information, row)) in information.iter_mut().zip(&inverse).enumerate() {
            *information = 1.0 / row.get(i)?;
        }
        Some(Solved {
            gain: dot(&causes, &self.right),
            causes,
            information,
        })
    }
}

/// The inverse of a symmetric, positive definite matrix, by Gauss and Jordan; `None` if it is not one.
fn inverse<const N: usize>(mut matrix: [[f32; N]; N]) -> Option<[[f32; N]; N]> {
    let mut inverse = [[0.0; N]; N];
    for (i, row) in inverse.iter_mut().enumerate() {
        *row.get_mut(i)? = 1.0;
    }
    for pivot in 0..N {
        let divisor = *matrix.get(pivot)?.get(pivot)?;
        if !(divisor > 0.0 && divisor.is_finite()) {
            return None;
        }
        let (row, of_inverse) = (
            matrix.get(pivot)?.map(|v| v / divisor),
            inverse.get(pivot)?.map(|v| v / divisor),
        );
        for (i, (other, other_of_inverse)) in matrix.iter_mut().zip(&mut inverse).enumerate() {
            if i == pivot {
                (*other, *other_of_inverse) = (row, of_inverse);
                continue;
            }
            let times = *other.get(pivot)?;
            other.iter_mut().zip(row).for_each(|(to, from)| *to -= times * from);
            other_of_inverse
                .iter_mut()
                .zip(of_inverse)
                .for_each(|(to, from)| *to -= times * from);
        }
    }
    Some(inverse)
}

/// How far the causes are tested: a turn of the sensor on its mount, as cosine and sine of 5°, which errs aside of the way, and a way
/// that is longer by as much, which errs along it; metres downward; and a view that is wider by this share than it is said to be.
pub(super) const TURN: (f32, f32) = (0.996_194_7, 0.087_155_74);
pub(super) const DOWN_M: f32 = 0.1;
pub(super) const WIDENING: f32 = 0.05;

/// What a motion leaves, explained by an error aside of the way, along it, downward, and by the width of the view. The first three are a
/// drift's, or a turned sensor's; none drifts as the last.
pub(super) type Errors = Squares<4>;
/// A width that is taken for known.
const KNOWN_WIDTH: f32 = 1e9;
/// Errors beyond this, in steps in which they were tested, are not explained by a drift.
const MOST_STEPS: f32 = 2.5;

impl Errors {
    /// How much less the motion costs without the drift in it.
    pub(super) fn drift_gain(&self) -> f32 {
        self.solved([0.0, 0.0, 0.0, KNOWN_WIDTH]).map_or(0.0, |solved| {
            let norm = libm::sqrtf(solved.causes.iter().map(|cause| cause * cause).sum());
            let share = MOST_STEPS / norm.max(MOST_STEPS);
            solved.gain * share * (2.0 - share)
        })
    }
}

/// A reading takes at least this long, and ends with this much information both aside and along; what takes longer than this says
/// nothing.
const READING_NS: Nanos = 1_000_000_000;
const READING_INFORMATION: f32 = 20.0;
/// With so much aside it counts for a whole one of the turn, and with so much on the view's width of that: with less, readings that
/// followed each other were seen to err alike.
const WHOLE_READING_INFORMATION: f32 = 60.0;
const WHOLE_WIDTH_INFORMATION: f32 = 4.0;
const LONGEST_READING_NS: Nanos = 4_000_000_000;
/// What a reading may leave unexplained, variances a sample: of a sensor that is turned, for it is so everywhere, and something that
/// moves beside the vehicle is not; and of a view of another width, which these small steps do not explain to the end.
const MOST_LEFT_BY_TURN: f32 = 0.12;
const MOST_LEFT_BY_WIDTH: f32 = 0.3;
/// Readings that are kept, and the fewest whole ones that say something.
const READINGS: usize = 16;
const FEWEST_READINGS: f32 = 2.0;
/// Before anything is known of it, an estimate is taken for one whose drift looks like so much of the tested turn (0.045 m/s at 1.3 m/s, of a
/// GPS's over a reading), and a view for one that errs by so much of its width, as if so many readings had said so.
const DRIFT_IN_TURNS: f32 = 0.4;
const ERROR_OF_WIDTH: f32 = 0.05;
const READINGS_BEFORE: f32 = 2.0;
/// A mean so many times its own standard deviation is reported. Readings that follow each other share most of a drift, so this is three and
/// a half of such a mean's.
const SURE: f32 = 6.0;
/// What was read along the way counts for about twenty readings.
const KEEP_ALONG: f32 = 0.95;
/// Turns that are reported, as multiples of the tested one, and the least share by which a view's width must differ.
const LEAST_TURN: f32 = 0.7;
const MOST_TURN: f32 = 2.5;
const LEAST_WIDENING: f32 = 0.15;

/// Readings of one error, the newest last, and for how much of a reading each counts.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Readings {
    values: [(f32, f32); READINGS],
    used: usize,
}

impl Readings {
    fn add(&mut self, value: f32, weight: f32) {
        self.values.rotate_left(1);
        if let Some(newest) = self.values.last_mut() {
            *newest = (value, weight);
        }
        self.used = (self.used + 1).min(READINGS);
    }

    /// Number, sum and sum of squares of the newest so many.
    fn sums(&self, newest: usize) -> (f32, f32, f32) {
        let newest = self.values.iter().rev().take(newest);
        newest.fold((0.0, 0.0, 0.0), |(count, sum, squares), (value, weight)| {
            let weighed = weight * value;
            (count + weight, sum + weighed, squares + weighed * value)
        })
    }

    /// Whether the mean of the newest, two or more, is in this range and no accident: not one of what scatters as the others do, and as so
    /// many more with this sum of squares.
    fn tell(&self, range: core::ops::Range<f32>, others: f32, squares: f32) -> bool {
        let (all, _, squares_of_all) = self.sums(self.used);
        (1..=self.used).any(|last| {
            let (count, sum, _) = self.sums(last);
            let mean = sum / count;
            let of_mean = mean * sum;
            let variance = (squares + squares_of_all - of_mean) / (others + all);
            count >= FEWEST_READINGS && range.contains(&mean.abs()) && of_mean > SURE * SURE * variance
        })
    }
}

/// Distinguishes a sensor that is turned on its mount from an estimate that drifts: the turn shows aside of every way alike, the drift to all
/// sides, along the way as well, and changes within seconds. And finds a view of another width, which no drift looks like.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct MountReadings {
    since_ns: Option<Nanos>,
    errors: Errors,
    turns: Readings,
    widenings: Readings,
    /// Sum of the squared errors along the way, and their number.
    along_squared: f32,
    alongs: f32,
}

impl MountReadings {
    /// The reading that was begun says nothing.
    pub(super) fn give_up(&mut self) {
        (self.since_ns, self.errors) = (None, Errors::default());
    }

    /// Takes a picture's samples. Whether the sensor is turned, or its view of another width.
    pub(super) fn read(&mut self, picture: &Errors, stamp_ns: Nanos) -> bool {
        self.errors.add_all(picture);
        let passed_ns = stamp_ns.saturating_sub(*self.since_ns.get_or_insert(stamp_ns));
        if passed_ns < READING_NS {
            return false;
        }
        let read = self.errors.solved([0.0; 4]).filter(|solved| {
            let [aside, along, ..] = solved.information;
            aside.min(along) >= READING_INFORMATION
        });
        let left = read.map_or(0.0, |solved| (self.errors.left - solved.gain) / self.errors.samples);
        if read.is_some() || passed_ns >= LONGEST_READING_NS {
            (self.since_ns, self.errors) = (Some(stamp_ns), Errors::default());
        }
        let Some(Solved {
            causes: [turn, along, _, widening],
            information: [aside, _, _, of_width],
            ..
        }) = read
        else {
            return false;
        };
        if left <= MOST_LEFT_BY_TURN {
            self.turns.add(turn, (aside / WHOLE_READING_INFORMATION).min(1.0));
            self.along_squared = KEEP_ALONG * self.along_squared + along * along;
            self.alongs = KEEP_ALONG * self.alongs + 1.0;
        }
        if left <= MOST_LEFT_BY_WIDTH {
            let weight = (of_width / WHOLE_WIDTH_INFORMATION).min(1.0);
            self.widenings.add(WIDENING * widening, weight);
        }
        let before = |deviation: f32| READINGS_BEFORE * deviation * deviation;
        let drift = before(DRIFT_IN_TURNS) + self.along_squared;
        let is_turned = (self.turns).tell(LEAST_TURN..MOST_TURN, READINGS_BEFORE + self.alongs, drift);
        is_turned || (self.widenings).tell(LEAST_WIDENING..f32::INFINITY, READINGS_BEFORE, before(ERROR_OF_WIDTH))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn causes_are_distinguished_and_what_they_leave_is_reported() {
        // Errors of two causes, 0.5 and -2 steps, and of neither: 0.3 by turns.
        let surface = |error_m| Found::Surface { error_m, range_m: 2.0 };
        let mut squares = Squares::<2>::default();
        for i in 0..40_u8 {
            let along = f32::from(i % 5) * 0.01 - 0.02;
            let (first, second) = (0.02 + along, 0.01 - 0.5 * along);
            let other = 0.3 * sigma_m(2.0) * if i % 10 < 5 { 1.0 } else { -1.0 };
            let error_m = other - 0.5 * first + 2.0 * second;
            let side = if i < 20 { 1.0 } else { -1.0 };
            let tested = [first, second].map(|step| surface(error_m + side * step));
            squares.add(surface(error_m), tested, side);
        }
        let solved = squares.solved([0.0; 2]).expect("two causes");
        let [first, second] = solved.causes;
        assert!((first - 0.5).abs() < 1e-3 && (second + 2.0).abs() < 1e-3, "{solved:?}");
        assert!(((squares.left - solved.gain) / 40.0 - 0.09).abs() < 1e-3, "{solved:?}");
        // One that is known takes the other's place.
        let [first, _] = squares.solved([0.0, 1e9]).expect("one cause").causes;
        assert!((first - 0.5).abs() > 0.2, "{first}");
        assert_eq!(Squares::<2>::default().solved([0.0; 2]), None, "no samples");
    }

    #[test]
    fn two_readings_convict_a_sensor_by_what_they_know() {
        // Of validation course 98000343, whose sensor sits well: the last two knew little of what lies aside.
        let last_two_count = |weight: f32| {
            let mut turns = Readings::default();
            for turn in [-0.149, 0.039, 0.068, -0.080, -0.074] {
                turns.add(turn, 1.0);
            }
            for turn in [-0.600, -0.905] {
                turns.add(turn, weight);
            }
            turns.tell(LEAST_TURN..MOST_TURN, READINGS_BEFORE + 7.0, 0.4)
        };
        assert!(last_two_count(1.0) && !last_two_count(0.36));
        // Of a goal 100 m away: two that knew little are not as much as two whole ones, however well the others agree.
        let mut turns = Readings::default();
        for turn in [
            -0.105, -0.036, -0.131, -0.126, -0.074, 0.018, 0.022, 0.123, 0.046, -0.108,
        ] {
            turns.add(turn, 1.0);
        }
        let mut convicts = |turn, weight| {
            turns.add(turn, weight);
            turns.tell(LEAST_TURN..MOST_TURN, READINGS_BEFORE + 12.0, 0.4)
        };
        assert!(!convicts(-0.774, 0.54) && !convicts(-0.897, 0.85) && convicts(-0.85, 0.85));
    }
}
