//! Puts the data of a flight into the page: style, script and plotting library are in it.

use serde_json::{Value, json};

const PAGE: &str = include_str!("../../assets/flight_report/page.html");
const STYLE: &str = include_str!("../../assets/flight_report/style.css");
const SCRIPT: &str = include_str!("../../assets/flight_report/script.js");
/// uPlot 1.6.32, MIT: see `uPlot-LICENSE` beside it.
const UPLOT_JS: &str = include_str!("../../assets/flight_report/uPlot.iife.min.js");
const UPLOT_CSS: &str = include_str!("../../assets/flight_report/uPlot.min.css");

/// More steps than this are thinned evenly: an hour of flight stays a page that a telephone opens.
pub const DATA_LIMIT: usize = 6000;

/// The plots. A line's column is one of the flight's; a range of null is that of the data; `none` is said where there is nothing.
fn panels() -> Value {
    let full = |column: &str, label: &str, decimals: u8| line(column, label, decimals, false);
    let dashed = |column: &str, label: &str, decimals: u8| line(column, label, decimals, true);
    json!([
        {
            "id": "score", "title": "Detector: score against threshold", "unit": "score", "range": [-0.02, 1.02],
            "series": [full("detector_score", "score", 3), dashed("detector_threshold", "threshold", 3)],
            "none": "No score: no detector monitored an actor in this flight."
        },
        {
            "id": "contributions", "title": "What moved the actor's yaw (SHAP)", "unit": "action units", "range": null,
            "series": [
                full("contribution_image", "picture", 3),
                full("contribution_bearing", "bearing", 3),
                full("contribution_distance", "distance", 3),
                full("contribution_told", "own motion", 3),
            ],
            "none": "No explanations: no detector monitored an actor in this flight."
        },
        {
            "id": "yaw", "title": "Yaw: what the actor wanted and what was flown",
            "unit": "action units of 30 °/s", "range": null,
            "series": [full("action_yaw", "flown", 2), dashed("actor_yaw", "the actor's own", 2)],
            "none": "No pilot decided anything in this flight."
        },
        {
            "id": "speed", "title": "Speeds and setpoints", "unit": "m/s", "range": null,
            "series": [
                full("speed_m_s", "speed over ground", 2),
                dashed("setpoint_forward_m_s", "setpoint forward", 2),
                full("climb_m_s", "climb", 2),
                dashed("action_forward_m_s", "pilot's forward", 2),
            ],
            "none": "No velocity was received and no setpoint sent."
        },
        {
            "id": "yaw-rate", "title": "Yaw rate", "unit": "°/s", "range": null,
            "series": [full("yaw_rate_deg_s", "measured", 1), dashed("setpoint_yaw_rate_deg_s", "setpoint", 1)],
            "none": "No yaw rate was received and no setpoint sent."
        },
        {
            "id": "obstacles", "title": "Distance to obstacles (up to 15 m)", "unit": "m", "range": [0.0, 15.0],
            "series": [
                full("clearance_m", "to the nearest obstacle of the course", 2),
                dashed("nearest_return_m", "nearest in the frame (1 % of pixels)", 2),
            ],
            "none": "The log holds neither obstacles nor depth frames."
        },
        {
            "id": "goal", "title": "Goal and height", "unit": "m", "range": null,
            "series": [full("goal_distance_m", "distance to the goal", 1), full("height_m", "height", 2)],
            "none": "No position was received."
        },
        {
            "id": "step-time", "title": "Time of a step (50 ms are there for it)", "unit": "ms", "range": null,
            "series": [full("step_time_ms", "execution", 3), dashed("wake_late_ms", "woken late", 3)],
            "none": "No step took measurable time: a flight in lockstep has no clock of its own."
        },
        {
            "id": "ages", "title": "Age of frame and telemetry", "unit": "ms", "range": null,
            "series": [full("frame_age_ms", "frame", 1), dashed("telemetry_age_ms", "telemetry", 1)],
            "none": "Neither frames nor telemetry were received."
        },
    ])
}

fn line(column: &str, label: &str, decimals: u8, dashed: bool) -> Value {
    json!({ "column": column, "label": label, "decimals": decimals, "dashed": dashed })
}

/// The page of a flight as one file.
pub fn html(mut data: Value) -> serde_json::Result<String> {
    data["panels"] = panels();
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
