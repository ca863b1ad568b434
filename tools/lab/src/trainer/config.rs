//! What a run is made of: a TOML file whose every key is optional and whose unknown keys are refused.

use std::path::Path;
use vigil_firmware::removed;
use vigil_policy::actor::SLOWEST_M_S;
use vigil_sim::world::Family;
use vigil_types::parameters::Range;
use vigil_types::settings;
use vigil_types::settings::{Outside, SettingsError, free, named_setting, section, within};
use vigil_types::{ACTION_LIMIT, FASTEST_M_S};

settings! {
    /// A run.
    pub struct LearnConfig {
        /// Fixes courses, noise, initial weights and samples: the same seed trains the same actor, bit for bit, on machines with the same
        /// instruction set.
        pub seed: u64 = free(1),
        /// Threads; any number trains the same actor.
        pub threads: usize = within(1, (1.0, 256.0), ""),
        /// Each training flight's course is of one of these, in turn by chance.
        pub families: Vec<Family> = free(vec![Family::Training, Family::Hard, Family::Hard]),
        /// Decisions after which training ends; rates and noise fall by them.
        pub decisions: u64 = free(320_000),
        /// Decisions of noise that fill the replay memory before the first update (the paper: 5 000).
        pub warm_up: u64 = free(5_000),
        /// Mean forward output of the warm-up's noise: noise alone stays where it is.
        pub warm_up_forward: f32 = within(0.7, (-1.5, 1.5), ""),
        /// Flights at the same time.
        pub environments: usize = within(32, (1.0, 256.0), ""),
        /// What the forward output is at its limit.
        pub cruise_m_s: f32 = within(ACTION_LIMIT, (f64::from(SLOWEST_M_S), f64::from(FASTEST_M_S)), "m/s"),
        /// Steps of 0.05 s that a decision lasts while training.
        pub steps_per_decision: usize = within(4, (1.0, 40.0), ""),
        /// A training flight is cut off after this time, seconds. The value of its last state still counts.
        pub time_limit_s: f32 = within(60.0, (1.0, 3600.0), ""),
        /// Share of the training flights whose odometry drifts, by up to `drift_scale` of the path and `drift_yaw_deg_s`.
        pub drift_share: f64 = within(0.25, (0.0, 1.0), ""),
        /// Most by which a path seems longer or shorter, as a share.
        pub drift_scale: f32 = within(0.02, (0.0, 0.5), ""),
        /// Most turning that does not happen, degrees per second.
        pub drift_yaw_deg_s: f32 = within(0.5, (0.0, 10.0), ""),
        /// Share of the training flights whose vehicle is one drawn between the models of other autopilots.
        pub drawn_vehicle_share: f64 = within(0.25, (0.0, 1.0), ""),
        /// Exploration.
        pub noise: NoiseConfig = section(),
        /// Share of the training flights in which the potential field is added to the action (the paper: 1).
        pub apf_share: f64 = within(0.25, (0.0, 1.0), ""),
        /// Reward.
        pub reward: RewardConfig = section(),
        /// Updates.
        pub learning: LearningConfig = section(),
        /// Replay memory.
        pub replay: ReplayConfig = section(),
        /// Flights that evaluate the actor.
        pub evaluation: EvaluationConfig = section(),
        /// What the encoder learns before it is frozen.
        pub encoder: EncoderConfig = section(),
    }

    /// Ornstein-Uhlenbeck noise on the action.
    pub struct NoiseConfig {
        /// Share of the noise that decays per decision.
        pub theta: f32 = within(0.15, (0.001, 1.0), ""),
        /// Standard deviation at first, action units.
        pub sigma_first: f32 = within(1.0, (0.0, 10.0), ""),
        /// Standard deviation at last.
        pub sigma_last: f32 = within(0.1, (0.0, 10.0), ""),
        /// Share of the run over which it falls linearly.
        pub falls_over: f32 = within(0.5, (0.001, 1.0), ""),
        /// Share of the flights after the warm-up that have noise.
        pub share: f64 = within(0.7, (0.0, 1.0), ""),
    }
}

/// Along what the reward measures progress.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Along {
    /// The shortest free path past what stands still.
    Path,
    /// The straight line to the goal (the paper).
    Line,
}

settings! {
    /// Reward: metres of progress, and these.
    pub struct RewardConfig {
        /// Progress along what.
        pub along: Along = free(Along::Path),
        /// At the goal.
        pub success: f32 = within(5.0, (-1e6, 1e6), ""),
        /// For collision and out of bounds (the paper: −2).
        pub dead: f32 = within(-6.0, (-1e6, 1e6), ""),
        /// For each decision (the paper: 0).
        pub decision: f32 = within(-0.02, (-1e6, 1e6), ""),
        /// At checkpoint C of N: this times (1 + C/N) (the paper: 2).
        pub checkpoint: f32 = within(0.0, (-1e6, 1e6), ""),
        /// For each decision that ends less than 1 m from an obstacle, times the square of the share of that metre that is missing
        /// (the paper: not there).
        pub near: f32 = within(-0.3, (-1e6, 1e6), ""),
    }

    /// The updates of actor and critics.
    pub struct LearningConfig {
        /// Discount per decision.
        pub gamma: f32 = within(0.97, (0.0, 1.0), ""),
        /// Rewards summed before the critics' value is used.
        pub n_steps: usize = within(3, (1.0, 100.0), ""),
        /// Transitions in an update.
        pub batch: usize = within(128, (1.0, 4096.0), ""),
        /// Decisions per update.
        pub decisions_per_update: u64 = within(2, (1.0, f64::INFINITY), ""),
        /// Adam's rate for the actor.
        pub actor_rate: f32 = within(3e-4, (0.0, 1.0), ""),
        /// Adam's rate for the critics.
        pub critic_rate: f32 = within(5e-4, (0.0, 1.0), ""),
        /// Share of all updates after which the rates begin to fall linearly, to a tenth at the end; 1 keeps them.
        pub rates_fall_from: f64 = within(0.6, (0.0, 1.0), ""),
        /// Share of the weights that the target networks take over at each update.
        pub tau: f32 = within(0.005, (0.0, 1.0), ""),
        /// Longest gradient.
        pub gradient_norm: f32 = within(5.0, (1e-6, 1e9), ""),
        /// Weight of the square of what exceeds 1 before the actor's last tanh.
        pub saturation_penalty: f32 = within(0.05, (0.0, 1e6), ""),
        /// Standard deviation of the noise on the target's action, cut off at twice that.
        pub smoothing: f32 = within(0.15, (0.0, 10.0), ""),
        /// Units of the critics' two layers.
        pub critic_units: [usize; 2] = within([256, 256], (1.0, 4096.0), ""),
        /// Half of the sampled transitions are seen in a mirror.
        pub mirror: bool = free(true),
    }

    /// Replay memory.
    pub struct ReplayConfig {
        /// Decisions stored; one takes 1 kB.
        pub decisions: usize = within(300_000, (1.0, 1e8), ""),
        /// Exponent of the priority; 0 samples evenly.
        pub alpha: f64 = within(0.0, (0.0, 1.0), ""),
        /// Exponent of the importance weights.
        pub beta: f64 = within(0.4, (0.0, 1.0), ""),
    }

    /// Flights that evaluate the actor, always over the same courses.
    pub struct EvaluationConfig {
        /// Updates between evaluations.
        pub every_updates: u64 = within(10_000, (1.0, f64::INFINITY), ""),
        /// Families that are flown at each; the mean of their completions chooses.
        pub families: Vec<Family> = free(vec![Family::Validation, Family::Hard]),
        /// Flights of each.
        pub flights: u64 = within(60, (1.0, f64::INFINITY), ""),
        /// Flights of each that choose between the best at the end.
        pub final_flights: u64 = free(200),
        /// Seed of the first course.
        pub first_seed: u64 = free(0),
        /// A flight that takes longer has failed, seconds.
        pub time_limit_s: f32 = within(90.0, (1.0, 3600.0), ""),
    }

    /// What the encoder learns before it is frozen: the collision scan, from single frames.
    pub struct EncoderConfig {
        /// Updates.
        pub updates: u64 = free(8_000),
        /// Frames in an update.
        pub batch: usize = within(48, (1.0, 4096.0), ""),
        /// Adam's rate.
        pub rate: f32 = within(2e-3, (0.0, 1.0), ""),
    }
}

named_setting!(Along, [("path", Along::Path), ("line", Along::Line)]);

impl LearnConfig {
    /// Reads and checks a file; what it does not name keeps its default.
    ///
    /// # Errors
    /// [`SettingsError`].
    pub fn load(path: &Path) -> Result<Self, SettingsError> {
        let refused = |message: String| {
            let path = path.to_owned();
            SettingsError::Content { path, message }
        };
        let config: Self = settings::load(path).map_err(|error| match error {
            SettingsError::Content { message, .. } => refused(removed::explain(message)),
            read => read,
        })?;
        config.check().map_err(|outside| refused(outside.to_string()))?;
        Ok(config)
    }

    /// Updates that belong to so many decisions.
    pub fn updates_due(&self, decisions: u64) -> u64 {
        decisions.saturating_sub(self.warm_up) / self.learning.decisions_per_update.max(1)
    }

    /// Checks every value.
    ///
    /// # Errors
    /// The first one that is not allowed.
    pub fn check(&self) -> Result<(), Outside> {
        settings::check(self)?;
        let held = (self.environments * (self.learning.n_steps + 40)) as f64;
        for (key, value, least) in [
            ("families", self.families.len() as f64, 1.0),
            ("decisions", self.decisions as f64, self.warm_up as f64 + 1.0),
            ("warm_up", self.warm_up as f64, held),
            ("replay.decisions", self.replay.decisions as f64, held),
        ] {
            let range = Range::from_least(least);
            if !range.contains(value) {
                let key = key.to_owned();
                return Err(Outside { key, value, range });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_configuration_survives_its_own_toml_and_what_is_wrong_is_named() {
        let default = LearnConfig::default();
        let read: LearnConfig = settings::from_toml(&settings::to_toml(&default)).unwrap();
        assert_eq!(read, default);
        assert!(default.check().is_ok());
        for (text, expected) in [
            ("[learning]\ngama = 0.9", "gama"),
            ("drift_share = nan", "`drift_share`"),
            ("families = []", "`families`"),
            ("warm_up = 10", "`warm_up`"),
            ("[learning]\nsmoothing = -0.1", "`learning.smoothing`"),
            ("[learning]\nsaturation_penalty = inf", "`learning.saturation_penalty`"),
            ("[reward]\nnear = nan", "`reward.near`"),
            ("[evaluation]\nflights = 0", "`evaluation.flights`"),
            ("[learning]\ncritic_units = [0, 256]", "`learning.critic_units`"),
            ("[replay]\ndecisions = 100_000_000_000_000", "`replay.decisions`"),
        ] {
            let config: Result<LearnConfig, _> = settings::from_toml(text);
            let error = config.map_or_else(|e| e, |c| c.check().unwrap_err().to_string());
            assert!(error.contains(expected), "{text}\n{error}");
        }
        let folder = tempfile::tempdir().unwrap();
        let earlier = folder.path().join("earlier.toml");
        for (text, expected) in [
            ("[learning]\ntwin = true", "`twin` is of an earlier version"),
            ("[reward]\nalong = \"way\"", "it is called `path`"),
        ] {
            std::fs::write(&earlier, text).unwrap();
            let error = LearnConfig::load(&earlier).unwrap_err().to_string();
            assert!(error.contains(expected), "{text}\n{error}");
        }
    }
}
