//! The attacks against independent oracles: float64 differences, the actor itself, the bounds, and chance.

#[path = "../../../firmware/nnet/tests/common/mod.rs"]
mod oracle;

use oracle::{activation, conv2d, dense, gru, rng, uniform, wide};
use vigil_adversary::{AttackConfig, AttackError, Method, REPLAYED_FRAMES, StateAttack, StreamAttack, Towards};
use vigil_detector::{FrozenDetector, LstmAd, Of, ROW, WINDOW, normalise};
use vigil_nnet::{Activation, Dense, GraphBuilder, Isa, Purpose};
use vigil_policy::actor::{
    ACTOR_FRAMES, ACTOR_HIDDEN, ACTOR_LIMIT, Actor, ActorSpec, FRAMES_IN_A_ROW, PositionalInputs,
};
use vigil_policy::{ExplainedHead, FrozenActor};
use vigil_types::{DEPTH_COLS, DEPTH_ROWS, column_bearing_rad, row_elevation_rad};

const SMALL: ActorSpec = ActorSpec {
    rows: 32,
    cols: 64,
    near_contrast: true,
    told_of_movers: false,
};

fn small_params(seed: u64) -> Vec<f32> {
    let len = SMALL.head_graph(Purpose::Gradients).unwrap().param_len();
    uniform(&mut rng(seed), len, 0.2)
}

/// Ranges between 0 and 1, some of them at the ends.
fn small_frames(count: usize, seed: u64) -> Vec<f32> {
    let values = uniform(&mut rng(seed), count * SMALL.frame_len(), 0.6);
    values.iter().map(|v| (v + 0.5).clamp(0.0, 1.0)).collect()
}

fn config(method: Method) -> AttackConfig {
    AttackConfig {
        method,
        iterations: 7,
        seed: 5,
        ..AttackConfig::PAPER
    }
}

/// The actor's yaw before saturation, float64, written from its description.
fn yaw_before_saturation(params: &[f64], frames: &[f64], position: &[f64]) -> f64 {
    let layout = SMALL.reserve(&mut GraphBuilder::new());
    let at = |p: vigil_nnet::Params| &params[p.at..p.at + p.len];
    let mut h = vec![0.0; ACTOR_HIDDEN];
    for frame in frames.chunks_exact(SMALL.frame_len()) {
        let mut x = activation(Activation::NEAR_CONTRAST, frame);
        for (layer, p) in SMALL.convolutions().into_iter().zip(layout.convolutions) {
            x = conv2d(layer, Activation::Elu, at(p), &x);
        }
        h = gru(SMALL.gru(), at(layout.gru), &x, &h);
    }
    let of = |inputs, outputs| Dense { inputs, outputs };
    let mut joined = activation(Activation::TANH, &h);
    joined.extend(dense(of(2, 6), Activation::TANH, at(layout.positional), position));
    let hidden = dense(of(54, 32), Activation::Elu, at(layout.dense), &joined);
    dense(of(32, 2), Activation::Identity, at(layout.output), &hidden)[1]
}

#[test]
fn the_gradient_is_the_float64_slope_of_the_yaw_before_its_saturation() {
    let (params, frames, position) = (small_params(1), small_frames(ACTOR_FRAMES, 2), [0.4, -0.3]);
    let (wide_params, wide_frames, wide_position) = (wide(&params), wide(&frames), wide(&position));
    for isa in Isa::available() {
        let mut attack = StateAttack::on(SMALL, isa, &params, &AttackConfig::PAPER).unwrap();
        let mut gradient = vec![0.0; frames.len()];
        attack.yaw_gradient(&frames, position, &mut gradient).unwrap();
        let largest = gradient.iter().fold(0.0f32, |m, g| m.max(g.abs()));
        assert!(largest > 1e-3, "{largest}");
        // Pixels at the ends of the range have a slope too, so that the attack can leave them.
        for i in (0..frames.len()).step_by(997) {
            let yaw_at = |x: f64| {
                let mut moved = wide_frames.clone();
                moved[i] = x;
                yaw_before_saturation(&wide_params, &moved, &wide_position)
            };
            let (x, h) = (wide_frames[i], 1e-6);
            let slope = (yaw_at(x + h) - yaw_at(x - h)) / (2.0 * h);
            let error = (f64::from(gradient[i]) - slope).abs();
            assert!(
                error < 1e-4 * f64::from(largest),
                "pixel {i}: {} not {slope}",
                gradient[i]
            );
        }
    }
}

#[test]
fn what_is_reported_is_what_the_actor_does_and_the_yaw_goes_where_it_was_aimed() {
    let (params, frames, position) = (small_params(3), small_frames(ACTOR_FRAMES, 4), [0.9, 0.5]);
    let graph = SMALL.graph(Purpose::Gradients, false).unwrap();
    let decide = |frames: &[f32]| -> Vec<f32> {
        let mut inputs: Vec<&[f32]> = frames.chunks_exact(SMALL.frame_len()).collect();
        inputs.push(&position);
        let mut tape = vec![0.0; graph.tape_len()];
        graph.forward(Isa::detect(), &params, &inputs, &mut tape).unwrap();
        graph.output(&tape).unwrap().to_vec()
    };
    for method in Method::ALL {
        for (towards, sign) in [(Towards::Left, -1.0), (Towards::Right, 1.0)] {
            let told = AttackConfig {
                towards,
                ..config(method)
            };
            let mut attack = StateAttack::on(SMALL, Isa::detect(), &params, &told).unwrap();
            let (mut altered, mut shown) = (frames.clone(), Vec::new());
            let outcome = attack
                .attack_each(&mut altered, position, |i, outcome, _| {
                    shown.push((i, outcome));
                })
                .unwrap();
            assert_eq!(outcome.clean.to_vec(), decide(&frames), "{}", method.name());
            assert_eq!(outcome.attacked.to_vec(), decide(&altered), "{}", method.name());
            let last = if method == Method::Fgsm { 1 } else { 7 };
            assert_eq!(shown.last(), Some(&(last, outcome)), "{}", method.name());
            if method.aims() {
                assert!(outcome.yaw_change() * sign > 0.0, "{}: {outcome:?}", method.name());
            }
        }
    }
}

#[test]
fn away_is_away_from_the_clean_decision_even_when_that_is_saturated() {
    let frames = small_frames(ACTOR_FRAMES, 4);
    let layout = SMALL.reserve(&mut GraphBuilder::new());
    for bias in [-6.0, 6.0] {
        let mut params = small_params(3);
        // The last of the output layer's values is the yaw's bias.
        params[layout.output.at + layout.output.len - 1] = bias;
        let told = AttackConfig {
            epsilon_255: 10.0,
            ..AttackConfig::PAPER
        };
        let mut attack = StateAttack::on(SMALL, Isa::detect(), &params, &told).unwrap();
        let mut altered = frames.clone();
        let outcome = attack.attack(&mut altered, [0.5, 0.0]).unwrap();
        // Through the saturated tanh there would be no gradient to follow.
        assert!(
            (outcome.clean[1] - ACTOR_LIMIT.copysign(bias)).abs() < 1e-2,
            "{outcome:?}"
        );
        assert!(outcome.yaw_change() * bias < 0.0, "{outcome:?}");
    }
}

#[test]
fn no_method_leaves_its_bounds() {
    let (params, frames) = (small_params(1), small_frames(ACTOR_FRAMES, 2));
    for method in Method::ALL {
        let told = config(method);
        let mut attack = StateAttack::on(SMALL, Isa::detect(), &params, &told).unwrap();
        let mut altered = frames.clone();
        attack
            .attack_each(&mut altered, [0.2, 0.1], |iteration, _, now| {
                let so_far = match method {
                    Method::BimAccumulating => iteration as f32 * told.epsilon(),
                    _ => told.reach(frames.len()),
                };
                for (x, clean) in now.iter().zip(&frames) {
                    assert!((0.0..=1.0).contains(x));
                    assert!((x - clean).abs() <= so_far + 1e-6, "{}", method.name());
                }
            })
            .unwrap();
        let moved = altered
            .iter()
            .zip(&frames)
            .map(|(x, clean)| f64::from((x - clean).powi(2)));
        let rms = (moved.sum::<f64>() / frames.len() as f64).sqrt();
        let epsilon = f64::from(told.epsilon());
        match method {
            Method::BimAccumulating => assert!(rms > 2.0 * epsilon, "{rms}"),
            Method::L2 => assert!(rms <= epsilon * (1.0 + 1e-5) && rms > 0.5 * epsilon, "{rms}"),
            Method::Noise => assert!(rms > 4.0 * epsilon, "{rms}"),
            Method::Replay => assert!(rms == 0.0, "nothing has passed that could be shown again"),
            _ => assert!(rms > 0.3 * epsilon, "{}: {rms}", method.name()),
        }
        if method == Method::Patch {
            let touched = altered.iter().zip(&frames).filter(|(x, clean)| x != clean).count();
            assert!(touched <= frames.len() / 32, "{touched} of {}", frames.len());
        }
    }
}

#[test]
fn the_same_seed_gives_the_same_bits_and_an_accumulating_run_holds_all_shorter_ones() {
    let (params, frames) = (small_params(8), small_frames(ACTOR_FRAMES, 9));
    let run = |told: &AttackConfig| {
        let mut attack = StateAttack::on(SMALL, Isa::detect(), &params, told).unwrap();
        let (mut altered, mut each) = (frames.clone(), Vec::new());
        attack
            .attack_each(&mut altered, [0.2, 0.1], |_, _, now| each.push(now.to_vec()))
            .unwrap();
        (altered, each)
    };
    for method in Method::ALL {
        let told = config(method);
        assert_eq!(run(&told).0, run(&told).0, "{}", method.name());
        let other = AttackConfig { seed: 6, ..told };
        let draws = matches!(method, Method::Pgd | Method::Noise | Method::Spsa);
        assert_eq!(run(&told).0 != run(&other).0, draws, "{}", method.name());
    }
    let told = config(Method::BimAccumulating);
    let (_, each) = run(&told);
    let shorter = AttackConfig { iterations: 3, ..told };
    assert_eq!(run(&shorter).0, each[2]);
}

#[test]
fn a_replay_shows_what_passed_first_and_a_blinded_sensor_sees_nothing() {
    let params = small_params(8);
    let streamed = |method| {
        let mut attack = StreamAttack::on(SMALL, Isa::detect(), &params, &config(method)).unwrap();
        let frames = (0..REPLAYED_FRAMES as usize + 3).map(|i| small_frames(1, 20 + i as u64));
        frames
            .map(|frame| {
                let mut altered = frame.clone();
                attack.attack(&mut altered, [0.2, 0.1]).unwrap();
                (frame, altered)
            })
            .collect::<Vec<_>>()
    };
    let replayed = streamed(Method::Replay);
    for (i, (frame, altered)) in replayed.iter().enumerate() {
        let first = &replayed[i % REPLAYED_FRAMES as usize].0;
        assert_eq!(altered, first, "frame {i}");
        assert_eq!(frame == altered, i < REPLAYED_FRAMES as usize);
    }
    assert!(
        streamed(Method::Blind)
            .iter()
            .all(|(_, altered)| altered.iter().all(|x| *x == 1.0))
    );
}

/// A pillar 2 m to 3 m ahead between two walls, as the LiDAR would see it.
fn scene(pillar_at_rad: f32, pillar_m: f32) -> Vec<f32> {
    let mut frame = Vec::with_capacity(DEPTH_ROWS * DEPTH_COLS);
    for row in 0..DEPTH_ROWS {
        for col in 0..DEPTH_COLS {
            let (bearing, elevation) = (column_bearing_rad(col as f32), row_elevation_rad(row as f32));
            let wall_m = 4.0 / bearing.sin().abs().max(0.05);
            let floor_m = if elevation < 0.0 {
                1.5 / -elevation.sin()
            } else {
                f32::MAX
            };
            let pillar_m = if (bearing - pillar_at_rad).abs() < 0.12 {
                pillar_m
            } else {
                f32::MAX
            };
            frame.push((wall_m.min(floor_m).min(pillar_m) / 100.0).min(1.0));
        }
    }
    frame
}

#[test]
fn the_attack_bends_the_built_in_actor_far_and_noise_of_its_size_does_not() {
    let actor = FrozenActor::built_in().unwrap();
    let position = PositionalInputs::at_rest([0.6, 0.2], actor.inputs);
    let yaw_changes = |method| {
        let told = AttackConfig {
            method,
            ..AttackConfig::PAPER
        };
        let mut attack = StateAttack::new(Isa::detect(), &actor, &told).unwrap();
        let mut changes = Vec::new();
        for (i, at) in [-0.4, -0.1, 0.2, 0.5].into_iter().enumerate() {
            let mut frames = scene(at, 2.0 + 0.3 * i as f32).repeat(ACTOR_FRAMES);
            let outcome = attack.attack(&mut frames, position).unwrap();
            changes.push(outcome.yaw_change().abs());
        }
        changes.iter().sum::<f32>() / changes.len() as f32
    };
    let (attacked, noise) = (yaw_changes(Method::BimAccumulating), yaw_changes(Method::Noise));
    // That noise is ±7.8 m in every pixel, which blinds more than it deceives.
    assert!(attacked > 1.0 && attacked > 2.5 * noise, "{attacked} against {noise}");
}

#[test]
fn pixels_of_a_region_move_together_and_the_actor_is_bent_all_the_same() {
    const SIDE: usize = 8;
    let actor = FrozenActor::built_in().unwrap();
    let told = AttackConfig {
        region_pixels: SIDE as u32,
        ..AttackConfig::PAPER
    };
    let clean = scene(0.2, 4.0);
    let position = PositionalInputs::at_rest([0.6, 0.2], actor.inputs);
    let alter = |config: &AttackConfig| {
        let mut attack = StateAttack::new(Isa::detect(), &actor, config).unwrap();
        let mut frames = clean.repeat(ACTOR_FRAMES);
        (attack.attack(&mut frames, position).unwrap(), frames)
    };
    let (outcome, frames) = alter(&told);
    assert!(outcome.is_effective(), "{outcome:?}");
    let nearest = |of: &[f32]| of.iter().copied().fold(f32::INFINITY, f32::min);
    assert!(
        nearest(&frames) >= 0.005,
        "ranges of 0 would make the sensor look blind"
    );
    assert!(nearest(&frames) < nearest(&clean));
    // One step, so that no pixel comes to an end of the range and stays behind.
    let (_, frames) = alter(&AttackConfig { iterations: 1, ..told });
    for frame in frames.chunks_exact(clean.len()) {
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
    }
    let none = AttackConfig {
        region_pixels: 0,
        ..told
    };
    assert!(matches!(
        StateAttack::new(Isa::detect(), &actor, &none),
        Err(AttackError::Region)
    ));
}

#[test]
fn the_streaming_attacker_knows_to_the_bit_what_the_actor_decides() {
    let params = small_params(3);
    let isa = Isa::detect();
    let spread = [7, 5, 3, 2, 0];
    for (begins, ages) in [0, 1, 6].into_iter().flat_map(|b| [(b, FRAMES_IN_A_ROW), (b, spread)]) {
        let attack = StreamAttack::on(SMALL, isa, &params, &config(Method::BimAccumulating)).unwrap();
        let mut attack = attack.with_frame_ages(ages);
        let mut deceived = Actor::with_frame_ages(SMALL, isa, &params, ages).unwrap();
        let mut undisturbed = deceived.clone();
        for flight in 0..2 {
            for step in 0..14 {
                let (mut frame, position) = (small_frames(1, 100 + step), [0.1 * step as f32, 0.3]);
                let given = frame.clone();
                let clean = undisturbed.decide(&frame, position).unwrap();
                let burst = begins..begins + 4;
                let attacks = burst.contains(&step);
                // The first frame stands for the missing older ones.
                let mut held = ages.iter().map(|age| step.saturating_sub(*age as u64));
                let outcome = if attacks {
                    Some(attack.attack(&mut frame, position).unwrap())
                } else {
                    attack.pass(&mut frame, position).unwrap();
                    None
                };
                let decided = deceived.decide(&frame, position).unwrap();
                assert_eq!(frame != given, attacks);
                if let Some(outcome) = outcome {
                    assert_eq!(
                        (outcome.clean, outcome.attacked),
                        (clean, decided),
                        "flight {flight}, step {step}"
                    );
                }
                assert_eq!(
                    decided != clean,
                    held.any(|s| burst.contains(&s)),
                    "step {step} of {ages:?}"
                );
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
            let bearing = if step < 6 { -1.2 } else { 1.2 };
            let position = PositionalInputs::at_rest([0.6, bearing], actor.inputs);
            attack.attack(&mut scene(3.0, 5.0), position).unwrap()
        })
        .collect();
    let (first, last) = (outcomes.first().unwrap(), outcomes.last().unwrap());
    assert!(first.clean[1] * last.clean[1] < 0.0, "{first:?} {last:?}");
    let direction = first.attacked[1] - first.clean[1];
    assert!(
        (last.attacked[1] - last.clean[1]) * direction >= 0.0 && last.attacked[1] * direction > 0.0,
        "{last:?}"
    );
}

#[test]
fn bad_configurations_and_frames_are_refused_by_name() {
    let params = small_params(1);
    for epsilon_255 in [0.0, -1.0, f32::NAN, f32::INFINITY, 256.0] {
        let told = AttackConfig {
            epsilon_255,
            ..AttackConfig::PAPER
        };
        let refused = StateAttack::on(SMALL, Isa::PORTABLE, &params, &told);
        assert!(matches!(refused, Err(AttackError::Epsilon { .. })));
    }
    let none = AttackConfig {
        iterations: 0,
        ..AttackConfig::PAPER
    };
    assert!(matches!(
        StreamAttack::on(SMALL, Isa::PORTABLE, &params, &none),
        Err(AttackError::Iterations)
    ));
    assert!(StateAttack::on(SMALL, Isa::PORTABLE, &params[1..], &AttackConfig::PAPER).is_err());
    let mut attack = StreamAttack::on(SMALL, Isa::PORTABLE, &params, &AttackConfig::PAPER).unwrap();
    let error = attack.attack(&mut [0.5; 7], [0.0; 2]).unwrap_err();
    assert_eq!(error.to_string(), "frame holds 7 values, expected 2048");
}

/// A detector of random weights for the small actor.
fn random_detector() -> FrozenDetector {
    let mut rng = rng(11);
    let params = LstmAd::tensors()
        .iter()
        .map(|(_, shape)| shape.iter().product::<usize>())
        .sum();
    let background = |rng: &mut _| (uniform(rng, ACTOR_HIDDEN, 0.5), [0.5, 0.1].into());
    FrozenDetector {
        of: Of::Actor,
        actor_sha256: String::new(),
        backgrounds: (0..5).map(|_| background(&mut rng)).collect(),
        centre: [0.0; ROW],
        scale: [0.02; ROW],
        threshold: 0.5,
        threshold_choice: String::new(),
        params: uniform(&mut rng, params, 0.2),
        training_config: String::new(),
        seed: 0,
        git_commit: None,
    }
}

/// The detector's score after ten frames of peace and five of an attack, worked out from what was delivered; and how far
/// the yaw was bent at the end.
fn score_after(attack: &mut StreamAttack, attacked: bool, detector: &FrozenDetector) -> (f32, f32) {
    let (params, isa, position) = (small_params(3), Isa::detect(), [0.4, 0.3]);
    let mut actor = Actor::new(SMALL, isa, &params).unwrap();
    let head = ExplainedHead::of_actor(SMALL, &params, Purpose::Multipliers).unwrap();
    let mut shap = detector.explainer(isa, head).unwrap();
    let mut rows = Vec::new();
    let mut bent = 0.0;
    for step in 0..15 {
        let mut frame = small_frames(1, 100);
        if attacked && step >= 10 {
            bent = attack.attack(&mut frame, position).unwrap().yaw_change().abs();
        } else {
            attack.pass(&mut frame, position).unwrap();
        }
        actor.decide(&frame, position).unwrap();
        shap.evaluate(&[actor.state(), &position]).unwrap();
        let mut phi = [0.0; ROW + 2];
        shap.attribute(1, &mut phi).unwrap();
        rows.push(normalise(phi.first_chunk().unwrap(), &detector.centre, &detector.scale));
    }
    let mut judge = LstmAd::new(isa, &detector.params).unwrap();
    (judge.score(rows.last_chunk::<WINDOW>().unwrap()).unwrap(), bent)
}

#[test]
fn an_attacker_who_knows_the_detector_lowers_its_score_and_still_bends_the_yaw() {
    let told = AttackConfig {
        epsilon_255: 0.5,
        ..AttackConfig::PAPER
    };
    let plain = || StreamAttack::on(SMALL, Isa::detect(), &small_params(3), &told).unwrap();
    let mut detector = random_detector();
    let (peace, _) = score_after(&mut plain(), false, &detector);
    let (raised, _) = score_after(&mut plain(), true, &detector);
    if raised < peace {
        // Random weights may like attacks; the negated output layer does not.
        let output = detector.params.len() - 17;
        detector.params[output..].iter_mut().for_each(|w| *w = -*w);
    }
    let (peace, _) = score_after(&mut plain(), false, &detector);
    let (caught, _) = score_after(&mut plain(), true, &detector);
    assert!(caught > peace, "{caught} {peace}");
    // A threshold between them: the attacker has to take care.
    detector.threshold = peace + 0.5 * (caught - peace);
    let mut evading = plain().evading(&detector).unwrap();
    let (score, bent) = score_after(&mut evading, true, &detector);
    assert!(score < caught && bent > 0.0, "{score} against {caught}, bent by {bent}");
    evading.reset();
    assert_eq!(
        score_after(&mut evading, true, &detector),
        (score, bent),
        "a reset begins anew"
    );
    detector.backgrounds.clear();
    assert!(plain().evading(&detector).is_err());
}
