//! A campaign whose seeds were flown on several machines, or that was killed and went on, is the campaign: byte for byte what one machine
//! writes in one go.

use std::fs;
use std::path::Path;
use std::process::Output;
use vigil_tests::{ended, has, json, refused, run, succeed, text};

/// Short flights in the wind.
const FLIGHTS: &str = "evaluate --pilot=geometric --family=training --noise=1.1 --threads=2 --wind=2.5";

/// Runs [`FLIGHTS`] of these seeds with more arguments.
fn fly(seed: &str, flights: &str, json: &Path, more: &[&str]) -> Output {
    let of = ["--seed", seed, "--flights", flights, "-o", text(json)];
    let common: Vec<&str> = FLIGHTS.split(' ').collect();
    run(&[&common, &of[..], more].concat())
}

fn flown(seed: &str, flights: &str, json: &Path, more: &[&str]) -> String {
    succeed(&fly(seed, flights, json, more))
}

fn merge(files: &[&Path], json: &Path) -> Output {
    let names: Vec<&str> = files.iter().map(|file| text(file)).collect();
    run(&[&["merge"], &names[..], &["-o", text(json)]].concat())
}

fn bytes(path: &Path) -> Vec<u8> {
    fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Whether two reports are the same, and the flights beside them.
fn same(one: &Path, other: &Path, endings: &[&str]) {
    for ending in endings {
        let (one, other) = (one.with_extension(ending), other.with_extension(ending));
        assert!(bytes(&one) == bytes(&other), "{other:?} differs from {one:?}");
    }
}

#[test]
fn seeds_flown_on_three_machines_make_the_files_that_one_machine_writes_byte_for_byte() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = |name: &str| folder.path().join(name);
    let table = flown("3", "5", &file("one.json"), &[]);
    for (seed, flights, name) in [("7", "1", "c.json"), ("3", "2", "a.json"), ("5", "2", "b.json")] {
        flown(seed, flights, &file(name), &[]);
    }
    let [a, b, c] = ["a.jsonl", "b.jsonl", "c.jsonl"].map(file);
    let whole = file("whole.json");
    let words = succeed(&merge(&[&b, &c, &a, &b], &whole));
    same(&file("one.json"), &whole, &["json", "jsonl"]);
    // The same table; only one machine knows how long it took.
    let of_one = ["simulated in", "details", "gone"];
    let rows = |words: &str| -> Vec<String> {
        let lines = words.lines().map(str::to_owned);
        let of_both = lines.filter(|line| !of_one.iter().any(|word| line.contains(word)));
        of_both.collect()
    };
    assert_eq!(rows(&table), rows(&words));
    // Lines that were put together by other means.
    let joined = file("joined.jsonl");
    fs::write(&joined, [bytes(&c), bytes(&a), bytes(&b)].concat()).expect("written");
    succeed(&merge(&[&joined], &file("joined-whole.json")));
    same(&whole, &file("joined-whole.json"), &["json", "jsonl"]);

    // What does not make a whole is refused, and the file that is there is kept.
    let before = bytes(&whole);
    let makes_none = |files: &[&Path], why: &str| refused(&merge(files, &whole), &[why]);
    makes_none(&[&a, &c], "2 of 5 flights are missing: fly --seed 5 --flights 2");
    flown("1000000000000", "1", &file("far.json"), &[]);
    let far = "fly --seed 5 --flights 2, --seed 8 --flights 999999999992";
    makes_none(&[&a, &c, &file("far.jsonl")], far);
    let words = flown("9", "1", &file("far.json"), &["--resume"]);
    let (is_part, is_cut) = (words.contains("incomplete"), words.contains("interrupted"));
    assert!(is_part && !is_cut, "{words}");
    flown("5", "2", &file("still.json"), &["--still"]);
    makes_none(&[&a, &file("still.jsonl"), &c], "still was true, and is false");
    let lines = fs::read_to_string(&b).expect("lines");
    let program = lines.split("\"program_sha256\":\"").nth(1).expect("a program")[..64].to_owned();
    let altered = |name: &str, from: &str, to: &str| {
        fs::write(file(name), lines.replace(from, to)).expect("written");
        file(name)
    };
    let other = altered("program.jsonl", &program, &"0".repeat(64));
    makes_none(&[&a, &other, &c], "program_sha256 was");
    let other = altered("longer.jsonl", "\"steps\":", "\"steps\":1");
    makes_none(&[&a, &b, &other, &c], "contradicts an earlier flight of seed 5");
    let other = altered("seeds.jsonl", "{\"seed\":6,\"arm", "{\"seed\":5,\"arm");
    makes_none(&[&a, &other, &c], "line 3 is of another seed than its flight");
    let other = altered("none.jsonl", "\"flights\":2", "\"flights\":0");
    makes_none(&[&a, &b, &c, &other], "none.jsonl is of no flight");
    let other = altered("cut.jsonl", "\"steps\":", "\"ste");
    makes_none(&[&a, &other, &c], "line 2 is damaged");
    let other = altered("counts.jsonl", "\"flown_steps\":", "\"flown_steps\":99999");
    makes_none(&[&a, &other, &c], "line 2 is damaged");
    makes_none(&[&a, &file("one.json"), &c], "one.json");
    assert!(bytes(&whole) == before, "what was there is kept");

    // Another program wrote the lines anew: a mark in front, entries by name, and no `.0`.
    let anew = |line: &str| {
        let value: serde_json::Value = serde_json::from_str(line).expect("JSON");
        value.to_string().replace(".0,", ",").replace(".0}", "}") + "\n"
    };
    let anew: String = lines.lines().map(anew).collect();
    fs::write(file("anew.jsonl"), format!("\u{feff}{anew}")).expect("written");
    succeed(&merge(&[&file("anew.jsonl"), &a, &c], &whole));
    same(&file("one.json"), &whole, &["json", "jsonl"]);
}

#[test]
fn a_killed_campaign_goes_on_with_every_flight_that_had_ended() {
    let folder = tempfile::tempdir().expect("a folder");
    let (one, killed) = (folder.path().join("one.json"), folder.path().join("killed.json"));
    flown("3", "4", &one, &[]);
    // The third flight was being written when the process was killed.
    let lines = fs::read_to_string(one.with_extension("jsonl")).expect("lines");
    let third = lines.match_indices('\n').nth(2).expect("three lines").0;
    // Then somebody took the half line away, and the newline before it.
    for len in [third + 50, third] {
        fs::write(killed.with_extension("jsonl"), &lines[..len]).expect("written");
        let words = flown("3", "4", &killed, &["--resume"]);
        assert!(words.contains("2 of 4 flights are there already"), "{words}");
        same(&one, &killed, &["json", "jsonl"]);
    }
    // More flights of the same campaign, some of which are there.
    let pictures = folder.path().join("pictures");
    let words = flown("3", "5", &killed, &["--resume", "--draw-failures", text(&pictures)]);
    let there = "4 of 5 flights are there already";
    has(&words, &[there, "--draw-failures have the others only"]);
    let before = bytes(&killed.with_extension("jsonl"));
    // What the first flight would be refused for is found before earlier flights make room.
    let hard = ["evaluate", "--family=hard", "--goal-distance=30", "-o", text(&killed)];
    refused(&run(&hard), &["cannot be made longer"]);
    assert!(bytes(&killed.with_extension("jsonl")) == before);
    let still = fly("3", "5", &killed, &["--resume", "--still"]);
    refused(&still, &["still was false, and is true"]);
    assert!(bytes(&killed.with_extension("jsonl")) == before);
    // Without the word it is flown anew, in place of a campaign's lines and of no others.
    assert!(!flown("3", "4", &killed, &[]).contains("already"));
    same(&one, &killed, &["json", "jsonl"]);
    fs::write(killed.with_extension("jsonl"), "{\"mine\":1}\n").expect("written");
    refused(&fly("3", "4", &killed, &[]), &["is no campaign's"]);
}

#[test]
fn campaigns_of_faults_and_of_attacks_are_put_together_too() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = |name: &str| folder.path().join(name);
    let fault = ["--sensor-fault", "zeros@1", "--second-sensor-heads", "1"];
    flown("3", "2", &file("fault.json"), &fault);
    flown("3", "1", &file("fault-1.json"), &fault);
    flown("4", "1", &file("fault-2.json"), &fault);
    let whole_sensor = fly("3", "2", &file("fault-1.json"), &[&["--resume"], &fault[2..]].concat());
    refused(&whole_sensor, &["sensor_fault was \"zeros@1\", and is absent"]);
    let [own, other] = ["fault-1.jsonl", "fault-2.jsonl"].map(file);
    succeed(&merge(&[&own, &other], &file("faults.json")));
    same(&file("fault.json"), &file("faults.json"), &["json", "jsonl"]);
    // A report of that name would take the place of the flights beside it.
    let before = bytes(&own);
    refused(&merge(&[&own, &other], &own), &["give it another ending"]);
    assert!(bytes(&own) == before);
    let report = json(&file("faults.json"));
    assert_eq!(report["second_sensor_heads"], 1);

    flown("3", "1", &file("fgsm.json"), &["--attack=fgsm"]);
    let evading = fly(
        "3",
        "1",
        &file("fgsm.json"),
        &["--attack=fgsm", "--evade-guard", "--resume"],
    );
    refused(&evading, &["attack.evades_guard was absent, and is true"]);
    let attack = |folder: &Path, words: &[&str], more: &[&str]| {
        run(&[&["attack"], words, &["--iterations=1", "-o", text(folder)], more].concat())
    };
    let completion = |folder: &Path, seed: &str, flights: &str| {
        let words = ["completion", "--seed", seed, "--flights", flights];
        succeed(&attack(folder, &words, &[]));
    };
    let defended = ["defended", "--seed=5003", "--flights=1", "--arms"];
    let one_arm = |arm| [&defended[..], &[arm, "--burst=20"]].concat();
    let [all, one, two] = ["all", "one", "two"].map(file);
    completion(&all, "5003", "2");
    completion(&one, "5003", "1");
    completion(&two, "5004", "1");
    let lines = [one.join("completion.jsonl"), two.join("completion.jsonl")];
    succeed(&merge(&[&lines[1], &lines[0]], &file("completion.json")));
    let of_all = all.join("completion.json");
    same(&of_all, &file("completion.json"), &["json", "jsonl"]);

    // With the detector and without it; the arms may have been flown one after the other.
    succeed(&attack(&all, &one_arm("recover,none"), &[]));
    succeed(&attack(&one, &one_arm("recover"), &[]));
    succeed(&attack(&one, &one_arm("none"), &["--resume"]));
    for ending in ["csv", "json"] {
        same(&all.join("defended.json"), &one.join("defended.json"), &[ending]);
    }
    refused(&attack(&one, &one_arm("none"), &[]), &["add --resume"]);
    let longer = [&defended[..], &["none", "--burst=21"]].concat();
    let longer = attack(&one, &longer, &["--resume"]);
    refused(&longer, &["burst was \"20\", and is \"21\""]);
    let none = file("x.json");
    let makes_none = |other: &Path, why: &str| refused(&merge(&[&lines[0], other], &none), &[why]);
    let defended = one.join("defended.jsonl");
    makes_none(&defended, "it is of `attack defended`, not of `attack completion`");
    makes_none(&file("fault.jsonl"), "it is of `evaluate`");
    assert!(!none.exists());
}

#[test]
fn a_detectors_flights_are_gathered_on_several_machines_and_make_the_files_of_one() {
    let folder = tempfile::tempdir().expect("a folder");
    let [some, all, one] = ["some", "all", "one"].map(|name| folder.path().join(name));
    let collect = |folder: &Path, more: &[&str]| {
        let words = succeed(&run(&[&["detector", "collect", "-o", text(folder)], more].concat()));
        assert!(!words.contains("interrupted"), "{words}");
    };
    // Half of the dozen that gives so many windows.
    collect(&some, &["--set", "learn", "--seed", "3000", "--flights", "6"]);
    fs::create_dir(&all).expect("a folder");
    succeed(&merge(&[&some.join("learn.jsonl")], &all.join("learn.jsonl")));
    same(&some.join("learn"), &all.join("learn"), &["jsonl"]);
    collect(&all, &["--windows", "100"]);
    assert!(!all.join("learn.jsonl").exists(), "the flights are in the file now");
    fs::create_dir(&one).expect("a folder");
    fs::copy(all.join("choose.safetensors"), one.join("choose.safetensors")).expect("a copy");
    collect(&one, &["--windows", "100"]);
    same(&all.join("learn"), &one.join("learn"), &["safetensors"]);
    let unnamed = run(&["detector", "collect", "--set", "learn", "-o", text(&one)]);
    ended(&unnamed, 2, &[]);
}
