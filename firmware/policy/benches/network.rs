//! Timings of the actor's network: `cargo bench --profile release -p vigil-policy --bench network`.

#[path = "../tests/common/mod.rs"]
mod common;

use common::input;
use divan::{Bencher, black_box};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use vigil_nnet::{Aligned, Graph, Isa, Purpose};
use vigil_policy::PilotInput;
use vigil_policy::actor::{Actor, ActorSpec, FrameEncoder, SCAN};
use vigil_types::{Attitude, DepthFrame};

fn main() {
    divan::main();
}

fn values(len: usize, limit: f32) -> Aligned {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let values: Vec<f32> = (0..len).map(|_| rng.random_range(-limit..limit)).collect();
    Aligned::from(&*values)
}

fn initial(graph: &Graph) -> Aligned {
    values(graph.param_len(), 0.08)
}

#[divan::bench(args = Isa::available())]
fn encoder_one_frame(bencher: Bencher, isa: Isa) {
    let graph = ActorSpec::FULL.encoder_graph(Purpose::Gradients, false).unwrap();
    let (params, frame) = (initial(&graph), values(ActorSpec::FULL.frame_len(), 0.5));
    let mut tape = Aligned::zeros(graph.tape_len());
    bencher.bench_local(|| graph.forward(isa, &params, &[black_box(&frame)], &mut tape).unwrap());
}

/// The same row by row, as in flight.
#[divan::bench(args = Isa::available())]
fn encoder_one_frame_by_rows(bencher: Bencher, isa: Isa) {
    let params = values(ActorSpec::FULL.encoder_len(), 0.08);
    let (mut encoder, frame) = (
        FrameEncoder::new(ActorSpec::FULL).unwrap(),
        values(ActorSpec::FULL.frame_len(), 0.5),
    );
    let mut scan = [0.0; SCAN];
    bencher.bench_local(|| encoder.encode(isa, &params, black_box(&frame), &mut scan).unwrap());
}

#[divan::bench(args = Isa::available())]
fn actor_one_new_frame(bencher: Bencher, isa: Isa) {
    let graph = ActorSpec::FULL.head_graph(Purpose::Gradients).unwrap();
    let mut frame = DepthFrame::EMPTY;
    frame.depth.copy_from_slice(&values(ActorSpec::FULL.frame_len(), 0.5));
    let params = initial(&graph);
    let mut actor = Actor::new(ActorSpec::FULL, isa, &params).unwrap();
    let mut now_ns = 0;
    bencher.bench_local(|| {
        now_ns += 50_000_000;
        let input = PilotInput {
            now_ns,
            ..input(&frame, Attitude::LEVEL_NORTH)
        };
        actor.decide(black_box(&input)).unwrap()
    });
}
