//! What a node of a graph computes. Each layer implements [`Operation`] beside itself; [`AnyOperation`] lists them.

use super::Purpose;
use super::run::{Backward, Forward, Pass};
use super::structure::{Concat, Input, Slice, Zeros};
use crate::elementwise::{Product, Sum};
use crate::shape::ShapeError;
use crate::{Activation, BatchNorm, Conv2d, Dense, Function, Gru, LayerNorm, Lstm, MaxPool2d};

/// A layer as a node of a graph.
pub(crate) trait Operation {
    /// Values that a node of `len` values keeps on its tape besides them.
    fn aux_len(&self, _len: usize, _purpose: Purpose) -> usize {
        0
    }

    /// Values that the backward pass needs besides the gradients.
    fn scratch_len(&self) -> usize {
        0
    }

    /// Writes the node's value, and what it keeps besides, from its sources' values.
    fn forward_node(&self, node: &mut Forward<'_>) -> Result<(), ShapeError>;

    /// Turns `d`, the gradient or the multipliers of the node's value, into those of its sources and, if the pass wants them,
    /// adds those of its parameters. A node without sources has nothing to hand on.
    fn backward_node(&self, _: &mut Backward<'_>, _: &mut [f32], _: &mut Pass<'_>) -> Result<(), ShapeError> {
        Ok(())
    }

    /// Writes the parameters in the order that the backward pass reads. Both slices have the layer's length.
    fn pack_node(&self, params: &[f32], packed: &mut [f32]) -> Result<(), ShapeError> {
        // Nothing to transpose.
        packed.copy_from_slice(params);
        Ok(())
    }

    /// First parameters, as PyTorch draws them; `draw` gives a number uniform within ± its argument.
    #[cfg(feature = "train")]
    fn initialize_node(&self, _params: &mut [f32], _draw: &mut dyn FnMut(f32) -> f32) {}
}

macro_rules! operations {
    ($($name:ident($type:ty),)+) => {
        /// Any of the operations.
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub(crate) enum AnyOperation {
            $($name($type),)+
        }

        $(impl From<$type> for AnyOperation {
            fn from(operation: $type) -> Self {
                Self::$name(operation)
            }
        })+

        impl AnyOperation {
            pub fn get(&self) -> &dyn Operation {
                match self {
                    $(Self::$name(operation) => operation,)+
                }
            }
        }
    };
}

// A new layer is a row here, besides its file.
operations! {
    Input(Input),
    Zeros(Zeros),
    Concat(Concat),
    Slice(Slice),
    Conv2d((Conv2d, Activation)),
    Dense((Dense, Activation)),
    Activation(Activation),
    BatchNorm(BatchNorm),
    MaxPool2d(MaxPool2d),
    Gru(Gru),
    Lstm(Lstm),
    Function(Function),
    Sum(Sum),
    Product(Product),
    LayerNorm(LayerNorm),
}

/// Draws within ±1/√(inputs of a unit).
#[cfg(feature = "train")]
pub(crate) fn draw_for(fan_in: usize, params: &mut [f32], draw: &mut dyn FnMut(f32) -> f32) {
    let limit = 1.0 / libm::sqrtf(fan_in as f32);
    for param in params {
        *param = draw(limit);
    }
}
