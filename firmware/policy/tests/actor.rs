//! The frozen actor's file and the pilot made of it.

use vigil_nnet::{Isa, Purpose};
use vigil_policy::actor::{Actor, ActorSpec, PositionalInputs};
use vigil_policy::{
    ActorInputs, ActorPilot, FlightPilot, FrozenActor, GeometricConfig, GeometricPilot, LedBy, Pilot, PilotInput,
    RecoveryPilot, apf,
};
use vigil_types::{Action, Attitude, DepthFrame, GoalRelative, HeadingVector};

fn frozen() -> FrozenActor {
    let len = ActorSpec::FULL
        .graph(vigil_nnet::Purpose::Gradients, false)
        .unwrap()
        .param_len();
    // Some numbers of either sign, small enough not to saturate.
    let params = (0..len).map(|i| 0.05 * libm::sinf(i as f32 * 1.7)).collect();
    FrozenActor {
        inputs: ActorInputs::default(),
        params,
        training_config: "seed = 3\n".to_owned(),
        seed: 3,
        updates: 1000,
        git_commit: Some("abc".to_owned()),
    }
}

#[test]
fn an_actor_survives_its_file() {
    let actor = frozen();
    let bytes = actor.to_bytes().unwrap();
    assert!(bytes.len() < 2_000_000);
    assert_eq!(FrozenActor::from_bytes("a", &bytes).unwrap(), actor);
    let folder = std::env::temp_dir().join(format!("vigil-actor-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("actor.safetensors");
    actor.save(&path).unwrap();
    assert_eq!(FrozenActor::load(&path).unwrap(), actor);
    let spread = FrozenActor {
        inputs: ActorInputs {
            frame_ages: vigil_policy::actor::FRAMES_SPREAD,
            led_by: LedBy::Path,
            told_of_movers: false,
        },
        ..actor.clone()
    };
    assert_ne!(spread.sha256(), actor.sha256());
    assert_eq!(
        FrozenActor::from_bytes("spread", &spread.to_bytes().unwrap()).unwrap(),
        spread
    );
    assert_eq!(
        spread.actor(Isa::detect()).unwrap().frame_ages(),
        vigil_policy::actor::FRAMES_SPREAD
    );
    let elsewhere = |bytes: Vec<u8>| {
        let at = bytes.windows(6).position(|w| w == b"led_by").unwrap() + 9;
        assert_eq!(&bytes[at..at + 4], b"path");
        [&bytes[..at], b"moon", &bytes[at + 4..]].concat()
    };
    assert!(FrozenActor::from_bytes("a", &elsewhere(spread.to_bytes().unwrap())).is_err());
    let missing = FrozenActor::load(&folder.join("none.safetensors")).unwrap_err();
    assert!(missing.to_string().contains("none.safetensors"), "{missing}");
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn an_actor_that_is_told_of_movers_is_one_of_another_architecture() {
    let len = ActorSpec::FULL_WITH_MOVERS
        .graph(Purpose::Gradients, false)
        .unwrap()
        .param_len();
    let told = FrozenActor {
        params: (0..len).map(|i| ((i * 37 % 101) as f32 - 50.0) / 2000.0).collect(),
        inputs: ActorInputs {
            told_of_movers: true,
            ..ActorInputs::default()
        },
        ..frozen()
    };
    let bytes = told.to_bytes().unwrap();
    assert_eq!(FrozenActor::from_bytes("told", &bytes).unwrap(), told);
    // Its parameters are not those of an actor that is told of the goal alone, nor the other way round.
    let goal_alone = FrozenActor {
        inputs: ActorInputs::default(),
        ..told.clone()
    };
    assert!(goal_alone.to_bytes().is_err());
    let mut other = bytes;
    let at = other.windows(5).position(|w| w == b"16-24").unwrap();
    other[at..at + 5].copy_from_slice(b"16-25");
    let error = FrozenActor::from_bytes("other.safetensors", &other)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("other.safetensors") && error.contains("16-25"),
        "{error}"
    );
    // It refuses what it was not made for, by name, and does not fly.
    let goal = PositionalInputs::of_goal(input(&DepthFrame::EMPTY).goal);
    let mut actor = told.actor(Isa::detect()).unwrap();
    assert!(actor.decide(&DepthFrame::EMPTY.depth, goal).is_err());
}

#[test]
fn wrong_truncated_and_altered_files_are_refused_by_name() {
    let refused = |bytes: &[u8], why: &str| {
        let error = FrozenActor::from_bytes("some/actor.safetensors", bytes)
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("some/actor.safetensors") && error.contains(why),
            "{error}"
        );
    };
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
    let text = String::from_utf8_lossy(&good).into_owned();
    let at = text.find("seed = 3").unwrap() + 7;
    let mut altered = good.clone();
    altered[at] = b'4';
    refused(&altered, "altered");
    let at = text.find("conv 5x5/2 16").unwrap() + 5;
    let mut altered = good.clone();
    altered[at] = b'7';
    refused(&altered, "this program takes");
    let mut broken = frozen();
    broken.params[7] = f32::NAN;
    assert!(broken.to_bytes().unwrap_err().to_string().contains("not finite"));
    // Another program may have written it all the same, with a digest that is right.
    let bytes_of = |params: &[f32]| -> Vec<u8> { params.iter().flat_map(|p| p.to_le_bytes()).collect() };
    let replaced = |bytes: &[u8], old: &[u8], new: &[u8]| {
        let at = bytes.windows(old.len()).position(|w| w == old).unwrap();
        [&bytes[..at], new, &bytes[at + old.len()..]].concat()
    };
    let sealed = replaced(&good, &bytes_of(&frozen().params[..9]), &bytes_of(&broken.params[..9]));
    let sealed = replaced(&sealed, frozen().sha256().as_bytes(), broken.sha256().as_bytes());
    refused(&sealed, "not finite");
    let mut short = frozen();
    short.params.pop();
    assert!(short.to_bytes().is_err());
}

fn input(frame: &DepthFrame) -> PilotInput<'_> {
    PilotInput {
        now_ns: 0,
        depth: frame,
        goal: GoalRelative {
            distance_m: 12.0,
            bearing_rad: 0.4,
        },
        attitude: Attitude::LEVEL_NORTH,
        velocity_m_s: HeadingVector::ZERO,
        height_m: 1.5,
    }
}

#[test]
fn the_pilot_flies_what_the_whole_network_says_of_the_last_five_frames() {
    let actor = frozen();
    let spec = ActorSpec::FULL;
    let isa = Isa::detect();
    let mut pilot = ActorPilot::new(Actor::new(spec, isa, &actor.params).unwrap(), false);
    let frames: Vec<DepthFrame> = (0..7)
        .map(|k| {
            let mut frame = DepthFrame::EMPTY;
            for (i, d) in frame.depth.iter_mut().enumerate() {
                *d = 0.02 + 0.01 * (k as f32) + 0.1 * ((i / 512 + 3 * k) % 7) as f32;
            }
            frame
        })
        .collect();
    let mut last = Action::HOVER;
    for frame in &frames {
        last = pilot.decide(&input(frame));
    }
    let graph = spec.graph(vigil_nnet::Purpose::Gradients, false).unwrap();
    let mut tape = vec![0.0; graph.tape_len()];
    let position = PositionalInputs::of_goal(input(&frames[0]).goal);
    let mut inputs: Vec<&[f32]> = frames[2..].iter().map(|f| f.depth.as_slice()).collect();
    inputs.push(&position);
    graph.forward(isa, &actor.params, &inputs, &mut tape).unwrap();
    let whole = graph.output(&tape).unwrap();
    assert!(
        (last.forward_m_s - whole[0]).abs() < 1e-5 && (last.yaw - whole[1]).abs() < 1e-5,
        "{last:?} {whole:?}"
    );

    // After a reset the past is gone: the same frame gives the same decision as to a new pilot.
    pilot.reset();
    let mut fresh = ActorPilot::new(Actor::new(spec, isa, &actor.params).unwrap(), false);
    assert_eq!(pilot.decide(&input(&frames[3])), fresh.decide(&input(&frames[3])));
}

#[test]
fn the_field_is_added_to_the_actor_s_action() {
    let actor = Actor::new(ActorSpec::FULL, Isa::detect(), &frozen().params).unwrap();
    let (mut with, mut without) = (ActorPilot::new(actor.clone(), true), ActorPilot::new(actor, false));
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
}

#[test]
fn a_flight_s_pilot_is_the_one_it_was_made_of() {
    let actor = Actor::new(ActorSpec::FULL, Isa::detect(), &frozen().params).unwrap();
    let frame = DepthFrame::EMPTY;
    let mut alone = ActorPilot::new(actor.clone(), true);
    let mut flown = FlightPilot::Actor(ActorPilot::new(actor, true));
    assert_eq!(flown.decide(&input(&frame)), alone.decide(&input(&frame)));
    assert_eq!(flown.surroundings().scan(), alone.surroundings().scan());
    let geometric = GeometricPilot::new(GeometricConfig::default());
    let mut alone = geometric.clone();
    let mut flown = FlightPilot::Geometric(geometric);
    assert_eq!(flown.decide(&input(&frame)), alone.decide(&input(&frame)));
    flown.reset();
    alone.reset();
    assert_eq!(flown.decide(&input(&frame)), alone.decide(&input(&frame)));
}

/// A wall across the way, 4 m ahead, open on the right only.
fn wall_open_on_the_right() -> DepthFrame {
    let mut frame = DepthFrame::EMPTY;
    frame.header.attitude = Attitude::LEVEL_NORTH;
    for (i, depth) in frame.depth.iter_mut().enumerate() {
        *depth = if i % 256 < 190 { 0.04 } else { 1.0 };
    }
    frame
}

#[test]
fn the_recovery_pilot_leads_along_its_path_and_over_open_ground_to_the_goal() {
    let actor = Actor::new(ActorSpec::FULL, Isa::detect(), &frozen().params).unwrap();
    let frame = wall_open_on_the_right();
    let ahead = PilotInput {
        goal: GoalRelative {
            distance_m: 9.0,
            bearing_rad: -0.1,
        },
        ..input(&frame)
    };
    let mut pilot = ActorPilot::new(actor, false);
    let mut planner = Box::<RecoveryPilot>::default();
    let mut newest = frame.clone();
    let mut led = ahead.goal;
    for sequence in 0..20 {
        newest.header.sequence = sequence;
        let seen = PilotInput {
            depth: &newest,
            ..ahead
        };
        planner.observe(&seen, true);
        led = planner.lead(&seen);
    }
    assert_eq!(led.distance_m, ahead.goal.distance_m);
    assert!(led.bearing_rad > 0.3, "to the right, around the wall: {led:?}");
    // The actor is told that bearing instead of the goal's.
    pilot.decide(&PilotInput { goal: led, ..ahead });
    assert_eq!(pilot.position(), Some(PositionalInputs::of_goal(led)));

    // Another flight: what was seen is forgotten, and an open field leads straight to the goal.
    planner.reset();
    let open = DepthFrame::EMPTY;
    let input = PilotInput { depth: &open, ..ahead };
    planner.observe(&input, true);
    let led = planner.lead(&input);
    assert!((led.bearing_rad + 0.1).abs() < 1e-3, "{led:?}");
}
