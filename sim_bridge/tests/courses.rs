//! The course files that come with the project.

use std::path::{Path, PathBuf};
use vigil_sim::world::Course;

fn files() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("courses");
    let entries = std::fs::read_dir(folder).expect("the folder of courses");
    let mut files: Vec<_> = entries.map(|e| e.expect("an entry").path()).collect();
    files.retain(|file| file.extension().is_some_and(|ending| ending == "toml"));
    files.sort();
    files
}

#[test]
fn every_course_file_is_valid_named_after_its_file_and_flyable() {
    let files = files();
    assert!(files.len() >= 3);
    for file in files {
        let course = Course::load(&file).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(file.file_stem().and_then(|s| s.to_str()), Some(course.name.as_str()));
        assert!(course.corridor().is_some(), "{} has no way", file.display());
    }
}

#[test]
fn the_hand_made_arena_cannot_be_flown_straight_and_has_every_kind_of_obstacle() {
    let arena = concat!(env!("CARGO_MANIFEST_DIR"), "/courses/arena.toml");
    let arena = Course::load(Path::new(arena)).expect("valid");
    assert!(arena.straight_line_is_blocked());
    let kinds = [
        arena.columns.len(),
        arena.boxes.len(),
        arena.walls.len(),
        arena.overhangs.len(),
        arena.wires.len(),
    ];
    assert!(kinds.iter().all(|n| *n > 0), "{kinds:?}");
}
