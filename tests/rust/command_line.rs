//! What a person meets at the command line: a whole flight, and clear words for bad input.

use rustix::process::{Pid, Signal, kill_process};
use std::net::UdpSocket;
use std::path::Path;
use std::process::Stdio;
use vigil_log::FlightInfo;
use vigil_tests::{
    Running, ended, has, json, only_log, processes_of, program, refused, run, run_line, said, succeed, text, write_log,
};

/// The command for a flight in real time on an instance, whose log goes to a folder.
fn flight(instance: u32, log: &Path) -> String {
    let log = text(log);
    format!("fly --family training --seed 3 --instance {instance} --log {log}")
}

#[test]
fn one_command_flies_a_course_in_real_time_and_its_log_replays_byte_for_byte() {
    let runs = tempfile::tempdir().expect("a folder");
    let flight = run_line(&flight(87, runs.path()));
    ended(&flight, 0, &["success", "landed, disarmed", "\nalarms    "]);
    let log = only_log(runs.path());
    for file in ["course.toml", "scene.json", "firmware.log", "simulator.log"] {
        assert!(log.with_file_name(file).is_file(), "{file} is missing");
    }
    succeed(&run(&["replay", text(log.parent().expect("a folder"))]));
}

#[test]
fn an_interrupted_flight_ends_all_processes_and_leaves_a_closed_log() {
    let runs = tempfile::tempdir().expect("a folder");
    let mut flight = Running::start(&flight(88, runs.path()));
    std::thread::sleep(std::time::Duration::from_secs(4));
    flight.signal(Signal::INT);
    assert_eq!(flight.wait(), Some(130));
    // Its ports are free again: no process was left behind.
    drop(UdpSocket::bind(("127.0.0.1", 14280 + 88)).expect("the simulator's port is free"));
    drop(UdpSocket::bind(("127.0.0.1", 14030 + 88)).expect("the firmware's port is free"));
    let replay = succeed(&run(&["replay", text(&only_log(runs.path()))]));
    assert!(!replay.contains("interrupted"), "not closed properly: {replay}");
}

#[test]
fn a_malformed_course_or_configuration_is_refused_with_file_line_and_field() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("bent.toml");
    let good = String::from_utf8(run(&["courses", "write", "--seed", "7"]).stdout).expect("TOML");
    let course = &*good.replacen("goal_radius_m = ", "goal_radios_m = ", 1);
    let unknown = "bent.toml:5: there is no key `goal_radios_m`";
    for (content, command, option, words) in [
        (course, "fly", "--course", unknown),
        (course, "sim", "--course", unknown),
        ("[lidar]\nmax_range = 3\n", "sim", "--config", "line"),
        ("[lidar]\nmax_range = 3\n", "firmware", "--config", "line"),
        ("[lidar]\nmax_range_m = -3.0\n", "sim", "--config", "max_range_m"),
        ("[limits]\nframe_age_s = nan\n", "firmware", "--config", "frame_age_s"),
    ] {
        std::fs::write(&file, content).expect("a file");
        refused(&run(&[command, option, text(&file)]), &["bent.toml", words]);
    }
    std::fs::write(&file, course).expect("a file");
    ended(&run(&["courses", "check", text(&file)]), 3, &[]);
}

#[test]
fn a_second_simulator_on_the_same_instance_is_refused_and_says_what_to_do() {
    let first = Running::start("sim --status --instance 89");
    first.wait_for_status("a running simulator", |_| true);
    refused(&run(&["sim", "--instance", "89"]), &["--instance"]);
    first.wait_for_status("the first one goes on", |s| s.time_s > 0.5);
}

#[test]
fn what_makes_no_sense_is_refused_with_why_it_does_not() {
    let folder = tempfile::tempdir().expect("a folder");
    let log = folder.path().join("no.mcap");
    std::fs::write(&log, "this is no log").expect("a file");
    let (folder, log) = (text(folder.path()), text(&log));
    let (large, too_large) = ("--seed 9223372036854775808", "not in 0..9223372036854775808");
    let (blind, watches_nothing) = ("--pilot geometric --detector on", "it watches the actor only");
    for (line, code, why) in [
        (format!("replay {log}"), 1, log),
        ("replay does-not-exist.mcap".to_owned(), 1, "does-not-exist.mcap"),
        (format!("evaluate -o {folder}"), 1, "is a folder: name a file"),
        (format!("evaluate -o {folder}/new/"), 1, "is a folder: name a file"),
        (format!("learn {large}"), 2, too_large),
        (format!("detector train {large}"), 2, too_large),
        (format!("firmware --instance 94 {blind}"), 1, watches_nothing),
        (format!("evaluate --json /dev/null {blind}"), 1, watches_nothing),
    ] {
        ended(&run_line(&line), code, &[why]);
    }
}

#[test]
fn every_command_explains_itself_with_examples() {
    for command in ["fly", "sim", "firmware", "evaluate", "replay", "courses"] {
        ended(&run(&[command, "--help"]), 0, &["Examples:"]);
    }
    ended(&run(&["evaluate", "--flights", "none"]), 2, &[]);
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
    assert!(found >= 30, "{found} of {altered} altered frames were scored attacked");
}

#[test]
fn every_part_of_a_decision_is_timed_beside_the_paper_s_figure() {
    let folder = tempfile::tempdir().expect("a folder");
    let into = folder.path().display().to_string();
    let text = succeed(&run(&["detector", "times", "--pictures", "1", "-o", &into]));
    let mut rows = 0;
    for line in text.lines().filter(|line| line.contains(" ms ")) {
        let numbers: Vec<f64> = line.split_whitespace().filter_map(|word| word.parse().ok()).collect();
        let is_sound = matches!(numbers[..], [median, late, paper] if 0.0 < median && median <= late && paper > 0.0);
        assert!(is_sound, "{text}");
        rows += 1;
    }
    assert_eq!(rows, 7, "{text}");
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
    let fly = || Running::start(&format!("{} --attack noise", flight(91, runs.path())));
    let first = fly();
    wait_until("fly, simulator, adversary and firmware run", || processes_of("91") == 4);
    drop(first);
    wait_until("all of them have ended", || processes_of("91") == 0);
    let mut second = fly();
    wait_until("four processes again", || processes_of("91") == 4);
    std::thread::sleep(std::time::Duration::from_secs(2));
    // Without its simulator it is an error, and what was flown until then is kept as that of any flight.
    let children = std::fs::read_to_string(format!("/proc/{0}/task/{0}/children", second.id())).expect("children");
    let simulator = children.split(' ').next().and_then(|id| id.parse().ok());
    let simulator = simulator.and_then(Pid::from_raw).expect("a simulator");
    kill_process(simulator, Signal::KILL).expect("it runs");
    assert_eq!(second.wait(), Some(1));
    let folders = std::fs::read_dir(runs.path()).expect("a folder");
    let mut folders: Vec<_> = folders.map(|entry| entry.expect("a flight's").path()).collect();
    folders.sort();
    assert_eq!(folders.len(), 2, "each flight has a folder of its own");
    assert!(only_log(&folders[1]).with_extension("html").is_file());
    assert!(!folders[1].join("adversary.part").exists(), "its content is in the log");
}

/// A command of `vigil` in a shell that was given something before.
fn shell(before_it: &str, command: &str) -> std::process::Output {
    let line = format!("{before_it}; {} {command}", vigil_tests::vigil().display());
    let done = std::process::Command::new("bash").args(["-c", &line]).output();
    done.expect("a shell")
}

#[test]
fn a_level_of_diagnostics_that_is_none_is_named() {
    for (level, is_named) in [
        ("infoo", true),
        ("debug,", true),
        ("", false),
        ("vigil_io=debug, warn", false),
    ] {
        let mut program = program();
        program.env("RUST_LOG", level).args(["courses", "write", "--seed", "7"]);
        let output = program.output().expect("the program runs");
        assert!(output.status.success());
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(
            said.contains("RUST_LOG is not understood, warn taken"),
            is_named,
            "{level}: {said}"
        );
    }
}

#[test]
fn what_cannot_be_written_is_named_and_is_no_success() {
    let full = run_line("evaluate --flights 1 --pilot geometric --json /dev/full");
    refused(&full, &["cannot write /dev/full: No space left"]);
    // A file size limit stands for a disk that fills up: what was there before is kept.
    let folder = tempfile::tempdir().expect("a folder");
    let course = folder.path().join("course.toml");
    std::fs::write(&course, "name = 'kept'").expect("a file");
    let command = format!("courses write --seed 7 -o {}", course.display());
    refused(&shell("ulimit -f 0", &command), &["course.toml"]);
    assert_eq!(std::fs::read_to_string(&course).expect("a file"), "name = 'kept'");
    let log = folder.path().join("a.mcap");
    write_log(&log, FlightInfo::default(), 3, |_| {});
    let copy = format!("recover {0} {0}.copy", log.display());
    refused(
        &shell("ulimit -f 0", &copy),
        &["a.mcap.copy cannot be written: File too large"],
    );
    let left = std::fs::read_dir(folder.path()).expect("a folder").count();
    assert_eq!(left, 3, "the course, the log and its tlog");
}

#[test]
fn a_reader_that_has_gone_is_no_fault_and_a_full_one_is() {
    let closed = shell("set -o pipefail", "courses write --seed 7 | true");
    assert_eq!((closed.status.code(), said(&closed)), (Some(0), String::new()));
    let full = shell("set -o pipefail", "courses write --seed 7 > /dev/full");
    refused(&full, &["cannot write standard output"]);
    refused(&shell(":", "--version > /dev/full"), &["cannot write standard output"]);
}

#[test]
fn a_report_on_standard_output_is_json_alone() {
    for name in ["-", "/dev/stdout"] {
        let flown = run(&["evaluate", "--flights", "1", "--pilot", "geometric", "--json", name]);
        succeed(&flown);
        let report: serde_json::Value = serde_json::from_slice(&flown.stdout).expect("JSON alone");
        assert_eq!(report["interrupted"], false);
        let for_people = String::from_utf8_lossy(&flown.stderr);
        assert!(for_people.contains("outcome"), "no table: {for_people}");
    }
    // Into a file that is appended to: what stands there stays.
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("kept");
    std::fs::write(&file, "earlier\n").expect("written");
    let appended = vigil_tests::program()
        .args(["courses", "write", "--seed", "7", "-o", "/dev/stdout"])
        .stdout(std::fs::File::options().append(true).open(&file).expect("a file"))
        .output();
    assert_eq!(succeed(&appended.expect("vigil starts")), "");
    let kept = std::fs::read_to_string(&file).expect("text");
    assert!(kept.starts_with("earlier\nname = "), "{kept}");
}

#[test]
fn what_is_made_of_a_log_does_not_take_its_place_and_without_a_step_nothing_is_made() {
    let folder = tempfile::tempdir().expect("a folder");
    let log = folder.path().join("empty.mcap");
    write_log(&log, FlightInfo::default(), 0, |_| {});
    let (name, before) = (text(&log), std::fs::read(&log).expect("a log"));
    for (arguments, words) in [
        (&["log", "report", name, "-o", name][..], "is the log itself"),
        (&["log", "ulg", name, "-o", name], "is the log itself"),
        (&["view", name, "--save", name], "is the log itself"),
        (&["view", name, "--save", "-"], "a recording is a file"),
        (&["log", "ulg", name], "holds no whole step"),
        (&["replay", name], "holds no step"),
    ] {
        refused(&run(arguments), &[words]);
    }
    assert!(std::fs::read(&log).expect("a log") == before);
}

#[test]
fn what_a_log_holds_can_be_chosen_where_the_configuration_names_its_folder() {
    let folder = tempfile::tempdir().expect("a folder");
    let config = folder.path().join("log.toml");
    std::fs::write(&config, format!("[log]\ndirectory = {:?}\n", folder.path())).expect("written");
    // Refused for the detector, if not for the log.
    let light = "firmware --instance 96 --log-content light --pilot geometric --detector on";
    refused(&run_line(light), &["give --log DIR"]);
    let named = run_line(&format!("{light} --config {}", text(&config)));
    refused(&named, &["it watches the actor only"]);
}

#[test]
fn an_interrupted_campaign_keeps_the_flights_that_had_ended_and_says_so() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("part.json");
    let mut campaign = Running::start(&format!(
        "evaluate --flights 1000000 --pilot geometric --threads 1 --json {}",
        text(&file)
    ));
    // A line every few seconds shows how far it is, terminal or not, once there is something to tell; here it is time.
    std::thread::sleep(std::time::Duration::from_secs(2));
    campaign.signal(Signal::INT);
    assert_eq!(campaign.wait(), Some(130));
    let report = json(&file);
    assert_eq!(report["interrupted"], true);
    assert_eq!(report["flights_asked_for"], 1_000_000);
}

#[test]
fn files_of_another_kind_or_size_are_refused_at_once_and_reported_once() {
    let folder = tempfile::tempdir().expect("a folder");
    let huge = folder.path().join("huge");
    let sparse = std::fs::File::create(&huge).and_then(|file| file.set_len(10 << 30));
    sparse.expect("a sparse file");
    for (arguments, limit) in [
        ("courses check", "4 MiB"),
        ("sim --course", "4 MiB"),
        ("sim --config", "1 MiB"),
        ("firmware --config", "1 MiB"),
        ("learn --config", "1 MiB"),
        ("rollout --actor", "256 MiB"),
    ] {
        let of = |file: &str| run_line(&format!("{arguments} {file}"));
        let huge = of(text(&huge));
        assert!(!huge.status.success());
        has(&said(&huge), &[&format!("it holds 10 GiB, the limit is {limit}")]);
        has(&said(&of("/dev/zero")), &["/dev/zero: it is a device"]);
        let missing = said(&of("/no/such/file"));
        assert_eq!(missing.matches("No such file").count(), 1, "{missing}");
    }
}

#[test]
fn a_state_that_is_refused_is_named_with_file_and_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("vehicle92.toml");
    std::fs::write(&file, "[parameters]\nMIS_TAKEOFF_ALT = 3.1\nCOM_OBL_RC_ACT = 4.5\n").expect("a file");
    let started = run(&["sim", "--instance", "92", "--seed", "1", "--state", text(folder.path())]);
    let mend = "vehicle92.toml: mend or delete it: line 3: ";
    refused(&started, &[mend, "COM_OBL_RC_ACT"]);
}

#[test]
fn simulator_and_firmware_say_at_start_what_they_are_and_how_they_end() {
    let says = |line: &str, words: &str| {
        let mut process = Running::start_saying(line, Stdio::piped());
        let mut heard = String::new();
        process.wait_for("how it ends", |line| {
            heard += line;
            line.starts_with("end ").then_some(())
        });
        process.signal(Signal::TERM);
        assert_eq!(process.wait(), Some(0), "{heard}");
        has(&heard, &words.split('|').collect::<Vec<_>>());
    };
    says(
        "sim --instance 93 --seed 5",
        "14373|14549|18663|`depth`|seed 5|unsigned packets from this machine only|Ctrl-C",
    );
    says(
        "firmware --instance 93",
        "14123|any vehicle|not signed|on command|scheduling|Ctrl-C|\
         the actor (built in)|the detector (built in) and the guard watch it|recover",
    );
    says(
        "firmware --instance 93 --pilot geometric",
        "the geometric pilot; nothing watches it",
    );
}

#[test]
fn a_bench_whose_load_ends_too_early_shows_what_it_measured_until_then() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("bench.json");
    let line = "bench realtime --minutes 5 --instance 95 --seed 5 --log";
    let mut arguments: Vec<&str> = line.split(' ').collect();
    arguments.extend([text(folder.path()), "-o", text(&file), "--load", "sleep 8"]);
    refused(&run(&arguments), &["the load ended before the run did"]);
    let report = json(&file);
    assert!(report["steps"].as_u64().expect("steps") > 20, "{report}");
    let early = report["run"]["ended_early"].as_str().expect("why");
    assert!(early.contains("the load ended"), "{early}");
}

#[test]
fn a_course_is_drawn_as_the_ending_of_its_file_says() {
    let folder = tempfile::tempdir().expect("a folder");
    let draw = |how: &str, name: &str| {
        let path = folder.path().join(name);
        let drawn = run(&["courses", how, "--seed", "7", "-o", text(&path)]);
        (drawn, std::fs::read(&path).unwrap_or_default())
    };
    let (drawn, svg) = draw("draw", "course.SVG");
    succeed(&drawn);
    let svg = String::from_utf8(svg).expect("text");
    has(&svg, &["<svg ", ">validation 7<", ">goal<"]);
    for (how, name) in [("draw", "course.png"), ("view", "view.png")] {
        let (drawn, png) = draw(how, name);
        succeed(&drawn);
        assert!(png.starts_with(b"\x89PNG") && png.len() > 2000);
    }
    let (drawn, jpg) = draw("draw", "course.jpg");
    refused(&drawn, &["course.png or", "course.svg"]);
    assert!(jpg.is_empty());
}

#[test]
fn what_an_earlier_version_had_is_refused_with_what_replaces_it() {
    let other = said(&run(&["evaluate", "--from", "x"]));
    assert!(!other.contains("earlier version"), "{other}");
    let folder = tempfile::tempdir().expect("a folder");
    let config = folder.path().join("old.toml");
    std::fs::write(&config, "[pilot]\nencoder = \"int8\"\n").expect("written");
    for (arguments, code, part) in [
        (&["train"][..], 2, "`vigil learn`"),
        (&["learn", "nothing"], 2, "leave it out"),
        (&["learn", "--from", "x"], 2, "--encoder-of"),
        (&["attack", "certify"], 2, "`vigil attack table`"),
        (&["evaluate", "--encoder", "int8"], 2, "float32"),
        (&["evaluate", "--astray", "3"], 2, "constants"),
        (&["evaluate", "--shard", "1/3"], 2, "vigil merge"),
        (&["firmware", "--config", text(&config)], 1, "float32"),
    ] {
        ended(&run(arguments), code, &["of an earlier version", part]);
    }
}
