//! The adversary between the sensor and the firmware: whole frames in, whole frames out.

use crate::config::{AttackError, AttackOutcome};
use crate::frame_attack::FrameAttack;
use crate::guard_evasion::GuardEvasion;
use std::ops::Range;
use vigil_policy::PilotInput;
use vigil_types::{DepthFrame, FrameHeader, GoalRelative, Nanos, NedVector, wrap_pi};

/// Distance and bearing of a goal from where the frame was taken, by the estimate in its header: what the pilot sees of
/// it, but for the vehicle's motion since.
pub fn goal_seen_from(header: &FrameHeader, goal_ned_m: NedVector) -> GoalRelative {
    let to_goal = goal_ned_m - header.position_ned_m;
    GoalRelative {
        distance_m: to_goal.horizontal_norm(),
        bearing_rad: wrap_pi(libm::atan2f(to_goal.y, to_goal.x) - header.attitude.yaw_rad()),
    }
}

/// What a pilot is given with a frame, from its header.
fn seen(frame: &DepthFrame, goal_ned_m: NedVector, velocity: NedVector) -> PilotInput<'_> {
    let header = &frame.header;
    PilotInput {
        velocity_m_s: velocity.to_heading(header.attitude.yaw_rad()),
        ..PilotInput::at_rest(frame, goal_seen_from(header, goal_ned_m))
    }
}

/// Alters the frames of the planned steps and seals them again; the firmware cannot know.
#[derive(Debug, Clone)]
pub struct Interceptor {
    attack: FrameAttack,
    steps: Range<u64>,
    goal_ned_m: NedVector,
    /// The guard that is to stay silent.
    guard: Option<GuardEvasion>,
    /// When and where the frame before was taken.
    before: Option<(Nanos, NedVector)>,
    /// The frame under way, as it was taken.
    taken: Box<DepthFrame>,
}

impl Interceptor {
    /// An adversary that attacks in these steps ([`crate::Burst::steps`]) and knows where the vehicle is to fly.
    pub fn new(attack: FrameAttack, steps: Range<u64>, goal_ned_m: NedVector) -> Self {
        Self {
            attack,
            steps,
            goal_ned_m,
            taken: Box::new(DepthFrame::EMPTY),
            guard: None,
            before: None,
        }
    }

    /// Makes the attack adaptive: it keeps the actor within what the guard lets pass.
    ///
    /// # Errors
    /// An attack on an imported policy.
    pub fn evading_guard(mut self) -> Result<Self, AttackError> {
        if matches!(self.attack, FrameAttack::Policy(_)) {
            return Err(AttackError::EvadingPolicy);
        }
        self.guard = Some(GuardEvasion::default());
        Ok(self)
    }

    /// The vehicle's velocity, from where the last two frames were taken, NED.
    fn velocity(&mut self, header: &FrameHeader) -> NedVector {
        let now = (header.stamp_ns, header.position_ned_m);
        match self.before.replace(now) {
            Some((then_ns, there)) if then_ns < now.0 => (now.1 - there) * (1e9 / (now.0 - then_ns) as f32),
            _ => NedVector::ZERO,
        }
    }

    /// Takes the frame of step number `step`, in place: what was done to it, `None` if nothing was.
    ///
    /// # Errors
    /// None for frames of the actor's size; the frame is then as it was.
    pub fn pass(&mut self, step: u64, frame: &mut DepthFrame) -> Result<Option<AttackOutcome>, AttackError> {
        self.pass_while(step, frame, || true)
    }

    /// The same within a deadline: after each iteration `go_on` says whether there is time for another.
    ///
    /// # Errors
    /// None for frames of the actor's size; the frame is then as it was.
    pub fn pass_while(
        &mut self,
        step: u64,
        frame: &mut DepthFrame,
        go_on: impl FnMut() -> bool,
    ) -> Result<Option<AttackOutcome>, AttackError> {
        let velocity = self.velocity(&frame.header);
        if !self.steps.contains(&step) {
            let seen = seen(frame, self.goal_ned_m, velocity);
            let decided = self.attack.pass(&seen)?;
            if let (Some(guard), Some(decided)) = (&mut self.guard, decided) {
                guard.delivered(&seen, decided);
            }
            return Ok(None);
        }
        if let (Some(guard), FrameAttack::Actor(attack)) = (&self.guard, &mut self.attack) {
            attack.yaw_bounds = guard.yaw_bounds();
        }
        (*self.taken).clone_from(frame);
        let taken = seen(&self.taken, self.goal_ned_m, velocity);
        let outcome = self.attack.attack_while(&taken, frame, go_on)?;
        frame.seal();
        if let Some(guard) = &mut self.guard {
            guard.delivered(&seen(frame, self.goal_ned_m, velocity), outcome.attacked);
        }
        Ok(Some(outcome))
    }
}
