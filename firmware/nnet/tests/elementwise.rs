//! Functions of single values, sums, products and layer normalisation: gradients by finite differences of plain definitions in
//! float64, multipliers by their additivity and, where a layer is made of others, by the layers that it is made of.

mod common;

use common::*;
use std::slice::from_ref;
use vigil_nnet::{Activation, BatchNorm, Dense, Function, GraphBuilder, Isa, LayerNorm, NodeId, Purpose};

/// A function and its definition in float64.
type Defined = (Function, fn(f64) -> f64);

fn functions() -> Vec<Defined> {
    vec![
        (
            Function::LeakyRelu { alpha: 0.2 },
            |x| if x < 0.0 { 0.2 * x } else { x },
        ),
        (
            Function::Elu { alpha: 0.7 },
            |x| if x > 0.0 { x } else { 0.7 * x.exp_m1() },
        ),
        (Function::Softplus, |x| x.exp().ln_1p()),
        (Function::Clip { least: -0.5, most: 0.6 }, |x| x.clamp(-0.5, 0.6)),
        (
            Function::Clip {
                least: -0.5,
                most: f32::INFINITY,
            },
            |x| x.max(-0.5),
        ),
        (Function::Power { exponent: 2.0 }, |x| x * x),
        (Function::Power { exponent: 3.0 }, |x| x * x * x),
        (Function::Exp, f64::exp),
        (Function::Abs, f64::abs),
        (Function::Erf, |x| {
            // Its series, which converges everywhere.
            let mut term = x;
            let mut sum = x;
            for n in 1..60 {
                term *= -x * x / f64::from(n);
                sum += term / f64::from(2 * n + 1);
            }
            sum * std::f64::consts::FRAC_2_SQRT_PI
        }),
    ]
}

/// Those of numbers above 0 alone.
fn of_positive() -> Vec<Defined> {
    vec![
        (Function::Log, f64::ln),
        (Function::Power { exponent: 0.5 }, f64::sqrt),
        (Function::Power { exponent: -1.0 }, |x| 1.0 / x),
        (Function::Power { exponent: 1.7 }, |x| x.powf(1.7)),
    ]
}

/// A network of one input.
fn network<'a>(
    build: impl FnOnce(&mut GraphBuilder, NodeId) -> NodeId,
    inputs: usize,
    params: &'a [f32],
) -> Evaluated<'a> {
    let mut b = GraphBuilder::new();
    let x = b.input(inputs, true).unwrap();
    let y = build(&mut b, x);
    Evaluated::new(b.finish(y, Purpose::Multipliers).unwrap(), Isa::detect(), params)
}

/// m · Δy / Δx of each value.
fn quotients(definition: fn(f64) -> f64, m: &[f32], x: &[f32], x_ref: &[f32]) -> Vec<f64> {
    let of = |i: usize| {
        let [a, b] = [x[i], x_ref[i]].map(f64::from);
        f64::from(m[i]) * (definition(a) - definition(b)) / (a - b)
    };
    (0..m.len()).map(of).collect()
}

#[test]
fn each_function_has_its_definitions_value_gradient_and_quotient() {
    let mut rng = rng(11);
    for (positive, all) in [(false, functions()), (true, of_positive())] {
        for (function, definition) in all {
            let n = 24;
            let inside = |x: Vec<f32>| -> Vec<f32> {
                x.into_iter()
                    .map(|x| if positive { 0.2 + x.abs() } else { x })
                    .collect()
            };
            let (x, x_ref) = (inside(uniform(&mut rng, n, 2.0)), inside(uniform(&mut rng, n, 2.0)));
            let m = uniform(&mut rng, n, 1.0);
            let layer = network(|b, x| b.function(x, function).unwrap(), n, &[]);
            let [tape, reference] = [&x, &x_ref].map(|x| layer.tape(from_ref(x)));
            let want: Vec<f64> = wide(&x).into_iter().map(definition).collect();
            assert!(
                distance(&layer.output(&tape), &want) < 3e-6 * largest(&want).max(1.0),
                "{function:?}"
            );
            let whole = |x: &[f64]| -> Vec<f64> { x.iter().map(|x| definition(*x)).collect() };
            let want = finite_differences(whole, &wide(&m), &wide(&x));
            assert!(
                distance(&layer.gradients(&tape, &m, 0.0).0[0], &want) < 1e-5 * largest(&want).max(1.0),
                "{function:?}"
            );
            let quotients = quotients(definition, &m, &x, &x_ref);
            // A quotient of two differences that may be small.
            let got = layer.multipliers(&tape, &reference, &m);
            assert!(
                distance(&got[0], &quotients) < 1e-3 * largest(&quotients).max(1.0),
                "{function:?}"
            );
        }
    }
    for (function, _) in functions() {
        assert!(function.value(f32::NAN).is_nan(), "{function:?}: NaN stays NaN");
    }
}

#[test]
fn sums_and_products_share_what_they_have_in_common() {
    let (mut rng, n) = (rng(12), 16);
    let [x, x_ref, m] = [1.5, 1.5, 1.0].map(|limit| uniform(&mut rng, n, limit));
    // (x + x · sigmoid(x) + x) · (x · sigmoid(x)): a node that is read five times.
    let silu_of = |b: &mut GraphBuilder, x: NodeId| {
        let gate = b.activation(x, Activation::Sigmoid).unwrap();
        b.product(x, gate).unwrap()
    };
    let built = |b: &mut GraphBuilder, x: NodeId| {
        let silu = silu_of(b, x);
        let sum = b.sum(&[x, silu, x]).unwrap();
        b.product(sum, silu).unwrap()
    };
    let built = network(built, n, &[]);
    let [tape, reference] = [&x, &x_ref].map(|x| built.tape(from_ref(x)));
    let definition = |x: &[f64]| -> Vec<f64> {
        let silu = |x: f64| x / (1.0 + (-x).exp());
        x.iter().map(|x| (2.0 * x + silu(*x)) * silu(*x)).collect()
    };
    assert!(distance(&built.output(&tape), &definition(&wide(&x))) < 1e-5);
    let want = finite_differences(definition, &wide(&m), &wide(&x));
    assert!(distance(&built.gradients(&tape, &m, 0.0).0[0], &want) < 1e-5 * largest(&want).max(1.0));
    let [y, y_ref] = [&tape, &reference].map(|tape| wide(&built.output(tape)));
    let multipliers = built.multipliers(&tape, &reference, &m).concat();
    adds_up("network", &multipliers, [&x, &x_ref], &m, [&y, &y_ref]);
    // Of one varying value the midpoint rule is the rescale rule: SiLU as a product has Δy / Δx.
    let silu = network(silu_of, n, &[]);
    let quotients = quotients(|x| x / (1.0 + (-x).exp()), &m, &x, &x_ref);
    let [tape, reference] = [&x, &x_ref].map(|x| silu.tape(from_ref(x)));
    assert!(distance(&silu.multipliers(&tape, &reference, &m)[0], &quotients) < 1e-4);
}

/// Layer normalisation of one row, written out: centred values by weights, squares, their mean, its inverse root, the product, scale and shift.
fn one_row_written_out(
    width: usize,
    params: &[f32],
) -> (impl FnOnce(&mut GraphBuilder, NodeId) -> NodeId + use<>, Vec<f32>) {
    let [centre, mean, all] =
        [[width, width], [width, 1], [1, width]].map(|[inputs, outputs]| Dense { inputs, outputs });
    let mut written = Vec::new();
    for i in 0..width * width {
        written.push(f32::from(u8::from(i % (width + 1) == 0)) - 1.0 / width as f32);
    }
    written.extend(vec![0.0; width]);
    written.extend(vec![1.0 / width as f32; width]);
    written.push(1e-3);
    written.extend(vec![1.0; width]);
    written.extend(vec![0.0; width]);
    for (i, scale) in params[..width].iter().enumerate() {
        written.extend((0..width).map(|j| if i == j { *scale } else { 0.0 }));
    }
    written.extend(&params[width..]);
    let layers = move |b: &mut GraphBuilder, x: NodeId| {
        let [p1, p2, p3, p4] = [centre, mean, all, centre].map(|layer| b.params(layer.param_len()));
        let centred = b.dense(x, centre, Activation::Identity, p1).unwrap();
        let squares = b.function(centred, Function::Power { exponent: 2.0 }).unwrap();
        let variance = b.dense(squares, mean, Activation::Identity, p2).unwrap();
        let inverse = b.function(variance, Function::Power { exponent: -0.5 }).unwrap();
        let inverse = b.dense(inverse, all, Activation::Identity, p3).unwrap();
        let normal = b.product(centred, inverse).unwrap();
        b.dense(normal, centre, Activation::Identity, p4).unwrap()
    };
    (layers, written)
}

#[test]
fn layer_normalisation_is_explained_as_the_layers_that_it_is_made_of() {
    let (mut rng, rows, width) = (rng(13), 2, 12);
    let n = rows * width;
    let layer = LayerNorm { width, epsilon: 1e-3 };
    let params = uniform(&mut rng, 2 * width, 1.0);
    let [x, x_ref, m] = [2.0, 2.0, 1.0].map(|limit| uniform(&mut rng, n, limit));
    let whole = |b: &mut GraphBuilder, x: NodeId| {
        let own = b.params(layer.param_len());
        b.layer_norm(x, layer, own).unwrap()
    };
    let (parts, written) = one_row_written_out(width, &params);
    let [of_whole, of_parts] = [
        (network(whole, n, &params), n),
        (network(parts, width, &written), width),
    ]
    .map(|(network, len)| {
        let [tape, reference] = [&x, &x_ref].map(|x| network.tape(&[x[..len].to_vec()]));
        network.multipliers(&tape, &reference, &m[..len]).concat()
    });
    assert!(distance(&of_parts, &wide(&of_whole[..width])) < 1e-4 * largest(&wide(&of_parts)).max(1.0));
}

#[test]
fn what_does_not_fit_is_refused() {
    let mut b = GraphBuilder::new();
    let (x, y) = (b.input(4, true).unwrap(), b.input(3, true).unwrap());
    let (own, of_batch) = (b.params(8), b.params(16));
    assert!(b.sum(&[]).is_err() && b.sum(&[x, y]).is_err() && b.product(x, y).is_err());
    for (width, epsilon) in [(5, 1e-5), (0, 1e-5), (4, 0.0)] {
        let layer = LayerNorm { width, epsilon };
        assert!(b.layer_norm(x, layer, own).is_err(), "{layer:?}");
    }
    for (epsilon, fits) in [(0.0, true), (-1e-3, false), (f32::NAN, false), (f32::INFINITY, false)] {
        let layer = BatchNorm { channels: 4, epsilon };
        assert_eq!(b.batch_norm(x, layer, of_batch).is_ok(), fits, "{layer:?}");
    }
}
