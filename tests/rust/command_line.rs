//! What a person meets at the command line: a whole flight, and clear words for bad input.

use rustix::process::Signal;
use std::net::UdpSocket;
use std::path::Path;
use vigil_tests::{Running, run, said};

fn text(path: &Path) -> &str {
    path.to_str().expect("a UTF-8 path")
}

/// The one flight folder in a folder of runs.
fn flight_folder(runs: &Path) -> std::path::PathBuf {
    std::fs::read_dir(runs)
        .expect("a folder")
        .next()
        .expect("a flight")
        .expect("readable")
        .path()
}

#[test]
fn one_command_flies_a_course_in_real_time_and_its_log_replays_byte_for_byte() {
    let runs = tempfile::tempdir().expect("a folder");
    let flight = run(&[
        "fly",
        "--family",
        "training",
        "--seed",
        "3",
        "--instance",
        "87",
        "--log",
        text(runs.path()),
    ]);
    assert_eq!(flight.status.code(), Some(0), "{}", said(&flight));
    let summary = String::from_utf8_lossy(&flight.stdout).into_owned();
    assert!(
        summary.contains("success") && summary.contains("landed, disarmed"),
        "{summary}"
    );
    let folder = flight_folder(runs.path());
    for file in ["course.toml", "scene.json", "firmware.log", "simulator.log"] {
        assert!(folder.join(file).is_file(), "{file} is missing");
    }
    let replay = run(&["replay", text(&folder)]);
    assert_eq!(replay.status.code(), Some(0), "{}", said(&replay));
}

#[test]
fn an_interrupted_flight_ends_all_processes_and_leaves_a_closed_log() {
    let runs = tempfile::tempdir().expect("a folder");
    let mut flight = Running::start(&[
        "fly",
        "--family",
        "training",
        "--seed",
        "3",
        "--instance",
        "88",
        "--log",
        text(runs.path()),
    ]);
    std::thread::sleep(std::time::Duration::from_secs(4));
    flight.signal(Signal::INT);
    assert_eq!(flight.wait(), Some(130));
    // Its ports are free again: no process was left behind.
    drop(UdpSocket::bind(("127.0.0.1", 14280 + 88)).expect("the simulator's port is free"));
    drop(UdpSocket::bind(("127.0.0.1", 14030 + 88)).expect("the firmware's port is free"));
    let replay = run(&["replay", text(&flight_folder(runs.path()))]);
    assert_eq!(replay.status.code(), Some(0), "{}", said(&replay));
    assert!(
        !said(&replay).contains("interrupted"),
        "the log was closed properly: {}",
        said(&replay)
    );
}

#[test]
fn a_malformed_course_is_refused_with_file_line_and_field() {
    let folder = tempfile::tempdir().expect("a folder");
    let course = folder.path().join("bent.toml");
    let good = String::from_utf8(run(&["courses", "write", "--seed", "7"]).stdout).expect("TOML");
    std::fs::write(&course, good.replacen("goal_radius_m = ", "goal_radios_m = ", 1)).expect("a file");
    for command in [
        vec!["fly", "--course", text(&course)],
        vec!["sim", "--course", text(&course)],
    ] {
        let refused = run(&command);
        assert_eq!(refused.status.code(), Some(1), "{}", said(&refused));
        let words = said(&refused);
        assert!(words.contains("bent.toml:5: `goal_radios_m`"), "{words}");
    }
    let check = run(&["courses", "check", text(&course)]);
    assert_eq!(check.status.code(), Some(3), "{}", said(&check));
}

#[test]
fn a_malformed_configuration_is_refused_with_file_line_and_field() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("wrong.toml");
    std::fs::write(&file, "[lidar]\nmax_range = 3\n").expect("a file");
    for command in ["sim", "firmware"] {
        let refused = run(&[command, "--config", text(&file)]);
        assert_eq!(refused.status.code(), Some(1), "{}", said(&refused));
        let words = said(&refused);
        assert!(words.contains("wrong.toml") && words.contains("line"), "{words}");
    }
    std::fs::write(&file, "[lidar]\nmax_range_m = -3.0\n").expect("a file");
    let refused = run(&["sim", "--config", text(&file)]);
    assert!(
        !refused.status.success() && said(&refused).contains("max_range_m"),
        "{}",
        said(&refused)
    );
    std::fs::write(&file, "[limits]\nframe_age_s = nan\n").expect("a file");
    let refused = run(&["firmware", "--config", text(&file)]);
    assert!(
        !refused.status.success() && said(&refused).contains("frame_age_s"),
        "{}",
        said(&refused)
    );
}

#[test]
fn a_second_simulator_on_the_same_instance_is_refused_and_says_what_to_do() {
    let first = Running::start(&["sim", "--status", "--instance", "89"]);
    first.wait_for_status("a running simulator", |_| true);
    let second = run(&["sim", "--instance", "89"]);
    assert_eq!(second.status.code(), Some(1), "{}", said(&second));
    assert!(said(&second).contains("--instance"), "{}", said(&second));
    first.wait_for_status("the first one goes on", |s| s.time_s > 0.5);
}

#[test]
fn wrong_logs_are_refused_by_name() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("no.mcap");
    std::fs::write(&file, "this is no log").expect("a file");
    for path in [text(&file), "does-not-exist.mcap"] {
        let refused = run(&["replay", path]);
        assert_eq!(refused.status.code(), Some(1), "{}", said(&refused));
        assert!(said(&refused).contains(path), "{}", said(&refused));
    }
}

#[test]
fn every_command_explains_itself_with_examples() {
    for command in ["fly", "sim", "firmware", "evaluate", "replay", "courses"] {
        let help = run(&[command, "--help"]);
        assert!(
            help.status.success() && said(&help).contains("Examples:"),
            "{command}: {}",
            said(&help)
        );
    }
    assert_eq!(run(&["evaluate", "--flights", "none"]).status.code(), Some(2));
}

#[test]
fn a_course_is_drawn_as_a_picture() {
    let folder = tempfile::tempdir().expect("a folder");
    for (what, name) in [("draw", "plan.png"), ("view", "view.png")] {
        let file = folder.path().join(name);
        let drawn = run(&["courses", what, "--seed", "7", "-o", text(&file)]);
        assert!(drawn.status.success(), "{}", said(&drawn));
        let bytes = std::fs::read(&file).expect("a picture");
        assert!(bytes.starts_with(b"\x89PNG") && bytes.len() > 2000);
    }
}

#[test]
fn a_flight_s_explanations_add_up_to_its_decisions_and_its_attack_is_noticed() {
    let folder = tempfile::tempdir().expect("a folder");
    let drawn = run(&[
        "detector",
        "figures",
        "--seed",
        "7",
        "--attacked",
        "--pictures",
        "1",
        "-o",
        text(folder.path()),
    ]);
    assert_eq!(drawn.status.code(), Some(0), "{}", said(&drawn));
    for picture in ["figure-12.png", "figure-13.png", "figure-14.png"] {
        assert!(folder.path().join(picture).is_file(), "{picture} is missing");
    }
    let table = std::fs::read_to_string(folder.path().join("explanations.csv")).expect("a table");
    let (mut altered, mut found) = (0, 0);
    for row in table.lines().skip(1) {
        let columns: Vec<&str> = row.split(',').collect();
        let number = |i: usize| columns[i].parse::<f64>().expect("a number");
        let sum: f64 = (3..7).map(number).sum();
        assert!((sum - number(2)).abs() < 1e-3, "{row}");
        if columns[1] == "1" {
            altered += 1;
            found += i32::from(columns[8] == "attack");
        }
    }
    assert_eq!(altered, 50);
    assert!(found >= 45, "{found} of {altered} altered frames were judged attacked");
}

#[test]
fn every_part_of_a_decision_is_timed_beside_the_paper_s_figure() {
    let timed = run(&["detector", "times", "--pictures", "1"]);
    assert_eq!(timed.status.code(), Some(0), "{}", said(&timed));
    let text = String::from_utf8_lossy(&timed.stdout).into_owned();
    let rows: Vec<Vec<f64>> = text
        .lines()
        .skip(2)
        .map(|line| line.split_whitespace().filter_map(|word| word.parse().ok()).collect())
        .collect();
    assert_eq!(rows.len(), 7, "{text}");
    for row in &rows {
        let [median, late, paper] = row[..] else {
            panic!("{text}")
        };
        assert!(0.0 < median && median <= late && paper > 0.0, "{text}");
    }
}
