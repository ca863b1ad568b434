//! The only module with `unsafe`: one product kernel, and a way to compile element-wise
//! loops for each instruction set.
//!
//! Every layer that multiplies (convolution, dense, recurrent; forward, input gradient, weight gradient, multipliers)
//! is one or a few [`Product`]s. A product checks, before it touches memory, that the furthest elements its strides can
//! reach lie inside the slices it was given; the tiles below it work on raw pointers within that range.
//!
//! Each output is summed in the same order on every instruction set and for every tile shape, so AVX2, AVX-512 and NEON
//! give the same bits (all fuse), and the portable kernels differ from them only by the rounding of each product.

#![allow(unsafe_code)]

mod product;
mod simd;

pub(crate) use product::{Product, Start};

use crate::isa::{Isa, Level};

/// Element-wise work that is compiled once for each instruction set. [`Task::run`] is plain Rust, to be marked
/// `#[inline(always)]`: the compiler vectorises its loops with what each set has, and fuses only what is written as fused.
pub trait Task {
    /// Does the work. `FUSED`: the instruction set has fused multiply-add.
    fn run<const FUSED: bool>(self);
}

/// Makes a function whose body is compiled once for each instruction set, as a [`Task`]'s; which one to run is its first argument.
#[macro_export]
macro_rules! vectorised {
    ($(#[$doc:meta])* $vis:vis fn $name:ident<$life:lifetime>($($arg:ident: $type:ty),* $(,)?) $body:block) => {
        $(#[$doc])*
        $vis fn $name<$life>(isa: $crate::Isa, $($arg: $type),*) {
            struct Arguments<$life> {
                $($arg: $type),*
            }

            impl<$life> $crate::Task for Arguments<$life> {
                #[inline(always)]
                fn run<const FUSED: bool>(self) {
                    let Self { $($arg),* } = self;
                    $body
                }
            }

            isa.run(Arguments { $($arg),* });
        }
    };
}

/// `a · b + c`, rounded once if `FUSED`.
#[inline(always)]
pub(crate) fn mul_add<const FUSED: bool>(a: f32, b: f32, c: f32) -> f32 {
    #[cfg(feature = "std")]
    if FUSED {
        return a.mul_add(b, c);
    }
    // `core` has no fused multiply-add of numbers, but the processor's own, which vectorises as well.
    #[cfg(all(not(feature = "std"), target_arch = "aarch64", target_feature = "neon"))]
    if FUSED {
        use core::arch::aarch64::{vdup_n_f32, vfmas_lane_f32};
        // SAFETY: the target has NEON.
        return unsafe { vfmas_lane_f32::<0>(c, a, vdup_n_f32(b)) };
    }
    // Elsewhere there is no detection without `std`, hence no instruction set that fuses.
    a * b + c
}

impl Isa {
    /// Does a task compiled for this instruction set.
    #[inline]
    pub fn run<T: Task>(self, task: T) {
        match self.0 {
            Level::Portable => task.run::<false>(),
            // SAFETY: an `Isa` of this level exists only where the processor has these features: its field is private and
            // is set only after detection.
            #[cfg(target_arch = "x86_64")]
            Level::Avx2Fma => unsafe { run_avx2(task) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 => unsafe { run_avx512(task) },
            #[cfg(all(target_arch = "aarch64", target_feature = "neon"))]
            Level::Neon => task.run::<true>(),
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn run_avx2<T: Task>(task: T) {
    task.run::<true>();
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx2,fma")]
fn run_avx512<T: Task>(task: T) {
    task.run::<true>();
}
