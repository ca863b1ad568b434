//! Judges, before any pilot sees them, whether the depth frames can be what the sensor of this vehicle sees here and now.
//!
//! A valid frame may still be wrong: dead, frozen, mirrored, turned on its mount, of another place. The check compares each
//! frame with what must be seen (the ground), its pose with the telemetry, and its picture with earlier ones and the way flown
//! between them: every surface of one picture, moved as the vehicle moved, must be found in the other. docs/sensor-faults.md
//! explains what is found, and how fast. No allocation, no panic, no clock.

mod blindness;
mod comparison;
mod drift;
mod evidence;
mod motion;
mod odometry;
mod parallax;
mod picture;
mod poses;
mod regions;
mod shadow;
mod silence;

pub use self::poses::has_jumped;

use self::blindness::{BLIND_FRAMES, SEEING_FRAMES};
use self::comparison::Kept;
use self::evidence::{Evidence, Raised};
use self::motion::{Pose, turn_rad};
use self::odometry::Odometry;
use self::parallax::Parallax;
use self::picture::{CellCounts, Directions, Picture, Sides};
use self::poses::PoseCheck;
use self::regions::Regions;
use self::shadow::Shadow;
use self::silence::SilentSide;
use crate::TakeOff;
use vigil_types::{Attitude, DepthFrame, Landed, Nanos, NedVector, Reason, Reasons, VehicleMode, VehicleTelemetry};

/// Lower than this the vehicle may stand or take off, and everything is near.
const LOW_M: f32 = 0.5;
/// Pictures farther apart than this, in time or by a turn, are not a step apart: a vehicle that is carried may turn at any rate.
const ONE_STEP_NS: Nanos = 120_000_000;
const ONE_STEP_RAD: f32 = 0.07;
/// After so long without a picture those from before are not compared with: the estimate has drifted meanwhile, which over a short way looks
/// like a sensor that is turned on its mount.
const MOST_GAP_NS: Nanos = 1_000_000_000;

/// The check; by default one that has seen nothing. A large value without pointers; no allocation.
#[derive(Debug, Clone, Default)]
pub struct PlausibilityCheck {
    directions: Directions,
    picture: Picture,
    before: Picture,
    /// Where the picture before was taken; `None` if there was none.
    pose_before: Option<Pose>,
    /// What the last frame's cells show.
    counts: CellCounts,
    faults: Reasons,
    /// Where the ground is, metres down from the local origin.
    ground_down_m: f32,
    estimate_disagrees: bool,
    /// It did not, some time in this flight.
    estimate_errs: bool,
    blindness: Fault,
    silent: SilentSide,
    shadow: Shadow,
    parallax: Parallax,
    regions: Regions,
    /// Stamp and attitude of the picture before.
    taken_before: Option<(Nanos, Attitude)>,
    poses: PoseCheck,
    take_off: TakeOff,
    kept: Kept,
    odometry: Odometry,
    evidence: Evidence,
    raised: Option<Raised>,
    raises: u8,
    fit_steps: u8,
    fits: u8,
    step: usize,
}

/// What [`PlausibilityCheck::smooth_share`] would be of this frame: for those who look at a sensor before it flies. A frame of any header.
pub fn smooth_share_of(frame: &DepthFrame) -> Option<f32> {
    counts_of(frame).smooth_share()
}

/// Whether two such frames are a blind sensor's whatever else they show: of zeros in many places, or of ranges of anywhere.
pub fn lacks_ranges(frame: &DepthFrame) -> bool {
    blindness::lacks_ranges(counts_of(frame))
}

/// What is counted in a frame of any header.
fn counts_of(frame: &DepthFrame) -> CellCounts {
    Picture::default().take(frame, &mut Sides::default())
}

impl PlausibilityCheck {
    /// Of the cells of the last frame checked in which something is seen, the share that shows one surface (4 × 4 pixels whose ranges differ
    /// by no more than 0.16 m and a fifth of the range); 0 where ranges go to and fro all over a part of 16 × 16 pixels, as a patch's do; `None`
    /// where next to nothing is seen. Moved regions are rough, too: each of them shows its surfaces, but nothing goes on from one to the next.
    pub fn smooth_share(&self) -> Option<f32> {
        match self.regions.restored() {
            Some(_) => Some(0.0),
            None => self.counts.smooth_share(),
        }
    }

    /// The last frame checked with the regions that were moved back where they were; `None` where none are. The check then goes by it.
    pub fn restored(&self) -> Option<&DepthFrame> {
        self.regions.restored()
    }

    /// What the reported velocity is more than the pictures say, NED, metres per second; at most 0.4. Zero for a vehicle whose
    /// estimate always agreed with itself, and while it obeys no setpoints.
    pub fn velocity_error_m_s(&self) -> NedVector {
        self.odometry.error_m_s()
    }

    /// The vehicle's estimate has disagreed with itself in this flight.
    pub fn estimate_errs(&self) -> bool {
        self.estimate_errs
    }

    /// What is implausible about the last frame checked.
    pub fn sensor_faults(&self, telemetry: &VehicleTelemetry) -> Reasons {
        // Only pictures of a vehicle that obeys setpoints could end it: no other is held for it.
        let beneath_ground = self.shadow.is_raised && obeys_setpoints(telemetry);
        self.faults.with_if(beneath_ground, Reason::BeneathGround)
    }

    /// Where the ground is, metres down from the local origin, from now on: near it everything is near, and nothing may move. And whether
    /// the vehicle's estimate agrees with itself: one whose velocity is not the rate at which its position changes drifts by as much as a
    /// sensor that sits wrong seems to.
    pub fn note_estimate(&mut self, ground_down_m: f32, agrees_with_itself: bool) {
        (self.ground_down_m, self.estimate_disagrees) = (ground_down_m, !agrees_with_itself);
        self.estimate_errs |= !agrees_with_itself;
    }

    /// Checks a valid frame that is newer than the last. Telemetry that is missing or not finite is checked by nobody here: only
    /// what needs none of it is then looked at.
    pub fn check(&mut self, frame: &DepthFrame, telemetry: &VehicleTelemetry) -> Reasons {
        self.step = self.step.wrapping_add(1);
        core::mem::swap(&mut self.picture, &mut self.before);
        self.counts = self.picture.take(frame, &mut self.regions.sides);
        self.note_regions(frame);
        let armed = telemetry.heartbeat.is_some_and(|h| h.armed);
        let known = telemetry.kinematics.zip(telemetry.attitude);
        let known = known.filter(|_| telemetry.is_finite());
        let height_m = known.map(|(kinematics, _)| self.ground_down_m - kinematics.position_ned_m.z);

        let pose = Pose {
            position_ned_m: frame.header.position_ned_m,
            attitude: frame.header.attitude,
        };
        let sees_nothing =
            blindness::sees_nothing(&self.picture, self.counts, &self.directions, pose.attitude, height_m);
        let is_blind = self.blindness.note(sees_nothing, BLIND_FRAMES, SEEING_FRAMES);
        let stamp_ns = frame.header.stamp_ns;
        let before = self.taken_before.replace((stamp_ns, pose.attitude));
        let one_step = before.is_some_and(|(before_ns, attitude)| {
            stamp_ns.saturating_sub(before_ns) <= ONE_STEP_NS && turn_rad(attitude, pose.attitude) <= ONE_STEP_RAD
        });
        if before.is_some_and(|(before_ns, _)| stamp_ns.saturating_sub(before_ns) > MOST_GAP_NS) {
            self.forget_pictures();
        }
        self.silent.note(&self.picture, one_step.then_some(&self.before));
        let blind = is_blind || self.silent.fault.is_raised;
        let in_flight = armed && height_m.is_some_and(|height_m| height_m > LOW_M);
        if let Some(known) = known {
            self.poses.note(&pose, stamp_ns, known, in_flight);
            self.odometry.advance(stamp_ns, known.0);
        }
        let takes_off = known.is_some_and(|(kinematics, _)| self.take_off.goes_on(telemetry, &kinematics))
            && !obeys_setpoints(telemetry)
            || stands_or_takes_off(telemetry);
        let guided = in_flight && obeys_setpoints(telemetry) && !blind && !self.poses.fault.is_raised;
        self.note_ranges(frame, &pose, height_m.filter(|_| guided));
        if !armed {
            // The flight is over.
            self.forget_motion();
            (self.raised, self.raises) = (None, 0);
            self.estimate_errs = false;
            (self.shadow, self.parallax) = (Shadow::default(), Parallax::default());
            self.regions.forget();
        } else if !in_flight || takes_off || blind || self.poses.fault.is_raised {
            self.forget_pictures();
        } else if self.raised.is_some() {
            self.look_for_a_fit(&pose, stamp_ns);
        } else {
            let comparable = one_step && self.pose_before.is_some() && self.restored().is_none();
            self.compare(&pose, stamp_ns, comparable);
        }
        self.note_velocity(pose.attitude, guided);
        self.pose_before = in_flight.then_some(pose);
        self.faults = Reasons::NONE
            .with_if(blind, Reason::BlindSensor)
            .with_if(self.poses.fault.is_raised, Reason::ImplausiblePose)
            .with_if(self.parallax.is_raised, Reason::InconsistentPicture)
            .union(self.raised.map_or(Reasons::NONE, |raised| Reasons::of(raised.reason)));
        self.sensor_faults(telemetry)
    }

    /// Looks whether regions were moved. Once they are known to be, the pictures before are none to compare with; what ranges raised stays.
    fn note_regions(&mut self, frame: &DepthFrame) {
        let height_m = self.ground_down_m - frame.header.position_ned_m.z;
        if height_m <= LOW_M {
            self.regions.skip();
        } else if self.regions.note(frame, &self.directions, height_m) {
            self.forget_motion();
            self.raised = self.raised.filter(|raised| raised.stays);
            self.shadow.skip();
            self.parallax.skip();
        }
        if let Some(counts) = self.regions.take_restored(&mut self.picture) {
            self.counts = counts;
        }
    }

    /// Takes the frame to the checks of its ranges, where the height of a vehicle that flies by it is known.
    fn note_ranges(&mut self, frame: &DepthFrame, pose: &Pose, height_m: Option<f32>) {
        let Some(height_m) = height_m else {
            self.shadow.skip();
            self.parallax.skip();
            return;
        };
        self.shadow
            .note(&self.picture, &self.directions, pose.attitude, height_m);
        let frame = self.regions.restored().unwrap_or(frame);
        self.parallax.note(frame, &self.directions, pose);
    }

    /// What the velocity of a vehicle that flies by the pictures is off by, where its estimate errs.
    fn note_velocity(&mut self, attitude: Attitude, guided: bool) {
        if guided && self.estimate_errs && self.raised.is_none() {
            self.odometry
                .compare(&self.directions, &self.picture, attitude, self.kept.all(), self.step);
        } else {
            self.odometry.forget();
        }
    }

    /// What is remembered of pictures is of no use any more; what was raised stays.
    fn forget_pictures(&mut self) {
        if self.raised.is_none() {
            self.forget_motion();
        }
        self.evidence.same_frames = 0;
    }

    fn forget_motion(&mut self) {
        self.kept.forget();
        self.evidence = Evidence::default();
        self.fit_steps = 0;
        self.fits = 0;
    }
}

/// While a vehicle stands, or takes off by itself, nobody flies by what is seen; and its estimate moves then by more than it does
/// ([`TakeOff`]).
fn stands_or_takes_off(telemetry: &VehicleTelemetry) -> bool {
    telemetry.landed == Landed::OnGround || telemetry.heartbeat.is_some_and(|h| h.mode == VehicleMode::Takeoff)
}

/// Only who steers the vehicle by what is seen can go astray: a mission over a slope is not held.
fn obeys_setpoints(telemetry: &VehicleTelemetry) -> bool {
    telemetry.heartbeat.is_some_and(|h| h.mode == VehicleMode::External)
}

/// Counts steps in a row.
fn count(steps: &mut u8, holds: bool) {
    *steps = if holds { steps.saturating_add(1) } else { 0 };
}

/// What so many bad steps in a row raise, and so many good ones end.
#[derive(Debug, Clone, Default, PartialEq)]
struct Fault {
    bad: u8,
    good: u8,
    is_raised: bool,
}

impl Fault {
    fn note(&mut self, is_bad: bool, raise_steps: u8, end_steps: u8) -> bool {
        count(&mut self.bad, is_bad);
        count(&mut self.good, !is_bad);
        self.is_raised = if self.is_raised {
            self.good < end_steps
        } else {
            self.bad >= raise_steps
        };
        self.is_raised
    }
}

#[cfg(test)]
mod tests;
