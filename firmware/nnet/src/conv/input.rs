//! The input gradient of a convolution: the transposed convolution, without its zeros.

use super::{Axis, Conv2d};
use crate::dense::transpose;
use crate::isa::Isa;
use crate::kernels::{Product, Start};
use crate::shape::{ShapeError, expect, part, part_mut};

/// One set of taps of the transposed convolution: `first + n · stride`, of which `count` reach an output.
#[derive(Clone, Copy)]
struct Phase {
    first: usize,
    count: usize,
    /// Output that tap `first` leads to; each further tap leads to the one before.
    output: usize,
}

impl Axis {
    /// The taps through which input `i` is seen by existing outputs.
    fn phase(self, i: usize) -> Phase {
        let at = i + self.padding;
        let mut first = at % self.stride;
        // Tap t leads to output (at − t) / stride; skip those past the last output.
        let top = at / self.stride;
        let skip = (top + 1).saturating_sub(self.out);
        first += skip * self.stride;
        let output = top - skip.min(top);
        let by_kernel = self.kernel.saturating_sub(first).div_ceil(self.stride);
        let count = if skip > top { 0 } else { by_kernel.min(output + 1) };
        Phase { first, count, output }
    }

    /// The inputs in runs, a stride apart, that are seen through the same taps by outputs that go along with them.
    fn runs_of_inputs(self) -> impl Iterator<Item = Inputs> {
        let (mut phase, mut at) = (0, 0);
        core::iter::from_fn(move || {
            while at >= self.size {
                phase += 1;
                at = phase;
                if phase >= self.stride.min(self.size) {
                    return None;
                }
            }
            let (from, taps) = (at, self.phase(at));
            let by_kernel = self.kernel.saturating_sub(taps.first).div_ceil(self.stride);
            // All taps go to an output until there are no more outputs; at the border each input sees others.
            let last = (at + self.padding) / self.stride >= self.out;
            let count = if last || taps.count < by_kernel {
                1
            } else {
                (self.out - taps.output).min((self.size - at).div_ceil(self.stride))
            };
            at += count * self.stride;
            Some(Inputs { from, count, taps })
        })
    }
}

/// `count` inputs from `from` on, a stride apart; `taps` are the first one's.
#[derive(Clone, Copy)]
struct Inputs {
    from: usize,
    count: usize,
    taps: Phase,
}

impl Conv2d {
    /// Writes the parameters in the order that [`Self::input_gradient`] reads, which is its own affair; the bias is left
    /// out.
    ///
    /// # Errors
    /// Slices that do not fit.
    pub fn pack(&self, params: &[f32], packed: &mut [f32]) -> Result<(), ShapeError> {
        expect("conv2d parameters", params, self.param_len())?;
        expect("packed conv2d parameters", packed, self.param_len())?;
        if self.is_planar() {
            return self.pack_planar(params, packed);
        }
        let tap = self.channels * self.filters;
        let rows = packed.chunks_exact_mut((self.kernel * tap).max(1));
        for (ky, row) in rows.take(self.kernel).enumerate() {
            if self.is_grouped() {
                for kx in 0..self.kernel {
                    let from = part("conv2d weights", params, (ky * self.kernel + kx) * tap, tap)?;
                    let (first, members) = self.group(kx / self.stride);
                    let group = part_mut("packed conv2d group", row, first * tap, members * tap)?;
                    let to = group.get_mut((kx - first) * self.channels..).unwrap_or_default();
                    for (f, to) in to.chunks_mut(members * self.channels).take(self.filters).enumerate() {
                        for (to, w) in to.iter_mut().zip(from.iter().skip(f).step_by(self.filters)) {
                            *to = *w;
                        }
                    }
                }
                continue;
            }
            for (slot, to) in row.chunks_exact_mut(tap.max(1)).enumerate() {
                let kx = self.tap_of_slot(slot);
                let from = part("conv2d weights", params, (ky * self.kernel + kx) * tap, tap)?;
                transpose(self.channels, self.filters, from, to);
            }
        }
        Ok(())
    }

    /// With few input channels a vector is filled by those of neighbouring columns.
    fn is_grouped(&self) -> bool {
        !self.is_planar() && self.channels <= 16 && self.stride > 1
    }

    /// First and number of the kernel columns of group `n`: through them an output sees `stride` neighbouring inputs.
    fn group(&self, n: usize) -> (usize, usize) {
        let first = n * self.stride;
        (first, self.kernel.saturating_sub(first).min(self.stride))
    }

    /// Kernel columns of one phase: those that are `phase` modulo the stride.
    fn taps_of_phase(&self, phase: usize) -> usize {
        self.kernel.saturating_sub(phase).div_ceil(self.stride)
    }

    /// Which kernel column is packed in a slot: phase by phase, within a phase the last column first. Neighbouring slots
    /// then belong to neighbouring outputs, so that taps and filters are summed in one stretch of memory.
    fn tap_of_slot(&self, slot: usize) -> usize {
        let mut before = 0;
        for phase in 0..self.stride {
            let taps = self.taps_of_phase(phase);
            if slot < before + taps {
                return phase + (before + taps - 1 - slot) * self.stride;
            }
            before += taps;
        }
        slot
    }

    /// First of `count` neighbouring slots that hold kernel columns `first`, `first + stride`, ….
    fn slot_of_taps(&self, first: usize, count: usize) -> usize {
        let phase = first % self.stride;
        let before: usize = (0..phase).map(|phase| self.taps_of_phase(phase)).sum();
        (before + self.taps_of_phase(phase)).saturating_sub(first / self.stride + count)
    }

    /// With so few input channels vectors run along image columns instead of channels.
    fn is_planar(&self) -> bool {
        self.channels <= 4
    }

    /// Length of the scratch slice that [`Self::input_gradient`] needs.
    pub fn input_gradient_scratch_len(&self) -> usize {
        if self.is_planar() { self.planar_scratch_len() } else { 0 }
    }

    /// `dx`, the gradient with respect to the input, from `dy` with respect to `x ∗ w + b`. The same for multipliers.
    ///
    /// `packed` comes from [`Self::pack`]; `scratch` is [`Self::input_gradient_scratch_len`] long, its content does not
    /// matter.
    ///
    /// # Errors
    /// Slices that do not fit.
    pub fn input_gradient(
        &self,
        isa: Isa,
        packed: &[f32],
        dy: &[f32],
        dx: &mut [f32],
        scratch: &mut [f32],
    ) -> Result<(), ShapeError> {
        self.validate()?;
        expect("packed conv2d parameters", packed, self.param_len())?;
        expect("conv2d output gradient", dy, self.output_len())?;
        expect("conv2d input gradient", dx, self.input_len())?;
        if self.is_planar() {
            return self.input_gradient_planar(isa, packed, dy, dx, scratch);
        }
        if self.is_grouped() {
            return self.input_gradient_grouped(isa, packed, dy, dx);
        }
        let (vertical, horizontal) = (self.vertical(), self.horizontal());
        let row_len = self.cols * self.channels;
        let (w_row, w_col) = (self.kernel * self.channels * self.filters, self.channels * self.filters);
        let dy_row = horizontal.out * self.filters;
        let stride = self.stride;
        // `rows` inputs of a run, `down` or along the columns; the first sees output `down` of the vertical run.
        let product = |v: Inputs, h: Inputs, down: usize, rows: usize, a_row: usize, out_row: usize| Product {
            rows,
            cols: self.channels,
            n_u: v.taps.count,
            n_k: h.taps.count * self.filters,
            a_at: ((v.taps.output + down) * dy_row + (h.taps.output + 1 - h.taps.count) * self.filters) as isize,
            a_row: a_row as isize,
            a_u: -(dy_row as isize),
            a_k: 1,
            b_at: (v.taps.first * w_row + self.slot_of_taps(h.taps.first, h.taps.count) * w_col) as isize,
            b_u: (stride * w_row) as isize,
            b_k: self.channels as isize,
            out_at: (v.from + down * stride) * row_len + h.from * self.channels,
            out_row: stride * out_row,
            ..Product::single()
        };
        for v in vertical.runs_of_inputs() {
            for down in 0..v.count {
                for h in horizontal.runs_of_inputs().filter(|h| h.count > 1) {
                    let along = product(v, h, down, h.count, self.filters, self.channels);
                    along.run(isa, dy, packed, Start::Zero, dx)?;
                }
            }
            // The border's columns run downwards: one input at a time would wait for each sum.
            for h in horizontal.runs_of_inputs().filter(|h| h.count == 1) {
                let down = product(v, h, 0, v.count, dy_row, row_len);
                down.run(isa, dy, packed, Start::Zero, dx)?;
            }
        }
        Ok(())
    }

    /// The input gradient with vectors along several columns: each output adds its share to the `stride` neighbouring
    /// inputs that it sees through a group of kernel columns, group by group.
    fn input_gradient_grouped(&self, isa: Isa, packed: &[f32], dy: &[f32], dx: &mut [f32]) -> Result<(), ShapeError> {
        let (vertical, horizontal) = (self.vertical(), self.horizontal());
        let row_len = self.cols * self.channels;
        let (tap, dy_row) = (self.channels * self.filters, horizontal.out * self.filters);
        let w_row = self.kernel * tap;
        let groups = self.kernel.div_ceil(self.stride);
        // Kernel columns `members` of group `n` from output column `o` on, for image row `down` of a run.
        let product = |v: Inputs, down: usize, n: usize, o: usize, (from, to): (usize, usize)| {
            let (first, members) = self.group(n);
            Product {
                cols: (to - from) * self.channels,
                n_u: v.taps.count,
                n_k: self.filters,
                a_at: ((v.taps.output + down) * dy_row + o * self.filters) as isize,
                a_u: -(dy_row as isize),
                a_k: 1,
                b_at: (v.taps.first * w_row + first * tap + from * self.channels) as isize,
                b_u: (self.stride * w_row) as isize,
                b_k: (members * self.channels) as isize,
                out_at: (v.from + down * self.stride) * row_len + (horizontal.input(o, first + from)) * self.channels,
                ..Product::single()
            }
        };
        // Members of group `n` that output `o` sees.
        let seen = |n: usize, o: usize| {
            let (first, members) = self.group(n);
            let at = o * self.stride + first;
            let from = self.padding.saturating_sub(at).min(members);
            let to = (self.cols + self.padding).saturating_sub(at).min(members);
            (from, to.max(from))
        };
        for v in vertical.runs_of_inputs() {
            for down in 0..v.count {
                let at = (v.from + down * self.stride) * row_len;
                part_mut("conv2d input gradient", dx, at, row_len)?.fill(0.0);
                for n in 0..groups {
                    let (from, to) = self.outputs_of_group(n);
                    if from == to {
                        continue;
                    }
                    let along = Product {
                        rows: to - from,
                        a_row: self.filters as isize,
                        out_row: self.stride * self.channels,
                        ..product(v, down, n, from, (0, self.group(n).1))
                    };
                    along.run(isa, dy, packed, Start::Output, dx)?;
                }
            }
            // The border's columns run downwards: one output at a time would wait for each sum.
            for n in 0..groups {
                let (from, to) = self.outputs_of_group(n);
                for o in (0..from).chain(to..horizontal.out) {
                    let members = seen(n, o);
                    if members.0 == members.1 {
                        continue;
                    }
                    let downwards = Product {
                        rows: v.count,
                        a_row: dy_row as isize,
                        out_row: self.stride * row_len,
                        ..product(v, 0, n, o, members)
                    };
                    downwards.run(isa, dy, packed, Start::Output, dx)?;
                }
            }
        }
        Ok(())
    }

    /// Outputs all of whose columns of group `n` fall on the input, `from..to`.
    fn outputs_of_group(&self, n: usize) -> (usize, usize) {
        let (first, members) = self.group(n);
        let out = self.out_cols();
        let from = self.padding.saturating_sub(first).div_ceil(self.stride).min(out);
        let reach = (self.cols + self.padding + self.stride).saturating_sub(first + members) / self.stride;
        (from, reach.clamp(from, out))
    }
}
