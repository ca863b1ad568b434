//! What is recorded is what is read, bit for bit.

mod common;

use common::{Draw, bits, drawn, info, lockstep, recorded};
use proptest::prelude::*;
use vigil_log::{LogEnd, LogPlace, Reader, Recorder, RecorderConfig, StartError, TickRecord};
use vigil_types::{Choice, LogContent};

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_step_survives_the_file_bit_for_bit(seed: u64, steps in 1_u64..5, now_ns in 0..u64::MAX / 2) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("flight.mcap");
        let mut recorder = Recorder::start(lockstep(LogPlace::File(path.clone()))).unwrap();
        let mut draw = Draw(seed);
        let mut expected = Vec::new();
        for step in 0..steps {
            let recorded = recorder.record(|slot| {
                draw.record(step, now_ns, slot);
                expected.push(bits(slot));
            });
            prop_assert!(recorded);
        }
        let summary = recorder.finish();
        prop_assert_eq!(summary.failure, None);
        prop_assert_eq!((summary.records, summary.dropped), (steps, 0));

        let mut reader = Reader::open(&path).unwrap();
        prop_assert_eq!(reader.info(), &info());
        let read: Vec<_> = reader.by_ref().map(|r| bits(&r.unwrap())).collect();
        prop_assert!(read == expected, "bits differ");
        prop_assert_eq!(reader.end(), Some(LogEnd::Closed { dropped: 0 }));
    }
}

#[test]
fn a_slot_keeps_nothing_of_the_step_before() {
    let mut record: Box<TickRecord> = Box::default();
    // Steps whose draws have a frame and steps whose draws have none, in one slot.
    let frames: Vec<bool> = (0..8)
        .map(|step| {
            Draw(step).record(step, step * 50_000_000, &mut record);
            assert!(bits(&record) == bits(&drawn(step)), "step {step}");
            record.frame().is_some()
        })
        .collect();
    assert!(frames.contains(&true) && frames.contains(&false));
}

#[test]
fn the_same_flight_in_lockstep_gives_the_same_file() {
    let dir = tempfile::tempdir().unwrap();
    let files = ["a.mcap", "b.mcap"].map(|name| {
        let summary = recorded(lockstep(LogPlace::File(dir.path().join(name))), 50);
        let log = std::fs::read(&summary.path).unwrap();
        assert_eq!(summary.bytes, log.len() as u64);
        log
    });
    assert!(files[0] == files[1]);
}

#[test]
fn a_log_holds_what_was_asked_for_and_no_more() {
    let dir = tempfile::tempdir().unwrap();
    let mut sizes = Vec::new();
    for content in [LogContent::Everything, LogContent::Replay, LogContent::Light] {
        let path = dir.path().join(format!("{}.mcap", content.name()));
        let config = RecorderConfig {
            content,
            ..lockstep(LogPlace::File(path.clone()))
        };
        sizes.push(recorded(config, 40).bytes);
        let mut frames = 0;
        for (step, read) in (0..).zip(Reader::open(&path).unwrap()) {
            let (read, mut expected) = (read.unwrap(), drawn(step));
            frames += usize::from(read.frame().is_some());
            if content == LogContent::Light {
                expected.set_frame(None);
            }
            assert!(bits(&read) == bits(&expected), "step {step} of {}", content.name());
        }
        assert_eq!(frames == 0, content == LogContent::Light, "{frames} frames");
    }
    assert!(sizes[0] > sizes[1] && sizes[1] > 2 * sizes[2], "{sizes:?}");
}

#[test]
fn a_dropped_handle_closes_the_log() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("flight.mcap");
    let mut recorder = Recorder::start(lockstep(LogPlace::File(path.clone()))).unwrap();
    assert!(recorder.record(|slot| Draw(0).record(0, 0, slot)));
    drop(recorder);
    let mut reader = Reader::open(&path).unwrap();
    assert_eq!(reader.by_ref().count(), 1);
    assert_eq!(reader.end(), Some(LogEnd::Closed { dropped: 0 }));
}

#[test]
fn a_directory_numbers_its_flights_and_an_existing_log_is_never_touched() {
    let dir = tempfile::tempdir().unwrap();
    let runs = dir.path().join("not/yet/there");
    let place = LogPlace::Directory(runs.clone());
    for number in 1..=3 {
        let summary = Recorder::start(lockstep(place.clone())).unwrap().finish();
        assert_eq!(summary.path, runs.join(format!("flight-000{number}.mcap")));
        assert!(summary.path.with_extension("tlog").exists());
    }
    // A tlog whose log was deleted still takes its number.
    std::fs::write(runs.join("flight-0007.tlog"), "").unwrap();
    let summary = Recorder::start(lockstep(place)).unwrap().finish();
    assert_eq!(summary.path, runs.join("flight-0008.mcap"));

    let taken = runs.join("flight-0001.mcap");
    let before = std::fs::read(&taken).unwrap();
    let error = Recorder::start(lockstep(LogPlace::File(taken.clone()))).unwrap_err();
    assert!(matches!(error, StartError::Exists { .. }), "{error}");
    assert!(std::fs::read(&taken).unwrap() == before);

    // The same when only the tlog is there: nothing is left behind.
    std::fs::write(runs.join("other.tlog"), "kept").unwrap();
    let error = Recorder::start(lockstep(LogPlace::File(runs.join("other.mcap")))).unwrap_err();
    assert!(matches!(error, StartError::Exists { .. }), "{error}");
    assert!(!runs.join("other.mcap").exists());
    assert_eq!(std::fs::read(runs.join("other.tlog")).unwrap(), b"kept");
}

#[test]
fn a_place_that_cannot_be_written_is_named_at_start() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("file");
    std::fs::write(&file, "").unwrap();
    let error = Recorder::start(lockstep(LogPlace::Directory(file.join("runs")))).unwrap_err();
    assert!(matches!(error, StartError::Directory(_)));
    assert!(error.to_string().contains("file"), "{error}");
    let error = Recorder::start(lockstep(LogPlace::File(dir.path().join("none/flight.mcap")))).unwrap_err();
    assert!(matches!(error, StartError::Create(_)), "{error}");
}
