//! What all figures share: PNG at 300 dots per inch and SVG of one drawing, letters, colours, ticks.

use anyhow::Result;
use base64::Engine as _;
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::FontStyle;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Once;
use vigil_tools::cli::output;
use vigil_tools::report::png_bytes;

/// Roboto (Apache-2.0), cut down to Latin, Greek and mathematical signs: the same letters on every machine.
const FONT: &[u8] = include_bytes!("../../../assets/Roboto-Regular.ttf");
/// Width of a figure at 100 dots per inch, dots.
pub(super) const WIDTH: u32 = 700;
/// PNG dots per SVG dot.
const PNG_SCALE: u32 = 3;
/// Dots per metre of the PNG: 300 per inch.
const DOTS_PER_M: u32 = 11_811;
pub(super) const INK: RGBColor = RGBColor(40, 42, 48);
pub(super) const GRID: RGBColor = RGBColor(226, 226, 222);
const BACKGROUND: RGBColor = RGBColor(255, 255, 255);
/// Distinguishable with every kind of colour vision (Okabe and Ito, 2008).
pub(super) const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(110, 110, 110),
];

/// What is drawn on.
pub(super) type Area<DB> = DrawingArea<DB, Shift>;
/// What a drawing surface says when it fails.
pub(super) type Fault<DB> = DrawingAreaErrorKind<<DB as DrawingBackend>::ErrorType>;

/// Pixels within a figure.
#[derive(Debug, Clone, PartialEq)]
pub struct Raster {
    /// Left, top, width and height in the figure, in its dots.
    pub place: [u32; 4],
    /// Columns and rows.
    pub size: (u32, u32),
    /// Red, green, blue of each, row by row from the top left.
    pub rgb: Vec<u8>,
}

/// A figure: drawn once, written in two formats.
pub trait Picture {
    /// Width and height at 100 dots per inch.
    fn size(&self) -> (u32, u32);

    /// Draws all but the rasters, `scale` times as large.
    fn draw<DB: DrawingBackend>(&self, area: &Area<DB>, scale: u32) -> Result<(), Fault<DB>>;

    /// Writes NAME.png and NAME.svg into a folder; their paths.
    fn save(&self, folder: &Path, name: &str) -> Result<[PathBuf; 2]> {
        let [png, svg] = ["png", "svg"].map(|ending| folder.join(format!("{name}.{ending}")));
        output::write(&png, self.png())?;
        output::write(&svg, self.svg())?;
        Ok([png, svg])
    }

    /// Pixels that lie over the drawing.
    fn rasters(&self) -> Vec<Raster> {
        Vec::new()
    }

    /// A PNG file's content, 300 dots per inch.
    fn png(&self) -> Vec<u8> {
        register_font();
        let (width, height) = self.size();
        let (width, height) = (width * PNG_SCALE, height * PNG_SCALE);
        let mut rgb = vec![255; (3 * width * height) as usize];
        drawn(self, BitMapBackend::with_buffer(&mut rgb, (width, height)), PNG_SCALE);
        for raster in self.rasters() {
            let [left, top, across, down] = raster.place.map(|dots| (dots * PNG_SCALE) as usize);
            for y in 0..down {
                for x in 0..across {
                    let column = x * raster.size.0 as usize / across;
                    let row = y * raster.size.1 as usize / down;
                    let from = 3 * (row * raster.size.0 as usize + column);
                    let to = 3 * ((top + y) * width as usize + left + x);
                    if let (Some(to), Some(from)) = (rgb.get_mut(to..to + 3), raster.rgb.get(from..from + 3)) {
                        to.copy_from_slice(from);
                    }
                }
            }
        }
        png_bytes((width, height), &rgb, |encoder| {
            encoder.set_color(png::ColorType::Rgb);
            encoder.set_pixel_dims(Some(png::PixelDimensions {
                xppu: DOTS_PER_M,
                yppu: DOTS_PER_M,
                unit: png::Unit::Meter,
            }));
        })
    }

    /// An SVG file's content.
    fn svg(&self) -> String {
        register_font();
        let mut text = String::new();
        drawn(self, SVGBackend::with_string(&mut text, self.size()), 1);
        let mut images = String::new();
        for raster in self.rasters() {
            let [x, y, width, height] = raster.place;
            let png = raster_png(&raster);
            let data = base64::engine::general_purpose::STANDARD.encode(png);
            images += &format!(
                "<image x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" preserveAspectRatio=\"none\" style=\"image-rendering:pixelated\" href=\"data:image/png;base64,{data}\"/>\n"
            );
        }
        let end = text.rfind("</svg>").unwrap_or(text.len());
        text.insert_str(end, &images);
        text
    }
}

fn drawn<P: Picture + ?Sized, DB: DrawingBackend>(picture: &P, surface: DB, scale: u32) {
    let area = surface.into_drawing_area();
    let all = || {
        area.fill(&BACKGROUND)?;
        picture.draw(&area, scale)?;
        area.present()
    };
    // Memory takes every drawing.
    all().unwrap_or_else(|e: Fault<DB>| unreachable!("{e}"));
}

/// A raster as a PNG: with a palette, often half as large, or without.
fn raster_png(raster: &Raster) -> Vec<u8> {
    let colours: BTreeSet<&[u8]> = raster.rgb.chunks_exact(3).collect();
    let colours: Vec<&[u8]> = colours.into_iter().collect();
    let plain = png_bytes(raster.size, &raster.rgb, |encoder| {
        encoder.set_color(png::ColorType::Rgb)
    });
    if colours.len() > 256 {
        return plain;
    }
    let index = |pixel| colours.binary_search(&pixel).unwrap_or_default() as u8;
    let pixels: Vec<u8> = raster.rgb.chunks_exact(3).map(index).collect();
    let indexed = png_bytes(raster.size, &pixels, |encoder| {
        encoder.set_color(png::ColorType::Indexed);
        encoder.set_palette(colours.concat());
        // Indices compress best as they are (PNG specification, 12.7).
        encoder.set_filter(png::Filter::NoFilter);
    });
    if indexed.len() < plain.len() { indexed } else { plain }
}

/// Round numbers from `low` to `high`, at most `most` of them: multiples of 1, 2 or 5 times a power of ten.
pub(super) fn ticks(low: f64, high: f64, most: usize) -> Vec<f64> {
    let range = (high - low).max(1e-9);
    let rough = range / most.max(2) as f64;
    let power = 10f64.powf(rough.log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0].map(|n| n * power);
    let is_enough = |step: &f64| *step >= rough * (1.0 - 1e-9);
    let step = steps.into_iter().find(is_enough).unwrap_or(10.0 * power);
    let (first, last) = ((low / step - 1e-9).ceil() as i64, (high / step + 1e-9).floor() as i64);
    (first..=last).map(|n| n as f64 * step).collect()
}

/// A tick's number with as many places as ticks this far apart need.
pub(super) fn tick(value: f64, range: f64) -> String {
    let places = (1.0 - (range.abs().max(1e-9) / 2.0).log10().floor()).clamp(0.0, 6.0) as usize;
    let text = format!("{value:.places$}");
    let text = if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.')
    } else {
        &text
    };
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

/// The style of a text of so many dots.
pub(super) fn text(scale: u32, size: u32, h: HPos, v: VPos) -> TextStyle<'static> {
    let style = TextStyle::from(("sans-serif", size * scale));
    style.color(&INK).pos(Pos::new(h, v))
}

/// A dashed straight line, dots.
pub(super) fn draw_dashed<DB: DrawingBackend>(
    area: &Area<DB>,
    [(x0, y0), (x1, y1)]: [(i32, i32); 2],
    (dash, gap): (u32, u32),
    style: ShapeStyle,
) -> Result<(), Fault<DB>> {
    let (dx, dy) = (f64::from(x1 - x0), f64::from(y1 - y0));
    let length = dx.hypot(dy);
    let at = |far: f64| {
        let share = (far / length).min(1.0);
        (x0 + (share * dx).round() as i32, y0 + (share * dy).round() as i32)
    };
    let mut far = 0.0;
    while far < length {
        area.draw(&PathElement::new(vec![at(far), at(far + f64::from(dash))], style))?;
        far += f64::from(dash + gap);
    }
    Ok(())
}

fn register_font() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        // Fails for bytes that are no font only; a test draws with it.
        let _ = plotters::style::register_font("sans-serif", FontStyle::Normal, FONT);
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::{Figure, Panel};

    #[test]
    fn a_chart_of_nothing_is_still_a_chart_and_its_png_has_letters_on_it() {
        let empty = Figure::over("updates", 0.0, vec![Panel::new("nothing yet", "reward", [])]);
        assert!(empty.svg().contains("nothing yet"));
        let bytes = empty.png();
        let mut reader = png::Decoder::new(std::io::Cursor::new(&bytes)).read_info().unwrap();
        let mut rgb = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut rgb).unwrap();
        assert_eq!(info.width, WIDTH * PNG_SCALE);
        // The axis' name stands in the bottom strip, where nothing else is drawn.
        let strip = &rgb[rgb.len() - 3 * info.width as usize * 11 * PNG_SCALE as usize..];
        assert!(strip.iter().any(|c| *c < 100), "no letter in the bottom strip");
    }

    #[test]
    fn ticks_are_round_and_written_with_the_places_that_they_need() {
        assert_eq!(ticks(0.0, 20.0, 9), [0.0, 5.0, 10.0, 15.0, 20.0]);
        assert_eq!(ticks(0.0, 246.0, 9), [0.0, 50.0, 100.0, 150.0, 200.0]);
        assert_eq!(ticks(0.0, 0.05, 9).len(), 6);
        assert_eq!(tick(0.30000000000000004, 1.0), "0.3");
        assert_eq!(tick(2500.0, 10_000.0), "2500");
        assert_eq!(tick(-0.0, 1.0), "0");
        assert_eq!(tick(0.025, 0.1), "0.025");
    }
}
