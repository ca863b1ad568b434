//! Line charts as pictures: panels one below the other over a common axis.

use embedded_graphics::mono_font::MonoTextStyle;
use embedded_graphics::mono_font::ascii::{FONT_6X10, FONT_9X15};
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::primitives::{Line, PrimitiveStyle, Rectangle};
use embedded_graphics::text::{Alignment, Text};

const WIDTH: u32 = 1000;
const PANEL_HEIGHT: i32 = 210;
const LEFT: i32 = 80;
const RIGHT: i32 = 20;
const TOP: i32 = 34;
const BOTTOM: i32 = 26;
const BACKGROUND: Rgb888 = Rgb888::new(252, 252, 250);
const GRID: Rgb888 = Rgb888::new(224, 224, 220);
const INK: Rgb888 = Rgb888::new(50, 52, 58);
const COLOURS: [Rgb888; 6] = [
    Rgb888::new(24, 104, 190),
    Rgb888::new(206, 96, 20),
    Rgb888::new(34, 139, 84),
    Rgb888::new(150, 60, 160),
    Rgb888::new(120, 120, 120),
    Rgb888::new(180, 30, 40),
];

/// An image that can be drawn on.
struct Canvas {
    height: u32,
    rgb: Vec<u8>,
}

impl OriginDimensions for Canvas {
    fn size(&self) -> Size {
        Size::new(WIDTH, self.height)
    }
}

impl DrawTarget for Canvas {
    type Color = Rgb888;
    type Error = core::convert::Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Rgb888>>>(&mut self, pixels: I) -> Result<(), Self::Error> {
        for Pixel(at, c) in pixels {
            if let (Ok(x), Ok(y)) = (usize::try_from(at.x), usize::try_from(at.y))
                && x < WIDTH as usize
                && let Some(rgb) = self
                    .rgb
                    .get_mut(3 * (y * WIDTH as usize + x)..)
                    .and_then(|p| p.first_chunk_mut())
            {
                *rgb = [c.r(), c.g(), c.b()];
            }
        }
        Ok(())
    }
}

/// A chart of its own: a title and lines over the common axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Panel {
    /// What it shows.
    pub title: String,
    /// Label and points of each line. What is not finite is left out.
    pub series: Vec<(String, Vec<(f64, f64)>)>,
}

impl Panel {
    /// From labels and points.
    pub fn new<'a>(title: &str, series: impl IntoIterator<Item = (&'a str, Vec<(f64, f64)>)>) -> Self {
        Self {
            title: title.to_owned(),
            series: series
                .into_iter()
                .map(|(label, points)| (label.to_owned(), points))
                .collect(),
        }
    }
}

/// The picture as a PNG file's content; the common axis goes from 0 to `last`.
pub fn chart_png(panels: &[Panel], last: f64) -> Vec<u8> {
    let height = panels.len() as u32 * PANEL_HEIGHT as u32;
    let mut canvas = Canvas {
        height,
        rgb: vec![0; (3 * WIDTH * height) as usize],
    };
    // Drawing on this canvas cannot fail.
    let Ok(()) = canvas.clear(BACKGROUND);
    for (i, chart) in panels.iter().enumerate() {
        let Ok(()) = panel(&mut canvas, i as i32 * PANEL_HEIGHT, chart, last.max(1e-9));
    }
    encode(&canvas)
}

fn panel(canvas: &mut Canvas, top: i32, chart: &Panel, last: f64) -> Result<(), core::convert::Infallible> {
    let Panel { title, series } = chart;
    let small = MonoTextStyle::new(&FONT_6X10, INK);
    let (x0, x1) = (LEFT, WIDTH as i32 - RIGHT);
    let (y0, y1) = (top + PANEL_HEIGHT - BOTTOM, top + TOP);
    let values = || {
        series
            .iter()
            .flat_map(|(_, points)| points)
            .map(|(_, y)| *y)
            .filter(|y| y.is_finite())
    };
    let low = values().fold(0.0, f64::min);
    let high = values().fold(low + 1e-3, f64::max);
    let at = |x: f64, y: f64| {
        let x = f64::from(x0) + x / last * f64::from(x1 - x0);
        let y = f64::from(y0) + (y - low) / (high - low) * f64::from(y1 - y0);
        Point::new(x as i32, y as i32)
    };
    Text::new(title, Point::new(x0, top + 18), MonoTextStyle::new(&FONT_9X15, INK)).draw(canvas)?;
    for k in 0..=4 {
        let share = f64::from(k) / 4.0;
        let (value, updates) = (low + share * (high - low), share * last);
        let (across, up) = (at(0.0, value), at(updates, low));
        let grid = PrimitiveStyle::with_stroke(GRID, 1);
        Line::new(across, Point::new(x1, across.y))
            .into_styled(grid)
            .draw(canvas)?;
        Line::new(up, Point::new(up.x, y1)).into_styled(grid).draw(canvas)?;
        let label = format!("{value:.3}");
        Text::with_alignment(&label, Point::new(x0 - 6, across.y + 3), small, Alignment::Right).draw(canvas)?;
        let label = format!("{updates:.*}", if last <= 10.0 { 2 } else { 0 });
        Text::with_alignment(&label, Point::new(up.x, y0 + 14), small, Alignment::Center).draw(canvas)?;
    }
    let mut legend_x = x1;
    for ((label, points), colour) in series.iter().zip(COLOURS.iter().cycle()) {
        let style = PrimitiveStyle::with_stroke(*colour, 2);
        for pair in points.windows(2) {
            let ends = [pair[0], pair[1]];
            if ends.iter().all(|(_, y)| y.is_finite()) {
                let [a, b] = ends.map(|(x, y)| at(x, y));
                Line::new(a, b).into_styled(style).draw(canvas)?;
            }
        }
        let style = MonoTextStyle::new(&FONT_6X10, *colour);
        Text::with_alignment(label, Point::new(legend_x, top + 16), style, Alignment::Right).draw(canvas)?;
        legend_x -= 6 * label.len() as i32 + 16;
    }
    let corner = Point::new(x0, y1);
    let size = Size::new((x1 - x0) as u32, (y0 - y1) as u32);
    Rectangle::new(corner, size)
        .into_styled(PrimitiveStyle::with_stroke(INK, 1))
        .draw(canvas)
}

fn encode(canvas: &Canvas) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, WIDTH, canvas.height);
    encoder.set_color(png::ColorType::Rgb);
    let written = encoder
        .write_header()
        .and_then(|mut writer| writer.write_image_data(&canvas.rgb));
    // Writing to memory fails only for a picture of the wrong size.
    written.unwrap_or_else(|e| unreachable!("{e}"));
    bytes
}
