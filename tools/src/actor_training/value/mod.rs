//! Learning by value: DDPG with critics that see the true state and a reward along the shortest free way.
//!
//! An expert that sees the true state as well learns within minutes; the actor of the pictures learns from its own flights, by the
//! critics' slope, behind an encoder that is taught first and then frozen. `docs/learning.md` describes it and what was measured.

mod actors;
mod encoder;
mod flyer;
mod mlp;
mod run;
mod slope;
pub(super) mod store;
mod value_buffer;
mod value_config;
mod value_learner;

pub use encoder::EncoderError;
pub use run::{FamilyCount, ValueEnd, ValueError, ValueOptions, ValueProgress, ValueResult, ValueRow, run_value};
pub use slope::SlopeReport;
pub use value_config::{
    Along, EncoderConfig, Leader, Recipe, Sees, Teacher, ValueConfig, ValueEvaluation, ValueLearning, ValueReward,
};
pub use value_learner::{Expert, ValueReport};
