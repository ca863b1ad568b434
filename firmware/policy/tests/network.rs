//! The actor in flight against the graph of the whole.

#[path = "../../nnet/tests/common/mod.rs"]
mod plain;
#[path = "common/mod.rs"]
mod scene;

use plain::{Evaluated, distance, rng, uniform, wide};
use scene::{Scene, block, column, walk};
use vigil_nnet::{ISA_MULTIPLIER_TOLERANCE, ISA_TOLERANCE, Isa, Purpose};
use vigil_policy::PilotInput;
use vigil_policy::actor::{Actor, ActorSpec, CONTEXT, LOW_DIM};
use vigil_types::{Ablation, DepthFrame, GoalRelative, HeadingVector};

const FRAME: usize = 128 * 256;

/// Some weights of either sign, small enough not to saturate.
fn params() -> Vec<f32> {
    let len = ActorSpec::FULL.head_graph(Purpose::Gradients).unwrap().param_len();
    uniform(&mut rng(3), len, 0.08)
}

fn actor(isa: Isa) -> Actor {
    Actor::new(ActorSpec::FULL, isa, &params()).unwrap()
}

fn input(frame: &DepthFrame) -> PilotInput<'_> {
    PilotInput {
        goal: GoalRelative::new(12.0 - 0.1 * frame.header.sequence as f32, 0.4),
        velocity_m_s: HeadingVector::new(1.0, 0.1, 0.0),
        ..scene::input(frame, frame.header.attitude)
    }
}

/// A flight past a wall and two columns.
fn frames() -> Vec<DepthFrame> {
    let scene = Scene::new(vec![
        block([6.0, 6.3], [-3.0, 1.0]),
        column(3.5, 1.5, 0.15),
        column(9.0, -4.0, 0.3),
    ]);
    walk(&scene, 30)
}

#[test]
fn the_actor_in_flight_decides_as_the_graph_of_the_whole() {
    let (params, graph) = (params(), ActorSpec::FULL.graph(Purpose::Gradients).unwrap());
    for isa in Isa::available() {
        let (mut actor, whole) = (actor(isa), Evaluated::new(graph.clone(), isa, &params));
        let mut twin = actor.clone();
        for (step, frame) in frames().iter().enumerate() {
            let action = actor.decide(&input(frame)).unwrap();
            let given = [&frame.depth[..], actor.context(), &actor.low_dim()].map(<[f32]>::to_vec);
            let output = whole.output(&whole.tape(&given));
            assert_eq!(action[..], output, "step {step} on {}", isa.name());
            assert_eq!(twin.decide(&input(frame)).unwrap(), action);
        }
        assert!(actor.context().iter().any(|x| *x > 0.0), "it remembers");
        // After a reset the past is gone.
        actor.reset();
        let frame = &frames()[3];
        assert_eq!(actor.decide(&input(frame)), self::actor(isa).decide(&input(frame)));
    }
    assert!(Actor::new(ActorSpec::FULL, Isa::detect(), &params[1..]).is_err());
}

#[test]
fn a_pixel_that_is_not_a_number_is_not_hidden_and_is_not_remembered() {
    for isa in Isa::available() {
        let (mut actor, mut frames) = (actor(isa), frames());
        actor.decide(&input(&frames[0])).unwrap();
        frames[1].depth[777] = f32::NAN;
        let blind = actor.decide(&input(&frames[1])).unwrap();
        assert!(blind[0].is_nan(), "{}", isa.name());
        let after = actor.decide(&input(&frames[2])).unwrap();
        assert!(after.iter().all(|x| x.is_finite()), "{}", isa.name());
    }
}

#[test]
fn instruction_sets_agree() {
    let params = params();
    let graph = ActorSpec::FULL.graph(Purpose::Multipliers).unwrap();
    let input = |seed: u64| -> [Vec<f32>; 3] {
        let mut rng = rng(seed);
        [FRAME, CONTEXT, LOW_DIM].map(|len| uniform(&mut rng, len, 0.5).iter().map(|x| x + 0.5).collect())
    };
    let results: Vec<(Isa, [Vec<f32>; 4])> = Isa::available()
        .map(|isa| {
            let actor = Evaluated::new(graph.clone(), isa, &params);
            let [tape, reference] = [1, 2].map(|seed| actor.tape(&input(seed)));
            let (mut gradients, d_params) = actor.gradients(&tape, &[1.0, -0.5], 0.0);
            let mut multipliers = actor.multipliers(&tape, &reference, &[1.0, -0.5]);
            // Between the nodes' values nothing is written.
            let tape = tape.into_iter().filter(|x| !x.is_nan()).collect();
            (isa, [tape, d_params, gradients.remove(0), multipliers.remove(0)])
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
fn what_is_taken_from_an_actor_it_does_not_use() {
    let frames = frames();
    let fly = |what: Ablation, frames: &[DepthFrame], bearing_rad: f32| {
        let mut actor = actor(Isa::detect()).without(what);
        let mut last = [0.0; 2];
        for frame in frames {
            let seen = input(frame);
            let goal = GoalRelative {
                bearing_rad,
                ..seen.goal
            };
            last = actor.decide(&PilotInput { goal, ..seen }).unwrap();
        }
        last
    };
    let empty: Vec<DepthFrame> = frames
        .iter()
        .map(|frame| DepthFrame {
            header: frame.header,
            ..DepthFrame::EMPTY
        })
        .collect();
    let whole = fly(Ablation::Nothing, &frames, 0.4);
    // Blind it decides the same whatever is there; as it is it does not.
    assert_eq!(fly(Ablation::Frames, &frames, 0.4), fly(Ablation::Frames, &empty, 0.4));
    assert_ne!(whole, fly(Ablation::Nothing, &empty, 0.4));
    assert_eq!(fly(Ablation::Goal, &frames, 0.4), fly(Ablation::Goal, &frames, -0.4));
    assert_ne!(whole, fly(Ablation::Nothing, &frames, -0.4));
    for what in [Ablation::Memory, Ablation::Motion] {
        assert_ne!(whole, fly(what, &frames, 0.4), "{what:?}");
    }
}

#[test]
fn after_a_gap_in_flight_what_is_remembered_of_places_is_still_there_and_nothing_of_its_own_motion() {
    let (mut actor, mut fresh) = (actor(Isa::detect()), actor(Isa::detect()));
    let frames = frames();
    for frame in &frames[..20] {
        actor.decide(&input(frame)).unwrap();
    }
    actor.pause();
    // Ten frames are missing.
    let after = input(&frames[29]);
    actor.decide(&after).unwrap();
    fresh.decide(&after).unwrap();
    assert_eq!(actor.low_dim(), fresh.low_dim(), "no yaw rate and no last action");
    assert_ne!(actor.context(), fresh.context(), "older scans and surfaces");
    assert_eq!(actor.forgotten(), 0);
}

#[test]
fn an_actor_that_remembers_as_another_decides_as_it_does() {
    let mut actor = actor(Isa::detect());
    let mut twin = actor.clone();
    let frames = frames();
    for frame in &frames[..20] {
        actor.decide(&input(frame)).unwrap();
    }
    twin.remember_as(&actor);
    for (step, frame) in frames.iter().enumerate().skip(20) {
        let seen = input(frame);
        assert_eq!(twin.decide(&seen), actor.decide(&seen), "step {step}");
        assert_eq!(twin.context(), actor.context());
    }
}
