//! The quick part of the fault campaign: some hostile frames, a spoofed flight, a flood, a kill, a stop, an attack on signing, full disks.
//! `tests/faults/run` flies all of it.

use std::path::Path;
use std::process::Command;
use vigil_tests::{has, json, succeed};

/// Runs the program into a folder.
fn run(arguments: &str, folder: &Path) {
    let mut faults = Command::new(env!("CARGO_BIN_EXE_vigil-faults"));
    faults.args(arguments.split(' ')).arg("-o").arg(folder);
    succeed(&faults.output().expect("it starts"));
}

#[test]
fn the_quick_part_of_the_fault_campaign_ends_without_collision_crash_or_anything_wrong() {
    let folder = tempfile::tempdir().expect("a folder");
    run("campaign --quick --instance 70", folder.path());
    let table = std::fs::read_to_string(folder.path().join("faults.md")).expect("a table");
    has(&table, &["hostile frames", "setpoints of", "nothing can be written"]);
    has(&table, &["signing:", "strangers, UDP", "killed", "stopped"]);
}

#[test]
fn a_minute_of_endurance_gives_the_same_hash_twice() {
    let hash = || {
        let folder = tempfile::tempdir().expect("a folder");
        run("endurance lockstep 1m", folder.path());
        let record = json(&folder.path().join("endurance.json"));
        assert!(record["operator"]["goals"].as_u64() >= Some(1), "{record}");
        record["state_hash"].as_str().expect("a hash").to_owned()
    };
    assert_eq!(hash(), hash());
}
