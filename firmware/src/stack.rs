//! The flight stack: everything of one step between what came in and what goes out. No clock, no allocation, no panic,
//! no standard library: time, frames and datagrams are arguments.
#![deny(clippy::std_instead_of_core, clippy::alloc_instead_of_core)]

use crate::deciding::{Deciding, Decision, View};
use crate::frame_keeper::{FrameKeeper, Refusal};
use crate::guarding::{Guarded, Guarding, GuardingInput};
use crate::motion::Motion;
use crate::pilots::Pilots;
use crate::tunables::Tunables;
use alloc::boxed::Box;
use vigil_guidance::{
    ConfigError, FrameStatus, Guidance, GuidanceConfig, GuidanceInput, GuidanceOutput, JustStopConfig,
};
use vigil_mavlink::common::{COMMAND_LONG_DATA, MavCmd, MavMessage};
use vigil_mavlink::{Companion, CompanionConfig, LET_GO, MavHeader, framing};
use vigil_policy::{FlightPilot, GeometricConfig, GeometricPilot, PilotInput, PlausibilityCheck, SecondSensor};
use vigil_types::{
    Datagrams, DepthFrame, Duty, FrameDefect, FrameKeys, Goal, GuardNotice, GuidanceState, Nanos, NedVector,
    OperatorRequest, Reason, Reasons, RequestOutcome, StepReport, StepTiming, VehicleRequest, VehicleTelemetry,
    Verdict,
};

/// MAVLink's usual identity of a ground station.
const GROUND_STATION: MavHeader = MavHeader {
    system_id: 255,
    component_id: 190,
    sequence: 0,
};
/// A standing vehicle's height moves by less than this from step to step, metres.
const SAME_HEIGHT_M: f32 = 0.5;
/// A vehicle's system unless somebody changed it.
const DEFAULT_SYSTEM: u8 = 1;

/// What the flight stack is made from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StackConfig {
    /// The sensor whose frames are accepted.
    pub sensor_id: u32,
    /// Guidance.
    pub guidance: GuidanceConfig,
    /// MAVLink towards the vehicle.
    pub companion: CompanionConfig,
    /// The geometric pilot.
    pub pilot: GeometricConfig,
    /// Where to fly, from home; `None` waits for an operator.
    pub goal: Option<Goal>,
    /// Whether frames are checked before the pilots see them (docs/sensor-faults.md).
    pub plausibility: bool,
    /// Whether a second sensor must see nothing nearer than the frames show (docs/second-sensor.md).
    pub second_sensor: bool,
    /// Whether somebody else's flight is guarded while guidance has not the vehicle (docs/just-stop.md).
    pub duty: Duty,
    /// How a guarded vehicle stops.
    pub just_stop: JustStopConfig,
}

/// What one step gets.
#[derive(Debug, Clone, Copy)]
pub struct TickInput<'a> {
    /// Time of the step.
    pub now_ns: Nanos,
    /// What the loop measured of itself.
    pub timing: StepTiming,
    /// The frame that is new since the last step; unchecked.
    pub frame: Option<&'a DepthFrame>,
    /// In replay: the frame was found unauthenticated when it arrived; the key is not needed any more.
    pub frame_known_altered: bool,
    /// What the links received since the last step.
    pub received: &'a Datagrams,
}

/// What one step gives.
#[derive(Debug, Clone, Default)]
pub struct TickOutput {
    /// What was decided and why.
    pub report: StepReport,
    /// What to send.
    pub sent: Datagrams,
}

/// The flight stack. A large value without pointers: box it once at start.
pub struct FlightStack {
    pub(crate) frames: FrameKeeper,
    /// Checks each new frame; `None` when that is switched off.
    plausibility: Option<PlausibilityCheck>,
    /// Compares the frames with the second sensor; `None` where there is none.
    second_sensor: Option<SecondSensor>,
    pub(crate) companion: Companion,
    pub(crate) guidance: Guidance,
    /// Guards somebody else's flight; `None` when that is not its duty.
    guarding: Option<Guarding>,
    pub(crate) deciding: Deciding,
    /// Jumps of the odometry that were reported.
    forgotten: u32,
    tunables: Tunables,
    component_id: u8,
    link: u8,
}

impl FlightStack {
    /// A stack with the geometric pilot that has seen nothing yet.
    ///
    /// # Errors
    /// A guidance configuration that must not fly.
    pub fn new(config: &StackConfig) -> Result<Box<Self>, ConfigError> {
        Self::with_pilots(
            config,
            Pilots::unmonitored(FlightPilot::Geometric(GeometricPilot::new(config.pilot))),
        )
    }

    /// A stack with pilots that have seen nothing yet; it is too large for a thread's stack.
    ///
    /// # Errors
    /// A guidance configuration that must not fly, or a goal that it does not permit.
    pub fn with_pilots(config: &StackConfig, pilots: Pilots) -> Result<Box<Self>, ConfigError> {
        let tunables = Tunables::of(
            config,
            pilots.monitor.as_ref().map(|monitor| monitor.threshold()),
            pilots.monitored,
        );
        let mut guidance = Guidance::new(tunables.guidance(&config.guidance))?;
        if let Some(Goal { position_ned_m }) = config.goal {
            let outcome = guidance.request(OperatorRequest::Goal {
                north_m: position_ned_m.x,
                east_m: position_ned_m.y,
                height_m: Some(-position_ned_m.z),
            });
            match outcome {
                RequestOutcome::Accepted => {}
                RequestOutcome::TooFar { distance_m, limit_m } => {
                    return Err(ConfigError::GoalTooFar { distance_m, limit_m });
                }
                RequestOutcome::Denied | RequestOutcome::TemporarilyRejected => return Err(ConfigError::GoalDenied),
            }
        }
        Ok(Box::new(Self {
            frames: FrameKeeper::new(config.sensor_id),
            plausibility: config.plausibility.then(PlausibilityCheck::default),
            second_sensor: config.second_sensor.then(SecondSensor::default),
            companion: Companion::new(config.companion).with_parameters(tunables.parameters()),
            tunables,
            guidance,
            guarding: (config.duty != Duty::Fly).then(|| Guarding::new(config.just_stop)),
            deciding: Deciding::new(pilots),
            forgotten: 0,
            component_id: config.companion.component_id,
            link: config.companion.link,
        }))
    }

    /// One step: what came in, what is known of the vehicle, what the pilots want, what guidance permits, what goes out.
    pub fn tick(&mut self, input: &TickInput<'_>, output: &mut TickOutput) {
        let now_ns = input.now_ns;
        let taken = input
            .frame
            .map(|frame| self.frames.take(frame, input.frame_known_altered, now_ns));
        self.receive(now_ns, input.received);
        let seen = self.observe(now_ns, taken);
        let decided = self.decide(&seen);
        let guided = self.guidance.step(&self.guidance_input(input.timing, &seen, &decided));
        let guarded = self.guard(&seen, &guided);
        self.deciding.note(guided.alarm);
        output.report = self.report(input.timing, &seen, &decided, &guided, &guarded);
        self.emit(&decided, &guided, &guarded, output);
    }

    /// Takes what the links received; answers what operators ask.
    fn receive(&mut self, now_ns: Nanos, received: &Datagrams) {
        for (link, datagram) in received.iter() {
            self.companion.receive(now_ns, link, datagram);
        }
        // As many as were queued: the companion's queue is bounded.
        while let Some(pending) = self.companion.take_request() {
            let outcome = self.guidance.request(pending.request());
            self.companion.answer(&pending, outcome);
        }
        if self.companion.parameters().take_changed() {
            self.tune();
        }
    }

    /// What is known now of the vehicle, its surroundings and its goal, and what is doubtful about it.
    fn observe(&mut self, now_ns: Nanos, taken: Option<Result<(), Refusal>>) -> Observation {
        let mut telemetry = *self.companion.telemetry();
        let limits = *self.guidance.config();
        let is_new = taken == Some(Ok(()));
        self.correct_heading(&mut telemetry, is_new);
        let sensor_faults = match (&mut self.plausibility, self.frames.newest()) {
            (Some(plausibility), Some(frame)) if is_new => {
                let agrees = self.companion.vehicle().estimate_agrees_with_itself();
                plausibility.note_estimate(self.guidance.home_ned_m().z, agrees);
                plausibility.check(frame, &telemetry)
            }
            (Some(plausibility), _) => plausibility.sensor_faults(&telemetry),
            (None, _) => Reasons::NONE,
        };
        self.correct_velocity(now_ns, &mut telemetry);
        let motion = Motion::of(&telemetry, now_ns, limits.telemetry_age_limit_ns);
        let sensor_faults = sensor_faults.union(self.second_opinion(now_ns, &telemetry, motion));
        let goal = self.guidance.goal();
        let is_fresh = self.frames.fresh(now_ns, limits.frame_age_limit_ns).is_some() && sensor_faults.is_empty();
        Observation {
            now_ns,
            telemetry,
            motion,
            goal,
            view: motion.zip(goal).filter(|_| is_fresh).map(|(motion, goal)| View {
                goal: goal.relative_to(&motion.kinematics, &motion.sample),
                goal_ned_m: goal.position_ned_m,
                motion,
            }),
            smooth_share: match &self.plausibility {
                Some(plausibility) if is_new => plausibility.smooth_share(),
                _ => None,
            },
            frame: FrameStatus {
                age_ns: self.frames.newest().map(|f| now_ns.saturating_sub(f.header.stamp_ns)),
                refused: matches!(taken, Some(Err(_))),
                unauthenticated: taken == Some(Err(Refusal::Defect(FrameDefect::BadTag))),
                sensor_faults,
            },
            is_fresh,
        }
    }

    /// The heading as the rates have it where the vehicle's report errs, in telemetry and the new frame alike.
    fn correct_heading(&mut self, telemetry: &mut VehicleTelemetry, is_new: bool) {
        let lacks_rad = self.companion.vehicle().heading_lacks_rad();
        if lacks_rad == 0.0 {
            return;
        }
        if let Some(sample) = &mut telemetry.attitude {
            sample.attitude = sample.attitude.turned_heading(lacks_rad);
        }
        if is_new {
            self.frames.correct_heading(lacks_rad);
        }
    }

    /// The velocity as the pictures have it, where an estimate errs, in telemetry and in what is asked of the vehicle alike. Without a fresh
    /// picture nobody knows what it is off by now.
    fn correct_velocity(&mut self, now_ns: Nanos, telemetry: &mut VehicleTelemetry) {
        let fresh = self.frames.fresh(now_ns, self.guidance.config().frame_age_limit_ns);
        let plausibility = self.plausibility.as_ref().filter(|_| fresh.is_some());
        let error_m_s = plausibility.map_or(NedVector::ZERO, PlausibilityCheck::velocity_error_m_s);
        self.companion.note_seen_error(error_m_s);
        if let Some(kinematics) = &mut telemetry.kinematics {
            kinematics.velocity_ned_m_s = kinematics.velocity_ned_m_s - error_m_s;
        }
    }

    /// Asks the pilots. Frames taken on the ground show the ground at the vehicle's own height: nobody looks before the vehicle is handed
    /// over.
    fn decide(&mut self, seen: &Observation) -> Decision {
        let before_flight = matches!(self.guidance.state(), GuidanceState::Standby | GuidanceState::Ready);
        let flying = self.guidance.expects_action(self.companion.handover());
        let asked = seen.view.filter(|_| flying).zip(self.frames.newest());
        // Home is on the ground, wherever the estimator began.
        let home_ned_m = self.guidance.home_ned_m();
        let asked = asked.map(|(view, depth)| {
            let input = PilotInput {
                goal: view.goal,
                ..view.motion.pilot_input(seen.now_ns, depth, home_ned_m)
            };
            (view, input)
        });
        let restored = self.plausibility.as_ref().and_then(PlausibilityCheck::restored);
        self.deciding
            .decide(before_flight, asked, restored, self.tunables.speed_limit_m_s)
    }

    fn guidance_input<'a>(&self, timing: StepTiming, seen: &'a Observation, decided: &Decision) -> GuidanceInput<'a> {
        // A monitored pilot that was not asked has no verdict, and no verdict is not a clean one.
        let verdict = decided
            .judgement
            .map_or(Verdict::Unknown, |judgement| judgement.verdict);
        GuidanceInput {
            now_ns: seen.now_ns,
            telemetry: &seen.telemetry,
            frame: seen.frame,
            action: decided.action,
            recovery: decided.recovery,
            verdict: self.deciding.pilots.monitor.as_ref().map(|_| verdict),
            risk: decided.risk,
            smooth_share: seen.smooth_share,
            timing,
            vehicle: self.companion.vehicle_status(),
        }
    }

    fn report(
        &self,
        timing: StepTiming,
        seen: &Observation,
        decided: &Decision,
        guided: &GuidanceOutput,
        guarded: &Guarded,
    ) -> StepReport {
        StepReport {
            now_ns: seen.now_ns,
            timing,
            state: guided.state,
            reasons: guided.reasons.union(guarded.reasons),
            telemetry: seen.telemetry,
            goal: seen.goal,
            goal_relative: seen.view.map(|view| view.goal),
            action: guided.action,
            judgement: decided.judgement,
            alarm: guided.alarm,
            setpoint: guided.setpoint,
            frame_sequence: self.frames.newest().map(|frame| frame.header.sequence),
            frame_age_ns: seen.frame.age_ns,
            frames_refused: self.frames.refusals().total(),
        }
    }

    /// What goes out: setpoint, request, texts, what stands around the vehicle.
    fn emit(&mut self, decided: &Decision, guided: &GuidanceOutput, guarded: &Guarded, output: &mut TickOutput) {
        let TickOutput { report, sent } = output;
        sent.clear();
        let request = match guided.request {
            VehicleRequest::None => guarded.request,
            own => own,
        };
        self.companion.emit(report, request, sent);
        if let Some(notice) = guarded.notice {
            self.companion.tell_of_guard(notice, sent);
        }
        let pilot = &self.deciding.pilots.pilot;
        let forgotten = pilot.actor().map_or(0, |actor| actor.forgotten());
        if self.forgotten != forgotten {
            self.forgotten = forgotten;
            self.companion.tell_of_guard(GuardNotice::Jumped, sent);
        }
        let looked = match (&self.guarding, decided.action) {
            (_, Some(_)) => Some(pilot.surroundings().scan()),
            (Some(guarding), None) if guarded.looked => Some(guarding.scan()),
            _ => None,
        };
        let sectors = looked.map(|scan| {
            let directions = scan.direction_right.iter().zip(&scan.direction_forward);
            directions
                .zip(&scan.range_m)
                .map(|((right, forward), range_m)| (libm::atan2f(*right, *forward), *range_m))
        });
        self.companion.emit_obstacles(report.now_ns, sectors, sent);
    }

    /// What the second sensor has against the frames.
    fn second_opinion(&mut self, now_ns: Nanos, telemetry: &VehicleTelemetry, motion: Option<Motion>) -> Reasons {
        let Some(second) = &mut self.second_sensor else {
            return Reasons::NONE;
        };
        let input = motion
            .zip(self.frames.fresh(now_ns, self.guidance.config().frame_age_limit_ns))
            .map(|(motion, depth)| motion.pilot_input(now_ns, depth, self.guidance.home_ned_m()));
        second.check(
            now_ns,
            &self.companion.vehicle().sector_ranges,
            input.as_ref(),
            telemetry.is_airborne(),
        )
    }

    /// Guards somebody else's flight, and takes a mission around what stopped it.
    fn guard(&mut self, seen: &Observation, guidance: &GuidanceOutput) -> Guarded {
        let duty = self.tunables.duty();
        let Some(guarding) = self.guarding.as_mut().filter(|_| duty != Duty::Fly) else {
            return Guarded::default();
        };
        let input = GuardingInput {
            now_ns: seen.now_ns,
            telemetry: &seen.telemetry,
            motion: seen.motion,
            drifts: self.plausibility.as_ref().is_some_and(PlausibilityCheck::estimate_errs),
            frame: self.frames.newest().filter(|_| seen.is_fresh),
            flies_around: duty == Duty::FlyAround,
            mission_place_m: self.companion.vehicle().mission_place_m(),
            mission_motion: self.companion.vehicle().mission_motion,
        };
        if !matches!(guidance.state, GuidanceState::Standby | GuidanceState::Ready) {
            let guided = guidance.state == GuidanceState::Guided;
            let reached = guidance.state == GuidanceState::Hold && guidance.reasons.contains(Reason::GoalReached);
            let request = guarding.accompany(&input, guided, reached);
            if request == VehicleRequest::Resume {
                self.guidance.hands_back();
            }
            return Guarded {
                request,
                ..Guarded::default()
            };
        }
        let mut guarded = guarding.step(&input);
        if let Some((north_m, east_m, height_m)) = guarded.fly_to_m {
            let known = self.guidance.goal().is_some_and(|Goal { position_ned_m: at }| {
                (at.x, at.y) == (north_m, east_m) && (at.z + height_m).abs() < SAME_HEIGHT_M
            });
            let outcome = if known {
                self.guidance.request(OperatorRequest::Engage)
            } else {
                self.guidance.request(OperatorRequest::FixedGoal {
                    north_m,
                    east_m,
                    height_m: Some(height_m),
                })
            };
            if known && outcome == RequestOutcome::Accepted {
                guarding.engaged();
                guarded.notice = Some(GuardNotice::FliesAround);
            }
        }
        guarded
    }

    /// Takes over the parameters that an operator set.
    fn tune(&mut self) {
        let before = self.tunables;
        self.tunables.take(self.companion.parameters());
        // Cannot fail: the parameters' ranges are guidance's.
        let _ = self
            .guidance
            .reconfigure(self.tunables.guidance(self.guidance.config()));
        if let (Some(guarding), Duty::Fly) = (&mut self.guarding, self.tunables.duty())
            && before.duty() != Duty::Fly
            && guarding.reset()
        {
            // The vehicle hovers where its detour was, and a person decides.
            let _ = self.guidance.request(OperatorRequest::Disengage);
        }
        if let (Some(monitor), Some(threshold)) = (&mut self.deciding.pilots.monitor, self.tunables.threshold) {
            monitor.set_threshold(threshold);
        }
        if let FlightPilot::Geometric(pilot) = &mut self.deciding.pilots.pilot
            && self.tunables.pilot != before.pilot
        {
            // Set on the ground only, where the pilot remembers nothing of use.
            *pilot = GeometricPilot::new(self.tunables.pilot);
        }
    }

    /// From now on takes only frames that were made with one of these keys, if there are any.
    pub fn require_frame_keys(&mut self, keys: FrameKeys) {
        self.frames.require(keys);
    }

    /// Appends the command of a person at the terminal who disengages guidance and has the vehicle hold by itself. It is meant for
    /// [`TickInput::received`]: it enters the stack as any operator's does, and the log has it.
    pub fn disengage_command(&self, received: &mut Datagrams) {
        let command = MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
            command: MavCmd::MAV_CMD_NAV_GUIDED_ENABLE,
            param2: LET_GO,
            target_system: self.companion.system_id().unwrap_or(DEFAULT_SYSTEM),
            target_component: self.component_id,
            ..COMMAND_LONG_DATA::DEFAULT
        });
        let mut packet = [0; framing::MAX_PACKET_LEN];
        // Every packet fits MAX_PACKET_LEN.
        let len = framing::serialize(GROUND_STATION, &command, &mut packet).unwrap_or(0);
        if let Some(datagram) = packet.get(..len) {
            received.push(self.link, datagram);
        }
    }

    /// The last packets before the firmware ends, after its last tick.
    pub fn shut_down(&mut self, now_ns: Nanos, sent: &mut Datagrams) {
        sent.clear();
        self.companion.shutdown(now_ns, sent);
    }
}

/// What is known in a step.
struct Observation {
    now_ns: Nanos,
    telemetry: VehicleTelemetry,
    /// Position, velocity and attitude, when they are fresh and finite.
    motion: Option<Motion>,
    goal: Option<Goal>,
    /// What the pilots need besides the frame, when everything is there, fresh, finite and plausible: then, and only then, guidance
    /// expects an action of them.
    view: Option<View>,
    /// Share of one surface among the cells of this step's new frame; `None` without one.
    smooth_share: Option<f32>,
    frame: FrameStatus,
    /// The newest frame is fresh, and nothing is implausible about it.
    is_fresh: bool,
}
