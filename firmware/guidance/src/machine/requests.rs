//! What an operator asks, and where a goal is when home moves.

use super::{Datum, Guidance, Progress};
use crate::conditions::FENCE_CLEAR_MARGIN_M;
use crate::config::GREATEST_GOAL_M;
use crate::input::GuidanceInput;
use vigil_types::{Goal, GuidanceState, NedVector, OperatorRequest, Reason, RequestOutcome};

impl Guidance {
    /// Takes what an operator asks; it has its effect in the next [`Guidance::step`].
    pub fn request(&mut self, request: OperatorRequest) -> RequestOutcome {
        match request {
            OperatorRequest::Goal {
                north_m,
                east_m,
                height_m,
            } => self.request_goal(Datum::Home, north_m, east_m, height_m),
            OperatorRequest::FixedGoal {
                north_m,
                east_m,
                height_m,
            } => self.request_goal(Datum::Origin, north_m, east_m, height_m),
            OperatorRequest::Engage => self.request_engage(),
            // It lands on.
            OperatorRequest::Disengage if self.state == GuidanceState::Land && !self.intent => {
                RequestOutcome::TemporarilyRejected
            }
            // Before guidance has the vehicle, landing it is not guidance's to do.
            OperatorRequest::Land if matches!(self.state, GuidanceState::Standby | GuidanceState::Ready) => {
                RequestOutcome::TemporarilyRejected
            }
            OperatorRequest::Disengage | OperatorRequest::Land => {
                (self.intent, self.operator, self.taken_over) = (false, true, true);
                self.operator_land |= request == OperatorRequest::Land;
                RequestOutcome::Accepted
            }
        }
    }

    fn request_goal(&mut self, datum: Datum, north_m: f32, east_m: f32, height_m: Option<f32>) -> RequestOutcome {
        let datum_ned_m = self.datum_ned_m(datum);
        let height_m = height_m.unwrap_or(match self.goal {
            Some(goal) => -(goal.position_ned_m - datum_ned_m).z,
            None => self.config.default_height_m - (self.home_ned_m - datum_ned_m).z,
        });
        let given_m = NedVector::new(north_m, east_m, -height_m);
        let from_home_m = given_m + (datum_ned_m - self.home_ned_m);
        // What is not a number is not within it either.
        let is_near = |m: &f32| m.abs() <= GREATEST_GOAL_M;
        let permitted = from_home_m.to_array().iter().all(is_near)
            && from_home_m.z < 0.0
            && self.config.geofence.is_none_or(|fence| {
                fence.contains(from_home_m, FENCE_CLEAR_MARGIN_M)
                    && fence.is_high_enough(from_home_m, FENCE_CLEAR_MARGIN_M)
            });
        if !permitted {
            return RequestOutcome::Denied;
        }
        let distance_m = from_home_m.horizontal_norm();
        if distance_m > self.config.goal_limit_m {
            let whole_m = distance_m as u32;
            return RequestOutcome::TooFar {
                distance_m: whole_m.saturating_add(u32::from((whole_m as f32) < distance_m)),
                limit_m: self.config.goal_limit_m as u32,
            };
        }
        self.given = Some((datum, given_m));
        self.place_goal();
        RequestOutcome::Accepted
    }

    /// Where what a goal is relative to is in the local frame.
    fn datum_ned_m(&self, datum: Datum) -> NedVector {
        match datum {
            Datum::Home => self.home_ned_m,
            Datum::Origin => NedVector::ZERO,
        }
    }

    /// Puts the goal where it is now that home is where it is.
    fn place_goal(&mut self) {
        self.goal = self.given.map(|(datum, given_m)| Goal {
            position_ned_m: given_m + self.datum_ned_m(datum),
        });
        self.reached_ns = None;
        self.dwelt = false;
        self.progress = Progress::default();
    }

    /// An autopilot may set home anew when it is armed, and the goal goes with it. In flight a goal does not move off: then
    /// only the first home that the vehicle ever reported counts.
    pub(super) fn note_home(&mut self, input: &GuidanceInput<'_>, restarted: bool) {
        if restarted {
            // Another start, another origin.
            self.home_known = false;
        }
        let reported = input.vehicle.home_ned_m.filter(|home_ned_m| home_ned_m.is_finite());
        let may_move = !self.home_known || !self.in_flight();
        let home_ned_m = match (reported, restarted) {
            (Some(home_ned_m), _) if may_move => home_ned_m,
            (None, true) => NedVector::ZERO,
            _ => return,
        };
        self.home_known = reported.is_some();
        if home_ned_m != self.home_ned_m {
            self.home_ned_m = home_ned_m;
            self.place_goal();
        }
    }

    fn request_engage(&mut self) -> RequestOutcome {
        let not_now = match self.state {
            // Not kept for later: nobody expects a flight to begin minutes after it was asked for.
            GuidanceState::Standby => true,
            GuidanceState::Hold => self.reasons.contains(Reason::ModeLost),
            GuidanceState::Land => self.must_land(self.reasons),
            GuidanceState::Ready | GuidanceState::Engaging | GuidanceState::Guided => false,
        };
        if not_now {
            return RequestOutcome::TemporarilyRejected;
        }
        self.intent = true;
        self.asked = true;
        self.taken_over = false;
        self.returned_disarmed_ns = None;
        self.operator = false;
        self.operator_land = false;
        self.handover_failed_ns = None;
        self.progress = Progress::default();
        self.alarm.trust_again();
        RequestOutcome::Accepted
    }
}
