//! A campaign in parts is the campaign: byte for byte what one machine writes.

use std::path::{Path, PathBuf};
use std::process::Output;
use vigil_tests::{run, said};

/// Short flights in the wind.
struct Flights {
    count: &'static str,
    wind: &'static str,
}

const FIVE: Flights = Flights {
    count: "5",
    wind: "2.5",
};

impl Flights {
    fn run(&self, more: &[&str]) -> Output {
        let common = [
            "evaluate",
            "--pilot",
            "geometric",
            "--family",
            "training",
            "--seed",
            "3",
            "--noise",
            "1.1",
            "--flights",
            self.count,
            "--wind",
            self.wind,
        ];
        run(&[&common, more].concat())
    }

    /// Flies with more arguments; the words said.
    fn fly(&self, more: &[&str], whole: &Path) -> String {
        let output = self.run(&[more, &["-o", text(whole)]].concat());
        assert_eq!(output.status.code(), Some(0), "{}", said(&output));
        said(&output)
    }
}

fn text(path: &Path) -> &str {
    path.to_str().expect("a UTF-8 path")
}

fn merge(parts: &[PathBuf], whole: &Path) -> (Option<i32>, String) {
    let names: Vec<&str> = parts.iter().map(|part| text(part)).collect();
    let output = run(&[&["merge"], &names[..], &["-o", text(whole)]].concat());
    (output.status.code(), said(&output))
}

#[test]
fn the_parts_of_a_campaign_make_the_file_that_one_machine_writes_byte_for_byte() {
    let folder = tempfile::tempdir().expect("a folder");
    let (whole, merged) = (folder.path().join("whole.json"), folder.path().join("merged.json"));
    let table = FIVE.fly(&["--threads", "2"], &whole);
    let part = |k: u64| folder.path().join(format!("merged.{k}-of-3.part.json"));
    for shard in ["3/3", "1/3", "2/3"] {
        FIVE.fly(&["--threads", "1", "--shard", shard], &merged);
    }
    assert!(!merged.exists(), "a shard leaves its part only");
    let (code, words) = merge(&[part(2), part(3), part(1), part(2)], &merged);
    assert_eq!(code, Some(0), "{words}");
    let bytes = |path: &Path| std::fs::read(path).expect("a file");
    assert!(bytes(&whole) == bytes(&merged), "the merged file differs");
    // The same table; only one machine knows how long it took.
    let rows = |words: &str| -> Vec<String> {
        let told = |line: &&str| !line.contains("simulated in") && !line.contains("details") && !line.contains("gone");
        words.lines().filter(told).map(str::to_owned).collect()
    };
    assert_eq!(rows(&table), rows(&words));
    std::fs::remove_file(&merged).expect("it is there");
    assert_eq!(merge(&[folder.path().to_owned()], &merged).0, Some(0));
    assert!(bytes(&whole) == bytes(&merged), "merging again changes nothing");

    // Flown again, a whole part costs nothing and stays as it is.
    let before = bytes(&part(1));
    let words = FIVE.fly(&["--shard", "1/3"], &merged);
    assert!(words.contains("1 of 1 flights"), "{words}");
    assert!(bytes(&part(1)) == before);

    // What does not make a whole is refused, and the file that is there is kept.
    let (code, words) = merge(&[part(1), part(3)], &merged);
    assert_eq!(code, Some(1));
    assert!(words.contains("2 of 5 flights are missing: fly --shard 2/3"), "{words}");
    let calm = folder.path().join("calm.json");
    Flights { wind: "0", ..FIVE }.fly(&["--shard", "2/3"], &calm);
    let (code, words) = merge(
        &[part(1), folder.path().join("calm.2-of-3.part.json"), part(3)],
        &merged,
    );
    assert_eq!(code, Some(1));
    assert!(words.contains("wind_m_s was 2.5, and is 0.0"), "{words}");
    assert!(bytes(&whole) == bytes(&merged), "what was there is kept");
}

#[test]
fn campaigns_of_faults_and_of_attacks_are_put_together_too() {
    let folder = tempfile::tempdir().expect("a folder");
    let bytes = |path: &Path| std::fs::read(path).expect("a file");
    let file = |name: &str| folder.path().join(name);
    let two_flights = Flights { count: "2", ..FIVE };
    let fault = ["--sensor-fault", "zeros@1", "--second-sensor-heads", "1"];
    two_flights.fly(&fault, &file("fault.json"));
    for shard in ["1/2", "2/2"] {
        two_flights.fly(&[&fault[..], &["--shard", shard]].concat(), &file("parts.json"));
    }
    let parts = ["parts.1-of-2.part.json", "parts.2-of-2.part.json"].map(file);
    assert_eq!(merge(&parts, &file("parts.json")).0, Some(0));
    assert!(bytes(&file("fault.json")) == bytes(&file("parts.json")));
    let report: serde_json::Value = serde_json::from_slice(&bytes(&file("parts.json"))).expect("JSON");
    assert_eq!(report["second_sensor_heads"], 1);

    let attack = |folder: &Path, more: &[&str]| {
        let common = [
            "attack",
            "completion",
            "--flights",
            "1",
            "--seed",
            "5003",
            "--iterations",
            "1",
        ];
        let output = run(&[&common, more, &["-o", text(folder)]].concat());
        assert_eq!(output.status.code(), Some(0), "{}", said(&output));
    };
    let (one, two) = (file("one"), file("two"));
    attack(&one, &[]);
    for shard in ["1/2", "2/2"] {
        attack(&two, &["--shard", shard]);
    }
    let parts = ["completion.1-of-2.part.json", "completion.2-of-2.part.json"].map(|name| two.join(name));
    let (code, words) = merge(&parts, &two.join("completion.json"));
    assert_eq!(code, Some(0), "{words}");
    assert!(bytes(&one.join("completion.json")) == bytes(&two.join("completion.json")));
    // With the detector and without it: the flights beside the table are the same as well.
    let defended = |folder: &Path, more: &[&str]| {
        let common = [
            "attack",
            "defended",
            "--arms=recover,none",
            "--flights=1",
            "--seed=5003",
            "--iterations=1",
            "--burst=20",
        ];
        let output = run(&[&common, more, &["-o", text(folder)]].concat());
        assert_eq!(output.status.code(), Some(0), "{}", said(&output));
    };
    defended(&one, &[]);
    for shard in ["2/2", "1/2"] {
        defended(&two, &["--shard", shard]);
    }
    let pieces = ["defended.1-of-2.part.json", "defended.2-of-2.part.json"].map(|name| two.join(name));
    let (code, words) = merge(&pieces, &two.join("defended.json"));
    assert_eq!(code, Some(0), "{words}");
    for name in ["defended.json", "defended.csv"] {
        assert!(bytes(&one.join(name)) == bytes(&two.join(name)), "{name} differs");
    }
    let (code, words) = merge(&[parts[0].clone(), pieces[0].clone()], &two.join("x.json"));
    assert_eq!(code, Some(1));
    assert!(
        words.contains("it was `attack completion`, and is `attack defended`"),
        "{words}"
    );
    let (code, words) = merge(&[parts[0].clone(), file("parts.1-of-2.part.json")], &two.join("x.json"));
    assert_eq!(code, Some(1));
    assert!(
        words.contains("it was `attack completion`, and is `evaluate`"),
        "{words}"
    );
    assert!(!two.join("x.json").exists());
}

#[test]
fn a_shard_that_is_none_is_refused_before_anything_is_flown() {
    for shard in ["0/3", "4/3", "3", "1/9"] {
        let output = FIVE.run(&["--shard", shard, "-o", "-"]);
        assert_ne!(output.status.code(), Some(0));
        assert!(output.stdout.is_empty(), "{}", said(&output));
        let words = said(&output);
        assert!(
            words.contains("K/N") || words.contains("at most so many parts"),
            "{words}"
        );
    }
}
