//! Vehicles that are well and vehicles that are not, and what is said of them.

use std::collections::BTreeMap;
use vigil_mavlink::common::*;
use vigil_mavlink::framing::{FramingCounters, encode, packets};
use vigil_mavlink::message;
use vigil_mavlink::{Flavour, MavMessage};
use vigil_sim::world::{Family, Lidar, LidarConfig, Shot, World, generate};
use vigil_sim::{SimConfig, Simulator, Start};
use vigil_tools::doctor::{Examination, ExaminationConfig, Finding, Severity, ground_tilt};
use vigil_types::{Attitude, Datagrams, DepthFrame, NedVector};

const MS: u64 = 1_000_000;

/// A vehicle on the ground that answers what it is asked, written from the protocol's documentation.
#[derive(Default)]
struct Scripted {
    flavour: Flavour,
    /// Milliseconds between two positions and attitudes.
    stream_ms: u64,
    has_home: bool,
    estimator: u16,
    prearm: bool,
    battery_percent: i8,
    yaw_rad: f32,
    speedup: f64,
    parameters: BTreeMap<&'static str, f32>,
    extra: Vec<((u8, u8), u64, MavMessage)>,
    asked: Vec<MavMessage>,
    texts: Vec<&'static str>,
    /// Milliseconds in which positions, and attitudes, do not come.
    no_position: core::ops::Range<u64>,
    no_attitude: core::ops::Range<u64>,
    /// Milliseconds in which positions are no numbers, estimator and pre-arm check are not ready, what they say does not come.
    no_numbers: core::ops::Range<u64>,
    not_ready: core::ops::Range<u64>,
    no_status: core::ops::Range<u64>,
    /// When it starts anew, its clock jumps by 3 s, its position by 4 m, its heading by 60°; never where that is 0.
    restarts_ms: u64,
    clock_jumps_ms: u64,
    position_jumps_ms: u64,
    heading_jumps_ms: u64,
    /// Whose position comes 0.9 s late, after newer ones; none where that is 0.
    late_ms: u64,
}

impl Scripted {
    fn well(flavour: Flavour) -> Self {
        let parameters: &[(&str, f32)] = match flavour {
            Flavour::Px4 => &[
                ("COM_OF_LOSS_T", 1.0),
                // Integers have their bits where the float is.
                ("COM_OBL_RC_ACT", f32::from_bits(4)),
                ("COM_RC_OVERRIDE", f32::from_bits(3)),
                ("COM_RCL_EXCEPT", f32::from_bits(4)),
                ("MPC_XY_CRUISE", 5.3),
            ],
            Flavour::ArduPilot => &[
                ("GUID_TIMEOUT", 0.5),
                ("FS_EKF_ACTION", 1.0),
                ("ARMING_CHECK", 1.0),
                ("RC_OVERRIDE_TIME", 3.0),
                ("WPNAV_SPEED", 530.0),
            ],
        };
        Self {
            flavour,
            stream_ms: 40,
            has_home: true,
            estimator: 1 | 2 | 4 | 8 | 16 | 32,
            prearm: true,
            battery_percent: 16,
            yaw_rad: 30_f32.to_radians(),
            speedup: 1.0,
            parameters: parameters.iter().copied().collect(),
            ..Self::default()
        }
    }

    fn heartbeat(&self) -> MavMessage {
        message!(
            HEARTBEAT,
            autopilot = match self.flavour {
                Flavour::Px4 => MavAutopilot::MAV_AUTOPILOT_PX4,
                Flavour::ArduPilot => MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA,
            },
            mavtype = MavType::MAV_TYPE_QUADROTOR,
            system_status = MavState::MAV_STATE_STANDBY
        )
    }

    /// What it sends at a millisecond.
    fn says(&self, ms: u64) -> Vec<MavMessage> {
        let is_after = |at_ms: u64| at_ms > 0 && ms >= at_ms;
        let boot_ms = match is_after(self.restarts_ms) {
            true => (ms - self.restarts_ms) as u32,
            false => 20_000 + (ms as f64 * self.speedup) as u32 + 3_000 * u32::from(is_after(self.clock_jumps_ms)),
        };
        let mut out = Vec::new();
        if ms.is_multiple_of(1000) {
            out.push(self.heartbeat());
        }
        if ms.is_multiple_of(self.stream_ms) {
            if self.streams(32) && !self.no_position.contains(&ms) {
                let late_ms = 900 * u32::from(ms > 0 && ms == self.late_ms);
                out.push(message!(
                    LOCAL_POSITION_NED,
                    time_boot_ms = boot_ms - late_ms,
                    x = match self.no_numbers.contains(&ms) {
                        true => f32::NAN,
                        false => 4.0 * f32::from(u8::from(is_after(self.position_jumps_ms))),
                    }
                ));
            }
            if self.streams(30) && !self.no_attitude.contains(&ms) {
                out.push(message!(
                    ATTITUDE,
                    time_boot_ms = boot_ms,
                    yaw = self.yaw_rad + 60_f32.to_radians() * f32::from(u8::from(is_after(self.heading_jumps_ms)))
                ));
            }
        }
        if ms.is_multiple_of(200) {
            if self.streams(33) {
                out.push(message!(GLOBAL_POSITION_INT, hdg = 3000));
            }
            if self.streams(245) && !self.no_status.contains(&ms) {
                let landed_state = MavLandedState::MAV_LANDED_STATE_ON_GROUND;
                out.push(message!(EXTENDED_SYS_STATE, landed_state));
            }
        }
        if ms.is_multiple_of(500) {
            out.extend(self.health(ms, boot_ms));
        }
        if self.has_home && ms.is_multiple_of(1000) && self.streams(242) {
            let (latitude, longitude, altitude) = (473_977_420, 85_455_940, 488_000);
            out.push(message!(HOME_POSITION, latitude, longitude, altitude));
            // Without it nobody knows that home is where the estimator began.
            out.push(message!(GPS_GLOBAL_ORIGIN, latitude, longitude, altitude));
        }
        out
    }

    fn times_asked_for(&self, id: u32) -> usize {
        let is_of = |m: &&MavMessage| matches!(m, MavMessage::COMMAND_LONG(c) if c.param1 == id as f32);
        self.asked.iter().filter(is_of).count()
    }

    /// PX4 streams unprompted; an ArduPilot sends only what is asked for.
    fn streams(&self, id: u32) -> bool {
        self.flavour == Flavour::Px4 || self.times_asked_for(id) > 0
    }

    /// What it says of itself twice a second.
    fn health(&self, ms: u64, boot_ms: u32) -> Vec<MavMessage> {
        let mut out = Vec::new();
        let prearm = MavSysStatusSensor::from_bits_retain(0x1000_0000);
        let is_ready = !self.not_ready.contains(&ms);
        if self.streams(1) && !self.no_status.contains(&ms) {
            out.push(message!(
                SYS_STATUS,
                battery_remaining = self.battery_percent,
                onboard_control_sensors_present = prearm,
                onboard_control_sensors_enabled = prearm,
                onboard_control_sensors_health = match self.prearm && is_ready {
                    true => prearm,
                    false => MavSysStatusSensor::empty(),
                }
            ));
        }
        // ESTIMATOR_STATUS has the flags that ArduPilot puts into a message of its own.
        if (self.streams(230) || self.times_asked_for(193) > 0) && !self.no_status.contains(&ms) {
            let flags = if is_ready { self.estimator } else { 1 | 128 };
            let flags = EstimatorStatusFlags::from_bits_retain(flags);
            out.push(message!(ESTIMATOR_STATUS, flags));
        }
        if self.streams(2) {
            let unix_us = 1_700_000_000_000_000 + ms * 1000;
            out.push(message!(SYSTEM_TIME, time_unix_usec = unix_us, time_boot_ms = boot_ms));
        }
        let texts = self.texts.iter();
        out.extend(texts.map(|text| message!(STATUSTEXT, text = (*text).into())));
        out
    }

    fn answers(&mut self, message: &MavMessage) -> Option<MavMessage> {
        match message {
            MavMessage::PARAM_REQUEST_READ(m) => {
                let name = m.param_id.to_str().expect("a name").to_owned();
                let value = self.parameters.get(name.as_str())?;
                Some(message!(
                    PARAM_VALUE,
                    param_id = name.as_str().into(),
                    param_value = *value,
                    param_type =
                        match self.flavour == Flavour::Px4 && name.starts_with("COM_") && name != "COM_OF_LOSS_T" {
                            true => MavParamType::MAV_PARAM_TYPE_INT32,
                            false => MavParamType::MAV_PARAM_TYPE_REAL32,
                        }
                ))
            }
            MavMessage::TIMESYNC(m) => Some(message!(TIMESYNC, tc1 = 77, ts1 = m.ts1)),
            _ => {
                self.asked.push(message.clone());
                None
            }
        }
    }
}

/// A link within this machine.
fn local() -> ExaminationConfig {
    ExaminationConfig {
        is_local: true,
        ..Default::default()
    }
}

/// What is said of a vehicle after eight seconds on such a link.
fn examined(vehicle: &mut Scripted) -> Vec<Finding> {
    examined_by(vehicle, local(), &[])
}

fn examined_by(vehicle: &mut Scripted, config: ExaminationConfig, frames: &[&DepthFrame]) -> Vec<Finding> {
    let config = ExaminationConfig {
        unix_time_at_zero_us: 1_700_000_000_000_000,
        ..config
    };
    let mut examination = Examination::new(config, 0);
    let mut questions = Box::<Datagrams>::default();
    let mut counters = FramingCounters::default();
    for ms in 0..8000 {
        let now_ns = ms * MS;
        for message in vehicle.says(ms) {
            examination.receive(now_ns, &encode((1, 1), 0, &message));
        }
        for (from, every_ms, message) in &vehicle.extra {
            if ms.is_multiple_of(*every_ms) {
                examination.receive(now_ns, &encode(*from, 0, message));
            }
        }
        questions.clear();
        examination.ask(now_ns, &mut questions);
        for (_, datagram) in questions.iter() {
            for packet in packets(datagram, &mut counters) {
                assert_ne!(packet.component_id(), 191, "it does not pass for the guidance computer");
                let message = packet.message().expect("known");
                if let Some(answer) = vehicle.answers(&message) {
                    examination.receive(now_ns + MS / 2, &encode((1, 1), 0, &answer));
                }
            }
        }
    }
    frames.iter().for_each(|frame| examination.observe_frame(frame));
    examination.findings(8000 * MS)
}

/// The names of what fails and of what is warned of, sorted.
fn bad(findings: &[Finding]) -> [String; 2] {
    [Severity::Failure, Severity::Warning].map(|severity| {
        let graded = findings.iter().filter(|f| f.severity == severity);
        let mut names: Vec<&str> = graded.map(|f| f.name.as_str()).collect();
        names.sort();
        names.join(", ")
    })
}

fn named<'a>(findings: &'a [Finding], name: &str) -> &'a Finding {
    let found = findings.iter().find(|f| f.name == name);
    found.unwrap_or_else(|| panic!("{name} is not among {findings:#?}"))
}

fn value<'a>(findings: &'a [Finding], name: &str) -> &'a str {
    named(findings, name).value.as_deref().unwrap_or_default()
}

#[test]
fn nothing_is_missing_of_a_vehicle_that_is_well_whichever_autopilot_it_has() {
    for flavour in [Flavour::Px4, Flavour::ArduPilot] {
        let findings = examined(&mut Scripted::well(flavour));
        assert_eq!(bad(&findings), ["", ""], "{}: {findings:#?}", flavour.name());
        assert!(value(&findings, "HEARTBEAT").contains(flavour.name()));
        let with_mark = findings.iter().filter(|f| f.name.contains('_')).count();
        assert_eq!(with_mark, 8, "{findings:#?}");
    }
}

#[test]
fn a_link_on_which_nobody_speaks_is_the_one_finding() {
    let findings = Examination::new(ExaminationConfig::default(), 0).findings(8000 * MS);
    assert_eq!(bad(&findings), ["HEARTBEAT", ""]);
    assert!(findings[0].why.contains("port"), "{}", findings[0].line());
}

#[test]
fn everything_that_is_wrong_with_a_vehicle_is_named_with_its_value() {
    let mut vehicle = Scripted::well(Flavour::Px4);
    vehicle.stream_ms = 400;
    vehicle.has_home = false;
    vehicle.estimator = 1 | 128;
    vehicle.prearm = false;
    vehicle.battery_percent = 14;
    vehicle.texts = vec!["Preflight Fail: ekf2 \u{1b}missing \"é\""];
    // A yaw counted from east to the left.
    vehicle.yaw_rad = 60_f32.to_radians();
    vehicle.speedup = 0.5;
    vehicle.parameters = [
        ("COM_OF_LOSS_T", 60.0),
        ("COM_OBL_RC_ACT", f32::from_bits(-1_i32 as u32)),
        ("COM_RC_OVERRIDE", f32::from_bits(1)),
        ("MPC_XY_CRUISE", 5.4),
    ]
    .into();
    let findings = examined(&mut vehicle);
    assert_eq!(
        bad(&findings),
        [
            "ATTITUDE, COM_OBL_RC_ACT, COM_OF_LOSS_T, LOCAL_POSITION_NED, arming, battery, clock, estimator, heading",
            "COM_RCL_EXCEPT, COM_RC_OVERRIDE, HOME_POSITION, MPC_XY_CRUISE",
        ],
        "{findings:#?}"
    );
    let value = |name: &str| value(&findings, name);
    assert_eq!(value("LOCAL_POSITION_NED"), "2.5 Hz");
    assert_eq!(value("COM_OF_LOSS_T"), "60 s");
    assert_eq!(value("COM_OBL_RC_ACT"), "-1");
    assert_eq!(value("clock"), "0.500 of real time");
    assert_eq!(named(&findings, "battery").wanted, "at least 15 %");
    assert!(value("arming").contains("ekf2 \u{fffd}missing \"é\""));
    assert!(value("estimator").contains("horizontal position"));
    assert!(named(&findings, "heading").why.contains("east-north-up"));
}

/// PX4 1.18 on the ground, asked as it stands: what it lacks of earlier versions is no fault, what it ships with for a lost stream is one.
#[test]
fn a_px4_1_18_at_rest_passes_once_a_lost_stream_does_not_return_it() {
    let mut vehicle = Scripted::well(Flavour::Px4);
    // CONST_POS_MODE beside an absolute position.
    vehicle.estimator = 0x03ff;
    vehicle.parameters = [
        ("COM_OF_LOSS_T", 1.0),
        ("COM_OBL_RC_ACT", f32::from_bits(0)),
        ("MAN_OVERRIDE_SPD", 10.0),
        ("MPC_XY_CRUISE", 5.0),
    ]
    .into();
    let findings = examined(&mut vehicle);
    assert_eq!(bad(&findings), ["COM_OBL_RC_ACT", ""], "{findings:#?}");
    vehicle.parameters.insert("COM_OBL_RC_ACT", f32::from_bits(5));
    vehicle.asked.clear();
    let findings = examined(&mut vehicle);
    assert_eq!(bad(&findings), ["", ""], "{findings:#?}");
    // Without an absolute position it knows none.
    vehicle.estimator = 0x03ff & !16;
    assert!(bad(&examined(&mut vehicle))[0].contains("estimator"));
}

#[test]
fn an_ardupilot_whose_failsafes_are_off_reads_it_and_what_it_never_sends_too() {
    let mut vehicle = Scripted::well(Flavour::ArduPilot);
    vehicle.no_position = 0..9_000;
    vehicle.parameters = [
        ("GUID_TIMEOUT", 3.0),
        ("FS_EKF_ACTION", 0.0),
        ("ARMING_CHECK", 0.0),
        ("RC_OVERRIDE_TIME", -1.0),
        ("WPNAV_SPEED", 540.0),
    ]
    .into();
    let findings = examined(&mut vehicle);
    assert_eq!(
        bad(&findings),
        [
            "LOCAL_POSITION_NED, RC_OVERRIDE_TIME",
            "ARMING_CHECK, FS_EKF_ACTION, GUID_TIMEOUT, WPNAV_SPEED",
        ],
        "{findings:#?}"
    );
    assert!(vehicle.times_asked_for(32) > 1, "it was asked for");
}

#[test]
fn who_else_is_on_the_link_is_named() {
    let companion = message!(
        HEARTBEAT,
        mavtype = MavType::MAV_TYPE_ONBOARD_CONTROLLER,
        autopilot = MavAutopilot::MAV_AUTOPILOT_INVALID
    );
    let one = |every_ms| ((1, 191), every_ms, companion.clone());
    let mut vehicle = Scripted::well(Flavour::Px4);
    vehicle.extra = vec![one(1000)];
    assert_eq!(bad(&examined(&mut vehicle)), ["", ""], "one is as it should be");

    // Two under one name, and two under names of their own.
    vehicle.extra = vec![one(500)];
    assert_eq!(bad(&examined(&mut vehicle)), ["companions", ""]);
    vehicle.extra = vec![one(1000), ((1, 192), 1000, companion)];
    let findings = examined(&mut vehicle);
    assert_eq!(bad(&findings), ["companions", ""]);
    assert_eq!(value(&findings, "companions"), "1/191, 1/192");

    let setpoint = MavMessage::SET_POSITION_TARGET_LOCAL_NED(SET_POSITION_TARGET_LOCAL_NED_DATA::default());
    let sticks = MavMessage::RC_CHANNELS_OVERRIDE(RC_CHANNELS_OVERRIDE_DATA::default());
    vehicle.extra = vec![
        ((255, 190), 100, sticks),
        ((1, 192), 100, setpoint),
        ((2, 1), 1000, vehicle.heartbeat()),
    ];
    let findings = examined(&mut vehicle);
    assert_eq!(bad(&findings), ["setpoints, vehicles", "RC override"]);
    let line = named(&findings, "RC override").line();
    assert!(line.contains("255/190"), "{line}");
}

#[test]
fn a_vehicle_of_another_autopilot_and_a_link_without_signatures_are_named() {
    let config = ExaminationConfig {
        flavour: Some(Flavour::ArduPilot),
        ..Default::default()
    };
    let findings = examined_by(&mut Scripted::well(Flavour::Px4), config, &[]);
    assert_eq!(bad(&findings), ["HEARTBEAT", "signing"]);
}

/// A frame taken 1.5 m above level ground, by a sensor that is turned by so much beyond what the header states.
fn frame(roll_rad: f32, pitch_rad: f32) -> Box<DepthFrame> {
    let mut frame = Box::new(DepthFrame::EMPTY);
    let course = generate(Family::Validation, 3);
    let stated = Attitude::from_euler_rad(0.0, 0.0, 30_f32.to_radians());
    let turned = Attitude::from_euler_rad(roll_rad, pitch_rad, 30_f32.to_radians());
    let shot = Shot {
        estimated_position_ned_m: NedVector::ZERO,
        estimated_attitude: stated,
        ..Shot::at(NedVector::new(0.0, 0.0, -1.5), turned)
    };
    let mut lidar = Lidar::new(LidarConfig::default(), 3).expect("valid");
    lidar.capture(&World::new(&course), &shot, &mut frame);
    frame
}

#[test]
fn a_sensor_that_is_mounted_at_an_angle_is_seen_by_the_ground() {
    for (roll_deg, pitch_deg) in [(0.0, 0.0), (0.0, -6.0), (5.0, 0.0), (-4.0, 4.0_f32)] {
        let frame = frame(f32::to_radians(roll_deg), f32::to_radians(pitch_deg));
        let tilt = ground_tilt(&frame).expect("ground");
        // A nose that is lower is a negative pitch of the sensor.
        let found = (tilt.roll_rad.to_degrees(), -tilt.pitch_rad.to_degrees());
        assert!(
            (found.0 - roll_deg).abs() < 1.0 && (found.1 - pitch_deg).abs() < 1.0,
            "{roll_deg} {pitch_deg}: {found:?}"
        );
        assert!((tilt.height_m - 1.5).abs() < 0.1, "{}", tilt.height_m);
        let findings = examined_by(&mut Scripted::well(Flavour::Px4), local(), &[&frame]);
        let is_level = roll_deg == 0.0 && pitch_deg == 0.0;
        assert_eq!(bad(&findings), ["", if is_level { "" } else { "mount" }]);
        assert_eq!(named(&findings, "frame pose").severity, Severity::Good);
    }
}

/// Its last two seconds are as good as ever.
#[test]
fn what_was_wrong_only_in_the_middle_is_named_too() {
    let say = |change: fn(&mut Scripted)| {
        let mut vehicle = Scripted::well(Flavour::Px4);
        change(&mut vehicle);
        examined(&mut vehicle)
    };
    let findings = say(|v| v.no_position = 2_000..5_000);
    assert_eq!(bad(&findings), ["LOCAL_POSITION_NED", ""]);
    assert!(value(&findings, "LOCAL_POSITION_NED").contains("25.0 Hz, but away 1 times, 3.0 s in all"));
    let findings = say(|v| v.no_attitude = 3_000..3_500);
    assert_eq!(bad(&findings), ["", "ATTITUDE"]);

    let findings = say(|v| v.no_position = 4_000..9_000);
    assert_eq!(bad(&findings), ["LOCAL_POSITION_NED", ""]);
    assert_eq!(value(&findings, "LOCAL_POSITION_NED"), "it came, and stopped 4.0 s ago");
    assert!(!named(&findings, "LOCAL_POSITION_NED").why.contains("never came"));
    let findings = say(|v| v.no_position = 7_300..9_000);
    assert!(value(&findings, "LOCAL_POSITION_NED").contains("away 1 times, 0.7 s in all"));

    let findings = say(|v| v.no_numbers = 3_000..4_000);
    assert_eq!(bad(&findings), ["values", ""]);
    assert!(value(&findings, "values").starts_with("25 times"));
    let findings = say(|v| v.not_ready = 3_000..5_000);
    assert_eq!(bad(&findings), ["", "arming, estimator"]);
    assert!(value(&findings, "estimator").contains("lacked horizontal position, height, velocity"));
    let findings = say(|v| v.no_status = 3_100..9_000);
    assert_eq!(bad(&findings), ["", "ESTIMATOR_STATUS, EXTENDED_SYS_STATE, SYS_STATUS"]);
    assert!(value(&findings, "SYS_STATUS").contains("came, and stopped 5.0 s ago"));

    let findings = say(|v| v.restarts_ms = 5_000);
    assert_eq!(bad(&findings), ["restart", ""]);
    assert!(value(&findings, "restart").contains("3.0 s ago"));
    assert!(value(&findings, "clock").contains("since its restart"));

    let findings = say(|v| v.late_ms = 4_000);
    assert_eq!(bad(&findings), ["", ""], "a packet out of order is no restart");

    let findings = say(|v| v.clock_jumps_ms = 4_000);
    assert!(bad(&findings)[0].contains("clock jumps"), "{findings:#?}");
    assert!(value(&findings, "clock jumps").contains("3.0 s"));
    let findings = say(|v| v.position_jumps_ms = 4_000);
    assert_eq!(bad(&findings), ["position jumps", ""]);
    assert!(value(&findings, "position jumps").starts_with("1, by 4.0 m"));
    let findings = say(|v| v.heading_jumps_ms = 4_000);
    assert!(bad(&findings)[0].contains("heading jumps"), "{findings:#?}");
}

#[test]
fn our_own_simulated_vehicle_is_fit_to_fly_and_so_is_its_sensor() {
    for start in [Start::Ground, Start::Airborne] {
        let mut config = SimConfig::new(generate(Family::Validation, 7), 7);
        config.start = start;
        let mut simulator = Simulator::new(&config, 0).expect("valid");
        let mut examination = Examination::new(local(), 0);
        let mut frame = Box::new(DepthFrame::EMPTY);
        let (mut questions, mut telemetry) = (Box::<Datagrams>::default(), Box::<Datagrams>::default());
        for _ in 0..160 {
            simulator.lockstep(&questions, &mut frame, &mut telemetry);
            for (_, datagram) in telemetry.iter() {
                examination.receive(simulator.now_ns(), datagram);
            }
            examination.observe_frame(&frame);
            questions.clear();
            examination.ask(simulator.now_ns(), &mut questions);
        }
        let findings = examination.findings(simulator.now_ns());
        assert_eq!(bad(&findings)[0], "", "{start:?}: {findings:#?}");
        for name in [
            "LOCAL_POSITION_NED",
            "ATTITUDE",
            "COM_OF_LOSS_T",
            "COM_OBL_RC_ACT",
            "frame pose",
        ] {
            assert_eq!(named(&findings, name).severity, Severity::Good, "{findings:#?}");
        }
    }
}
