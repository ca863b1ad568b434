//! MAVLink packets that are not what the dialect's types hold.

use vigil_mavlink::framing::encode_payload;

/// A COMMAND_LONG to the vehicle.
pub fn command(from: (u8, u8), number: u16, params: [f32; 7]) -> Vec<u8> {
    let mut payload: Vec<u8> = params.iter().flat_map(|p| p.to_le_bytes()).collect();
    payload.extend_from_slice(&number.to_le_bytes());
    payload.extend_from_slice(&[1, 1, 0]);
    encode_payload(from, 0, 76, &payload).expect("fits")
}
