//! Network layers on caller-owned buffers: value, gradient with respect to input and weights, and DeepLIFT multipliers.
//! The networks made of them are elsewhere: the actor in `vigil-policy`, the detectors in `vigil-detector`.
//!
//! Float32 throughout; images are `[row][column][channel]`. See docs/nnet.md for conventions and tolerances.
//!
//! A [`Graph`] describes a network; the caller owns parameters, tape and work buffer, so that evaluating allocates nothing.
//!
//! ```
//! use vigil_nnet::{Activation, Dense, GraphBuilder, Isa, Purpose, ShapeError};
//!
//! let layer = Dense { inputs: 2, outputs: 1 };
//! let mut b = GraphBuilder::new();
//! let (weights, x) = (b.params(layer.param_len()), b.input(2, true)?);
//! let y = b.dense(x, layer, Activation::Relu, weights)?;
//! let graph = b.finish(y, Purpose::Gradients)?;
//!
//! let params = [3.0, -1.0, 0.5]; // weights [inputs][outputs], then the bias
//! let mut tape = vec![0.0; graph.tape_len()];
//! graph.forward(Isa::detect(), &params, &[&[2.0, 1.0]], &mut tape)?;
//! assert_eq!(graph.output(&tape)?, [5.5]);
//!
//! let mut packed = vec![0.0; graph.param_len()];
//! graph.pack(&params, &mut packed)?;
//! let mut work = vec![0.0; graph.work_len()];
//! graph.backward(Isa::detect(), &packed, &tape, &[1.0], None, &mut work)?;
//! assert_eq!(graph.input_gradient(&work, 0)?, [3.0, -1.0]);
//! # Ok::<(), ShapeError>(())
//! ```
#![no_std]
#![deny(unsafe_code)]
#![warn(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

extern crate alloc;
#[cfg(feature = "std")]
extern crate std;

mod activation;
mod aligned;
mod conv;
mod dense;
mod elementwise;
mod graph;
mod gru;
mod isa;
mod kernels;
mod layer_norm;
mod lstm;
mod math;
#[cfg(feature = "file")]
pub mod network_file;
mod norm;
mod pool;
pub mod shape;
#[cfg(feature = "train")]
pub mod train;

pub use activation::{Activation, RESCALE_THRESHOLD};
pub use aligned::Aligned;
pub use conv::Conv2d;
pub use conv::chain::ConvChain;
pub use dense::Dense;
pub use elementwise::Function;
pub use graph::{Graph, GraphBuilder, NodeId, Params, Purpose};
pub use gru::Gru;
pub use isa::Isa;
pub use kernels::Task;
pub use layer_norm::LayerNorm;
pub use lstm::Lstm;
pub use norm::BatchNorm;
pub use pool::MaxPool2d;
pub use shape::ShapeError;

/// How far values and gradients of the portable kernels may be from those with fused multiply-add, relative to the
/// largest of the slice: they round each product once more. Those that fuse give the same bits.
pub const ISA_TOLERANCE: f32 = 5e-6;

/// The same for multipliers: a quotient of two small differences carries their rounding on.
pub const ISA_MULTIPLIER_TOLERANCE: f32 = 1e-4;
