//! A vehicle for tests: speaks PX4's MAVLink as the protocol's documentation has it, obeys at once, and sees no obstacle.
#![allow(dead_code, reason = "each test program uses a part")]

#[path = "../../io/tests/common/mod.rs"]
pub mod instance;

use std::fs::File;
use std::net::{SocketAddr, UdpSocket};
use std::os::fd::OwnedFd;
use std::path::Path;
use std::time::Duration;
use vigil_detector::FrozenDetector;
use vigil_firmware::stack::TickInput;
use vigil_firmware::step::Firmware;
use vigil_firmware::{FirmwareConfig, LockstepFirmware};
use vigil_io::Link;
use vigil_io::links::PeerRule;
use vigil_mavlink::MavHeader;
use vigil_mavlink::common::{
    COMMAND_LONG_DATA, MavAutopilot, MavCmd, MavLandedState, MavMessage, MavModeFlag, MavParamType, MavResult,
    MavState, MavType, SET_POSITION_TARGET_LOCAL_NED_DATA,
};
use vigil_mavlink::framing::{self, FramingCounters};
use vigil_mavlink::message;
use vigil_types::{
    Attitude, DEPTH_COLS, DEPTH_FULL_SCALE_M, Datagrams, DepthFrame, FrameKey, GuidanceState, Nanos, NedVector,
    PilotKind, STEP_NS, STEP_S, StepReport, StepTiming, column_bearing_rad, row_elevation_rad,
};

/// A generator whose stream never changes (xorshift64*).
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }
}

/// Bounds every wait; far above what any of them takes.
pub const PATIENCE: Duration = Duration::from_secs(20);

pub const SECOND: Nanos = 1_000_000_000;
/// Whose link takes any vehicle for its peer.
pub const VEHICLE: PeerRule = PeerRule::Vehicle { system: None };

/// A port of this machine that is free.
pub fn loopback() -> SocketAddr {
    ([127, 0, 0, 1], 0).into()
}

/// A port of this machine that is free at this moment.
pub fn free_port() -> u16 {
    UdpSocket::bind(loopback()).unwrap().local_addr().unwrap().port()
}

/// A socket on this machine that waits for nobody.
pub fn socket() -> UdpSocket {
    let socket = UdpSocket::bind(loopback()).unwrap();
    socket.set_nonblocking(true).unwrap();
    socket
}

/// The datagrams that a socket has now. On the loopback interface one has arrived when its sending returns.
pub fn arrived(socket: &UdpSocket) -> Vec<Vec<u8>> {
    let mut buffer = [0; 2048];
    let next = std::iter::from_fn(|| socket.recv(&mut buffer).ok().map(|len| buffer[..len].to_vec()));
    next.collect()
}

/// The messages of one kind among those that somebody heard.
#[macro_export]
macro_rules! only {
    ($heard:expr, $kind:ident) => {
        $heard.into_iter().filter_map(|(_, message)| match message {
            vigil_mavlink::MavMessage::$kind(found) => Some(found),
            _ => None,
        })
    };
}

/// A ground station's wish that a parameter of the guidance computer has this value.
pub fn set_parameter(name: &str, param_value: f32, param_type: MavParamType) -> MavMessage {
    message!(
        PARAM_SET,
        param_value,
        target_system = 1,
        target_component = 191,
        param_id = name.into(),
        param_type
    )
}

/// The datagrams that a link has for us now.
pub fn heard(link: &mut impl Link, now_ns: Nanos) -> Vec<Vec<u8>> {
    let mut received = Datagrams::default();
    link.receive(now_ns, &mut received);
    received.iter().map(|(_, datagram)| datagram.to_vec()).collect()
}

/// Sends these datagrams over a link.
pub fn say<D: AsRef<[u8]>>(link: &mut impl Link, datagrams: &[D]) {
    let mut sent = Datagrams::default();
    let mut bytes = datagrams.iter().map(AsRef::as_ref);
    assert!(bytes.all(|datagram| sent.push(0, datagram)));
    link.send(&sent);
}

/// A step of the flight stack over a link.
pub fn step_over(
    firmware: &mut Firmware,
    link: &mut impl Link,
    (now_ns, step): (Nanos, u64),
    frame: Option<&DepthFrame>,
) -> StepReport {
    let mut received = Datagrams::default();
    link.receive(now_ns, &mut received);
    let input = TickInput {
        now_ns,
        timing: StepTiming::of_step(step),
        frame,
        frame_known_altered: false,
        received: &received,
    };
    *firmware.step(&input, |sent| link.send(sent))
}

/// A serial line: `device` is what the firmware opens, `master` the end of the cable.
pub struct PseudoTerminal {
    pub device: String,
    pub master: File,
}

impl PseudoTerminal {
    pub fn open() -> Self {
        use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
        let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
        let master = openpt(flags).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        rustix::io::ioctl_fionbio(&master, true).unwrap();
        let device = ptsname(&master, Vec::new()).unwrap().into_string().unwrap();
        Self {
            device,
            master: master.into(),
        }
    }

    /// The device's own end, to look at. Open it before the firmware does, which wants it for itself.
    pub fn other_end(&self) -> OwnedFd {
        use rustix::fs::{Mode, OFlags, open};
        open(&*self.device, OFlags::RDWR | OFlags::NOCTTY, Mode::empty()).unwrap()
    }
}

/// A configuration that engages by itself and flies to a goal 20 m ahead and 5 m to the right.
pub fn config() -> FirmwareConfig {
    let mut config = FirmwareConfig::to_goal(NedVector::new(20.0, 5.0, -2.5));
    // These frames are made by hand; the actor knows those of the LiDAR.
    config.pilot.kind = PilotKind::Geometric;
    config
}

/// A detector of the actor built in whose score is always 0.5: what the verdict is, a test chooses by the threshold.
pub fn undecided_detector() -> FrozenDetector {
    let mut detector = FrozenDetector::built_in().unwrap();
    detector.params.fill(0.0);
    (detector.threshold, detector.seed) = (0.6, 0);
    detector
}

/// The same flight, flown by the actor under [`undecided_detector`], whose verdict is clean.
pub fn monitored_config(folder: &Path) -> FirmwareConfig {
    let file = folder.join("undecided.safetensors");
    undecided_detector().save(&file).unwrap();
    let mut config = config();
    config.pilot.kind = PilotKind::Actor;
    (config.detector.enabled, config.detector.file) = (Some(true), Some(file));
    config
}

pub const SENSOR_ID: u32 = 1;
pub const SYSTEM_ID: u8 = 1;

/// PX4's flight modes as (main, sub) of its custom mode.
pub const OFFBOARD: (u8, u8) = (6, 0);
pub const TAKEOFF: (u8, u8) = (4, 2);
pub const LOITER: (u8, u8) = (4, 3);
pub const LAND: (u8, u8) = (4, 6);
/// Northwards, through whatever stands there.
pub const MISSION: (u8, u8) = (4, 4);

#[derive(Default)]
pub struct TestVehicle {
    pub position_ned_m: NedVector,
    pub velocity_ned_m_s: NedVector,
    pub yaw_rad: f32,
    /// What it reports is turned by so much, though its rates, reported then, do not turn it.
    pub heading_error_rad: f32,
    pub mode: (u8, u8),
    pub armed: bool,
    /// Setpoints received, newest last.
    pub setpoints: Vec<SET_POSITION_TARGET_LOCAL_NED_DATA>,
    /// Everything else received, newest last, with its sender.
    pub heard: Vec<(MavHeader, MavMessage)>,
    pub bad_packets: u64,
    sequence: u8,
    frames: u64,
    steps: u64,
    acks: Vec<MavMessage>,
}

impl TestVehicle {
    pub fn on_ground() -> Self {
        Self {
            mode: LOITER,
            ..Self::default()
        }
    }

    pub fn hovering(height_m: f32) -> Self {
        Self {
            position_ned_m: NedVector::new(0.0, 0.0, -height_m),
            armed: true,
            ..Self::on_ground()
        }
    }

    pub fn is_in_air(&self) -> bool {
        self.position_ned_m.z < -0.2
    }

    /// Takes what the firmware sent.
    pub fn hear(&mut self, datagram: &[u8]) {
        let mut found = 0;
        for packet in framing::packets(datagram, &mut FramingCounters::default()) {
            found += 1;
            let message = packet.message().expect("the firmware sends what the dialect knows");
            let header = packet.header();
            match message {
                MavMessage::SET_POSITION_TARGET_LOCAL_NED(setpoint) => self.setpoints.push(setpoint),
                MavMessage::COMMAND_LONG(command) => {
                    self.obey(&command, header);
                    self.heard.push((header, MavMessage::COMMAND_LONG(command)));
                }
                other => self.heard.push((header, other)),
            }
        }
        if found != 1 {
            self.bad_packets += 1;
        }
    }

    fn obey(&mut self, command: &COMMAND_LONG_DATA, from: MavHeader) {
        let mut result = MavResult::MAV_RESULT_ACCEPTED;
        match command.command {
            MavCmd::MAV_CMD_COMPONENT_ARM_DISARM => self.armed = command.param1 > 0.5,
            MavCmd::MAV_CMD_NAV_TAKEOFF => self.mode = TAKEOFF,
            MavCmd::MAV_CMD_NAV_LAND => self.mode = LAND,
            MavCmd::MAV_CMD_DO_SET_MODE => {
                let mode = (command.param2 as u8, command.param3 as u8);
                // PX4 refuses OFFBOARD without a stream of setpoints.
                if mode == OFFBOARD && self.setpoints.is_empty() {
                    result = MavResult::MAV_RESULT_TEMPORARILY_REJECTED;
                } else {
                    self.mode = mode;
                }
            }
            _ => result = MavResult::MAV_RESULT_UNSUPPORTED,
        }
        let command = command.command;
        let (target_system, target_component) = (from.system_id as u8, from.component_id);
        self.acks
            .push(message!(COMMAND_ACK, command, result, target_system, target_component));
    }

    /// Flies for one step.
    pub fn advance(&mut self) {
        self.velocity_ned_m_s = match (self.armed, self.mode) {
            (false, _) => NedVector::ZERO,
            (true, TAKEOFF) if self.position_ned_m.z > -2.5 => NedVector::new(0.0, 0.0, -1.0),
            (true, TAKEOFF) => {
                self.mode = LOITER;
                NedVector::ZERO
            }
            (true, LAND) if self.is_in_air() => NedVector::new(0.0, 0.0, 0.7),
            (true, LAND) => {
                self.armed = false;
                NedVector::ZERO
            }
            (true, OFFBOARD) => self.setpoints.last().map_or(NedVector::ZERO, |s| {
                self.yaw_rad += s.yaw_rate * STEP_S;
                vigil_types::HeadingVector::new(s.vx, s.vy, s.vz).to_ned(self.yaw_rad + self.heading_error_rad)
            }),
            (true, MISSION) => NedVector::new(1.5, 0.0, 0.0),
            _ => NedVector::ZERO,
        };
        self.position_ned_m = self.position_ned_m + self.velocity_ned_m_s * STEP_S;
        self.steps += 1;
    }

    /// What it sends in this step: each packet in a datagram of its own.
    pub fn telemetry(&mut self) -> Datagrams {
        let mut sent = Datagrams::default();
        let time_boot_ms = (self.steps * STEP_NS / 1_000_000) as u32;
        let mut base_mode = MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED;
        base_mode.set(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED, self.armed);
        let custom_mode = u32::from(self.mode.0) << 16 | u32::from(self.mode.1) << 24;
        let (mavtype, autopilot) = (MavType::MAV_TYPE_QUADROTOR, MavAutopilot::MAV_AUTOPILOT_PX4);
        let system_status = MavState::MAV_STATE_ACTIVE;
        let [x, y, z] = self.position_ned_m.to_array();
        let [vx, vy, vz] = self.velocity_ned_m_s.to_array();
        let Attitude {
            w: q1,
            x: q2,
            y: q3,
            z: q4,
        } = self.attitude();
        // A gyroscope is never quite still; without an error the field is not filled.
        let rollspeed = 1e-4 * self.heading_error_rad;
        let fills_rates = f32::from(self.heading_error_rad != 0.0);
        let yawspeed = self.setpoints.last().map_or(0.0, |s| s.yaw_rate * fills_rates);
        let landed_state = match self.is_in_air() {
            true => MavLandedState::MAV_LANDED_STATE_IN_AIR,
            false => MavLandedState::MAV_LANDED_STATE_ON_GROUND,
        };
        let messages = [
            message!(
                HEARTBEAT,
                custom_mode,
                mavtype,
                autopilot,
                base_mode,
                system_status,
                mavlink_version = 3
            ),
            message!(LOCAL_POSITION_NED, time_boot_ms, x, y, z, vx, vy, vz),
            message!(ATTITUDE_QUATERNION, time_boot_ms, q1, q2, q3, q4, rollspeed, yawspeed),
            message!(EXTENDED_SYS_STATE, landed_state),
        ];
        for message in messages.into_iter().chain(std::mem::take(&mut self.acks)) {
            assert!(sent.push(0, &framing::encode((SYSTEM_ID, 1), self.sequence, &message)));
            self.sequence = self.sequence.wrapping_add(1);
        }
        sent
    }

    fn attitude(&self) -> Attitude {
        Attitude::from_euler_rad(0.0, 0.0, self.yaw_rad + self.heading_error_rad)
    }

    /// What it sees: level ground that is never nearer than half a metre below it, and open space.
    pub fn frame(&mut self, now_ns: Nanos) -> Box<DepthFrame> {
        self.frame_with_wall(now_ns, f32::INFINITY)
    }

    /// The same with a wall that stands across the whole field of view, this far north of the local origin.
    pub fn frame_with_wall(&mut self, now_ns: Nanos, wall_north_m: f32) -> Box<DepthFrame> {
        let mut frame = Box::new(DepthFrame::EMPTY);
        frame.header.stamp_ns = now_ns;
        frame.header.sequence = self.frames;
        frame.header.sensor_id = SENSOR_ID;
        frame.header.position_ned_m = self.position_ned_m;
        frame.header.attitude = self.attitude();
        let height_m = (-self.position_ned_m.z).max(0.5);
        for (row, pixels) in frame.depth.chunks_exact_mut(DEPTH_COLS).enumerate() {
            let range_m = height_m / (-row_elevation_rad(row as f32)).sin();
            if (0.0..60.0).contains(&range_m) {
                pixels.fill(range_m / DEPTH_FULL_SCALE_M);
            }
            for (col, pixel) in pixels.iter_mut().enumerate() {
                let bearing_rad = self.yaw_rad + column_bearing_rad(col as f32);
                let north = row_elevation_rad(row as f32).cos() * bearing_rad.cos();
                let wall_m = (wall_north_m - self.position_ned_m.x) / north;
                if (0.1..60.0).contains(&wall_m) {
                    *pixel = pixel.min(wall_m / DEPTH_FULL_SCALE_M);
                }
            }
        }
        frame.seal();
        self.frames += 1;
        frame
    }
}

/// Vehicle and firmware in step; either side's contribution can be left out of a step.
pub struct Flight {
    pub vehicle: TestVehicle,
    pub firmware: LockstepFirmware,
    /// The key with which the sensor's driver authenticates frames.
    pub driver: Option<FrameKey>,
    pub now_ns: Nanos,
    pub last: StepReport,
    pub sent: Datagrams,
}

impl Flight {
    pub fn new(vehicle: TestVehicle, config: &FirmwareConfig) -> Self {
        Self::of(vehicle, LockstepFirmware::new(config).unwrap())
    }

    pub fn of(vehicle: TestVehicle, firmware: LockstepFirmware) -> Self {
        Self {
            vehicle,
            firmware,
            driver: None,
            now_ns: SECOND,
            last: StepReport::default(),
            sent: Datagrams::default(),
        }
    }

    pub fn step_with(&mut self, frame: Option<&DepthFrame>, telemetry: &Datagrams) -> StepReport {
        self.last = *self.firmware.step(self.now_ns, frame, telemetry, &mut self.sent);
        for (_, datagram) in self.sent.iter() {
            self.vehicle.hear(datagram);
        }
        self.vehicle.advance();
        self.now_ns += STEP_NS;
        self.last
    }

    /// A step with a frame of the driver, which somebody alters on its way.
    pub fn step_altered(&mut self, alter: impl FnOnce(&mut DepthFrame)) -> StepReport {
        let (mut frame, telemetry) = (self.vehicle.frame(self.now_ns), self.vehicle.telemetry());
        if let Some(key) = &self.driver {
            frame.authenticate(key);
        }
        alter(&mut frame);
        self.step_with(Some(&frame), &telemetry)
    }

    pub fn step(&mut self) -> StepReport {
        self.step_altered(|_| {})
    }

    pub fn until(&mut self, state: GuidanceState, limit_s: f64) {
        let deadline_ns = self.now_ns + (limit_s * 1e9) as Nanos;
        while self.last.state != state {
            assert!(self.now_ns < deadline_ns, "not {state:?} in time: {:?}", self.last);
            self.step();
        }
    }
}
