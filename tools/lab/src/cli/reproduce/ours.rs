//! Tables and figures of our own.

use super::data::Sources;
use super::made::{Grid, Made, NONE, optional, outcomes, percent, share_of};
use crate::attack_campaigns::{self as attack, Arm};
use crate::campaign::Tally;
use crate::cli::detector::roc;
use crate::detector_training::{Proportion, Report, Role, auc, true_positives_at};
use crate::report::{Bar, BarRow, Bars, Figure, Panel, Series, from_csv};
use anyhow::{Context, Result};
use serde::Deserialize;
use std::collections::BTreeMap;
use vigil_sim::world::Outcome;

pub(super) fn attacked_completion(sources: &Sources) -> Result<Made> {
    let report: attack::CompletionReport = sources.of("attack-completion").json("attack-completion")?;
    let mut table =
        Grid::new("attack | field | completed | 95 % interval | the paper | collisions | out of bounds | time-outs");
    let mut rows = Vec::new();
    for row in &report.rows {
        let steps = row.attack.map(|setting| setting.burst.to_string());
        let attacked = |steps: &String| format!("{steps} steps attacked");
        let label = steps.as_ref().map_or("not attacked".to_owned(), attacked);
        let paper = match (steps.as_deref(), row.apf) {
            (None, true) => Some(97.0),
            (Some("5"), false) => Some(35.0),
            _ => None,
        };
        let field = if row.apf { "on" } else { "off" };
        let cells = outcomes(&row.tally, &optional(paper, |value| format!("{value:.0} %")));
        table.row([label.clone(), field.to_owned()].into_iter().chain(cells));
        add_bar(
            &mut rows,
            &label,
            completion_bar(usize::from(!row.apf), &row.tally),
            paper,
        );
    }
    let title = "Validation courses completed, undefended";
    let chart = completion_chart(title, &["field on", "field off"], rows);
    table.beside(
        &chart,
        "The paper compares 97 % (field on, not attacked) with 35 % (field off, five of its steps attacked, about 2.5 s: our 50 \
                  steps). Here all six cells are flown over the same courses. Wilson's intervals.",
    )
}

/// Adds a bar to the row of this name, a new one below the others if there is none.
fn add_bar(rows: &mut Vec<BarRow>, label: &str, bar: Bar, paper: Option<f64>) {
    if !rows.iter().any(|row| row.label == label) {
        let (label, bars) = (label.to_owned(), Vec::new());
        rows.push(BarRow { label, bars, paper });
    }
    if let Some(row) = rows.iter_mut().find(|row| row.label == label) {
        row.bars.push(bar);
        row.paper = row.paper.or(paper);
    }
}

fn completion_bar(series: usize, tally: &Tally) -> Bar {
    let (low, high) = tally.wilson_95;
    Bar {
        series,
        value: 100.0 * tally.completion,
        interval: (100.0 * low, 100.0 * high),
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

pub(super) fn detection(sources: &Sources) -> Result<Made> {
    let evaluation: Evaluation = sources.of("detector-evaluate").json("detector-evaluate")?;
    let report = evaluation.at_one_half;
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
    table.beside(
        &roc(&report),
        format!(
            "Windows of ten explanations, judged one by one, against those of unattacked flights: accuracy under the paper's attack at \
             0.5 is {accuracy}, 95 % interval {interval} (the paper: 91 %). The names are method, ε · 255 x iterations; of each method \
             the hardest is drawn, if it does not lie on the paper's line. Intervals take windows for independent, which those \
             of one flight are not."
        ),
    )
}

pub(super) fn alarm_delay(sources: &Sources) -> Result<Made> {
    let evaluation: Evaluation = sources.of("detector-evaluate").json("detector-evaluate")?;
    let report = evaluation.at_threshold;
    let panel = |title: &str, label: &str, points: &mut dyn Iterator<Item = (usize, &Proportion)>| {
        let known = points.filter_map(|(at, p)| Some((at as f64, p.share?, p.interval.0, p.interval.1)));
        Panel {
            top: Some(1.0),
            ..Panel::of(title, "share of windows", [Series::banded(label, known)])
        }
    };
    let mut rising = report.rows.iter().map(|row| (row.attacked_rows, &row.detected));
    let mut falling = report.after.iter().map(|after| (after.steps_after, &after.alarmed));
    let found = "Judged attacked, by attacked frames among the last ten";
    let lingers = "Still judged attacked, by steps since the last attacked frame";
    let panels = [
        panel(found, "found", &mut rising),
        panel(lingers, "lingers", &mut falling),
    ];
    let figure = Figure::over("steps of 0.05 s", 20.0, panels.into());
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
    table.beside(
        &figure,
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

/// The value in the middle, or the mean of the two there.
fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let last = values.len().checked_sub(1)?;
    Some((values[last / 2] + values[last.div_ceil(2)]) / 2.0)
}

pub(super) fn defences(sources: &Sources) -> Result<Made> {
    let mut table = Grid::new(
        "attacker | defence | completed | 95 % interval | the paper | collisions | out of bounds | time-outs | flights with an alarm | median time to the goal",
    );
    let mut rows = Vec::new();
    const DEFENCES: [&str; 4] = [
        "undefended",
        "alarm stops",
        "alarm stops, then recovery",
        "the same without the guard",
    ];
    for (unit, (place, attacker), guarded) in [
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
        let arms: &[(Arm, usize)] = match place {
            0 => &[(Arm::None, 0), (Arm::NoneWatched, 2)],
            _ => &[(Arm::Undefended, 0), (Arm::Stop, 1), (Arm::Recover, 2)],
        };
        for (arm, defence) in arms {
            let own: Vec<&Flight> = flights.iter().filter(|f| f.arm == *arm).collect();
            if own.is_empty() {
                continue;
            }
            let defence = if guarded { *defence } else { 3 };
            let paper = match (place, defence) {
                (1, 0) => "35 % (a shorter burst)",
                (1, 1) => "it stops; recovery is open work",
                _ => NONE,
            };
            let ends: Vec<Option<Outcome>> = own.iter().map(|f| Outcome::from_name(&f.outcome)).collect();
            let tally = Tally::of(&ends);
            let arrived = own.iter().filter(|f| f.outcome == Outcome::Success.name());
            let times: Vec<f64> = arrived.map(|f| f.flight_time_s).collect();
            let alarmed = own.iter().filter(|f| f.alarms > 0).count();
            let cells = [attacker, DEFENCES[defence]].map(str::to_owned).into_iter();
            table.row(
                cells
                    .chain(outcomes(&tally, paper))
                    .chain([alarmed.to_string(), optional(median(times), |s| format!("{s:.1} s"))]),
            );
            add_bar(&mut rows, attacker, completion_bar(defence, &tally), None);
        }
    }
    let chart = completion_chart("Validation courses completed, by attacker and defence", &DEFENCES, rows);
    table.beside(
        &chart,
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

pub(super) fn families(sources: &Sources) -> Result<Made> {
    let rows = [
        ("family-training", "training"),
        ("family-validation", "validation"),
        ("family-dense", "dense"),
        ("family-hard", "hard, things that move"),
    ];
    completions(
        sources,
        "courses",
        &rows,
        "Courses completed, by family",
        "Actor with field, detector, guard and recovery as they fly by default, nobody attacks; a quarter of the flights begins \
                  on the ground. The paper has one validation course, we draw one for each flight. Wilson's intervals.",
    )
}

pub(super) fn vehicles(sources: &Sources) -> Result<Made> {
    let rows = [
        ("vehicle-ours", "ours"),
        ("vehicle-px4-light", "px4-light"),
        ("vehicle-px4-sih", "px4-sih"),
        ("vehicle-arducopter", "arducopter"),
    ];
    completions(
        sources,
        "vehicle",
        &rows,
        "Validation courses completed, by vehicle model",
        "The same stack on vehicles that answer as other autopilots do (docs/vehicle.md), the same courses for each; their estimates stray \
                  by half a metre, frames and collisions are the truth's. Wilson's intervals.",
    )
}

/// How the flights of some units of `vigil evaluate` ended, a row each.
fn completions(sources: &Sources, first_column: &str, units: &[(&str, &str)], title: &str, note: &str) -> Result<Made> {
    let mut table = Grid::new(&format!(
        "{first_column} | completed | 95 % interval | the paper | collisions | out of bounds | time-outs"
    ));
    let mut rows = Vec::new();
    for (unit, name) in units.iter().copied() {
        let report: FamilyReport = sources.of(unit).json(unit)?;
        let ends = (report.rates.iter()).flat_map(|rate| vec![Outcome::from_name(&rate.outcome); rate.flights]);
        let tally = Tally::of(&ends.collect::<Vec<Option<Outcome>>>());
        let paper = (unit == "family-validation").then_some(97.0);
        let cells = outcomes(&tally, &optional(paper, |value| format!("{value:.0} %")));
        table.row([name.to_owned()].into_iter().chain(cells));
        add_bar(&mut rows, name, completion_bar(0, &tally), paper);
    }
    let chart = completion_chart(title, &["whole stack"], rows);
    table.beside(&chart, note)
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

pub(super) fn peers(sources: &Sources) -> Result<Made> {
    let report: Peers = sources.of("peers").json("peers")?;
    let mut table =
        Grid::new("work | ours | other program | its time | its time over ours | lowest to highest | the paper");
    let mut rows = Vec::new();
    let time = |us: f64| match us >= 1000.0 {
        true => format!("{:.1} ms", us / 1000.0),
        false => format!("{us:.1} µs"),
    };
    for (name, case) in &report.cases {
        // A name that fits beside the bars, and the paper's time.
        let (label, paper) = match name.as_str() {
            "actor" => ("a new frame decided on", "52 to 56 ms"),
            "update" => ("DDPG update, batch 32", NONE),
            "update-as-trained" => ("update as we train", NONE),
            "shap-hidden" => ("SHAP at the split point", "19 ms"),
            "shap-pixels" => ("SHAP of all pixels", "13.3 s"),
            "bim" => ("BIM, 20 iterations", NONE),
            "lstm-ad" => ("LSTM-AD's verdict", "1 ms"),
            _ => (case.title.as_str(), NONE),
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
                interval: (p.ratio_low, p.ratio_high),
                note: format!("{:.1} × {peer}", p.ratio),
            });
        }
        let (label, paper) = (label.to_owned(), None);
        rows.push(BarRow { label, bars, paper });
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
    table.beside(
        &chart,
        format!(
            "{}, {} instructions, one core and one thread a side, in turns; medians of the rounds, and the lowest and highest in place \
             of an interval. Both sides compute the same (docs/peers.md).",
            report.processor, report.isa
        ),
    )
}

#[cfg(test)]
mod tests {
    use super::median;

    #[test]
    fn a_median_lies_between_the_two_in_the_middle() {
        assert_eq!(median(vec![4.0, 1.0, 2.0, 9.0]), Some(3.0));
        assert_eq!(median(vec![9.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(Vec::new()), None);
    }
}
