//! Building blocks of training.

mod common;

use common::*;
use vigil_nnet::train::{
    Adam, OrnsteinUhlenbeck, PrioritizedReplay, ReplayConfig, Sampled, SumTree, clip_norm, normal, soft_update,
};
use vigil_nnet::{ActorSpec, Isa, Purpose};

#[test]
fn adam_takes_the_published_steps() {
    // Algorithm 1 in float64, with a gradient that changes sign and size.
    let gradient = |t: i32, i: usize| (0.3 * f64::from(t) + i as f64).sin() * 10f64.powi(i as i32 - 2);
    let mut adam = Adam::new(4);
    let mut params = vec![1.0f32; 4];
    let (mut m, mut v, mut want) = ([0.0f64; 4], [0.0f64; 4], [1.0f64; 4]);
    for t in 1..=200 {
        let g: Vec<f32> = (0..4).map(|i| gradient(t, i) as f32).collect();
        adam.step(1e-2, &g, &mut params).unwrap();
        for i in 0..4 {
            m[i] = 0.9 * m[i] + 0.1 * gradient(t, i);
            v[i] = 0.999 * v[i] + 0.001 * gradient(t, i).powi(2);
            let (m, v) = (m[i] / (1.0 - 0.9f64.powi(t)), v[i] / (1.0 - 0.999f64.powi(t)));
            want[i] -= 1e-2 * m / (v.sqrt() + 1e-8);
        }
    }
    assert!(distance(&params, &want) < 2e-5, "{params:?} {want:?}");
    assert!(adam.step(1e-2, &[0.0; 3], &mut params).is_err());
}

#[test]
fn a_resumed_optimizer_takes_the_same_steps() {
    let run = |adam: &mut Adam, params: &mut Vec<f32>, from: usize, to: usize| {
        for t in from..to {
            let g: Vec<f32> = params.iter().map(|p| p - t as f32 * 0.01).collect();
            adam.step(3e-3, &g, params).unwrap();
        }
    };
    let (mut adam, mut params) = (Adam::new(3), vec![1.0, -2.0, 0.5]);
    run(&mut adam, &mut params, 0, 20);
    let (mut resumed, mut params_resumed) = (adam.clone(), params.clone());
    run(&mut adam, &mut params, 20, 40);
    run(&mut resumed, &mut params_resumed, 20, 40);
    assert_eq!((adam, params), (resumed, params_resumed));
}

#[test]
fn a_long_gradient_is_shortened_and_a_short_one_left() {
    let mut g = vec![3.0, -4.0];
    assert_eq!(clip_norm(10.0, &mut g), 5.0);
    assert_eq!(g, [3.0, -4.0]);
    assert_eq!(clip_norm(1.0, &mut g), 5.0);
    assert!((g[0] - 0.6).abs() < 1e-6 && (g[1] + 0.8).abs() < 1e-6);
    let mut g = vec![f32::NAN, 1.0];
    assert!(clip_norm(1.0, &mut g).is_nan());
    assert_eq!(g[1], 1.0);
}

#[test]
fn a_target_follows_its_source_geometrically() {
    let mut target = vec![0.0; 2];
    for _ in 0..100 {
        soft_update(0.05, &[1.0, -2.0], &mut target).unwrap();
    }
    let want = 1.0 - 0.95f64.powi(100);
    assert!(distance(&target, &[want, -2.0 * want]) < 1e-5);
    assert!(soft_update(0.05, &[1.0], &mut target).is_err());
}

#[test]
fn a_share_of_the_total_falls_where_a_linear_search_says() {
    let mut rng = rng(4);
    let mut tree = SumTree::new(13);
    assert_eq!(tree.find(0.0), None);
    let mut priorities = [0.0f64; 13];
    for round in 0..200 {
        let slot = round * 7 % 13;
        priorities[slot] = f64::from(uniform(&mut rng, 1, 2.0)[0].max(0.0));
        assert!(tree.set(slot, priorities[slot]));
        let total: f64 = priorities.iter().sum();
        assert!((tree.total() - total).abs() < 1e-12);
        if total == 0.0 {
            continue;
        }
        let share = total * f64::from(uniform(&mut rng, 1, 0.5)[0] + 0.5);
        let mut rest = share;
        let want = priorities.iter().position(|p| {
            rest -= p;
            rest < 0.0
        });
        assert_eq!(tree.find(share), want);
        // Past the end: the last slot with any priority.
        assert_eq!(tree.find(2.0 * total), priorities.iter().rposition(|p| *p > 0.0));
    }
    assert!(!tree.set(13, 1.0) && !tree.set(0, f64::NAN) && !tree.set(0, -1.0));
}

#[test]
fn transitions_are_drawn_in_proportion_and_weighted_against_it() {
    let config = ReplayConfig {
        alpha: 0.5,
        beta: 1.0,
        epsilon: 0.0,
    };
    let mut replay = PrioritizedReplay::new(4, config);
    let mut batch = [Sampled { slot: 9, weight: 0.0 }; 10];
    let mut rng = rng(8);
    assert!(!replay.sample(&mut rng, &mut batch), "nothing to draw");
    for slot in 0..4 {
        assert_eq!(replay.push(), Some(slot));
    }
    // Priorities 1, 2, 3, 4.
    for (slot, error) in [1.0, -4.0, 9.0, -16.0].into_iter().enumerate() {
        assert!(replay.update(slot, error));
    }
    let (mut counts, mut corrected) = ([0; 4], [0.0; 4]);
    for _ in 0..1000 {
        assert!(replay.sample(&mut rng, &mut batch));
        assert!(
            batch.iter().any(|drawn| drawn.weight == 1.0),
            "the largest weight of a batch is 1"
        );
        for drawn in &batch {
            counts[drawn.slot] += 1;
            corrected[drawn.slot] += f64::from(drawn.weight);
        }
    }
    // One draw from each tenth: exactly in proportion.
    assert_eq!(counts, [1000, 2000, 3000, 4000]);
    // With beta 1 the weights undo the proportion.
    assert!(corrected.iter().all(|c| (c - 1000.0).abs() < 1.0), "{corrected:?}");
    assert!(!replay.update(0, f64::NAN));
    // Full: the oldest goes, and the new one has the largest priority seen.
    assert_eq!(replay.push(), Some(0));
    assert!(replay.sample(&mut rng, &mut batch));
    let share = |slot| batch.iter().filter(|drawn| drawn.slot == slot).count();
    assert_eq!(replay.len(), 4);
    assert!(share(0) >= 2, "4 of 13 of the total");
}

#[test]
fn first_weights_are_seeded_and_bounded_and_an_actor_with_them_is_not_saturated() {
    let spec = ActorSpec {
        rows: 32,
        cols: 64,
        near_contrast: true,
    };
    let graph = spec.graph(Purpose::Gradients, false).unwrap();
    let draw = |seed| {
        let mut params = vec![f32::NAN; graph.param_len()];
        graph.initialize(&mut rng(seed), &mut params).unwrap();
        params
    };
    let params = draw(1);
    assert_eq!(params, draw(1));
    assert_ne!(params, draw(2));
    assert!(params.iter().all(|p| p.is_finite() && p.abs() <= 1.0));
    // The first convolution has 25 inputs.
    assert!(params[..400].iter().all(|p| p.abs() <= 0.2));
    assert!(params[..400].iter().any(|p| p.abs() > 0.19));
    let frame = vec![0.2; spec.frame_len()];
    let inputs: [&[f32]; 6] = [&frame, &frame, &frame, &frame, &frame, &[0.5, 0.1]];
    let mut tape = vec![0.0; graph.tape_len()];
    graph.forward(Isa::detect(), &params, &inputs, &mut tape).unwrap();
    assert!(graph.output(&tape).unwrap().iter().all(|y| y.abs() < 0.75));
}

#[test]
fn normal_values_have_the_normal_distributions_moments_and_tails() {
    let mut rng = rng(12);
    let draws: Vec<f64> = (0..200_000).map(|_| f64::from(normal(&mut rng))).collect();
    let moment = |k: i32| draws.iter().map(|x| x.powi(k)).sum::<f64>() / draws.len() as f64;
    // Each bound is more than four standard errors.
    assert!(moment(1).abs() < 0.01);
    assert!((moment(2) - 1.0).abs() < 0.015);
    assert!(moment(3).abs() < 0.04);
    assert!((moment(4) - 3.0).abs() < 0.1);
    let beyond = draws.iter().filter(|x| x.abs() > 1.959_964).count() as f64 / draws.len() as f64;
    assert!((beyond - 0.05).abs() < 0.002);
}

#[test]
fn wandering_noise_has_its_stationary_spread_and_memory() {
    let mut rng = rng(13);
    let (theta, sigma) = (0.15, 0.4);
    let mut noise = OrnsteinUhlenbeck::new(theta);
    let values: Vec<f64> = (0..200_000).map(|_| f64::from(noise.step(&mut rng, sigma))).collect();
    let n = values.len() as f64;
    let variance = values.iter().map(|x| x * x).sum::<f64>() / n;
    let pull = 1.0 - f64::from(theta);
    let want = f64::from(sigma).powi(2) / (1.0 - pull * pull);
    assert!((variance / want - 1.0).abs() < 0.04, "{variance} against {want}");
    let correlation = values.windows(2).map(|w| w[0] * w[1]).sum::<f64>() / n / variance;
    assert!((correlation - pull).abs() < 0.01);
    let mut still = OrnsteinUhlenbeck { theta, value: 1.0 };
    assert!(
        (still.step(&mut rng, 0.0) - 0.85).abs() < 1e-6,
        "without noise it decays"
    );
}
