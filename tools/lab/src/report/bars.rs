//! Bar charts: named rows of bars with their intervals, and what others measured beside them.

use super::picture::{Area, COLOURS, Fault, GRID, INK, Picture, WIDTH, draw_dashed, text, tick, ticks};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};

/// Room for the rows' names, for title and legend, for the axis, dots at 100 per inch.
const LEFT: u32 = 200;
const RIGHT: u32 = 96;
const HEAD: u32 = 44;
const FOOT: u32 = 40;
const BAR: u32 = 15;
const GAP: u32 = 12;

#[derive(Debug, Clone, PartialEq)]
pub struct Bar {
    /// Which of the chart's series it belongs to.
    pub series: usize,
    pub value: f64,
    /// Its 95 % interval.
    pub interval: (f64, f64),
    /// What stands behind it.
    pub note: String,
}

#[derive(Debug, Clone, PartialEq)]
pub struct BarRow {
    pub label: String,
    /// From top to bottom.
    pub bars: Vec<Bar>,
    pub paper: Option<f64>,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Bars {
    pub title: String,
    /// What the axis counts, with its unit in brackets.
    pub x_label: String,
    pub x_range: (f64, f64),
    pub logarithmic: bool,
    /// A named level, drawn dashed.
    pub threshold: Option<(String, f64)>,
    pub series: Vec<String>,
    /// From top to bottom.
    pub rows: Vec<BarRow>,
}

impl Bars {
    /// Where a value stands along the axis, dots.
    fn at(&self, value: f64, scale: u32) -> i32 {
        let (low, high) = self.x_range;
        let share = match self.logarithmic {
            true => (value.max(low) / low).log10() / (high / low).log10(),
            false => (value - low) / (high - low),
        };
        let width = f64::from(WIDTH - LEFT - RIGHT);
        ((f64::from(LEFT) + share.clamp(0.0, 1.0) * width) * f64::from(scale)).round() as i32
    }

    fn ticks(&self) -> Vec<f64> {
        let (low, high) = self.x_range;
        match self.logarithmic {
            true => (low.log10().ceil() as i32..=high.log10().floor() as i32)
                .map(|power| 10f64.powi(power))
                .collect(),
            false => ticks(low, high, 10),
        }
    }

    fn row_height(row: &BarRow) -> u32 {
        row.bars.len().max(1) as u32 * BAR + GAP
    }

    fn draw_legend<DB: DrawingBackend>(&self, area: &Area<DB>, scale: u32) -> Result<(), Fault<DB>> {
        let dots = |n: u32| (n * scale) as i32;
        let style = text(scale, 11, HPos::Left, VPos::Center);
        let (mut x, y) = (dots(LEFT), dots(32));
        let next = |x: &mut i32, label: &str| -> Result<(), Fault<DB>> {
            area.draw_text(label, &style, (*x + dots(16), y))?;
            *x += dots(16) + area.estimate_text_size(label, &style)?.0 as i32 + dots(14);
            Ok(())
        };
        if self.series.len() > 1 {
            for (label, colour) in self.series.iter().zip(COLOURS.iter().cycle()) {
                let mark = [(x, y - dots(4)), (x + dots(11), y + dots(4))];
                area.draw(&Rectangle::new(mark, colour.filled()))?;
                next(&mut x, label)?;
            }
        }
        if self.rows.iter().any(|row| row.paper.is_some()) {
            area.draw(&diamond(x + dots(6), y, dots(5)))?;
            next(&mut x, "the paper")?;
        }
        if let Some((label, _)) = &self.threshold {
            let ends = [(x, y), (x + dots(12), y)];
            draw_dashed(area, ends, (4 * scale, 3 * scale), INK.stroke_width(scale))?;
            next(&mut x, label)?;
        }
        Ok(())
    }

    /// A bar with its interval and note, from `start` on, its upper edge at `y`.
    fn draw_bar<DB>(&self, area: &Area<DB>, scale: u32, bar: &Bar, (start, y): (i32, i32)) -> Result<(), Fault<DB>>
    where
        DB: DrawingBackend,
    {
        let dots = |n: u32| (n * scale) as i32;
        let (upper, lower, centre) = (y + dots(1), y + dots(BAR - 2), y + dots(BAR) / 2);
        let (end, colour) = (self.at(bar.value, scale), COLOURS[bar.series % COLOURS.len()]);
        let corners = [(start.min(end), upper), (start.max(end), lower)];
        area.draw(&Rectangle::new(corners, colour.mix(0.75).filled()))?;
        // So that a bar of nothing shows whose it is.
        if self.series.len() > 1 {
            let mark = [(start - dots(6), upper), (start - dots(2), lower)];
            area.draw(&Rectangle::new(mark, colour.filled()))?;
        }
        let (low, high) = (self.at(bar.interval.0, scale), self.at(bar.interval.1, scale));
        let ends = [low, high].map(|x| [(x, centre - dots(3)), (x, centre + dots(3))]);
        for line in [[(low, centre), (high, centre)], ends[0], ends[1]] {
            area.draw(&PathElement::new(line.to_vec(), INK.stroke_width(scale)))?;
        }
        let place = (end.max(high) + dots(6), centre + dots(1));
        area.draw_text(&bar.note, &text(scale, 10, HPos::Left, VPos::Center), place)
    }
}

fn diamond(x: i32, y: i32, radius: i32) -> Polygon<(i32, i32)> {
    let corners = vec![(x, y - radius), (x + radius, y), (x, y + radius), (x - radius, y)];
    Polygon::new(corners, INK.filled())
}

impl Picture for Bars {
    fn size(&self) -> (u32, u32) {
        (WIDTH, HEAD + self.rows.iter().map(Self::row_height).sum::<u32>() + FOOT)
    }

    fn draw<DB: DrawingBackend>(&self, area: &Area<DB>, scale: u32) -> Result<(), Fault<DB>> {
        let dots = |n: u32| (n * scale) as i32;
        let write = |words: &str, size, h, v, at| area.draw_text(words, &text(scale, size, h, v), at);
        let line = |ends: [(i32, i32); 2], style: ShapeStyle| area.draw(&PathElement::new(ends.to_vec(), style));
        write(&self.title, 14, HPos::Left, VPos::Center, (dots(12), dots(13)))?;
        self.draw_legend(area, scale)?;
        let bottom = dots(self.size().1 - FOOT);
        for value in self.ticks() {
            let x = self.at(value, scale);
            line([(x, dots(HEAD)), (x, bottom)], GRID.stroke_width(scale))?;
            let apart = self.x_range.1 - self.x_range.0;
            let name = tick(value, if self.logarithmic { value } else { apart });
            write(&name, 11, HPos::Center, VPos::Top, (x, bottom + dots(4)))?;
        }
        // Shares of a logarithmic axis are longer or shorter than one.
        let start = self.at(if self.logarithmic { 1.0 } else { self.x_range.0 }, scale);
        let mut top = HEAD + GAP / 2;
        for row in &self.rows {
            let middle = dots(top) + dots(row.bars.len().max(1) as u32 * BAR) / 2;
            write(&row.label, 12, HPos::Right, VPos::Center, (dots(LEFT - 12), middle))?;
            for (number, bar) in row.bars.iter().enumerate() {
                self.draw_bar(area, scale, bar, (start, dots(top + number as u32 * BAR)))?;
            }
            if let Some(paper) = row.paper {
                area.draw(&diamond(self.at(paper, scale), middle, dots(5)))?;
            }
            top += Self::row_height(row);
        }
        line([(start, dots(HEAD)), (start, bottom)], INK.stroke_width(scale))?;
        if let Some((_, level)) = &self.threshold {
            let x = self.at(*level, scale);
            let ends = [(x, dots(HEAD)), (x, bottom)];
            draw_dashed(area, ends, (6 * scale, 4 * scale), INK.stroke_width(scale))?;
        }
        let at = (dots((LEFT + WIDTH - RIGHT) / 2), dots(self.size().1 - 5));
        write(&self.x_label, 12, HPos::Center, VPos::Bottom, at)
    }
}
