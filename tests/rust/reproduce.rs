//! `vigil reproduce` makes every table and figure that the documentation shows, from data that are whole, and goes on where it was
//! interrupted.

use rustix::process::Signal;
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use vigil_tests::{Running, files_below, json, pages, refused, root, run, succeed, text};

/// Pictures in the documentation that are no figures of data, and what makes each.
const OTHER_PICTURES: [(&str, &str); 12] = [
    ("attacked-undefended.gif", "vigil log film"),
    ("attacked-defended.gif", "vigil log film"),
    ("flight-report.png", "a screenshot of the report of vigil log report"),
    ("report-map-and-film-dark.png", "the same in the dark"),
    ("report-plots-light.png", "its plots"),
    ("view-campaign.png", "a screenshot of vigil evaluate --view"),
    ("view-course.png", "a screenshot of vigil courses view"),
    ("tlog-mavgraph.png", "mavgraph.py of pymavlink on a flight's tlog"),
    ("view-rerun.png", "a screenshot of vigil view"),
    ("real-time-fifo.svg", "vigil bench realtime --figure"),
    ("real-time-normal.svg", "vigil bench realtime --figure"),
    ("attacks.svg", "vigil attack pictures"),
];

/// Runs `vigil reproduce` into a folder over the repository's data.
fn reproduce(output: &Path, more: &[&str]) -> std::process::Output {
    reproduce_of(&root().join("docs/measured"), output, more)
}

fn reproduce_of(data: &Path, output: &Path, more: &[&str]) -> std::process::Output {
    run(&[&["reproduce", "-o", text(output), "--data", text(data)], more].concat())
}

fn manifest(folder: &Path) -> Value {
    json(&folder.join("manifest.json"))
}

/// The items by their names, with their files.
fn items(manifest: &Value) -> BTreeMap<String, BTreeMap<String, String>> {
    let items = manifest["items"].as_array().expect("items");
    let files = |item: &Value| serde_json::from_value(item["files"].clone()).expect("files");
    items
        .iter()
        .map(|item| (item["id"].as_str().expect("a name").to_owned(), files(item)))
        .collect()
}

/// What `vigil reproduce --list` names, and the units that each is made of.
fn listed() -> BTreeMap<String, BTreeSet<String>> {
    let table = succeed(&run(&["reproduce", "--list"]));
    let mut lines = table.lines();
    let units = lines
        .next()
        .and_then(|heading| heading.find("made of"))
        .expect("a column");
    let mut items = BTreeMap::new();
    for line in lines {
        let name = line.split_whitespace().next().expect("a name").to_owned();
        let of = line[units..].split(", ").map(|unit| unit.trim().to_owned()).collect();
        assert!(items.insert(name, of).is_none(), "named twice: {line}");
    }
    items
}

fn is_picture(name: &str) -> bool {
    [".png", ".svg", ".gif", ".jpg"]
        .iter()
        .any(|ending| name.ends_with(ending))
}

/// Pictures that the pages show.
fn pictures_in_documentation() -> BTreeSet<String> {
    let mut pictures = BTreeSet::new();
    for page in pages() {
        let page = fs::read_to_string(page).expect("a page");
        let is_of_name = |c: char| c.is_alphanumeric() || "-_.".contains(c);
        let names = page
            .split("images/")
            .skip(1)
            .filter_map(|after| after.split(|c: char| !is_of_name(c)).next());
        pictures.extend(names.filter(|name| is_picture(name)).map(str::to_owned));
    }
    pictures
}

#[test]
fn the_committed_data_make_every_item_and_the_documentation_shows_what_they_make() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("out");
    succeed(&reproduce(&out, &["--committed"]));

    // What is listed is made, what is made is in the manifest, and what is in the manifest lies in the folder.
    let manifest = manifest(&out);
    let items = items(&manifest);
    assert!(items.keys().eq(listed().keys()), "{:?}", items.keys());
    let tables = (1..=4).map(|n| format!("table-{n}"));
    for paper in tables.chain((9..=14).map(|n| format!("figure-{n}"))) {
        assert!(items.contains_key(&paper), "{paper}");
    }
    let named: BTreeMap<&String, &String> = items.values().flatten().collect();
    for (file, digest) in &named {
        let content = fs::read(out.join(file)).unwrap_or_else(|e| panic!("{file}: {e}"));
        let found: String = Sha256::digest(&content).iter().map(|b| format!("{b:02x}")).collect();
        assert_eq!(found, **digest, "{file}");
    }
    for inner in ["figures", "tables"] {
        for entry in fs::read_dir(out.join(inner)).expect("a folder") {
            let name = format!("{inner}/{}", entry.expect("readable").file_name().display());
            assert!(named.contains_key(&name), "the manifest lacks {name}");
        }
    }
    let page = fs::read_to_string(out.join("index.html")).expect("a page");
    for item in manifest["items"].as_array().expect("items") {
        let id = item["id"].as_str().expect("a name");
        let has = |file: String| items[id].contains_key(&file);
        assert!(has(format!("tables/{id}.csv")), "{id} has no numbers");
        for ending in ["svg", "png"] {
            let is_drawn = has(format!("figures/{id}.{ending}"));
            assert_eq!(is_drawn, item["kind"] == "figure", "{id}");
        }
        for source in item["sources"].as_array().expect("sources") {
            for field in ["command", "seeds", "commit", "version"] {
                let is_told = source[field].as_str().is_some_and(|s| !s.is_empty());
                assert!(is_told, "{id}: {field}");
            }
        }
        let section = format!("<section id=\"{id}\"");
        assert!(page.contains(&section), "{id} is not on the page");
    }
    // The page is whole in itself.
    for fetched in ["<script", "src=\"http", "href=\"http", "@import", "url("] {
        assert!(!page.contains(fetched), "the page has {fetched}");
    }

    the_documentation_shows_what_is_made(&out, |file| named.contains_key(file));
    the_data_are_of_the_built_in_models(&manifest["made_by"]);
}

fn the_data_are_of_the_built_in_models(ours: &Value) {
    for path in files_below(&root().join("docs/measured"), &[".json", ".csv"]) {
        let content = fs::read_to_string(&path).expect("a text");
        for model in ["actor_sha256", "detector_sha256"] {
            let own = ours[model].as_str().expect("a digest");
            for stated in content.split(&format!("\"{model}\":")).skip(1) {
                let digest = stated.trim_start_matches([' ', '"']);
                let is_own = digest.starts_with(own) || digest.starts_with("null");
                assert!(is_own, "{}: another {model} than the built-in one's", path.display());
            }
        }
    }
}

fn the_documentation_shows_what_is_made(out: &Path, is_made: impl Fn(&String) -> bool) {
    // Every figure that the documentation shows has a command, and is what it makes.
    for name in pictures_in_documentation() {
        if OTHER_PICTURES.iter().any(|(other, _)| *other == name) {
            continue;
        }
        let file = format!("figures/{name}");
        assert!(
            is_made(&file),
            "{name} is shown, but `vigil reproduce` does not make it: add it there, or to the other pictures with its command"
        );
        let shown = fs::read(root().join("docs/images").join(&name)).expect("a picture");
        assert!(
            shown == fs::read(out.join(&file)).expect("a figure"),
            "docs/images/{name} is not what the committed data make: copy it from `vigil reproduce --committed`"
        );
    }
    // None lies there unused.
    let shown = pictures_in_documentation();
    for entry in fs::read_dir(root().join("docs/images")).expect("a folder") {
        let name = entry.expect("readable").file_name().to_string_lossy().into_owned();
        let is_used = !is_picture(&name) || shown.contains(&name);
        assert!(is_used, "docs/images/{name} is shown nowhere");
    }
}

#[test]
fn every_item_is_made_of_units_that_there_are_and_every_unit_is_used() {
    let specification = root().join("tools/assets/reproduce/units.toml");
    let units: toml::Table = toml::from_str(&fs::read_to_string(specification).expect("a file")).expect("TOML");
    let units = units["unit"].as_array().expect("units").iter();
    let names = units.map(|unit| unit["name"].as_str().expect("a name").to_owned());
    let mut known: BTreeSet<String> = names.collect();
    // What is measured otherwise is committed with the command that measures it.
    known.extend(["training-runs", "peers"].map(str::to_owned));
    let used: BTreeSet<String> = listed().into_values().flatten().collect();
    assert_eq!(used, known);
}

#[test]
fn data_that_are_missing_or_damaged_are_named_and_nothing_is_drawn_from_them() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("measured");
    fs::create_dir(&data).expect("a folder");
    for name in ["index.toml", "figure-11.csv", "table-2.json"] {
        fs::copy(root().join("docs/measured").join(name), data.join(name)).expect("a copy");
    }
    let out = folder.path().join("out");
    let only = |item: &str| reproduce_of(&data, &out, &["--committed", "--only", item]);
    succeed(&only("figure-11,table-2"));
    assert_eq!(items(&manifest(&out)).len(), 2);

    let csv = data.join("figure-11.csv");
    let whole = fs::read_to_string(&csv).expect("a file");
    fs::write(&csv, whole.replacen("650", "950", 1)).expect("a file");
    refused(&only("figure-11"), &["figure-11.csv is not what was measured"]);
    fs::remove_file(&csv).expect("removed");
    refused(&only("figure-11"), &["figure-11.csv: No such file"]);
    // The other item does not need it.
    succeed(&only("table-2"));
    fs::write(data.join("index.toml"), "[units.").expect("a file");
    refused(&only("table-2"), &["index.toml is damaged"]);

    refused(&reproduce_of(folder.path(), &out, &["--committed"]), &["--data"]);
}

#[test]
fn what_cannot_be_done_is_said_before_anything_is_flown() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("out");
    refused(&reproduce(&out, &["--only", "table-5"]), &["there is no table-5"]);
    refused(&reproduce(&out, &["--only", ","]), &["--only names nothing"]);
    let readme = root().join("README.md");
    for model in ["--actor", "--detector"] {
        refused(&reproduce(&out, &["--quick", model, text(&readme)]), &["README.md"]);
    }
    assert!(!out.exists(), "nothing was begun");

    // A file where the folder should be, a folder of other things, one of another commit.
    let file = folder.path().join("file");
    fs::write(&file, "").expect("a file");
    refused(&reproduce(&file.join("out"), &["--committed"]), &["cannot make"]);
    refused(&reproduce(folder.path(), &["--committed"]), &["holds other files"]);
    succeed(&reproduce(&out, &["--committed", "--only", "table-2"]));
    let made_by = out.join("made-by.toml");
    let ours = fs::read_to_string(&made_by).expect("a file");
    let commit = ours.lines().find(|l| l.starts_with("commit")).expect("a commit");
    fs::write(&made_by, ours.replace(commit, "commit = \"another\"")).expect("a file");
    refused(&reproduce(&out, &["--committed"]), &["its commit is another"]);
    fs::write(&made_by, "version =").expect("a file");
    refused(&reproduce(&out, &["--committed"]), &["made-by.toml is damaged"]);
}

#[test]
fn an_interrupted_run_keeps_what_is_whole_and_goes_on() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("out");
    let data = root().join("docs/measured");
    let (to, from) = (text(&out), text(&data));
    let mut running = Running::start(&format!("reproduce --quick --only figure-14,roc -o {to} --data {from}"));
    // The flight is explained first; the detector's evaluation takes minutes.
    running.wait_for("the second unit", |line| line.starts_with("[2/2]").then_some(()));
    running.signal(Signal::INT);
    assert_eq!(running.wait(), Some(130));
    let kept = items(&manifest(&out));
    assert_eq!(
        kept.keys().collect::<Vec<_>>(),
        ["figure-14"],
        "an item that was not measured is not made of committed data"
    );

    let explained = out.join("data/explained-attacked/explanations.csv");
    let before = fs::metadata(&explained).and_then(|m| m.modified()).expect("a file");
    let again = succeed(&reproduce(&out, &["--quick", "--only", "figure-14"]));
    assert!(again.contains("is there"), "{}", again);
    let after = fs::metadata(&explained).and_then(|m| m.modified()).expect("a file");
    assert_eq!(after, before);
    let manifest = manifest(&out);
    assert_eq!(manifest["made_by"]["mode"], "quick");
    assert_eq!(manifest["items"][0]["sources"][0]["flown_anew"], true);
    let page = fs::read_to_string(out.join("index.html")).expect("a page");
    assert!(page.contains("few flights"));

    let full = reproduce(&out, &["--only", "figure-14"]);
    refused(&full, &["its mode is quick, this one's full"]);
}

/// Every file below a folder by its path from there.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let named = |path: PathBuf| {
        let name = path.strip_prefix(folder).expect("below the folder").to_owned();
        (name, fs::read(&path).expect("a file"))
    };
    files_below(folder, &[""]).into_iter().map(named).collect()
}

#[test]
fn two_machines_measure_a_part_each_and_the_page_of_both_is_the_page_of_one() {
    let folder = tempfile::tempdir().expect("a folder");
    let [one, first, second, whole] = ["one", "first", "second", "whole"].map(|name| folder.path().join(name));
    // The quickest units of which none is a time.
    let quick =
        |output: &Path, only: &str, more: &[&str]| reproduce(output, &[&["--quick", "--only", only], more].concat());
    let measured = |output: &Path, only: &str, more: &[&str]| succeed(&quick(output, only, more));
    measured(&one, "figure-12,figure-14", &[]);
    measured(&first, "figure-12", &[]);
    measured(&second, "figure-14", &[]);
    let both = format!("{},{}", text(&first), text(&second));
    let words = measured(&whole, "figure-12,figure-14", &["--from", &both]);
    assert_eq!(words.matches("is there").count(), 2, "{words}");
    let (one, made) = (files(&one), files(&whole));
    let differing: Vec<&PathBuf> = made.keys().filter(|name| made.get(*name) != one.get(*name)).collect();
    assert!(differing.is_empty(), "{differing:?}");
    // Not taken along are pictures beside the data, which the index does not name and the page does not show.
    let index = String::from_utf8_lossy(&made[Path::new("data/index.toml")]).into_owned();
    for name in one.keys().filter(|name| !made.contains_key(*name)) {
        let unit_file = name.strip_prefix("data").expect("only data are left out");
        assert!(!index.contains(text(unit_file)), "{}", name.display());
    }
    // The same again changes nothing.
    measured(&whole, "figure-12,figure-14", &["--from", text(&second)]);
    assert!(files(&whole) == made);

    let third = folder.path().join("third");
    let full = reproduce(&third, &["--only", "figure-12", "--from", text(&first)]);
    refused(&full, &["its mode is quick, this one's full"]);
    let merged = run(&["merge", text(&first), text(&second), "-o", text(&third)]);
    refused(&merged, &["`vigil reproduce --from DIR`"]);
    fs::write(first.join("data/explained/pixels.json"), "{}").expect("written");
    let fourth = folder.path().join("fourth");
    let altered = quick(&fourth, "figure-12", &["--from", text(&first)]);
    refused(&altered, &["is not what was measured"]);
}
