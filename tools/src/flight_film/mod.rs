//! A film of one flight as an animated picture: the course from above, what the sensor saw, the detector's score, who flies.

mod picture;

use crate::flight_report::{LogSeen, ReportError, StepSeen, WHO};
use gif::{DisposalMethod, Encoder, Frame, Repeat};
use picture::{Canvas, Colour, PALETTE};
use std::borrow::Cow;
use std::io::Write;
use std::path::Path;
use vigil_log::{Reader, SceneSolid, TickRecord};
use vigil_types::{DEPTH_COLS, DEPTH_ROWS, GuidanceState};

/// Size of the film, pixels.
const WIDTH: usize = 640;
const HEIGHT: usize = 330;
/// The map is a square at the left, below the banner.
const BANNER: usize = 26;
const MAP: usize = HEIGHT - BANNER;
/// Where the right column begins.
const RIGHT: usize = MAP + 14;
/// A picture of the film is shown so long, hundredths of a second.
const PICTURE_CS: u16 = 10;
/// The last one is shown so long.
const LAST_CS: u16 = 250;
/// Steps of the loop in a second.
const STEPS_A_SECOND: f64 = 20.0;
/// A film is never of more pictures: a longer flight is shown faster.
const MOST_PICTURES: usize = 260;

/// How to film.
#[derive(Debug, Clone, PartialEq)]
pub struct FilmOptions {
    /// Seconds of flight in a second of film.
    pub speed: f64,
    /// What stands in the banner besides who flies.
    pub title: String,
}

/// Why there is no film.
#[derive(Debug, thiserror::Error)]
pub enum FilmError {
    /// The log cannot be shown.
    #[error(transparent)]
    Log(#[from] ReportError),
    /// The vehicle never took off, or the log ends before it did.
    #[error("the vehicle never took off in this log: there is nothing to film; `vigil log report` says why")]
    NeverTookOff,
    /// The film cannot be encoded or written.
    #[error("the film cannot be written: {0}")]
    Encode(#[from] gif::EncodingError),
}

/// Films the log at `path` into `sink`. Returns the number of pictures.
///
/// # Errors
/// [`FilmError`]: a log that cannot be read, a flight that never took off, a sink that takes no more.
pub fn film(path: &Path, options: &FilmOptions, sink: impl Write) -> Result<usize, FilmError> {
    let log = LogSeen::read(path).map_err(ReportError::from)?;
    let steps = shown(&log);
    let (Some(first), Some(last)) = (steps.first().copied(), steps.last().copied()) else {
        return Err(FilmError::NeverTookOff);
    };
    let stride = (options.speed * STEPS_A_SECOND * f64::from(PICTURE_CS) / 100.0)
        .round()
        .max(1.0) as usize;
    let stride = stride.max((last - first).div_ceil(MOST_PICTURES));
    let palette: Vec<u8> = PALETTE.iter().flatten().copied().collect();
    let mut encoder = Encoder::new(sink, WIDTH as u16, HEIGHT as u16, &palette)?;
    encoder.set_repeat(Repeat::Infinite)?;

    let scene = Scene::of(&log, first, last);
    let background = scene.background(&log);
    let mut reader = Reader::open(path).map_err(ReportError::from)?;
    let mut record = Box::<TickRecord>::default();
    let mut shown: Option<Canvas> = None;
    let mut depth = vec![0_u8; DEPTH_COLS / 2 * DEPTH_ROWS / 2];
    let mut pictures = 0;
    for number in 0..=last {
        if !reader.read_next(&mut record).map_err(ReportError::from)? {
            break;
        }
        let due = number >= first && ((number - first).is_multiple_of(stride) || number == last);
        if !due {
            continue;
        }
        if let Some(frame) = record.frame() {
            half_size(&frame.depth, &mut depth);
        }
        let mut canvas = background.clone();
        scene.draw(&mut canvas, &log, (first, number), &depth, &options.title);
        let delay = if number == last { LAST_CS } else { PICTURE_CS };
        encoder.write_frame(&difference(shown.as_ref(), &canvas, delay))?;
        shown = Some(canvas);
        pictures += 1;
    }
    Ok(pictures)
}

/// From a moment before guidance flies to its end.
fn shown(log: &LogSeen) -> Vec<usize> {
    let flies = |s: &StepSeen| matches!(s.report.state, GuidanceState::Guided | GuidanceState::Hold);
    let from = log.steps.iter().position(flies);
    let to = log.steps.iter().rposition(flies);
    // What comes after the flight's end, where that is known, is a wreck on the ground.
    let ended_ns: Option<u64> = log.story.about.get("ended_ns").and_then(|text| text.parse().ok());
    let ended = ended_ns.and_then(|ns| log.steps.iter().position(|s| s.now_ns >= ns));
    match (from, to) {
        (Some(from), Some(to)) => (from.saturating_sub(6)..=ended.unwrap_or(to).max(from)).collect(),
        _ => Vec::new(),
    }
}

/// The nearest of each four pixels in eight greys: the noise of single pixels would only swell the film.
fn half_size(depth: &[f32], to: &mut [u8]) {
    let range = |row: usize, col: usize| depth.get(row * DEPTH_COLS + col).copied().unwrap_or(1.0);
    for (i, value) in to.iter_mut().enumerate() {
        let (row, col) = (2 * (i / (DEPTH_COLS / 2)), 2 * (i % (DEPTH_COLS / 2)));
        let mut four = [
            range(row, col),
            range(row, col + 1),
            range(row + 1, col),
            range(row + 1, col + 1),
        ];
        four.sort_by(f32::total_cmp);
        let grey = crate::cli::output::range_grey(0.5 * (four[1] + four[2]))[0];
        *value = grey / 32;
    }
}

/// What changed since the last picture, as the smallest rectangle around it; pixels in it that did not change are transparent.
fn difference(before: Option<&Canvas>, now: &Canvas, delay: u16) -> Frame<'static> {
    let whole = (0, 0, WIDTH, HEIGHT);
    let (left, top, right, bottom) = before.map_or(whole, |before| {
        let changed = || (0..WIDTH * HEIGHT).filter(|i| before.pixels[*i] != now.pixels[*i]);
        let (top, bottom) = (
            changed().next().map_or(0, |i| i / WIDTH),
            changed().next_back().map_or(0, |i| i / WIDTH),
        );
        let (left, right) = changed().fold((WIDTH - 1, 0), |(l, r), i| (l.min(i % WIDTH), r.max(i % WIDTH)));
        (left.min(right), top, right + 1, bottom + 1)
    });
    let mut buffer = Vec::with_capacity((right - left) * (bottom - top));
    for y in top..bottom {
        for x in left..right {
            let i = y * WIDTH + x;
            let same = before.is_some_and(|before| before.pixels[i] == now.pixels[i]);
            buffer.push(if same { Colour::TRANSPARENT } else { now.pixels[i] });
        }
    }
    Frame {
        delay,
        dispose: DisposalMethod::Keep,
        transparent: Some(Colour::TRANSPARENT),
        left: left as u16,
        top: top as u16,
        width: (right - left) as u16,
        height: (bottom - top) as u16,
        buffer: Cow::Owned(buffer),
        ..Frame::default()
    }
}

/// The course and how it is laid onto the map.
struct Scene {
    /// North and east of the map's lower left corner, metres; pixels in a metre.
    origin: (f32, f32),
    scale: f32,
    altered: std::collections::HashMap<u64, f32>,
    alarms: Vec<usize>,
    threshold: Option<f32>,
}

impl Scene {
    fn of(log: &LogSeen, first: usize, last: usize) -> Self {
        let positions = log.steps[first..=last]
            .iter()
            .filter_map(|s| s.report.telemetry.kinematics);
        let mut points: Vec<(f32, f32)> = positions.map(|k| (k.position_ned_m.x, k.position_ned_m.y)).collect();
        points.extend(log.story.solids.iter().map(|solid| match solid {
            SceneSolid::Cuboid { centre_ned_m, .. } | SceneSolid::Cylinder { centre_ned_m, .. } => {
                (centre_ned_m[0], centre_ned_m[1])
            }
        }));
        let goal = log
            .steps
            .iter()
            .rev()
            .find_map(|s| s.report.goal)
            .map(|g| g.position_ned_m);
        points.extend(goal.map(|g| (g.x, g.y)));
        points.retain(|(n, e)| n.is_finite() && e.is_finite());
        let span = |value: fn(&(f32, f32)) -> f32| {
            let values = || points.iter().map(value);
            let (least, most) = (
                values().fold(f32::INFINITY, f32::min),
                values().fold(f32::NEG_INFINITY, f32::max),
            );
            if least <= most { (least, most) } else { (0.0, 1.0) }
        };
        let ((n0, n1), (e0, e1)) = (span(|p| p.0), span(|p| p.1));
        let margin = 1.5;
        let side = (n1 - n0).max(e1 - e0) + 2.0 * margin;
        Self {
            origin: (0.5 * (n0 + n1 - side), 0.5 * (e0 + e1 - side)),
            scale: MAP as f32 / side,
            altered: log.altered().unwrap_or_default(),
            alarms: log.alarms(),
            threshold: log.threshold(),
        }
    }

    /// Pixels of a place.
    fn at(&self, north: f32, east: f32) -> (f32, f32) {
        let x = (east - self.origin.1) * self.scale;
        let y = HEIGHT as f32 - (north - self.origin.0) * self.scale;
        (x, y)
    }

    fn background(&self, log: &LogSeen) -> Canvas {
        let mut canvas = Canvas::new(WIDTH, HEIGHT, Colour::PAPER);
        for solid in &log.story.solids {
            let corners = crate::flight_report::outline_of(solid);
            let corners: Vec<(f32, f32)> = corners.iter().map(|[n, e]| self.at(*n as f32, *e as f32)).collect();
            canvas.polygon(&corners, Colour::SOLID);
        }
        if let Some(goal) = log.steps.iter().rev().find_map(|s| s.report.goal) {
            let centre = self.at(goal.position_ned_m.x, goal.position_ned_m.y);
            canvas.ring(centre, self.scale, 2.0, Colour::GOAL);
            canvas.disc(centre, 3.0, Colour::GOAL);
        }
        canvas.rectangle(0, 0, WIDTH, BANNER, Colour::PAPER);
        canvas.rectangle(MAP, BANNER, WIDTH - MAP, HEIGHT - BANNER, Colour::PAPER);
        canvas.rectangle(MAP + 2, BANNER, 1, HEIGHT - BANNER, Colour::LINE);
        canvas.text(RIGHT + 2, BANNER + 152, "score of the detector", Colour::SOFT);
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

    fn is_altered(&self, step: &StepSeen) -> bool {
        step.report
            .frame_sequence
            .is_some_and(|f| self.altered.contains_key(&f))
    }

    fn draw(&self, canvas: &mut Canvas, log: &LogSeen, (first, now): (usize, usize), depth: &[u8], title: &str) {
        let place = |s: &StepSeen| {
            let position = s
                .report
                .telemetry
                .kinematics
                .map(|k| k.position_ned_m)
                .filter(|p| p.is_finite());
            position.map(|p| self.at(p.x, p.y))
        };
        // What was flown so far: wide below where frames were altered, in the colour of who flew above.
        let flown = &log.steps[first..=now];
        for pair in flown.windows(2).filter(|pair| self.is_altered(&pair[1])) {
            if let (Some(a), Some(b)) = (place(&pair[0]), place(&pair[1])) {
                canvas.line(a, b, 9.0, Colour::ATTACK_PALE);
            }
        }
        for pair in flown.windows(2) {
            if let (Some(a), Some(b)) = (place(&pair[0]), place(&pair[1])) {
                canvas.line(a, b, 3.0, Self::colour(log.who(&pair[1].report)));
            }
        }
        let step = &log.steps[now];
        for alarm in self.alarms.iter().filter(|i| (first..=now).contains(*i)) {
            if let Some(centre) = log.steps.get(*alarm).and_then(place) {
                canvas.ring(centre, 7.0, 2.0, Colour::ATTACK);
            }
        }
        if let (Some((x, y)), Some(attitude)) = (place(step), step.report.telemetry.attitude) {
            let (sin, cos) = attitude.attitude.yaw_rad().sin_cos();
            let turned = |(ahead, right): (f32, f32)| (x + ahead * sin + right * cos, y - ahead * cos + right * sin);
            let arrow = [(9.0, 0.0), (-6.0, 6.0), (-3.0, 0.0), (-6.0, -6.0)].map(turned);
            canvas.polygon(&arrow, Colour::INK);
        }

        // Banner: who flies, and whether the frames are altered.
        let who = log.who(&step.report);
        let altered = self.is_altered(step);
        canvas.rectangle(
            0,
            0,
            WIDTH,
            BANNER - 2,
            if altered { Colour::ATTACK } else { Colour::BANNER },
        );
        let on = if altered { Colour::PAPER } else { Colour::INK };
        let time = log.seconds(step.now_ns) - log.seconds(log.steps[first].now_ns);
        canvas.text(8, 7, title, on);
        let state = match altered {
            true => "ATTACK: frames altered",
            false => "",
        };
        canvas.text(RIGHT + 2, 7, state, on);
        canvas.text(WIDTH - 58, 7, &format!("{time:5.1} s"), on);

        // What it saw.
        let (left, top) = (RIGHT + 2, BANNER + 6);
        for (i, grey) in depth.iter().enumerate() {
            let (row, col) = (2 * (i / (DEPTH_COLS / 2)), 2 * (i % (DEPTH_COLS / 2)));
            canvas.rectangle(left + col, top + row, 2, 2, Colour::GREY + grey);
        }
        if altered {
            canvas.frame(left - 2, top - 2, DEPTH_COLS + 4, DEPTH_ROWS + 4, Colour::ATTACK);
        } // The score over the last 10 s.
        let (left, top, width, height) = (RIGHT + 2, BANNER + 168, 256, 60);
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
            let Some(step) = now
                .checked_sub(back)
                .filter(|i| *i >= first)
                .and_then(|i| log.steps.get(i))
            else {
                continue;
            };
            let score = step.report.judgement.and_then(|j| j.score);
            let point = score.map(|s| {
                (
                    (left + x) as f32,
                    top as f32 + (1.0 - s.clamp(0.0, 1.0)) * (height - 1) as f32,
                )
            });
            if let (Some(a), Some(b)) = (before, point) {
                canvas.line(
                    a,
                    b,
                    2.0,
                    if self.threshold.is_some_and(|t| score > Some(t)) {
                        Colour::ATTACK
                    } else {
                        Colour::ACTOR
                    },
                );
            }
            before = point;
        }
        if log.info.detector_sha256.is_none() {
            canvas.text(left + 90, top + 24, "no detector", Colour::SOFT);
        }

        // Who flies, in words.
        let y = top + height + 12;
        canvas.rectangle(left, y, 14, 12, Self::colour(who));
        let words = match step.report.alarm {
            Some(alarm) if who == 4 => format!("stopped: alarm ({})", alarm.cause.name()),
            Some(alarm) => format!("{} flies: alarm ({})", WHO[usize::from(who)], alarm.cause.name()),
            None if who == 4 => "holds".to_owned(),
            None => format!("{} flies", WHO[usize::from(who)]),
        };
        canvas.text(left + 22, y, &words, Colour::INK);
        let ended = log.story.about.get("outcome").filter(|_| {
            let ended_ns = log
                .story
                .about
                .get("ended_ns")
                .and_then(|text| text.parse::<u64>().ok());
            // In lockstep the log ends with the flight.
            ended_ns.map_or(now + 1 == log.steps.len(), |ns| step.now_ns >= ns)
        });
        if let Some(outcome) = ended {
            let good = outcome.starts_with("success");
            canvas.text(left, y + 20, outcome, if good { Colour::GOAL } else { Colour::ATTACK });
        }
    }
}
