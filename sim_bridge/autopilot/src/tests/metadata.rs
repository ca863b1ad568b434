//! Component metadata, as a client finds and reads it.

use crate::testing::*;
use crate::tests::ftp::Client;
use serde_json::Value;
use vigil_mavlink::crc::crc32;

fn content(b: &mut Bench, uri: &str) -> (Value, u32) {
    let path = uri.strip_prefix("mftp://").expect("a file of the vehicle's");
    let bytes = Client::new().download(b, 0, path);
    (serde_json::from_slice(&bytes).expect("JSON"), crc32(&bytes))
}

/// What the general metadata says of the one of this type.
fn part(b: &mut Bench, kind: u64) -> Value {
    let found = b.request::<COMPONENT_METADATA_DATA>();
    let (general, general_crc) = content(b, found.uri.to_str().expect("text"));
    assert_eq!(found.file_crc, general_crc);
    assert_eq!(general["version"], 1);
    let types = general["metadataTypes"].as_array().expect("a list");
    let part = types.iter().find(|t| t["type"] == kind).expect("has the type");
    let (json, crc) = content(b, part["uri"].as_str().expect("text"));
    assert_eq!(part["fileCrc"], crc);
    json
}

#[test]
fn the_metadata_describes_every_parameter() {
    let mut b = Bench::new();
    let json = part(&mut b, 1);
    let described = json["parameters"].as_array().expect("a list");
    assert_eq!(described.len(), parameter_table().len());
    for (described, info) in described.iter().zip(parameter_table()) {
        assert_eq!(described["name"], info.name);
        assert_eq!(described["shortDesc"], info.description);
        assert_eq!(described["units"], info.unit);
        let kind = match info.default {
            ParameterValue::Integer(_) => "Int32",
            ParameterValue::Real(_) => "Float",
        };
        assert_eq!(described["type"], kind);
        for (key, value) in [("default", info.default.as_f32()), ("min", info.min), ("max", info.max)] {
            assert_eq!(described[key].as_f64().expect("number") as f32, value, "{}", info.name);
        }
    }
    let text = json.to_string();
    assert!(text.contains("\"default\":0.4,"), "not 0.4000000059604645");
}

#[test]
fn every_event_that_comes_is_defined_with_arguments_that_fit() {
    let mut b = Bench::new();
    let json = part(&mut b, 4);
    let groups = json["components"]["1"]["event_groups"].as_object().expect("groups");
    for (group, events) in groups {
        for (id, event) in events["events"].as_object().expect("events") {
            assert!(id.parse::<u32>().expect("a number") < 1 << 24);
            let size_of = |argument: &Value| {
                let kind = argument["type"].as_str().expect("text");
                let base = json["components"]["1"]["enums"][kind]["type"].as_str().unwrap_or(kind);
                match base {
                    "uint8_t" => 1,
                    "uint32_t" => 4,
                    other => panic!("{group} {id}: {other}"),
                }
            };
            let arguments = event["arguments"].as_array().into_iter().flatten();
            let size: usize = arguments.map(size_of).sum();
            assert!(size <= 40, "{event}");
            let message = event["message"].as_str().expect("text");
            assert!(!message.is_empty() && message.len() <= 120);
        }
    }
}

#[test]
fn the_numbers_of_a_choice_say_what_they_stand_for() {
    let mut b = Bench::new();
    let json = part(&mut b, 1);
    let values = |name: &str| {
        let described = json["parameters"].as_array().expect("a list");
        let row = described.iter().find(|row| row["name"] == name).expect("a parameter");
        let values = row["values"].as_array().cloned().unwrap_or_default();
        let read = |v: &Value| Some((v["value"].as_i64()?, v["description"].as_str()?.to_owned()));
        let read: Option<Vec<_>> = values.iter().map(read).collect();
        read.expect("numbers with texts")
    };
    assert_eq!(values("GF_ACTION")[3], (3, "return".to_owned()));
    assert!(values("COM_OF_LOSS_T").is_empty() && values("SYS_AUTOSTART").is_empty());
    // Every acting integer that is not of bits is a choice, and all of its numbers are listed.
    let acting = parameter_table()
        .iter()
        .filter(|i| i.role == crate::ParameterRole::Acts && !i.description.contains("by bits"));
    for info in acting {
        if let ParameterValue::Integer(_) = info.default {
            let numbers: Vec<i64> = values(info.name).iter().map(|(number, _)| *number).collect();
            let allowed = info.min as i64..=info.max as i64;
            assert_eq!(numbers, allowed.collect::<Vec<_>>(), "{}", info.name);
        }
    }
}
