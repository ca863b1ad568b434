//! Puts the data of a flight into the page: style, script and plotting library are in it.

use serde_json::Value;

const PAGE: &str = include_str!("../../assets/flight_report/page.html");
const STYLE: &str = include_str!("../../assets/flight_report/style.css");
const SCRIPT: &str = include_str!("../../assets/flight_report/script.js");
/// The plots. A line's column is one of the flight's; a range of null is that of the data; `none` is said where there is nothing.
const PANELS: &str = include_str!("../../assets/flight_report/panels.json");
/// uPlot 1.6.32, MIT: see `uPlot-LICENSE` beside it.
const UPLOT_JS: &str = include_str!("../../assets/flight_report/uPlot.iife.min.js");
const UPLOT_CSS: &str = include_str!("../../assets/flight_report/uPlot.min.css");

/// More steps than this are thinned evenly: an hour of flight stays a page that a telephone opens.
pub const DATA_LIMIT: usize = 6000;

/// The page of a flight as one file.
pub fn html(mut data: Value) -> serde_json::Result<String> {
    data["panels"] = serde_json::from_str(PANELS)?;
    // Within a script element nothing may look like its end.
    let data = serde_json::to_string(&data)?.replace('<', "\\u003c");
    let mut page = String::with_capacity(PAGE.len() + UPLOT_JS.len() + SCRIPT.len() + data.len() + 8192);
    let mut rest = PAGE;
    for (mark, content) in [
        ("/*UPLOT_CSS*/", UPLOT_CSS),
        ("/*STYLE*/", STYLE),
        ("/*DATA*/", &data),
        ("/*UPLOT_JS*/", UPLOT_JS),
        ("/*SCRIPT*/", SCRIPT),
    ] {
        if let Some((before, after)) = rest.split_once(mark) {
            page.push_str(before);
            page.push_str(content);
            rest = after;
        }
    }
    page.push_str(rest);
    Ok(page)
}
