//! What a person meets at the command line: a whole flight, and clear words for bad input.

use rustix::process::Signal;
use std::net::UdpSocket;
use std::path::Path;
use vigil_tests::{Running, run, run_line, said, succeed, text};

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
    let flight = run_line(&format!(
        "fly --family training --seed 3 --instance 87 --log {}",
        text(runs.path())
    ));
    assert_eq!(flight.status.code(), Some(0), "{}", said(&flight));
    let summary = String::from_utf8_lossy(&flight.stdout).into_owned();
    assert!(
        summary.contains("success") && summary.contains("landed, disarmed"),
        "{summary}"
    );
    assert!(summary.contains("\nalarms    "), "{summary}");
    let folder = flight_folder(runs.path());
    for file in ["course.toml", "scene.json", "firmware.log", "simulator.log"] {
        assert!(folder.join(file).is_file(), "{file} is missing");
    }
    succeed(&run(&["replay", text(&folder)]));
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
    let replay = succeed(&run(&["replay", text(&flight_folder(runs.path()))]));
    assert!(
        !replay.contains("interrupted"),
        "the log was closed properly: {}",
        replay
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
    succeed(&run_line(&format!(
        "detector figures --seed 7 --attacked --pictures 1 -o {}",
        text(folder.path())
    )));
    for picture in ["figure-12.png", "figure-13.png", "figure-14.png"] {
        assert!(folder.path().join(picture).is_file(), "{picture} is missing");
    }
    let table = std::fs::read_to_string(folder.path().join("explanations.csv")).expect("a table");
    let (mut altered, mut found) = (0, 0);
    for row in table.lines().skip(1) {
        let columns: Vec<&str> = row.split(',').collect();
        let number = |i: usize| columns[i].parse::<f64>().expect("a number");
        let sum: f64 = (3..8).map(number).sum();
        assert!((sum - number(2)).abs() < 1e-3, "{row}");
        if columns[1] == "1" {
            altered += 1;
            found += i32::from(columns[9] == "attack");
        }
    }
    assert_eq!(altered, 50);
    // Five of six raise the alarm.
    assert!(found >= 30, "{found} of {altered} altered frames were judged attacked");
}

#[test]
fn every_part_of_a_decision_is_timed_beside_the_paper_s_figure() {
    let folder = tempfile::tempdir().expect("a folder");
    let into = folder.path().display().to_string();
    let timed = run(&["detector", "times", "--pictures", "1", "-o", &into]);
    assert_eq!(timed.status.code(), Some(0), "{}", said(&timed));
    let text = String::from_utf8_lossy(&timed.stdout).into_owned();
    let rows: Vec<Vec<f64>> = text
        .lines()
        .filter(|line| line.contains(" ms "))
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

/// Numbers of the processes of an instance that this user runs.
fn processes_of(instance: &str) -> Vec<String> {
    let wanted = format!("\0--instance\0{instance}\0");
    std::fs::read_dir("/proc")
        .expect("processes")
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .filter(|pid| {
            let command = std::fs::read_to_string(format!("/proc/{pid}/cmdline")).unwrap_or_default();
            command.contains(&wanted)
        })
        .collect()
}

fn wait_until(what: &str, mut holds: impl FnMut() -> bool) {
    let begun = std::time::Instant::now();
    while !holds() {
        assert!(begun.elapsed() < vigil_tests::PATIENCE, "waited for: {what}");
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
}

#[test]
fn a_killed_flight_leaves_nothing_running_and_the_next_one_on_its_instance_flies() {
    let runs = tempfile::tempdir().expect("a folder");
    let fly = || {
        Running::start(&[
            "fly",
            "--family",
            "training",
            "--seed",
            "3",
            "--instance",
            "91",
            "--attack",
            "noise",
            "--log",
            text(runs.path()),
        ])
    };
    let first = fly();
    wait_until("fly, simulator, adversary and firmware run", || {
        processes_of("91").len() == 4
    });
    first.kill();
    wait_until("all of them have ended", || processes_of("91").is_empty());
    let mut second = fly();
    wait_until("four processes again", || processes_of("91").len() == 4);
    std::thread::sleep(std::time::Duration::from_secs(2));
    second.signal(Signal::INT);
    assert_eq!(second.wait(), Some(130));
    let folders = std::fs::read_dir(runs.path()).expect("a folder").count();
    assert_eq!(folders, 2, "each flight has a folder of its own");
}

#[test]
fn what_cannot_be_written_is_named_and_is_no_success() {
    let full = run_line("evaluate --flights 1 --pilot geometric --json /dev/full");
    assert_eq!(full.status.code(), Some(1), "{}", said(&full));
    assert!(
        said(&full).contains("cannot write /dev/full: No space left"),
        "{}",
        said(&full)
    );
    // A file size limit stands for a disk that fills up: what was there before is kept.
    let folder = tempfile::tempdir().expect("a folder");
    let course = folder.path().join("course.toml");
    std::fs::write(&course, "name = 'kept'").expect("a file");
    let command = format!(
        "ulimit -f 0; trap '' XFSZ; {} courses write --seed 7 -o {}",
        vigil_tests::vigil().display(),
        course.display()
    );
    let cut = std::process::Command::new("bash")
        .args(["-c", &command])
        .output()
        .expect("a shell");
    assert_eq!(cut.status.code(), Some(1), "{}", said(&cut));
    assert!(said(&cut).contains("course.toml"), "{}", said(&cut));
    assert_eq!(std::fs::read_to_string(&course).expect("a file"), "name = 'kept'");
    assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 1);
}

#[test]
fn a_reader_that_has_gone_is_no_fault_and_a_full_one_is() {
    let shell = |command: &str| {
        let command = format!("set -o pipefail; {} {command}", vigil_tests::vigil().display());
        std::process::Command::new("bash")
            .args(["-c", &command])
            .output()
            .expect("a shell")
    };
    let closed = shell("courses write --seed 7 | true");
    assert_eq!((closed.status.code(), said(&closed)), (Some(0), String::new()));
    let full = shell("courses write --seed 7 > /dev/full");
    assert_eq!(full.status.code(), Some(1), "{}", said(&full));
    assert!(said(&full).contains("cannot write standard output"), "{}", said(&full));
}

#[test]
fn a_report_on_standard_output_is_json_alone() {
    let told = run(&["evaluate", "--flights", "1", "--pilot", "geometric", "--json", "-"]);
    assert_eq!(told.status.code(), Some(0), "{}", said(&told));
    let report: serde_json::Value = serde_json::from_slice(&told.stdout).expect("JSON alone");
    assert_eq!(report["interrupted"], false);
    assert!(
        String::from_utf8_lossy(&told.stderr).contains("outcome"),
        "the table is for people"
    );
}

#[test]
fn an_interrupted_campaign_keeps_the_flights_that_had_ended_and_says_so() {
    let folder = tempfile::tempdir().expect("a folder");
    let json = folder.path().join("part.json");
    let mut campaign = std::process::Command::new(vigil_tests::vigil())
        .args([
            "evaluate",
            "--flights",
            "1000000",
            "--pilot",
            "geometric",
            "--threads",
            "1",
            "--json",
        ])
        .arg(&json)
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .expect("vigil starts");
    // A line every few seconds tells how far it is, terminal or not, once there is something to tell; here it is time.
    std::thread::sleep(std::time::Duration::from_secs(2));
    rustix::process::kill_process(rustix::process::Pid::from_child(&campaign), Signal::INT).expect("it is running");
    let ended = campaign.wait().expect("it ends");
    assert_eq!(ended.code(), Some(130));
    let report: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(&json).expect("a report")).expect("JSON");
    assert_eq!(report["interrupted"], true);
    assert_eq!(report["flights_asked_for"], 1_000_000);
}

#[test]
fn files_of_another_kind_or_size_are_refused_at_once_and_told_once() {
    let folder = tempfile::tempdir().expect("a folder");
    let huge = folder.path().join("huge");
    std::fs::File::create(&huge)
        .expect("a file")
        .set_len(10 << 30)
        .expect("a sparse file");
    for (arguments, limit) in [
        (["courses", "check"], "4 MiB"),
        (["sim", "--course"], "4 MiB"),
        (["sim", "--config"], "1 MiB"),
        (["firmware", "--config"], "1 MiB"),
        (["learn", "--config"], "1 MiB"),
        (["rollout", "--actor"], "64 MiB"),
    ] {
        let refused = run(&[&arguments[..], &[text(&huge)]].concat());
        let words = said(&refused);
        assert!(!refused.status.success(), "{words}");
        assert!(
            words.contains(&format!("it holds 10 GiB, the limit is {limit}")),
            "{words}"
        );
        let device = said(&run(&[&arguments[..], &["/dev/zero"]].concat()));
        assert!(device.contains("/dev/zero: it is a device"), "{device}");
        let missing = said(&run(&[&arguments[..], &["/no/such/file"]].concat()));
        assert_eq!(missing.matches("No such file").count(), 1, "{missing}");
    }
}

#[test]
fn a_picture_of_another_format_is_refused_by_name() {
    let refused = run(&["courses", "draw", "--seed", "7", "-o", "course.jpg"]);
    assert_eq!(refused.status.code(), Some(1), "{}", said(&refused));
    assert!(said(&refused).contains("course.png"), "{}", said(&refused));
}

#[test]
fn a_state_that_is_refused_is_named_with_file_and_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("vehicle92.toml");
    std::fs::write(&file, "[parameters]\nMIS_TAKEOFF_ALT = 3.1\nCOM_OBL_RC_ACT = 4.5\n").expect("a file");
    let refused = run(&["sim", "--instance", "92", "--seed", "1", "--state", text(folder.path())]);
    assert_eq!(refused.status.code(), Some(1), "{}", said(&refused));
    let words = said(&refused);
    assert!(words.contains("vehicle92.toml: mend or delete it: line 3: "), "{words}");
    assert!(words.contains("COM_OBL_RC_ACT"), "{words}");
}

#[test]
fn simulator_and_firmware_say_at_start_what_they_are_and_how_they_end() {
    let told = |arguments: &[&str], words: &[&str]| {
        let mut process = std::process::Command::new(vigil_tests::vigil())
            .args(arguments)
            .stdout(std::process::Stdio::null())
            .stderr(std::process::Stdio::piped())
            .spawn()
            .expect("vigil starts");
        let lines = std::io::BufRead::lines(std::io::BufReader::new(process.stderr.take().expect("it is piped")));
        let mut heard = String::new();
        for line in lines.map_while(Result::ok) {
            heard += &(line + "\n");
            if heard.contains("\nend ") {
                break;
            }
        }
        rustix::process::kill_process(rustix::process::Pid::from_child(&process), Signal::TERM).expect("it runs");
        assert_eq!(process.wait().expect("it ends").code(), Some(0), "{heard}");
        for word in words {
            assert!(heard.contains(word), "{word} is not in:\n{heard}");
        }
    };
    told(
        &["sim", "--instance", "93", "--seed", "5"],
        &[
            "14373",
            "14549",
            "18663",
            "`depth`",
            "seed 5",
            "unsigned packets from this machine only",
            "Ctrl-C",
        ],
    );
    let start = [
        "14123",
        "any vehicle",
        "not signed",
        "on command",
        "scheduling",
        "Ctrl-C",
    ];
    let watched = [
        "the actor (built in)",
        "the detector (built in) and the guard watch it",
        "recover",
    ];
    told(&["firmware", "--instance", "93"], &[&start[..], &watched[..]].concat());
    let geometric = ["the geometric pilot; nothing watches it"];
    told(&["firmware", "--instance", "93", "--pilot", "geometric"], &geometric);
}

#[test]
fn a_bench_whose_load_ends_too_early_tells_what_it_measured_until_then() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("bench.json");
    let bench = run(&[
        "bench",
        "realtime",
        "--minutes",
        "5",
        "--instance",
        "95",
        "--seed",
        "5",
        "--load",
        "sleep 8",
        "--log",
        text(folder.path()),
        "-o",
        text(&file),
    ]);
    assert_eq!(bench.status.code(), Some(1), "{}", said(&bench));
    assert!(
        said(&bench).contains("the load ended before the run did"),
        "{}",
        said(&bench)
    );
    let report: serde_json::Value = serde_json::from_slice(&std::fs::read(&file).expect("a report")).expect("JSON");
    assert!(report["steps"].as_u64().expect("steps") > 20, "{report}");
    let early = report["run"]["ended_early"].as_str().expect("why");
    assert!(early.contains("the load ended"), "{early}");
}

#[test]
fn a_detector_that_would_watch_nothing_is_refused() {
    for command in [
        &["firmware", "--instance", "94"][..],
        &["evaluate", "--flights", "1", "--json", "/dev/null"],
    ] {
        let refused = run(&[command, &["--pilot", "geometric", "--detector", "on"]].concat());
        assert_eq!(refused.status.code(), Some(1), "{}", said(&refused));
        assert!(
            said(&refused).contains("it watches the actor only"),
            "{}",
            said(&refused)
        );
    }
}

#[test]
fn a_course_is_drawn_as_the_ending_of_its_file_says() {
    let folder = tempfile::tempdir().expect("a folder");
    let draw = |name: &str| {
        let path = folder.path().join(name);
        let drawn = run(&["courses", "draw", "--seed", "7", "-o", text(&path)]);
        (
            drawn.status.code(),
            said(&drawn),
            std::fs::read(&path).unwrap_or_default(),
        )
    };
    let (code, _, svg) = draw("course.SVG");
    let svg = String::from_utf8(svg).expect("text");
    assert_eq!(code, Some(0));
    assert!(
        svg.starts_with("<svg ") && svg.contains(">validation 7<") && svg.contains(">goal<"),
        "{svg}"
    );
    let (code, _, png) = draw("course.png");
    assert!(code == Some(0) && png.starts_with(b"\x89PNG"));
    let (code, words, jpg) = draw("course.jpg");
    assert!(code == Some(1) && jpg.is_empty());
    assert!(
        words.contains("course.png or") && words.contains("course.svg"),
        "{words}"
    );
}

#[test]
fn what_an_earlier_version_had_is_refused_with_what_replaces_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let config = folder.path().join("old.toml");
    std::fs::write(&config, "[pilot]\nencoder = \"int8\"\n").expect("written");
    for (arguments, code, part) in [
        (&["train"][..], 2, "`vigil learn`"),
        (&["learn", "nothing"], 2, "leave it out"),
        (&["attack", "certify"], 2, "`vigil attack table`"),
        (&["evaluate", "--encoder", "int8"], 2, "float32"),
        (&["evaluate", "--astray", "3"], 2, "constants"),
        (&["evaluate", "--shard", "1/3"], 2, "vigil merge"),
        (&["firmware", "--config", text(&config)], 1, "float32"),
    ] {
        let refused = run(arguments);
        assert_eq!(refused.status.code(), Some(code), "{}", said(&refused));
        assert!(said(&refused).contains("of an earlier version"), "{}", said(&refused));
        assert!(said(&refused).contains(part), "{}", said(&refused));
    }
}
