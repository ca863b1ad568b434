//! The input gradient of a convolution of few input channels: vectors run along image columns.

use super::Conv2d;
use super::reorder::{interleave, transpose};
use crate::aligned::LINE;
use crate::isa::Isa;
use crate::kernels::{Product, Start};
use crate::shape::{ShapeError, expect, part, part_mut};

/// Along one axis, taps `step · stride + phase` for steps `from..to`, each of which has the phases `0..phases`. With stride
/// 2 and a kernel of 5: taps 0, 1, 2, 3, and tap 4.
#[derive(Clone, Copy)]
struct Taps {
    from: usize,
    to: usize,
    phases: usize,
}

/// Neighbouring inputs along one axis that lie in as many phases, `first..end`; tap `step · stride + phase` leads from the
/// input of this phase to output `top − step`.
#[derive(Clone, Copy)]
struct Group {
    first: usize,
    end: usize,
    top: usize,
}

impl Group {
    /// The group that begins with input `i`.
    fn of(layer: &Conv2d, i: usize, size: usize) -> Self {
        let first = (i + layer.padding) % layer.stride;
        Self {
            first,
            end: first + (layer.stride - first).min(size - i),
            top: (i + layer.padding) / layer.stride,
        }
    }

    fn len(self) -> usize {
        self.end - self.first
    }

    /// Its phases that these taps have: the first, and how many.
    fn phases(self, taps: Taps) -> (usize, usize) {
        (self.first, self.end.min(taps.phases).saturating_sub(self.first))
    }
}

impl Conv2d {
    /// The taps of one axis, those that all phases have and the others.
    fn taps(&self) -> [Taps; 2] {
        let (all, rest) = (self.kernel / self.stride, self.kernel % self.stride);
        let taps = |from, to, phases| Taps { from, to, phases };
        [taps(0, all, self.stride), taps(all, all + rest.min(1), rest)]
    }

    /// Where the weights of two sets of taps begin in the packed parameters, in taps. They lie step by step, and within a
    /// step phase by phase, so that all inputs of a group read weights at equal distances.
    fn block(&self, y: Taps, x: Taps) -> usize {
        let before = |taps: Taps| taps.from * self.stride;
        before(y) * self.kernel + (y.to - y.from) * y.phases * before(x)
    }

    /// [`Self::pack`] for [`Self::input_gradient_planar`]: `[channel][filter]` of each tap as they are.
    pub(super) fn pack_planar(&self, params: &[f32], packed: &mut [f32]) -> Result<(), ShapeError> {
        let tap = self.channels * self.filters;
        for y in self.taps() {
            for x in self.taps() {
                let mut at = self.block(y, x) * tap;
                for (step_y, step_x) in (y.from..y.to).flat_map(|step_y| (x.from..x.to).map(move |s| (step_y, s))) {
                    for phase_y in 0..y.phases {
                        for phase_x in 0..x.phases {
                            let (ky, kx) = (step_y * self.stride + phase_y, step_x * self.stride + phase_x);
                            let from = part("conv2d weights", params, (ky * self.kernel + kx) * tap, tap)?;
                            part_mut("packed conv2d parameters", packed, at, tap)?.copy_from_slice(from);
                            at += tap;
                        }
                    }
                }
            }
        }
        Ok(())
    }

    /// Zeros left of each row of the transposed output gradient: as many as the kernel is long, and to the next cache line.
    fn halo(&self) -> usize {
        self.kernel.next_multiple_of(LINE)
    }

    /// Length of a row of the transposed output gradient with zeros on both sides.
    fn plane_row_len(&self) -> usize {
        let seen = self.out_cols().max(self.cols.div_ceil(self.stride));
        (self.halo() + seen + self.kernel).next_multiple_of(LINE)
    }

    /// Output rows that one image row of the input is seen by, at most.
    fn rows_seen(&self) -> usize {
        self.kernel.div_ceil(self.stride)
    }

    /// Output rows that are kept transposed: few enough for the nearest cache, several times as many as one image row needs, so
    /// that moving those that are needed again costs little.
    fn plane_rows(&self) -> usize {
        (3 * self.rows_seen()).min(self.out_rows())
    }

    /// Phases that the input's columns have.
    fn column_phases(&self) -> usize {
        self.stride.min(self.cols)
    }

    /// Length of one image row of the input, its columns sorted by phase and channel.
    fn phases_len(&self) -> usize {
        self.column_phases() * self.channels * self.cols.div_ceil(self.stride)
    }

    /// Length of the scratch slice of [`Self::input_gradient_planar`].
    pub(super) fn planar_scratch_len(&self) -> usize {
        self.plane_rows() * self.filters * self.plane_row_len() + self.stride.min(self.rows) * self.phases_len()
    }

    /// The input gradient with vectors along the columns: row by row, as they are needed, `dy` is turned into planes
    /// `[row][filter][column]` with zeros around each row, so that no tap needs a bounds check. Then the phases of as many
    /// image rows as see the same outputs are products of weights (broadcast) and shifted planes, and are interleaved into
    /// the image rows.
    pub(super) fn input_gradient_planar(
        &self,
        isa: Isa,
        packed: &[f32],
        dy: &[f32],
        dx: &mut [f32],
        scratch: &mut [f32],
    ) -> Result<(), ShapeError> {
        expect("conv2d scratch", scratch, self.planar_scratch_len())?;
        let (plane_row, row_len) = (self.plane_row_len(), self.cols * self.channels);
        let (image_row, dy_row) = (self.filters * plane_row, self.out_cols() * self.filters);
        let (plane_rows, kept) = (self.plane_rows(), self.rows_seen().saturating_sub(1));
        let planes_len = plane_rows * image_row;
        let (planes, phase_rows) = scratch.split_at_mut_checked(planes_len).unwrap_or_default();
        // Halos stay zero: only what lies between them is written again.
        planes.fill(0.0);
        let mut dy_rows = dy.chunks_exact(dy_row);
        // The planes hold output rows `oldest..next`.
        let (mut oldest, mut next) = (0, 0);
        let mut dx_rows = dx.chunks_exact_mut(row_len);
        let mut iy = 0;
        while iy < self.rows {
            let rows = Group::of(self, iy, self.rows);
            while next <= rows.top
                && let Some(dy_row) = dy_rows.next()
            {
                if next == oldest + plane_rows {
                    planes.copy_within(planes_len.saturating_sub(kept * image_row).., 0);
                    oldest = next - kept;
                }
                let plane = part_mut("conv2d scratch", planes, (next - oldest) * image_row, image_row)?;
                let to = plane.get_mut(self.halo()..).unwrap_or_default();
                transpose(isa, self.filters, dy_row, to, plane_row);
                next += 1;
            }
            let phases_len = self.phases_len();
            let phase_rows = part_mut("conv2d scratch", phase_rows, 0, rows.len() * phases_len)?;
            phase_rows.fill(0.0);
            let mut phase = 0;
            while phase < self.column_phases() {
                let columns = Group::of(self, phase, self.column_phases());
                for y in self.taps() {
                    for x in self.taps() {
                        self.add_taps(isa, packed, planes, oldest, (rows, y), (columns, x), phase, phase_rows)?;
                    }
                }
                phase += columns.len();
            }
            for (phases, dx_row) in phase_rows.chunks_exact(phases_len).zip(&mut dx_rows) {
                interleave(isa, phases, self.column_phases() * self.channels, dx_row);
            }
            iy += rows.len();
        }
        Ok(())
    }

    /// Adds the share of some taps to the phases of a group of rows and of columns; `phase` is the first column's.
    #[expect(clippy::too_many_arguments, reason = "the inside of two loops")]
    fn add_taps(
        &self,
        isa: Isa,
        packed: &[f32],
        planes: &[f32],
        oldest: usize,
        (rows, y): (Group, Taps),
        (columns, x): (Group, Taps),
        phase: usize,
        phase_rows: &mut [f32],
    ) -> Result<(), ShapeError> {
        let (first_y, count_y) = rows.phases(y);
        let (first_x, count_x) = columns.phases(x);
        // Steps that go to outputs that exist; along the columns those that do not are zeros of the halo.
        let from = y.from.max((rows.top + 1).saturating_sub(self.out_rows()));
        let to = y.to.min(rows.top + 1);
        if from >= to || x.from == x.to || count_y * count_x == 0 {
            return Ok(());
        }
        let (plane_row, phase_len) = (self.plane_row_len(), self.cols.div_ceil(self.stride));
        let image_row = self.filters * plane_row;
        let tap = self.channels * self.filters;
        let step = y.phases * x.phases;
        let begin = self.block(y, x) + (from - y.from) * (x.to - x.from) * step + first_y * x.phases + first_x;
        let phases = self.column_phases();
        // All phases in one product if their weights and their places lie at equal distances.
        let (lines, rows_of_line, a_row, out_row) = if count_x == x.phases && count_x == phases {
            (1, count_y * count_x * self.channels, self.filters, phase_len)
        } else if count_x * self.channels == 1 {
            (1, count_y, x.phases * tap, phases * phase_len)
        } else {
            (count_y, count_x * self.channels, self.filters, phase_len)
        };
        for line in 0..lines {
            let product = Product {
                rows: rows_of_line,
                cols: phase_len,
                n_u: to - from,
                n_v: x.to - x.from,
                n_k: self.filters,
                a_at: ((begin + line * x.phases) * tap) as isize,
                a_row: a_row as isize,
                a_u: ((x.to - x.from) * step * tap) as isize,
                a_v: (step * tap) as isize,
                a_k: 1,
                b_at: ((rows.top - from).saturating_sub(oldest) * image_row + self.halo() + columns.top) as isize
                    - x.from as isize,
                b_u: -(image_row as isize),
                b_v: -1,
                b_k: plane_row as isize,
                out_at: (line * phases + phase) * self.channels * phase_len,
                out_row,
                ..Product::single()
            };
            product.run(isa, packed, planes, Start::Output, phase_rows)?;
        }
        Ok(())
    }
}
