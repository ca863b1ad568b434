//! What comparisons with earlier pictures tell, gathered over frames.

use super::drift::{Errors, MountReadings};
use super::picture::{PART_COLS, PART_ROWS};
use vigil_types::Reason;

/// What is found counts for about ten frames, and for about forty where directions are compared.
const KEEP: f32 = 0.9;
const KEEP_LONG: f32 = 0.975;
/// Frames in a row that hardly changed by a bit, although the vehicle moved: the sensor is frozen.
const SAME_FRAMES: u8 = 2;
/// Cost of the motion over that of standing still, for the view (and as a share of the motion's) and for a part of it, that
/// shows it frozen; and how many parts.
const FROZEN_VIEW: f32 = 120.0;
const FROZEN_FIT: f32 = 0.8;
const FROZEN_PART: f32 = 40.0;
const FROZEN_PARTS: usize = 6;
/// So many parts show it even where the view as a whole moved: more than something shows that moves beside the vehicle.
const FROZEN_PARTS_OF_A_MOVING_VIEW: usize = 28;
/// Mean cost of the motion that shows a picture of another place, and samples that it needs.
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
pub(super) const MIRRORED: f32 = 150.0;
const MIRRORED_FIT: f32 = 0.5;
/// And the mean cost of the motion near by: a mirrored sensor's picture does not fit there either, and what tilts by a third of a degree while the
/// vehicle turns does.
const MIRRORED_NEAR: f32 = 0.05;
/// Points of a part that were seen through, and how many such parts make a picture from which something vanished: more than something
/// near covers that goes away by itself.
const VANISHED: f32 = 6.0;
const VANISHED_PARTS: usize = 16;
/// Points that were seen through above one row of the view, where next to nothing was found: that side of the view is dead, and
/// showed too little when it died for [`SilentSide`](super::silence::SilentSide) to tell.
const VANISHED_ABOVE: f32 = 10.0;
const FOUND_ABOVE: f32 = 0.1;

/// A value for each part of the view.
type Parts = [[f32; PART_COLS]; PART_ROWS];

/// The parts of which that is so.
fn count(a: &Parts, b: &Parts, is: impl Fn(f32, f32) -> bool) -> usize {
    let both = a.as_flattened().iter().zip(b.as_flattened());
    both.filter(|(a, b)| is(**a, **b)).count()
}

/// Evidence on the picture's motion, fading with time.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Evidence {
    /// Samples, and what the motion cost them, by columns of parts.
    pub samples: [f32; PART_COLS],
    pub costs: [f32; PART_COLS],
    /// What the motion cost all samples, and that over what standing still would have.
    pub cost: f32,
    pub frozen: f32,
    pub frozen_parts: Parts,
    pub cost_parts: Parts,
    /// Points found and seen through.
    pub found_parts: Parts,
    pub lost_parts: Parts,
    /// The same by row, for longer.
    pub found_rows: [f32; PART_ROWS],
    pub lost_rows: [f32; PART_ROWS],
    /// Cost of the motion over that of a mirrored sensor, and what drift may explain of it.
    pub mirrored: f32,
    pub drift: Errors,
    /// Whether the sensor is turned on its mount, or of another width; this does not fade.
    pub mount: MountReadings,
    pub wrong_mount: bool,
    /// What the motion cost where these are compared.
    pub far_cost: f32,
    /// Frames in a row that hardly changed by a bit.
    pub same_frames: u8,
}

impl Evidence {
    pub(super) fn fade(&mut self) {
        let parts = self.frozen_parts.iter_mut().chain(&mut self.cost_parts);
        let parts = parts.chain(&mut self.found_parts).chain(&mut self.lost_parts);
        let columns = self.samples.iter_mut().chain(&mut self.costs);
        let all = parts.flatten().chain(columns).chain([&mut self.frozen, &mut self.cost]);
        all.for_each(|value| *value *= KEEP);
        let rows = self.found_rows.iter_mut().chain(&mut self.lost_rows);
        let all = rows.chain([&mut self.mirrored, &mut self.far_cost]);
        all.for_each(|value| *value *= KEEP_LONG);
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

    /// What it says of a picture, of one with regions moved back if `is_restored`.
    pub(super) fn verdict(&self, is_restored: bool) -> Option<Raised> {
        // A picture that moves another way may cost less standing still too, but hardly fits.
        let is_frozen = |frozen: f32, cost: f32, least: f32| frozen > least && frozen > FROZEN_FIT * cost;
        let frozen_parts = count(&self.frozen_parts, &self.cost_parts, |frozen, cost| {
            is_frozen(frozen, cost, FROZEN_PART)
        });
        let is_lost = |found: f32, lost: f32| lost > VANISHED && lost > 4.0 * found;
        let lost_parts = count(&self.found_parts, &self.lost_parts, is_lost);
        // Whatever rises above some row of the view vanishes, and nothing is ever found there.
        let (mut found_above, mut lost_above, mut dead_above) = (0.0, 0.0, false);
        for (found, lost) in self.found_rows.iter().zip(&self.lost_rows) {
            found_above += found;
            lost_above += lost;
            dead_above |= lost_above > VANISHED_ABOVE && found_above < FOUND_ABOVE * lost_above;
        }
        let times = if is_restored { MISFIT_RESTORED } else { 1.0 };
        // Of regions that were moved the uppermost are hardly ever known.
        dead_above &= !is_restored;
        // What drift explains is no mirror's.
        let mirrored = self.mirrored - self.drift.drift_gain();
        let is_mirrored =
            mirrored > MIRRORED && mirrored > MIRRORED_FIT * self.far_cost && self.misfits_by(MIRRORED_NEAR);
        let raised = |reason, stays| Some(Raised { reason, stays });
        if self.same_frames >= SAME_FRAMES {
            raised(Reason::FrozenSensor, false)
        } else if is_mirrored || self.wrong_mount {
            raised(Reason::InconsistentPicture, true)
        } else if is_frozen(self.frozen, self.cost, FROZEN_VIEW)
            || (frozen_parts >= FROZEN_PARTS && self.frozen > 0.0)
            || frozen_parts >= FROZEN_PARTS_OF_A_MOVING_VIEW
        {
            raised(Reason::FrozenSensor, false)
        } else if self.misfits(times) || lost_parts >= VANISHED_PARTS || dead_above {
            raised(Reason::InconsistentPicture, false)
        } else {
            None
        }
    }
}

/// What was raised of the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Raised {
    pub reason: Reason,
    /// Until the end of the flight.
    pub stays: bool,
}
