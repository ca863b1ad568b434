//! Bounds over boxes of inputs: nothing leaves them, they are tight where they can be, and their gradient is that of an independent
//! float64 interval arithmetic.

mod common;

use common::*;
use rand::RngExt;
use vigil_nnet::{
    Activation, Bounds, BoundsGradient, BoundsMut, BoundsParams, Conv2d, Dense, Graph, GraphBuilder, Gru, Isa,
    MaxPool2d, PackedBoundsParams, Purpose, Rounding,
};

/// Lower and upper ends of the output for inputs within `radius` of `centre`.
struct Bounded {
    lower: Vec<f32>,
    upper: Vec<f32>,
    tapes: [Vec<f32>; 2],
}

fn bounded(graph: &Graph, isa: Isa, params: &[f32], boxes: &[(Vec<f32>, Vec<f32>)]) -> Bounded {
    let mut magnitudes = vec![f32::NAN; graph.param_len()];
    graph.magnitudes(params, &mut magnitudes).unwrap();
    let mut tapes = [vec![f32::NAN; graph.tape_len()], vec![f32::NAN; graph.tape_len()]];
    let mut work = vec![f32::NAN; graph.bounds_work_len()];
    let inputs: Vec<Bounds> = boxes.iter().map(|(lower, upper)| Bounds { lower, upper }).collect();
    let [lower, upper] = &mut tapes;
    let weights = BoundsParams {
        params,
        magnitudes: &magnitudes,
    };
    graph
        .bounds(
            isa,
            Rounding::Counted,
            weights,
            &inputs,
            &mut BoundsMut { lower, upper },
            &mut work,
        )
        .unwrap();
    Bounded {
        lower: graph.output(&tapes[0]).unwrap().to_vec(),
        upper: graph.output(&tapes[1]).unwrap().to_vec(),
        tapes,
    }
}

fn boxes_of(graph: &Graph, rng: &mut impl rand::Rng, radius: f32) -> Vec<(Vec<f32>, Vec<f32>)> {
    (0..graph.input_count())
        .map(|i| {
            let centre: Vec<f32> = (0..graph.input_len(i)).map(|_| rng.random_range(0.02..0.98)).collect();
            let end = |by: f32| centre.iter().map(|x| (x + by).clamp(0.0, 1.0)).collect();
            (end(-radius), end(radius))
        })
        .collect()
}

#[test]
fn no_input_of_the_box_leaves_the_bounds() {
    let graph = small_network(Purpose::Gradients, false);
    let mut rng = rng(3);
    for isa in [Isa::detect(), Isa::PORTABLE] {
        for radius in [0.0, 1e-6, 0.004, 0.05, 0.5] {
            let params = uniform(&mut rng, graph.param_len(), 0.3);
            let boxes = boxes_of(&graph, &mut rng, radius);
            let bounds = bounded(&graph, isa, &params, &boxes);
            let mut tape = vec![0.0; graph.tape_len()];
            for draw in 0..40 {
                let corners = draw < 20;
                let inputs: Vec<Vec<f32>> = boxes
                    .iter()
                    .map(|(lower, upper)| {
                        let ends = lower.iter().zip(upper);
                        ends.map(|(l, u)| match rng.random_range(0.0_f32..1.0) {
                            at if corners => {
                                if at < 0.5 {
                                    *l
                                } else {
                                    *u
                                }
                            }
                            at => (l + at * (u - l)).clamp(*l, *u),
                        })
                        .collect()
                    })
                    .collect();
                let views: Vec<&[f32]> = inputs.iter().map(Vec::as_slice).collect();
                graph.forward(isa, &params, &views, &mut tape).unwrap();
                for (y, (l, u)) in graph
                    .output(&tape)
                    .unwrap()
                    .iter()
                    .zip(bounds.lower.iter().zip(&bounds.upper))
                {
                    assert!(l <= y && y <= u, "{y} is outside of {l} to {u}, radius {radius}");
                }
            }
        }
    }
}

#[test]
fn inputs_that_are_known_are_bounded_by_rounding_alone() {
    let graph = small_network(Purpose::Gradients, false);
    let mut rng = rng(4);
    let params = uniform(&mut rng, graph.param_len(), 0.3);
    let bounds = bounded(&graph, Isa::detect(), &params, &boxes_of(&graph, &mut rng, 0.0));
    for (l, u) in bounds.lower.iter().zip(&bounds.upper) {
        assert!(u - l > 0.0 && u - l < 0.1, "{l} to {u}");
    }
}

/// One layer is bounded as tightly as can be: some corner reaches each end.
#[test]
fn a_single_layers_bounds_are_reached() {
    let layer = Dense { inputs: 5, outputs: 3 };
    let mut b = GraphBuilder::new();
    let p = b.params(layer.param_len());
    let x = b.input(5, false).unwrap();
    let y = b.dense(x, layer, Activation::TANH, p).unwrap();
    let graph = b.finish(y, Purpose::Gradients).unwrap();
    let mut rng = rng(5);
    let params = uniform(&mut rng, graph.param_len(), 1.0);
    let boxes = boxes_of(&graph, &mut rng, 0.1);
    let bounds = bounded(&graph, Isa::detect(), &params, &boxes);
    let (lower, upper) = &boxes[0];
    let mut tape = vec![0.0; graph.tape_len()];
    let mut reached = [[f32::INFINITY, f32::NEG_INFINITY]; 3];
    for corner in 0..32 {
        let x: Vec<f32> = (0..5)
            .map(|i| if corner >> i & 1 == 0 { lower[i] } else { upper[i] })
            .collect();
        graph.forward(Isa::detect(), &params, &[&x], &mut tape).unwrap();
        for ([least, most], y) in reached.iter_mut().zip(graph.output(&tape).unwrap()) {
            (*least, *most) = (least.min(*y), most.max(*y));
        }
    }
    for ([least, most], (l, u)) in reached.iter().zip(bounds.lower.iter().zip(&bounds.upper)) {
        assert!(
            (least - l).abs() < 1e-5 && (most - u).abs() < 1e-5,
            "{l} to {u}, reached {least} to {most}"
        );
    }
}

/// Ends of values in float64: lower, then upper.
type Ends = [Vec<f64>; 2];

/// Weights by their signs, an implementation that shares nothing with the layers': the least that a sum can be takes each term's end.
fn affine(outputs: usize, weights: impl Fn(usize, usize) -> f64, bias: impl Fn(usize) -> f64, x: &Ends) -> Ends {
    [0, 1].map(|end| {
        (0..outputs)
            .map(|o| {
                let terms = (0..x[0].len()).map(|i| {
                    let w = weights(i, o);
                    let take = if w >= 0.0 { end } else { 1 - end };
                    w * x[take][i]
                });
                bias(o) + terms.sum::<f64>()
            })
            .collect()
    })
}

fn curve(x: &Ends, f: impl Fn(f64) -> f64) -> Ends {
    [0, 1].map(|end| x[end].iter().map(|x| f(*x)).collect())
}

fn gru_ends(layer: Gru, p: &[f64], x: &Ends, h: &Ends) -> Ends {
    let (n, w) = (layer.hidden, 3 * layer.hidden);
    let (input, rest) = p.split_at(layer.inputs * w);
    let (recurrent, bias) = rest.split_at(n * w);
    let from_x = affine(w, |i, o| input[i * w + o], |o| bias[o], x);
    let from_h = affine(w, |i, o| recurrent[i * w + o], |o| bias[w + o], h);
    let sigmoid = |x: f64| 1.0 / (1.0 + (-x).exp());
    let [mut low, mut high] = [Vec::new(), Vec::new()];
    for i in 0..n {
        let gate = |g: usize| [0, 1].map(|end| sigmoid(from_x[end][g * n + i] + from_h[end][g * n + i]));
        let (r, z) = (gate(0), gate(1));
        let q = [from_h[0][2 * n + i], from_h[1][2 * n + i]];
        let products: Vec<f64> = r.iter().flat_map(|r| q.map(|q| r * q)).collect();
        let least = products.iter().copied().fold(f64::INFINITY, f64::min);
        let most = products.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let candidate = [
            (from_x[0][2 * n + i] + least).tanh(),
            (from_x[1][2 * n + i] + most).tanh(),
        ];
        let all = |end: usize| z.map(|z| (1.0 - z) * candidate[end] + z * h[end][i]);
        low.push(all(0).into_iter().fold(f64::INFINITY, f64::min));
        high.push(all(1).into_iter().fold(f64::NEG_INFINITY, f64::max));
    }
    [low, high]
}

/// An image through contrast and a convolution, twice into a GRU, the second time beside a slice, then dense.
#[test]
fn values_and_gradients_are_those_of_plain_interval_arithmetic() {
    let image = Conv2d {
        rows: 4,
        cols: 6,
        channels: 1,
        filters: 3,
        kernel: 3,
        stride: 2,
        padding: 1,
    };
    let gru = Gru {
        inputs: image.output_len(),
        hidden: 4,
    };
    let out = Dense { inputs: 6, outputs: 2 };
    let mut b = GraphBuilder::new();
    let (p1, p2, p3) = (
        b.params(image.param_len()),
        b.params(gru.param_len()),
        b.params(out.param_len()),
    );
    let mut h = b.zeros(4).unwrap();
    for _ in 0..2 {
        let x = b.input(image.input_len(), true).unwrap();
        let x = b.activation(x, Activation::NearContrast { gain: 4.0 }).unwrap();
        let x = b.conv2d(x, image, Activation::Elu, p1).unwrap();
        h = b.gru(x, h, gru, p2).unwrap();
    }
    let beside = b.input(3, false).unwrap();
    let beside = b.slice(beside, 1, 2).unwrap();
    let joined = b.concat(&[h, beside]).unwrap();
    let y = b.dense(joined, out, Activation::Tanh { scale: 1.5 }, p3).unwrap();
    let graph = b.finish(y, Purpose::Gradients).unwrap();

    let oracle = |p: &[f64], x: &[f64]| -> Vec<f64> {
        let (pc, rest) = p.split_at(image.param_len());
        let (pg, pd) = rest.split_at(gru.param_len());
        let mut h = [vec![0.0; 4], vec![0.0; 4]];
        let mut left = x;
        let mut take = |len: usize| {
            let (own, rest) = left.split_at(2 * len);
            left = rest;
            [own[..len].to_vec(), own[len..].to_vec()]
        };
        for _ in 0..2 {
            let [low, high] = take(image.input_len());
            let x = curve(&[high, low], |x| 1.0 / (1.0 + 4.0 * x));
            // The convolution as a matrix, column by column.
            let unit = |i: usize| {
                let mut x = vec![0.0; image.input_len()];
                x[i] = 1.0;
                x
            };
            let mut no_bias = pc.to_vec();
            no_bias[image.weight_len()..].fill(0.0);
            let columns: Vec<Vec<f64>> = (0..image.input_len())
                .map(|i| conv2d(image, Activation::Identity, &no_bias, &unit(i)))
                .collect();
            let bias = conv2d(image, Activation::Identity, pc, &vec![0.0; image.input_len()]);
            let x = affine(image.output_len(), |i, o| columns[i][o], |o| bias[o], &x);
            let x = curve(&x, |x| if x > 0.0 { x } else { x.exp_m1() });
            h = gru_ends(gru, pg, &x, &h);
        }
        let beside = take(3);
        let joined = [0, 1].map(|end| [h[end].clone(), beside[end][1..].to_vec()].concat());
        let y = affine(2, |i, o| pd[i * 2 + o], |o| pd[12 + o], &joined);
        curve(&y, |y| 1.5 * y.tanh()).concat()
    };

    let mut rng = rng(6);
    let params = uniform(&mut rng, graph.param_len(), 0.6);
    let boxes = boxes_of(&graph, &mut rng, 0.03);
    let flat: Vec<f32> = boxes
        .iter()
        .flat_map(|(l, u)| [l.clone(), u.clone()].concat())
        .collect();
    let isa = Isa::detect();
    let got = bounded(&graph, isa, &params, &boxes);
    let want = oracle(&wide(&params), &wide(&flat));
    assert!(distance(&[got.lower, got.upper].concat(), &want) < 2e-4, "{want:?}");

    let mut magnitudes = vec![0.0; graph.param_len()];
    graph.magnitudes(&params, &mut magnitudes).unwrap();
    let (mut packed, mut packed_magnitudes) = (vec![0.0; graph.param_len()], vec![0.0; graph.param_len()]);
    graph.pack(&params, &mut packed).unwrap();
    graph.pack(&magnitudes, &mut packed_magnitudes).unwrap();
    let weights = [0.7, -0.4, 1.1, 0.9];
    let (mut d_params, mut d_magnitudes) = (vec![0.0; graph.param_len()], vec![0.0; graph.param_len()]);
    let mut work = vec![f32::NAN; graph.bounds_backward_work_len()];
    graph
        .bounds_backward(
            isa,
            PackedBoundsParams {
                params: &packed,
                magnitudes: &packed_magnitudes,
            },
            Bounds {
                lower: &got.tapes[0],
                upper: &got.tapes[1],
            },
            Bounds {
                lower: &weights[..2],
                upper: &weights[2..],
            },
            BoundsGradient {
                params: &mut d_params,
                magnitudes: &mut d_magnitudes,
            },
            &mut work,
        )
        .unwrap();
    let both = BoundsParams {
        params: &params,
        magnitudes: &magnitudes,
    };
    graph
        .add_magnitude_gradient(
            both,
            BoundsGradient {
                params: &mut d_params,
                magnitudes: &mut d_magnitudes,
            },
        )
        .unwrap();
    let want = finite_differences(|p| oracle(p, &wide(&flat)), &wide(&weights), &wide(&params));
    assert!(
        distance(&d_params, &want) < 1e-3 * largest(&want),
        "{}",
        distance(&d_params, &want) / largest(&want)
    );

    let want = finite_differences(|x| oracle(&wide(&params), x), &wide(&weights), &wide(&flat));
    let mut at = 0;
    for i in 0..2 {
        let d = graph.input_bounds_gradient(&work, i).unwrap();
        let len = image.input_len();
        assert!(distance(d.lower, &want[at..at + len]) < 1e-3 * largest(&want));
        assert!(distance(d.upper, &want[at + len..at + 2 * len]) < 1e-3 * largest(&want));
        at += 2 * len;
    }
}

#[test]
fn a_layer_without_bounds_is_named() {
    let mut b = GraphBuilder::new();
    let x = b.input(16, false).unwrap();
    let pool = MaxPool2d {
        rows: 4,
        cols: 4,
        channels: 1,
        window: 2,
    };
    let y = b.max_pool2d(x, pool).unwrap();
    let graph = b.finish(y, Purpose::Gradients).unwrap();
    let (mut lower, mut upper) = (vec![0.0; graph.tape_len()], vec![0.0; graph.tape_len()]);
    let mut tapes = BoundsMut {
        lower: &mut lower,
        upper: &mut upper,
    };
    let none = BoundsParams {
        params: &[],
        magnitudes: &[],
    };
    let mut work = vec![0.0; graph.bounds_work_len()];
    let given = [Bounds::exactly(&[0.5; 16])];
    let refused = graph.bounds(Isa::PORTABLE, Rounding::Counted, none, &given, &mut tapes, &mut work);
    assert!(refused.unwrap_err().to_string().contains("has no bounds"));
    let refused = graph.bounds(Isa::PORTABLE, Rounding::Counted, none, &[], &mut tapes, &mut work);
    assert!(refused.unwrap_err().to_string().contains("list of inputs"));
}
