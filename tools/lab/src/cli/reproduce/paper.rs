//! The paper's tables and figures.

use super::data::Sources;
use super::made::{Grid, Made, NONE, between, optional, outcomes, percent, share_of};
use crate::attack_campaigns as attack;
use crate::cli::detector::TimesReport;
use crate::cli::figures::{ExplanationLine, Pixels, figure_12, figure_13, figure_14};
use crate::cli::report as training;
use crate::detector_training::TableRow;
use crate::report::{Figure, Panel, Scale, Series, from_csv};
use anyhow::{Context, Result};
use serde::Deserialize;
use std::collections::BTreeSet;
use vigil_adversary::Method;
use vigil_types::YAW_RATE_PER_UNIT_RAD_S;

fn arms(sources: &Sources) -> Result<Vec<training::Arm>> {
    training::arms(&sources.of("training-runs").folders("training-runs")?)
}

pub(super) fn table_1(sources: &Sources) -> Result<Made> {
    let mut table =
        Grid::new("training | completed without the field | 95 % interval | the paper | decisions | the paper's steps");
    let arms = arms(sources)?;
    let runs = || arms.iter().flat_map(|arm| &arm.runs);
    let courses: BTreeSet<String> = runs().map(|run| run.test.flights.to_string()).collect();
    let courses: Vec<String> = courses.into_iter().collect();
    for arm in &arms {
        let (paper, steps) = match arm.name {
            "DDPG" => ("80 %", "27 456"),
            _ => ("97 %", "24 012"),
        };
        for training::Run { result, test, .. } in &arm.runs {
            let completion = percent(test.completion());
            table.row([
                format!("{}, seed {}", arm.name, result.seed),
                format!("{} of {} ({completion})", test.successes, test.flights),
                between(test.wilson_95),
                NONE.to_owned(),
                result.decisions.to_string(),
                NONE.to_owned(),
            ]);
        }
        let (mean, half) = arm.mean();
        table.row([
            format!("{}, mean of {} seeds", arm.name, arm.runs.len()),
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
    table.alone(format!(
        "{} training runs from nothing, each tested on {} validation courses that nothing was chosen by, flown without the \
         field; intervals of single runs are Wilson's, of means Student's over the seeds. A decision is 0.2 s of flight, a \
         step of the paper's about 0.5 s. The actor that is built in was tested on the courses of the attacks.",
        runs().count(),
        courses.join(" or ")
    ))
}

pub(super) fn table_2(sources: &Sources) -> Result<Made> {
    let report: attack::DeflectionReport = sources.of("attack-deflection").json("attack-deflection")?;
    let mut bearings: Vec<f32> = Vec::new();
    for cell in &report.cells {
        if !bearings.contains(&cell.bearing_deg) {
            bearings.push(cell.bearing_deg);
        }
    }
    let goals: String = bearings.iter().map(|b| format!(" | goal at {b}°")).collect();
    let mut table = Grid::new(&format!(
        "attack | gap to the wall{goals} | mean | 95 % interval of the mean | the paper"
    ));
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
    table.alone(format!(
        "Mean absolute change of the yaw decision, °/s, hovering before a wall {} m wide, goal {} m away; ε = {}/255, {} \
         iterations, {} states a cell. The interval is Student's over the bearings, taken as independent. The paper's attack \
         is the accumulating one.",
        report.wall_width_m, report.goal_distance_m, report.epsilon_255, report.iterations, report.states_per_cell
    ))
}

#[derive(Deserialize)]
struct DetectorTable {
    learned_from: usize,
    rows: Vec<TableRow>,
}

pub(super) fn table_3(sources: &Sources) -> Result<Made> {
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
    table.alone(format!(
        "Right verdicts on unaltered and attacked states met on validation courses, half of each. The image detectors learned from \
         {} states; LSTM-AD is the one that flies, at the threshold that it flies with. Wilson's intervals.",
        report.learned_from
    ))
}

pub(super) fn table_4(sources: &Sources) -> Result<Made> {
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
    table.alone(format!(
        "One thread, {} instructions, on the states of one flight over validation course {}. Times move with the machine and its \
         other work; the step has 50 ms.",
        report.isa, report.seed
    ))
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
    table.beside(&curve.figure(&arms), caption)
}

pub(super) fn figure_9(sources: &Sources) -> Result<Made> {
    training_curve(
        sources,
        &training::REWARDS,
        "reward of the last 20 flights",
        "Rolling mean of the training flights' reward; lines are means over the seeds, bands reach from the least to the \
         greatest of them. Flights of the warm-up, which noise flies, are left out. Interval: Student's over the seeds.",
    )
}

pub(super) fn figure_10(sources: &Sources) -> Result<Made> {
    training_curve(
        sources,
        &training::SUCCESSES,
        "share of the last 10 flights",
        "Training flights have noise, and a quarter of those of DDPG-APF the field; bands reach from the least to the greatest \
         of the seeds. Interval: Student's over the seeds, of which an end may lie beyond 1.",
    )
}

pub(super) fn figure_11(sources: &Sources) -> Result<Made> {
    let text = sources.of("attack-table").text("attack-table", ".csv")?;
    let lines = attack::StrengthCell::of_csv(&text).context("figure-11.csv is not ours")?;
    let mut iterations: Vec<u32> = lines.iter().map(|line| line.iterations).collect();
    iterations.sort_unstable();
    iterations.dedup();
    let mut sizes: Vec<f64> = lines.iter().map(|line| f64::from(line.epsilon_255)).collect();
    sizes.sort_by(f64::total_cmp);
    sizes.dedup();
    let of = |method: Method, count: u32| {
        let own = lines
            .iter()
            .filter(move |line| line.method == method && line.iterations == count);
        own.map(|line| (f64::from(line.epsilon_255), line))
    };
    let shares = |title: &str, method: Method| {
        let series = iterations.iter().map(|count| {
            let is_last = Some(count) == iterations.last();
            let unit = if is_last { " iterations" } else { "" };
            let shares = of(method, *count).map(|(size, line)| (size, line.share, line.wilson_95.0, line.wilson_95.1));
            Series::banded(format!("{count}{unit}"), shares)
        });
        Panel {
            top: Some(1.0),
            ..Panel::of(title, "states deceived (share)", series)
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
    strength_table(&lines, to_deg_s).beside(
        &figure,
        "A state counts as deceived when its yaw output moves by 1.0 (30 °/s) or more. One iteration is FGSM. Bands: Wilson's \
                  95 % intervals. The paper reads ε as that of one iteration and its figure levels off at 61 to 68 %.",
    )
}

fn strength_table(lines: &[attack::StrengthCell], to_deg_s: f64) -> Grid {
    let mut table = Grid::new(
        "attack | ε · 255 | iterations | states deceived | 95 % interval | mean change of yaw | the paper's limit",
    );
    for line in lines {
        table.row([
            line.method.name().to_owned(),
            line.epsilon_255.to_string(),
            line.iterations.to_string(),
            format!("{} of {} ({})", line.effective, line.states, percent(line.share)),
            between(line.wilson_95),
            format!("{:.1} °/s", to_deg_s * line.mean_yaw_change),
            match line.method == Method::Noise {
                true => NONE,
                false => "61 to 68 %",
            }
            .to_owned(),
        ]);
    }
    table
}

/// A flight explained: its pixels and its steps.
pub(super) fn explained(sources: &Sources, unit: &str) -> Result<(Pixels, Vec<ExplanationLine>)> {
    let data = sources.of(unit);
    let lines = from_csv(&data.text(unit, ".csv")?).with_context(|| data.other(unit))?;
    Ok((data.json(unit)?, lines))
}

pub(super) fn pixels_of_a_flight(sources: &Sources) -> Result<Made> {
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
    table.beside(
        &figure_12(&pixels)?,
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

pub(super) fn contributions(sources: &Sources) -> Result<Made> {
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
    table.beside(
        &figure_13(&pixels, &lines),
        "Means over the steps. Above, what image (48 values together), bearing, distance and what the actor is told beside them add to the yaw output; below, the \
                  detector's score of the last ten explanations and the threshold that it flies with. The actor flies alone, nobody \
                  acts on the verdict. Of one flight there are no intervals.",
    )
}

pub(super) fn sum_and_action(sources: &Sources) -> Result<Made> {
    let (pixels, lines) = explained(sources, "explained-attacked")?;
    let difference = |line: &ExplanationLine| (line.sum() - line.yaw).abs();
    let greatest = lines.iter().map(difference).fold(0.0, f32::max);
    let mut table = Grid::new("steps | greatest difference of sum and action | the paper");
    table.row([
        lines.len().to_string(),
        format!("{greatest:.1e} (units of 30 °/s)"),
        "a picture: a constant apart".to_owned(),
    ]);
    table.beside(
        &figure_14(&pixels, &lines),
        "The constant is the mean of the yaw output over the background sample; DeepSHAP's values add up to the rest, attacked \
                  or not. What is left below is rounding.",
    )
}
