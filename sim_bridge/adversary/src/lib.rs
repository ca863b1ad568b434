//! The adversary: alters depth frames so that the actor turns the wrong way. White box: it knows the actor's weights, the
//! goal and, from the frames' headers, where the vehicle is. It alters pixels only (docs/adversary.md).
//!
//! Shapes: a frame is `[128][256]` ranges over 100 m, row by row (32 768 values); outputs are forward velocity and yaw, each in ±1.5.
//!
//! ```
//! use vigil_adversary::{AttackConfig, StreamAttack};
//! use vigil_nnet::Isa;
//! use vigil_policy::{FrozenActor, PilotInput};
//! use vigil_types::{DepthFrame, GoalRelative};
//!
//! let actor = FrozenActor::built_in()?;
//! let config = AttackConfig { iterations: 2, ..AttackConfig::PAPER };
//! let mut adversary = StreamAttack::new(Isa::detect(), &actor, &config)?;
//! let (mut frame, mut delivered) = (DepthFrame::EMPTY, DepthFrame::EMPTY);
//! frame.depth.fill(0.2); // a wall at 20 m all around
//! let goal = GoalRelative { distance_m: 20.0, bearing_rad: 0.0 };
//! let taken = PilotInput { height_m: 1.5, ..PilotInput::at_rest(&frame, goal) };
//! adversary.attack_while(&taken, &mut delivered, || true)?;
//! let most = delivered.depth.iter().map(|range| (range - 0.2).abs()).fold(0.0, f32::max);
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
pub use burst::{Burst, SINGLE_BURST_FIRST, SINGLE_BURST_LAST};
pub use config::{
    AttackConfig, AttackError, AttackOutcome, EFFECTIVE_YAW, Method, REPLAYED_FRAMES, SPSA_QUERIES, SWELL_FRAMES,
    Towards,
};
pub use frame_attack::FrameAttack;
pub use intercept::{Interceptor, goal_seen_from};
pub use policy_attack::PolicyAttack;
pub use state_attack::StateAttack;
pub use stream_attack::StreamAttack;
pub use surrogate::{Beside, Evaluated};
