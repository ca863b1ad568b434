//! From verdicts to an alarm, and from the alarm to what guidance does: with hysteresis, pure.
//!
//! A single verdict neither raises nor ends an alarm: five attacked steps (0.25 s) hardly turn the vehicle, and false
//! verdicts seldom last as long. *Unknown* ends none, and too many of them in a row raise one. So does, whatever the
//! verdict, an action that leads into something, and an actor that does not bring the vehicle on along the path that the
//! guard plans. What ends an alarm are clean steps in a row: the verdict is clean, the picture is not rough, and the actor's action
//! leads into nothing.

use crate::conditions::{STOP_LIMIT_NS, STOPPED_M_S, UNKNOWN_LIMIT};
use crate::input::GuidanceInput;
use vigil_types::parameters::{self, OutOfRange};
use vigil_types::{Alarm, AlarmCause, AlarmPolicy, AlarmResponse, Nanos, ParameterSpec, STEP_S, Verdict};

// What only programs set, stated as the table states the rest.
const GUARD_STEPS: ParameterSpec = ParameterSpec::unlisted("guard_steps", (0.0, 1200.0), "steps", 4.0);
const RECOVERY_GUARD_STEPS: ParameterSpec =
    ParameterSpec::unlisted("recovery_guard_steps", (0.0, 1200.0), "steps", 2.0);
const PATH_SPEED: ParameterSpec = ParameterSpec::unlisted("way_speed", (0.0, 1.5), "m/s", 0.5);
// An actor that looks for the path out of a dead end falls behind by more than 6 m in a fifth of hard flights; a vehicle that is turned away
// at 1.2 m/s is found after 12 s.
const ASTRAY: ParameterSpec = ParameterSpec::unlisted("astray", (0.0, 100.0), "m", 20.0);
const APART: ParameterSpec = ParameterSpec::unlisted("apart", (0.1, 3.0), "", 2.0);
// Longer than a swerve round an obstacle on the other side than the planner's (docs/detection.md).
const DISAGREEMENT: ParameterSpec = ParameterSpec::unlisted("disagreement", (0.0, 60.0), "s", 3.5);
// Unaltered, no frame of three families fell below 0.70 with up to three times the sensor's noise (docs/robustness.md).
const SMOOTH_SHARE: ParameterSpec = ParameterSpec::unlisted("smooth_share", (0.0, 0.95), "", ROUGH_BELOW as f64);

/// A picture is rough when fewer of its cells than this share show one surface.
pub const ROUGH_BELOW: f32 = 0.6;

/// Thresholds of the alarm; [`AlarmConfig::default`] is what `docs/guidance.md` states.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AlarmConfig {
    /// What a raised alarm brings about.
    pub policy: AlarmPolicy,
    /// This many of the last [`AlarmConfig::raise_window`] verdicts raise the alarm when they are attack.
    pub raise_count: u8,
    /// Verdicts that are looked back on; 1 to 32.
    pub raise_window: u8,
    /// Consecutive steps in which the actor is on a collision course that raise the alarm; 0 raises none.
    pub guard_steps: u16,
    /// Consecutive steps in which the recovery pilot is on one that stop it; 0 stops it never. Fewer than the actor's, for it is looked at less far ahead.
    pub recovery_guard_steps: u16,
    /// How far the actor may fall behind a vehicle that flies along the guard's path at [`AlarmConfig::path_speed_m_s`], metres; 0 is as far as
    /// it likes. What it gains on that vehicle does not count.
    pub astray_limit_m: f32,
    /// The least that an actor gets on along the guard's path in the long run, metres per second.
    pub path_speed_m_s: f32,
    /// So much longer may actor and recovery pilot want to turn apart than they do not, seconds; 0 is as long as they like.
    pub disagreement_limit_s: f32,
    /// They turn apart when their yaw outputs differ by more than this.
    pub apart_yaw: f32,
    /// Fewer cells of one surface than this share make a picture rough; as many rough ones as verdicts of attack raise the alarm. 0 is never.
    pub smooth_share: f32,
    /// Consecutive clean steps that end the first alarm of a flight; each further one asks for twice as many.
    pub clear_steps: u16,
}

impl Default for AlarmConfig {
    fn default() -> Self {
        Self {
            policy: AlarmPolicy::default(),
            raise_count: parameters::RAISE_COUNT.number() as u8,
            raise_window: parameters::RAISE_WINDOW.number() as u8,
            guard_steps: GUARD_STEPS.number() as u16,
            recovery_guard_steps: RECOVERY_GUARD_STEPS.number() as u16,
            astray_limit_m: ASTRAY.number_f32(),
            path_speed_m_s: PATH_SPEED.number_f32(),
            disagreement_limit_s: DISAGREEMENT.number_f32(),
            apart_yaw: APART.number_f32(),
            smooth_share: SMOOTH_SHARE.number_f32(),
            clear_steps: parameters::CLEAR_STEPS.number() as u16,
        }
    }
}

impl AlarmConfig {
    /// The same where no guard looks on: the verdict alone raises the alarm.
    #[must_use]
    pub fn without_guard(self) -> Self {
        Self {
            guard_steps: 0,
            recovery_guard_steps: 0,
            astray_limit_m: 0.0,
            disagreement_limit_s: 0.0,
            smooth_share: 0.0,
            ..self
        }
    }

    /// Whether so many of the last verdicts or pictures are set that the alarm is raised.
    fn are_enough(&self, last: u32) -> bool {
        let looked_back_on = u32::MAX >> (32 - u32::from(self.raise_window.clamp(1, 32)));
        (last & looked_back_on).count_ones() >= u32::from(self.raise_count)
    }

    /// Whether guidance may fly with these thresholds.
    pub(crate) fn check(&self) -> Result<(), OutOfRange> {
        for (parameter, value) in [
            (&parameters::RAISE_WINDOW, f64::from(self.raise_window)),
            (&parameters::RAISE_COUNT, self.raise_count.into()),
            (&GUARD_STEPS, self.guard_steps.into()),
            (&RECOVERY_GUARD_STEPS, self.recovery_guard_steps.into()),
            (&ASTRAY, self.astray_limit_m.into()),
            (&PATH_SPEED, self.path_speed_m_s.into()),
            (&DISAGREEMENT, self.disagreement_limit_s.into()),
            (&APART, self.apart_yaw.into()),
            (&SMOOTH_SHARE, self.smooth_share.into()),
            (&parameters::CLEAR_STEPS, self.clear_steps.into()),
        ] {
            parameter.check(value)?;
        }
        let (key, range) = (parameters::RAISE_COUNT.key, (1.0, self.raise_window.into()));
        ParameterSpec::unlisted(key, range, "verdicts, at most raise_window", 1.0).check(self.raise_count.into())
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Raised {
    cause: AlarmCause,
    since_ns: Nanos,
    /// The vehicle has stopped since.
    stopped: bool,
    /// It stops because the recovery pilot was about to fly into something.
    recovery_stopped: bool,
}

/// What the steps of a flight speak for.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Evidence {
    /// The last verdicts, newest in the lowest bit; set where it was attack.
    attacks: u32,
    /// The last frames, newest in the lowest bit; set where the picture was rough.
    rough: u32,
    /// Consecutive steps without a verdict, and clean ones.
    unknown_steps: u16,
    clean_steps: u16,
    /// Consecutive steps in which the actor's action was on a collision course.
    course_steps: u16,
    /// How far the actor has fallen behind a vehicle that flies along the guard's path, metres.
    behind_m: f32,
    /// Steps in which they turned apart, less those in which they did not, since that was last 0.
    apart_steps: u16,
}

/// Counts a step in which something holds, or begins anew.
pub(crate) fn count(steps: &mut u16, holds: bool) {
    *steps = if holds { steps.saturating_add(1) } else { 0 };
}

impl Evidence {
    fn note(&mut self, config: &AlarmConfig, input: &GuidanceInput<'_>, is_raised: bool, guided: bool) {
        let on_collision_course = input.risk.is_some_and(|risk| risk.collision_course);
        // Without a detector a step is clean when the guard looked and saw nothing; when nobody looked it is not.
        let looks_clean = match input.verdict {
            Some(verdict) => verdict == Verdict::Clean,
            None => input.risk.is_some(),
        };
        self.attacks = self.attacks << 1 | u32::from(input.verdict == Some(Verdict::Attack));
        count(&mut self.unknown_steps, input.verdict == Some(Verdict::Unknown));
        count(&mut self.course_steps, on_collision_course);
        if let Some(smooth_share) = input.smooth_share {
            self.rough = self.rough << 1 | u32::from(smooth_share < config.smooth_share);
        }
        // Who knows the detector goes on supplying clean verdicts.
        let is_rough = self.rough & 1 != 0;
        count(&mut self.clean_steps, looks_clean && !is_rough && !on_collision_course);
        match (is_raised, guided) {
            (true, _) => {}
            // What is scored while the vehicle holds moves nothing.
            (false, false) => (self.attacks, self.rough, self.unknown_steps, self.course_steps) = (0, 0, 0, 0),
            (false, true) => self.note_flight(config, input),
        }
    }

    fn note_flight(&mut self, config: &AlarmConfig, input: &GuidanceInput<'_>) {
        // Of two vehicles, one along the path at a constant speed, the other flown by the actor: Page's cumulative sum (1954), which shows a
        // lasting change soonest and forgets what went well before.
        if let Some(speed_m_s) = input.risk.map(|risk| risk.speed_along_path_m_s)
            && speed_m_s.is_finite()
        {
            self.behind_m = (self.behind_m + (config.path_speed_m_s - speed_m_s) * STEP_S).max(0.0);
        }
        if let Some((actor, own)) = input.action.zip(input.recovery) {
            let apart = (actor.clipped().yaw - own.clipped().yaw).abs();
            self.apart_steps = if apart > config.apart_yaw {
                self.apart_steps.saturating_add(1)
            } else {
                self.apart_steps.saturating_sub(1)
            };
        }
    }
}

/// A cause, and when there is evidence enough for it.
type Trigger = (AlarmCause, fn(&Evidence, &AlarmConfig) -> bool);

/// What raises the alarm, in order of precedence.
const TRIGGERS: [Trigger; 6] = [
    (AlarmCause::Attack, |e, c| c.are_enough(e.attacks)),
    (AlarmCause::NoVerdict, |e, _| e.unknown_steps > UNKNOWN_LIMIT),
    (AlarmCause::CollisionCourse, |e, c| {
        c.guard_steps > 0 && e.course_steps >= c.guard_steps
    }),
    (AlarmCause::LedAstray, |e, c| {
        c.astray_limit_m > 0.0 && e.behind_m > c.astray_limit_m
    }),
    (AlarmCause::Disagreement, |e, c| {
        c.disagreement_limit_s > 0.0 && f32::from(e.apart_steps) * STEP_S > c.disagreement_limit_s
    }),
    (AlarmCause::RoughPicture, |e, c| c.are_enough(e.rough)),
];

/// The alarm's state.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct AlarmLogic {
    raised: Option<Raised>,
    evidence: Evidence,
    /// Consecutive steps in which the recovery pilot, flying, was on a collision course.
    recovery_course_steps: u16,
    /// Alarms of this flight that have ended.
    ended: u8,
}

/// The number of clean verdicts that end an alarm doubles this often at the most.
const MOST_DOUBLINGS: u8 = 6;

impl AlarmLogic {
    /// Consecutive clean steps that end this alarm: an attack that came back in a flight is likely to come back again.
    fn clear_steps(&self, config: &AlarmConfig) -> u32 {
        (u32::from(config.clear_steps) << self.ended.min(MOST_DOUBLINGS)).min(u32::from(u16::MAX))
    }

    /// An operator trusts the actor again: ends an alarm of the guard.
    pub fn trust_again(&mut self) {
        if self.raised.is_some_and(|raised| raised.cause.is_of_guard()) {
            self.end();
        }
    }

    fn end(&mut self) {
        *self = Self {
            ended: self.ended.saturating_add(1),
            ..Self::default()
        };
    }

    /// One step; says what is raised after it. `in_flight`: guidance is in a flight; `guided`: the pilot's actions reach the vehicle.
    pub fn step(
        &mut self,
        config: &AlarmConfig,
        input: &GuidanceInput<'_>,
        in_flight: bool,
        guided: bool,
    ) -> Option<Alarm> {
        if !in_flight {
            *self = Self::default();
            return None;
        }
        self.evidence.note(config, input, self.raised.is_some(), guided);
        let evidence = &self.evidence;
        let cause = TRIGGERS
            .iter()
            .find(|(_, fires)| fires(evidence, config))
            .map(|(cause, _)| *cause);
        let clean = u32::from(evidence.clean_steps) >= self.clear_steps(config);
        match (&mut self.raised, cause) {
            (None, Some(cause)) => {
                self.raised = Some(Raised {
                    cause,
                    since_ns: input.now_ns,
                    stopped: false,
                    recovery_stopped: false,
                });
                // Of an actor that goes astray, or that disagrees, every step before was clean.
                self.evidence.clean_steps = 0;
            }
            // Where nobody else flies on, a person decides whether the actor may.
            (Some(raised), _) if raised.cause.is_of_guard() && config.policy == AlarmPolicy::Stop => {}
            // It is known now to be an attack; the actor does not fly any more, so there is nothing to stop anew.
            (Some(raised), Some(AlarmCause::Attack)) if !raised.cause.is_of_guard() => {
                raised.cause = AlarmCause::Attack
            }
            (Some(_), _) if clean => self.end(),
            _ => {}
        }
        let raised = self.raised.as_mut()?;
        let recovers = raised.stopped && guided && config.policy == AlarmPolicy::Recover;
        count(
            &mut self.recovery_course_steps,
            recovers && input.risk.is_some_and(|risk| risk.recovery_course),
        );
        if config.recovery_guard_steps > 0 && self.recovery_course_steps >= config.recovery_guard_steps {
            // It begins anew from where the vehicle then stands.
            self.recovery_course_steps = 0;
            (raised.since_ns, raised.stopped, raised.recovery_stopped) = (input.now_ns, false, true);
        }
        let begins = raised.since_ns == input.now_ns;
        let kinematics = input.telemetry.kinematics;
        let still = kinematics.is_some_and(|k| k.velocity_ned_m_s.norm() < STOPPED_M_S);
        let long = input.now_ns.saturating_sub(raised.since_ns) >= STOP_LIMIT_NS;
        raised.stopped |= !begins && (still || long);
        raised.recovery_stopped &= !raised.stopped;
        Some(Alarm {
            cause: if raised.recovery_stopped {
                AlarmCause::CollisionCourse
            } else {
                raised.cause
            },
            response: match config.policy {
                AlarmPolicy::Ignore => AlarmResponse::Ignored,
                AlarmPolicy::Recover if raised.stopped => AlarmResponse::Recovery,
                AlarmPolicy::Stop | AlarmPolicy::Recover => AlarmResponse::Stop,
            },
        })
    }
}
