//! Whether a publisher of depth frames keeps to the interface (docs/sensor-interface.md): what a driver's author wants to know before
//! the first flight.

use crate::statistics::quantile;
use serde::Serialize;
use std::fmt::Write;
use vigil_policy::plausibility::{lacks_ranges, smooth_share_of};
use vigil_types::{
    DEPTH_COLS, DEPTH_FULL_SCALE_M, DEPTH_ROWS, DepthFrame, FrameDefect, FrameKeys, HORIZONTAL_FOV_RAD, Nanos, STEP_NS,
    VERTICAL_FOV_RAD,
};

/// Frames that come more than this apart on average leave some steps without a new one.
const LONGEST_INTERVAL_S: f64 = 1.05 * STEP_NS as f64 * 1e-9;
/// The age at which the loop holds by default, and the share of it that is a warning.
const AGE_LIMIT_S: f64 = 0.25;
const OLD_S: f64 = 0.1;
/// The view is looked at in parts of 16 × 16 pixels.
const PART: usize = 16;
const PART_ROWS: usize = DEPTH_ROWS / PART;
const PART_COLS: usize = DEPTH_COLS / PART;
/// Of the parts from this row down, from 15° below the horizon, each strip must see one: the firmware looks for the ground there.
const GROUND_ROW: usize = 6;
/// The guard's default for what it takes for an altered picture (docs/detection.md, rough picture), and what leaves little room above it.
const ROUGH_SHARE: f64 = vigil_guidance::ROUGH_BELOW as f64;
const NEARLY_ROUGH_SHARE: f64 = ROUGH_SHARE + 0.1;
/// Half the side of the square in the middle of the image that is held against a wall.
const MIDDLE: usize = 4;
/// How far a wall may be from where it is: the LiDAR model's noise is 2 cm.
const WALL_TOLERANCE_M: f32 = 0.1;

pub use crate::doctor::Severity;
use Severity::{Failure, Good, Warning};

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    pub name: &'static str,
    pub severity: Severity,
    /// What was found, and what to do where that is not good.
    pub text: String,
}

/// Findings, as they are added.
struct Report(Vec<Finding>);

impl Report {
    fn add(&mut self, name: &'static str, severity: Severity, text: String) {
        self.0.push(Finding { name, severity, text });
    }

    /// With the first grade that holds, and its advice behind the text; without one all is good.
    fn grade<const N: usize>(&mut self, name: &'static str, text: String, grades: [(bool, Severity, &str); N]) {
        let first = grades.into_iter().find(|(holds, ..)| *holds);
        let (severity, advice) = first.map_or((Good, ""), |(_, severity, advice)| (severity, advice));
        self.add(name, severity, text + advice);
    }
}

/// The upper one of an even count.
pub(crate) fn median(mut values: Vec<f32>) -> Option<f32> {
    values.sort_by(f32::total_cmp);
    values.get(values.len() / 2).copied()
}

/// Looks at one frame after the other.
#[derive(Default)]
pub struct SensorCheck {
    sensor_id: u32,
    keys: FrameKeys,
    wall_m: Option<f32>,
    arrivals_s: Vec<f64>,
    ages_s: Vec<f64>,
    refused: Vec<(FrameDefect, u64)>,
    last_stamp_ns: Option<Nanos>,
    last_sequence: Option<u64>,
    not_newer: u64,
    left_out: u64,
    restarted: u64,
    returns: Vec<f64>,
    smooth_shares: Vec<f64>,
    zeros: u64,
    /// Pictures in a row, and the most of them, of so many zeros, or such ranges, that two make the firmware hold.
    lacking: (u8, u8),
    unchanged: u64,
    last_pixels_hash: Option<u64>,
    seen: [[bool; PART_COLS]; PART_ROWS],
    middle_m: Vec<f32>,
}

impl SensorCheck {
    /// Of a sensor whose frames must be made with these keys, perhaps with a wall straight ahead at a known range.
    pub fn new(sensor_id: u32, keys: FrameKeys, wall_m: Option<f32>) -> Self {
        Self {
            sensor_id,
            keys,
            wall_m,
            ..Self::default()
        }
    }

    /// Takes a frame that arrived at `arrived_ns`.
    pub fn observe(&mut self, frame: &DepthFrame, arrived_ns: Nanos) {
        let header = &frame.header;
        self.arrivals_s.push(arrived_ns as f64 * 1e-9);
        let tagged = self.keys.accept(frame).then_some(()).ok_or(FrameDefect::BadTag);
        let checked = frame.check(self.sensor_id).and(tagged);
        if let Err(defect) = checked {
            match self.refused.iter_mut().find(|(known, _)| *known == defect) {
                Some((_, count)) => *count += 1,
                None => self.refused.push((defect, 1)),
            }
            return;
        }
        self.ages_s
            .push((i128::from(arrived_ns) - i128::from(header.stamp_ns)) as f64 * 1e-9);
        if self.last_stamp_ns.is_some_and(|last| header.stamp_ns <= last) {
            self.not_newer += 1;
        }
        match self.last_sequence.map(|last| header.sequence.checked_sub(last)) {
            None | Some(Some(1)) => {}
            Some(Some(0) | None) => self.restarted += 1,
            Some(Some(step)) => self.left_out = self.left_out.saturating_add(step - 1),
        }
        self.last_stamp_ns = Some(header.stamp_ns);
        self.last_sequence = Some(header.sequence);

        let pixels_hash = frame.depth.iter().fold(0xcbf2_9ce4_8422_2325u64, |hash, v| {
            (hash ^ u64::from(v.to_bits())).wrapping_mul(0x0000_0100_0000_01b3)
        });
        let before = self.last_pixels_hash.replace(pixels_hash);
        self.unchanged += u64::from(before == Some(pixels_hash));

        let mut returned = 0u32;
        for (row, pixels) in frame.depth.chunks_exact(DEPTH_COLS).enumerate() {
            for (part, values) in pixels.chunks_exact(PART).enumerate() {
                let in_part = values.iter().filter(|v| **v > 0.0 && **v < 1.0).count();
                returned += in_part as u32;
                self.seen[row / PART][part] |= in_part > 0;
            }
            self.zeros += pixels.iter().filter(|v| **v == 0.0).count() as u64;
        }
        self.returns
            .push(f64::from(returned) / f64::from((DEPTH_ROWS * DEPTH_COLS) as u32));
        self.lacking.0 = self.lacking.0.saturating_add(1) * u8::from(lacks_ranges(frame));
        self.lacking.1 = self.lacking.1.max(self.lacking.0);
        self.smooth_shares.extend(smooth_share_of(frame).map(f64::from));
        if self.wall_m.is_some() {
            let (row, col) = (DEPTH_ROWS / 2, DEPTH_COLS / 2);
            let middle = (row - MIDDLE..row + MIDDLE)
                .flat_map(|r| (col - MIDDLE..col + MIDDLE).filter_map(move |c| frame.range_m(r, c)));
            self.middle_m.extend(median(middle.collect()));
        }
    }

    /// What was found in the `seconds` until `ended_ns`.
    pub fn findings(&self, seconds: f64, ended_ns: Nanos) -> Vec<Finding> {
        let mut report = Report(Vec::new());
        if self.arrivals_s.is_empty() {
            let text = format!(
                "none within {seconds:.0} s: is the publisher running, for the same user, on the same instance and service?"
            );
            report.add("frames", Failure, text);
            return report.0;
        }
        let used = self.ages_s.len();
        let mut text = format!("{used} of {} are taken", self.arrivals_s.len());
        for (defect, count) in &self.refused {
            let _ = write!(text, "; {count} refused: {defect}");
        }
        report.grade("frames", text, [(!self.refused.is_empty(), Failure, "")]);
        self.rate(ended_ns as f64 * 1e-9, &mut report);
        if used > 0 {
            self.clock(&mut report);
            self.order(&mut report);
            self.picture(&mut report);
        }
        report.0
    }

    fn rate(&self, ended_s: f64, report: &mut Report) {
        let silent_s = self.arrivals_s.last().map_or(0.0, |last| ended_s - last);
        let intervals: Vec<f64> = self.arrivals_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let longest = quantile(&intervals, 1.0).unwrap_or_default();
        if silent_s > AGE_LIMIT_S.max(2.0 * longest) {
            let text = format!(
                "they came, and stopped {silent_s:.1} s ago: did the publisher end, does it still see its sensor?"
            );
            return report.add("rate", Failure, text);
        }
        let Some(mean) = (!intervals.is_empty()).then(|| intervals.iter().sum::<f64>() / intervals.len() as f64) else {
            return;
        };
        let longest = longest.max(silent_s);
        let held = ": longer than the age limit of 0.25 s, so the vehicle holds";
        let slow = ": slower than the 20 Hz loop, so some steps have no new picture";
        let text = format!("{:.1} Hz, longest interval {:.0} ms", 1.0 / mean, longest * 1e3);
        let (is_held, is_slow) = (longest > AGE_LIMIT_S, mean > LONGEST_INTERVAL_S);
        report.grade("rate", text, [(is_held, Failure, held), (is_slow, Warning, slow)]);
    }

    fn clock(&self, report: &mut Report) {
        let at = |q| quantile(&self.ages_s, q).unwrap_or(f64::NAN);
        let (least, middle, most) = (at(0.0), at(0.5), at(1.0));
        if least < -(STEP_NS as f64) * 1e-9 {
            let text = format!(
                "stamps lie up to {:.3} s in the future of CLOCK_MONOTONIC: stamp frames with that clock, at capture",
                -least
            );
            report.add("clock", Failure, text);
        } else if middle > 1000.0 {
            let text = format!("stamps are {middle:.0} s old: they are of another clock than CLOCK_MONOTONIC");
            report.add("clock", Failure, text);
        } else {
            let held = ": older than the age limit of 0.25 s, so the vehicle holds";
            let old = ": the vehicle flies by what it saw that long ago";
            let text = format!("{:.1} ms old on arrival, at most {:.1} ms", middle * 1e3, most * 1e3);
            let (is_held, is_old) = (most > AGE_LIMIT_S, middle > OLD_S);
            report.grade("latency", text, [(is_held, Failure, held), (is_old, Warning, old)]);
        }
    }

    fn order(&self, report: &mut Report) {
        let stamps = "with a stamp that is not newer than the one before: refused in flight";
        let numbers = "times the number did not rise: a restarted publisher, or frames sent twice";
        let wrong = [(self.not_newer, stamps), (self.restarted, numbers)].into_iter();
        let wrong = wrong.filter(|(count, _)| *count > 0);
        let words: Vec<String> = wrong.map(|(count, what)| format!("{count} {what}")).collect();
        let text = match words.is_empty() {
            true => format!("stamps and numbers rise; {} numbers were left out", self.left_out),
            false => words.join("; "),
        };
        let (is_old, is_restarted) = (self.not_newer > 0, self.restarted > 0);
        report.grade("order", text, [(is_old, Failure, ""), (is_restarted, Warning, "")]);
    }

    fn picture(&self, report: &mut Report) {
        let share = self.returns.iter().sum::<f64>() / self.returns.len() as f64;
        let none = ": a blind sensor";
        let few = ": hardly anything returns; is the range divided by 100 m?";
        let text = format!("{:.1} % of the pixels", 100.0 * share);
        report.grade(
            "returns",
            text,
            [(share == 0.0, Failure, none), (share < 0.05, Warning, few)],
        );
        let lacks = self.lacking.1 > 1;
        // Many zeros are rough, too, and no noise.
        if let Some(least) = quantile(&self.smooth_shares, 0.02).filter(|_| self.zeros == 0 || !lacks) {
            let middle = quantile(&self.smooth_shares, 0.5).unwrap_or(f64::NAN);
            let rough = ": the guard would take this sensor's pictures for altered ones: see to its noise, or fly without the guard";
            let (is_rough, is_nearly) = (least < ROUGH_SHARE, least < NEARLY_ROUGH_SHARE);
            let nearly = ": hardly more than the guard asks for";
            let text = format!(
                "{:.0} % of the parts in which something is seen show one surface (2 % of the pictures below {:.0} %)",
                100.0 * middle,
                100.0 * least
            );
            report.grade(
                "surfaces",
                text,
                [(is_rough, Warning, rough), (is_nearly, Warning, nearly)],
            );
        }
        if self.zeros > 0 || lacks {
            let held = ": the firmware holds for pictures with so many, or with ranges of anywhere (blind sensor)";
            let text = format!(
                "{} pixels are 0.0, a surface at the lens (no return is 1.0)",
                self.zeros
            );
            report.grade("zeros", text, [(lacks, Failure, held), (true, Warning, "")]);
        }
        if self.unchanged > 0 {
            let (unchanged, all) = (self.unchanged, self.returns.len());
            let text = format!(
                "{unchanged} of {all} pictures are the one before to the bit: a real sensor's noise changes them"
            );
            report.add("change", Warning, text);
        }
        self.view(report);
        self.wall(report);
    }

    /// The part of the field of view from which anything returned.
    fn view(&self, report: &mut Report) {
        let bearings = |col: usize| (col as f32 / PART_COLS as f32 - 0.5) * HORIZONTAL_FOV_RAD.to_degrees();
        let elevations = |row: usize| (0.5 - row as f32 / PART_ROWS as f32) * VERTICAL_FOV_RAD.to_degrees();
        let columns: Vec<usize> = (0..PART_COLS).filter(|c| self.seen.iter().any(|row| row[*c])).collect();
        let rows: Vec<usize> = (0..PART_ROWS)
            .filter(|r| self.seen[*r].iter().any(|seen| *seen))
            .collect();
        let edges = [columns.first(), columns.last(), rows.first(), rows.last()];
        let [Some(left), Some(right), Some(top), Some(bottom)] = edges else {
            return;
        };
        let mut text = format!(
            "returns from {:.0}° to {:.0}° across and {:.0}° to {:.0}° in height, of ±60° and ±30°",
            bearings(*left),
            bearings(right + 1),
            elevations(bottom + 1),
            elevations(*top)
        );
        let ground = &self.seen[GROUND_ROW..];
        let blind = (0..PART_COLS).filter(|c| !ground.iter().any(|row| row[*c])).count();
        if blind > 0 {
            let _ = write!(
                text,
                "; {blind} of {PART_COLS} strips never returned anything below {:.0}°: two such below 6 m are a blind \
                 sensor, and the firmware holds",
                elevations(GROUND_ROW)
            );
        }
        let severity = if blind == PART_COLS { Failure } else { Warning };
        report.grade("view", text, [(blind > 0, severity, "")]);
    }

    /// The wall that is expected in the middle.
    fn wall(&self, report: &mut Report) {
        let Some(wall_m) = self.wall_m else { return };
        let found_m = median(self.middle_m.clone()).filter(|found_m| *found_m < DEPTH_FULL_SCALE_M);
        let Some(found_m) = found_m else {
            let text = format!("no return in the middle of the image, {wall_m:.2} m expected");
            return report.add("wall", Failure, text);
        };
        let is_off = (found_m - wall_m).abs() > WALL_TOLERANCE_M;
        let text = format!("{found_m:.2} m in the middle of the image, {wall_m:.2} m expected");
        report.grade(
            "wall",
            text,
            [(is_off, Failure, ": ranges are along the ray, divided by 100 m")],
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: Nanos = 1_000_000_000;

    /// A frame of a wall 3 m away, a little different each time.
    fn frame(number: u64) -> Box<DepthFrame> {
        let mut frame = Box::new(DepthFrame::EMPTY);
        frame.header.sensor_id = 1;
        frame.header.sequence = number;
        frame.header.stamp_ns = SECOND + number * STEP_NS;
        frame.depth.fill(0.03);
        frame.depth[number as usize % 7] = 0.031;
        frame.seal();
        frame
    }

    fn check() -> SensorCheck {
        SensorCheck::new(1, FrameKeys::default(), Some(3.0))
    }

    type Alter = fn(u64, &mut DepthFrame, &mut Nanos);

    /// What is not good of a hundred frames that `alter` had a hand in before they were sealed, or after: name and text. A frame arrives
    /// 4 ms after its capture.
    fn found(is_sealed: bool, alter: Alter) -> Vec<(&'static str, String)> {
        let mut check = check();
        for number in 0..100 {
            let mut frame = frame(number);
            let mut arrived_ns = frame.header.stamp_ns + 4_000_000;
            alter(number, &mut frame, &mut arrived_ns);
            if is_sealed {
                frame.seal();
            }
            check.observe(&frame, arrived_ns);
        }
        let findings = check.findings(5.0, SECOND + 100 * STEP_NS);
        findings
            .into_iter()
            .filter(|f| f.severity > Good)
            .map(|f| (f.name, f.text))
            .collect()
    }

    #[test]
    fn a_driver_that_keeps_to_the_interface_passes() {
        assert_eq!(found(true, |_, _, _| {}), []);
    }

    /// Until it ended it was as good as ever. A slow publisher has not stopped.
    #[test]
    fn silence_is_a_failure_that_says_where_to_look_also_after_frames_or_a_single_one() {
        for (frames, apart_ns, words) in [
            (0, STEP_NS, "on the same instance and service?"),
            (1, STEP_NS, "stopped 5.0 s ago"),
            (61, STEP_NS, "stopped 2.0 s ago"),
            (10, SECOND / 2, "2.0 Hz, longest interval 500 ms: longer"),
        ] {
            let mut check = check();
            for number in 0..frames {
                check.observe(&frame(number), SECOND + number * apart_ns);
            }
            let findings = check.findings(5.0, 6 * SECOND);
            let name = if frames == 0 { "frames" } else { "rate" };
            let is_it = |f: &Finding| f.name == name && f.severity == Failure && f.text.contains(words);
            assert!(findings.iter().any(is_it), "{findings:?}");
            assert!(frames > 0 || findings.len() == 1, "{findings:?}");
        }
    }

    #[test]
    fn each_mistake_of_a_driver_is_named_with_what_to_do() {
        let cases: [(&str, &str, Alter); 16] = [
            ("frames", "checksum", |_, f, _| f.depth[5] = 0.5),
            ("frames", "128 x 128", |_, f, _| f.header.cols = 128),
            ("frames", "sensor 9", |_, f, _| f.header.sensor_id = 9),
            ("rate", "slower than the 20 Hz loop", |n, _, at| *at += n * 40_000_000),
            ("clock", "future", |_, _, at| *at -= SECOND),
            ("clock", "another clock", |_, _, at| *at += 1_000_000 * SECOND),
            ("latency", "age limit", |_, _, at| *at += SECOND),
            ("order", "not newer", |n, f, _| f.header.stamp_ns -= n % 2 * STEP_NS),
            ("returns", "blind", |_, f, _| f.depth.fill(1.0)),
            ("surfaces", "without the guard", |n, f, _| {
                let rough = f.depth.iter_mut().skip(n as usize % 2).step_by(2);
                rough.for_each(|v| *v += 0.01);
            }),
            ("zeros", "(blind sensor)", |_, f, _| {
                f.depth.iter_mut().step_by(2).for_each(|v| *v = 0.0);
            }),
            ("change", "to the bit", |_, f, _| f.depth[..7].fill(0.03)),
            ("wall", "2.60 m", |_, f, _| f.depth.iter_mut().for_each(|v| *v -= 0.004)),
            ("wall", "no return in the middle", |_, f, _| f.depth.fill(1.0)),
            (
                "view",
                "and 0° to 30° in height, of ±60° and ±30°; 16 of 16",
                |_, f, _| {
                    f.depth[DEPTH_COLS * DEPTH_ROWS / 2..].fill(1.0);
                },
            ),
            ("view", "-30°", |_, f, _| {
                let rows = f.depth.chunks_exact_mut(DEPTH_COLS);
                rows.for_each(|row| row[..64].fill(1.0));
            }),
        ];
        for (name, words, alter) in cases {
            let found = found(words != "checksum", alter);
            let is_surfaces = |(n, _): &(&str, String)| *n == "surfaces";
            assert!(
                name != "zeros" || !found.iter().any(is_surfaces),
                "zeros are no noise: {found:?}"
            );
            assert!(
                found.iter().any(|(n, text)| *n == name && text.contains(words)),
                "{name}, {words}: {found:?}"
            );
        }
    }
}
