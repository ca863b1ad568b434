//! Functions of single values whose derivative does not follow from their result, and sums and products of nodes: what networks of
//! others have besides layers with weights. Multipliers: rescale rule, and for products the midpoint rule.

use crate::activation::rescale;
use crate::graph::operation::Operation;
use crate::graph::run::{Backward, Forward, Pass};
use crate::graph::{GraphBuilder, NodeId, Params, description};
use crate::shape::{ShapeError, expect};

/// A function of single values. Unlike an [`Activation`](crate::Activation) it is no part of the layer before it, and its derivative
/// needs its input.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(missing_docs, reason = "the formulas say what the fields are")]
pub enum Function {
    /// `y = x` for `x ≥ 0`, else `alpha · x`.
    LeakyRelu { alpha: f32 },
    /// `y = x` for `x > 0`, else `alpha · (exp(x) − 1)`.
    Elu { alpha: f32 },
    /// `y = ln(1 + exp(x))`.
    Softplus,
    /// `y = min(max(x, least), most)`.
    Clip { least: f32, most: f32 },
    /// `y = x ^ exponent`.
    Power { exponent: f32 },
    /// `y = exp(x)`.
    Exp,
    /// `y = ln(x)`.
    Log,
    /// `y = |x|`.
    Abs,
    /// `y = erf(x)`, the error function.
    Erf,
}

impl Function {
    /// The function's value. Written so that NaN stays NaN.
    pub fn value(self, x: f32) -> f32 {
        match self {
            Self::LeakyRelu { alpha } if x < 0.0 => alpha * x,
            Self::LeakyRelu { .. } => x,
            Self::Elu { alpha } if x <= 0.0 => alpha * libm::expm1f(x),
            Self::Elu { .. } => x,
            Self::Softplus => (if x < 0.0 { 0.0 } else { x }) + libm::log1pf(libm::expf(-x.abs())),
            Self::Clip { least, most } => {
                let raised = if x < least { least } else { x };
                if raised > most { most } else { raised }
            }
            Self::Power { exponent } => match exponent {
                2.0 => x * x,
                3.0 => x * x * x,
                0.5 => libm::sqrtf(x),
                -1.0 => 1.0 / x,
                _ => libm::powf(x, exponent),
            },
            Self::Exp => libm::expf(x),
            Self::Log => libm::logf(x),
            Self::Abs => x.abs(),
            Self::Erf => libm::erff(x),
        }
    }

    /// The derivative, from input and value.
    fn slope(self, x: f32, y: f32) -> f32 {
        match self {
            Self::LeakyRelu { alpha } if x < 0.0 => alpha,
            Self::LeakyRelu { .. } => 1.0,
            Self::Elu { alpha } if x <= 0.0 => y + alpha,
            Self::Elu { .. } => 1.0,
            Self::Softplus => 1.0 / (1.0 + libm::expf(-x)),
            Self::Clip { least, most } if x < least || x > most => 0.0,
            Self::Clip { .. } => 1.0,
            Self::Power { exponent } => match exponent {
                2.0 => 2.0 * x,
                0.5 => 0.5 / y,
                -1.0 => -y * y,
                _ => exponent * libm::powf(x, exponent - 1.0),
            },
            Self::Exp => y,
            Self::Log => 1.0 / x,
            Self::Abs if x == 0.0 => 0.0,
            Self::Abs => 1.0_f32.copysign(x),
            Self::Erf => core::f32::consts::FRAC_2_SQRT_PI * libm::expf(-x * x),
        }
    }
}

/// The sum of nodes of one length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Sum;

/// The product of two nodes of one length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Product;

impl GraphBuilder {
    /// A function of each value.
    ///
    /// # Errors
    /// An unknown node.
    pub fn function(&mut self, x: NodeId, function: Function) -> Result<NodeId, ShapeError> {
        let len = self.len_of(x)?;
        self.add(function, &[x], len, Params::default())
    }

    /// The sum of nodes, value by value.
    ///
    /// # Errors
    /// No nodes, an unknown one, or nodes of several lengths.
    pub fn sum(&mut self, parts: &[NodeId]) -> Result<NodeId, ShapeError> {
        let Some(first) = parts.first() else {
            return description("sum", "it has no nodes");
        };
        let len = self.len_of(*first)?;
        for part in parts {
            self.check("summand", *part, len)?;
        }
        self.add(Sum, parts, len, Params::default())
    }

    /// The product of two nodes, value by value.
    ///
    /// # Errors
    /// An unknown node, or nodes of two lengths.
    pub fn product(&mut self, x: NodeId, y: NodeId) -> Result<NodeId, ShapeError> {
        let len = self.len_of(x)?;
        self.check("factor", y, len)?;
        self.add(Product, &[x, y], len, Params::default())
    }
}

impl Operation for Function {
    fn forward_node(&self, node: &mut Forward<'_>) -> Result<(), ShapeError> {
        let x = node.source(0)?;
        expect("function's input", x, node.value.len())?;
        for (y, x) in node.value.iter_mut().zip(x) {
            *y = self.value(*x);
        }
        Ok(())
    }

    fn backward_node(&self, node: &mut Backward<'_>, d: &mut [f32], pass: &mut Pass<'_>) -> Result<(), ShapeError> {
        let (x, y) = (node.source(0, node.tape)?, node.kept(node.tape)?.value);
        match pass.reference() {
            None => {
                for (d, (x, y)) in d.iter_mut().zip(x.iter().zip(y)) {
                    *d *= self.slope(*x, *y);
                }
            }
            Some(reference) => {
                let of_reference = node.source(0, reference)?.iter().zip(node.kept(reference)?.value);
                for ((d, (x, y)), (x_ref, y_ref)) in d.iter_mut().zip(x.iter().zip(y)).zip(of_reference) {
                    *d *= rescale(*x, *y, *x_ref, *y_ref, self.slope(*x, *y));
                }
            }
        }
        node.hand_on(0, d)
    }
}

impl Operation for Sum {
    fn forward_node(&self, node: &mut Forward<'_>) -> Result<(), ShapeError> {
        node.value.copy_from_slice(node.source(0)?);
        for i in 1..node.source_count() {
            let x = node.source(i)?;
            for (y, x) in node.value.iter_mut().zip(x) {
                *y += x;
            }
        }
        Ok(())
    }

    fn backward_node(&self, node: &mut Backward<'_>, d: &mut [f32], _: &mut Pass<'_>) -> Result<(), ShapeError> {
        for i in 0..node.source_count() {
            node.hand_on(i, d)?;
        }
        Ok(())
    }
}

impl Operation for Product {
    fn forward_node(&self, node: &mut Forward<'_>) -> Result<(), ShapeError> {
        let both = node.source(0)?.iter().zip(node.source(1)?);
        for (y, (a, b)) in node.value.iter_mut().zip(both) {
            *y = a * b;
        }
        Ok(())
    }

    fn backward_node(&self, node: &mut Backward<'_>, d: &mut [f32], pass: &mut Pass<'_>) -> Result<(), ShapeError> {
        let tape = node.tape;
        // Against a reference the mean of both: Δ(ab) = Δa · mean(b) + Δb · mean(a), exactly.
        let reference = pass.reference().unwrap_or(tape);
        for i in 0..2 {
            let (other, other_ref) = (node.source(1 - i, tape)?, node.source(1 - i, reference)?);
            node.write_source(i, |dx, _| {
                for ((dx, d), (b, b_ref)) in dx.iter_mut().zip(d.iter()).zip(other.iter().zip(other_ref)) {
                    *dx = d * 0.5 * (b + b_ref);
                }
                Ok(())
            })?;
        }
        Ok(())
    }
}
