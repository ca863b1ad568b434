//! The page: one file with all figures and tables in it, without scripts.

use super::made::Grid;
use super::{MadeBy, Shown};
use crate::report::to_csv;
use std::fmt::Write as _;

const STYLE: &str = include_str!("../../../../assets/reproduce/style.css");

impl Grid {
    /// As comma-separated values.
    pub fn csv(&self) -> String {
        to_csv([&self.columns].into_iter().chain(&self.rows))
    }

    fn html(&self, out: &mut String) {
        let heading = |name: &String| format!("<th scope=\"col\">{}</th>", escaped(name));
        *out += "<div class=\"scroll\"><table><thead><tr>";
        out.extend(self.columns.iter().map(heading));
        *out += "</tr></thead><tbody>\n";
        for row in &self.rows {
            *out += "<tr>";
            for (column, cell) in self.columns.iter().zip(row) {
                let is_paper = column.starts_with("the paper");
                let class = if is_paper { " class=\"paper\"" } else { "" };
                let _ = write!(out, "<td{class}>{}</td>", escaped(cell));
            }
            *out += "</tr>\n";
        }
        *out += "</tbody></table></div>\n";
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

/// Rows above which a table is folded.
const LONG: usize = 14;

pub fn html(made_by: &MadeBy, all: &[Shown]) -> String {
    let mut out = String::from(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<meta name=\"color-scheme\" content=\"light dark\">\n\
         <title>Vigil beside the paper</title>\n<style>\n",
    );
    out += STYLE;
    out += "</style>\n</head>\n<body>\n<header>\n<h1>Vigil beside the paper</h1>\n";
    out += "<p>Every table and figure of Hickling, Aouf, Spencer, <cite>Robust Adversarial Attacks Detection based on Explainable Deep \
            Reinforcement Learning for UAV Guidance and Planning</cite>, measured again, and those that Vigil adds.</p>\n";
    out += match made_by.mode.as_str() {
        "quick" => {
            "<p class=\"quick\"><strong>Quick:</strong> flown anew with few flights. The intervals are wide; do not cite these numbers.</p>\n"
        }
        "committed" => "<p>From the data that the repository holds; nothing was flown for this page.</p>\n",
        _ => "<p>Flown anew with as many flights as the figures need.</p>\n",
    };
    let _ = write!(out, "<p class=\"soft\">vigil {}", escaped(&made_by.version));
    // What is committed was measured at other commits, which each section names.
    if made_by.mode != "committed" {
        let [actor, detector] =
            [&made_by.actor_sha256, &made_by.detector_sha256].map(|digest| digest.get(..12).unwrap_or(digest));
        let commit = escaped(&made_by.commit);
        let _ = write!(out, " · commit {commit} · actor {actor} · detector {detector}");
    }
    out += "</p>\n";
    out += "<nav aria-label=\"Tables and figures\"><ul>\n";
    for Shown { item, .. } in all {
        let _ = writeln!(out, "<li><a href=\"#{}\">{}</a></li>", item.id, escaped(item.title));
    }
    out += "</ul></nav>\n</header>\n<main>\n";
    for shown in all {
        section(&mut out, shown, made_by.mode == "quick");
    }
    out += "</main>\n<footer>Made by <code>vigil reproduce</code>; figures as SVG and PNG and tables as CSV lie beside this file, \
            manifest.json names them all.</footer>\n</body>\n</html>\n";
    out
}

fn section(out: &mut String, shown: &Shown, is_quick: bool) {
    let Shown { item, made, sources } = shown;
    let any_fresh = sources.iter().any(|source| source.flown_anew);
    let (id, title, caption) = (item.id, escaped(item.title), escaped(&made.caption));
    let _ = writeln!(out, "<section id=\"{id}\" aria-labelledby=\"h-{id}\">");
    let _ = write!(out, "<h2 id=\"h-{id}\">{title}");
    if is_quick && any_fresh {
        *out += " <span class=\"badge\">quick: few flights</span>";
    }
    *out += "</h2>\n";
    if let Some((svg, _)) = &made.figure {
        let _ = writeln!(
            out,
            "<figure><div class=\"scroll\" role=\"img\" aria-label=\"{title}\" tabindex=\"0\">\n{svg}</div><figcaption>{caption}</figcaption></figure>"
        );
    } else {
        let _ = writeln!(out, "<p class=\"caption\">{caption}</p>");
    }
    let rows = made.table.rows.len();
    let folded = shown.made.figure.is_some() && rows > LONG;
    if folded {
        let _ = writeln!(out, "<details><summary>Numbers: {rows} rows</summary>");
    }
    made.table.html(out);
    if folded {
        *out += "</details>\n";
    }
    *out += "<p class=\"files\">";
    if made.figure.is_some() {
        let _ = write!(
            out,
            "<a href=\"figures/{id}.svg\">SVG</a> <a href=\"figures/{id}.png\">PNG, 300 dpi</a> "
        );
    }
    let _ = writeln!(out, "<a href=\"tables/{id}.csv\">CSV</a></p>");
    *out += "<details class=\"sources\"><summary>Where the numbers come from</summary>\n<ul>\n";
    for source in sources {
        let [command, seeds, commit, version] =
            [source.command, source.seeds, source.commit, source.version].map(escaped);
        let whence = match source.flown_anew {
            true => "measured for this page",
            false => "committed data",
        };
        let _ = write!(
            out,
            "<li><code>{command}</code><br>{whence}; seeds: {seeds}; commit {commit}, version {version}"
        );
        if !source.note.is_empty() {
            let _ = write!(out, "; {}", escaped(source.note));
        }
        *out += "</li>\n";
    }
    *out += "</ul></details>\n</section>\n";
}
