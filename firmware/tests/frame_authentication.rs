//! Stories of a sensor whose frames are authenticated: whoever alters or forges one without the key stops the vehicle, by name,
//! and never steers it.

mod common;

use common::{Flight, SENSOR_ID, TestVehicle, config};
use vigil_firmware::{LockstepFirmware, replay};
use vigil_log::{Reader, Recorder, RecorderConfig};
use vigil_types::{DepthFrame, FrameKey, FrameKeys, GuidanceState, Reason, Reasons};

fn key(secret: u8) -> FrameKey {
    FrameKey::new(&[secret; 32], SENSOR_ID, b"this boot")
}

fn only(secret: u8) -> FrameKeys {
    FrameKeys {
        current: Some(key(secret)),
        other: None,
    }
}

impl Flight {
    /// A guided flight. The driver has the key of secret 1 unless a test exchanges it.
    fn authenticated(mut firmware: LockstepFirmware) -> Self {
        firmware.require_frame_keys(only(1));
        let mut flight = Self::of(TestVehicle::hovering(2.5), firmware);
        flight.driver = Some(key(1));
        flight.until_guided();
        flight
    }

    fn guided() -> Self {
        Self::authenticated(LockstepFirmware::new(&config()).unwrap())
    }

    fn until_guided(&mut self) {
        self.until(GuidanceState::Guided, 10.0);
    }

    fn stopped_by(&mut self, alter: impl FnOnce(&mut DepthFrame)) {
        let used = self.last.frame_sequence;
        let report = self.step_altered(alter);
        assert_eq!(report.state, GuidanceState::Hold);
        assert_eq!(report.reasons, Reasons::of(Reason::UnauthenticatedFrame));
        assert_eq!(
            report.frame_sequence, used,
            "the last frame that was taken is the driver's"
        );
        let setpoint = self.vehicle.setpoints.last().unwrap();
        assert_eq!([setpoint.vx, setpoint.vy, setpoint.yaw_rate], [0.0; 3]);
    }
}

#[test]
fn an_altered_frame_with_a_right_checksum_stops_the_vehicle_by_name_and_true_ones_let_it_fly_on() {
    let mut flight = Flight::guided();
    flight.stopped_by(|frame| {
        frame.depth[9_999] = 0.07;
        frame.seal();
    });
    flight.until_guided();
    assert_eq!(flight.last.frames_refused, 1);
}

#[test]
fn a_publisher_without_the_key_or_with_another_never_gets_the_vehicle_off_its_place() {
    let mut firmware = LockstepFirmware::new(&config()).unwrap();
    firmware.require_frame_keys(only(1));
    let mut flight = Flight::of(TestVehicle::hovering(2.5), firmware);
    for step in 0..60 {
        flight.driver = (step % 2 == 0).then(|| key(2));
        let report = flight.step();
        assert_eq!(report.state, GuidanceState::Standby);
        assert!(
            report.reasons.contains(Reason::UnauthenticatedFrame),
            "{:?}",
            report.reasons
        );
    }
}

#[test]
fn frames_that_were_kept_do_not_fly_the_vehicle_again() {
    let mut flight = Flight::guided();
    let mut kept = flight.vehicle.frame(flight.now_ns);
    kept.authenticate(&key(1));
    flight.step();
    // In the same boot: its stamp is not newer.
    let telemetry = flight.vehicle.telemetry();
    let report = flight.step_with(Some(&kept), &telemetry);
    assert_eq!(
        (report.state, report.reasons),
        (GuidanceState::Hold, Reasons::of(Reason::BadFrame))
    );
    flight.until_guided();
    // With its stamp set right: the tag covers the stamp.
    let now_ns = flight.now_ns;
    flight.stopped_by(|frame| {
        frame.clone_from(&kept);
        frame.header.stamp_ns = now_ns;
        frame.seal();
    });
    // Of another boot, with a stamp that fits.
    flight.until_guided();
    flight.stopped_by(|frame| frame.authenticate(&FrameKey::new(&[1; 32], SENSOR_ID, b"the boot before")));
}

#[test]
fn a_key_is_exchanged_in_flight_without_a_hold() {
    let mut flight = Flight::guided();
    flight.firmware.require_frame_keys(FrameKeys {
        current: Some(key(2)),
        other: Some(key(1)),
    });
    for driver in [1, 2] {
        flight.driver = Some(key(driver));
        for _ in 0..20 {
            assert_eq!(flight.step().state, GuidanceState::Guided);
        }
    }
    flight.firmware.require_frame_keys(only(2));
    assert_eq!(flight.step().state, GuidanceState::Guided);
    flight.driver = Some(key(1));
    flight.stopped_by(|_| {});
}

#[test]
fn a_flight_with_forged_frames_is_replayed_to_the_byte_by_somebody_without_the_key() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.mcap");
    let recorder = Recorder::start(RecorderConfig::lossless(&path, config().flight_info())).unwrap();
    let mut firmware = LockstepFirmware::new(&config()).unwrap();
    firmware.record(recorder);
    let mut flight = Flight::authenticated(firmware);
    for step in 0..60 {
        flight.step_altered(|frame| {
            if step % 20 == 7 {
                frame.depth[123] = 0.01;
                frame.seal();
            }
        });
    }
    assert_eq!(flight.last.frames_refused, 3);
    let steps = flight.firmware.steps();
    flight.firmware.finish().unwrap();
    let report = replay(&mut Reader::open(&path).unwrap()).unwrap();
    assert_eq!((report.difference, report.steps), (None, steps));
}

#[test]
fn a_key_that_is_refused_is_named_before_anything_flies() {
    let mut config = config();
    config.frame_key_files = vec!["no/such.key".into()];
    let error = config.frame_keys().unwrap_err().to_string();
    assert!(error.contains("no/such.key"), "{error}");
}
