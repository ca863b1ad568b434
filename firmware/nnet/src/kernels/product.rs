//! The product kernel.

use super::simd::{Portable, Simd};
use crate::error::ShapeError;
use crate::isa::{Isa, Level};

/// A strided product of two slices:
///
/// `out[out_at + i·out_row + c] = start + Σ_u Σ_v Σ_k a[a_at + i·a_row + u·a_u + v·a_v + k·a_k] · b[b_at + u·b_u + v·b_v + k·b_k + c]`
///
/// for `i < rows`, `c < cols`, summed in the order written (`k` innermost). Strides count elements and may be negative.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Product {
    pub rows: usize,
    pub cols: usize,
    /// Extents of the three sums.
    pub n_u: usize,
    pub n_v: usize,
    pub n_k: usize,
    pub a_at: isize,
    pub a_row: isize,
    pub a_u: isize,
    pub a_v: isize,
    pub a_k: isize,
    pub b_at: isize,
    pub b_u: isize,
    pub b_v: isize,
    pub b_k: isize,
    pub out_at: usize,
    pub out_row: usize,
}

/// What a product's sums begin with.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Start<'a> {
    /// Zero.
    Zero,
    /// What the output holds.
    Output,
    /// A value for each column, `cols` long.
    Bias(&'a [f32]),
}

impl Product {
    /// One sum only: `n_u = n_v = 1`.
    pub fn single() -> Self {
        Self {
            n_u: 1,
            n_v: 1,
            ..Self::default()
        }
    }

    /// Runs the product.
    ///
    /// # Errors
    /// When a stride leads outside `a`, `b`, `out` or the bias; nothing is written then.
    pub fn run(&self, isa: Isa, a: &[f32], b: &[f32], start: Start<'_>, out: &mut [f32]) -> Result<(), ShapeError> {
        if self.rows == 0 || self.cols == 0 {
            return Ok(());
        }
        let summed = self.n_u > 0 && self.n_v > 0 && self.n_k > 0;
        if summed {
            let sums = [(self.n_u, 0), (self.n_v, 1), (self.n_k, 2)];
            let a_strides = [self.a_u, self.a_v, self.a_k];
            let b_strides = [self.b_u, self.b_v, self.b_k];
            let mut a_range = Range::at(self.a_at);
            let mut b_range = Range::at(self.b_at);
            a_range.walk(self.rows, self.a_row);
            b_range.walk(self.cols, 1);
            for (n, which) in sums {
                a_range.walk(n, a_strides.get(which).copied().unwrap_or(0));
                b_range.walk(n, b_strides.get(which).copied().unwrap_or(0));
            }
            a_range.check("left factor", a.len())?;
            b_range.check("right factor", b.len())?;
        }
        let mut out_range = Range::at(self.out_at as isize);
        out_range.walk(self.rows, self.out_row as isize);
        out_range.walk(self.cols, 1);
        out_range.check("output", out.len())?;
        let (keep, bias) = match start {
            Start::Zero => (false, core::ptr::null()),
            Start::Output => (true, core::ptr::null()),
            Start::Bias(bias) => {
                crate::error::expect("bias", bias, self.cols)?;
                (false, bias.as_ptr())
            }
        };
        let tiles = Tiles {
            product: if summed { *self } else { Self { n_u: 0, ..*self } },
            a: a.as_ptr(),
            b: b.as_ptr(),
            out: out.as_mut_ptr(),
            keep,
            bias,
        };
        // SAFETY: every element the strides can reach lies in its slice (checked above; a stride of rows that overlap
        // in `out` is harmless, tiles are written one after the other), and the instruction set was detected, since an
        // `Isa` of a vector level can only come from detection.
        unsafe {
            match isa.0 {
                Level::Portable => tiles.all::<Portable>(),
                #[cfg(target_arch = "x86_64")]
                Level::Avx2Fma => avx2(&tiles),
                #[cfg(target_arch = "x86_64")]
                Level::Avx512 => avx512(&tiles),
            }
        }
        Ok(())
    }
}

/// Smallest and largest index that strides can reach.
struct Range {
    low: isize,
    high: isize,
}

impl Range {
    fn at(at: isize) -> Self {
        Self { low: at, high: at }
    }

    /// Adds `n` steps (at least one) of a stride. Saturates, so that an absurd stride fails the check.
    fn walk(&mut self, n: usize, stride: isize) {
        let reach = (n as isize - 1).saturating_mul(stride);
        self.low = self.low.saturating_add(reach.min(0));
        self.high = self.high.saturating_add(reach.max(0));
    }

    fn check(&self, what: &'static str, len: usize) -> Result<(), ShapeError> {
        if self.low < 0 || self.high >= len as isize {
            return Err(ShapeError::Length {
                what,
                expected: (self.high.max(0) as usize).saturating_add(1),
                got: len,
            });
        }
        Ok(())
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
unsafe fn avx2(tiles: &Tiles) {
    // SAFETY: the caller's.
    unsafe { tiles.all::<super::simd::Avx2Fma>() }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx2,fma")]
unsafe fn avx512(tiles: &Tiles) {
    // SAFETY: the caller's.
    unsafe { tiles.all::<super::simd::Avx512>() }
}

/// A checked product with its pointers.
struct Tiles {
    product: Product,
    a: *const f32,
    b: *const f32,
    out: *mut f32,
    keep: bool,
    bias: *const f32,
}

impl Tiles {
    /// Cuts the output into tiles that fit the register file.
    ///
    /// # Safety
    /// All elements that the product reaches are valid and `S`'s instruction set exists.
    #[inline(always)]
    unsafe fn all<S: Simd>(&self) {
        let p = &self.product;
        let mut col = 0;
        while col < p.cols {
            let left = p.cols - col;
            // SAFETY: `col` and the row ranges below stay inside `rows × cols`.
            unsafe {
                if p.rows == 1 && left >= 8 * S::LANES {
                    self.tile::<S, 1, 8, false>(0, col, S::LANES);
                    col += 8 * S::LANES;
                } else if p.rows == 1 && left >= 4 * S::LANES {
                    self.tile::<S, 1, 4, false>(0, col, S::LANES);
                    col += 4 * S::LANES;
                } else if p.rows == 2 && left >= 4 * S::LANES {
                    self.tile::<S, 2, 4, false>(0, col, S::LANES);
                    col += 4 * S::LANES;
                } else if left >= 2 * S::LANES {
                    self.column::<S, 2, false>(col, S::LANES);
                    col += 2 * S::LANES;
                } else if left > S::LANES {
                    self.column::<S, 2, true>(col, left - S::LANES);
                    col = p.cols;
                } else if left == S::LANES {
                    self.column::<S, 1, false>(col, S::LANES);
                    col = p.cols;
                } else {
                    self.column::<S, 1, true>(col, left);
                    col = p.cols;
                }
            }
        }
    }

    /// All rows of `C` vectors of columns, of which the last has `last` lanes.
    ///
    /// # Safety
    /// As [`Self::all`]; the columns exist.
    #[inline(always)]
    unsafe fn column<S: Simd, const C: usize, const MASKED: bool>(&self, col: usize, last: usize) {
        let most = if C == 2 { S::ROWS_2 } else { S::ROWS_1 };
        let mut row = 0;
        while row < self.product.rows {
            let rows = (self.product.rows - row).min(most);
            // SAFETY: `row + rows ≤ product.rows`.
            unsafe {
                match rows {
                    1 => self.tile::<S, 1, C, MASKED>(row, col, last),
                    2 => self.tile::<S, 2, C, MASKED>(row, col, last),
                    3 => self.tile::<S, 3, C, MASKED>(row, col, last),
                    4 => self.tile::<S, 4, C, MASKED>(row, col, last),
                    5 if most >= 5 => self.tile::<S, 5, C, MASKED>(row, col, last),
                    6 if most >= 6 => self.tile::<S, 6, C, MASKED>(row, col, last),
                    7 if most >= 7 => self.tile::<S, 7, C, MASKED>(row, col, last),
                    _ => self.tile::<S, 8, C, MASKED>(row, col, last),
                }
            }
            row += rows;
        }
    }

    /// One tile: `R` rows by `C` vectors of accumulators that stay in registers during the whole sum.
    ///
    /// # Safety
    /// As [`Self::all`]; rows `row..row + R` and the columns exist.
    #[inline(always)]
    unsafe fn tile<S: Simd, const R: usize, const C: usize, const MASKED: bool>(
        &self,
        row: usize,
        col: usize,
        last: usize,
    ) {
        let p = &self.product;
        // SAFETY: `Product::run` checked the reach of all strides over all rows and columns; a masked vector touches
        // only its first `last` lanes. Offsets are applied with `wrapping_offset` where they may be intermediate.
        unsafe {
            let load = |at: *const f32, c: usize| {
                if MASKED && c + 1 == C {
                    S::load_first(at.add(c * S::LANES), last)
                } else {
                    S::load(at.add(c * S::LANES))
                }
            };
            let out = self.out.add(p.out_at + row * p.out_row + col);
            let mut acc = [[S::splat(0.0); C]; R];
            if self.keep {
                for (r, acc) in acc.iter_mut().enumerate() {
                    for (c, acc) in acc.iter_mut().enumerate() {
                        *acc = load(out.add(r * p.out_row), c);
                    }
                }
            } else if !self.bias.is_null() {
                let mut bias = [S::splat(0.0); C];
                for (c, bias) in bias.iter_mut().enumerate() {
                    *bias = load(self.bias.add(col), c);
                }
                acc = [bias; R];
            }
            for u in 0..p.n_u as isize {
                for v in 0..p.n_v as isize {
                    let a = self
                        .a
                        .wrapping_offset(p.a_at + row as isize * p.a_row + u * p.a_u + v * p.a_v);
                    let mut a_rows = [a; R];
                    for (r, at) in a_rows.iter_mut().enumerate() {
                        *at = a.wrapping_offset(r as isize * p.a_row);
                    }
                    let mut b = self.b.wrapping_offset(p.b_at + col as isize + u * p.b_u + v * p.b_v);
                    let mut a_k = 0;
                    for _ in 0..p.n_k {
                        let mut b_vectors = [S::splat(0.0); C];
                        for (c, b_vector) in b_vectors.iter_mut().enumerate() {
                            *b_vector = load(b, c);
                        }
                        for (a_row, acc) in a_rows.iter().zip(&mut acc) {
                            let a = S::splat(a_row.wrapping_offset(a_k).read());
                            for (b, acc) in b_vectors.iter().zip(acc) {
                                *acc = S::mul_add(a, *b, *acc);
                            }
                        }
                        a_k += p.a_k;
                        b = b.wrapping_offset(p.b_k);
                    }
                }
            }
            for (r, acc) in acc.iter().enumerate() {
                for (c, acc) in acc.iter().enumerate() {
                    let at = out.add(r * p.out_row + c * S::LANES);
                    if MASKED && c + 1 == C {
                        S::store_first(at, *acc, last);
                    } else {
                        S::store(at, *acc);
                    }
                }
            }
        }
    }
}
