//! Products of bytes, summed as integers: every instruction set gives the same bits.

use crate::isa::Isa;
#[cfg(target_arch = "x86_64")]
use crate::isa::Level;
use crate::shape::{ShapeError, expect, expect_len};

/// Columns of one block of right factors.
pub(crate) const BLOCK: usize = 16;
/// Neighbouring left factors that are multiplied at once.
pub(crate) const DEPTH: usize = 4;

/// Right factors of 16 columns, four neighbours each: a cache line.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(crate) struct Factors(pub [[i8; DEPTH]; BLOCK]);

/// What the sums of 16 columns begin with and stand for: `sum · scale + bias`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Meaning {
    pub start: [i32; BLOCK],
    pub scale: [f32; BLOCK],
    pub bias: [f32; BLOCK],
}

/// A strided product of bytes:
///
/// `out[i][c] = (start[c] + Σ_u Σ_k Σ_j a[a_at + i·a_row + u·a_u + 4·k + j] · b[c / 16][u][k][c mod 16][j]) · scale[c] + bias[c]`
///
/// for `i < rows`, `c < 16 · blocks`, `u < n_u`, `k < n_k`, `j < 4`. Strides count bytes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DotProduct {
    pub rows: usize,
    pub blocks: usize,
    pub n_u: usize,
    pub n_k: usize,
    pub a_at: usize,
    pub a_row: usize,
    pub a_u: usize,
}

impl DotProduct {
    /// Runs the product and raises `most`, for each column of a block, to the largest value's bits, which as integers have the order of positive
    /// numbers. Up to 60 000 summands of any size stay within 32 bits.
    ///
    /// # Errors
    /// Slices that do not fit; nothing is written then.
    pub fn run(
        &self,
        isa: Isa,
        a: &[u8],
        b: &[Factors],
        meaning: &[Meaning],
        most: &mut [i32; BLOCK],
        out: &mut [f32],
    ) -> Result<(), ShapeError> {
        let steps = |n: usize, stride: usize| n.saturating_sub(1).saturating_mul(stride);
        let furthest = [
            steps(self.rows, self.a_row),
            steps(self.n_u, self.a_u),
            self.n_k.saturating_mul(DEPTH),
        ];
        let reach = furthest.iter().fold(self.a_at, |sum, n| sum.saturating_add(*n));
        if a.len() < reach {
            return Err(ShapeError::Length {
                what: "left factor",
                expected: reach,
                got: a.len(),
            });
        }
        expect_len("right factor", b.len(), self.blocks * self.n_u * self.n_k)?;
        expect_len("meaning of sums", meaning.len(), self.blocks)?;
        expect("output", out, self.rows * self.blocks * BLOCK)?;
        match isa.0 {
            // SAFETY: the level exists only after detection; the furthest elements lie inside the slices (checked above).
            #[cfg(target_arch = "x86_64")]
            Level::Avx512Vnni => unsafe { x86::all(self, a.as_ptr(), b.as_ptr(), meaning, most, out.as_mut_ptr()) },
            _ => super::run(
                isa,
                Plain {
                    product: self,
                    a,
                    b,
                    meaning,
                    most,
                    out,
                },
            ),
        }
        Ok(())
    }
}

/// The product in plain Rust.
struct Plain<'a> {
    product: &'a DotProduct,
    a: &'a [u8],
    b: &'a [Factors],
    meaning: &'a [Meaning],
    most: &'a mut [i32; BLOCK],
    out: &'a mut [f32],
}

impl super::Task for Plain<'_> {
    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let p = self.product;
        for (i, out) in self.out.chunks_exact_mut((p.blocks * BLOCK).max(1)).enumerate() {
            let blocks = self.b.chunks_exact((p.n_u * p.n_k).max(1)).zip(self.meaning);
            for (out, (block, meaning)) in out.as_chunks_mut::<BLOCK>().0.iter_mut().zip(blocks) {
                let mut sums = meaning.start;
                for (u, row) in block.chunks_exact(p.n_k.max(1)).enumerate() {
                    let a = self.a.get(p.a_at + i * p.a_row + u * p.a_u..).unwrap_or_default();
                    for (a, Factors(b)) in a.as_chunks::<DEPTH>().0.iter().zip(row) {
                        let [a0, a1, a2, a3] = a.map(i32::from);
                        for (sum, b) in sums.iter_mut().zip(b) {
                            let [b0, b1, b2, b3] = b.map(i32::from);
                            *sum += a0 * b0 + a1 * b1 + a2 * b2 + a3 * b3;
                        }
                    }
                }
                let columns = sums.iter().zip(meaning.scale.iter().zip(&meaning.bias));
                for ((out, most), (sum, (scale, bias))) in out.iter_mut().zip(&mut *self.most).zip(columns) {
                    *out = *sum as f32 * scale + bias;
                    *most = (*most).max(out.to_bits() as i32);
                }
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::{BLOCK, DEPTH, DotProduct, Factors, Meaning};
    use core::arch::x86_64::*;

    /// Cuts the output into tiles that fit the register file.
    ///
    /// # Safety
    /// All elements that the product reaches are valid, `meaning` has one for each block; the processor has AVX-512 VNNI.
    #[target_feature(enable = "avx512f,avx512vnni")]
    pub(super) unsafe fn all(
        p: &DotProduct,
        a: *const u8,
        b: *const Factors,
        meaning: &[Meaning],
        most: &mut [i32; BLOCK],
        out: *mut f32,
    ) {
        // SAFETY: the caller's; blocks and rows lie within the product.
        unsafe {
            let mut highest = _mm512_loadu_si512(most.as_ptr().cast());
            for (pair, meaning) in meaning.chunks(2).enumerate() {
                let block = 2 * pair;
                let b = b.add(block * p.n_u * p.n_k);
                let mut row = 0;
                while row < p.rows {
                    let (a, out) = (a.add(p.a_at + row * p.a_row), out.add((row * p.blocks + block) * BLOCK));
                    row += match (meaning, p.rows - row) {
                        ([one, two], 8..) => tile::<8, 2>(p, a, b, [one, two], &mut highest, out),
                        ([one, two], 4..) => tile::<4, 2>(p, a, b, [one, two], &mut highest, out),
                        ([one, two], _) => tile::<1, 2>(p, a, b, [one, two], &mut highest, out),
                        ([one], 16..) => tile::<16, 1>(p, a, b, [one], &mut highest, out),
                        ([one], 4..) => tile::<4, 1>(p, a, b, [one], &mut highest, out),
                        ([one], _) => tile::<1, 1>(p, a, b, [one], &mut highest, out),
                        _ => p.rows,
                    };
                }
            }
            _mm512_storeu_si512(most.as_mut_ptr().cast(), highest);
        }
    }

    /// `R` rows by `C` blocks; gives `R`.
    ///
    /// # Safety
    /// As [`all`]; the tile lies within the product.
    #[inline]
    #[target_feature(enable = "avx512f,avx512vnni")]
    unsafe fn tile<const R: usize, const C: usize>(
        p: &DotProduct,
        a: *const u8,
        b: *const Factors,
        meaning: [&Meaning; C],
        highest: &mut __m512i,
        out: *mut f32,
    ) -> usize {
        // SAFETY: the caller's; factors begin at cache lines.
        unsafe {
            let starts = meaning.map(|meaning| _mm512_loadu_si512(meaning.start.as_ptr().cast()));
            let mut sums = [starts; R];
            let mut b = b;
            for u in 0..p.n_u {
                let mut a = a.add(u * p.a_u);
                for _ in 0..p.n_k {
                    let mut right = starts;
                    for (c, right) in right.iter_mut().enumerate() {
                        *right = _mm512_load_si512(b.add(c * p.n_u * p.n_k).cast());
                    }
                    for (r, sums) in sums.iter_mut().enumerate() {
                        let left = _mm512_set1_epi32(a.add(r * p.a_row).cast::<i32>().read_unaligned());
                        for (sum, right) in sums.iter_mut().zip(&right) {
                            *sum = _mm512_dpbusd_epi32(*sum, left, *right);
                        }
                    }
                    a = a.add(DEPTH);
                    b = b.add(1);
                }
            }
            let scales = meaning.map(|meaning| _mm512_loadu_ps(meaning.scale.as_ptr()));
            let biases = meaning.map(|meaning| _mm512_loadu_ps(meaning.bias.as_ptr()));
            for (r, sums) in sums.iter().enumerate() {
                for (c, (sum, (scale, bias))) in sums.iter().zip(scales.iter().zip(&biases)).enumerate() {
                    // Rounded twice, as everywhere.
                    let product = _mm512_mul_ps(_mm512_cvtepi32_ps(*sum), *scale);
                    let value = _mm512_add_ps(product, *bias);
                    *highest = _mm512_max_epi32(*highest, _mm512_castps_si512(value));
                    _mm512_storeu_ps(out.add((r * p.blocks + c) * BLOCK), value);
                }
            }
        }
        R
    }
}
