//! What an attack is given, and what it came to.

use serde::{Deserialize, Serialize};
use vigil_detector::ShapError;
use vigil_nnet::ShapeError;
use vigil_types::named;

/// A change of the yaw output by as much counts as effective: 30 °/s (docs/paper.md, "Attack in flight").
pub const EFFECTIVE_YAW: f32 = 1.0;

named! {
    /// How the pixels are altered. ε is [`AttackConfig::epsilon_255`] / 255 of the image's range; g the gradient of the loss.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, clap::ValueEnum)]
    #[serde(rename_all = "kebab-case")]
    pub enum Method {
        /// One step of ε · sign(g), whatever `iterations` says (Goodfellow et al., 2015).
        Fgsm => "fgsm",
        /// Basic iterative method: steps of 2.5 ε / iterations, at most ε, along sign(g); the total stays within ε of the clean frame (Kurakin
        /// et al., 2017).
        BimClipped => "bim-clipped",
        /// Steps of ε · sign(g) without projection, as the paper writes it: up to iterations · ε.
        BimAccumulating => "bim-accumulating",
        /// As clipped, from a random start within ε (Madry et al., 2018).
        Pgd => "pgd",
        /// Steps of ε / iterations along the sign of g's running sum, each normalised by its mean size; within ε (Dong et al.,
        /// 2018, μ = 1).
        Momentum => "momentum",
        /// Steps along g itself, within a root mean square of ε over all pixels: few pixels move far.
        L2 => "l2",
        /// Only the 32 × 32 pixels that count most, each within 32 ε: the whole frame's budget in one place.
        Patch => "patch",
        /// The control: random signs of size iterations · ε, as large as bim-accumulating may get. With one iteration it is as large as
        /// the others.
        Noise => "noise",
        /// No gradient: everything above and ahead is shown farther away, by iterations · ε. It deceives whoever believes the frames, the recovery
        /// pilot and the guard as well as the actor; the ground below stays where it is.
        Recede => "recede",
        /// The same, swelling from nothing to that over the first 5 s.
        Swell => "swell",
        /// No gradient: everything but the ground is shown farther away, by iterations · ε, and what of the ground would be seen before it is
        /// painted there: nothing lies beneath the ground, and nothing hides it.
        Repaint => "repaint",
        /// No gradient: every pixel is shown as one without a return.
        Blind => "blind",
        /// No gradient: the first two seconds of what passed while attacking are shown again and again.
        Replay => "replay",
        /// Black box: as bim-accumulating, by an estimate of the gradient from the yaw output alone, asked 16 times in each iteration
        /// (simultaneous perturbation; Spall 1992, Uesato et al. 2018). Finds more with `--region`.
        Spsa => "spsa",
    }
}

/// Frames over which [`Method::Swell`] reaches its size: 5 s.
pub const SWELL_FRAMES: u64 = 100;

impl Method {
    /// Whether a frame is altered at once, without steps and gradient.
    pub const fn alters_at_once(self) -> bool {
        matches!(
            self,
            Self::Noise | Self::Recede | Self::Swell | Self::Repaint | Self::Blind | Self::Replay
        )
    }
}

named! {
    /// The yaw limit that the attack aims at.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, clap::ValueEnum)]
    #[serde(rename_all = "kebab-case")]
    pub enum Towards {
        /// −1.5: counter-clockwise.
        Left => "left",
        /// 1.5: clockwise.
        Right => "right",
        /// The one farther from the clean decision.
        Away => "away",
    }
}

impl Towards {
    /// −1 to aim left, 1 to aim right, for a clean yaw output.
    pub(crate) fn sign(self, clean_yaw: f32) -> f32 {
        match self {
            Self::Left => -1.0,
            Self::Right => 1.0,
            Self::Away if clean_yaw >= 0.0 => -1.0,
            Self::Away => 1.0,
        }
    }
}

/// What an attack is given.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AttackConfig {
    /// How.
    pub method: Method,
    /// ε in 1/255 of the image's range of 100 m: 1 is 0.39 m.
    pub epsilon_255: f32,
    /// Iterations, at least 1.
    pub iterations: u32,
    /// Where to.
    pub towards: Towards,
    /// For the methods that draw: the same seed and calls give the same bits.
    pub seed: u64,
    /// Side of the squares whose pixels move together, pixels: what shows one surface then goes on showing one. 1 moves each by itself.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub region_pixels: u32,
    /// Columns within this angle of the nose are left as they are, degrees: who knows the second sensor lies only where it does not look.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub truthful_ahead_deg: f32,
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "what serde calls it with")]
fn is_zero(value: &f32) -> bool {
    *value == 0.0
}

fn one() -> u32 {
    1
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "what serde calls it with")]
fn is_one(value: &u32) -> bool {
    *value == 1
}

impl AttackConfig {
    /// The paper's: accumulating, ε = 1/255, 20 iterations.
    pub const PAPER: Self = Self {
        method: Method::BimAccumulating,
        epsilon_255: 1.0,
        iterations: 20,
        towards: Towards::Away,
        seed: 0,
        region_pixels: 1,
        truthful_ahead_deg: 0.0,
    };

    /// ε as a normalised range.
    pub fn epsilon(&self) -> f32 {
        self.epsilon_255 / 255.0
    }

    /// The farthest that one pixel may move, as a normalised range; [`Method::L2`] bounds all pixels together, so one of
    /// `pixels` may move by as much as the whole budget.
    pub fn reach(&self, pixels: usize) -> f32 {
        let epsilon = self.epsilon();
        match self.method {
            Method::Fgsm | Method::BimClipped | Method::Pgd | Method::Momentum => epsilon,
            Method::BimAccumulating
            | Method::Noise
            | Method::Recede
            | Method::Swell
            | Method::Repaint
            | Method::Spsa => epsilon * self.iterations as f32,
            Method::Blind | Method::Replay => 1.0,
            Method::L2 => epsilon * (pixels as f32).sqrt(),
            Method::Patch => epsilon * PATCH_GAIN,
        }
    }

    /// What no pixel is brought nearer than, as a normalised range: who moves regions so that they look like surfaces does not make a sensor
    /// look blind either, as ranges of 0 would.
    pub(crate) fn floor(&self) -> f32 {
        if self.region_pixels > 1 { REGION_FLOOR } else { 0.0 }
    }

    /// Whether an attack can be made with it.
    ///
    /// # Errors
    /// What is out of its range.
    pub fn check(&self) -> Result<(), AttackError> {
        if !(self.epsilon_255 > 0.0 && self.epsilon_255 <= 255.0) {
            return Err(AttackError::Epsilon(self.epsilon_255));
        }
        if self.iterations == 0 {
            return Err(AttackError::Iterations);
        }
        if self.region_pixels == 0 {
            return Err(AttackError::Region);
        }
        if !(0.0..=180.0).contains(&self.truthful_ahead_deg) {
            return Err(AttackError::TruthfulAhead(self.truthful_ahead_deg));
        }
        Ok(())
    }
}

/// [`AttackConfig::floor`] of attacks that move regions: 0.5 m.
const REGION_FLOOR: f32 = 0.005;

/// Decisions that [`Method::Spsa`] asks for in each iteration.
pub const SPSA_QUERIES: usize = 16;

/// Frames that [`Method::Replay`] keeps: two seconds.
pub const REPLAYED_FRAMES: u64 = 40;

/// The frame's pixels over the patch's.
pub(crate) const PATCH_GAIN: f32 = 32.0;

/// What an attack came to: the actor's outputs (x-velocity, yaw) in ±1.5.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AttackOutcome {
    /// What it would have decided without any attack.
    pub clean: [f32; 2],
    /// What it decides on what it gets.
    pub attacked: [f32; 2],
}

impl AttackOutcome {
    /// Change of the yaw output.
    pub fn yaw_change(&self) -> f32 {
        self.attacked[1] - self.clean[1]
    }

    /// Whether the yaw moved by [`EFFECTIVE_YAW`] or more.
    pub fn is_effective(&self) -> bool {
        self.yaw_change().abs() >= EFFECTIVE_YAW
    }
}

/// Why there is no attack.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum AttackError {
    /// ε is out of its range.
    #[error("epsilon must be above 0 and at most 255 (in 1/255 of the image's range), got {0}")]
    Epsilon(f32),
    /// The angle that is spared is out of its range.
    #[error("the angle that is spared must be from 0 to 180 degrees, got {0}")]
    TruthfulAhead(f32),
    /// No iterations.
    #[error("an attack needs at least one iteration")]
    Iterations,
    /// Squares without pixels.
    #[error("the squares whose pixels move together are at least 1 pixel wide, got 0")]
    Region,
    /// The detector to be evaded cannot explain the actor.
    #[error("the detector to be evaded cannot be used: {0}")]
    Detector(#[from] ShapError),
    /// An imported policy that does not fit itself.
    #[error("the policy cannot be attacked: {0}")]
    Policy(String),
    /// Deceiving the detector along with an imported policy.
    #[error(
        "an attack that evades detector or guard knows our own actor's architecture only, and this is an imported policy: leave --evade and --evade-guard out"
    )]
    EvadingPolicy,
    /// Frames or parameters of another actor.
    #[error(transparent)]
    Shape(#[from] ShapeError),
}
