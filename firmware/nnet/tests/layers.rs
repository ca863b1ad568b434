//! Each layer against a plain float64 implementation of its definition, on every instruction set: its value, its
//! gradients against finite differences of that implementation, and the additivity of its multipliers.

mod common;

use common::*;
use vigil_nnet::{
    Activation, BatchNorm, Conv2d, ConvChain, Dense, GraphBuilder, Gru, Isa, LayerNorm, Lstm, MaxPool2d, NodeId,
    Params, Purpose, ShapeError,
};

type Build<'a> = dyn Fn(&mut GraphBuilder, &[NodeId], Params) -> Result<NodeId, ShapeError> + 'a;
/// Of parameters and inputs.
type Oracle<'a> = dyn Fn(&[f64], &[&[f64]]) -> Vec<f64> + 'a;

/// Relative to the largest value of the compared slice.
const TOLERANCE: f64 = 5e-6;

fn close(what: &str, got: &[f32], want: &[f64]) {
    let scale = largest(want).max(1e-3);
    let error = distance(got, want) / scale;
    assert!(error < TOLERANCE, "{what}: off by {error:e} of {scale}");
}

/// A layer of which all parameters are learned, and any number is valid.
fn check(name: &str, inputs: &[usize], params: usize, build: &Build<'_>, oracle: &Oracle<'_>) {
    check_learned(name, inputs, [params; 2], build, oracle, &|_| {});
}

/// A layer by the lengths of its inputs, the number of its parameters and how many of them, from the first, are learned (a running
/// statistic is not), how to build it, and its definition in float64; `tame` makes parameters valid (a variance is positive).
fn check_learned(
    name: &str,
    lens: &[usize],
    [param_len, learned_len]: [usize; 2],
    build: &Build<'_>,
    oracle: &Oracle<'_>,
    tame: &dyn Fn(&mut [f32]),
) {
    let mut b = GraphBuilder::new();
    let params = b.params(param_len);
    let nodes: Vec<NodeId> = lens.iter().map(|len| b.input(*len, true).unwrap()).collect();
    let output = build(&mut b, &nodes, params).unwrap();
    let graph = b.finish(output, Purpose::Multipliers).unwrap();
    let mut rng = rng(7);
    let mut params = uniform(&mut rng, param_len, 0.3);
    tame(&mut params);
    let inputs: Vec<Vec<f32>> = lens.iter().map(|n| uniform(&mut rng, *n, 1.0)).collect();
    let references: Vec<Vec<f32>> = lens.iter().map(|n| uniform(&mut rng, *n, 1.0)).collect();
    let weights = uniform(&mut rng, graph.output_len(), 1.0);
    let (params_wide, weights_wide) = (wide(&params), wide(&weights));
    let inputs_wide: Vec<Vec<f64>> = inputs.iter().map(|x| wide(x)).collect();
    let wide_slices = || inputs_wide.iter().map(Vec::as_slice).collect::<Vec<_>>();
    let value = oracle(&params_wide, &wide_slices());
    let gradient_of = |i: usize| {
        let of_input = |x: &[f64]| {
            let mut all = wide_slices();
            all[i] = x;
            oracle(&params_wide, &all)
        };
        finite_differences(of_input, &weights_wide, &inputs_wide[i])
    };
    let gradients_want: Vec<Vec<f64>> = (0..lens.len()).map(gradient_of).collect();
    let d_params_want = finite_differences(|p| oracle(p, &wide_slices()), &weights_wide, &params_wide);
    for isa in Isa::available() {
        let on = format!("{name} on {}", isa.name());
        let layer = Evaluated::new(graph.clone(), isa, &params);
        let (tape, reference) = (layer.tape(&inputs), layer.tape(&references));
        close(&format!("{on}: value"), &layer.output(&tape), &value);

        let (gradients, d_params) = layer.gradients(&tape, &weights, 1.0);
        let (learned, fixed) = d_params.split_at(learned_len);
        let want = &d_params_want[..learned_len];
        close(&format!("{on}: weight gradient"), learned, want);
        let is_untouched = fixed.iter().all(|d| *d == 0.0);
        assert!(is_untouched, "{on}: a running statistic got a gradient");
        for (i, got) in gradients.iter().enumerate() {
            close(&format!("{on}: gradient of input {i}"), got, &gradients_want[i]);
        }

        let m = layer.multipliers(&tape, &reference, &weights);
        let [y, y_ref] = [&tape, &reference].map(|tape| wide(&layer.output(tape)));
        let ends = [&inputs.concat()[..], &references.concat()];
        adds_up(&on, &m.concat(), ends, &weights, [&y, &y_ref]);

        // Against itself every ratio is a derivative: the multipliers are the gradient.
        assert!(largest(&wide(&m[0])) > 0.0, "{on}: all multipliers are zero");
        let m = layer.multipliers(&tape, &tape, &weights);
        if name != "max pool" {
            close(&format!("{on}: multipliers against itself"), &m[0], &gradients_want[0]);
        }
    }
}

fn curves() -> [Activation; 6] {
    [
        Activation::Identity,
        Activation::Relu,
        Activation::Elu,
        Activation::Tanh { scale: 1.5 },
        Activation::Sigmoid,
        Activation::NearContrast { gain: 0.5 },
    ]
}

#[test]
fn dense_layers_of_odd_sizes_match_their_definition() {
    for ((inputs, outputs, rows), act) in [(3, 2, 1), (17, 48, 1), (54, 33, 3), (5, 150, 2), (40, 1, 4), (6, 6, 2)]
        .into_iter()
        .zip(curves())
    {
        let layer = Dense { inputs, outputs };
        check(
            "dense",
            &[inputs * rows],
            layer.param_len(),
            &|b, x, p| b.dense(x[0], layer, act, p),
            &|p, x| dense(layer, act, p, x[0]),
        );
    }
}

#[test]
fn convolutions_of_many_shapes_match_their_definition() {
    // rows, cols, channels, filters, kernel, stride, padding
    let shapes = [
        (12, 20, 1, 16, 5, 2, 2),
        (9, 11, 3, 5, 3, 1, 1),
        (4, 6, 16, 32, 3, 2, 1),
        (5, 9, 5, 19, 3, 2, 1),
        (6, 6, 2, 4, 4, 4, 0),
        (2, 37, 6, 33, 1, 1, 0),
        (3, 3, 7, 8, 3, 2, 2),
        (9, 9, 2, 3, 3, 3, 1),
        (4, 5, 1, 3, 2, 3, 1),
    ];
    for (i, (rows, cols, channels, filters, kernel, stride, padding)) in shapes.into_iter().enumerate() {
        let layer = Conv2d::new([rows, cols, channels], filters, kernel, stride, padding);
        let act = curves()[i % 6];
        check(
            &format!("{layer:?} {act:?}"),
            &[layer.input_len()],
            layer.param_len(),
            &|b, x, p| b.conv2d(x[0], layer, act, p),
            &|p, x| conv2d(layer, act, p, x[0]),
        );
    }
}

/// Row by row, and twice, so that nothing of the image before is left; kernels smaller than the stride, and no padding, among them.
#[test]
fn a_chain_of_convolutions_gives_what_its_layers_give_one_after_the_other() {
    let filters_kernel_stride_padding = [
        vec![(16, 5, 2, 2), (16, 3, 2, 1), (32, 3, 2, 1), (32, 3, 2, 1)],
        vec![(3, 3, 1, 1), (5, 4, 3, 0), (2, 1, 2, 0)],
        vec![(4, 2, 3, 1), (19, 3, 1, 2)],
        vec![(2, 6, 5, 5)],
    ];
    for (layers, isa) in filters_kernel_stride_padding
        .iter()
        .flat_map(|layers| Isa::available().map(move |isa| (layers, isa)))
    {
        let mut b = GraphBuilder::new();
        let (mut shape, mut chain) = ([33, 41, 2], Vec::new());
        let mut node = b.input(shape.iter().product(), false).unwrap();
        node = b.activation(node, Activation::NEAR_CONTRAST).unwrap();
        for (filters, kernel, stride, padding) in layers {
            let layer = Conv2d::new(shape, *filters, *kernel, *stride, *padding);
            let params = b.params(layer.param_len());
            node = b.conv2d(node, layer, Activation::Elu, params).unwrap();
            chain.push((layer, Activation::Elu, params));
            shape = [layer.out_rows(), layer.out_cols(), *filters];
        }
        let graph = b.finish(node, Purpose::Gradients).unwrap();
        let mut by_rows = ConvChain::new(Activation::NEAR_CONTRAST, &chain).unwrap();
        let mut rng = rng(3);
        let params = uniform(&mut rng, graph.param_len(), 0.3);
        let mut tape = vec![0.0; graph.tape_len()];
        for _ in 0..2 {
            let image: Vec<f32> = uniform(&mut rng, 33 * 41 * 2, 1.0).iter().map(|x| x.abs()).collect();
            graph.forward(isa, &params, &[&image], &mut tape).unwrap();
            let got = by_rows.forward(isa, &params, &image).unwrap();
            assert!(got == graph.output(&tape).unwrap(), "{layers:?} with {isa}");
        }
        assert!(
            by_rows.forward(isa, &params, &[0.0; 5]).is_err()
                && by_rows.forward(isa, &[], &[0.0; 33 * 41 * 2]).is_err()
        );
        chain.push(chain[0]);
        assert!(chain.len() < 3 || ConvChain::new(Activation::Identity, &chain).is_err());
        assert!(ConvChain::new(Activation::Identity, &[]).is_err());
    }
}

#[test]
fn recurrent_steps_match_their_definition() {
    let layer = Gru { inputs: 11, hidden: 7 };
    check(
        "GRU",
        &[11, 7],
        layer.param_len(),
        &|b, x, p| b.gru(x[0], x[1], layer, p),
        &|p, x| gru(layer, p, x[0], x[1]),
    );
    for cell in [Activation::TANH, Activation::Relu] {
        let layer = Lstm {
            inputs: 9,
            hidden: 5,
            cell,
        };
        check(
            "LSTM",
            &[9, 10],
            layer.param_len(),
            &|b, x, p| b.lstm(x[0], x[1], layer, p),
            &|p, x| lstm(layer, p, x[0], x[1]),
        );
    }
}

#[test]
fn pooling_and_normalisation_match_their_definition() {
    let tiles = MaxPool2d::tiles(7, 10, 9, 2);
    let overlapping = MaxPool2d {
        window: [3; 2],
        stride: 2,
        padding: 1,
        ..tiles
    };
    let whole = MaxPool2d {
        window: [7, 10],
        stride: 1,
        ..tiles
    };
    for layer in [tiles, overlapping, whole] {
        check(
            "max pool",
            &[layer.input_len()],
            0,
            &|b, x, _| b.max_pool2d(x[0], layer),
            &|_, x| max_pool(layer, x[0]),
        );
    }
    let layer = BatchNorm {
        channels: 3,
        epsilon: 1e-3,
    };
    check_learned(
        "batch norm",
        &[12],
        [layer.param_len(), 2 * layer.channels],
        &|b, x, p| b.batch_norm(x[0], layer, p),
        &|p, x| batch_norm(layer, p, x[0]),
        &|p| p[9..].iter_mut().for_each(|variance| *variance = variance.abs() + 0.1),
    );
}

#[test]
fn layer_normalisation_matches_its_definition() {
    // Of two values the norm is ±1, whatever they are.
    for width in [3, 7, 48, 129] {
        let layer = LayerNorm { width, epsilon: 1e-5 };
        check(
            "layer norm",
            &[2 * width],
            layer.param_len(),
            &|b, x, p| b.layer_norm(x[0], layer, p),
            &|p, x| layer_norm(layer, p, x[0]),
        );
    }
}

#[test]
fn element_wise_curves_match_their_definition() {
    for act in curves() {
        check("curve", &[37], 0, &|b, x, _| b.activation(x[0], act), &|_, x| {
            activation(act, x[0])
        });
    }
}

/// Convolution is linear in its input and in its weights, so both gradients are its adjoints:
/// `⟨conv(x, w), d⟩ = ⟨x, input gradient(d)⟩ = ⟨w, weight gradient(d)⟩`. Shapes are drawn, so that every meeting of
/// kernel, stride, padding and edge occurs.
#[test]
fn gradients_of_any_convolution_are_its_adjoints() {
    use rand::RngExt;
    let mut rng = rng(21);
    let mut checked = 0;
    while checked < 400 {
        let kernel = rng.random_range(1..=6);
        let layer = Conv2d::new(
            [
                rng.random_range(1..=12),
                rng.random_range(1..=40),
                rng.random_range(1..=20),
            ],
            rng.random_range(1..=40),
            kernel,
            rng.random_range(1..=4),
            rng.random_range(0..kernel),
        );
        if layer.validate().is_err() {
            continue;
        }
        checked += 1;
        let mut params = uniform(&mut rng, layer.param_len(), 0.5);
        params[layer.weight_len()..].fill(0.0);
        let [x, d] = [layer.input_len(), layer.output_len()].map(|len| uniform(&mut rng, len, 1.0));
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
        let want: f64 = conv2d(layer, Activation::Identity, &wide(&params), &wide(&x))
            .iter()
            .zip(&d)
            .map(|(y, d)| y * f64::from(*d))
            .sum();
        let scale = (dot(&d, &d) * dot(&x, &x)).sqrt().max(1.0);
        for isa in Isa::available() {
            let mut y = vec![f32::NAN; layer.output_len()];
            layer
                .forward(isa, &params, Activation::Identity, &x, None, &mut y)
                .unwrap();
            let mut packed = vec![f32::NAN; layer.param_len()];
            layer.pack(&params, &mut packed).unwrap();
            let mut dx = vec![f32::NAN; layer.input_len()];
            let mut scratch = vec![f32::NAN; layer.input_gradient_scratch_len()];
            layer.input_gradient(isa, &packed, &d, &mut dx, &mut scratch).unwrap();
            let mut dw = vec![0.0; layer.param_len()];
            layer.weight_gradient(isa, &x, &d, &mut dw).unwrap();
            dw[layer.weight_len()..].fill(0.0);
            for (what, got) in [
                ("value", dot(&y, &d)),
                ("input gradient", dot(&x, &dx)),
                ("weight gradient", dot(&params, &dw)),
            ] {
                let error = (got - want).abs() / scale;
                assert!(
                    error < 1e-5,
                    "{what} of {layer:?} on {}: {got} against {want}",
                    isa.name()
                );
            }
        }
    }
}
