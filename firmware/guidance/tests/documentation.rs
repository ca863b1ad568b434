//! `docs/guidance.md` holds exactly what the tables say. `UPDATE_DOCS=1 cargo test --release -p vigil-guidance` writes it.

#[path = "common/page.rs"]
mod page;

use std::fmt::Write;
use vigil_guidance::GuidanceConfig;
use vigil_guidance::conditions::*;
use vigil_guidance::table::TRANSITIONS;
use vigil_types::GuidanceState;

fn thresholds(text: &str) -> String {
    let c = GuidanceConfig::default();
    let seconds = |ns: u64| format!("{} s", (ns / 1_000_000) as f64 / 1000.0);
    [
        ("{frame_age_limit}", seconds(c.frame_age_limit_ns)),
        ("{telemetry_age_limit}", seconds(c.telemetry_age_limit_ns)),
        ("{slow_telemetry}", seconds(c.telemetry_age_limit_ns / 2)),
        ("{heartbeat_age_limit}", seconds(c.heartbeat_age_limit_ns)),
        ("{slip_limit}", c.slip_limit.to_string()),
        ("{slip_window}", seconds(SLIP_WINDOW_NS)),
        ("{goal_radius}", format!("{} m", c.goal_radius_m)),
        ("{goal_dwell}", seconds(GOAL_DWELL_NS)),
        (
            "{no_progress_limit}",
            c.no_progress_limit_ns.map_or("no time".to_owned(), seconds),
        ),
        ("{no_progress_gain}", format!("{} m", NO_PROGRESS_GAIN_M)),
        ("{no_progress_dwell}", seconds(NO_PROGRESS_DWELL_NS)),
        ("{handover_limit}", seconds(HANDOVER_LIMIT_NS)),
        ("{handover_pause}", seconds(HANDOVER_PAUSE_NS)),
        ("{raise_count}", c.alarm.raise_count.to_string()),
        ("{raise_window}", c.alarm.raise_window.to_string()),
        ("{stopped}", format!("{} m/s", STOPPED_M_S)),
        ("{stop_limit}", seconds(STOP_LIMIT_NS)),
        ("{alarm_clear_steps}", c.alarm.clear_steps.to_string()),
        ("{guard_steps}", c.alarm.guard_steps.to_string()),
        ("{recovery_guard_steps}", c.alarm.recovery_guard_steps.to_string()),
        ("{apart}", c.alarm.apart_yaw.to_string()),
        ("{astray}", format!("{} m", c.alarm.astray_limit_m)),
        ("{smooth_share}", c.alarm.smooth_share.to_string()),
        ("{disagreement}", format!("{} s", c.alarm.disagreement_limit_s)),
        ("{way_speed}", format!("{} m/s", c.alarm.path_speed_m_s)),
        ("{unknown_limit}", UNKNOWN_LIMIT.to_string()),
        ("{battery_limit}", format!("{} %", (c.battery_limit * 100.0).round())),
    ]
    .iter()
    .fold(text.to_owned(), |text, (name, value)| text.replace(name, value))
}

fn conditions() -> String {
    let mut out = String::from(
        "| Bit | Condition | In flight | Blocks *ready* | Present when | Clears with |\n| --- | --- | --- | --- | --- | --- |\n",
    );
    for c in &CONDITIONS {
        let demand = match c.demand {
            Demand::Land => "land",
            Demand::Hold => "hold",
            Demand::End => "end of flight",
            Demand::Wait => "wait",
            Demand::Recover => "recovery pilot flies",
            Demand::Warn => "warning",
        };
        let blocks = if c.blocks_ready { "yes" } else { "" };
        let (bit, name) = (c.reason as u8, c.reason.name());
        let (present, clears) = (thresholds(c.present), thresholds(c.clears));
        writeln!(out, "| {bit} | {name} | {demand} | {blocks} | {present} | {clears} |").unwrap();
    }
    out
}

fn names(states: &[GuidanceState]) -> String {
    match states.len() {
        6 => "any".to_owned(),
        _ => states.iter().map(|s| s.name()).collect::<Vec<_>>().join(", "),
    }
}

fn transitions() -> String {
    let mut out = String::from("| | From | When | To | Wish to fly | Why |\n| --- | --- | --- | --- | --- | --- |\n");
    for (n, row) in TRANSITIONS.iter().enumerate() {
        let (from, when, to) = (names(row.from), row.when.name(), row.to.name());
        writeln!(
            out,
            "| {} | {from} | {when} | {to} | {} | {} |",
            n + 1,
            row.intent.name(),
            row.why
        )
        .unwrap();
    }
    out
}

fn diagram() -> String {
    let mut out = String::from("```mermaid\nstateDiagram-v2\n    [*] --> standby\n");
    for row in &TRANSITIONS {
        for from in row.from.iter().filter(|from| **from != row.to) {
            writeln!(out, "    {} --> {}: {}", from.name(), row.to.name(), row.when.name()).unwrap();
        }
    }
    out + "```\n"
}

#[test]
fn the_page_holds_the_tables_as_they_are() {
    let sections = [
        ("conditions", conditions()),
        ("transitions", transitions()),
        ("diagram", diagram()),
    ];
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/guidance.md");
    page::holds(path, &sections, "-p vigil-guidance");
}
