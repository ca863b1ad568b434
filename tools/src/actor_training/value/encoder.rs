//! What an encoder learns before it is frozen: the ranges in sight, on frames of flights by noise alone. There is no teacher here
//! but the simulator, and afterwards a frame is encoded once, not in each of the transitions that hold it.

use super::flyer::TrueFlight;
use super::value_config::ValueConfig;
use crate::actor_training::adam::{self, Adam};
use crate::actor_training::collector::CollectError;
use crate::actor_training::learner::UpdateError;
use crate::actor_training::networks::{Networks, SPEC, rate_shares_of};
use crate::actor_training::noise::OrnsteinUhlenbeck;
use crate::actor_training::replay_buffer::{pack_frame, unpack_frame};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use vigil_nnet::{Activation, Aligned, Dense, Isa, ShapeError};
use vigil_policy::apf;
use vigil_sim::environment::true_state::RAYS;
use vigil_types::{Action, DEPTH_PIXELS};
use vigil_world::Outcome;

/// Rays to each side of the nose within the sensor's ±60°.
const SIDE: usize = 8;
const TARGETS: usize = 2 * SIDE + 1;
/// Parts of a batch; fixed, so that the sums do not depend on the threads.
const SHARDS: usize = 4;
/// Seeds of the flights whose frames teach the encoder; no others use them.
const FIRST_SEED: u64 = 900_000_000;
const STREAM: u64 = 1 << 40;
const GRADIENT_NORM: f32 = 5.0;

struct Example {
    frame: Vec<u8>,
    /// From left to right.
    ranges: [f32; TARGETS],
}

fn collect(config: &ValueConfig) -> Result<Vec<Example>, CollectError> {
    let share = config.encoder.frames.div_ceil(config.environments);
    let parts = (0..config.environments)
        .into_par_iter()
        .map(|part| {
            let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
            rng.set_stream(STREAM + 1 + part as u64);
            let mut examples = Vec::with_capacity(share);
            let mut seed = FIRST_SEED + config.seed.wrapping_mul(1 << 24) + ((part as u64) << 20);
            while examples.len() < share {
                let family = config.families[rng.random_range(0..config.families.len())];
                let mut flight = TrueFlight::new(config, family, seed, config.time_limit_s)?;
                seed += 1;
                let mut wander = OrnsteinUhlenbeck::start(&mut rng);
                loop {
                    wander.step(config.noise.theta, &mut rng);
                    let mean = Action {
                        forward_m_s: config.warm_up_forward,
                        yaw: 0.0,
                    };
                    let (_, outcome) = flight.decide(config, apf::add(mean, wander.at(config.noise.sigma_first)));
                    if matches!(outcome, Some(o) if o != Outcome::TimeOut) || examples.len() == share {
                        break;
                    }
                    flight.look();
                    let mut frame = vec![0; DEPTH_PIXELS];
                    pack_frame(&flight.flight.frame().depth, &mut frame);
                    let state = flight.state();
                    let ranges = core::array::from_fn(|k| state[(RAYS + k - SIDE) % RAYS]);
                    examples.push(Example { frame, ranges });
                    if outcome.is_some() {
                        break;
                    }
                }
            }
            Ok(examples)
        })
        .collect::<Result<Vec<_>, CollectError>>()?;
    Ok(parts.into_iter().flatten().collect())
}

struct Shard {
    contrast: Vec<f32>,
    tape: Aligned,
    work: Aligned,
    d_features: Vec<f32>,
    d_encoder: Aligned,
    d_readout: Vec<f32>,
    loss: f32,
}

/// Teaches an encoder; returns its parameters and the loss after each hundred updates.
///
/// # Errors
/// A loss that is not finite.
pub fn teach_encoder(
    config: &ValueConfig,
    isa: Isa,
    report: &mut (dyn FnMut(u64, f32) + Send),
) -> Result<Vec<f32>, EncoderError> {
    let networks = Networks::new()?;
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    rng.set_stream(STREAM);
    let mut actor = networks.initial(&mut rng);
    let shares = rate_shares_of(SPEC);
    let encoder = networks.encoder_len();
    let features = networks.encoder.output_len();
    let readout = Dense {
        inputs: features,
        outputs: TARGETS,
    };
    let limit = (1.0 / features as f32).sqrt();
    let mut read: Vec<f32> = (0..readout.param_len())
        .map(|_| rng.random_range(-limit..limit))
        .collect();
    let read_shares = vec![0.0625; read.len()];
    let examples = collect(config)?;
    let (mut encoder_adam, mut read_adam) = (Adam::new(encoder), Adam::new(read.len()));
    let mut shards: Vec<Shard> = (0..SHARDS)
        .map(|_| Shard {
            contrast: vec![0.0; DEPTH_PIXELS],
            tape: Aligned::zeros(networks.encoder.tape_len()),
            work: Aligned::zeros(networks.encoder.work_len()),
            d_features: vec![0.0; features],
            d_encoder: Aligned::zeros(actor.len()),
            d_readout: vec![0.0; read.len()],
            loss: 0.0,
        })
        .collect();
    let (mut packed, mut read_packed) = (vec![0.0; actor.len()], vec![0.0; read.len()]);
    let mut mean_loss = 0.0;
    for update in 0..config.encoder.updates {
        let draws: Vec<(usize, bool)> = (0..config.encoder.batch)
            .map(|_| (rng.random_range(0..examples.len()), rng.random_bool(0.5)))
            .collect();
        networks.encoder.pack(&actor, &mut packed)?;
        readout.pack(&read, &mut read_packed)?;
        let count = (draws.len() * TARGETS) as f32;
        let per_shard = draws.len().div_ceil(SHARDS);
        shards.par_iter_mut().zip(draws.par_chunks(per_shard)).try_for_each(
            |(s, draws)| -> Result<(), ShapeError> {
                s.d_encoder.fill(0.0);
                s.d_readout.fill(0.0);
                s.loss = 0.0;
                for &(i, mirror) in draws {
                    let example = &examples[i];
                    unpack_frame(&example.frame, mirror, &mut s.contrast);
                    networks.encoder.forward(isa, &actor, &[&s.contrast], &mut s.tape)?;
                    let seen = networks.encoder.output(&s.tape)?;
                    let mut out = [0.0; TARGETS];
                    readout.forward(isa, &read, Activation::Identity, seen, None, &mut out)?;
                    let mut d = [0.0; TARGETS];
                    for (k, (d, out)) in d.iter_mut().zip(&out).enumerate() {
                        let error = out - example.ranges[if mirror { TARGETS - 1 - k } else { k }];
                        s.loss += error * error / count;
                        *d = 2.0 * error / count;
                    }
                    readout.weight_gradient(isa, seen, &d, &mut s.d_readout)?;
                    readout.input_gradient(isa, &read_packed, &d, &mut s.d_features)?;
                    let d_encoder = Some(&mut *s.d_encoder);
                    networks
                        .encoder
                        .backward(isa, &packed, &s.tape, &s.d_features, d_encoder, &mut s.work)?;
                }
                Ok(())
            },
        )?;
        let (total, others) = shards.split_at_mut(1);
        let total = &mut total[0];
        for other in others {
            total.loss += other.loss;
            let sums = [
                (&mut *total.d_encoder, &*other.d_encoder),
                (&mut *total.d_readout, &*other.d_readout),
            ];
            for (to, from) in sums {
                to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
            }
        }
        let d_encoder = &mut total.d_encoder[..encoder];
        let norm = adam::norm(&[d_encoder, &total.d_readout]);
        if !norm.is_finite() {
            return Err(UpdateError::NotFinite {
                update,
                what: "gradient",
                layer: "encoder",
            }
            .into());
        }
        let scale = adam::shortening(norm, GRADIENT_NORM);
        d_encoder.iter_mut().for_each(|d| *d *= scale);
        let left = 1.0 - 0.95 * (update as f32 / config.encoder.updates as f32);
        let rate = config.encoder.rate * left;
        encoder_adam.step(rate, &shares[..encoder], &mut actor[..encoder], d_encoder);
        read_adam.step(rate, &read_shares, &mut read, &total.d_readout);
        mean_loss += total.loss / 100.0;
        if (update + 1).is_multiple_of(100) {
            report(update + 1, mean_loss);
            mean_loss = 0.0;
        }
    }
    actor.truncate(encoder);
    Ok(actor)
}

/// Why an encoder could not be taught.
#[derive(Debug, thiserror::Error)]
pub enum EncoderError {
    /// A flight.
    #[error(transparent)]
    Collect(#[from] CollectError),
    /// An update.
    #[error(transparent)]
    Update(#[from] UpdateError),
    /// Networks that do not fit.
    #[error(transparent)]
    Network(#[from] ShapeError),
}
