//! The quick part of the fault campaign: some hostile frames, a spoofed flight, a flood, a kill, a stop, an attack on signing, full disks.
//! `tests/faults/run` flies all of it.

use std::process::Command;

#[test]
fn the_quick_part_of_the_fault_campaign_ends_without_collision_crash_or_anything_wrong() {
    let folder = tempfile::tempdir().expect("a folder");
    let campaign = Command::new(env!("CARGO_BIN_EXE_vigil-faults"))
        .args(["campaign", "--quick", "--instance", "70", "-o"])
        .arg(folder.path())
        .output()
        .expect("it starts");
    let said = vigil_tests::said(&campaign);
    assert_eq!(campaign.status.code(), Some(0), "{said}");
    let table = std::fs::read_to_string(folder.path().join("faults.md")).expect("a table");
    for kind in [
        "hostile frames",
        "setpoints of",
        "nothing can be written",
        "signing:",
        "strangers, UDP",
        "killed",
        "stopped",
    ] {
        assert!(table.contains(kind), "{kind} is missing: {table}");
    }
}

#[test]
fn a_minute_of_endurance_gives_the_same_hash_twice() {
    let hash = || {
        let folder = tempfile::tempdir().expect("a folder");
        let flown = Command::new(env!("CARGO_BIN_EXE_vigil-faults"))
            .args(["endurance", "lockstep", "1m", "-o"])
            .arg(folder.path())
            .output()
            .expect("it starts");
        assert_eq!(flown.status.code(), Some(0), "{}", vigil_tests::said(&flown));
        let record = std::fs::read_to_string(folder.path().join("endurance.json")).expect("a record");
        let record: serde_json::Value = serde_json::from_str(&record).expect("JSON");
        assert!(record["operator"]["goals"].as_u64() >= Some(1), "{record}");
        record["state_hash"].as_str().expect("a hash").to_owned()
    };
    assert_eq!(hash(), hash());
}
