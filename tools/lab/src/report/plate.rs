//! Pictures in rows and columns with their names, and scales of their colours.

use super::picture::{Area, Fault, INK, Picture, Raster, WIDTH, text};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};
use vigil_types::{DEPTH_COLS, DEPTH_ROWS};

/// Room for the rows' names, for title and columns' names, between pictures, for the scales of the colours.
const LEFT: u32 = 92;
const HEAD: u32 = 46;
const GAP: u32 = 8;
const FOOT: u32 = 62;
const COLUMN: u32 = (WIDTH - LEFT - 12 - GAP) / 2;
/// Twice as wide as high, as depth frames are.
const ROW: u32 = COLUMN / 2;

/// A scale of colours: its name, and values along it from 0 (left) to 1.
#[derive(Debug, Clone, PartialEq)]
pub struct ColourScale {
    /// What the colours mean, with the unit in brackets.
    pub label: String,
    /// Where values stand, and how they are written.
    pub ticks: Vec<(f64, String)>,
    /// Colour of each place from 0 to 1.
    pub colours: Vec<[u8; 3]>,
}

impl ColourScale {
    /// Of depth frames, near is bright: a range's grey is 255 / (1 + range / 3 m).
    pub fn of_ranges() -> Self {
        let place = |range_m: f64| (1.0 - 1.0 / (1.0 + range_m / 3.0), format!("{range_m}"));
        Self {
            label: "range (m)".to_owned(),
            ticks: [0.0, 1.0, 3.0, 10.0, 100.0].map(place).into(),
            colours: (0..=255u8).rev().map(|grey| [grey; 3]).collect(),
        }
    }
}

#[derive(Debug, Clone, PartialEq)]
pub struct Plate {
    pub title: String,
    /// Names of the columns, and what their colours mean.
    pub columns: [(&'static str, ColourScale); 2],
    /// Names of the rows, line by line, and the colours of their two pictures, as large as depth frames.
    pub rows: Vec<(Vec<String>, [Vec<u8>; 2])>,
}

fn left_of(column: usize) -> u32 {
    LEFT + column as u32 * (COLUMN + GAP)
}

impl Plate {
    fn scales_top(&self) -> u32 {
        HEAD + self.rows.len() as u32 * (ROW + GAP)
    }
}

impl Picture for Plate {
    fn size(&self) -> (u32, u32) {
        (WIDTH, self.scales_top() + FOOT)
    }

    fn draw<DB: DrawingBackend>(&self, area: &Area<DB>, scale: u32) -> Result<(), Fault<DB>> {
        let dots = |n: u32| (n * scale) as i32;
        let text = |size: u32, h, v| text(scale, size, h, v);
        area.draw_text(&self.title, &text(14, HPos::Left, VPos::Center), (dots(12), dots(13)))?;
        for (number, (name, colours)) in self.columns.iter().enumerate() {
            let left = left_of(number);
            let centre = text(12, HPos::Center, VPos::Center);
            area.draw_text(name, &centre, (dots(left + COLUMN / 2), dots(36)))?;
            let top = dots(self.scales_top() + 14);
            for (share, value) in &colours.ticks {
                let x = dots(left) + (share * f64::from(COLUMN * scale)).round() as i32;
                let ends = vec![(x, top), (x, top + dots(4))];
                area.draw(&PathElement::new(ends, INK.stroke_width(scale)))?;
                // Numbers at the ends keep within the scale: its neighbour has some as well.
                let side = match *share {
                    s if s < 0.05 => HPos::Left,
                    s if s > 0.95 => HPos::Right,
                    _ => HPos::Center,
                };
                area.draw_text(value, &text(10, side, VPos::Top), (x, top + dots(5)))?;
            }
            let centre = text(11, HPos::Center, VPos::Bottom);
            let at = (dots(left + COLUMN / 2), dots(self.size().1 - 6));
            area.draw_text(&colours.label, &centre, at)?;
        }
        for (number, (lines, _)) in self.rows.iter().enumerate() {
            let middle = HEAD + number as u32 * (ROW + GAP) + ROW / 2;
            let above = 8 * (lines.len() as u32).saturating_sub(1);
            for (line, words) in lines.iter().enumerate() {
                let y = dots(middle + 16 * line as u32) - dots(above);
                area.draw_text(words, &text(12, HPos::Right, VPos::Center), (dots(LEFT - 8), y))?;
            }
        }
        Ok(())
    }

    fn rasters(&self) -> Vec<Raster> {
        let pictures = self.rows.iter().enumerate().flat_map(|(row, (_, pictures))| {
            pictures.iter().enumerate().map(move |(column, rgb)| Raster {
                place: [left_of(column), HEAD + row as u32 * (ROW + GAP), COLUMN, ROW],
                size: (DEPTH_COLS as u32, DEPTH_ROWS as u32),
                rgb: rgb.clone(),
            })
        });
        let scales = self.columns.iter().enumerate().map(|(number, (_, scale))| Raster {
            place: [left_of(number), self.scales_top() + 4, COLUMN, 10],
            size: (scale.colours.len() as u32, 1),
            rgb: scale.colours.concat(),
        });
        pictures.chain(scales).collect()
    }
}
