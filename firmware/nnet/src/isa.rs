//! Which instruction set the kernels use.

/// An instruction set that this processor is known to have.
///
/// The field is private, so that a value other than [`Isa::PORTABLE`] can only come from [`Isa::detect`] or
/// [`Isa::available`]: the kernels rely on it when they run instructions the build's target does not promise.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Isa(pub(crate) Level);

/// The kernels there are. On a target without vector kernels of its own only [`Level::Portable`] exists in practice.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(
    not(feature = "std"),
    allow(dead_code, reason = "only detection makes some of the others")
)]
pub(crate) enum Level {
    /// Multiply, then add, four lanes at a time in whatever the target's baseline offers.
    Portable,
    /// 256-bit vectors with fused multiply-add.
    #[cfg(target_arch = "x86_64")]
    Avx2Fma,
    /// 512-bit vectors with fused multiply-add and lane masks.
    #[cfg(target_arch = "x86_64")]
    Avx512,
    /// 128-bit vectors with fused multiply-add, which every 64-bit ARM processor has.
    #[cfg(all(target_arch = "aarch64", target_feature = "neon"))]
    Neon,
}

impl Isa {
    /// Runs everywhere.
    pub const PORTABLE: Self = Self(Level::Portable);

    /// The fastest kernels for this processor; without `std` those that every processor of the target has. Call it once at start and
    /// pass the value on.
    pub fn detect() -> Self {
        Self::available().last().unwrap_or(Self::PORTABLE)
    }

    /// All kernels that this processor can run, slowest first.
    pub fn available() -> impl Iterator<Item = Self> {
        #[cfg(all(target_arch = "x86_64", feature = "std"))]
        let vectors = {
            let avx2 = std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma");
            // The AVX-512 kernels are compiled with AVX2 and FMA as well, for what is not 512 bits wide.
            let avx512 = avx2 && std::arch::is_x86_feature_detected!("avx512f");
            [
                avx2.then_some(Self(Level::Avx2Fma)),
                avx512.then_some(Self(Level::Avx512)),
            ]
        };
        #[cfg(all(target_arch = "aarch64", target_feature = "neon"))]
        let vectors = [Some(Self(Level::Neon))];
        #[cfg(not(any(
            all(target_arch = "x86_64", feature = "std"),
            all(target_arch = "aarch64", target_feature = "neon")
        )))]
        let vectors: [Option<Self>; 0] = [];
        core::iter::once(Self::PORTABLE).chain(vectors.into_iter().flatten())
    }

    /// Name for logs and benchmarks.
    pub fn name(self) -> &'static str {
        match self.0 {
            Level::Portable => "portable",
            #[cfg(target_arch = "x86_64")]
            Level::Avx2Fma => "avx2+fma",
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 => "avx512",
            #[cfg(all(target_arch = "aarch64", target_feature = "neon"))]
            Level::Neon => "neon",
        }
    }
}

impl core::fmt::Display for Isa {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(self.name())
    }
}
