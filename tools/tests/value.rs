//! Whole runs by value, small ones.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use vigil_policy::actor::FRAMES_SPREAD;
use vigil_policy::{ActorInputs, FrozenActor, LedBy};
use vigil_tools::actor_training::value::{
    Expert, Leader, Sees, Teacher, ValueConfig, ValueEnd, ValueOptions, ValueProgress, run_value,
};
use vigil_world::Family;

/// A folder that is removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("vigil-value-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        Self(path)
    }

    fn bytes(&self, file: &str) -> Vec<u8> {
        std::fs::read(self.0.join(file)).unwrap()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Flights end, are cut off and push old ones out of the memory; 1 000 updates make two rows of the curve.
fn small(sees: Sees) -> ValueConfig {
    let mut config = ValueConfig {
        sees,
        led_by: Leader::Path,
        told_of_movers: true,
        teacher: match sees {
            Sees::Truth => Teacher::Expert,
            Sees::Pictures => Teacher::Geometric,
        },
        families: vec![Family::Training, Family::Hard],
        decisions: 620,
        warm_up: 120,
        environments: 2,
        time_limit_s: 6.0,
        apf_share: 0.5,
        ..ValueConfig::default()
    };
    if sees == Sees::Pictures {
        config.learning.imitation = 0.5;
        config.learning.critics_told = true;
    }
    config.learning.batch = 4;
    config.learning.decisions_per_update = if sees == Sees::Truth { 1 } else { 10 };
    config.learning.critic_units = [16, 16];
    config.learning.actor_units = [16, 16];
    config.replay.decisions = 300;
    config.replay.alpha = 0.6;
    config.evaluation.every_updates = if sees == Sees::Truth { 250 } else { 25 };
    config.evaluation.flights = 1;
    config.evaluation.families = vec![Family::Training];
    config.evaluation.time_limit_s = 2.0;
    config.evaluation.slope_states = 1;
    config.encoder.frames = 8;
    config.encoder.updates = 2;
    config.encoder.batch = 4;
    config
}

fn options(folder: &Folder) -> ValueOptions {
    ValueOptions {
        folder: folder.0.clone(),
        resume: false,
        expert: None,
        encoder_of: None,
        from: None,
        git_commit: None,
        test_flights: 0,
    }
}

fn train(config: &ValueConfig, options: &ValueOptions, stop_at_row: Option<u64>) -> ValueEnd {
    let stop = AtomicBool::new(false);
    run_value(config, options, &stop, &mut |progress| {
        if let (ValueProgress::Row(row, _), Some(at)) = (progress, stop_at_row)
            && row.updates >= at
        {
            stop.store(true, Ordering::Relaxed);
        }
    })
    .unwrap()
}

fn resumed(config: &ValueConfig, file: &str, stop_at: u64) {
    let (whole, parts) = (
        Folder::new(&format!("whole-{file}")),
        Folder::new(&format!("parts-{file}")),
    );
    assert!(matches!(train(config, &options(&whole), None), ValueEnd::Complete(..)));
    assert!(matches!(
        train(config, &options(&parts), Some(stop_at)),
        ValueEnd::Interrupted(_)
    ));
    let on_two = ValueConfig {
        threads: 2,
        ..config.clone()
    };
    let again = ValueOptions {
        resume: true,
        ..options(&parts)
    };
    let ValueEnd::Complete(path, result) = train(&on_two, &again, None) else {
        panic!("not complete");
    };
    assert_eq!(path, parts.0.join(file));
    assert_eq!(
        result.updates,
        config.decisions.saturating_sub(config.warm_up) / config.learning.decisions_per_update
    );
    assert!(parts.bytes(file).len() > 1000);
    let curve = String::from_utf8(whole.bytes("curves.csv")).unwrap();
    assert!(
        curve.starts_with("updates,decisions") && curve.lines().count() >= 3,
        "{curve}"
    );
    // All but the time it took.
    let columns = |text: &[u8]| -> Vec<String> {
        String::from_utf8_lossy(text)
            .lines()
            .map(|l| {
                l.split(',')
                    .enumerate()
                    .filter(|(i, _)| *i != 2)
                    .map(|(_, c)| c)
                    .collect::<Vec<_>>()
                    .join(",")
            })
            .collect()
    };
    assert_eq!(columns(curve.as_bytes()), columns(&parts.bytes("curves.csv")));
    let flights = String::from_utf8(whole.bytes("flights.csv")).unwrap();
    assert!(flights.lines().count() > 3, "{flights}");
    assert_eq!(flights.into_bytes(), parts.bytes("flights.csv"));
    if file == "actor.safetensors" {
        let (one, two) = [&whole, &parts]
            .map(|f| FrozenActor::load(&f.0.join(file)).unwrap())
            .into();
        assert!(one.params == two.params && one.params.iter().all(|p| p.is_finite()));
        let inputs = ActorInputs {
            frame_ages: FRAMES_SPREAD,
            led_by: LedBy::Path,
            told_of_movers: true,
        };
        assert_eq!((one.inputs, two.inputs), (inputs, inputs));
    } else {
        let (one, two) = [&whole, &parts].map(|f| Expert::load(&f.0.join(file)).unwrap()).into();
        assert!(one == two);
    }
}

#[test]
fn an_experts_run_goes_on_exactly_where_it_was_on_any_number_of_threads() {
    resumed(&small(Sees::Truth), "expert.safetensors", 250);
}

#[test]
fn a_pictures_actors_run_goes_on_exactly_where_it_was() {
    resumed(&small(Sees::Pictures), "actor.safetensors", 25);
}

#[test]
fn what_cannot_be_run_is_refused_by_name() {
    let folder = Folder::new("refused");
    let refused = |config: &ValueConfig, options: &ValueOptions, why: &str| {
        let error = run_value(config, options, &AtomicBool::new(false), &mut |_| {})
            .unwrap_err()
            .to_string();
        assert!(error.contains(why), "{error}");
    };
    let mut config = small(Sees::Truth);
    config.learning.imitation = 1.0;
    refused(&config, &options(&folder), "--expert");
    config.learning.imitation = 0.0;
    let resume = ValueOptions {
        resume: true,
        ..options(&folder)
    };
    refused(&config, &resume, "cannot read checkpoint");
    train(&config, &options(&folder), Some(250));
    refused(&config, &options(&folder), "holds a run already");
    let other = ValueConfig {
        seed: 2,
        ..config.clone()
    };
    refused(&other, &resume, "another configuration");
    let path = folder.0.join("checkpoint.safetensors");
    let good = folder.bytes("checkpoint.safetensors");
    std::fs::write(&path, &good[..good.len() / 2]).unwrap();
    refused(&config, &resume, "truncated");
    // One bit in the middle of what was learned.
    let mut altered = good.clone();
    altered[good.len() / 2] ^= 1;
    std::fs::write(&path, &altered).unwrap();
    refused(&config, &resume, "was altered");
}
