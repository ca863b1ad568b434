//! Networks of our layers against PyTorch's, and DeepSHAP against the reference vectors: `shap`'s own values, an
//! independent float64 implementation, exact Shapley values where they must agree, and additivity everywhere.

mod torch;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use torch::{Given, Tensors, actor_params, features, reference, transposed};
use vigil_detector::{DeepShap, ShapError};
use vigil_nnet::{Activation, Dense, Graph, GraphBuilder, Isa, Purpose};
use vigil_policy::actor::{ActorSpec, CONTEXT, LOW_DIM, SCAN};

/// Largest difference allowed to a reference, and of Σφ to f(x) − mean f(b).
const TOLERANCE: f32 = 1e-5;
const FRAME: usize = 128 * 256;

fn pairs<'a>(first: &'a [f32], n: usize, second: &'a [f32], m: usize) -> Vec<Vec<&'a [f32]>> {
    let rows = first.chunks_exact(n).zip(second.chunks_exact(m));
    rows.map(|(a, b)| vec![a, b]).collect()
}

fn close(what: &str, got: &[f32], want: &[f32]) {
    assert_eq!(got.len(), want.len(), "{what}");
    for (i, (a, b)) in got.iter().zip(want).enumerate() {
        assert!((a - b).abs() <= TOLERANCE, "{what}: value {i} is {a}, not {b}");
    }
}

/// Σφ against the change of the output.
fn additive(what: &str, phi: &[f32], change: f32) {
    let sum: f64 = phi.iter().map(|phi| f64::from(*phi)).sum();
    let error = (sum - f64::from(change)).abs();
    assert!(error <= f64::from(TOLERANCE), "{what}: the sum is off by {error:e}");
}

/// Row `i`, column `output` of a reference with the output running fastest.
fn column(reference: &[f32], i: usize, n: usize, output: usize) -> Vec<f32> {
    reference[i * n * 2..(i + 1) * n * 2]
        .iter()
        .skip(output)
        .step_by(2)
        .copied()
        .collect()
}

/// Of each output φ, and the change of the output that it explains.
fn explained(shap: &mut DeepShap, inputs: &[&[f32]]) -> Vec<(Vec<f32>, f32)> {
    let outputs = shap.evaluate(inputs).unwrap().to_vec();
    let explain = |(output, f)| {
        let mut phi = vec![0.0; shap.phi_len()];
        shap.attribute(output, &mut phi).unwrap();
        (phi, f - shap.expected()[output])
    };
    outputs.into_iter().enumerate().map(explain).collect()
}

#[test]
fn the_second_half_is_explained_as_by_shap_and_in_float64() {
    let t = Tensors::load("second_half");
    let (bg_h, bg_pos, x_h, x_pos) = (t.get("bg_h"), t.get("bg_pos"), t.get("x_h"), t.get("x_pos"));
    for isa in Isa::available() {
        let graph = reference(Given::State, Purpose::Multipliers);
        let mut shap = DeepShap::new(isa, graph, &actor_params(), &pairs(&bg_h, 48, &bg_pos, 2)).unwrap();
        let of_backgrounds = t.get("f_bg");
        let mean =
            |output| of_backgrounds.iter().skip(output).step_by(2).sum::<f32>() / (of_backgrounds.len() / 2) as f32;
        close("PyTorch's backgrounds", shap.expected(), &[mean(0), mean(1)]);
        for (i, inputs) in pairs(&x_h, 48, &x_pos, 2).iter().enumerate() {
            let pytorch = &t.get("f_x")[2 * i..2 * i + 2];
            close("PyTorch's outputs", shap.evaluate(inputs).unwrap(), pytorch);
            for (output, (phi, change)) in explained(&mut shap, inputs).iter().enumerate() {
                for who in ["shap", "np64"] {
                    let h = column(&t.get(&format!("{who}_h")), i, 48, output);
                    let pos = column(&t.get(&format!("{who}_pos")), i, 2, output);
                    close(who, phi, &[h, pos].concat());
                }
                additive("second half", phi, *change);
            }
        }
    }
}

/// The second half model with 8 instead of 48 values, or a linear map from the same inputs.
fn tiny(t: &Tensors) -> (Graph, Vec<f32>) {
    let layer = |inputs, outputs| Dense { inputs, outputs };
    let mut b = GraphBuilder::new();
    let (h, pos) = (b.input(8, true).unwrap(), b.input(2, true).unwrap());
    let dense = |b: &mut GraphBuilder, x, layer: Dense, act| {
        let params = b.params(layer.param_len());
        b.dense(x, layer, act, params).unwrap()
    };
    let pos = dense(&mut b, pos, layer(2, 6), Activation::TANH);
    let h = b.activation(h, Activation::TANH).unwrap();
    let z = b.concat(&[h, pos]).unwrap();
    let z = dense(&mut b, z, layer(14, 32), Activation::Elu);
    let y = dense(&mut b, z, layer(32, 2), Activation::Tanh { scale: 1.5 });
    let params = ["second_dp", "second_d1", "second_d2"]
        .map(|name| t.dense(name))
        .concat();
    (b.finish(y, Purpose::Multipliers).unwrap(), params)
}

#[test]
fn a_small_network_is_explained_as_in_float64() {
    let t = Tensors::load("tiny10");
    let (bg_h, bg_pos, x_h, x_pos) = (t.get("bg_h"), t.get("bg_pos"), t.get("x_h"), t.get("x_pos"));
    let (graph, params) = tiny(&t);
    let mut shap = DeepShap::new(Isa::detect(), graph, &params, &pairs(&bg_h, 8, &bg_pos, 2)).unwrap();
    for (i, inputs) in pairs(&x_h, 8, &x_pos, 2).iter().enumerate() {
        for (output, (phi, change)) in explained(&mut shap, inputs).iter().enumerate() {
            close("tiny10", phi, &column(&t.get("deepshap_np64"), i, 10, output));
            let exact = column(&t.get("exact"), i, 10, output);
            // DeepSHAP only approximates Shapley values, but both explain the same change.
            additive("tiny10", phi, *change);
            additive("exact Shapley values", &exact, *change);
        }
    }
}

#[test]
fn for_a_linear_network_deepshap_is_the_exact_shapley_value() {
    let t = Tensors::load("tiny10");
    let (bg_h, bg_pos, x_h, x_pos) = (t.get("bg_h"), t.get("bg_pos"), t.get("x_h"), t.get("x_pos"));
    let layer = Dense { inputs: 10, outputs: 2 };
    let mut b = GraphBuilder::new();
    let (h, pos) = (b.input(8, true).unwrap(), b.input(2, true).unwrap());
    let x = b.concat(&[h, pos]).unwrap();
    let params = b.params(layer.param_len());
    let y = b.dense(x, layer, Activation::Identity, params).unwrap();
    let graph = b.finish(y, Purpose::Multipliers).unwrap();
    let params = [transposed(&t.get("linear_W"), 2), vec![0.25; 2]].concat();
    let mut shap = DeepShap::new(Isa::detect(), graph, &params, &pairs(&bg_h, 8, &bg_pos, 2)).unwrap();
    for (i, inputs) in pairs(&x_h, 8, &x_pos, 2).iter().enumerate() {
        for (output, (phi, _)) in explained(&mut shap, inputs).iter().enumerate() {
            let exact = column(&t.get("linear_exact"), i, 10, output);
            for (a, b) in phi.iter().zip(exact) {
                assert!((a - b).abs() < 1e-6, "{a} against {b}");
            }
        }
    }
}

#[test]
fn through_the_gru_each_frames_share_is_as_in_float64() {
    let t = Tensors::load("frames7");
    let graph = reference(Given::Features, Purpose::Multipliers);
    let load = |what: &str| -> Vec<Vec<f32>> { t.get(what).chunks_exact(1024).map(features).collect() };
    let (bg_feat, x_feat) = (load("bg_feat"), load("x_feat"));
    let (bg_pos, x_pos) = (t.get("bg_pos"), t.get("x_pos"));
    let states = |feat: &'_ [Vec<f32>], pos: &'_ [f32]| -> Vec<Vec<Vec<f32>>> {
        let rows = feat.chunks_exact(5).zip(pos.chunks_exact(2));
        rows.map(|(f, p)| f.iter().cloned().chain([p.to_vec()]).collect())
            .collect()
    };
    let (backgrounds, inputs) = (states(&bg_feat, &bg_pos), states(&x_feat, &x_pos));
    let backgrounds: Vec<_> = backgrounds.iter().map(|b| views(b)).collect();
    let mut shap = DeepShap::new(Isa::detect(), graph, &actor_params(), &backgrounds).unwrap();
    for (i, state) in inputs.iter().enumerate() {
        for (output, (phi, change)) in explained(&mut shap, &views(state)).iter().enumerate() {
            let (frames, pos) = phi.split_at(5 * 1024);
            let mut players: Vec<f32> = frames.chunks_exact(1024).map(|f| f.iter().sum()).collect();
            players.extend(pos);
            close("frames", &players, &column(&t.get("deepshap_np64"), i, 7, output));
            additive("frames", phi, *change);
        }
    }
}

#[test]
fn the_whole_actor_is_explained_at_its_pixels_as_in_float64() {
    let t = Tensors::load("pixel");
    let (bg_img, bg_pos, x_img, x_pos) = (t.get("bg_img"), t.get("bg_pos"), t.get("x_img"), t.get("x_pos"));
    let state = |images, position| {
        <[f32]>::chunks_exact(images, FRAME)
            .chain([position])
            .collect::<Vec<_>>()
    };
    let rows = bg_img.chunks_exact(5 * FRAME).zip(bg_pos.chunks_exact(2));
    let backgrounds: Vec<Vec<&[f32]>> = rows.map(|(images, position)| state(images, position)).collect();
    let graph = reference(Given::Frames(true), Purpose::Multipliers);
    let mut shap = DeepShap::new(Isa::detect(), graph, &actor_params(), &backgrounds).unwrap();
    let sampled = t.get("np64_img_every_5th");
    for (output, (phi, change)) in explained(&mut shap, &state(&x_img, &x_pos)).iter().enumerate() {
        additive("pixels", phi, *change);
        // The reference saw the images before they were rounded to 1/65535.
        assert!((change - t.get("f_diff")[output]).abs() < TOLERANCE);
        let (images, position) = phi.split_at(5 * FRAME);
        let every_5th: Vec<f32> = images.iter().step_by(5).copied().collect();
        let n = every_5th.len();
        close("pixels", &every_5th, &sampled[output * n..(output + 1) * n]);
        close("position", position, &column(&t.get("np64_pos"), 0, 2, output));
        let frames: Vec<f32> = images.chunks_exact(FRAME).map(|f| f.iter().sum()).collect();
        for (a, b) in frames.iter().zip(column(&t.get("np64_img_frame_sums"), 0, 5, output)) {
            assert!((a - b).abs() < 2e-5, "a frame's share is {a}, not {b}");
        }
        let mut on_threads = vec![0.0; phi.len()];
        shap.attribute_on_threads(output, 2, &mut on_threads).unwrap();
        let largest = phi
            .iter()
            .zip(&on_threads)
            .fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
        assert!(largest < 1e-8, "threads change φ by {largest:e}");
    }
}

/// Values that differ from place to place, the same in each run; within ±1.
fn wave(n: usize, seed: usize) -> Vec<f32> {
    let at = |i: usize| ((i * i + 3 * seed * i + seed) as f32 * 0.37).sin();
    (0..n).map(at).collect()
}

fn views(state: &[Vec<f32>]) -> Vec<&[f32]> {
    state.iter().map(Vec::as_slice).collect()
}

/// φ of the yaw output, and the change of the output that it explains.
fn yaw_explained(graph: Graph, params: &[f32], backgrounds: &[Vec<Vec<f32>>], x: &[Vec<f32>]) -> (Vec<f32>, f32) {
    let backgrounds: Vec<_> = backgrounds.iter().map(|b| views(b)).collect();
    let mut shap = DeepShap::new(Isa::detect(), graph, params, &backgrounds).unwrap();
    explained(&mut shap, &views(x)).swap_remove(1)
}

/// The actor of flight: the newest frame's pixels carry what its scan does, and what is remembered and low-dimensional keeps its share.
#[test]
fn the_actors_pixels_share_out_what_its_scan_contributed() {
    let spec = ActorSpec { rows: 32, cols: 64 };
    let graph = spec.graph(Purpose::Multipliers).unwrap();
    // The same network from the scan on.
    let behind_the_scan = {
        let mut b = GraphBuilder::new();
        let params = spec.reserve(&mut b);
        let (scan, context) = (b.input(SCAN, true).unwrap(), b.input(CONTEXT, true).unwrap());
        let low = b.input(LOW_DIM, true).unwrap();
        let state = spec.trunk_to_state(&mut b, &params, scan, context).unwrap();
        let last = Activation::Tanh { scale: 1.5 };
        let output = spec.decide(&mut b, &params, state, low, last).unwrap();
        b.finish(output, Purpose::Multipliers).unwrap()
    };
    let encoder = spec.encoder_graph(Purpose::Gradients, false).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let params: Vec<f32> = (0..graph.param_len()).map(|_| random.random_range(-0.3..0.3)).collect();
    let isa = Isa::detect();
    let mut tape = vec![0.0; encoder.tape_len()];
    let mut state = |seed: usize| {
        let frame: Vec<f32> = wave(spec.frame_len(), 10 * seed)
            .iter()
            .map(|x| 0.1 + 0.1 * x)
            .collect();
        encoder.forward(isa, &params, &[&frame], &mut tape).unwrap();
        let scan = encoder.output(&tape).unwrap().to_vec();
        let beside = [wave(CONTEXT, seed + 50), wave(LOW_DIM, seed + 90)];
        let with = |first: Vec<f32>| [&[first][..], &beside[..]].concat();
        (with(frame), with(scan))
    };
    let x = state(0);
    let (frames, scans): (Vec<_>, Vec<_>) = (1..5).map(&mut state).unzip();
    let (pixels, change) = yaw_explained(graph, &params, &frames, &x.0);
    let (columns, same_change) = yaw_explained(behind_the_scan, &params, &scans, &x.1);
    assert!(change.abs() > 1e-2, "the outputs differ: {change}");
    assert!((change - same_change).abs() < TOLERANCE);
    additive("pixels, memory and low-dimensional values", &pixels, change);
    let (frame, beside) = pixels.split_at(spec.frame_len());
    let (scan, beside_the_scan) = columns.split_at(SCAN);
    close("memory and low-dimensional values", beside, beside_the_scan);
    let (of_pixels, of_scan): (f32, f32) = (frame.iter().sum(), scan.iter().sum());
    assert!((of_pixels - of_scan).abs() < TOLERANCE, "{of_pixels} against {of_scan}");
    assert!(of_scan.abs() > 1e-4, "the frame has a share: {of_scan}");
    assert!(beside.iter().any(|phi| phi.abs() > 1e-4), "so has what is remembered");
}

#[test]
fn what_cannot_be_explained_is_refused_by_name() {
    let params = actor_params();
    let (h, pos) = ([0.1f32; 48], [0.2f32; 2]);
    let background = || vec![vec![&h[..], &pos[..]]];
    let head = || reference(Given::State, Purpose::Multipliers);
    let none: [Vec<&[f32]>; 0] = [];
    let new = |graph, backgrounds: &[Vec<&[f32]>]| DeepShap::new(Isa::detect(), graph, &params, backgrounds);
    assert_eq!(new(head(), &none).unwrap_err(), ShapError::NoBackground);
    let gradients = reference(Given::State, Purpose::Gradients);
    assert_eq!(new(gradients, &background()).unwrap_err(), ShapError::Purpose);
    let encoder = reference(Given::Frames(false), Purpose::Multipliers);
    assert_eq!(new(encoder, &background()).unwrap_err(), ShapError::NothingExplained);
    let broken = [f32::NAN; 48];
    let with_nan = vec![vec![&h[..], &pos[..]], vec![&broken[..], &pos[..]]];
    assert_eq!(
        new(head(), &with_nan).unwrap_err(),
        ShapError::BackgroundNotFinite { background: 1 }
    );
    let short = vec![vec![&h[..47], &pos[..]]];
    let message = new(head(), &short).unwrap_err().to_string();
    assert_eq!(message, "network input holds 47 values, expected 48");

    let mut shap = new(head(), &background()).unwrap();
    let mut phi = vec![0.0; 50];
    assert_eq!(shap.attribute(0, &mut phi).unwrap_err(), ShapError::NotEvaluated);
    shap.evaluate(&[&h, &pos]).unwrap();
    let error = shap.attribute(2, &mut phi).unwrap_err();
    assert_eq!(error, ShapError::Output { output: 2, outputs: 2 });
    assert!(shap.attribute(0, &mut phi[1..]).is_err());
    shap.attribute(0, &mut phi).unwrap();
    assert!(phi.iter().all(|phi| *phi == 0.0), "a state equal to its background");
    shap.evaluate(&[&broken, &pos]).unwrap();
    assert_eq!(shap.attribute(1, &mut phi).unwrap_err(), ShapError::NotFinite);
    shap.evaluate(&[&h, &pos]).unwrap();
    shap.attribute(1, &mut phi).unwrap();
    assert!(shap.evaluate(&[&h]).is_err());
    assert_eq!(shap.attribute(1, &mut phi).unwrap_err(), ShapError::NotEvaluated);
}
