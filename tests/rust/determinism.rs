//! The same seed gives the same flight, bit for bit, wherever and however it runs; the tick run again over its log gives the same
//! bytes, and a changed step is found.

use serde_json::Value;
use std::path::Path;
use vigil_tests::{Running, copy_log, ended, evaluate, only_log, run, said, succeed, text};

/// Its state hashes, in the order of its seeds.
fn hashes(report: &Value) -> Vec<String> {
    let flights = report["flights"].as_array().expect("flights");
    let of = |flight: &Value| flight["state_hash"].as_str().expect("a hash").to_owned();
    flights.iter().map(of).collect()
}

/// The state hashes of a small campaign by the default stack, in the order of its seeds.
fn campaign(folder: &Path, name: &str, arguments: &[&str]) -> Vec<String> {
    hashes(&evaluate(folder, name, "3", arguments))
}

#[test]
fn a_campaign_gives_the_same_bits_on_one_thread_and_on_two() {
    let folder = tempfile::tempdir().expect("a folder");
    let one = campaign(folder.path(), "one.json", &["--seed", "40", "--threads", "1"]);
    let two = campaign(folder.path(), "two.json", &["--seed", "40", "--threads", "2"]);
    let again = campaign(folder.path(), "again.json", &["--seed", "40", "--threads", "2"]);
    assert_eq!(one, two);
    assert_eq!(two, again);
    let others = campaign(folder.path(), "others.json", &["--seed", "41", "--threads", "2"]);
    assert_eq!(others[..2], one[1..], "flight i uses seed SEED + i");
    assert_ne!(one[0], one[1], "another seed is another flight");
}

#[test]
fn attacked_flights_with_alarm_stop_and_recovery_are_the_same_bits_too() {
    let folder = tempfile::tempdir().expect("a folder");
    let [one, two] = [1, 2].map(|threads| {
        let line = format!("--seed 44 --apf off --attack bim-accumulating --burst 20 --threads {threads}");
        let arguments: Vec<&str> = line.split(' ').collect();
        evaluate(folder.path(), &format!("{threads}.json"), "3", &arguments)
    });
    assert_eq!(hashes(&one), hashes(&two));
    for flight in one["flights"].as_array().expect("flights") {
        let monitored = |what: &str| flight["watch"][what].as_u64();
        assert!(monitored("judged_steps") > Some(100), "{flight}");
        assert!(
            monitored("alarms") > Some(0) && monitored("recovery_steps") > Some(0),
            "{flight}"
        );
    }
}

#[test]
fn two_processes_in_lockstep_fly_the_same_flight_as_one_and_its_log_replays_but_for_one_changed_step() {
    let folder = tempfile::tempdir().expect("a folder");
    let one = campaign(folder.path(), "one.json", &["--seed", "42", "--ground-every", "0"]);

    let course = run(&["courses", "write", "--seed", "42"]);
    let course = String::from_utf8(course.stdout).expect("TOML");
    let course = vigil_sim::world::Course::from_toml_str(&course, "written course").expect("a course");
    let goal = course.goal_ned_m();
    let (north_m, east_m, height_m, logs) = (goal.x, goal.y, course.flight_height_m, text(folder.path()));
    let to_goal = format!("--engage auto --goal={north_m},{east_m} --height {height_m}");
    let mut firmware = Running::start(&format!("firmware --lockstep --instance 81 {to_goal} --log {logs}"));
    let simulator = run(&["sim", "--lockstep", "--airborne", "--instance", "81", "--seed", "42"]);
    let record: Value = serde_json::from_slice(&simulator.stdout).unwrap_or_else(|_| panic!("{}", said(&simulator)));
    assert_eq!(record["state_hash"].as_str(), Some(one[0].as_str()));
    assert_eq!(
        firmware.wait(),
        Some(0),
        "the firmware ends with the simulator's flight"
    );

    let log = only_log(folder.path());
    succeed(&run(&["replay", text(&log)]));
    let altered = folder.path().join("altered.mcap");
    let (mut steps, mut engaged) = (0, false);
    copy_log(&log, &altered, |record| {
        assert_eq!(record.timing.step, steps, "no step is missing");
        assert!(record.frame().is_some(), "in lockstep every step has a new frame");
        steps += 1;
        engaged |= record.report.action.is_some();
        record.report.frames_refused += u64::from(record.timing.step == 60);
    });
    assert!(steps > 100 && engaged);
    ended(
        &run(&["replay", text(&altered)]),
        3,
        &["step 60 ", "report: `frames_refused`"],
    );
}
