//! Scripted vehicles of both flavours, written from the protocol's and the autopilots' documentation, on the crate's own
//! parser: they share no code with the companion but the packet scanner.

use vigil_mavlink::common::*;
use vigil_mavlink::framing::{FramingCounters, encode, packets};
use vigil_mavlink::{Flavour, MavMessage, message};
use vigil_types::{Nanos, STEP_NS};

/// Above sea level, where both peers' home and local origin are.
pub const HOME_ALTITUDE_M: f32 = 488.0;
const STEP_S: f32 = 0.05;
const CLIMB_M_S: f32 = 1.5;
const SECOND: Nanos = 1_000_000_000;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Mode {
    /// AUTO.LOITER or LOITER.
    #[default]
    Loiter,
    /// AUTO.TAKEOFF; a Copter has no such mode.
    Takeoff,
    /// OFFBOARD or GUIDED.
    External,
    Land,
    /// POSCTL or STABILIZE.
    Manual,
    /// AUTO.MISSION or AUTO: north, at [`Peer::cruise_m_s`].
    Mission,
    /// BRAKE; a PX4 has no such mode.
    Brake,
}

/// What a command is answered with instead of what is right.
#[derive(Debug, Clone, Copy)]
pub struct Quirk {
    pub command: u16,
    pub answer: Option<MavResult>,
    /// How often.
    pub times: u32,
}

/// A command as it arrived.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Got {
    pub at_ns: Nanos,
    pub command: u16,
    pub confirmation: u8,
    pub params: [f32; 7],
}

#[derive(Debug, Default)]
pub struct Peer {
    pub flavour: Flavour,
    pub system: u8,
    pub armed: bool,
    pub mode: Mode,
    pub failsafe: bool,
    pub north_m: f32,
    pub east_m: f32,
    /// Above the local origin.
    pub height_m: f32,
    /// What it reports; only missions and what stops them fly by it.
    pub speed_north_m_s: f32,
    /// As it leans to gain speed.
    pub pitch_rad: f32,
    /// In missions.
    pub cruise_m_s: f32,
    /// Gains and loses speed in missions and holds with so much, metres per second squared; its parameter says a fifth more.
    pub gain_m_s2: f32,
    /// COM_OF_LOSS_T or GUID_TIMEOUT, seconds.
    pub setpoint_timeout_s: f32,
    /// VGL_OF_LOSS_T, seconds, of a vehicle that has it.
    pub own_timeout_s: Option<f32>,
    /// It reports that parameter, and lets it be set.
    pub reports_parameters: bool,
    pub sets_parameters: bool,
    /// Parameters asked for, and set.
    pub parameters_read: u32,
    pub parameters_set: Vec<f32>,
    /// Home in the local frame; an ArduPilot sets it where it stands when it is armed.
    pub home_ned_m: [f32; 3],
    /// HOME_POSITION says where home is on the globe only.
    pub home_on_globe_only: bool,
    /// Steps between two positions and attitudes, as somebody set them; `None` is each step.
    pub slowed_to_steps: Option<u32>,
    /// SET_MESSAGE_INTERVAL does not undo that.
    pub keeps_slow: bool,
    /// What REQUEST_DATA_STREAM asked for: stream and rate.
    pub streams_asked: Vec<(u8, u16)>,
    /// EXTENDED_SYS_STATE is sent.
    pub tells_landed: bool,
    pub quirks: Vec<Quirk>,
    pub commands: Vec<Got>,
    /// Latitude and longitude, 1e-7 degrees, of the places that it was sent to; speed, flags and altitude.
    pub places: Vec<(i32, i32, [f32; 3])>,
    /// As one outside its fence.
    pub refuses_places: bool,
    /// Time, velocity and yaw rate of each setpoint.
    pub setpoints: Vec<(Nanos, [f32; 4])>,
    /// A setpoint came well before the take-off's height (it ends a Copter's take-off).
    pub disturbed_takeoff: bool,
    pub boot_ns: Nanos,
    pub target_height_m: Option<f32>,
    pub wanted_messages: Vec<u32>,
    pub replies: Vec<MavMessage>,
    pub sequence: u8,
    pub steps: u32,
}

impl Peer {
    pub fn on_the_ground(flavour: Flavour) -> Self {
        // What either autopilot ships with.
        let (mode, setpoint_timeout_s) = match flavour {
            Flavour::Px4 => (Mode::Loiter, 1.0),
            Flavour::ArduPilot => (Mode::Manual, 3.0),
        };
        Self {
            flavour,
            system: 1,
            mode,
            cruise_m_s: 3.0,
            gain_m_s2: 2.5,
            setpoint_timeout_s,
            reports_parameters: true,
            sets_parameters: true,
            tells_landed: true,
            boot_ns: 20 * SECOND,
            ..Self::default()
        }
    }

    pub fn in_the_air(flavour: Flavour) -> Self {
        Self {
            armed: true,
            mode: Mode::Loiter,
            height_m: 3.0,
            ..Self::on_the_ground(flavour)
        }
    }

    /// Command numbers in order, repetitions and requests for messages left out.
    pub fn flight_commands(&self) -> Vec<u16> {
        let mut numbers: Vec<u16> = self.commands.iter().map(|c| c.command).filter(|c| *c < 500).collect();
        numbers.dedup();
        numbers
    }

    /// The commands of a number, in order.
    pub fn got(&self, command: u16) -> Vec<Got> {
        self.commands.iter().copied().filter(|c| c.command == command).collect()
    }

    /// Has a command answered otherwise, so many times.
    pub fn answer(&mut self, command: u16, answer: Option<MavResult>, times: u32) {
        self.quirks.push(Quirk { command, answer, times });
    }

    /// The power was cut and came back, on the ground.
    pub fn reboot(&mut self, now_ns: Nanos) {
        *self = Self {
            boot_ns: now_ns,
            quirks: std::mem::take(&mut self.quirks),
            commands: std::mem::take(&mut self.commands),
            ..Self::on_the_ground(self.flavour)
        };
    }

    fn custom_mode(&self) -> u32 {
        match (self.flavour, self.mode) {
            (Flavour::Px4, Mode::Mission) => 4 << 16 | 4 << 24,
            (Flavour::ArduPilot, Mode::Mission) => 3,
            (Flavour::ArduPilot, Mode::Brake) => 17,
            (Flavour::Px4, Mode::Loiter | Mode::Brake) => 4 << 16 | 3 << 24,
            (Flavour::Px4, Mode::Takeoff) => 4 << 16 | 2 << 24,
            (Flavour::Px4, Mode::External) => 6 << 16,
            (Flavour::Px4, Mode::Land) => 4 << 16 | 6 << 24,
            (Flavour::Px4, Mode::Manual) => 3 << 16,
            (Flavour::ArduPilot, Mode::Loiter) => 5,
            (Flavour::ArduPilot, Mode::External | Mode::Takeoff) => 4,
            (Flavour::ArduPilot, Mode::Land) => 9,
            (Flavour::ArduPilot, Mode::Manual) => 0,
        }
    }

    fn heartbeat(&self) -> MavMessage {
        let mut base_mode = MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED;
        base_mode.set(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED, self.armed);
        message!(
            HEARTBEAT,
            custom_mode = self.custom_mode(),
            mavtype = MavType::MAV_TYPE_QUADROTOR,
            autopilot = match self.flavour {
                Flavour::Px4 => MavAutopilot::MAV_AUTOPILOT_PX4,
                Flavour::ArduPilot => MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA,
            },
            base_mode,
            system_status = match (self.failsafe, self.armed) {
                (true, _) => MavState::MAV_STATE_CRITICAL,
                (_, true) => MavState::MAV_STATE_ACTIVE,
                _ => MavState::MAV_STATE_STANDBY,
            },
            mavlink_version = 3
        )
    }

    fn landed_state(&self) -> MavLandedState {
        // The ground may lie below the local origin.
        let ground_m = -self.home_ned_m[2].max(0.0);
        match (
            self.height_m > ground_m + 0.1,
            self.target_height_m.is_some(),
            self.mode,
        ) {
            (false, ..) => MavLandedState::MAV_LANDED_STATE_ON_GROUND,
            (_, true, _) => MavLandedState::MAV_LANDED_STATE_TAKEOFF,
            (_, _, Mode::Land) => MavLandedState::MAV_LANDED_STATE_LANDING,
            _ => MavLandedState::MAV_LANDED_STATE_IN_AIR,
        }
    }

    /// One step of flying; the datagrams it sends, one packet each.
    pub fn step(&mut self, now_ns: Nanos) -> Vec<Vec<u8>> {
        let before_m = [self.north_m, self.height_m];
        self.fly(now_ns);
        let [north_m_s, up_m_s] = [self.north_m - before_m[0], self.height_m - before_m[1]].map(|way_m| way_m / STEP_S);
        let time_boot_ms = ((now_ns - self.boot_ns) / 1_000_000) as u32;
        let mut out = std::mem::take(&mut self.replies);
        if self.steps.is_multiple_of(20) {
            out.push(self.heartbeat());
        }
        let streams = |id: u32, unprompted: bool, wanted: &[u32]| unprompted || wanted.contains(&id);
        let px4 = self.flavour == Flavour::Px4;
        let now = self
            .slowed_to_steps
            .is_none_or(|steps| self.steps.is_multiple_of(steps));
        if now && streams(32, px4, &self.wanted_messages) {
            let (x, y, z) = (self.north_m, self.east_m, -self.height_m);
            let (vx, vz) = (north_m_s, -up_m_s);
            out.push(message!(LOCAL_POSITION_NED, time_boot_ms, x, y, z, vx, vz));
        }
        if now && streams(30, px4, &self.wanted_messages) {
            out.push(message!(ATTITUDE, time_boot_ms, pitch = self.pitch_rad));
        }
        if self.tells_landed && self.steps.is_multiple_of(4) && streams(245, px4, &self.wanted_messages) {
            out.push(message!(EXTENDED_SYS_STATE, landed_state = self.landed_state()));
        }
        if self.steps.is_multiple_of(20) && streams(1, px4, &self.wanted_messages) {
            out.push(message!(SYS_STATUS, battery_remaining = 87));
        }
        if self.steps.is_multiple_of(40) && streams(242, px4, &self.wanted_messages) {
            out.push(self.home_position());
        }
        self.steps += 1;
        out.iter()
            .map(|message| {
                self.sequence = self.sequence.wrapping_add(1);
                encode((self.system, 1), self.sequence, message)
            })
            .collect()
    }

    /// A metre is 1e7 / 111 194.93 units of latitude, and of longitude at 47.4° that over its cosine.
    fn home_position(&self) -> MavMessage {
        let [north_m, east_m, down_m] = self.home_ned_m;
        let [x, y, z] = if self.home_on_globe_only {
            [0.0; 3]
        } else {
            self.home_ned_m
        };
        message!(
            HOME_POSITION,
            latitude = 473_977_420 + (north_m * 89.932_16).round() as i32,
            longitude = 85_455_940 + (east_m * 89.932_16 / 0.676_912_4).round() as i32,
            altitude = ((HOME_ALTITUDE_M - down_m) * 1000.0).round() as i32,
            x,
            y,
            z
        )
    }

    fn origin(&self) -> MavMessage {
        let altitude = (HOME_ALTITUDE_M * 1000.0) as i32;
        let (latitude, longitude) = (473_977_420, 85_455_940);
        message!(GPS_GLOBAL_ORIGIN, latitude, longitude, altitude)
    }

    fn fly(&mut self, now_ns: Nanos) {
        if let Some(target_m) = self.target_height_m {
            self.height_m = (self.height_m + CLIMB_M_S * STEP_S).min(target_m);
            if self.height_m >= target_m {
                self.target_height_m = None;
                if self.mode == Mode::Takeoff {
                    self.mode = Mode::Loiter;
                }
            }
        }
        let last = self.setpoints.last().copied();
        let age_ns = last.map_or(Nanos::MAX, |(at_ns, _)| now_ns - at_ns);
        let timeout_ns = (self.setpoint_timeout_s * 1e9) as Nanos;
        match self.mode {
            Mode::External if self.flavour == Flavour::Px4 && age_ns > timeout_ns => {
                (self.mode, self.failsafe) = (Mode::Loiter, true);
            }
            // A Copter stops, and stays in its mode.
            Mode::External if age_ns <= timeout_ns => {
                if let Some((_, [vx, _, vz, _])) = last {
                    self.north_m += vx * STEP_S;
                    self.height_m -= vz * STEP_S;
                }
            }
            Mode::Land => {
                self.height_m = (self.height_m - CLIMB_M_S * STEP_S).max(0.0);
                if self.height_m <= 0.0 {
                    self.armed = false;
                }
            }
            Mode::Mission => self.gain(self.cruise_m_s),
            Mode::Loiter | Mode::Brake => self.gain(0.0),
            _ => {}
        }
    }

    /// Flies north.
    fn gain(&mut self, wanted_m_s: f32) {
        let most_m_s = self.gain_m_s2 * STEP_S;
        let gained_m_s = (wanted_m_s - self.speed_north_m_s).clamp(-most_m_s, most_m_s);
        self.speed_north_m_s += gained_m_s;
        self.pitch_rad = -(gained_m_s / STEP_S / 9.81).atan();
        self.north_m += self.speed_north_m_s * STEP_S;
    }

    pub fn receive(&mut self, now_ns: Nanos, datagram: &[u8]) {
        for packet in packets(datagram, &mut FramingCounters::default()) {
            assert_eq!(
                (packet.system_id(), packet.component_id()),
                (self.system, 191),
                "the companion's identity"
            );
            match packet.message().expect("a known message") {
                MavMessage::SET_POSITION_TARGET_LOCAL_NED(s) => {
                    assert_eq!((s.target_system, s.target_component), (self.system, 1));
                    assert_eq!((s.coordinate_frame as u8, s.type_mask.bits()), (8, 0x5C7));
                    if self.flavour == Flavour::ArduPilot
                        && let Some(target_m) = self.target_height_m.take()
                    {
                        self.disturbed_takeoff |= self.height_m < 0.89 * target_m;
                    }
                    self.setpoints.push((now_ns, [s.vx, s.vy, s.vz, s.yaw_rate]));
                }
                MavMessage::PARAM_REQUEST_READ(p) if p.target_system == self.system && p.target_component == 1 => {
                    let name = p.param_id.to_str().expect("a name is UTF-8");
                    assert_eq!(p.param_index, -1, "{name}");
                    self.parameters_read += u32::from(TIMEOUTS.contains(&name));
                    // An autopilot that has no such parameter says nothing.
                    let reports = self.reports_parameters || name == OWN_TIMEOUT;
                    self.replies.extend(self.value(name).filter(|_| reports));
                }
                MavMessage::PARAM_SET(p) if p.target_system == self.system && p.target_component == 1 => {
                    let name = p.param_id.to_str().expect("a name is UTF-8");
                    if name == OWN_TIMEOUT {
                        self.own_timeout_s = self.own_timeout_s.map(|_| p.param_value);
                    } else {
                        assert!(TIMEOUTS.contains(&name), "{name}");
                        self.parameters_set.push(p.param_value);
                        if self.sets_parameters {
                            self.setpoint_timeout_s = p.param_value;
                        }
                    }
                    self.replies.extend(self.value(name));
                }
                MavMessage::COMMAND_LONG(c) if c.target_system == self.system && c.target_component == 1 => {
                    self.command(now_ns, &c)
                }
                MavMessage::COMMAND_INT(c) if c.target_system == self.system && c.target_component == 1 => {
                    assert_eq!(c.frame as u8, 0, "above sea level, where that is known");
                    self.places.push((c.x, c.y, [c.param1, c.param2, c.z]));
                    let mut result = MavResult::MAV_RESULT_DENIED;
                    if self.flavour == Flavour::Px4 && c.command as u16 == 192 && !self.refuses_places {
                        (self.mode, result) = (Mode::Loiter, MavResult::MAV_RESULT_ACCEPTED);
                    }
                    self.acknowledge(c.command, result);
                }
                #[allow(deprecated)] // what ArduPilot's ground stations use
                MavMessage::REQUEST_DATA_STREAM(r) if r.target_system == self.system => {
                    self.streams_asked.push((r.req_stream_id as u8, r.req_message_rate));
                    self.slowed_to_steps = None;
                }
                _ => {}
            }
        }
    }

    fn acknowledge(&mut self, command: MavCmd, result: MavResult) {
        let (target_system, target_component) = (self.system, 191);
        self.replies
            .push(message!(COMMAND_ACK, command, result, target_system, target_component));
    }

    fn command(&mut self, now_ns: Nanos, c: &COMMAND_LONG_DATA) {
        self.commands.push(Got {
            at_ns: now_ns,
            command: c.command as u16,
            confirmation: c.confirmation,
            params: [c.param1, c.param2, c.param3, c.param4, c.param5, c.param6, c.param7],
        });
        let mut quirks = self.quirks.iter_mut();
        let answer = match quirks.find(|q| q.command == c.command as u16 && q.times > 0) {
            Some(quirk) => {
                quirk.times -= 1;
                quirk.answer
            }
            None => Some(self.obey(now_ns, c)),
        };
        if let Some(result) = answer {
            self.acknowledge(c.command, result);
        }
    }

    /// A parameter: the limits, and those by which it changes its speed in missions.
    fn value(&self, name: &str) -> Option<MavMessage> {
        let param_value = match (self.flavour, name) {
            (_, OWN_TIMEOUT) => self.own_timeout_s?,
            (Flavour::Px4, "COM_OF_LOSS_T") | (Flavour::ArduPilot, "GUID_TIMEOUT") => self.setpoint_timeout_s,
            (Flavour::Px4, "MPC_ACC_HOR") => 1.2 * self.gain_m_s2,
            (Flavour::Px4, "MPC_JERK_AUTO") => 4.0,
            (Flavour::ArduPilot, "WPNAV_ACCEL") => 100.0 * self.gain_m_s2,
            (Flavour::ArduPilot, "PSC_JERK_XY") => 5.0,
            _ => panic!("{name} is asked of a {}", self.flavour.name()),
        };
        Some(message!(
            PARAM_VALUE,
            param_value,
            param_count = 900,
            param_index = u16::MAX,
            param_id = name.into(),
            param_type = MavParamType::MAV_PARAM_TYPE_REAL32
        ))
    }

    fn obey(&mut self, now_ns: Nanos, c: &COMMAND_LONG_DATA) -> MavResult {
        use MavResult::{MAV_RESULT_ACCEPTED as ACCEPTED, MAV_RESULT_DENIED as DENIED, MAV_RESULT_FAILED as FAILED};
        let px4 = self.flavour == Flavour::Px4;
        match c.command as u16 {
            400 if c.param1 == 1.0 => {
                // A Copter cannot be armed for guided flight in a mode flown by sticks.
                if !px4 && self.mode != Mode::External {
                    return FAILED;
                }
                self.armed = true;
                if !px4 {
                    self.home_ned_m = [self.north_m, self.east_m, -self.height_m];
                    self.replies.push(self.home_position());
                }
                ACCEPTED
            }
            22 => {
                let height_m = match c.param7 {
                    none_m if px4 && none_m.is_nan() => 2.5,
                    above_sea_m if px4 => above_sea_m - HOME_ALTITUDE_M,
                    above_home_m => above_home_m - self.home_ned_m[2],
                };
                let guided = px4 || self.mode == Mode::External;
                if !self.armed || !guided || height_m <= self.height_m {
                    return FAILED;
                }
                self.target_height_m = Some(height_m);
                if px4 {
                    self.mode = Mode::Takeoff;
                }
                ACCEPTED
            }
            176 if px4 => match (c.param2, c.param3) {
                (6.0, _) => {
                    let recent = self.setpoints.iter().filter(|(at_ns, _)| now_ns - at_ns <= SECOND);
                    if recent.count() < 2 {
                        return DENIED;
                    }
                    (self.mode, self.failsafe) = (Mode::External, false);
                    ACCEPTED
                }
                (4.0, 3.0) => {
                    self.mode = Mode::Loiter;
                    ACCEPTED
                }
                _ => DENIED,
            },
            176 => {
                self.mode = match (c.param1, c.param2) {
                    (1.0, 4.0) => Mode::External,
                    (1.0, 17.0) => Mode::Brake,
                    _ => return DENIED,
                };
                ACCEPTED
            }
            21 => {
                self.mode = Mode::Land;
                ACCEPTED
            }
            511 => {
                let id = c.param1 as u32;
                self.wanted_messages.push(id);
                if !self.keeps_slow && [30, 32].contains(&id) {
                    self.slowed_to_steps = None;
                }
                ACCEPTED
            }
            512 => {
                self.replies.push(match c.param1 as u32 {
                    49 => self.origin(),
                    _ => self.home_position(),
                });
                ACCEPTED
            }
            _ => MavResult::MAV_RESULT_UNSUPPORTED,
        }
    }
}

/// Longest gap between setpoints from `from_ns` on.
pub fn longest_gap_ns(setpoints: &[(Nanos, [f32; 4])], from_ns: Nanos) -> Nanos {
    let at: Vec<Nanos> = setpoints.iter().map(|s| s.0).filter(|at| *at >= from_ns).collect();
    at.windows(2).map(|w| w[1] - w[0]).max().unwrap_or(STEP_NS)
}

/// The limit for the guidance computer alone, and those for everybody.
const OWN_TIMEOUT: &str = "VGL_OF_LOSS_T";
const TIMEOUTS: [&str; 2] = ["COM_OF_LOSS_T", "GUID_TIMEOUT"];
