//! What the 48 values hold of what was seen earlier: linear read-outs of it, fitted on some flights and tried on others.

use crate::trainer::evaluation::{EvaluatedActor, EvaluationSpec, fly};
use anyhow::{Context, Result};
use nalgebra::DMatrix;
use rayon::prelude::*;
use std::f32::consts::{FRAC_PI_3, PI};
use vigil_nnet::Isa;
use vigil_policy::FrozenActor;
use vigil_policy::actor::memory::{proximity, range_m, scan_bearing_rad};
use vigil_types::Ablation;

/// How long ago what is asked for was seen, seconds.
pub const LAGS_S: [usize; 3] = [5, 15, 30];
/// Steps of a second, and steps on either side of the moment that is asked for that count as well.
const STEPS_PER_S: usize = 20;
const WITHIN: usize = 5;
/// Directions that are out of view, each 60° wide: 60° to 120° and 120° to 180° on either side.
const SECTORS: usize = 4;
/// A sample is taken every so many steps.
const EVERY: usize = 5;
/// Added to the diagonal of the normal equations, as a share of their mean.
const RIDGE: f64 = 1e-4;

/// Shares of the variance that are read out, R², on flights that nothing was fitted on; not a number without flights that are long enough.
#[derive(Debug, Clone, Copy)]
pub struct Readout {
    /// How long ago, seconds.
    pub lag_s: usize,
    /// Moments of the flights that it was tried on.
    pub samples: usize,
    /// From the 48 values, and the controls: from those of the same actor beside it, its memory wiped; from the newest scan; from the 48
    /// values, what another flight saw.
    pub shares: [f64; 4],
}

/// A moment of a flight: what is read from, and for each lag the proximities that are asked for, where the flight is old enough.
struct Sample {
    sources: [Vec<f32>; 3],
    seen: [Option<[f32; SECTORS]>; LAGS_S.len()],
}

/// Flies an actor and fits; of three flights two are fitted on.
///
/// # Errors
/// Parameters of another architecture.
pub fn probe(frozen: &FrozenActor, isa: Isa, what: &EvaluationSpec) -> Result<Vec<Readout>> {
    let flights = (0..what.flights)
        .into_par_iter()
        .map(|i| samples(frozen, isa, what, what.first_seed.wrapping_add(i)))
        .collect::<Result<Vec<_>>>()?;
    let readout = |(lag, &lag_s): (usize, &usize)| {
        let r2 = |source: usize, shift: usize| {
            let pairs = |is_fitted: bool| {
                let chosen = (0..flights.len()).filter(move |i| (i % 3 < 2) == is_fitted);
                chosen.flat_map(|i| {
                    let other = &flights[(i + 3 * shift) % flights.len()];
                    let pairs = flights[i].iter().zip(other.iter().map(|sample| sample.seen[lag]));
                    pairs.filter_map(|(sample, seen)| {
                        sample.seen[lag].and(seen).map(|seen| (&*sample.sources[source], seen))
                    })
                })
            };
            r_squared(&pairs(true).collect::<Vec<_>>(), &pairs(false).collect::<Vec<_>>())
        };
        let tried = flights.iter().skip(2).step_by(3).flatten();
        Ok(Readout {
            lag_s,
            samples: tried.filter(|sample| sample.seen[lag].is_some()).count(),
            shares: [r2(0, 0)?, r2(1, 0)?, r2(2, 0)?, r2(0, 1)?],
        })
    };
    LAGS_S.iter().enumerate().map(readout).collect()
}

/// One flight of the actor, its twin without a memory beside it.
fn samples(frozen: &FrozenActor, isa: Isa, what: &EvaluationSpec, seed: u64) -> Result<Vec<Sample>> {
    let mut twin = frozen.actor(isa)?.without(Ablation::Memory);
    // In each step the places of the surfaces seen, north and east.
    let mut seen: Vec<Vec<(f32, f32)>> = Vec::new();
    let mut samples = Vec::new();
    let pilot = EvaluatedActor::Actor(frozen);
    fly(pilot, isa, what, seed, |actor, input, position_ned_m| {
        twin.decide(input)?;
        let (sin, cos) = input.attitude.yaw_rad().sin_cos();
        let places = actor.scan().iter().enumerate().map(|(column, near)| {
            let (right, forward) = scan_bearing_rad(column).sin_cos();
            let range_m = range_m(*near);
            let (forward_m, right_m) = (range_m * forward, range_m * right);
            (
                position_ned_m.x + cos * forward_m - sin * right_m,
                position_ned_m.y + sin * forward_m + cos * right_m,
            )
        });
        seen.push(places.collect());
        if seen.len().is_multiple_of(EVERY) {
            let of = |lag_s: &usize| {
                let at = seen.len().checked_sub(1 + lag_s * STEPS_PER_S)?;
                let mut nearest = [0.0_f32; SECTORS];
                let then = &seen[at.saturating_sub(WITHIN)..=at + WITHIN];
                for (north_m, east_m) in then.iter().flatten() {
                    let (north, east) = (north_m - position_ned_m.x, east_m - position_ned_m.y);
                    let bearing_rad = (cos * east - sin * north).atan2(cos * north + sin * east);
                    let sector = ((bearing_rad + PI) / FRAC_PI_3) as usize;
                    // Of the six those ahead, the third and the fourth, are in view.
                    let at = match sector {
                        0 | 1 => sector,
                        4 | 5 => sector - 2,
                        _ => continue,
                    };
                    nearest[at] = nearest[at].max(proximity(north.hypot(east)));
                }
                Some(nearest)
            };
            samples.push(Sample {
                sources: [actor.state().to_vec(), twin.state().to_vec(), actor.scan().to_vec()],
                seen: LAGS_S.each_ref().map(of),
            });
        }
        Ok(())
    })?;
    Ok(samples)
}

/// Fits on the first pairs by ridge regression and tries on the others; not a number without any.
fn r_squared(fitted: &[(&[f32], [f32; SECTORS])], tried: &[(&[f32], [f32; SECTORS])]) -> Result<f64> {
    if fitted.is_empty() || tried.is_empty() {
        return Ok(f64::NAN);
    }
    // The last column is for the mean.
    let matrices = |pairs: &[(&[f32], [f32; SECTORS])]| {
        let width = pairs[0].0.len();
        (
            DMatrix::from_fn(pairs.len(), width + 1, |i, j| {
                pairs[i].0.get(j).map_or(1.0, |v| f64::from(*v))
            }),
            DMatrix::from_fn(pairs.len(), SECTORS, |i, j| f64::from(pairs[i].1[j])),
        )
    };
    let ((x, y), (x_tried, y_tried)) = (matrices(fitted), matrices(tried));
    let mut normal = x.tr_mul(&x);
    let ridge = RIDGE * normal.trace() / normal.nrows() as f64;
    (0..normal.nrows()).for_each(|i| normal[(i, i)] += ridge);
    let weights = normal
        .cholesky()
        .context("the normal equations are singular")?
        .solve(&x.tr_mul(&y));
    let mean = y.row_mean();
    let off = DMatrix::from_fn(y_tried.nrows(), SECTORS, |i, j| y_tried[(i, j)] - mean[j]);
    Ok(1.0 - (y_tried - x_tried * weights).norm_squared() / off.norm_squared())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn what_is_linear_in_the_source_is_read_out_whole_and_what_has_nothing_to_do_with_it_not_at_all() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let sources: Vec<[f32; 6]> = (0..3000).map(|_| rng.random()).collect();
        let shown = |s: &[f32; 6]| [s[0] - 0.5 * s[3], 1.0 + s[1], s[2], s[4] + s[5]];
        let pairs = |of: &[[f32; SECTORS]]| {
            let pairs = sources.iter().zip(of).map(|(source, seen)| (&source[..], *seen));
            let pairs: Vec<(&[f32], [f32; SECTORS])> = pairs.collect();
            let (fitted, tried) = pairs.split_at(2000);
            r_squared(fitted, tried).unwrap()
        };
        let linear: Vec<_> = sources.iter().map(shown).collect();
        let unrelated: Vec<_> = linear.iter().skip(7).chain(linear.iter().take(7)).copied().collect();
        assert!(pairs(&linear) > 0.999, "{}", pairs(&linear));
        assert!(pairs(&unrelated).abs() < 0.02, "{}", pairs(&unrelated));
        assert!(r_squared(&[], &[]).unwrap().is_nan());
    }
}
