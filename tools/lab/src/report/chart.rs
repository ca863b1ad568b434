//! Line charts: panels one below the other over a common axis.

use super::picture::{Area, COLOURS, Fault, GRID, INK, Picture, WIDTH, draw_dashed, text, tick, ticks};
use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, ValueFormatter};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};
use std::ops::Range;

const PANEL_HEIGHT: u32 = 190;
const AXIS_HEIGHT: u32 = 22;
/// Room for the upright axis.
const LEFT: u32 = 62;
/// Room for title and legend.
const HEAD: u32 = 26;
/// What times are shaded with.
const SPAN: RGBColor = RGBColor(213, 94, 0);

/// A line of a chart. Points that are not finite interrupt it.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    pub label: String,
    pub points: Vec<(f64, f64)>,
    /// An interval around it: abscissa, lower, upper. Empty without one.
    pub band: Vec<(f64, f64, f64)>,
    /// Drawn dashed, over what it may lie on.
    pub dashed: bool,
}

impl Series {
    pub fn line(label: impl Into<String>, points: Vec<(f64, f64)>) -> Self {
        Self {
            label: label.into(),
            points,
            band: Vec::new(),
            dashed: false,
        }
    }

    /// From abscissa, value, and the lower and upper end of the interval around it.
    pub fn banded(label: impl Into<String>, points: impl IntoIterator<Item = (f64, f64, f64, f64)>) -> Self {
        let parts = points.into_iter().map(|(x, y, low, high)| ((x, y), (x, low, high)));
        let (points, band) = parts.unzip();
        Self {
            band,
            ..Self::line(label, points)
        }
    }
}

/// A chart of its own: lines over the figure's common axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Panel {
    pub title: String,
    /// What the upright axis counts, with its unit in brackets.
    pub y_label: String,
    pub series: Vec<Series>,
    /// Named levels, drawn dashed; one without a name is not in the legend.
    pub thresholds: Vec<(String, f64)>,
    /// The upright axis reaches at least this far.
    pub top: Option<f64>,
}

impl Panel {
    pub fn new<'a>(title: &str, y_label: &str, series: impl IntoIterator<Item = (&'a str, Vec<(f64, f64)>)>) -> Self {
        let lines = series.into_iter().map(|(label, points)| Series::line(label, points));
        Self::of(title, y_label, lines)
    }

    pub fn of(title: impl Into<String>, y_label: &str, series: impl IntoIterator<Item = Series>) -> Self {
        Self {
            title: title.into(),
            y_label: y_label.to_owned(),
            series: series.into_iter().collect(),
            thresholds: Vec::new(),
            top: None,
        }
    }

    /// Lowest and highest value shown, with a little room.
    fn values(&self) -> (f64, f64) {
        let lines = self.series.iter().flat_map(|s| s.points.iter().map(|(_, y)| *y));
        let bands = self.series.iter().flat_map(|s| &s.band).flat_map(|(_, a, b)| [*a, *b]);
        let levels = self.thresholds.iter().map(|(_, y)| *y);
        let all = lines.chain(bands).chain(levels).chain(self.top);
        let all = all.filter(|y| y.is_finite());
        let (low, high) = all.fold((0.0_f64, f64::NEG_INFINITY), |(low, high), y| (low.min(y), high.max(y)));
        let high = if high > low { high } else { low + 1.0 };
        let room = 0.05 * (high - low);
        (if low < 0.0 { low - room } else { low }, high + room)
    }
}

/// How values are spread along the common axis.
#[derive(Debug, Clone, PartialEq)]
pub enum Scale {
    /// From 0, evenly.
    Linear,
    /// By their logarithm, with ticks at these values; it begins at the first, where what is less stands too.
    Logarithmic(Vec<f64>),
}

/// Panels over a common axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    /// What the common axis counts, with its unit in brackets.
    pub x_label: String,
    pub x_last: f64,
    pub x_scale: Scale,
    /// What is shaded in all panels, from where and to where.
    pub span: Option<(String, f64, f64)>,
    /// From top to bottom.
    pub panels: Vec<Panel>,
}

impl Figure {
    /// Panels over an axis from 0 to `x_last`.
    pub fn over(x_label: &str, x_last: f64, panels: Vec<Panel>) -> Self {
        Self {
            x_label: x_label.to_owned(),
            x_last,
            x_scale: Scale::Linear,
            span: None,
            panels,
        }
    }

    /// Where a value stands along the axis.
    fn at(&self, x: f64) -> f64 {
        match &self.x_scale {
            Scale::Linear => x,
            Scale::Logarithmic(values) => x.max(values.first().map_or(1.0, |first| *first)).log10(),
        }
    }

    /// Where the axis begins and ends, and its ticks with their numbers.
    fn axis(&self) -> (f64, f64, Vec<(f64, String)>) {
        match &self.x_scale {
            Scale::Linear => {
                let last = if self.x_last > 0.0 { self.x_last } else { 1.0 };
                let numbers = ticks(0.0, last, 9);
                (0.0, last, numbers.into_iter().map(|x| (x, tick(x, last))).collect())
            }
            Scale::Logarithmic(values) => {
                let first = values.first().map_or(1.0, |x| *x);
                let named = values.iter().map(|x| (x.log10(), tick(*x, *x))).collect();
                (first.log10(), self.x_last.max(first * 1.1).log10(), named)
            }
        }
    }
}

impl Picture for Figure {
    fn size(&self) -> (u32, u32) {
        (WIDTH, self.panels.len().max(1) as u32 * PANEL_HEIGHT + AXIS_HEIGHT)
    }

    fn draw<DB: DrawingBackend>(&self, area: &Area<DB>, scale: u32) -> Result<(), Fault<DB>> {
        let (_, height) = self.size();
        let (panels, _) = area.split_vertically((height - AXIS_HEIGHT) * scale);
        let parts = panels.split_evenly((self.panels.len().max(1), 1));
        for (number, (panel, part)) in self.panels.iter().zip(parts).enumerate() {
            draw_panel(&part, self, panel, scale)?;
            let span = self.span.as_ref().filter(|_| number == 0);
            draw_head(&part, panel, span.map(|(label, ..)| label.as_str()), scale)?;
        }
        let style = text(scale, 12, HPos::Center, VPos::Bottom);
        let middle = ((WIDTH + LEFT) / 2 * scale) as i32;
        area.draw_text(&self.x_label, &style, (middle, ((height - 5) * scale) as i32))
    }
}

/// A straight axis with its ticks where they are wanted.
struct Ticks {
    range: (f64, f64),
    places: Vec<f64>,
}

impl Ranged for Ticks {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, (from, to): (i32, i32)) -> i32 {
        let share = (value - self.range.0) / (self.range.1 - self.range.0);
        (f64::from(from) + share * f64::from(to - from)).round() as i32
    }

    fn key_points<H: KeyPointHint>(&self, hint: H) -> Vec<f64> {
        match hint.weight().allow_light_points() {
            true => Vec::new(),
            false => self.places.clone(),
        }
    }

    fn range(&self) -> Range<f64> {
        self.range.0..self.range.1
    }
}

impl ValueFormatter<f64> for Ticks {}

fn draw_panel<DB: DrawingBackend>(
    area: &Area<DB>,
    figure: &Figure,
    panel: &Panel,
    scale: u32,
) -> Result<(), Fault<DB>> {
    let (low, high) = panel.values();
    let (first, last, named) = figure.axis();
    let axis = Ticks {
        range: (first, last),
        places: named.iter().map(|(x, _)| *x).collect(),
    };
    let name_of = |x: &f64| {
        let near = named.iter().find(|(at, _)| (at - x).abs() <= 1e-9 * (last - first));
        near.map_or_else(String::new, |(_, name)| name.clone())
    };
    let mut chart = ChartBuilder::on(area)
        .margin(6 * scale)
        .margin_top(HEAD * scale)
        .margin_right(16 * scale)
        .y_label_area_size((LEFT - 6) * scale)
        .x_label_area_size(18 * scale)
        .build_cartesian_2d(axis, low..high)?;
    chart
        .configure_mesh()
        .axis_style(INK.stroke_width(scale))
        .bold_line_style(GRID.stroke_width(scale))
        .light_line_style(TRANSPARENT)
        .x_labels(named.len() + 1)
        .y_labels(6)
        .x_label_formatter(&name_of)
        .y_label_formatter(&|y| tick(*y, high - low))
        .label_style(("sans-serif", 11 * scale).into_font().color(&INK))
        .y_desc(&panel.y_label)
        .axis_desc_style(("sans-serif", 12 * scale).into_font().color(&INK))
        .draw()?;
    if let Some((_, from, to)) = &figure.span {
        let corners = [(figure.at(*from), low), (figure.at(*to), high)];
        chart.draw_series([Rectangle::new(corners, SPAN.mix(0.13).filled())])?;
    }
    for (series, colour) in panel.series.iter().zip(COLOURS.iter().cycle()) {
        let upper = series.band.iter().map(|(x, _, y)| (figure.at(*x), *y));
        let lower = series.band.iter().rev().map(|(x, y, _)| (figure.at(*x), *y));
        if !series.band.is_empty() {
            chart.draw_series([Polygon::new(upper.chain(lower).collect::<Vec<_>>(), colour.mix(0.2))])?;
        }
    }
    for (series, colour) in panel.series.iter().zip(COLOURS.iter().cycle()) {
        let style = colour.stroke_width(3 * scale / 2);
        let whole = series.points.split(|(x, y)| !(x.is_finite() && y.is_finite()));
        for piece in whole.filter(|piece| !piece.is_empty()) {
            let placed: Vec<_> = piece.iter().map(|(x, y)| (figure.at(*x), *y)).collect();
            // What lies between a few measured points was not measured.
            let at_ticks = || matches!(&figure.x_scale, Scale::Logarithmic(values) if piece.iter().all(|(x, _)| values.contains(x)));
            if piece.len() <= 12 && (!series.band.is_empty() || at_ticks()) {
                let radius = (2 * scale) as i32;
                let dots = placed.iter().map(|at| Circle::new(*at, radius, colour.filled()));
                chart.draw_series(dots)?;
            }
            match series.dashed {
                true => chart.draw_series(DashedLineSeries::new(placed, 6 * scale, 5 * scale, style))?,
                false => chart.draw_series([PathElement::new(placed, style)])?,
            };
        }
    }
    for (_, level) in &panel.thresholds {
        let ends = [(first, *level), (last, *level)];
        let style = INK.stroke_width(scale);
        chart.draw_series(DashedLineSeries::new(ends, 6 * scale, 4 * scale, style))?;
    }
    Ok(())
}

/// Title on the left, names of the lines on the right, above the chart and not on it.
fn draw_head<DB>(area: &Area<DB>, panel: &Panel, span: Option<&str>, scale: u32) -> Result<(), Fault<DB>>
where
    DB: DrawingBackend,
{
    let middle = (HEAD / 2 * scale) as i32;
    let (left, mark, gap) = ((LEFT * scale) as i32, (16 * scale) as i32, (7 * scale) as i32);
    let title = text(scale, 14, HPos::Left, VPos::Center);
    area.draw_text(&panel.title, &title, (left, middle))?;
    let lines = panel.series.iter().map(|s| s.label.as_str());
    let lines = lines.zip(COLOURS.iter().map(|c| (c.to_rgba(), false)).cycle());
    let levels = panel.thresholds.iter().filter(|(label, _)| !label.is_empty());
    let levels = levels.map(|(label, _)| (label.as_str(), (INK.to_rgba(), true)));
    let shaded = span.map(|label| (label, (SPAN.mix(0.3), false)));
    let names: Vec<_> = lines.chain(levels).chain(shaded).collect();
    if names.len() < 2 {
        return Ok(());
    }
    let style = text(scale, 11, HPos::Right, VPos::Center);
    let mut right = ((WIDTH - 16) * scale) as i32;
    for (label, (colour, is_level)) in names.into_iter().rev() {
        area.draw_text(label, &style, (right, middle))?;
        right -= area.estimate_text_size(label, &style)?.0 as i32 + gap;
        let ends = [(right - mark, middle), (right, middle)];
        let style = colour.stroke_width(2 * scale);
        match is_level {
            true => draw_dashed(area, ends, (4 * scale, 3 * scale), INK.stroke_width(scale))?,
            false => area.draw(&PathElement::new(ends.to_vec(), style))?,
        }
        right -= mark + 2 * gap;
    }
    Ok(())
}
