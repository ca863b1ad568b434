//! The short programs that show how to use a crate alone do what they say.

use std::process::Command;
use vigil_tests::{said, vigil};

#[test]
fn every_example_runs_and_says_what_it_found() {
    for (name, part) in [
        ("explain_your_network", "which is the difference"),
        ("depth_frame", "course 7: nearest"),
        ("own_pilot", "course 7: success"),
        ("talk_to_a_vehicle", "MAV_RESULT_ACCEPTED"),
    ] {
        let program = vigil().with_file_name("examples").join(name);
        assert!(
            program.is_file(),
            "{} is missing: run `cargo build --release --workspace --examples`",
            program.display()
        );
        let output = Command::new(program).output().expect("it starts");
        let words = said(&output);
        assert!(output.status.success() && words.contains(part), "{name}: {words}");
    }
}
