//! The adversary: alters depth frames so that the actor turns the wrong way. White box: it knows the actor's weights, the
//! goal and, from the frames' headers, where the vehicle is. It alters pixels only (docs/adversary.md).
//!
//! Shapes: a frame is `[128][256]` ranges over 100 m, row by row (32 768 values); a state five of them, oldest first (163 840);
//! `position` the goal's distance / 20 m and bearing / 1 rad; outputs forward velocity and yaw, each in ±1.5.

mod attack;
mod burst;
mod config;
mod detector_evasion;
mod intercept;
mod perturb;
pub mod process;
mod state_attack;
mod stream_attack;
mod surrogate;

pub use attack::{Attack, AttackArgs, AttackRecord};
pub use burst::{Burst, BurstPlan, SINGLE_BURST_FIRST, SINGLE_BURST_LAST};
pub use config::{AttackConfig, AttackError, AttackOutcome, EFFECTIVE_YAW, Method, Towards};
pub use intercept::{Interceptor, PassedStep, goal_seen_from};
pub use state_attack::StateAttack;
pub use stream_attack::StreamAttack;
