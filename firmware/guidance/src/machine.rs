//! The state machine: evaluates conditions, takes the first transition that fits, says what is sent.

use crate::alarm::{AlarmInput, AlarmLogic};
use crate::conditions::{Demand, FENCE_CLEAR_MARGIN_M, blocking_ready, demanding};
use crate::config::{ConfigError, GREATEST_GOAL_M, GuidanceConfig};
use crate::setpoint::{changes_height, guided_setpoint};
use crate::table::{Guard, Intent, TRANSITIONS, Transition};
use vigil_types::{
    Action, Alarm, AlarmCause, AlarmResponse, AtGoal, EngagePolicy, Goal, GuidanceState, HandoverProgress, Kinematics,
    Nanos, NedVector, OnNoProgress, OperatorRequest, Reason, Reasons, RequestOutcome, StepTiming, VehicleMode,
    VehicleRequest, VehicleStatus, VehicleTelemetry, VelocitySetpoint, Verdict,
};

/// A vehicle that comes back disarmed after silence restarted, if its clock says so within this time; else somebody
/// disarmed it.
const RESTART_SHOWS_NS: Nanos = 2_000_000_000;
/// A vehicle in the air whose autopilot started less than this ago did not take off: it is a simulation that begins there.
const BORN_AIRBORNE_NS: Nanos = 30_000_000_000;
/// Longest time between two steps that counts as flown, against clocks that jump.
const LONGEST_STEP_NS: Nanos = 1_000_000_000;
/// Missed steps that are remembered; [`GuidanceConfig::slip_limit`] is at most this.
const SLIPS_REMEMBERED: usize = 8;
/// A failsafe hold within this time after the stream of setpoints was interrupted is for that: the longest limit that a PX4 may have, and the
/// second between two heartbeats.
const INTERRUPTION_NS: Nanos = 6_000_000_000;

/// What became of the depth frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FrameStatus {
    /// Age of the newest valid frame; `None` when there never was one.
    pub age_ns: Option<Nanos>,
    /// A frame was refused in this step.
    pub refused: bool,
    /// It was refused because it was not made with the sensor's key.
    pub unauthenticated: bool,
    /// What is implausible about the newest valid frame: [`Reason::BlindSensor`] and its like; no pilot was shown it then.
    pub doubts: Reasons,
}

/// What the recovery pilot foresees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Risk {
    /// The pilot's action leads into something.
    pub collision_course: bool,
    /// The recovery pilot's own action leads into something that stopping avoids.
    pub recovery_course: bool,
    /// How fast the vehicle flies along the way that the recovery pilot plans, metres per second; 0 where it has none.
    pub speed_along_way_m_s: f32,
}

/// Everything guidance looks at in one step.
#[derive(Debug, Clone, Copy)]
pub struct GuidanceInput<'a> {
    /// Time of the step.
    pub now_ns: Nanos,
    /// What is known of the vehicle.
    pub telemetry: &'a VehicleTelemetry,
    /// Depth frames.
    pub frame: FrameStatus,
    /// The pilot's action. The pilot is asked in every step for which [`Guidance::expects_action`] and in which there are a
    /// fresh frame, fresh finite telemetry and a goal; `None` when it was not asked.
    pub action: Option<Action>,
    /// The recovery pilot's action, asked together with the pilot; `None` without a recovery pilot.
    pub recovery: Option<Action>,
    /// What the detector says of the pilot's action; `None` without a detector.
    pub verdict: Option<Verdict>,
    /// What the recovery pilot foresees; `None` when it did not look, or there is none.
    pub risk: Option<Risk>,
    /// Share of one surface among the cells of this step's new frame in which something is seen; `None` without one.
    pub smooth_share: Option<f32>,
    /// Steps missed.
    pub timing: StepTiming,
    /// How it stands with the vehicle.
    pub vehicle: VehicleStatus,
}

/// What a goal is relative to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Datum {
    Home,
    Origin,
}

/// What guidance decided.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GuidanceOutput {
    /// State after the step.
    pub state: GuidanceState,
    /// Conditions present in the step, those that caused its transition included.
    pub reasons: Reasons,
    /// The alarm, while it is raised.
    pub alarm: Option<Alarm>,
    /// The action of the pilot that flies, whether or not it may reach the vehicle.
    pub action: Option<Action>,
    /// The transition taken, if one was.
    pub transition: Option<&'static Transition>,
    /// What to send; `None` is silence.
    pub setpoint: Option<VelocitySetpoint>,
    /// What to ask of the vehicle.
    pub request: VehicleRequest,
}

/// How the flight gets on.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Progress {
    /// Nearest that the vehicle has been to the goal, metres; counted in steps of the least gain.
    nearest_m: Option<f32>,
    /// Time flown since.
    flown_ns: Nanos,
    /// Time of the last step.
    last_ns: Option<Nanos>,
    /// When the vehicle was given up.
    stopped_ns: Option<Nanos>,
    /// It was given up long enough ago to land.
    dwelt: bool,
}

/// The state machine. Plain data; time only comes in as an argument.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Guidance {
    config: GuidanceConfig,
    hold_conditions: Reasons,
    ready_conditions: Reasons,
    state: GuidanceState,
    since_ns: Nanos,
    goal: Option<Goal>,
    /// The goal as it was given.
    given: Option<(Datum, NedVector)>,
    /// Home as far as the goal and the fence are concerned; the local origin until the vehicle tells.
    home_ned_m: NedVector,
    home_known: bool,
    progress: Progress,
    /// Guidance wants to fly.
    intent: bool,
    /// An operator engaged, and it came to no end yet.
    asked: bool,
    /// A person took the vehicle over, and no operator engaged since.
    taken_over: bool,
    /// Guidance began to take this vehicle, and since then neither did a person nor ended the flight.
    begun: bool,
    /// When the vehicle came back disarmed after silence.
    returned_disarmed_ns: Option<Nanos>,
    /// An operator disengaged or told to land.
    operator: bool,
    operator_land: bool,
    outside_fence: bool,
    /// The vehicle was in its landing mode since this landing began.
    landing_seen: bool,
    reached_ns: Option<Nanos>,
    /// The goal was reached long enough ago.
    dwelt: bool,
    handover_failed_ns: Option<Nanos>,
    flight_started_ns: Option<Nanos>,
    /// Conditions of the last step.
    reasons: Reasons,
    restarts: Option<u32>,
    slips: Option<u64>,
    slip_times_ns: [Option<Nanos>; SLIPS_REMEMBERED],
    /// When the stream of setpoints may last have been interrupted: steps were missed, or the vehicle was not heard.
    interrupted_ns: Option<Nanos>,
    /// In the vehicle's failsafe hold: whether lost setpoints are what it is for.
    setpoints_lost: Option<bool>,
    /// Consecutive steps: without a condition that keeps from leaving standby or hold; the same with the vehicle's mode
    /// and failsafe left aside; out of the external mode.
    clear_steps: u16,
    regain_steps: u16,
    released_steps: u16,
    alarm: AlarmLogic,
}

impl Guidance {
    /// Guidance in standby, without a goal.
    ///
    /// # Errors
    /// [`ConfigError`] when the configuration must not fly.
    pub fn new(config: GuidanceConfig) -> Result<Self, ConfigError> {
        config.check()?;
        Ok(Self {
            config,
            hold_conditions: demanding(Demand::Hold),
            ready_conditions: blocking_ready(),
            state: GuidanceState::Standby,
            since_ns: 0,
            goal: None,
            given: None,
            home_ned_m: NedVector::ZERO,
            home_known: false,
            progress: Progress::default(),
            intent: config.engage == EngagePolicy::Auto,
            asked: false,
            taken_over: config.taken_over,
            begun: false,
            returned_disarmed_ns: None,
            operator: false,
            operator_land: false,
            outside_fence: false,
            landing_seen: false,
            reached_ns: None,
            dwelt: false,
            handover_failed_ns: None,
            flight_started_ns: None,
            reasons: Reasons::NONE,
            restarts: None,
            slips: None,
            slip_times_ns: [None; SLIPS_REMEMBERED],
            interrupted_ns: None,
            setpoints_lost: None,
            clear_steps: 0,
            regain_steps: 0,
            released_steps: 0,
            alarm: AlarmLogic::default(),
        })
    }

    /// The present state.
    pub fn state(&self) -> GuidanceState {
        self.state
    }

    /// Whether the pilot is to be asked in the next [`Guidance::step`], given how far the vehicle is with the hand-over: in
    /// *guided* and *hold*, and in the step in which the vehicle is handed over, so that its first action is there with
    /// *guided*. Before that the vehicle stands or climbs, and what its sensor shows is the ground.
    pub fn expects_action(&self, handover: HandoverProgress) -> bool {
        self.flying_to_goal() || self.state == GuidanceState::Engaging && handover == HandoverProgress::Done
    }

    /// Whether a person took the vehicle over and no operator engaged since: what should outlive a restart.
    pub fn taken_over(&self) -> bool {
        self.taken_over
    }

    /// Home in the local frame, as goal and fence are counted from it.
    pub fn home_ned_m(&self) -> NedVector {
        self.home_ned_m
    }

    /// The goal in force, in the local frame.
    pub fn goal(&self) -> Option<Goal> {
        self.goal
    }

    /// The configuration.
    pub fn config(&self) -> &GuidanceConfig {
        &self.config
    }

    /// Takes another configuration; state and goal stay. It has its effect in the next [`Guidance::step`].
    ///
    /// # Errors
    /// [`ConfigError`] when the configuration must not fly; the present one stays.
    pub fn reconfigure(&mut self, config: GuidanceConfig) -> Result<(), ConfigError> {
        config.check()?;
        self.config = config;
        Ok(())
    }

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
            OperatorRequest::Disengage => {
                self.operator_ends();
                RequestOutcome::Accepted
            }
            OperatorRequest::Land => match self.state {
                // Before guidance has the vehicle, landing it is not guidance's to do.
                GuidanceState::Standby | GuidanceState::Ready => RequestOutcome::TemporarilyRejected,
                _ => {
                    self.operator_ends();
                    self.operator_land = true;
                    RequestOutcome::Accepted
                }
            },
        }
    }

    fn operator_ends(&mut self) {
        self.intent = false;
        self.operator = true;
        self.taken_over = true;
    }

    fn request_goal(&mut self, datum: Datum, north_m: f32, east_m: f32, height_m: Option<f32>) -> RequestOutcome {
        let datum_ned_m = self.datum_ned_m(datum);
        let height_m = height_m.unwrap_or(match self.goal {
            Some(goal) => -(goal.position_ned_m - datum_ned_m).z,
            None => self.config.default_height_m - (self.home_ned_m - datum_ned_m).z,
        });
        let given_m = NedVector::new(north_m, east_m, -height_m);
        let from_home_m = given_m + (datum_ned_m - self.home_ned_m);
        let permitted = from_home_m.is_finite()
            && from_home_m.x.abs() <= GREATEST_GOAL_M
            && from_home_m.y.abs() <= GREATEST_GOAL_M
            && from_home_m.z < 0.0
            && from_home_m.z >= -GREATEST_GOAL_M
            && self.config.geofence.is_none_or(|fence| {
                fence.contains(from_home_m, FENCE_CLEAR_MARGIN_M)
                    && fence.is_high_enough(from_home_m, FENCE_CLEAR_MARGIN_M)
            });
        if !permitted {
            return RequestOutcome::Denied;
        }
        let distance_m = from_home_m.horizontal_norm();
        if distance_m > self.config.goal_limit_m {
            return RequestOutcome::TooFar {
                distance_m: (distance_m as u32).saturating_add(1),
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

    /// An autopilot may set home anew when it is armed, and the goal goes with it. In flight a goal does not wander off: then
    /// only the first home that the vehicle ever told counts.
    fn note_home(&mut self, input: &GuidanceInput<'_>, restarted: bool) {
        if restarted {
            // Another start, another origin.
            self.home_known = false;
        }
        let told = input.vehicle.home_ned_m.filter(|home_ned_m| home_ned_m.is_finite());
        let may_move = !self.home_known || !self.in_flight();
        let home_ned_m = match (told, restarted) {
            (Some(home_ned_m), _) if may_move => home_ned_m,
            (None, true) => NedVector::ZERO,
            _ => return,
        };
        self.home_known = told.is_some();
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

    /// One step of the loop.
    pub fn step(&mut self, input: &GuidanceInput<'_>) -> GuidanceOutput {
        let restarted =
            self.restarts.replace(input.vehicle.restarts) != Some(input.vehicle.restarts) && input.vehicle.restarts > 0;
        self.note_home(input, restarted);
        self.note_return(input.now_ns);
        self.note_slips(input);
        self.note_hand_over(input);
        let alarm = self.note_verdict(input);
        let action = match alarm {
            Some(Alarm {
                response: AlarmResponse::Recovery,
                ..
            }) => input.recovery,
            _ => input.action,
        };
        let was_lost = self.reasons.contains(Reason::LinkLost);
        let reasons = self.conditions(input, alarm, action);
        self.reasons = reasons;
        self.count_steps(input, reasons);
        let transition = TRANSITIONS
            .iter()
            .find(|row| row.from.contains(&self.state) && self.holds(row.when, input, reasons, restarted));
        if let Some(row) = transition {
            self.enter(row, input.now_ns, was_lost);
        }
        GuidanceOutput {
            state: self.state,
            reasons,
            alarm,
            action,
            transition,
            setpoint: self.setpoint(input, action),
            request: self.vehicle_request(input),
        }
    }

    fn in_flight(&self) -> bool {
        matches!(
            self.state,
            GuidanceState::Guided | GuidanceState::Hold | GuidanceState::Land
        )
    }

    fn flying_to_goal(&self) -> bool {
        matches!(self.state, GuidanceState::Guided | GuidanceState::Hold)
    }

    /// A vehicle that came back disarmed after silence, and did not restart: a person had it meanwhile.
    fn note_return(&mut self, now_ns: Nanos) {
        if let Some(at_ns) = self.returned_disarmed_ns
            && now_ns.saturating_sub(at_ns) > RESTART_SHOWS_NS
        {
            self.take_over();
        }
    }

    /// A person has the vehicle from now on.
    fn take_over(&mut self) {
        self.taken_over = true;
        self.begun = false;
        self.returned_disarmed_ns = None;
    }

    /// Whether the policy *auto* may take the vehicle from where it is; `docs/guidance.md`, "Where auto engages".
    fn auto_may_take(&self, input: &GuidanceInput<'_>) -> bool {
        let telemetry = input.telemetry;
        let Some(heartbeat) = telemetry.heartbeat else {
            // Nothing is known of it, and nothing is engaged without a heartbeat.
            return true;
        };
        match heartbeat.mode {
            // It was given to whoever sends setpoints; an unknown one is refused by the hand-over, which says why.
            VehicleMode::External | VehicleMode::Unknown => true,
            VehicleMode::Hold if !heartbeat.armed || heartbeat.failsafe => true,
            VehicleMode::Hold => {
                let born_airborne = input.vehicle.up_ns.is_some_and(|up_ns| up_ns < BORN_AIRBORNE_NS);
                self.begun || born_airborne && telemetry.is_airborne()
            }
            VehicleMode::Takeoff => self.begun,
            VehicleMode::Land | VehicleMode::Return | VehicleMode::Mission | VehicleMode::Other => false,
        }
    }

    fn note_slips(&mut self, input: &GuidanceInput<'_>) {
        let before = self.slips.replace(input.timing.slips).unwrap_or(input.timing.slips);
        let missed = input.timing.slips.saturating_sub(before);
        if missed > 0 {
            self.interrupted_ns = Some(input.now_ns);
        }
        for _ in 0..missed.min(SLIPS_REMEMBERED as u64) {
            self.slip_times_ns.rotate_right(1);
            if let Some(newest) = self.slip_times_ns.first_mut() {
                *newest = Some(input.now_ns);
            }
        }
    }

    fn note_hand_over(&mut self, input: &GuidanceInput<'_>) {
        if self.state == GuidanceState::Engaging {
            let too_long = input.now_ns.saturating_sub(self.since_ns) > self.config.handover_limit_ns;
            if input.vehicle.handover == HandoverProgress::Failed || too_long {
                self.handover_failed_ns = Some(input.now_ns);
            }
        } else if let Some(failed_ns) = self.handover_failed_ns
            && input.now_ns.saturating_sub(failed_ns) >= self.config.handover_pause_ns
        {
            self.handover_failed_ns = None;
        }
    }

    /// The conditions present in this step; [`crate::conditions::CONDITIONS`] states them in words.
    fn conditions(&mut self, input: &GuidanceInput<'_>, alarm: Option<Alarm>, action: Option<Action>) -> Reasons {
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
            && input.frame.doubts.is_empty()
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
        self.progress.dwelt = self
            .progress
            .stopped_ns
            .is_some_and(|at_ns| now_ns.saturating_sub(at_ns) >= self.config.no_progress_dwell_ns);
        self.dwelt = self
            .reached_ns
            .is_some_and(|at_ns| now_ns.saturating_sub(at_ns) >= self.config.goal_dwell_ns);
        let mode_lost = match self.state {
            GuidanceState::Guided | GuidanceState::Hold => !self.obeys(input),
            _ => false,
        };
        let pilot_in_command = match self.state {
            GuidanceState::Standby | GuidanceState::Ready => {
                self.taken_over || self.config.engage == EngagePolicy::Auto && !self.auto_may_take(input)
            }
            _ => false,
        };
        let slow_telemetry = input
            .vehicle
            .telemetry_interval_ns
            .is_some_and(|interval_ns| interval_ns > self.config.telemetry_age_limit_ns / 2);
        let recent_slips = self
            .slip_times_ns
            .iter()
            .flatten()
            .filter(|at_ns| now_ns.saturating_sub(**at_ns) <= self.config.slip_window_ns)
            .count();
        let flown_ns = self.flight_started_ns.map(|start_ns| now_ns.saturating_sub(start_ns));
        let too_long = matches!((flown_ns, self.config.time_limit_ns), (Some(flown), Some(limit)) if flown > limit);
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
            .union(input.frame.doubts)
    }

    fn note_verdict(&mut self, input: &GuidanceInput<'_>) -> Option<Alarm> {
        let kinematics = input.telemetry.kinematics;
        self.alarm.step(
            &self.config.alarm,
            &AlarmInput {
                now_ns: input.now_ns,
                verdict: input.verdict,
                risk: input.risk,
                smooth_share: input.smooth_share,
                yaw_apart: match (input.action, input.recovery) {
                    (Some(actor), Some(own)) => Some((actor.clipped().yaw - own.clipped().yaw).abs()),
                    _ => None,
                },
                // A hand-over in the air regains a flight; the alarm survives it.
                in_flight: self.in_flight() || self.state == GuidanceState::Engaging,
                // On a climb or descent on the spot the action leads nowhere.
                guided: self.state == GuidanceState::Guided && !self.changes_height(kinematics),
                speed_m_s: kinematics.map(|k| k.velocity_ned_m_s.norm()),
            },
        )
    }

    fn changes_height(&self, kinematics: Option<Kinematics>) -> bool {
        let places = self.goal.zip(kinematics);
        places.is_some_and(|(goal, kinematics)| changes_height(goal, kinematics.position_ned_m))
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
            .is_none_or(|nearest_m| distance_m <= nearest_m - self.config.no_progress_gain_m)
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

    fn obeys(&self, input: &GuidanceInput<'_>) -> bool {
        input
            .telemetry
            .heartbeat
            .is_some_and(|h| h.mode == VehicleMode::External)
    }

    fn disarmed(&self, input: &GuidanceInput<'_>) -> bool {
        input.telemetry.heartbeat.is_some_and(|h| !h.armed)
    }

    /// Tells the vehicle's failsafe of lost setpoints from every other, as its fence or its battery, which weighs more than the flight:
    /// it follows an interruption of the stream.
    fn note_failsafe(&mut self, input: &GuidanceInput<'_>, reasons: Reasons) {
        if reasons.contains(Reason::LinkLost) || reasons.contains(Reason::StaleTelemetry) {
            self.interrupted_ns = Some(input.now_ns);
        }
        let heartbeat = input.telemetry.heartbeat;
        let holds = heartbeat.is_some_and(|h| h.failsafe && h.armed && h.mode == VehicleMode::Hold);
        let interrupted = self
            .interrupted_ns
            .is_some_and(|at_ns| input.now_ns.saturating_sub(at_ns) < INTERRUPTION_NS);
        self.setpoints_lost = holds.then(|| self.setpoints_lost.unwrap_or(interrupted));
    }

    fn count_steps(&mut self, input: &GuidanceInput<'_>, reasons: Reasons) {
        self.note_failsafe(input, reasons);
        let count = |steps: &mut u16, holds: bool| *steps = if holds { steps.saturating_add(1) } else { 0 };
        let relevant = match self.state {
            GuidanceState::Standby => self.ready_conditions,
            _ => self.hold_conditions,
        };
        let mode_aside =
            Reasons(relevant.0 & !(Reasons::of(Reason::ModeLost).0 | Reasons::of(Reason::VehicleFailsafe).0));
        count(&mut self.clear_steps, !reasons.intersects(relevant));
        count(&mut self.regain_steps, !reasons.intersects(mode_aside));
        let released = self.state == GuidanceState::Hold && !reasons.contains(Reason::LinkLost) && !self.obeys(input);
        count(&mut self.released_steps, released);
    }

    /// Whether a transition's condition holds.
    fn holds(&self, guard: Guard, input: &GuidanceInput<'_>, reasons: Reasons, restarted: bool) -> bool {
        let heartbeat = input.telemetry.heartbeat;
        let unclear = reasons.intersects(self.hold_conditions);
        let done = input.vehicle.handover == HandoverProgress::Done && self.obeys(input) && !self.disarmed(input);
        let failsafe_hold =
            self.config.engage == EngagePolicy::Auto && self.intent && self.setpoints_lost == Some(true);
        match guard {
            Guard::VehicleRestarted => restarted,
            Guard::MotorsOff => reasons.contains(Reason::Disarmed),
            Guard::LandDemanded => self.operator_land || self.lands_without_progress() || self.must_land(reasons),
            Guard::LandingTakenOver => {
                self.landing_seen
                    && !reasons.contains(Reason::LinkLost)
                    && heartbeat.is_some_and(|h| h.mode != VehicleMode::Land)
            }
            Guard::Reengaged => self.intent && !self.must_land(reasons),
            Guard::HandoverFailed => reasons.contains(Reason::HandoverFailed),
            Guard::Disengaged => reasons.contains(Reason::Operator),
            Guard::HandedOver => done && !unclear,
            Guard::HandedOverUnclear => done && unclear,
            Guard::HoldDemanded => unclear,
            Guard::FailsafeHoldRegainable => failsafe_hold && self.regain_steps >= self.config.clear_steps,
            Guard::VehicleTaken => !failsafe_hold && self.released_steps >= self.config.release_steps,
            Guard::ClearLongEnough | Guard::InputsGood => self.clear_steps >= self.config.clear_steps,
            Guard::InputsMissing => reasons.intersects(self.ready_conditions),
            Guard::EngageWanted => {
                let permitted = self.asked || !reasons.contains(Reason::PilotInCommand);
                self.intent && permitted && !reasons.contains(Reason::HandoverFailed)
            }
        }
    }

    /// Whether landing is demanded by something that an operator's engage does not lift.
    fn must_land(&self, reasons: Reasons) -> bool {
        self.config.at_goal == AtGoal::Land && self.dwelt
            || reasons.contains(Reason::LowBattery)
            || reasons.contains(Reason::TimeLimit)
    }

    /// Whether landing is demanded because the vehicle did not get nearer to its goal; an operator's engage lifts it.
    fn lands_without_progress(&self) -> bool {
        self.config.on_no_progress == OnNoProgress::Land && self.progress.dwelt
    }

    /// `was_lost`: the vehicle was silent until this step.
    fn enter(&mut self, row: &Transition, now_ns: Nanos, was_lost: bool) {
        let auto = self.config.engage == EngagePolicy::Auto;
        let ended_by_restart = row.when == Guard::VehicleRestarted && self.returned_disarmed_ns.take().is_some();
        match (row.when, self.state) {
            (Guard::VehicleTaken | Guard::LandingTakenOver, _) => self.take_over(),
            // A landing that ends disarmed is the end of the flight, and of guidance's claim.
            (Guard::MotorsOff, GuidanceState::Land) => self.begun = false,
            (Guard::MotorsOff, _) if was_lost => self.returned_disarmed_ns = Some(now_ns),
            (Guard::MotorsOff, _) => self.take_over(),
            _ => {}
        }
        self.state = row.to;
        self.since_ns = now_ns;
        (self.clear_steps, self.regain_steps, self.released_steps) = (0, 0, 0);
        self.landing_seen = false;
        match row.intent {
            Intent::Keep => {}
            Intent::Clear => self.intent = false,
            Intent::Spend => self.intent &= auto,
            Intent::Renew => self.intent = auto && (self.intent || ended_by_restart),
        }
        match row.to {
            GuidanceState::Engaging => self.begun = true,
            GuidanceState::Standby => {
                self.asked = false;
                self.operator_land = false;
                self.operator &= row.when != Guard::VehicleRestarted;
                self.reached_ns = None;
                self.progress = Progress::default();
                self.flight_started_ns = None;
            }
            GuidanceState::Guided => self.flight_started_ns = self.flight_started_ns.or(Some(now_ns)),
            _ => {}
        }
    }

    fn setpoint(&self, input: &GuidanceInput<'_>, action: Option<Action>) -> Option<VelocitySetpoint> {
        match self.state {
            GuidanceState::Standby | GuidanceState::Ready => None,
            GuidanceState::Engaging => matches!(
                input.vehicle.handover,
                HandoverProgress::Done | HandoverProgress::InProgress { stream_setpoints: true }
            )
            .then_some(VelocitySetpoint::HOLD),
            GuidanceState::Guided => Some(self.guided_setpoint(input, action)),
            GuidanceState::Hold => Some(VelocitySetpoint::HOLD),
            // Zeros until the vehicle lands by itself: an autopilot may keep the last velocity for seconds.
            GuidanceState::Land => input
                .telemetry
                .heartbeat
                .is_none_or(|h| h.mode == VehicleMode::External)
                .then_some(VelocitySetpoint::HOLD),
        }
    }

    fn guided_setpoint(&self, input: &GuidanceInput<'_>, action: Option<Action>) -> VelocitySetpoint {
        let (Some(action), Some(goal), Some(kinematics)) = (action, self.goal, input.telemetry.kinematics) else {
            return VelocitySetpoint::HOLD;
        };
        guided_setpoint(&self.config, action, goal, kinematics.position_ned_m)
    }

    fn vehicle_request(&mut self, input: &GuidanceInput<'_>) -> VehicleRequest {
        match (self.state, self.goal) {
            (GuidanceState::Engaging, Some(goal)) => VehicleRequest::FlyExternal {
                takeoff_height_m: -goal.position_ned_m.z,
            },
            (GuidanceState::Land, _) => {
                let landing = input.telemetry.heartbeat.is_some_and(|h| h.mode == VehicleMode::Land);
                self.landing_seen |= landing;
                if landing {
                    VehicleRequest::None
                } else {
                    VehicleRequest::Land
                }
            }
            _ => VehicleRequest::None,
        }
    }
}

/// What an alarm is a reason for: the pilot that recovers, or a stop.
fn of_alarm(alarm: Alarm) -> Reasons {
    let reason = match (alarm.response, alarm.cause) {
        (AlarmResponse::Recovery, _) => Reason::Recovering,
        (AlarmResponse::Stop, AlarmCause::Attack) => Reason::Attack,
        (AlarmResponse::Stop, AlarmCause::NoVerdict) => Reason::NoVerdict,
        (AlarmResponse::Stop, AlarmCause::CollisionCourse) => Reason::CollisionCourse,
        (AlarmResponse::Stop, AlarmCause::LedAstray) => Reason::LedAstray,
        (AlarmResponse::Stop, AlarmCause::Disagreement) => Reason::Disagreement,
        (AlarmResponse::Stop, AlarmCause::RoughPicture) => Reason::RoughPicture,
    };
    Reasons::NONE.with_if(true, reason)
}
