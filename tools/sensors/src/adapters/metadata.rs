//! An Ouster sensor as its metadata file describes it: what the sensor's own web page and its tools save as JSON.
//!
//! Source: Ouster, *Software User Manual*, "Sensor metadata" and "Lidar range to XYZ". Files of both shapes are read: flat as firmware 2
//! wrote them, and in groups as from firmware 3 on.

use serde_json::Value;
use std::ops::RangeInclusive;
use vigil_types::FrdVector;

/// What a metadata file lacks, and what to do.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{0}")]
pub struct MetadataError(String);

/// A scanner's beams and packets.
#[derive(Debug, Clone, PartialEq)]
pub struct OusterDevice {
    /// Columns of a turn.
    pub columns: usize,
    /// Columns of a packet.
    pub columns_per_packet: usize,
    /// Turns in a second.
    pub rate_hz: f32,
    /// Sine and cosine of each beam's elevation, and of its bearing beside its column's.
    beams: Vec<[f32; 4]>,
    altitudes_deg: Vec<f32>,
    /// Sine and cosine of each column's angle.
    angles: Vec<[f32; 2]>,
    /// Distance of the beams' origin from the axis, metres.
    origin_m: f32,
    /// Rotation and translation from the axes of the measurement into the sensor's (forward, left, up), metres.
    to_sensor: [[f32; 4]; 3],
}

/// Where a field may stand, if not at the top: it depends on the version of the sensor's software.
const GROUPS: [&str; 6] = [
    "beam_intrinsics",
    "lidar_intrinsics",
    "lidar_data_format",
    "data_format",
    "config_params",
    "sensor_info",
];

impl OusterDevice {
    /// Reads a metadata file's text.
    ///
    /// # Errors
    /// [`MetadataError`].
    pub fn from_metadata(text: &str) -> Result<Self, MetadataError> {
        let root: Value =
            serde_json::from_str(text).map_err(|e| MetadataError(format!("the metadata file is no JSON: {e}")))?;
        let find = |field: &str| {
            let inner = || GROUPS.iter().find_map(|group| root.get(group)?.get(field));
            root.get(field).or_else(inner)
        };
        let wrong = |field: &str, expected: &str| {
            let what = match find(field) {
                Some(_) => format!("wrong, {expected} was expected: save it from the sensor again"),
                // As in files of the first firmware.
                None => "missing: update the sensor's firmware to 2.0 or newer, and save it again".to_owned(),
            };
            MetadataError(format!("the metadata file's `{field}` is {what}"))
        };
        if let Some(profile) = find("udp_profile_lidar").and_then(Value::as_str)
            && profile != "LEGACY"
        {
            return Err(MetadataError(format!(
                "the sensor sends the packet format {profile}; this adapter reads LEGACY: set udp_profile_lidar to LEGACY"
            )));
        }
        let mode = find("lidar_mode").and_then(Value::as_str);
        let mode = mode.and_then(|mode| mode.split_once('x'));
        let (columns, rate) = mode.ok_or_else(|| wrong("lidar_mode", "a mode as 1024x20"))?;
        let columns = columns.parse().ok().filter(|n| [512, 1024, 2048, 4096].contains(n));
        let rate_hz = rate.parse().ok().filter(|hz| [5.0, 10.0, 20.0].contains(hz));
        let list = |field, expected, count: RangeInclusive<usize>, most: f64| {
            let number = |v: &Value| v.as_f64().filter(|v| v.abs() <= most).map(|v| v as f32);
            let list = find(field).and_then(Value::as_array);
            let values: Option<Vec<f32>> = list.and_then(|list| list.iter().map(number).collect());
            let values = values.filter(|list| count.contains(&list.len()));
            values.ok_or_else(|| wrong(field, expected))
        };
        let each = "a list of 16 to 128 angles in degrees";
        let altitudes_deg = list("beam_altitude_angles", each, 16..=128, 90.0)?;
        let beams = altitudes_deg.len();
        let each = "as many angles in degrees as there are altitudes";
        let azimuths_deg = list("beam_azimuth_angles", each, beams..=beams, 90.0)?;
        let stated = find("pixels_per_column").and_then(Value::as_u64);
        if stated.is_some_and(|stated| stated != beams as u64) {
            return Err(wrong("pixels_per_column", "the number of beams"));
        }
        let per_packet = find("columns_per_packet").map_or(Some(16), Value::as_u64);
        let origin_mm = find("lidar_origin_to_beam_origin_mm").and_then(Value::as_f64);
        let matrix = list("lidar_to_sensor_transform", "16 numbers, row by row", 16..=16, 1e4)?;
        let columns: usize = columns.ok_or_else(|| wrong("lidar_mode", "512, 1024, 2048 or 4096 columns"))?;
        let beam = |(altitude, azimuth): (&f32, &f32)| {
            let ((se, ce), (sa, ca)) = (altitude.to_radians().sin_cos(), (-azimuth).to_radians().sin_cos());
            [se, ce, sa, ca]
        };
        let angle = |column: usize| {
            let angle = std::f64::consts::TAU * (1.0 - column as f64 / columns as f64);
            [angle.sin() as f32, angle.cos() as f32]
        };
        Ok(Self {
            columns,
            columns_per_packet: per_packet
                .and_then(|n| usize::try_from(n).ok())
                .filter(|n| (1..=64).contains(n) && columns.is_multiple_of(*n))
                .ok_or_else(|| wrong("columns_per_packet", "a part of the columns"))?,
            rate_hz: rate_hz.ok_or_else(|| wrong("lidar_mode", "5, 10 or 20 turns a second"))?,
            beams: altitudes_deg.iter().zip(&azimuths_deg).map(beam).collect(),
            altitudes_deg,
            angles: (0..columns).map(angle).collect(),
            origin_m: origin_mm
                .filter(|mm| (-100.0..=100.0).contains(mm))
                .ok_or_else(|| wrong("lidar_origin_to_beam_origin_mm", "millimetres"))? as f32
                * 1e-3,
            to_sensor: std::array::from_fn(|row| {
                let m = |column: usize| matrix[4 * row + column];
                [m(0), m(1), m(2), m(3) * 1e-3]
            }),
        })
    }

    /// Beams of a column.
    pub fn beams(&self) -> usize {
        self.beams.len()
    }

    /// The widest angle between neighbouring beams, degrees: across and down.
    pub fn resolution_deg(&self) -> (f32, f32) {
        let mut altitudes = self.altitudes_deg.clone();
        altitudes.sort_by(f32::total_cmp);
        let widest = altitudes.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f32::max);
        (360.0 / self.columns as f32, widest)
    }

    /// The point that a beam of a column measured, in the sensor's axes (forward, right, down), metres.
    #[inline]
    pub(crate) fn point_frd_m(&self, column: usize, beam: usize, range_mm: u32) -> Option<FrdVector> {
        let [sin, cos] = *self.angles.get(column)?;
        let [se, ce, sa, ca] = *self.beams.get(beam)?;
        let n = self.origin_m;
        let r = range_mm as f32 * 1e-3 - n;
        let x = r * ce * (cos * ca - sin * sa) + n * cos;
        let y = r * ce * (sin * ca + cos * sa) + n * sin;
        let z = r * se;
        let [forward, left, up] = self.to_sensor.map(|[a, b, c, d]| a * x + b * y + c * z + d);
        Some(FrdVector::new(forward, -left, -up))
    }
}
