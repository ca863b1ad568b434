//! A film of one flight as an animated picture or a video: the view from behind, the course from above, what the sensor saw and
//! what in it moved the actor, the detector's score, who flies, whether frames are altered.

mod encode;
mod picture;
mod third_person;

use crate::flight_derived::ExplainedReplay;
use crate::flight_report::{LogSeen, StepSeen, WHO};
use anyhow::{Context, Result};
pub use encode::{Gif, Video};
use picture::{Canvas, Colour, span};
use std::path::Path;
use third_person::{Seen, Stage};
use vigil_log::{LogEnd, Reader, SHAP_COLS, TickRecord};
use vigil_types::{Alarm, DEPTH_COLS, DEPTH_ROWS, GuidanceState, Judgement, NedVector};

/// Size of the film, pixels; even, as an mp4 needs it.
const WIDTH: usize = 640;
const HEIGHT: usize = 448;
/// The banner, then at the left the view from behind with the map below it.
const BANNER: usize = 26;
const VIEW_WIDTH: usize = 358;
const VIEW_HEIGHT: usize = 208;
const MAP_TOP: usize = BANNER + VIEW_HEIGHT + 2;
/// Where the right column begins.
const RIGHT: usize = VIEW_WIDTH + 14;
/// Left, top, width and height of the detector's score.
const SCORE: [usize; 4] = [RIGHT, BANNER + 2 + 2 * (DEPTH_ROWS + 4 + LINE) + LINE, 256, 26];
/// A line of text, and the width of a letter.
const LINE: usize = 16;
const LETTER: usize = 7;
/// A picture of the film is shown so long, hundredths of a second.
const PICTURE_CS: u16 = 10;
/// The last one is shown so long.
const LAST_CS: u16 = 250;
/// Steps of the loop in a second.
const STEPS_A_SECOND: f64 = 20.0;
/// A film is never of more pictures: a longer flight is shown faster.
const MOST_PICTURES: usize = 200;
/// So much of the path is shown in the view from behind, steps.
const TRAIL_STEPS: usize = 160;
/// Pixels weaker than this share of the strongest are not marked.
const WEAK: f32 = 0.12;

/// Takes a picture that is shown for so many hundredths of a second.
pub type Take<'a> = &'a mut dyn FnMut(&Canvas, u16) -> Result<()>;

/// The number of a film's pictures, and why they are not all of the flight where they are not.
pub type Filmed = (usize, Option<String>);

/// Films the log at `path`: `speed` seconds of flight in a second, a banner with the title and who flies; at most so many pictures get their
/// pixels `explained`, evenly over the film, the others show the last explanation.
///
/// # Errors
/// A log that cannot be read, a flight that never took off, what takes no more pictures.
pub fn film(path: &Path, (speed, title): (f64, &str), explained: usize, take: Take<'_>) -> Result<Filmed> {
    let log = LogSeen::read(path)?;
    let (first, last) = shown(&log)
        .context("the vehicle never took off in this log: there is nothing to film; `vigil log report` says why")?;
    let stride = (speed * STEPS_A_SECOND * f64::from(PICTURE_CS) / 100.0)
        .round()
        .max(1.0) as usize;
    let stride = stride.max((last - first).div_ceil(MOST_PICTURES - 1));

    let scene = Scene::of(&log, first, last);
    let background = scene.background(&log);
    let mut stage = Stage::new(&log.story.solids, log.goal_ned_m());
    let mut reader = Reader::open(path)?;
    let mut explaining = Explaining::of(&reader, explained, (last - first).div_ceil(stride));
    let mut record = Box::<TickRecord>::default();
    let mut depth = None;
    let mut pictures = 0;
    for number in 0..=last {
        // The same records were read before.
        if !reader.read_next(&mut record)? {
            break;
        }
        let due = number >= first && ((number - first).is_multiple_of(stride) || number == last);
        explaining.see(&record, due);
        if !due {
            continue;
        }
        if let Some(frame) = record.frame() {
            half_size(&frame.depth, depth.get_or_insert_default());
        }
        let mut canvas = background.clone();
        let so_far = (first, number);
        scene.view(&mut canvas, &mut stage, &log, so_far);
        scene.draw_path(&mut canvas, &log, so_far);
        draw_banner(&mut canvas, &log, number, title);
        scene.draw_score(&mut canvas, &log, so_far);
        scene.draw_state(&mut canvas, &log, number);
        let altered = log.is_altered(&log.steps[number]);
        eyes(&mut canvas, depth.as_deref(), &explaining, altered);
        let delay = if number == last { LAST_CS } else { PICTURE_CS };
        take(&canvas, delay)?;
        pictures += 1;
    }
    let interrupted = log.end.filter(|end| matches!(end, LogEnd::Interrupted { .. }));
    Ok((pictures, log.damage.or_else(|| interrupted.map(|end| end.to_string()))))
}

/// Explains what the actor was shown, now and then.
struct Explaining {
    /// Or why nothing is explained.
    with: Result<ExplainedReplay, &'static str>,
    /// Every so many pictures.
    every: usize,
    pictures: usize,
    /// The last explanation, as shares of its strongest pixels: positive turned the vehicle right.
    shares: Option<Vec<f32>>,
}

impl Explaining {
    fn of(log: &Reader, most: usize, pictures: usize) -> Self {
        let with = match most {
            0 => Err("not explained"),
            _ => ExplainedReplay::of(log).map_err(|_| "no actor of this program flew"),
        };
        Self {
            with,
            every: pictures.div_ceil(most.max(1)).max(1),
            pictures: 0,
            shares: None,
        }
    }

    fn see(&mut self, record: &TickRecord, due: bool) {
        let Ok(replay) = &mut self.with else { return };
        replay.step(record);
        if !due {
            return;
        }
        self.pictures += 1;
        if !(self.pictures - 1).is_multiple_of(self.every) {
            return;
        }
        if let Ok(Some(sums)) = replay.squares() {
            let sizes: Vec<f64> = sums.iter().map(|v| f64::from(v.abs())).collect();
            let full = crate::statistics::quantile(&sizes, 0.99).unwrap_or(1.0).max(1e-9) as f32;
            self.shares = Some(sums.iter().map(|v| v / full).collect());
        }
    }
}

/// What the sensor saw, and what in it moved the actor's yaw.
fn eyes(canvas: &mut Canvas, depth: Option<&[u8]>, explaining: &Explaining, altered: bool) {
    let (left, top) = (RIGHT, BANNER + 4 + LINE);
    let below = top + DEPTH_ROWS + 4 + LINE;
    let Some(depth) = depth else {
        canvas.text(left + 60, top + 56, "no frames in the log", Colour::SOFT);
        return;
    };
    let draw = |canvas: &mut Canvas, top: usize, shade: &dyn Fn(usize, usize, u8) -> u8| {
        for (i, grey) in depth.iter().enumerate() {
            let (row, col) = (i / (DEPTH_COLS / 2), i % (DEPTH_COLS / 2));
            canvas.rectangle(left + 2 * col, top + 2 * row, 2, 2, shade(row, col, *grey));
        }
    };
    draw(canvas, top, &|_, _, grey| Colour::GREY + grey);
    match &explaining.shares {
        // Half as bright, so that the colours stand out.
        Some(shares) => draw(canvas, below, &|row, col, grey| {
            let share = shares.get(row / 2 * SHAP_COLS + col / 2).copied().unwrap_or(0.0);
            let strength = (4.0 * (share.abs() - WEAK) / (1.0 - WEAK)).clamp(0.0, 3.0) as u8;
            match share {
                share if share > WEAK => Colour::RIGHT + strength,
                share if share < -WEAK => Colour::LEFT + strength,
                _ => Colour::GREY + grey / 2,
            }
        }),
        None => {
            let why = explaining.with.as_ref().err().copied();
            canvas.text(left + 4, below + 56, why.unwrap_or_default(), Colour::SOFT);
        }
    }
    if altered {
        canvas.frame(left - 2, top - 2, DEPTH_COLS + 4, DEPTH_ROWS + 4, Colour::ATTACK);
    }
}

/// From a moment before guidance flies to its end.
fn shown(log: &LogSeen) -> Option<(usize, usize)> {
    let flies = |s: &StepSeen| matches!(s.report.state, GuidanceState::Guided | GuidanceState::Hold);
    let from = log.steps.iter().position(flies).filter(|_| log.took_off())?;
    let to = log.steps.iter().rposition(flies)?;
    // What comes after the flight's end, where that is known, is a wreck on the ground.
    let ended = log
        .ended_ns()
        .and_then(|ns| log.steps.iter().position(|s| s.now_ns >= ns));
    Some((from.saturating_sub(6), ended.unwrap_or(to).max(from)))
}

/// The nearest of each four pixels in eight greys: the noise of single pixels would only swell the film.
fn half_size(depth: &[f32], to: &mut Vec<u8>) {
    to.resize(DEPTH_COLS / 2 * DEPTH_ROWS / 2, 0);
    let range = |row: usize, col: usize| depth.get(row * DEPTH_COLS + col).copied().unwrap_or(1.0);
    for (i, value) in to.iter_mut().enumerate() {
        let (row, col) = (2 * (i / (DEPTH_COLS / 2)), 2 * (i % (DEPTH_COLS / 2)));
        let mut four = [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(down, right)| range(row + down, col + right));
        four.sort_by(f32::total_cmp);
        let grey = vigil_tools::cli::output::range_grey(0.5 * (four[1] + four[2]))[0];
        *value = grey / 32;
    }
}

/// The course and how it is laid onto the map.
struct Scene {
    /// North and east of the map's upper left corner, metres; pixels in a metre. North is to the right, east is down.
    origin: (f32, f32),
    scale: f32,
    alarms: Vec<usize>,
    threshold: Option<f32>,
}

impl Scene {
    fn of(log: &LogSeen, first: usize, last: usize) -> Self {
        let positions = log.steps[first..=last]
            .iter()
            .filter_map(|s| s.report.telemetry.kinematics);
        let mut points: Vec<(f32, f32)> = positions.map(|k| (k.position_ned_m.x, k.position_ned_m.y)).collect();
        points.extend(log.story.solids.iter().map(|solid| {
            let ([north, east, _], ..) = solid.parts();
            (north, east)
        }));
        points.extend(log.goal_ned_m().map(|g| (g.x, g.y)));
        points.retain(|(n, e)| n.is_finite() && e.is_finite());
        if points.is_empty() {
            points = vec![(0.0, 0.0), (1.0, 1.0)];
        }
        let ((n0, n1), (e0, e1)) = (span(points.iter().map(|p| p.0)), span(points.iter().map(|p| p.1)));
        let margin = 1.5;
        let (length, width) = (n1 - n0 + 2.0 * margin, e1 - e0 + 2.0 * margin);
        let scale = (VIEW_WIDTH as f32 / length).min((HEIGHT - MAP_TOP) as f32 / width);
        let over_n = VIEW_WIDTH as f32 / scale - length;
        let over_e = (HEIGHT - MAP_TOP) as f32 / scale - width;
        Self {
            origin: (n0 - margin - 0.5 * over_n, e0 - margin - 0.5 * over_e),
            scale,
            alarms: log.alarms(),
            threshold: log.threshold(),
        }
    }

    /// Pixels of a place.
    fn at(&self, north: f32, east: f32) -> (f32, f32) {
        let x = (north - self.origin.0) * self.scale;
        let y = (east - self.origin.1) * self.scale;
        (x, MAP_TOP as f32 + y)
    }

    fn background(&self, log: &LogSeen) -> Canvas {
        let mut canvas = Canvas::new(WIDTH, HEIGHT, Colour::PAPER);
        for solid in &log.story.solids {
            let corners = crate::flight_report::outline_of(solid);
            let corners: Vec<(f32, f32)> = corners.iter().map(|[n, e]| self.at(*n as f32, *e as f32)).collect();
            canvas.polygon(&corners, Colour::SOLID);
        }
        if let Some(goal) = log.goal_ned_m() {
            let centre = self.at(goal.x, goal.y);
            canvas.ring(centre, self.scale, 2.0, Colour::GOAL);
            canvas.disc(centre, 3.0, Colour::GOAL);
        }
        canvas.rectangle(0, 0, WIDTH, MAP_TOP, Colour::PAPER);
        canvas.rectangle(VIEW_WIDTH, BANNER, WIDTH - VIEW_WIDTH, HEIGHT - BANNER, Colour::PAPER);
        canvas.rectangle(VIEW_WIDTH + 2, BANNER, 1, HEIGHT - BANNER, Colour::LINE);
        let mut y = BANNER + 2;
        canvas.text(RIGHT, y, "what the sensor saw", Colour::SOFT);
        y += DEPTH_ROWS + 4 + LINE;
        canvas.text(RIGHT, y, "moved the yaw: orange right, blue left", Colour::SOFT);
        y += DEPTH_ROWS + 4 + LINE;
        canvas.text(RIGHT, y, "score of the detector", Colour::SOFT);
        canvas
    }

    fn colour(who: u8) -> u8 {
        match WHO.get(usize::from(who)).copied() {
            Some("actor" | "geometric pilot") => Colour::ACTOR,
            Some("recovery pilot") => Colour::RECOVERY,
            Some("hold") => Colour::HOLD,
            _ => Colour::SOFT,
        }
    }

    /// The view from behind; until a pose is known it stays empty.
    fn view(&self, canvas: &mut Canvas, stage: &mut Stage, log: &LogSeen, (first, now): (usize, usize)) {
        let trail: Vec<(NedVector, u8)> = log.steps[first.max(now.saturating_sub(TRAIL_STEPS))..=now]
            .iter()
            .step_by(2)
            .filter_map(|s| Some((s.position_ned_m()?, Self::colour(log.who(&s.report)))))
            .collect();
        let step = &log.steps[now];
        let attitude = step.report.telemetry.attitude.map(|a| a.attitude);
        if let (Some(position_ned_m), Some(attitude)) = (step.position_ned_m(), attitude.filter(|a| a.is_valid())) {
            let seen = Seen {
                position_ned_m,
                attitude,
                trail: &trail,
                colour: Self::colour(log.who(&step.report)),
            };
            stage.draw(canvas, [0, BANNER, VIEW_WIDTH, VIEW_HEIGHT], &seen);
        }
    }

    /// The way flown so far, alarms, and the vehicle.
    fn draw_path(&self, canvas: &mut Canvas, log: &LogSeen, (first, now): (usize, usize)) {
        let step = &log.steps[now];
        let place = |s: &StepSeen| s.position_ned_m().map(|p| self.at(p.x, p.y));
        // What was flown so far: wide below where frames were altered, in the colour of who flew above.
        let flown = &log.steps[first..=now];
        let ways = || {
            flown
                .windows(2)
                .filter_map(|pair| Some((place(&pair[0])?, place(&pair[1])?, &pair[1])))
        };
        for (a, b, _) in ways().filter(|(.., step)| log.is_altered(step)) {
            canvas.line(a, b, 9.0, Colour::ATTACK_PALE);
        }
        for (a, b, step) in ways() {
            canvas.line(a, b, 3.0, Self::colour(log.who(&step.report)));
        }
        for alarm in self.alarms.iter().filter(|i| (first..=now).contains(*i)) {
            if let Some(centre) = log.steps.get(*alarm).and_then(place) {
                canvas.ring(centre, 7.0, 2.0, Colour::ATTACK);
            }
        }
        if let (Some((x, y)), Some(attitude)) = (place(step), step.report.telemetry.attitude) {
            let (sin, cos) = attitude.attitude.yaw_rad().sin_cos();
            let turned = |(ahead, right): (f32, f32)| (x + ahead * cos - right * sin, y + ahead * sin + right * cos);
            let arrow = [(9.0, 0.0), (-6.0, 6.0), (-3.0, 0.0), (-6.0, -6.0)].map(turned);
            canvas.polygon(&arrow, Colour::INK);
        }
    }

    /// The score over the last 10 s, and below it what moved the yaw.
    fn draw_score(&self, canvas: &mut Canvas, log: &LogSeen, (first, now): (usize, usize)) {
        let [left, top, width, height] = SCORE;
        canvas.frame(left - 1, top - 1, width + 2, height + 2, Colour::LINE);
        if let Some(threshold) = self.threshold {
            let y = top + ((1.0 - threshold) * (height - 1) as f32) as usize;
            for x in (0..width).step_by(6) {
                canvas.rectangle(left + x, y, 3, 1, Colour::SOFT);
            }
        }
        let mut before = None;
        for x in 0..width {
            let back = (width - 1 - x) * 200 / width;
            let at = now.checked_sub(back).filter(|i| *i >= first);
            let Some(step) = at.and_then(|i| log.steps.get(i)) else {
                continue;
            };
            let score = step.report.judgement.and_then(|j| j.score);
            let down = |s: f32| top as f32 + (1.0 - s.clamp(0.0, 1.0)) * (height - 1) as f32;
            let point = score.map(|s| ((left + x) as f32, down(s)));
            if let (Some(a), Some(b)) = (before, point) {
                let is_above = self.threshold.is_some_and(|t| score > Some(t));
                canvas.line(a, b, 2.0, if is_above { Colour::ATTACK } else { Colour::ACTOR });
            }
            before = point;
        }
        if log.info.detector_sha256.is_none() {
            canvas.text(left + 90, top + 6, "no detector", Colour::SOFT);
        }
        if let Some(judgement) = log.steps[now].report.judgement {
            causes(canvas, (left, top + height + 3), &judgement);
        }
    }

    /// Who flies, in words, and how it ended.
    fn draw_state(&self, canvas: &mut Canvas, log: &LogSeen, now: usize) {
        let (step, left) = (&log.steps[now], RIGHT);
        let who = log.who(&step.report);
        let y = HEIGHT - 2 * LINE + 2;
        canvas.rectangle(left, y, 14, 12, Self::colour(who));
        canvas.text(left + 22, y, &state_words(who, step.report.alarm), Colour::INK);
        let ended = log.story.about.get("outcome").filter(|_| {
            // In lockstep the log ends with the flight.
            log.ended_ns()
                .map_or(now + 1 == log.steps.len(), |ns| step.now_ns >= ns)
        });
        if let Some(outcome) = ended {
            let good = outcome.starts_with("success");
            let colour = if good { Colour::GOAL } else { Colour::ATTACK };
            canvas.text(left, y + LINE, outcome, colour);
        }
    }
}

/// The title, the log's time, and whether the frames are altered.
fn draw_banner(canvas: &mut Canvas, log: &LogSeen, now: usize, title: &str) {
    let step = &log.steps[now];
    let (on, below, end, state) = match log.is_altered(step) {
        true => (Colour::PAPER, Colour::ATTACK, RIGHT, "ATTACK: frames altered"),
        false => (Colour::INK, Colour::BANNER, WIDTH - 66, ""),
    };
    canvas.rectangle(0, 0, WIDTH, BANNER - 2, below);
    canvas.text(8, 7, &cut(title, end - 8), on);
    canvas.text(RIGHT, 7, state, on);
    canvas.text(WIDTH - 58, 7, &format!("{:5.1} s", log.seconds(step.now_ns)), on);
}

/// As much of a text as fits into so many pixels.
fn cut(text: &str, width: usize) -> String {
    let letters = width / LETTER;
    match text.chars().count() > letters {
        true => text.chars().take(letters - 3).chain("...".chars()).collect(),
        false => text.to_owned(),
    }
}

/// Who flies, and the alarm that made it so: at most 35 letters, or the picture's edge cuts them.
fn state_words(who: u8, alarm: Option<Alarm>) -> String {
    let name = WHO[usize::from(who)];
    match alarm {
        Some(alarm) if who == 4 => format!("stopped: alarm, {}", alarm.cause.name()),
        Some(alarm) => format!("{name}: {}", alarm.cause.name()),
        None if who == 4 => "holds".to_owned(),
        None => format!("{name} flies"),
    }
}

/// How much picture, bearing, distance and own motion moved the actor's yaw output: a bar each, to the
/// right where they turned it right.
fn causes(canvas: &mut Canvas, (left, top): (usize, usize), judgement: &Judgement) {
    let parts = [
        ("picture", judgement.image),
        ("bearing", judgement.bearing),
        ("distance", judgement.distance),
        ("told", judgement.told),
    ];
    for (i, (name, value)) in parts.into_iter().enumerate() {
        let y = top + 12 * i;
        canvas.text(left, y, name, Colour::SOFT);
        let (middle, most) = (left + 160, 90.0);
        let length = (value.abs().min(1.5) / 1.5 * most) as usize;
        let (from, colour) = match value > 0.0 {
            true => (middle, Colour::RECOVERY),
            false => (middle - length, Colour::ACTOR),
        };
        canvas.rectangle(from, y + 3, length, 7, colour);
        canvas.rectangle(middle, y, 1, 12, Colour::LINE);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vigil_types::{AlarmCause, AlarmResponse};

    #[test]
    fn the_cause_of_an_alarm_is_read_to_its_last_letter_whoever_flies() {
        let response = AlarmResponse::Recovery;
        for who in 0..WHO.len() as u8 {
            for cause in AlarmCause::ALL {
                let words = state_words(who, Some(Alarm { cause, response }));
                assert!(RIGHT + 22 + LETTER * words.len() <= WIDTH, "{words}");
            }
        }
        let fits = ["Wall", "Hall of columns"].map(|title| cut(title, 15 * LETTER));
        assert_eq!(fits, ["Wall", "Hall of columns"]);
        assert_eq!(cut("Hall of columns", 14 * LETTER), "Hall of col...");
    }
}
