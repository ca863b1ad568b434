//! Trains any network with one output to tell two classes apart.

use crate::report::decimals;
use anyhow::{Result, ensure};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use vigil_nnet::train::adam::{Adam, norm, shortening};
use vigil_nnet::{Graph, Isa};

/// Examples with their class.
pub trait Examples: Sync {
    /// How many.
    fn count(&self) -> usize;

    /// The network's inputs of example `i`.
    fn inputs<'a>(&'a self, i: usize, buffer: &'a mut Vec<f32>) -> Vec<&'a [f32]>;

    /// Its class.
    fn attacked(&self, i: usize) -> bool;
}

/// How it is trained.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FitConfig {
    /// Passes over the examples.
    pub epochs: usize,
    /// Examples of a step.
    pub batch: usize,
    /// Adam's rate at the start; it falls along half a cosine to a hundredth.
    pub rate: f32,
    /// Longest gradient.
    pub gradient_norm: f32,
    /// Share of each weight taken away at each step, times the rate.
    pub weight_decay: f32,
    /// Seed of first weights and order.
    pub seed: u64,
}

/// Losses after an epoch: a line of the curves beside a detector.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Epoch {
    /// From 1.
    pub epoch: usize,
    /// Mean cross entropy while training.
    #[serde(serialize_with = "decimals::<6, _, _>")]
    pub train_loss: f64,
    /// The same on the examples that choose.
    #[serde(serialize_with = "decimals::<6, _, _>")]
    pub choose_loss: f64,
    /// Share of them on the right side of 0.5.
    #[serde(serialize_with = "decimals::<6, _, _>")]
    pub choose_accuracy: f64,
}

/// The result.
#[derive(Debug, Clone, PartialEq)]
pub struct Fitted {
    /// Parameters of the chosen epoch.
    pub params: Vec<f32>,
    /// The chosen epoch: least loss on the examples that choose.
    pub chosen: usize,
    /// All epochs.
    pub epochs: Vec<Epoch>,
}

/// Examples whose gradients one task adds up: fixed, so that sums do not depend on the number of threads.
const SHARE: usize = 8;

/// Cross entropy of a logit, and its slope.
fn loss(logit: f32, attacked: bool) -> (f64, f32) {
    let (z, y) = (f64::from(logit), f64::from(u8::from(attacked)));
    let value = z.max(0.0) - z * y + libm::log1p(libm::exp(-z.abs()));
    (value, (1.0 / (1.0 + libm::exp(-z)) - y) as f32)
}

/// The network's output for each example.
///
/// # Errors
/// Examples that do not fit.
pub fn outputs(graph: &Graph, isa: Isa, params: &[f32], examples: &impl Examples) -> Result<Vec<f32>> {
    (0..examples.count())
        .into_par_iter()
        .with_min_len(SHARE)
        .map_init(
            || (vec![0.0; graph.tape_len()], Vec::new()),
            |(tape, values), i| {
                graph.forward(isa, params, &examples.inputs(i, values), tape)?;
                Ok(graph.output(tape)?[0])
            },
        )
        .collect()
}

/// Loss and gradient of a share of the examples, each a sum.
fn add_up(
    graph: &Graph,
    isa: Isa,
    (params, packed): (&[f32], &[f32]),
    train: &impl Examples,
    share: &[usize],
) -> Result<(f64, Vec<f32>)> {
    let (mut tape, mut work) = (vec![0.0; graph.tape_len()], vec![0.0; graph.work_len()]);
    let mut values = Vec::new();
    let mut gradient = vec![0.0; params.len()];
    let mut sum = 0.0;
    for i in share {
        graph.forward(isa, params, &train.inputs(*i, &mut values), &mut tape)?;
        let (value, slope) = loss(graph.output(&tape)?[0], train.attacked(*i));
        sum += value;
        graph.backward(isa, packed, &tape, &[slope], Some(&mut gradient), &mut work)?;
    }
    Ok((sum, gradient))
}

/// Trains a network whose output is a logit, from parameters that are given. The same arguments give the same bits on any
/// number of threads.
///
/// # Errors
/// Examples that do not fit, a loss that is not finite.
pub fn fit(
    graph: &Graph,
    isa: Isa,
    mut params: Vec<f32>,
    train: &impl Examples,
    choose: &impl Examples,
    config: &FitConfig,
    progress: &mut dyn FnMut(usize, Option<&Epoch>),
) -> Result<Fitted> {
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    let mut adam = Adam::new(params.len());
    let mut gradient = vec![0.0; params.len()];
    let mut packed = vec![0.0; params.len()];
    let mut order: Vec<usize> = (0..train.count()).collect();
    let steps = train.count().div_ceil(config.batch) * config.epochs;
    let mut best: Option<(f64, usize, Vec<f32>)> = None;
    let mut epochs = Vec::new();
    let mut step = 0;
    for epoch in 1..=config.epochs {
        order.shuffle(&mut rng);
        let diverged = || format!("the loss in epoch {epoch} is not finite; lower the rate");
        let mut sum = 0.0;
        for batch in order.chunks(config.batch) {
            graph.pack(&params, &mut packed)?;
            let parts = batch.par_chunks(SHARE);
            let parts = parts.map(|share| add_up(graph, isa, (&params, &packed), train, share));
            let parts = parts.collect::<Result<Vec<_>>>()?;
            for (part_sum, part) in parts {
                sum += part_sum;
                for (g, part) in gradient.iter_mut().zip(part) {
                    *g += part / batch.len() as f32;
                }
            }
            let length = norm(&gradient);
            ensure!(length.is_finite(), diverged());
            let factor = shortening(length, config.gradient_norm);
            let turn = core::f64::consts::PI * step as f64 / steps as f64;
            let rate = config.rate * (0.01 + 0.99 * 0.5 * (1.0 + libm::cos(turn) as f32));
            params.iter_mut().for_each(|p| *p *= 1.0 - rate * config.weight_decay);
            adam.step(rate, factor, &mut params, &mut gradient);
            step += 1;
            progress(step, None);
        }
        let logits = outputs(graph, isa, &params, choose)?;
        let (mut choose_sum, mut right) = (0.0, 0usize);
        for (i, logit) in logits.iter().enumerate() {
            choose_sum += loss(*logit, choose.attacked(i)).0;
            right += usize::from((*logit > 0.0) == choose.attacked(i));
        }
        let row = Epoch {
            epoch,
            train_loss: sum / train.count() as f64,
            choose_loss: choose_sum / choose.count().max(1) as f64,
            choose_accuracy: right as f64 / choose.count().max(1) as f64,
        };
        ensure!((row.train_loss + row.choose_loss).is_finite(), diverged());
        if best.as_ref().is_none_or(|(least, ..)| row.choose_loss < *least) {
            best = Some((row.choose_loss, epoch, params.clone()));
        }
        epochs.push(row);
        progress(step, Some(&row));
    }
    let (_, chosen, params) = best.unwrap_or((f64::NAN, 0, params));
    Ok(Fitted { params, chosen, epochs })
}
