//! Component metadata: what the parameters and events mean, as JSON that is fetched by file transfer.
//! <https://mavlink.io/en/services/component_information.html>

use crate::files::FileSystem;
use crate::service::prelude::*;
use crate::services::events::definitions;
use crate::vehicle_parameters::{ParameterInfo, ParameterValue, parameter_table};
use serde::Serialize;
use serde_json::json;
use vigil_mavlink::crc::crc32;

/// Where PX4 keeps them.
const GENERAL: &str = "etc/extras/component_general.json";
const PARAMETERS: &str = "etc/extras/parameters.json";
const EVENTS: &str = "etc/extras/all_events.json";

pub(crate) struct Metadata;

impl Service for Metadata {
    fn start(&mut self, core: &mut Core) {
        let now_s = core.unix_time_s();
        provide(&mut core.files, now_s);
    }

    fn messages(&self) -> &'static [Produced] {
        const {
            &[Produced::from(
                COMPONENT_METADATA_DATA::ID,
                [0.0; 3],
                component_metadata,
            )]
        }
    }
}

fn uri(path: &str) -> String {
    format!("mftp:///{path}")
}

fn component_metadata(core: &Core) -> Option<MavMessage> {
    Some(MavMessage::COMPONENT_METADATA(COMPONENT_METADATA_DATA {
        time_boot_ms: core.time_boot_ms(),
        file_crc: crc32(core.files.read(GENERAL).ok()?),
        uri: uri(GENERAL).as_str().into(),
    }))
}

/// A parameter as the schema of parameter metadata has it. Numbers are written as short as they read back.
#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct Described {
    name: &'static str,
    #[serde(rename = "type")]
    kind: &'static str,
    group: &'static str,
    short_desc: &'static str,
    units: &'static str,
    default: Number,
    min: Number,
    max: Number,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    values: Vec<Choice>,
}

/// A number that stands for something.
#[derive(Serialize)]
struct Choice {
    value: i32,
    description: &'static str,
}

#[derive(Serialize)]
#[serde(untagged)]
enum Number {
    Integer(i32),
    Real(f32),
}

impl From<&ParameterInfo> for Described {
    fn from(info: &ParameterInfo) -> Self {
        let (kind, default) = match info.default {
            ParameterValue::Int32(value) => ("Int32", Number::Integer(value)),
            ParameterValue::Real32(value) => ("Float", Number::Real(value)),
        };
        let limit = |value: f32| match info.default {
            ParameterValue::Int32(_) => Number::Integer(value as i32),
            ParameterValue::Real32(_) => Number::Real(value),
        };
        Self {
            name: info.name,
            kind,
            group: info.name.split_once('_').map_or("", |(group, _)| group),
            short_desc: info.description,
            units: info.unit,
            default,
            min: limit(info.min),
            max: limit(info.max),
            values: info
                .choices()
                .into_iter()
                .map(|(value, description)| Choice { value, description })
                .collect(),
        }
    }
}

#[derive(Serialize)]
struct ParameterFile {
    version: u32,
    parameters: Vec<Described>,
}

/// What is in memory always serialises; were it not to, the file would be empty and clients would do without.
fn text(value: &impl Serialize) -> Vec<u8> {
    serde_json::to_vec(value).unwrap_or_default()
}

/// Puts the metadata among the vehicle's own files.
fn provide(files: &mut FileSystem, now_s: u64) {
    let parameters = text(&ParameterFile {
        version: 1,
        parameters: parameter_table().iter().map(Described::from).collect(),
    });
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
        files.provide(path, content, now_s);
    }
}
