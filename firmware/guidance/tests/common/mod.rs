//! A loop around guidance with inputs that a story can spoil.
#![allow(dead_code)] // each test program uses a part of it

use vigil_guidance::{FrameStatus, Guidance, GuidanceConfig, GuidanceInput, GuidanceOutput, Risk};
use vigil_types::{
    Action, Attitude, AttitudeSample, FrdVector, GuidanceState, HandoverProgress, Heartbeat, Kinematics, Landed, Nanos,
    NedVector, OperatorRequest, Reasons, RequestOutcome, STEP_NS, StepTiming, VehicleMode, VehicleStatus,
    VehicleTelemetry, Verdict,
};

/// The recovery pilot foresees nothing.
pub const QUIET: Risk = Risk {
    collision_course: false,
    recovery_course: false,
    speed_along_path_m_s: 1.0,
};

/// Inputs as they are in a good flight; change a field to spoil one.
pub struct Story {
    pub guidance: Guidance,
    pub now_ns: Nanos,
    pub armed: bool,
    pub mode: VehicleMode,
    pub failsafe: bool,
    pub position_ned_m: NedVector,
    pub battery: Option<f32>,
    pub frame: FrameStatus,
    pub telemetry_age_ns: Nanos,
    pub heartbeat_age_ns: Option<Nanos>,
    pub action: Option<Action>,
    pub recovery: Option<Action>,
    pub verdict: Option<Verdict>,
    pub risk: Risk,
    pub smooth_share: Option<f32>,
    pub velocity_ned_m_s: NedVector,
    pub timing: StepTiming,
    pub vehicle: VehicleStatus,
    pub landed: Landed,
    pub last: Option<GuidanceOutput>,
}

pub const GOAL: OperatorRequest = OperatorRequest::Goal {
    north_m: 20.0,
    east_m: 5.0,
    height_m: Some(3.0),
};

impl Story {
    /// A vehicle on the ground, everything fresh, a goal 20 m ahead.
    pub fn begin(config: GuidanceConfig) -> Self {
        let mut guidance = Guidance::new(config).expect("the configuration is valid");
        assert_eq!(guidance.request(GOAL), RequestOutcome::Accepted);
        Self {
            guidance,
            now_ns: 10_000_000_000,
            armed: false,
            mode: VehicleMode::Hold,
            failsafe: false,
            position_ned_m: NedVector::ZERO,
            battery: Some(0.9),
            frame: FrameStatus {
                age_ns: Some(STEP_NS),
                ..FrameStatus::default()
            },
            telemetry_age_ns: 10_000_000,
            heartbeat_age_ns: Some(400_000_000),
            action: Some(Action::new(1.0, 0.5)),
            recovery: None,
            verdict: None,
            risk: QUIET,
            smooth_share: Some(0.9),
            velocity_ned_m_s: NedVector::ZERO,
            timing: StepTiming::default(),
            vehicle: VehicleStatus {
                up_ns: Some(600_000_000_000),
                ..VehicleStatus::default()
            },
            landed: Landed::Unknown,
            last: None,
        }
    }

    /// The same, already flying to the goal.
    pub fn guided(config: GuidanceConfig) -> Self {
        let mut story = Self::begin(config);
        story.run(20);
        if story.guidance.state() == GuidanceState::Ready {
            story.engages();
        }
        story.hand_over();
        assert_eq!(story.step().state, GuidanceState::Guided);
        story
    }

    /// The vehicle obeys.
    pub fn hand_over(&mut self) {
        self.armed = true;
        self.mode = VehicleMode::External;
        self.failsafe = false;
        self.position_ned_m.z = -3.0;
        self.vehicle.handover = HandoverProgress::Done;
    }

    pub fn telemetry(&self) -> VehicleTelemetry {
        let at_ns = self.now_ns.saturating_sub(self.telemetry_age_ns);
        VehicleTelemetry {
            heartbeat: self.heartbeat_age_ns.map(|age_ns| Heartbeat {
                at_ns: self.now_ns.saturating_sub(age_ns),
                armed: self.armed,
                mode: self.mode,
                failsafe: self.failsafe,
            }),
            kinematics: Some(Kinematics::new(at_ns, self.position_ned_m, self.velocity_ned_m_s)),
            attitude: Some(AttitudeSample::new(at_ns, Attitude::LEVEL_NORTH, FrdVector::ZERO)),
            landed: self.landed,
            battery_remaining: self.battery,
        }
    }

    pub fn step(&mut self) -> GuidanceOutput {
        self.now_ns += STEP_NS;
        let telemetry = self.telemetry();
        let output = self.guidance.step(&GuidanceInput {
            now_ns: self.now_ns,
            telemetry: &telemetry,
            frame: self.frame,
            action: self.action,
            recovery: self.recovery,
            verdict: self.verdict,
            risk: Some(self.risk),
            smooth_share: self.smooth_share,
            timing: self.timing,
            vehicle: self.vehicle,
        });
        self.last = Some(output);
        output
    }

    /// Several steps with the same inputs; the last output.
    pub fn run(&mut self, steps: usize) -> GuidanceOutput {
        assert!(steps > 0);
        (0..steps).map(|_| self.step()).last().expect("at least one step")
    }

    /// State and reasons after several steps with the same inputs.
    pub fn ends(&mut self, steps: usize) -> (GuidanceState, Reasons) {
        let output = self.run(steps);
        (output.state, output.reasons)
    }

    /// Steps until the state is reached; how many it took.
    pub fn until(&mut self, state: GuidanceState) -> usize {
        for n in 1..=400 {
            if self.step().state == state {
                return n;
            }
        }
        panic!("{} was not reached: {:?}", state.name(), self.last);
    }

    /// An operator engages; the state after the next step.
    pub fn engages(&mut self) -> GuidanceState {
        assert_eq!(self.ask(OperatorRequest::Engage), RequestOutcome::Accepted);
        self.step().state
    }

    /// An operator sets something else.
    pub fn reconfigure(&mut self, change: impl FnOnce(&mut GuidanceConfig)) {
        let mut config = *self.guidance.config();
        change(&mut config);
        self.guidance.reconfigure(config).expect("the configuration is valid");
    }

    pub fn ask(&mut self, request: OperatorRequest) -> RequestOutcome {
        self.guidance.request(request)
    }
}
