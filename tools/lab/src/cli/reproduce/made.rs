//! What an item is made into: a figure, a table and a caption, and how shares are written.

use crate::campaign::Tally;
use crate::detector_training::Proportion;
use crate::report::Picture;
use anyhow::Result;

/// A table: headings, and rows as wide.
pub struct Grid {
    pub columns: Vec<String>,
    pub rows: Vec<Vec<String>>,
}

impl Grid {
    /// Without rows; a bar between two headings.
    pub(super) fn new(columns: &str) -> Self {
        Self {
            columns: columns.split(" | ").map(str::to_owned).collect(),
            rows: Vec::new(),
        }
    }

    pub(super) fn row(&mut self, cells: impl IntoIterator<Item = String>) {
        let row: Vec<String> = cells.into_iter().collect();
        debug_assert_eq!(row.len(), self.columns.len());
        self.rows.push(row);
    }

    /// An item without a figure.
    pub(super) fn alone(self, caption: impl Into<String>) -> Result<Made> {
        Ok(Made {
            figure: None,
            table: self,
            caption: caption.into(),
        })
    }

    /// An item with one.
    pub(super) fn beside(self, picture: &impl Picture, caption: impl Into<String>) -> Result<Made> {
        let figure = Some((picture.svg(), picture.png()));
        self.alone(caption).map(|made| Made { figure, ..made })
    }
}

/// An item made of data.
pub struct Made {
    /// SVG and PNG.
    pub figure: Option<(String, Vec<u8>)>,
    /// Ours beside the paper's.
    pub table: Grid,
    pub caption: String,
}

/// No number of the paper's.
pub(super) const NONE: &str = "—";

pub(super) fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share)
}

/// How many of some flights came there, with the interval, the paper's share and how the others ended.
pub(super) fn outcomes(tally: &Tally, paper: &str) -> [String; 6] {
    [
        format!(
            "{} of {} ({})",
            tally.completed,
            tally.flights,
            percent(tally.completion)
        ),
        between(tally.wilson_95),
        paper.to_owned(),
        tally.collisions.to_string(),
        tally.out_of_bounds.to_string(),
        tally.time_outs.to_string(),
    ]
}

pub(super) fn between((low, high): (f64, f64)) -> String {
    format!("{:.1} to {:.1} %", 100.0 * low, 100.0 * high)
}

pub(super) fn share_of(p: &Proportion) -> [String; 2] {
    match p.share {
        Some(share) => [
            format!("{} of {} ({})", p.count, p.of, percent(share)),
            between(p.interval),
        ],
        None => [NONE.to_owned(), NONE.to_owned()],
    }
}

pub(super) fn optional(value: Option<f64>, write: impl Fn(f64) -> String) -> String {
    value.map_or_else(|| NONE.to_owned(), write)
}
