//! Component metadata: what the parameters and events mean, as JSON that is fetched by file transfer.
//! <https://mavlink.io/en/services/component_information.html>

use crate::saved::exact;
use crate::service::prelude::*;
use crate::services::events::definitions;
use crate::vehicle_parameters::{ParameterInfo, ParameterValue, parameter_table};
use serde_json::{Value, json};
use vigil_mavlink::crc::crc32;

/// Where PX4 keeps them.
const GENERAL: &str = "etc/extras/component_general.json";
const PARAMETERS: &str = "etc/extras/parameters.json";
const EVENTS: &str = "etc/extras/all_events.json";

pub(crate) struct Metadata;

impl Service for Metadata {
    fn start(&mut self, core: &mut Core) {
        provide(core);
    }

    fn messages(&self) -> &'static [Produced] {
        const { &[Produced::from(COMPONENT_METADATA_DATA::ID, [0.0; 3], general)] }
    }
}

fn uri(path: &str) -> String {
    format!("mftp:///{path}")
}

/// Where the general metadata is.
fn general(core: &Core) -> Option<MavMessage> {
    Some(MavMessage::COMPONENT_METADATA(COMPONENT_METADATA_DATA {
        time_boot_ms: core.time_boot_ms(),
        file_crc: crc32(core.files.read(GENERAL).ok()?),
        uri: uri(GENERAL).as_str().into(),
    }))
}

/// A parameter as the schema of parameter metadata has it. Numbers are written as short as they read back.
fn described(info: &ParameterInfo) -> Value {
    let (kind, number): (_, fn(f32) -> Value) = match info.default {
        ParameterValue::Integer(_) => ("Int32", |value| json!(value as i32)),
        ParameterValue::Real(_) => ("Float", |value| json!(exact(ParameterValue::Real(value)))),
    };
    let choice = |(value, description)| json!({ "value": value, "description": description });
    let values: Vec<Value> = info.choices().into_iter().map(choice).collect();
    let mut described = json!({
        "name": info.name,
        "type": kind,
        "group": info.name.split_once('_').map_or("", |(group, _)| group),
        "shortDesc": info.description,
        "units": info.unit,
        "default": number(info.default.as_f32()),
        "min": number(info.min),
        "max": number(info.max),
    });
    if !values.is_empty() {
        described["values"] = values.into();
    }
    described
}

/// What is in memory always serialises; were it not to, the file would be empty and clients would do without.
fn text(value: &Value) -> Vec<u8> {
    serde_json::to_vec(value).unwrap_or_default()
}

/// Puts the metadata among the vehicle's own files.
fn provide(core: &mut Core) {
    let parameters: Vec<Value> = parameter_table().iter().map(described).collect();
    let parameters = text(&json!({ "version": 1, "parameters": parameters }));
    let events = text(&definitions());
    let part = |kind: CompMetadataType, path: &str, content: &[u8]| json!({ "type": kind as u32, "uri": uri(path), "fileCrc": crc32(content) });
    let general = text(&json!({
        "version": 1,
        "vendorName": "Vigil",
        "modelName": "Simulated quadcopter",
        "firmwareVersion": env!("CARGO_PKG_VERSION"),
        "metadataTypes": [
            part(CompMetadataType::COMP_METADATA_TYPE_PARAMETER, PARAMETERS, &parameters),
            part(CompMetadataType::COMP_METADATA_TYPE_EVENTS, EVENTS, &events),
        ],
    }));
    for (path, content) in [(GENERAL, general), (PARAMETERS, parameters), (EVENTS, events)] {
        core.files.provide(path, content, core.unix_time_s());
    }
}
