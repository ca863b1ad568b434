//! What is drawn on, twice: a raster, on which shapes are several times too large, for smooth edges, and text has its own size;
//! and the same shapes and text as SVG.

use core::convert::Infallible;
use core::ops::Range;
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use std::path::Path;
use vigil_types::files;

/// Shapes are drawn this much larger in both directions and averaged.
const OVERSAMPLING: usize = 3;

/// An RGB picture, 8 bits a channel.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    width: usize,
    height: usize,
    rgb: Vec<u8>,
}

/// Why a picture could not be written: the file and what to do.
#[derive(Debug, thiserror::Error)]
#[error("cannot write picture {0}")]
pub struct ImageError(String);

/// Refuses a picture's file whose name promises another format than PNG, before the work is done.
///
/// # Errors
/// [`ImageError`].
pub fn check_png_name(path: &Path) -> Result<(), ImageError> {
    match path.extension() {
        Some(extension) if !extension.eq_ignore_ascii_case("png") => {
            let (file, better) = (path.display(), path.with_extension("png"));
            let better = better.display();
            Err(ImageError(format!("{file}: pictures are PNG files; name it {better}")))
        }
        _ => Ok(()),
    }
}

impl Image {
    pub(crate) fn new(width: usize, height: usize, background: Rgb888) -> Self {
        let pixel = [background.r(), background.g(), background.b()];
        Self::from_fn(width, height, |_, _| pixel)
    }

    /// A picture whose pixel in column `x`, row `y` is `colour(x, y)`: red, green, blue.
    pub fn from_fn(width: usize, height: usize, colour: impl Fn(usize, usize) -> [u8; 3]) -> Self {
        let rgb = (0..height)
            .flat_map(|y| (0..width).map(move |x| (x, y)))
            .flat_map(|(x, y)| colour(x, y))
            .collect();
        Self { width, height, rgb }
    }

    /// Width in pixels.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height in pixels.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Red, green and blue of each pixel, row by row from the top left.
    pub fn rgb(&self) -> &[u8] {
        &self.rgb
    }

    /// Writes the picture as a PNG file.
    ///
    /// # Errors
    /// [`ImageError`] names the file and what the system said.
    pub fn write_png(&self, path: &Path) -> Result<(), ImageError> {
        check_png_name(path)?;
        let write = || Ok(files::replace(path, &self.to_png()?, files::Access::Shared)?);
        write().map_err(|e: png::EncodingError| ImageError(format!("{}: {e}", path.display())))
    }

    /// The picture as PNG.
    ///
    /// # Errors
    /// What cannot be encoded: a picture without pixels.
    pub fn to_png(&self) -> Result<Vec<u8>, png::EncodingError> {
        let mut bytes = Vec::new();
        // The sizes are a few thousand pixels at most.
        let mut encoder = png::Encoder::new(&mut bytes, self.width as u32, self.height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.rgb)?;
        writer.finish()?;
        Ok(bytes)
    }
}

/// A picture in the making and the layer that shapes go to first.
pub(crate) struct Canvas {
    pub(crate) image: Image,
    layer: Layer,
    /// The elements of an SVG file so far.
    pub(crate) svg: String,
}

impl Canvas {
    pub(crate) fn new(width: usize, height: usize, background: Rgb888) -> Self {
        let (layer_width, layer_height) = (width * OVERSAMPLING, height * OVERSAMPLING);
        Self {
            image: Image::new(width, height, background),
            layer: Layer {
                width: layer_width,
                height: layer_height,
                pixels: vec![None; layer_width * layer_height],
                touched: [NOTHING; 2],
                svg: String::new(),
            },
            svg: format!(
                "<rect width=\"{width}\" height=\"{height}\" fill=\"{}\"/>\n",
                hex(background)
            ),
        }
    }

    /// An SVG file's content.
    pub(crate) fn to_svg(&self) -> String {
        let (width, height) = (self.image.width, self.image.height);
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\">\n{}</svg>\n",
            self.svg
        )
    }

    /// Lays what `shapes` draws over the picture at an opacity of 0 to 1. Shapes of one layer do not shine through each other.
    pub(crate) fn layer(&mut self, opacity: f32, shapes: impl FnOnce(&mut Layer)) {
        shapes(&mut self.layer);
        let elements = core::mem::take(&mut self.layer.svg);
        if !elements.is_empty() {
            self.svg += &format!("<g opacity=\"{opacity}\">\n{elements}</g>\n");
        }
        let touched = core::mem::replace(&mut self.layer.touched, [NOTHING; 2]);
        let [columns, rows] = touched.map(|part| part.start / OVERSAMPLING..part.end.div_ceil(OVERSAMPLING));
        for y in rows {
            for x in columns.clone() {
                self.average(x, y, opacity);
            }
        }
    }

    /// Blends one pixel of the layer into the picture and clears it.
    fn average(&mut self, x: usize, y: usize, opacity: f32) {
        let mut sum = [0u32; 3];
        let mut count = 0u32;
        for dy in 0..OVERSAMPLING {
            let start = (y * OVERSAMPLING + dy) * self.layer.width + x * OVERSAMPLING;
            for sample in &mut self.layer.pixels[start..start + OVERSAMPLING] {
                if let Some(c) = sample.take() {
                    count += 1;
                    for (total, channel) in sum.iter_mut().zip([c.r(), c.g(), c.b()]) {
                        *total += u32::from(channel);
                    }
                }
            }
        }
        if count == 0 {
            return;
        }
        let share = opacity * count as f32 / (OVERSAMPLING * OVERSAMPLING) as f32;
        let pixel = &mut self.image.rgb[3 * (y * self.image.width + x)..][..3];
        for (old, total) in pixel.iter_mut().zip(sum) {
            let new = total as f32 / count as f32;
            *old = (f32::from(*old) + share * (new - f32::from(*old))).round() as u8;
        }
    }
}

/// No column or row.
const NOTHING: Range<usize> = Range {
    start: usize::MAX,
    end: 0,
};

/// The column and row of a pixel, where it is on a raster of this size.
fn within(at: Point, width: usize, height: usize) -> Option<[usize; 2]> {
    let (x, y) = (usize::try_from(at.x).ok()?, usize::try_from(at.y).ok()?);
    (x < width && y < height).then_some([x, y])
}

/// Text and everything that needs no smoothing is drawn right onto the picture.
impl DrawTarget for Image {
    type Color = Rgb888;
    type Error = Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Rgb888>>>(&mut self, pixels: I) -> Result<(), Infallible> {
        for Pixel(at, colour) in pixels {
            if let Some([x, y]) = within(at, self.width, self.height) {
                self.rgb[3 * (y * self.width + x)..][..3].copy_from_slice(&[colour.r(), colour.g(), colour.b()]);
            }
        }
        Ok(())
    }
}

impl OriginDimensions for Image {
    fn size(&self) -> Size {
        Size::new(self.width as u32, self.height as u32)
    }
}

/// One layer of shapes, oversampled. Coordinates are those of the picture, as fractions of pixels.
pub(crate) struct Layer {
    width: usize,
    height: usize,
    pixels: Vec<Option<Rgb888>>,
    /// The columns and rows that were drawn on.
    touched: [Range<usize>; 2],
    /// The same shapes as SVG elements.
    pub(crate) svg: String,
}

/// A colour as SVG has it.
pub(crate) fn hex(colour: Rgb888) -> String {
    format!("#{:02X}{:02X}{:02X}", colour.r(), colour.g(), colour.b())
}

impl Layer {
    /// A length on this layer in pixels of the picture.
    pub(crate) fn pixels(&self, length: u32) -> f32 {
        length as f32 / OVERSAMPLING as f32
    }

    /// A point of the picture on this layer.
    pub(crate) fn point(&self, [x, y]: [f32; 2]) -> Point {
        let scale = OVERSAMPLING as f32;
        Point::new((x * scale).round() as i32, (y * scale).round() as i32)
    }

    /// A length of the picture on this layer, at least one pixel.
    pub(crate) fn length(&self, pixels: f32) -> u32 {
        (pixels * OVERSAMPLING as f32).round().max(1.0) as u32
    }
}

impl DrawTarget for Layer {
    type Color = Rgb888;
    type Error = Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Rgb888>>>(&mut self, pixels: I) -> Result<(), Infallible> {
        for Pixel(at, colour) in pixels {
            if let Some([x, y]) = within(at, self.width, self.height) {
                self.pixels[y * self.width + x] = Some(colour);
                for (part, at) in self.touched.iter_mut().zip([x, y]) {
                    *part = part.start.min(at)..part.end.max(at + 1);
                }
            }
        }
        Ok(())
    }
}

impl OriginDimensions for Layer {
    fn size(&self) -> Size {
        Size::new(self.width as u32, self.height as u32)
    }
}
