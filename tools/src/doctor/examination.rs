//! Asks a vehicle, watches what it sends, and judges.

use super::finding::{Finding, Severity};
use super::ground::ground_tilt;
use super::parameters::{self, Row, STICKS_BY_SPEED, Versions};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use vigil_mavlink::common::{
    ATTITUDE_DATA, ATTITUDE_QUATERNION_DATA, ESTIMATOR_STATUS_DATA, EXTENDED_SYS_STATE_DATA, GLOBAL_POSITION_INT_DATA,
    GPS_GLOBAL_ORIGIN_DATA, HEARTBEAT_DATA, HOME_POSITION_DATA, LOCAL_POSITION_NED_DATA, MavAutopilot, MavModeFlag,
    MavParamType, MavState, MavType, PARAM_REQUEST_READ_DATA, SYS_STATUS_DATA, SYSTEM_TIME_DATA, TIMESYNC_DATA,
};
use vigil_mavlink::framing::{Command, FramingCounters, MAX_PACKET_LEN, Packet, packets, serialize};
use vigil_mavlink::mavlink::MessageData;
use vigil_mavlink::{Flavour, MavHeader, MavMessage, Vehicle};
use vigil_types::{Attitude, Datagrams, DepthFrame, Landed, Nanos, NedVector, wrap_pi};

const AUTOPILOT: u8 = 1;
/// MAV_COMP_ID_PERIPHERAL: who asks.
const COMPONENT: u8 = 158;
/// MAV_COMP_ID_ONBOARD_COMPUTER, under which Vigil's firmware speaks.
const ONBOARD_COMPUTER: u8 = 191;
const ONBOARD_CONTROLLER: u8 = 18;
/// MAV_TYPEs of multicopters.
const MULTICOPTERS: [u8; 6] = [2, 13, 14, 15, 29, 35];

const SET_MESSAGE_INTERVAL: u16 = 511;
const REQUEST_MESSAGE: u16 = 512;
/// ArduPilot's EKF_STATUS_REPORT, of its own dialect; its flags are those of ESTIMATOR_STATUS and lie behind five floats.
const EKF_STATUS_REPORT: u32 = 193;
const EKF_FLAGS_AT: usize = 20;

const SECOND_NS: Nanos = 1_000_000_000;
/// Pause between two questions, so that they never come as a burst on a slow line.
const PAUSE_NS: Nanos = 50_000_000;
/// A parameter is asked for so often, this far apart.
const ATTEMPTS: u8 = 3;
const RETRY_NS: Nanos = 600_000_000;
/// Arrivals that a rate is told by.
const WINDOW_NS: Nanos = 2 * SECOND_NS;

/// Rates of position and attitude: below the first the vehicle holds again and again, below the second it flies with little margin.
const LEAST_HZ: f64 = 4.0;
const GOOD_HZ: f64 = 10.0;
/// Two headings, and two heights, that differ by more than this are not of one frame.
const HEADING_RAD: f32 = 0.35;
const HEIGHT_M: f32 = 3.0;
/// The sensor's mounting is off by more than this: radians.
const TILT_RAD: f32 = 0.05;
/// The vehicle's clock may run this much faster or slower than ours.
const CLOCK_RATIO: f64 = 0.03;
/// Answers to TIMESYNC: seconds there and back.
const SLOW_S: f64 = 0.1;
const TOO_SLOW_S: f64 = 0.3;
/// The vehicle's wall clock and ours may differ by this, seconds: signing refuses more than a minute.
const WALL_S: f64 = 10.0;
/// A position that is farther from where velocity and time led than this has jumped, metres, and so much more for each second between.
const JUMP_M: f32 = 1.0;
const JUMP_M_S: f32 = 10.0;
/// A heading has jumped that changed by more than this between two attitudes beside what its rate explains, radians.
const JUMP_RAD: f32 = 0.35;
/// The vehicle's clock has jumped if it went on by so much more than ours.
const CLOCK_JUMP_NS: Nanos = SECOND_NS / 2;
/// Battery below which guidance does not begin, by default.
const LOW_BATTERY: f32 = 0.2;

/// ESTIMATOR_STATUS_FLAGS.
const EKF_ATTITUDE: u16 = 1;
const EKF_VELOCITY: u16 = 2 | 4;
const EKF_POSITION: u16 = 8 | 16;
const EKF_ABSOLUTE_POSITION: u16 = 16;
const EKF_HEIGHT: u16 = 32 | 64;
const EKF_CONSTANT_POSITION: u16 = 128;
const EKF_BAD: u16 = 1024 | 2048;

/// MAV_SYS_STATUS_PREARM_CHECK.
const PREARM: u32 = 0x1000_0000;

/// What is known before.
#[derive(Debug, Clone, Default)]
pub struct ExaminationConfig {
    /// What the vehicle must be; `None` takes what it says.
    pub flavour: Option<Flavour>,
    /// Its system; the first autopilot that is heard, if none.
    pub system: Option<u8>,
    /// The link cannot leave this machine: no signature is needed.
    pub is_local: bool,
    /// There is a signing key, which what arrives was verified with.
    pub has_key: bool,
    /// Unix time at the clock's zero, microseconds.
    pub unix_time_at_zero_us: u64,
}

/// When a message came.
#[derive(Debug, Clone, Default)]
struct Arrivals {
    recent: VecDeque<Nanos>,
    last_ns: Option<Nanos>,
    /// It came in time once: from then on what is longer is a gap.
    is_steady: bool,
    gaps: Gaps,
}

/// Times in which a stream that came did not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Gaps {
    count: u32,
    longest_ns: Nanos,
    sum_ns: Nanos,
}

impl Gaps {
    fn note(&mut self, lasted_ns: Nanos) {
        self.count += 1;
        self.sum_ns += lasted_ns;
        self.longest_ns = self.longest_ns.max(lasted_ns);
    }
}

impl Arrivals {
    /// An arrival of a message that is late after `late_ns`.
    fn note(&mut self, now_ns: Nanos, late_ns: Nanos) {
        if let Some(last_ns) = self.last_ns.replace(now_ns) {
            let since_ns = now_ns.saturating_sub(last_ns);
            if since_ns <= late_ns {
                self.is_steady = true;
            } else if self.is_steady {
                self.gaps.note(since_ns);
            }
        }
        self.recent.push_back(now_ns);
        while self.recent.front().is_some_and(|at| now_ns - at > WINDOW_NS) {
            self.recent.pop_front();
        }
    }

    /// Mean rate of the last two seconds up to now; `None` when nothing came in them.
    fn rate_hz(&self, now_ns: Nanos) -> Option<f64> {
        let since = now_ns.saturating_sub(WINDOW_NS);
        let count = self.recent.iter().filter(|at| **at >= since).count();
        (count > 0).then(|| count as f64 / (WINDOW_NS as f64 * 1e-9))
    }

    /// Its gaps, that up to now included.
    fn gaps(&self, now_ns: Nanos, late_ns: Nanos) -> Gaps {
        let mut gaps = self.gaps;
        let since_ns = self.last_ns.map_or(0, |last_ns| now_ns.saturating_sub(last_ns));
        if self.is_steady && since_ns > late_ns {
            gaps.note(since_ns);
        }
        gaps
    }
}

/// After how long a message is late: the heartbeat comes once a second, and guidance holds by what else is older than 0.3 s.
fn late_ns(message_id: u32) -> Nanos {
    match message_id {
        HEARTBEAT_DATA::ID => 5 * SECOND_NS / 2,
        _ => 3 * SECOND_NS / 10,
    }
}

/// Seconds for people.
fn s(ns: Nanos) -> String {
    format!("{:.1} s", ns as f64 * 1e-9)
}

#[derive(Debug, Clone, Copy, Default)]
struct Asked {
    attempts: u8,
    at_ns: Nanos,
    value: Option<f32>,
}

/// One examination.
pub struct Examination {
    config: ExaminationConfig,
    started_ns: Nanos,
    counters: FramingCounters,
    vehicle: Vehicle,
    system: Option<u8>,
    other_systems: BTreeSet<u8>,
    vehicle_type: Option<u8>,
    is_signed: bool,
    arrivals: BTreeMap<u32, Arrivals>,
    /// Boot time of the vehicle and arrival: first and last.
    boot: Option<((u32, Nanos), (u32, Nanos))>,
    /// The last position and attitude.
    position: Option<(u32, NedVector, NedVector)>,
    heading: Option<(u32, f32)>,
    /// When the vehicle started anew, when its clock jumped, and how far position and heading did at the most, with how often.
    restarted_ns: Option<Nanos>,
    clock_jumps_s: Option<f64>,
    position_jumps: (u32, f32),
    heading_jumps: (u32, f32),
    was_in_failsafe: bool,
    round_trips_s: Vec<f64>,
    unix_time_us: Option<(u64, Nanos)>,
    estimator: Option<u16>,
    /// SYS_STATUS: present, enabled, healthy.
    sensors: Option<(u32, u32, u32)>,
    prearm_texts: BTreeSet<String>,
    /// GLOBAL_POSITION_INT: metres above home, and heading in radians where it is told.
    global: Option<(f32, Option<f32>)>,
    /// Other guidance computers, by system and component: arrivals of heartbeats.
    companions: BTreeMap<(u8, u8), Arrivals>,
    setpoints_of: BTreeSet<(u8, u8)>,
    sticks_of: BTreeSet<(u8, u8)>,
    parameters: BTreeMap<&'static str, Asked>,
    frame: Option<(Attitude, NedVector, Nanos)>,
    tilts: Vec<(f32, f32)>,
    next_question_ns: Nanos,
    turn: u64,
    sequence: u8,
}

impl Examination {
    /// One that has heard nothing.
    pub fn new(config: ExaminationConfig, now_ns: Nanos) -> Self {
        Self {
            system: config.system,
            vehicle: Vehicle::new(None),
            config,
            started_ns: now_ns,
            counters: FramingCounters::default(),
            other_systems: BTreeSet::new(),
            vehicle_type: None,
            is_signed: false,
            arrivals: BTreeMap::new(),
            boot: None,
            position: None,
            heading: None,
            restarted_ns: None,
            clock_jumps_s: None,
            position_jumps: (0, 0.0),
            heading_jumps: (0, 0.0),
            was_in_failsafe: false,
            round_trips_s: Vec::new(),
            unix_time_us: None,
            estimator: None,
            sensors: None,
            prearm_texts: BTreeSet::new(),
            global: None,
            companions: BTreeMap::new(),
            setpoints_of: BTreeSet::new(),
            sticks_of: BTreeSet::new(),
            parameters: BTreeMap::new(),
            frame: None,
            tilts: Vec::new(),
            next_question_ns: now_ns,
            turn: 0,
            sequence: 0,
        }
    }

    /// Takes a datagram that arrived at `now_ns`.
    pub fn receive(&mut self, now_ns: Nanos, datagram: &[u8]) {
        let mut counters = self.counters;
        for packet in packets(datagram, &mut counters) {
            self.packet(now_ns, &packet);
        }
        self.counters = counters;
    }

    fn packet(&mut self, now_ns: Nanos, packet: &Packet<'_>) {
        if packet.is_of_autopilot(&mut self.system) {
            self.of_vehicle(now_ns, packet);
            return;
        }
        let from = (packet.system_id(), packet.component_id());
        if packet.is_autopilots_heartbeat() {
            self.other_systems.insert(from.0);
        }
        match packet.message_id() {
            HEARTBEAT_DATA::ID => {
                let is_onboard = packet.payload().get(4) == Some(&ONBOARD_CONTROLLER);
                if (is_onboard || from.1 == ONBOARD_COMPUTER) && from.1 != COMPONENT {
                    let arrivals = self.companions.entry(from).or_default();
                    arrivals.note(now_ns, late_ns(HEARTBEAT_DATA::ID));
                }
            }
            // MANUAL_CONTROL, RC_CHANNELS_OVERRIDE.
            69 | 70 => {
                self.sticks_of.insert(from);
            }
            // SET_ATTITUDE_TARGET, SET_POSITION_TARGET_LOCAL_NED and _GLOBAL_INT.
            82 | 84 | 86 => {
                self.setpoints_of.insert(from);
            }
            _ => {}
        }
    }

    fn of_vehicle(&mut self, now_ns: Nanos, packet: &Packet<'_>) {
        self.is_signed |= packet.is_signed();
        let arrivals = self.arrivals.entry(packet.message_id()).or_default();
        arrivals.note(now_ns, late_ns(packet.message_id()));
        self.vehicle.receive(now_ns, packet);
        match packet.message_id() {
            HEARTBEAT_DATA::ID => self.vehicle_type = packet.payload().get(4).copied(),
            EKF_STATUS_REPORT => {
                let byte = |at: usize| packet.payload().get(at).copied().unwrap_or(0);
                self.estimator = Some(u16::from_le_bytes([byte(EKF_FLAGS_AT), byte(EKF_FLAGS_AT + 1)]));
            }
            _ => {}
        }
        let Ok(message) = packet.message() else { return };
        match message {
            MavMessage::LOCAL_POSITION_NED(m) => {
                self.note_clock(m.time_boot_ms, now_ns);
                let position = NedVector::new(m.x, m.y, m.z);
                let velocity = NedVector::new(m.vx, m.vy, m.vz);
                self.note_position(m.time_boot_ms, position, velocity);
            }
            MavMessage::ATTITUDE(m) => {
                if let Some((last_ms, yaw_rad)) = self.heading.replace((m.time_boot_ms, m.yaw))
                    && let Some(since_ms) = m.time_boot_ms.checked_sub(last_ms)
                {
                    let led_to_rad = yaw_rad + m.yawspeed * since_ms as f32 * 1e-3;
                    let off_rad = wrap_pi(m.yaw - led_to_rad).abs();
                    if since_ms < 1000 && off_rad > JUMP_RAD {
                        self.heading_jumps = (self.heading_jumps.0 + 1, self.heading_jumps.1.max(off_rad));
                    }
                }
            }
            MavMessage::HEARTBEAT(_) => {
                self.was_in_failsafe |= self.vehicle.telemetry.heartbeat.is_some_and(|h| h.failsafe);
            }
            MavMessage::ESTIMATOR_STATUS(m) => self.estimator = Some(m.flags.bits()),
            MavMessage::SYS_STATUS(m) => {
                self.sensors = Some((
                    m.onboard_control_sensors_present.bits(),
                    m.onboard_control_sensors_enabled.bits(),
                    m.onboard_control_sensors_health.bits(),
                ));
            }
            MavMessage::GLOBAL_POSITION_INT(m) => {
                // UINT16_MAX: not known.
                let heading = (m.hdg != u16::MAX).then(|| (f32::from(m.hdg) * 0.01).to_radians());
                self.global = Some((m.relative_alt as f32 * 1e-3, heading));
            }
            MavMessage::SYSTEM_TIME(m) => self.unix_time_us = Some((m.time_unix_usec, now_ns)),
            MavMessage::TIMESYNC(m) if m.tc1 != 0 => {
                // The answer has our time of asking.
                if let Ok(asked_ns) = u64::try_from(m.ts1)
                    && (self.started_ns..=now_ns).contains(&asked_ns)
                {
                    self.round_trips_s.push((now_ns - asked_ns) as f64 * 1e-9);
                }
            }
            MavMessage::STATUSTEXT(m) => {
                let text = m.text.to_str().unwrap_or_default();
                if ["PreArm", "Arm:", "Preflight Fail"]
                    .iter()
                    .any(|start| text.starts_with(start))
                {
                    self.prearm_texts.insert(text.to_owned());
                }
            }
            MavMessage::PARAM_VALUE(m) => {
                let name = m.param_id.to_str().unwrap_or_default();
                if let Some(row) = parameters::of(self.vehicle.flavour()).find(|row| row.name == name) {
                    // A PX4 puts an integer's bits where the float is.
                    let is_bits =
                        self.vehicle.flavour() == Flavour::Px4 && m.param_type == MavParamType::MAV_PARAM_TYPE_INT32;
                    let value = match is_bits {
                        true => m.param_value.to_bits() as i32 as f32,
                        false => m.param_value,
                    };
                    self.parameters.entry(row.name).or_default().value = Some(value);
                }
            }
            _ => {}
        }
    }

    /// A vehicle that starts anew while it is looked at has another zero; one whose clock jumps has not.
    fn note_clock(&mut self, boot_ms: u32, now_ns: Nanos) {
        let now = (boot_ms, now_ns);
        let Some((first, last)) = self.boot else {
            self.boot = Some((now, now));
            return;
        };
        let Some(since_ms) = boot_ms.checked_sub(last.0) else {
            self.restarted_ns = Some(now_ns);
            self.position = None;
            self.heading = None;
            self.boot = Some((now, now));
            return;
        };
        let ahead_ns = (u64::from(since_ms) * 1_000_000).saturating_sub(now_ns - last.1);
        if ahead_ns > CLOCK_JUMP_NS {
            let ahead_s = ahead_ns as f64 * 1e-9;
            self.clock_jumps_s = Some(self.clock_jumps_s.map_or(ahead_s, |s| s.max(ahead_s)));
        }
        self.boot = Some((first, now));
    }

    fn note_position(&mut self, boot_ms: u32, position_m: NedVector, velocity_m_s: NedVector) {
        let Some((last_ms, last_m, last_m_s)) = self.position.replace((boot_ms, position_m, velocity_m_s)) else {
            return;
        };
        let since_s = boot_ms.saturating_sub(last_ms) as f32 * 1e-3;
        let off_m = (position_m - (last_m + last_m_s * since_s)).norm();
        if off_m > JUMP_M + JUMP_M_S * since_s {
            self.position_jumps = (self.position_jumps.0 + 1, self.position_jumps.1.max(off_m));
        }
    }

    /// Takes a depth frame that was checked.
    pub fn observe_frame(&mut self, frame: &DepthFrame) {
        let header = &frame.header;
        self.frame = Some((header.attitude, header.position_ned_m, header.stamp_ns));
        if let Some(tilt) = ground_tilt(frame) {
            self.tilts.push((tilt.pitch_rad, tilt.roll_rad));
        }
    }

    /// Adds the questions that are due to `out`. Call it often.
    pub fn ask(&mut self, now_ns: Nanos, out: &mut Datagrams) {
        if now_ns < self.next_question_ns {
            return;
        }
        self.next_question_ns = now_ns + PAUSE_NS;
        self.turn += 1;
        // Some vehicles answer on a link only to whom they have heard.
        if self.turn % 20 == 1 {
            self.say_heartbeat(out);
        }
        let Some(system) = self.system.filter(|_| self.vehicle.telemetry.heartbeat.is_some()) else {
            return;
        };
        if self.turn.is_multiple_of(4) {
            let message = MavMessage::TIMESYNC(TIMESYNC_DATA {
                tc1: 0,
                ts1: now_ns as i64,
                ..TIMESYNC_DATA::DEFAULT
            });
            self.say(&message, out);
        } else if self.turn % 4 == 2 {
            self.ask_for_messages(now_ns, system, out);
        } else {
            self.ask_for_parameters(now_ns, system, out);
        }
    }

    fn ask_for_messages(&mut self, now_ns: Nanos, system: u8, out: &mut Datagrams) {
        // As the firmware asks: what comes too rarely, and no more.
        let estimator = match self.vehicle.flavour() {
            Flavour::Px4 => ESTIMATOR_STATUS_DATA::ID,
            Flavour::ArduPilot => EKF_STATUS_REPORT,
        };
        let streams = [
            (
                LOCAL_POSITION_NED_DATA::ID,
                LOCAL_POSITION_NED_DATA::ID,
                33_333.0,
                GOOD_HZ,
            ),
            (ATTITUDE_DATA::ID, ATTITUDE_QUATERNION_DATA::ID, 20_000.0, GOOD_HZ),
            (
                GLOBAL_POSITION_INT_DATA::ID,
                GLOBAL_POSITION_INT_DATA::ID,
                200_000.0,
                1.0,
            ),
            (EXTENDED_SYS_STATE_DATA::ID, EXTENDED_SYS_STATE_DATA::ID, 200_000.0, 1.0),
            (SYS_STATUS_DATA::ID, SYS_STATUS_DATA::ID, 500_000.0, 0.5),
            (estimator, estimator, 500_000.0, 0.5),
            (SYSTEM_TIME_DATA::ID, SYSTEM_TIME_DATA::ID, 1_000_000.0, 0.5),
        ];
        let once = [HOME_POSITION_DATA::ID, GPS_GLOBAL_ORIGIN_DATA::ID];
        let place = (self.turn / 4) as usize % (streams.len() + once.len());
        match (streams.get(place), once.get(place.wrapping_sub(streams.len()))) {
            (Some((id, or, interval_us, least_hz)), _) => {
                let rate_hz = |id| self.arrivals.get(id).and_then(|a| a.rate_hz(now_ns)).unwrap_or(0.0);
                if rate_hz(id).max(rate_hz(or)) < *least_hz {
                    let params = [*id as f32, *interval_us, 0.0, 0.0, 0.0, 0.0, 0.0];
                    self.command(system, SET_MESSAGE_INTERVAL, params, out);
                }
            }
            (None, Some(id)) if !self.arrivals.contains_key(id) => {
                let params = [*id as f32, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
                self.command(system, REQUEST_MESSAGE, params, out);
            }
            _ => {}
        }
    }

    fn ask_for_parameters(&mut self, now_ns: Nanos, system: u8, out: &mut Datagrams) {
        let due = parameters::of(self.vehicle.flavour()).find(|row| {
            let asked = self.parameters.get(row.name).copied().unwrap_or_default();
            asked.value.is_none()
                && asked.attempts < ATTEMPTS
                && (asked.attempts == 0 || now_ns - asked.at_ns >= RETRY_NS)
        });
        let Some(row) = due else { return };
        let asked = self.parameters.entry(row.name).or_default();
        asked.attempts += 1;
        asked.at_ns = now_ns;
        let message = MavMessage::PARAM_REQUEST_READ(PARAM_REQUEST_READ_DATA {
            param_index: -1,
            target_system: system,
            target_component: AUTOPILOT,
            param_id: row.name.into(),
        });
        self.say(&message, out);
    }

    fn header(&mut self) -> MavHeader {
        self.sequence = self.sequence.wrapping_add(1);
        MavHeader {
            system_id: self.system.unwrap_or(1).into(),
            component_id: COMPONENT,
            sequence: self.sequence,
        }
    }

    fn say(&mut self, message: &MavMessage, out: &mut Datagrams) {
        let mut packet = [0; MAX_PACKET_LEN];
        if let Ok(len) = serialize(self.header(), message, &mut packet) {
            out.push(0, &packet[..len]);
        }
    }

    fn command(&mut self, system: u8, number: u16, params: [f32; 7], out: &mut Datagrams) {
        let mut packet = [0; MAX_PACKET_LEN];
        if let Ok(len) = Command::to_autopilot(system, number, params, 0).serialize(self.header(), &mut packet) {
            out.push(0, &packet[..len]);
        }
    }

    fn say_heartbeat(&mut self, out: &mut Datagrams) {
        let message = MavMessage::HEARTBEAT(HEARTBEAT_DATA {
            custom_mode: 0,
            mavtype: MavType::MAV_TYPE_GENERIC,
            autopilot: MavAutopilot::MAV_AUTOPILOT_INVALID,
            base_mode: MavModeFlag::empty(),
            system_status: MavState::MAV_STATE_ACTIVE,
            mavlink_version: 3,
        });
        self.say(&message, out);
    }

    /// What was found up to `now_ns`.
    pub fn findings(&self, now_ns: Nanos) -> Vec<Finding> {
        let mut report = Report(Vec::new());
        if !self.heartbeat(now_ns, &mut report) {
            return report.0;
        }
        self.company(now_ns, &mut report);
        self.streams(now_ns, &mut report);
        self.changes(now_ns, &mut report);
        self.time(&mut report);
        self.estimator(&mut report);
        self.coordinates(&mut report);
        self.signing(&mut report);
        self.read_parameters(&mut report);
        self.mounting(&mut report);
        report.0
    }

    fn heartbeat(&self, now_ns: Nanos, report: &mut Report) -> bool {
        let Some(heartbeat) = self.vehicle.telemetry.heartbeat else {
            let others: Vec<String> = self.other_systems.iter().map(u8::to_string).collect();
            let value = (!others.is_empty()).then(|| format!("other vehicles: system {}", others.join(", ")));
            report.add(
                "HEARTBEAT",
                Severity::Failure,
                value,
                "the heartbeat of an autopilot (component 1), once a second",
                "nobody is heard: is the link's address that to which the vehicle sends, is its port in use by another program, does it \
                 pass a firewall, does the vehicle sign?",
            );
            return false;
        };
        let rate_hz = self.arrivals.get(&HEARTBEAT_DATA::ID).and_then(|a| a.rate_hz(now_ns));
        let name = match self.vehicle.named {
            Some(flavour) => flavour.name().to_owned(),
            None => format!("MAV_AUTOPILOT {}", self.vehicle.mav_autopilot),
        };
        let told = format!("system {}, {name}", self.system.unwrap_or_default());
        match (self.config.flavour, self.vehicle.named) {
            _ if rate_hz.is_some() && self.gaps(&[HEARTBEAT_DATA::ID], now_ns).count > 0 => {
                let gaps = self.gaps(&[HEARTBEAT_DATA::ID], now_ns);
                report.add(
                    "HEARTBEAT",
                    Severity::Failure,
                    Some(format!("{told}, away for {} at the longest", s(gaps.longest_ns))),
                    "once a second",
                    "without it guidance holds: link lost",
                );
            }
            _ if rate_hz.is_none() => report.add(
                "HEARTBEAT",
                Severity::Failure,
                Some(format!("{told}, and then silence")),
                "once a second",
                "without it guidance holds: link lost",
            ),
            (Some(wanted), Some(named)) if wanted != named => report.add(
                "HEARTBEAT",
                Severity::Failure,
                Some(told),
                wanted.name(),
                "the vehicle is not flown: name what it is with --vehicle, or leave that out",
            ),
            (None, None) => report.add(
                "HEARTBEAT",
                Severity::Warning,
                Some(told),
                "PX4 (12) or ArduPilot (3)",
                "an autopilot that is not known is flown as PX4",
            ),
            _ => report.good("HEARTBEAT", told),
        }
        if let Some(kind) = self.vehicle_type.filter(|kind| !MULTICOPTERS.contains(kind)) {
            report.add(
                "MAV_TYPE",
                Severity::Failure,
                Some(kind.to_string()),
                "a multicopter (2, 13, 14, 15, 29, 35)",
                "setpoints of velocity that may be zero are for what can hover",
            );
        }
        if heartbeat.failsafe {
            report.add(
                "failsafe",
                Severity::Failure,
                Some("the vehicle reports CRITICAL or EMERGENCY".to_owned()),
                "none",
                "guidance holds while it lasts; the vehicle's texts say what it is",
            );
        } else if self.was_in_failsafe {
            report.add(
                "failsafe",
                Severity::Warning,
                Some("the vehicle reported CRITICAL or EMERGENCY for a while".to_owned()),
                "none",
                "guidance holds while one lasts; the vehicle's texts say what it was",
            );
        }
        if let Some(battery) = self.vehicle.telemetry.battery_remaining {
            let value = format!("{:.0} %", 100.0 * battery);
            match battery < LOW_BATTERY {
                true => report.add(
                    "battery",
                    Severity::Failure,
                    Some(value),
                    "at least 20 %",
                    "guidance does not begin below",
                ),
                false => report.good("battery", value),
            }
        }
        true
    }

    /// Who else is there.
    fn company(&self, now_ns: Nanos, report: &mut Report) {
        if self.config.system.is_none() && !self.other_systems.is_empty() {
            let ids: Vec<String> = self.other_systems.iter().map(u8::to_string).collect();
            report.add(
                "vehicles",
                Severity::Failure,
                Some(format!(
                    "system {} and {}",
                    self.system.unwrap_or_default(),
                    ids.join(", ")
                )),
                "one, or one that is named",
                "whose telemetry is flown by would be chance: add system=ID to the link",
            );
        }
        let ids = |of: &BTreeSet<(u8, u8)>| of.iter().map(id).collect::<Vec<_>>().join(", ");
        let doubled = self
            .companions
            .values()
            .any(|a| a.rate_hz(now_ns).is_some_and(|hz| hz > 1.6));
        let names: Vec<String> = self.companions.keys().map(id).collect();
        if doubled || names.len() > 1 {
            let each = if doubled { " (with the heartbeats of two)" } else { "" };
            report.add(
                "companions",
                Severity::Failure,
                Some(format!("{}{each}", names.join(", "))),
                "one",
                "two guidance computers give setpoints in turn, and the vehicle obeys both: stop one of them",
            );
        } else if let Some(name) = names.first() {
            report.good("companions", format!("one, {name}"));
        }
        if !self.setpoints_of.is_empty() {
            report.add(
                "setpoints",
                Severity::Failure,
                Some(format!("sent by {}", ids(&self.setpoints_of))),
                "none before the flight",
                "somebody already steers the vehicle: stop that program",
            );
        }
        if !self.sticks_of.is_empty() {
            report.add(
                "RC override",
                Severity::Warning,
                Some(format!(
                    "MANUAL_CONTROL or RC_CHANNELS_OVERRIDE by {}",
                    ids(&self.sticks_of)
                )),
                "none, or a pilot who means it",
                "sticks by MAVLink may take the vehicle out of OFFBOARD or GUIDED: switch the ground station's joystick off",
            );
        }
    }

    fn streams(&self, now_ns: Nanos, report: &mut Report) {
        let rate = |ids: &[u32]| {
            ids.iter()
                .filter_map(|id| self.arrivals.get(id)?.rate_hz(now_ns))
                .reduce(f64::max)
        };
        for (name, ids) in [
            ("LOCAL_POSITION_NED", &[LOCAL_POSITION_NED_DATA::ID][..]),
            ("ATTITUDE", &[ATTITUDE_DATA::ID, ATTITUDE_QUATERNION_DATA::ID]),
        ] {
            let hz = rate(ids);
            let gaps = self.gaps(ids, now_ns);
            let last_ns = ids.iter().filter_map(|id| self.arrivals.get(id)?.last_ns).max();
            let severity = match hz {
                Some(_) if gaps.longest_ns > SECOND_NS => Severity::Failure,
                Some(hz) if hz >= GOOD_HZ && gaps.count == 0 => Severity::Good,
                Some(hz) if hz >= LEAST_HZ => Severity::Warning,
                _ => Severity::Failure,
            };
            let value = match (hz, last_ns) {
                (Some(hz), _) if gaps.count > 0 => Some(format!(
                    "{hz:.1} Hz, but away {} times, {} in all, {} at the longest",
                    gaps.count,
                    s(gaps.sum_ns),
                    s(gaps.longest_ns)
                )),
                (Some(hz), _) => Some(format!("{hz:.1} Hz")),
                (None, Some(last_ns)) => Some(format!(
                    "it came, and stopped {} ago",
                    s(now_ns.saturating_sub(last_ns))
                )),
                (None, None) => None,
            };
            let why = match (hz, last_ns) {
                (Some(_), _) if gaps.count > 0 => {
                    "guidance holds by what is older than 0.3 s: the link fails, the line is full, or the vehicle's estimator stops"
                }
                (None, Some(_)) => {
                    "guidance holds: did the estimator lose its position (GPS), did somebody switch the stream off, did the link fail?"
                }
                (None, None) => {
                    "it never came, though it was asked for: does the estimator have a position (GPS, or another source), and may \
                         this link ask (SET_MESSAGE_INTERVAL)?"
                }
                (Some(_), _) => {
                    "guidance holds by what is older than 0.3 s: somebody slows the stream down, or the line is full"
                }
            };
            report.judge(name, severity, value, "10 Hz or more, without a gap", why);
        }
        let t = &self.vehicle.telemetry;
        let finite = t
            .kinematics
            .is_none_or(|k| k.position_ned_m.is_finite() && k.velocity_ned_m_s.is_finite());
        if !finite || t.attitude.is_some_and(|a| !a.attitude.is_valid()) {
            report.add(
                "values",
                Severity::Failure,
                Some("a position, velocity or attitude that is no number".to_owned()),
                "finite numbers, and a quaternion of unit length",
                "the estimator has failed: guidance holds",
            );
        }
        if t.landed == Landed::Unknown {
            report.add(
                "EXTENDED_SYS_STATE",
                Severity::Warning,
                None,
                "1 Hz or more",
                "without it the height alone says whether the vehicle flies",
            );
        }
    }

    /// The gaps of the one of some messages that has the fewest: each says the same.
    fn gaps(&self, ids: &[u32], now_ns: Nanos) -> Gaps {
        let steady = ids.iter().filter_map(|id| {
            let arrivals = self.arrivals.get(id).filter(|arrivals| arrivals.is_steady)?;
            Some(arrivals.gaps(now_ns, late_ns(*id)))
        });
        steady.min_by_key(|gaps| gaps.sum_ns).unwrap_or_default()
    }

    /// What must not change under who looks: the vehicle's run, its clock, its place, its heading.
    fn changes(&self, now_ns: Nanos, report: &mut Report) {
        if let Some(restarted_ns) = self.restarted_ns {
            report.add(
                "restart",
                Severity::Failure,
                Some(format!("the vehicle started anew {} ago", s(now_ns - restarted_ns))),
                "a vehicle that keeps running",
                "in flight that is a fall: look for its cause (power, a watchdog, a simulation that was restarted) and examine it again",
            );
        }
        if let Some(ahead_s) = self.clock_jumps_s {
            report.add(
                "clock jumps",
                Severity::Failure,
                Some(format!(
                    "the vehicle's time since its start jumped ahead by {ahead_s:.1} s"
                )),
                "none",
                "what it stamps is believed by its order and age",
            );
        }
        let (count, most_m) = self.position_jumps;
        if count > 0 {
            report.add(
                "position jumps",
                Severity::Failure,
                Some(format!("{count}, by {most_m:.1} m at the most")),
                "none",
                "the estimator changes its mind (GPS glitch, a reset, two vehicles of one system): guidance holds (implausible pose)",
            );
        }
        let (count, most_rad) = self.heading_jumps;
        if count > 0 {
            report.add(
                "heading jumps",
                Severity::Failure,
                Some(format!("{count}, by {:.0}° at the most", most_rad.to_degrees())),
                "none",
                "the estimator changes its mind (compass, a reset): setpoints in the body's frame then lead elsewhere",
            );
        }
    }

    fn time(&self, report: &mut Report) {
        if let Some(((boot_ms, at_ns), (later_ms, later_ns))) = self.boot
            && later_ns - at_ns > SECOND_NS
        {
            let ratio = f64::from(later_ms - boot_ms) * 1e6 / (later_ns - at_ns) as f64;
            let severity = match (ratio - 1.0).abs() <= CLOCK_RATIO {
                true => Severity::Good,
                false => Severity::Failure,
            };
            report.judge(
                "clock",
                severity,
                Some(match self.restarted_ns {
                    None => format!("{ratio:.3} of real time"),
                    Some(_) => format!("{ratio:.3} of real time since its restart"),
                }),
                "1.00",
                "the vehicle's time runs otherwise than ours: a simulation must run in real time (PX4: PX4_SIM_SPEED_FACTOR=1; ArduPilot: \
                 --speedup 1), and the machine must keep up with it",
            );
        }
        let mut trips = self.round_trips_s.clone();
        trips.sort_by(f64::total_cmp);
        if let Some(middle_s) = trips.get(trips.len() / 2) {
            let severity = match *middle_s {
                s if s > TOO_SLOW_S => Severity::Failure,
                s if s > SLOW_S => Severity::Warning,
                _ => Severity::Good,
            };
            report.judge(
                "TIMESYNC",
                severity,
                Some(format!("{:.0} ms there and back", middle_s * 1e3)),
                "at most 100 ms",
                "setpoints and telemetry are that old: guidance flies by what was",
            );
        }
        match self.unix_time_us {
            Some((unix_us, at_ns)) if unix_us > 0 => {
                let ours_us = self.config.unix_time_at_zero_us + at_ns / 1000;
                let apart_s = (unix_us as f64 - ours_us as f64) * 1e-6;
                let severity = match apart_s.abs() <= WALL_S {
                    true => Severity::Good,
                    false => Severity::Warning,
                };
                report.judge(
                    "SYSTEM_TIME",
                    severity,
                    Some(format!("{apart_s:+.1} s from this machine's clock")),
                    "within 10 s",
                    "the logs' times differ, and signing refuses what is a minute old: set one of the clocks",
                );
            }
            _ => report.add(
                "SYSTEM_TIME",
                Severity::Warning,
                None,
                "the vehicle's wall clock",
                "without it the vehicle's and Vigil's logs cannot be laid side by side by time of day",
            ),
        }
    }

    fn estimator(&self, report: &mut Report) {
        match self.estimator {
            None => report.add(
                "estimator",
                Severity::Warning,
                None,
                "ESTIMATOR_STATUS or EKF_STATUS_REPORT",
                "the vehicle does not say whether its position can be relied on",
            ),
            Some(flags) => {
                let mut lacks = Vec::new();
                for (bits, what) in [
                    (EKF_ATTITUDE, "attitude"),
                    (EKF_POSITION, "horizontal position"),
                    (EKF_HEIGHT, "height"),
                ] {
                    if flags & bits == 0 {
                        lacks.push(what);
                    }
                }
                if flags & EKF_VELOCITY != EKF_VELOCITY {
                    lacks.push("velocity");
                }
                // A PX4 at rest sets it beside an absolute position: it does stand still.
                let stands = flags & EKF_ABSOLUTE_POSITION != 0 && !self.vehicle.telemetry.is_airborne();
                if flags & EKF_CONSTANT_POSITION != 0 && !stands {
                    lacks.push("any source of position (it assumes to stand still)");
                }
                if flags & EKF_BAD != 0 {
                    lacks.push("trust in its sensors (GPS glitch, accelerometer error, or not yet started)");
                }
                match lacks.is_empty() {
                    true => report.good("estimator", format!("ready ({flags:#06x})")),
                    false => report.add(
                        "estimator",
                        Severity::Failure,
                        Some(format!("not ready ({flags:#06x}): lacks {}", lacks.join(", "))),
                        "attitude, velocity, position and height",
                        "the vehicle refuses OFFBOARD or GUIDED, or flies by a wrong position: wait for GPS, or see its texts",
                    ),
                }
            }
        }
        if let Some((present, enabled, healthy)) = self.sensors {
            let checked = present & enabled & PREARM != 0;
            let texts: Vec<&str> = self.prearm_texts.iter().map(String::as_str).collect();
            if checked && healthy & PREARM == 0 {
                report.add(
                    "arming",
                    Severity::Failure,
                    Some(match texts.is_empty() {
                        true => "the pre-arm check fails".to_owned(),
                        false => texts.join("; "),
                    }),
                    "the pre-arm check passes",
                    "the vehicle will refuse to be armed",
                );
            } else if checked {
                report.good("arming", "the pre-arm check passes".to_owned());
            }
        }
    }

    fn coordinates(&self, report: &mut Report) {
        let home = self.vehicle.home_ned_m();
        match home {
            Some(home) => report.good("HOME_POSITION", format!("{:.1} m north, {:.1} m east, {:.1} m up", home.x, home.y, 0.0 - home.z)),
            None => report.add(
                "HOME_POSITION",
                Severity::Warning,
                None,
                "where home is",
                "goals are then from the local origin, where the estimator began: an ArduPilot sets home when it is armed or has GPS, a PX4 \
                 when it has a global position",
            ),
        }
        let t = &self.vehicle.telemetry;
        let (Some(k), Some(attitude)) = (t.kinematics, t.attitude) else {
            return;
        };
        let Some((up_m, heading_rad)) = self.global else { return };
        if let Some(home) = home {
            let local_up_m = home.z - k.position_ned_m.z;
            let apart_m = (local_up_m - up_m).abs();
            let value = format!("{local_up_m:.1} m by LOCAL_POSITION_NED, {up_m:.1} m by GLOBAL_POSITION_INT");
            if apart_m <= HEIGHT_M {
                report.good("height", value);
            } else {
                let is_upside_down = (local_up_m + up_m).abs() <= HEIGHT_M;
                let why = match is_upside_down {
                    true => "the local frame's z points up: it must point down (NED, not ENU)",
                    false => "the two frames' origins differ: a goal's height would be wrong by as much",
                };
                report.add(
                    "height",
                    Severity::Failure,
                    Some(value),
                    "the same height above home",
                    why,
                );
            }
        }
        if let Some(heading_rad) = heading_rad {
            let yaw_rad = attitude.attitude.yaw_rad();
            let value = format!(
                "{:.0}° by ATTITUDE, {:.0}° by GLOBAL_POSITION_INT",
                wrap_pi(yaw_rad).to_degrees(),
                wrap_pi(heading_rad).to_degrees()
            );
            let apart = |other: f32| wrap_pi(other - heading_rad).abs();
            if apart(yaw_rad) <= HEADING_RAD {
                report.good("heading", value);
            } else {
                let why = match apart(std::f32::consts::FRAC_PI_2 - yaw_rad) <= HEADING_RAD {
                    true => "attitude is told in east-north-up: yaw must be clockwise from north (NED)",
                    false => "setpoints are in the body's frame: the vehicle would fly another way than it looks",
                };
                report.add("heading", Severity::Failure, Some(value), "one heading", why);
            }
        }
    }

    fn signing(&self, report: &mut Report) {
        match (self.is_signed, self.config.has_key) {
            (true, true) => report.good("signing", "signed with the key".to_owned()),
            (true, false) => report.add(
                "signing",
                Severity::Failure,
                Some("the vehicle signs its packets, and there is no key here".to_owned()),
                "the vehicle's key",
                "it will refuse commands and setpoints without a signature: give --signing-key",
            ),
            (false, true) => report.add(
                "signing",
                Severity::Failure,
                Some("packets without a signature".to_owned()),
                "packets signed with the key",
                "the vehicle has another key or none: give it this one (SETUP_SIGNING)",
            ),
            (false, false) if self.config.is_local => {
                report.good("signing", "none, on a link within this machine".to_owned());
            }
            (false, false) => report.add(
                "signing",
                Severity::Warning,
                Some("none".to_owned()),
                "signed packets where others reach the link",
                "whoever reaches the link may command the vehicle: docs/firmware.md, Signing",
            ),
        }
    }

    fn read_parameters(&self, report: &mut Report) {
        let told = |name: &str| self.parameters.get(name).is_some_and(|asked| asked.value.is_some());
        let by_speed = told(STICKS_BY_SPEED);
        let judged = |row: &&Row| match row.versions {
            Versions::All => true,
            Versions::BeforeSticksBySpeed => !by_speed,
            Versions::SticksBySpeed => by_speed,
        };
        for row in parameters::of(self.vehicle.flavour()).filter(judged) {
            match self.parameters.get(row.name).and_then(|asked| asked.value) {
                Some(value) => {
                    let told = format!("{value} {}", row.unit).trim_end().to_owned();
                    report.judge(row.name, (row.judge)(value), Some(told), row.wanted, row.why);
                }
                None => report.add(
                    row.name,
                    Severity::Warning,
                    None,
                    row.wanted,
                    "the vehicle did not tell this parameter: it may be of a version that does not have it, or not answer on this link",
                ),
            }
        }
    }

    fn mounting(&self, report: &mut Report) {
        let Some((attitude, position_ned_m, _)) = self.frame else {
            return;
        };
        let t = &self.vehicle.telemetry;
        if let (Some(k), Some(a)) = (t.kinematics, t.attitude) {
            let yaw_apart = wrap_pi(attitude.yaw_rad() - a.attitude.yaw_rad()).abs();
            let apart_m = (position_ned_m - k.position_ned_m).norm();
            let value = format!("{apart_m:.1} m and {:.0}° from the vehicle's", yaw_apart.to_degrees());
            let severity = match yaw_apart <= HEADING_RAD && apart_m <= HEIGHT_M {
                true => Severity::Good,
                false => Severity::Failure,
            };
            report.judge(
                "frame pose",
                severity,
                Some(value),
                "the vehicle's own",
                "the pose in the frames' header is of another frame or vehicle: guidance holds (implausible pose)",
            );
        }
        if self.tilts.is_empty() {
            return;
        }
        let median = |of: fn(&(f32, f32)) -> f32| {
            let mut values: Vec<f32> = self.tilts.iter().map(of).collect();
            values.sort_by(f32::total_cmp);
            values[values.len() / 2]
        };
        let (pitch, roll) = (median(|t| t.0), median(|t| t.1));
        let severity = match pitch.abs().max(roll.abs()) <= TILT_RAD {
            true => Severity::Good,
            false => Severity::Warning,
        };
        report.judge(
            "mount",
            severity,
            Some(format!(
                "the ground leans by {:.1}° in pitch and {:.1}° in roll",
                pitch.to_degrees(),
                roll.to_degrees()
            )),
            "at most 3° over level ground",
            "the sensor is mounted at another angle than its driver tells (or the ground is not level): add the mount's angles to the pose in \
             the frames' header",
        );
    }
}

fn id((system, component): &(u8, u8)) -> String {
    format!("{system}/{component}")
}

struct Report(Vec<Finding>);

impl Report {
    fn add(&mut self, name: &str, severity: Severity, value: Option<String>, wanted: &str, why: &str) {
        self.0.push(Finding {
            name: name.to_owned(),
            severity,
            value,
            wanted: wanted.to_owned(),
            why: why.to_owned(),
        });
    }

    fn good(&mut self, name: &str, value: String) {
        self.add(name, Severity::Good, Some(value), "", "");
    }

    fn judge(&mut self, name: &str, severity: Severity, value: Option<String>, wanted: &str, why: &str) {
        let why = if severity == Severity::Good { "" } else { why };
        self.add(name, severity, value, wanted, why);
    }
}
