//! What Vigil is built from keeps to `deny.toml` and to docs/dependencies.md: licences, sources, versions, reasons.
//!
//! `cargo deny` checks the same and more (`tests/run` asks it where it is installed); this needs nothing but cargo.

use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;
use vigil_tests::root;

const REGISTRY: &str = "registry+https://github.com/rust-lang/crates.io-index";

fn list<'a>(of: &'a Value, key: &str) -> &'a [Value] {
    of[key].as_array().unwrap_or_else(|| panic!("no list {key}"))
}

fn word<'a>(of: &'a Value, key: &str) -> &'a str {
    of[key].as_str().unwrap_or_else(|| panic!("no {key} in {of}"))
}

fn output(program: &str, arguments: &[&str]) -> String {
    let output = Command::new(program)
        .args(arguments)
        .current_dir(root())
        .output()
        .unwrap_or_else(|e| panic!("{program}: {e}"));
    vigil_tests::succeed(&output);
    String::from_utf8(output.stdout).expect("UTF-8")
}

/// Everything that is built on this machine: programs, tests and what builds them.
fn packages() -> Vec<Value> {
    let about = output("rustc", &["-vV"]);
    let host = about.lines().find_map(|l| l.strip_prefix("host: ")).expect("a host");
    // What is built was fetched before; other platforms' crates were not.
    let line = format!("metadata --format-version=1 --locked --offline --filter-platform {host}");
    let arguments: Vec<&str> = line.split(' ').collect();
    let metadata: Value = serde_json::from_str(&output(env!("CARGO"), &arguments)).expect("metadata");
    let nodes = list(&metadata["resolve"], "nodes").iter();
    let built: BTreeSet<&str> = nodes.map(|node| word(node, "id")).collect();
    let mut packages = list(&metadata, "packages").to_vec();
    packages.retain(|package| built.contains(word(package, "id")));
    assert!(packages.len() > 100);
    packages
}

fn deny() -> Value {
    let text = std::fs::read_to_string(root().join("deny.toml")).expect("deny.toml");
    toml::from_str(&text).expect("TOML")
}

#[test]
fn every_licence_is_one_that_is_allowed() {
    let deny = deny();
    let names = list(&deny["licenses"], "allow").iter().filter_map(Value::as_str);
    let allowed: Vec<spdx::Licensee> = names
        .map(|name| spdx::Licensee::parse(name).unwrap_or_else(|e| panic!("{name}: {e}")))
        .collect();
    for package in packages() {
        let (name, license) = (word(&package, "name"), word(&package, "license"));
        // Old manifests write a slash for OR.
        let expression = spdx::Expression::parse_mode(license, spdx::ParseMode::LAX)
            .unwrap_or_else(|e| panic!("{name}: {license}: {e}"));
        assert!(
            expression.evaluate(|asked| allowed.iter().any(|licensee| licensee.satisfies(asked))),
            "{name} comes under {license}, which deny.toml does not allow"
        );
    }
}

#[test]
fn everything_comes_from_the_workspace_or_the_registry() {
    for package in packages() {
        let (name, source) = (&package["name"], &package["source"]);
        assert!(source.is_null() || source == REGISTRY, "{name} comes from {source}");
    }
}

#[test]
fn nothing_is_built_in_two_versions_but_what_others_force() {
    let bans = &deny()["bans"];
    assert_eq!(bans["multiple-versions"], "deny");
    let skips = list(bans, "skip").iter();
    let mut skipped: BTreeMap<&str, &str> = skips.map(|s| (word(s, "crate"), word(s, "reason"))).collect();
    let mut versions: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for package in packages() {
        let version = word(&package, "version");
        let (version, _build) = version.split_once('+').unwrap_or((version, ""));
        let name = word(&package, "name").to_owned();
        versions.entry(name).or_default().push(version.to_owned());
    }
    for (name, mut versions) in versions {
        let built = versions.len();
        versions.retain(|version| {
            let reason = skipped.remove(&*format!("{name}@{version}"));
            assert!(reason != Some(""), "{name}@{version} is skipped without a reason");
            assert!(
                reason.is_none() || built > 1,
                "{name}@{version} need not be skipped any more"
            );
            reason.is_none()
        });
        assert!(
            versions.len() <= 1,
            "{name} is built as {versions:?}: take one, or say in deny.toml who forces the other"
        );
    }
    assert!(skipped.is_empty(), "skipped in deny.toml, but not built: {skipped:?}");
}

#[test]
fn what_vigil_asks_for_itself_is_pinned_and_has_its_reason() {
    let page = std::fs::read_to_string(root().join("docs/dependencies.md")).expect("docs/dependencies.md");
    let reasons: BTreeSet<&str> = page.split('`').skip(1).step_by(2).collect();
    for package in packages().iter().filter(|package| package["source"].is_null()) {
        for asked in list(package, "dependencies").iter().filter(|d| d["path"].is_null()) {
            let (who, name, req) = (&package["name"], word(asked, "name"), word(asked, "req"));
            assert!(req.starts_with('='), "{who} asks for {name} {req}: pin it");
            assert!(reasons.contains(name), "docs/dependencies.md does not say why {name}");
        }
    }
}
