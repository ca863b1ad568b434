//! Flying, keeping and learning: small, with the built-in actor.

use std::path::Path;
use vigil_adversary::{AttackConfig, Method};
use vigil_lab::detector_training::{
    Adversary, Examples, Feature, FitConfig, Frame, LstmConfig, Plan, Record, Scenario, Shown, WindowScorer, counts_of,
    fit, fly, load_flights, save_flights, train,
};
use vigil_nnet::{Activation, Dense, GraphBuilder, Isa, Purpose};
use vigil_policy::{FrozenActor, FrozenPilot};
use vigil_sim::world::Family;
use vigil_tools::threads::thread_pool;

fn actor() -> FrozenPilot {
    FrozenPilot::load_or_built_in(None).unwrap()
}

/// Attacks these steps.
fn attacking(config: AttackConfig, steps: std::ops::Range<u64>) -> Option<Adversary> {
    let bursts = std::iter::once(steps).collect();
    Some(Adversary { config, bursts })
}

/// Thirty steps with two attacked ones in the middle.
fn attacked(plan: Plan) -> Scenario {
    let config = AttackConfig {
        method: Method::BimAccumulating,
        epsilon_255: 10.0,
        iterations: 2,
        ..AttackConfig::PAPER
    };
    Scenario {
        adversary: attacking(config, 12..14),
        steps: 30,
        ..Scenario::unattacked(Family::Training, 3001, plan)
    }
}

fn monitored(scenario: &Scenario, mut watch: impl FnMut(&Shown<'_>)) -> Record {
    let flown = fly(Isa::detect(), &actor(), scenario, &mut |_, shown| {
        watch(shown);
        Ok(())
    });
    flown.unwrap()
}

fn flown(scenario: &Scenario) -> Record {
    monitored(scenario, |_| {})
}

#[test]
fn only_frames_that_count_as_attacked_differ_from_what_the_sensor_took() {
    let mut differences = Vec::new();
    let record = monitored(&attacked(Plan::Actor), |shown| {
        let pairs = shown.input.depth.depth.iter().zip(&shown.taken.depth);
        differences.push(pairs.filter(|(a, b)| a != b).count());
    });
    assert_eq!(record.steps.len(), 30);
    for (i, (step, pixels)) in record.steps.iter().zip(differences).enumerate() {
        let within = (12..14).contains(&i);
        assert_eq!(step.frame == Frame::Attacked, within, "step {i}");
        assert_eq!(pixels > 1000, within, "step {i}: {pixels} pixels differ");
        assert_eq!(step.yaw_change != 0.0, within, "step {i}");
    }
}

#[test]
fn who_steers_changes_the_flight_but_not_what_is_explained_first() {
    let flown = |plan| flown(&attacked(plan)).steps;
    let (own, other) = (flown(Plan::Actor), flown(Plan::Geometric));
    assert_eq!(own[0], other[0], "the same first frame, the same decision");
    assert_ne!(own[29].state, other[29].state, "by then they are elsewhere");
    let recovering = flown(Plan::Recovering {
        delay: 1,
        hover: 5,
        trust: 5,
    });
    assert_eq!(recovering[..12], own[..12], "until the alarm the actor flies");
    assert_ne!(recovering[16].state, own[16].state, "then it brakes");
}

#[test]
fn a_flight_that_is_drawn_unattacked_has_no_attacked_window() {
    // One that draws noise, which is no attack.
    let mut scenario = Scenario::drawn(3109, false);
    scenario.steps = 20;
    scenario.adversary = scenario.adversary.and_then(|a| attacking(a.config, 8..20));
    assert!(scenario.adversary.is_some());
    assert_eq!(counts_of(&[flown(&scenario)])[0], 0);
}

#[test]
fn flights_come_back_from_their_file_and_only_for_their_actor() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flights.safetensors");
    let flights = [flown(&attacked(Plan::Switching))];
    save_flights(&path, &actor(), &flights).unwrap();
    assert_eq!(load_flights(&path, &actor()).unwrap(), flights);
    let mut other = FrozenActor::built_in().unwrap();
    other.seed += 1;
    let other = FrozenPilot::Actor(other);
    let foreign = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../firmware/policy/actor/actor.safetensors");
    for (path, pilot, words) in [
        (&path, &other, ["name another folder with -o", &other.sha256()]),
        (&foreign, &actor(), ["holds no data of", "`vigil detector collect`"]),
    ] {
        let refused = load_flights(path, pilot).unwrap_err().to_string();
        assert!(words.iter().all(|word| refused.contains(word)), "{refused}");
    }
}

#[test]
fn the_built_in_detector_judges_the_built_in_actor() {
    let (frozen, actor) = (vigil_detector::FrozenDetector::built_in().unwrap(), actor());
    assert_eq!(
        frozen.actor_sha256,
        actor.sha256(),
        "train a detector for the actor that is built in"
    );
    assert_eq!(frozen.backgrounds.len(), 30);
    // Two flights over a course that it was not trained on.
    let mut scenario = Scenario {
        steps: 60,
        ..Scenario::unattacked(Family::Validation, 6501, Plan::Actor)
    };
    let quiet = flown(&scenario);
    scenario.adversary = attacking(AttackConfig::PAPER, 30..60);
    let bent = flown(&scenario);
    let scorer = WindowScorer::from_frozen(frozen);
    let scores = scorer.scores(Isa::detect(), &actor, &[quiet, bent]).unwrap();
    let alarms = [0, 1].map(|flight: usize| scores[flight].iter().flatten().filter(|s| **s > 0.5).count());
    let verdicts = scores[0].iter().flatten().count();
    assert_eq!(verdicts, 51, "no verdict before the window is full");
    assert!(alarms[0] <= 3 && alarms[1] >= 25, "{alarms:?} alarms");
}

#[test]
fn nothing_to_learn_from_is_said_with_numbers() {
    let config = LstmConfig::default();
    let (isa, shap) = (Isa::detect(), Feature::Shap);
    let refused = train(isa, &actor(), shap, (&[], &[]), &config, &mut |_, _| {});
    let refused = refused.unwrap_err().to_string();
    assert!(
        refused.contains("0 attacked and 0 unattacked windows for training"),
        "{refused}"
    );
}

/// Two interleaved half circles, from a fixed recipe.
struct Moons(usize);

impl Examples for Moons {
    fn count(&self) -> usize {
        self.0
    }

    fn inputs<'a>(&'a self, i: usize, buffer: &'a mut Vec<f32>) -> Vec<&'a [f32]> {
        let angle = (i / 2) as f32 * 0.618;
        let (x, y) = ((angle % 3.1).cos(), (angle % 3.1).sin());
        *buffer = if self.attacked(i) {
            vec![x, y]
        } else {
            vec![1.0 - x, 0.4 - y]
        };
        vec![buffer.as_slice()]
    }

    fn attacked(&self, i: usize) -> bool {
        i.is_multiple_of(2)
    }
}

#[test]
fn a_network_learns_what_no_straight_line_separates_with_the_same_bits_on_any_number_of_threads() {
    let mut b = GraphBuilder::new();
    let mut x = b.input(2, false).unwrap();
    for (inputs, outputs, curve) in [(2, 24, Activation::Relu), (24, 1, Activation::Identity)] {
        let layer = Dense { inputs, outputs };
        let params = b.params(layer.param_len());
        x = b.dense(x, layer, curve, params).unwrap();
    }
    let graph = b.finish(x, Purpose::Gradients).unwrap();
    let config = FitConfig {
        epochs: 60,
        batch: 32,
        rate: 2e-2,
        gradient_norm: 5.0,
        weight_decay: 0.0,
        seed: 5,
    };
    let train = |threads| {
        let pool = thread_pool(threads).unwrap();
        let first: Vec<f32> = (0..graph.param_len()).map(|i| (i as f32 * 1.7).sin() * 0.5).collect();
        let (isa, learn, choose) = (Isa::detect(), Moons(400), Moons(100));
        let fitted = pool.install(|| fit(&graph, isa, first, &learn, &choose, &config, &mut |_, _| {}));
        fitted.unwrap()
    };
    let fitted = train(1);
    assert_eq!(fitted, train(2));
    let chosen = fitted.epochs[fitted.chosen - 1];
    assert!(chosen.choose_accuracy > 0.95, "{chosen:?}");
    assert!(fitted.epochs.iter().all(|e| e.choose_loss >= chosen.choose_loss));
}
