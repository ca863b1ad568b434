//! Puts the data of a flight into the page: style, script and plotting library are in it.

use crate::flight_report::Flight;
use serde_json::{Value, json};

const PAGE: &str = include_str!("../../assets/flight_report/page.html");
const STYLE: &str = include_str!("../../assets/flight_report/style.css");
const SCRIPT: &str = include_str!("../../assets/flight_report/script.js");
/// uPlot 1.6.32, MIT: see `uPlot-LICENSE` beside it.
const UPLOT_JS: &str = include_str!("../../assets/flight_report/uPlot.iife.min.js");
const UPLOT_CSS: &str = include_str!("../../assets/flight_report/uPlot.min.css");

/// More steps than this are thinned evenly: an hour of flight stays a page that a telephone opens.
pub const DATA_LIMIT: usize = 6000;

/// A quantity in a plot: column, label, decimals, dashed.
type Line = (&'static str, &'static str, u8, bool);
/// Name, title, unit, range (none: as the data), lines, what is said when there is nothing to show.
type Panel = (
    &'static str,
    &'static str,
    &'static str,
    Option<[f64; 2]>,
    &'static [Line],
    &'static str,
);

/// The plots. Each column is one of [`Flight::columns`].
const PANELS: [Panel; 9] = [
    (
        "score",
        "Detector: score against threshold",
        "score",
        Some([-0.02, 1.02]),
        &[
            ("detector_score", "score", 3, false),
            ("detector_threshold", "threshold", 3, true),
        ],
        "No score: no detector monitored an actor in this flight.",
    ),
    (
        "contributions",
        "What moved the actor's yaw (SHAP)",
        "action units",
        None,
        &[
            ("contribution_image", "picture", 3, false),
            ("contribution_bearing", "bearing", 3, false),
            ("contribution_distance", "distance", 3, false),
            ("contribution_told", "own motion", 3, false),
        ],
        "No explanations: no detector monitored an actor in this flight.",
    ),
    (
        "yaw",
        "Yaw: what the actor wanted and what was flown",
        "action units of 30 °/s",
        None,
        &[
            ("action_yaw", "flown", 2, false),
            ("actor_yaw", "the actor's own", 2, true),
        ],
        "No pilot decided anything in this flight.",
    ),
    (
        "speed",
        "Speeds and setpoints",
        "m/s",
        None,
        &[
            ("speed_m_s", "speed over ground", 2, false),
            ("setpoint_forward_m_s", "setpoint forward", 2, true),
            ("climb_m_s", "climb", 2, false),
            ("action_forward_m_s", "pilot's forward", 2, true),
        ],
        "No velocity was received and no setpoint sent.",
    ),
    (
        "yaw-rate",
        "Yaw rate",
        "°/s",
        None,
        &[
            ("yaw_rate_deg_s", "measured", 1, false),
            ("setpoint_yaw_rate_deg_s", "setpoint", 1, true),
        ],
        "No yaw rate was received and no setpoint sent.",
    ),
    (
        "obstacles",
        "Distance to obstacles (up to 15 m)",
        "m",
        Some([0.0, 15.0]),
        &[
            ("clearance_m", "to the nearest obstacle of the course", 2, false),
            ("nearest_return_m", "nearest in the frame (1 % of pixels)", 2, true),
        ],
        "The log holds neither obstacles nor depth frames.",
    ),
    (
        "goal",
        "Goal and height",
        "m",
        None,
        &[
            ("goal_distance_m", "distance to the goal", 1, false),
            ("height_m", "height", 2, false),
        ],
        "No position was received.",
    ),
    (
        "step-time",
        "Time of a step (50 ms are there for it)",
        "ms",
        None,
        &[
            ("step_time_ms", "execution", 3, false),
            ("wake_late_ms", "woken late", 3, true),
        ],
        "No step took measurable time: a flight in lockstep has no clock of its own.",
    ),
    (
        "ages",
        "Age of frame and telemetry",
        "ms",
        None,
        &[
            ("frame_age_ms", "frame", 1, false),
            ("telemetry_age_ms", "telemetry", 1, true),
        ],
        "Neither frames nor telemetry were received.",
    ),
];

fn panels() -> Vec<Value> {
    let series = |lines: &[Line]| -> Vec<Value> {
        lines
            .iter()
            .map(|(column, label, decimals, dashed)| {
                json!({ "column": column, "label": label, "decimals": decimals, "dashed": dashed })
            })
            .collect()
    };
    PANELS
        .iter()
        .map(|(id, title, unit, range, lines, none)| {
            json!({ "id": id, "title": title, "unit": unit, "range": range, "series": series(lines), "none": none })
        })
        .collect()
}

/// The page as one file.
pub fn html(flight: &Flight) -> serde_json::Result<String> {
    let mut data = serde_json::to_value(flight)?;
    data["panels"] = Value::from(panels());
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
