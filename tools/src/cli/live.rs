//! The flight on a terminal while it flies: the course from above in braille, score against threshold, step time, state.

use vigil_sim::program::{NEARNESS_COLS, NEARNESS_ROWS, Status};
use vigil_sim::world::Course;
use vigil_types::NedVector;

/// Widest and tallest map, in characters of 2 × 4 dots.
const MOST_COLS: usize = 76;
const MOST_ROWS: usize = 14;
/// A map of fewer rows is worth less than the depth picture's.
const LEAST_ROWS: usize = 3;
/// Characters of the lines around the pictures at their longest: behind the title, score, step, state.
const LINES: [usize; 4] = [44, 78, 76, 160];
/// Ground around the obstacles that is shown, metres.
const MARGIN_M: f32 = 1.0;
/// Characters of the score's bar.
const BAR: usize = 40;
/// A step has 50 ms.
const STEP_BUDGET_US: f32 = 50_000.0;

/// What does not change in a flight, and the path so far.
pub struct Live {
    title: String,
    goal_ned_m: NedVector,
    threshold: Option<f32>,
    /// NED metres (north, east) of the map's upper left corner: north is to the right, east is down.
    corner_m: (f32, f32),
    dot_m: f32,
    cols: usize,
    rows: usize,
    shows_depth: bool,
    /// Braille dots of each character.
    ground: Vec<u8>,
}

impl Live {
    /// For a terminal of so many columns and rows. What is too high makes room: the map, then the depth picture.
    pub fn new(title: String, course: &Course, threshold: Option<f32>, columns: u16, rows: u16) -> Self {
        let columns = usize::from(columns.max(1));
        let [behind_title, lines @ ..] = LINES;
        let lines = lines.into_iter().chain([title.chars().count() + behind_title]);
        let around: usize = lines.map(|chars| chars.div_ceil(columns)).sum();
        let room = usize::from(if rows == 0 { 24 } else { rows }).saturating_sub(around);
        let depth_rows = NEARNESS_ROWS * NEARNESS_COLS.div_ceil(columns);
        let shows_depth = room >= LEAST_ROWS + depth_rows;
        let most_rows = if shows_depth { room - depth_rows } else { room }.clamp(1, MOST_ROWS);
        let solids = course.corridor_solids();
        let goal_ned_m = course.goal_ned_m();
        let mut low = (goal_ned_m.x.min(0.0), goal_ned_m.y.min(0.0));
        let mut high = (goal_ned_m.x.max(0.0), goal_ned_m.y.max(0.0));
        for solid in &solids {
            let (centre, reach) = (solid.centre_ned_m(), solid.plan_half_extents_m());
            low = (low.0.min(centre.x - reach.0), low.1.min(centre.y - reach.1));
            high = (high.0.max(centre.x + reach.0), high.1.max(centre.y + reach.1));
        }
        let low = (low.0 - MARGIN_M, low.1 - MARGIN_M);
        let (length_m, width_m) = (high.0 + MARGIN_M - low.0, high.1 + MARGIN_M - low.1);
        let most_cols = MOST_COLS.min(columns.saturating_sub(2)).max(8);
        let dot_m = (length_m / (2 * most_cols) as f32).max(width_m / (4 * most_rows) as f32);
        let cols = ((length_m / dot_m / 2.0).ceil() as usize).clamp(1, most_cols);
        let rows = ((width_m / dot_m / 4.0).ceil() as usize).clamp(1, most_rows);
        let mut live = Self {
            title,
            goal_ned_m,
            threshold,
            corner_m: low,
            dot_m,
            cols,
            rows,
            shows_depth,
            ground: vec![0; cols * rows],
        };
        for x in 0..2 * cols {
            for y in 0..4 * rows {
                let north = low.0 + (x as f32 + 0.5) * dot_m;
                let east = low.1 + (y as f32 + 0.5) * dot_m;
                if solids.iter().any(|s| s.plan_distance_m(north, east) <= dot_m / 2.0) {
                    let (at, bit) = (y / 4 * cols + x / 2, dot(x, y));
                    live.ground[at] |= bit;
                }
            }
        }
        live
    }

    /// The dot at a position, if it is on the map.
    fn dot_of(&self, p: &NedVector) -> Option<(usize, usize)> {
        let [x, y] = [p.x - self.corner_m.0, p.y - self.corner_m.1].map(|m| m / self.dot_m);
        let inside = x >= 0.0 && y >= 0.0 && x < (2 * self.cols) as f32 && y < (4 * self.rows) as f32;
        inside.then_some((x as usize, y as usize))
    }

    /// Several lines for the terminal.
    pub fn picture(&self, path: &[NedVector], status: &Status) -> String {
        let mut dots = self.ground.clone();
        for (x, y) in path.iter().filter_map(|p| self.dot_of(p)) {
            dots[y / 4 * self.cols + x / 2] |= dot(x, y);
        }
        let place = |p: &NedVector| self.dot_of(p).map(|(x, y)| y / 4 * self.cols + x / 2);
        let goal = place(&self.goal_ned_m);
        let [x, y, z] = status.position_ned_m;
        let vehicle = place(&NedVector::new(x, y, z));
        let (title, col_m) = (&self.title, 2.0 * self.dot_m);
        let mut text = format!("{title}   north →, east ↓, a character is {col_m:.1} m\n");
        for row in 0..self.rows {
            for col in 0..self.cols {
                let at = row * self.cols + col;
                text.push(match at {
                    at if vehicle == Some(at) => '◆',
                    at if goal == Some(at) => '×',
                    // The block of braille patterns has all 256 of them.
                    at => char::from_u32(0x2800 + u32::from(dots[at])).unwrap_or(' '),
                });
            }
            text.push('\n');
        }
        let digits = status.nearness.as_bytes();
        let depth_rows = if self.shows_depth { NEARNESS_ROWS } else { 0 };
        for row in digits.chunks_exact(NEARNESS_COLS).take(depth_rows) {
            text.extend(row.iter().map(|digit| match digit {
                b'8'.. => '█',
                b'6'.. => '▓',
                b'4'.. => '▒',
                b'1'.. => '░',
                _ => ' ',
            }));
            text.push('\n');
        }
        text += &format!("score  {}\n", self.score(status.score));
        let budget = bar(status.step_us / STEP_BUDGET_US, None);
        text += &format!("step   {budget} {:>5.0} µs of {STEP_BUDGET_US:.0}", status.step_us);
        if status.slips > 0 {
            text += &format!(", {} missed", status.slips);
        }
        text + "\n" + &state_line(status)
    }

    fn score(&self, score: Option<f32>) -> String {
        match (score, self.threshold) {
            (Some(score), Some(threshold)) => {
                let word = if score > threshold { "ATTACK" } else { "clean" };
                let bar = bar(score, Some(threshold));
                format!("{bar} {score:.3}, threshold {threshold:.3}: {word}")
            }
            (Some(score), None) => format!("{} {score:.3}", bar(score, None)),
            (None, Some(_)) => "none yet: no verdict is unknown, not clean".to_owned(),
            (None, None) => "no detector flies".to_owned(),
        }
    }
}

/// A bar for a share of 1, with a mark.
fn bar(share: f32, mark: Option<f32>) -> String {
    let cells = |share: f32| (share.clamp(0.0, 1.0) * BAR as f32).round() as usize;
    let (full, mark) = (cells(share), mark.map(|m| cells(m).min(BAR - 1)));
    (0..BAR)
        .map(|i| match i {
            i if mark == Some(i) => '|',
            i if i < full => '█',
            _ => '·',
        })
        .collect()
}

/// The bit of a dot within its character.
fn dot(x: usize, y: usize) -> u8 {
    const BITS: [[u8; 4]; 2] = [[0x01, 0x02, 0x04, 0x40], [0x08, 0x10, 0x20, 0x80]];
    BITS[x % 2][y % 4]
}

/// Where the vehicle is and what guidance does, in a line.
pub(super) fn state_line(s: &Status) -> String {
    if let Some(pose) = &s.pose {
        return format!("{:5.1} s  no frames: {pose}", s.time_s);
    }
    let guidance = match (&s.guidance, s.reasons.is_empty()) {
        (None, _) => "no firmware yet".to_owned(),
        (Some(state), true) => state.clone(),
        (Some(state), false) => format!("{state} ({})", s.reasons.join(", ")),
    };
    format!(
        "{:5.1} s  {:5.1} m to goal  {:.1} m/s  {:<8}  {guidance}  step {:.0} us, {} missed",
        s.time_s, s.goal_distance_m, s.speed_m_s, s.mode, s.step_us, s.slips
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use vigil_sim::world::{Family, generate};

    fn status(score: Option<f32>, position_ned_m: [f32; 3]) -> Status {
        Status {
            position_ned_m,
            score,
            nearness: "0479".repeat(NEARNESS_COLS * NEARNESS_ROWS / 4),
            ..Status::default()
        }
    }

    #[test]
    fn the_map_shows_obstacles_vehicle_goal_and_path_within_the_terminal() {
        let course = generate(Family::Validation, 7);
        let live = Live::new("course 7".to_owned(), &course, Some(0.8), 66, 40);
        let path: Vec<NedVector> = (0..50).map(|i| NedVector::new(0.1 * i as f32, 0.0, -1.5)).collect();
        let before = live.picture(&[], &status(None, [0.0, 0.0, -1.5]));
        let after = live.picture(&path, &status(Some(0.95), [5.0, 0.0, -1.5]));
        for text in [&before, &after] {
            let mut rows = text.lines().skip(1).take(live.rows);
            assert!(rows.all(|line| line.chars().count() == live.cols && live.cols <= 64));
            assert_eq!((text.matches('◆').count(), text.matches('×').count()), (1, 1), "{text}");
        }
        let of_depth = after.matches('▒').count();
        assert_eq!(of_depth, NEARNESS_COLS * NEARNESS_ROWS / 4, "the depth picture");
        assert!(live.ground.iter().any(|dots| *dots != 0), "obstacles");
        assert_ne!(before.find('◆'), after.find('◆'));
        assert!(before.contains("no verdict is unknown") && after.contains("0.950, threshold 0.800: ATTACK"));
    }

    #[test]
    fn a_small_terminal_keeps_score_step_and_state_and_loses_map_and_depth_picture_first() {
        let course = generate(Family::Validation, 7);
        let flying = Status {
            guidance: Some("guided".to_owned()),
            reasons: vec!["within distance of an obstacle".to_owned(); 2],
            slips: 12,
            ..status(Some(0.95), [5.0, 0.0, -1.5])
        };
        for (columns, rows, has_depth) in [(80, 24, true), (80, 0, true), (80, 12, false), (40, 24, false)] {
            let live = Live::new("validation course 7".to_owned(), &course, Some(0.8), columns, rows);
            let text = live.picture(&[], &flying);
            let height = |line: &str| line.chars().count().max(1).div_ceil(columns.into());
            let lines: usize = text.lines().map(height).sum();
            let fits = (19..25).contains(&lines) || rows == 12 && (7..13).contains(&lines);
            assert!(fits, "{columns} × {rows}: {lines}\n{text}");
            assert_eq!(text.contains('▒'), has_depth, "{columns} × {rows}");
        }
    }

    #[test]
    fn the_bar_marks_the_threshold() {
        let text = bar(0.5, Some(0.75));
        let counts = [text.chars().count(), text.matches('█').count()];
        assert_eq!(counts, [BAR, BAR / 2]);
        assert_eq!(text.chars().position(|c| c == '|'), Some(30));
    }
}
