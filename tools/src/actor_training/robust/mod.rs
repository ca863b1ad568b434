//! An actor whose decisions provably hold: one that flies is taught on, by itself, to decide alike for all frames within ε.
//!
//! Interval arithmetic bounds its outputs over the box of frames (`vigil_nnet::Graph::bounds`), and the ends of the bounds are drawn to
//! what the teacher does, with ε rising from 0 (Gowal et al. 2018; for policies Zhang et al. 2020 and Oikarinen et al. 2021). The states
//! are those that the actor itself flies to. `docs/robustness.md` says what came of it.

mod bounded_learner;
mod kept_flights;
mod robust_config;
mod robust_run;

pub use robust_config::RobustConfig;
pub use robust_run::{RobustEnd, RobustError, RobustOptions, RobustResult, RobustRow, run_robust};
