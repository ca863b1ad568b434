//! Vectors of several widths behind one trait.

use super::product::Tiles;

/// [`Tiles::tile`], [`Tiles::square`] and [`Tiles::strip`], compiled for an instruction set.
macro_rules! compiled_for {
    ($(#[$features:meta])?) => {
        $(#[$features])?
        unsafe fn tile<const R: usize, const C: usize, const A_ROW: isize, const MASKED: bool>(
            tiles: &Tiles,
            row: usize,
            col: usize,
            last: usize,
        ) {
            // SAFETY: the caller's.
            unsafe { tiles.tile::<Self, R, C, A_ROW, MASKED>(row, col, last) }
        }

        $(#[$features])?
        unsafe fn square(tiles: &Tiles) {
            // SAFETY: the caller's.
            unsafe { tiles.square::<Self>() }
        }

        $(#[$features])?
        unsafe fn strip<const R: usize>(tiles: &Tiles, row: usize, col: usize) {
            // SAFETY: the caller's.
            unsafe { tiles.strip::<Self, R>(row, col) }
        }
    };
}

/// Vector operations, each an expression.
macro_rules! operations {
    ($($name:ident($($arg:ident: $type:ty),*) $(-> $out:ty)? = $body:expr;)*) => {$(
        #[inline(always)]
        #[allow(unused_unsafe, reason = "not every one needs it")]
        unsafe fn $name($($arg: $type),*) $(-> $out)? {
            unsafe { $body }
        }
    )*};
}

/// A vector of [`Simd::LANES`] float32.
///
/// # Safety
/// All methods may only be called where the implementor's instruction set exists; pointers must be valid for the lanes
/// that are read or written (all of them, or the first `n`). No alignment is required.
pub(super) trait Simd: Sized {
    /// Register type.
    type V: Copy;
    /// Lanes in one register.
    const LANES: usize;
    /// Largest number of rows of accumulators beside two vectors of columns that the register file holds.
    const ROWS_2: usize;
    /// Largest number of rows beside one vector of columns.
    const ROWS_1: usize;
    /// Whether there are registers for the higher tiles that constant strides of rows allow.
    const CONSTANT: bool;

    unsafe fn splat(x: f32) -> Self::V;
    unsafe fn load(p: *const f32) -> Self::V;
    unsafe fn store(p: *mut f32, v: Self::V);
    /// Reads the first `n` lanes; the rest are zero.
    unsafe fn load_first(p: *const f32, n: usize) -> Self::V;
    /// Writes the first `n` lanes.
    unsafe fn store_first(p: *mut f32, v: Self::V, n: usize);
    /// `a · b + c`, fused where the instruction set fuses.
    unsafe fn mul_add(a: Self::V, b: Self::V, c: Self::V) -> Self::V;

    compiled_for!();
}

/// Four lanes of plain Rust: the registers of the target's baseline after optimisation.
pub(super) struct Portable;

impl Simd for Portable {
    type V = [f32; 4];
    const LANES: usize = 4;
    const ROWS_2: usize = 4;
    const ROWS_1: usize = 8;
    const CONSTANT: bool = false;

    // SAFETY of the bodies: the caller vouches for the lanes; an array of f32 has the alignment of f32.
    operations! {
        splat(x: f32) -> Self::V = [x; 4];
        load(p: *const f32) -> Self::V = p.cast::<[f32; 4]>().read();
        store(p: *mut f32, v: Self::V) = p.cast::<[f32; 4]>().write(v);
        load_first(p: *const f32, n: usize) -> Self::V = {
            let mut v = [0.0; 4];
            for (i, lane) in v.iter_mut().enumerate() {
                if i < n {
                    *lane = p.add(i).read();
                }
            }
            v
        };
        store_first(p: *mut f32, v: Self::V, n: usize) = {
            for (i, lane) in v.iter().enumerate() {
                if i < n {
                    p.add(i).write(*lane);
                }
            }
        };
        mul_add(a: Self::V, b: Self::V, c: Self::V) -> Self::V = {
            let ([a0, a1, a2, a3], [b0, b1, b2, b3], [c0, c1, c2, c3]) = (a, b, c);
            [a0 * b0 + c0, a1 * b1 + c1, a2 * b2 + c2, a3 * b3 + c3]
        };
    }
}

#[cfg(target_arch = "x86_64")]
pub(super) use x86::{Avx2Fma, Avx512};

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::{Simd, Tiles};
    use core::arch::x86_64::*;

    /// Eight lanes; sixteen registers.
    pub(in super::super) struct Avx2Fma;

    /// All ones in the first `n` of eight lanes.
    #[inline(always)]
    unsafe fn first(n: usize) -> __m256i {
        // SAFETY: AVX2 exists where this is called.
        unsafe {
            let lane = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
            _mm256_cmpgt_epi32(_mm256_set1_epi32(n as i32), lane)
        }
    }

    // SAFETY of the bodies below: the trait's contract gives the instruction set and the valid lanes.
    impl Simd for Avx2Fma {
        type V = __m256;
        const LANES: usize = 8;
        const ROWS_2: usize = 6;
        const ROWS_1: usize = 8;
        const CONSTANT: bool = false;

        operations! {
            splat(x: f32) -> Self::V = _mm256_set1_ps(x);
            load(p: *const f32) -> Self::V = _mm256_loadu_ps(p);
            store(p: *mut f32, v: Self::V) = _mm256_storeu_ps(p, v);
            load_first(p: *const f32, n: usize) -> Self::V = _mm256_maskload_ps(p, first(n));
            store_first(p: *mut f32, v: Self::V, n: usize) = _mm256_maskstore_ps(p, first(n), v);
            mul_add(a: Self::V, b: Self::V, c: Self::V) -> Self::V = _mm256_fmadd_ps(a, b, c);
        }

        compiled_for!(#[target_feature(enable = "avx2,fma")]);
    }

    /// Sixteen lanes; thirty-two registers.
    pub(in super::super) struct Avx512;

    impl Simd for Avx512 {
        type V = __m512;
        const LANES: usize = 16;
        const ROWS_2: usize = 8;
        const ROWS_1: usize = 8;
        const CONSTANT: bool = true;

        operations! {
            splat(x: f32) -> Self::V = _mm512_set1_ps(x);
            load(p: *const f32) -> Self::V = _mm512_loadu_ps(p);
            store(p: *mut f32, v: Self::V) = _mm512_storeu_ps(p, v);
            load_first(p: *const f32, n: usize) -> Self::V = _mm512_maskz_loadu_ps(((1u32 << n) - 1) as u16, p);
            store_first(p: *mut f32, v: Self::V, n: usize) = _mm512_mask_storeu_ps(p, ((1u32 << n) - 1) as u16, v);
            mul_add(a: Self::V, b: Self::V, c: Self::V) -> Self::V = _mm512_fmadd_ps(a, b, c);
        }

        compiled_for!(#[target_feature(enable = "avx512f,avx2,fma")]);
    }
}

#[cfg(all(target_arch = "aarch64", target_feature = "neon"))]
pub(super) use arm::Neon;

#[cfg(all(target_arch = "aarch64", target_feature = "neon"))]
mod arm {
    use super::{Portable, Simd};
    use core::arch::aarch64::*;

    /// Four lanes; thirty-two registers.
    pub(in super::super) struct Neon;

    // SAFETY of the bodies below: the target has NEON; the trait's contract gives the valid lanes.
    impl Simd for Neon {
        type V = float32x4_t;
        const LANES: usize = 4;
        const ROWS_2: usize = 8;
        const ROWS_1: usize = 8;
        const CONSTANT: bool = false;

        operations! {
            splat(x: f32) -> Self::V = vdupq_n_f32(x);
            load(p: *const f32) -> Self::V = vld1q_f32(p);
            store(p: *mut f32, v: Self::V) = vst1q_f32(p, v);
            load_first(p: *const f32, n: usize) -> Self::V = vld1q_f32(Portable::load_first(p, n).as_ptr());
            store_first(p: *mut f32, v: Self::V, n: usize) = {
                let mut lanes = [0.0; 4];
                vst1q_f32(lanes.as_mut_ptr(), v);
                Portable::store_first(p, lanes, n);
            };
            mul_add(a: Self::V, b: Self::V, c: Self::V) -> Self::V = vfmaq_f32(c, a, b);
        }
    }
}
