//! What Vigil is built from keeps to `deny.toml` and to docs/dependencies.md: licences, sources, versions, reasons.
//!
//! `cargo deny` checks the same and more (`tests/run` asks it where it is installed); this needs nothing but cargo.

use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::process::Command;
use vigil_tests::root;

const REGISTRY: &str = "registry+https://github.com/rust-lang/crates.io-index";

/// The part of `deny.toml` that is checked here.
#[derive(Deserialize)]
struct Deny {
    licenses: Licenses,
    bans: Bans,
}

#[derive(Deserialize)]
struct Licenses {
    allow: Vec<String>,
}

#[derive(Deserialize)]
#[serde(rename_all = "kebab-case")]
struct Bans {
    multiple_versions: String,
    skip: Vec<Skip>,
}

#[derive(Deserialize)]
struct Skip {
    #[serde(rename = "crate")]
    name: String,
    reason: String,
}

/// The part of `cargo metadata` that is checked here.
#[derive(Deserialize)]
struct Metadata {
    packages: Vec<Package>,
    resolve: Resolve,
}

#[derive(Deserialize)]
struct Resolve {
    nodes: Vec<Node>,
}

#[derive(Deserialize)]
struct Node {
    id: String,
}

#[derive(Deserialize)]
struct Package {
    id: String,
    name: String,
    version: String,
    license: Option<String>,
    source: Option<String>,
    dependencies: Vec<Dependency>,
}

#[derive(Deserialize)]
struct Dependency {
    name: String,
    req: String,
    path: Option<PathBuf>,
}

fn output(program: &str, arguments: &[&str]) -> String {
    let output = Command::new(program)
        .args(arguments)
        .current_dir(root())
        .output()
        .unwrap_or_else(|e| panic!("{program}: {e}"));
    assert!(
        output.status.success(),
        "{program} {arguments:?}: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    String::from_utf8(output.stdout).expect("UTF-8")
}

/// Everything that is built on this machine: programs, tests and what builds them.
fn packages() -> Vec<Package> {
    let about = output("rustc", &["-vV"]);
    let host = about.lines().find_map(|l| l.strip_prefix("host: ")).expect("a host");
    // What is built was fetched before; other platforms' crates were not.
    let arguments = [
        "metadata",
        "--format-version=1",
        "--locked",
        "--offline",
        "--filter-platform",
        host,
    ];
    let metadata: Metadata = serde_json::from_str(&output(env!("CARGO"), &arguments)).expect("metadata");
    let built: BTreeSet<String> = metadata.resolve.nodes.into_iter().map(|n| n.id).collect();
    let mut packages = metadata.packages;
    packages.retain(|p| built.contains(&p.id));
    assert!(packages.len() > 100);
    packages
}

fn deny() -> Deny {
    let text = std::fs::read_to_string(root().join("deny.toml")).expect("deny.toml");
    toml::from_str(&text).expect("TOML")
}

#[test]
fn every_licence_is_one_that_is_allowed() {
    let allowed: Vec<spdx::Licensee> = deny()
        .licenses
        .allow
        .iter()
        .map(|name| spdx::Licensee::parse(name).unwrap_or_else(|e| panic!("{name}: {e}")))
        .collect();
    for Package { name, license, .. } in packages() {
        let license = license.unwrap_or_else(|| panic!("{name} names no licence"));
        // Old manifests write a slash for OR.
        let expression = spdx::Expression::parse_mode(&license, spdx::ParseMode::LAX)
            .unwrap_or_else(|e| panic!("{name}: {license}: {e}"));
        assert!(
            expression.evaluate(|asked| allowed.iter().any(|licensee| licensee.satisfies(asked))),
            "{name} comes under {license}, which deny.toml does not allow"
        );
    }
}

#[test]
fn everything_comes_from_the_workspace_or_the_registry() {
    for Package { name, source, .. } in packages() {
        assert!(
            source.as_deref().is_none_or(|source| source == REGISTRY),
            "{name} comes from {source:?}"
        );
    }
}

#[test]
fn nothing_is_built_in_two_versions_but_what_others_force() {
    let bans = deny().bans;
    assert_eq!(bans.multiple_versions, "deny");
    let mut skipped: BTreeMap<String, String> = bans.skip.into_iter().map(|s| (s.name, s.reason)).collect();
    let mut versions: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for package in packages() {
        let (version, _build) = package.version.split_once('+').unwrap_or((&package.version, ""));
        versions.entry(package.name).or_default().push(version.to_owned());
    }
    for (name, versions) in versions {
        let left: Vec<&String> = versions
            .iter()
            .filter(|version| match skipped.remove(&format!("{name}@{version}")) {
                Some(reason) => {
                    assert!(!reason.is_empty(), "{name}@{version} is skipped without a reason");
                    assert!(versions.len() > 1, "{name}@{version} need not be skipped any more");
                    false
                }
                None => true,
            })
            .collect();
        assert!(
            left.len() <= 1,
            "{name} is built as {left:?}: take one, or say in deny.toml who forces the other"
        );
    }
    assert!(skipped.is_empty(), "skipped in deny.toml, but not built: {skipped:?}");
}

#[test]
fn what_vigil_asks_for_itself_is_pinned_and_has_its_reason() {
    let page = std::fs::read_to_string(root().join("docs/dependencies.md")).expect("docs/dependencies.md");
    let reasons: BTreeSet<&str> = page.split('`').skip(1).step_by(2).collect();
    for package in packages().into_iter().filter(|p| p.source.is_none()) {
        for Dependency { name, req, path } in package.dependencies {
            if path.is_none() {
                assert!(req.starts_with('='), "{} asks for {name} {req}: pin it", package.name);
                assert!(
                    reasons.contains(name.as_str()),
                    "docs/dependencies.md does not say why {name}"
                );
            }
        }
    }
}
