//! The flight log as bytes: ULog, which PX4 writes, so that its tools read it.
//! <https://docs.px4.io/main/en/dev_log/ulog_file_format.html>

use crate::core::Core;
use crate::flight::LandedState;
use crate::vehicle_parameters::ParameterValue;
use vigil_mavlink::common::MavSeverity;

/// Bytes before the first message: magic, version, start.
const HEADER_LEN: usize = 16;
/// Bytes of a message before its payload: size, type.
const MESSAGE_HEADER_LEN: usize = 3;

/// Topics by their number, with names and fields as PX4 has them.
const TOPICS: [(&str, &str); 6] = [
    (
        "vehicle_local_position",
        "float x;float y;float z;float vx;float vy;float vz;float heading;",
    ),
    ("vehicle_attitude", "float[4] q;"),
    (
        "vehicle_status",
        "uint8_t nav_state;uint8_t arming_state;bool failsafe;",
    ),
    ("vehicle_land_detected", "bool landed;"),
    ("battery_status", "float voltage_v;float current_a;float remaining;"),
    ("actuator_motors", "float[4] control;"),
];

fn message(out: &mut Vec<u8>, kind: u8, parts: &[&[u8]]) {
    let len: usize = parts.iter().map(|part| part.len()).sum();
    // No message is longer than a text, a format or a name.
    out.extend_from_slice(&(len as u16).to_le_bytes());
    out.push(kind);
    parts.iter().for_each(|part| out.extend_from_slice(part));
}

fn named(out: &mut Vec<u8>, kind: u8, key: &str, value: &[u8]) {
    message(out, kind, &[&[key.len() as u8], key.as_bytes(), value]);
}

/// The file's beginning: what is in it, whose it is, the parameters.
pub(crate) fn begin(core: &Core) -> Vec<u8> {
    let mut out = b"ULog\x01\x12\x35\x01".to_vec();
    out.extend_from_slice(&core.time_boot_us().to_le_bytes());
    // No flags, nothing appended.
    message(&mut out, b'B', &[&[0; 40]]);
    let text = |out: &mut Vec<u8>, key: &str, value: &str| {
        named(out, b'I', &format!("char[{}] {key}", value.len()), value.as_bytes());
    };
    text(&mut out, "sys_name", "Vigil");
    text(&mut out, "ver_hw", "simulated quadcopter");
    text(&mut out, "ver_sw", env!("CARGO_PKG_VERSION"));
    for (name, fields) in TOPICS {
        let format = format!("{name}:uint64_t timestamp;{fields}");
        message(&mut out, b'F', &[format.as_bytes()]);
    }
    for (info, value) in core.parameters.all() {
        let kind = match value {
            ParameterValue::Integer(_) => "int32_t",
            ParameterValue::Real(_) => "float",
        };
        named(
            &mut out,
            b'P',
            &format!("{kind} {}", info.name),
            &value.on_wire().0.to_le_bytes(),
        );
    }
    for (number, (name, _)) in TOPICS.iter().enumerate() {
        message(&mut out, b'A', &[&[0], &(number as u16).to_le_bytes(), name.as_bytes()]);
    }
    out
}

/// Appends a status text. Levels are those of syslog, as MAVLink's are, in ASCII.
pub(crate) fn text(out: &mut Vec<u8>, core: &Core, severity: MavSeverity, text: &str) {
    let level = [b'0' + severity as u8];
    let time = core.time_boot_us().to_le_bytes();
    message(out, b'L', &[&level, &time, text.as_bytes()]);
}

/// Appends the vehicle's state: one message of each topic.
pub(crate) fn record(out: &mut Vec<u8>, core: &Core) {
    let (c, e, s) = (&core.commander, &core.view.estimate, &core.view.sensors);
    let (p, v, a) = (e.position_ned_m, e.velocity_ned_m_s, e.attitude);
    let floats = |values: &[f32]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    let (_, _, nav_state, ..) = c.mode.px4();
    let state = [nav_state, 1 + u8::from(c.armed), u8::from(c.failsafe.is_some())];
    let contents = [
        floats(&[p.x, p.y, p.z, v.x, v.y, v.z, a.yaw_rad()]),
        floats(&[a.w, a.x, a.y, a.z]),
        state.to_vec(),
        vec![u8::from(c.landed == LandedState::OnGround)],
        floats(&[s.battery_voltage_v, s.battery_current_a, s.battery_remaining]),
        floats(&s.motors),
    ];
    let time = core.time_boot_us().to_le_bytes();
    for (number, content) in contents.iter().enumerate() {
        message(out, b'D', &[&(number as u16).to_le_bytes(), &time, content]);
    }
}

/// The first message that begins at or after `offset`, from one that begins at `known`: offsets into a log.
pub(crate) fn next_message(log: &[u8], known: usize, offset: usize) -> usize {
    let mut at = known.max(HEADER_LEN);
    while at < offset {
        let Some(&[low, high]) = log.get(at..at + 2) else {
            break;
        };
        at += MESSAGE_HEADER_LEN + usize::from(u16::from_le_bytes([low, high]));
    }
    at
}
