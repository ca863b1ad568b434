//! What the image detectors look at: the newest frame's pixel explanation, as an image.

/// Rows and columns of an image: a value stands for 2 × 2 pixels of the depth frame.
pub const IMAGE_ROWS: usize = 64;
/// See [`IMAGE_ROWS`].
pub const IMAGE_COLS: usize = 128;
/// The negative part and the positive part.
pub const IMAGE_CHANNELS: usize = 2;
/// Values of an image.
pub const IMAGE: usize = IMAGE_ROWS * IMAGE_COLS * IMAGE_CHANNELS;

const BLOCK: usize = 2;
const COLS: usize = IMAGE_COLS * BLOCK;
const FRAME: usize = IMAGE_ROWS * BLOCK * COLS;

/// SHAP values of a frame's pixels (128 · 256) as an image of two channels `[64][128][2]`: sums of the negative and of the positive
/// values over blocks of 2 × 2 pixels, each channel over its largest value, 0 to 1 as bytes. `None` for another length or a value
/// that is not finite.
pub fn image(phi: &[f32]) -> Option<Vec<u8>> {
    if phi.len() != FRAME || !phi.iter().all(|x| x.is_finite()) {
        return None;
    }
    let mut sums = vec![0.0f32; IMAGE];
    let bands = sums.chunks_exact_mut(IMAGE_COLS * IMAGE_CHANNELS);
    for (row, band) in bands.zip(phi.chunks_exact(BLOCK * COLS)) {
        for line in band.chunks_exact(COLS) {
            for (slot, block) in row.chunks_exact_mut(IMAGE_CHANNELS).zip(line.chunks_exact(BLOCK)) {
                for x in block {
                    if let Some(slot) = slot.get_mut(usize::from(*x > 0.0)) {
                        *slot += x.abs();
                    }
                }
            }
        }
    }
    let mut largest = [f32::MIN_POSITIVE; IMAGE_CHANNELS];
    for pair in sums.chunks_exact(IMAGE_CHANNELS) {
        for (largest, x) in largest.iter_mut().zip(pair) {
            *largest = largest.max(*x);
        }
    }
    let mut bytes = vec![0; IMAGE];
    let pairs = sums.chunks_exact(IMAGE_CHANNELS);
    for (bytes, pair) in bytes.chunks_exact_mut(IMAGE_CHANNELS).zip(pairs) {
        for (byte, (x, largest)) in bytes.iter_mut().zip(pair.iter().zip(largest)) {
            *byte = (255.0 * x / largest).round() as u8;
        }
    }
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn negative_and_positive_parts_are_summed_over_blocks_and_scaled_apart() {
        let mut phi = vec![0.0; FRAME];
        // The block of row 1, column 2: rows 2 and 3, columns 4 and 5 of the frame.
        let at = |row: usize, col: usize| row * COLS + col;
        phi[at(2, 4)] = 3.0;
        phi[at(3, 5)] = 1.0;
        phi[at(3, 4)] = -0.5;
        phi[at(0, 0)] = 2.0;
        let bytes = image(&phi).unwrap();
        let value = |row: usize, col: usize, channel: usize| bytes[(row * IMAGE_COLS + col) * IMAGE_CHANNELS + channel];
        assert_eq!(
            (value(1, 2, 0), value(1, 2, 1)),
            (255, 255),
            "each channel's largest value"
        );
        assert_eq!(value(0, 0, 1), 128, "half of it");
        assert_eq!(bytes.iter().filter(|b| **b != 0).count(), 3);
    }

    #[test]
    fn what_is_not_an_explanation_gives_no_image() {
        assert!(image(&[0.0; 7]).is_none());
        let mut phi = vec![0.0; FRAME];
        phi[9] = f32::NAN;
        assert!(image(&phi).is_none());
        phi[9] = 0.0;
        assert!(
            image(&phi).unwrap().iter().all(|b| *b == 0),
            "nothing explained, nothing shown"
        );
    }
}
