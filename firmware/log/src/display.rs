//! What a viewer is shown of a record: standard Foxglove messages and the flat status row.
//!
//! Viewers draw with z up, so everything spatial is turned from NED into the `map` frame (x east, y north, z up, origin
//! at home) and from FRD into `base_link` (x forward, y left, z up). The record beside it keeps the loop's own NED bits.

use crate::TickRecord;
use crate::proto::Status;
use crate::proto::foxglove::log::Level;
use crate::proto::foxglove::{FrameTransform, Log, Pose, PoseInFrame, PosesInFrame, Quaternion, RawImage, Vector3};
use crate::proto::google::protobuf::Timestamp;
use std::f64::consts::FRAC_1_SQRT_2;
use vigil_types::{
    Attitude, DEPTH_COLS, DEPTH_FULL_SCALE_M, DEPTH_PIXELS, DEPTH_ROWS, DepthFrame, GuidanceState, NedVector, Reasons,
    StepReport, VehicleMode,
};

/// x east, y north, z up, origin at home.
pub(crate) const MAP_FRAME: &str = "map";
/// x forward, y left, z up.
pub(crate) const BODY_FRAME: &str = "base_link";
/// The depth sensor: sits at the origin of the body and looks along its x axis.
pub(crate) const SENSOR_FRAME: &str = "depth_sensor";
/// Bytes of one image row.
const ROW_BYTES: usize = DEPTH_COLS * 4;

/// A viewer's time stamp of nanoseconds since the UNIX epoch; none as long as they are not known.
pub(crate) fn timestamp(at_ns: impl Into<Option<u64>>) -> Option<Timestamp> {
    let second = 1_000_000_000;
    let at_ns: Option<u64> = at_ns.into();
    at_ns.map(|at_ns| Timestamp {
        seconds: (at_ns / second) as i64,
        nanos: (at_ns % second) as i32,
    })
}

/// NED → map.
pub(crate) fn map_point(ned: NedVector) -> Vector3 {
    Vector3 {
        x: ned.y.into(),
        y: ned.x.into(),
        z: -f64::from(ned.z),
    }
}

/// map → NED.
pub(crate) fn ned_point(map: Vector3) -> NedVector {
    NedVector::new(map.y as f32, map.x as f32, -map.z as f32)
}

/// FRD-to-NED rotation → `base_link`-to-`map` rotation: q(map ← NED) ⊗ q ⊗ q(FRD ← FLU), with the half turns about
/// (x + y)/√2 and x multiplied out.
fn map_rotation(q: Attitude) -> Quaternion {
    let (w, x, y, z) = (f64::from(q.w), f64::from(q.x), f64::from(q.y), f64::from(q.z));
    Quaternion {
        w: FRAC_1_SQRT_2 * (w + z),
        x: FRAC_1_SQRT_2 * (x + y),
        y: FRAC_1_SQRT_2 * (x - y),
        z: FRAC_1_SQRT_2 * (w - z),
    }
}

/// Where the vehicle believes to be, if it reported so with finite numbers.
pub(crate) fn vehicle_pose(record: &TickRecord) -> Option<Pose> {
    let telemetry = &record.report.telemetry;
    let (k, a) = (telemetry.kinematics.as_ref()?, telemetry.attitude.as_ref()?);
    (k.position_ned_m.is_finite() && a.attitude.is_valid()).then(|| pose(k.position_ned_m, a.attitude))
}

/// A pose in `map`.
pub(crate) fn pose(position_ned_m: NedVector, attitude: Attitude) -> Pose {
    Pose {
        position: Some(map_point(position_ned_m)),
        orientation: Some(map_rotation(attitude)),
    }
}

pub(crate) fn transform(parent: &str, child: &str, pose: Pose, at_ns: impl Into<Option<u64>>) -> FrameTransform {
    FrameTransform {
        timestamp: timestamp(at_ns),
        parent_frame_id: parent.to_owned(),
        child_frame_id: child.to_owned(),
        translation: pose.position,
        rotation: pose.orientation,
    }
}

pub(crate) fn pose_in_map(pose: Pose, at_ns: impl Into<Option<u64>>) -> PoseInFrame {
    PoseInFrame {
        timestamp: timestamp(at_ns),
        frame_id: MAP_FRAME.to_owned(),
        pose: Some(pose),
    }
}

/// Not turned in its frame.
pub(crate) const UNTURNED: Quaternion = Quaternion {
    x: 0.0,
    y: 0.0,
    z: 0.0,
    w: 1.0,
};

/// Somewhere in its frame and not turned.
pub(crate) fn unturned_at(position: Vector3) -> Pose {
    Pose {
        position: Some(position),
        orientation: Some(UNTURNED),
    }
}

/// Pixels of the sensor, in rows.
pub(crate) fn image(
    rows: usize,
    cols: usize,
    encoding: &str,
    data: Vec<u8>,
    at_ns: impl Into<Option<u64>>,
) -> RawImage {
    RawImage {
        timestamp: timestamp(at_ns),
        frame_id: SENSOR_FRAME.to_owned(),
        width: cols as u32,
        height: rows as u32,
        encoding: encoding.to_owned(),
        step: (data.len() / rows) as u32,
        data,
    }
}

/// The frame as an image with the exact bits of its pixels: 32FC1 is little-endian.
pub(crate) fn depth_image(frame: &DepthFrame, at_ns: impl Into<Option<u64>>) -> RawImage {
    let mut data = vec![0; DEPTH_PIXELS * 4];
    for (bytes, value) in data.chunks_exact_mut(4).zip(&frame.depth) {
        bytes.copy_from_slice(&value.to_le_bytes());
    }
    image(DEPTH_ROWS, DEPTH_COLS, "32FC1", data, at_ns)
}

/// The frame for people: ranges in millimetres, one of each 2 × 2 pixels, at most 65.5 m; no return is 0, as viewers of depth
/// images have it. 32 kB.
pub(crate) fn range_image(frame: &DepthFrame, at_ns: u64) -> RawImage {
    let mut data = Vec::with_capacity(DEPTH_PIXELS / 2);
    for row in frame.depth.chunks_exact(DEPTH_COLS).step_by(2) {
        for value in row.iter().step_by(2) {
            // A cast saturates; a range that is no number gives 0.
            let millimetres = (value * (DEPTH_FULL_SCALE_M * 1000.0)) as u16;
            let seen = if *value >= 1.0 { 0 } else { millimetres };
            data.extend(seen.to_le_bytes());
        }
    }
    image(DEPTH_ROWS / 2, DEPTH_COLS / 2, "16UC1", data, at_ns)
}

/// Where the sensor sits on the body.
pub(crate) fn sensor_transform(at_ns: u64) -> FrameTransform {
    transform(BODY_FRAME, SENSOR_FRAME, unturned_at(Vector3::default()), at_ns)
}

/// Fills pixels from an image that [`depth_image`] made; `false` for an image of another kind.
pub(crate) fn read_depth_image(image: &RawImage, depth: &mut [f32; DEPTH_PIXELS]) -> bool {
    let ours = image.width as usize == DEPTH_COLS
        && image.height as usize == DEPTH_ROWS
        && image.step as usize == ROW_BYTES
        && image.encoding == "32FC1"
        && image.data.len() == DEPTH_PIXELS * 4;
    if ours {
        for (value, bytes) in depth.iter_mut().zip(image.data.chunks_exact(4)) {
            *value = f32::from_le_bytes(bytes.try_into().unwrap_or_default());
        }
    }
    ours
}

/// The path flown so far, thinned so that it never grows beyond [`PathTrail::MAX_POSES`].
#[derive(Debug)]
pub(crate) struct PathTrail {
    poses: Vec<Pose>,
    /// Takes every n-th pose offered.
    stride: u64,
    offered: u64,
}

impl PathTrail {
    const MAX_POSES: usize = 600;

    pub(crate) fn new() -> Self {
        Self {
            poses: Vec::new(),
            stride: 4,
            offered: 0,
        }
    }

    pub(crate) fn offer(&mut self, pose: Pose) {
        if self.offered.is_multiple_of(self.stride) {
            if self.poses.len() >= Self::MAX_POSES {
                self.poses = std::mem::take(&mut self.poses).into_iter().step_by(2).collect();
                self.stride *= 2;
            }
            self.poses.push(pose);
        }
        self.offered += 1;
    }

    pub(crate) fn message(&self, at_ns: u64) -> PosesInFrame {
        PosesInFrame {
            timestamp: timestamp(at_ns),
            frame_id: MAP_FRAME.to_owned(),
            poses: self.poses.clone(),
        }
    }
}

/// The flat row for plots.
pub(crate) fn status(record: &TickRecord, threshold: Option<f32>) -> Status {
    let report = &record.report;
    let telemetry = &report.telemetry;
    let number = |value: Option<f32>| value.map_or(f64::NAN, f64::from);
    let degrees = |value: Option<f32>| number(value).to_degrees();
    let milliseconds = |ns: Option<u64>| ns.map_or(f64::NAN, |ns| ns as f64 / 1e6);
    let position = telemetry.kinematics.map(|k| k.position_ned_m);
    let velocity = telemetry.kinematics.map(|k| k.velocity_ned_m_s);
    let attitude = telemetry.attitude.map(|a| a.attitude);
    let setpoint = report.setpoint.map(|s| s.velocity_m_s);
    let mode = telemetry.heartbeat.map_or(VehicleMode::Unknown, |h| h.mode);
    let [reason_bits, further_reason_bits] = report.reasons.words();
    Status {
        step: record.timing.step,
        state: report.state.name().to_owned(),
        state_code: report.state as u32,
        reasons: reason_names(report.reasons),
        reason_bits,
        further_reason_bits,
        goal_distance_m: number(report.goal_relative.map(|g| g.distance_m)),
        goal_bearing_deg: degrees(report.goal_relative.map(|g| g.bearing_rad)),
        action_forward_m_s: number(report.action.map(|a| a.forward_m_s)),
        action_yaw: number(report.action.map(|a| a.yaw)),
        setpoint_forward_m_s: number(setpoint.map(|v| v.x)),
        setpoint_right_m_s: number(setpoint.map(|v| v.y)),
        setpoint_down_m_s: number(setpoint.map(|v| v.z)),
        setpoint_yaw_rate_deg_s: degrees(report.setpoint.map(|s| s.yaw_rate_rad_s)),
        north_m: number(position.map(|p| p.x)),
        east_m: number(position.map(|p| p.y)),
        height_m: number(position.map(|p| -p.z)),
        speed_m_s: number(velocity.map(|v| v.horizontal_norm())),
        climb_m_s: number(velocity.map(|v| -v.z)),
        roll_deg: degrees(attitude.map(|a| a.roll_rad())),
        pitch_deg: degrees(attitude.map(|a| a.pitch_rad())),
        heading_deg: degrees(attitude.map(|a| a.yaw_rad())),
        yaw_rate_deg_s: degrees(telemetry.attitude.map(|a| a.rates_frd_rad_s.z)),
        battery_percent: 100.0 * number(telemetry.battery_remaining),
        armed: telemetry.heartbeat.is_some_and(|h| h.armed),
        vehicle_mode: mode.name().to_owned(),
        step_time_ms: milliseconds(Some(record.timing.previous_execution_ns)),
        wake_late_ms: milliseconds(Some(record.timing.wake_late_ns)),
        slips: record.timing.slips,
        frame_age_ms: milliseconds(report.frame_age_ns),
        telemetry_age_ms: milliseconds(telemetry.flight_data_age_ns(record.now_ns)),
        frames_refused: report.frames_refused,
        received_datagrams: record.received.len() as u32,
        sent_datagrams: record.sent.len() as u32,
        records_dropped: record.dropped_before,
        detector_score: number(report.judgement.and_then(|j| j.score)),
        detector_verdict: number(report.judgement.map(|j| f32::from(j.verdict as u8))),
        contribution_image: number(report.judgement.map(|j| j.image)),
        contribution_bearing: number(report.judgement.map(|j| j.bearing)),
        contribution_distance: number(report.judgement.map(|j| j.distance)),
        contribution_told: number(report.judgement.map(|j| j.told)),
        alarm: report.alarm.map_or("", |alarm| alarm.cause.name()).to_owned(),
        alarm_response: number(report.alarm.map(|alarm| f32::from(alarm.response as u8))),
        detector_threshold: number(threshold),
        actor_yaw: number(report.judgement.map(|j| j.yaw())),
    }
}

fn reason_names(reasons: Reasons) -> String {
    let names: Vec<_> = reasons.iter().map(|r| r.name()).collect();
    names.join(", ")
}

/// Turns changes between records into lines for a viewer's log panel.
#[derive(Debug, Default)]
pub(crate) struct Narrator {
    /// The last report, and how many records had been dropped.
    last: Option<(StepReport, u64)>,
}

impl Narrator {
    /// Hands every line that this record calls for to `tell`, with its level.
    pub(crate) fn lines(&mut self, record: &TickRecord, mut tell: impl FnMut(Level, String)) {
        let now = record.report;
        let last = self.last.replace((now, record.dropped_before));
        let (before, dropped_then) = last.unzip();
        let armed = |report: &StepReport| report.telemetry.heartbeat.is_some_and(|h| h.armed);
        let mode = |report: &StepReport| report.telemetry.heartbeat.map_or(VehicleMode::Unknown, |h| h.mode);
        if before.is_none_or(|b| (b.state, b.reasons) != (now.state, now.reasons)) {
            let level = match now.state {
                GuidanceState::Hold if !now.reasons.contains(vigil_types::Reason::GoalReached) => Level::Warning,
                _ => Level::Info,
            };
            let from = match before {
                Some(b) if b.state != now.state => format!("{} → ", b.state.name()),
                _ => String::new(),
            };
            let why = match reason_names(now.reasons) {
                names if names.is_empty() => names,
                names => format!(" ({names})"),
            };
            tell(level, format!("guidance: {from}{}{why}", now.state.name()));
        }
        match (before.and_then(|b| b.alarm), now.alarm) {
            (before, Some(alarm)) if before != now.alarm => {
                let (cause, response) = (alarm.cause.name(), alarm.response.name());
                tell(Level::Error, format!("alarm: {cause}, {response}"));
            }
            (Some(_), None) => tell(Level::Info, "alarm: clear".to_owned()),
            _ => {}
        }
        if before.is_some_and(|b| armed(&b) != armed(&now)) {
            let word = if armed(&now) { "armed" } else { "disarmed" };
            tell(Level::Info, format!("vehicle: {word}"));
        }
        if before.is_some_and(|b| mode(&b) != mode(&now)) {
            tell(Level::Info, format!("vehicle: mode {}", mode(&now).name()));
        }
        let lost = record.dropped_before.saturating_sub(dropped_then.unwrap_or(0));
        if lost > 0 {
            tell(
                Level::Error,
                format!("log: {lost} records were dropped before this one"),
            );
        }
    }
}

pub(crate) fn log_line(level: Level, message: String, at_ns: u64) -> Log {
    Log {
        timestamp: timestamp(at_ns),
        level: level as i32,
        message,
        name: "vigil".to_owned(),
        ..Log::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vigil_types::{Alarm, AlarmCause, AlarmResponse, AttitudeSample, FrdVector, Heartbeat, Kinematics, Reason};

    #[test]
    fn the_body_axes_of_the_map_are_those_of_the_loop() {
        let attitude = Attitude::from_euler_rad(0.3, -0.2, 2.1);
        let Quaternion { w, x, y, z } = map_rotation(attitude);
        let [w, x, y, z] = [w, x, y, z].map(|value| value as f32);
        let shown = Attitude { w, x, y, z };
        for [x, y, z] in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] {
            let expected = map_point(attitude.to_ned(FrdVector::new(x, y, z)));
            // The same axis, forward, left and up; a rotation does not ask which frame's axes it turns.
            let [x, y, z] = shown.to_ned(FrdVector::new(x, -y, -z)).to_array().map(f64::from);
            let error = (expected.x - x).abs() + (expected.y - y).abs() + (expected.z - z).abs();
            assert!(error < 1e-6, "{expected:?} against {x} {y} {z}");
        }
    }

    #[test]
    fn a_long_flights_path_stays_small_and_keeps_its_start_and_its_end() {
        let mut trail = PathTrail::new();
        let at = |x: f64| Pose {
            position: Some(Vector3 { x, y: 0.0, z: 0.0 }),
            orientation: None,
        };
        for i in 0..200_000 {
            trail.offer(at(f64::from(i)));
        }
        let poses = trail.message(0).poses;
        assert!(poses.len() <= PathTrail::MAX_POSES && poses.len() > PathTrail::MAX_POSES / 3);
        let x = |p: &Pose| p.position.unwrap().x;
        assert_eq!(x(&poses[0]), 0.0);
        assert!(x(poses.last().unwrap()) > 199_000.0);
        let steps: Vec<f64> = poses.windows(2).map(|w| x(&w[1]) - x(&w[0])).collect();
        assert!(steps.iter().all(|s| *s == steps[0]), "evenly thinned");
    }

    #[test]
    fn changes_are_reported_once_and_a_hold_for_cause_is_a_warning() {
        let mut narrator = Narrator::default();
        let mut record = TickRecord::default();
        let mut lines = |record: &TickRecord| {
            let mut lines = Vec::new();
            narrator.lines(record, |level, line| lines.push(format!("{level:?}, {line}")));
            lines
        };
        assert_eq!(lines(&record), ["Info, guidance: standby"]);
        assert!(lines(&record).is_empty());
        record.report.state = GuidanceState::Hold;
        record.report.reasons = Reasons::of(Reason::StaleFrame).with_if(true, Reason::Slip);
        record.report.telemetry.heartbeat = Some(Heartbeat {
            at_ns: 0,
            armed: true,
            mode: VehicleMode::External,
            failsafe: false,
        });
        record.dropped_before = 3;
        assert_eq!(
            lines(&record),
            [
                "Warning, guidance: standby → hold (stale frame, slip)",
                "Info, vehicle: armed",
                "Info, vehicle: mode external",
                "Error, log: 3 records were dropped before this one",
            ]
        );
        record.report.alarm = Some(Alarm {
            cause: AlarmCause::Attack,
            response: AlarmResponse::Stop,
        });
        assert_eq!(lines(&record), ["Error, alarm: attack, stopping"]);
        record.report.alarm = None;
        assert_eq!(lines(&record), ["Info, alarm: clear"]);
        record.report.reasons = Reasons::of(Reason::GoalReached);
        assert_eq!(lines(&record), ["Info, guidance: hold (goal reached)"]);
    }

    #[test]
    fn the_status_row_shows_what_was_never_received_as_a_gap() {
        let mut record = TickRecord::default();
        let row = status(&record, None);
        assert!(row.north_m.is_nan() && row.goal_distance_m.is_nan() && row.frame_age_ms.is_nan());
        record.now_ns = 5_000_000;
        record.report.telemetry.kinematics = Some(Kinematics::new(
            2_000_000,
            NedVector::new(1.0, 2.0, -3.0),
            NedVector::new(3.0, 4.0, 0.5),
        ));
        record.report.telemetry.attitude = Some(AttitudeSample::new(
            4_000_000,
            Attitude::from_euler_rad(0.0, 0.0, std::f32::consts::FRAC_PI_2),
            FrdVector::ZERO,
        ));
        let row = status(&record, None);
        assert_eq!((row.north_m, row.east_m, row.height_m), (1.0, 2.0, 3.0));
        assert_eq!((row.speed_m_s, row.climb_m_s, row.telemetry_age_ms), (5.0, -0.5, 3.0));
        assert!((row.heading_deg - 90.0).abs() < 1e-4);
    }
}
