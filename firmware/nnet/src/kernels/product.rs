//! The product kernel.

#[cfg(all(target_arch = "aarch64", target_feature = "neon"))]
use super::simd::Neon;
#[cfg(target_arch = "x86_64")]
use super::simd::{Avx2Fma, Avx512};
use super::simd::{Portable, Simd};
use crate::isa::{Isa, Level};
use crate::shape::ShapeError;

/// A strided product of two slices:
///
/// `out[out_at + i·out_row + c] = start + Σ_u Σ_v Σ_k a[a_at + i·a_row + u·a_u + v·a_v + k·a_k] · b[b_at + u·b_u + v·b_v + k·b_k + c]`
///
/// for `i < rows`, `c < cols`, summed in the order written (`k` innermost). Strides count elements and may be negative.
///
/// `bands` such products lie one behind the other in the output; each begins `a_band` further in `a`.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Product {
    pub rows: usize,
    pub cols: usize,
    pub bands: usize,
    /// Extents of the three sums.
    pub n_u: usize,
    pub n_v: usize,
    pub n_k: usize,
    pub a_at: isize,
    pub a_row: isize,
    pub a_band: isize,
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
    /// One sum only: `n_u = n_v = 1`, in one band.
    pub fn single() -> Self {
        Self {
            bands: 1,
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
        if self.rows == 0 || self.cols == 0 || self.bands == 0 {
            return Ok(());
        }
        let summed = self.n_u > 0 && self.n_v > 0 && self.n_k > 0;
        if summed {
            let mut a_range = Range::at(self.a_at);
            let mut b_range = Range::at(self.b_at);
            a_range.walk(self.rows, self.a_row);
            a_range.walk(self.bands, self.a_band);
            b_range.walk(self.cols, 1);
            let (u, v, k) = ([self.a_u, self.b_u], [self.a_v, self.b_v], [self.a_k, self.b_k]);
            for (n, [a, b]) in [(self.n_u, u), (self.n_v, v), (self.n_k, k)] {
                a_range.walk(n, a);
                b_range.walk(n, b);
            }
            a_range.check("left factor", a.len())?;
            b_range.check("right factor", b.len())?;
        }
        let mut out_range = Range::at(self.out_at as isize);
        out_range.walk(self.rows.saturating_mul(self.bands), self.out_row as isize);
        out_range.walk(self.cols, 1);
        out_range.check("output", out.len())?;
        let (keep, bias) = match start {
            Start::Zero => (false, core::ptr::null()),
            Start::Output => (true, core::ptr::null()),
            Start::Bias(bias) => {
                crate::shape::expect("bias", bias, self.cols)?;
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
                Level::Avx2Fma => tiles.all::<Avx2Fma>(),
                #[cfg(target_arch = "x86_64")]
                Level::Avx512 => tiles.all::<Avx512>(),
                #[cfg(all(target_arch = "aarch64", target_feature = "neon"))]
                Level::Neon => tiles.all::<Neon>(),
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

/// Side of the first convolution's kernel, for which there are tiles of their own.
const SIDE: usize = 5;

/// A checked product with its pointers.
pub(super) struct Tiles {
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
    unsafe fn all<S: Simd>(&self) {
        let p = &self.product;
        // SAFETY: the caller's; each band is a part of the product.
        unsafe {
            if S::CONSTANT && (p.bands, p.rows, p.a_row, p.a_k, p.cols) == (SIDE, SIDE, 1, 2, S::LANES) {
                S::square(self);
                return;
            }
            for band in 0..p.bands {
                let product = Product {
                    bands: 1,
                    a_at: p.a_at + band as isize * p.a_band,
                    out_at: p.out_at + band * p.rows * p.out_row,
                    ..*p
                };
                Self { product, ..*self }.band::<S>();
            }
        }
    }

    /// The same for one band.
    ///
    /// # Safety
    /// As [`Self::all`].
    unsafe fn band<S: Simd>(&self) {
        let p = &self.product;
        let mut col = 0;
        while col < p.cols {
            let left = p.cols - col;
            // SAFETY: `col` and the row ranges below stay inside `rows × cols`.
            unsafe {
                if p.rows == 1 && left >= 8 * S::LANES {
                    S::tile::<1, 8, 0, false>(self, 0, col, S::LANES);
                    col += 8 * S::LANES;
                } else if p.rows == 1 && left >= 4 * S::LANES {
                    S::tile::<1, 4, 0, false>(self, 0, col, S::LANES);
                    col += 4 * S::LANES;
                } else if p.rows == 2 && left >= 4 * S::LANES {
                    S::tile::<2, 4, 0, false>(self, 0, col, S::LANES);
                    col += 4 * S::LANES;
                } else if S::CONSTANT && p.rows == 4 && left >= 4 * S::LANES {
                    S::tile::<4, 4, 0, false>(self, 0, col, S::LANES);
                    col += 4 * S::LANES;
                } else if left >= 2 * S::LANES {
                    match p.a_row {
                        1 if S::CONSTANT => self.column::<S, 2, 1, false>(col, S::LANES),
                        32 if S::CONSTANT => self.column::<S, 2, 32, false>(col, S::LANES),
                        64 if S::CONSTANT => self.column::<S, 2, 64, false>(col, S::LANES),
                        _ => self.column::<S, 2, 0, false>(col, S::LANES),
                    }
                    col += 2 * S::LANES;
                } else if left > S::LANES {
                    self.column::<S, 2, 0, true>(col, left - S::LANES);
                    col = p.cols;
                } else if left == S::LANES {
                    match p.a_row {
                        2 if S::CONSTANT && (p.n_k, p.a_k) == (SIDE, 1) => self.strips::<S>(col),
                        32 if S::CONSTANT => self.column::<S, 1, 32, false>(col, S::LANES),
                        _ => self.column::<S, 1, 0, false>(col, S::LANES),
                    }
                    col = p.cols;
                } else {
                    self.column::<S, 1, 0, true>(col, left);
                    col = p.cols;
                }
            }
        }
    }

    /// All rows of `C` vectors of columns, of which the last has `last` lanes, in tiles of about the same height.
    ///
    /// With `A_ROW`, a layer's stride of rows compiled in, a tile needs one pointer for all its rows, so it may have more
    /// rows than there are registers for pointers.
    ///
    /// # Safety
    /// As [`Self::all`]; the columns exist; `A_ROW` is the product's `a_row` or 0.
    unsafe fn column<S: Simd, const C: usize, const A_ROW: isize, const MASKED: bool>(&self, col: usize, last: usize) {
        let wide = A_ROW != 0;
        let most = match (C, wide) {
            (2, true) => 12,
            (2, false) => S::ROWS_2,
            (_, true) => 16,
            (_, false) => S::ROWS_1,
        };
        let rows = self.product.rows;
        let (mut row, mut tiles) = (0, rows.div_ceil(most));
        while tiles > 0 {
            let height = (rows - row).div_ceil(tiles);
            macro_rules! tile_of {
                ($($height:tt)*) => {
                    match height {
                        $($height if most >= $height => S::tile::<$height, C, A_ROW, MASKED>(self, row, col, last),)*
                        _ => {}
                    }
                };
            }
            // SAFETY: `row + height ≤ rows`.
            unsafe { tile_of!(1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16) }
            row += height;
            tiles -= 1;
        }
    }

    /// All rows of one vector of columns in strips.
    ///
    /// # Safety
    /// As [`Self::strip`].
    unsafe fn strips<S: Simd>(&self, col: usize) {
        const MOST: usize = 9;
        let (mut row, rows) = (0, self.product.rows);
        // SAFETY: `row` stays below `rows`.
        unsafe {
            while rows - row >= MOST {
                S::strip::<MOST>(self, row, col);
                row += MOST;
            }
            while rows - row >= 3 {
                S::strip::<3>(self, row, col);
                row += 3;
            }
            while row < rows {
                S::strip::<1>(self, row, col);
                row += 1;
            }
        }
    }

    /// One tile: `R` rows by `C` vectors of accumulators that stay in registers during the whole sum.
    ///
    /// # Safety
    /// As [`Self::all`]; rows `row..row + R` and the columns exist.
    #[inline(always)]
    pub(super) unsafe fn tile<S: Simd, const R: usize, const C: usize, const A_ROW: isize, const MASKED: bool>(
        &self,
        row: usize,
        col: usize,
        last: usize,
    ) {
        let p = &self.product;
        // SAFETY: `Product::run` checked the reach of all strides over all rows and columns; a masked vector touches
        // only its first `last` lanes. Offsets are applied with `wrapping_offset` where they may be intermediate.
        unsafe {
            let mut acc = self.begin::<S, R, C, MASKED>(row, col, last);
            for u in 0..p.n_u as isize {
                for v in 0..p.n_v as isize {
                    let mut a = self
                        .a
                        .wrapping_offset(p.a_at + row as isize * p.a_row + u * p.a_u + v * p.a_v);
                    let mut a_rows = [a; R];
                    if A_ROW == 0 {
                        for (r, at) in a_rows.iter_mut().enumerate() {
                            *at = a.wrapping_offset(r as isize * p.a_row);
                        }
                    }
                    let mut b = self.b.wrapping_offset(p.b_at + col as isize + u * p.b_u + v * p.b_v);
                    let mut a_k = 0;
                    for _ in 0..p.n_k {
                        let mut b_vectors = [S::splat(0.0); C];
                        for (c, b_vector) in b_vectors.iter_mut().enumerate() {
                            *b_vector = load::<S, C, MASKED>(b, c, last);
                        }
                        for (r, (a_row, acc)) in a_rows.iter().zip(&mut acc).enumerate() {
                            let at = if A_ROW == 0 {
                                a_row.wrapping_offset(a_k)
                            } else {
                                a.wrapping_offset(r as isize * A_ROW)
                            };
                            let a = S::splat(at.read());
                            for (b, acc) in b_vectors.iter().zip(acc) {
                                *acc = S::mul_add(a, *b, *acc);
                            }
                        }
                        a_k += p.a_k;
                        a = a.wrapping_offset(p.a_k);
                        b = b.wrapping_offset(p.b_k);
                    }
                }
            }
            self.end::<S, R, C, MASKED>(&acc, row, col, last);
        }
    }

    /// What the sums of a tile begin with.
    ///
    /// # Safety
    /// As [`Self::tile`].
    #[inline(always)]
    unsafe fn begin<S: Simd, const R: usize, const C: usize, const MASKED: bool>(
        &self,
        row: usize,
        col: usize,
        last: usize,
    ) -> [[S::V; C]; R] {
        let p = &self.product;
        // SAFETY: the caller's.
        unsafe {
            let mut acc = [[S::splat(0.0); C]; R];
            if self.keep {
                let out = self.out.add(p.out_at + row * p.out_row + col);
                for (r, acc) in acc.iter_mut().enumerate() {
                    for (c, acc) in acc.iter_mut().enumerate() {
                        *acc = load::<S, C, MASKED>(out.add(r * p.out_row), c, last);
                    }
                }
            } else if !self.bias.is_null() {
                let mut bias = [S::splat(0.0); C];
                for (c, bias) in bias.iter_mut().enumerate() {
                    *bias = load::<S, C, MASKED>(self.bias.add(col), c, last);
                }
                acc = [bias; R];
            }
            acc
        }
    }

    /// Writes the sums of a tile.
    ///
    /// # Safety
    /// As [`Self::tile`].
    #[inline(always)]
    unsafe fn end<S: Simd, const R: usize, const C: usize, const MASKED: bool>(
        &self,
        acc: &[[S::V; C]; R],
        row: usize,
        col: usize,
        last: usize,
    ) {
        let p = &self.product;
        // SAFETY: the caller's.
        unsafe {
            let out = self.out.add(p.out_at + row * p.out_row + col);
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

    /// `R` rows by one vector where each row sees [`SIDE`] neighbours and the next row begins two further: the first
    /// convolution. Rows share what they read, for reading a value into all lanes is what limits a tile one vector wide.
    ///
    /// # Safety
    /// As [`Self::tile`]; the product has this shape.
    #[inline(always)]
    pub(super) unsafe fn strip<S: Simd, const R: usize>(&self, row: usize, col: usize) {
        let p = &self.product;
        // SAFETY: as in `tile`.
        unsafe {
            let mut acc = self.begin::<S, R, 1, false>(row, col, S::LANES);
            for u in 0..p.n_u as isize {
                for v in 0..p.n_v as isize {
                    let a = self
                        .a
                        .wrapping_offset(p.a_at + 2 * row as isize + u * p.a_u + v * p.a_v);
                    let b = self.b.wrapping_offset(p.b_at + col as isize + u * p.b_u + v * p.b_v);
                    let mut vectors = [S::splat(0.0); SIDE];
                    for (k, vector) in vectors.iter_mut().enumerate() {
                        *vector = S::load(b.wrapping_offset(k as isize * p.b_k));
                    }
                    for (r, [acc]) in acc.iter_mut().enumerate() {
                        for (k, vector) in vectors.iter().enumerate() {
                            *acc = S::mul_add(S::splat(a.add(2 * r + k).read()), *vector, *acc);
                        }
                    }
                }
            }
            self.end::<S, R, 1, false>(&acc, row, col, S::LANES);
        }
    }

    /// [`SIDE`] bands of [`SIDE`] rows whose left factors are neighbours, by one vector, all in one tile; the left factors
    /// of the next summand are two further: the first convolution's weight gradient. Summands share what they read, as in
    /// [`Self::strip`].
    ///
    /// # Safety
    /// As [`Self::all`]; the product has this shape.
    #[inline(always)]
    pub(super) unsafe fn square<S: Simd>(&self) {
        let p = &self.product;
        // SAFETY: as in `tile`; the rows of all bands lie one behind the other in the output.
        unsafe {
            let mut acc = [[S::splat(0.0); SIDE]; SIDE];
            for (band, acc) in acc.iter_mut().enumerate() {
                *acc = self
                    .begin::<S, SIDE, 1, false>(band * SIDE, 0, S::LANES)
                    .map(|[acc]| acc);
            }
            for u in 0..p.n_u as isize {
                for v in 0..p.n_v as isize {
                    let mut a = self.a.wrapping_offset(p.a_at + u * p.a_u + v * p.a_v);
                    let mut b = self.b.wrapping_offset(p.b_at + u * p.b_u + v * p.b_v);
                    for _ in 0..p.n_k / 2 {
                        let vectors = [S::load(b), S::load(b.wrapping_offset(p.b_k))];
                        let mut band = a;
                        for acc in &mut acc {
                            for (j, acc) in acc.iter_mut().enumerate() {
                                for (k, vector) in vectors.iter().enumerate() {
                                    let a = S::splat(band.wrapping_add(j + 2 * k).read());
                                    *acc = S::mul_add(a, *vector, *acc);
                                }
                            }
                            band = band.wrapping_offset(p.a_band);
                        }
                        a = a.wrapping_add(4);
                        b = b.wrapping_offset(2 * p.b_k);
                    }
                    if p.n_k % 2 == 1 {
                        let vector = S::load(b);
                        let mut band = a;
                        for acc in &mut acc {
                            for (j, acc) in acc.iter_mut().enumerate() {
                                *acc = S::mul_add(S::splat(band.wrapping_add(j).read()), vector, *acc);
                            }
                            band = band.wrapping_offset(p.a_band);
                        }
                    }
                }
            }
            for (band, acc) in acc.iter().enumerate() {
                self.end::<S, SIDE, 1, false>(&acc.map(|acc| [acc]), band * SIDE, 0, S::LANES);
            }
        }
    }
}

/// Vector `c` of `C`, the last one masked if `MASKED`.
///
/// # Safety
/// The lanes are valid and `S`'s instruction set exists.
#[inline(always)]
unsafe fn load<S: Simd, const C: usize, const MASKED: bool>(at: *const f32, c: usize, last: usize) -> S::V {
    // SAFETY: the caller's.
    unsafe {
        if MASKED && c + 1 == C {
            S::load_first(at.add(c * S::LANES), last)
        } else {
            S::load(at.add(c * S::LANES))
        }
    }
}
