//! A MAVLink message as anybody sends it.

use vigil_mavlink::MavMessage;
use vigil_mavlink::framing::{MAX_PACKET_LEN, serialize};
use vigil_mavlink::mavlink::MavHeader;

pub fn header((system_id, component_id): (u8, u8)) -> MavHeader {
    MavHeader {
        system_id: system_id.into(),
        component_id,
        sequence: 0,
    }
}

/// A message of a system and component.
pub fn packet(from: (u8, u8), message: &MavMessage) -> Vec<u8> {
    let mut out = [0; MAX_PACKET_LEN];
    let len = serialize(header(from), message, &mut out).expect("fits");
    out[..len].to_vec()
}
