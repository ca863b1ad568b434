//! The pilots of a flight: asked once a step, and who of them flew the step before.
#![deny(clippy::std_instead_of_core, clippy::alloc_instead_of_core)]

use crate::motion::Motion;
use crate::pilots::Pilots;
use crate::segment::{Segment, along_path, turned_to_path};
use vigil_guidance::Risk;
use vigil_policy::{Decider, Pilot, PilotInput};
use vigil_types::{Action, Alarm, AlarmResponse, DepthFrame, Goal, GoalRelative, Judgement, NedVector};

/// What the pilots may see of the vehicle and the goal.
#[derive(Debug, Clone, Copy)]
pub(crate) struct View {
    pub goal: GoalRelative,
    pub goal_ned_m: NedVector,
    pub motion: Motion,
}

/// What the pilots decided in a step; empty when they were not asked.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Decision {
    pub action: Option<Action>,
    pub recovery: Option<Action>,
    pub judgement: Option<Judgement>,
    /// What the recovery pilot foresees; `None` when nothing watches.
    pub risk: Option<Risk>,
}

/// The pilots, and what they did in the step before.
pub(crate) struct Deciding {
    pub pilots: Pilots,
    /// What an imported policy follows to a far goal.
    segment: Segment,
    /// The vehicle was flown by the recovery pilot, or by an imported policy along its path, in the step before.
    along_path: bool,
    /// The recovery pilot flew since the alarm was raised; while the vehicle stops for its own course too.
    recovery_flew: bool,
    /// The pilot was asked in the step before.
    asked: bool,
    /// They have seen nothing since their last reset.
    are_new: bool,
}

impl Deciding {
    /// Pilots that have seen nothing yet.
    pub fn new(pilots: Pilots) -> Self {
        Self {
            pilots,
            segment: Segment::default(),
            along_path: false,
            recovery_flew: false,
            asked: false,
            are_new: true,
        }
    }

    /// Asks the pilots, or lets them know once that what they remember is out of date. No action is faster than `limit_m_s`. The recovery pilot
    /// goes by the frame as it was `restored`, where it was.
    pub fn decide(
        &mut self,
        before_flight: bool,
        seen: Option<(View, PilotInput<'_>)>,
        restored: Option<&DepthFrame>,
        limit_m_s: f32,
    ) -> Decision {
        let Some((view, input)) = seen else {
            self.pause();
            if before_flight {
                self.forget();
            }
            return Decision::default();
        };
        (self.asked, self.are_new) = (true, false);
        let (goal, mut detour) = self.target(&view, &input);
        let believed = PilotInput {
            depth: restored.unwrap_or(input.depth),
            ..input
        };
        let asks_recovery = self.asks_recovery();
        let Pilots {
            pilot,
            monitor,
            recovery,
            monitored,
        } = &mut self.pilots;
        let mut recovery = recovery.as_deref_mut().filter(|_| asks_recovery);
        if let Some(recovery) = recovery.as_deref_mut() {
            recovery.observe(&believed, self.along_path);
            detour = detour.map(|_| along_path(recovery.path_ahead(&believed)));
        }
        let limited = |action: Action| action.within(limit_m_s);
        let decided = pilot.decide(&PilotInput {
            goal: detour.unwrap_or(goal),
            ..input
        });
        let action = limited(detour.map_or(decided, |path| turned_to_path(path, decided)));
        let mut decision = Decision {
            action: Some(action),
            ..Decision::default()
        };
        if let (Some(monitor), Some(decider)) = (monitor, pilot.decider())
            && let Some(low_dim) = decider.low_dim()
        {
            decision.judgement = Some(monitor.score(decider.state(), low_dim));
        }
        if let (true, Some(recovery)) = (*monitored, recovery) {
            let own = limited(recovery.decide(&believed));
            decision.recovery = Some(own);
            decision.risk = Some(Risk {
                collision_course: recovery.foresees_collision(&believed, action),
                speed_along_path_m_s: recovery.speed_along_path_m_s(&believed).unwrap_or(0.0),
                recovery_course: recovery.foresees_own_collision(&believed, own),
            });
        }
        decision
    }

    /// Nobody asks for a path to a near goal that nothing watches.
    fn asks_recovery(&self) -> bool {
        self.pilots.monitored || self.segment.is_far()
    }

    /// Where the pilot is to fly, and whether along a path. An imported policy knows near goals only; the actor and the geometric pilot fly
    /// to the goal as it is.
    fn target(&mut self, view: &View, input: &PilotInput<'_>) -> (GoalRelative, Option<GoalRelative>) {
        if !matches!(self.pilots.pilot.decider(), Some(Decider::Imported(_))) {
            return (view.goal, None);
        }
        let Motion { kinematics, sample } = view.motion;
        let here = kinematics.position_ned_m;
        self.segment.take_up(input.now_ns, here, view.goal_ned_m);
        match self.segment.next(input.now_ns, here, view.goal.bearing_rad) {
            Some(position_ned_m) => (Goal { position_ned_m }.relative_to(&kinematics, &sample), None),
            None => (view.goal, Some(view.goal)),
        }
    }

    /// Before a flight nobody remembers another one.
    fn forget(&mut self) {
        if core::mem::replace(&mut self.are_new, true) {
            return;
        }
        self.segment.reset();
        self.pilots.pilot.reset();
        if let Some(recovery) = &mut self.pilots.recovery {
            recovery.reset();
        }
    }

    /// Nothing to decide on. Actor and recovery pilot keep what they remember of places through the whole flight: whoever can hold back
    /// frames must not be able to erase it.
    fn pause(&mut self) {
        if core::mem::take(&mut self.asked) {
            self.pilots.pilot.pause();
            if let Some(monitor) = &mut self.pilots.monitor {
                monitor.reset();
            }
        }
    }

    /// Notes who flies after this step.
    pub fn note(&mut self, alarm: Option<Alarm>) {
        self.recovery_flew = alarm.is_some_and(|alarm| match alarm.response {
            AlarmResponse::Recovery => true,
            AlarmResponse::Stop => self.recovery_flew,
            AlarmResponse::Ignored => false,
        });
        self.along_path = match alarm {
            Some(_) => self.recovery_flew,
            None => self.asked && self.segment.is_by_path(),
        };
    }
}

/// For looking at a flight afterwards.
#[cfg(feature = "std")]
impl Deciding {
    /// The pilot that keeps a map and plans a path: the recovery pilot, else the geometric one; `None` where neither has been asked.
    pub fn mapping(&self) -> Option<&vigil_policy::GeometricPilot> {
        match (&self.pilots.recovery, &self.pilots.pilot) {
            (Some(recovery), _) if self.asks_recovery() && !self.are_new => Some(recovery.mapping()),
            (None, vigil_policy::FlightPilot::Geometric(pilot)) => Some(pilot),
            _ => None,
        }
    }

    /// The actor, if it decided in the last step.
    pub fn actor(&self) -> Option<&vigil_policy::actor::Actor> {
        self.pilots.pilot.actor().filter(|_| self.asked)
    }
}
