//! `vigil` and its laboratory: two programs of one build.

use std::process::Command;
use vigil_tests::{ended, refused, root, run, run_line, succeed, text, vigil};

#[test]
fn the_laboratory_is_started_where_it_is_built_and_otherwise_it_is_said_how_to_build_it() {
    let handed_on = run(&["detector", "evaluate", "--help"]);
    ended(&handed_on, 0, &["Usage: vigil detector evaluate"]);
    let help = run(&["help", "attack", "completion"]);
    ended(&help, 0, &["Usage: vigil attack completion"]);
    ended(&run(&["attack", "table", "--states", "none"]), 2, &[]);

    let folder = tempfile::tempdir().expect("a folder");
    // `vigil` without the laboratory beside it.
    let alone = folder.path().join("vigil");
    let made = std::fs::hard_link(vigil(), &alone).or_else(|_| std::fs::copy(vigil(), &alone).map(|_| ()));
    made.expect("a copy of the program");
    let film = folder.path().join("flight.gif");
    for command in [
        vec!["attack", "table"],
        vec!["log", "film", "flight.mcap"],
        vec!["fly", "--record", text(&film)],
    ] {
        let tried = Command::new(&alone).args(&command).output();
        refused(&tried.expect("vigil starts"), &["cargo build --release -p vigil-lab"]);
    }
    assert_eq!(std::fs::read_dir(folder.path()).expect("the folder").count(), 1);
}

#[test]
fn a_laboratory_of_other_sources_is_refused() {
    let lab = vigil().with_file_name("vigil-lab");
    let called = |sources: &str| {
        let mut lab = Command::new(&lab);
        lab.args(["reproduce", "--list"])
            .env("VIGIL_SOURCES_OF_CALLER", sources);
        lab.output().expect("vigil-lab starts")
    };
    refused(&called("0123456789abcdef"), &["other sources", "0123456789ab"]);
    succeed(&run(&["reproduce", "--list"]));
}

#[test]
fn what_no_work_can_come_of_is_refused_before_the_work() {
    let folder = tempfile::tempdir().expect("a folder");
    let empty = text(folder.path());
    let import = run(&["import", "missing.onnx", "-o", empty]);
    refused(&import, &["is a folder: name a file"]);
    for metres in ["nan", "-1", "inf"] {
        let attack = run_line(&format!("attack deflection --goal-distance={metres} -o {empty}"));
        refused(&attack, &["--goal-distance must be above 0"]);
    }
    // A folder that is named has runs, or is not left out in silence.
    let runs = root().join("docs/runs/from-nothing");
    let report = run(&["report", text(&runs), empty, "-o", empty]);
    refused(&report, &[&format!("no finished run in {empty}")]);
    assert_eq!(std::fs::read_dir(folder.path()).expect("the folder").count(), 0);
}
