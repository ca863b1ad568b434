//! Bounds of every value of a network over boxes of inputs: interval arithmetic through the layers (Gowal et al. 2018, "On the
//! effectiveness of interval bound propagation for training verifiably robust models").
//!
//! A box goes through weights as its centre and its radius: `W c + b` and `|W| r`. Curves are monotone, so their bounds are their
//! values at both ends. With [`Rounding::Counted`] the bounds hold for the numbers that [`Graph::forward`] gives: each sum of n products is
//! widened by 2 (n + 8) 2⁻²⁴ of the sum of its terms' magnitudes, each curve by [`CURVE_ERROR`].

use super::operation::AnyOperation;
use super::structure::Input;
use super::{Graph, Node, Params};
use crate::activation::Activation;
use crate::isa::Isa;
use crate::shape::{ShapeError, expect, part, part_mut};

/// How far a curve's value here may be from the real one, and what the sum of two values before it adds; docs/nnet.md has the
/// polynomials' errors.
pub const CURVE_ERROR: f32 = 2e-6;

/// Lower and upper ends of the same values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds<'a> {
    /// The least that each value can be.
    pub lower: &'a [f32],
    /// The greatest.
    pub upper: &'a [f32],
}

/// [`Bounds`] to be written.
#[derive(Debug)]
pub struct BoundsMut<'a> {
    /// The least that each value can be.
    pub lower: &'a mut [f32],
    /// The greatest.
    pub upper: &'a mut [f32],
}

impl<'a> Bounds<'a> {
    /// Values that are known.
    pub fn exactly(values: &'a [f32]) -> Self {
        Self {
            lower: values,
            upper: values,
        }
    }

    /// `offset..offset + len` of them.
    ///
    /// # Errors
    /// [`ShapeError::Length`], with `what` it is.
    pub fn part(&self, what: &'static str, offset: usize, len: usize) -> Result<Self, ShapeError> {
        Ok(Self {
            lower: part(what, self.lower, offset, len)?,
            upper: part(what, self.upper, offset, len)?,
        })
    }

    /// Writes centre and radius of each, `[centres][radii]`; the radius is widened by what sums of `terms` products of these values
    /// may lose, as a share of the products.
    pub(crate) fn split<'w>(
        &self,
        rounding: Rounding,
        terms: usize,
        work: &'w mut [f32],
    ) -> Result<(&'w [f32], &'w [f32]), ShapeError> {
        let len = self.lower.len();
        let (centre, rest) = work.split_at_mut_checked(len).unwrap_or_default();
        let radius = part_mut("bounds work", rest, 0, len)?;
        let lost = match rounding {
            Rounding::Counted => 2.0 * (terms + 8) as f32 * (0.5 * f32::EPSILON),
            Rounding::Ignored => 0.0,
        };
        let ends = self.lower.iter().zip(self.upper);
        for ((centre, radius), (lower, upper)) in centre.iter_mut().zip(radius.iter_mut()).zip(ends) {
            let (c, r) = (0.5 * (lower + upper), 0.5 * (upper - lower));
            *centre = c;
            *radius = r + lost * (c.abs() + r);
        }
        Ok((centre, radius))
    }
}

impl<'a> BoundsMut<'a> {
    /// To read.
    pub fn view(&self) -> Bounds<'_> {
        Bounds {
            lower: self.lower,
            upper: self.upper,
        }
    }

    /// The same, borrowed for less long.
    pub fn reborrow(&mut self) -> BoundsMut<'_> {
        BoundsMut {
            lower: self.lower,
            upper: self.upper,
        }
    }

    /// `offset..offset + len` of them, to be written.
    ///
    /// # Errors
    /// [`ShapeError::Length`], with `what` it is.
    pub fn part_mut(&mut self, what: &'static str, offset: usize, len: usize) -> Result<BoundsMut<'_>, ShapeError> {
        Ok(BoundsMut {
            lower: part_mut(what, self.lower, offset, len)?,
            upper: part_mut(what, self.upper, offset, len)?,
        })
    }

    /// Centres in `lower` and radii in `upper` become ends.
    pub(crate) fn spread(&mut self) {
        for (lower, upper) in self.lower.iter_mut().zip(self.upper.iter_mut()) {
            (*lower, *upper) = (*lower - *upper, *lower + *upper);
        }
    }

    /// Through a curve.
    pub(crate) fn through(&mut self, isa: Isa, rounding: Rounding, curve: Activation) {
        curve.apply_in_place(isa, self.lower);
        curve.apply_in_place(isa, self.upper);
        if matches!(curve, Activation::NearContrast { .. }) {
            // The one that falls.
            self.lower.swap_with_slice(self.upper);
        }
        if curve != Activation::Identity {
            self.widen(rounding);
        }
    }

    /// By [`CURVE_ERROR`].
    pub(crate) fn widen(&mut self, rounding: Rounding) {
        if rounding == Rounding::Ignored {
            return;
        }
        self.lower.iter_mut().for_each(|lower| *lower -= CURVE_ERROR);
        self.upper.iter_mut().for_each(|upper| *upper += CURVE_ERROR);
    }

    fn split_at(self, at: usize) -> (BoundsMut<'a>, BoundsMut<'a>) {
        let (lower, lower_rest) = self.lower.split_at_mut_checked(at).unwrap_or_default();
        let (upper, upper_rest) = self.upper.split_at_mut_checked(at).unwrap_or_default();
        let rest = BoundsMut {
            lower: lower_rest,
            upper: upper_rest,
        };
        (BoundsMut { lower, upper }, rest)
    }
}

/// Whether bounds hold for float32 as it is computed, or for real numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rounding {
    /// For float32: what is proved.
    Counted,
    /// For real numbers: what is trained, where the bounds of a network that is not robust yet would be nothing but rounding.
    Ignored,
}

/// Parameters of a network as its bounds need them.
#[derive(Debug, Clone, Copy)]
pub struct BoundsParams<'a> {
    /// The parameters.
    pub params: &'a [f32],
    /// [`Graph::magnitudes`] of them.
    pub magnitudes: &'a [f32],
}

/// One node's turn in a bounds pass.
pub(crate) struct BoundsForward<'a> {
    graph: &'a Graph,
    node: &'a Node,
    pub isa: Isa,
    pub rounding: Rounding,
    /// The node's own parameters.
    pub params: &'a [f32],
    /// Magnitudes of those that multiply, zeros for those that are added.
    pub magnitudes: &'a [f32],
    before: Bounds<'a>,
    /// What was given for it, if it is an input of the network.
    pub given: Bounds<'a>,
    /// To be written.
    pub value: BoundsMut<'a>,
    /// What it keeps besides, to be written.
    pub aux: BoundsMut<'a>,
    /// Room for [`Bounds::split`] of any source.
    pub work: &'a mut [f32],
}

impl<'a> BoundsForward<'a> {
    /// How many sources the node has.
    pub fn source_count(&self) -> usize {
        self.node.sources.len()
    }

    /// The bounds of source `i`.
    pub fn source(&self, i: usize) -> Result<Bounds<'a>, ShapeError> {
        let from = self.graph.source(self.node, i)?;
        self.before.part("tape", from.at, from.len)
    }

    /// The bounds of a layer with weights before a curve, whose outputs are sums of `terms` products each. `product` gets
    /// parameters, input and output.
    pub fn weighted(
        &mut self,
        terms: usize,
        curve: Activation,
        product: impl Fn(&[f32], &[f32], &mut [f32]) -> Result<(), ShapeError>,
    ) -> Result<(), ShapeError> {
        let (centre, radius) = self.source(0)?.split(self.rounding, terms, self.work)?;
        product(self.params, centre, self.value.lower)?;
        product(self.magnitudes, radius, self.value.upper)?;
        self.value.spread();
        self.value.through(self.isa, self.rounding, curve);
        Ok(())
    }
}

fn slice_of<'a>(what: &'static str, all: &'a [f32], range: Params) -> Result<&'a [f32], ShapeError> {
    part(what, all, range.at, range.len)
}

impl Graph {
    /// Length of the work buffer of [`Self::bounds`].
    pub fn bounds_work_len(&self) -> usize {
        self.spill_len
    }

    /// Magnitudes of the parameters that multiply, and zeros in place of those that are added. To be repeated whenever the parameters
    /// change.
    ///
    /// # Errors
    /// Slices that do not fit.
    pub fn magnitudes(&self, params: &[f32], magnitudes: &mut [f32]) -> Result<(), ShapeError> {
        expect("network parameters", params, self.param_len)?;
        expect("magnitudes", magnitudes, self.param_len)?;
        magnitudes.fill(0.0);
        for node in &self.nodes {
            let len = node.operation.get().weight_len();
            let from = part("network parameters", params, node.params.at, len)?;
            let to = part_mut("magnitudes", magnitudes, node.params.at, len)?;
            for (to, from) in to.iter_mut().zip(from) {
                *to = from.abs();
            }
        }
        Ok(())
    }

    /// Bounds of all nodes for inputs anywhere between theirs; left on `tapes`, each as long as a tape.
    ///
    /// # Errors
    /// Slices that do not fit; a layer that has no bounds. The tapes' content is then undefined.
    pub fn bounds(
        &self,
        isa: Isa,
        rounding: Rounding,
        params: BoundsParams<'_>,
        inputs: &[Bounds<'_>],
        tapes: &mut BoundsMut<'_>,
        work: &mut [f32],
    ) -> Result<(), ShapeError> {
        expect("network parameters", params.params, self.param_len)?;
        expect("magnitudes", params.magnitudes, self.param_len)?;
        expect("lower tape", tapes.lower, self.tape_len)?;
        expect("upper tape", tapes.upper, self.tape_len)?;
        expect("bounds work", work, self.bounds_work_len())?;
        if inputs.len() != self.inputs.len() {
            return Err(ShapeError::Length {
                what: "list of inputs",
                expected: self.inputs.len(),
                got: inputs.len(),
            });
        }
        let mut inputs = inputs.iter();
        for node in &self.nodes {
            let given = if let AnyOperation::Input(Input { .. }) = node.operation {
                inputs.next().copied()
            } else {
                None
            };
            if !node.live {
                continue;
            }
            let (before, mut own) = tapes.reborrow().split_at(node.at);
            let (value, aux) = own.part_mut("tape", 0, node.len + node.aux_len)?.split_at(node.len);
            node.operation.get().bounds_node(&mut BoundsForward {
                graph: self,
                node,
                isa,
                rounding,
                params: slice_of("network parameters", params.params, node.params)?,
                magnitudes: slice_of("magnitudes", params.magnitudes, node.params)?,
                before: before.view(),
                given: given.unwrap_or(Bounds::exactly(&[])),
                value,
                aux,
                work,
            })?;
        }
        Ok(())
    }

    /// The output's bounds on two tapes.
    ///
    /// # Errors
    /// Tapes of another length.
    pub fn output_bounds<'a>(&self, tapes: Bounds<'a>) -> Result<Bounds<'a>, ShapeError> {
        Ok(Bounds {
            lower: self.output(tapes.lower)?,
            upper: self.output(tapes.upper)?,
        })
    }
}

/// Parameters as the backward pass over bounds reads them.
#[cfg(feature = "train")]
#[derive(Debug, Clone, Copy)]
pub struct PackedBoundsParams<'a> {
    /// [`Graph::pack`] of the parameters.
    pub params: &'a [f32],
    /// [`Graph::pack`] of their [`Graph::magnitudes`].
    pub magnitudes: &'a [f32],
}

/// Where gradients of parameters are added: as centres see them and as radii see their magnitudes. The two become one by
/// [`Graph::add_magnitude_gradient`].
#[cfg(feature = "train")]
#[derive(Debug)]
pub struct BoundsGradient<'a> {
    /// With respect to the parameters.
    pub params: &'a mut [f32],
    /// With respect to the magnitudes.
    pub magnitudes: &'a mut [f32],
}

/// One node's turn in a backward pass over bounds.
#[cfg(feature = "train")]
pub(crate) struct BoundsBackward<'a> {
    graph: &'a Graph,
    node: &'a Node,
    pub isa: Isa,
    /// The node's own parameters and magnitudes, packed.
    pub packed: PackedBoundsParams<'a>,
    tapes: Bounds<'a>,
    before: BoundsMut<'a>,
    /// Room for [`Bounds::split`] of all sources together.
    pub spill: &'a mut [f32],
    pub scratch: &'a mut [f32],
    /// Where the gradients of the node's own parameters are added.
    pub d_params: BoundsGradient<'a>,
}

#[cfg(feature = "train")]
impl<'a> BoundsBackward<'a> {
    /// How many sources the node has.
    pub fn source_count(&self) -> usize {
        self.node.sources.len()
    }

    /// The bounds of source `i`.
    pub fn source(&self, i: usize) -> Result<Bounds<'a>, ShapeError> {
        let source = self.graph.source(self.node, i)?;
        self.tapes.part("tape", source.at, source.len)
    }

    /// The node's own bounds, and those of what it keeps besides.
    pub fn kept(&self) -> Result<(Bounds<'a>, Bounds<'a>), ShapeError> {
        let node = self.node;
        Ok((
            self.tapes.part("tape", node.at, node.len)?,
            self.tapes.part("tape", node.at + node.len, node.aux_len)?,
        ))
    }

    /// Hands what to write the gradient of source `i`'s ends to, and the scratch, to `write`.
    pub fn write_source(
        &mut self,
        i: usize,
        write: impl FnOnce(BoundsMut<'_>, &mut [f32]) -> Result<(), ShapeError>,
    ) -> Result<(), ShapeError> {
        let source = self.graph.source(self.node, i)?;
        if !(source.reaches_input || source.reaches_params) {
            return Ok(());
        }
        let (lower, rest) = self.spill.split_at_mut_checked(source.len).unwrap_or_default();
        let upper = part_mut("work buffer", rest, 0, source.len)?;
        write(
            BoundsMut {
                lower: &mut *lower,
                upper: &mut *upper,
            },
            self.scratch,
        )?;
        let adds = self.node.sources.get(i).is_some_and(|edge| edge.adds);
        let to = self.before.part_mut("work buffer", source.gradient_at, source.len)?;
        for (to, from) in [(to.lower, lower), (to.upper, upper)] {
            if adds {
                to.iter_mut().zip(from).for_each(|(to, from)| *to += *from);
            } else {
                to.copy_from_slice(from);
            }
        }
        Ok(())
    }

    /// The same for a source that the layer reads as centre and radius: `write` gets packed parameters and a gradient to write, first
    /// for the centre, then for the radius.
    pub fn write_split_source(
        &mut self,
        i: usize,
        mut write: impl FnMut(Side, &[f32], &mut [f32], &mut [f32]) -> Result<(), ShapeError>,
    ) -> Result<(), ShapeError> {
        let packed = self.packed;
        self.write_source(i, |mut d, scratch| {
            write(Side::Centre, packed.params, d.lower, scratch)?;
            write(Side::Radius, packed.magnitudes, d.upper, scratch)?;
            // The centre is (lower + upper) / 2, the radius (upper − lower) / 2.
            d.spread();
            for end in [d.lower, d.upper] {
                end.iter_mut().for_each(|d| *d *= 0.5);
            }
            Ok(())
        })
    }

    /// The backward pass of [`BoundsForward::weighted`]: `add_weight_gradient` gets input, gradient before the curve and the parameters'
    /// gradient; `write_input_gradient` packed parameters, the gradient before the curve, the input's to write, and scratch.
    pub fn weighted(
        &mut self,
        curve: Activation,
        d: BoundsMut<'_>,
        add_weight_gradient: impl Fn(&[f32], &[f32], &mut [f32]) -> Result<(), ShapeError>,
        write_input_gradient: impl Fn(&[f32], &[f32], &mut [f32], &mut [f32]) -> Result<(), ShapeError>,
    ) -> Result<(), ShapeError> {
        let (value, _) = self.kept()?;
        through_backward(self.isa, curve, value, d.lower, d.upper)?;
        let (d_centre, d_radius) = (d.lower, d.upper);
        ends_to_split(d_centre, d_radius);
        let (centre, radius) = self.source(0)?.split(Rounding::Ignored, 0, self.spill)?;
        add_weight_gradient(centre, d_centre, self.d_params.params)?;
        add_weight_gradient(radius, d_radius, self.d_params.magnitudes)?;
        self.write_split_source(0, |side, packed, dx, scratch| {
            write_input_gradient(packed, side.of(d_centre, d_radius), dx, scratch)
        })
    }
}

/// What of a box: its centre or its radius.
#[cfg(feature = "train")]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Side {
    Centre,
    Radius,
}

#[cfg(feature = "train")]
impl Side {
    /// The one of two that belongs to it.
    pub fn of<T>(self, centre: T, radius: T) -> T {
        match self {
            Self::Centre => centre,
            Self::Radius => radius,
        }
    }
}

/// Gradients of ends become those of centre and radius: `lower = centre − radius`, `upper = centre + radius`.
#[cfg(feature = "train")]
pub(crate) fn ends_to_split(d_lower: &mut [f32], d_upper: &mut [f32]) {
    for (lower, upper) in d_lower.iter_mut().zip(d_upper.iter_mut()) {
        (*lower, *upper) = (*lower + *upper, *upper - *lower);
    }
}

/// Gradients behind a curve become those before it.
#[cfg(feature = "train")]
pub(crate) fn through_backward(
    isa: Isa,
    curve: Activation,
    value: Bounds<'_>,
    d_lower: &mut [f32],
    d_upper: &mut [f32],
) -> Result<(), ShapeError> {
    curve.gradient(isa, value.lower, d_lower)?;
    curve.gradient(isa, value.upper, d_upper)?;
    if matches!(curve, Activation::NearContrast { .. }) {
        d_lower.swap_with_slice(d_upper);
    }
    Ok(())
}

#[cfg(feature = "train")]
impl Graph {
    /// Length of the work buffer of [`Self::bounds_backward`].
    pub fn bounds_backward_work_len(&self) -> usize {
        2 * (self.gradient_len + self.spill_len + self.scratch_len)
    }

    /// Gradient of `Σ d_output · (the output's ends)` with respect to the inputs' ends (see [`Self::input_bounds_gradient`]) and, added to
    /// `d_params`, to the parameters.
    ///
    /// # Errors
    /// Slices that do not fit; a layer that has no bounds.
    pub fn bounds_backward(
        &self,
        isa: Isa,
        packed: PackedBoundsParams<'_>,
        tapes: Bounds<'_>,
        d_output: Bounds<'_>,
        d_params: BoundsGradient<'_>,
        work: &mut [f32],
    ) -> Result<(), ShapeError> {
        for slice in [packed.params, packed.magnitudes, d_params.params, d_params.magnitudes] {
            expect("network parameters", slice, self.param_len)?;
        }
        expect("lower tape", tapes.lower, self.tape_len)?;
        expect("upper tape", tapes.upper, self.tape_len)?;
        expect("work buffer", work, self.bounds_backward_work_len())?;
        let (lower, rest) = work.split_at_mut_checked(self.gradient_len).unwrap_or_default();
        let (upper, rest) = rest.split_at_mut_checked(self.gradient_len).unwrap_or_default();
        let (spill, scratch) = rest.split_at_mut_checked(2 * self.spill_len).unwrap_or_default();
        let mut gradients = BoundsMut { lower, upper };
        let output = self.node(self.output)?;
        let d = gradients.part_mut("work buffer", output.gradient_at, output.len)?;
        for (to, from) in [(d.lower, d_output.lower), (d.upper, d_output.upper)] {
            expect("output gradient", from, output.len)?;
            to.copy_from_slice(from);
        }
        for node in self.nodes.iter().rev() {
            if !node.live || !(node.reaches_input || node.reaches_params) || node.sources.is_empty() {
                continue;
            }
            let (before, mut own) = gradients.reborrow().split_at(node.gradient_at);
            let d = own.part_mut("work buffer", 0, node.len)?;
            let Params { at, len } = node.params;
            let mut step = BoundsBackward {
                graph: self,
                node,
                isa,
                packed: PackedBoundsParams {
                    params: part("packed parameters", packed.params, at, len)?,
                    magnitudes: part("packed magnitudes", packed.magnitudes, at, len)?,
                },
                tapes,
                before,
                spill: &mut *spill,
                scratch: &mut *scratch,
                d_params: BoundsGradient {
                    params: part_mut("parameter gradient", d_params.params, at, len)?,
                    magnitudes: part_mut("magnitude gradient", d_params.magnitudes, at, len)?,
                },
            };
            node.operation.get().bounds_backward_node(&mut step, d)?;
        }
        Ok(())
    }

    /// The gradient of input `i`'s ends after [`Self::bounds_backward`]. Meaningless unless [`Self::is_explained`].
    ///
    /// # Errors
    /// A work buffer of another length, no such input.
    pub fn input_bounds_gradient<'a>(&self, work: &'a [f32], i: usize) -> Result<Bounds<'a>, ShapeError> {
        let node = self.input_node(i)?;
        Ok(Bounds {
            lower: part("work buffer", work, node.gradient_at, node.len)?,
            upper: part("work buffer", work, self.gradient_len + node.gradient_at, node.len)?,
        })
    }

    /// Adds to the gradient of the parameters what their magnitudes' gradient means for them.
    ///
    /// # Errors
    /// Slices that do not fit.
    pub fn add_magnitude_gradient(
        &self,
        params: BoundsParams<'_>,
        gradient: BoundsGradient<'_>,
    ) -> Result<(), ShapeError> {
        for slice in [params.params, params.magnitudes, gradient.params, gradient.magnitudes] {
            expect("network parameters", slice, self.param_len)?;
        }
        let both = params.params.iter().zip(params.magnitudes);
        for ((d, d_magnitude), (param, magnitude)) in gradient.params.iter_mut().zip(gradient.magnitudes).zip(both) {
            // What is added has no magnitude.
            if *magnitude > 0.0 {
                *d += if *param < 0.0 { -*d_magnitude } else { *d_magnitude };
            }
        }
        Ok(())
    }
}
