//! The tables and figures: what each shows, which data it needs, and how it is made of them.

use super::data::Sources;
use crate::attack_campaigns::{self as attack, Arm};
use crate::campaign::Tally;
use crate::cli::detector::{TimesReport, roc};
use crate::cli::figures::{ExplanationLine, Pixels, figure_12, figure_13, figure_14};
use crate::cli::report as training;
use crate::detector_training::{Proportion, Report, Role, TableRow, auc, true_positives_at};
use crate::report::{Bar, BarRow, Bars, Figure, Panel, Picture, Scale, Series, from_csv};
use crate::statistics::quantile;
use anyhow::{Context, Result};
use serde::Deserialize;
use std::collections::BTreeMap;
use vigil_adversary::Method;
use vigil_sim::world::Outcome;
use vigil_types::YAW_RATE_PER_UNIT_RAD_S;

/// A table or a figure.
pub struct Item {
    pub id: &'static str,
    pub title: &'static str,
    /// The units of data that it needs.
    pub units: &'static [&'static str],
    make: fn(&Sources) -> Result<Made>,
}

/// A figure's two files.
pub struct Drawn {
    pub svg: String,
    pub png: Vec<u8>,
}

/// A table: headings, and rows as wide.
pub struct Grid {
    pub columns: Vec<String>,
    pub rows: Vec<Vec<String>>,
}

impl Grid {
    /// Without rows; a bar between two headings.
    fn new(columns: &str) -> Self {
        Self {
            columns: columns.split(" | ").map(str::to_owned).collect(),
            rows: Vec::new(),
        }
    }

    fn row(&mut self, cells: impl IntoIterator<Item = String>) {
        let row: Vec<String> = cells.into_iter().collect();
        debug_assert_eq!(row.len(), self.columns.len());
        self.rows.push(row);
    }
}

/// An item made of data.
pub struct Made {
    pub figure: Option<Drawn>,
    /// Ours beside the paper's.
    pub table: Grid,
    pub caption: String,
}

/// A table without a figure, or the figure and the table of a picture.
fn made(figure: Option<Drawn>, table: Grid, caption: impl Into<String>) -> Result<Made> {
    Ok(Made {
        figure,
        table,
        caption: caption.into(),
    })
}

fn drawn(picture: &impl Picture) -> Option<Drawn> {
    Some(Drawn {
        svg: picture.svg(),
        png: picture.png(),
    })
}

impl Item {
    /// Makes it.
    ///
    /// # Errors
    /// Data that are missing, damaged or of something else.
    pub fn make(&self, sources: &Sources) -> Result<Made> {
        (self.make)(sources).with_context(|| format!("{} cannot be made", self.id))
    }
}

const fn item(
    id: &'static str,
    make: fn(&Sources) -> Result<Made>,
    units: &'static [&'static str],
    title: &'static str,
) -> Item {
    Item { id, title, units, make }
}

/// In the order of the page: the paper's, then ours.
pub const ITEMS: [Item; 16] = [
    item(
        "table-1",
        table_1,
        &["training-runs", "attack-completion"],
        "Table I: training with and without the potential field, completion of validation courses",
    ),
    item(
        "table-2",
        table_2,
        &["attack-deflection"],
        "Table II: yaw deflection in front of a wall",
    ),
    item(
        "table-3",
        table_3,
        &["detector-table"],
        "Table III: detection by four detectors on the same states",
    ),
    item(
        "table-4",
        table_4,
        &["detector-times"],
        "Table IV: time of deciding, explaining and judging",
    ),
    item(
        "figure-9",
        figure_9,
        &["training-runs"],
        "Figure 9: reward of the training flights",
    ),
    item(
        "figure-10",
        figure_10,
        &["training-runs"],
        "Figure 10: share of the last ten training flights that reached the goal",
    ),
    item(
        "figure-11",
        figure_11,
        &["attack-table"],
        "Figure 11: states deceived, and deflection of the yaw, over the strength of the attack",
    ),
    item(
        "figure-12",
        pixels_of_a_flight,
        &["explained"],
        "Figure 12: depth frames and the SHAP values of their pixels",
    ),
    item(
        "figure-13",
        contributions,
        &["explained-attacked"],
        "Figure 13: SHAP values of image, bearing and distance over an attacked flight",
    ),
    item(
        "figure-14",
        sum_and_action,
        &["explained-attacked"],
        "Figure 14: the sum of the SHAP values against the action",
    ),
    item(
        "attacked-completion",
        attacked_completion,
        &["attack-completion"],
        "Completion under short attacks, with and without the potential field",
    ),
    item(
        "roc",
        detection,
        &["detector-evaluate"],
        "Receiver operating characteristic of LSTM-AD, by attack",
    ),
    item(
        "alarm-delay",
        alarm_delay,
        &["detector-evaluate"],
        "How soon LSTM-AD notices an attack, and forgets it",
    ),
    item(
        "defences",
        defences,
        &[
            "defended-100",
            "defended-continuous",
            "defended-adaptive",
            "defended-adaptive-unguarded",
        ],
        "Attackers against defences",
    ),
    item(
        "families",
        families,
        &["family-training", "family-validation", "family-dense", "family-hard"],
        "Completion by course family, whole stack",
    ),
    item("peers", peers, &["peers"], "Time of other programs for the same work"),
];

/// No number of the paper's.
const NONE: &str = "—";

fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share)
}

/// How many of some flights came there, with the interval, the paper's share and how the others ended.
fn outcomes(tally: &Tally, paper: &str) -> [String; 6] {
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

fn between((low, high): (f64, f64)) -> String {
    format!("{:.1} to {:.1} %", 100.0 * low, 100.0 * high)
}

fn share_of(p: &Proportion) -> [String; 2] {
    match p.share {
        Some(share) => [
            format!("{} of {} ({})", p.count, p.of, percent(share)),
            between(p.interval),
        ],
        None => [NONE.to_owned(), NONE.to_owned()],
    }
}

fn optional(value: Option<f64>, write: impl Fn(f64) -> String) -> String {
    value.map_or_else(|| NONE.to_owned(), write)
}

fn arms(sources: &Sources) -> Result<Vec<training::Arm>> {
    training::arms(&sources.of("training-runs").folders("training-runs")?)
}

fn table_1(sources: &Sources) -> Result<Made> {
    let mut table =
        Grid::new("training | completed without the field | 95 % interval | the paper | decisions | the paper's steps");
    for arm in arms(sources)? {
        let (paper, steps) = match arm.name {
            "DDPG" => ("80 %", "27 456"),
            _ => ("97 %", "24 012"),
        };
        for run in arm.tests() {
            table.row([
                format!("{}, seed {}", arm.name, run.seed),
                format!("{} of {} ({})", run.successes, run.flights, percent(run.completion)),
                between(run.interval),
                NONE.to_owned(),
                run.decisions.to_string(),
                NONE.to_owned(),
            ]);
        }
        let (mean, half) = arm.mean();
        table.row([
            format!("{}, mean of {} seeds", arm.name, arm.tests().count()),
            percent(mean),
            optional(half, |half| between((mean - half, (mean + half).min(1.0)))),
            paper.to_owned(),
            NONE.to_owned(),
            steps.to_owned(),
        ]);
    }
    let completion: attack::CompletionReport = sources.of("attack-completion").json("attack-completion")?;
    for row in completion.rows.iter().filter(|row| row.attack.is_none()) {
        let (field, paper) = if row.apf { ("on", "97 %") } else { ("off", NONE) };
        let cells = outcomes(&row.tally, paper).into_iter().take(3);
        let name = format!("the actor that is built in, field {field}");
        table.row([name].into_iter().chain(cells).chain([NONE, NONE].map(str::to_owned)));
    }
    made(
        None,
        table,
        "Ten training runs from nothing, each tested on 200 validation courses that nothing was chosen by, flown without the \
                  field; intervals of single runs are Wilson's, of means Student's over the seeds. A decision is 0.2 s of flight, a \
                  step of the paper's about 0.5 s. The actor that is built in was tested on the courses of the attacks.",
    )
}

fn table_2(sources: &Sources) -> Result<Made> {
    let report: attack::DeflectionReport = sources.of("attack-deflection").json("attack-deflection")?;
    let mut bearings: Vec<f32> = Vec::new();
    for cell in &report.cells {
        if !bearings.contains(&cell.bearing_deg) {
            bearings.push(cell.bearing_deg);
        }
    }
    let mut table = Grid {
        columns: ["attack", "gap to the wall"].map(str::to_owned).into(),
        rows: Vec::new(),
    };
    table.columns.extend(bearings.iter().map(|b| format!("goal at {b}°")));
    table
        .columns
        .extend(["mean", "95 % interval of the mean", "the paper"].map(str::to_owned));
    for block in report.cells.chunks(bearings.len().max(1)) {
        let values: Vec<f64> = block.iter().map(|cell| f64::from(cell.deflection_deg_s)).collect();
        let (mean, half) = training::mean_and_interval(&values);
        let (gap_m, method) = (block[0].gap_m, block[0].method);
        let paper = attack::PAPER_DEFLECTION.iter().find(|(gap, _)| *gap == gap_m);
        let mut row = vec![method.name().to_owned(), format!("{gap_m} m")];
        row.extend(values.iter().map(|value| format!("{value:.0}")));
        row.push(format!("{mean:.0} °/s"));
        row.push(optional(half, |half| {
            format!("{:.0} to {:.0} °/s", mean - half, mean + half)
        }));
        row.push(match (paper, method) {
            (Some((_, value)), Method::BimAccumulating) => format!("{value:.0} °/s"),
            _ => NONE.to_owned(),
        });
        table.rows.push(row);
    }
    made(
        None,
        table,
        format!(
            "Mean absolute change of the yaw decision, °/s, hovering before a wall {} m wide, goal {} m away; ε = {}/255, {} \
             iterations, {} states a cell. The interval is Student's over the bearings, taken as independent. The paper's attack \
             is the accumulating one.",
            report.wall_width_m, report.goal_distance_m, report.epsilon_255, report.iterations, report.states_per_cell
        ),
    )
}

#[derive(Deserialize)]
struct DetectorTable {
    learned_from: usize,
    rows: Vec<TableRow>,
}

fn table_3(sources: &Sources) -> Result<Made> {
    let report: DetectorTable = sources.of("detector-table").json("detector-table")?;
    let mut table =
        Grid::new("detector | accuracy | 95 % interval | the paper | attacked states found | false alarms | AUC");
    for row in &report.rows {
        let s = &row.separation;
        let [accuracy, interval] = share_of(&s.accuracy);
        table.row([
            row.detector.clone(),
            accuracy,
            interval,
            format!("{:.0} %", 100.0 * row.paper),
            optional(s.detected.share, percent),
            optional(s.false_alarms.share, percent),
            format!("{:.4}", s.auc),
        ]);
    }
    made(
        None,
        table,
        format!(
            "Right verdicts on unaltered and attacked states met on validation courses, half of each. The image detectors learned from \
             {} states; LSTM-AD is the one that flies, at the threshold that it flies with. Wilson's intervals.",
            report.learned_from
        ),
    )
}

fn table_4(sources: &Sources) -> Result<Made> {
    let report: TimesReport = sources.of("detector-times").json("detector-times")?;
    let mut table = Grid::new("part of the step | median | 99 % of the times below | the paper | measured");
    for row in &report.rows {
        let ms = |seconds: f64| format!("{:.3} ms", 1e3 * seconds);
        table.row([
            row.part.clone(),
            optional(row.median_s, ms),
            optional(row.p99_s, ms),
            format!("{:.0} ms", 1e3 * row.paper_s),
            row.measured.to_string(),
        ]);
    }
    made(
        None,
        table,
        format!(
            "One thread, {} instructions, on the states of one flight over validation course {}. Times move with the machine and its \
             other work; the step has 50 ms.",
            report.isa, report.seed
        ),
    )
}

/// A rolling mean of the training flights over the seeds, and where it ended.
fn training_curve(sources: &Sources, curve: &training::Curve, heading: &str, caption: &str) -> Result<Made> {
    let arms = arms(sources)?;
    let mut table = Grid::new(&format!("training | {heading} | 95 % interval | the paper"));
    for arm in &arms {
        let last = curve.last(arm);
        let (mean, half) = training::mean_and_interval(&last);
        table.row([
            format!("{}, {} seeds", arm.name, last.len()),
            format!("{mean:.2}"),
            optional(half, |half| format!("{:.2} to {:.2}", mean - half, mean + half)),
            "a figure without numbers".to_owned(),
        ]);
    }
    made(drawn(&curve.figure(&arms)), table, caption)
}

fn figure_9(sources: &Sources) -> Result<Made> {
    training_curve(
        sources,
        &training::REWARDS,
        "reward of the last 20 flights",
        "Rolling mean of the training flights' reward; lines are means over the seeds, bands reach from the least to the \
         greatest of them. Flights of the warm-up, which noise flies, are left out. Interval: Student's over the seeds.",
    )
}

fn figure_10(sources: &Sources) -> Result<Made> {
    training_curve(
        sources,
        &training::SUCCESSES,
        "share of the last 10 flights",
        "Training flights have noise, and a quarter of those of DDPG-APF the field; bands reach from the least to the greatest \
         of the seeds. Interval: Student's over the seeds, of which an end may lie beyond 1.",
    )
}

fn figure_11(sources: &Sources) -> Result<Made> {
    let lines: Vec<attack::StrengthLine> =
        from_csv(&sources.of("attack-table").text("attack-table", ".csv")?).context("figure-11.csv is not ours")?;
    let mut iterations: Vec<u32> = lines.iter().map(|line| line.iterations).collect();
    iterations.sort_unstable();
    iterations.dedup();
    let mut sizes: Vec<f64> = lines.iter().map(|line| f64::from(line.epsilon_255)).collect();
    sizes.sort_by(f64::total_cmp);
    sizes.dedup();
    let of = |method: Method, count: u32| {
        let own = lines
            .iter()
            .filter(move |line| line.method == method.name() && line.iterations == count);
        own.map(|line| (f64::from(line.epsilon_255), line))
    };
    let shares = |title: &str, method: Method| {
        let series = iterations.iter().map(|count| Series {
            label: if Some(count) == iterations.last() {
                format!("{count} iterations")
            } else {
                count.to_string()
            },
            points: of(method, *count).map(|(size, line)| (size, line.share)).collect(),
            band: of(method, *count)
                .map(|(size, line)| (size, line.low_95, line.high_95))
                .collect(),
            dashed: false,
        });
        Panel {
            title: title.to_owned(),
            y_label: "states deceived (share)".to_owned(),
            series: series.collect(),
            thresholds: Vec::new(),
            top: Some(1.0),
        }
    };
    let mut accumulating = shares("BIM, accumulating", Method::BimAccumulating);
    accumulating.thresholds = vec![("the paper levels off".to_owned(), 0.61), (String::new(), 0.68)];
    let to_deg_s = f64::from(YAW_RATE_PER_UNIT_RAD_S.to_degrees());
    let mean = |method: Method, count: u32| {
        of(method, count)
            .map(|(size, line)| (size, to_deg_s * line.mean_yaw_change))
            .collect::<Vec<_>>()
    };
    let deflection = Panel::new(
        "Mean change of the yaw rate",
        "change (°/s)",
        [
            ("FGSM (1)", mean(Method::BimAccumulating, 1)),
            ("accumulating (20)", mean(Method::BimAccumulating, 20)),
            ("clipped (20)", mean(Method::BimClipped, 20)),
            ("noise (20)", mean(Method::Noise, 20)),
        ],
    );
    let panels = vec![
        accumulating,
        shares("BIM, clipped", Method::BimClipped),
        shares("Noise as large", Method::Noise),
        deflection,
    ];
    let mut figure = Figure::over(
        "ε (1/255 of the image's range, logarithmic)",
        sizes.last().copied().unwrap_or(1.0),
        panels,
    );
    figure.x_scale = Scale::Logarithmic(sizes);
    let mut table = Grid::new(
        "attack | ε · 255 | iterations | states deceived | 95 % interval | mean change of yaw | the paper's limit",
    );
    for line in &lines {
        table.row([
            line.method.clone(),
            line.epsilon_255.to_string(),
            line.iterations.to_string(),
            format!("{} of {} ({})", line.effective, line.states, percent(line.share)),
            between((line.low_95, line.high_95)),
            format!("{:.1} °/s", to_deg_s * line.mean_yaw_change),
            match line.method == Method::Noise.name() {
                true => NONE,
                false => "61 to 68 %",
            }
            .to_owned(),
        ]);
    }
    made(
        drawn(&figure),
        table,
        "A state counts as deceived when its yaw output moves by 1.0 (30 °/s) or more. One iteration is FGSM. Bands: Wilson's \
                  95 % intervals. The paper reads ε as that of one iteration and its figure levels off at 61 to 68 %.",
    )
}

/// A flight explained: its pixels and its steps.
fn explained(sources: &Sources, unit: &str) -> Result<(Pixels, Vec<ExplanationLine>)> {
    let data = sources.of(unit);
    let lines = from_csv(&data.text(unit, ".csv")?).with_context(|| data.other(unit))?;
    Ok((data.json(unit)?, lines))
}

fn pixels_of_a_flight(sources: &Sources) -> Result<Made> {
    let (pixels, lines) = explained(sources, "explained")?;
    let mut table = Grid::new("time | yaw output | image | bearing | distance | told | score | the paper");
    for frame in &pixels.frames {
        if let Some(line) = lines.get(frame.step) {
            let parts = [line.yaw, line.image, line.bearing, line.distance, line.told];
            let parts = parts.map(|value| format!("{value:.3}")).into_iter();
            table.row([format!("{:.1} s", line.time_s)].into_iter().chain(parts).chain([
                optional(line.score.map(f64::from), |score| format!("{score:.4}")),
                "a picture".to_owned(),
            ]));
        }
    }
    made(
        drawn(&figure_12(&pixels)?),
        table,
        format!(
            "{} moments of an unattacked flight: the newest frame, near is bright, and what each of its pixels adds to the yaw output \
             (30 °/s each unit), one scale for all. Of one flight there are no intervals.",
            pixels.frames.len()
        ),
    )
}

fn mean_of(lines: &[&ExplanationLine], value: impl Fn(&ExplanationLine) -> f32) -> String {
    let sum: f64 = lines.iter().map(|line| f64::from(value(line))).sum();
    match lines.len() {
        0 => NONE.to_owned(),
        count => format!("{:.3}", sum / count as f64),
    }
}

fn contributions(sources: &Sources) -> Result<Made> {
    let (pixels, lines) = explained(sources, "explained-attacked")?;
    let mut table = Grid::new("steps | image | bearing | distance | told | score | verdict attack | the paper");
    for (name, altered) in [("as taken", 0), ("attacked", 1)] {
        let those: Vec<_> = lines.iter().filter(|line| line.altered == altered).collect();
        let found = those.iter().filter(|line| line.verdict == "attack").count();
        let scored: Vec<_> = those.iter().filter(|line| line.score.is_some()).copied().collect();
        let parts: [fn(&ExplanationLine) -> f32; 4] = [|l| l.image, |l| l.bearing, |l| l.distance, |l| l.told];
        let parts = parts.map(|value| mean_of(&those, value)).into_iter();
        table.row([format!("{} {name}", those.len())].into_iter().chain(parts).chain([
            mean_of(&scored, |line| line.score.unwrap_or(f32::NAN)),
            format!("{found} of {}", scored.len()),
            "a picture".to_owned(),
        ]));
    }
    made(
        drawn(&figure_13(&pixels, &lines)),
        table,
        "Means over the steps. Above, what image (48 values together), bearing, distance and what the actor is told beside them add to the yaw output; below, the \
                  detector's score of the last ten explanations and the threshold that it flies with. The actor flies alone, nobody \
                  acts on the verdict. Of one flight there are no intervals.",
    )
}

fn sum_and_action(sources: &Sources) -> Result<Made> {
    let (pixels, lines) = explained(sources, "explained-attacked")?;
    let difference = |line: &ExplanationLine| (line.sum() - line.yaw).abs();
    let greatest = lines.iter().map(difference).fold(0.0, f32::max);
    let mut table = Grid::new("steps | greatest difference of sum and action | the paper");
    table.row([
        lines.len().to_string(),
        format!("{greatest:.1e} (units of 30 °/s)"),
        "a picture: a constant apart".to_owned(),
    ]);
    made(
        drawn(&figure_14(&pixels, &lines)),
        table,
        "The constant is the mean of the yaw output over the background sample; DeepSHAP's values add up to the rest, attacked \
                  or not. What is left below is rounding.",
    )
}

fn attacked_completion(sources: &Sources) -> Result<Made> {
    let report: attack::CompletionReport = sources.of("attack-completion").json("attack-completion")?;
    let mut table =
        Grid::new("attack | field | completed | 95 % interval | the paper | collisions | out of bounds | time-outs");
    let mut rows: Vec<BarRow> = Vec::new();
    for row in &report.rows {
        let (label, steps) = row.attack.map_or(("not attacked".to_owned(), None), |setting| {
            (
                format!("{} steps attacked", setting.burst),
                Some(setting.burst.to_string()),
            )
        });
        let paper = match (steps.as_deref(), row.apf) {
            (None, true) => Some(97.0),
            (Some("5"), false) => Some(35.0),
            _ => None,
        };
        let field = if row.apf { "on" } else { "off" };
        let cells = outcomes(&row.tally, &optional(paper, |value| format!("{value:.0} %")));
        table.row([label.clone(), field.to_owned()].into_iter().chain(cells));
        let bar = completion_bar(usize::from(!row.apf), &row.tally);
        match rows.iter_mut().find(|r| r.label == label) {
            Some(known) => {
                known.bars.push(bar);
                known.paper = known.paper.or(paper);
            }
            None => rows.push(BarRow {
                label,
                bars: vec![bar],
                paper,
            }),
        }
    }
    let chart = completion_chart(
        "Validation courses completed, undefended",
        &["field on", "field off"],
        rows,
    );
    made(
        drawn(&chart),
        table,
        "The paper compares 97 % (field on, not attacked) with 35 % (field off, five of its steps attacked, about 2.5 s: our 50 \
                  steps). Here all six cells are flown over the same courses. Wilson's intervals.",
    )
}

fn completion_bar(series: usize, tally: &Tally) -> Bar {
    let (low, high) = tally.wilson_95;
    Bar {
        series,
        value: 100.0 * tally.completion,
        interval: Some((100.0 * low, 100.0 * high)),
        note: format!("{} of {}", tally.completed, tally.flights),
    }
}

fn completion_chart(title: &str, series: &[&str], rows: Vec<BarRow>) -> Bars {
    Bars {
        title: title.to_owned(),
        x_label: "flights that reached the goal (%), with 95 % interval".to_owned(),
        x_range: (0.0, 100.0),
        logarithmic: false,
        threshold: None,
        series: series.iter().map(|name| (*name).to_owned()).collect(),
        rows,
    }
}

#[derive(Deserialize)]
struct Evaluation {
    at_one_half: Report,
    at_threshold: Report,
}

fn detection(sources: &Sources) -> Result<Made> {
    let Evaluation {
        at_one_half: report, ..
    } = sources.of("detector-evaluate").json("detector-evaluate")?;
    let mut table = Grid::new(
        "attack | learned from | found at 0.5 | 95 % interval | AUC | found at 1 % false alarms | at 0.1 % | the paper (accuracy)",
    );
    for set in report.sets.iter().filter(|set| !set.roc.is_empty()) {
        let is_paper = set.role == Role::Paper;
        let [found, interval] = share_of(&set.detected);
        table.row([
            set.name.clone(),
            if set.role == Role::Untrained { "no" } else { "yes" }.to_owned(),
            found,
            interval,
            format!("{:.5}", auc(&set.roc)),
            percent(true_positives_at(&set.roc, 0.01)),
            percent(true_positives_at(&set.roc, 0.001)),
            if is_paper { "91 %" } else { NONE }.to_owned(),
        ]);
    }
    let [accuracy, interval] = share_of(&report.separation.accuracy);
    made(
        drawn(&roc(&report)),
        table,
        format!(
            "Windows of ten explanations, judged one by one, against those of unattacked flights: accuracy under the paper's attack at \
             0.5 is {accuracy}, 95 % interval {interval} (the paper: 91 %). The names are method, ε · 255 x iterations; of each method \
             the hardest is drawn, if it does not lie on the paper's line. Intervals take windows for independent, which those \
             of one flight are not."
        ),
    )
}

fn alarm_delay(sources: &Sources) -> Result<Made> {
    let Evaluation {
        at_threshold: report, ..
    } = sources.of("detector-evaluate").json("detector-evaluate")?;
    let series = |label: &str, points: Vec<(usize, &Proportion)>| {
        let known = || points.iter().filter_map(|(at, p)| Some((*at as f64, *p, p.share?)));
        Series {
            label: label.to_owned(),
            points: known().map(|(at, _, share)| (at, share)).collect(),
            band: known().map(|(at, p, _)| (at, p.interval.0, p.interval.1)).collect(),
            dashed: false,
        }
    };
    let panel = |title: &str, line: Series| Panel {
        title: title.to_owned(),
        y_label: "share of windows".to_owned(),
        series: vec![line],
        thresholds: Vec::new(),
        top: Some(1.0),
    };
    let rising = report
        .rows
        .iter()
        .map(|row| (row.attacked_rows, &row.detected))
        .collect();
    let falling = report
        .after
        .iter()
        .map(|after| (after.steps_after, &after.alarmed))
        .collect();
    let figure = Figure::over(
        "steps of 0.05 s",
        20.0,
        vec![
            panel(
                "Judged attacked, by attacked frames among the last ten",
                series("found", rising),
            ),
            panel(
                "Still judged attacked, by steps since the last attacked frame",
                series("lingers", falling),
            ),
        ],
    );
    let mut table = Grid::new(
        "attack | bursts noticed before they ended | 95 % interval | delay of those, median | 90 % within | the paper",
    );
    for set in report.sets.iter().filter(|set| set.bursts_noticed.of > 0) {
        let [noticed, interval] = share_of(&set.bursts_noticed);
        let steps = |steps: Option<f64>| optional(steps, |n| format!("{n:.0} steps"));
        table.row([
            set.name.clone(),
            noticed,
            interval,
            steps(set.delay_steps.map(|d| d.0)),
            steps(set.delay_steps.map(|d| d.1)),
            NONE.to_owned(),
        ]);
    }
    made(
        drawn(&figure),
        table,
        format!(
            "At the threshold that flies ({:.3}), the paper's attack. A delay of 1 step is at once: the first attacked frame itself. The \
             alarm in flight needs several verdicts of the last few (docs/guidance.md). Bands: Wilson's intervals.",
            report.threshold
        ),
    )
}

/// A flight of a campaign, as far as it is counted here.
#[derive(Deserialize)]
struct Flight {
    arm: Arm,
    outcome: String,
    flight_time_s: f64,
    alarms: u64,
}

fn defences(sources: &Sources) -> Result<Made> {
    let mut table = Grid::new(
        "attacker | defence | completed | 95 % interval | the paper | collisions | out of bounds | time-outs | flights with an alarm | median time to the goal",
    );
    let mut rows: BTreeMap<usize, BarRow> = BTreeMap::new();
    let mut count = |attacker: (usize, &str), defence: (usize, &str), paper: &str, flights: &[&Flight]| {
        let ends: Vec<Option<Outcome>> = flights.iter().map(|f| f.outcome.parse().ok()).collect();
        let tally = Tally::of(&ends);
        let arrived = flights.iter().filter(|f| f.outcome == Outcome::Success.name());
        let times: Vec<f64> = arrived.map(|f| f.flight_time_s).collect();
        let alarmed = flights.iter().filter(|f| f.alarms > 0).count();
        let cells = [attacker.1, defence.1].map(str::to_owned).into_iter();
        table.row(cells.chain(outcomes(&tally, paper)).chain([
            alarmed.to_string(),
            optional(quantile(&times, 0.5), |s| format!("{s:.1} s")),
        ]));
        let row = rows.entry(attacker.0).or_insert_with(|| BarRow {
            label: attacker.1.to_owned(),
            bars: Vec::new(),
            paper: None,
        });
        row.bars.push(completion_bar(defence.0, &tally));
    };
    const DEFENCES: [&str; 4] = [
        "undefended",
        "alarm stops",
        "alarm stops, then recovery",
        "the same without the guard",
    ];
    for (unit, attacker, guarded) in [
        ("defended-continuous", (0, "nobody"), true),
        ("defended-100", (1, "for 100 steps (5 s)"), true),
        ("defended-continuous", (2, "all the time"), true),
        ("defended-adaptive", (3, "knows the detector too"), true),
        ("defended-adaptive-unguarded", (3, "knows the detector too"), false),
    ] {
        let data = sources.of(unit);
        let text = data.text(unit, ".csv")?;
        let lines = text.split_once('\n').map_or("", |(_, lines)| lines);
        let flights: Vec<Flight> = from_csv(lines).with_context(|| data.other(unit))?;
        let arms = match attacker.0 {
            0 => [(Arm::None, 0), (Arm::NoneWatched, 2), (Arm::Stop, 1)],
            _ => [(Arm::Undefended, 0), (Arm::Stop, 1), (Arm::Recover, 2)],
        };
        for (arm, defence) in arms {
            let own: Vec<&Flight> = flights.iter().filter(|f| f.arm == arm).collect();
            if own.is_empty() || (attacker.0 == 0 && arm == Arm::Stop) {
                continue;
            }
            let defence = if guarded { defence } else { 3 };
            let paper = match (attacker.0, defence) {
                (1, 0) => "35 % (a shorter burst)",
                (1, 1) => "it stops; recovery is open work",
                _ => NONE,
            };
            count(attacker, (defence, DEFENCES[defence]), paper, &own);
        }
    }
    let chart = completion_chart(
        "Validation courses completed, by attacker and defence",
        &DEFENCES,
        rows.into_values().collect(),
    );
    made(
        drawn(&chart),
        table,
        "Accumulating BIM, ε = 1/255, 20 iterations on each frame as it passes, actor without the field; every defence over the \
                  same courses of an attacker. Wilson's intervals. An attacker who knows the detector lowers its score as well.",
    )
}

#[derive(Deserialize)]
struct Rate {
    outcome: String,
    flights: usize,
}

#[derive(Deserialize)]
struct FamilyReport {
    rates: Vec<Rate>,
}

fn families(sources: &Sources) -> Result<Made> {
    let mut table =
        Grid::new("courses | completed | 95 % interval | the paper | collisions | out of bounds | time-outs");
    let mut rows = Vec::new();
    for (unit, name) in [
        ("family-training", "training"),
        ("family-validation", "validation"),
        ("family-dense", "dense"),
        ("family-hard", "hard, things that move"),
    ] {
        let report: FamilyReport = sources.of(unit).json(unit)?;
        let ends = (report.rates.iter()).flat_map(|rate| vec![rate.outcome.parse().ok(); rate.flights]);
        let tally = Tally::of(&ends.collect::<Vec<Option<Outcome>>>());
        let paper = (unit == "family-validation").then_some(97.0);
        let cells = outcomes(&tally, &optional(paper, |value| format!("{value:.0} %")));
        table.row([name.to_owned()].into_iter().chain(cells));
        rows.push(BarRow {
            label: name.to_owned(),
            bars: vec![completion_bar(0, &tally)],
            paper,
        });
    }
    let chart = completion_chart("Courses completed, by family", &["whole stack"], rows);
    made(
        drawn(&chart),
        table,
        "Actor with field, detector, guard and recovery as they fly by default, nobody attacks; a quarter of the flights begins \
                  on the ground. The paper has one validation course, we draw one for each flight. Wilson's intervals.",
    )
}

#[derive(Deserialize)]
struct Peers {
    processor: String,
    isa: String,
    cases: BTreeMap<String, PeerCase>,
}

#[derive(Deserialize)]
struct PeerCase {
    title: String,
    ours_median_us: f64,
    peers: BTreeMap<String, Peer>,
}

#[derive(Deserialize)]
struct Peer {
    median_us: f64,
    ratio: f64,
    ratio_low: f64,
    ratio_high: f64,
}

fn peers(sources: &Sources) -> Result<Made> {
    let report: Peers = sources.of("peers").json("peers")?;
    let mut table =
        Grid::new("work | ours | other program | its time | its time over ours | lowest to highest | the paper");
    let mut rows = Vec::new();
    let time = |us: f64| match us >= 1000.0 {
        true => format!("{:.1} ms", us / 1000.0),
        false => format!("{us:.1} µs"),
    };
    for (name, case) in &report.cases {
        let paper = match name.as_str() {
            "actor" => "52 to 56 ms",
            "shap-hidden" => "19 ms",
            "shap-pixels" => "13.3 s",
            "lstm-ad" => "1 ms",
            _ => NONE,
        };
        let mut bars = Vec::new();
        for (peer, p) in &case.peers {
            table.row([
                case.title.clone(),
                time(case.ours_median_us),
                peer.clone(),
                time(p.median_us),
                format!("{:.2}", p.ratio),
                format!("{:.2} to {:.2}", p.ratio_low, p.ratio_high),
                paper.to_owned(),
            ]);
            bars.push(Bar {
                series: 0,
                value: p.ratio,
                interval: Some((p.ratio_low, p.ratio_high)),
                note: format!("{:.1} × {peer}", p.ratio),
            });
        }
        rows.push(BarRow {
            label: peer_label(name, &case.title),
            bars,
            paper: None,
        });
    }
    let chart = Bars {
        title: "Other programs' time over ours".to_owned(),
        x_label: "time over ours (logarithmic), lowest to highest of the rounds".to_owned(),
        x_range: (0.5, 1000.0),
        logarithmic: true,
        threshold: Some(("as fast as ours".to_owned(), 1.0)),
        series: vec!["other program".to_owned()],
        rows,
    };
    made(
        drawn(&chart),
        table,
        format!(
            "{}, {} instructions, one core and one thread a side, in turns; medians of the rounds, and the lowest and highest in place \
             of an interval. Both sides compute the same (docs/peers.md).",
            report.processor, report.isa
        ),
    )
}

/// A name that fits beside the bars.
fn peer_label(name: &str, title: &str) -> String {
    match name {
        "actor" => "a new frame decided on",
        "update" => "DDPG update, batch 32",
        "update-as-trained" => "update as we train",
        "shap-hidden" => "SHAP at the split point",
        "shap-pixels" => "SHAP of all pixels",
        "bim" => "BIM, 20 iterations",
        "lstm-ad" => "LSTM-AD's verdict",
        _ => title,
    }
    .to_owned()
}
