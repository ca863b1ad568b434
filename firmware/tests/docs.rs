//! The references in the documentation are what the program takes: both come from the table of parameters.
//! `UPDATE_DOCS=1 cargo test --release -p vigil-firmware --test docs` writes them.

#[path = "../guidance/tests/common/page.rs"]
mod page;

use std::fmt::Write as _;
use vigil_firmware::{FirmwareConfig, reference};
use vigil_types::parameters::{ALL, Kind, SECTIONS};
use vigil_types::settings::Value;

fn mavlink_parameters() -> String {
    let mut out =
        String::from("| Name | Type | Accepted | Configuration | In flight |\n| --- | --- | --- | --- | --- |\n");
    for row in ALL {
        let Some(mavlink) = row.mavlink else { continue };
        let (kind, accepted) = match row.kind {
            Kind::Choice(words) => {
                let listed: Vec<_> = (0..)
                    .zip(words)
                    .map(|(code, (word, _))| format!("{code} {word}"))
                    .collect();
                ("INT32", listed.join(", "))
            }
            Kind::Switch => ("INT32", "0 off, 1 on".to_owned()),
            _ => ("REAL32", row.range().unwrap().to_string()),
        };
        let in_flight = if mavlink.in_flight { "yes" } else { "no" };
        writeln!(
            out,
            "| `{}` | {kind} | {accepted} | `{}` | {in_flight} |",
            mavlink.name, row.key
        )
        .unwrap();
    }
    out
}

#[test]
fn the_page_holds_the_table_of_parameters() {
    let configuration = format!("```toml\n{}```\n", reference::configuration());
    let sections = [("configuration", configuration), ("parameters", mavlink_parameters())];
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/firmware.md");
    page::holds(path, &sections, "-p vigil-firmware --test docs");
}

#[test]
fn every_key_of_the_reference_is_known_and_every_key_is_in_the_reference() {
    // With the keys that have no default switched on.
    let full = reference::configuration().replace("\n# ", "\n");
    let config = FirmwareConfig::from_toml(&full).unwrap();
    let written = config.to_toml();
    let keys = |text: &str| -> Vec<String> {
        let mut keys: Vec<String> = text
            .lines()
            .filter_map(|line| Some(line.split_once([' ', ']'])?.0.to_owned()))
            .collect();
        keys.sort();
        keys
    };
    assert_eq!(keys(&written), keys(&full));
}

#[test]
fn the_file_accepts_what_the_table_says_and_nothing_else() {
    let default = FirmwareConfig::default();
    for row in ALL {
        // A section that may be left out is whole or not there.
        let is_part = SECTIONS
            .iter()
            .any(|section| section.is_optional && row.key.starts_with(section.name));
        if is_part {
            continue;
        }
        let with = |value: Value| default.with(row, &value);
        match row.kind {
            Kind::Real(range) => {
                for limit in [range.least, range.greatest] {
                    assert!(with(limit.into()).is_ok(), "{} = {limit}", row.key);
                }
                for beyond in [range.greatest + 1.0, range.least - 2.0, f64::NAN] {
                    let refused = with(beyond.into()).unwrap_err();
                    assert!(refused.contains(&range.to_string()), "{}: {refused}", row.key);
                }
            }
            Kind::Whole(range) => {
                for limit in [range.least, range.greatest] {
                    assert!(with((limit as i64).into()).is_ok(), "{} = {limit}", row.key);
                }
                assert!(with((range.greatest as i64 + 1).into()).is_err(), "{}", row.key);
            }
            Kind::Choice(words) => {
                for (word, _) in words {
                    assert!(with((*word).into()).is_ok(), "{} = {word}", row.key);
                }
                let refused = with("perhaps".into()).unwrap_err();
                assert!(words.iter().all(|(word, _)| refused.contains(word)), "{refused}");
            }
            Kind::Switch => assert!(with(true.into()).is_ok() && with(1.into()).is_err(), "{}", row.key),
            Kind::Text => {}
        }
    }
}
