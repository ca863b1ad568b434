//! Line charts: panels one below the other over a common axis, as PNG at 300 dots per inch and as SVG.

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::FontStyle;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::sync::Once;

/// Roboto (Apache-2.0), cut down to Latin, Greek and mathematical signs: the same letters on every machine.
const FONT: &[u8] = include_bytes!("../../assets/Roboto-Regular.ttf");
/// Size of a chart at 100 dots per inch, dots.
const WIDTH: u32 = 700;
const PANEL_HEIGHT: u32 = 190;
const AXIS_HEIGHT: u32 = 22;
/// Room for the upright axis.
const LEFT: u32 = 62;
/// Room for title and legend.
const HEAD: u32 = 26;
/// PNG dots per SVG dot.
const PNG_SCALE: u32 = 3;
/// Dots per metre of the PNG: 300 per inch.
const DOTS_PER_M: u32 = 11_811;
const INK: RGBColor = RGBColor(40, 42, 48);
const GRID: RGBColor = RGBColor(226, 226, 222);
const BACKGROUND: RGBColor = RGBColor(255, 255, 255);
/// Distinguishable with every kind of colour vision (Okabe and Ito, 2008).
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(110, 110, 110),
];

/// A line of a chart. Points that are not finite interrupt it.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Its name in the legend.
    pub label: String,
    /// Its points.
    pub points: Vec<(f64, f64)>,
    /// An interval around it: abscissa, lower, upper. Empty without one.
    pub band: Vec<(f64, f64, f64)>,
}

impl Series {
    /// A line without an interval.
    pub fn line(label: impl Into<String>, points: Vec<(f64, f64)>) -> Self {
        Self {
            label: label.into(),
            points,
            band: Vec::new(),
        }
    }
}

/// A chart of its own: lines over the figure's common axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Panel {
    /// What it shows.
    pub title: String,
    /// What the upright axis counts, with its unit in brackets.
    pub y_label: String,
    /// The lines.
    pub series: Vec<Series>,
    /// Named levels, drawn dashed.
    pub thresholds: Vec<(String, f64)>,
}

impl Panel {
    /// From names and points.
    pub fn new<'a>(title: &str, y_label: &str, series: impl IntoIterator<Item = (&'a str, Vec<(f64, f64)>)>) -> Self {
        Self {
            title: title.to_owned(),
            y_label: y_label.to_owned(),
            series: series
                .into_iter()
                .map(|(label, points)| Series::line(label, points))
                .collect(),
            thresholds: Vec::new(),
        }
    }

    /// Lowest and highest value shown, with a little room.
    fn values(&self) -> (f64, f64) {
        let lines = self.series.iter().flat_map(|s| s.points.iter().map(|(_, y)| *y));
        let bands = self
            .series
            .iter()
            .flat_map(|s| s.band.iter().flat_map(|(_, a, b)| [*a, *b]));
        let levels = self.thresholds.iter().map(|(_, y)| *y);
        let all = lines.chain(bands).chain(levels).filter(|y| y.is_finite());
        let (low, high) = all.fold((0.0_f64, f64::NEG_INFINITY), |(low, high), y| (low.min(y), high.max(y)));
        let high = if high > low { high } else { low + 1.0 };
        let room = 0.05 * (high - low);
        (if low < 0.0 { low - room } else { low }, high + room)
    }
}

/// Panels over a common axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    /// What the common axis counts, with its unit in brackets.
    pub x_label: String,
    /// The common axis goes from 0 to here.
    pub x_last: f64,
    /// From top to bottom.
    pub panels: Vec<Panel>,
}

impl Figure {
    /// The figure's height at 100 dots per inch.
    fn height(&self) -> u32 {
        self.panels.len().max(1) as u32 * PANEL_HEIGHT + AXIS_HEIGHT
    }

    /// A PNG file's content, 300 dots per inch.
    ///
    /// # Panics
    /// Never: drawing in memory does not fail.
    pub fn png(&self) -> Vec<u8> {
        register_font();
        let (width, height) = (WIDTH * PNG_SCALE, self.height() * PNG_SCALE);
        let mut rgb = vec![255; (3 * width * height) as usize];
        {
            let area = BitMapBackend::with_buffer(&mut rgb, (width, height)).into_drawing_area();
            self.draw(&area, PNG_SCALE).unwrap_or_else(|e| unreachable!("{e}"));
        }
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, width, height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_compression(png::Compression::High);
        encoder.set_pixel_dims(Some(png::PixelDimensions {
            xppu: DOTS_PER_M,
            yppu: DOTS_PER_M,
            unit: png::Unit::Meter,
        }));
        let written = encoder
            .write_header()
            .and_then(|mut writer| writer.write_image_data(&rgb));
        // Writing to memory fails only for a picture of the wrong size.
        written.unwrap_or_else(|e| unreachable!("{e}"));
        bytes
    }

    /// An SVG file's content.
    ///
    /// # Panics
    /// Never: drawing in memory does not fail.
    pub fn svg(&self) -> String {
        register_font();
        let mut text = String::new();
        {
            let area = SVGBackend::with_string(&mut text, (WIDTH, self.height())).into_drawing_area();
            self.draw(&area, 1).unwrap_or_else(|e| unreachable!("{e}"));
        }
        text
    }

    fn draw<DB: DrawingBackend>(
        &self,
        area: &DrawingArea<DB, Shift>,
        scale: u32,
    ) -> Result<(), DrawingAreaErrorKind<DB::ErrorType>> {
        area.fill(&BACKGROUND)?;
        let last = if self.x_last > 0.0 { self.x_last } else { 1.0 };
        let (panels, _) = area.split_vertically((self.height() - AXIS_HEIGHT) * scale);
        for (panel, part) in self
            .panels
            .iter()
            .zip(panels.split_evenly((self.panels.len().max(1), 1)))
        {
            draw_panel(&part, panel, last, scale)?;
        }
        let centre = Pos::new(HPos::Center, VPos::Bottom);
        let style = TextStyle::from(("sans-serif", 12 * scale)).color(&INK).pos(centre);
        area.draw_text(
            &self.x_label,
            &style,
            (
                ((WIDTH + LEFT) / 2 * scale) as i32,
                ((self.height() - 5) * scale) as i32,
            ),
        )?;
        area.present()
    }
}

fn draw_panel<DB: DrawingBackend>(
    area: &DrawingArea<DB, Shift>,
    panel: &Panel,
    last: f64,
    scale: u32,
) -> Result<(), DrawingAreaErrorKind<DB::ErrorType>> {
    let (low, high) = panel.values();
    let mut chart = ChartBuilder::on(area)
        .margin(6 * scale)
        .margin_top(HEAD * scale)
        .margin_right(16 * scale)
        .y_label_area_size((LEFT - 6) * scale)
        .x_label_area_size(18 * scale)
        .build_cartesian_2d(0.0..last, low..high)?;
    chart
        .configure_mesh()
        .axis_style(INK.stroke_width(scale))
        .bold_line_style(GRID.stroke_width(scale))
        .light_line_style(TRANSPARENT)
        .x_labels(9)
        .y_labels(6)
        .x_label_formatter(&|x| tick(*x, last))
        .y_label_formatter(&|y| tick(*y, high - low))
        .label_style(("sans-serif", 11 * scale).into_font().color(&INK))
        .y_desc(&panel.y_label)
        .axis_desc_style(("sans-serif", 12 * scale).into_font().color(&INK))
        .draw()?;
    for (series, colour) in panel.series.iter().zip(COLOURS.iter().cycle()) {
        let upper = series.band.iter().map(|(x, _, y)| (*x, *y));
        let lower = series.band.iter().rev().map(|(x, y, _)| (*x, *y));
        if !series.band.is_empty() {
            chart.draw_series([Polygon::new(upper.chain(lower).collect::<Vec<_>>(), colour.mix(0.2))])?;
        }
    }
    for (series, colour) in panel.series.iter().zip(COLOURS.iter().cycle()) {
        let style = colour.stroke_width(3 * scale / 2);
        let whole = series.points.split(|(x, y)| !(x.is_finite() && y.is_finite()));
        for piece in whole.filter(|piece| !piece.is_empty()) {
            chart.draw_series([PathElement::new(piece.to_vec(), style)])?;
        }
    }
    for (_, level) in &panel.thresholds {
        let ends = [(0.0, *level), (last, *level)];
        chart.draw_series(DashedLineSeries::new(
            ends,
            6 * scale,
            4 * scale,
            INK.stroke_width(scale),
        ))?;
    }
    draw_head(area, panel, scale)
}

/// Title on the left, names of the lines on the right, above the chart and not on it.
fn draw_head<DB: DrawingBackend>(
    area: &DrawingArea<DB, Shift>,
    panel: &Panel,
    scale: u32,
) -> Result<(), DrawingAreaErrorKind<DB::ErrorType>> {
    let middle = (HEAD / 2 * scale) as i32;
    let (left, mark, gap) = ((LEFT * scale) as i32, (16 * scale) as i32, (5 * scale) as i32);
    let anchor = |h| Pos::new(h, VPos::Center);
    let title = TextStyle::from(("sans-serif", 14 * scale))
        .color(&INK)
        .pos(anchor(HPos::Left));
    area.draw_text(&panel.title, &title, (left, middle))?;
    let lines = panel.series.iter().map(|s| &s.label).zip(COLOURS.iter().cycle());
    let levels = panel.thresholds.iter().map(|(label, _)| (label, &INK));
    let names: Vec<_> = lines.chain(levels).collect();
    if names.len() < 2 {
        return Ok(());
    }
    let style = TextStyle::from(("sans-serif", 11 * scale))
        .color(&INK)
        .pos(anchor(HPos::Right));
    let mut right = ((WIDTH - 16) * scale) as i32;
    for (label, colour) in names.into_iter().rev() {
        area.draw_text(label, &style, (right, middle))?;
        right -= area.estimate_text_size(label, &style)?.0 as i32 + gap;
        let ends = vec![(right - mark, middle), (right, middle)];
        area.draw(&PathElement::new(ends, colour.stroke_width(2 * scale)))?;
        right -= mark + 2 * gap;
    }
    Ok(())
}

/// A tick's number with as many places as ticks this far apart need.
fn tick(value: f64, range: f64) -> String {
    let places = (1.0 - (range.abs().max(1e-9) / 2.0).log10().floor()).clamp(0.0, 6.0) as usize;
    let text = format!("{value:.places$}");
    let text = if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.')
    } else {
        &text
    };
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
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

    fn figure() -> Figure {
        let wave = |phase: f64| {
            (0..200)
                .map(|i| (f64::from(i) * 0.1, (f64::from(i) * 0.1 + phase).sin()))
                .collect()
        };
        let mut panel = Panel::new("Two waves", "score", [("sine", wave(0.0)), ("cosine", wave(1.57))]);
        panel.thresholds.push(("threshold 0.8".to_owned(), 0.8));
        panel.series[0].points[100].1 = f64::NAN;
        Figure {
            x_label: "time (s)".to_owned(),
            x_last: 20.0,
            panels: vec![panel],
        }
    }

    #[test]
    fn a_chart_names_its_axes_lines_and_levels() {
        let svg = figure().svg();
        for text in [
            "Two waves",
            "score",
            "time (s)",
            "sine",
            "cosine",
            "threshold 0.8",
            ">\n10\n<",
            ">\n0.5\n<",
        ] {
            assert!(svg.contains(text), "{text} is not in the chart");
        }
    }

    #[test]
    fn a_png_has_letters_on_it() {
        let bytes = figure().png();
        let mut reader = png::Decoder::new(std::io::Cursor::new(&bytes)).read_info().unwrap();
        let mut rgb = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut rgb).unwrap();
        assert_eq!(info.width, WIDTH * PNG_SCALE);
        // The axis' name stands in the bottom strip, where nothing else is drawn.
        let row = 3 * info.width as usize;
        let strip = &rgb[rgb.len() - row * (AXIS_HEIGHT * PNG_SCALE / 2) as usize..];
        assert!(strip.iter().any(|c| *c < 100), "no letter in the bottom strip");
    }

    #[test]
    fn ticks_are_written_with_the_places_that_they_need() {
        assert_eq!(tick(0.30000000000000004, 1.0), "0.3");
        assert_eq!(tick(2500.0, 10_000.0), "2500");
        assert_eq!(tick(-0.0, 1.0), "0");
        assert_eq!(tick(0.025, 0.1), "0.025");
    }

    #[test]
    fn a_chart_of_nothing_is_still_a_chart() {
        let empty = Figure {
            x_label: "updates".to_owned(),
            x_last: 0.0,
            panels: vec![Panel::new("nothing yet", "reward", [])],
        };
        assert!(empty.svg().contains("nothing yet"));
    }
}
