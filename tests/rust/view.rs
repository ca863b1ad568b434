//! A flight is opened in a viewer, or the person reads what is missing; what a replay gives is put into its log.

use std::net::TcpListener;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use vigil_log::{FlightInfo, Reader};
use vigil_tests::{attacked_flight, ended, has, json, only_log, refused, run, run_line, succeed, text, write_log};

/// A log of a vehicle that stood for three steps without a frame.
fn short_log(folder: &Path) -> PathBuf {
    let log = folder.join("short.mcap");
    write_log(&log, FlightInfo::default(), 3, |_| {});
    log
}

/// A Python that says it has the viewer, and keeps the script, what it is asked to show, and the course that is shown.
fn stand_in(folder: &Path) -> PathBuf {
    let keeps = "cat > \"$0.script\"\n[ \"$2\" = --course ] && cp \"$3\" \"$0.json\"\necho \"$@\" > \"$0.asked\"\n[ ! -e \"$0.fails\" ]\n";
    let script = format!("#!/bin/sh\nif [ \"$1\" = -c ]; then echo 0.41.0; exit; fi\n{keeps}");
    program(folder, "python", &script);
    folder.join("python")
}

/// What [`stand_in`] was asked.
fn asked(folder: &Path) -> String {
    std::fs::read_to_string(folder.join("python.asked")).expect("what was asked")
}

#[test]
fn a_viewer_that_is_absent_is_reported_with_the_command_that_installs_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let log = short_log(folder.path());
    let json = folder.path().join("evaluate.json");
    for (python, why) in [
        ("no-such-python", "there is no program"),
        ("false", "lacks its packages"),
    ] {
        for command in [
            vec!["view", text(&log)],
            vec!["fly", "--view", "-o", text(folder.path())],
            vec!["evaluate", "--flights", "2", "--view", "2", "-o", text(&json)],
            vec!["courses", "view", "--seed", "7"],
        ] {
            let shown = run(&[&command[..], &["--python", python]].concat());
            refused(&shown, &[why, "pip install rerun-sdk=="]);
        }
    }
    // Nothing was flown without the viewer that was asked for.
    let left = std::fs::read_dir(folder.path()).expect("the folder").count();
    assert_eq!(left, 2, "the log and its tlog");
}

#[test]
fn a_log_is_handed_to_the_viewer_and_nothing_is_shown_on_a_port_that_is_taken() {
    let folder = tempfile::tempdir().expect("a folder");
    let log = short_log(folder.path());
    let python = stand_in(folder.path());
    let taken = TcpListener::bind("0.0.0.0:0").expect("a port");
    let port = taken.local_addr().expect("its number").port().to_string();
    let on_port = |command: &[&str]| run(&[command, &["--python", text(&python), "--view-port", &port]].concat());
    let json = folder.path().join("e.json");
    for command in [
        ["view", text(&log)].as_slice(),
        &["courses", "view", "--seed", "7"],
        &["evaluate", "--flights=2", "--view=2", "-o", text(&json)],
    ] {
        refused(&on_port(command), &[&format!("port {port} is taken")]);
    }
    drop(taken);
    succeed(&on_port(&["view", text(&log)]));
    let asked = asked(folder.path());
    assert_eq!(asked.trim(), format!("- {} --port {port}", text(&log)));
    let script = std::fs::read_to_string(folder.path().join("python.script")).expect("the script");
    assert!(script.contains("def layout"));

    ended(&run(&["view", text(&log), "--foxglove"]), 0, &["Import from file"]);
    assert!(folder.path().join("foxglove-layout.json").is_file());
}

#[test]
fn what_is_no_log_of_this_version_is_refused_before_a_viewer_opens() {
    let folder = tempfile::tempdir().expect("a folder");
    let python = stand_in(folder.path());
    let junk = folder.path().join("junk.mcap");
    std::fs::write(&junk, b"no log at all, but long enough to be looked at").expect("a file");
    for command in [
        vec!["view", text(&junk), "--python", text(&python)],
        vec!["log", "derive", text(&junk)],
    ] {
        refused(&run(&command), &["junk.mcap"]);
    }
    assert!(!folder.path().join("python.asked").exists());
}

/// The number before a word, in brackets perhaps.
fn before_word(word: &str, said: &str) -> usize {
    let words: Vec<&str> = said.split_whitespace().collect();
    let at = words.iter().position(|w| *w == word);
    let at = at.unwrap_or_else(|| panic!("no {word} in {said}"));
    words[at - 1].trim_start_matches('(').parse().expect("a number")
}

#[test]
fn map_way_and_pixels_are_put_into_a_log_once_and_it_replays_as_before() {
    let folder = tempfile::tempdir().expect("a folder");
    let json = folder.path().join("evaluate.json");
    let (logs, report) = (text(folder.path()), text(&json));
    let line = format!("evaluate --flights 1 --seed 3001 --logs {logs} -o {report}");
    succeed(&run_line(&line));
    let log = folder.path().join("3001.mcap");
    // The same again loses neither the log nor the flight.
    let flights = std::fs::read(json.with_extension("jsonl")).expect("flights");
    refused(&run_line(&line), &["3001.mcap is there and is kept"]);
    assert!(std::fs::read(json.with_extension("jsonl")).expect("flights") == flights);
    let about = |log: &Path| vigil_log::Story::about(log).expect("a log");
    let (before, records) = (about(&log), Reader::open(&log).expect("a log").count());
    let saved = folder.path().join("saved.mcap");
    succeed(&run(&["recover", text(&log), text(&saved)]));
    let added = |log: &Path| vigil_log::Story::read(log).expect("a log").truth;
    let is_saved = added(&saved) == added(&log);
    assert!(added(&log).len() > 10 && is_saved, "what was added is saved too");
    assert_eq!(about(&saved), before);
    let mut outputs = Vec::new();
    for _ in 0..2 {
        let derived = succeed(&run(&["log", "derive", text(&log)]));
        outputs.push((derived, std::fs::metadata(&log).expect("the log").len()));
    }
    assert_eq!(outputs[0], outputs[1], "derived anew, not twice");
    let (said, size) = &outputs[0];
    // The pixels of each explained frame take 8 kB: they stay while the map is derived anew.
    succeed(&run(&["log", "derive", "--only", "map", text(&log)]));
    let bytes = std::fs::metadata(&log).expect("the log").len();
    assert!(bytes.abs_diff(*size) < 20_000, "{bytes}, {size}");
    // Twice and once a second, of 20 steps each; the first seconds have no goal yet.
    let (maps, explained) = (before_word("maps,", said), before_word("explained", said));
    assert!(maps > records / 12 && explained > records / 24, "{said}");
    assert_eq!(about(&log), before, "what is known of the flight stays");
    succeed(&run(&["replay", text(&log)]));
    assert_eq!(Reader::open(&log).expect("a log").count(), records);
}

/// Runs `vigil` with a folder of programs before those on the path, or with no other program at all.
fn run_with_path(arguments: &[&str], path: &str) -> std::process::Output {
    vigil_tests::program()
        .args(arguments)
        .env("PATH", path)
        .stdin(std::process::Stdio::null())
        .output()
        .expect("vigil starts")
}

fn program(folder: &Path, name: &str, script: &str) {
    let file = folder.join(name);
    std::fs::write(&file, script).expect("a file");
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o755)).expect("a program");
}

#[test]
fn a_film_shows_an_attacked_flight_and_pixels_are_explained_more_often_around_the_alarm() {
    let folder = tempfile::tempdir().expect("a folder");
    let log = attacked_flight(folder.path());
    let text_of_it = succeed(&run(&["log", "derive", "--only", "shap", text(&log)]));
    let explained = before_word("explained", &text_of_it);
    let steps = Reader::open(&log).expect("a log").count();
    // One a second, and each frame of the two seconds around the alarm.
    let around = steps / 20 + 36..steps / 20 + 46;
    assert!(around.contains(&explained), "{text_of_it}, {steps} steps");

    let gif = folder.path().join("film.gif");
    let (from, to) = (text(&log), text(&gif));
    succeed(&run_line(&format!("log film {from} -o {to} --speed 10 --shap 3")));
    let film = std::fs::read(&gif).expect("a film");
    // The signature, then 640 × 448 pixels.
    assert_eq!(&film[..10], b"GIF89a\x80\x02\xc0\x01");
    assert!(film.len() < 3_000_000, "{} bytes", film.len());

    // As far as it is whole.
    let bytes = std::fs::read(&log).expect("a log");
    let cut = folder.path().join("cut.mcap");
    std::fs::write(&cut, &bytes[..bytes.len() / 2]).expect("a file");
    assert!(succeed(&run(&["log", "film", text(&cut), "--shap", "0"])).contains("it is not all of the flight"));
    let (python, saved) = (stand_in(folder.path()), folder.path().join("cut.rrd"));
    let (cut, python, saved) = (text(&cut), text(&python), text(&saved));
    succeed(&run_line(&format!("view {cut} --save {saved} --python {python}")));
}

#[test]
fn an_mp4_is_as_many_pictures_handed_to_ffmpeg_and_one_that_fails_leaves_the_earlier_film() {
    let folder = tempfile::tempdir().expect("a folder");
    let (folder, log) = (folder.path(), &attacked_flight(folder.path()));
    // An mp4 is as many pictures, handed to ffmpeg; the last one stands still for 2.5 s.
    let bin = folder.join("bin");
    std::fs::create_dir(&bin).expect("a folder");
    let ffmpeg = |does: &str| {
        let script = format!("#!/bin/sh\n[ \"$1\" = -version ] && exit 0\n{does}\n");
        program(&bin, "ffmpeg", &script);
    };
    ffmpeg("for last; do :; done\nwc -c > \"$last\"");
    let path = format!("{}:/usr/bin:/bin", text(&bin));
    let mp4 = folder.join("film.mp4");
    let film = ["log", "film", text(log), "-o", text(&mp4), "--speed=10", "--shap=0"];
    let words = succeed(&run_with_path(&film, &path));
    let pictures = before_word("pictures,", &words);
    let came = || std::fs::read_to_string(&mp4).expect("what came").trim().to_owned();
    let bytes = ((pictures + 24) * 640 * 448 * 3).to_string();
    assert_eq!(came(), bytes);

    // One that fails is reported, and leaves no half of a film and the earlier one as it was.
    ffmpeg("echo no such encoder >&2\nexit 1");
    refused(&run_with_path(&film, &path), &["no such encoder"]);
    assert_eq!(came(), bytes, "the earlier one");
    assert!(!mp4.with_extension("mp4.part").exists());
    // Before anything is flown.
    let runs = folder.join("runs");
    for command in [film.to_vec(), vec!["fly", "--record", text(&mp4), "-o", text(&runs)]] {
        refused(&run_with_path(&command, text(&runs)), &["there is none on the path"]);
    }
    assert!(!runs.exists());
}

#[test]
fn what_cannot_be_filmed_is_reported_with_what_can_be_seen_of_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let log = short_log(folder.path());
    refused(&run(&["log", "film", text(&log)]), &["never took off", "log report"]);
    assert!(!log.with_extension("gif").exists());
    let avi = run(&["log", "film", text(&log), "-o", "film.avi"]);
    ended(&avi, 2, &[".gif or .mp4"]);
    let none = folder.path().join("none.mcap");
    refused(&run(&["log", "film", text(&none)]), &["none.mcap"]);
}

#[test]
fn a_flight_leaves_a_film_and_a_light_log_that_is_looked_at_and_not_replayed() {
    let folder = tempfile::tempdir().expect("a folder");
    let (runs, gif) = (folder.path().join("runs"), folder.path().join("film.gif"));
    let (film, into) = (text(&gif), text(&runs));
    let line = "fly --family training --seed 3 --instance 86 --quiet --log-content light";
    let flown = succeed(&run_line(&format!("{line} --record {film} -o {into}")));
    assert!(flown.contains("film      ") && gif.is_file(), "{}", flown);
    let log = only_log(&runs);
    let seconds = Reader::open(&log).expect("a log").count() as u64 / 20;
    let bytes = std::fs::metadata(&log).expect("the log").len();
    assert!(bytes < 300_000 * seconds, "{bytes} bytes in {seconds} s");
    assert!(log.with_extension("html").is_file(), "the report");
    let before = std::fs::read(&log).expect("the log");
    for (command, said) in [(&["replay"][..], ""), (&["log", "derive"], "nothing was derived from")] {
        let looked_at = run(&[command, &[text(&log)]].concat());
        refused(&looked_at, &["recorded without its frames", said]);
    }
    assert!(std::fs::read(&log).expect("the log") == before);
}

#[test]
fn a_course_is_handed_to_the_viewer_with_its_obstacles_way_and_what_is_seen_at_its_start() {
    let folder = tempfile::tempdir().expect("a folder");
    let python = stand_in(folder.path());
    let saved = folder.path().join("course.rrd");
    let (to, by) = (text(&saved), text(&python));
    succeed(&run_line(&format!(
        "courses view --family hard --seed 7 --save {to} --python {by}"
    )));
    let asked = asked(folder.path());
    has(&asked, &["- --course ", "--save /proc/"]);
    let course = json(&folder.path().join("python.json"));
    let count = |key: &str| course[key].as_array().map_or(0, Vec::len);
    let counts = ["solids", "way_ne_m", "movers"].map(count);
    assert!(counts[0] > 5 && counts[1] > 1 && counts[2] > 100, "{counts:?}");
    let depth: Vec<&serde_json::Value> = course["depth_mm"].as_array().expect("rows").iter().collect();
    assert_eq!((depth.len(), depth[0].as_array().map(Vec::len)), (64, Some(128)));
    let moving = |step: usize| &course["movers"][step]["solids"][0];
    assert_ne!(moving(0), moving(10), "obstacles move");
    // What was saved earlier stays where nothing takes its place.
    std::fs::write(&saved, "earlier").expect("written");
    std::fs::write(folder.path().join("python.fails"), "").expect("written");
    let failed = run_line(&format!("courses view --seed 7 --save {to} --python {by}"));
    refused(&failed, &["course.rrd: the viewer's script failed (exit status: 1)"]);
    assert_eq!(std::fs::read_to_string(&saved).expect("kept"), "earlier");
}

#[test]
fn some_flights_of_a_campaign_are_handed_to_one_viewer_and_their_logs_are_kept() {
    let folder = tempfile::tempdir().expect("a folder");
    let python = stand_in(folder.path());
    let json = folder.path().join("evaluate.json");
    let (by, to) = (text(&python), text(&json));
    let line = "evaluate --family training --flights 3 --seed 3 --view 2";
    let flown = succeed(&run_line(&format!("{line} --python {by} -o {to}")));
    let asked = asked(folder.path());
    let mut words = asked.split_whitespace().skip(1);
    let logs = PathBuf::from(words.next().expect("a folder"));
    assert_eq!(words.collect::<Vec<_>>()[..2], ["--flights", "3,4"]);
    let kept = |seed: u64| logs.join(format!("{seed}.mcap")).is_file();
    assert!(kept(3) && kept(4) && !kept(5), "{asked}");
    assert!(flown.contains(text(&logs)), "{}", flown);
}
