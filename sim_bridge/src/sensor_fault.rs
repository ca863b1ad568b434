//! Faults of the depth sensor: what a frame becomes before it is published (docs/sensor-faults.md).

use crate::vehicle::normal_of;
use crate::world::split_mix;
use std::ops::RangeBounds;
use std::str::FromStr;
use vigil_types::{
    Attitude, DEPTH_COLS, DEPTH_FULL_SCALE_M, DEPTH_PIXELS, DEPTH_ROWS, DepthFrame, NedVector, PIXEL_PITCH_RAD,
    STEP_NS, named,
};

/// Steps by which a delayed frame comes late: 0.3 s.
const DELAY_STEPS: usize = 6;
/// Columns by which a shifted picture is off: 5.2°.
const SHIFT_COLUMNS: usize = 11;
/// How far a mount that gave way is turned: 5°.
const TURN_RAD: f32 = 5.0 * core::f32::consts::PI / 180.0;
/// Rows and columns of a band that is stuck.
const STUCK_ROWS: usize = 24;
const STUCK_COLUMNS: usize = 48;
/// Where a position that is wrong and finite is moved to, metres.
const DISPLACED_M: f32 = 25.0;
/// Fresh noise on a frozen picture, metres.
const NOISE_SIGMA_M: f32 = 0.02;
/// Moments from which [`Onset::Random`] is drawn, seconds.
const RANDOM_ONSET_S: (f64, f64) = (0.5, 15.0);

named! {
    /// What is wrong with the sensor.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum SensorFaultMode {
        /// Every pixel 0.0.
        Zeros => "zeros",
        /// Every pixel 1.0: no return anywhere.
        Ones => "ones",
        /// The same image again and again, under fresh stamps and poses.
        Frozen => "frozen",
        /// The same with fresh noise on it.
        FrozenNoisy => "frozen-noisy",
        /// No return in the left half.
        DeadLeft => "dead-left",
        /// No return in the right half.
        DeadRight => "dead-right",
        /// No return in the upper half.
        DeadTop => "dead-top",
        /// No return in the lower half.
        DeadBottom => "dead-bottom",
        /// The left half stays as it was.
        FrozenLeft => "frozen-left",
        /// The right half stays as it was.
        FrozenRight => "frozen-right",
        /// The upper half stays as it was.
        FrozenTop => "frozen-top",
        /// The lower half stays as it was.
        FrozenBottom => "frozen-bottom",
        /// A band of 24 rows stays as it was.
        StuckRows => "stuck-rows",
        /// A band of 48 columns stays as it was.
        StuckColumns => "stuck-columns",
        /// Left and right are exchanged.
        Mirrored => "mirrored",
        /// The image is shifted by 11 columns (5.2°), to a side drawn from the seed; the outermost column fills the rest.
        Shifted => "shifted",
        /// The sensor is turned by 5° on its mount, to a side drawn from the seed.
        Turned => "turned",
        /// Frames arrive 0.3 s late, with the stamp of their capture.
        Delayed => "delayed",
        /// The header's position is 1e30.
        FarPosition => "far-position",
        /// The header's position is 25 m off.
        DisplacedPosition => "displaced-position",
        /// The header's quaternion is not of unit length.
        BadQuaternion => "bad-quaternion",
        /// The header's pose stays as it was.
        FrozenPose => "frozen-pose",
        /// The stamp stays as it was.
        FrozenStamp => "frozen-stamp",
        /// Stamps go back by a second.
        EarlierStamp => "earlier-stamp",
    }
}

/// From when on.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Onset {
    /// From this moment on, seconds from the simulator's start.
    At(f64),
    /// From a moment drawn from the flight's seed, 0.5 to 15 s.
    Random,
}

/// A fault and its onset: `MODE`, `MODE@SECONDS` or `MODE@random`.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct SensorFault {
    /// What is wrong.
    pub mode: SensorFaultMode,
    /// From when on.
    pub onset: Onset,
}

impl FromStr for SensorFault {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (mode, onset) = text.split_once('@').unwrap_or((text, "0"));
        let mode = SensorFaultMode::from_name(mode).ok_or_else(|| {
            let names = SensorFaultMode::ALL.map(SensorFaultMode::name).join(", ");
            format!("`{mode}` is no sensor fault; there are {names}")
        })?;
        let onset = match onset {
            "random" => Onset::Random,
            seconds => match seconds.parse() {
                Ok(at_s) if (0.0..=3600.0).contains(&at_s) => Onset::At(at_s),
                _ => return Err("after @ give the onset in seconds, 0 to 3600, or `random`".to_owned()),
            },
        };
        Ok(Self { mode, onset })
    }
}

impl std::fmt::Display for SensorFault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.onset {
            Onset::At(0.0) => write!(f, "{}", self.mode.name()),
            Onset::At(at_s) => write!(f, "{}@{at_s}", self.mode.name()),
            Onset::Random => write!(f, "{}@random", self.mode.name()),
        }
    }
}

/// A sensor that fails: keeps what the fault needs of earlier frames.
pub(crate) struct FailingSensor {
    mode: SensorFaultMode,
    onset_ns: u64,
    /// Draws side and place.
    draw: u64,
    /// The frame at the onset.
    kept: Option<Box<DepthFrame>>,
    /// The last frames, for a delay; a ring.
    late: Vec<DepthFrame>,
    frames: u64,
}

impl FailingSensor {
    pub(crate) fn new(fault: SensorFault, seed: u64) -> Self {
        let draw = split_mix(seed ^ 0x5e25_0f41);
        let onset_s = match fault.onset {
            Onset::At(at_s) => at_s,
            Onset::Random => {
                let share = (split_mix(draw) >> 11) as f64 / (1u64 << 53) as f64;
                RANDOM_ONSET_S.0 + share * (RANDOM_ONSET_S.1 - RANDOM_ONSET_S.0)
            }
        };
        let late = match fault.mode {
            SensorFaultMode::Delayed => vec![DepthFrame::EMPTY; DELAY_STEPS + 1],
            _ => Vec::new(),
        };
        Self {
            mode: fault.mode,
            onset_ns: (onset_s * 1e9) as u64,
            draw,
            kept: None,
            late,
            frames: 0,
        }
    }

    fn to_the_left(&self) -> bool {
        self.draw & 1 == 0
    }

    /// How the sensor is turned `elapsed_ns` after the start, given how it ought to be.
    pub(crate) fn attitude(&self, elapsed_ns: u64, attitude: Attitude) -> Attitude {
        if self.mode != SensorFaultMode::Turned || elapsed_ns < self.onset_ns {
            return attitude;
        }
        let half = 0.5 * if self.to_the_left() { -TURN_RAD } else { TURN_RAD };
        let (s, c) = (libm::sinf(half), libm::cosf(half));
        let Attitude { w, x, y, z } = attitude;
        // The product with a turn about the body's own down axis.
        Attitude {
            w: w * c - z * s,
            x: x * c + y * s,
            y: y * c - x * s,
            z: z * c + w * s,
        }
    }

    /// Makes of a good frame what the failing sensor publishes `elapsed_ns` after the start, and seals it.
    pub(crate) fn spoil(&mut self, elapsed_ns: u64, frame: &mut DepthFrame) {
        let number = self.frames;
        self.frames += 1;
        if !self.late.is_empty() {
            let slots = self.late.len() as u64;
            self.late[(number % slots) as usize] = frame.clone();
        }
        if elapsed_ns < self.onset_ns {
            return;
        }
        let (draw, left) = (self.draw, self.to_the_left());
        let kept = &**self.kept.get_or_insert_with(|| Box::new(frame.clone()));
        let header = &mut frame.header;
        match self.mode {
            SensorFaultMode::Zeros => frame.depth = [0.0; DEPTH_PIXELS],
            SensorFaultMode::Ones => frame.depth = [1.0; DEPTH_PIXELS],
            SensorFaultMode::Frozen => frame.depth = kept.depth,
            SensorFaultMode::FrozenNoisy => {
                frame.depth = kept.depth;
                for (pixel, depth) in frame.depth.iter_mut().enumerate().filter(|(_, d)| **d < 1.0) {
                    let noise_m = NOISE_SIGMA_M
                        * normal_of(split_mix(draw ^ split_mix(number * DEPTH_PIXELS as u64 + pixel as u64))) as f32;
                    *depth = (*depth + noise_m / DEPTH_FULL_SCALE_M).clamp(1e-6, 1.0);
                }
            }
            SensorFaultMode::DeadLeft => region(frame, .., ..DEPTH_COLS / 2, |_| 1.0),
            SensorFaultMode::DeadRight => region(frame, .., DEPTH_COLS / 2.., |_| 1.0),
            SensorFaultMode::DeadTop => region(frame, ..DEPTH_ROWS / 2, .., |_| 1.0),
            SensorFaultMode::DeadBottom => region(frame, DEPTH_ROWS / 2.., .., |_| 1.0),
            SensorFaultMode::FrozenLeft => region(frame, .., ..DEPTH_COLS / 2, |i| kept.depth[i]),
            SensorFaultMode::FrozenRight => region(frame, .., DEPTH_COLS / 2.., |i| kept.depth[i]),
            SensorFaultMode::FrozenTop => region(frame, ..DEPTH_ROWS / 2, .., |i| kept.depth[i]),
            SensorFaultMode::FrozenBottom => region(frame, DEPTH_ROWS / 2.., .., |i| kept.depth[i]),
            SensorFaultMode::StuckRows => {
                let first = (split_mix(draw ^ 1) as usize) % (DEPTH_ROWS - STUCK_ROWS);
                region(frame, first..first + STUCK_ROWS, .., |i| kept.depth[i]);
            }
            SensorFaultMode::StuckColumns => {
                let first = (split_mix(draw ^ 1) as usize) % (DEPTH_COLS - STUCK_COLUMNS);
                region(frame, .., first..first + STUCK_COLUMNS, |i| kept.depth[i]);
            }
            SensorFaultMode::Mirrored => frame.depth.chunks_exact_mut(DEPTH_COLS).for_each(<[f32]>::reverse),
            SensorFaultMode::Shifted => {
                for row in frame.depth.chunks_exact_mut(DEPTH_COLS) {
                    if left {
                        row.copy_within(SHIFT_COLUMNS.., 0);
                        let last = row[DEPTH_COLS - 1];
                        row[DEPTH_COLS - SHIFT_COLUMNS..].fill(last);
                    } else {
                        row.copy_within(..DEPTH_COLS - SHIFT_COLUMNS, SHIFT_COLUMNS);
                        let first = row[0];
                        row[..SHIFT_COLUMNS].fill(first);
                    }
                }
            }
            // The sensor looks elsewhere; its frames are as they should be.
            SensorFaultMode::Turned => {}
            SensorFaultMode::Delayed => {
                let slots = self.late.len() as u64;
                let taken = number.saturating_sub(slots - 1);
                *frame = self.late[(taken % slots) as usize].clone();
            }
            SensorFaultMode::FarPosition => header.position_ned_m = NedVector::new(1e30, 1e30, 1e30),
            SensorFaultMode::DisplacedPosition => {
                header.position_ned_m = header.position_ned_m + NedVector::new(DISPLACED_M, 0.0, 0.0);
            }
            SensorFaultMode::BadQuaternion => header.attitude.w *= 1.5,
            SensorFaultMode::FrozenPose => {
                header.position_ned_m = kept.header.position_ned_m;
                header.attitude = kept.header.attitude;
            }
            SensorFaultMode::FrozenStamp => header.stamp_ns = kept.header.stamp_ns,
            SensorFaultMode::EarlierStamp => header.stamp_ns = header.stamp_ns.saturating_sub(20 * STEP_NS),
        }
        frame.seal();
    }
}

/// Sets the pixels of some rows and columns from their index in the image.
fn region(
    frame: &mut DepthFrame,
    rows: impl RangeBounds<usize>,
    columns: impl RangeBounds<usize>,
    value: impl Fn(usize) -> f32,
) {
    for (pixel, depth) in frame.depth.iter_mut().enumerate() {
        if rows.contains(&(pixel / DEPTH_COLS)) && columns.contains(&(pixel % DEPTH_COLS)) {
            *depth = value(pixel);
        }
    }
}

const _: () = assert!((SHIFT_COLUMNS as f32 * PIXEL_PITCH_RAD - TURN_RAD).abs() < PIXEL_PITCH_RAD);

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(number: u64) -> Box<DepthFrame> {
        let mut frame = Box::new(DepthFrame::EMPTY);
        frame.header.stamp_ns = (number + 100) * STEP_NS;
        frame.header.sequence = number;
        for (i, depth) in frame.depth.iter_mut().enumerate() {
            *depth = 0.05 + 1e-6 * i as f32 + 1e-3 * number as f32;
        }
        frame.seal();
        frame
    }

    fn spoiled(fault: &str, frames: u64) -> Box<DepthFrame> {
        let mut sensor = FailingSensor::new(fault.parse().unwrap(), 7);
        let mut last = frame(0);
        for number in 0..frames {
            last = frame(number);
            sensor.spoil(number * STEP_NS, &mut last);
        }
        last
    }

    #[test]
    fn every_fault_is_named_as_it_is_parsed_and_seals_its_frame() {
        for mode in SensorFaultMode::ALL {
            let fault: SensorFault = mode.name().parse().unwrap();
            assert_eq!((fault.mode, fault.to_string().as_str()), (mode, mode.name()));
            let frame = spoiled(mode.name(), 9);
            assert_eq!(frame.header.checksum, frame.compute_checksum(), "{}", mode.name());
        }
        let fault: SensorFault = "frozen@2.5".parse().unwrap();
        assert_eq!(fault.onset, Onset::At(2.5));
        assert_eq!(fault.to_string(), "frozen@2.5");
        assert!("melted".parse::<SensorFault>().unwrap_err().contains("frozen"));
        assert!("frozen@soon".parse::<SensorFault>().unwrap_err().contains("seconds"));
    }

    #[test]
    fn before_its_onset_a_fault_changes_nothing() {
        assert_eq!(spoiled("zeros@0.45", 9), frame(8));
        assert_ne!(spoiled("zeros@0.4", 9), frame(8));
    }

    #[test]
    fn pictures_stay_or_move_as_their_names_say() {
        assert_eq!(spoiled("frozen@0.1", 9).depth, frame(2).depth);
        let noisy = spoiled("frozen-noisy@0.1", 9);
        assert!(noisy.depth != frame(2).depth);
        let apart = |(a, b): (&f32, &f32)| (a - b).abs() * DEPTH_FULL_SCALE_M;
        assert!(noisy.depth.iter().zip(&frame(2).depth).all(|p| apart(p) < 0.08));
        let dead = spoiled("dead-top", 1);
        assert!(dead.depth[..DEPTH_PIXELS / 2].iter().all(|d| *d == 1.0));
        assert_eq!(dead.depth[DEPTH_PIXELS / 2..], frame(0).depth[DEPTH_PIXELS / 2..]);
        let left = spoiled("frozen-left@0.1", 9);
        assert_eq!(left.depth[3], frame(2).depth[3]);
        assert_eq!(left.depth[200], frame(8).depth[200]);
        assert_eq!(spoiled("mirrored", 1).depth[0], frame(0).depth[DEPTH_COLS - 1]);
        let shifted = spoiled("shifted", 1);
        let there = [128 - SHIFT_COLUMNS, 128 + SHIFT_COLUMNS].map(|c| frame(0).depth[c]);
        assert!(there.contains(&shifted.depth[128]));
        let delayed = spoiled("delayed", 9);
        assert_eq!(delayed.header.stamp_ns, frame(2).header.stamp_ns);
    }

    #[test]
    fn a_turned_sensor_looks_five_degrees_aside() {
        let sensor = FailingSensor::new("turned".parse().unwrap(), 7);
        let level = Attitude::from_euler_rad(0.1, -0.2, 0.3);
        let off_rad = sensor.attitude(0, level);
        let nose = |a: Attitude| a.to_ned(vigil_types::FrdVector::new(1.0, 0.0, 0.0));
        let (a, b) = (nose(level), nose(off_rad));
        let angle = libm::acosf(a.x * b.x + a.y * b.y + a.z * b.z);
        assert!((angle - TURN_RAD).abs() < 1e-3, "{angle}");
        assert!(off_rad.is_valid());
        let down = |a: Attitude| a.to_ned(vigil_types::FrdVector::new(0.0, 0.0, 1.0)).z;
        assert!((down(level) - down(off_rad)).abs() < 1e-5, "about its own axis");
    }
}
