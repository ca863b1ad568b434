//! `vigil detector`: data for the detectors, their training, and how well they detect.

mod images;
mod report;

pub(crate) use report::roc;

use crate::cli::collect::CollectArgs;
use crate::cli::output::{self, Interrupt, Progress, git_commit, or_dash, put, say};
use crate::detector_training::{
    EvaluationSize, Feature, Fitted, LstmConfig, Proportion, Record, Role, Scenario, Set, WindowScorer, draw_windows,
    evaluate, fly, load_flights, save_flights, sets,
};
use crate::report::{Figure, Picture, TextTable, to_csv};
use crate::statistics::quantile;
use crate::threads::thread_pool_of;
use anyhow::{Context, Result, bail, ensure};
use clap::builder::RangedU64ValueParser;
use rayon::prelude::*;
use report::{curves_png, percent, roc_figure, text};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use vigil_detector::FrozenDetector;
use vigil_nnet::Isa;
use vigil_policy::{FrozenActor, FrozenPilot};

fn epochs() -> RangedU64ValueParser<usize> {
    RangedU64ValueParser::new().range(1..=10_000)
}

/// The detector of this actor: of a file, or the one built in.
///
/// # Errors
/// A file that is none, a detector of another actor.
pub(crate) fn detector_of(actor_sha256: &str, file: Option<&Path>) -> Result<FrozenDetector> {
    let detector = file.map_or_else(FrozenDetector::built_in, FrozenDetector::load)?;
    ensure!(
        detector.actor_sha256 == actor_sha256,
        "the detector {} was trained for the actor {}, but the actor that flies is {actor_sha256}: give --detector a detector of this \
         actor (`vigil detector train --actor FILE`)",
        file.map_or("built in".to_owned(), |file| file.display().to_string()),
        detector.actor_sha256
    );
    Ok(detector)
}

/// Arguments of `vigil detector`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil detector collect                     fly the data, attacked and not, into runs/detector
  vigil detector train                      train LSTM-AD on them: runs/detector/lstm_ad.safetensors
  vigil detector evaluate                   score validation courses, attacks not trained on, controls
  vigil detector ablate                     the same network on the actor's state, actions, gradients instead
  vigil detector images                     states with the SHAP images of all pixels, for the next
  vigil detector table                      CNN-AD, FCN-AD, PCA and LSTM-AD on the same states
  vigil detector figures --seed 7           how the decisions of a flight are explained, as pictures
  vigil detector times                      how long deciding, explaining and scoring take
  vigil detector collect --actor my.safetensors -o runs/mine
  vigil detector collect --set learn --seed 3300 --flights 300 -o runs/a
                                            some of the flights, on another machine (docs/cluster.md)

But for figures and times, each needs the one before. Flights that are there already are not flown again. docs/detectors.md explains the method.")]
pub struct DetectorArgs {
    #[command(subcommand)]
    command: DetectorCommand,

    /// The frozen actor that is explained [default: the one built in].
    #[arg(long, value_name = "FILE", global = true)]
    actor: Option<PathBuf>,

    /// Folder of the data and results.
    #[arg(short, long, value_name = "DIR", default_value = "runs/detector", global = true)]
    output: PathBuf,

    /// Threads; all cores when absent. Any number gives the same bits.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024), global = true)]
    threads: Option<u16>,
}

#[derive(Debug, Clone, clap::Subcommand)]
enum DetectorCommand {
    /// Fly the data to learn from.
    Collect(CollectArgs),
    /// Train LSTM-AD and freeze it.
    Train {
        /// Epochs.
        #[arg(long, default_value_t = LstmConfig::default().fit.epochs, value_parser = epochs())]
        epochs: usize,
        /// Seed of first weights, order and background sample; below 2⁶³, as TOML's integers.
        #[arg(long, default_value_t = LstmConfig::default().fit.seed, value_parser = clap::value_parser!(u64).range(..1 << 63))]
        seed: u64,
    },
    /// Score flights on courses never trained on.
    Evaluate {
        #[command(flatten)]
        size: EvaluationSize,
        /// The frozen detector [default: lstm_ad.safetensors in the folder, or else the one built in].
        #[arg(long, value_name = "FILE")]
        detector: Option<PathBuf>,
    },
    /// Train the same network on other rows than SHAP values and score the same flights.
    Ablate {
        #[command(flatten)]
        size: EvaluationSize,
    },
    /// Fly one course and draw how its decisions are explained: the paper's figures 12, 13 and 14.
    Figures {
        /// Validation course.
        #[arg(long, default_value_t = 7)]
        seed: u64,
        /// Alter frames by the paper's attack, 50 steps from step 100 on.
        #[arg(long)]
        attacked: bool,
        /// Steps whose pixels are explained.
        #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=20))]
        pictures: u64,
        /// The frozen detector [default: lstm_ad.safetensors in the folder, or else the one built in].
        #[arg(long, value_name = "FILE")]
        detector: Option<PathBuf>,
    },
    /// Time decision, explanation and verdict on one flight's states, one thread: the paper's table IV.
    Times {
        /// Validation course.
        #[arg(long, default_value_t = 7)]
        seed: u64,
        /// Steps whose pixels are explained.
        #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=100))]
        pictures: u64,
        /// The frozen detector [default: lstm_ad.safetensors in the folder, or else the one built in].
        #[arg(long, value_name = "FILE")]
        detector: Option<PathBuf>,
    },
    /// Fly states and explain all pixels of their newest frame.
    Images {
        /// States to learn from, half of them attacked; a tenth as many choose the epoch.
        #[arg(long, default_value_t = 4000, value_parser = clap::value_parser!(u64).range(40..))]
        states: u64,
        /// States to score, half of them attacked, on validation courses.
        #[arg(long, default_value_t = 2000, value_parser = clap::value_parser!(u64).range(20..))]
        judged: u64,
        /// States of the background sample.
        #[arg(long, default_value_t = 30, value_parser = clap::value_parser!(u64).range(1..=100))]
        backgrounds: u64,
    },
    /// Train CNN-AD, FCN-AD and PCA on the images, and score the same states by all four.
    Table {
        /// Epochs of CNN-AD and FCN-AD.
        #[arg(long, default_value_t = 8, value_parser = epochs())]
        epochs: usize,
        /// Seed of their first weights and order.
        #[arg(long, default_value_t = 1)]
        seed: u64,
        /// The frozen LSTM-AD [default: lstm_ad.safetensors in the folder, or else the one built in].
        #[arg(long, value_name = "FILE")]
        detector: Option<PathBuf>,
    },
}

/// What `times.json` holds.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct TimesReport {
    pub version: String,
    pub actor_sha256: String,
    pub seed: u64,
    pub isa: String,
    pub rows: Vec<TimeRow>,
}

/// How long a part of the work took, one thread.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct TimeRow {
    pub part: String,
    pub measured: usize,
    pub median_s: Option<f64>,
    pub p99_s: Option<f64>,
    pub paper_s: f64,
}

/// What every stage needs.
pub(super) struct Stage<'a> {
    pub(super) isa: Isa,
    pub(super) pilot: FrozenPilot,
    pub(super) folder: &'a Path,
}

/// Runs a stage.
///
/// # Errors
/// A file that is no actor, data of another actor, a folder that cannot be written.
pub fn run(args: &DetectorArgs) -> Result<ExitCode> {
    let stage = Stage {
        isa: Isa::detect(),
        pilot: FrozenPilot::load_or_built_in(args.actor.as_deref())?,
        folder: &args.output,
    };
    let pool = thread_pool_of(args.threads)?;
    pool.install(|| match &args.command {
        DetectorCommand::Collect(collect) => stage.collect(collect, &pool),
        DetectorCommand::Images {
            states,
            judged,
            backgrounds,
        } => stage.images(*states as usize, *judged as usize, *backgrounds as usize),
        DetectorCommand::Train { epochs, seed } => stage.train(*epochs, *seed),
        DetectorCommand::Evaluate { size, detector } => stage.evaluate(size, detector.as_deref()),
        DetectorCommand::Ablate { size } => stage.ablate(size),
        DetectorCommand::Figures {
            seed,
            attacked,
            pictures,
            detector,
        } => stage.figures(*seed, *attacked, *pictures as usize, detector.as_deref()),
        DetectorCommand::Times {
            seed,
            pictures,
            detector,
        } => stage.times(*seed, *pictures as usize, detector.as_deref()),
        DetectorCommand::Table { epochs, seed, detector } => stage.table(*epochs, *seed, detector.as_deref()),
    })?;
    // What can be interrupted ends well, having said so.
    Ok(Interrupt::on_ctrl_c()?.exit_code())
}

impl Stage<'_> {
    /// The actor, for what explains all pixels of its frame.
    pub(super) fn actor(&self, command: &str) -> Result<&FrozenActor> {
        match &self.pilot {
            FrozenPilot::Actor(actor) => Ok(actor),
            FrozenPilot::Imported(_) => bail!(
                "`vigil detector {command}` explains all pixels of our own actor's frame, and --actor is an imported policy; \
                 collect, train, evaluate and ablate take one"
            ),
        }
    }

    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    fn training_flights(&self) -> Result<[Vec<Record>; 2]> {
        let load = |name| {
            let path = self.path(name);
            let file = path.display();
            ensure!(path.exists(), "no {file}: run `vigil detector collect` first");
            load_flights(&path, &self.pilot)
        };
        Ok([load("learn.safetensors")?, load("choose.safetensors")?])
    }

    fn train_on(
        &self,
        feature: Feature,
        [learn, choose]: &[Vec<Record>; 2],
        config: &LstmConfig,
    ) -> Result<(WindowScorer, Fitted)> {
        let steps = draw_windows(learn, config).len().div_ceil(config.fit.batch) * config.fit.epochs;
        let bar = Progress::new(steps as u64, "steps")?;
        let trained = crate::detector_training::train(
            self.isa,
            &self.pilot,
            feature,
            (learn, choose),
            config,
            &mut |step, epoch| {
                bar.set_position(step as u64);
                if let Some(e) = epoch {
                    bar.set_message(format!("epoch {}: {:.2} % right", e.epoch, 100.0 * e.choose_accuracy));
                }
            },
        )?;
        bar.finish();
        Ok(trained)
    }

    fn train(&self, epochs: usize, seed: u64) -> Result<()> {
        let mut config = LstmConfig::default();
        config.fit.epochs = epochs;
        config.fit.seed = seed;
        let flights = self.training_flights()?;
        let (mut scorer, fitted) = self.train_on(Feature::Shap, &flights, &config)?;
        let file = self.path("lstm_ad.safetensors");
        let threshold = scorer.threshold(self.isa, &self.pilot, &flights[1])?;
        (scorer.detector.threshold, scorer.detector.git_commit) = (threshold, git_commit());
        scorer.detector.save(&file)?;
        self.write("lstm_ad.csv", to_csv(&fitted.epochs))?;
        self.write("lstm_ad.png", curves_png(&fitted.epochs))?;
        let chosen = fitted.epochs.get(fitted.chosen.saturating_sub(1));
        say!(
            "LSTM-AD          {} after epoch {} of {epochs}, {} windows: {} right, loss {} on the flights that choose; \
             threshold {threshold:.3}",
            file.display(),
            fitted.chosen,
            draw_windows(&flights[0], &config).len(),
            or_dash(100.0 * chosen.map_or(f64::NAN, |e| e.choose_accuracy), 2, " %"),
            or_dash(chosen.map_or(f64::NAN, |e| e.choose_loss), 4, ""),
        );
        Ok(())
    }

    /// The evaluation's flights, flown or kept; none when Ctrl-C came first.
    fn evaluation(&self, size: &EvaluationSize) -> Result<Option<Vec<Set<Record>>>> {
        const FILE: &str = "evaluate.safetensors";
        let (sets, path) = (sets(size), self.path(FILE));
        let scenarios: Vec<&Scenario> = sets.iter().flat_map(|s| &s.flights).collect();
        let kept = path.exists().then(|| load_flights(&path, &self.pilot)).transpose()?;
        let is_same = |kept: &Vec<Record>| kept.iter().map(|r| &r.scenario).eq(scenarios.iter().copied());
        let records = match kept.filter(is_same) {
            Some(kept) => kept,
            None => {
                let bar = Progress::new(scenarios.len() as u64, "flights")?;
                let interrupt = Interrupt::on_ctrl_c()?;
                let mut records = Vec::new();
                for block in scenarios.chunks(8).take_while(|_| !interrupt.came()) {
                    let flown = block
                        .par_iter()
                        .map(|scenario| fly(self.isa, &self.pilot, scenario, &mut |_, _| Ok(())));
                    records.extend(flown.collect::<Result<Vec<_>>>()?);
                    bar.inc(block.len() as u64);
                }
                bar.finish();
                if interrupt.came() {
                    say!("interrupted: nothing of the evaluation is kept");
                    return Ok(None);
                }
                save_flights(&path, &self.pilot, &records)?;
                records
            }
        };
        let mut records = records.into_iter();
        let flown = sets.into_iter().map(|Set { name, role, flights }| Set {
            name,
            role,
            flights: records.by_ref().take(flights.len()).collect(),
        });
        Ok(Some(flown.collect()))
    }

    fn evaluate(&self, size: &EvaluationSize, detector: Option<&Path>) -> Result<()> {
        let scorer = WindowScorer::from_frozen(self.detector(detector)?);
        let frozen = &scorer.detector;
        let Some(sets) = self.evaluation(size)? else {
            return Ok(());
        };
        let at = |threshold| evaluate(self.isa, &self.pilot, &scorer, threshold, &sets);
        let (report, mut in_flight) = (at(0.5)?, at(frozen.threshold)?);
        // The curves are those of any threshold: once is enough.
        in_flight.roc.clear();
        in_flight.sets.iter_mut().for_each(|set| set.roc.clear());
        put!(
            "{}\nAT THE THRESHOLD IN FLIGHT ({})\n{}",
            text(&report),
            frozen.threshold_choice,
            text(&in_flight)
        );
        let json = serde_json::json!({
            "actor_sha256": frozen.actor_sha256,
            "detector_sha256": frozen.sha256(),
            "git_commit": git_commit(),
            "size": size,
            "at_one_half": report,
            "at_threshold": in_flight,
        });
        self.write_with_curves("evaluate.json", &json, (&roc(&report), "roc"))
    }

    /// The frozen LSTM-AD of this actor: of the file, of the folder, or the one built in.
    pub(super) fn detector(&self, file: Option<&Path>) -> Result<FrozenDetector> {
        let own = self.path("lstm_ad.safetensors");
        detector_of(&self.pilot.sha256(), file.or(own.exists().then_some(&own)))
    }

    fn times(&self, seed: u64, pictures: usize, detector: Option<&Path>) -> Result<()> {
        let (actor, detector) = (self.actor("times")?, self.detector(detector)?);
        let (record, times) = crate::detector_training::time(self.isa, actor, &detector, seed, pictures)?;
        let [action_s, explanation_s, verdict_s, pixels_s, cnn_s, fcn_s] = &times;
        say!(
            "validation course {seed}, {} steps, {} of them with all pixels; one thread, {}",
            record.steps.len(),
            pixels_s.len(),
            self.isa.name()
        );
        let in_all = |i: usize| action_s[i] + explanation_s[i] + verdict_s[i];
        let step_s: Vec<f64> = (0..action_s.len()).map(in_all).collect();
        let rows = [
            ("action", action_s, 0.056),
            ("SHAP values at the split point", explanation_s, 0.019),
            ("LSTM-AD", verdict_s, 0.001),
            ("a step of the three", &step_s, 0.076),
            ("SHAP values of all pixels of the frame", pixels_s, 13.33),
            ("CNN-AD", cnn_s, 0.162),
            ("FCN-AD", fcn_s, 0.056),
        ]
        .map(|(name, seconds, paper_s)| TimeRow {
            part: name.to_owned(),
            measured: seconds.len(),
            median_s: quantile(seconds, 0.5),
            p99_s: quantile(seconds, 0.99),
            paper_s,
        });
        let mut table = TextTable::new(" | > median | > 99 % | > paper");
        for row in &rows {
            let [median, p99] = [row.median_s, row.p99_s].map(|s| or_dash(1e3 * s.unwrap_or(f64::NAN), 3, " ms"));
            table.row([row.part.clone(), median, p99, format!("{:.0} ms", 1e3 * row.paper_s)]);
        }
        say!("{table}");
        let report = TimesReport {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            actor_sha256: self.pilot.sha256(),
            seed,
            isa: self.isa.name().to_owned(),
            rows: rows.into(),
        };
        self.write("times.json", serde_json::to_string_pretty(&report)?)?;
        say!("written          {}", self.path("times.json").display());
        Ok(())
    }

    fn ablate(&self, size: &EvaluationSize) -> Result<()> {
        let flights = self.training_flights()?;
        let Some(sets) = self.evaluation(size)? else {
            return Ok(());
        };
        let config = LstmConfig::default();
        let mut reports = Vec::new();
        let mut table = TextTable::new(
            "rows of | > accuracy | > AUC | > found at 1 % | > at 0.1 % | > false alarms | > untrained attacks found",
        );
        for feature in Feature::ALL {
            if Interrupt::on_ctrl_c()?.came() {
                say!("interrupted: nothing of the comparison is kept");
                return Ok(());
            }
            let (scorer, _) = self.train_on(feature, &flights, &config)?;
            let report = evaluate(self.isa, &self.pilot, &scorer, 0.5, &sets)?;
            let untrained = report.sets.iter().filter(|s| s.role == Role::Untrained);
            let (count, of) = untrained.fold((0, 0), |(c, o), s| (c + s.detected.count, o + s.detected.of));
            let s = &report.separation;
            table.row([
                feature.name().to_owned(),
                percent(&s.accuracy),
                or_dash(s.auc, 5, ""),
                or_dash(100.0 * s.found_at_1_percent, 2, " %"),
                or_dash(100.0 * s.found_at_0_1_percent, 2, " %"),
                percent(&s.false_alarms),
                percent(&Proportion::new(count, of)),
            ]);
            reports.push(report);
        }
        say!("{table}");
        let curves = roc_figure(reports.iter().map(|report| (report.feature.name(), report.roc.clone())));
        self.write_with_curves("ablate.json", &reports, (&curves, "ablate"))
    }

    fn write_with_curves(&self, json: &str, report: &impl Serialize, (curves, name): (&Figure, &str)) -> Result<()> {
        self.write(json, serde_json::to_string_pretty(report)?)?;
        curves.save(self.folder, name)?;
        let path = self.path(json);
        say!("written          {}, {name}.png and {name}.svg", path.display());
        Ok(())
    }

    pub(super) fn write(&self, name: &str, content: impl AsRef<[u8]>) -> Result<()> {
        let path = self.path(name);
        std::fs::create_dir_all(self.folder).with_context(|| format!("cannot make {}", self.folder.display()))?;
        output::write(&path, content)
    }
}
