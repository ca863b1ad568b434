//! Streams, requests, parameters, identity: what clients ask besides flying.

use crate::testing::*;
use crate::tests::plans::{MISSION, waypoint};
use vigil_mavlink::mavlink::Message;

#[test]
fn telemetry_streams_unasked_at_the_rates_of_each_link() {
    let mut b = Bench::new();
    b.run_ms(4_000);
    for (id, onboard, api, gcs) in [
        (HEARTBEAT_DATA::ID, 4, 4, 4),
        (ATTITUDE_DATA::ID, 200, 200, 80),
        (ATTITUDE_QUATERNION_DATA::ID, 200, 80, 40),
        (LOCAL_POSITION_NED_DATA::ID, 200, 120, 40),
        (GLOBAL_POSITION_INT_DATA::ID, 20, 40, 20),
        (EXTENDED_SYS_STATE_DATA::ID, 20, 20, 4),
        (SYS_STATUS_DATA::ID, 4, 20, 4),
        (GPS_RAW_INT_DATA::ID, 4, 20, 4),
        (BATTERY_STATUS_DATA::ID, 2, 2, 2),
        (HOME_POSITION_DATA::ID, 2, 2, 2),
    ] {
        let counts = [ONBOARD, API, GCS].map(|link| b.count(link, id));
        for (count, wanted) in counts.into_iter().zip([onboard, api, gcs]) {
            // A rate that does not divide a millisecond lands on the next one.
            assert!(count.abs_diff(wanted) <= wanted / 20, "message {id}: {counts:?}");
        }
    }
}

#[test]
fn system_time_is_the_clock_it_was_given_once_a_second_on_every_link() {
    const AT_ZERO_US: u64 = 1_800_000_000_000_000;
    let mut b = Bench::with(EndpointConfig {
        unix_time_at_zero_us: AT_ZERO_US,
        ..EndpointConfig::default()
    });
    b.run_ms(1_500);
    b.sent.clear();
    b.run_ms(10_000);
    for link in [ONBOARD, API, GCS] {
        let messages = b.all::<SYSTEM_TIME_DATA>(link).into_iter();
        let times: Vec<_> = messages.map(|time| (time.time_unix_usec, time.time_boot_ms)).collect();
        assert_eq!(times.len(), 10, "{times:?}");
        for pair in times.windows(2) {
            assert_eq!(pair[1].0 - pair[0].0, 1_000_000, "both clocks run alike");
            assert_eq!(pair[1].1 - pair[0].1, 1_000);
        }
        let (unix_us, boot_ms) = times[0];
        assert!((2_000..=3_000).contains(&boot_ms), "{boot_ms} ms since boot");
        // The first step of a test's vehicle is 1.001 s after the clock's zero.
        assert_eq!(unix_us, AT_ZERO_US + 1_001_000 + u64::from(boot_ms) * 1000);
    }
}

#[test]
fn intervals_are_set_and_reported_per_link() {
    let mut b = Bench::new();
    let id = ATTITUDE_DATA::ID;
    let interval = |us: f32| [id as f32, us];
    assert_eq!(b.ask(511, &interval(100_000.0)), ACCEPTED);
    b.sent.clear();
    b.run_ms(1_000);
    assert!((10..=11).contains(&b.count(API, id)), "one at once, then every 100 ms");
    assert_eq!(b.count(GCS, id), 20, "another link keeps its rate");
    assert_eq!(b.ask(510, &interval(0.0)), ACCEPTED);
    let answer = b.one::<MESSAGE_INTERVAL_DATA>();
    assert_eq!((answer.interval_us, answer.message_id), (100_000, 30));
}

#[test]
fn a_message_the_vehicle_does_not_have_is_denied() {
    let mut b = Bench::new();
    for id in [11_000.0, 1e9, -5.0, f32::NAN, f32::INFINITY] {
        assert_eq!(b.ask(511, &[id, 1e5]), FAILED, "{id}");
        assert_eq!(b.ask(512, &[id, 1e5]), DENIED, "{id}");
    }
    assert_eq!((b.ask(510, &[11_000.0]), b.ask(510, &[f32::NAN])), (ACCEPTED, DENIED));
    assert_eq!(b.one::<MESSAGE_INTERVAL_DATA>().interval_us, 0, "unknown");
}

#[test]
fn requests_are_answered_on_the_link_they_came_on() {
    let mut b = Bench::new();
    let version = b.request::<AUTOPILOT_VERSION_DATA>();
    let counts = [API, GCS].map(|link| b.count(link, AUTOPILOT_VERSION_DATA::ID));
    assert_eq!(counts, [1, 0]);
    let bytewise = MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE;
    assert!(version.capabilities.contains(bytewise));
    assert_eq!(version.flight_sw_version.to_be_bytes(), [1, 18, 0, 255]);
    for id in [HOME_POSITION_DATA::ID, GPS_GLOBAL_ORIGIN_DATA::ID] {
        b.sent.clear();
        assert_eq!(b.ask(512, &[id as f32]), ACCEPTED);
        assert_eq!(b.count(API, id), 1);
    }
}

#[test]
fn set_mode_is_acknowledged_as_the_command_that_it_stands_for() {
    let mut b = Bench::airborne();
    // There is no mission, which AUTO without a sub mode is too.
    for (main, sub) in [(4, 4), (4, 0), (4, 77), (4, 1), (3, 2), (8, 0)] {
        assert_eq!(b.set_mode_message(1, main, sub), REJECTED, "{main} {sub}");
    }
    assert_eq!(b.set_mode_message(1, 4, 6), ACCEPTED);
    assert_eq!(b.status().mode, FlightMode::Land);
}

/// As PX4 reads and reports them: by HEARTBEAT's base mode older clients name the mode.
#[test]
fn a_base_mode_is_flown_as_by_px4_and_reported_by_the_sticks_that_it_needs() {
    let mut b = Bench::new();
    let modes = [
        (4, FlightMode::Mission, 29),
        (64, FlightMode::Manual, 81),
        (64 + 16, FlightMode::Stabilized, 81),
        (64 + 8, FlightMode::Position, 81),
    ];
    for (base, mode, reported) in modes {
        assert_eq!(b.ask(176, &[f32::from(base)]), ACCEPTED);
        assert_eq!(
            (b.status().mode, b.last::<HEARTBEAT_DATA>(API).base_mode.bits()),
            (mode, reported)
        );
        assert_eq!(b.set_mode(API, SCRIPT, 5, 0), ACCEPTED);
        assert_eq!(b.last::<HEARTBEAT_DATA>(API).base_mode.bits(), 65, "acro");
        assert_eq!(b.set_mode_message(base, 0, 0), ACCEPTED);
        assert_eq!(b.status().mode, mode);
    }
    assert_eq!(b.set_mode_message(0, 4, 6), REJECTED, "none");
    b.assert_said("mode denied: not flown by this vehicle");
}

/// PX4 1.18: pauses and starts are mode changes, MISSION_SET_CURRENT chooses an item, ACTUATOR_TEST tries a motor, REQUEST_MESSAGE asks
/// for HOME_POSITION and the two versions.
#[test]
fn commands_that_px4_does_not_know_are_unsupported_and_change_nothing() {
    let mut b = Bench::airborne();
    b.upload(MISSION, &[waypoint((30.0, 0.0), 3.0), waypoint((0.0, 10.0), 3.0)]);
    assert_eq!(b.set_mode(API, SCRIPT, 4, 4), ACCEPTED);
    for command in [17, 193, 209, 224, 410, 519, 520] {
        for first in [0.0, 1.0] {
            b.sent.clear();
            assert_eq!(b.ask(command, &[first]), UNSUPPORTED, "{command}");
            let asked_for = [
                HOME_POSITION_DATA::ID,
                AUTOPILOT_VERSION_DATA::ID,
                PROTOCOL_VERSION_DATA::ID,
            ];
            assert!(asked_for.iter().all(|id| b.count(API, *id) == 0), "{command}");
        }
    }
    assert_eq!(b.status().mode, FlightMode::Mission);
    assert_eq!(b.status().refusals.command_unsupported, 14);
}

#[test]
fn position_is_reported_locally_and_globally_alike() {
    let mut b = Bench::airborne();
    b.run_ms(1_000);
    let g = b.one::<GLOBAL_POSITION_INT_DATA>();
    let l = b.one::<LOCAL_POSITION_NED_DATA>();
    assert!((l.z + 3.0).abs() < 0.2, "{l:?}");
    // A degree of latitude is 111.195 km on a sphere of 6371 km; of longitude, times the cosine of the latitude.
    let north_m = f64::from(g.lat - 473_977_420) * 1e-7 * 111_194.93;
    let east_m = f64::from(g.lon - 85_455_940) * 1e-7 * 111_194.93 * 47.397_742_f64.to_radians().cos();
    let (off_north_m, off_east_m) = (north_m - f64::from(l.x), east_m - f64::from(l.y));
    let off_up_m = f64::from(g.relative_alt) * 1e-3 + f64::from(l.z);
    let is_alike = [off_north_m, off_east_m, off_up_m]
        .iter()
        .all(|off_m| off_m.abs() < 0.05);
    assert!(is_alike, "{g:?} {l:?}");
    assert!((g.alt - 488_000 - g.relative_alt).abs() <= 1);
}

#[test]
fn pings_and_time_requests_are_answered_to_their_sender() {
    let mut b = Bench::new();
    b.send(API, SCRIPT, &message!(PING, seq = 5));
    let p = b.one::<PING_DATA>();
    assert_eq!((p.seq, p.target_system, p.target_component), (5, 245, 190));
    b.send(API, SCRIPT, &message!(TIMESYNC, ts1 = 123_456));
    let t = b.one::<TIMESYNC_DATA>();
    assert_eq!(t.ts1, 123_456);
    assert!(t.tc1 > 0);
    // An answer is not answered: two vehicles would never stop.
    b.sent.clear();
    b.send(API, SCRIPT, &message!(TIMESYNC, tc1 = 9, ts1 = 123_456));
    assert_eq!(b.count(API, TIMESYNC_DATA::ID), 0);
}

#[test]
fn the_parameter_list_is_complete_typed_and_paced() {
    let mut b = Bench::new();
    b.tell(message!(PARAM_REQUEST_LIST));
    b.run_ms(2_000);
    let mut listed = b.all::<PARAM_VALUE_DATA>(API);
    assert_eq!(listed.remove(0).param_id.to_str(), Ok("_HASH_CHECK"));
    assert_eq!(listed.len(), parameter_table().len());
    for (i, (value, info)) in listed.iter().zip(parameter_table()).enumerate() {
        assert_eq!(value.param_id.to_str(), Ok(info.name));
        let place = (usize::from(value.param_index), usize::from(value.param_count));
        assert_eq!(place, (i, listed.len()));
    }
    assert!(b.all::<PARAM_VALUE_DATA>(GCS).is_empty());
    let is_value = |s: &&Sent| matches!(s.message, Some(MavMessage::PARAM_VALUE(_)));
    let times: Vec<_> = b.sent.iter().filter(is_value).map(|s| s.at_ns).collect();
    // The digest comes at once.
    assert!(times[1..].windows(2).all(|w| w[1] - w[0] >= 5_000_000));
}

#[test]
fn parameters_are_read_by_name_and_index_and_integers_travel_bytewise() {
    let mut b = Bench::new();
    b.read_parameter("COM_OBL_RC_ACT", -1);
    let index = parameter_table().iter().position(|p| p.name == "MIS_TAKEOFF_ALT");
    b.read_parameter("", index.expect("known") as i16);
    let got = b.all::<PARAM_VALUE_DATA>(API);
    assert_eq!(got[0].param_type, MavParamType::MAV_PARAM_TYPE_INT32);
    assert_eq!(got[0].param_value.to_bits(), 5);
    assert_eq!(got[1].param_id.to_str(), Ok("MIS_TAKEOFF_ALT"));
    assert_eq!(got[1].param_value, 2.5);
    b.read_parameter("NO_SUCH", -1);
    b.read_parameter("", 999);
    assert_eq!(b.all::<PARAM_VALUE_DATA>(API).len(), 2);
    assert_eq!(b.status().refusals.parameter, 2);
}

#[test]
fn a_set_parameter_acts_and_everybody_hears_of_it() {
    let mut b = Bench::new();
    b.set_parameter("MIS_TAKEOFF_ALT", ParameterValue::Real(10.0));
    assert_eq!(b.all::<PARAM_VALUE_DATA>(API)[0].param_value, 10.0);
    assert_eq!(b.all::<PARAM_VALUE_DATA>(GCS)[0].param_value, 10.0);
    b.take_off();
    // PX4's own flight test: the height is kept for a minute.
    let down_m = |b: &Bench| b.view().estimate.position_ned_m.z;
    b.run_until(30, "the height", |b| (down_m(b) + 10.0).abs() < 0.35);
    let before_m = down_m(&b);
    assert!(b.most(60_000, |b| (down_m(b) - before_m).abs()) < 0.25);
}

#[test]
fn a_bad_parameter_set_changes_nothing_and_says_why() {
    let mut b = Bench::new();
    use MavParamError::{
        MAV_PARAM_ERROR_DOES_NOT_EXIST as UNKNOWN, MAV_PARAM_ERROR_READ_ONLY as FIXED,
        MAV_PARAM_ERROR_TYPE_MISMATCH as TYPE, MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE as RANGE,
    };
    use MavParamType::{MAV_PARAM_TYPE_INT32 as INT32, MAV_PARAM_TYPE_REAL32 as REAL32, MAV_PARAM_TYPE_UINT8 as UINT8};
    let bad = [
        // What set-up pages cannot change.
        ("SYS_AUTOSTART", f32::from_bits(10_016), INT32, FIXED),
        ("MIS_TAKEOFF_ALT", f32::NAN, REAL32, RANGE),
        ("MIS_TAKEOFF_ALT", -2.0, REAL32, RANGE),
        ("MIS_TAKEOFF_ALT", f32::from_bits(3), INT32, TYPE),
        ("COM_OBL_RC_ACT", f32::from_bits(99), INT32, RANGE),
        ("COM_OBL_RC_ACT", 4.0, REAL32, TYPE),
        ("MIS_TAKEOFF_ALT", 3.0, UINT8, TYPE),
        ("NO_SUCH", 3.0, REAL32, UNKNOWN),
    ];
    for (name, value, kind, _) in bad {
        b.set_parameter_as(name, value, kind);
    }
    assert_eq!(b.status().refusals.parameter, 8);
    let ids: Vec<u32> = b.messages(API).map(Message::message_id).take(2).collect();
    assert_eq!(ids, [PARAM_ERROR_DATA::ID, PARAM_VALUE_DATA::ID]);
    let errors = b.all::<PARAM_ERROR_DATA>(API).into_iter();
    let answers: Vec<_> = errors.map(|e| (e.target_system, e.error)).collect();
    assert_eq!(answers, bad.map(|(.., error)| (SCRIPT.system, error)));
    for value in b.all::<PARAM_VALUE_DATA>(API) {
        let unchanged = value.param_value == 2.5 || [5, 4001].contains(&value.param_value.to_bits());
        assert!(unchanged, "{value:?}");
    }
    b.assert_said("is not within 0.5 to 80");
    b.assert_said("SYS_AUTOSTART cannot be set");
    assert!(b.all::<PARAM_VALUE_DATA>(GCS).is_empty());
    // Each of a flood is answered to its sender; the texts, which go to all, are few, and come again for the next mistake.
    b.run_ms(1_000);
    for (sets, texts) in [(100, 4), (1, 1)] {
        b.sent.clear();
        for i in 0..sets {
            b.set_parameter(&format!("NO_SUCH_{i}"), ParameterValue::Integer(1));
            b.run_ms(10);
        }
        assert_eq!((b.count(API, PARAM_ERROR_DATA::ID), b.texts().len()), (sets, texts));
    }
}

#[test]
fn a_calibration_is_reported_as_px4_does_and_one_that_needs_hands_is_refused() {
    let mut b = Bench::new();
    let ask =
        |b: &mut Bench, gyro: f32, mag: f32, accelerometer: f32| b.ask(241, &[gyro, mag, 0.0, 0.0, accelerometer]);
    for (gyro, level, name) in [(1.0, 0.0, "gyro"), (0.0, 2.0, "level")] {
        b.sent.clear();
        assert_eq!(ask(&mut b, gyro, 0.0, level), ACCEPTED);
        assert_eq!(ask(&mut b, gyro, 0.0, level), REJECTED, "one at a time");
        b.run_ms(1_500);
        b.assert_said(&format!("[cal] calibration started: 2 {name}"));
        b.assert_said("[cal] progress <50>");
        b.assert_said(&format!("[cal] calibration done: {name}"));
    }
    assert_eq!(ask(&mut b, 0.0, 1.0, 0.0), REJECTED);
    assert_eq!(ask(&mut b, 0.0, 0.0, 1.0), REJECTED);
    assert_eq!(ask(&mut b, 1.0, 0.0, 0.0), ACCEPTED);
    assert_eq!(ask(&mut b, 0.0, 0.0, 0.0), ACCEPTED, "cancels");
    let is_said = b.texts().iter().any(|text| text.contains("cancelled"));
    assert!(!is_said, "who waits for the acknowledgement takes no text before it");
    b.run_ms(1_500);
    b.assert_said("[cal] calibration cancelled");
    b.sent.clear();
    let (calibrate, frame) = (MavCmd::MAV_CMD_PREFLIGHT_CALIBRATION, MavFrame::MAV_FRAME_LOCAL_NED);
    assert_eq!(b.command_at(calibrate, [0.0; 4], frame, (2e-7, 0.0), 0.0), ACCEPTED);
    b.assert_said("started: 2 level");
    assert_eq!(b.arm(), ACCEPTED);
    b.run_ms(100);
    b.assert_said("[cal] calibration failed: armed");
    assert_eq!(ask(&mut b, 1.0, 0.0, 0.0), REJECTED, "armed");
}

#[test]
fn vibration_is_felt_in_flight_and_not_on_the_ground() {
    let level = |b: &mut Bench| b.fresh::<VIBRATION_DATA>(4_000).vibration_z;
    let (still, flying) = (level(&mut Bench::new()), level(&mut Bench::airborne()));
    assert!(still >= 0.0 && flying > 0.0 && flying < 5.0, "{still} {flying}");
}

#[test]
fn a_signing_key_reaches_the_vehicle_and_nobody_else() {
    let mut b = Bench::new();
    b.send(ONBOARD, COMPANION, &message!(HEARTBEAT));
    let setup = |system, component, byte| {
        message!(
            SETUP_SIGNING,
            target_system = system,
            target_component = component,
            secret_key = [byte; 32],
            initial_timestamp = 77
        )
    };
    b.sent.clear();
    for message in [setup(1, 191, 5), setup(0, 0, 5), setup(2, 1, 5), setup(1, 1, 0)] {
        b.send(API, SCRIPT, &message);
        assert!(b.endpoint.take_signing_setup().is_none());
    }
    b.assert_said("signing key refused: all zeros");
    b.send(API, SCRIPT, &setup(1, 1, 5));
    let taken = b.endpoint.take_signing_setup().expect("taken");
    assert_eq!((taken.key, taken.initial_timestamp), ([5; 32], 77));
    assert!(b.endpoint.take_signing_setup().is_none(), "once");
    b.run_ms(100);
    for link in [ONBOARD, API, GCS] {
        assert_eq!(b.count(link, SETUP_SIGNING_DATA::ID), 0, "a key is passed on");
    }
}

/// An interval that is no time: added to the clock it ended the process.
#[test]
fn an_interval_that_is_no_time_is_denied_and_the_streams_go_on() {
    const ATTITUDE: f32 = 30.0;
    let mut b = Bench::new();
    let set = |b: &mut Bench, interval_us: f32| b.ask(511, &[ATTITUDE, interval_us]);
    for no_time_us in [f32::INFINITY, f32::NEG_INFINITY, f32::MAX, 1.9e16, f32::NAN] {
        assert_eq!(set(&mut b, no_time_us), DENIED, "{no_time_us}");
        b.sent.clear();
        b.run_ms(1_000);
        assert_eq!(b.count(API, 30), 50, "as before");
    }
    // A year is a time, however useless; so are a subnormal and a negative number, which switch to the fastest and off.
    let and_off = [(f32::MIN, 0), (0.0, 50), (-1.0, 0), (0.0, 50)];
    for (interval_us, per_s) in [(3.2e13, 0), (f32::MIN_POSITIVE, 500)].into_iter().chain(and_off) {
        assert_eq!(set(&mut b, interval_us), ACCEPTED, "{interval_us}");
        b.run_ms(2);
        b.sent.clear();
        b.run_ms(1_000);
        assert_eq!(b.count(API, 30), per_s, "{interval_us}");
    }
}

#[test]
fn the_vehicle_s_system_is_a_parameter_that_is_nobody_s_to_set_or_to_keep() {
    for system_id in [1, 7] {
        let mut b = Bench::with(EndpointConfig {
            system_id,
            ..EndpointConfig::default()
        });
        b.sent.clear();
        b.system = system_id;
        b.set_parameter("MAV_SYS_ID", ParameterValue::Integer(9));
        b.read_parameter("MAV_SYS_ID", -1);
        let requested = b.last::<PARAM_VALUE_DATA>(API).param_value.to_bits();
        assert_eq!(requested, u32::from(system_id));
        assert!(b.endpoint.saved().parameters.is_empty());
    }
}
