//! One source, compiled for several vector widths, chosen when the program runs.
//!
//! The bits cannot depend on the choice: all arithmetic is element by element, and the compiler neither reorders nor fuses
//! floating-point operations.

/// Which copy of the vector code runs. Only [`Simd::available`] makes one, so a value exists only where the CPU can run it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Simd(pub(super) Width);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(not(target_arch = "x86_64"), expect(dead_code))]
pub(super) enum Width {
    Portable,
    Avx2,
    Avx512,
}

impl Simd {
    /// All that this CPU can run, the fastest last.
    pub(crate) fn available() -> Vec<Self> {
        let mut all = vec![Self(Width::Portable)];
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx2") {
                all.push(Self(Width::Avx2));
            }
            if is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512bw")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512vl")
            {
                all.push(Self(Width::Avx512));
            }
        }
        all
    }

    /// The fastest that this CPU can run.
    pub(crate) fn best() -> Self {
        Self::available().pop().unwrap_or(Self(Width::Portable))
    }
}

/// Defines `fn name(simd, args…)` that runs a copy of an `#[inline(always)]` function compiled for `simd`.
macro_rules! vectorised {
    ($(#[$doc:meta])* $vis:vis fn $name:ident($($arg:ident: $ty:ty),* $(,)?) = $body:path;) => {
        $(#[$doc])*
        $vis fn $name(simd: $crate::world::lidar::simd::Simd, $($arg: $ty),*) {
            #[cfg(target_arch = "x86_64")]
            {
                use $crate::world::lidar::simd::Width;
                #[target_feature(enable = "avx2")]
                fn avx2($($arg: $ty),*) {
                    $body($($arg),*);
                }
                #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl")]
                fn avx512($($arg: $ty),*) {
                    $body($($arg),*);
                }
                match simd.0 {
                    // SAFETY: `Simd::available` asked the CPU for these features before it made the value.
                    Width::Avx2 => return unsafe { avx2($($arg),*) },
                    // SAFETY: as above.
                    Width::Avx512 => return unsafe { avx512($($arg),*) },
                    Width::Portable => {}
                }
            }
            $body($($arg),*);
        }
    };
}
pub(crate) use vectorised;
