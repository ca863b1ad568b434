//! AUTOPILOT_VERSION and PROTOCOL_VERSION: who this is and what it can do; and SETUP_SIGNING: a new key for MAVLink signing. The
//! links put it into force; it is never passed on. <https://mavlink.io/en/messages/common.html#SETUP_SIGNING>

use crate::core::SigningSetup;
use crate::service::prelude::*;
use vigil_mavlink::common::MavProtocolCapability as Capability;

pub(super) const MESSAGES: &[Produced] = &[
    Produced::from(AUTOPILOT_VERSION_DATA::ID, [0.0; 3], autopilot_version),
    Produced::from(PROTOCOL_VERSION_DATA::ID, [0.0; 3], protocol_version),
];

/// The PX4 whose answers are given: 1.18.0, a release (255).
const DIALECT_OF_PX4: u32 = 1 << 24 | 18 << 16 | 255;

/// Vigil's own version as MAVLink packs one: major, minor, patch, type.
fn own_version() -> u32 {
    let part = |text: &str| text.parse::<u32>().unwrap_or(0) & 0xFF;
    part(env!("CARGO_PKG_VERSION_MAJOR")) << 24
        | part(env!("CARGO_PKG_VERSION_MINOR")) << 16
        | part(env!("CARGO_PKG_VERSION_PATCH")) << 8
}

fn autopilot_version(core: &Core) -> Option<MavMessage> {
    // A bit stands here only if a service answers for it.
    let capabilities = Capability::MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        | Capability::MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
        | Capability::MAV_PROTOCOL_CAPABILITY_FTP
        | Capability::MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
        | Capability::MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
        | Capability::MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
        | Capability::MAV_PROTOCOL_CAPABILITY_FLIGHT_TERMINATION
        | Capability::MAV_PROTOCOL_CAPABILITY_MISSION_INT
        | Capability::MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
        | Capability::MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
        | Capability::MAV_PROTOCOL_CAPABILITY_MAVLINK2;
    let uid = u64::from(core.id().system);
    let mut uid2 = [0; 18];
    uid2[0] = core.id().system;
    Some(message!(
        AUTOPILOT_VERSION,
        capabilities,
        uid,
        flight_sw_version = DIALECT_OF_PX4,
        middleware_sw_version = own_version(),
        os_sw_version = own_version(),
        flight_custom_version = *b"vigil\0\0\0",
        uid2
    ))
}

fn protocol_version(_core: &Core) -> Option<MavMessage> {
    let (version, min_version, max_version) = (200, 100, 200);
    Some(message!(PROTOCOL_VERSION, version, min_version, max_version))
}

pub(super) fn set_up(m: SETUP_SIGNING_DATA, _source: Source, core: &mut Core) {
    // To everybody or to another system: a key is given to one component.
    if (m.target_system, m.target_component) != (core.id().system, core.id().component) {
        return;
    }
    if m.secret_key == [0; 32] {
        return core.warn_refused("signing key refused: all zeros");
    }
    core.signing_setup = Some(SigningSetup {
        key: m.secret_key,
        initial_timestamp: m.initial_timestamp,
    });
    core.inform("signing key accepted");
}
