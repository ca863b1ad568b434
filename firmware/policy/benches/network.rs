//! Timings of the actor's network: `cargo bench --profile release -p vigil-policy --bench network`.

use divan::{Bencher, black_box};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use vigil_nnet::{Aligned, Graph, Isa, Purpose};
use vigil_policy::actor::{Actor, ActorSpec};

fn main() {
    divan::main();
}

fn values(len: usize, limit: f32) -> Aligned {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let values: Vec<f32> = (0..len).map(|_| rng.random_range(-limit..limit)).collect();
    Aligned::from(&*values)
}

/// Names an instruction set in the table.
#[derive(Clone, Copy)]
struct Named(Isa);

impl std::fmt::Display for Named {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.0.name())
    }
}

fn sets() -> Vec<Named> {
    Isa::available().map(Named).collect()
}

fn initial(graph: &Graph) -> Aligned {
    values(graph.param_len(), 0.08)
}

#[divan::bench(args = sets())]
fn encoder_one_frame(bencher: Bencher, isa: Named) {
    let graph = ActorSpec::FULL.encoder_graph(Purpose::Gradients, false).unwrap();
    let (params, frame) = (initial(&graph), values(ActorSpec::FULL.frame_len(), 0.5));
    let mut tape = Aligned::zeros(graph.tape_len());
    bencher.bench_local(|| graph.forward(isa.0, &params, &[black_box(&frame)], &mut tape).unwrap());
}

#[divan::bench(args = sets())]
fn actor_one_new_frame(bencher: Bencher, isa: Named) {
    let graph = ActorSpec::FULL.head_graph(Purpose::Gradients).unwrap();
    let frame = values(ActorSpec::FULL.frame_len(), 0.5);
    let params = initial(&graph);
    let mut actor = Actor::new(ActorSpec::FULL, isa.0, &params).unwrap();
    bencher.bench_local(|| actor.decide(black_box(&frame), [0.3, 0.1]).unwrap());
}

/// 32 states of 5 frames, forward and backward with weight gradients, on one core: the actor's part of an update.
#[divan::bench(args = sets(), sample_count = 5, sample_size = 1)]
fn batch_32_forward_and_backward(bencher: Bencher, isa: Named) {
    let graph = ActorSpec::FULL.graph(Purpose::Gradients, false).unwrap();
    let params = initial(&graph);
    let mut packed = Aligned::zeros(graph.param_len());
    let mut d_params = Aligned::zeros(graph.param_len());
    let mut tape = Aligned::zeros(graph.tape_len());
    let mut work = Aligned::zeros(graph.work_len());
    let frames: Vec<_> = (0..5).map(|_| values(ActorSpec::FULL.frame_len(), 0.5)).collect();
    let position = [0.3, 0.1];
    let mut inputs: Vec<&[f32]> = frames.iter().map(|frame| &**frame).collect();
    inputs.push(&position);
    bencher.bench_local(|| {
        graph.pack(&params, &mut packed).unwrap();
        for _ in 0..32 {
            graph.forward(isa.0, &params, black_box(&inputs), &mut tape).unwrap();
            graph
                .backward(isa.0, &packed, &tape, &[1.0, -1.0], Some(&mut d_params), &mut work)
                .unwrap();
        }
    });
}
