//! Logs outlive the programs that wrote them, in both directions.

use mcap::MessageStream;
use prost_types::FileDescriptorSet;
use std::path::Path;
use vigil_log::{LogEnd, Reader, Recorder, RecorderConfig};
use vigil_types::{GuidanceState, STEP_NS};

/// The first seconds of what `examples/sample_log.rs` of version 0.1.0 recorded, whose messages were not yet made from a .proto file.
const EARLIER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/before-0.2.mcap");

#[test]
fn a_log_of_version_0_1_is_read_as_it_was_recorded() {
    let mut reader = Reader::open(Path::new(EARLIER)).unwrap();
    assert!(reader.info().program.starts_with("sample_log 0.1.0"));
    let mut steps = 0;
    for record in reader.by_ref() {
        let record = record.unwrap();
        let step = record.timing.step;
        assert_eq!((step, record.now_ns), (steps, steps * STEP_NS));
        let report = &record.report;
        let kinematics = report.telemetry.kinematics.unwrap();
        assert_eq!(kinematics.position_ned_m.to_array(), [0.1 * step as f32, 0.5, -1.5]);
        let guided = step >= 20;
        assert_eq!(report.state == GuidanceState::Guided, guided);
        assert_eq!(
            report.action.map(|a| (a.forward_m_s, a.yaw)),
            guided.then_some((1.5, -0.25))
        );
        assert_eq!(report.frame_sequence, Some(step / 2));
        assert_eq!(record.frame().is_some(), step.is_multiple_of(2));
        if let Some(frame) = record.frame() {
            assert_eq!(frame.depth[1234], ((1234 + step) % 1000) as f32 / 1000.0);
        }
        let altered = usize::from(step % 50 == 8);
        let noise = usize::from(step % 50 == 7);
        assert_eq!((record.received.len(), record.sent.len()), (1 + noise + altered, 1));
        steps += 1;
    }
    assert!(steps >= 20, "{steps}");
    assert_eq!(reader.end(), Some(LogEnd::Interrupted { records: steps }));
}

/// The fields of the messages in a log: message, name, number, kind.
fn fields(bytes: &[u8]) -> Vec<(String, String, i32, i32)> {
    let channel = MessageStream::new(bytes)
        .unwrap()
        .filter_map(Result::ok)
        .find(|message| message.channel.topic == "/vigil/tick")
        .expect("a step")
        .channel;
    let schema = channel.schema.as_ref().expect("a schema");
    let set: FileDescriptorSet = prost::Message::decode(&*schema.data).unwrap();
    let messages = set.file.iter().flat_map(|file| &file.message_type);
    messages
        .flat_map(|message| message.field.iter().map(move |field| (message, field)))
        .map(|(message, field)| {
            let kind = field.r#type.unwrap_or_default() * 10 + field.label.unwrap_or_default();
            (message.name().to_owned(), field.name().to_owned(), field.number(), kind)
        })
        .collect()
}

#[test]
fn a_reader_of_version_0_1_finds_every_field_that_it_knows_in_a_log_of_today() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("today.mcap");
    let earlier = std::fs::read(EARLIER).unwrap();
    let mut reader = Reader::open(Path::new(EARLIER)).unwrap();
    let config = RecorderConfig::lossless(&path, reader.info().clone());
    let mut recorder = Recorder::start(config).unwrap();
    for record in reader.by_ref() {
        let r = record.unwrap();
        assert!(recorder.record(|slot| slot.fill(r.now_ns, r.timing, r.frame(), &r.received, &r.sent, &r.report)));
    }
    assert_eq!(recorder.finish().failure, None);
    let today = fields(&std::fs::read(path).unwrap());
    for field in fields(&earlier) {
        assert!(today.contains(&field), "{field:?} is not what it was");
    }
}
