//! Network layers on caller-owned buffers: value, gradient with respect to input and weights, and DeepLIFT multipliers.
//!
//! Float32 throughout; images are `[row][column][channel]`. See docs/nnet.md for conventions and tolerances.
#![no_std]
#![deny(unsafe_code)]
#![warn(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

extern crate alloc;
#[cfg(feature = "std")]
extern crate std;

mod activation;
mod actor;
mod aligned;
mod conv;
mod dense;
mod error;
#[cfg(feature = "file")]
pub mod file;
mod graph;
mod gru;
mod isa;
mod kernels;
mod lstm;
mod math;
mod norm;
mod pool;
#[cfg(feature = "train")]
pub mod train;

pub use activation::{Activation, RESCALE_THRESHOLD};
pub use actor::{
    ACTOR_FRAMES, ACTOR_HIDDEN, ACTOR_LIMIT, ACTOR_OUTPUTS, ACTOR_POSITIONAL, Actor, ActorParams, ActorSpec,
    FRAMES_IN_A_ROW, FRAMES_SPREAD,
};
pub use aligned::Aligned;
pub use conv::Conv2d;
pub use dense::Dense;
pub use error::ShapeError;
pub use graph::{Graph, GraphBuilder, NodeId, Params, Purpose};
pub use gru::Gru;
pub use isa::Isa;
pub use lstm::Lstm;
pub use norm::BatchNorm;
pub use pool::MaxPool2d;

/// How far values and gradients of the portable kernels may be from those with fused multiply-add, relative to the
/// largest of the slice: they round each product once more. Those that fuse give the same bits.
pub const ISA_TOLERANCE: f32 = 5e-6;

/// The same for multipliers: a quotient of two small differences carries their rounding on.
pub const ISA_MULTIPLIER_TOLERANCE: f32 = 1e-4;
