//! A flight is opened in a viewer, or the person is told what is missing; what a replay gives is put into its log.

use std::net::TcpListener;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use vigil_log::{FlightInfo, LogPlace, Reader, Recorder, RecorderConfig, TickRecord, WhenFull};
use vigil_tests::{run, said};
use vigil_types::{Datagrams, StepReport, StepTiming};

fn text(path: &Path) -> &str {
    path.to_str().expect("a UTF-8 path")
}

/// A log of a vehicle that stood for three steps without a frame.
fn short_log(folder: &Path) -> PathBuf {
    let log = folder.join("short.mcap");
    let mut recorder = Recorder::start(RecorderConfig {
        when_full: WhenFull::Wait,
        ..RecorderConfig::new(LogPlace::File(log.clone()), FlightInfo::default())
    })
    .expect("a log");
    let nothing = Datagrams::default();
    for step in 0..3 {
        let timing = StepTiming {
            step,
            ..StepTiming::default()
        };
        let report = StepReport::default();
        recorder
            .record(|slot: &mut TickRecord| slot.fill(50_000_000 * step, timing, None, &nothing, &nothing, &report));
    }
    recorder.finish();
    log
}

/// A Python that says it has the viewer, and notes what it is asked to show.
fn stand_in(folder: &Path) -> PathBuf {
    let python = folder.join("python");
    let script =
        "#!/bin/sh\nif [ \"$1\" = -c ]; then echo 0.41.0; exit; fi\ncat > \"$0.script\"\necho \"$@\" > \"$0.asked\"\n";
    std::fs::write(&python, script).expect("a file");
    std::fs::set_permissions(&python, std::fs::Permissions::from_mode(0o755)).expect("a program");
    python
}

#[test]
fn a_viewer_that_is_absent_is_told_with_the_command_that_installs_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let log = short_log(folder.path());
    for (python, why) in [
        ("no-such-python", "there is no program"),
        ("false", "lacks its packages"),
    ] {
        for command in [
            vec!["view", text(&log)],
            vec!["fly", "--view", "-o", text(folder.path())],
        ] {
            let shown = run(&[&command[..], &["--python", python]].concat());
            assert_eq!(shown.status.code(), Some(1));
            let said = said(&shown);
            assert!(said.contains(why) && said.contains("pip install rerun-sdk=="), "{said}");
        }
    }
    // Nothing was flown without the viewer that was asked for.
    assert_eq!(
        std::fs::read_dir(folder.path()).expect("the folder").count(),
        2,
        "the log and its tlog"
    );
}

#[test]
fn a_log_is_handed_to_the_viewer_unless_its_port_is_taken() {
    let folder = tempfile::tempdir().expect("a folder");
    let log = short_log(folder.path());
    let python = stand_in(folder.path());
    let taken = TcpListener::bind("0.0.0.0:0").expect("a port");
    let port = taken.local_addr().expect("its number").port().to_string();
    let view = || run(&["view", text(&log), "--python", text(&python), "--view-port", &port]);
    let refused = view();
    assert_eq!(refused.status.code(), Some(1));
    assert!(
        said(&refused).contains(&format!("port {port} is taken")),
        "{}",
        said(&refused)
    );
    drop(taken);
    let shown = view();
    assert_eq!(shown.status.code(), Some(0), "{}", said(&shown));
    let asked = std::fs::read_to_string(folder.path().join("python.asked")).expect("what was asked");
    assert_eq!(asked.trim(), format!("- {} --port {port}", text(&log)));
    let script = std::fs::read_to_string(folder.path().join("python.script")).expect("the script");
    assert!(script.contains("def layout"));

    let layout = run(&["view", text(&log), "--foxglove"]);
    assert_eq!(layout.status.code(), Some(0));
    assert!(folder.path().join("foxglove-layout.json").is_file() && said(&layout).contains("Import from file"));
}

#[test]
fn what_is_no_log_of_this_version_is_refused_before_a_viewer_opens() {
    let folder = tempfile::tempdir().expect("a folder");
    let python = stand_in(folder.path());
    let junk = folder.path().join("junk.mcap");
    std::fs::write(&junk, b"no log at all, but long enough to be looked at").expect("a file");
    for command in ["view", "log derive"] {
        let mut line: Vec<&str> = command.split(' ').collect();
        line.push(text(&junk));
        if command == "view" {
            line.extend(["--python", text(&python)]);
        }
        let refused = run(&line);
        assert_eq!(refused.status.code(), Some(1), "{command}");
        assert!(said(&refused).contains("junk.mcap"), "{}", said(&refused));
    }
    assert!(!folder.path().join("python.asked").exists());
}

#[test]
fn map_way_and_pixels_are_put_into_a_log_once_and_it_replays_as_before() {
    let folder = tempfile::tempdir().expect("a folder");
    let json = folder.path().join("evaluate.json");
    let flown = run(&[
        "evaluate",
        "--flights",
        "1",
        "--seed",
        "3001",
        "--logs",
        text(folder.path()),
        "-o",
        text(&json),
    ]);
    assert_eq!(flown.status.code(), Some(0), "{}", said(&flown));
    let log = folder.path().join("3001.mcap");
    let about = |log: &Path| vigil_log::Story::read(log).expect("a log").about;
    let (before, records) = (about(&log), Reader::open(&log).expect("a log").count());
    let mut told = Vec::new();
    for _ in 0..2 {
        let derived = run(&["log", "derive", text(&log)]);
        assert_eq!(derived.status.code(), Some(0), "{}", said(&derived));
        told.push((said(&derived), std::fs::metadata(&log).expect("the log").len()));
    }
    assert_eq!(told[0], told[1], "derived anew, not twice");
    let number = |word: &str| -> usize {
        let words: Vec<&str> = told[0].0.split_whitespace().collect();
        let at = words
            .iter()
            .position(|w| *w == word)
            .unwrap_or_else(|| panic!("no {word} in {}", told[0].0));
        words[at - 1].parse().expect("a number")
    };
    // Twice and once a second, of 20 steps each; the first seconds have no goal yet.
    assert!(
        number("maps,") > records / 12 && number("explained") > records / 24,
        "{}",
        told[0].0
    );
    assert_eq!(about(&log), before, "what is known of the flight stays");
    let replayed = run(&["replay", text(&log)]);
    assert_eq!(replayed.status.code(), Some(0), "{}", said(&replayed));
    assert_eq!(Reader::open(&log).expect("a log").count(), records);
}
