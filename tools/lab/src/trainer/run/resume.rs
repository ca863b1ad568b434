//! A run that is stored, and goes on from there to the bit.

use super::{Candidate, Run, SoFar};
use crate::trainer::config::LearnConfig;
use crate::trainer::replay::Transition;
use crate::trainer::store::{FORMAT, Stored, Tensor, save, tensor};
use crate::trainer::worker::{EnvWorker, WorkerState};
use anyhow::{Result, bail, ensure};
use rayon::prelude::*;
use safetensors::Dtype;
use serde::{Deserialize, Serialize};
use std::time::Instant;
use vigil_types::settings;

#[derive(Serialize, Deserialize)]
struct RunState {
    format: String,
    config: String,
    so_far: SoFar,
    updates: u64,
    elapsed_s: f64,
    random_at: (u64, u64),
    adam_steps: Vec<u64>,
    largest_bits: u64,
    lanes: Vec<(u64, u64)>,
    transitions: Vec<Vec<Transition>>,
    workers: Vec<WorkerState>,
    candidates: Vec<(u64, f64)>,
}

impl Run<'_> {
    pub(super) fn restore(&mut self, saved: &Stored) -> Result<()> {
        let state: RunState = saved.state()?;
        let checkpoint = self.checkpoint.display();
        let other = format!(
            "checkpoint {checkpoint} is of a run with another configuration: only `threads`, `families`, `decisions`, `drawn_vehicle_share` \
             and `evaluation` may change; resume with the same one, or train in another folder"
        );
        let Ok(mut earlier) = settings::from_toml::<LearnConfig>(&state.config) else {
            bail!(other)
        };
        let config = self.config;
        let (e, now) = (&mut earlier.evaluation, &config.evaluation);
        (e.every_updates, e.final_flights) = (now.every_updates, now.final_flights);
        let is_measured_alike = *e == *now;
        // What new flights are made of, and how long it goes on, may change; what is stored or learned may not.
        (earlier.threads, earlier.families, earlier.decisions) =
            (config.threads, config.families.clone(), config.decisions);
        (earlier.drawn_vehicle_share, earlier.evaluation) = (config.drawn_vehicle_share, now.clone());
        let counts = [state.transitions.len(), state.workers.len(), config.environments];
        let is_whole = counts.iter().all(|n| *n == counts[0]) && state.adam_steps.len() == 3;
        ensure!(earlier == *config && is_whole, other);
        let (all, made) = (config.decisions, state.so_far.decisions);
        // The last round of the environments may go beyond.
        ensure!(
            made < all.saturating_add(config.environments as u64),
            "`decisions` is {all}, but checkpoint {checkpoint} has made {made}"
        );
        for (i, (lane, transitions)) in self.replay.trajectories.iter_mut().zip(state.transitions).enumerate() {
            lane.states = saved.numbers(&format!("states_{i}"), Dtype::U16, u16::from_le_bytes)?;
            lane.transitions = transitions;
        }
        let largest = f64::from_bits(state.largest_bits);
        let priorities = saved.numbers("priorities", Dtype::F64, f64::from_le_bytes)?;
        let fits = self.replay.restore(&priorities, largest, &state.lanes);
        ensure!(fits, other);
        let states = self.workers.par_iter_mut().zip(&state.workers);
        states.try_for_each(|(worker, state)| worker.restore(config, state))?;
        for ((name, network), steps) in self.learner.networks().into_iter().zip(state.adam_steps) {
            let len = network.params.len();
            network.adam.steps = steps;
            for (end, values) in network.parts() {
                *values = saved.f32(&format!("{name}{end}"), Some(len))?;
            }
        }
        self.learner.updates = state.updates;
        for (i, (updates, completion)) in state.candidates.into_iter().enumerate() {
            let params = saved.f32(&format!("candidate_{i}"), Some(self.learner.actor.params.len()))?;
            if is_measured_alike {
                self.candidates.push(Candidate {
                    updates,
                    completion,
                    params,
                });
            } else {
                // By other flights it would be compared with those to come.
                self.add_candidate(updates, params)?;
            }
        }
        let (high, low) = state.random_at;
        self.rng.set_word_pos(u128::from(high) << 64 | u128::from(low));
        (self.so_far, self.earlier_s) = (state.so_far, state.elapsed_s);
        self.begun = Instant::now();
        Ok(())
    }

    pub(super) fn save(&mut self) -> Result<()> {
        self.write_tables()?;
        let at = self.rng.get_word_pos();
        let (priorities, largest, lanes) = self.replay.places();
        let mut state = RunState {
            format: FORMAT.to_owned(),
            config: settings::to_toml(self.config),
            so_far: self.so_far.clone(),
            updates: self.learner.updates,
            elapsed_s: self.elapsed_s(),
            random_at: ((at >> 64) as u64, at as u64),
            adam_steps: Vec::new(),
            largest_bits: largest.to_bits(),
            lanes,
            transitions: self.replay.trajectories.iter().map(|l| l.transitions.clone()).collect(),
            workers: self.workers.iter().map(EnvWorker::state).collect(),
            candidates: self.candidates.iter().map(|c| (c.updates, c.completion)).collect(),
        };
        let f32s = |name: String, values: &[f32]| tensor(name, Dtype::F32, values, f32::to_le_bytes);
        let mut tensors: Vec<Tensor> = vec![
            f32s("encoder".into(), &self.encoder_params),
            tensor("priorities".into(), Dtype::F64, &priorities, f64::to_le_bytes),
        ];
        for (name, network) in self.learner.networks() {
            state.adam_steps.push(network.adam.steps);
            let parts = network.parts().into_iter();
            tensors.extend(parts.map(|(end, values)| f32s(format!("{name}{end}"), values)));
        }
        for (i, lane) in self.replay.trajectories.iter().enumerate() {
            let name = format!("states_{i}");
            tensors.push(tensor(name, Dtype::U16, &lane.states, u16::to_le_bytes));
        }
        let candidates = self.candidates.iter().enumerate();
        tensors.extend(candidates.map(|(i, candidate)| f32s(format!("candidate_{i}"), &candidate.params)));
        save(&self.checkpoint, &state, tensors)
    }
}
