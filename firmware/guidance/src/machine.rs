//! The state machine: evaluates conditions, takes the first transition that fits, says what is sent.

mod present;
mod requests;

use crate::alarm::{AlarmLogic, count};
use crate::conditions::{Demand, HANDOVER_LIMIT_NS, HANDOVER_PAUSE_NS, blocking_ready, demanding};
use crate::config::{ConfigError, GuidanceConfig};
use crate::input::{GuidanceInput, GuidanceOutput};
use crate::setpoint::{changes_height, guided_setpoint};
use crate::table::{Guard, Intent, TRANSITIONS, Transition};
use vigil_types::{
    Action, Alarm, AlarmResponse, AtGoal, EngagePolicy, Goal, GuidanceState, HandoverProgress, Kinematics, Nanos,
    NedVector, OnNoProgress, Reason, Reasons, VehicleMode, VehicleRequest, VelocitySetpoint,
};

/// A vehicle that comes back disarmed after silence restarted, if its clock says so within this time; else somebody
/// disarmed it.
const RESTART_SHOWS_NS: Nanos = 2_000_000_000;
/// A vehicle in the air whose autopilot started less than this ago did not take off: it is a simulation that begins there.
const BORN_AIRBORNE_NS: Nanos = 30_000_000_000;
/// *Auto* gives a vehicle on the ground this long from *ready* on to report its home: a PX4 does every other second.
const HOME_COMES_NS: Nanos = 2_500_000_000;
/// Longest time between two steps that counts as flown, against clocks that jump.
const LONGEST_STEP_NS: Nanos = 1_000_000_000;
/// Missed steps that are remembered; [`GuidanceConfig::slip_limit`] is at most this.
const SLIPS_REMEMBERED: usize = 8;
/// A failsafe hold within this time after the stream of setpoints was interrupted is for that: the longest limit that a PX4 may have, and the
/// second between two heartbeats.
const INTERRUPTION_NS: Nanos = 6_000_000_000;
/// Consecutive steps without a blocking condition before standby ends and before hold ends; of zero setpoints after the vehicle left its
/// external mode, before guidance falls silent.
const CLEAR_STEPS: u16 = 10;
const RELEASE_STEPS: u16 = 10;

/// What a goal is relative to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Datum {
    Home,
    Origin,
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

/// The state machine. Plain data; time only comes in as an argument. By default it stands by, without a goal.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Guidance {
    config: GuidanceConfig,
    state: GuidanceState,
    since_ns: Nanos,
    goal: Option<Goal>,
    /// The goal as it was given.
    given: Option<(Datum, NedVector)>,
    /// Home as far as the goal and the fence are concerned; the local origin until the vehicle reports it.
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
    /// The vehicle is given back to its own mission: who has it then did not take it.
    handed_back: bool,
    /// Whether the vehicle is armed, and its mode, while it is being taken.
    engaged_as: Option<(bool, VehicleMode)>,
    hand_over_taken: bool,
    /// When the vehicle came back disarmed after silence.
    returned_disarmed_ns: Option<Nanos>,
    /// An operator disengaged or ordered to land.
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
            intent: config.engage == EngagePolicy::Auto,
            taken_over: config.taken_over,
            ..Self::default()
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

    /// One step of the loop.
    pub fn step(&mut self, input: &GuidanceInput<'_>) -> GuidanceOutput {
        let restarted =
            self.restarts.replace(input.vehicle.restarts) != Some(input.vehicle.restarts) && input.vehicle.restarts > 0;
        self.note_home(input, restarted);
        self.note_return(input.now_ns);
        self.note_who_has_it(input);
        self.note_slips(input);
        self.note_hand_over(input);
        let alarm = self.note_verdict(input);
        let recovers = alarm.is_some_and(|alarm| alarm.response == AlarmResponse::Recovery);
        let action = if recovers { input.recovery } else { input.action };
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
        self.flying_to_goal() || self.state == GuidanceState::Land
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

    /// Who disarms a vehicle that is being taken, or puts it into a mode that no hand-over leads to, keeps it.
    fn note_who_has_it(&mut self, input: &GuidanceInput<'_>) {
        use VehicleMode::{External, Hold, Takeoff, Unknown};
        let heartbeat = input
            .telemetry
            .heartbeat
            .filter(|_| self.state == GuidanceState::Engaging);
        let now = heartbeat.map(|h| (h.armed, h.mode));
        self.hand_over_taken = match (core::mem::replace(&mut self.engaged_as, now), heartbeat) {
            (Some((was_armed, before)), Some(h)) => {
                let leaves = match (before, h.mode) {
                    (External, Hold) => !h.failsafe,
                    (before, mode) => mode != before && !matches!(mode, External | Hold | Takeoff | Unknown),
                };
                was_armed && !h.armed || leaves
            }
            _ => false,
        };
    }

    /// The vehicle is given back to its own mission: that it leaves the external mode then is nobody's take-over.
    pub fn hands_back(&mut self) {
        self.handed_back = true;
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
            // A climb takes its time.
            let climb_m = self.goal.map_or(0.0, |goal| self.home_ned_m.z - goal.position_ned_m.z);
            let limit_ns = HANDOVER_LIMIT_NS + (climb_m.max(0.0) * 1e9) as Nanos;
            let too_long = input.now_ns.saturating_sub(self.since_ns) > limit_ns;
            if input.vehicle.handover == HandoverProgress::Failed || too_long {
                self.handover_failed_ns = Some(input.now_ns);
            }
        } else if let Some(failed_ns) = self.handover_failed_ns
            && input.now_ns.saturating_sub(failed_ns) >= HANDOVER_PAUSE_NS
        {
            self.handover_failed_ns = None;
        }
    }

    fn note_verdict(&mut self, input: &GuidanceInput<'_>) -> Option<Alarm> {
        // A hand-over in the air regains a flight; the alarm survives it.
        let in_flight = self.in_flight() || self.state == GuidanceState::Engaging;
        // On a climb or descent on the spot the action leads nowhere.
        let guided = self.state == GuidanceState::Guided && !self.changes_height(input.telemetry.kinematics);
        self.alarm.step(&self.config.alarm, input, in_flight, guided)
    }

    fn changes_height(&self, kinematics: Option<Kinematics>) -> bool {
        let places = self.goal.zip(kinematics);
        places.is_some_and(|(goal, kinematics)| changes_height(goal, kinematics.position_ned_m))
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

    /// Distinguishes the vehicle's failsafe of lost setpoints from every other, as its fence or its battery, which weighs more than the flight:
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
        let relevant = match self.state {
            GuidanceState::Standby => blocking_ready(),
            _ => demanding(Demand::Hold),
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
        let unclear = reasons.intersects(demanding(Demand::Hold));
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
            Guard::HandOverTaken => self.hand_over_taken,
            Guard::HandoverFailed => reasons.contains(Reason::HandoverFailed),
            Guard::Disengaged => reasons.contains(Reason::Operator),
            Guard::HandedOver => done && !unclear,
            Guard::HandedOverUnclear => done && unclear,
            Guard::HoldDemanded => unclear,
            Guard::FailsafeHoldRegainable => failsafe_hold && self.regain_steps >= CLEAR_STEPS,
            Guard::VehicleTaken => !failsafe_hold && self.released_steps >= RELEASE_STEPS,
            Guard::ClearLongEnough | Guard::InputsGood => self.clear_steps >= CLEAR_STEPS,
            Guard::InputsMissing => reasons.intersects(blocking_ready()),
            Guard::EngageWanted => {
                let ready_ns = input.now_ns.saturating_sub(self.since_ns);
                let has_home = self.home_known || input.telemetry.is_airborne() || ready_ns >= HOME_COMES_NS;
                let permitted = self.asked || has_home && !reasons.contains(Reason::PilotInCommand);
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
            (Guard::VehicleTaken, _) if self.handed_back => self.begun = false,
            (Guard::HandOverTaken, _) if was_lost => self.returned_disarmed_ns = Some(now_ns),
            (Guard::VehicleTaken | Guard::LandingTakenOver | Guard::HandOverTaken, _) => self.take_over(),
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
            GuidanceState::Engaging => (self.begun, self.handed_back) = (true, false),
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
            GuidanceState::Guided => Some(match (action, self.goal, input.telemetry.kinematics) {
                (Some(action), Some(goal), Some(now)) => {
                    guided_setpoint(&self.config, action, goal, now.position_ned_m)
                }
                _ => VelocitySetpoint::HOLD,
            }),
            GuidanceState::Hold => Some(VelocitySetpoint::HOLD),
            // Zeros until the vehicle lands by itself: an autopilot may keep the last velocity for seconds.
            GuidanceState::Land => input
                .telemetry
                .heartbeat
                .is_none_or(|h| h.mode == VehicleMode::External)
                .then_some(VelocitySetpoint::HOLD),
        }
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
