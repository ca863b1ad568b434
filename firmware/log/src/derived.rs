//! What follows from a log's records and is worth seeing: the map and the way that a pilot had, and what pixels did to the actor's
//! decision. It is computed after the flight, by replay: the loop knows nothing of it.

use crate::display::{self, MAP_FRAME};
use crate::log_file::topic;
use crate::proto::foxglove::packed_element_field::NumericType;
use crate::proto::foxglove::{Grid, PackedElementField, PosesInFrame, Vector2, Vector3};
use crate::side::{SideError, SideFile};
use std::path::Path;
use vigil_types::{DEPTH_COLS, DEPTH_ROWS, Nanos, NedVector};

/// Columns of a picture of SHAP values: each is the sum over 4 × 4 pixels.
pub const SHAP_COLS: usize = DEPTH_COLS / 4;
/// Its rows.
pub const SHAP_ROWS: usize = DEPTH_ROWS / 4;

/// A pilot's map at a moment.
#[derive(Debug, Clone, Copy)]
pub struct MapSeen<'a> {
    /// NED metres (north, east) of the south-western corner.
    pub corner_ned_m: (f32, f32),
    /// Edge of a cell in metres.
    pub cell_m: f32,
    /// Cells in a row from west to east.
    pub cols: usize,
    /// Evidence of an obstacle, rows from south to north.
    pub scores: &'a [i8],
    /// The greatest score: 100 % in the log.
    pub score_limit: i8,
}

/// A file of derived messages, in the order of their times; [`crate::merge_derived`] puts them into the log and stamps them.
pub struct DerivedLog {
    pub(crate) file: SideFile,
}

impl DerivedLog {
    /// Starts a file beside `log` that has no name: it ends with the process, however that ends.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn create(log: &Path) -> Result<Self, SideError> {
        let kinds = [
            (topic::GRID, "foxglove.Grid"),
            (topic::WAY, "foxglove.PosesInFrame"),
            (topic::SHAP, "foxglove.RawImage"),
        ];
        let sink = tempfile::tempfile_in(vigil_types::files::folder_of(log));
        SideFile::new(log, sink, &kinds).map(|file| Self { file })
    }

    /// A pilot's map at `at_ns` of the loop's clock, drawn on the ground: evidence of an obstacle in percent. `sequence` is the step's.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn map(&mut self, at_ns: Nanos, sequence: u32, seen: &MapSeen<'_>) -> Result<(), SideError> {
        let limit = i32::from(seen.score_limit).max(1);
        let percent = |score: &i8| (i32::from(*score).clamp(0, limit) * 100 / limit) as u8;
        let (north, east) = seen.corner_ned_m;
        let cell_m = f64::from(seen.cell_m);
        let message = Grid {
            timestamp: None,
            frame_id: MAP_FRAME.to_owned(),
            pose: Some(display::unturned_at(Vector3 {
                x: east.into(),
                y: north.into(),
                z: 0.0,
            })),
            column_count: seen.cols as u32,
            cell_size: Some(Vector2 { x: cell_m, y: cell_m }),
            row_stride: seen.cols as u32,
            cell_stride: 1,
            fields: vec![PackedElementField {
                name: "obstacle_percent".to_owned(),
                offset: 0,
                r#type: NumericType::Uint8 as i32,
            }],
            data: seen.scores.iter().map(percent).collect(),
        };
        self.file.put(topic::GRID, (at_ns, sequence), &message)
    }

    /// The way that a pilot planned, NED metres (north, east), at the height of the vehicle.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn way(
        &mut self,
        at_ns: Nanos,
        sequence: u32,
        points_ned_m: &[(f32, f32)],
        down_m: f32,
    ) -> Result<(), SideError> {
        let pose =
            |&(north, east): &(f32, f32)| display::unturned_at(display::map_point(NedVector::new(north, east, down_m)));
        let message = PosesInFrame {
            timestamp: None,
            frame_id: MAP_FRAME.to_owned(),
            poses: points_ned_m.iter().map(pose).collect(),
        };
        self.file.put(topic::WAY, (at_ns, sequence), &message)
    }

    /// What the pixels of the step's frame added to the actor's yaw output: [`SHAP_ROWS`] × [`SHAP_COLS`] sums, action units.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn shap(&mut self, at_ns: Nanos, sequence: u32, sums: &[f32]) -> Result<(), SideError> {
        let data = sums.iter().flat_map(|v| v.to_le_bytes()).collect();
        let message = display::image(SHAP_ROWS, SHAP_COLS, "32FC1", data, None);
        self.file.put(topic::SHAP, (at_ns, sequence), &message)
    }
}
