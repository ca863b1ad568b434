//! A run that is stored, and goes on from there to the bit.

use super::{Candidate, Run, SoFar};
use crate::trainer::config::LearnConfig;
use crate::trainer::replay::Transition;
use crate::trainer::store::{Stored, Values, save};
use crate::trainer::worker::{EnvWorker, WorkerState};
use anyhow::{Result, ensure};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::time::Instant;
use vigil_nnet::train::adam::Adam;
use vigil_types::settings;

const FORMAT: &str = "vigil learn checkpoint 2";

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
        let same = state.format == FORMAT
            && settings::from_toml(&state.config).is_ok_and(|mut saved: LearnConfig| {
                let now = self.config.clone();
                // What new flights are made of, and how long it goes on, may change; what is stored or learned may not.
                (saved.threads, saved.families, saved.decisions) = (now.threads, now.families, now.decisions);
                (saved.drawn_vehicle_share, saved.evaluation) = (now.drawn_vehicle_share, now.evaluation);
                saved == *self.config
            });
        let counts = [state.transitions.len(), state.workers.len(), self.config.environments];
        let is_whole = counts.iter().all(|n| *n == counts[0]) && state.adam_steps.len() == 3;
        ensure!(same && is_whole, other);
        for (i, (lane, transitions)) in self.replay.trajectories.iter_mut().zip(state.transitions).enumerate() {
            lane.states = saved.u16(&format!("states_{i}"))?;
            lane.transitions = transitions;
        }
        let largest = f64::from_bits(state.largest_bits);
        let fits = self.replay.restore(&saved.f64("priorities")?, largest, &state.lanes);
        ensure!(fits, other);
        let config = self.config;
        let states = self.workers.par_iter_mut().zip(&state.workers);
        states.try_for_each(|(worker, state)| worker.restore(config, state))?;
        let l = &mut self.learner;
        let adam = |name: &str, len: usize, steps: u64| -> Result<Adam> {
            Ok(Adam {
                mean: saved.f32(&format!("{name}_mean"), Some(len))?,
                square: saved.f32(&format!("{name}_square"), Some(len))?,
                steps,
            })
        };
        let len = l.actor.len();
        l.actor = saved.f32("actor", Some(len))?;
        l.actor_target = saved.f32("actor_target", Some(len))?;
        l.actor_adam = adam("actor", len, state.adam_steps[0])?;
        for (i, (critic, steps)) in l.critics.iter_mut().zip(&state.adam_steps[1..]).enumerate() {
            let len = critic.params.len();
            critic.params = saved.f32(&format!("critic_{i}"), Some(len))?;
            critic.target = saved.f32(&format!("critic_{i}_target"), Some(len))?;
            critic.adam = adam(&format!("critic_{i}"), len, *steps)?;
        }
        l.updates = state.updates;
        for (i, (updates, completion)) in state.candidates.into_iter().enumerate() {
            self.candidates.push(Candidate {
                updates,
                completion,
                params: saved.f32(&format!("candidate_{i}"), Some(len))?,
            });
        }
        let (high, low) = state.random_at;
        self.rng.set_word_pos(u128::from(high) << 64 | u128::from(low));
        (self.so_far, self.earlier_s) = (state.so_far, state.elapsed_s);
        self.begun = Instant::now();
        Ok(())
    }

    pub(super) fn save(&self) -> Result<()> {
        self.write_tables()?;
        let at = self.rng.get_word_pos();
        let (priorities, largest, lanes) = self.replay.places();
        let l = &self.learner;
        let adams = [&l.actor_adam, &l.critics[0].adam, &l.critics[1].adam];
        let state = RunState {
            format: FORMAT.to_owned(),
            config: self.config.to_toml(),
            so_far: self.so_far.clone(),
            updates: l.updates,
            elapsed_s: self.elapsed_s(),
            random_at: ((at >> 64) as u64, at as u64),
            adam_steps: adams.iter().map(|adam| adam.steps).collect(),
            largest_bits: largest.to_bits(),
            lanes,
            transitions: self.replay.trajectories.iter().map(|l| l.transitions.clone()).collect(),
            workers: self.workers.iter().map(EnvWorker::state).collect(),
            candidates: self.candidates.iter().map(|c| (c.updates, c.completion)).collect(),
        };
        let mut tensors = vec![
            ("encoder".to_owned(), Values::F32(&self.encoder_params)),
            ("priorities".to_owned(), Values::F64(&priorities)),
            ("actor".to_owned(), Values::F32(&l.actor)),
            ("actor_target".to_owned(), Values::F32(&l.actor_target)),
            ("actor_mean".to_owned(), Values::F32(&l.actor_adam.mean)),
            ("actor_square".to_owned(), Values::F32(&l.actor_adam.square)),
        ];
        for (i, critic) in l.critics.iter().enumerate() {
            tensors.extend([
                (format!("critic_{i}"), Values::F32(&critic.params)),
                (format!("critic_{i}_target"), Values::F32(&critic.target)),
                (format!("critic_{i}_mean"), Values::F32(&critic.adam.mean)),
                (format!("critic_{i}_square"), Values::F32(&critic.adam.square)),
            ]);
        }
        for (i, lane) in self.replay.trajectories.iter().enumerate() {
            tensors.push((format!("states_{i}"), Values::U16(&lane.states)));
        }
        for (i, candidate) in self.candidates.iter().enumerate() {
            tensors.push((format!("candidate_{i}"), Values::F32(&candidate.params)));
        }
        save(&self.checkpoint, &state, &tensors)
    }
}
