//! Layer normalisation, for actor and critics: it keeps their values from growing where they have seen none (Ball et al. 2023).

use crate::Purpose;
use crate::graph::operation::Operation;
use crate::graph::run::{self, Pass};
use crate::graph::{GraphBuilder, NodeId, Params};
use crate::isa::Isa;
use crate::kernels::{self, Task};
use crate::shape::{ShapeError, expect};

/// Normalises each row to mean 0 and variance 1, then scales and shifts each column (Ba et al. 2016).
///
/// Parameters, in this order: scale γ `[width]`, shift β `[width]`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LayerNorm {
    /// Length of a row.
    pub width: usize,
    /// Added to the variance.
    pub epsilon: f32,
}

impl LayerNorm {
    /// Number of parameters.
    pub fn param_len(&self) -> usize {
        2 * self.width
    }

    fn rows(&self, x: &[f32]) -> Result<usize, ShapeError> {
        let rows = x.len() / self.width.max(1);
        expect("layer norm input", x, rows * self.width)?;
        Ok(rows)
    }

    /// `y = γ x̂ + β` for `x.len() / width` rows, where `x̂ = (x − mean) / √(variance + ε)` of the row. `normal` receives `x̂`
    /// `[rows][width]`, `inverse` the rows' `1 / √(variance + ε)`: what [`Self::backward`] needs.
    ///
    /// # Errors
    /// Slices that do not fit.
    pub fn forward(
        &self,
        isa: Isa,
        params: &[f32],
        x: &[f32],
        normal: &mut [f32],
        inverse: &mut [f32],
        y: &mut [f32],
    ) -> Result<(), ShapeError> {
        let rows = self.rows(x)?;
        expect("layer norm parameters", params, self.param_len())?;
        expect("layer norm normal", normal, x.len())?;
        expect("layer norm deviations", inverse, rows)?;
        expect("layer norm output", y, x.len())?;
        let layer = *self;
        kernels::run(
            isa,
            Forward {
                layer,
                params,
                x,
                normal,
                inverse,
                y,
            },
        );
        Ok(())
    }

    /// Turns `d`, the gradient at `y`, into the gradient at `x`, and adds that of the parameters to `d_params` if it is given.
    ///
    /// # Errors
    /// Slices that do not fit.
    pub fn backward(
        &self,
        isa: Isa,
        params: &[f32],
        normal: &[f32],
        inverse: &[f32],
        d: &mut [f32],
        d_params: Option<&mut [f32]>,
    ) -> Result<(), ShapeError> {
        let rows = self.rows(d)?;
        expect("layer norm parameters", params, self.param_len())?;
        expect("layer norm normal", normal, d.len())?;
        expect("layer norm deviations", inverse, rows)?;
        if let Some(d_params) = &d_params {
            expect("layer norm parameter gradient", d_params, self.param_len())?;
        }
        let layer = *self;
        kernels::run(
            isa,
            Backward {
                layer,
                params,
                normal,
                inverse,
                d,
                d_params,
            },
        );
        Ok(())
    }
}

/// Squares of deviations whose sums differ by less than this share take the slope of the root instead of a quotient.
const SAME_VARIANCE: f32 = 1e-4;

impl LayerNorm {
    /// Turns `m`, the multipliers of `y`, into those of `x`. The deviation `c = x − mean` and the factor `s = 1 / √(variance + ε)`
    /// are a product of two varying values, so both get the other's mean (docs/deepshap.md); what the factor gets goes on to `c` by
    /// the rescale rule over the variance. `now` and `reference` are `x̂` and `s` of either pass. Exactly additive.
    fn multipliers(&self, params: &[f32], now: (&[f32], f32), reference: (&[f32], f32), m: &mut [f32]) {
        let ((normal, inverse), (normal_ref, inverse_ref)) = (now, reference);
        let width = self.width.max(1) as f32;
        let mean_inverse = 0.5 * (inverse + inverse_ref);
        // Both passes' deviations are x̂ / s.
        let middle = |normal: f32, normal_ref: f32| 0.5 * (normal / inverse + normal_ref / inverse_ref);
        let (variance, variance_ref) = (1.0 / (inverse * inverse), 1.0 / (inverse_ref * inverse_ref));
        let slope = if (variance - variance_ref).abs() < SAME_VARIANCE * variance {
            -0.5 * inverse * inverse * inverse
        } else {
            (inverse - inverse_ref) / (variance - variance_ref)
        };
        let mut through_factor = 0.0;
        for (((m, scale), normal), normal_ref) in m.iter_mut().zip(params).zip(normal).zip(normal_ref) {
            *m *= scale;
            through_factor += *m * middle(*normal, *normal_ref);
        }
        let by_deviation = 2.0 * through_factor * slope / width;
        for ((m, normal), normal_ref) in m.iter_mut().zip(normal).zip(normal_ref) {
            *m = *m * mean_inverse + by_deviation * middle(*normal, *normal_ref);
        }
        let mean = sum(m, |m| m) / width;
        m.iter_mut().for_each(|m| *m -= mean);
    }
}

impl GraphBuilder {
    /// Layer normalisation of one row.
    ///
    /// # Errors
    /// Lengths that do not fit.
    pub fn layer_norm(&mut self, x: NodeId, layer: LayerNorm, params: Params) -> Result<NodeId, ShapeError> {
        self.check("layer norm input", x, layer.width)?;
        Self::check_params("layer norm parameters", params, layer.param_len())?;
        self.add(layer, &[x], layer.width, params)
    }
}

/// What a node keeps besides its value: `x̂`, then `1 / √(variance + ε)`.
fn kept(aux: &[f32]) -> (&[f32], f32) {
    aux.split_last()
        .map_or((&[], 1.0), |(inverse, normal)| (normal, *inverse))
}

impl Operation for LayerNorm {
    fn aux_len(&self, len: usize, _purpose: Purpose) -> usize {
        len + 1
    }

    fn forward_node(&self, node: &mut run::Forward<'_>) -> Result<(), ShapeError> {
        let x = node.source(0)?;
        let (normal, inverse) = node.aux.split_at_mut_checked(self.width).unwrap_or_default();
        self.forward(node.isa, node.params, x, normal, inverse, node.value)
    }

    fn backward_node(
        &self,
        node: &mut run::Backward<'_>,
        d: &mut [f32],
        pass: &mut Pass<'_>,
    ) -> Result<(), ShapeError> {
        let now = kept(node.kept(node.tape)?.aux);
        match pass.reference() {
            None => {
                let d_params = node.d_params(pass)?;
                self.backward(node.isa, node.packed, now.0, &[now.1], d, d_params)?;
            }
            Some(reference) => self.multipliers(node.packed, now, kept(node.kept(reference)?.aux), d),
        }
        node.write_source(0, |dx, _| {
            dx.copy_from_slice(d);
            Ok(())
        })
    }

    /// The identity.
    #[cfg(feature = "train")]
    fn initialize_node(&self, params: &mut [f32], _draw: &mut dyn FnMut(f32) -> f32) {
        let (scale, shift) = params.split_at_mut_checked(self.width).unwrap_or_default();
        scale.fill(1.0);
        shift.fill(0.0);
    }
}

struct Forward<'a> {
    layer: LayerNorm,
    params: &'a [f32],
    x: &'a [f32],
    normal: &'a mut [f32],
    inverse: &'a mut [f32],
    y: &'a mut [f32],
}

impl Task for Forward<'_> {
    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let Self {
            layer,
            params,
            x,
            normal,
            inverse,
            y,
        } = self;
        let width = layer.width.max(1);
        let (scale, shift) = params.split_at_checked(layer.width).unwrap_or_default();
        let slots = normal.chunks_exact_mut(width).zip(y.chunks_exact_mut(width));
        for ((x, (normal, y)), inverse) in x.chunks_exact(width).zip(slots).zip(inverse) {
            let mean = sum(x, |x| x) / width as f32;
            let variance = sum(x, |x| (x - mean) * (x - mean)) / width as f32;
            *inverse = 1.0 / libm::sqrtf(variance + layer.epsilon);
            let columns = scale.iter().zip(shift).zip(normal.iter_mut().zip(y.iter_mut()));
            for (x, ((scale, shift), (normal, y))) in x.iter().zip(columns) {
                *normal = (x - mean) * *inverse;
                *y = scale * *normal + shift;
            }
        }
    }
}

struct Backward<'a> {
    layer: LayerNorm,
    params: &'a [f32],
    normal: &'a [f32],
    inverse: &'a [f32],
    d: &'a mut [f32],
    d_params: Option<&'a mut [f32]>,
}

impl Task for Backward<'_> {
    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let Self {
            layer,
            params,
            normal,
            inverse,
            d,
            mut d_params,
        } = self;
        let width = layer.width.max(1);
        let (scale, _) = params.split_at_checked(layer.width).unwrap_or_default();
        for ((d, normal), inverse) in d.chunks_exact_mut(width).zip(normal.chunks_exact(width)).zip(inverse) {
            if let Some((d_scale, d_shift)) = d_params.as_deref_mut().and_then(|p| p.split_at_mut_checked(width)) {
                for ((d_scale, d_shift), (d, normal)) in d_scale.iter_mut().zip(d_shift).zip(d.iter().zip(normal)) {
                    *d_scale += d * normal;
                    *d_shift += d;
                }
            }
            d.iter_mut().zip(scale).for_each(|(d, scale)| *d *= scale);
            let mean = sum(d, |d| d) / width as f32;
            let along = dot(d, normal) / width as f32;
            for (d, normal) in d.iter_mut().zip(normal) {
                *d = (*d - mean - normal * along) * inverse;
            }
        }
    }
}

/// Sums that the compiler can keep in vectors, in a fixed order.
const LANES: usize = 16;

#[inline(always)]
fn sum(x: &[f32], f: impl Fn(f32) -> f32) -> f32 {
    let mut lanes = [0.0; LANES];
    for chunk in x.chunks(LANES) {
        for (lane, x) in lanes.iter_mut().zip(chunk) {
            *lane += f(*x);
        }
    }
    lanes.iter().sum()
}

#[inline(always)]
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut lanes = [0.0; LANES];
    for (a, b) in a.chunks(LANES).zip(b.chunks(LANES)) {
        for (lane, (a, b)) in lanes.iter_mut().zip(a.iter().zip(b)) {
            *lane += a * b;
        }
    }
    lanes.iter().sum()
}
