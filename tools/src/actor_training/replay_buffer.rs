//! What replay memories keep: depth frames in 8 bits of contrast, and what follows a decision.
//!
//! A frame is kept as `1 / (1 + range / 3 m)` in 255 steps, which is what the network's first layer makes of it: a step is
//! 1 cm of range near the vehicle, 8 cm at 5 m.

use serde::{Deserialize, Serialize};
use vigil_nnet::Activation;
use vigil_types::{DEPTH_COLS, DEPTH_PIXELS};

/// Steps of contrast in a kept frame.
const LEVELS: f32 = 255.0;

/// Keeps a depth image.
pub fn pack_frame(depth: &[f32; DEPTH_PIXELS], packed: &mut [u8]) {
    let Activation::NearContrast { gain } = Activation::NEAR_CONTRAST else {
        unreachable!("the contrast layer is a contrast layer");
    };
    for (packed, depth) in packed.iter_mut().zip(depth) {
        *packed = (LEVELS / (1.0 + gain * depth) + 0.5) as u8;
    }
}

/// The contrast that the first convolution gets of a kept frame, as it was or in a mirror.
pub fn unpack_frame(packed: &[u8], mirror: bool, contrast: &mut [f32]) {
    const SCALE: f32 = 1.0 / LEVELS;
    if mirror {
        for (to, from) in contrast
            .chunks_exact_mut(DEPTH_COLS)
            .zip(packed.chunks_exact(DEPTH_COLS))
        {
            for (to, from) in to.iter_mut().zip(from.iter().rev()) {
                *to = f32::from(*from) * SCALE;
            }
        }
    } else {
        for (to, from) in contrast.iter_mut().zip(packed) {
            *to = f32::from(*from) * SCALE;
        }
    }
}

/// What follows a decision.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Next {
    /// The next record of the lane.
    Decision,
    /// Nothing: success, collision, out of bounds.
    Terminal,
    /// The next record of the lane is the state in which the flight was cut off.
    CutOff,
    /// This is that state; no action was taken in it.
    Nothing,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_kept_frame_holds_near_range_to_centimetres_and_can_be_seen_in_a_mirror() {
        let mut depth: Box<[f32; DEPTH_PIXELS]> = vec![1.0; DEPTH_PIXELS].into_boxed_slice().try_into().unwrap();
        depth[0] = 0.005;
        depth[1] = 0.05;
        let mut packed = vec![0; DEPTH_PIXELS];
        pack_frame(&depth, &mut packed);
        let (mut plain, mut mirror) = (vec![0.0; DEPTH_PIXELS], vec![0.0; DEPTH_PIXELS]);
        unpack_frame(&packed, false, &mut plain);
        unpack_frame(&packed, true, &mut mirror);
        let range_m = |contrast: f32| 3.0 / contrast - 3.0;
        assert!((range_m(plain[0]) - 0.5).abs() < 0.02, "{}", range_m(plain[0]));
        assert!((range_m(plain[1]) - 5.0).abs() < 0.05, "{}", range_m(plain[1]));
        assert_eq!(mirror[DEPTH_COLS - 1], plain[0]);
        assert_eq!(mirror[DEPTH_COLS - 2], plain[1]);
        assert_eq!(mirror[DEPTH_COLS + 7], plain[DEPTH_COLS + 7]);
    }
}
