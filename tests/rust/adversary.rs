//! Frames altered between the sensor and the firmware: in lockstep the same bits for the same seed, live in a process of
//! its own whose death leaves a vehicle that holds.

use rustix::process::Signal;
use serde_json::Value;
use std::path::Path;
use vigil_tests::{Running, evaluate, program, run_line, said, succeed, text};

/// Seeds and flights of a small campaign of the actor.
fn campaign(folder: &Path, name: &str, arguments: &[&str]) -> Vec<Value> {
    let actor = ["--pilot=actor", "--apf=off", "--detector=off", "--seed=60"];
    let report = evaluate(folder, name, "2", &[&actor[..], arguments].concat());
    report["flights"].as_array().expect("flights").clone()
}

#[test]
fn an_attacked_campaign_is_the_same_on_any_number_of_threads_and_says_what_was_attacked() {
    let folder = tempfile::tempdir().expect("a folder");
    let attack = ["--attack", "pgd", "--iterations", "3", "--burst", "20"];
    let on = |threads| [&attack[..], &["--threads", threads]].concat();
    let one = campaign(folder.path(), "one.json", &on("1"));
    let two = campaign(folder.path(), "two.json", &on("2"));
    assert_eq!(one, two);
    let unattacked = campaign(folder.path(), "none.json", &[]);
    for (attacked, unattacked) in one.iter().zip(&unattacked) {
        assert_ne!(attacked["state_hash"], unattacked["state_hash"]);
        let attack = &attacked["attack"];
        assert_eq!(attack["attacked_steps"], 20, "{attack}");
        let first_step = attack["first_step"].as_u64().expect("a step");
        assert!((20..=200).contains(&first_step), "{attack}");
        assert!(attack["effective_steps"].as_u64().expect("a number") <= 20, "{attack}");
        assert!(attack["mean_yaw_change"].as_f64().expect("a number") > 0.0, "{attack}");
        assert!(unattacked.get("attack").is_none());
    }
    let moments: Vec<_> = one.iter().map(|flight| &flight["attack"]["first_step"]).collect();
    assert_ne!(moments[0], moments[1], "each flight's seed draws its own moment");
}

/// Outcome, alarms and the guard's of them in a flight against an attacker who deceives the detector as well.
fn against_one_who_knows_the_detector(folder: &Path, guard: &str) -> (String, u32, u32) {
    let detector = concat!(env!("CARGO_MANIFEST_DIR"), "/../detector/frozen/lstm_ad.safetensors");
    let folder = folder.join(guard);
    succeed(&run_line(&format!(
        "attack defended --arms recover --flights 1 --seed 5000 --burst continuous --epsilon 2 --iterations 5 \
         --evade {detector} --guard {guard} --output {}",
        text(&folder)
    )));
    let table = std::fs::read_to_string(folder.join("defended.csv")).expect("the flights");
    let lines: Vec<Vec<&str>> = table.lines().skip(1).map(|line| line.split(',').collect()).collect();
    let [names, flight] = &lines[..] else {
        panic!("not one flight: {table}")
    };
    let of = |name| flight[names.iter().position(|n| *n == name).expect("a column")];
    let count = |name| of(name).parse().expect("a number");
    (of("outcome").to_owned(), count("alarms"), count("guard_alarms"))
}

#[test]
fn who_deceives_the_detector_too_still_does_not_fly_the_vehicle_into_an_obstacle() {
    let folder = tempfile::tempdir().expect("a folder");
    let (outcome, alarms, by_guard) = against_one_who_knows_the_detector(folder.path(), "off");
    assert_eq!((outcome.as_str(), by_guard), ("success", 0), "the verdict alone");
    assert!(alarms >= 1);
    let (outcome, alarms, by_guard) = against_one_who_knows_the_detector(folder.path(), "on");
    assert_eq!(outcome, "success");
    assert!(by_guard >= 1 && alarms >= by_guard, "{by_guard} of {alarms}");
}

#[test]
fn an_attack_that_cannot_be_is_refused_by_name_and_leaves_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    for (arguments, wanted) in [
        ("evaluate --attack bim-clipped --epsilon 0", "epsilon must be above 0"),
        ("evaluate --attack bim-clipped --iterations 0", "at least one iteration"),
        ("evaluate --epsilon 2", "--attack"),
        (
            "evaluate --attack pgd --attack-actor missing.safetensors",
            "missing.safetensors",
        ),
        ("adversary --goal 20,5", "--attack METHOD"),
    ] {
        let output = program().args(arguments.split(' ')).current_dir(folder.path()).output();
        let output = output.expect("vigil starts");
        assert!(!output.status.success());
        assert!(said(&output).contains(wanted), "{arguments:?}: {}", said(&output));
    }
    assert_eq!(std::fs::read_dir(folder.path()).expect("the folder").count(), 0);
}

#[test]
fn a_live_adversary_alters_what_the_firmware_believes_and_its_death_makes_the_vehicle_hold() {
    let adversary = || {
        let how = "--attack bim-accumulating --iterations 2 --burst continuous";
        Running::start(&format!("adversary --instance 87 --goal 18,4 {how}"))
    };
    let simulator =
        Running::start("sim --status --airborne --frames depth-raw --instance 87 --seed 11 --family training");
    let first = adversary();
    let mut firmware = Running::start("firmware --engage auto --goal 18,4 --height 1.5 --pilot actor --instance 87");
    simulator.wait_for_status("guided flight on delivered frames", |s| {
        s.guidance.as_deref() == Some("guided")
    });
    drop(first);
    simulator.wait_for_status("a hold without frames", |s| {
        s.guidance.as_deref() == Some("hold") && s.reasons.iter().any(|r| r.contains("frame"))
    });
    let mut second = adversary();
    simulator.wait_for_status("guided flight again", |s| s.guidance.as_deref() == Some("guided"));
    second.signal(Signal::TERM);
    let summary: Value = second.wait_for("the adversary's summary", |line| serde_json::from_str(line).ok());
    assert_eq!(second.wait(), Some(0));
    let (frames, attacked) = (summary["frames"].as_u64(), summary["attacked_steps"].as_u64());
    assert!(attacked > Some(0) && frames >= attacked, "{summary}");
    assert!(summary["latency_max_ms"].as_f64().expect("a number") > 0.0, "{summary}");
    firmware.signal(Signal::TERM);
    assert_eq!(firmware.wait(), Some(0));
}
