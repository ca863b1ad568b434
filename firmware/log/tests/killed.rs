//! A process that is killed leaves a log that can be read.

mod common;

use common::{Draw, bits, drawn, lockstep};
use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Command, Stdio};
use vigil_log::{LogEnd, LogPlace, Reader, Recorder, RecoverError, recover_until};

const CHILD: &str = "VIGIL_LOG_KILLED_CHILD";
const FLUSHED: &str = "flushed ";

/// Not a test of its own: the process that is killed is this test binary, run again with a path to record to.
#[test]
fn the_process_that_is_killed() {
    let Some(path) = std::env::var_os(CHILD) else { return };
    let mut recorder = Recorder::start(lockstep(LogPlace::File(PathBuf::from(path)))).unwrap();
    for step in 0..3000 {
        assert!(recorder.record(|slot| Draw(step).record(step, step * 50_000_000, slot)));
        println!("\n{FLUSHED}{}", recorder.flushed());
    }
    panic!("it was not killed in time");
}

#[test]
fn a_killed_process_leaves_a_log_that_is_read_up_to_the_last_flush() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("flight.mcap");
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "the_process_that_is_killed", "--nocapture"])
        .env(CHILD, &path)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let flushed = BufReader::new(child.stdout.take().unwrap())
        .lines()
        .filter_map(|line| line.unwrap().strip_prefix(FLUSHED)?.parse::<u64>().ok())
        .find(|flushed| *flushed >= 60)
        .unwrap();
    child.kill().unwrap();
    child.wait().unwrap();

    let mut reader = Reader::open(&path).unwrap();
    let mut recovered = 0;
    for record in reader.by_ref() {
        assert!(bits(&record.unwrap()) == bits(&drawn(recovered)), "step {recovered}");
        recovered += 1;
    }
    assert!(recovered >= flushed, "{recovered} recovered, {flushed} were flushed");
    assert_eq!(reader.end(), Some(LogEnd::Interrupted { records: recovered }));
    let note = reader.end().unwrap().to_string();
    assert!(
        note.contains("not closed") && note.contains(&recovered.to_string()),
        "{note}"
    );
    // Whoever stops its recovery finds nothing of it.
    let copies = tempfile::tempdir().unwrap();
    let copy = |stop: bool| recover_until(&path, &copies.path().join("copy.mcap"), &stop.into());
    assert!(matches!(copy(true), Err(RecoverError::Interrupted)));
    assert_eq!(std::fs::read_dir(copies.path()).unwrap().count(), 0);
    assert_eq!(copy(false).unwrap().records, recovered);
    // The tlog is cut at most within its last packet.
    assert!(std::fs::metadata(path.with_extension("tlog")).unwrap().len() > 0);
}
