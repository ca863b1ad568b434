//! The flight report holds the whole story of an attacked and recovered flight, and of a bad log what can be shown.

use serde_json::Value;
use std::path::Path;
use vigil_log::{FlightInfo, Story};
use vigil_tests::{attacked_flight, copy_log, has, refused, run, succeed, text, write_log};
use vigil_types::{GuidanceState, Kinematics, Landed, NedVector, Reason, Reasons};

fn data(report: &Path) -> Value {
    let page = std::fs::read_to_string(report).expect("a report");
    let (_, rest) = page.split_once("id=\"data\">").expect("data in the page");
    let (json, _) = rest.split_once("</script>").expect("the end of the data");
    serde_json::from_str(json).expect("JSON")
}

/// Makes a report of a log beside it.
fn report(log: &Path) -> Value {
    let said = succeed(&run(&["log", "report", "--shap", "0", text(log)]));
    let report = data(&log.with_extension("html"));
    let is_cut = notes(&report).contains("was not closed");
    assert_eq!(said.contains("it is not all of the flight"), is_cut, "{said}");
    report
}

fn list<'a>(value: &'a Value, key: &str) -> &'a [Value] {
    value[key].as_array().unwrap_or_else(|| panic!("{key} is no list"))
}

fn notes(value: &Value) -> String {
    value["notes"].to_string()
}

#[test]
fn an_attacked_and_recovered_flight_has_data_in_every_panel_and_its_log_replays_bit_for_bit() {
    let folder = tempfile::tempdir().expect("a folder");
    let log = attacked_flight(folder.path());
    let flight = data(&log.with_extension("html"));

    let steps = list(&flight, "t").len();
    every_panel_has_data(&flight);
    let name = |who: &Value| &flight["who_names"][who.as_u64().expect("a number") as usize];
    let who: Vec<&Value> = list(&flight, "who").iter().map(name).collect();
    for pilot in ["actor", "hold", "recovery pilot"] {
        assert!(who.iter().any(|who| *who == pilot), "{pilot}: {who:?}");
    }
    assert_eq!(list(&flight, "attack").iter().filter(|a| **a == 1).count(), 50);
    // Verdict and guard ask for five frames of six both.
    let cause = flight["alarms"][0][1].as_str().expect("a cause");
    assert!(["attack", "rough picture"].contains(&cause), "{cause}");
    assert!(flight["phi"]["values"].as_str().is_some_and(|v| v.len() > steps * 48));
    assert!(!list(&flight["map"], "solids").is_empty() && list(&flight["map"], "truth").len() > 50);
    assert!(flight["map"]["goal"].is_array());
    let is_shown = |f: &Value| f["altered"] == true && f["clean"].is_string() && f["clean"] != f["depth"];
    assert!(list(&flight, "frames").iter().any(is_shown));
    let events = list(&flight, "events").iter().filter_map(|e| e["text"].as_str());
    let events: Vec<&str> = events.collect();
    let is_shown = |words: &str| events.iter().any(|text| text.contains(words));
    for words in [
        &*format!("alarm: {cause}"),
        "frames are altered",
        "hold → guided",
        "the flight ended: success",
        "closest to",
    ] {
        assert!(is_shown(words), "no event `{words}`");
    }
    assert_eq!(flight["verdict"]["good"], true);
    let command = flight["command"].as_str().expect("a command");
    assert!(command.starts_with("vigil evaluate --apf off --attack"), "{command}");
    assert!(command.ends_with("--flights 1 --seed 3001"), "{command}");
    assert_eq!(notes(&flight), "[]");

    // From disk alone: nothing in the page names another place to load from.
    let page = std::fs::read_to_string(log.with_extension("html")).expect("a report");
    for address in ["src=\"http", "href=", "@import", "fetch(", "url(http"] {
        assert!(!page.contains(address), "{address}");
    }
    assert!(page.len() < 4_000_000, "{} bytes", page.len());

    succeed(&run(&["replay", text(&log)]));
    let story = Story::read(&log).expect("a log");
    assert_eq!(story.attack.iter().filter(|m| m.altered).count(), 50);
    assert!(!story.clean.is_empty() && story.truth.is_sorted_by_key(|(at_ns, _)| *at_ns));

    a_log_that_was_cut_is_shown_as_far_as_it_is_whole(&log);
    a_log_without_frames_says_so_and_shows_the_rest(&log);
    a_log_of_another_version_is_refused_by_name(&log);
}

fn every_panel_has_data(flight: &Value) {
    let steps = list(flight, "t").len();
    for panel in list(flight, "panels") {
        let id = panel["id"].as_str().expect("a name");
        for series in list(panel, "series") {
            let column = series["column"].as_str().expect("a column");
            let values = list(&flight["columns"], column);
            assert_eq!(values.len(), steps, "{column}");
            // A flight in lockstep has no clock of its own.
            if id != "step-time" {
                assert!(values.iter().any(Value::is_number), "{id}: {column} is empty");
            }
        }
    }
}

fn a_log_that_was_cut_is_shown_as_far_as_it_is_whole(log: &Path) {
    let bytes = std::fs::read(log).expect("a log");
    let cut = log.with_file_name("cut.mcap");
    std::fs::write(&cut, &bytes[..bytes.len() / 2]).expect("a file");
    let flight = report(&cut);
    assert!(notes(&flight).contains("was not closed"), "{}", notes(&flight));
    assert!(list(&flight, "t").len() > 100 && !list(&flight, "frames").is_empty());
}

fn a_log_without_frames_says_so_and_shows_the_rest(log: &Path) {
    let blind = log.with_file_name("blind.mcap");
    copy_log(log, &blind, |record| record.set_frame(None));
    let flight = report(&blind);
    has(&notes(&flight), &["No step of this log has a depth frame"]);
    assert_eq!(flight["film_none"], "The log holds no depth frames.");
    // This copy does not know the referee's word, but guidance held at the goal before the flight ended.
    assert_eq!(flight["verdict"]["text"], "The goal was reached.");
    let scores = list(&flight["columns"], "detector_score");
    assert!(scores.iter().any(Value::is_number));
}

fn a_log_of_another_version_is_refused_by_name(log: &Path) {
    let mut bytes = std::fs::read(log).expect("a log");
    // The entry `format` of the metadata: its length, its name, the length of its value, its value.
    let entry = b"\x06\0\0\0format\x01\0\0\x001";
    let at = bytes.windows(entry.len()).position(|w| w == entry);
    bytes[at.expect("the version") + entry.len() - 1] = b'9';
    let other = log.with_file_name("other.mcap");
    std::fs::write(&other, bytes).expect("a file");
    let reported = run(&["log", "report", text(&other)]);
    refused(&reported, &["log format 9, this program reads 1"]);
    assert!(!other.with_extension("html").exists());
}

#[test]
fn a_flight_that_never_took_off_says_why_and_a_log_without_a_step_that_there_is_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("grounded.mcap");
    write_log(&path, FlightInfo::default(), 40, |slot| {
        let step = slot.timing.step;
        slot.report.now_ns = slot.now_ns;
        slot.report.reasons = Reasons::of(Reason::LinkLost).with_if(step < 20, Reason::NoGoal);
        // Guidance holds, and the estimate of a vehicle that stands is never still.
        slot.report.state = GuidanceState::Hold;
        slot.report.telemetry.landed = Landed::OnGround;
        let position_ned_m = NedVector::new((step % 2) as f32, 0.0, 0.0);
        slot.report.telemetry.kinematics = Some(Kinematics::new(0, position_ned_m, NedVector::default()));
    });
    let flight = report(&path);
    assert_eq!(flight["verdict"]["text"], "The vehicle never took off.");
    has(&notes(&flight), &["link lost for 2.0 s, no goal for 1.0 s"]);
    let facts = flight["facts"].to_string();
    has(&facts, &["nobody: the vehicle never took off", "\"0.0 m, at most"]);

    let empty = folder.path().join("empty.mcap");
    write_log(&empty, FlightInfo::default(), 0, |_| {});
    refused(&run(&["log", "report", text(&empty)]), &["holds no step"]);
    // One that is damaged before its first whole step is not one without steps: the others can be saved.
    let damaged = folder.path().join("damaged.mcap");
    write_log(&damaged, FlightInfo::default(), 10, |_| {});
    let mut bytes = std::fs::read(&damaged).expect("a log");
    let chunk = bytes.windows(7).position(|w| w == b"\x03\0\0\0lz4").expect("a chunk");
    bytes[chunk + 40] ^= 0x10;
    std::fs::write(&damaged, bytes).expect("a file");
    let none = run(&["log", "report", text(&damaged)]);
    refused(&none, &["is damaged after record 0", "`vigil recover`"]);

    let none = folder.path().join("none.mcap");
    refused(&run(&["log", "report", text(&none)]), &["none.mcap"]);
}
