//! A picture of few colours to draw on.

use embedded_graphics::mono_font::MonoTextStyle;
use embedded_graphics::mono_font::iso_8859_1::FONT_7X13;
use embedded_graphics::pixelcolor::Gray8;
use embedded_graphics::prelude::*;
use embedded_graphics::text::{Baseline, Text};
use std::convert::Infallible;

pub struct Colour;

impl Colour {
    pub const PAPER: u8 = 0;
    pub const INK: u8 = 1;
    pub const SOFT: u8 = 2;
    pub const LINE: u8 = 3;
    pub const SOLID: u8 = 4;
    pub const ACTOR: u8 = 5;
    pub const RECOVERY: u8 = 6;
    pub const HOLD: u8 = 7;
    pub const ATTACK: u8 = 8;
    pub const ATTACK_PALE: u8 = 9;
    pub const GOAL: u8 = 10;
    pub const BANNER: u8 = 11;
    pub const TRANSPARENT: u8 = 12;
    pub const SOLID_TOP: u8 = 13;
    pub const SOLID_DARK: u8 = 14;
    pub const GROUND: u8 = 15;
    /// The first of eight greys.
    pub const GREY: u8 = 16;
    /// The first of four strengths of what turned the vehicle right, and left.
    pub const RIGHT: u8 = 24;
    pub const LEFT: u8 = 28;
}

/// The colours up to the greys, red, green, blue: safe for the colour-blind.
const FLAT: [u32; 16] = [
    0xffffff, 0x1b1f24, 0x5b6570, 0xcdd3da, 0xb9c1ca, 0x0072b2, 0xe69f00, 0x8a5aa8, 0xd55e00, 0xf7d6be, 0x008262,
    0xeceff2, 0x000000, 0xd4dae0, 0x949eaa, 0xf3f5f7,
];

/// Red, green, blue of each number.
pub const PALETTE: [[u8; 3]; 32] = {
    let mut palette = [[0; 3]; 32];
    let mut number = 0;
    while number < palette.len() {
        // From dark, on which they lie, to bright.
        let share = number as u8 % 4 + 1;
        palette[number] = match number {
            0..16 => {
                let [_, red, green, blue] = FLAT[number].to_be_bytes();
                [red, green, blue]
            }
            16..24 => [36 * (number as u8 - 16); 3],
            24..28 => [63 * share, 40 * share, 0],
            _ => [0, 35 * share, 62 * share],
        };
        number += 1;
    }
    palette
};

/// The least and the greatest value.
pub fn span(values: impl Iterator<Item = f32>) -> (f32, f32) {
    values.fold((f32::INFINITY, f32::NEG_INFINITY), |(least, most), value| {
        (least.min(value), most.max(value))
    })
}

/// A raster of colour numbers.
#[derive(Debug, Clone)]
pub struct Canvas {
    width: usize,
    height: usize,
    /// Row by row.
    pub pixels: Vec<u8>,
}

impl Canvas {
    pub fn new(width: usize, height: usize, colour: u8) -> Self {
        Self {
            width,
            height,
            pixels: vec![colour; width * height],
        }
    }

    fn put(&mut self, x: i64, y: i64, colour: u8) {
        if (0..self.width as i64).contains(&x) && (0..self.height as i64).contains(&y) {
            self.pixels[y as usize * self.width + x as usize] = colour;
        }
    }

    pub fn rectangle(&mut self, left: usize, top: usize, width: usize, height: usize, colour: u8) {
        for y in top..(top + height).min(self.height) {
            let row = y * self.width;
            self.pixels[row + left.min(self.width)..row + (left + width).min(self.width)].fill(colour);
        }
    }

    /// A border of two pixels.
    pub fn frame(&mut self, left: usize, top: usize, width: usize, height: usize, colour: u8) {
        self.rectangle(left, top, width, 2, colour);
        self.rectangle(left, top + height - 2, width, 2, colour);
        self.rectangle(left, top, 2, height, colour);
        self.rectangle(left + width - 2, top, 2, height, colour);
    }

    /// Colours every pixel of a box whose centre `is_in`.
    fn fill(&mut self, (x0, y0, x1, y1): (f32, f32, f32, f32), colour: u8, is_in: impl Fn(f32, f32) -> bool) {
        // Beyond the picture nothing is drawn, however far a shape reaches.
        let bound = |v: f32, most: usize| v.clamp(-2.0, most as f32 + 2.0) as i64;
        for y in bound(y0, self.height)..=bound(y1, self.height) {
            for x in bound(x0, self.width)..=bound(x1, self.width) {
                if is_in(x as f32 + 0.5, y as f32 + 0.5) {
                    self.put(x, y, colour);
                }
            }
        }
    }

    pub fn disc(&mut self, centre: (f32, f32), radius: f32, colour: u8) {
        self.ring(centre, 0.5 * radius, radius, colour);
    }

    pub fn ring(&mut self, (cx, cy): (f32, f32), radius: f32, width: f32, colour: u8) {
        let outer = radius + 0.5 * width;
        let around = (cx - outer, cy - outer, cx + outer, cy + outer);
        self.fill(around, colour, |x, y| {
            ((x - cx).hypot(y - cy) - radius).abs() <= 0.5 * width
        });
    }

    pub fn line(&mut self, (ax, ay): (f32, f32), (bx, by): (f32, f32), width: f32, colour: u8) {
        let half = 0.5 * width;
        let around = (
            ax.min(bx) - half,
            ay.min(by) - half,
            ax.max(bx) + half,
            ay.max(by) + half,
        );
        let (dx, dy) = (bx - ax, by - ay);
        let length_2 = (dx * dx + dy * dy).max(f32::MIN_POSITIVE);
        self.fill(around, colour, |x, y| {
            let share = (((x - ax) * dx + (y - ay) * dy) / length_2).clamp(0.0, 1.0);
            (x - ax - share * dx).hypot(y - ay - share * dy) <= half
        });
    }

    pub fn polygon(&mut self, corners: &[(f32, f32)], colour: u8) {
        let ((x0, x1), (y0, y1)) = (span(corners.iter().map(|c| c.0)), span(corners.iter().map(|c| c.1)));
        self.fill((x0, y0, x1, y1), colour, |x, y| {
            let mut inside = false;
            let mut last = corners.len().wrapping_sub(1);
            for (i, (cx, cy)) in corners.iter().enumerate() {
                let (px, py) = corners[last];
                if (*cy > y) != (py > y) && x < (px - cx) * (y - cy) / (py - cy) + cx {
                    inside = !inside;
                }
                last = i;
            }
            inside
        });
    }

    /// Text whose upper left corner is at `x`, `y`.
    pub fn text(&mut self, x: usize, y: usize, text: &str, colour: u8) {
        let style = MonoTextStyle::new(&FONT_7X13, Gray8::new(colour));
        let Ok(_) = Text::with_baseline(text, Point::new(x as i32, y as i32), style, Baseline::Top).draw(self);
    }
}

impl OriginDimensions for Canvas {
    fn size(&self) -> Size {
        Size::new(self.width as u32, self.height as u32)
    }
}

/// The number of a colour stands in the place of its brightness.
impl DrawTarget for Canvas {
    type Color = Gray8;
    type Error = Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<Gray8>>>(&mut self, pixels: I) -> Result<(), Infallible> {
        for Pixel(at, colour) in pixels {
            self.put(at.x.into(), at.y.into(), colour.luma());
        }
        Ok(())
    }
}
