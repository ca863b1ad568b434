//! Asks a vehicle and keeps what it sends; what is found in that is in `findings` and `readiness`.

mod findings;
mod readiness;

use super::ground::{GroundTilt, ground_tilt};
use super::parameters;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use vigil_mavlink::common::{
    ATTITUDE_DATA, ATTITUDE_QUATERNION_DATA, ESTIMATOR_STATUS_DATA, EXTENDED_SYS_STATE_DATA, GLOBAL_POSITION_INT_DATA,
    GPS_GLOBAL_ORIGIN_DATA, HEARTBEAT_DATA, HOME_POSITION_DATA, LOCAL_POSITION_NED_DATA, MavParamType,
    PARAM_REQUEST_READ_DATA, SYS_STATUS_DATA, SYSTEM_TIME_DATA,
};
use vigil_mavlink::framing::{AUTOPILOT, Command, FramingCounters, Packet, packets};
use vigil_mavlink::mavlink::MessageData;
use vigil_mavlink::message;
use vigil_mavlink::{Flavour, MavMessage, RESTART_MS, Sender, Vehicle};
use vigil_types::{Attitude, Datagrams, DepthFrame, Kinematics, Nanos, NedVector, wrap_pi};

/// MAV_COMP_ID_PERIPHERAL: who asks.
const COMPONENT: u8 = 158;
/// MAV_COMP_ID_ONBOARD_COMPUTER, under which Vigil's firmware speaks.
const ONBOARD_COMPUTER: u8 = 191;
const ONBOARD_CONTROLLER: u8 = 18;

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
/// Arrivals that a rate is taken from.
const WINDOW_NS: Nanos = 2 * SECOND_NS;

const GOOD_HZ: f64 = 10.0;
/// A position that is farther from where velocity and time would bring it than this has jumped, metres, and so much more for each second between.
const JUMP_M: f32 = 1.0;
const JUMP_M_S: f32 = 10.0;
/// A heading has jumped that changed by more than this between two attitudes beside what its rate explains, radians.
const JUMP_RAD: f32 = 0.35;
/// The vehicle's clock has jumped if it went on by so much more than ours.
const CLOCK_JUMP_NS: Nanos = SECOND_NS / 2;
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
#[derive(Default)]
pub struct Examination {
    config: ExaminationConfig,
    started_ns: Nanos,
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
    /// Positions and attitudes that are no numbers, flags of an estimator that was not ready, a pre-arm check that failed.
    unusable: u32,
    was_not_ready: Option<u16>,
    was_not_armable: bool,
    round_trips_s: Vec<f64>,
    unix_time_us: Option<(u64, Nanos)>,
    estimator: Option<u16>,
    /// Whether the pre-arm check passes, where SYS_STATUS has one.
    is_armable: Option<bool>,
    prearm_texts: BTreeSet<String>,
    /// GLOBAL_POSITION_INT: metres above home, and heading in radians where it is known.
    global: Option<(f32, Option<f32>)>,
    /// Other guidance computers, by system and component: arrivals of heartbeats.
    companions: BTreeMap<(u8, u8), Arrivals>,
    setpoints_of: BTreeSet<(u8, u8)>,
    sticks_of: BTreeSet<(u8, u8)>,
    parameters: BTreeMap<&'static str, Asked>,
    frame: Option<(Attitude, NedVector)>,
    tilts: Vec<GroundTilt>,
    next_question_ns: Nanos,
    turn: u64,
    sender: Sender,
}

impl Examination {
    /// One that has heard nothing.
    pub fn new(config: ExaminationConfig, now_ns: Nanos) -> Self {
        Self {
            system: config.system,
            sender: Sender::new(1, COMPONENT),
            config,
            started_ns: now_ns,
            next_question_ns: now_ns,
            ..Self::default()
        }
    }

    /// Takes a datagram that arrived at `now_ns`.
    pub fn receive(&mut self, now_ns: Nanos, datagram: &[u8]) {
        for packet in packets(datagram, &mut FramingCounters::default()) {
            self.packet(now_ns, &packet);
        }
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
        let t = &self.vehicle.telemetry;
        match packet.message_id() {
            HEARTBEAT_DATA::ID => {
                self.vehicle_type = packet.payload().get(4).copied();
                self.was_in_failsafe |= t.heartbeat.is_some_and(|h| h.failsafe);
            }
            LOCAL_POSITION_NED_DATA::ID => {
                let is_number = |k: Kinematics| k.position_ned_m.is_finite() && k.velocity_ned_m_s.is_finite();
                self.unusable += u32::from(!t.kinematics.is_none_or(is_number));
            }
            ATTITUDE_DATA::ID | ATTITUDE_QUATERNION_DATA::ID => {
                self.unusable += u32::from(!t.attitude.is_none_or(|a| a.attitude.is_valid()));
            }
            EKF_STATUS_REPORT => {
                let byte = |at: usize| packet.payload().get(at).copied().unwrap_or(0);
                self.note_estimator(u16::from_le_bytes([byte(EKF_FLAGS_AT), byte(EKF_FLAGS_AT + 1)]));
            }
            _ => {}
        }
        let Ok(message) = packet.message() else { return };
        match message {
            MavMessage::LOCAL_POSITION_NED(m) => {
                if !self.note_clock(m.time_boot_ms, now_ns) {
                    return;
                }
                let position = NedVector::new(m.x, m.y, m.z);
                let velocity = NedVector::new(m.vx, m.vy, m.vz);
                self.note_position(m.time_boot_ms, position, velocity);
            }
            MavMessage::ATTITUDE(m) => self.note_heading(m.time_boot_ms, m.yaw, m.yawspeed),
            MavMessage::ESTIMATOR_STATUS(m) => self.note_estimator(m.flags.bits()),
            MavMessage::SYS_STATUS(m) => {
                let checked = m.onboard_control_sensors_present & m.onboard_control_sensors_enabled;
                let passes = m.onboard_control_sensors_health.bits() & PREARM != 0;
                self.is_armable = (checked.bits() & PREARM != 0).then_some(passes);
                self.was_not_armable |= self.is_armable == Some(false);
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
                let starts = ["PreArm", "Arm:", "Preflight Fail"];
                if starts.iter().any(|start| text.starts_with(start)) {
                    // It is shown on a terminal.
                    self.prearm_texts.insert(text.replace(char::is_control, "\u{fffd}"));
                }
            }
            MavMessage::PARAM_VALUE(m) => {
                let name = m.param_id.to_str().unwrap_or_default();
                self.note_parameter(name, m.param_value, m.param_type);
            }
            _ => {}
        }
    }

    /// A vehicle that starts anew while it is looked at has another zero; one whose clock jumps has not. Whether the packet is in order.
    fn note_clock(&mut self, boot_ms: u32, now_ns: Nanos) -> bool {
        let now = (boot_ms, now_ns);
        let (first, last) = *self.boot.get_or_insert((now, now));
        if boot_ms < last.0 && last.0 - boot_ms < RESTART_MS {
            return false;
        }
        let Some(since_ms) = boot_ms.checked_sub(last.0) else {
            self.restarted_ns = Some(now_ns);
            self.position = None;
            self.heading = None;
            self.boot = Some((now, now));
            return true;
        };
        let ahead_ns = (u64::from(since_ms) * 1_000_000).saturating_sub(now_ns - last.1);
        if ahead_ns > CLOCK_JUMP_NS {
            let ahead_s = ahead_ns as f64 * 1e-9;
            self.clock_jumps_s = Some(self.clock_jumps_s.map_or(ahead_s, |s| s.max(ahead_s)));
        }
        self.boot = Some((first, now));
        true
    }

    fn note_estimator(&mut self, flags: u16) {
        self.estimator = Some(flags);
        if !self.estimator_lacks(flags).is_empty() {
            self.was_not_ready = Some(flags);
        }
    }

    fn note_position(&mut self, boot_ms: u32, position_m: NedVector, velocity_m_s: NedVector) {
        if !position_m.is_finite() || !velocity_m_s.is_finite() {
            self.position = None;
            return;
        }
        let Some((last_ms, last_m, last_m_s)) = self.position.replace((boot_ms, position_m, velocity_m_s)) else {
            return;
        };
        let since_s = boot_ms.saturating_sub(last_ms) as f32 * 1e-3;
        let off_m = (position_m - (last_m + last_m_s * since_s)).norm();
        if off_m > JUMP_M + JUMP_M_S * since_s {
            self.position_jumps = (self.position_jumps.0 + 1, self.position_jumps.1.max(off_m));
        }
    }

    fn note_heading(&mut self, boot_ms: u32, yaw_rad: f32, yaw_rad_s: f32) {
        let Some((last_ms, last_rad)) = self.heading.replace((boot_ms, yaw_rad)) else {
            return;
        };
        if let Some(since_ms) = boot_ms.checked_sub(last_ms).filter(|ms| *ms < 1000) {
            let expected_rad = last_rad + yaw_rad_s * since_ms as f32 * 1e-3;
            let off_rad = wrap_pi(yaw_rad - expected_rad).abs();
            if off_rad > JUMP_RAD {
                self.heading_jumps = (self.heading_jumps.0 + 1, self.heading_jumps.1.max(off_rad));
            }
        }
    }

    fn note_parameter(&mut self, name: &str, value: f32, kind: MavParamType) {
        let flavour = self.vehicle.flavour();
        if let Some(row) = parameters::of(flavour).find(|row| row.name == name) {
            // A PX4 puts an integer's bits where the float is.
            let is_bits = flavour == Flavour::Px4 && kind == MavParamType::MAV_PARAM_TYPE_INT32;
            let value = if is_bits { value.to_bits() as i32 as f32 } else { value };
            self.parameters.entry(row.name).or_default().value = Some(value);
        }
    }

    /// Takes a depth frame that was checked.
    pub fn observe_frame(&mut self, frame: &DepthFrame) {
        let header = &frame.header;
        self.frame = Some((header.attitude, header.position_ned_m));
        self.tilts.extend(ground_tilt(frame));
    }

    /// Adds the questions that are due to `out`. Call it often.
    pub fn ask(&mut self, now_ns: Nanos, out: &mut Datagrams) {
        if now_ns < self.next_question_ns {
            return;
        }
        self.next_question_ns = now_ns + PAUSE_NS;
        self.turn += 1;
        // Who speaks: of the vehicle's system.
        self.sender.system_id = self.system.unwrap_or(1);
        // Some vehicles answer on a link only to whom they have heard.
        if self.turn % 20 == 1 {
            self.sender.listener_heartbeat(out, 0);
        }
        let Some(system) = self.system.filter(|_| self.vehicle.telemetry.heartbeat.is_some()) else {
            return;
        };
        if self.turn.is_multiple_of(4) {
            let message = message!(TIMESYNC, tc1 = 0, ts1 = now_ns as i64);
            self.sender.message(out, 0, &message);
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
        // Those without an interval are asked for once.
        let rows = [
            (LOCAL_POSITION_NED_DATA::ID, 33_333.0, GOOD_HZ),
            (ATTITUDE_DATA::ID, 20_000.0, GOOD_HZ),
            (GLOBAL_POSITION_INT_DATA::ID, 200_000.0, 1.0),
            (EXTENDED_SYS_STATE_DATA::ID, 200_000.0, 1.0),
            (SYS_STATUS_DATA::ID, 500_000.0, 0.5),
            (estimator, 500_000.0, 0.5),
            (SYSTEM_TIME_DATA::ID, 1_000_000.0, 0.5),
            (HOME_POSITION_DATA::ID, 0.0, 0.0),
            (GPS_GLOBAL_ORIGIN_DATA::ID, 0.0, 0.0),
        ];
        let (id, interval_us, least_hz) = rows[(self.turn / 4) as usize % rows.len()];
        let rate_hz = |id: u32| self.arrivals.get(&id).and_then(|a| a.rate_hz(now_ns)).unwrap_or(0.0);
        let (number, suffices) = match id {
            _ if interval_us == 0.0 => (REQUEST_MESSAGE, self.arrivals.contains_key(&id)),
            // Attitude comes in one of two messages.
            ATTITUDE_DATA::ID if rate_hz(ATTITUDE_QUATERNION_DATA::ID) >= least_hz => return,
            _ => (SET_MESSAGE_INTERVAL, rate_hz(id) >= least_hz),
        };
        if !suffices {
            let parameters = [id as f32, interval_us, 0.0, 0.0, 0.0, 0.0, 0.0];
            let command = Command::to_autopilot(system, number, parameters, 0);
            self.sender.command(out, 0, &command);
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
        self.sender.message(out, 0, &message);
    }
}
