//! Judges, before any pilot sees them, whether the depth frames can be what the sensor of this vehicle sees here and now.
//!
//! A valid frame may still be wrong: dead, frozen, mirrored, turned on its mount, of another place. The check compares each
//! frame with what must be seen (the ground), its pose with the telemetry, and its picture with earlier ones and the way flown
//! between them: every surface of one picture, moved as the vehicle moved, must be found in the other. docs/sensor-faults.md
//! explains what is found, and how fast. No allocation, no panic, no clock.

mod drift;
mod motion;
mod odometry;
mod parallax;
mod picture;
mod regions;
mod shadow;
mod silence;

use self::drift::{DOWN_M, Errors, MountReadings, Pair, TURN, WIDENING, allowed_drift_m};
use self::motion::{MOST_COST, Map, Pose, cost, look, look_widened, samples};
use self::odometry::Odometry;
use self::parallax::Parallax;
use self::picture::{COLS, CellCounts, Directions, Picture, ROWS, Seen, Sides};
use self::regions::Regions;
use self::shadow::Shadow;
use self::silence::SilentSide;
use crate::TakeOff;
use vigil_types::{
    Attitude, DepthFrame, FrdVector, Kinematics, Landed, Nanos, NedVector, Reason, Reasons, VehicleMode,
    VehicleTelemetry,
};

/// The ground must be seen where its range is below this, metres; and it is at the height of home.
const GROUND_M: f32 = 15.0;
/// Lower than this the vehicle may stand or take off, and everything is near.
const LOW_M: f32 = 0.5;
/// Higher than this the ground may be too far to be seen at all.
const HIGH_M: f32 = 0.4 * GROUND_M;
/// Columns of cells that are checked together: 7.5°.
const STRIP: usize = 4;
const STRIPS: usize = COLS / STRIP;
/// Strips without a ground that make a sensor blind, and cells of zeros, with many of them, and of ranges of anywhere that do.
const BLIND_STRIPS: usize = 2;
const BLIND_ZEROS: usize = ROWS * COLS / 50;
const BLIND_HOLES: usize = ROWS * COLS / 3;
const BLIND_WILD: usize = ROWS * COLS / 4;
/// Cells of a strip that must show the ground before its absence says anything.
const LEAST_GROUND: u16 = 8;
/// Frames in a row that make a sensor blind, and that make it see again.
const BLIND_FRAMES: u8 = 2;
const SEEING_FRAMES: u8 = 3;
/// Pictures farther apart than this, in time or by a turn, are not a step apart: a vehicle that is carried may turn at any rate.
const ONE_STEP_NS: Nanos = 120_000_000;
const ONE_STEP_RAD: f32 = 0.07;

/// After so long without a picture those from before are not compared with: the estimate has drifted meanwhile, which over a short way looks
/// like a sensor that is turned on its mount.
const MOST_GAP_NS: Nanos = 1_000_000_000;

/// How far the header's position and attitude may be from the telemetry's, and by how much the difference may change in 10 frames.
const POSE_M: f32 = 2.0;
const POSE_COS_HALF: f32 = 0.991_445; // 15°
const POSE_DRIFT_M: f32 = 0.4;
const POSE_FRAMES: usize = 10;
const BAD_POSES: u8 = 2;
/// A position this far from where the velocity led since the last one has jumped; the second allows for each second between them.
const JUMP_M: f32 = 1.0;
const JUMP_M_S: f32 = 10.0;
/// Telemetry is extrapolated to the frame's stamp by no more than this, seconds.
const MOST_EXTRAPOLATION_S: f32 = 0.3;

/// Earlier pictures that are kept.
const ANCHORS: usize = 8;
/// A further one is kept when the vehicle has come so far since the last; a turn of a radian counts as 3 m.
const ANCHOR_EVERY_M: f32 = 0.2;
const METRES_PER_RADIAN: f32 = 3.0;
/// Where the vehicle hardly moves, the newest kept picture is replaced after this time, and older ones are not compared with.
const ANCHOR_FRESH_NS: Nanos = 1_000_000_000;
const ANCHOR_USEFUL_NS: Nanos = 6_000_000_000;
/// One that is to show the same near by must be younger: what an estimate drifts in a longer time is not explained by a shift.
const NEAR_USEFUL_NS: Nanos = 1_000_000_000;
/// How far back a picture is compared with: near to find what is frozen soon, far to tell directions.
const NEAR_M: f32 = 0.35;
const FAR_M: f32 = 1.2;
const LEAST_M: f32 = 0.15;
/// A mirrored sensor shows over a way that leads this far aside; over less the errors of estimated roll and position decide.
const LEAST_ASIDE_M: f32 = 0.08;
/// A way that is long enough, and flown fast enough, to tell 5° from the error of the estimated position.
const DIRECTED_M: f32 = 0.7;
const DIRECTED_M_S: f32 = 0.5;
/// A way shorter than so many times what the estimate may have drifted meanwhile says nothing: a vehicle that hovers for seconds on a real
/// one seems to have come half a metre, and a picture that did not move must not be taken for one that did.
const DRIFTS: f32 = 1.5;

/// What is found counts for about ten frames, and for about forty where directions are told.
const KEEP: f32 = 0.9;
const KEEP_LONG: f32 = 0.975;
/// Parts of the view of 4 × 4 cells.
const PART: usize = 4;
const PART_COLS: usize = COLS / PART;
const PART_ROWS: usize = ROWS / PART;
const PARTS: usize = PART_ROWS * PART_COLS;

/// Cells that did not change by a bit although they should have, of a step's samples, and how many steps in a row.
const SAME_CELLS: u16 = 10;
const SAME_FRAMES: u8 = 2;
/// A cell should have changed if the motion asks for more than this, metres.
const CHANGE_M: f32 = 0.03;
/// Cost of the motion over that of standing still, for the view (and as a share of the motion's) and for a part of it, that
/// tells frozen; and how many parts.
const FROZEN_VIEW: f32 = 120.0;
const FROZEN_FIT: f32 = 0.8;
const FROZEN_PART: f32 = 40.0;
const FROZEN_PARTS: usize = 6;
/// So many parts tell it even where the view as a whole moved: more than something shows that moves beside the vehicle.
const FROZEN_PARTS_OF_A_MOVING_VIEW: usize = 28;
/// Something nearer than this may move beside the vehicle and fill the view: whether it fits, stays, is there or is gone tells nothing, metres.
const MAY_MOVE_M: f32 = 2.5;
/// Mean cost of the motion that tells a picture of another place, and samples that it needs.
const MISFIT: f32 = 2.0;
const MISFIT_SAMPLES: f32 = 300.0;
/// Regions that were moved are known to a few decimetres only: this is how many times as much their motion may cost.
const MISFIT_RESTORED: f32 = 2.0;
/// It does not fit beside something that moves either: this is the mean cost, and these are the samples, without those columns of parts,
/// 45° wide, that fit worst.
const MISFIT_BESIDE: f32 = 1.4;
const MISFIT_BESIDE_SAMPLES: f32 = 150.0;
const MOVER_COLS: usize = 6;
/// Cost of the motion, drift taken from it, over that of a mirrored sensor's, and as a share of it too.
const MIRRORED: f32 = 150.0;
const MIRRORED_FIT: f32 = 0.5;
/// And the mean cost of the motion near by: a mirrored sensor's picture does not fit there either, and what tilts by a third of a degree while the
/// vehicle turns does.
const MIRRORED_NEAR: f32 = 0.05;
/// Points of a part that were seen through, and how many such parts make a picture from which something vanished: more than something
/// near covers that goes away by itself.
const VANISHED: f32 = 6.0;
const VANISHED_PARTS: usize = 16;
/// Points that were seen through above one row of the view, where next to nothing was found: that side of the view is dead, and
/// showed too little when it died for [`SilentSide`] to tell.
const VANISHED_ABOVE: f32 = 10.0;
const FOUND_ABOVE: f32 = 0.1;

/// A picture fits an earlier one if so many samples say something, such a share of them agrees at such a mean cost, and standing
/// still would cost so much more.
const FIT_SAMPLES: u16 = 80;
const FIT_SHARE: f32 = 0.88;
const FIT_MEAN_COST: f32 = 1.2;
const FIT_COST: f32 = 150.0;
/// So many of the kept pictures have to fit.
const FITS: u8 = 2;
/// Raised so often in a flight, it stays until the end of the flight.
const LAST_RAISE: u8 = 2;

/// An earlier picture, and where it was taken.
#[derive(Debug, Clone)]
struct Anchor {
    picture: Picture,
    pose: Pose,
    stamp_ns: Nanos,
    /// The reported velocity summed up until then.
    path_ned_m: NedVector,
}

/// Evidence on the picture's motion, fading with time.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Evidence {
    /// Samples, and what the motion cost them, by columns of parts.
    samples: [f32; PART_COLS],
    costs: [f32; PART_COLS],
    /// What the motion cost all samples, and that over what standing still would have.
    cost: f32,
    frozen: f32,
    frozen_parts: [f32; PARTS],
    cost_parts: [f32; PARTS],
    /// Points found and seen through.
    found_parts: [f32; PARTS],
    lost_parts: [f32; PARTS],
    /// The same by row, for longer.
    found_rows: [f32; PART_ROWS],
    lost_rows: [f32; PART_ROWS],
    /// Cost of the motion over that of a mirrored sensor, and what drift may explain of it.
    mirrored: f32,
    drift: Errors,
    /// Whether the sensor is turned on its mount, or of another width; this does not fade.
    mount: MountReadings,
    wrong_mount: bool,
    /// What the motion cost where these are told.
    far_cost: f32,
}

impl Evidence {
    const NONE: Self = Self {
        samples: [0.0; PART_COLS],
        costs: [0.0; PART_COLS],
        cost: 0.0,
        frozen: 0.0,
        frozen_parts: [0.0; PARTS],
        cost_parts: [0.0; PARTS],
        found_parts: [0.0; PARTS],
        lost_parts: [0.0; PARTS],
        found_rows: [0.0; PART_ROWS],
        lost_rows: [0.0; PART_ROWS],
        mirrored: 0.0,
        drift: Errors::NONE,
        mount: MountReadings::NONE,
        wrong_mount: false,
        far_cost: 0.0,
    };

    fn fade(&mut self) {
        self.frozen *= KEEP;
        self.cost *= KEEP;
        for value in self.samples.iter_mut().chain(&mut self.costs) {
            *value *= KEEP;
        }
        let parts = self.frozen_parts.iter_mut().chain(&mut self.cost_parts);
        for value in parts.chain(&mut self.found_parts).chain(&mut self.lost_parts) {
            *value *= KEEP;
        }
        for value in self.found_rows.iter_mut().chain(&mut self.lost_rows) {
            *value *= KEEP_LONG;
        }
        self.mirrored *= KEEP_LONG;
        self.far_cost *= KEEP_LONG;
        self.drift.fade(KEEP_LONG);
    }

    /// Whether the motion costs at least so much near by, in the mean.
    fn misfits_by(&self, mean: f32) -> bool {
        self.costs.iter().sum::<f32>() >= mean * self.samples.iter().sum::<f32>()
    }

    /// Whether the motion does not explain the picture, not even beside something that moves by itself, where it may cost so many `times` what
    /// it may in a picture as it was taken.
    fn misfits(&self, times: f32) -> bool {
        let samples: f32 = self.samples.iter().sum();
        let cost: f32 = self.costs.iter().sum();
        let by_columns = || self.samples.windows(MOVER_COLS).zip(self.costs.windows(MOVER_COLS));
        samples >= MISFIT_SAMPLES
            && cost > times * MISFIT * samples
            && by_columns().all(|(samples_there, costs_there)| {
                let beside = samples - samples_there.iter().sum::<f32>();
                let cost_beside = cost - costs_there.iter().sum::<f32>();
                beside >= MISFIT_BESIDE_SAMPLES && cost_beside > times * MISFIT_BESIDE * beside
            })
    }
}

/// What was raised of the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Raised {
    reason: Reason,
    /// Until the end of the flight.
    stays: bool,
}

/// The check. A large value without pointers; no allocation.
#[derive(Debug, Clone)]
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
    estimate_agrees: bool,
    /// It did not, some time in this flight.
    estimate_errs: bool,
    blind_frames: u8,
    seeing_frames: u8,
    blind: bool,
    silent: SilentSide,
    shadow: Shadow,
    parallax: Parallax,
    regions: Regions,
    /// Stamp and attitude of the picture before.
    taken_before: Option<(Nanos, Attitude)>,
    pose_errors: [NedVector; POSE_FRAMES],
    poses: usize,
    bad_poses: u8,
    good_poses: u8,
    bad_pose: bool,
    /// What the vehicle told when the frame before was checked.
    kinematics_before: Option<Kinematics>,
    take_off: TakeOff,
    anchors: [Anchor; ANCHORS],
    anchors_used: usize,
    newest: usize,
    odometry: Odometry,
    evidence: Evidence,
    same_frames: u8,
    raised: Option<Raised>,
    raises: u8,
    fit_steps: u8,
    fits: u8,
    step: usize,
}

/// Whether the vehicle is told to be where it cannot have come to since it told its position before: more than 1 m, and 10 m for each
/// second between the two, from where its velocity led.
pub fn has_jumped(before: &Kinematics, now: &Kinematics) -> bool {
    let passed_s = now.at_ns.saturating_sub(before.at_ns) as f32 * 1e-9;
    let led_to_ned_m = before.position_ned_m + before.velocity_ned_m_s * passed_s;
    (now.position_ned_m - led_to_ned_m).norm() > JUMP_M + JUMP_M_S * passed_s
}

impl Default for PlausibilityCheck {
    fn default() -> Self {
        Self::new()
    }
}

/// What [`PlausibilityCheck::smooth_share`] would be of this frame: for those who look at a sensor before it flies. A frame of any header.
pub fn smooth_share_of(frame: &DepthFrame) -> Option<f32> {
    let mut picture = Picture::EMPTY;
    picture.take(frame, &mut Sides::default()).smooth_share()
}

impl PlausibilityCheck {
    /// A check that has seen nothing.
    pub fn new() -> Self {
        const NOWHERE: Pose = Pose {
            position_ned_m: NedVector::ZERO,
            attitude: Attitude::LEVEL_NORTH,
        };
        const NO_ANCHOR: Anchor = Anchor {
            picture: Picture::EMPTY,
            pose: NOWHERE,
            stamp_ns: 0,
            path_ned_m: NedVector::ZERO,
        };
        Self {
            directions: Directions::new(),
            picture: Picture::EMPTY,
            before: Picture::EMPTY,
            pose_before: None,
            counts: CellCounts::default(),
            faults: Reasons::NONE,
            ground_down_m: 0.0,
            estimate_agrees: true,
            estimate_errs: false,
            blind_frames: 0,
            seeing_frames: 0,
            blind: false,
            silent: SilentSide::default(),
            shadow: Shadow::default(),
            parallax: Parallax::default(),
            regions: Regions::default(),
            taken_before: None,
            pose_errors: [NedVector::ZERO; POSE_FRAMES],
            poses: 0,
            bad_poses: 0,
            good_poses: 0,
            bad_pose: false,
            kinematics_before: None,
            take_off: TakeOff::default(),
            anchors: [NO_ANCHOR; ANCHORS],
            anchors_used: 0,
            newest: 0,
            odometry: Odometry::default(),
            evidence: Evidence::NONE,
            same_frames: 0,
            raised: None,
            raises: 0,
            fit_steps: 0,
            fits: 0,
            step: 0,
        }
    }

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
    pub fn sensor_faults(&self) -> Reasons {
        self.faults
    }

    /// Where the ground is, metres down from the local origin, from now on: near it everything is near, and nothing may move. And whether
    /// the vehicle's estimate agrees with itself: one whose velocity is not the rate at which its position changes drifts by as much as a
    /// sensor that sits wrong seems to.
    pub fn note_estimate(&mut self, ground_down_m: f32, agrees_with_itself: bool) {
        (self.ground_down_m, self.estimate_agrees) = (ground_down_m, agrees_with_itself);
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
        let known = if telemetry.is_finite() {
            telemetry.kinematics.zip(telemetry.attitude)
        } else {
            None
        };
        let height_m = known.map(|(kinematics, _)| self.ground_down_m - kinematics.position_ned_m.z);

        self.note_blindness(frame.header.attitude, height_m);
        let pose = Pose {
            position_ned_m: frame.header.position_ned_m,
            attitude: frame.header.attitude,
        };
        let stamp_ns = frame.header.stamp_ns;
        let before = self.taken_before.replace((stamp_ns, pose.attitude));
        let one_step = before.is_some_and(|(before_ns, attitude)| {
            stamp_ns.saturating_sub(before_ns) <= ONE_STEP_NS && turn_rad(attitude, pose.attitude) <= ONE_STEP_RAD
        });
        if before.is_some_and(|(before_ns, _)| stamp_ns.saturating_sub(before_ns) > MOST_GAP_NS) {
            self.forget_pictures();
        }
        self.silent.note(&self.picture, one_step.then_some(&self.before));
        let blind = self.blind || self.silent.is_dead();
        if let Some((kinematics, attitude)) = known {
            let lead_s = |at_ns: Nanos| {
                let lead_ns = stamp_ns as i64 - at_ns as i64;
                (lead_ns as f32 * 1e-9).clamp(-MOST_EXTRAPOLATION_S, MOST_EXTRAPOLATION_S)
            };
            let position = kinematics.position_ned_m + kinematics.velocity_ned_m_s * lead_s(kinematics.at_ns);
            let turned = turned_by(attitude.attitude, attitude.rates_frd_rad_s * lead_s(attitude.at_ns));
            self.note_pose(&pose, position, turned);
        }
        let in_flight = armed && height_m.is_some_and(|height_m| height_m > LOW_M);
        if let Some((kinematics, _)) = known {
            self.odometry.advance(stamp_ns, kinematics);
            let before = self.kinematics_before.replace(kinematics);
            if in_flight && before.is_some_and(|before| has_jumped(&before, &kinematics)) {
                // Whatever was seen lies elsewhere now, and nobody knows which of the two positions is right.
                (self.bad_pose, self.good_poses) = (true, 0);
            }
        }
        let takes_off = known.is_some_and(|(kinematics, _)| self.take_off.goes_on(telemetry, &kinematics))
            && !obeys_setpoints(telemetry)
            || stands_or_takes_off(telemetry);
        let guided = in_flight && obeys_setpoints(telemetry) && !blind && !self.bad_pose;
        self.note_ranges(frame, &pose, height_m.filter(|_| guided));
        if !armed {
            // The flight is over.
            self.forget_motion();
            (self.raised, self.raises) = (None, 0);
            self.estimate_errs = false;
            (self.shadow, self.parallax) = (Shadow::default(), Parallax::default());
            self.regions.forget();
        } else if !in_flight || takes_off || blind || self.bad_pose {
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
            .with_if(self.bad_pose, Reason::ImplausiblePose)
            .with_if(self.shadow.is_raised(), Reason::BeneathGround)
            .with_if(self.parallax.is_raised(), Reason::InconsistentPicture)
            .union(self.raised.map_or(Reasons::NONE, |raised| Reasons::of(raised.reason)));
        self.faults
    }

    /// Looks whether regions were moved. From when on they are known to be, the pictures before are none to compare with.
    fn note_regions(&mut self, frame: &DepthFrame) {
        let height_m = self.ground_down_m - frame.header.position_ned_m.z;
        if height_m > LOW_M && self.regions.note(frame, &self.directions, height_m) {
            self.forget_motion();
            self.raised = self.raised.filter(|raised| raised.stays);
            (self.shadow, self.parallax) = (Shadow::default(), Parallax::default());
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
            let kept = self.anchors.get(..self.anchors_used).unwrap_or_default();
            self.odometry
                .compare(&self.directions, &self.picture, attitude, kept, self.step);
        } else {
            self.odometry.forget();
        }
    }

    /// What is remembered of pictures is of no use any more; what was raised stays.
    fn forget_pictures(&mut self) {
        if self.raised.is_none() {
            self.forget_motion();
        }
        self.same_frames = 0;
    }

    fn forget_motion(&mut self) {
        self.anchors_used = 0;
        self.evidence = Evidence::NONE;
        self.same_frames = 0;
        self.fit_steps = 0;
        self.fits = 0;
    }

    /// Zeros, ranges of anywhere, no return at all, or strips of the view without the ground.
    fn note_blindness(&mut self, attitude: Attitude, height_m: Option<f32>) {
        let down = attitude.to_frd(NedVector::new(0.0, 0.0, 1.0));
        let low = height_m.is_none_or(|height_m| height_m < HIGH_M);
        let ground_m = height_m.filter(|height_m| (LOW_M..HIGH_M).contains(height_m));
        let mut returns = false;
        let (mut expected, mut missing) = ([0_u16; STRIPS], [0_u16; STRIPS]);
        for (row, cells) in self.picture.rows().iter().enumerate() {
            let strips = cells
                .as_chunks::<STRIP>()
                .0
                .iter()
                .zip(expected.iter_mut().zip(&mut missing));
            for (strip, (cells, (expected, missing))) in strips.enumerate() {
                returns |= cells.iter().any(|inverse| *inverse != 0.0);
                let Some(ground_m) = ground_m else { continue };
                let falls = self.directions.falls(down, row, strip * STRIP + STRIP / 2);
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
        let CellCounts { zeros, holes, wild, .. } = self.counts;
        let no_ranges = zeros >= BLIND_ZEROS || holes >= BLIND_HOLES || wild >= BLIND_WILD;
        let blind = no_ranges || (low && !returns) || dead >= BLIND_STRIPS;
        count(&mut self.blind_frames, blind);
        count(&mut self.seeing_frames, !blind);
        self.blind = if self.blind {
            self.seeing_frames < SEEING_FRAMES
        } else {
            self.blind_frames >= BLIND_FRAMES
        };
    }

    /// The header's pose against the telemetry's at the same time.
    fn note_pose(&mut self, pose: &Pose, position_ned_m: NedVector, attitude: Attitude) {
        let error = pose.position_ned_m - position_ned_m;
        let slot = self.poses % POSE_FRAMES;
        let drift_m = match self.pose_errors.get_mut(slot) {
            Some(earlier) => {
                let drift_m = (error - core::mem::replace(earlier, error)).norm();
                if self.poses < POSE_FRAMES { 0.0 } else { drift_m }
            }
            None => 0.0,
        };
        // Counts on from 10 to 19 and back to 10, so that it never wraps.
        self.poses = if self.poses + 1 == 2 * POSE_FRAMES {
            POSE_FRAMES
        } else {
            self.poses + 1
        };
        let (a, b) = (pose.attitude, attitude);
        let alike = a.w * b.w + a.x * b.x + a.y * b.y + a.z * b.z;
        // Written so that NaN is bad.
        let good = error.norm() <= POSE_M && drift_m <= POSE_DRIFT_M && alike.abs() >= POSE_COS_HALF;
        count(&mut self.bad_poses, !good);
        count(&mut self.good_poses, good);
        self.bad_pose = if self.bad_pose {
            usize::from(self.good_poses) < POSE_FRAMES
        } else {
            self.bad_poses >= BAD_POSES
        };
    }

    /// Compares the picture with the one before (`comparable`: that is a step older, and this one has no regions moved back) and with two that were
    /// kept; raises what that tells, or keeps the picture.
    fn compare(&mut self, pose: &Pose, stamp_ns: Nanos, comparable: bool) {
        let same = self
            .pose_before
            .map_or(0, |before| self.cells_that_stayed(&Map::between(pose, &before)));
        count(&mut self.same_frames, same >= SAME_CELLS);
        self.evidence.fade();
        if let Some(near) = self.anchor_at(NEAR_M, NEAR_USEFUL_NS, pose, stamp_ns) {
            self.compare_near(near, pose, stamp_ns);
        }
        if let Some(far) = self.anchor_at(FAR_M, ANCHOR_USEFUL_NS, pose, stamp_ns) {
            self.compare_far(far, pose, stamp_ns);
        }
        let vanished = comparable && silence::have_vanished(&self.before, &self.picture);
        let wiped = vanished.then_some(Raised {
            reason: Reason::InconsistentPicture,
            stays: false,
        });
        if let Some(raised) = wiped.or_else(|| self.verdict()) {
            self.raises = self.raises.saturating_add(1);
            let stays = raised.stays || self.raises >= LAST_RAISE;
            self.raised = Some(Raised { stays, ..raised });
            (self.fit_steps, self.fits) = (0, 0);
        } else {
            self.keep(pose, stamp_ns);
        }
    }

    /// Samples that show the same, bit for bit, as in the picture before, although the motion asks for another range.
    fn cells_that_stayed(&self, map: &Map) -> u16 {
        let mut stayed = 0;
        for (row, column) in samples(self.step) {
            let cell = row * COLS + column;
            let inverse = self.picture.inverse(cell);
            if inverse > 0.0 && inverse.to_bits() == self.before.inverse(cell).to_bits() {
                let (found, _) = look(
                    &self.directions,
                    (row, column),
                    self.picture.at(cell),
                    map,
                    &self.before,
                );
                stayed +=
                    u16::from(matches!(found, motion::Found::Surface { error_m, .. } if error_m.abs() > CHANGE_M));
            }
        }
        stayed
    }

    /// The kept picture that is nearest to so far back; `None` if none is far enough, or all are older than this.
    fn anchor_at(&self, back_m: f32, oldest_ns: Nanos, pose: &Pose, stamp_ns: Nanos) -> Option<usize> {
        let mut best: Option<(usize, f32)> = None;
        for (i, anchor) in self.anchors.iter().take(self.anchors_used).enumerate() {
            let way_m = apart_m(&anchor.pose, pose);
            let miss_m = (way_m - back_m).abs();
            let age_ns = stamp_ns.saturating_sub(anchor.stamp_ns);
            let useful = way_m >= LEAST_M.max(DRIFTS * allowed_drift_m(age_ns)) && age_ns <= oldest_ns;
            if useful && best.is_none_or(|(_, least_m)| miss_m < least_m) {
                best = Some((i, miss_m));
            }
        }
        best.map(|(i, _)| i)
    }

    /// Did the picture move at all, everywhere?
    fn compare_near(&mut self, near: usize, pose: &Pose, stamp_ns: Nanos) {
        let Some(anchor) = self.anchors.get(near) else { return };
        let back = self.way_back(anchor, pose, stamp_ns, samples(self.step));
        let evidence = &mut self.evidence;
        for (row, column) in samples(self.step) {
            let cell = row * COLS + column;
            let seen = self.picture.at(cell);
            let (found, _) = look(&self.directions, (row, column), seen, &back, &anchor.picture);
            if let (Some(moved), Seen::Surface(range_m)) = (found.cost(), seen) {
                let strip = column / PART;
                if range_m > MAY_MOVE_M
                    && found.is_beyond(MAY_MOVE_M)
                    && let (Some(samples), Some(cost)) =
                        (evidence.samples.get_mut(strip), evidence.costs.get_mut(strip))
                {
                    *samples += 1.0;
                    *cost += moved;
                }
                evidence.cost += moved;
                let stayed = match anchor.picture.at(cell) {
                    Seen::Surface(there_m) => Some(cost(there_m - range_m, range_m)),
                    Seen::Nothing => Some(MOST_COST),
                    Seen::Mixed => None,
                };
                if let Some(stayed) = stayed {
                    let more = moved - stayed;
                    evidence.frozen += more;
                    let part = part_of(row, column);
                    if range_m > MAY_MOVE_M
                        && let (Some(frozen), Some(cost)) =
                            (evidence.frozen_parts.get_mut(part), evidence.cost_parts.get_mut(part))
                    {
                        *frozen += more;
                        *cost += moved;
                    }
                }
            }
        }
    }

    /// Did it move to the side to which the vehicle did; and is everything still there?
    fn compare_far(&mut self, far: usize, pose: &Pose, stamp_ns: Nanos) {
        let Some(anchor) = self.anchors.get(far) else { return };
        let (map, forth) = (Map::between(pose, &anchor.pose), Map::between(&anchor.pose, pose));
        // Over a shorter way the estimate's own error has a direction.
        let age_s = stamp_ns.saturating_sub(anchor.stamp_ns) as f32 * 1e-9;
        let level_m = (pose.position_ned_m - anchor.pose.position_ned_m).horizontal_norm();
        let directed = level_m >= DIRECTED_M.max(DIRECTED_M_S * age_s);
        // What drifted over a slower way would be seen through.
        let swift = apart_m(pose, &anchor.pose) >= DIRECTED_M_S * age_s;
        // To the other side in each step, so that a slope of one side has no direction.
        let side = if self.step.is_multiple_of(2) { 1.0 } else { -1.0 };
        let (cos, sin) = (TURN.0, side * TURN.1);
        let down = anchor.pose.attitude.to_frd(NedVector::new(0.0, 0.0, side * DOWN_M));
        let tested = [map, map.turned((cos, sin)), map.stretched(1.0 + sin), map.shifted(down)];
        let mirror = map.mirrored();
        // Straight ahead or straight up a mirrored sensor sees the same: what differs there is the error of the estimated roll.
        let aside = map.aside_m() >= LEAST_ASIDE_M;
        let mut errors = Errors::NONE;
        for (row, column) in samples(self.step).filter(|_| swift) {
            let (found, (there_row, there_column)) = look(
                &self.directions,
                (row, column),
                anchor.picture.at(row * COLS + column),
                &forth,
                &self.picture,
            );
            let near = anchor.picture.is_near(row * COLS + column, MAY_MOVE_M);
            if near || !found.is_beyond(MAY_MOVE_M) {
                continue;
            }
            let part = part_of(there_row as usize, there_column as usize);
            let evidence = &mut self.evidence;
            let (parts, rows) = if found.is_seen_through() {
                (&mut evidence.lost_parts, &mut evidence.lost_rows)
            } else if found.agrees() {
                (&mut evidence.found_parts, &mut evidence.found_rows)
            } else {
                continue;
            };
            if let (Some(part), Some(row)) = (parts.get_mut(part), rows.get_mut(there_row as usize / PART)) {
                *part += 1.0;
                *row += 1.0;
            }
        }
        for (row, column) in samples(self.step).step_by(2) {
            let seen = self.picture.at(row * COLS + column);
            let found = |map| look(&self.directions, (row, column), seen, map, &anchor.picture).0;
            let [straight, turned, longer, lower] = tested.each_ref().map(found);
            let cell = (row, column);
            let wider = look_widened(&self.directions, cell, seen, &map, &anchor.picture, side * WIDENING).0;
            errors.add(straight, [turned, longer, lower, wider], side);
            let Some(straight) = straight.cost() else { continue };
            if aside && let Some(mirrored) = found(&mirror).cost() {
                self.evidence.mirrored += straight - mirrored;
                self.evidence.far_cost += straight;
            }
        }
        // What spoke against it long ago must not outweigh what speaks for it now.
        self.evidence.mirrored = self.evidence.mirrored.max(-MIRRORED);
        self.evidence.drift.add_all(&errors);
        let mount = &mut self.evidence.mount;
        if !self.estimate_agrees {
            mount.give_up();
        }
        self.evidence.wrong_mount = directed && mount.read(&errors, stamp_ns);
    }

    /// The motion from a pose to where a picture was kept, without what the estimate drifted meanwhile.
    fn way_back(
        &self,
        anchor: &Anchor,
        pose: &Pose,
        stamp_ns: Nanos,
        cells: impl Iterator<Item = (usize, usize)> + Clone,
    ) -> Map {
        let pair = Pair {
            directions: &self.directions,
            from: &self.picture,
            to: &anchor.picture,
            cells,
        };
        let passed_ns = stamp_ns.saturating_sub(anchor.stamp_ns);
        pair.without_drift(&Map::between(pose, &anchor.pose), allowed_drift_m(passed_ns))
    }

    /// What the evidence tells.
    fn verdict(&self) -> Option<Raised> {
        let evidence = &self.evidence;
        // A picture that moves another way may cost less standing still too, but hardly fits.
        let is_frozen = |frozen: f32, cost: f32, least: f32| frozen > least && frozen > FROZEN_FIT * cost;
        let frozen_parts = evidence.frozen_parts.iter().zip(&evidence.cost_parts);
        let frozen_parts = frozen_parts
            .filter(|(frozen, cost)| is_frozen(**frozen, **cost, FROZEN_PART))
            .count();
        let lost = evidence.found_parts.iter().zip(&evidence.lost_parts);
        let lost_parts = lost
            .filter(|(found, lost)| **lost > VANISHED && **lost > 4.0 * **found)
            .count();
        // Whatever rises above some row of the view vanishes, and nothing is ever found there.
        let (mut found_above, mut lost_above, mut dead_above) = (0.0, 0.0, false);
        for (found, lost) in evidence.found_rows.iter().zip(&evidence.lost_rows) {
            found_above += found;
            lost_above += lost;
            dead_above |= lost_above > VANISHED_ABOVE && found_above < FOUND_ABOVE * lost_above;
        }
        let is_restored = self.regions.restored().is_some();
        let times = if is_restored { MISFIT_RESTORED } else { 1.0 };
        // Of regions that were moved the uppermost are hardly ever known.
        dead_above &= !is_restored;
        // What drift explains is no mirror's.
        let mirrored = evidence.mirrored - evidence.drift.drift_gain();
        let is_mirrored =
            mirrored > MIRRORED && mirrored > MIRRORED_FIT * evidence.far_cost && evidence.misfits_by(MIRRORED_NEAR);
        let raised = |reason, stays| Some(Raised { reason, stays });
        if self.same_frames >= SAME_FRAMES {
            raised(Reason::FrozenSensor, false)
        } else if is_mirrored || evidence.wrong_mount {
            raised(Reason::InconsistentPicture, true)
        } else if is_frozen(evidence.frozen, evidence.cost, FROZEN_VIEW)
            || (frozen_parts >= FROZEN_PARTS && evidence.frozen > 0.0)
            || frozen_parts >= FROZEN_PARTS_OF_A_MOVING_VIEW
        {
            raised(Reason::FrozenSensor, false)
        } else if evidence.misfits(times) || lost_parts >= VANISHED_PARTS || dead_above {
            raised(Reason::InconsistentPicture, false)
        } else {
            None
        }
    }

    /// Keeps the picture if the vehicle has come far enough since the last kept, or that one is no longer fresh.
    fn keep(&mut self, pose: &Pose, stamp_ns: Nanos) {
        let newest = self.anchors.get(self.newest).filter(|_| self.anchors_used > 0);
        let (way_m, age_ns) = newest.map_or((f32::INFINITY, 0), |anchor| {
            (apart_m(&anchor.pose, pose), stamp_ns.saturating_sub(anchor.stamp_ns))
        });
        if way_m >= ANCHOR_EVERY_M {
            self.newest = if self.anchors_used == 0 {
                0
            } else {
                (self.newest + 1) % ANCHORS
            };
            self.anchors_used = (self.anchors_used + 1).min(ANCHORS);
        } else if age_ns < ANCHOR_FRESH_NS {
            return;
        }
        if let Some(anchor) = self.anchors.get_mut(self.newest) {
            anchor.picture.clone_from(&self.picture);
            (anchor.pose, anchor.stamp_ns) = (*pose, stamp_ns);
            anchor.path_ned_m = self.odometry.path_ned_m();
        }
    }

    /// While something is raised: one kept picture in each step is looked at whether this one follows from it.
    fn look_for_a_fit(&mut self, pose: &Pose, stamp_ns: Nanos) {
        if self.raised.is_some_and(|raised| raised.stays) || self.anchors_used == 0 {
            return;
        }
        if self.fits_anchor(self.step % self.anchors_used, pose, stamp_ns) {
            self.fits += 1;
        }
        self.fit_steps += 1;
        if self.fits >= FITS {
            self.raised = None;
            self.forget_motion();
        } else if usize::from(self.fit_steps) >= ANCHORS {
            (self.fit_steps, self.fits) = (0, 0);
        }
    }

    fn fits_anchor(&self, anchor: usize, pose: &Pose, stamp_ns: Nanos) -> bool {
        let Some(anchor) = self.anchors.get(anchor) else {
            return false;
        };
        let cells = samples(self.step).chain(samples(self.step + 4));
        let back = self.way_back(anchor, pose, stamp_ns, cells.clone());
        let forth = Map::between(&anchor.pose, pose);
        let (mut told, mut agreed, mut lost, mut same) = (0_u16, 0_u16, 0_u16, 0_u16);
        let (mut moved_costs, mut stayed_costs) = (0.0, 0.0);
        for (row, column) in cells {
            let cell = row * COLS + column;
            let seen = self.picture.at(cell);
            let inverse = self.picture.inverse(cell);
            same += u16::from(inverse > 0.0 && inverse.to_bits() == self.before.inverse(cell).to_bits());
            let (found, _) = look(&self.directions, (row, column), seen, &back, &anchor.picture);
            if let (Some(moved), Seen::Surface(range_m)) = (found.cost(), seen) {
                told += 1;
                agreed += u16::from(found.agrees());
                moved_costs += moved;
                if let Seen::Surface(there_m) = anchor.picture.at(cell) {
                    stayed_costs += cost(there_m - range_m, range_m) - moved;
                }
            }
            let (found, _) = look(
                &self.directions,
                (row, column),
                anchor.picture.at(cell),
                &forth,
                &self.picture,
            );
            lost += u16::from(found.is_seen_through());
        }
        told >= FIT_SAMPLES
            && f32::from(agreed) >= FIT_SHARE * f32::from(told)
            && f32::from(lost) <= (1.0 - FIT_SHARE) * f32::from(told)
            && moved_costs <= FIT_MEAN_COST * f32::from(told)
            && stayed_costs >= FIT_COST
            && same < SAME_CELLS
    }
}

/// While a vehicle stands, or takes off by itself, nobody flies by what is seen; and its estimate moves then by more than it does
/// ([`TakeOff`]).
fn stands_or_takes_off(telemetry: &VehicleTelemetry) -> bool {
    telemetry.landed == Landed::OnGround || telemetry.heartbeat.is_some_and(|h| h.mode == VehicleMode::Takeoff)
}

/// Only who leads the vehicle by what is seen can be led astray: a mission over a slope is not held.
fn obeys_setpoints(telemetry: &VehicleTelemetry) -> bool {
    telemetry.heartbeat.is_some_and(|h| h.mode == VehicleMode::External)
}

/// Counts steps in a row.
fn count(steps: &mut u8, holds: bool) {
    *steps = if holds { steps.saturating_add(1) } else { 0 };
}

/// How far two poses are apart, metres; turns count as [`METRES_PER_RADIAN`].
fn apart_m(a: &Pose, b: &Pose) -> f32 {
    (a.position_ned_m - b.position_ned_m).norm() + METRES_PER_RADIAN * turn_rad(a.attitude, b.attitude)
}

/// The angle φ between two attitudes as 2 sin(φ/2), radians.
fn turn_rad(p: Attitude, q: Attitude) -> f32 {
    let alike = (p.w * q.w + p.x * q.x + p.y * q.y + p.z * q.z).abs().min(1.0);
    2.0 * libm::sqrtf(1.0 - alike * alike)
}

/// The attitude after a small turn, radians about the body's axes.
fn turned_by(attitude: Attitude, turn: FrdVector) -> Attitude {
    let (a, b, c) = (0.5 * turn.x, 0.5 * turn.y, 0.5 * turn.z);
    let Attitude { w, x, y, z } = attitude;
    let (nw, nx, ny, nz) = (
        w - a * x - b * y - c * z,
        x + a * w + c * y - b * z,
        y + b * w + a * z - c * x,
        z + c * w + b * x - a * y,
    );
    let scale = 1.0 / libm::sqrtf(nw * nw + nx * nx + ny * ny + nz * nz);
    Attitude {
        w: nw * scale,
        x: nx * scale,
        y: ny * scale,
        z: nz * scale,
    }
}

/// The part of the view in which a cell lies.
fn part_of(row: usize, column: usize) -> usize {
    (row / PART) * PART_COLS + column / PART
}

#[cfg(test)]
mod tests;
