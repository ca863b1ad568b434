//! What the detector says of the actor's decision, and what guidance makes of it.

use crate::named;

/// Values at the actor's split point whose contributions are scored.
pub const EXPLAINED_STATE: usize = 48;

named! {
    /// Whether an explanation looks like those of an attacked actor. The numbers are telemetry (`NAMED_VALUE_FLOAT`
    /// "dt_state") and never change meaning.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default, PartialOrd, Ord)]
    #[repr(u8)]
    pub enum Verdict {
        /// There is no verdict in this step: too few explanations yet, or one that is not finite. Never taken for clean.
        #[default]
        Unknown = 0 => "unknown",
        /// The score is not above the threshold.
        Clean = 1 => "clean",
        /// The score is above the threshold.
        Attack = 2 => "attack",
    }
}

/// One step's judgement: the explanation of the actor's yaw output (DeepSHAP, action units; an imported policy's before its
/// `--output-scale`) and the verdict on the last explanations; [`Judgement::yaw`] puts it together again.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Judgement {
    /// The verdict.
    pub verdict: Verdict,
    /// The detector's score, 0 (clean) to 1 (attack); `None` when there is none.
    pub score: Option<f32>,
    /// Contribution of the depth frames: the sum of `phi`. NaN without an explanation.
    pub image: f32,
    /// Contribution of the goal's bearing, of our actor its sine's and cosine's. NaN without an explanation.
    pub bearing: f32,
    /// Contribution of the goal's distance. NaN without an explanation.
    pub distance: f32,
    /// Contribution of the vehicle's own motion and of the last action (movers too, in logs of actors that observed them). 0 for a
    /// policy that is given the goal alone, NaN without an explanation.
    pub told: f32,
    /// Mean yaw output of the background sample.
    pub base: f32,
    /// Contribution of each value at the actor's split point. NaN without an explanation.
    pub phi: [f32; EXPLAINED_STATE],
}

impl Judgement {
    /// No explanation, no verdict.
    pub const UNKNOWN: Self = Self {
        verdict: Verdict::Unknown,
        score: None,
        image: f32::NAN,
        bearing: f32::NAN,
        distance: f32::NAN,
        told: f32::NAN,
        base: f32::NAN,
        phi: [f32::NAN; EXPLAINED_STATE],
    };

    /// The sum of base and contributions: the actor's yaw output, but for rounding; an imported policy's before its `--output-scale`. NaN
    /// without an explanation.
    pub fn yaw(&self) -> f32 {
        self.base + self.image + self.bearing + self.distance + self.told
    }
}

named! {
    /// Why the alarm is raised.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
    #[repr(u8)]
    pub enum AlarmCause {
        /// The verdict was attack.
        Attack = 0 => "attack",
        /// There was no verdict for too long.
        NoVerdict = 1 => "no verdict",
        /// The actor was about to fly into something, whatever the verdict.
        CollisionCourse = 2 => "collision course",
        /// The actor did not bring the vehicle on along the way that the guard plans, whatever the verdict.
        LedAstray = 3 => "led astray",
        /// The actor and the guard's planner went on turning apart, whatever the verdict.
        Disagreement = 4 => "disagreement",
        /// The depth frames were rough, as no surface is, whatever the verdict.
        RoughPicture = 5 => "rough picture",
    }
}

impl AlarmCause {
    /// Whether the guard raised it: by what the vehicle would do, whatever the verdict on the actor's explanation.
    pub const fn is_of_guard(self) -> bool {
        match self {
            Self::CollisionCourse | Self::LedAstray | Self::Disagreement | Self::RoughPicture => true,
            Self::Attack | Self::NoVerdict => false,
        }
    }
}

named! {
    /// What the raised alarm makes guidance do in this step.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
    #[repr(u8)]
    pub enum AlarmResponse {
        /// Nothing: the policy only reports.
        Ignored = 0 => "ignored",
        /// Zero setpoints.
        Stop = 1 => "stopping",
        /// The recovery pilot's action takes the actor's place.
        Recovery = 2 => "recovery pilot flies",
    }
}

/// A raised alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Alarm {
    /// Why.
    pub cause: AlarmCause,
    /// What guidance does.
    pub response: AlarmResponse,
}
