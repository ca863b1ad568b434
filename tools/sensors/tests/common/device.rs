//! A scanner as it would send: written from the manufacturer's description of packets and angles, without the adapter's code.

use vigil_sim::world::World;
use vigil_types::{Attitude, FrdVector, NedVector};

use super::rays;

/// Columns of a turn, and of a packet.
pub const COLUMNS: usize = 1024;
pub const PER_PACKET: usize = 16;
/// Time of a column: 20 turns in a second.
pub const COLUMN_NS: u64 = 50_000_000 / COLUMNS as u64;
const ORIGIN_M: f64 = 0.027_67;
const SENSOR_UP_M: f64 = 0.036_18;
const REACH_M: f64 = 60.0;

/// A scanner of `beams` beams over ±45°, staggered as such sensors are.
pub struct Device {
    altitudes_deg: Vec<f64>,
    azimuths_deg: Vec<f64>,
    /// Where it sits on the vehicle, and how it is turned.
    pub mount: (FrdVector, Attitude),
    /// Its clock when the machine's reads 0, and whose turn it is.
    pub clock_ns: i64,
}

impl Device {
    pub fn new(beams: usize, mount: (FrdVector, Attitude)) -> Self {
        Self {
            altitudes_deg: (0..beams)
                .map(|i| 45.0 - 90.0 * (i as f64 + 0.5) / beams as f64)
                .collect(),
            azimuths_deg: (0..beams).map(|i| [3.1, 1.0, -1.1, -3.2][i % 4]).collect(),
            mount,
            clock_ns: 77_000_000_000,
        }
    }

    /// Its metadata file, flat or in groups.
    pub fn metadata(&self, in_groups: bool) -> String {
        let beams = self.altitudes_deg.len();
        let list = |values: &[f64]| {
            let values: Vec<String> = values.iter().map(f64::to_string).collect();
            format!("[{}]", values.join(", "))
        };
        let beam = format!(
            r#""beam_altitude_angles": {}, "beam_azimuth_angles": {}, "lidar_origin_to_beam_origin_mm": 27.67"#,
            list(&self.altitudes_deg),
            list(&self.azimuths_deg)
        );
        let turn = r#""lidar_to_sensor_transform": [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 36.18, 0, 0, 0, 1]"#;
        let format = format!(
            r#""pixels_per_column": {beams}, "columns_per_packet": 16, "columns_per_frame": 1024, "udp_profile_lidar": "LEGACY""#
        );
        match in_groups {
            true => format!(
                r#"{{"beam_intrinsics": {{{beam}}}, "lidar_intrinsics": {{{turn}}}, "lidar_data_format": {{{format}}},
                    "config_params": {{"lidar_mode": "1024x20", "udp_profile_lidar": "LEGACY"}}}}"#
            ),
            false => format!(
                r#"{{"prod_line": "OS-0", "lidar_mode": "1024x20", {beam}, {turn}, "data_format": {{{format}}}}}"#
            ),
        }
    }

    /// The packets of one turn on a course from a standing vehicle: in the middle of the turn, when it looks ahead, the machine's clock
    /// reads `ahead_ns`. Only what lies within 72° of the nose is cast; beside and behind it nothing returns.
    pub fn turn(&self, world: &World, pose: (NedVector, Attitude), number: u16, ahead_ns: u64) -> Vec<Vec<u8>> {
        (0..COLUMNS / PER_PACKET)
            .map(|packet| {
                let columns = packet * PER_PACKET..(packet + 1) * PER_PACKET;
                columns
                    .flat_map(|column| self.column(world, pose, number, ahead_ns, column))
                    .collect()
            })
            .collect()
    }

    fn column(&self, world: &World, pose: (NedVector, Attitude), number: u16, ahead_ns: u64, column: usize) -> Vec<u8> {
        let since_ns = column as i64 * COLUMN_NS as i64 - 25_000_000;
        let stamp_ns = ahead_ns as i64 + self.clock_ns + since_ns;
        let mut bytes = Vec::new();
        bytes.extend((stamp_ns as u64).to_le_bytes());
        bytes.extend((column as u16).to_le_bytes());
        bytes.extend(number.to_le_bytes());
        bytes.extend((column as u32 * 90_112 / COLUMNS as u32).to_le_bytes());
        for beam in 0..self.altitudes_deg.len() {
            let is_front = (3 * COLUMNS / 10..7 * COLUMNS / 10).contains(&column);
            let range_mm = is_front
                .then(|| self.range_mm(world, pose, column, beam))
                .flatten()
                .unwrap_or(0);
            // Beside the range's 20 bits the word and the others hold what is not ours.
            bytes.extend((range_mm | 0x0a50_0000).to_le_bytes());
            bytes.extend([0x5a; 8]);
        }
        bytes.extend([0xff; 4]);
        bytes
    }

    fn range_mm(
        &self,
        world: &World,
        (position, attitude): (NedVector, Attitude),
        column: usize,
        beam: usize,
    ) -> Option<u32> {
        let turned = std::f64::consts::TAU * (1.0 - column as f64 / COLUMNS as f64);
        let elevation = self.altitudes_deg[beam].to_radians();
        let bearing = turned - self.azimuths_deg[beam].to_radians();
        // Axes of the measurement: forward is where column 0 looks, the sensor's back; left; up.
        let from = [ORIGIN_M * turned.cos(), ORIGIN_M * turned.sin(), 0.0];
        let along = [
            elevation.cos() * bearing.cos(),
            elevation.cos() * bearing.sin(),
            elevation.sin(),
        ];
        // The sensor's axes are turned by half a turn; ours are forward, right, down.
        let frd = |v: [f64; 3]| FrdVector::new(-v[0] as f32, v[1] as f32, -v[2] as f32);
        let from = frd([from[0], from[1], SENSOR_UP_M]);
        let (offset, turn) = self.mount;
        let origin = position + attitude.to_ned(offset + rays::in_vehicle(turn, from));
        let direction = attitude.to_ned(rays::in_vehicle(turn, frd(along)));
        let (range_m, _) = rays::cast(world, origin, direction)?;
        // The range is measured from where the axis is, not from where the beam leaves.
        (range_m < REACH_M).then(|| ((range_m + ORIGIN_M) * 1e3).round() as u32)
    }
}
