//! A second sensor against the depth frames: what it sees nearer than they do is really there (docs/second-sensor.md).
//!
//! It looks ahead only, coarsely and not far, so it does not steer; but it does not come through the same driver, and who alters frames does not
//! alter it. It convicts frames of hiding something, never of showing too much: what it does not see may be beside its view.

use crate::geometric::range_scan::SECTORS;
use crate::{PilotInput, RangeScan, larger};
use vigil_types::{HORIZONTAL_FOV_RAD, Nanos, Reason, Reasons, SectorRanges, wrap_pi};

/// A report older than this is as good as none: four of a 15 Hz sensor's are missing.
const AGE_LIMIT_NS: Nanos = 300_000_000;
/// Nearer than the frames show by more than this, metres, something is hidden: noise of both, the way flown between both, edges.
const HIDDEN_M: f32 = 0.5;
/// The frames may show it beside the sector by this share of its width: the vehicle turns between report and frame.
const SLACK: f32 = 1.0;
/// So many of the last [`WINDOW`] reports contradict the frames.
const CONTRADICTIONS: u32 = 3;
const WINDOW: u32 = 5;
/// Reports in a row that agree until the frames are believed again.
const AGREEING: u8 = 15;
/// Lower than this the vehicle may stand or take off, metres.
const LOW_M: f32 = 0.5;

/// Judges each report of the second sensor. No allocation.
#[derive(Debug, Clone, Default)]
pub struct SecondSensor {
    scan: RangeScan,
    last_ns: Option<Nanos>,
    /// One bit for each of the last reports, 1 where it contradicted the frames.
    contradicted: u32,
    agreeing: u8,
    disagrees: bool,
    /// How often they began to disagree in this flight.
    times: u8,
}

impl SecondSensor {
    /// One that has seen nothing.
    pub fn new() -> Self {
        Self::default()
    }

    /// What is wrong now: [`Reason::SecondSensorSilent`], [`Reason::SensorsDisagree`]. `newest` is the sensor's newest report, `input` the newest
    /// frame with where the vehicle is, `None` while either is stale. To be asked once in every step.
    pub fn check(
        &mut self,
        now_ns: Nanos,
        newest: Option<&SectorRanges>,
        input: Option<&PilotInput<'_>>,
        airborne: bool,
    ) -> Reasons {
        if !airborne {
            (self.contradicted, self.agreeing, self.disagrees, self.times) = (0, 0, false, 0);
        }
        let newest = newest.filter(|ranges| {
            // Sectors too wide to lie in the camera's view are compared with nothing.
            now_ns.saturating_sub(ranges.at_ns) <= AGE_LIMIT_NS && half_rad(ranges) <= 0.5 * HORIZONTAL_FOV_RAD
        });
        let Some(ranges) = newest else {
            return Reasons::of(Reason::SecondSensorSilent).with_if(self.disagrees, Reason::SensorsDisagree);
        };
        if self.last_ns != Some(ranges.at_ns)
            && let Some(input) = input.filter(|input| airborne && input.height_m > LOW_M)
        {
            self.last_ns = Some(ranges.at_ns);
            let hides = self.hides(ranges, input);
            self.note(hides);
        }
        Reasons::NONE.with_if(self.disagrees, Reason::SensorsDisagree)
    }

    fn note(&mut self, hides: bool) {
        self.contradicted = (self.contradicted << 1 | u32::from(hides)) & ((1 << WINDOW) - 1);
        self.agreeing = if hides { 0 } else { self.agreeing.saturating_add(1) };
        let contradicted = self.contradicted.count_ones() >= CONTRADICTIONS;
        if contradicted && !self.disagrees {
            self.disagrees = true;
            self.times = self.times.saturating_add(1);
        } else if self.disagrees && self.times < 2 && self.agreeing >= AGREEING {
            self.disagrees = false;
        }
    }

    /// Whether the frame shows nothing as near as the sensor does, in any of its sectors.
    fn hides(&mut self, ranges: &SectorRanges, input: &PilotInput<'_>) -> bool {
        let scan = self.scan.observe(input);
        let half_rad = half_rad(ranges);
        let least_cos = libm::cosf(half_rad);
        ranges.known().any(|(bearing_rad, range_m)| {
            // Where the camera does not look it hides nothing.
            let in_view = wrap_pi(bearing_rad).abs() + half_rad <= 0.5 * HORIZONTAL_FOV_RAD;
            if !range_m.is_finite() || !in_view {
                return false;
            }
            let (sin, cos) = (libm::sinf(bearing_rad), libm::cosf(bearing_rad));
            let directions = scan.direction_forward.iter().zip(&scan.direction_right);
            let nearest_m = directions
                .zip(&scan.range_m)
                .filter(|((forward, right), _)| *forward * cos + *right * sin >= least_cos)
                .map(|(_, seen_m)| *seen_m)
                .reduce(f32::min);
            // In a turn the frame may have had no direction there.
            nearest_m.is_some_and(|nearest_m| range_m + HIDDEN_M < nearest_m)
        })
    }
}

/// From a sector's middle to the end of what is compared with it: at least one direction of the frame's scan.
fn half_rad(ranges: &SectorRanges) -> f32 {
    larger(
        ranges.step_rad.abs() * (0.5 + SLACK),
        HORIZONTAL_FOV_RAD / SECTORS as f32,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use vigil_types::{Attitude, DepthFrame, GoalRelative, RANGE_SECTORS};

    const REPORT_NS: Nanos = 66_000_000;

    /// Ranges ahead in eight sectors over 45°.
    fn report(at_ns: Nanos, ahead_m: f32) -> SectorRanges {
        let step_rad = core::f32::consts::FRAC_PI_4 / 8.0;
        let mut range_m = [f32::NAN; RANGE_SECTORS];
        range_m.iter_mut().take(8).for_each(|range| *range = f32::INFINITY);
        range_m[3] = ahead_m;
        SectorRanges {
            at_ns,
            first_rad: -3.5 * step_rad,
            step_rad,
            range_m,
        }
    }

    /// What a vehicle that hovers sees.
    fn hovering(now_ns: Nanos, depth: &DepthFrame) -> PilotInput<'_> {
        PilotInput {
            now_ns,
            height_m: 2.0,
            ..PilotInput::at_rest(depth, GoalRelative::new(10.0, 0.0))
        }
    }

    /// Judges so many reports of something at `near_m` against frames that show a wall at `wall_m` all around.
    fn check(sensor: &mut SecondSensor, from: u64, reports: u64, near_m: f32, wall_m: f32, airborne: bool) -> Reasons {
        let mut frame = DepthFrame::EMPTY;
        frame.depth.fill(wall_m / 100.0);
        let mut found = Reasons::NONE;
        for i in from..from + reports {
            let now_ns = i * REPORT_NS;
            frame.header.stamp_ns = now_ns;
            let input = hovering(now_ns, &frame);
            found = sensor.check(now_ns, Some(&report(now_ns, near_m)), Some(&input), airborne);
        }
        found
    }

    #[test]
    fn three_reports_of_what_the_frames_hide_hold_the_flight_until_fifteen_agree() {
        let mut sensor = SecondSensor::new();
        let disagrees = Reasons::of(Reason::SensorsDisagree);
        assert_eq!(check(&mut sensor, 0, 20, 2.0, 2.2, true), Reasons::NONE, "both see it");
        assert_eq!(
            check(&mut sensor, 20, 20, f32::INFINITY, 2.2, true),
            Reasons::NONE,
            "it sees less"
        );
        assert_eq!(check(&mut sensor, 40, 2, 2.0, 9.8, true), Reasons::NONE);
        assert_eq!(check(&mut sensor, 42, 1, 2.0, 9.8, true), disagrees);
        assert_eq!(check(&mut sensor, 43, 14, 2.0, 2.0, true), disagrees);
        assert_eq!(check(&mut sensor, 57, 1, 2.0, 2.0, true), Reasons::NONE);
        // The second time is for the rest of the flight.
        assert_eq!(check(&mut sensor, 58, 5, 2.0, 9.8, true), disagrees);
        assert_eq!(check(&mut sensor, 63, 100, 2.0, 2.0, true), disagrees);
        assert_eq!(check(&mut sensor, 163, 1, 2.0, 9.8, false), Reasons::NONE, "landed");
        assert_eq!(check(&mut sensor, 164, 2, 2.0, 9.8, true), Reasons::NONE, "begins anew");
    }

    #[test]
    fn a_sensor_that_is_silent_or_stale_is_named_and_one_that_speaks_again_is_not() {
        let mut sensor = SecondSensor::new();
        let silent = Reasons::of(Reason::SecondSensorSilent);
        assert_eq!(sensor.check(0, None, None, false), silent);
        let old = report(1_000, 2.0);
        assert_eq!(
            sensor.check(1_000 + AGE_LIMIT_NS, Some(&old), None, true),
            Reasons::NONE
        );
        assert_eq!(sensor.check(1_001 + AGE_LIMIT_NS, Some(&old), None, true), silent);
        let new = report(2 * AGE_LIMIT_NS, 2.0);
        assert_eq!(sensor.check(2 * AGE_LIMIT_NS, Some(&new), None, true), Reasons::NONE);
    }

    #[test]
    fn where_the_camera_does_not_look_nothing_is_hidden() {
        let mut sensor = SecondSensor::new();
        let mut frame = DepthFrame::EMPTY;
        frame.depth.fill(0.2);
        let input = hovering(0, &frame);
        let behind = SectorRanges {
            first_rad: core::f32::consts::PI,
            ..report(0, 2.0)
        };
        assert!(!sensor.hides(&behind, &input));
        assert!(sensor.hides(&report(0, 2.0), &input));
    }

    #[test]
    fn a_narrow_beam_is_compared_with_what_is_nearest_to_it_and_one_wider_than_the_view_is_none() {
        let mut sensor = SecondSensor::new();
        let mut frame = DepthFrame::EMPTY;
        frame.depth.fill(0.03);
        let input = hovering(0, &frame);
        let beam = |step_deg: f32, i: i16| SectorRanges {
            first_rad: f32::from(i) * 0.02 - 0.5,
            step_rad: step_deg.to_radians(),
            range_m: core::array::from_fn(|sector| if sector == 0 { 3.0 } else { f32::NAN }),
            ..report(0, 3.0)
        };
        assert!(
            (0..50).all(|i| !sensor.hides(&beam(0.2, i), &input)),
            "both see the wall"
        );
        let turned = PilotInput {
            now_ns: 150_000_000,
            attitude: Attitude::from_euler_rad(0.0, 0.0, 6.75_f32.to_radians()),
            ..input
        };
        assert!(!sensor.hides(&beam(2.0, 74), &turned), "in a turn");
        let silent = Reasons::of(Reason::SecondSensorSilent);
        assert_eq!(sensor.check(0, Some(&beam(43.0, 25)), Some(&input), true), silent);
    }
}
