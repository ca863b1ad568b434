//! One column or row of the image: what lies between the samples that fell on it.
//!
//! Along a line across a plane the reciprocal of range changes almost linearly with the angle, so between two samples of one
//! surface it is interpolated. Where two samples are of different surfaces the nearer one counts: no range appears where nothing
//! is, and nothing becomes thinner. These are the LiDAR model's rules, for beams that lie anywhere.

use vigil_types::DEPTH_COLS;

/// Neighbours whose ranges differ by no more than this see one surface, metres.
const TOLERANCE_M: f32 = 0.2;
/// A slope is taken over at least this distance, pixels.
const LEAST_TRAVEL: f32 = 0.5;
/// How many samples back it is looked for.
const MOST_BACK: usize = 2;

/// What fell on a pixel: reciprocal of range (0 where nothing did, 1/m), and how far from the pixel's centre, pixels.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Sample {
    pub(crate) inverse: f32,
    /// Along the line that is filled first.
    pub(crate) down: f32,
    /// Across it.
    pub(crate) across: f32,
}

/// A sample's place on the line, and the sample.
type Mark = (f32, Sample);

/// The samples of one line.
pub(crate) struct Line {
    marks: [Mark; DEPTH_COLS],
    count: usize,
    span: f32,
}

impl Line {
    /// `span`: how far apart two samples may be between which nothing is missing, pixels.
    pub(crate) fn new(span: f32) -> Self {
        Self {
            marks: [Mark::default(); DEPTH_COLS],
            count: 0,
            span,
        }
    }

    /// Replaces the samples of a line by what is on the centres of its pixels. `at` gives a sample's place from its pixel's centre.
    pub(crate) fn centre(
        &mut self,
        pixels: usize,
        read: impl Fn(usize) -> Sample,
        at: impl Fn(Sample) -> f32,
        mut write: impl FnMut(usize, Sample),
    ) {
        self.count = 0;
        for pixel in 0..pixels {
            let sample = read(pixel);
            if sample.inverse > 0.0
                && let Some(mark) = self.marks.get_mut(self.count)
            {
                *mark = (pixel as f32 + at(sample), sample);
                self.count += 1;
            }
        }
        let mut next = 0;
        for pixel in 0..pixels {
            let centre = pixel as f32;
            while next < self.count && self.mark(next).is_some_and(|(at, _)| at < centre) {
                next += 1;
            }
            let before = next.checked_sub(1).and_then(|i| self.mark(i));
            let after = self.mark(next);
            let own = |mark: Option<Mark>| mark.filter(|(at, _)| (at - centre).abs() <= 0.5);
            let found = match (before, after) {
                (Some((from, a)), Some((to, b))) if to - from <= self.span => {
                    match (self.is_one_surface(next - 1), own(before), own(after)) {
                        (true, _, _) => {
                            let part = (centre - from) / (to - from).max(f32::EPSILON);
                            Some(Sample {
                                inverse: a.inverse + part * (b.inverse - a.inverse),
                                across: a.across + part * (b.across - a.across),
                                ..a
                            })
                        }
                        (false, Some(_), None) => Some(a),
                        (false, None, Some(_)) => Some(b),
                        _ if a.inverse > b.inverse => Some(a),
                        _ => Some(b),
                    }
                }
                _ => own(after).or(own(before)).map(|(_, sample)| sample),
            };
            write(pixel, found.map(|s| Sample { down: 0.0, ..s }).unwrap_or_default());
        }
    }

    fn mark(&self, i: usize) -> Option<Mark> {
        self.marks.get(..self.count).and_then(|marks| marks.get(i)).copied()
    }

    /// Whether sample `i` and the next see one surface: their ranges are alike, or one lies where a straight line through the other
    /// and its outer neighbour leads.
    fn is_one_surface(&self, i: usize) -> bool {
        let (Some(a), Some(b)) = (self.mark(i), self.mark(i + 1)) else {
            return false;
        };
        let tolerance = TOLERANCE_M * a.1.inverse * b.1.inverse;
        let continues = |(at, from): Mark, (to_at, to): Mark, outer: &dyn Fn(usize) -> Option<Mark>| {
            let outer = (1..=MOST_BACK)
                .filter_map(outer)
                .find(|m| (at - m.0).abs() >= LEAST_TRAVEL);
            outer.is_some_and(|(outer_at, outer)| {
                let slope = (from.inverse - outer.inverse) / (at - outer_at);
                let is_near = (at - outer_at).abs() <= self.span;
                is_near && (from.inverse + slope * (to_at - at) - to.inverse).abs() <= tolerance
            })
        };
        (a.1.inverse - b.1.inverse).abs() <= tolerance
            || continues(a, b, &|n| self.mark(i.checked_sub(n)?))
            || continues(b, a, &|n| self.mark(i + 1 + n))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    extern crate std;
    use std::vec::Vec;

    /// Ranges of ten pixels, of samples (place, range).
    fn centred(span: f32, samples: &[(f32, f32)]) -> Vec<f32> {
        let mut given = [Sample::default(); 10];
        for (at, range_m) in samples {
            let pixel = libm::roundf(*at);
            let sample = &mut given[pixel as usize];
            (sample.inverse, sample.down) = (1.0 / range_m, at - pixel);
        }
        let mut out = [0.0; 10];
        Line::new(span).centre(10, |i| given[i], |s| s.down, |i, s| out[i] = s.inverse);
        out.iter().map(|q| libm::roundf(1e4 / q) / 1e4).collect()
    }

    const NONE: f32 = f32::INFINITY;

    #[test]
    fn between_two_beams_of_one_plane_lies_the_plane() {
        // Reciprocals 0.1, 0.11, 0.12 at 0, 3, 6.
        let seen = centred(4.0, &[(0.0, 10.0), (3.0, 1.0 / 0.11), (6.0, 1.0 / 0.12)]);
        for (pixel, range_m) in seen.iter().enumerate().take(7) {
            assert!((range_m - 1.0 / (0.1 + pixel as f32 / 300.0)).abs() < 1e-3, "{seen:?}");
        }
        assert_eq!(seen[7..], [NONE; 3], "beyond the last beam is nothing");
    }

    #[test]
    fn at_an_edge_the_nearer_counts_and_no_range_appears_between() {
        assert_eq!(
            centred(4.0, &[(1.0, 9.0), (4.0, 3.0)]),
            [NONE, 9.0, 3.0, 3.0, 3.0, NONE, NONE, NONE, NONE, NONE]
        );
    }

    #[test]
    fn what_is_farther_apart_than_beams_are_stays_open() {
        assert_eq!(centred(2.0, &[(1.0, 3.0), (4.0, 3.0)])[2..4], [NONE; 2]);
    }

    #[test]
    fn a_beam_beside_its_pixels_centre_is_moved_along_its_surface() {
        let at = |x: f32| 1.0 / (0.05 + 0.01 * x);
        let seen = centred(2.0, &[(0.6, at(0.6)), (1.7, at(1.7)), (2.8, at(2.8)), (4.1, at(4.1))]);
        for (pixel, range_m) in seen.iter().enumerate().skip(1).take(4) {
            assert!((range_m - at(pixel as f32)).abs() < 1e-3 || pixel == 4, "{seen:?}");
        }
    }
}
