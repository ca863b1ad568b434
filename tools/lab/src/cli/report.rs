//! `vigil report`: the paper's table I and figures 9 and 10, from the logs that training runs leave.

use crate::cli::output::{self, put, say};
use crate::report::{Figure, Panel, Picture, Series, from_csv};
use crate::trainer::evaluation::FamilyCount;
use crate::trainer::run::LearnResult;
use anyhow::{Context, Result, ensure};
use serde_json::Value;
use std::collections::HashSet;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use vigil_sim::world::{Family, Outcome};

/// A run of a million flights has 40 MB.
const SIZE_LIMIT: u64 = 256 << 20;
/// Arguments of `vigil report`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil report                        table I and figures 9 and 10 from the runs in docs/runs/from-nothing
  vigil report runs/a runs/b -o out   the same from runs of yours

A run is a folder that `vigil learn` left: result.json and flights.csv are read; of its tests the validation family's counts.
Runs with the field in no training flight are called DDPG, the others DDPG-APF.")]
pub struct ReportArgs {
    /// Folders of runs, or folders that hold them.
    #[arg(default_value = "docs/runs/from-nothing", value_name = "DIR")]
    runs: Vec<PathBuf>,

    /// Where table-1.md, figure-9 and figure-10 (PNG and SVG) go.
    #[arg(short, long, value_name = "DIR", default_value = "runs/report")]
    output: PathBuf,
}

/// A training flight, a line of `flights.csv`.
#[derive(Debug, serde::Deserialize)]
struct Flight {
    warm_up: u8,
    outcome: String,
    reward: f64,
}

pub(crate) struct Run {
    pub result: LearnResult,
    /// Flights over validation courses that nothing was chosen by.
    pub test: FamilyCount,
    flights: Vec<Flight>,
}

/// The runs with the field, or those without.
pub(crate) struct Arm {
    pub name: &'static str,
    pub runs: Vec<Run>,
}

impl Arm {
    /// Mean completion over the seeds, and half of its 95 % interval.
    pub fn mean(&self) -> (f64, Option<f64>) {
        let shares: Vec<f64> = self.runs.iter().map(|run| run.test.completion()).collect();
        mean_and_interval(&shares)
    }
}

/// The runs in these folders, those with the field first.
pub(crate) fn arms(given: &[PathBuf]) -> Result<Vec<Arm>> {
    let empty = |name| Arm { name, runs: Vec::new() };
    let mut arms = [empty("DDPG-APF"), empty("DDPG")];
    for folder in folders(given)? {
        let run = read(&folder)?;
        let [with, without] = &mut arms;
        let arm = if run.result.apf_share > 0.0 { with } else { without };
        arm.runs.push(run);
    }
    Ok(arms.into_iter().filter(|a| !a.runs.is_empty()).collect())
}

/// Reads the runs, prints table I and draws the figures.
pub fn run(args: &ReportArgs) -> Result<ExitCode> {
    let arms = arms(&args.runs)?;
    let table = table(&arms);
    put!("{table}");
    std::fs::create_dir_all(&args.output).with_context(|| format!("cannot make {}", args.output.display()))?;
    let mut written = vec![args.output.join("table-1.md")];
    output::write(&written[0], table)?;
    written.extend(REWARDS.figure(&arms).save(&args.output, "figure-9")?);
    written.extend(SUCCESSES.figure(&arms).save(&args.output, "figure-10")?);
    for path in written {
        say!("{}", path.display());
    }
    Ok(ExitCode::SUCCESS)
}

/// The folders themselves where they hold a finished run, otherwise those in them that do, by name.
fn folders(given: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let is_run = |folder: &PathBuf| folder.join("result.json").exists();
    let mut all = Vec::new();
    for folder in given {
        if is_run(folder) {
            all.push(folder.clone());
            continue;
        }
        let entries = std::fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
        let mut inner: Vec<PathBuf> = entries.filter_map(|e| Some(e.ok()?.path())).filter(is_run).collect();
        ensure!(
            !inner.is_empty(),
            "no finished run in {}: `vigil learn -o DIR` makes one",
            folder.display()
        );
        inner.sort();
        all.append(&mut inner);
    }
    // A run that is named twice is one all the same.
    let mut seen = HashSet::new();
    all.retain(|folder| folder.canonicalize().map_or(true, |path| seen.insert(path)));
    Ok(all)
}

fn read(folder: &Path) -> Result<Run> {
    let text = |name: &str| {
        let path = folder.join(name);
        vigil_types::files::read_text(&path, SIZE_LIMIT).with_context(|| format!("cannot read {}", path.display()))
    };
    let bad = |name: &str| format!("{} is not what `vigil learn` writes", folder.join(name).display());
    let json: Value = serde_json::from_str(&text("result.json")?).with_context(|| bad("result.json"))?;
    let result = serde_json::from_value::<LearnResult>(json).with_context(|| {
        let path = folder.join("result.json");
        format!(
            "{} is another program's, or of an earlier version; leave this folder out",
            path.display()
        )
    })?;
    let tests = |count: &&FamilyCount| count.family == Family::Validation && count.ablation.is_none();
    let test = result.test.iter().find(tests).cloned();
    let test = test.context("its actor was not tested on validation courses: `vigil learn --test-flights`");
    let test = test.with_context(|| bad("result.json"))?;
    let flights = from_csv(&text("flights.csv")?).with_context(|| bad("flights.csv"))?;
    Ok(Run { result, test, flights })
}

fn table(arms: &[Arm]) -> String {
    let mut text = String::from(
        "| Training | Seed | Decisions (steps of 0.05 s) | Flights | Updates | Minutes | Completion without the field | 95 % interval | Collisions | Time-outs |\n\
         | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |\n",
    );
    for arm in arms {
        for Run { result: r, test, .. } in &arm.runs {
            let (low, high) = test.wilson_95;
            let _ = writeln!(
                text,
                "| {} | {} | {} ({}) | {} | {} | {:.0} | {:.2} % of {} | {:.1} to {:.1} % | {} | {} |",
                arm.name,
                r.seed,
                r.decisions,
                r.steps,
                r.flights,
                r.updates,
                r.elapsed_s / 60.0,
                100.0 * test.completion(),
                test.flights,
                100.0 * low,
                100.0 * high,
                test.collisions,
                test.time_outs
            );
        }
        let (mean, half) = arm.mean();
        let _ = writeln!(
            text,
            "| **{}, {} seeds** | | | | | | **{:.2} %** | {} | | |",
            arm.name,
            arm.runs.len(),
            100.0 * mean,
            half.map_or_else(
                || "one run".to_owned(),
                |h| format!("± {:.2} (t, over seeds)", 100.0 * h)
            ),
        );
    }
    text
}

/// Mean, and half of Student's 95 % interval of the mean; none of a single value.
pub(crate) fn mean_and_interval(values: &[f64]) -> (f64, Option<f64>) {
    /// 97.5 % quantiles of Student's t with 1 to 9 degrees of freedom.
    const T: [f64; 9] = [12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262];
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let half = values.len().checked_sub(2).map(|i| {
        let variance = values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / (n - 1.0);
        // Beyond the table to 0.005 of it.
        let beyond = || 1.96 + 2.4 / (n - 1.0) + 2.8 / (n - 1.0).powi(2);
        T.get(i).copied().unwrap_or_else(beyond) * (variance / n).sqrt()
    });
    (mean, half)
}

/// Mean of each run of `count` neighbours, at the last one's number.
fn rolling(values: &[f64], count: usize) -> Vec<(f64, f64)> {
    let mean = |(i, w): (usize, &[f64])| ((i + count) as f64, w.iter().sum::<f64>() / count as f64);
    values.windows(count).enumerate().map(mean).collect()
}

/// The flights of the actor; in those of the warm-up it was not flying yet.
fn own<'a>(run: &'a Run, value: impl Fn(&Flight) -> f64 + 'a) -> Vec<f64> {
    run.flights.iter().filter(|f| f.warm_up == 0).map(value).collect()
}

fn longest(arms: &[Arm]) -> f64 {
    let runs = arms.iter().flat_map(|a| &a.runs);
    runs.map(|r| own(r, |_| 0.0).len()).max().unwrap_or(1) as f64
}

/// Mean over the runs, with the least and the greatest of them as its band; where fewer runs have values, of those.
fn over_seeds(label: &str, runs: &[Vec<(f64, f64)>]) -> Series {
    let longest = runs.iter().max_by_key(|r| r.len()).map_or(&[][..], Vec::as_slice);
    let over = |(i, (x, _)): (usize, &(f64, f64))| {
        let at = || runs.iter().filter_map(|r| r.get(i)).map(|(_, y)| *y);
        let mean = at().sum::<f64>() / at().count() as f64;
        let least = at().fold(f64::INFINITY, f64::min);
        (*x, mean, least, at().fold(f64::NEG_INFINITY, f64::max))
    };
    Series::banded(label, longest.iter().enumerate().map(over))
}

/// A rolling mean over each run's training flights.
pub(crate) struct Curve {
    /// Flights that it is the mean of.
    count: usize,
    of: fn(&Flight) -> f64,
    title: &'static str,
    y_label: &'static str,
}

pub(crate) const REWARDS: Curve = Curve {
    count: 20,
    of: |flight| flight.reward,
    title: "Reward, mean of the last 20 flights (band: all seeds)",
    y_label: "reward (m and bonuses)",
};
/// Figure 10; the paper's ten flights.
pub(crate) const SUCCESSES: Curve = Curve {
    count: 10,
    of: |flight| f64::from(u8::from(flight.outcome == Outcome::Success.name())),
    title: "Share of the last 10 flights that reached the goal (band: all seeds)",
    y_label: "share of flights",
};

impl Curve {
    fn runs<'a>(&'a self, arm: &'a Arm) -> impl Iterator<Item = Vec<(f64, f64)>> + 'a {
        arm.runs.iter().map(|run| rolling(&own(run, self.of), self.count))
    }

    /// Its last value of each run.
    pub fn last(&self, arm: &Arm) -> Vec<f64> {
        self.runs(arm).filter_map(|curve| Some(curve.last()?.1)).collect()
    }

    /// Mean over the seeds, and their range.
    pub fn figure(&self, arms: &[Arm]) -> Figure {
        let series = arms.iter().map(|arm| {
            let runs: Vec<_> = self.runs(arm).collect();
            over_seeds(&format!("{}, {} seeds", arm.name, runs.len()), &runs)
        });
        let panel = Panel::of(self.title, self.y_label, series);
        let label = "training flight (those of the warm-up are left out)";
        Figure::over(label, longest(arms), vec![panel])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mean_over_seeds_has_students_interval() {
        // Of 1, 2, 3, 4, 5: mean 3, deviation 1.5811, 2.776 × 1.5811 / √5 = 1.9629.
        let (mean, half) = mean_and_interval(&[1.0, 2.0, 3.0, 4.0, 5.0]);
        assert!((mean - 3.0).abs() < 1e-12);
        assert!((half.unwrap() - 1.9629).abs() < 1e-3);
        assert_eq!(mean_and_interval(&[0.5]), (0.5, None));
    }

    #[test]
    fn a_run_by_value_is_read_by_its_validation_flights() {
        let count = |family: &str, successes: usize| {
            format!(
                r#"{{"family": "{family}", "first_seed": 7000000, "flights": 40, "successes": {successes}, "collisions": 1, "time_outs": 0, "wilson_95": [0.8, 0.99]}}"#
            )
        };
        let result = |tests: &str| {
            format!(
                r#"{{"sees": "pictures", "seed": 3, "apf_share": 0.25, "steps": 480, "flights": 9, "decisions": 120, "updates": 60, "frozen_after": 50, "elapsed_s": 90.0, "test": [{tests}]}}"#
            )
        };
        let temporary = tempfile::tempdir().unwrap();
        let folder = temporary.path();
        let flights = "flight,updates,warm_up,field,outcome,decisions,reward\n1,0,1,0,collision,20,-3.5\n2,4,0,1,success,88,24.6\n";
        std::fs::write(folder.join("flights.csv"), flights).unwrap();
        let tests = [count("training", 40), count("validation", 39)].join(", ");
        std::fs::write(folder.join("result.json"), result(&tests)).unwrap();
        assert_eq!(folders(&[folder.join("."), folder.into()]).unwrap().len(), 1);
        let run = read(folder).unwrap();
        assert_eq!(
            (own(&run, |f| f.reward), own(&run, SUCCESSES.of)),
            (vec![24.6], vec![1.0])
        );
        let (name, runs) = ("DDPG-APF", vec![run]);
        let table = table(&[Arm { name, runs }]);
        let line = "| DDPG-APF | 3 | 120 (480) | 9 | 60 | 2 | 97.50 % of 40 |";
        assert!(table.contains(line), "{table}");
        std::fs::write(folder.join("result.json"), result(&count("hard", 4))).unwrap();
        let error = format!("{:#}", read(folder).err().unwrap());
        assert!(
            error.contains("result.json") && error.contains("--test-flights"),
            "{error}"
        );
        std::fs::write(folder.join("result.json"), result("").replace("[]", "{}")).unwrap();
        let error = format!("{:#}", read(folder).err().unwrap());
        assert!(error.contains("earlier version; leave this folder out"), "{error}");
        // A row of another table is no flight.
        assert!(from_csv::<Flight>(&(flights.to_owned() + "50,12000,42.2\n")).is_err());
    }
}
