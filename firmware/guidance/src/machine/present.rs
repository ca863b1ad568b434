//! Which conditions are present in a step: fence, goal, progress, telemetry and alarm.

use super::{Guidance, LONGEST_STEP_NS};
use crate::conditions::{
    FENCE_CLEAR_MARGIN_M, GOAL_DWELL_NS, NO_PROGRESS_DWELL_NS, NO_PROGRESS_GAIN_M, SLIP_WINDOW_NS,
};
use crate::input::GuidanceInput;
use crate::setpoint::changes_height;
use vigil_types::{
    Action, Alarm, AlarmCause, AlarmResponse, EngagePolicy, GuidanceState, Nanos, NedVector, Reason, Reasons,
};

impl Guidance {
    /// The conditions present in this step; [`crate::conditions::CONDITIONS`] states them in words.
    pub(super) fn conditions(
        &mut self,
        input: &GuidanceInput<'_>,
        alarm: Option<Alarm>,
        action: Option<Action>,
    ) -> Reasons {
        let GuidanceInput { now_ns, telemetry, .. } = *input;
        let older = |age_ns: Option<Nanos>, limit_ns| age_ns.is_none_or(|age_ns| age_ns > limit_ns);
        let stale_frame = older(input.frame.age_ns, self.config.frame_age_limit_ns);
        let stale_telemetry = older(telemetry.flight_data_age_ns(now_ns), self.config.telemetry_age_limit_ns);
        let heartbeat_age_ns = telemetry.heartbeat.map(|h| now_ns.saturating_sub(h.at_ns));
        let link_lost = older(heartbeat_age_ns, self.config.heartbeat_age_limit_ns);
        let received = telemetry.kinematics.is_some() && telemetry.attitude.is_some();
        let bad_telemetry = received && !telemetry.is_finite();
        let pilot_could = self.expects_action(input.vehicle.handover)
            && !stale_frame
            && !input.frame.refused
            && input.frame.sensor_faults.is_empty()
            && !stale_telemetry
            && !bad_telemetry
            && self.goal.is_some();
        let bad_action = action.map_or(pilot_could, |action| !action.is_finite());
        let usable = !stale_telemetry && !bad_telemetry;
        if let (true, Some(kinematics)) = (usable, telemetry.kinematics) {
            self.note_fence(kinematics.position_ned_m);
            self.note_goal(now_ns, kinematics.position_ned_m);
            self.note_progress(now_ns, kinematics.position_ned_m);
        }
        let since = |at_ns: Option<Nanos>| at_ns.map(|at_ns| now_ns.saturating_sub(at_ns));
        let mode_lost = matches!(self.state, GuidanceState::Guided | GuidanceState::Hold) && !self.obeys(input);
        // Nobody lands a vehicle that a person may just have taken.
        self.progress.dwelt = !mode_lost && since(self.progress.stopped_ns) >= Some(NO_PROGRESS_DWELL_NS);
        self.dwelt = !mode_lost && since(self.reached_ns) >= Some(GOAL_DWELL_NS);
        let auto_wants = self.config.engage == EngagePolicy::Auto && self.intent && !self.asked;
        let pilot_in_command = matches!(self.state, GuidanceState::Standby | GuidanceState::Ready)
            && (self.taken_over || auto_wants && !self.auto_may_take(input));
        let slow_telemetry = input
            .vehicle
            .telemetry_interval_ns
            .is_some_and(|interval_ns| interval_ns > self.config.telemetry_age_limit_ns / 2);
        let recent_slips = self
            .slip_times_ns
            .iter()
            .flatten()
            .filter(|at_ns| now_ns.saturating_sub(**at_ns) <= SLIP_WINDOW_NS)
            .count();
        let too_long = (self.config.time_limit_ns).is_some_and(|limit| since(self.flight_started_ns) > Some(limit));
        let low_battery = telemetry
            .battery_remaining
            .is_some_and(|charge| charge < self.config.battery_limit);
        Reasons::NONE
            .with_if(stale_frame, Reason::StaleFrame)
            .with_if(input.frame.refused && !input.frame.unauthenticated, Reason::BadFrame)
            .with_if(stale_telemetry, Reason::StaleTelemetry)
            .with_if(link_lost, Reason::LinkLost)
            .with_if(bad_telemetry || bad_action, Reason::NotFinite)
            .with_if(mode_lost, Reason::ModeLost)
            .with_if(self.in_flight() && self.disarmed(input), Reason::Disarmed)
            .with_if(recent_slips >= usize::from(self.config.slip_limit), Reason::Slip)
            .with_if(self.outside_fence, Reason::Geofence)
            .with_if(self.reached_ns.is_some(), Reason::GoalReached)
            .with_if(self.goal.is_none(), Reason::NoGoal)
            .with_if(self.operator, Reason::Operator)
            .with_if(self.handover_failed_ns.is_some(), Reason::HandoverFailed)
            .with_if(low_battery, Reason::LowBattery)
            .with_if(telemetry.heartbeat.is_some_and(|h| h.failsafe), Reason::VehicleFailsafe)
            .with_if(too_long, Reason::TimeLimit)
            .with_if(self.progress.stopped_ns.is_some(), Reason::NoProgress)
            .with_if(slow_telemetry, Reason::SlowTelemetry)
            .with_if(pilot_in_command, Reason::PilotInCommand)
            .with_if(input.frame.unauthenticated, Reason::UnauthenticatedFrame)
            .union(alarm.map_or(Reasons::NONE, of_alarm))
            .union(input.frame.sensor_faults)
    }

    fn note_fence(&mut self, position_ned_m: NedVector) {
        let Some(fence) = self.config.geofence else { return };
        let margin_m = if self.outside_fence { FENCE_CLEAR_MARGIN_M } else { 0.0 };
        let from_home_m = position_ned_m - self.home_ned_m;
        let high_enough = !self.flying_to_goal() || fence.is_high_enough(from_home_m, margin_m);
        self.outside_fence = !(fence.contains(from_home_m, margin_m) && high_enough);
    }

    fn note_goal(&mut self, now_ns: Nanos, position_ned_m: NedVector) {
        if let (true, None, Some(goal)) = (self.flying_to_goal(), self.reached_ns, self.goal)
            && (goal.position_ned_m - position_ned_m).horizontal_norm() <= self.config.goal_radius_m
        {
            self.reached_ns = Some(now_ns);
        }
    }

    /// Counts the time flown since the vehicle last got nearer to its goal; gives the flight up after too much of it.
    fn note_progress(&mut self, now_ns: Nanos, position_ned_m: NedVector) {
        let progress = &mut self.progress;
        let step_ns = now_ns.saturating_sub(progress.last_ns.replace(now_ns).unwrap_or(now_ns));
        let (true, Some(goal)) = (self.state == GuidanceState::Guided, self.goal) else {
            return;
        };
        if changes_height(goal, position_ned_m) {
            return;
        }
        let distance_m = (goal.position_ned_m - position_ned_m).horizontal_norm();
        progress.flown_ns += step_ns.min(LONGEST_STEP_NS);
        if progress
            .nearest_m
            .is_none_or(|nearest_m| distance_m <= nearest_m - NO_PROGRESS_GAIN_M)
        {
            (progress.nearest_m, progress.flown_ns) = (Some(distance_m), 0);
        }
        let given_up = self
            .config
            .no_progress_limit_ns
            .is_some_and(|limit_ns| progress.flown_ns > limit_ns);
        if given_up && self.reached_ns.is_none() {
            progress.stopped_ns = progress.stopped_ns.or(Some(now_ns));
        }
    }
}

/// What an alarm is a reason for: the pilot that recovers, or a stop.
fn of_alarm(alarm: Alarm) -> Reasons {
    let reason = match (alarm.response, alarm.cause) {
        (AlarmResponse::Ignored, _) => return Reasons::NONE,
        (AlarmResponse::Recovery, _) => Reason::Recovering,
        (AlarmResponse::Stop, AlarmCause::Attack) => Reason::Attack,
        (AlarmResponse::Stop, AlarmCause::NoVerdict) => Reason::NoVerdict,
        (AlarmResponse::Stop, AlarmCause::CollisionCourse) => Reason::CollisionCourse,
        (AlarmResponse::Stop, AlarmCause::LedAstray) => Reason::LedAstray,
        (AlarmResponse::Stop, AlarmCause::Disagreement) => Reason::Disagreement,
        (AlarmResponse::Stop, AlarmCause::RoughPicture) => Reason::RoughPicture,
    };
    Reasons::of(reason)
}
