//! The actor against PyTorch's, and in flight against itself.

#[path = "../../nnet/tests/common/mod.rs"]
mod plain;
#[path = "common/torch.rs"]
mod torch;

use plain::{distance, rng, uniform, wide};
use torch::{SPEC, Tensors, actor_params};
use vigil_nnet::{ISA_MULTIPLIER_TOLERANCE, ISA_TOLERANCE, Isa, Purpose};
use vigil_policy::actor::{Actor, ActorSpec, FRAMES_SPREAD};

const FRAME: usize = 128 * 256;

#[test]
fn the_second_half_gives_what_pytorch_gives() {
    let (t, params) = (Tensors::load("second_half"), actor_params());
    let graph = SPEC.head_graph(Purpose::Gradients).unwrap();
    let mut tape = vec![0.0; graph.tape_len()];
    for isa in Isa::available() {
        for (h, pos, want) in [("x_h", "x_pos", "f_x"), ("bg_h", "bg_pos", "f_bg")] {
            let (h, pos, want) = (t.get(h), t.get(pos), t.get(want));
            let rows = h.chunks_exact(48).zip(pos.chunks_exact(2)).zip(want.chunks_exact(2));
            for ((h, pos), want) in rows {
                graph.forward(isa, &params, &[h, pos], &mut tape).unwrap();
                let error = distance(graph.output(&tape).unwrap(), &wide(want));
                assert!(error < 1e-6, "{error:e} on {}", isa.name());
            }
        }
    }
}

#[test]
fn the_whole_actor_gives_what_pytorch_gives() {
    let (t, params) = (Tensors::load("pixel"), actor_params());
    let graph = SPEC.graph(Purpose::Gradients, false).unwrap();
    let mut tape = vec![0.0; graph.tape_len()];
    for isa in Isa::available() {
        let mut evaluate = |images: &[f32], pos: &[f32]| {
            let mut inputs: Vec<&[f32]> = images.chunks_exact(FRAME).collect();
            inputs.push(pos);
            graph.forward(isa, &params, &inputs, &mut tape).unwrap();
            wide(graph.output(&tape).unwrap())
        };
        let mut difference = evaluate(&t.get("x_img"), &t.get("x_pos"));
        for (images, pos) in t
            .get("bg_img")
            .chunks_exact(5 * FRAME)
            .zip(t.get("bg_pos").chunks_exact(2))
        {
            let f = evaluate(images, pos);
            difference.iter_mut().zip(f).for_each(|(d, f)| *d -= f / 3.0);
        }
        // The images are rounded to 1/65535.
        let error = distance(&t.get("f_diff"), &difference);
        assert!(error < 1e-5, "{error:e} on {}", isa.name());
    }
}

/// A small actor with near contrast and random weights.
fn small() -> (ActorSpec, Vec<f32>) {
    let spec = ActorSpec {
        rows: 32,
        cols: 64,
        near_contrast: true,
        told_of_movers: false,
    };
    let params = spec.head_graph(Purpose::Gradients).unwrap().param_len();
    (spec, uniform(&mut rng(3), params, 0.2))
}

#[test]
fn encoding_only_the_new_frame_gives_the_bits_of_encoding_all_five() {
    let (spec, params) = small();
    let graph = spec.graph(Purpose::Gradients, false).unwrap();
    let encoder = spec.encoder_graph(Purpose::Gradients, false).unwrap();
    let mut encoder_tape = vec![0.0; encoder.tape_len()];
    let frames: Vec<Vec<f32>> = (0..9)
        .map(|i| {
            uniform(&mut rng(i), spec.frame_len(), 0.5)
                .iter()
                .map(|x| x + 0.5)
                .collect()
        })
        .collect();
    for isa in Isa::available() {
        let mut actor = Actor::new(spec, isa, &params).unwrap();
        let mut tape = vec![0.0; graph.tape_len()];
        for newest in 0..frames.len() {
            let position = [0.1 * newest as f32, -0.2];
            let action = actor.decide(&frames[newest], position).unwrap();
            // Before the fifth frame the first one stands for the missing ones.
            let mut inputs: Vec<&[f32]> = (0..5)
                .map(|age| frames[(newest + age).saturating_sub(4)].as_slice())
                .collect();
            inputs.push(&position);
            graph.forward(isa, &params, &inputs, &mut tape).unwrap();
            assert_eq!(action, graph.output(&tape).unwrap(), "step {newest} on {}", isa.name());
            for age in 0..5 {
                encoder
                    .forward(isa, &params, &inputs[4 - age..5 - age], &mut encoder_tape)
                    .unwrap();
                assert_eq!(actor.features(age), Some(encoder.output(&encoder_tape).unwrap()));
            }
            assert_eq!(actor.features(5), None);
        }
        actor.reset();
        let again = actor.decide(&frames[0], [0.0, -0.2]).unwrap();
        let first = Actor::new(spec, isa, &params)
            .unwrap()
            .decide(&frames[0], [0.0, -0.2])
            .unwrap();
        assert_eq!(again, first, "a reset forgets");
    }
}

#[test]
fn a_frame_of_another_size_is_refused_and_not_remembered() {
    let (spec, params) = small();
    let mut actor = Actor::new(spec, Isa::detect(), &params).unwrap();
    let mut twin = actor.clone();
    let frame = vec![0.4; spec.frame_len()];
    actor.decide(&frame, [0.0; 2]).unwrap();
    twin.decide(&frame, [0.0; 2]).unwrap();
    let error = actor.decide(&frame[1..], [0.0; 2]).unwrap_err();
    assert_eq!(error.to_string(), "network input holds 2047 values, expected 2048");
    assert_eq!(actor.decide(&frame, [0.1; 2]), twin.decide(&frame, [0.1; 2]));
    assert!(Actor::new(spec, Isa::detect(), &params[1..]).is_err());
}

#[test]
fn a_pixel_that_is_not_a_number_is_not_hidden() {
    let (spec, params) = small();
    let mut frame = vec![0.4; spec.frame_len()];
    frame[777] = f32::NAN;
    for isa in Isa::available() {
        let mut actor = Actor::new(spec, isa, &params).unwrap();
        assert!(actor.decide(&frame, [0.0; 2]).unwrap()[0].is_nan(), "{}", isa.name());
    }
}

#[test]
fn instruction_sets_agree() {
    let (spec, params) = small();
    let graph = spec.graph(Purpose::Multipliers, true).unwrap();
    let mut packed = vec![0.0; graph.param_len()];
    graph.pack(&params, &mut packed).unwrap();
    let input = |seed: u64| -> Vec<Vec<f32>> {
        let mut rng = rng(seed);
        let mut all: Vec<Vec<f32>> = (0..5)
            .map(|_| {
                uniform(&mut rng, spec.frame_len(), 0.5)
                    .iter()
                    .map(|x| x + 0.5)
                    .collect()
            })
            .collect();
        all.push(vec![0.3, -0.4]);
        all
    };
    let results: Vec<(Isa, [Vec<f32>; 4])> = Isa::available()
        .map(|isa| {
            let evaluate = |inputs: &[Vec<f32>]| {
                let mut tape = vec![0.0; graph.tape_len()];
                let views: Vec<&[f32]> = inputs.iter().map(Vec::as_slice).collect();
                graph.forward(isa, &params, &views, &mut tape).unwrap();
                tape
            };
            let (tape, reference) = (evaluate(&input(1)), evaluate(&input(2)));
            let (mut work, mut d_params) = (vec![0.0; graph.work_len()], vec![0.0; graph.param_len()]);
            let weights = [1.0, -0.5];
            graph
                .backward(isa, &packed, &tape, &weights, Some(&mut d_params), &mut work)
                .unwrap();
            let gradient = graph.input_gradient(&work, 2).unwrap().to_vec();
            graph
                .multipliers(isa, &packed, &tape, &reference, &weights, &mut work)
                .unwrap();
            let multipliers = graph.input_gradient(&work, 2).unwrap().to_vec();
            (isa, [tape, d_params, gradient, multipliers])
        })
        .collect();
    let (_, portable) = &results[0];
    for (isa, fused) in &results[1..] {
        // Fused multiply-add in the same order: the same bits, whatever the width.
        assert_eq!(fused, &results[1].1, "{}", isa.name());
        let tolerances = [ISA_TOLERANCE, ISA_TOLERANCE, ISA_TOLERANCE, ISA_MULTIPLIER_TOLERANCE];
        for ((fused, portable), tolerance) in fused.iter().zip(portable).zip(tolerances) {
            let scale = portable.iter().fold(0.0f32, |m, x| m.max(x.abs()));
            let error = distance(fused, &wide(portable)) as f32;
            assert!(error <= tolerance * scale, "{error:e} of {scale}");
        }
    }
}

#[test]
fn frames_may_be_spread_over_many_decisions() {
    let (spec, params) = small();
    let isa = Isa::detect();
    let graph = spec.graph(Purpose::Gradients, false).unwrap();
    let mut tape = vec![0.0; graph.tape_len()];
    let frames: Vec<Vec<f32>> = (0..50).map(|i| uniform(&mut rng(i), spec.frame_len(), 0.5)).collect();
    let mut actor = Actor::with_frame_ages(spec, isa, &params, FRAMES_SPREAD).unwrap();
    for newest in 0..frames.len() {
        let position = [0.3, 0.02 * newest as f32];
        let action = actor.decide(&frames[newest], position).unwrap();
        let older = FRAMES_SPREAD.map(|age| frames[newest.saturating_sub(age)].as_slice());
        let mut inputs = older.to_vec();
        inputs.push(&position);
        graph.forward(isa, &params, &inputs, &mut tape).unwrap();
        assert_eq!(action, graph.output(&tape).unwrap(), "step {newest}");
    }
    for ages in [[4, 3, 2, 1, 1], [4, 3, 3, 1, 0], [0, 1, 2, 3, 4], [65, 3, 2, 1, 0]] {
        assert!(Actor::with_frame_ages(spec, isa, &params, ages).is_err(), "{ages:?}");
    }
}
