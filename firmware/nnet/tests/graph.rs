//! Networks: shared weights, shared nodes, what is computed, what is refused.

mod common;
mod counting;

use common::*;
use counting::allocations;
use vigil_nnet::{Activation, Conv2d, Dense, GraphBuilder, Gru, Isa, Lstm, Params, Purpose};

/// Two windows over shared features, a shared GRU, a node used three times: every way an edge can meet another.
#[test]
fn gradients_of_shared_nodes_and_weights_add_up() {
    let (first, gru_layer) = (Dense { inputs: 4, outputs: 3 }, Gru { inputs: 3, hidden: 3 });
    let lstm_layer = Lstm {
        inputs: 3,
        hidden: 2,
        cell: Activation::TANH,
    };
    let mut b = GraphBuilder::new();
    let (p1, p2) = (b.params(first.param_len()), b.params(gru_layer.param_len()));
    let p3 = b.params(lstm_layer.param_len());
    let x: Vec<_> = (0..3).map(|_| b.input(4, true).unwrap()).collect();
    let f: Vec<_> = x
        .iter()
        .map(|x| b.dense(*x, first, Activation::Elu, p1).unwrap())
        .collect();
    let zero = b.zeros(3).unwrap();
    let h1 = b.gru(f[0], zero, gru_layer, p2).unwrap();
    let h2 = b.gru(f[1], h1, gru_layer, p2).unwrap();
    let h3 = b.gru(f[2], h2, gru_layer, p2).unwrap();
    // A state as an input, an input as a state.
    let h4 = b.gru(h2, f[1], gru_layer, p2).unwrap();
    let cell = b.zeros(4).unwrap();
    let s1 = b.lstm(f[2], cell, lstm_layer, p3).unwrap();
    let s2 = b.lstm(h3, s1, lstm_layer, p3).unwrap();
    let part = b.slice(s2, 1, 2).unwrap();
    let output = b.concat(&[h4, part, h3, f[1], h2]).unwrap();
    let graph = b.finish(output, Purpose::Multipliers).unwrap();

    let oracle = |p: &[f64], x: &[f64]| -> Vec<f64> {
        let (d, rest) = p.split_at(first.param_len());
        let (g, l) = rest.split_at(gru_layer.param_len());
        let f: Vec<_> = x.chunks_exact(4).map(|x| dense(first, Activation::Elu, d, x)).collect();
        let h1 = gru(gru_layer, g, &f[0], &[0.0; 3]);
        let h2 = gru(gru_layer, g, &f[1], &h1);
        let h3 = gru(gru_layer, g, &f[2], &h2);
        let h4 = gru(gru_layer, g, &h2, &f[1]);
        let s1 = lstm(lstm_layer, l, &f[2], &[0.0; 4]);
        let s2 = lstm(lstm_layer, l, &h3, &s1);
        [h4, s2[1..3].to_vec(), h3, f[1].clone(), h2].concat()
    };
    let mut rng = rng(5);
    let params = uniform(&mut rng, graph.param_len(), 0.7);
    let (x, x_ref) = (uniform(&mut rng, 12, 1.0), uniform(&mut rng, 12, 1.0));
    let weights = uniform(&mut rng, graph.output_len(), 1.0);
    let graph = Evaluated::new(graph, Isa::detect(), &params);
    let [tape, reference] =
        [&x, &x_ref].map(|x| graph.tape(&x.chunks_exact(4).map(<[f32]>::to_vec).collect::<Vec<_>>()));
    let (gradients, d_params) = graph.gradients(&tape, &weights, 0.0);
    let want = finite_differences(|p| oracle(p, &wide(&x)), &wide(&weights), &wide(&params));
    assert!(distance(&d_params, &want) < 1e-5 * largest(&want).max(1.0));
    let want = finite_differences(|x| oracle(&wide(&params), x), &wide(&weights), &wide(&x));
    assert!(distance(&gradients.concat(), &want) < 1e-5 * largest(&want).max(1.0));

    let m = graph.multipliers(&tape, &reference, &weights).concat();
    let [now, then] = [&x, &x_ref].map(|x| oracle(&wide(&params), &wide(x)));
    adds_up("shared", &m, [&x, &x_ref], &weights, [&now, &then]);
}

#[test]
fn what_the_output_does_not_need_is_not_computed() {
    let layer = Dense { inputs: 2, outputs: 2 };
    let mut b = GraphBuilder::new();
    let p = b.params(layer.param_len());
    let (x, unused) = (b.input(2, true).unwrap(), b.input(2, true).unwrap());
    let y = b.dense(x, layer, Activation::Identity, p).unwrap();
    b.dense(unused, layer, Activation::Elu, p).unwrap();
    let graph = b.finish(y, Purpose::Gradients).unwrap();
    assert!(graph.is_explained(0) && !graph.is_explained(1));
    let params = [1.0, 0.0, 0.0, 1.0, 0.5, 0.5];
    let mut tape = vec![f32::NAN; graph.tape_len()];
    // An input that nobody needs may hold anything, but not be left out.
    graph
        .forward(Isa::PORTABLE, &params, &[&[1.0, 2.0], &[f32::NAN; 2]], &mut tape)
        .unwrap();
    assert_eq!(graph.output(&tape).unwrap(), [1.5, 2.5]);
    assert!(
        graph
            .forward(Isa::PORTABLE, &params, &[&[1.0, 2.0]], &mut tape)
            .is_err()
    );
}

#[test]
fn an_input_that_is_not_explained_costs_no_gradient_but_weights_still_learn() {
    let gradient = |explained| {
        let graph = small_network(Purpose::Gradients, explained);
        let mut rng = rng(9);
        let params = uniform(&mut rng, graph.param_len(), 0.2);
        let inputs: Vec<Vec<f32>> = (0..3).map(|i| uniform(&mut rng, graph.input_len(i), 0.9)).collect();
        let network = Evaluated::new(graph, Isa::detect(), &params);
        let (mut gradients, d_params) = network.gradients(&network.tape(&inputs), &[1.0, 1.0], 0.0);
        (d_params, gradients.remove(0))
    };
    let ((with, reached), (without, left)) = (gradient(true), gradient(false));
    assert_eq!(with, without);
    assert!(reached.iter().all(|d| !d.is_nan()) && left.iter().all(|d| d.to_bits() == f32::NAN.to_bits()));
}

#[test]
fn descriptions_that_do_not_fit_are_refused_with_the_numbers() {
    let mut b = GraphBuilder::new();
    let x = b.input(5, true).unwrap();
    let layer = Dense { inputs: 4, outputs: 2 };
    let p = b.params(layer.param_len());
    let error = b.dense(x, layer, Activation::Elu, p).unwrap_err();
    assert_eq!(error.to_string(), "dense input holds 5 values, expected 4");
    let other = Params { at: 6, len: 10 };
    let y = b.input(4, true).unwrap();
    assert!(
        b.dense(y, layer, Activation::Elu, other).is_err(),
        "parameters past the end"
    );
    assert!(b.slice(x, 3, 3).is_err());
    assert!(b.zeros(0).is_err());
    let mut foreign = GraphBuilder::new();
    assert!(
        foreign.activation(x, Activation::Relu).is_err(),
        "a node of another graph"
    );
    assert!(Conv2d::new([2, 2, 1], 1, 5, 1, 1).validate().is_err());
    let out = b.dense(y, Dense { inputs: 4, outputs: 2 }, Activation::Elu, p).unwrap();
    let graph = b.finish(out, Purpose::Gradients).unwrap();
    let (tape, mut work) = (vec![0.0; graph.tape_len()], vec![0.0; graph.work_len()]);
    let error = graph.multipliers(Isa::PORTABLE, &[0.0; 10], &tape, &tape, &[1.0; 2], &mut work);
    assert!(
        error.is_err(),
        "tapes without values before the curves cannot give multipliers"
    );
}

#[test]
fn evaluating_a_network_does_not_allocate() {
    let graph = small_network(Purpose::Multipliers, true);
    let params = uniform(&mut rng(1), graph.param_len(), 0.2);
    let image = vec![0.3; graph.input_len(0)];
    let inputs: [&[f32]; 3] = [&image, &image, &[0.1, 0.2]];
    let (mut tape, mut packed) = (vec![0.0; graph.tape_len()], vec![0.0; graph.param_len()]);
    let (mut work, mut d_params) = (vec![0.0; graph.work_len()], vec![0.0; graph.param_len()]);
    for isa in Isa::available() {
        let before = allocations();
        graph.pack(&params, &mut packed).unwrap();
        graph.forward(isa, &params, &inputs, &mut tape).unwrap();
        graph
            .backward(isa, &packed, &tape, &[1.0, 0.0], Some(&mut d_params), &mut work)
            .unwrap();
        graph
            .multipliers(isa, &packed, &tape, &tape, &[0.0, 1.0], &mut work)
            .unwrap();
        assert_eq!(allocations(), before, "{}", isa.name());
    }
}
