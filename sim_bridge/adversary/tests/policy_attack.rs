//! The attack on imported policies against what can be worked out by hand: linear policies, and the pilot that flies them.

use vigil_adversary::{AttackConfig, AttackOutcome, FrameAttack, Method, Towards};
use vigil_nnet::{Activation, Dense, Isa};
use vigil_policy::actor::{ACTOR_LIMIT, LowDim};
use vigil_policy::imported::{Channels, Depth, FrozenPolicy, Layer, Network, PolicyInputs};
use vigil_policy::{FrozenPilot, ImportedPilot, PilotInput};
use vigil_types::{DEPTH_COLS, DEPTH_PIXELS, DepthFrame, GoalRelative};

const INPUTS: PolicyInputs = PolicyInputs {
    rows: 4,
    cols: 8,
    channels: 3,
    order: Channels::Stack,
    depth: Depth::Range,
    scale: 1.0,
    frame_input: 0,
    has_position: false,
    output_scale: 1.5,
};
const EPSILON: f32 = 1.0 / 255.0;

/// Weight of the yaw output at value `i` of the policy's frame: of either sign, none of them 0.
fn weight(i: usize) -> f32 {
    ((i * 29 % 17) as f32 - 8.5) / 40.0
}

/// The yaw is a weighted sum of the frame's values.
fn linear(inputs: PolicyInputs, curve: Activation) -> FrozenPilot {
    let len = inputs.rows * inputs.cols * inputs.channels;
    let layer = Dense::new(len, 2);
    let mut params = vec![0.0; 2 * len + 2];
    for i in 0..len {
        params[2 * i + 1] = weight(i);
    }
    FrozenPilot::Imported(FrozenPolicy {
        network: Network {
            layers: vec![Layer::Input { len }, Layer::Dense { x: 0, layer, curve }],
            output: 1,
        },
        params,
        inputs,
        split: None,
        source: "a test".to_owned(),
    })
}

fn config(method: Method) -> AttackConfig {
    AttackConfig {
        method,
        towards: Towards::Right,
        iterations: 1,
        epsilon_255: 1.0,
        seed: 5,
        ..AttackConfig::PAPER
    }
}

fn frame(level: f32) -> Vec<f32> {
    (0..DEPTH_PIXELS)
        .map(|i| level + (i % DEPTH_COLS) as f32 / 4000.0)
        .collect()
}

const GOAL: GoalRelative = GoalRelative::new(10.0, 0.1);

/// A frame's pixels as they were handed over.
fn taken_of(depth: &[f32]) -> Box<DepthFrame> {
    let mut frame = Box::new(DepthFrame::EMPTY);
    frame.depth.copy_from_slice(depth);
    frame
}

fn input(depth: &DepthFrame) -> PilotInput<'_> {
    PilotInput {
        height_m: 1.5,
        ..PilotInput::at_rest(depth, GOAL)
    }
}

fn pass(attack: &mut FrameAttack, depth: &[f32]) {
    attack.pass(&input(&taken_of(depth))).unwrap();
}

fn alter(attack: &mut FrameAttack, depth: &mut [f32], go_on: impl FnMut() -> bool) -> AttackOutcome {
    let (taken, mut delivered) = (taken_of(depth), Box::new(DepthFrame::EMPTY));
    let outcome = attack.attack_while(&input(&taken), &mut delivered, go_on).unwrap();
    depth.copy_from_slice(&delivered.depth);
    outcome
}

fn pilot(frozen: &FrozenPilot) -> ImportedPilot {
    let FrozenPilot::Imported(policy) = frozen else {
        unreachable!()
    };
    policy.pilot(Isa::detect()).unwrap()
}

fn yaw(pilot: &mut ImportedPilot, frame: &[f32]) -> f32 {
    pilot.decide_on(frame, LowDim::of_goal(GOAL)).yaw
}

#[test]
fn a_linear_policy_is_moved_as_far_as_epsilon_allows_by_the_pixels_that_it_samples() {
    for depth in [Depth::Range, Depth::Contrast] {
        let inputs = PolicyInputs { depth, ..INPUTS };
        let frozen = linear(inputs, Activation::Identity);
        let mut attack = FrameAttack::on(&frozen, Isa::detect(), &config(Method::Fgsm)).unwrap();
        // Two frames are behind it, so that the third is one channel of three.
        for level in [0.2, 0.3] {
            pass(&mut attack, &frame(level));
        }
        let taken = frame(0.4);
        let mut altered = taken.clone();
        alter(&mut attack, &mut altered, || true);
        let places: Vec<usize> = inputs.places().map(|place| place as usize).collect();
        assert_eq!(places.len(), 32);
        for (i, (a, b)) in altered.iter().zip(&taken).enumerate() {
            let expected = match places.iter().position(|place| *place == i) {
                None => *b,
                // A nearer surface is a brighter pixel.
                Some(own) => {
                    let sign = weight(own * 3 + 2).signum();
                    b + EPSILON * if depth == Depth::Range { sign } else { -sign }
                }
            };
            assert!((a - expected).abs() < 1e-6, "pixel {i}: {a} instead of {expected}");
        }
    }
}

#[test]
fn what_the_attack_says_of_a_decision_is_what_the_pilot_decides_on_what_was_delivered() {
    for order in [Channels::Stack, Channels::Repeat] {
        let frozen = linear(PolicyInputs { order, ..INPUTS }, Activation::Tanh { scale: 0.9 });
        let mut attack = FrameAttack::on(&frozen, Isa::detect(), &config(Method::BimClipped)).unwrap();
        let (mut misled, mut undisturbed) = (pilot(&frozen), pilot(&frozen));
        for step in 0..12 {
            let taken = frame(0.05 * step as f32);
            let mut delivered = taken.clone();
            let clean = yaw(&mut undisturbed, &taken);
            if step % 4 < 2 {
                pass(&mut attack, &delivered);
                // A burst is over: what was altered before stays in the stack.
                let seen = yaw(&mut misled, &delivered);
                assert!(order == Channels::Stack || seen == clean);
                continue;
            }
            let outcome = alter(&mut attack, &mut delivered, || true);
            assert_eq!(outcome.attacked[1], yaw(&mut misled, &delivered), "step {step}");
            if step < 4 {
                assert_eq!(outcome.clean[1], clean, "step {step}");
            }
            assert!(outcome.attacked[1] > outcome.clean[1], "step {step}");
        }
    }
}

#[test]
fn a_policy_at_its_limit_is_moved_away_from_it_though_its_own_slope_is_zero() {
    let steep = PolicyInputs {
        output_scale: 1000.0,
        ..INPUTS
    };
    let frozen = linear(steep, Activation::Tanh { scale: 1.5 });
    let taken = frame(0.4);
    let clean = yaw(&mut pilot(&frozen), &taken);
    assert_eq!(clean.abs(), ACTOR_LIMIT);
    let towards = if clean > 0.0 { Towards::Left } else { Towards::Right };
    let strong = AttackConfig {
        towards,
        iterations: 255,
        ..config(Method::BimAccumulating)
    };
    let mut attack = FrameAttack::on(&frozen, Isa::detect(), &strong).unwrap();
    let outcome = alter(&mut attack, &mut taken.clone(), || true);
    assert_eq!(outcome.clean[1], clean);
    assert_eq!(outcome.attacked[1], -clean);
}

#[test]
fn time_runs_out_after_the_iteration_that_it_runs_out_in_and_a_reset_forgets() {
    let frozen = linear(INPUTS, Activation::Identity);
    let many = AttackConfig {
        iterations: 20,
        ..config(Method::BimAccumulating)
    };
    let mut attack = FrameAttack::on(&frozen, Isa::detect(), &many).unwrap();
    let moved = |attack: &mut FrameAttack, count: u32| {
        let (mut altered, mut done) = (frame(0.4), 0);
        alter(attack, &mut altered, || {
            done += 1;
            done < count
        });
        attack.reset();
        let changes = altered.iter().zip(frame(0.4)).map(|(a, b)| (a - b).abs());
        changes.fold(0.0f32, f32::max)
    };
    assert!((moved(&mut attack, 3) - 3.0 * EPSILON).abs() < 1e-6);
    assert!((moved(&mut attack, 20) - 20.0 * EPSILON).abs() < 1e-5);
}
