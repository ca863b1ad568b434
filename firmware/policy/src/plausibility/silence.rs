//! What is gone from one frame to the next: a side of the view that goes dead, and things that vanish from the midst of it.
//!
//! What leaves a view leaves it over its edge, some cells in a step; what goes out of range is far away. Near surfaces that are gone
//! within one step, and with them whatever lay between them and one edge of the view, are gone because the sensor no longer sees
//! them: where they lay deep inside the view or, above and below, where the rest of the same surface is still there. Nor does what
//! stands there give way to what is behind it within a step: somebody wiped it from the picture.

use super::Fault;
use super::blindness::{BLIND_FRAMES, SEEING_FRAMES};
use super::picture::{COLS, Picture, ROWS};

/// What is farther away may go out of range, metres.
const NEAR_M: f32 = 15.0;
/// Rows and columns at the inner border of the dead part that do not count: by so much the view turns in a step.
const BORDER: usize = 3;
/// Columns at the view's edge that do not count for a dead left or right: what is passed at arm's length leaves the view by so much
/// in a step.
const EDGE_COLUMNS: usize = 8;
/// The rest of a surface is this far beyond the border, and its range changes by no more than this part in a step.
const REST: usize = 2;
const SAME_PART: f32 = 0.15;
/// Cells with a near surface that must have gone.
const GONE_CELLS: usize = 6;

/// What vanishes stood so far away, metres: nearer things, and those that move, go farther than [`ABOUT_COLUMNS`] in a step.
const VANISHED_FROM_M: f32 = 1.5;
const VANISHED_TO_M: f32 = 12.0;
/// Rows and columns about a cell in which what it showed may be a step later.
const ABOUT_ROWS: usize = 1;
const ABOUT_COLUMNS: usize = 3;
/// What is behind a surface is farther by this part of its range, and metres.
const BEHIND_PART: f32 = 0.3;
const BEHIND_M: f32 = 0.5;
/// Cells that must have vanished: no frame of 300 hard flights had one.
const VANISHED_CELLS: usize = 12;

/// Whether surfaces of the picture a step before are neither where they were nor about there, and what is behind them is seen. Where nothing is
/// seen behind any of them the sensor may have failed ([`SilentSide`]).
pub(super) fn have_vanished(before: &Picture, now: &Picture) -> bool {
    let (mut cells, mut shown) = (0, 0);
    for row in ABOUT_ROWS..ROWS - ABOUT_ROWS {
        for column in ABOUT_COLUMNS..COLS - ABOUT_COLUMNS {
            let cell = row * COLS + column;
            let inverse = before.inverse(cell);
            if !(1.0 / VANISHED_TO_M..1.0 / VANISHED_FROM_M).contains(&inverse) {
                continue;
            }
            let behind = inverse / (1.0 + BEHIND_PART + BEHIND_M * inverse);
            let is_behind = |cell: usize| (0.0..behind).contains(&now.inverse(cell));
            let about = |cell: usize| (cell - ABOUT_COLUMNS..=cell + ABOUT_COLUMNS).all(is_behind);
            // Nearly every cell is where it was: it is looked at first.
            if is_behind(cell) && (row - ABOUT_ROWS..=row + ABOUT_ROWS).all(|row| about(row * COLS + column)) {
                cells += 1;
                shown += usize::from(now.inverse(cell) > 0.0);
            }
        }
    }
    cells >= VANISHED_CELLS && shown > 0
}

/// A side of the view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Side {
    Top,
    Bottom,
    Left,
    Right,
}

const SIDES: [Side; 4] = [Side::Top, Side::Bottom, Side::Left, Side::Right];

impl Side {
    /// Whether its lines are rows of the view.
    fn has_rows(self) -> bool {
        matches!(self, Self::Top | Self::Bottom)
    }

    /// Number of its lines, and of the cells of each.
    fn size(self) -> (usize, usize) {
        if self.has_rows() { (ROWS, COLS) } else { (COLS, ROWS) }
    }

    /// A cell of the line so many from this side's edge inwards.
    fn cell(self, line: usize, along: usize) -> usize {
        match self {
            Self::Top => line * COLS + along,
            Self::Bottom => (ROWS - 1 - line) * COLS + along,
            Self::Left => along * COLS + line,
            Self::Right => along * COLS + COLS - 1 - line,
        }
    }

    /// Whether nothing is seen in a line.
    fn is_empty(self, line: usize, picture: &Picture) -> bool {
        (0..self.size().1).all(|along| picture.inverse(self.cell(line, along)) == 0.0)
    }

    /// Lines of cells, from this side's edge inwards, in which nothing is seen; all of them where nothing is seen at all.
    fn empty_lines(self, picture: &Picture) -> usize {
        (0..self.size().0)
            .take_while(|line| self.is_empty(*line, picture))
            .count()
    }

    /// Near surfaces of the picture before in so many lines that are empty now, and that cannot have left by themselves.
    fn gone(self, lines: usize, before: &Picture, now: &Picture) -> usize {
        let (all, length) = self.size();
        let may_count = |along: usize, line: usize| {
            if !self.has_rows() {
                return (EDGE_COLUMNS..COLS - EDGE_COLUMNS).contains(&line);
            }
            let rest = self.cell((lines + REST).min(all - 1), along);
            let (a, b) = (before.inverse(rest), now.inverse(rest));
            lines + REST < all && a > 1.0 / NEAR_M && (b - a).abs() <= SAME_PART * a
        };
        let cells = (0..lines.saturating_sub(BORDER)).flat_map(|line| (0..length).map(move |along| (line, along)));
        cells
            .filter(|(line, along)| before.inverse(self.cell(*line, *along)) > 1.0 / NEAR_M && may_count(*along, *line))
            .count()
    }
}

/// Whether a side of the view is dead.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct SilentSide {
    /// The side that fell silent, and how many of its lines.
    part: Option<(Side, usize)>,
    /// From the second silent frame until something is seen there in three frames in a row.
    pub(super) fault: Fault,
}

impl SilentSide {
    /// Takes a picture, with the one before if that was taken a step earlier by a vehicle that hardly turned since.
    pub(super) fn note(&mut self, now: &Picture, before: Option<&Picture>) {
        if let (None, Some(before)) = (self.part, before) {
            self.part = SIDES.into_iter().find_map(|side| {
                let lines = side.empty_lines(now);
                (side.gone(lines, before, now) >= GONE_CELLS).then_some((side, lines))
            });
        }
        let Some((side, lines)) = self.part else { return };
        let silent = (0..lines.saturating_sub(BORDER)).all(|line| side.is_empty(line, now));
        if !self.fault.note(silent, BLIND_FRAMES, SEEING_FRAMES) && !silent {
            *self = Self::default();
        }
    }
}
