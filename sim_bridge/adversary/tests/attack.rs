//! The attacks against independent oracles: float64 differences, the actor itself, the bounds, and chance.

#[path = "../../../firmware/nnet/tests/common/mod.rs"]
mod oracle;

use oracle::{Evaluated, activation, conv2d, dense, layer_norm, rng, uniform, wide};
use vigil_adversary::{
    AttackConfig, AttackError, Beside, Method, REPLAYED_FRAMES, SWELL_FRAMES, StateAttack, StreamAttack, Towards,
};
use vigil_detector::{FrozenDetector, LstmAd, ROW, WINDOW, normalise};
use vigil_nnet::{Activation, Dense, GraphBuilder, Isa, Purpose};
use vigil_policy::actor::memory::SCAN_AGES;
use vigil_policy::actor::{ACTOR_HIDDEN, ACTOR_LIMIT, Actor, ActorSpec, CONTEXT, LOW_DIM, LowDim};
use vigil_policy::{ExplainedHead, FrozenActor, PilotInput};
use vigil_types::{
    Attitude, DEPTH_COLS, DEPTH_PIXELS, DEPTH_ROWS, DepthFrame, GoalRelative, HeadingVector, NedVector, STEP_NS,
    column_bearing_rad, row_elevation_rad,
};

const SPEC: ActorSpec = ActorSpec::FULL;

/// The built-in encoder, and random weights behind it.
fn random_actor(seed: u64) -> FrozenActor {
    let mut actor = FrozenActor::built_in().unwrap();
    let layout = SPEC.reserve(&mut GraphBuilder::new());
    let behind = SPEC.encoder_len();
    let random = uniform(&mut rng(seed), actor.params.len() - behind, 0.2);
    actor.params[behind..].copy_from_slice(&random);
    for (_, norm) in layout.trunk {
        actor.params[norm.at..norm.at + norm.len / 2].fill(1.0);
    }
    actor
}

/// A pillar between walls, uneven, with some ranges at the ends of 0 to 1.
fn frame(seed: u64) -> Vec<f32> {
    let uneven = uniform(&mut rng(seed), DEPTH_PIXELS, 0.01);
    let clean = scene(0.2 - 0.01 * (seed % 40) as f32, 3.0);
    let pixel = |(i, (x, by)): (usize, (&f32, &f32))| match i % 61 {
        0 => 0.0,
        1 => 1.0,
        _ => (x + by).clamp(0.0, 1.0),
    };
    clean.iter().zip(&uneven).enumerate().map(pixel).collect()
}

/// Something that is remembered and observed.
fn beside(seed: u64) -> Beside {
    let mut rng = rng(seed);
    let context = uniform(&mut rng, CONTEXT, 0.5);
    Beside {
        context: std::array::from_fn(|i| context[i] + 0.5),
        low_dim: LowDim::from_values(&uniform(&mut rng, LOW_DIM, 0.9)).unwrap(),
    }
}

/// What an actor holds that hovers before a frame.
fn hovering(actor: &FrozenActor, depth: &[f32], goal: GoalRelative) -> Beside {
    let mut flying = actor.actor(Isa::detect()).unwrap();
    for step in 0..=SCAN_AGES[0] as u64 {
        let seen = taken(depth, step, 0.0);
        let input = PilotInput {
            goal,
            velocity_m_s: HeadingVector::ZERO,
            ..input(&seen)
        };
        flying.decide(&input).unwrap();
        flying.note_action(vigil_types::Action::HOVER);
    }
    Beside::of(&flying)
}

/// A frame as the sensor hands it over, in a flight north at so many metres a step.
fn taken(depth: &[f32], step: u64, step_m: f32) -> DepthFrame {
    let mut frame = DepthFrame::EMPTY;
    frame.depth.copy_from_slice(depth);
    frame.header.stamp_ns = step * STEP_NS;
    frame.header.position_ned_m = NedVector::new(step_m * step as f32, 0.0, -1.5);
    frame.header.attitude = Attitude::LEVEL_NORTH;
    frame
}

/// What a pilot is given with a frame.
fn input(frame: &DepthFrame) -> PilotInput<'_> {
    let goal = GoalRelative::new(12.0 - frame.header.position_ned_m.x, 0.3);
    PilotInput {
        velocity_m_s: HeadingVector::new(1.0, 0.0, 0.0),
        ..PilotInput::at_rest(frame, goal)
    }
}

/// The paper's attack but for this.
fn paper(change: impl FnOnce(&mut AttackConfig)) -> AttackConfig {
    let mut config = AttackConfig::PAPER;
    change(&mut config);
    config
}

fn config(method: Method) -> AttackConfig {
    AttackConfig {
        method,
        iterations: 7,
        seed: 5,
        // Whole pixels apart are too many for so few queries.
        region_pixels: if method == Method::Spsa { 8 } else { 1 },
        ..AttackConfig::PAPER
    }
}

/// The actor's yaw before saturation, float64, written from its description.
fn yaw_before_saturation(params: &[f64], frame: &[f64], beside: &Beside) -> f64 {
    let layout = SPEC.reserve(&mut GraphBuilder::new());
    let at = |p: vigil_nnet::Params| &params[p.at..p.at + p.len];
    let mut x = activation(Activation::NEAR_CONTRAST, frame);
    for (layer, p) in SPEC.convolutions().into_iter().zip(layout.convolutions) {
        x = conv2d(layer, Activation::Elu, at(p), &x);
    }
    x = dense(SPEC.scan(), Activation::Sigmoid, at(layout.scan), &x);
    x.extend(wide(&beside.context));
    for (layer, (weights, norm)) in SPEC.trunk().into_iter().zip(layout.trunk) {
        x = dense(layer, Activation::Identity, at(weights), &x);
        let norm_of = ActorSpec::norm(layer);
        x = activation(Activation::Elu, &layer_norm(norm_of, at(norm), &x));
    }
    let of = |inputs, outputs| Dense { inputs, outputs };
    let state = dense(of(128, ACTOR_HIDDEN), Activation::Identity, at(layout.state), &x);
    let mut x = activation(Activation::TANH, &state);
    let low_dim = wide(&beside.low_dim);
    x.extend(dense(of(8, 24), Activation::TANH, at(layout.low), &low_dim));
    x = dense(of(72, 64), Activation::Elu, at(layout.head[0]), &x);
    x = dense(of(64, 32), Activation::Elu, at(layout.head[1]), &x);
    dense(of(32, 2), Activation::Identity, at(layout.output), &x)[1]
}

#[test]
fn the_gradient_is_the_float64_slope_of_the_yaw_before_its_saturation() {
    let (actor, frame, beside) = (random_actor(1), frame(2), beside(3));
    let (wide_params, wide_frame) = (wide(&actor.params), wide(&frame));
    for isa in Isa::available() {
        let mut attack = StateAttack::new(isa, &actor, &AttackConfig::PAPER).unwrap();
        let mut gradient = vec![0.0; frame.len()];
        attack.yaw_gradient(&frame, &beside, &mut gradient).unwrap();
        let largest = gradient.iter().fold(0.0f32, |m, g| m.max(g.abs()));
        assert!(largest > 1e-3, "{largest}");
        // Pixels at the ends of the range have a slope too, so that the attack can leave them.
        for i in (0..frame.len()).step_by(61 * 53 + 1) {
            let yaw_at = |x: f64| {
                let mut moved = wide_frame.clone();
                moved[i] = x;
                yaw_before_saturation(&wide_params, &moved, &beside)
            };
            let (x, h) = (wide_frame[i], 1e-6);
            let slope = (yaw_at(x + h) - yaw_at(x - h)) / (2.0 * h);
            let error = (f64::from(gradient[i]) - slope).abs();
            let is_near = error < 1e-4 * f64::from(largest);
            assert!(is_near, "pixel {i}: {} not {slope}", gradient[i]);
        }
    }
}

#[test]
fn what_is_reported_is_what_the_actor_does_and_the_yaw_goes_where_it_was_aimed() {
    let (actor, clean, beside) = (random_actor(3), frame(4), beside(5));
    let whole = Evaluated::new(SPEC.graph(Purpose::Gradients).unwrap(), Isa::detect(), &actor.params);
    let inputs = |frame: &[f32]| [frame, &beside.context, &beside.low_dim].map(<[f32]>::to_vec);
    let decide = |frame: &[f32]| whole.output(&whole.tape(&inputs(frame)));
    for method in Method::ALL {
        for (towards, sign) in [(Towards::Left, -1.0), (Towards::Right, 1.0)] {
            let settings = AttackConfig {
                towards,
                ..config(method)
            };
            let mut attack = StateAttack::new(Isa::detect(), &actor, &settings).unwrap();
            let (mut altered, mut shown) = (clean.clone(), Vec::new());
            let show = |i, outcome, _: &[f32]| shown.push((i, outcome));
            let outcome = attack.attack_each(&mut altered, &beside, show).unwrap();
            assert_eq!(outcome.clean.to_vec(), decide(&clean), "{}", method.name());
            assert_eq!(outcome.attacked.to_vec(), decide(&altered), "{}", method.name());
            let last = if method == Method::Fgsm { 1 } else { 7 };
            assert_eq!(shown.last(), Some(&(last, outcome)), "{}", method.name());
            if !method.alters_at_once() {
                assert!(outcome.yaw_change() * sign > 0.0, "{}: {outcome:?}", method.name());
            }
        }
    }
}

#[test]
fn away_is_away_from_the_clean_decision_even_when_that_is_saturated() {
    let layout = SPEC.reserve(&mut GraphBuilder::new());
    for bias in [-6.0, 6.0] {
        let mut actor = random_actor(3);
        // The last of the output layer's values is the yaw's bias.
        actor.params[layout.output.at + layout.output.len - 1] = bias;
        let settings = paper(|c| (c.method, c.epsilon_255) = (Method::BimClipped, 10.0));
        let mut attack = StateAttack::new(Isa::detect(), &actor, &settings).unwrap();
        let outcome = attack.attack(&mut frame(4), &beside(5)).unwrap();
        // Through the saturated tanh there would be no gradient to follow.
        let is_saturated = (outcome.clean[1] - ACTOR_LIMIT.copysign(bias)).abs() < 1e-2;
        assert!(is_saturated && outcome.yaw_change() * bias < 0.0, "{outcome:?}");
    }
}

#[test]
fn no_method_leaves_its_bounds() {
    let (actor, taken) = (random_actor(1), frame(2));
    for method in Method::ALL {
        let settings = config(method);
        let mut attack = StateAttack::new(Isa::detect(), &actor, &settings).unwrap();
        let mut altered = taken.clone();
        let check = |iteration: u32, _, now: &[f32]| {
            let so_far = match method {
                Method::BimAccumulating => iteration as f32 * settings.epsilon(),
                _ => settings.reach(taken.len()),
            };
            for (x, clean) in now.iter().zip(&taken) {
                assert!((0.0..=1.0).contains(x));
                assert!((x - clean).abs() <= so_far + 1e-6, "{}", method.name());
            }
        };
        attack.attack_each(&mut altered, &beside(3), check).unwrap();
        let both = altered.iter().zip(&taken);
        let moved = both.map(|(x, clean)| f64::from((x - clean).powi(2)));
        let rms = (moved.sum::<f64>() / taken.len() as f64).sqrt();
        let epsilon = f64::from(settings.epsilon());
        match method {
            Method::BimAccumulating => assert!(rms > 2.0 * epsilon, "{rms}"),
            Method::L2 => assert!(rms <= epsilon * (1.0 + 1e-5) && rms > 0.5 * epsilon, "{rms}"),
            Method::Noise => assert!(rms > 4.0 * epsilon, "{rms}"),
            Method::Replay | Method::Swell => assert!(rms == 0.0, "of the first frame nothing is altered"),
            _ => assert!(rms > 0.3 * epsilon, "{}: {rms}", method.name()),
        }
        if method == Method::Patch {
            let touched = altered.iter().zip(&taken).filter(|(x, clean)| x != clean).count();
            assert!(touched <= taken.len() / 32, "{touched} of {}", taken.len());
        }
    }
}

#[test]
fn the_same_seed_gives_the_same_bits_and_an_accumulating_run_holds_all_shorter_ones() {
    let (actor, taken) = (random_actor(8), frame(9));
    let run = |settings: &AttackConfig| {
        let mut attack = StateAttack::new(Isa::detect(), &actor, settings).unwrap();
        let (mut altered, mut each) = (taken.clone(), Vec::new());
        let keep = |_, _, now: &[f32]| each.push(now.to_vec());
        attack.attack_each(&mut altered, &beside(3), keep).unwrap();
        (altered, each)
    };
    for method in Method::ALL {
        let settings = config(method);
        assert_eq!(run(&settings).0, run(&settings).0, "{}", method.name());
        let other = AttackConfig { seed: 6, ..settings };
        let draws = matches!(method, Method::Pgd | Method::Noise | Method::Spsa);
        assert_eq!(run(&settings).0 != run(&other).0, draws, "{}", method.name());
    }
    let settings = config(Method::BimAccumulating);
    let (_, each) = run(&settings);
    let shorter = AttackConfig {
        iterations: 3,
        ..settings
    };
    assert_eq!(run(&shorter).0, each[2]);
}

#[test]
fn a_replay_shows_what_passed_first_a_blinded_sensor_sees_nothing_and_a_swelling_one_ever_farther() {
    let actor = random_actor(8);
    let streamed = |method| {
        let mut attack = StreamAttack::new(Isa::detect(), &actor, &config(method)).unwrap();
        (0..REPLAYED_FRAMES + 3)
            .map(|step| {
                let (given, mut altered) = (taken(&frame(20 + step), step, 0.05), DepthFrame::EMPTY);
                attack.attack_while(&input(&given), &mut altered, || true).unwrap();
                (given.depth, altered.depth)
            })
            .collect::<Vec<_>>()
    };
    let replayed = streamed(Method::Replay);
    for (i, (given, altered)) in replayed.iter().enumerate() {
        let first = &replayed[i % REPLAYED_FRAMES as usize].0;
        assert!(altered == first, "frame {i}");
        assert_eq!(given == altered, i < REPLAYED_FRAMES as usize);
    }
    let blinded = streamed(Method::Blind);
    assert!(blinded.iter().flat_map(|(_, altered)| altered).all(|x| *x == 1.0));
    for (i, (given, altered)) in streamed(Method::Swell).iter().enumerate() {
        let by = i as f32 / SWELL_FRAMES as f32 * config(Method::Swell).reach(given.len());
        let moved = altered.iter().zip(given).map(|(altered, given)| altered - given);
        assert!((moved.fold(0.0, f32::max) - by).abs() < 1e-6, "frame {i}");
    }
}

/// A pillar 2 m to 3 m ahead between two walls, as the LiDAR would see it.
fn scene(pillar_at_rad: f32, pillar_m: f32) -> Vec<f32> {
    let mut frame = Vec::with_capacity(DEPTH_ROWS * DEPTH_COLS);
    for row in 0..DEPTH_ROWS {
        for col in 0..DEPTH_COLS {
            let (bearing, elevation) = (column_bearing_rad(col as f32), row_elevation_rad(row as f32));
            let wall_m = 4.0 / bearing.sin().abs().max(0.05);
            let mut nearest_m = wall_m;
            if elevation < 0.0 {
                nearest_m = nearest_m.min(1.5 / -elevation.sin());
            }
            if (bearing - pillar_at_rad).abs() < 0.12 {
                nearest_m = nearest_m.min(pillar_m);
            }
            frame.push((nearest_m / 100.0).min(1.0));
        }
    }
    frame
}

#[test]
fn a_repainted_picture_shows_the_pillar_farther_away_and_nothing_beneath_the_ground_before_it() {
    let actor = FrozenActor::built_in().unwrap();
    let settings = paper(|c| c.method = Method::Repaint);
    let taken = scene(0.0, 2.5);
    let mut altered = taken.clone();
    let mut attack = StateAttack::new(Isa::detect(), &actor, &settings).unwrap();
    attack.attack(&mut altered, &hovering(&actor, &taken, GOAL)).unwrap();
    let (mut moved, mut painted) = (0, 0);
    for (i, (shown, was)) in altered.iter().zip(&taken).enumerate() {
        let falls = -row_elevation_rad((i / DEPTH_COLS) as f32).sin();
        let ground = if falls > 0.0 { 0.015 / falls } else { f32::INFINITY };
        let by = (was + settings.reach(taken.len())).min(1.0);
        assert!(
            (shown - was).abs() < 1e-6 || (shown - by.min(ground)).abs() < 1e-6,
            "pixel {i}"
        );
        assert!(*shown <= ground * 1.001, "pixel {i}");
        moved += usize::from(*shown == by && by > *was);
        painted += usize::from(ground < by && *was < 0.9 * ground);
    }
    assert!(moved > 1_000 && painted > 1_000, "{moved}, {painted}");
}

const GOAL: GoalRelative = GoalRelative::new(12.0, 0.2);

#[test]
fn the_attack_bends_the_built_in_actor_far_and_noise_of_its_size_does_not() {
    let actor = FrozenActor::built_in().unwrap();
    let yaw_changes = |method, iterations| {
        let settings = paper(|c| (c.method, c.iterations) = (method, iterations));
        let mut attack = StateAttack::new(Isa::detect(), &actor, &settings).unwrap();
        let mut changes = Vec::new();
        for (i, at) in [-0.4, -0.1, 0.2, 0.5].into_iter().enumerate() {
            let mut frame = scene(at, 2.0 + 0.3 * i as f32);
            let beside = hovering(&actor, &frame, GOAL);
            let outcome = attack.attack(&mut frame, &beside).unwrap();
            changes.push(outcome.yaw_change().abs());
        }
        changes.iter().sum::<f32>() / changes.len() as f32
    };
    // Both move each pixel by 1/255 at most. Noise as large as the accumulating attack gets, ±7.8 m in every pixel, blinds an actor that looks.
    let (attacked, noise) = (yaw_changes(Method::BimClipped, 20), yaw_changes(Method::Noise, 1));
    assert!(attacked > 0.5 && attacked > 5.0 * noise, "{attacked} against {noise}");
}

#[test]
fn pixels_of_a_region_move_together_and_the_actor_is_bent_all_the_same() {
    const SIDE: usize = 8;
    let actor = FrozenActor::built_in().unwrap();
    let settings = paper(|c| c.region_pixels = SIDE as u32);
    let clean = scene(0.2, 4.0);
    let beside = hovering(&actor, &clean, GOAL);
    let alter = |config: &AttackConfig| {
        let mut attack = StateAttack::new(Isa::detect(), &actor, config).unwrap();
        let mut frame = clean.clone();
        (attack.attack(&mut frame, &beside).unwrap(), frame)
    };
    let (outcome, frame) = alter(&settings);
    assert!(outcome.is_effective(), "{outcome:?}");
    let nearest = |of: &[f32]| of.iter().copied().fold(f32::INFINITY, f32::min);
    assert!(nearest(&frame) >= 0.005, "ranges of 0 would make the sensor look blind");
    assert!(nearest(&frame) < nearest(&clean));
    // One step, so that no pixel comes to an end of the range and stays behind.
    let (_, frame) = alter(&AttackConfig {
        iterations: 1,
        ..settings
    });
    let moved: Vec<f32> = frame.iter().zip(&clean).map(|(x, c)| x - c).collect();
    let within = |i: usize| 0.005 < frame[i] && frame[i] < 1.0;
    let (mut apart, mut moves) = (0, 0);
    for (i, by) in moved.iter().enumerate() {
        let (row, col) = (i / DEPTH_COLS, i % DEPTH_COLS);
        let corner = row / SIDE * SIDE * DEPTH_COLS + col / SIDE * SIDE;
        moves += usize::from(*by != 0.0);
        apart += usize::from(within(i) && within(corner) && (by - moved[corner]).abs() > 1e-5);
    }
    assert_eq!(apart, 0);
    assert!(moves > frame.len() / 2, "{moves} pixels moved");
    let refused = StateAttack::new(Isa::detect(), &actor, &paper(|c| c.region_pixels = 0));
    assert!(matches!(refused, Err(AttackError::Region)));
}

#[test]
fn the_streaming_attacker_knows_to_the_bit_what_the_actor_decides() {
    let (actor, isa) = (random_actor(3), Isa::detect());
    for begins in [0, 1, 30] {
        let mut attack = StreamAttack::new(isa, &actor, &config(Method::BimAccumulating)).unwrap();
        let (mut deceived, mut undisturbed) = (actor.actor(isa).unwrap(), actor.actor(isa).unwrap());
        for flight in 0..2 {
            for step in 0..40 {
                let given = taken(&frame(100 + step), step, 0.05);
                let mut delivered = given.clone();
                let clean = undisturbed.decide(&input(&given)).unwrap();
                let burst = begins..begins + 4;
                let attacks = burst.contains(&step);
                let outcome = if attacks {
                    Some(attack.attack_while(&input(&given), &mut delivered, || true).unwrap())
                } else {
                    attack.pass(&input(&given)).unwrap();
                    None
                };
                let decided = deceived.decide(&input(&delivered)).unwrap();
                // It is flown, whatever the other would have done.
                let [forward_m_s, yaw] = decided;
                undisturbed.note_action(vigil_types::Action { forward_m_s, yaw });
                assert_eq!(delivered.depth != given.depth, attacks);
                if let Some(outcome) = outcome {
                    let settings = (outcome.clean, outcome.attacked);
                    assert_eq!(settings, (clean, decided), "flight {flight}, step {step}");
                }
                // What was altered is remembered as an older scan.
                let held = SCAN_AGES
                    .iter()
                    .any(|age| step.checked_sub(*age as u64).is_some_and(|s| burst.contains(&s)));
                if step < begins {
                    assert_eq!(decided, clean, "step {step}");
                } else if attacks || held {
                    assert_ne!(decided, clean, "step {step}");
                }
            }
            attack.reset();
            deceived.reset();
            undisturbed.reset();
        }
    }
}

#[test]
fn a_burst_keeps_its_direction_though_the_clean_decision_changes_sides() {
    let actor = FrozenActor::built_in().unwrap();
    let mut attack = StreamAttack::new(Isa::detect(), &actor, &AttackConfig::PAPER).unwrap();
    // The goal moves from one side to the other, and the clean decision with it.
    let outcomes: Vec<_> = (0..12)
        .map(|step| {
            let given = taken(&scene(3.0, 5.0), step, 0.0);
            let moved = PilotInput {
                goal: GoalRelative::new(12.0, if step < 6 { -1.2 } else { 1.2 }),
                velocity_m_s: HeadingVector::ZERO,
                ..input(&given)
            };
            attack.attack_while(&moved, &mut given.clone(), || true).unwrap()
        })
        .collect();
    let (first, last) = (outcomes.first().unwrap(), outcomes.last().unwrap());
    assert!(first.clean[1] * last.clean[1] < 0.0, "{first:?} {last:?}");
    let direction = first.attacked[1] - first.clean[1];
    let bent = last.attacked[1] - last.clean[1];
    assert!(
        bent * direction >= 0.0 && last.attacked[1] * direction > 0.0,
        "{last:?}"
    );
}

#[test]
fn bad_configurations_and_frames_are_refused_by_name() {
    let actor = random_actor(1);
    for epsilon_255 in [0.0, -1.0, f32::NAN, f32::INFINITY, 256.0] {
        let refused = StateAttack::new(Isa::PORTABLE, &actor, &paper(|c| c.epsilon_255 = epsilon_255));
        assert!(matches!(refused, Err(AttackError::Epsilon { .. })));
    }
    let refused = StreamAttack::new(Isa::PORTABLE, &actor, &paper(|c| c.iterations = 0));
    assert!(matches!(refused, Err(AttackError::Iterations)));
    let mut attack = StateAttack::new(Isa::PORTABLE, &actor, &AttackConfig::PAPER).unwrap();
    let error = attack.attack(&mut [0.5; 7], &beside(3)).unwrap_err();
    assert_eq!(error.to_string(), "frame holds 7 values, expected 32768");
    let short = FrozenActor {
        params: actor.params[1..].to_vec(),
        ..actor
    };
    assert!(StateAttack::new(Isa::PORTABLE, &short, &AttackConfig::PAPER).is_err());
    assert!(StreamAttack::new(Isa::PORTABLE, &short, &AttackConfig::PAPER).is_err());
}

/// A detector of random weights.
fn random_detector() -> FrozenDetector {
    let mut rng = rng(11);
    let built_in = FrozenDetector::built_in().unwrap();
    let background = |rng: &mut _| (uniform(rng, ACTOR_HIDDEN, 0.5), beside(7).low_dim);
    FrozenDetector {
        backgrounds: (0..5).map(|_| background(&mut rng)).collect(),
        centre: [0.0; ROW],
        scale: [0.02; ROW],
        threshold: 0.5,
        params: uniform(&mut rng, built_in.params.len(), 0.2),
        ..built_in
    }
}

/// The detector's score after ten frames of peace and five of an attack, worked out from what was delivered; and how far
/// the yaw was bent at the end.
fn score_after(attack: &mut StreamAttack, attacked: bool, detector: &FrozenDetector) -> (f32, f32) {
    let (frozen, isa) = (random_actor(3), Isa::detect());
    let mut actor: Actor = frozen.actor(isa).unwrap();
    let head = ExplainedHead::of_actor(&frozen.params, Purpose::Multipliers).unwrap();
    let mut shap = detector.explainer(isa, head).unwrap();
    let mut rows = Vec::new();
    let mut bent = 0.0;
    for step in 0..15 {
        let given = taken(&frame(100), step, 0.05);
        let mut delivered = given.clone();
        if attacked && step >= 10 {
            let outcome = attack.attack_while(&input(&given), &mut delivered, || true).unwrap();
            bent = outcome.yaw_change().abs();
        } else {
            attack.pass(&input(&given)).unwrap();
        }
        actor.decide(&input(&delivered)).unwrap();
        shap.evaluate(&[actor.state(), &actor.low_dim()]).unwrap();
        let mut phi = [0.0; ROW + LOW_DIM];
        shap.attribute(1, &mut phi).unwrap();
        rows.push(normalise(phi.first_chunk().unwrap(), &detector.centre, &detector.scale));
    }
    let mut scorer = LstmAd::new(isa, &detector.params).unwrap();
    (scorer.score(rows.last_chunk::<WINDOW>().unwrap()).unwrap(), bent)
}

#[test]
fn an_attacker_who_knows_the_detector_lowers_its_score_and_still_bends_the_yaw() {
    let settings = paper(|c| c.epsilon_255 = 0.5);
    let plain = || StreamAttack::new(Isa::detect(), &random_actor(3), &settings).unwrap();
    let mut detector = random_detector();
    let [peace, raised] = [false, true].map(|attacked| score_after(&mut plain(), attacked, &detector).0);
    if raised < peace {
        // Random weights may like attacks; the negated output layer does not.
        let output = detector.params.len() - 17;
        detector.params[output..].iter_mut().for_each(|w| *w = -*w);
    }
    let [peace, caught] = [false, true].map(|attacked| score_after(&mut plain(), attacked, &detector).0);
    assert!(caught > peace, "{caught} {peace}");
    // A threshold between them: the attacker has to take care.
    detector.threshold = peace + 0.5 * (caught - peace);
    let mut evading = plain().evading(&detector).unwrap();
    let (score, bent) = score_after(&mut evading, true, &detector);
    assert!(score < caught && bent > 0.0, "{score} against {caught}, bent by {bent}");
    evading.reset();
    let again = score_after(&mut evading, true, &detector);
    assert_eq!(again, (score, bent), "a reset begins anew");
    detector.backgrounds.clear();
    assert!(plain().evading(&detector).is_err());
}
