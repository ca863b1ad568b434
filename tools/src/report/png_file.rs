//! Pictures as PNG files.

/// A file's content, 8 bits a channel, compressed well; `set` states colours and whatever else is to be stated.
///
/// # Panics
/// Pixels of another size.
pub fn png_bytes(
    size: (u32, u32),
    pixels: &[u8],
    set: impl for<'a> FnOnce(&mut png::Encoder<'a, &'a mut Vec<u8>>),
) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, size.0, size.1);
    encoder.set_compression(png::Compression::High);
    set(&mut encoder);
    let written = encoder
        .write_header()
        .and_then(|mut writer| writer.write_image_data(pixels));
    // Writing to memory fails only for a picture of the wrong size.
    written.unwrap_or_else(|e| unreachable!("{e}"));
    bytes
}
