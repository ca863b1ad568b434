//! Layer normalisation: of imported policies, and of critics, whose values it keeps from growing where they were never taught any
//! (Ball et al. 2023).

use crate::activation::rescale;
use crate::graph::operation::Operation;
use crate::graph::run::{Backward, Forward, Pass};
use crate::graph::{GraphBuilder, NodeId, Params, description};
use crate::isa::Isa;
use crate::shape::{ShapeError, expect};
use crate::vectorised;

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
        forward(isa, *self, params, x, normal, inverse, y);
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
        backward(isa, *self, params, normal, inverse, d, d_params);
        Ok(())
    }
}

/// `x̂` of a tape, and the rows' `1 / √(variance + ε)`.
type Normal<'a> = (&'a [f32], &'a [f32]);

impl LayerNorm {
    /// Turns `d`, the multipliers of `y`, into those of `x`: its parts are the centred values c, the mean of their squares v, its
    /// inverse root r, and their product c · r.
    fn multipliers(&self, scale: &[f32], now: Normal<'_>, reference: Normal<'_>, d: &mut [f32]) {
        let width = self.width.max(1);
        let rows = now.0.chunks_exact(width).zip(now.1);
        let of_reference = reference.0.chunks_exact(width).zip(reference.1);
        for (d, ((normal, r), (normal_ref, r_ref))) in d.chunks_exact_mut(width).zip(rows.zip(of_reference)) {
            let centred = || normal.iter().zip(normal_ref).map(|(n, n_ref)| n / r + n_ref / r_ref);
            d.iter_mut().zip(scale).for_each(|(d, scale)| *d *= scale);
            let of_r: f32 = d.iter().zip(centred()).map(|(d, both)| 0.5 * d * both).sum();
            let (v, v_ref) = (1.0 / (r * r), 1.0 / (r_ref * r_ref));
            let of_v = of_r * rescale(v, *r, v_ref, *r_ref, -0.5 * r * r * r);
            for (d, both) in d.iter_mut().zip(centred()) {
                *d = 0.5 * (r + r_ref) * *d + of_v / width as f32 * both;
            }
            let mean = sum(d, |d| d) / width as f32;
            d.iter_mut().for_each(|d| *d -= mean);
        }
    }
}

impl GraphBuilder {
    /// Layer normalisation of each row of `layer.width` values.
    ///
    /// # Errors
    /// An unknown node, or one that is no whole number of rows.
    pub fn layer_norm(&mut self, x: NodeId, layer: LayerNorm, params: Params) -> Result<NodeId, ShapeError> {
        let len = self.len_of(x)?;
        if layer.width == 0 || !len.is_multiple_of(layer.width) {
            return description("layer norm", "its input is no whole number of rows");
        }
        if !(layer.epsilon > 0.0 && layer.epsilon.is_finite()) {
            return description("layer norm", "epsilon is not above 0");
        }
        Self::check_params("layer norm parameters", params, layer.param_len())?;
        self.add(layer, &[x], len, params)
    }
}

impl Operation for LayerNorm {
    fn aux_len(&self, len: usize, _: crate::Purpose) -> usize {
        len + len / self.width.max(1)
    }

    fn forward_node(&self, node: &mut Forward<'_>) -> Result<(), ShapeError> {
        let x = node.source(0)?;
        let (normal, inverse) = node.aux.split_at_mut_checked(x.len()).unwrap_or_default();
        self.forward(node.isa, node.params, x, normal, inverse, node.value)
    }

    fn backward_node(&self, node: &mut Backward<'_>, d: &mut [f32], pass: &mut Pass<'_>) -> Result<(), ShapeError> {
        let split = |aux| <[f32]>::split_at_checked(aux, d.len()).unwrap_or_default();
        let now: Normal<'_> = split(node.kept(node.tape)?.aux);
        match pass.reference() {
            None => {
                let d_params = node.d_params(pass)?;
                self.backward(node.isa, node.packed, now.0, now.1, d, d_params)?;
            }
            Some(tape) => {
                let reference = split(node.kept(tape)?.aux);
                let (scale, _) = node.packed.split_at_checked(self.width).unwrap_or_default();
                self.multipliers(scale, now, reference, d);
            }
        }
        node.hand_on(0, d)
    }
}

vectorised! {
    fn forward<'a>(
        layer: LayerNorm,
        params: &'a [f32],
        x: &'a [f32],
        normal: &'a mut [f32],
        inverse: &'a mut [f32],
        y: &'a mut [f32],
    ) {
        let LayerNorm { width, epsilon } = layer;
        let (scale, shift) = params.split_at_checked(width).unwrap_or_default();
        let width = width.max(1);
        let slots = normal.chunks_exact_mut(width).zip(y.chunks_exact_mut(width));
        for ((x, (normal, y)), inverse) in x.chunks_exact(width).zip(slots).zip(inverse) {
            let mean = sum(x, |x| x) / width as f32;
            let variance = sum(x, |x| (x - mean) * (x - mean)) / width as f32;
            *inverse = 1.0 / libm::sqrtf(variance + epsilon);
            let columns = scale.iter().zip(shift).zip(normal.iter_mut().zip(y.iter_mut()));
            for (x, ((scale, shift), (normal, y))) in x.iter().zip(columns) {
                *normal = (x - mean) * *inverse;
                *y = scale * *normal + shift;
            }
        }
    }
}

vectorised! {
    fn backward<'a>(
        layer: LayerNorm,
        params: &'a [f32],
        normal: &'a [f32],
        inverse: &'a [f32],
        d: &'a mut [f32],
        d_params: Option<&'a mut [f32]>,
    ) {
        let (width, mut d_params) = (layer.width.max(1), d_params);
        let (scale, _) = params.split_at_checked(layer.width).unwrap_or_default();
        let rows = d.chunks_exact_mut(width).zip(normal.chunks_exact(width));
        for ((d, normal), inverse) in rows.zip(inverse) {
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
