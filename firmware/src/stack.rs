//! The flight stack: everything of one step between what came in and what goes out. No clock, no allocation, no panic,
//! no standard library: time, frames and datagrams are arguments.
#![deny(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::std_instead_of_core,
    clippy::alloc_instead_of_core
)]

use crate::frame_keeper::{FrameKeeper, FrameRefusals, Refusal};
use crate::guarding::{Guarded, Guarding, GuardingInput};
use crate::leg::{LedTo, Leg, along_path, turned_to_path};
use crate::motion::Motion;
use crate::pilots::Pilots;
use crate::tunables::Tunables;
use vigil_guidance::{
    ConfigError, FrameStatus, Guidance, GuidanceConfig, GuidanceInput, GuidanceOutput, JustStopConfig,
};
use vigil_mavlink::common::{COMMAND_LONG_DATA, MavCmd, MavMessage};
use vigil_mavlink::{Companion, CompanionConfig, LET_GO, LinkCounters, MavHeader, Parameters, StatusText, framing};
use vigil_policy::actor::Actor;
use vigil_policy::{FlightPilot, GeometricConfig, GeometricPilot, Pilot, PilotInput, PlausibilityJudge, SecondSensor};
use vigil_types::{
    Action, AlarmResponse, Datagrams, DepthFrame, Duty, FrameDefect, FrameKeys, Goal, GoalRelative, GuardNotice,
    GuidanceState, Judgement, Nanos, NedVector, OperatorRequest, Reason, Reasons, RequestOutcome, StepReport,
    StepTiming, VehicleRequest, VehicleTelemetry, Verdict,
};

/// MAVLink's usual identity of a ground station.
const GROUND_STATION: MavHeader = MavHeader {
    system_id: 255,
    component_id: 190,
    sequence: 0,
};
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
    /// Greatest speed that any pilot's action may have, metres per second.
    pub speed_limit_m_s: f32,
    /// Where to fly, from home; `None` waits for an operator.
    pub goal: Option<Goal>,
    /// Whether frames are judged before the pilots see them (docs/sensor-faults.md).
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
    frames: FrameKeeper,
    /// Judges each new frame; `None` when that is switched off.
    plausibility: Option<PlausibilityJudge>,
    /// Compares the frames with the second sensor; `None` where there is none.
    second_sensor: Option<SecondSensor>,
    companion: Companion,
    guidance: Guidance,
    /// Guards somebody else's flight; `None` when that is not its duty.
    guarding: Option<Guarding>,
    pilots: Pilots,
    /// The vehicle was flown by the recovery pilot, or by an imported policy along its path, in the step before.
    along_path: bool,
    /// The recovery pilot flew since the alarm was raised; while the vehicle stops for its own course too.
    recovery_flew: bool,
    /// The pilot was asked in the step before.
    pilot_asked: bool,
    /// Jumps of the odometry that were told of.
    forgotten: u32,
    /// What an imported policy follows to a far goal.
    leg: Leg,
    /// The recovery pilot has seen nothing since its last reset.
    recovery_is_new: bool,
    tunables: Tunables,
    component_id: u8,
    link: u8,
}

impl FlightStack {
    /// A stack with the geometric pilot that has seen nothing yet.
    ///
    /// # Errors
    /// A guidance configuration that must not fly.
    pub fn new(config: &StackConfig) -> Result<Self, ConfigError> {
        Self::with_pilots(
            config,
            Pilots::unwatched(FlightPilot::Geometric(GeometricPilot::new(config.pilot))),
        )
    }

    /// A stack with pilots that have seen nothing yet.
    ///
    /// # Errors
    /// A guidance configuration that must not fly, or a goal that it does not permit.
    pub fn with_pilots(config: &StackConfig, pilots: Pilots) -> Result<Self, ConfigError> {
        let mut guidance = Guidance::new(config.guidance)?;
        let tunables = Tunables::of(
            config,
            pilots.monitor.as_ref().map(|monitor| monitor.threshold()),
            pilots.watched,
        );
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
        Ok(Self {
            frames: FrameKeeper::new(config.sensor_id),
            plausibility: config.plausibility.then(PlausibilityJudge::new),
            second_sensor: config.second_sensor.then(SecondSensor::new),
            companion: Companion::new(config.companion).with_parameters(tunables.parameters()),
            tunables,
            guidance,
            guarding: (config.duty != Duty::Fly).then(|| Guarding::new(config.just_stop)),
            pilots,
            along_path: false,
            recovery_flew: false,
            pilot_asked: false,
            forgotten: 0,
            leg: Leg::default(),
            recovery_is_new: true,
            component_id: config.companion.component_id,
            link: config.companion.link,
        })
    }

    /// One step: what came in, what is known of the vehicle, what the pilot wants, what guidance permits, what goes out.
    pub fn tick(&mut self, input: &TickInput<'_>, output: &mut TickOutput) {
        let now_ns = input.now_ns;

        // Acquire.
        let outcome = input
            .frame
            .map(|frame| self.frames.take(frame, input.frame_known_altered, now_ns));
        let taken = outcome.map(|outcome| outcome.is_ok());
        let refused = taken == Some(false);
        let unauthenticated = outcome == Some(Err(Refusal::Defect(FrameDefect::BadTag)));
        for (link, datagram) in input.received.iter() {
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
        let telemetry = *self.companion.telemetry();
        let frame_age_ns = self.frames.newest().map(|f| now_ns.saturating_sub(f.header.stamp_ns));

        // Judge the frame.
        let doubts = match (&mut self.plausibility, self.frames.newest()) {
            (Some(judge), Some(frame)) if taken == Some(true) => judge.judge(frame, &telemetry),
            (Some(judge), _) => judge.doubts(),
            (None, _) => Reasons::NONE,
        };
        let doubts = doubts.union(self.second_opinion(now_ns, &telemetry));

        // Pilot.
        let goal = self.guidance.goal();
        let view = if doubts.is_empty() {
            self.view(now_ns, &telemetry, goal.as_ref())
        } else {
            None
        };
        // Frames taken on the ground show the ground at the vehicle's own height: nobody looks before the vehicle is handed over.
        let flying = self.guidance.expects_action(self.companion.handover());
        let Decision {
            action,
            recovery,
            judgement,
            collision_course,
            recovery_course,
            speed_along_way_m_s,
        } = self.decide(now_ns, view.filter(|_| flying));
        // A watched pilot that was not asked has no verdict, and no verdict is not a clean one.
        let verdict = judgement.map_or(Verdict::Unknown, |judgement| judgement.verdict);

        // Guide.
        let guidance = self.guidance.step(&GuidanceInput {
            now_ns,
            telemetry: &telemetry,
            frame: FrameStatus {
                age_ns: frame_age_ns,
                refused,
                unauthenticated,
                doubts,
            },
            action,
            recovery,
            verdict: self.pilots.monitor.as_ref().map(|_| verdict),
            collision_course,
            recovery_course,
            speed_along_way_m_s,
            smooth_share: match (&self.plausibility, taken) {
                (Some(judge), Some(true)) => judge.smooth_share(),
                _ => None,
            },
            timing: input.timing,
            handover: self.companion.handover(),
            vehicle_restarts: self.companion.vehicle_restarts(),
            vehicle_up_ns: self.companion.vehicle_up_ns(),
            home_ned_m: self.companion.home_ned_m(),
            telemetry_interval_ns: self.companion.telemetry_interval_ns(),
        });

        let guards = self.guard(now_ns, &telemetry, doubts, &guidance);

        self.recovery_flew = guidance.alarm.is_some_and(|alarm| match alarm.response {
            AlarmResponse::Recovery => true,
            AlarmResponse::Stop => self.recovery_flew,
            AlarmResponse::Ignored => false,
        });
        self.along_path = match guidance.alarm {
            Some(_) => self.recovery_flew,
            None => self.pilot_asked && self.leg.is_by_path(),
        };

        // Emit.
        output.report = StepReport {
            now_ns,
            timing: input.timing,
            state: guidance.state,
            reasons: guidance.reasons.union(guards.reasons),
            telemetry,
            goal,
            goal_relative: view.map(|view| view.goal),
            action: guidance.action,
            judgement,
            alarm: guidance.alarm,
            setpoint: guidance.setpoint,
            frame_sequence: self.frames.newest().map(|frame| frame.header.sequence),
            frame_age_ns,
            frames_refused: self.frames.refused(),
        };
        output.sent.clear();
        let request = match guidance.request {
            VehicleRequest::None => guards.request,
            own => own,
        };
        self.companion.emit(&output.report, request, &mut output.sent);
        if let Some(notice) = guards.notice {
            self.companion.tell_of_guard(notice, &mut output.sent);
        }
        let forgotten = self.pilots.pilot.forgotten();
        if self.forgotten != forgotten {
            self.forgotten = forgotten;
            self.companion.tell_of_guard(GuardNotice::Jumped, &mut output.sent);
        }
        let looked = match (&self.guarding, action) {
            (_, Some(_)) => Some(self.pilots.pilot.surroundings().scan()),
            (Some(guarding), None) if guards.looked => Some(guarding.scan()),
            _ => None,
        };
        let sectors = looked.map(|scan| {
            let directions = scan.direction_right.iter().zip(&scan.direction_forward);
            directions
                .zip(&scan.range_m)
                .map(|((right, forward), range_m)| (libm::atan2f(*right, *forward), *range_m))
        });
        self.companion.emit_obstacles(now_ns, sectors, &mut output.sent);
    }

    /// What the second sensor has against the frames.
    fn second_opinion(&mut self, now_ns: Nanos, telemetry: &VehicleTelemetry) -> Reasons {
        let Some(second) = &mut self.second_sensor else {
            return Reasons::NONE;
        };
        let limits = self.guidance.config();
        let input = Motion::of(telemetry, now_ns, limits.telemetry_age_limit_ns)
            .zip(self.frames.fresh(now_ns, limits.frame_age_limit_ns))
            .map(|(motion, depth)| motion.pilot_input(now_ns, depth, self.guidance.home_ned_m()));
        second.judge(
            now_ns,
            self.companion.sector_ranges(),
            input.as_ref(),
            telemetry.is_airborne(),
        )
    }

    /// Guards somebody else's flight, and takes a mission around what stopped it.
    fn guard(
        &mut self,
        now_ns: Nanos,
        telemetry: &VehicleTelemetry,
        doubts: Reasons,
        guidance: &GuidanceOutput,
    ) -> Guarded {
        let limits = *self.guidance.config();
        let duty = self.tunables.duty();
        let Some(guarding) = self.guarding.as_mut().filter(|_| duty != Duty::Fly) else {
            return Guarded::default();
        };
        let input = GuardingInput {
            now_ns,
            telemetry,
            motion: Motion::of(telemetry, now_ns, limits.telemetry_age_limit_ns),
            frame: self
                .frames
                .fresh(now_ns, limits.frame_age_limit_ns)
                .filter(|_| doubts.is_empty()),
            flies_around: duty == Duty::FlyAround,
            mission_place_m: self.companion.mission_place_m(),
        };
        if !matches!(guidance.state, GuidanceState::Standby | GuidanceState::Ready) {
            let guided = guidance.state == GuidanceState::Guided;
            let reached = guidance.state == GuidanceState::Hold && guidance.reasons.contains(Reason::GoalReached);
            return Guarded {
                request: guarding.accompany(&input, guided, reached),
                ..Guarded::default()
            };
        }
        let mut guarded = guarding.step(&input);
        if let Some((north_m, east_m, height_m)) = guarded.fly_to_m {
            let known = self
                .guidance
                .goal()
                .is_some_and(|goal| (goal.position_ned_m.x, goal.position_ned_m.y) == (north_m, east_m));
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
        if let (Some(monitor), Some(threshold)) = (&mut self.pilots.monitor, self.tunables.threshold) {
            monitor.set_threshold(threshold);
        }
        if let FlightPilot::Geometric(pilot) = &mut self.pilots.pilot
            && self.tunables.pilot != before.pilot
        {
            // Set on the ground only, where the pilot remembers nothing of use.
            *pilot = GeometricPilot::new(self.tunables.pilot);
        }
    }

    /// The parameters and their values in force.
    pub fn parameters(&mut self) -> &Parameters {
        self.companion.parameters()
    }

    /// From now on takes only frames that were made with one of these keys, if there are any.
    pub fn require_frame_keys(&mut self, keys: FrameKeys) {
        self.frames.require(keys);
    }

    /// Frames refused since start, by reason.
    pub fn frame_refusals(&self) -> FrameRefusals {
        self.frames.refusals()
    }

    /// Whether a person took the vehicle over and no operator engaged since.
    pub fn taken_over(&self) -> bool {
        self.guidance.taken_over()
    }

    /// The pilot that keeps a map and plans a way: the recovery pilot, else the geometric one; `None` where neither has been asked. For
    /// looking at a flight afterwards ([`crate::replay()`]).
    pub fn mapping(&self) -> Option<&GeometricPilot> {
        match (&self.pilots.recovery, &self.pilots.pilot) {
            (Some(recovery), _) if !self.recovery_is_new => Some(recovery.mapping()),
            (None, FlightPilot::Geometric(pilot)) => Some(pilot),
            _ => None,
        }
    }

    /// The actor and the frame that it decided on in the last step; `None` if none did. For looking at a flight afterwards.
    pub fn actor(&self) -> Option<(&Actor, &DepthFrame)> {
        match &self.pilots.pilot {
            FlightPilot::Actor(pilot) if self.pilot_asked => Some((pilot.actor(), self.frames.newest()?)),
            _ => None,
        }
    }

    /// The texts that the last step told people.
    pub fn told(&self) -> &[StatusText] {
        self.companion.told()
    }

    /// What the link refused or dropped, since start.
    pub fn link_counters(&self) -> LinkCounters {
        self.companion.counters()
    }

    /// Appends the command of a person at the terminal who disengages guidance. It is meant for [`TickInput::received`]:
    /// it enters the stack as any operator's does, and the log has it.
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

    /// What the pilot needs besides the frame, when everything is there, fresh and finite: then, and only then, guidance
    /// expects an action of it.
    fn view(&self, now_ns: Nanos, telemetry: &VehicleTelemetry, goal: Option<&Goal>) -> Option<View> {
        let limits = self.guidance.config();
        self.frames.fresh(now_ns, limits.frame_age_limit_ns)?;
        let motion = Motion::of(telemetry, now_ns, limits.telemetry_age_limit_ns)?;
        let goal = goal?;
        Some(View {
            goal: goal.relative_to(&motion.kinematics, &motion.sample),
            goal_ned_m: goal.position_ned_m,
            motion,
        })
    }

    /// Asks the pilots, or tells them once that what they remember is out of date.
    fn decide(&mut self, now_ns: Nanos, view: Option<View>) -> Decision {
        let Pilots {
            pilot,
            monitor,
            recovery,
            watched,
        } = &mut self.pilots;
        let before_flight = matches!(self.guidance.state(), GuidanceState::Standby | GuidanceState::Ready);
        if before_flight {
            self.leg.reset();
        }
        if let (true, Some(recovery)) = (before_flight && !self.recovery_is_new, &mut *recovery) {
            recovery.reset();
            self.recovery_is_new = true;
        }
        let (Some(view), Some(depth)) = (view, self.frames.newest()) else {
            if before_flight {
                pilot.reset();
            }
            if self.pilot_asked {
                // Actor and recovery pilot keep what they remember of places through the whole flight: whoever can hold back frames must not
                // be able to erase it.
                pilot.pause();
                if let Some(monitor) = monitor {
                    monitor.reset();
                }
                self.pilot_asked = false;
            }
            return Decision::default();
        };
        self.pilot_asked = true;
        let input = PilotInput {
            goal: view.goal,
            // Home is on the ground, wherever the estimator began.
            ..view.motion.pilot_input(now_ns, depth, self.guidance.home_ned_m())
        };
        // An imported policy knows near goals only. The actor and the geometric pilot fly to the goal as it is.
        let mut detour = None;
        let mut towards = input;
        if let FlightPilot::Imported(_) = pilot {
            let Motion { kinematics, sample } = view.motion;
            let here = kinematics.position_ned_m;
            self.leg.take_up(now_ns, here, view.goal_ned_m);
            match self.leg.next(now_ns, here, view.goal.bearing_rad) {
                LedTo::Point(position_ned_m) => {
                    towards.goal = Goal { position_ned_m }.relative_to(&kinematics, &sample);
                }
                LedTo::Path => detour = Some(input.goal),
            }
        }
        // Nobody asks for a path to a near goal that nothing watches.
        let is_asked = *watched || self.leg.is_far();
        let mut recovery = recovery.as_deref_mut().filter(|_| is_asked);
        if let Some(recovery) = recovery.as_deref_mut() {
            self.recovery_is_new = false;
            recovery.observe(&input, self.along_path);
            detour = detour.map(|_| along_path(recovery.lead(&input)));
        }
        if let Some(along) = detour {
            towards.goal = along;
        }
        let limit_m_s = self.tunables.speed_limit_m_s;
        let limited = |action: Action| Action {
            forward_m_s: action.forward_m_s.clamp(-limit_m_s, limit_m_s),
            ..action
        };
        let decided = pilot.decide(&towards);
        let action = limited(detour.map_or(decided, |way| turned_to_path(way, decided)));
        let mut decision = Decision {
            action: Some(action),
            ..Decision::default()
        };
        if let (Some(monitor), Some(state), Some(position)) = (monitor, pilot.state(), pilot.position()) {
            decision.judgement = Some(monitor.judge(state, position));
        }
        if let (true, Some(recovery)) = (*watched, recovery) {
            let own = limited(recovery.decide(&input));
            decision.recovery = Some(own);
            decision.collision_course = Some(recovery.foresees_collision(&input, action));
            decision.speed_along_way_m_s = Some(recovery.speed_along_way_m_s(&input).unwrap_or(0.0));
            decision.recovery_course = Some(recovery.foresees_own_collision(&input, own));
        }
        decision
    }
}

/// What the pilots decided in a step; empty when they were not asked.
#[derive(Debug, Clone, Copy, Default)]
struct Decision {
    action: Option<Action>,
    recovery: Option<Action>,
    judgement: Option<Judgement>,
    /// Whether the recovery pilot sees the action lead into something; `None` when it was not asked.
    collision_course: Option<bool>,
    /// Whether it sees its own action lead into something that stopping avoids.
    recovery_course: Option<bool>,
    /// How fast the vehicle flies along the way that it plans; 0 where it has none.
    speed_along_way_m_s: Option<f32>,
}

/// What the pilot may see of the vehicle and the goal.
#[derive(Debug, Clone, Copy)]
struct View {
    goal: GoalRelative,
    goal_ned_m: NedVector,
    motion: Motion,
}
