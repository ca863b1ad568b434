//! How an evaluation is written: shares with their intervals, curves and tables.

use crate::cli::output::or_dash;
use crate::detector_training::{Epoch, Proportion, Report, Role, SetReport, auc};
use crate::report::{Figure, Panel, Picture, Scale, TextTable};
use std::fmt::Write as _;

pub(super) fn percent(p: &Proportion) -> String {
    or_dash(100.0 * p.share.unwrap_or(f64::NAN), 2, " %")
}

/// A share with its interval, or a dash for nothing.
pub(super) fn share(p: &Proportion) -> String {
    match p.share {
        Some(share) => format!(
            "{:.2} % ({:.2} to {:.2}, {} of {})",
            100.0 * share,
            100.0 * p.interval.0,
            100.0 * p.interval.1,
            p.count,
            p.of
        ),
        None => "-".to_owned(),
    }
}

/// A share alone, or a dash.
pub(super) fn short(p: &Proportion) -> String {
    or_dash(100.0 * p.share.unwrap_or(f64::NAN), 2, "")
}

pub(super) fn curves_png(epochs: &[Epoch]) -> Vec<u8> {
    let over = |value: fn(&Epoch) -> f64| epochs.iter().map(|e| (e.epoch as f64, value(e))).collect::<Vec<_>>();
    let panels = [
        Panel::new(
            "Cross entropy",
            "nats",
            [
                ("flights that choose", over(|e| e.choose_loss)),
                ("training", over(|e| e.train_loss)),
            ],
        ),
        Panel::new(
            "Right verdicts on the flights that choose",
            "accuracy (%)",
            [("accuracy", over(|e| 100.0 * e.choose_accuracy))],
        ),
    ];
    Figure::over("epoch", epochs.len() as f64, panels.into()).png()
}

/// ROC of the paper's attack, and of the methods that are not found as well.
pub(crate) fn roc(report: &Report) -> Figure {
    let is_other = |s: &&SetReport| s.role != Role::Paper && !s.roc.is_empty();
    let name = |s: &SetReport| s.name.split(' ').next().unwrap_or_default().to_owned();
    // The hardest of each method: the others lie above it.
    let mut hardest: Vec<(String, &SetReport)> = Vec::new();
    for set in report.sets.iter().filter(is_other) {
        match hardest.iter_mut().find(|(method, _)| *method == name(set)) {
            Some((_, kept)) if auc(&set.roc) < auc(&kept.roc) => *kept = set,
            Some(_) => {}
            None => hardest.push((name(set), set)),
        }
    }
    hardest.sort_by(|a, b| auc(&a.1.roc).total_cmp(&auc(&b.1.roc)));
    // The others lie on the upper edge and would hide each other.
    let apart = hardest.iter().filter(|(_, set)| auc(&set.roc) < 0.9999);
    let shown = apart.rev().map(|(method, set)| (method.as_str(), set.roc.clone()));
    roc_figure([("the paper's", report.roc.clone())].into_iter().chain(shown))
}

pub(super) fn roc_figure<'a>(curves: impl IntoIterator<Item = (&'a str, Vec<(f64, f64)>)>) -> Figure {
    let panel = Panel::new("Found over false alarms", "attacked windows found (share)", curves);
    let label = "false alarms (share of the unattacked windows, logarithmic)";
    let mut figure = Figure::over(label, 1.0, vec![panel]);
    figure.x_scale = Scale::Logarithmic(vec![1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0]);
    figure
}

/// Columns of the table of sets.
const OF_SETS: &str = "set | > flights | > at goal % | > detected % | > effective | > ineffective | > false alarms % | > on noise \
                       | > delay 50 / 90 % | > bursts noticed % | > rough pictures %";

pub(super) fn text(report: &Report) -> String {
    let mut out = String::new();
    let mut line = |text: String| {
        let _ = writeln!(out, "{text}");
    };
    let effective = "... effective attacks only (yaw moved by 1 or more)";
    for (name, s) in [
        (
            "paper's attack, streaming, against unattacked flights",
            &report.separation,
        ),
        (effective, &report.separation_effective),
    ] {
        line(format!(
            "{name}\n  accuracy at {}    {}\n  detected           {}\n  false alarms       {}\n  AUC                {}\n  \
             found at 1 % / 0.1 % false alarms   {} / {}",
            report.threshold,
            share(&s.accuracy),
            share(&s.detected),
            share(&s.false_alarms),
            or_dash(s.auc, 5, ""),
            or_dash(100.0 * s.found_at_1_percent, 2, " %"),
            or_dash(100.0 * s.found_at_0_1_percent, 2, " %")
        ));
    }
    line(format!(
        "false stops          {} in {:.2} h of unattacked flight: {} an hour",
        report.false_stops,
        report.unattacked_hours,
        or_dash(report.false_stops as f64 / report.unattacked_hours, 2, "")
    ));
    let mut table = TextTable::new("> attacked rows of ten | > detected % | > accuracy % | > windows");
    for row in &report.rows {
        table.row([
            row.attacked_rows.to_string(),
            short(&row.detected),
            or_dash(100.0 * row.accuracy, 2, ""),
            row.detected.of.to_string(),
        ]);
    }
    line(format!("\n{table}"));
    let after: Vec<String> = report.after.iter().map(|a| short(&a.alarmed)).collect();
    line(format!(
        "\nstill alarmed 1, 2, … 20 steps after an attack, %: {}",
        after.join(" ")
    ));
    let mut table = TextTable::new(OF_SETS);
    for set in &report.sets {
        let delay = set
            .delay_steps
            .map_or_else(|| "-".to_owned(), |(m, p)| format!("{m:.0} / {p:.0}"));
        table.row([
            set.name.to_string(),
            set.flights.to_string(),
            short(&set.at_goal),
            short(&set.detected),
            short(&set.detected_effective),
            short(&set.detected_ineffective),
            short(&set.false_alarms),
            short(&set.alarms_on_noise),
            delay,
            short(&set.bursts_noticed),
            short(&set.rough),
        ]);
    }
    line(format!("\n{table}"));
    out
}
