//! The exported actor: what ONNX Runtime makes of it (`actor.onnx.json`, written by the exporter) against our own kernels.

#[path = "../../nnet/tests/common/mod.rs"]
mod plain;

use plain::Evaluated;
use vigil_nnet::{Isa, Purpose};
use vigil_policy::FrozenActor;
use vigil_policy::actor::{ActorSpec, CONTEXT, LOW_DIM};
use vigil_types::{DEPTH_COLS, DEPTH_ROWS};

const RECORD: &str = include_str!("../actor/actor.onnx.json");
const EXPORT: &str = "run tools/peers/export.sh and commit actor.onnx.json";

#[derive(serde::Deserialize)]
struct Record {
    actor_sha256: String,
    actions: Vec<[f32; 2]>,
}

/// A depth frame: the formula of `pattern_frame` in tools/peers/actor.py.
fn pattern_frame(seed: usize) -> Vec<f32> {
    let triangle = |x: usize| (x % 512).abs_diff(256) as f32;
    let at = |i: usize| {
        let (row, col) = (i / DEPTH_COLS, i % DEPTH_COLS);
        (triangle(7 * col + 40 * seed) + triangle(5 * row + 90 * seed)) / 1024.0
    };
    (0..DEPTH_ROWS * DEPTH_COLS).map(at).collect()
}

/// What is remembered, or low-dimensional: the formula of `pattern_values` there.
fn pattern_values(seed: usize, count: usize) -> Vec<f32> {
    let value = |i: usize| 0.125 * ((3 * i + seed) % 9) as f32 - 0.5;
    (0..count).map(value).collect()
}

#[test]
fn onnx_runtime_decides_as_our_actor_does() {
    let record: Record = serde_json::from_str(RECORD).unwrap();
    let actor = FrozenActor::built_in().unwrap();
    let sha256 = actor.sha256();
    assert_eq!(record.actor_sha256, sha256, "exported from another actor; {EXPORT}");
    let graph = ActorSpec::FULL.graph(Purpose::Gradients).unwrap();
    assert!(record.actions.len() >= 5);
    for isa in Isa::available() {
        let (name, evaluated) = (isa.name(), Evaluated::new(graph.clone(), isa, &actor.params));
        let act = |seed| {
            let [context, low_dim] = [CONTEXT, LOW_DIM].map(|count| pattern_values(seed, count));
            evaluated.output(&evaluated.tape(&[pattern_frame(seed), context, low_dim]))
        };
        for (seed, theirs) in record.actions.iter().enumerate() {
            let ours = act(seed);
            for (a, b) in ours.iter().zip(theirs) {
                let off = (a - b).abs();
                assert!(off < 1e-5, "{name}, pattern {seed}: {ours:?} against {theirs:?}");
            }
        }
        let [first, second] = [0, 1].map(act);
        assert_ne!(first, second, "patterns do matter");
    }
}
