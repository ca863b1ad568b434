//! `docs/mavlink.md` holds exactly what the tables say. `UPDATE_DOCS=1 cargo test --release -p vigil-autopilot` writes it.

#[path = "../../../../firmware/guidance/tests/common/page.rs"]
mod page;

use crate::{ParameterRole, parameter_table, services};
use std::fmt::Write;
use vigil_mavlink::MavMessage;
use vigil_mavlink::mavlink::Message;

fn streams() -> String {
    let services = services::all();
    let mut produced: Vec<_> = services.iter().flat_map(|s| s.messages()).collect();
    produced.sort_by_key(|p| p.id);
    let mut table = String::from("| Message | Number | Onboard | API | GCS |\n| --- | --- | --- | --- | --- |\n");
    let mut asked = Vec::new();
    for p in produced {
        let message = MavMessage::default_message_from_id(p.id).expect("the dialect has it");
        let ([onboard, api, gcs], name) = (p.rate_hz, message.message_name());
        if p.rate_hz.iter().all(|hz| *hz <= 0.0) {
            asked.push(format!("{name} ({})", p.id));
        } else {
            writeln!(table, "| {name} | {} | {onboard} | {api} | {gcs} |", p.id).expect("a string grows");
        }
    }
    table + &format!("\nOn request only:\n{}.\n", asked.join(",\n"))
}

fn parameters() -> String {
    let mut table = String::from("| Parameter | Default | Limits | Unit | |\n| --- | --- | --- | --- | --- |\n");
    for info in parameter_table().iter().filter(|info| info.role == ParameterRole::Acts) {
        let default = info.default.as_f32();
        let (name, unit, text) = (info.name, info.unit, info.description);
        let limits = format!("{} to {}", info.min, info.max);
        writeln!(table, "| {name} | {default} | {limits} | {unit} | {text} |").expect("a string grows");
    }
    table
}

#[test]
fn the_documentation_has_the_tables_of_the_code() {
    let sections = [("streams", streams()), ("parameters", parameters())];
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/mavlink.md");
    page::holds(path, &sections, "-p vigil-autopilot");
}
