//! A second sensor against the depth frames: what it sees nearer than they do is really there (docs/second-sensor.md).
//!
//! It looks ahead only, coarsely and not far, so it does not steer; but it does not come through the same driver, and who alters frames does not
//! alter it. It convicts frames of hiding something, never of showing too much: what it does not see may be beside its view.

use crate::geometric::range_scan::SECTORS;
use crate::{PilotInput, RangeScan, Scan, larger};
use vigil_types::{HORIZONTAL_FOV_RAD, Nanos, RANGE_SOURCES, Reason, Reasons, SectorRanges, wrap_pi};

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

/// What one component's reports came to.
#[derive(Debug, Clone, Copy, Default)]
struct Head {
    component: u8,
    last_ns: Option<Nanos>,
    /// One bit for each of the last reports, 1 where it contradicted the frames.
    contradicted: u32,
    agreeing: u8,
}

impl Head {
    fn note(&mut self, ranges: &SectorRanges, hides: bool) {
        if self.component != ranges.component {
            *self = Self::default();
        }
        (self.component, self.last_ns) = (ranges.component, Some(ranges.at_ns));
        self.contradicted = (self.contradicted << 1 | u32::from(hides)) & ((1 << WINDOW) - 1);
        self.agreeing = if hides { 0 } else { self.agreeing.saturating_add(1) };
    }
}

/// Checks each report of the second sensor, or of each of several; by default one that has seen nothing. No allocation.
#[derive(Debug, Clone, Default)]
pub struct SecondSensor {
    scan: RangeScan,
    heads: [Head; RANGE_SOURCES],
    /// When the last report arrived that says something of what the camera sees.
    heard_ns: Option<Nanos>,
    disagrees: bool,
    /// How often they began to disagree in this flight.
    times: u8,
}

impl SecondSensor {
    /// What is wrong now: [`Reason::SecondSensorSilent`], [`Reason::SensorsDisagree`]. `newest` is the newest report of each component, `input`
    /// the newest frame with where the vehicle is, `None` while either is stale. To be asked once in every step.
    pub fn check(
        &mut self,
        now_ns: Nanos,
        newest: &[Option<SectorRanges>],
        input: Option<&PilotInput<'_>>,
        airborne: bool,
    ) -> Reasons {
        if !airborne {
            (self.heads, self.disagrees, self.times) = (Default::default(), false, 0);
        }
        // What looks elsewhere, or is too wide, is compared with nothing.
        let usable = |ranges: &&SectorRanges| in_view(ranges).next().is_some();
        let heard_ns = newest.iter().flatten().filter(usable).map(|ranges| ranges.at_ns);
        self.heard_ns = heard_ns.chain(self.heard_ns).max();
        let is_recent = |at_ns: Nanos| now_ns.saturating_sub(at_ns) <= AGE_LIMIT_NS;
        if !self.heard_ns.is_some_and(is_recent) {
            return Reasons::of(Reason::SecondSensorSilent).with_if(self.disagrees, Reason::SensorsDisagree);
        }
        if let Some(input) = input.filter(|input| airborne && input.height_m > LOW_M) {
            let heads = self.heads.iter_mut().zip(newest);
            let reports = heads.filter_map(|(head, ranges)| Some((head, ranges.as_ref().filter(usable)?)));
            let mut reports = reports
                .filter(|(head, ranges)| head.last_ns != Some(ranges.at_ns) && is_recent(ranges.at_ns))
                .peekable();
            if reports.peek().is_some() {
                let scan = self.scan.observe(input);
                reports.for_each(|(head, ranges)| head.note(ranges, hides(scan, ranges)));
                self.weigh(is_recent);
            }
        }
        Reasons::NONE.with_if(self.disagrees, Reason::SensorsDisagree)
    }

    /// One component's reports hold the vehicle; all that are heard let it go on.
    fn weigh(&mut self, is_recent: impl Fn(Nanos) -> bool) {
        let mut heard = self.heads.iter().filter(|head| head.last_ns.is_some_and(&is_recent));
        if heard
            .clone()
            .any(|head| head.contradicted.count_ones() >= CONTRADICTIONS)
        {
            self.times = self.times.saturating_add(u8::from(!self.disagrees));
            self.disagrees = true;
        } else if self.times < 2 && heard.all(|head| head.agreeing >= AGREEING) {
            self.disagrees = false;
        }
    }
}

/// Whether the frame shows nothing as near as the sensor does, in any of its sectors.
fn hides(scan: &Scan, ranges: &SectorRanges) -> bool {
    let half_rad = half_rad(ranges);
    let least_cos = libm::cosf(half_rad);
    let mut seen = in_view(ranges).filter(|(_, range_m)| range_m.is_finite());
    seen.any(|(bearing_rad, range_m)| {
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

/// From a sector's middle to the end of what is compared with it: at least one direction of the frame's scan.
fn half_rad(ranges: &SectorRanges) -> f32 {
    larger(
        ranges.step_rad.abs() * (0.5 + SLACK),
        HORIZONTAL_FOV_RAD / SECTORS as f32,
    )
}

/// The known sectors in the camera's view: elsewhere it hides nothing.
fn in_view(ranges: &SectorRanges) -> impl Iterator<Item = (f32, f32)> + '_ {
    let half_rad = half_rad(ranges);
    let sectors = ranges.known();
    sectors.filter(move |(bearing_rad, _)| wrap_pi(*bearing_rad).abs() + half_rad <= 0.5 * HORIZONTAL_FOV_RAD)
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
            component: 196,
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

    fn hides_of(sensor: &mut SecondSensor, ranges: &SectorRanges, input: &PilotInput<'_>) -> bool {
        hides(sensor.scan.observe(input), ranges)
    }

    /// Checks so many reports of something at `near_m` against frames that show a wall at `wall_m` all around.
    fn check(sensor: &mut SecondSensor, from: u64, reports: u64, near_m: f32, wall_m: f32, airborne: bool) -> Reasons {
        let mut frame = DepthFrame::EMPTY;
        frame.depth.fill(wall_m / 100.0);
        let mut found = Reasons::NONE;
        for i in from..from + reports {
            let now_ns = i * REPORT_NS;
            frame.header.stamp_ns = now_ns;
            let input = hovering(now_ns, &frame);
            found = sensor.check(now_ns, &[Some(report(now_ns, near_m))], Some(&input), airborne);
        }
        found
    }

    #[test]
    fn three_reports_of_what_the_frames_hide_hold_the_flight_until_fifteen_agree() {
        let mut sensor = SecondSensor::default();
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
    fn one_of_three_components_that_report_by_turns_or_at_once_is_enough_to_hold_and_all_let_it_go_on() {
        let free = f32::INFINITY;
        let from = |component: u8, at_ns, ahead_m| {
            Some(SectorRanges {
                component,
                ..report(at_ns, ahead_m)
            })
        };
        let mut frame = DepthFrame::EMPTY;
        for by_turns in [false, true] {
            let mut sensor = SecondSensor::default();
            let mut held = alloc::vec::Vec::new();
            for i in 0..75 {
                let (now_ns, ahead_m) = (i * REPORT_NS, if i < 12 { 1.0 } else { free });
                frame.header.stamp_ns = now_ns;
                let last_ns = |head: u64| {
                    if by_turns {
                        (i - (i + head) % 3.min(i + 1)) * REPORT_NS
                    } else {
                        now_ns
                    }
                };
                let heads = [
                    from(196, last_ns(0), free),
                    from(197, last_ns(1), ahead_m),
                    from(198, last_ns(2), free),
                ];
                held.push(
                    !sensor
                        .check(now_ns, &heads, Some(&hovering(now_ns, &frame)), true)
                        .is_empty(),
                );
            }
            let first = held.iter().position(|held| *held).expect("held");
            assert!((2..9).contains(&first) && !held[74], "{first}");
        }
    }

    #[test]
    fn a_sensor_that_is_silent_or_stale_is_named_and_one_that_speaks_again_is_not() {
        let mut sensor = SecondSensor::default();
        let silent = Reasons::of(Reason::SecondSensorSilent);
        assert_eq!(sensor.check(0, &[None], None, false), silent);
        let old = report(1_000, 2.0);
        assert_eq!(
            sensor.check(1_000 + AGE_LIMIT_NS, &[Some(old)], None, true),
            Reasons::NONE
        );
        assert_eq!(sensor.check(1_001 + AGE_LIMIT_NS, &[Some(old)], None, true), silent);
        let new = report(2 * AGE_LIMIT_NS, 2.0);
        assert_eq!(sensor.check(2 * AGE_LIMIT_NS, &[Some(new)], None, true), Reasons::NONE);
    }

    #[test]
    fn where_the_camera_does_not_look_nothing_is_hidden() {
        let mut sensor = SecondSensor::default();
        let mut frame = DepthFrame::EMPTY;
        frame.depth.fill(0.2);
        let input = hovering(0, &frame);
        let behind = SectorRanges {
            first_rad: core::f32::consts::PI,
            ..report(0, 2.0)
        };
        assert!(!hides_of(&mut sensor, &behind, &input));
        assert!(hides_of(&mut sensor, &report(0, 2.0), &input));
        // A sensor that looks only there is as good as none; beside one that looks ahead it does no harm.
        let silent = Reasons::of(Reason::SecondSensorSilent);
        assert_eq!(sensor.check(0, &[Some(behind)], Some(&input), true), silent);
        for newest in [report(0, 20.0), behind] {
            assert_eq!(sensor.check(0, &[Some(newest)], Some(&input), true), Reasons::NONE);
        }
    }

    #[test]
    fn a_narrow_beam_is_compared_with_what_is_nearest_to_it_and_one_wider_than_the_view_is_none() {
        let mut sensor = SecondSensor::default();
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
            (0..50).all(|i| !hides_of(&mut sensor, &beam(0.2, i), &input)),
            "both see the wall"
        );
        let turned = PilotInput {
            now_ns: 150_000_000,
            attitude: Attitude::from_euler_rad(0.0, 0.0, 6.75_f32.to_radians()),
            ..input
        };
        assert!(!hides_of(&mut sensor, &beam(2.0, 74), &turned), "in a turn");
        let silent = Reasons::of(Reason::SecondSensorSilent);
        assert_eq!(sensor.check(0, &[Some(beam(43.0, 25))], Some(&input), true), silent);
    }
}
