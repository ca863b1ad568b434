//! How the depth sensor is mounted, by the ground that it sees.

use crate::sensor_check::median;
use vigil_types::{DEPTH_COLS, DEPTH_ROWS, DepthFrame, FrdVector, NedVector, column_bearing_rad, row_elevation_rad};

/// Rows that look down enough to see the ground near the vehicle, and every how manieth pixel is taken.
const FIRST_ROW: usize = DEPTH_ROWS * 5 / 8;
const STRIDE: usize = 4;
/// Ground farther than this is seen too flat to tell its slope, metres.
const FARTHEST_M: f32 = 12.0;
/// A point this far off the plane is something that stands on the ground, metres; it is left out in the second fit.
const OFF_PLANE_M: f32 = 0.15;
/// Fewer points are no ground.
const LEAST_POINTS: usize = 200;
/// Points that must remain on the plane: else it is no plane.
const LEAST_SHARE: f32 = 0.6;

/// How the seen ground leans, by the attitude in the frame's header. On level ground that is the error of the sensor's mounting.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroundTilt {
    /// The picture looks this much too low (the sensor's nose is lower than stated), radians.
    pub pitch_rad: f32,
    /// The sensor is turned this much to the right about its forward axis beyond what is stated, radians.
    pub roll_rad: f32,
    /// Height of the sensor above that ground, metres.
    pub height_m: f32,
}

/// Fits a plane to the lower part of a picture. `None` where it shows no ground.
pub fn ground_tilt(frame: &DepthFrame) -> Option<GroundTilt> {
    let attitude = frame.header.attitude;
    if !attitude.is_valid() {
        return None;
    }
    let yaw_rad = attitude.yaw_rad();
    let mut points = Vec::new();
    for row in (FIRST_ROW..DEPTH_ROWS).step_by(STRIDE) {
        for col in (0..DEPTH_COLS).step_by(STRIDE) {
            let Some(range_m) = frame.range_m(row, col).filter(|range_m| *range_m < FARTHEST_M) else {
                continue;
            };
            let (bearing, elevation) = (column_bearing_rad(col as f32), row_elevation_rad(row as f32));
            let ray = FrdVector::new(
                elevation.cos() * bearing.cos(),
                elevation.cos() * bearing.sin(),
                -elevation.sin(),
            );
            let ned: NedVector = attitude.to_ned(ray * range_m);
            let heading = ned.to_heading(yaw_rad);
            points.push([heading.x, heading.y, heading.z]);
        }
    }
    if points.len() < LEAST_POINTS {
        return None;
    }
    // Things on the ground draw the plane up: it is fitted again without what is off it, nearer and nearer.
    let mut plane = fit(&points)?;
    let seen = points.len();
    for _ in 0..4 {
        let off = |p: &[f32; 3]| (p[2] - (plane[0] * p[0] + plane[1] * p[1] + plane[2])).abs();
        let allowed_m = (2.0 * median(points.iter().map(off).collect())?).max(OFF_PLANE_M);
        let near: Vec<[f32; 3]> = points.iter().copied().filter(|p| off(p) <= allowed_m).collect();
        plane = fit(&near)?;
        points = near;
    }
    if (points.len() as f32) < LEAST_SHARE * seen as f32 {
        return None;
    }
    let [ahead, right, down_m] = plane;
    // Ground that seems to fall away ahead is seen by a sensor whose nose is higher than stated.
    Some(GroundTilt {
        pitch_rad: -ahead.atan(),
        roll_rad: -right.atan(),
        height_m: down_m,
    })
}

/// Least squares of z = a·x + b·y + c.
fn fit(points: &[[f32; 3]]) -> Option<[f32; 3]> {
    let n = points.len() as f64;
    if points.len() < 3 {
        return None;
    }
    let mean = |k: usize| points.iter().map(|p| f64::from(p[k])).sum::<f64>() / n;
    let (mx, my, mz) = (mean(0), mean(1), mean(2));
    let (mut xx, mut xy, mut yy, mut xz, mut yz) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for p in points {
        let (x, y, z) = (f64::from(p[0]) - mx, f64::from(p[1]) - my, f64::from(p[2]) - mz);
        xx += x * x;
        xy += x * y;
        yy += y * y;
        xz += x * z;
        yz += y * z;
    }
    let determinant = xx * yy - xy * xy;
    if determinant <= 1e-6 * xx.max(yy).powi(2) {
        return None;
    }
    let a = (xz * yy - yz * xy) / determinant;
    let b = (yz * xx - xz * xy) / determinant;
    Some([a as f32, b as f32, (mz - a * mx - b * my) as f32])
}
