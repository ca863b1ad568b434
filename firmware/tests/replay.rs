//! A recorded flight runs again to the byte; one byte of difference is found and named.

mod common;

use common::{Flight, TestVehicle, config, monitored_config, undecided_detector};
use std::path::{Path, PathBuf};
use vigil_firmware::replay::ReplayReport;
use vigil_firmware::{FirmwareConfig, LockstepFirmware, replay};
use vigil_log::{FlightInfo, LogEnd, LogPlace, Reader, Recorder, RecorderConfig, TickRecord};
use vigil_types::{AlarmResponse, Datagrams, GuidanceState};

const STEPS: u64 = 240;

fn recorder(path: &Path, info: FlightInfo) -> Recorder {
    Recorder::start(RecorderConfig::lossless(path, info)).unwrap()
}

/// Flies for [`STEPS`] and records; every third step has no frame, one has a bad one.
fn record(folder: &Path, config: &FirmwareConfig) -> PathBuf {
    let path = folder.join("flight.mcap");
    let mut firmware = LockstepFirmware::new(config).unwrap();
    firmware.record(recorder(&path, config.flight_info()));
    let mut flight = Flight::of(TestVehicle::hovering(2.5), firmware);
    flight.now_ns = 0;
    let mut guided = false;
    for step in 0..STEPS {
        let (mut frame, telemetry) = (flight.vehicle.frame(flight.now_ns), flight.vehicle.telemetry());
        if step == 100 {
            frame.depth[77] = f32::NAN;
        }
        let report = flight.step_with((step % 3 != 0).then_some(&frame), &telemetry);
        guided |= report.state == GuidanceState::Guided;
    }
    assert!(guided, "the record is of a flight");
    let summary = flight.firmware.finish().unwrap();
    assert_eq!((summary.records, summary.dropped, summary.failure), (STEPS, 0, None));
    path
}

fn replayed(path: &Path) -> ReplayReport {
    replay(&mut Reader::open(path).unwrap()).unwrap()
}

/// Writes the log again with one record altered.
fn altered(folder: &Path, original: &Path, step: u64, alter: impl FnOnce(&mut TickRecord)) -> PathBuf {
    let path = folder.join(format!("altered-{step}.mcap"));
    let mut reader = Reader::open(original).unwrap();
    let mut writer = recorder(&path, reader.info().clone());
    let mut record = Box::<TickRecord>::default();
    let mut alter = Some(alter);
    while reader.read_next(&mut record).unwrap() {
        if record.timing.step == step {
            alter.take().unwrap()(&mut record);
        }
        assert!(writer.record(|slot| slot.clone_from(&record)));
    }
    assert!(alter.is_none(), "the step is in the log");
    writer.finish();
    path
}

/// Flips the lowest bit of one byte.
fn flip(datagrams: &mut Datagrams, datagram: usize, byte: usize) {
    let mut copy = Datagrams::default();
    for (i, (link, bytes)) in datagrams.iter().enumerate() {
        let mut bytes = bytes.to_vec();
        if i == datagram {
            bytes[byte] ^= 1;
        }
        copy.push(link, &bytes);
    }
    *datagrams = copy;
}

#[test]
fn judgements_and_alarms_run_again_to_the_bit_and_only_with_the_detector_that_flew() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = monitored_config(folder.path());
    config.detector.threshold = Some(0.4);
    let path = record(folder.path(), &config);
    let report = replayed(&path);
    assert!(report.is_equal() && report.sent_bytes > 10_000, "{report}");
    assert_eq!(
        (report.steps, report.log_end),
        (STEPS, Some(LogEnd::Closed { dropped: 0 }))
    );

    let mut reader = Reader::open(&path).unwrap();
    let info = reader.info().clone();
    assert_eq!(info.detector_sha256, Some(undecided_detector().sha256()));
    assert_eq!(info.actor_sha256, Some(undecided_detector().actor_sha256));
    let mut record = Box::<TickRecord>::default();
    let (mut scored, mut recovering) = (0, 0);
    while reader.read_next(&mut record).unwrap() {
        let (judgement, alarm) = (record.report.judgement, record.report.alarm);
        scored += u64::from(judgement.is_some_and(|j| j.phi.iter().all(|phi| phi.is_finite())));
        recovering += u64::from(alarm.is_some_and(|a| a.response == AlarmResponse::Recovery));
    }
    assert!(scored > 200 && recovering > 50, "{scored} {recovering}");

    let bent = altered(folder.path(), &path, 200, |record| {
        let judgement = record.report.judgement.as_mut().unwrap();
        judgement.phi[7] = f32::from_bits(judgement.phi[7].to_bits() ^ 1);
    });
    let difference = replayed(&bent).difference.unwrap();
    assert_eq!(difference.place, "report: `judgement`", "{difference}");

    let mut other = undecided_detector();
    other.seed = 1;
    other.save(&config.detector.file.unwrap()).unwrap();
    let error = replay(&mut Reader::open(&path).unwrap()).unwrap_err();
    assert!(error.to_string().starts_with("a detector with SHA-256"), "{error}");
}

#[test]
fn one_byte_of_difference_is_found_and_named() {
    let folder = tempfile::tempdir().unwrap();
    let original = record(folder.path(), &config());

    // An output that was not what the tick gave.
    let sent = altered(folder.path(), &original, 150, |record| flip(&mut record.sent, 0, 20));
    let report = replayed(&sent);
    assert!(!report.is_equal());
    let difference = report.difference.clone().unwrap();
    assert_eq!((difference.step, report.steps), (150, 150));
    assert_eq!(difference.place, "datagram 0, byte 20");
    let byte = |text: &str| u8::from_str_radix(&text[2..], 16).unwrap();
    assert_eq!(byte(&difference.recorded) ^ byte(&difference.replayed), 1);
    assert!(report.to_string().contains("step 150"), "{report}");

    let differs = |step, alter: fn(&mut TickRecord)| {
        let bent = altered(folder.path(), &original, step, alter);
        replayed(&bent).difference.unwrap()
    };

    // An input that was not what the tick got: a byte of the vehicle's position, with its packet's checksum now wrong,
    // so that the position is missing and older ones count.
    let difference = differs(160, |record| flip(&mut record.received, 1, 15));
    assert!(difference.step >= 160, "{difference}");

    // A pixel of a frame: its checksum is wrong and the frame is refused.
    let difference = differs(170, |record| {
        let mut frame = Box::new(record.frame().unwrap().clone());
        frame.depth[12_345] = 0.5;
        record.set_frame(Some(&frame));
    });
    assert_eq!(difference.step, 170);

    // A report that says something else.
    let difference = differs(180, |record| record.report.frames_refused += 1);
    assert_eq!(difference.step, 180);
    assert!(difference.to_string().contains("frames_refused"), "{difference}");

    // A datagram that is not there.
    let difference = differs(190, |record| record.sent.clear());
    assert_eq!(difference.place, "the number of datagrams");
    assert_eq!(difference.recorded, "0", "{difference}");
}

#[test]
fn where_records_were_dropped_the_replay_ends_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let original = record(folder.path(), &config());
    let path = folder.path().join("gap.mcap");
    // A recorder with one slot that drops: whatever is lost, the records say so.
    let mut reader = Reader::open(&original).unwrap();
    let mut writer = Recorder::start(RecorderConfig {
        slots: 1,
        ..RecorderConfig::new(LogPlace::File(path.clone()), reader.info().clone())
    })
    .unwrap();
    let mut record = Box::<TickRecord>::default();
    while reader.read_next(&mut record).unwrap() {
        writer.record(|slot| slot.clone_from(&record));
    }
    // The last one is written, however slow the disk: a gap has two sides.
    while !writer.record(|slot| slot.clone_from(&record)) {
        std::thread::yield_now();
    }
    assert!(writer.finish().dropped > 0);
    let report = replayed(&path);
    assert!(report.gap_before_step.is_some() && !report.is_equal(), "{report}");
    assert_eq!(report.difference, None);
    assert!(report.to_string().contains("dropped"), "{report}");
}

#[test]
fn a_log_of_another_version_is_refused_by_the_name_of_who_flew_without_advice_that_a_log_cannot_follow() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |config_toml: &str| {
        let info = FlightInfo {
            program: "firmware 0.2.0".into(),
            actor_sha256: Some("5a".repeat(32)),
            config_toml: config_toml.into(),
            ..FlightInfo::default()
        };
        let path = folder.path().join(format!("{}.mcap", config_toml.len()));
        recorder(&path, info).finish();
        replay(&mut Reader::open(&path).unwrap()).unwrap_err().to_string()
    };
    let text = refused("[pilot]\nencoder = \"int8\"");
    assert!(text.contains("firmware 0.2.0") && text.contains("encoder"), "{text}");
    assert!(!text.contains("leave it out"), "{text}");
    let text = refused("");
    assert!(
        text.ends_with("`firmware 0.2.0` flew its built-in one: replay the log with that version"),
        "{text}"
    );
}
