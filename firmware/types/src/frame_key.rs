//! Authentication of depth frames: a keyed tag over header and pixels, so that a frame that somebody without the key made or
//! altered is known from one of the sensor's driver.

use crate::DepthFrame;

/// Bytes of a frame's tag: 128 bits.
pub const FRAME_TAG_BYTES: usize = 16;

/// What keys are derived for; another use of the same secret gives other keys.
const CONTEXT: &str = "Vigil depth frame authentication, version 1";

/// The key with which one sensor's frames are authenticated in one session.
///
/// Derived from a secret that sensor and firmware share, the sensor's number, and what distinguishes this session from others: the
/// machine's boot (shared memory and the monotonic clock of the stamps begin anew with it). So a tag of one sensor does not fit
/// another's frame, and a frame kept from before the last boot does not fit now. Within a session a frame is taken once, because
/// stamps must rise, and only while it is fresh.
///
/// The function is BLAKE3, keyed; <https://github.com/BLAKE3-team/BLAKE3-specs>.
#[derive(Clone)]
pub struct FrameKey([u8; 32]);

impl FrameKey {
    /// The key of a secret for `sensor_id` in `session` (the boot's identifier where machines are real).
    pub fn new(secret: &[u8; 32], sensor_id: u32, session: &[u8]) -> Self {
        let mut derivation = blake3::Hasher::new_derive_key(CONTEXT);
        derivation.update(secret);
        derivation.update(&sensor_id.to_le_bytes());
        derivation.update(session);
        Self(*derivation.finalize().as_bytes())
    }

    /// The first 128 bits of the keyed hash over the 56 covered bytes of the header and the pixels' bytes.
    pub fn tag(&self, frame: &DepthFrame) -> [u8; FRAME_TAG_BYTES] {
        let mut hasher = blake3::Hasher::new_keyed(&self.0);
        hasher.update(&frame.header.covered());
        hasher.update(bytemuck::cast_slice(&frame.depth));
        let mut tag = [0; FRAME_TAG_BYTES];
        hasher.finalize_xof().fill(&mut tag);
        tag
    }
}

impl core::fmt::Debug for FrameKey {
    /// Never shows the key.
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("FrameKey(..)")
    }
}

/// The keys that a receiver accepts: none, where frames are not authenticated; one; or two while a key is being exchanged.
#[derive(Debug, Clone, Default)]
pub struct FrameKeys {
    /// The key in force.
    pub current: Option<FrameKey>,
    /// Another one that is accepted as well: the next, before its publisher changes, or the last, after it did.
    pub other: Option<FrameKey>,
}

impl FrameKeys {
    /// Whether frames must carry a tag.
    pub fn is_required(&self) -> bool {
        self.current.is_some() || self.other.is_some()
    }

    /// Whether the frame's tag was made with one of the keys; true where none is required.
    pub fn accept(&self, frame: &DepthFrame) -> bool {
        !self.is_required()
            || [&self.current, &self.other]
                .into_iter()
                .flatten()
                .any(|key| equal(&key.tag(frame), &frame.header.tag))
    }
}

/// Compares in a time that does not depend on where the first difference is.
fn equal(a: &[u8; FRAME_TAG_BYTES], b: &[u8; FRAME_TAG_BYTES]) -> bool {
    let difference = a.iter().zip(b).fold(0, |bits, (a, b)| bits | (a ^ b));
    core::hint::black_box(difference) == 0
}

impl DepthFrame {
    /// Sets checksum and tag; the publisher's last act where it has a key.
    pub fn authenticate(&mut self, key: &FrameKey) {
        self.seal();
        self.header.tag = key.tag(self);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DEPTH_PIXELS, NedVector};

    fn key(secret: u8, sensor_id: u32, session: &[u8]) -> FrameKeys {
        FrameKeys {
            current: Some(FrameKey::new(&[secret; 32], sensor_id, session)),
            other: None,
        }
    }

    fn authentic() -> DepthFrame {
        let mut frame = DepthFrame::EMPTY;
        frame.header.sensor_id = 7;
        frame.authenticate(&FrameKey::new(&[1; 32], 7, b"boot"));
        frame
    }

    #[test]
    fn only_the_keys_holder_makes_a_frame_that_is_accepted() {
        let keys = key(1, 7, b"boot");
        assert!(keys.accept(&authentic()));
        for others in [key(2, 7, b"boot"), key(1, 8, b"boot"), key(1, 7, b"the boot before")] {
            assert!(!others.accept(&authentic()));
        }
        for pixel in [0, 1023, 1024, DEPTH_PIXELS - 1] {
            let mut frame = authentic();
            frame.depth[pixel] = 0.5;
            frame.seal();
            assert_eq!(
                frame.check(7),
                Ok(()),
                "whoever alters a frame can make its checksum right"
            );
            assert!(!keys.accept(&frame));
        }
        let alterations: [fn(&mut DepthFrame); 5] = [
            |f| f.header.stamp_ns += 1,
            |f| f.header.sequence += 1,
            |f| f.header.position_ned_m = NedVector::new(0.0, 0.0, -0.01),
            |f| f.header.attitude.z = 0.01,
            |f| f.header.tag[15] ^= 1,
        ];
        for alter in alterations {
            let mut frame = authentic();
            alter(&mut frame);
            frame.seal();
            assert!(!keys.accept(&frame));
        }
    }

    /// The tag that `blake3` 1.0 for Python, C behind it, gives by the recipe in docs/frame-authentication.md.
    #[test]
    fn another_implementation_makes_the_same_tag() {
        let mut frame = DepthFrame::EMPTY;
        frame.header.stamp_ns = 123_456_789;
        frame.header.sequence = 42;
        frame.header.sensor_id = 7;
        frame.header.position_ned_m = NedVector::new(1.5, -2.25, -3.0);
        for (i, pixel) in frame.depth.iter_mut().enumerate() {
            *pixel = (i % 1000) as f32 / 1000.0;
        }
        let secret = core::array::from_fn(|i| i as u8);
        let expected = 0x4532_ac94_f12d_27af_fbc6_04b7_c018_5b6f_u128.to_be_bytes();
        assert_eq!(FrameKey::new(&secret, 7, b"4f1a").tag(&frame), expected);
    }
}
