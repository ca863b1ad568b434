//! The documentation holds together: every link leads somewhere, every page is in the index.

use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};
use vigil_tests::root;

fn pages() -> Vec<PathBuf> {
    let beside = ["CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md"].map(|name| root().join(name));
    vigil_tests::pages().into_iter().chain(beside).collect()
}

/// The text without fenced code, where brackets are not links.
fn prose(path: &Path) -> String {
    let text = fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    text.split("```").step_by(2).collect()
}

/// What stands between `](` and `)`.
fn links(text: &str) -> impl Iterator<Item = &str> {
    text.split("](").skip(1).filter_map(|rest| rest.split(')').next())
}

/// The anchors that headings get on the usual hosts: lower case, blanks as hyphens, signs dropped.
fn anchors(text: &str) -> HashSet<String> {
    let headings = text.lines().filter(|l| l.starts_with('#'));
    let words = headings.map(|heading| heading.trim_start_matches('#').trim().to_lowercase().replace(' ', "-"));
    let is_kept = |c: &char| c.is_alphanumeric() || "-_".contains(*c);
    words.map(|words| words.chars().filter(is_kept).collect()).collect()
}

#[test]
fn every_link_leads_somewhere() {
    let mut broken = Vec::new();
    for page in pages() {
        let text = prose(&page);
        for link in links(&text).filter(|l| !l.contains("://") && !l.starts_with("mailto:")) {
            let (file, anchor) = link.split_once('#').unwrap_or((link, ""));
            let target = match file {
                "" => page.clone(),
                file => page.parent().unwrap().join(file),
            };
            let found =
                target.exists() && (anchor.is_empty() || target.is_dir() || anchors(&prose(&target)).contains(anchor));
            if !found {
                broken.push(format!("{}: {link}", page.display()));
            }
        }
    }
    assert!(broken.is_empty(), "broken links:\n{}", broken.join("\n"));
}

#[test]
fn every_page_is_in_the_index() {
    let index = prose(&root().join("docs/README.md"));
    let named: HashSet<&str> = links(&index).collect();
    let docs = root().join("docs");
    for page in pages() {
        if let Ok(name) = page.strip_prefix(&docs)
            && name != Path::new("README.md")
        {
            let name = name.to_str().expect("a UTF-8 path");
            assert!(named.contains(name), "docs/README.md does not name {name}");
        }
    }
}
