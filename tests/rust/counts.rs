//! The house does not grow back: lines of each crate, packages, long functions, and words that are Vigil's own where the field has one.
//!
//! `counts.txt` beside this file holds what was reached; a count may only fall. `UPDATE_COUNTS=1 cargo test --release -p vigil-tests
//! --test counts` writes what is there now: where a count rises, CHANGELOG.md says what for.

use std::collections::BTreeMap;
use std::path::Path;
use std::{env, fs};
use vigil_tests::{files_below, pages, root};

/// A function may be as long; a longer one is counted.
const LONG_FUNCTION: usize = 80;
const LONG_FILE: usize = 600;
/// Words for which the field has another: whole words in Rust and in the pages.
const WORDS: [&str; 14] = [
    "told", "tells", "led", "lead", "leader", "judge", "judged", "judging", "doubts", "watched", "crew", "leg",
    "flyer", "wander",
];

/// Lines from `fn` to the brace that closes it, of each function of a formatted file.
fn function_lengths(text: &str) -> Vec<usize> {
    let lines: Vec<&str> = text.lines().collect();
    let begins = |line: &str| {
        let words: Vec<&str> = line.split_whitespace().take_while(|word| *word != "fn").collect();
        let is_prefix = |word: &&str| word.starts_with("pub") || ["const", "async", "unsafe", "extern"].contains(word);
        line.split_whitespace().nth(words.len()) == Some("fn") && words.iter().all(is_prefix)
    };
    let mut lengths = Vec::new();
    for (first, line) in lines.iter().enumerate().filter(|(_, line)| begins(line)) {
        let indent = &line[..line.len() - line.trim_start().len()];
        let end = lines[first..].iter().position(|line| {
            let own = line.strip_prefix(indent).unwrap_or_default();
            own.starts_with('}') || own.ends_with(';') && !own.starts_with(' ')
        });
        lengths.extend(end.map(|end| end + 1));
    }
    lengths
}

fn counts() -> BTreeMap<String, usize> {
    let manifest: toml::Table =
        toml::from_str(&fs::read_to_string(root().join("Cargo.toml")).expect("a manifest")).expect("TOML");
    let members: Vec<&str> = (manifest["workspace"]["members"].as_array().expect("members").iter())
        .filter_map(toml::Value::as_str)
        .collect();
    let mut counts = BTreeMap::new();
    let mut count = |name: String, more: usize| *counts.entry(name).or_insert(0) += more;
    count("packages of the workspace".to_owned(), members.len());
    let lock = fs::read_to_string(root().join("Cargo.lock")).expect("a lock file");
    count("packages in Cargo.lock".to_owned(), lock.matches("[[package]]").count());
    for path in files_below(&root(), &[".rs"]).into_iter().chain(pages()) {
        let text = fs::read_to_string(&path).expect("UTF-8");
        for word in text.split(|c: char| !c.is_alphanumeric() && c != '_') {
            let word = word.to_lowercase();
            if WORDS.contains(&&*word) {
                count(format!("word {word}"), 1);
            }
        }
        if path.extension().is_some_and(|ending| ending == "md") {
            count("words in the pages".to_owned(), text.split_whitespace().count());
            continue;
        }
        let within = path.strip_prefix(root()).expect("below the root");
        // The member whose folder is the longest that holds the file.
        let of = (members.iter().filter(|member| within.starts_with(member))).max_by_key(|member| member.len());
        count(format!("lines of {}", of.unwrap_or(&"others")), text.lines().count());
        let is_long = text.lines().count() > LONG_FILE;
        count(format!("files over {LONG_FILE} lines"), usize::from(is_long));
        let lengths = function_lengths(&text).into_iter();
        let long = lengths.filter(|length| *length > LONG_FUNCTION).count();
        count(format!("functions over {LONG_FUNCTION} lines"), long);
    }
    counts
}

#[test]
fn no_count_has_risen() {
    let (counts, file) = (counts(), Path::new(env!("CARGO_MANIFEST_DIR")).join("rust/counts.txt"));
    if env::var_os("UPDATE_COUNTS").is_some() {
        let lines = counts.iter().map(|(name, count)| format!("{name}: {count}\n"));
        fs::write(&file, lines.collect::<String>()).expect("written");
    }
    let reached = fs::read_to_string(&file).expect("counts.txt");
    let reached: BTreeMap<&str, usize> = (reached.lines().filter_map(|line| line.split_once(": ")))
        .map(|(name, count)| (name, count.parse().expect("a number")))
        .collect();
    let risen: Vec<String> = (counts.iter())
        .filter(|(name, count)| reached.get(name.as_str()).is_none_or(|most| *count > most))
        .map(|(name, count)| format!("{name}: {count}, was {:?}", reached.get(name.as_str())))
        .collect();
    assert!(
        risen.is_empty(),
        "{}\nmake it shorter; or say in CHANGELOG.md what it is for, and write the new count: UPDATE_COUNTS=1",
        risen.join("\n")
    );
}

#[test]
fn a_function_is_as_long_as_from_its_name_to_its_brace() {
    let text = "pub const fn one(a: u8) -> u8 {\n    a\n}\n\nimpl A {\n    fn two(\n        &self,\n    ) {\n    }\n\n    fn three(&self);\n}\n// fn four() {\n";
    assert_eq!(function_lengths(text), [3, 4, 1]);
}
