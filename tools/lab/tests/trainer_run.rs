//! Whole runs, small ones.

use anyhow::Result;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use vigil_lab::trainer::config::LearnConfig;
use vigil_lab::trainer::run::{LearnEnd, LearnOptions, Progress, Row, csv, learn};
use vigil_policy::actor::ActorSpec;
use vigil_sim::world::Family;

/// Flights end, are cut off and push old ones out of the memory; 1 000 updates make a row of the curve and an evaluation.
fn small() -> LearnConfig {
    let mut config = LearnConfig {
        families: vec![Family::Training, Family::Hard],
        decisions: 1_180,
        warm_up: 180,
        environments: 4,
        time_limit_s: 6.0,
        apf_share: 0.5,
        drift_share: 0.5,
        drawn_vehicle_share: 0.5,
        ..LearnConfig::default()
    };
    config.learning.batch = 4;
    config.learning.decisions_per_update = 1;
    config.learning.critic_units = [16, 16];
    config.replay.decisions = 600;
    config.replay.alpha = 0.6;
    config.evaluation.every_updates = 500;
    config.evaluation.flights = 1;
    config.evaluation.final_flights = 1;
    config.evaluation.time_limit_s = 2.0;
    config
}

fn options(folder: &Path, resume: bool) -> LearnOptions {
    // Of nobody's learning: what it shows is a pattern all the same.
    let encoder = (0..ActorSpec::FULL.encoder_len())
        .map(|i| 0.1 * (i as f32 * 1.7).sin())
        .collect();
    LearnOptions {
        folder: folder.to_owned(),
        resume,
        encoder: Some(encoder),
        test_flights: 1,
    }
}

/// What becomes of a run in this folder that nothing stops.
fn unstopped(config: &LearnConfig, folder: &Path, resume: bool) -> Result<LearnEnd> {
    learn(config, &options(folder, resume), &AtomicBool::new(false), &mut |_| {})
}

fn complete(end: LearnEnd) -> Vec<f32> {
    match end {
        LearnEnd::Complete(actor, result) => {
            assert_eq!(
                result.test.len(),
                9,
                "three families, each as it is, blind and without memory"
            );
            actor.params
        }
        LearnEnd::Interrupted(_) => panic!("it was not interrupted"),
    }
}

#[test]
fn a_run_that_was_interrupted_ends_as_one_that_was_not_whatever_its_threads() {
    let folder = tempfile::tempdir().unwrap();
    let whole = folder.path().join("whole");
    let mut rows = 0;
    let (config, given, never) = (small(), options(&whole, false), AtomicBool::new(false));
    let end = learn(&config, &given, &never, &mut |progress| {
        rows += usize::from(matches!(progress, Progress::Row(..)));
    });
    let expected = complete(end.unwrap());
    assert_eq!(rows, 2);

    let parts = folder.path().join("parts");
    let stop = AtomicBool::new(false);
    let end = learn(&small(), &options(&parts, false), &stop, &mut |progress| {
        // In the middle, while flights last.
        if let Progress::Row(row, _) = progress {
            stop.store(row.updates == 500, Ordering::Relaxed);
            let second = unstopped(&small(), &parts, true).unwrap_err().to_string();
            assert!(second.contains("another `vigil learn` trains in"), "{second}");
        }
    });
    assert!(matches!(end.unwrap(), LearnEnd::Interrupted(Some(path)) if path.exists()));
    let two = LearnConfig { threads: 2, ..small() };
    let end = unstopped(&two, &parts, true);
    assert!(complete(end.unwrap()) == expected, "the same bits");
    for file in ["curves.csv", "flights.csv"] {
        let lines = |folder: &Path| {
            let text = std::fs::read_to_string(folder.join(file)).unwrap();
            // The time of the curve's rows differs.
            text.lines()
                .map(|line| line.split(',').take(2).collect::<Vec<_>>().join(","))
                .collect::<Vec<_>>()
        };
        assert_eq!(lines(&whole), lines(&parts), "{file}");
    }

    let without_flights = csv(&[Row::default()]);
    assert!(without_flights.ends_with("\n0,0,0.0,0,0,,0.00000,0.0000,0.0000,0.0000,0.00000\n"));

    // Stopped while the end is tested, it is tested when it goes on; until then it is not complete.
    assert!(parts.join("result.json").exists() && parts.join("actor.safetensors").exists());
    let stopped = learn(&two, &options(&parts, true), &AtomicBool::new(true), &mut |_| {});
    assert!(matches!(stopped.unwrap(), LearnEnd::Interrupted(Some(_))));
    assert!(!parts.join("result.json").exists());

    // It goes on for longer, over other courses, and every flight is in the table.
    let mut longer = LearnConfig {
        decisions: 1_280,
        families: vec![Family::Hard],
        ..small()
    };
    longer.evaluation.families = vec![Family::Training];
    let end = unstopped(&longer, &parts, true);
    let LearnEnd::Complete(_, result) = end.unwrap() else {
        panic!("it was not interrupted")
    };
    assert_eq!(result.decisions, longer.decisions);
    let flights = std::fs::read_to_string(parts.join("flights.csv")).unwrap();
    assert_eq!(flights.lines().count(), 1 + result.flights);

    // Another configuration cannot go on with it, and no run begins where one is.
    let other = LearnConfig { seed: 2, ..small() };
    let nowhere = folder.path().join("mistyped");
    assert!(unstopped(&longer, &nowhere, true).is_err() && !nowhere.exists());
    let refused = |config: &LearnConfig, resume| unstopped(config, &parts, resume).unwrap_err().to_string();
    assert!(refused(&other, true).contains("another configuration"));
    let fewer = refused(&small(), true);
    assert!(fewer.contains("is 1180") && fewer.contains("has made 1280"), "{fewer}");
    assert!(refused(&small(), false).contains("holds a run already"));
    let mut another = options(&parts, true);
    another.encoder = Some(Vec::new());
    let end = learn(&longer, &another, &AtomicBool::new(false), &mut |_| {});
    assert!(end.unwrap_err().to_string().contains("another encoder"));
    let checkpoint = parts.join("checkpoint.safetensors");
    let mut bytes = std::fs::read(&checkpoint).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&checkpoint, &bytes).unwrap();
    assert!(refused(&longer, true).contains("was altered"));
}

#[test]
fn who_is_stopped_while_the_encoder_is_taught_ends_and_keeps_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let from_nothing = LearnOptions {
        encoder: None,
        ..options(folder.path(), false)
    };
    let end = learn(&small(), &from_nothing, &AtomicBool::new(true), &mut |_| {});
    assert!(matches!(end.unwrap(), LearnEnd::Interrupted(None)));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}
