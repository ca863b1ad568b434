//! The depth frame: what the LiDAR saw, as the policy gets it.

use crate::{Attitude, FRAME_TAG_BYTES, Nanos, NedVector};
use core::f32::consts::PI;
use twox_hash::XxHash3_64;

/// Image rows; row 0 looks up, the last row down.
pub const DEPTH_ROWS: usize = 128;
/// Image columns; column 0 looks left, the last column right.
pub const DEPTH_COLS: usize = 256;
/// Values in one frame.
pub const DEPTH_PIXELS: usize = DEPTH_ROWS * DEPTH_COLS;
/// Range in metres that maps to 1.0 (docs/paper.md, "Depth image").
pub const DEPTH_FULL_SCALE_M: f32 = 100.0;
/// Horizontal field of view: 120°, so that a pixel is square at 256 columns.
pub const HORIZONTAL_FOV_RAD: f32 = 120.0 * PI / 180.0;
/// Vertical field of view: 60°.
pub const VERTICAL_FOV_RAD: f32 = 60.0 * PI / 180.0;
/// Angle between neighbouring pixel centres, in both directions: 0.46875°.
pub const PIXEL_PITCH_RAD: f32 = HORIZONTAL_FOV_RAD / DEPTH_COLS as f32;

/// Bearing of a column's centre in the body frame, positive to the right. Column `c` may be fractional.
#[inline]
pub fn column_bearing_rad(c: f32) -> f32 {
    (c + 0.5) * PIXEL_PITCH_RAD - 0.5 * HORIZONTAL_FOV_RAD
}

/// Elevation of a row's centre in the body frame, positive up. Row `r` may be fractional.
#[inline]
pub fn row_elevation_rad(r: f32) -> f32 {
    0.5 * VERTICAL_FOV_RAD - (r + 0.5) * PIXEL_PITCH_RAD
}

/// What is known about a frame besides its pixels. Plain data with a fixed layout: it crosses shared memory.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[repr(C)]
pub struct FrameHeader {
    /// Time of capture.
    pub stamp_ns: Nanos,
    /// Counts frames of this publisher from 0.
    pub sequence: u64,
    /// Which sensor took it; a receiver accepts the one it was configured for.
    pub sensor_id: u32,
    /// Rows of the image; always [`DEPTH_ROWS`] in a valid frame.
    pub rows: u16,
    /// Columns of the image; always [`DEPTH_COLS`] in a valid frame.
    pub cols: u16,
    /// The vehicle's estimated position at capture, metres as in LOCAL_POSITION_NED.
    pub position_ned_m: NedVector,
    /// The vehicle's estimated attitude at capture.
    pub attitude: Attitude,
    /// Keeps the layout free of padding.
    pub reserved: u32,
    /// [`DepthFrame::compute_checksum`] over all of the above and the pixels.
    pub checksum: u64,
    /// [`FrameKey::tag`](crate::FrameKey::tag) over the same, made by a publisher that has the key; zeros without one.
    pub tag: [u8; FRAME_TAG_BYTES],
}

/// One depth image: range along each pixel's ray (not along the optical axis) divided by [`DEPTH_FULL_SCALE_M`],
/// row-major. A pixel is the equirectangular direction of [`column_bearing_rad`] and [`row_elevation_rad`]. No return is 1.0.
#[derive(Debug, Clone, PartialEq)]
#[repr(C)]
pub struct DepthFrame {
    /// Stamp, sequence, pose.
    pub header: FrameHeader,
    /// `DEPTH_ROWS × DEPTH_COLS` normalised ranges in 0..=1.
    pub depth: [f32; DEPTH_PIXELS],
}

/// Why a frame must not be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum FrameDefect {
    /// Rows or columns are not the ones the policy was built for.
    #[error("frame is {rows} x {cols}, expected {DEPTH_ROWS} x {DEPTH_COLS}")]
    WrongSize {
        /// Rows in the header.
        rows: u16,
        /// Columns in the header.
        cols: u16,
    },
    /// Another sensor's frame.
    #[error("frame is of sensor {sensor_id}")]
    WrongSensor {
        /// Sensor in the header.
        sensor_id: u32,
    },
    /// The checksum does not match: torn or altered in transit.
    #[error("frame checksum does not match")]
    BadChecksum,
    /// A pixel is NaN, infinite or outside 0..=1.
    #[error("frame holds a range that is not within 0..=1")]
    BadRange,
    /// The pose at capture is not finite or its quaternion is not of unit length.
    #[error("frame's pose at capture is not valid")]
    BadPose,
    /// The authentication tag was not made with a key that the receiver has: altered, foreign, or of before the last boot.
    #[error("frame's authentication tag does not match")]
    BadTag,
}

/// Bytes of the header that checksum and tag cover.
pub(crate) const COVERED_BYTES: usize = 56;

// Pixels are hashed where they lie.
const _: () = assert!(cfg!(target_endian = "little"), "frames are little-endian in memory");

impl FrameHeader {
    /// The fields that checksum and tag cover, little-endian, in order.
    pub(crate) fn covered(&self) -> [u8; COVERED_BYTES] {
        let Attitude { w, x, y, z } = self.attitude;
        let whole = self
            .stamp_ns
            .to_le_bytes()
            .into_iter()
            .chain(self.sequence.to_le_bytes());
        let whole = whole.chain(self.sensor_id.to_le_bytes());
        let size = [self.rows, self.cols].into_iter().flat_map(u16::to_le_bytes);
        let pose = self.position_ned_m.to_array().into_iter().chain([w, x, y, z]);
        let mut head = [0; COVERED_BYTES];
        for (slot, byte) in head
            .iter_mut()
            .zip(whole.chain(size).chain(pose.flat_map(f32::to_le_bytes)))
        {
            *slot = byte;
        }
        head
    }
}

impl DepthFrame {
    /// A frame of no returns, with a valid size and checksum still unset.
    pub const EMPTY: Self = Self {
        header: FrameHeader {
            stamp_ns: 0,
            sequence: 0,
            sensor_id: 0,
            rows: DEPTH_ROWS as u16,
            cols: DEPTH_COLS as u16,
            position_ned_m: NedVector::ZERO,
            attitude: Attitude::LEVEL_NORTH,
            reserved: 0,
            checksum: 0,
            tag: [0; FRAME_TAG_BYTES],
        },
        depth: [1.0; DEPTH_PIXELS],
    };

    /// xxHash3-64 over the header (checksum excluded) and the pixels' bits. Not a defence against an adversary, who can
    /// recompute it: it catches torn, truncated and foreign memory.
    pub fn compute_checksum(&self) -> u64 {
        let head = self.header.covered();
        // Chained over blocks; the value is part of the interface.
        let mut hash = XxHash3_64::oneshot(&head);
        for block in self.depth.chunks(1024) {
            hash = XxHash3_64::oneshot_with_seed(hash, bytemuck::cast_slice(block));
        }
        hash
    }

    /// Sets the checksum; the publisher's last act, unless it also [authenticates](Self::authenticate).
    pub fn seal(&mut self) {
        self.header.checksum = self.compute_checksum();
    }

    /// Checks everything a receiver relies on: size, sensor, checksum, pose, every range.
    ///
    /// # Errors
    /// The first [`FrameDefect`] found.
    pub fn check(&self, sensor_id: u32) -> Result<(), FrameDefect> {
        let h = &self.header;
        if usize::from(h.rows) != DEPTH_ROWS || usize::from(h.cols) != DEPTH_COLS {
            return Err(FrameDefect::WrongSize {
                rows: h.rows,
                cols: h.cols,
            });
        }
        if h.sensor_id != sensor_id {
            return Err(FrameDefect::WrongSensor { sensor_id: h.sensor_id });
        }
        if h.checksum != self.compute_checksum() {
            return Err(FrameDefect::BadChecksum);
        }
        if !h.position_ned_m.is_finite() || !h.attitude.is_valid() {
            return Err(FrameDefect::BadPose);
        }
        // NaN fails both comparisons' negation, so this form catches it.
        if self.depth.iter().fold(false, |bad, v| bad | !(*v >= 0.0 && *v <= 1.0)) {
            return Err(FrameDefect::BadRange);
        }
        Ok(())
    }

    /// Range in metres of pixel (`row`, `col`), or `None` outside the image.
    #[inline]
    pub fn range_m(&self, row: usize, col: usize) -> Option<f32> {
        if col >= DEPTH_COLS {
            return None;
        }
        self.depth.get(row * DEPTH_COLS + col).map(|v| v * DEPTH_FULL_SCALE_M)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sealed() -> DepthFrame {
        let mut f = DepthFrame::EMPTY;
        f.header.sensor_id = 7;
        f.seal();
        f
    }

    #[test]
    fn a_sealed_frame_is_accepted_and_its_layout_has_no_padding() {
        assert_eq!(sealed().check(7), Ok(()));
        assert_eq!(core::mem::size_of::<FrameHeader>(), 80);
        assert_eq!(core::mem::size_of::<DepthFrame>(), 80 + 4 * DEPTH_PIXELS);
    }

    #[test]
    fn every_defect_has_its_name() {
        let mut f = sealed();
        f.header.rows = 64;
        assert_eq!(f.check(7), Err(FrameDefect::WrongSize { rows: 64, cols: 256 }));
        assert_eq!(sealed().check(8), Err(FrameDefect::WrongSensor { sensor_id: 7 }));
        for tamper in [0, 1023, 1024, DEPTH_PIXELS - 1] {
            let mut f = sealed();
            f.depth[tamper] = 0.5;
            assert_eq!(f.check(7), Err(FrameDefect::BadChecksum));
        }
        for bad in [f32::NAN, f32::INFINITY, -0.01, 1.01] {
            let mut f = sealed();
            f.depth[99] = bad;
            f.seal();
            assert_eq!(f.check(7), Err(FrameDefect::BadRange));
        }
        let mut f = sealed();
        f.header.attitude.w = f32::NAN;
        f.seal();
        assert_eq!(f.check(7), Err(FrameDefect::BadPose));
    }

    #[test]
    fn the_image_spans_the_field_of_view_symmetrically() {
        let half = PIXEL_PITCH_RAD / 2.0;
        assert!((column_bearing_rad(0.0) + HORIZONTAL_FOV_RAD / 2.0 - half).abs() < 1e-6);
        assert!((column_bearing_rad(255.0) - HORIZONTAL_FOV_RAD / 2.0 + half).abs() < 1e-6);
        assert!((row_elevation_rad(0.0) - VERTICAL_FOV_RAD / 2.0 + half).abs() < 1e-6);
        assert!((row_elevation_rad(127.0) + VERTICAL_FOV_RAD / 2.0 - half).abs() < 1e-6);
    }
}
