//! Whole runs, small ones.

use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use sha2::{Digest, Sha256};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use vigil_policy::FrozenActor;
use vigil_tools::actor_training::{RunEnd, RunOptions, TrainConfig, run};

/// A folder that is removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("vigil-train-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// A run of 12 updates in which flights are cut off, begin anew, and push old ones out of the memory.
fn small() -> TrainConfig {
    let mut config = TrainConfig {
        decisions: 96,
        environments: 2,
        time_limit_s: 2.0,
        ..TrainConfig::default()
    };
    config.warm_up.decisions = 64;
    config.warm_up.updates = 4;
    config.learning.batch = 4;
    config.learning.imitation_updates = 20;
    config.replay.decisions = 60;
    config.evaluation.every_updates = 8;
    config.evaluation.flights = 1;
    config.evaluation.final_flights = 1;
    config.evaluation.time_limit_s = 1.0;
    config
}

fn train(config: &TrainConfig, folder: &Folder, resume: bool, stop_at: Option<u64>) -> RunEnd {
    let options = RunOptions {
        folder: folder.0.clone(),
        resume,
        git_commit: None,
        test_flights: 0,
    };
    let stop = AtomicBool::new(false);
    run(config, &options, &stop, &mut |progress| {
        if stop_at.is_some_and(|at| progress.decisions >= at) {
            stop.store(true, Ordering::Relaxed);
        }
    })
    .unwrap()
}

fn actor(folder: &Folder) -> FrozenActor {
    FrozenActor::load(&folder.0.join("actor.safetensors")).unwrap()
}

#[test]
fn an_interrupted_run_goes_on_exactly_where_it_was_on_any_number_of_threads() {
    let config = small();
    let (whole, parts) = (Folder::new("whole"), Folder::new("parts"));
    assert!(matches!(train(&config, &whole, false, None), RunEnd::Complete { .. }));
    assert!(matches!(
        train(&config, &parts, false, Some(76)),
        RunEnd::Interrupted(_)
    ));
    let on_two = TrainConfig {
        threads: 2,
        ..config.clone()
    };
    assert!(matches!(train(&on_two, &parts, true, Some(86)), RunEnd::Interrupted(_)));
    assert!(matches!(train(&config, &parts, true, None), RunEnd::Complete { .. }));
    assert!(actor(&whole) == actor(&parts));

    let threads = Folder::new("threads");
    let many = TrainConfig { threads: 3, ..config };
    train(&many, &threads, false, None);
    assert!(actor(&whole).params == actor(&threads).params);
    let text = std::fs::read_to_string(whole.0.join("curves.csv")).unwrap();
    assert!(text.starts_with("updates,decisions"), "{text}");
    let picture = std::fs::read(whole.0.join("curves.png")).unwrap();
    assert!(picture.starts_with(b"\x89PNG"));
}

#[test]
fn another_seed_is_another_run() {
    let mut config = small();
    config.decisions = 72;
    let (one, two) = (Folder::new("one"), Folder::new("two"));
    train(&config, &one, false, None);
    config.seed = 2;
    train(&config, &two, false, None);
    assert!(actor(&one).params != actor(&two).params);
    assert_eq!(actor(&two).seed, 2);
}

/// A checkpoint with another state and a digest that is right.
fn sealed_again(checkpoint: &[u8], edit: impl Fn(&mut serde_json::Value)) -> Vec<u8> {
    let (_, header) = SafeTensors::read_metadata(checkpoint).unwrap();
    let mut metadata = header.metadata().clone().unwrap();
    let file = SafeTensors::deserialize(checkpoint).unwrap();
    let mut state = serde_json::from_slice(file.tensor("state").unwrap().data()).unwrap();
    edit(&mut state);
    let state = serde_json::to_vec(&state).unwrap();
    let view = TensorView::new(Dtype::U8, vec![state.len()], &state).unwrap();
    let mut tensors: Vec<(String, TensorView<'_>)> = file.tensors();
    tensors.retain(|(name, _)| name != "state");
    tensors.push(("state".to_owned(), view));
    tensors.sort_by(|(a, _), (b, _)| a.cmp(b));
    let mut hash = Sha256::new();
    for (name, view) in &tensors {
        let kind = format!("{:?}", view.dtype());
        for part in [name.as_bytes(), &[0], kind.as_bytes(), &[0], view.data()] {
            hash.update(part);
        }
    }
    let digest = hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
    metadata.insert("sha256".to_owned(), digest);
    safetensors::serialize(tensors, Some(metadata)).unwrap()
}

#[test]
fn what_cannot_be_resumed_is_refused_and_left_as_it_is() {
    let config = small();
    let folder = Folder::new("refused");
    let refused = |config: &TrainConfig, resume: bool, why: &str| {
        let options = RunOptions {
            folder: folder.0.clone(),
            resume,
            git_commit: None,
            test_flights: 0,
        };
        let error = run(config, &options, &AtomicBool::new(false), &mut |_| {})
            .unwrap_err()
            .to_string();
        assert!(error.contains(why), "{error}");
    };
    refused(&config, true, "cannot read checkpoint");
    assert!(matches!(
        train(&config, &folder, false, Some(66)),
        RunEnd::Interrupted(_)
    ));
    let path = folder.0.join("checkpoint.safetensors");
    let good = std::fs::read(&path).unwrap();
    refused(&config, false, "holds a run already");
    let mut other = config.clone();
    other.learning.gamma = 0.9;
    refused(&other, true, "another configuration");
    let kept = std::fs::read_to_string(folder.0.join("config.toml")).unwrap();
    assert_eq!(kept, config.to_toml(), "the run keeps its own configuration");
    std::fs::write(&path, &good[..good.len() / 2]).unwrap();
    refused(&config, true, "truncated");
    // One bit anywhere, in weights, numbers of the run or the list of what is where.
    for part in 1..12 {
        let mut bad = good.clone();
        let at = good.len() * part / 12;
        bad[at] ^= 0x10;
        std::fs::write(&path, bad).unwrap();
        refused(&config, true, "checkpoint.safetensors");
    }
    // A list that was emptied, sealed again by whoever did it.
    let emptied: [(&str, &str); 5] = [
        ("/lanes", "another number of environments"),
        ("/collectors", "another number of environments"),
        ("/lanes/0/records", "do not belong together"),
        ("/lanes/1/episodes", "a flight that lasts"),
        ("/lanes/0/records/0/newest_frame", "frames that were not taken"),
    ];
    for (place, why) in emptied {
        let edit = |state: &mut serde_json::Value| {
            let value = state.pointer_mut(place).expect("the place is in the state");
            *value = match value.is_array() {
                true => serde_json::json!([]),
                false => serde_json::json!(u64::MAX),
            };
        };
        std::fs::write(&path, sealed_again(&good, edit)).unwrap();
        refused(&config, true, why);
    }
    // A directory in the place of a file stands for a disk that takes no more.
    std::fs::write(&path, &good).unwrap();
    std::fs::remove_file(folder.0.join("config.toml")).unwrap();
    std::fs::create_dir(folder.0.join("config.toml")).unwrap();
    refused(&config, true, "is kept as it was");
    assert!(std::fs::read(&path).unwrap() == good);
}
