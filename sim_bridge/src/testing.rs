//! What this crate's tests share: courses, and MAVLink packets as anybody sends them.

use crate::world::Course;
use vigil_mavlink::MavMessage;
use vigil_mavlink::framing::{MAX_PACKET_LEN, SerializeError, serialize, serialize_payload};
use vigil_mavlink::mavlink::MavHeader;

fn header((system_id, component_id): (u8, u8)) -> MavHeader {
    MavHeader {
        system_id: system_id.into(),
        component_id,
        sequence: 0,
    }
}

/// A message of a system and component.
pub(crate) fn packet(from: (u8, u8), message: &MavMessage) -> Vec<u8> {
    let mut out = [0; MAX_PACKET_LEN];
    let len = serialize(header(from), message, &mut out).expect("fits");
    out[..len].to_vec()
}

/// A message of any payload.
pub(crate) fn raw(from: (u8, u8), id: u32, payload: &[u8]) -> Result<Vec<u8>, SerializeError> {
    let mut out = [0; MAX_PACKET_LEN];
    let len = serialize_payload(header(from), id, payload, &mut out)?;
    Ok(out[..len].to_vec())
}

/// A COMMAND_LONG to the vehicle.
pub(crate) fn command(from: (u8, u8), number: u16, params: [f32; 7]) -> Vec<u8> {
    let mut payload: Vec<u8> = params.iter().flat_map(|p| p.to_le_bytes()).collect();
    payload.extend_from_slice(&number.to_le_bytes());
    payload.extend_from_slice(&[1, 1, 0]);
    raw(from, 76, &payload).expect("fits")
}

/// A field with a goal 20 m north and so far east, within so many metres to either side, and what the text puts into it.
pub(crate) fn field(goal_east_m: f32, half_width_m: f32, text: &str) -> Course {
    let text = format!(
        "name = \"test\"\ngoal = {{ north_m = 20.0, east_m = {goal_east_m:?} }}\n\
         bounds = {{ north_m = [-4.0, 26.0], east_m = [{:?}, {half_width_m:?}], top_m = 6.0 }}\n{text}",
        -half_width_m
    );
    Course::from_toml_str(&text, "test").expect("valid")
}
