//! The picture beside earlier ones, and the way flown between them.

use super::drift::{DOWN_M, Errors, Pair, TURN, WIDENING, allowed_drift_m};
use super::evidence::{MIRRORED, Raised};
use super::motion::{Found, MOST_COST, Map, Pose, apart_m, cost, look, look_widened, samples};
use super::picture::{COLS, PART, Picture, Seen, part_of};
use super::silence::have_vanished;
use super::{PlausibilityCheck, count};
use vigil_types::{Nanos, NedVector, Reason};

/// Earlier pictures that are kept.
const ANCHORS: usize = 8;
/// A further one is kept when the vehicle has come so far since the last; a turn of a radian counts as 3 m.
const ANCHOR_EVERY_M: f32 = 0.2;
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
/// Cells that did not change by a bit although they should have, of a step's samples.
const SAME_CELLS: u16 = 10;
/// A cell should have changed if the motion asks for more than this, metres.
const CHANGE_M: f32 = 0.03;
/// Something nearer than this may move beside the vehicle and fill the view: whether it fits, stays, is there or is gone shows nothing, metres.
const MAY_MOVE_M: f32 = 2.5;
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
#[derive(Debug, Clone, Default)]
pub(super) struct Anchor {
    pub picture: Picture,
    pub pose: Pose,
    pub stamp_ns: Nanos,
    /// The reported velocity summed up until then.
    pub path_ned_m: NedVector,
}

/// The earlier pictures that are kept.
#[derive(Debug, Clone, Default)]
pub(super) struct Kept {
    anchors: [Anchor; ANCHORS],
    used: usize,
    newest: usize,
}

impl Kept {
    pub(super) fn all(&self) -> &[Anchor] {
        self.anchors.get(..self.used).unwrap_or_default()
    }

    pub(super) fn forget(&mut self) {
        self.used = 0;
    }

    /// The kept picture that is nearest to so far back; `None` if none is far enough, or all are older than this.
    fn at(&self, back_m: f32, oldest_ns: Nanos, pose: &Pose, stamp_ns: Nanos) -> Option<&Anchor> {
        let mut best: Option<(&Anchor, f32)> = None;
        for anchor in self.all() {
            let way_m = apart_m(&anchor.pose, pose);
            let miss_m = (way_m - back_m).abs();
            let age_ns = stamp_ns.saturating_sub(anchor.stamp_ns);
            let useful = way_m >= LEAST_M.max(DRIFTS * allowed_drift_m(age_ns)) && age_ns <= oldest_ns;
            if useful && best.is_none_or(|(_, least_m)| miss_m < least_m) {
                best = Some((anchor, miss_m));
            }
        }
        best.map(|(anchor, _)| anchor)
    }

    /// Keeps the picture if the vehicle has come far enough since the last kept, or that one is no longer fresh.
    fn keep(&mut self, picture: &Picture, pose: &Pose, stamp_ns: Nanos, path_ned_m: NedVector) {
        let newest = self.anchors.get(self.newest).filter(|_| self.used > 0);
        let (way_m, age_ns) = newest.map_or((f32::INFINITY, 0), |anchor| {
            (apart_m(&anchor.pose, pose), stamp_ns.saturating_sub(anchor.stamp_ns))
        });
        if way_m >= ANCHOR_EVERY_M {
            self.newest = if self.used == 0 { 0 } else { (self.newest + 1) % ANCHORS };
            self.used = (self.used + 1).min(ANCHORS);
        } else if age_ns < ANCHOR_FRESH_NS {
            return;
        }
        if let Some(anchor) = self.anchors.get_mut(self.newest) {
            anchor.picture.clone_from(picture);
            (anchor.pose, anchor.stamp_ns) = (*pose, stamp_ns);
            anchor.path_ned_m = path_ned_m;
        }
    }
}

impl PlausibilityCheck {
    /// Compares the picture with the one before (`comparable`: that is a step older, and this one has no regions moved back) and with two that were
    /// kept; raises what that shows, or keeps the picture.
    pub(super) fn compare(&mut self, pose: &Pose, stamp_ns: Nanos, comparable: bool) {
        let same = self
            .pose_before
            .map_or(0, |before| self.cells_that_stayed(&Map::between(pose, &before)));
        count(&mut self.evidence.same_frames, same >= SAME_CELLS);
        self.evidence.fade();
        self.compare_near(pose, stamp_ns);
        self.compare_far(pose, stamp_ns);
        let vanished = comparable && have_vanished(&self.before, &self.picture);
        let wiped = vanished.then_some(Raised {
            reason: Reason::InconsistentPicture,
            stays: false,
        });
        if let Some(raised) = wiped.or_else(|| self.evidence.verdict(self.regions.restored().is_some())) {
            self.raises = self.raises.saturating_add(1);
            let stays = raised.stays || self.raises >= LAST_RAISE;
            self.raised = Some(Raised { stays, ..raised });
            (self.fit_steps, self.fits) = (0, 0);
        } else {
            let path_ned_m = self.odometry.path_ned_m;
            self.kept.keep(&self.picture, pose, stamp_ns, path_ned_m);
        }
    }

    /// Samples that show the same, bit for bit, as in the picture before, although the motion asks for another range.
    fn cells_that_stayed(&self, map: &Map) -> u16 {
        let mut stayed = 0;
        for (row, column) in samples(self.step) {
            let cell = row * COLS + column;
            if self.is_same_to_the_bit(cell) {
                let seen = self.picture.at(cell);
                let (found, _) = look(&self.directions, (row, column), seen, map, &self.before);
                stayed += u16::from(matches!(found, Found::Surface { error_m, .. } if error_m.abs() > CHANGE_M));
            }
        }
        stayed
    }

    fn is_same_to_the_bit(&self, cell: usize) -> bool {
        let inverse = self.picture.inverse(cell);
        inverse > 0.0 && inverse.to_bits() == self.before.inverse(cell).to_bits()
    }

    /// Did the picture move at all, everywhere?
    fn compare_near(&mut self, pose: &Pose, stamp_ns: Nanos) {
        let Some(anchor) = self.kept.at(NEAR_M, NEAR_USEFUL_NS, pose, stamp_ns) else {
            return;
        };
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
                    let (part, cost_parts) = (part_of(row, column), evidence.cost_parts.as_flattened_mut());
                    let frozen_parts = evidence.frozen_parts.as_flattened_mut();
                    if range_m > MAY_MOVE_M
                        && let (Some(frozen), Some(cost)) = (frozen_parts.get_mut(part), cost_parts.get_mut(part))
                    {
                        *frozen += more;
                        *cost += moved;
                    }
                }
            }
        }
    }

    /// Did it move to the side to which the vehicle did; and is everything still there?
    fn compare_far(&mut self, pose: &Pose, stamp_ns: Nanos) {
        let Some(anchor) = self.kept.at(FAR_M, ANCHOR_USEFUL_NS, pose, stamp_ns) else {
            return;
        };
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
        let mut errors = Errors::default();
        for (row, column) in samples(self.step).filter(|_| swift) {
            let cell = row * COLS + column;
            let there = anchor.picture.at(cell);
            let (found, place) = look(&self.directions, (row, column), there, &forth, &self.picture);
            let (there_row, there_column) = (place.0 as usize, place.1 as usize);
            let near = anchor.picture.is_near(cell, MAY_MOVE_M);
            if near || !found.is_beyond(MAY_MOVE_M) {
                continue;
            }
            let evidence = &mut self.evidence;
            let (parts, rows) = if found.is_seen_through() {
                (&mut evidence.lost_parts, &mut evidence.lost_rows)
            } else if found.agrees() {
                (&mut evidence.found_parts, &mut evidence.found_rows)
            } else {
                continue;
            };
            let part = parts.as_flattened_mut().get_mut(part_of(there_row, there_column));
            if let (Some(part), Some(row)) = (part, rows.get_mut(there_row / PART)) {
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
        if self.estimate_disagrees {
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

    /// While something is raised: one kept picture in each step is looked at whether this one follows from it.
    pub(super) fn look_for_a_fit(&mut self, pose: &Pose, stamp_ns: Nanos) {
        if self.raised.is_some_and(|raised| raised.stays) || self.kept.used == 0 {
            return;
        }
        if self.fits_anchor(self.step % self.kept.used, pose, stamp_ns) {
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
        let Some(anchor) = self.kept.anchors.get(anchor) else {
            return false;
        };
        let cells = samples(self.step).chain(samples(self.step + 4));
        let back = self.way_back(anchor, pose, stamp_ns, cells.clone());
        let forth = Map::between(&anchor.pose, pose);
        let (mut compared, mut agreed, mut lost, mut same) = (0_u16, 0_u16, 0_u16, 0_u16);
        let (mut moved_costs, mut stayed_costs) = (0.0, 0.0);
        for (row, column) in cells {
            let cell = row * COLS + column;
            let seen = self.picture.at(cell);
            same += u16::from(self.is_same_to_the_bit(cell));
            let (found, _) = look(&self.directions, (row, column), seen, &back, &anchor.picture);
            if let (Some(moved), Seen::Surface(range_m)) = (found.cost(), seen) {
                compared += 1;
                agreed += u16::from(found.agrees());
                moved_costs += moved;
                if let Seen::Surface(there_m) = anchor.picture.at(cell) {
                    stayed_costs += cost(there_m - range_m, range_m) - moved;
                }
            }
            let there = anchor.picture.at(cell);
            let (found, _) = look(&self.directions, (row, column), there, &forth, &self.picture);
            lost += u16::from(found.is_seen_through());
        }
        compared >= FIT_SAMPLES
            && f32::from(agreed) >= FIT_SHARE * f32::from(compared)
            && f32::from(lost) <= (1.0 - FIT_SHARE) * f32::from(compared)
            && moved_costs <= FIT_MEAN_COST * f32::from(compared)
            && stayed_costs >= FIT_COST
            && same < SAME_CELLS
    }
}
