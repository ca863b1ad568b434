//! The exported actor: what ONNX Runtime makes of it (`actor.onnx.json`, written by the exporter) against our own kernels.

use sha2::{Digest, Sha256};
use vigil_nnet::{Graph, Isa, Purpose};
use vigil_policy::FrozenActor;
use vigil_policy::actor::ACTOR_FRAMES;
use vigil_types::{DEPTH_COLS, DEPTH_ROWS};

const ONNX: &[u8] = include_bytes!("../actor/actor.onnx");
const RECORD: &str = include_str!("../actor/actor.onnx.json");
const EXPORT: &str = "run tools/peers/export.sh and commit what it writes";

#[derive(serde::Deserialize)]
struct Record {
    actor_sha256: String,
    onnx_sha256: String,
    actions: Vec<[f32; 2]>,
}

/// One of five depth frames: the formula of `pattern_frames` in tools/peers/actor.py.
fn pattern_frame(seed: usize, t: usize) -> Vec<f32> {
    let triangle = |x: usize| (x % 512).abs_diff(256) as f32;
    let at = |i: usize| {
        let (row, col) = (i / DEPTH_COLS, i % DEPTH_COLS);
        (triangle(7 * col + 3 * t + 40 * seed) + triangle(5 * row + 11 * t + 90 * seed)) / 1024.0
    };
    (0..DEPTH_ROWS * DEPTH_COLS).map(at).collect()
}

fn act(isa: Isa, graph: &Graph, params: &[f32], inputs: usize, seed: usize) -> Vec<f32> {
    let frames: Vec<Vec<f32>> = (0..ACTOR_FRAMES).map(|t| pattern_frame(seed, t)).collect();
    let told = |i: usize| 0.125 * ((3 * i + seed) % 9) as f32 - 0.5;
    let mut position = vec![0.125 * (seed as f32 + 1.0), 0.25 * (seed as f32 - 2.0)];
    position.extend((2..inputs).map(told));
    let mut given: Vec<&[f32]> = frames.iter().map(Vec::as_slice).collect();
    given.push(&position);
    let mut tape = vec![0.0; graph.tape_len()];
    graph.forward(isa, params, &given, &mut tape).unwrap();
    graph.output(&tape).unwrap().to_vec()
}

#[test]
fn onnx_runtime_decides_as_our_actor_does() {
    let record: Record = serde_json::from_str(RECORD).unwrap();
    let actor = FrozenActor::built_in().unwrap();
    assert_eq!(
        record.actor_sha256,
        actor.sha256(),
        "exported from another actor; {EXPORT}"
    );
    let onnx: String = Sha256::digest(ONNX).iter().map(|byte| format!("{byte:02x}")).collect();
    assert_eq!(record.onnx_sha256, onnx, "actor.onnx was altered; {EXPORT}");
    let spec = actor.inputs.spec();
    let (graph, inputs) = (spec.graph(Purpose::Gradients, false).unwrap(), spec.positional().inputs);
    assert!(record.actions.len() >= 5);
    for isa in Isa::available() {
        for (seed, theirs) in record.actions.iter().enumerate() {
            let ours = act(isa, &graph, &actor.params, inputs, seed);
            for (a, b) in ours.iter().zip(theirs) {
                assert!(
                    (a - b).abs() < 1e-5,
                    "{}, pattern {seed}: {ours:?} against {theirs:?}",
                    isa.name()
                );
            }
        }
        assert_ne!(
            act(isa, &graph, &actor.params, inputs, 0),
            act(isa, &graph, &actor.params, inputs, 1),
            "patterns do matter"
        );
    }
}
