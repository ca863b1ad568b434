//! LSTM-AD against its definition in float64, and its file.

#[path = "../../firmware/nnet/tests/common/mod.rs"]
mod common;
#[path = "../../firmware/nnet/tests/counting/mod.rs"]
mod counting;

use common::{dense, lstm, rng, uniform, wide};
use counting::allocations;
use vigil_detector::{FrozenDetector, LstmAd, Of, ROW, ROW_LIMIT, WINDOW, normalise};
use vigil_nnet::{Activation, Dense, Isa, Lstm};

fn param_len() -> usize {
    LstmAd::tensors().iter().map(|(_, s)| s.iter().product::<usize>()).sum()
}

fn window(seed: u64) -> [[f32; ROW]; WINDOW] {
    let values = uniform(&mut rng(seed), WINDOW * ROW, 2.0);
    core::array::from_fn(|i| *values[i * ROW..].first_chunk().unwrap())
}

/// docs/paper.md's LSTM-AD, written plainly.
fn oracle(params: &[f32], rows: &[[f32; ROW]; WINDOW]) -> f64 {
    let params = wide(params);
    let layer = Lstm {
        inputs: 48,
        hidden: 100,
        cell: Activation::Relu,
    };
    let (own, mut rest) = params.split_at(48 * 400 + 100 * 400 + 400);
    let mut state = vec![0.0; 200];
    for row in rows {
        state = lstm(layer, own, &wide(row), &state);
    }
    let mut x = state[..100].to_vec();
    let hidden = [64, 32, 16].map(|outputs| (outputs, Activation::Relu));
    for (outputs, curve) in hidden.into_iter().chain([(1, Activation::Sigmoid)]) {
        let layer = Dense::new(x.len(), outputs);
        let (own, after) = rest.split_at(layer.inputs * outputs + outputs);
        x = dense(layer, curve, own, &x);
        rest = after;
    }
    assert!(rest.is_empty());
    x[0]
}

#[test]
fn the_score_is_the_papers_network_in_float64() {
    let params = uniform(&mut rng(1), param_len(), 0.2);
    let mut seen = Vec::new();
    for isa in Isa::available() {
        let mut detector = LstmAd::new(isa, &params).unwrap();
        for seed in 10..20 {
            let (got, want) = (detector.score(&window(seed)).unwrap(), oracle(&params, &window(seed)));
            assert!(
                (f64::from(got) - want).abs() < 1e-5,
                "{}: {got} is not {want}",
                isa.name()
            );
            seen.push(got);
        }
    }
    let spread = seen.iter().fold(0.0f32, |m, s| m.max((s - seen[0]).abs()));
    assert!(spread > 1e-2, "the score depends on the window: {seen:?}");
}

#[test]
fn the_order_of_the_rows_matters() {
    let params = uniform(&mut rng(1), param_len(), 0.2);
    let mut detector = LstmAd::new(Isa::detect(), &params).unwrap();
    let (forward, mut backward) = (window(3), window(3));
    backward.reverse();
    assert_ne!(detector.score(&forward).unwrap(), detector.score(&backward).unwrap());
}

#[test]
fn scoring_does_not_allocate_and_a_row_that_is_not_a_number_gives_no_score() {
    let mut detector = LstmAd::new(Isa::detect(), &uniform(&mut rng(1), param_len(), 0.1)).unwrap();
    let rows = window(5);
    let before = allocations();
    let score = detector.score(&rows).unwrap();
    assert_eq!(allocations(), before);
    assert!((0.0..=1.0).contains(&score));
    for at in [0, WINDOW - 1] {
        let mut rows = window(5);
        rows[at][7] = f32::NAN;
        assert!(detector.score(&rows).unwrap().is_nan(), "row {at}");
    }
    assert!(LstmAd::new(Isa::detect(), &[0.0; 3]).is_err());
}

#[test]
fn rows_are_shifted_scaled_and_limited() {
    let (mut phi, mut centre, mut scale) = ([0.0; ROW], [0.0; ROW], [1.0; ROW]);
    (phi[0], centre[0], scale[0]) = (3.0, 1.0, 4.0);
    (phi[1], scale[1]) = (-5.0, 0.01);
    phi[2] = f32::NAN;
    let row = normalise(&phi, &centre, &scale);
    assert_eq!(row[..2], [0.5, -ROW_LIMIT]);
    assert!(row[2].is_nan(), "what is not a number must not become one");
    assert_eq!(row[3..], [0.0; ROW - 3]);
}

fn frozen() -> FrozenDetector {
    let values = uniform(&mut rng(9), 4 * ROW, 1.0);
    let row = |i: usize| *values[i * ROW..].first_chunk().unwrap();
    FrozenDetector {
        of: Of::Actor,
        actor_sha256: "ab12".to_owned(),
        backgrounds: vec![
            (row(0).to_vec(), [0.5, -0.25, 0.1, 0.0, 0.3, 0.0, 0.7, -0.2].into()),
            (row(1).to_vec(), [0.125, 1.0, 0.0, -0.4, 0.0, 0.2, 0.0, 0.9].into()),
        ],
        centre: row(2),
        scale: row(3).map(|x: f32| x.abs() + 0.1),
        threshold: 0.5,
        threshold_choice: "fixed".to_owned(),
        params: uniform(&mut rng(2), param_len(), 0.1),
        training_config: "epochs = 3\n".to_owned(),
        seed: 7,
        git_commit: Some("c0ffee".to_owned()),
    }
}

#[test]
fn a_detector_comes_back_from_its_file_unaltered() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("detector.safetensors");
    // Of an imported policy's split point with another width too.
    let states = (0..4).map(|i| (vec![0.1 * i as f32; 300], [0.5, 0.1].into()));
    let imported = FrozenDetector {
        of: Of::Imported,
        backgrounds: states.collect(),
        ..frozen()
    };
    for detector in [imported, frozen()] {
        detector.save(&path).unwrap();
        assert_eq!(FrozenDetector::load(&path).unwrap(), detector);
    }
    assert!(std::fs::metadata(&path).unwrap().len() <= 1 << 20, "at most 1 MB");
}

#[test]
fn detectors_that_cannot_judge_are_not_written() {
    let refused = |change: fn(&mut FrozenDetector)| {
        let mut detector = frozen();
        change(&mut detector);
        detector.to_bytes().unwrap_err().to_string()
    };
    assert!(refused(|d| d.backgrounds.clear()).contains("empty background"));
    assert!(refused(|d| d.scale[4] = 0.0).contains("`scale`"));
    assert!(refused(|d| d.threshold = f32::NAN).contains("`threshold`"));
    assert!(refused(|d| d.params[9] = f32::INFINITY).contains("lstm.input_weight"));
    assert!(refused(|d| d.params.truncate(9)).contains("9 values"));
}

#[test]
fn another_programs_file_is_refused_by_what_differs() {
    let refused = |file: &str, bytes: &[u8], parts: &[&str]| {
        let refused = FrozenDetector::from_bytes(file, bytes).unwrap_err().to_string();
        for part in parts {
            assert!(refused.contains(part), "{part}: {refused}");
        }
    };
    let mut other = frozen().to_bytes().unwrap();
    let header = b"vigil detector 2";
    let at = other.windows(header.len()).position(|w| w == header).unwrap();
    other[at + header.len() - 1] = b'9';
    refused("mine", &other, &["vigil detector 9", "vigil detector 2"]);
    // The format before is named with the version that flies it.
    other[at + header.len() - 1] = b'1';
    let parts = ["mine", "vigil detector 1", "Vigil 0.2.0 flies it", "train"];
    refused("mine", &other, &parts);
    // The actor's own file: safetensors too, but no detector.
    let actor = include_bytes!("../../firmware/policy/actor/actor.safetensors");
    let file = "actor.safetensors";
    refused(file, actor, &[file, "vigil actor 2"]);
}
