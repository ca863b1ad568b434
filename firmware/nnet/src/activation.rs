//! Element-wise functions: value, gradient and DeepLIFT multipliers (rescale rule).

use crate::graph::operation::Operation;
use crate::graph::run::{Backward, Forward, Pass};
use crate::graph::{GraphBuilder, NodeId, Params};
use crate::isa::Isa;
use crate::math::{exp_m1_negative, sigmoid, tanh};
use crate::shape::{ShapeError, expect};
use crate::vectorised;

/// Below this difference of inputs the rescale rule uses the derivative at the explained input, as the `shap` package
/// does.
pub const RESCALE_THRESHOLD: f32 = 1e-6;

/// An element-wise function. Each has a derivative that follows from its value, so a gradient pass needs only outputs.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[allow(missing_docs, reason = "the formulas say what the fields are")]
pub enum Activation {
    /// `y = x`.
    #[default]
    Identity,
    /// `y = max(x, 0)`.
    Relu,
    /// `y = x` for `x > 0`, else `exp(x) − 1`.
    Elu,
    /// `y = scale · tanh(x)`. See [`Activation::TANH`].
    Tanh { scale: f32 },
    /// `y = 1 / (1 + exp(−x))`.
    Sigmoid,
    /// `y = 1 / (1 + gain · x)`: gives near obstacles contrast. A range that is normalised by 100 m becomes
    /// `1 / (1 + range / 3 m)` with the gain of [`Activation::NEAR_CONTRAST`]. Inputs are to be ≥ 0.
    NearContrast { gain: f32 },
}

impl Activation {
    /// Hyperbolic tangent.
    pub const TANH: Self = Self::Tanh { scale: 1.0 };
    /// `1 / (1 + range / 3 m)` of a range normalised by 100 m (a reduced prototype trained on raw range completed 83 %, on this 99.5 %).
    pub const NEAR_CONTRAST: Self = Self::NearContrast { gain: Self::NEAR_GAIN };
    /// Of [`Self::NEAR_CONTRAST`].
    pub const NEAR_GAIN: f32 = 100.0 / 3.0;

    /// The derivative, from the output.
    #[inline(always)]
    pub(crate) fn slope(self, y: f32) -> f32 {
        match self {
            Self::Identity => 1.0,
            Self::Relu | Self::Elu if y > 0.0 => 1.0,
            Self::Relu => 0.0,
            Self::Elu => y + 1.0,
            Self::Tanh { scale } => scale - y * y / scale,
            Self::Sigmoid => y * (1.0 - y),
            Self::NearContrast { gain } => -gain * y * y,
        }
    }

    /// `y = f(x)`.
    ///
    /// # Errors
    /// Slices of different lengths.
    pub fn apply(self, isa: Isa, x: &[f32], y: &mut [f32]) -> Result<(), ShapeError> {
        expect("activation output", y, x.len())?;
        y.copy_from_slice(x);
        self.apply_in_place(isa, y);
        Ok(())
    }

    /// `y = f(y)`.
    pub fn apply_in_place(self, isa: Isa, y: &mut [f32]) {
        apply(isa, self, y);
    }

    /// `d = d · f'`, with the derivative taken from the output `y`.
    ///
    /// # Errors
    /// Slices of different lengths.
    pub fn gradient(self, isa: Isa, y: &[f32], d: &mut [f32]) -> Result<(), ShapeError> {
        expect("activation gradient", d, y.len())?;
        gradient(isa, self, y, d);
        Ok(())
    }

    /// `m = m · Δy / Δx` between the explained input (`x`, `y`) and the reference (`x_ref`, `y_ref`), or the derivative
    /// at `x` where |Δx| is below [`RESCALE_THRESHOLD`].
    ///
    /// # Errors
    /// Slices of different lengths.
    pub fn multipliers(
        self,
        isa: Isa,
        (x, y): (&[f32], &[f32]),
        (x_ref, y_ref): (&[f32], &[f32]),
        m: &mut [f32],
    ) -> Result<(), ShapeError> {
        for slice in [x, x_ref, y_ref, m] {
            expect("activation multipliers", slice, y.len())?;
        }
        multipliers(isa, self, x, y, x_ref, y_ref, m);
        Ok(())
    }
}

/// `m = Δy / Δx` for one element of any differentiable curve.
#[inline(always)]
pub(crate) fn rescale(x: f32, y: f32, x_ref: f32, y_ref: f32, slope: f32) -> f32 {
    let dx = x - x_ref;
    let ratio = (y - y_ref) / dx;
    if dx.abs() < RESCALE_THRESHOLD { slope } else { ratio }
}

#[inline(always)]
fn map(y: &mut [f32], f: impl Fn(f32) -> f32) {
    for y in y {
        *y = f(*y);
    }
}

vectorised! {
    fn apply<'a>(act: Activation, y: &'a mut [f32]) {
        match act {
            Activation::Identity => {}
            // Written so that NaN stays NaN. A sum of which one part is 0, as below: a choice between the two becomes a masked store,
            // which costs AVX2 more than the rest.
            Activation::Relu => map(y, |x| 0.0 + if x < 0.0 { 0.0 } else { x }),
            Activation::Elu => map(y, |x| {
                let (above, below) = if x > 0.0 { (x, 0.0) } else { (0.0, x) };
                above + exp_m1_negative::<FUSED>(below)
            }),
            Activation::Tanh { scale } => map(y, |x| scale * tanh::<FUSED>(x)),
            Activation::Sigmoid => map(y, sigmoid::<FUSED>),
            Activation::NearContrast { gain } => map(y, |x| 1.0 / (1.0 + gain * x)),
        }
    }
}

/// Runs a loop with the activation's derivative as a function of its output, written out for each curve, so that the choice is made
/// outside the loop.
macro_rules! by_curve {
    ($act:expr, $slope:ident => $body:stmt) => {
        by_curve!($act, $slope => $body; Relu, Elu, Tanh { scale }, Sigmoid, NearContrast { gain })
    };
    ($act:expr, $slope:ident => $body:stmt; $($name:ident $({ $value:ident })?),*) => {
        match $act {
            Activation::Identity => {}
            $(Activation::$name $({ $value })? => {
                let $slope = move |y| Activation::$name $({ $value })?.slope(y);
                $body
            })*
        }
    };
}

vectorised! {
    fn gradient<'a>(act: Activation, y: &'a [f32], d: &'a mut [f32]) {
        by_curve!(act, slope => for (d, y) in d.iter_mut().zip(y) {
            *d *= slope(*y);
        });
    }
}

vectorised! {
    fn multipliers<'a>(
        act: Activation,
        x: &'a [f32],
        y: &'a [f32],
        x_ref: &'a [f32],
        y_ref: &'a [f32],
        m: &'a mut [f32],
    ) {
        let (now, reference) = (x.iter().zip(y), x_ref.iter().zip(y_ref));
        by_curve!(act, slope => for ((m, (x, y)), (x_ref, y_ref)) in m.iter_mut().zip(now).zip(reference) {
            *m *= rescale(*x, *y, *x_ref, *y_ref, slope(*y));
        });
    }
}

impl GraphBuilder {
    /// An element-wise function.
    ///
    /// # Errors
    /// An unknown node.
    pub fn activation(&mut self, x: NodeId, activation: Activation) -> Result<NodeId, ShapeError> {
        let len = self.len_of(x)?;
        self.add(activation, &[x], len, Params::default())
    }
}

impl Operation for Activation {
    fn forward_node(&self, node: &mut Forward<'_>) -> Result<(), ShapeError> {
        self.apply(node.isa, node.source(0)?, node.value)
    }

    fn backward_node(&self, node: &mut Backward<'_>, d: &mut [f32], pass: &mut Pass<'_>) -> Result<(), ShapeError> {
        // The curve's input is the source's value, so it is not kept twice.
        let (x, y) = (node.source(0, node.tape)?, node.kept(node.tape)?.value);
        match pass.reference() {
            None => self.gradient(node.isa, y, d)?,
            Some(reference) => {
                let (x_ref, y_ref) = (node.source(0, reference)?, node.kept(reference)?.value);
                self.multipliers(node.isa, (x, y), (x_ref, y_ref), d)?;
            }
        }
        node.hand_on(0, d)
    }
}
