//! States with the SHAP images of all pixels, and the detectors of images beside ours on them.

use super::Stage;
use super::report::{curves_png, share, short};
use crate::cli::output::{Interrupt, Progress, git_commit, or_dash, say};
use crate::detector_training::{
    FitConfig, ImageNetwork, LstmConfig, States, WindowScorer, gather_states, lstm_scores, pca_scores, row,
};
use crate::report::{TextTable, to_csv};
use anyhow::{Context, Result, ensure};
use std::path::Path;
use vigil_sim::world::Family;

/// First seeds of the states with images to learn from, without an end, and below them of those that choose; the others are on validation
/// courses.
const LEARN_SEED: u64 = 5000;
const CHOOSE_SEED: u64 = 2500;
const JUDGE_SEED: u64 = 7000;

impl Stage<'_> {
    pub(super) fn images(&self, states: usize, scored: usize, backgrounds: usize) -> Result<()> {
        let (interrupt, actor) = (Interrupt::on_ctrl_c()?, self.actor("images")?);
        let load = |path: &Path| -> Result<States> {
            let there = States::load(path, actor)?;
            ensure!(
                there.backgrounds.is_none_or(|of| of as usize == backgrounds),
                "{} is of {} backgrounds, not {backgrounds}: remove it, or name another folder with -o",
                path.display(),
                there.backgrounds.unwrap_or_default()
            );
            Ok(there)
        };
        for (part, family, seed, count) in [
            ("learn", Family::Training, LEARN_SEED, states / 2),
            ("choose", Family::Training, CHOOSE_SEED, states / 20),
            ("judge", Family::Validation, JUDGE_SEED, scored / 2),
        ] {
            let name = format!("images-{part}.safetensors");
            let path = self.path(&name);
            if path.exists() {
                let there = load(&path)?.states.len();
                ensure!(
                    there >= 2 * count,
                    "{} holds {there} states, not {}: remove it, or name another folder with -o",
                    path.display(),
                    2 * count
                );
                say!("{name:<26} is there already");
                continue;
            }
            let bar = Progress::new(count as u64, "states of each class")?;
            let (place, size) = ((family, seed), (count, backgrounds));
            let part = self.path(&format!("{name}.part"));
            let begun = part.exists().then(|| load(&part)).transpose()?;
            // What is mixed could not be taken apart later.
            ensure!(
                begun.as_ref().is_none_or(|begun| begun.backgrounds.is_some()),
                "{} is of an earlier version: remove it",
                part.display()
            );
            let mut progress = |count| {
                bar.set_position(count as u64);
                interrupt.flow()
            };
            let (states, complete) = gather_states(self.isa, actor, place, size, begun, &mut progress)?;
            bar.finish();
            if !complete {
                states.save(&part, actor)?;
                let (count, part) = (states.states.len(), part.display());
                say!("interrupted: {count} states are kept in {part}; the same command goes on with them");
                return Ok(());
            }
            states.save(&path, actor)?;
            // What they held is in the files just written.
            let _ = std::fs::remove_file(&part);
            let _ = std::fs::remove_file(part.with_extension("flights"));
            let (count, flights) = (states.states.len(), states.records.len());
            say!("{name:<26} {count} states of {flights} flights from seed {seed}");
        }
        Ok(())
    }

    pub(super) fn table(&self, epochs: usize, seed: u64, detector: Option<&Path>) -> Result<()> {
        let actor = self.actor("table")?;
        let scorer = WindowScorer::from_frozen(self.detector(detector)?);
        let frozen = &scorer.detector;
        let load = |name| States::load(&self.path(name), actor).context("run `vigil detector images` first");
        let (learn, choose) = (load("images-learn.safetensors")?, load("images-choose.safetensors")?);
        let scored = load("images-judge.safetensors")?;
        let mut rows = Vec::new();
        for (network, paper) in [(ImageNetwork::FCN, 0.56), (ImageNetwork::CNN, 0.80)] {
            let config = FitConfig {
                epochs,
                batch: 32,
                seed,
                ..LstmConfig::default().fit
            };
            let steps = (learn.states.len().div_ceil(config.batch) * epochs) as u64;
            let bar = Progress::new(steps, "steps")?;
            let fitted = network.train(self.isa, (&learn, &choose), &config, &mut |step, epoch| {
                bar.set_position(step as u64);
                if let Some(e) = epoch {
                    let right = 100.0 * e.choose_accuracy;
                    bar.set_message(format!("{} epoch {}: {right:.1} % right", network.0, e.epoch));
                }
            })?;
            bar.finish();
            let name = network.0.to_lowercase().replace('-', "_");
            self.write(&format!("{name}.csv"), to_csv(&fitted.epochs))?;
            self.write(&format!("{name}.png"), curves_png(&fitted.epochs))?;
            let scores = network.scores(self.isa, &fitted.params, &scored)?;
            rows.push(row(network.0, paper, 0.5, &scored, &scores));
        }
        let lstm = lstm_scores(self.isa, &self.pilot, &scorer, &scored)?;
        rows.push(row("LSTM-AD", 0.91, frozen.threshold, &scored, &lstm));
        let pca = pca_scores(&learn, &choose, &scored);
        rows.push(row("PCA", 0.70, 1.0, &scored, &pca));
        let mut table = TextTable::new("detector | > paper | accuracy | > detected % | > false alarms % | > AUC");
        for of in &rows {
            let s = &of.separation;
            table.row([
                of.detector.to_owned(),
                format!("{:.0} %", 100.0 * of.paper),
                share(&s.accuracy),
                short(&s.detected),
                short(&s.false_alarms),
                or_dash(s.auc, 4, ""),
            ]);
        }
        say!("{table}");
        let json = serde_json::json!({
            "actor_sha256": frozen.actor_sha256,
            "detector_sha256": frozen.sha256(),
            "git_commit": git_commit(),
            "learned_from": learn.states.len(),
            "rows": rows,
        });
        self.write("table.json", serde_json::to_string_pretty(&json)?)?;
        say!("written    {}", self.path("table.json").display());
        Ok(())
    }
}
