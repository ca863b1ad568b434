//! The monitor: one judgement per decision, unknown rather than wrong, and never of another actor.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use vigil_detector::{Background, FrozenDetector, LstmAd, Monitor, MonitorError, Of, WINDOW, normalise};
use vigil_nnet::{Isa, Purpose};
use vigil_policy::ExplainedHead;
use vigil_policy::actor::{ACTOR_HIDDEN, ActorSpec, LOW_DIM};
use vigil_policy::imported::Network;
use vigil_types::{Judgement, Verdict};

const ACTOR: &str = "0123";

struct Bench {
    random: ChaCha8Rng,
    /// An actor's second half.
    head: ExplainedHead,
    detector: FrozenDetector,
}

impl Bench {
    fn new() -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let graph = ActorSpec::FULL.head_graph(Purpose::Multipliers).unwrap();
        let mut draw = |n: usize| -> Vec<f32> { (0..n).map(|_| random.random_range(-0.3..0.3)).collect() };
        let params = draw(graph.param_len());
        let built_in = FrozenDetector::built_in().unwrap();
        let detector = FrozenDetector {
            actor_sha256: ACTOR.to_owned(),
            backgrounds: Vec::new(),
            centre: [0.01; ACTOR_HIDDEN],
            scale: [0.05; ACTOR_HIDDEN],
            threshold: 0.5,
            params: draw(built_in.params.len()),
            ..built_in
        };
        let mut bench = Self {
            random,
            head: ExplainedHead { graph, params },
            detector,
        };
        bench.detector.backgrounds = (0..30).map(|_| bench.state()).collect();
        bench
    }

    fn state(&mut self) -> Background {
        let mut draw = || self.random.random_range(-0.9..0.9);
        (
            (0..ACTOR_HIDDEN).map(|_| draw()).collect(),
            core::array::from_fn::<_, LOW_DIM, _>(|_| draw()).into(),
        )
    }

    fn monitor(&self) -> Monitor {
        Monitor::new(Isa::detect(), self.head.clone(), ACTOR, &self.detector).unwrap()
    }

    /// The actor's own yaw output.
    fn yaw(&self, decision: &Background) -> f32 {
        yaw_of(&self.head, decision)
    }
}

fn yaw_of(ExplainedHead { graph, params }: &ExplainedHead, (state, low_dim): &Background) -> f32 {
    let mut tape = vec![0.0; graph.tape_len()];
    graph
        .forward(Isa::detect(), params, &[state, low_dim], &mut tape)
        .unwrap();
    graph.output(&tape).unwrap()[1]
}

#[test]
fn the_contributions_add_up_to_what_the_actor_decided() {
    let mut bench = Bench::new();
    let mut monitor = bench.monitor();
    let backgrounds = bench.detector.backgrounds.clone();
    let mean = backgrounds.iter().map(|b| bench.yaw(b)).sum::<f32>() / backgrounds.len() as f32;
    for _ in 0..20 {
        let decision = bench.state();
        let j = monitor.score(&decision.0, decision.1);
        assert!((j.base - mean).abs() < 1e-5);
        assert!((j.yaw() - bench.yaw(&decision)).abs() < 1e-5);
        assert!((j.image - j.phi.iter().sum::<f32>()).abs() < 1e-6);
    }
}

/// Of the low-dimensional observation value 0 is the goal's distance, 1 and 2 its bearing, the others the vehicle's own motion.
#[test]
fn each_contribution_is_of_what_its_name_says() {
    let mut bench = Bench::new();
    let usual = bench.detector.backgrounds[0].clone();
    // Against a single background, what does not differ from it contributes nothing.
    bench.detector.backgrounds.truncate(1);
    let mut monitor = bench.monitor();
    for changed in 0..LOW_DIM {
        let mut low = <[f32; LOW_DIM]>::try_from(&*usual.1).unwrap();
        low[changed] += 0.5;
        let j = monitor.score(&usual.0, low);
        let named = [j.image, j.distance, j.bearing, j.told];
        let expected = match changed {
            0 => 1,
            1 | 2 => 2,
            _ => 3,
        };
        for (i, contribution) in named.into_iter().enumerate() {
            assert_eq!(contribution != 0.0, i == expected, "value {changed}: {named:?}");
        }
        let yaw = bench.yaw(&(usual.0.clone(), low.into()));
        assert!((j.yaw() - yaw).abs() < 1e-5);
    }
}

#[test]
fn the_verdict_is_the_network_s_on_the_last_ten_explanations_and_unknown_before() {
    let mut bench = Bench::new();
    let mut monitor = bench.monitor();
    let mut lstm = LstmAd::new(Isa::detect(), &bench.detector.params).unwrap();
    let mut rows = Vec::new();
    for step in 1..=3 * WINDOW {
        let (state, low_dim) = bench.state();
        let judgement = monitor.score(&state, low_dim);
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
                let (state, low_dim) = bench.state();
                last = monitor.score(&state, low_dim);
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
        monitor.score(&good.0, good.1);
    }
    assert_ne!(monitor.score(&good.0, good.1).verdict, Verdict::Unknown);
    for bad in [f32::NAN, f32::INFINITY] {
        let mut state = good.0.clone();
        state[5] = bad;
        let judgement = monitor.score(&state, good.1);
        assert_eq!((judgement.verdict, judgement.score), (Verdict::Unknown, None));
        assert!(judgement.image.is_nan());
    }
    for _ in 1..WINDOW {
        assert_eq!(monitor.score(&good.0, good.1).verdict, Verdict::Unknown);
    }
    assert_ne!(monitor.score(&good.0, good.1).verdict, Verdict::Unknown);
}

#[test]
fn another_actor_s_detector_and_an_empty_background_are_refused() {
    let mut bench = Bench::new();
    let head = bench.head.clone();
    let refused = |sha256: &str, detector: &FrozenDetector| {
        Monitor::new(Isa::detect(), head.clone(), sha256, detector).unwrap_err()
    };
    let other = refused("4567", &bench.detector);
    assert!(matches!(other, MonitorError::OtherActor { .. }));
    let words = other.to_string();
    assert!(words.contains("0123") && words.contains("4567"), "{words}");
    bench.detector.params.pop();
    let short = refused(ACTOR, &bench.detector);
    assert!(matches!(short, MonitorError::Shape(_)));
    bench.detector.backgrounds.clear();
    let empty = refused(ACTOR, &bench.detector);
    assert!(empty.to_string().contains("background sample is empty"), "{empty}");
}

/// What lies behind a split point of `width` values: a hidden layer, the goal beside it.
fn imported(random: &mut ChaCha8Rng, width: usize) -> ExplainedHead {
    let text = format!("input {width}\ninput 2\ndense 0 {width} 20 elu\nconcat 2 1\ndense 3 22 2 tanh*1.5\noutput 4\n");
    let graph = text.parse::<Network>().unwrap().graph(Purpose::Multipliers).unwrap();
    ExplainedHead {
        params: (0..graph.param_len()).map(|_| random.random_range(-0.3..0.3)).collect(),
        graph,
    }
}

#[test]
fn an_imported_policy_is_explained_at_as_many_values_as_its_split_point_has() {
    for width in [16, ACTOR_HIDDEN, 300] {
        let mut bench = Bench::new();
        let head = imported(&mut bench.random, width);
        let mut drawn = |n: usize| -> Vec<f32> { (0..n).map(|_| bench.random.random_range(-0.9..0.9)).collect() };
        let mut decision = || (drawn(width), [drawn(1)[0], 0.2].into());
        let backgrounds: Vec<Background> = (0..20).map(|_| decision()).collect();
        let detector = FrozenDetector {
            of: Of::Imported,
            backgrounds,
            ..bench.detector.clone()
        };
        let yaw = |made: &Background| yaw_of(&head, made);
        let mean = detector.backgrounds.iter().map(yaw).sum::<f32>() / 20.0;
        let mut monitor = Monitor::new(Isa::detect(), head.clone(), ACTOR, &detector).unwrap();
        for step in 1..=WINDOW {
            let made = decision();
            let j = monitor.score(&made.0, made.1);
            assert!((j.base - mean).abs() < 1e-5);
            assert!((j.yaw() - yaw(&made)).abs() < 1e-5, "{width} values");
            // What is scored and logged are 48 numbers: those, or sums of neighbours, or those and zeros.
            assert!((j.image - j.phi.iter().sum::<f32>()).abs() < 1e-5);
            assert_eq!(j.score.is_some(), step == WINDOW);
            if width < ACTOR_HIDDEN {
                assert_eq!(j.phi[width..], [0.0; ACTOR_HIDDEN][width..]);
            }
        }
        let short = monitor.score(&vec![0.0; width - 1], [0.5, 0.2]);
        assert_eq!(short.verdict, Verdict::Unknown, "a state of another length is no state");
        // The detector's states are not those of another policy's split point.
        let head = imported(&mut bench.random, width - 1);
        let refused = Monitor::new(Isa::detect(), head, ACTOR, &detector).unwrap_err();
        let words = refused.to_string();
        assert!(
            words.contains(&format!("{}", width - 1)) && words.contains(&format!("{width}")),
            "{words}"
        );
    }
}
