//! Attack timings on the built-in actor: `cargo bench --profile release -p vigil-adversary`.

use divan::Bencher;
use vigil_adversary::{AttackConfig, StateAttack, StreamAttack};
use vigil_nnet::Isa;
use vigil_policy::FrozenActor;
use vigil_policy::actor::{ACTOR_FRAMES, ActorSpec, PositionalInputs};

fn main() {
    divan::main();
}

/// Ranges that differ from place to place, the same in each run.
fn frames(count: usize) -> Vec<f32> {
    let len = count * ActorSpec::FULL.frame_len();
    (0..len)
        .map(|i| 0.02 + (i * 40_503 % 65_536) as f32 / 300_000.0)
        .collect()
}

/// The paper's attack on a whole state: 20 iterations over five frames.
#[divan::bench(sample_count = 10, sample_size = 1)]
fn state_20_iterations(bencher: Bencher) {
    let actor = FrozenActor::built_in().unwrap();
    let mut attack = StateAttack::new(Isa::detect(), &actor, &AttackConfig::PAPER).unwrap();
    bencher.with_inputs(|| frames(ACTOR_FRAMES)).bench_local_refs(|frames| {
        attack
            .attack(frames, PositionalInputs::at_rest([0.5, 0.1], actor.inputs))
            .unwrap()
    });
}

/// The same on a frame as it passes.
#[divan::bench(sample_count = 20, sample_size = 1)]
fn stream_20_iterations(bencher: Bencher) {
    let actor = FrozenActor::built_in().unwrap();
    let mut attack = StreamAttack::new(Isa::detect(), &actor, &AttackConfig::PAPER).unwrap();
    bencher.with_inputs(|| frames(1)).bench_local_refs(|frame| {
        attack
            .attack(frame, PositionalInputs::at_rest([0.5, 0.1], actor.inputs))
            .unwrap()
    });
}
