//! The frozen actor's file, the pilot made of it, and the actor in flight against the graph of the whole.

#[path = "../../nnet/tests/common/mod.rs"]
mod plain;
#[path = "common/mod.rs"]
mod scene;

use plain::{Evaluated, distance, rng, uniform, wide};
use scene::{Scene, block, column, walk};
use vigil_nnet::{ISA_MULTIPLIER_TOLERANCE, ISA_TOLERANCE, Isa, Purpose};
use vigil_policy::actor::{ACTOR_LIMIT, Actor, ActorSpec, CONTEXT, LOW_DIM};
use vigil_policy::{Decider, FrozenActor, LearnedPilot, Pilot, PilotInput, RecoveryPilot, apf};
use vigil_types::{Ablation, Attitude, DepthFrame, GoalRelative, HeadingVector};

fn frozen() -> FrozenActor {
    let len = ActorSpec::FULL.head_graph(Purpose::Gradients).unwrap().param_len();
    FrozenActor {
        // Some weights of either sign, small enough not to saturate.
        params: uniform(&mut rng(3), len, 0.08),
        training_config: "seed = 3\n".to_owned(),
        seed: 3,
        updates: 1000,
        cruise_m_s: ACTOR_LIMIT,
        git_commit: Some("abc".to_owned()),
    }
}

/// The same with something else where that stands first.
fn replaced(bytes: &[u8], old: &[u8], new: &[u8]) -> Vec<u8> {
    let at = bytes.windows(old.len()).position(|w| w == old).unwrap();
    [&bytes[..at], new, &bytes[at + old.len()..]].concat()
}

/// The content of this file is refused by its name for this reason.
fn refused(file: &str, bytes: &[u8], why: &str) {
    let error = FrozenActor::from_bytes(file, bytes).unwrap_err().to_string();
    assert!(error.contains(file) && error.contains(why), "{error}");
}

#[test]
fn an_actor_survives_its_file() {
    let actor = FrozenActor {
        training_config: "seed = 3\nname = \"a\\b\t\u{1}\u{7f}ü\"\n".to_owned(),
        ..frozen()
    };
    let bytes = actor.to_bytes().unwrap();
    assert!(bytes.len() < 2_000_000);
    assert!(actor.to_bytes().unwrap() == bytes, "the same network is the same file");
    assert_eq!(FrozenActor::from_bytes("a", &bytes).unwrap(), actor);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("actor.safetensors");
    actor.save(&path).unwrap();
    assert_eq!(FrozenActor::load(&path).unwrap(), actor);
    let missing = FrozenActor::load(&folder.path().join("none.safetensors")).unwrap_err();
    assert!(missing.to_string().contains("none.safetensors"), "{missing}");
}

#[test]
fn an_actor_trained_to_be_twice_as_fast_flies_twice_as_fast_with_its_field_and_from_its_file() {
    let fast = FrozenActor {
        cruise_m_s: 2.0 * ACTOR_LIMIT,
        ..frozen()
    };
    let read = FrozenActor::from_bytes("fast", &fast.to_bytes().unwrap()).unwrap();
    assert_eq!(read, fast);
    assert_ne!(fast.sha256(), frozen().sha256());
    let frame = DepthFrame::EMPTY;
    for field in [false, true] {
        let pilot = |actor: &FrozenActor| LearnedPilot::new(Decider::Actor(actor.actor(Isa::detect()).unwrap()), field);
        let (mut slow, mut quick) = (pilot(&frozen()), pilot(&read));
        // Of its last action the actor knows in units, so that both decide alike from step to step.
        for _ in 0..3 {
            let (own, twice) = (slow.decide(&input(&frame)), quick.decide(&input(&frame)));
            assert!(own.forward_m_s != 0.0, "{own:?}");
            assert_eq!(twice, own.scaled(2.0), "field {field}");
        }
    }
    let too_fast = FrozenActor {
        cruise_m_s: 5.0,
        ..frozen()
    };
    refused("a", &too_fast.to_bytes().unwrap(), "5 m/s; allowed: 0.5 to 3");
}

#[test]
fn an_actor_of_0_2_0_is_refused_with_the_version_that_flies_it() {
    let old = replaced(&frozen().to_bytes().unwrap(), b"vigil actor 2", b"vigil actor 1");
    refused("old.safetensors", &old, "0.2.0");
}

#[test]
fn wrong_truncated_and_altered_files_are_refused_by_name() {
    let refused = |bytes: &[u8], why: &str| refused("some/actor.safetensors", bytes, why);
    let good = frozen().to_bytes().unwrap();
    refused(&[], "truncated");
    refused(b"not an actor at all, but long enough to hold a header", "truncated");
    refused(&good[..good.len() - 1], "truncated");
    refused(&good[..good.len() / 2], "truncated");
    let mut altered = good.clone();
    let last = altered.len() - 2;
    altered[last] ^= 1;
    refused(&altered, "altered");
    // One character of the metadata, length kept.
    refused(&replaced(&good, b"seed = 3", b"seed = 4"), "altered");
    refused(&replaced(&good, b"conv 5x5/2", b"conv 7x5/2"), "this program takes");
    let mut broken = frozen();
    broken.params[7] = f32::NAN;
    assert!(broken.to_bytes().unwrap_err().to_string().contains("not finite"));
    // Another program may have written it all the same, with a digest that is right.
    let bytes_of = |params: &[f32]| -> Vec<u8> { params.iter().flat_map(|p| p.to_le_bytes()).collect() };
    let sealed = replaced(&good, &bytes_of(&frozen().params[..9]), &bytes_of(&broken.params[..9]));
    let sealed = replaced(&sealed, frozen().sha256().as_bytes(), broken.sha256().as_bytes());
    refused(&sealed, "not finite");
    let mut short = frozen();
    short.params.pop();
    assert!(short.to_bytes().is_err());
}

fn input(frame: &DepthFrame) -> PilotInput<'_> {
    PilotInput {
        height_m: 1.5,
        ..PilotInput::at_rest(frame, GoalRelative::new(12.0, 0.4))
    }
}

#[test]
fn the_field_is_added_to_the_actor_s_action() {
    let pilot = |field| LearnedPilot::new(Decider::Actor(actor(Isa::detect())), field);
    let (mut with, mut without) = (pilot(true), pilot(false));
    // A surface on the right half of the picture, another 10 m away on the left.
    let mut decide = |right: f32| {
        let mut frame = DepthFrame::EMPTY;
        for (i, d) in frame.depth.iter_mut().enumerate() {
            *d = if i % 256 > 140 { right } else { 0.10 };
        }
        let input = input(&frame);
        without.reset();
        with.reset();
        (without.decide(&input), with.decide(&input), apf::attraction(input.goal))
    };
    let (own, sum, pull) = decide(0.10);
    assert_eq!(sum, apf::add(own, pull), "nothing near: the goal pulls");
    let (own, sum, _) = decide(0.02);
    assert_eq!(sum, own, "a surface 2 m ahead: the actor passes it alone");
    let (own, sum, _) = decide(0.005);
    assert_eq!(sum.forward_m_s, own.forward_m_s);
    assert!(sum.yaw < own.yaw - 0.5, "0.5 m: turned away: {sum:?} {own:?}");
    // What is flown is its last action: another one, another decision.
    let frame = DepthFrame::EMPTY;
    let (seen, pull) = (input(&frame), apf::attraction(input(&frame).goal));
    for pilot in [&mut with, &mut without] {
        pilot.reset();
        pilot.decide(&seen);
    }
    assert_ne!(with.decide(&seen), apf::add(without.decide(&seen), pull));
}

#[test]
fn the_recovery_pilot_leads_along_its_path_and_over_open_ground_to_the_goal() {
    // A wall across the way, 4 m ahead, open on the right only.
    let mut frame = DepthFrame::EMPTY;
    frame.header.attitude = Attitude::LEVEL_NORTH;
    for (i, depth) in frame.depth.iter_mut().enumerate() {
        *depth = if i % 256 < 190 { 0.04 } else { 1.0 };
    }
    let goal = GoalRelative::new(9.0, -0.1);
    let mut planner = Box::<RecoveryPilot>::default();
    let mut local = goal;
    for sequence in 0..20 {
        frame.header.sequence = sequence;
        let seen = PilotInput { goal, ..input(&frame) };
        planner.observe(&seen, true);
        local = planner.path_ahead(&seen);
    }
    assert_eq!(local.distance_m, goal.distance_m);
    assert!(local.bearing_rad > 0.3, "to the right, around the wall: {local:?}");
    // Another flight: what was seen is forgotten, and an open field leads straight to the goal.
    planner.reset();
    let open = DepthFrame::EMPTY;
    let input = PilotInput { goal, ..input(&open) };
    planner.observe(&input, true);
    let local = planner.path_ahead(&input);
    assert!((local.bearing_rad + 0.1).abs() < 1e-3, "{local:?}");
}

fn actor(isa: Isa) -> Actor {
    frozen().actor(isa).unwrap()
}

/// In the midst of the flight.
fn in_flight(frame: &DepthFrame) -> PilotInput<'_> {
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
    let (params, graph) = (frozen().params, ActorSpec::FULL.graph(Purpose::Gradients).unwrap());
    for isa in Isa::available() {
        let (mut actor, whole) = (actor(isa), Evaluated::new(graph.clone(), isa, &params));
        let mut twin = actor.clone();
        for (step, frame) in frames().iter().enumerate() {
            let action = actor.decide(&in_flight(frame)).unwrap();
            let given = [&frame.depth[..], actor.context(), &actor.low_dim()].map(<[f32]>::to_vec);
            let output = whole.output(&whole.tape(&given));
            assert_eq!(action[..], output, "step {step} on {}", isa.name());
            assert_eq!(twin.decide(&in_flight(frame)).unwrap(), action);
        }
        assert!(actor.context().iter().any(|x| *x > 0.0), "it remembers");
        // After a reset the past is gone.
        actor.reset();
        let frame = &frames()[3];
        assert_eq!(
            actor.decide(&in_flight(frame)),
            self::actor(isa).decide(&in_flight(frame))
        );
    }
    assert!(Actor::new(ActorSpec::FULL, Isa::detect(), &params[1..]).is_err());
}

#[test]
fn a_pixel_that_is_not_a_number_is_not_hidden_and_is_not_remembered() {
    for isa in Isa::available() {
        let (mut actor, mut frames) = (actor(isa), frames());
        actor.decide(&in_flight(&frames[0])).unwrap();
        frames[1].depth[777] = f32::NAN;
        let blind = actor.decide(&in_flight(&frames[1])).unwrap();
        assert!(blind[0].is_nan(), "{}", isa.name());
        let after = actor.decide(&in_flight(&frames[2])).unwrap();
        assert!(after.iter().all(|x| x.is_finite()), "{}", isa.name());
    }
}

#[test]
fn instruction_sets_agree() {
    let params = frozen().params;
    let graph = ActorSpec::FULL.graph(Purpose::Multipliers).unwrap();
    let input = |seed: u64| -> [Vec<f32>; 3] {
        let mut rng = rng(seed);
        [ActorSpec::FULL.frame_len(), CONTEXT, LOW_DIM]
            .map(|len| uniform(&mut rng, len, 0.5).iter().map(|x| x + 0.5).collect())
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
            let seen = in_flight(frame);
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
        actor.decide(&in_flight(frame)).unwrap();
    }
    actor.pause();
    // Ten frames are missing.
    let after = in_flight(&frames[29]);
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
        actor.decide(&in_flight(frame)).unwrap();
    }
    twin.remember_as(&actor);
    for (step, frame) in frames.iter().enumerate().skip(20) {
        let seen = in_flight(frame);
        assert_eq!(twin.decide(&seen), actor.decide(&seen), "step {step}");
        assert_eq!(twin.context(), actor.context());
    }
}
