//! The configuration file with every key, its default and what it accepts, made from the table of parameters.

use std::fmt::Write as _;
use vigil_types::parameters::{ALL, Kind, ParameterSpec, Preset, SECTIONS, Section};

/// Where the comments begin.
const COMMENT_COLUMN: usize = 31;

/// The configuration file's reference, as TOML. Keys without a default, and sections that may be left out, are commented out.
pub fn configuration() -> String {
    let mut out = String::new();
    let no_section = Section {
        name: "",
        text: "",
        is_optional: false,
    };
    for section in [&no_section].into_iter().chain(SECTIONS) {
        let mark = if section.is_optional { "# " } else { "" };
        if !section.name.is_empty() {
            line(&mut out, &format!("\n{mark}[{}]", section.name), section.text);
        }
        for row in ALL {
            let (of, name) = row.key.rsplit_once('.').unwrap_or(("", row.key));
            if of == section.name {
                let has_none = matches!(row.default, Preset::Absent(_));
                let mark = if has_none && !section.is_optional { "# " } else { mark };
                line(&mut out, &format!("{mark}{name} = {}", value(row)), &comment(row));
            }
        }
    }
    out
}

fn line(out: &mut String, text: &str, comment: &str) {
    let column = COMMENT_COLUMN + text.len() - text.trim_start_matches('\n').len();
    // Writing to a string does not fail.
    let _ = writeln!(out, "{text:column$} # {comment}");
}

/// The default, or the example where there is none.
fn value(row: &ParameterSpec) -> String {
    match (row.default, row.kind) {
        (Preset::Absent(example), _) => example.to_owned(),
        (Preset::Switch(on), _) => on.to_string(),
        (Preset::Number(value), Kind::Whole(_)) => value.to_string(),
        // With its point, as TOML wants it.
        (Preset::Number(value), _) => format!("{value:?}"),
        (Preset::Choice(place), Kind::Choice(words)) => words
            .get(place)
            .map_or_else(String::new, |(word, _)| format!("\"{word}\"")),
        (Preset::Choice(place), _) => place.to_string(),
    }
}

/// What it means and what is accepted.
fn comment(row: &ParameterSpec) -> String {
    match row.kind {
        Kind::Real(range) | Kind::Whole(range) if range.greatest < f64::from(u32::MAX) => {
            format!("{} ({range})", row.text)
        }
        Kind::Choice(words) => {
            let words: Vec<_> = words.iter().map(|(word, _)| *word).collect();
            format!("{}: {}", row.text, words.join(" | "))
        }
        _ => row.text.to_owned(),
    }
}
