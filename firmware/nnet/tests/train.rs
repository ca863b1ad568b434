//! Building blocks of training.

mod common;

use common::*;
use vigil_nnet::train::{Adam, SumTree, adam, soft_update};
use vigil_nnet::{Isa, Purpose};

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
fn first_weights_are_seeded_and_bounded_and_a_network_with_them_is_not_saturated() {
    let graph = small_network(Purpose::Gradients, false);
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
    let image = vec![0.2; graph.input_len(0)];
    let inputs: [&[f32]; 3] = [&image, &image, &[0.5, 0.1]];
    let mut tape = vec![0.0; graph.tape_len()];
    graph.forward(Isa::detect(), &params, &inputs, &mut tape).unwrap();
    assert!(graph.output(&tape).unwrap().iter().all(|y| y.abs() < 0.75));
}

#[test]
fn the_first_step_has_the_length_of_the_rate_whatever_the_gradient() {
    let mut adam = Adam::new(3);
    let mut p = [1.0, 1.0, 1.0];
    adam.step_by_shares(0.1, &[1.0, 0.5], 2.0, &mut p, &mut [1e-3, -50.0, 0.0]);
    assert!(
        (p[0] - 0.9).abs() < 1e-5 && (p[1] - 1.05).abs() < 1e-5 && p[2] == 1.0,
        "{p:?}"
    );
}

#[test]
fn it_reaches_the_bottom_of_a_narrow_valley() {
    // f = (x − 3)² + 100 (y + 1)²
    let mut adam = Adam::new(2);
    let (mut p, mut g) = ([0.0_f32, 0.0], [0.0; 2]);
    for _ in 0..4000 {
        g[0] += 2.0 * (p[0] - 3.0);
        g[1] += 200.0 * (p[1] + 1.0);
        adam.step(0.01, 1.0, &mut p, &mut g);
    }
    assert!((p[0] - 3.0).abs() < 1e-3 && (p[1] + 1.0).abs() < 1e-3, "{p:?}");
}

#[test]
fn only_long_gradients_are_shortened() {
    assert_eq!(adam::norm(&[3.0, 0.0, 4.0]), 5.0);
    assert_eq!(adam::shortening(5.0, 5.0), 1.0);
    assert_eq!(adam::shortening(10.0, 5.0), 0.5);
}
