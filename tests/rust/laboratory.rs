//! `vigil` and its laboratory: two programs of one build.

use std::path::Path;
use std::process::Command;
use vigil_tests::{run, said, vigil};

/// `vigil` alone in a folder, without the laboratory.
fn flight_tier_alone(folder: &Path) -> std::path::PathBuf {
    let alone = folder.join("vigil");
    std::fs::hard_link(vigil(), &alone)
        .or_else(|_| std::fs::copy(vigil(), &alone).map(|_| ()))
        .expect("a copy of the program");
    alone
}

#[test]
fn the_laboratory_is_started_where_it_is_built_and_otherwise_told_how_to_build_it() {
    let handed_on = run(&["detector", "evaluate", "--help"]);
    assert_eq!(handed_on.status.code(), Some(0));
    assert!(said(&handed_on).contains("Usage: vigil detector evaluate"));
    assert_eq!(run(&["attack", "table", "--states", "none"]).status.code(), Some(2));

    let folder = tempfile::tempdir().expect("a folder");
    let alone = flight_tier_alone(folder.path());
    let film = folder.path().join("flight.gif");
    for command in [
        vec!["attack", "table"],
        vec!["log", "film", "flight.mcap"],
        vec!["fly", "--record", film.to_str().expect("a UTF-8 path")],
    ] {
        let refused = Command::new(&alone).args(&command).output().expect("vigil starts");
        assert_eq!(refused.status.code(), Some(1));
        assert!(
            said(&refused).contains("cargo build --release -p vigil-lab"),
            "{}",
            said(&refused)
        );
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
    let refused = called("0123456789abcdef");
    assert_eq!(refused.status.code(), Some(1));
    assert!(said(&refused).contains("other sources") && said(&refused).contains("0123456789ab"));
    assert_eq!(run(&["reproduce", "--list"]).status.code(), Some(0));
}
