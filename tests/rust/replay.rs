//! A flight's log holds everything: the tick run again over it gives the same bytes, and a changed byte is found.

use std::path::{Path, PathBuf};
use vigil_tests::{Running, copy_log, ended, only_log, run, run_line, said, succeed, text};
use vigil_types::Datagrams;

/// Flies a course in lockstep in two processes with a log; returns the log's path.
fn logged_flight(folder: &Path) -> PathBuf {
    let mut firmware = Running::start_line(&format!(
        "firmware --lockstep --instance 83 --engage auto --goal 12,3 --height 1.5 --log {}",
        text(folder)
    ));
    let simulator = run_line("sim --lockstep --airborne --instance 83 --seed 5 --family training");
    assert!(!simulator.stdout.is_empty(), "{}", said(&simulator));
    assert_eq!(firmware.wait(), Some(0));
    only_log(folder)
}

/// Flips the last bit of the last datagram's last byte.
fn change_one_bit(datagrams: &mut Datagrams) {
    let mut all: Vec<(u8, Vec<u8>)> = datagrams.iter().map(|(link, bytes)| (link, bytes.to_vec())).collect();
    *all.last_mut()
        .and_then(|(_, bytes)| bytes.last_mut())
        .expect("something was sent") ^= 1;
    datagrams.clear();
    for (link, bytes) in &all {
        assert!(datagrams.push(*link, bytes));
    }
}

#[test]
fn a_flight_is_replayed_byte_for_byte_and_one_changed_byte_is_found() {
    let folder = tempfile::tempdir().expect("a folder");
    let log = logged_flight(folder.path());
    succeed(&run(&["replay", text(&log)]));

    let altered = folder.path().join("altered.mcap");
    let (mut steps, mut engaged) = (0, false);
    copy_log(&log, &altered, |record| {
        assert_eq!(record.timing.step, steps, "no step is missing");
        assert!(record.frame().is_some(), "in lockstep every step has a new frame");
        steps += 1;
        engaged |= record.report.action.is_some();
        if record.timing.step == 60 {
            change_one_bit(&mut record.sent);
        }
    });
    assert!(steps > 100 && engaged);
    ended(&run(&["replay", text(&altered)]), 3, &["byte"]);
}
