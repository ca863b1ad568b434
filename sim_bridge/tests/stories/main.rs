//! Stories of the whole simulator.

mod simulator;
mod vehicle_links;
mod vehicle_models;

use vigil_mavlink::framing::encode_payload;

/// A COMMAND_LONG to the vehicle.
fn command(from: (u8, u8), number: u16, params: [f32; 7]) -> Vec<u8> {
    let mut payload: Vec<u8> = params.iter().flat_map(|p| p.to_le_bytes()).collect();
    payload.extend_from_slice(&number.to_le_bytes());
    payload.extend_from_slice(&[1, 1, 0]);
    encode_payload(from, 0, 76, &payload).expect("fits")
}
