//! What a run by value is made of: a TOML file whose every key is optional and whose unknown keys are refused.

use crate::actor_training::config::{ConfigError, NoiseConfig, ReplayConfig};
use crate::actor_training::limits::{self, Limits};
use serde::{Deserialize, Serialize};
use std::path::Path;
use vigil_policy::actor::FRAMES_SPREAD;
use vigil_policy::{ActorInputs, LedBy};
use vigil_world::Family;

/// A run by value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ValueConfig {
    /// Fixes courses, noise, initial weights and samples: the same seed trains the same actor, bit for bit, on machines with the
    /// same instruction set.
    pub seed: u64,
    /// Threads; any number trains the same actor.
    pub threads: usize,
    /// What the actor sees.
    pub sees: Sees,
    /// Whose bearing the pictures' actor is given.
    pub led_by: Leader,
    /// Whether the pictures' actor is told what moves near it, as further positional inputs.
    pub told_of_movers: bool,
    /// Who says in each state what to do, for `learning.imitation`.
    pub teacher: Teacher,
    /// Each training flight's course is of one of these, in turn by chance.
    pub families: Vec<Family>,
    /// Decisions after which training ends.
    pub decisions: u64,
    /// Decisions of noise that fill the memory before the first update (the paper: 5 000).
    pub warm_up: u64,
    /// The warm-up is flown by the first actor with noise, not by noise alone: for a run that begins with an actor that flies.
    pub warm_up_by_actor: bool,
    /// Mean forward output of the warm-up's noise: noise alone stays where it is.
    pub warm_up_forward: f32,
    /// Flights at the same time.
    pub environments: usize,
    /// Steps of 0.05 s that a decision lasts while training.
    pub steps_per_decision: usize,
    /// A training flight is cut off after this time, seconds. The value of its last state still counts.
    pub time_limit_s: f32,
    /// Exploration.
    pub noise: NoiseConfig,
    /// Share of the training flights in which the potential field is added to the action (the paper: 1).
    pub apf_share: f64,
    /// Reward.
    pub reward: ValueReward,
    /// Updates.
    pub learning: ValueLearning,
    /// Replay memory.
    pub replay: ReplayConfig,
    /// Flights that evaluate the actor.
    pub evaluation: ValueEvaluation,
    /// What the actor's encoder learns before it is frozen; for an actor that sees pictures.
    pub encoder: EncoderConfig,
}

/// Which of the configurations that were measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Recipe {
    /// An expert that sees the true state.
    Expert,
    /// The pictures' actor, taught by an expert's critics.
    Actor,
    /// The pictures' actor from nothing, without any teacher.
    Nothing,
}

/// What an actor sees.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Sees {
    /// The true state: an expert, which teaches and does not fly.
    Truth,
    /// Depth frames and the goal: the actor that flies.
    Pictures,
}

/// Whose bearing the actor's second positional input is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Leader {
    /// The goal's (the paper).
    Goal,
    /// The planned path's over the occupancy grid of what the frames have shown.
    Path,
}

impl From<Leader> for LedBy {
    fn from(leader: Leader) -> Self {
        match leader {
            Leader::Goal => Self::Goal,
            Leader::Path => Self::Path,
        }
    }
}

/// Who teaches, where `learning.imitation` is above 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Teacher {
    /// The expert that was given.
    Expert,
    /// The geometric pilot, which plans the path and follows movers: it knows no more than an actor that is led by the path and told of movers.
    Geometric,
}

/// Along what the reward measures progress.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Along {
    /// The shortest free way past what stands still.
    Way,
    /// The straight line to the goal (the paper).
    Line,
}

/// Reward: metres of progress, and these.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ValueReward {
    /// Progress along what.
    pub along: Along,
    /// At the goal.
    pub success: f32,
    /// For collision and out of bounds (the paper: −2).
    pub dead: f32,
    /// For each decision (the paper: 0).
    pub decision: f32,
    /// At checkpoint C of N: this times (1 + C/N) (the paper: 2).
    pub checkpoint: f32,
    /// For each decision that ends less than 1 m from an obstacle, times the share of that metre that is missing (the paper: not there).
    pub near: f32,
}

/// The updates of actor and critics.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ValueLearning {
    /// Discount per decision.
    pub gamma: f32,
    /// Rewards summed before the critics' value is used.
    pub n_steps: usize,
    /// Transitions in an update.
    pub batch: usize,
    /// Decisions per update.
    pub decisions_per_update: u64,
    /// Adam's rate for the actor.
    pub actor_rate: f32,
    /// Adam's rate for the critics.
    pub critic_rate: f32,
    /// Share of all updates after which the rates begin to fall linearly, to a twentieth at the end; 1 keeps them.
    pub rates_fall_from: f64,
    /// Share of the weights that the target networks take over at each update.
    pub tau: f32,
    /// Longest gradient.
    pub gradient_norm: f32,
    /// Weight of the square of what exceeds 1 before the actor's last tanh.
    pub saturation_penalty: f32,
    /// Standard deviation of the noise on the target's action, cut off at twice that.
    pub smoothing: f32,
    /// Two critics, of which the lower one's value is the target (Fujimoto et al. 2018); otherwise one.
    pub twin: bool,
    /// Units of the critics' two layers.
    pub critic_units: [usize; 2],
    /// Units of the expert's two layers.
    pub actor_units: [usize; 2],
    /// Weight of the critics' value in the actor's loss (the paper: 1).
    pub value_weight: f32,
    /// Weight of the distance between the actor's action and the expert's, at first; needs an expert.
    pub imitation: f32,
    /// Share of the run over which this weight falls linearly to 0, at most a half.
    pub imitation_falls_over: f64,
    /// This weight stays as it is instead: imitation alone, for comparison. With a value weight of 0 only.
    pub imitation_stays: bool,
    /// Weight of telling the nearest mover in sight, place and velocity, from the actor's 48 values: a readout that learns beside it
    /// and is not frozen with it. Of pictures only.
    pub motion: f32,
    /// The critics begin as the expert's.
    pub expert_critics: bool,
    /// The critics see what the actor is told beside its frames as well as the true state: where it is led, and which movers it knows of. Of
    /// pictures only.
    pub critics_told: bool,
    /// Updates that the critics make before the actor begins to move.
    pub critics_first: u64,
    /// Half of the sampled transitions are seen in a mirror; of true states only.
    pub mirror: bool,
    /// Judge and freeze the actor's target network, a mean over the last 1/τ updates, instead of the actor itself.
    pub freeze_target: bool,
}

/// Flights that evaluate the actor, always over the same courses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ValueEvaluation {
    /// Updates between evaluations.
    pub every_updates: u64,
    /// Families that are flown at each; the mean of their completions chooses.
    pub families: Vec<Family>,
    /// Flights of each.
    pub flights: u64,
    /// Seed of the first course. Training itself uses seeds from 1 000 000 on.
    pub first_seed: u64,
    /// A flight that takes longer has failed, seconds.
    pub time_limit_s: f32,
    /// States at which the critics' slope is compared with what flights tell.
    pub slope_states: u64,
}

/// What the encoder learns before it is frozen: the ranges in sight, on frames of the warm-up's flights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EncoderConfig {
    /// Frames to learn from.
    pub frames: usize,
    /// Updates.
    pub updates: u64,
    /// Frames in an update.
    pub batch: usize,
    /// Adam's rate.
    pub rate: f32,
}

impl Default for ValueConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            threads: 1,
            sees: Sees::Truth,
            led_by: Leader::Goal,
            told_of_movers: false,
            teacher: Teacher::Expert,
            families: vec![Family::Training, Family::Hard],
            decisions: 200_000,
            warm_up: 5_000,
            warm_up_by_actor: false,
            warm_up_forward: 0.7,
            environments: 8,
            steps_per_decision: 4,
            time_limit_s: 60.0,
            noise: NoiseConfig {
                theta: 0.15,
                sigma_first: 1.0,
                sigma_last: 0.1,
                falls_over: 0.5,
                share: 0.7,
            },
            apf_share: 0.0,
            reward: ValueReward::default(),
            learning: ValueLearning::default(),
            replay: ReplayConfig {
                decisions: 300_000,
                alpha: 0.0,
                beta: 0.4,
            },
            evaluation: ValueEvaluation::default(),
            encoder: EncoderConfig::default(),
        }
    }
}

impl Default for ValueReward {
    fn default() -> Self {
        Self {
            along: Along::Way,
            success: 5.0,
            dead: -6.0,
            decision: -0.02,
            checkpoint: 0.0,
            near: 0.0,
        }
    }
}

impl Default for ValueLearning {
    fn default() -> Self {
        Self {
            gamma: 0.97,
            n_steps: 3,
            batch: 128,
            decisions_per_update: 4,
            actor_rate: 3e-4,
            critic_rate: 5e-4,
            rates_fall_from: 0.6,
            tau: 0.005,
            gradient_norm: 5.0,
            saturation_penalty: 0.05,
            smoothing: 0.15,
            twin: true,
            critic_units: [256, 256],
            actor_units: [256, 128],
            value_weight: 1.0,
            imitation: 0.0,
            imitation_falls_over: 0.5,
            imitation_stays: false,
            motion: 0.0,
            expert_critics: false,
            critics_told: false,
            critics_first: 0,
            mirror: true,
            freeze_target: true,
        }
    }
}

impl Default for ValueEvaluation {
    fn default() -> Self {
        Self {
            every_updates: 5_000,
            families: vec![Family::Training, Family::Hard],
            flights: 40,
            first_seed: 0,
            time_limit_s: 90.0,
            slope_states: 24,
        }
    }
}

impl Default for EncoderConfig {
    fn default() -> Self {
        Self {
            frames: 3_000,
            updates: 2_000,
            batch: 32,
            rate: 1e-3,
        }
    }
}

impl ValueConfig {
    /// A configuration that was measured (docs/training.md).
    pub fn recipe(recipe: Recipe) -> Self {
        let mut config = Self::default();
        let e = &mut config.evaluation;
        if recipe == Recipe::Expert {
            config.families = vec![Family::Hard];
            (e.every_updates, e.families, e.flights) = (2_500, vec![Family::Hard], 30);
            return config;
        }
        config.sees = Sees::Pictures;
        config.led_by = Leader::Path;
        (config.encoder.frames, config.encoder.updates) = (3_200, 1_400);
        if recipe == Recipe::Nothing {
            config.told_of_movers = true;
            config.families = vec![Family::Training, Family::Hard, Family::Hard];
            (config.decisions, config.replay.decisions) = (165_000, 165_000);
            config.apf_share = 0.25;
            config.reward.near = -0.5;
            (config.learning.critics_told, config.learning.critics_first) = (true, 500);
            (e.every_updates, e.families) = (2_500, vec![Family::Validation, Family::Hard]);
            (e.slope_states, e.flights, e.time_limit_s) = (4, 30, 90.0);
        } else {
            config.replay.decisions = 100_000;
            config.replay.alpha = 0.6;
            config.decisions = 85_000;
            config.apf_share = 0.1;
            config.noise.sigma_first = 0.6;
            config.learning.actor_rate = 5e-4;
            config.learning.imitation = 1.0;
            config.learning.expert_critics = true;
            (e.every_updates, e.slope_states) = (2_000, 12);
        }
        config
    }

    /// What the pictures' actor decides from.
    pub(crate) fn inputs(&self) -> ActorInputs {
        ActorInputs {
            frame_ages: FRAMES_SPREAD,
            led_by: self.led_by.into(),
            told_of_movers: self.told_of_movers,
        }
    }

    /// Updates that belong to so many decisions.
    pub(crate) fn updates_due(&self, decisions: u64) -> u64 {
        decisions.saturating_sub(self.warm_up) / self.learning.decisions_per_update.max(1)
    }

    /// Reads and checks a file.
    ///
    /// # Errors
    /// [`ConfigError`].
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let config: Self = limits::load(path)?;
        config.check()?;
        Ok(config)
    }

    /// Writes TOML that [`Self::load`] reads back unchanged.
    pub fn to_toml(&self) -> String {
        limits::to_toml(self)
    }

    /// Checks every value.
    ///
    /// # Errors
    /// The first one that is not allowed.
    pub fn check(&self) -> Result<(), ConfigError> {
        const LEAST: &str = "environments x (n_steps + 40) or more";
        let (l, e) = (&self.learning, &self.evaluation);
        let least = self.environments.saturating_mul(l.n_steps.saturating_add(40)) as u64;
        Limits::new()
            .some("families", self.families.len() as u64)
            .count("threads", self.threads, 1..=256)
            .least(
                "decisions",
                self.decisions,
                self.warm_up.saturating_add(1),
                "more than the warm-up",
            )
            .least("warm_up", self.warm_up, least, LEAST)
            .number("warm_up_forward", self.warm_up_forward, -1.5..=1.5)
            .count("environments", self.environments, 1..=256)
            .count("steps_per_decision", self.steps_per_decision, 1..=40)
            .number("time_limit_s", self.time_limit_s, 1.0..=3600.0)
            .noise(&self.noise)
            .share("apf_share", self.apf_share)
            .number("learning.gamma", l.gamma, 0.0..=1.0)
            .count("learning.n_steps", l.n_steps, 1..=100)
            .count("learning.batch", l.batch, 1..=4096)
            .some("learning.decisions_per_update", l.decisions_per_update)
            .number("learning.actor_rate", l.actor_rate, 0.0..=1.0)
            .number("learning.critic_rate", l.critic_rate, 0.0..=1.0)
            .number("learning.tau", l.tau, 0.0..=1.0)
            .number("learning.gradient_norm", l.gradient_norm, 1e-6..=1e9)
            .number("learning.imitation", l.imitation, 0.0..=1e6)
            .that(
                "learning.imitation_falls_over",
                l.imitation_falls_over,
                (0.0..=0.5).contains(&l.imitation_falls_over),
                "0 to 0.5: the teacher's weight ends at half of the run",
            )
            .that(
                "learning.imitation_stays",
                1.0,
                !l.imitation_stays || l.value_weight == 0.0,
                "only with learning.value_weight = 0: the teacher's weight ends at half of a run by value",
            )
            .that(
                "teacher",
                0.0,
                self.teacher == Teacher::Expert
                    || (self.sees == Sees::Pictures && self.led_by == Leader::Path && self.told_of_movers),
                "geometric only with sees = pictures, led_by = path and told_of_movers = true: it is the pilot that plans this path",
            )
            .share("replay.alpha", self.replay.alpha)
            .least("replay.decisions", self.replay.decisions as u64, least, LEAST)
            .some("evaluation.every_updates", e.every_updates)
            .end()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_learns_from_nothing_without_being_told_otherwise_is_how_the_built_in_actor_learned() {
        let made: ValueConfig = toml::from_str(include_str!("../../../../docs/runs/value/near-1/config.toml")).unwrap();
        assert_eq!(ValueConfig::recipe(Recipe::Nothing), made);
        let actor = vigil_policy::FrozenActor::built_in().unwrap();
        assert_eq!(toml::from_str::<ValueConfig>(&actor.training_config).unwrap(), made);
    }

    #[test]
    fn a_configuration_survives_its_own_toml_and_what_is_wrong_is_named() {
        let default = ValueConfig::default();
        let read: ValueConfig = toml::from_str(&default.to_toml()).unwrap();
        assert_eq!(read, default);
        assert!(default.check().is_ok());
        for (text, expected) in [
            ("[learning]\ngama = 0.9", "gama"),
            ("[learning]\nimitation_falls_over = 0.8", "half of the run"),
            ("families = []", "`families`"),
            ("sees = \"everything\"", "pictures"),
        ] {
            let config: Result<ValueConfig, _> = toml::from_str(text);
            let error = config.map_or_else(|e| e.to_string(), |c| c.check().unwrap_err().to_string());
            assert!(error.contains(expected), "{text}\n{error}");
        }
    }
}
