//! DeepSHAP timings: `cargo bench --profile release -p vigil-detector`.

use divan::{Bencher, black_box};
use vigil_detector::DeepShap;
use vigil_nnet::{Graph, Isa, Purpose};
use vigil_policy::actor::ActorSpec;

fn main() {
    divan::main();
}

const BACKGROUNDS: usize = 30;

/// Values that differ from place to place, the same in each run.
fn values(len: usize, seed: usize, limit: f32) -> Vec<f32> {
    let at = |i: usize| ((i + 1) * (2 * seed + 12_345) * 40_503 % 65_536) as f32 / 32_768.0 - 1.0;
    (0..len).map(|i| limit * at(i)).collect()
}

fn inputs(graph: &Graph, seed: usize) -> Vec<Vec<f32>> {
    let each = |i| values(graph.input_len(i), seed + 100 * i, 0.9);
    (0..graph.input_count()).map(each).collect()
}

fn views(inputs: &[Vec<f32>]) -> Vec<&[f32]> {
    inputs.iter().map(Vec::as_slice).collect()
}

fn explainer(graph: Graph) -> (DeepShap, Vec<Vec<f32>>) {
    let params = values(graph.param_len(), 7, 0.1);
    let owned: Vec<_> = (1..=BACKGROUNDS).map(|seed| inputs(&graph, seed)).collect();
    let backgrounds: Vec<_> = owned.iter().map(|b| views(b)).collect();
    let x = inputs(&graph, 0);
    let shap = DeepShap::new(Isa::detect(), graph, &params, &backgrounds).unwrap();
    (shap, x)
}

/// The second half model, both outputs, 30 backgrounds: what the tick does.
#[divan::bench]
fn second_half_both_outputs(bencher: Bencher) {
    let (mut shap, x) = explainer(ActorSpec::FULL.head_graph(Purpose::Multipliers).unwrap());
    let (x, mut phi) = (views(&x), vec![0.0; shap.phi_len()]);
    bencher.bench_local(|| {
        shap.evaluate(black_box(&x)).unwrap();
        shap.attribute(0, &mut phi).unwrap();
        shap.attribute(1, &mut phi).unwrap();
    });
}

/// Exact: all pixels of the newest frame, what is remembered beside them, one output, 30 backgrounds.
#[divan::bench(args = [1, 2], sample_count = 20, sample_size = 1)]
fn pixels_of_the_newest_frame(bencher: Bencher, threads: usize) {
    let (mut shap, x) = explainer(ActorSpec::FULL.graph(Purpose::Multipliers).unwrap());
    let (x, mut phi) = (views(&x), vec![0.0; shap.phi_len()]);
    bencher.bench_local(|| {
        shap.evaluate(black_box(&x)).unwrap();
        match threads {
            1 => shap.attribute(1, &mut phi).unwrap(),
            _ => shap.attribute_on_threads(1, threads, &mut phi).unwrap(),
        }
    });
}
