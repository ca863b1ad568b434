//! Attack timings on the built-in actor: `cargo bench --profile release -p vigil-adversary`.

use divan::Bencher;
use vigil_adversary::{AttackConfig, Beside, StateAttack, StreamAttack};
use vigil_nnet::Isa;
use vigil_policy::{FrozenActor, PilotInput};
use vigil_types::{DepthFrame, GoalRelative};

fn main() {
    divan::main();
}

/// Ranges that differ from place to place, the same in each run.
fn frame() -> Box<DepthFrame> {
    let mut frame = Box::new(DepthFrame::EMPTY);
    for (i, range) in frame.depth.iter_mut().enumerate() {
        *range = 0.02 + (i * 40_503 % 65_536) as f32 / 300_000.0;
    }
    frame
}

fn input(depth: &DepthFrame) -> PilotInput<'_> {
    PilotInput {
        height_m: 1.5,
        ..PilotInput::at_rest(depth, GoalRelative::new(10.0, 0.1))
    }
}

/// The paper's attack on a state: 20 iterations over the newest frame.
#[divan::bench(sample_count = 10, sample_size = 1)]
fn state_20_iterations(bencher: Bencher) {
    let frozen = FrozenActor::built_in().unwrap();
    let mut actor = frozen.actor(Isa::detect()).unwrap();
    actor.decide(&input(&frame())).unwrap();
    let beside = Beside::of(&actor);
    let mut attack = StateAttack::new(Isa::detect(), &frozen, &AttackConfig::PAPER).unwrap();
    bencher
        .with_inputs(frame)
        .bench_local_refs(|frame| attack.attack(&mut frame.depth, &beside).unwrap());
}

/// The same on a frame as it passes.
#[divan::bench(sample_count = 20, sample_size = 1)]
fn stream_20_iterations(bencher: Bencher) {
    let actor = FrozenActor::built_in().unwrap();
    let mut attack = StreamAttack::new(Isa::detect(), &actor, &AttackConfig::PAPER).unwrap();
    let taken = frame();
    bencher
        .with_inputs(frame)
        .bench_local_refs(|delivered| attack.attack_while(&input(&taken), delivered, || true).unwrap());
}
