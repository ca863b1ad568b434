//! The adversary: alters depth frames so that the actor turns the wrong way. White box: it knows the actor's weights, the
//! goal and, from the frames' headers, where the vehicle is. It alters pixels only (docs/adversary.md).
//!
//! Shapes: a frame is `[128][256]` ranges over 100 m, row by row (32 768 values); a state five of them, oldest first (163 840);
//! `position` the goal's distance / 20 m and bearing / 1 rad; outputs forward velocity and yaw, each in ±1.5.
//!
//! ```
//! use vigil_adversary::{AttackConfig, StreamAttack};
//! use vigil_nnet::Isa;
//! use vigil_policy::FrozenActor;
//! use vigil_policy::actor::PositionalInputs;
//! use vigil_types::DEPTH_PIXELS;
//!
//! let actor = FrozenActor::built_in()?;
//! let config = AttackConfig { iterations: 2, ..AttackConfig::PAPER };
//! let mut adversary = StreamAttack::new(Isa::detect(), &actor, &config)?;
//! let mut frame = vec![0.2; DEPTH_PIXELS]; // a wall at 20 m all around
//! adversary.attack(&mut frame, PositionalInputs::at_rest([1.0, 0.0], actor.inputs))?;
//! let most = frame.iter().map(|range| (range - 0.2).abs()).fold(0.0, f32::max);
//! assert!(most > 0.0 && most <= 2.0 / 255.0 + 1e-6, "two iterations of 1/255: {most}");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod attack;
mod burst;
mod config;
mod detector_evasion;
mod frame_attack;
mod guard_evasion;
mod intercept;
mod perturb;
mod policy_attack;
pub mod process;
mod state_attack;
mod stream_attack;
mod surrogate;

pub use attack::{Attack, AttackArgs, AttackRecord};
pub use burst::{Burst, BurstPlan, SINGLE_BURST_FIRST, SINGLE_BURST_LAST};
pub use config::{
    AttackConfig, AttackError, AttackOutcome, EFFECTIVE_YAW, Method, REPLAYED_FRAMES, SPSA_QUERIES, Towards,
};
pub use frame_attack::FrameAttack;
pub use intercept::{Interceptor, PassedStep, goal_seen_from};
pub use policy_attack::PolicyAttack;
pub use state_attack::StateAttack;
pub use stream_attack::StreamAttack;
