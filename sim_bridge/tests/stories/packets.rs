//! MAVLink packets that are not what the dialect's types hold.

use crate::packet::header;
use vigil_mavlink::framing::{MAX_PACKET_LEN, SerializeError, serialize_payload};

/// A message of any payload.
pub fn raw(from: (u8, u8), id: u32, payload: &[u8]) -> Result<Vec<u8>, SerializeError> {
    let mut out = [0; MAX_PACKET_LEN];
    let len = serialize_payload(header(from), id, payload, &mut out)?;
    Ok(out[..len].to_vec())
}

/// A COMMAND_LONG to the vehicle.
pub fn command(from: (u8, u8), number: u16, params: [f32; 7]) -> Vec<u8> {
    let mut payload: Vec<u8> = params.iter().flat_map(|p| p.to_le_bytes()).collect();
    payload.extend_from_slice(&number.to_le_bytes());
    payload.extend_from_slice(&[1, 1, 0]);
    raw(from, 76, &payload).expect("fits")
}
