//! The monitor: one judgement per decision, unknown rather than wrong, and never of another actor.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use vigil_detector::{Background, FrozenDetector, LstmAd, Monitor, MonitorError, WINDOW, normalise};
use vigil_nnet::{Graph, Isa, Purpose};
use vigil_policy::actor::{ACTOR_HIDDEN, ActorSpec};
use vigil_types::{Judgement, Verdict};

const ACTOR: &str = "0123";

struct Bench {
    random: ChaCha8Rng,
    head: Graph,
    params: Vec<f32>,
    detector: FrozenDetector,
}

impl Bench {
    fn new() -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let head = ActorSpec::FULL.head_graph(Purpose::Gradients).unwrap();
        let mut draw = |n: usize| -> Vec<f32> { (0..n).map(|_| random.random_range(-0.3..0.3)).collect() };
        let params = draw(head.param_len());
        let detector = FrozenDetector {
            actor_sha256: ACTOR.to_owned(),
            backgrounds: Vec::new(),
            centre: [0.01; ACTOR_HIDDEN],
            scale: [0.05; ACTOR_HIDDEN],
            threshold: 0.5,
            threshold_choice: "for a test".to_owned(),
            params: draw(
                LstmAd::tensors()
                    .iter()
                    .map(|(_, shape)| shape.iter().product::<usize>())
                    .sum(),
            ),
            training_config: String::new(),
            seed: 7,
            git_commit: None,
        };
        let mut bench = Self {
            random,
            head,
            params,
            detector,
        };
        bench.detector.backgrounds = (0..30).map(|_| bench.state()).collect();
        bench
    }

    fn state(&mut self) -> Background {
        let mut draw = || self.random.random_range(-0.9..0.9);
        (
            core::array::from_fn(|_| draw()),
            core::array::from_fn::<_, 2, _>(|_| draw()).into(),
        )
    }

    fn monitor(&self) -> Monitor {
        Monitor::new(Isa::detect(), &self.params, ACTOR, &self.detector).unwrap()
    }

    /// The actor's own yaw output.
    fn yaw(&self, (state, position): &Background) -> f32 {
        let mut tape = vec![0.0; self.head.tape_len()];
        self.head
            .forward(Isa::detect(), &self.params, &[state, position], &mut tape)
            .unwrap();
        self.head.output(&tape).unwrap()[1]
    }
}

#[test]
fn the_contributions_add_up_to_what_the_actor_decided() {
    let mut bench = Bench::new();
    let mut monitor = bench.monitor();
    let backgrounds = bench.detector.backgrounds.clone();
    let mean = backgrounds.iter().map(|b| bench.yaw(b)).sum::<f32>() / backgrounds.len() as f32;
    for _ in 0..20 {
        let decision = bench.state();
        let j = monitor.judge(&decision.0, decision.1);
        assert!((j.base - mean).abs() < 1e-5);
        assert!((j.base + j.image + j.bearing + j.distance - bench.yaw(&decision)).abs() < 1e-5);
        assert!((j.image - j.phi.iter().sum::<f32>()).abs() < 1e-6);
    }
}

#[test]
fn the_verdict_is_the_network_s_on_the_last_ten_explanations_and_unknown_before() {
    let mut bench = Bench::new();
    let mut monitor = bench.monitor();
    let mut lstm = LstmAd::new(Isa::detect(), &bench.detector.params).unwrap();
    let mut rows = Vec::new();
    for step in 1..=3 * WINDOW {
        let (state, position) = bench.state();
        let judgement = monitor.judge(&state, position);
        rows.push(normalise(&judgement.phi, &bench.detector.centre, &bench.detector.scale));
        let Some(window) = rows.last_chunk::<WINDOW>() else {
            assert_eq!(
                (judgement.score, judgement.verdict),
                (None, Verdict::Unknown),
                "step {step}"
            );
            continue;
        };
        let score = lstm.score(window).unwrap();
        assert_eq!(judgement.score, Some(score));
        // The same score on both sides of the threshold.
        let mut again = |threshold| {
            let mut monitor = monitor.clone();
            monitor.reset();
            monitor.set_threshold(threshold);
            let mut last = Judgement::UNKNOWN;
            bench.random = ChaCha8Rng::seed_from_u64(99);
            for _ in 0..WINDOW {
                let (state, position) = bench.state();
                last = monitor.judge(&state, position);
            }
            last
        };
        if step == 3 * WINDOW {
            let score = again(0.5).score.unwrap();
            assert_eq!(again(score).verdict, Verdict::Clean, "attack is above the threshold");
            assert_eq!(again(score * 0.999).verdict, Verdict::Attack);
        }
    }
}

#[test]
fn an_explanation_that_is_not_finite_is_unknown_and_so_are_the_steps_until_the_window_is_whole_again() {
    let mut bench = Bench::new();
    let mut monitor = bench.monitor();
    let good = bench.state();
    for _ in 0..WINDOW {
        monitor.judge(&good.0, good.1);
    }
    assert_ne!(monitor.judge(&good.0, good.1).verdict, Verdict::Unknown);
    for bad in [f32::NAN, f32::INFINITY] {
        let mut state = good.0;
        state[5] = bad;
        let judgement = monitor.judge(&state, good.1);
        assert_eq!((judgement.verdict, judgement.score), (Verdict::Unknown, None));
        assert!(judgement.image.is_nan());
    }
    for _ in 1..WINDOW {
        assert_eq!(monitor.judge(&good.0, good.1).verdict, Verdict::Unknown);
    }
    assert_ne!(monitor.judge(&good.0, good.1).verdict, Verdict::Unknown);
}

#[test]
fn another_actor_s_detector_and_an_empty_background_are_refused() {
    let mut bench = Bench::new();
    let refused = |params: &[f32], sha256: &str, detector: &FrozenDetector| {
        Monitor::new(Isa::detect(), params, sha256, detector).unwrap_err()
    };
    let other = refused(&bench.params, "4567", &bench.detector);
    assert!(matches!(other, MonitorError::OtherActor { .. }));
    assert!(
        other.to_string().contains("0123") && other.to_string().contains("4567"),
        "{other}"
    );
    bench.detector.params.pop();
    assert!(matches!(
        refused(&bench.params, ACTOR, &bench.detector),
        MonitorError::Shape(_)
    ));
    bench.detector.backgrounds.clear();
    let empty = refused(&bench.params, ACTOR, &bench.detector);
    assert!(empty.to_string().contains("background sample is empty"), "{empty}");
}
