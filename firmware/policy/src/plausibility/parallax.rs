//! Parallax: as the vehicle passes what stands beside its course, edges move in bearing, the faster the nearer they are. Who alters
//! ranges alone cannot move edges: what is shown farther away than it is moves faster than it should at the range shown.
//!
//! A vehicle of wrong odometry sees the same on both sides, one of wrong heading opposite things; what moves by itself moves on one side.
//! So edges on both sides have to move too far. Where none are seen nothing is known, which is no good word for the picture.

use super::motion::Pose;
use super::picture::{Directions, SIDE};
use vigil_types::{
    DEPTH_COLS, DEPTH_FULL_SCALE_M, DepthFrame, Nanos, NedVector, PIXEL_PITCH_RAD, VERTICAL_FOV_RAD,
    column_bearing_rad, wrap_pi,
};

/// Views kept, and how far apart, level metres.
const VIEWS: usize = 16;
const EVERY_M: f32 = 0.08;
/// A view is compared with the newest so far back, level metres, and no older: the estimate drifts by a tenth of that in a worse flight.
const BACK_M: f32 = 0.8;
const OLDEST_NS: Nanos = 2_500_000_000;
/// Rows of pixels that are looked at, each second of 6° about the horizon.
const ROWS_SEEN: usize = 7;
/// Edges of a view; of surfaces no farther than this, before what lies farther by a part and metres.
const EDGES: usize = 32;
const FAR_M: f32 = 15.0;
const BEHIND_PART: f32 = 1.25;
const BEHIND_M: f32 = 0.4;
/// The same edge is shown at the range that it should be at, within metres and a part of it, and within 20° of where it should be.
const SAME_M: f32 = 0.3;
const SAME_PART: f32 = 0.07;
const SEARCHED_RAD: f32 = 0.35;
/// Edges nearer than this to the vehicle, to the course (8°) or to the end of the view (6°) are left out.
const NEAR_M: f32 = 0.5;
const LEAST_OFF_RAD: f32 = 0.14;
const MOST_BEARING_RAD: f32 = 0.942;
/// Edges that moved by 2° count: they are displaced if they moved farther than they should by a fifth and 0.2°.
const LEAST_MOVED_RAD: f32 = 0.035;
const DISPLACED_PART: f32 = 0.2;
const DISPLACED_RAD: f32 = 0.0035;
/// Edges count for about 20 pictures. With so many on each side, such a share displaced on both, in so many
/// pictures in a row, the ranges are no true ones.
const KEEP: f32 = 0.95;
const LEAST_EDGES: f32 = 6.0;
const DISPLACED_SHARE: f32 = 0.8;
const RAISE_PICTURES: u8 = 5;

/// Where something near ends before something farther.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Edge {
    bearing_rad: f32,
    range_m: f32,
    /// It is the near thing's right end.
    is_right: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct View {
    stamp_ns: Nanos,
    position_ned_m: NedVector,
    yaw_rad: f32,
    edges: [Edge; EDGES],
    count: usize,
}

impl View {
    fn of(frame: &DepthFrame, directions: &Directions, pose: &Pose) -> Self {
        let mut view = Self {
            stamp_ns: frame.header.stamp_ns,
            position_ned_m: pose.position_ned_m,
            yaw_rad: pose.attitude.yaw_rad(),
            ..Self::default()
        };
        let ranges_m = along_horizon_m(frame, directions, pose);
        for (i, four) in ranges_m.windows(4).enumerate() {
            let [before, left, right, after] = *four else { continue };
            let is_before = |near_m: f32, far_m: f32, beside_m: f32| {
                let whole = (beside_m - near_m).abs() < 0.1 * near_m + 0.1;
                near_m < FAR_M && far_m > BEHIND_PART * near_m + BEHIND_M && whole
            };
            let is_right = is_before(left, right, before);
            if (is_right || is_before(right, left, after))
                && let Some(edge) = view.edges.get_mut(view.count)
            {
                *edge = Edge {
                    bearing_rad: column_bearing_rad(i as f32 + 1.5),
                    range_m: if is_right { left } else { right },
                    is_right,
                };
                view.count += 1;
            }
        }
        view
    }

    fn edges(&self) -> impl Iterator<Item = &Edge> {
        self.edges.iter().take(self.count)
    }

    fn level_m_from(&self, other: &Self) -> f32 {
        (self.position_ned_m - other.position_ned_m).horizontal_norm()
    }
}

/// The nearest of each column within 3° of the horizon, metres.
fn along_horizon_m(frame: &DepthFrame, directions: &Directions, pose: &Pose) -> [f32; DEPTH_COLS] {
    let down = pose.attitude.to_frd(NedVector::new(0.0, 0.0, 1.0));
    let rows = frame.depth.as_chunks::<DEPTH_COLS>().0;
    let mut nearest_m = [f32::INFINITY; DEPTH_COLS];
    for (column, nearest_m) in nearest_m.as_chunks_mut::<SIDE>().0.iter_mut().enumerate() {
        let (cos, sin) = directions.column(column);
        let elevation_rad = libm::atan2f(down.x * cos + down.y * sin, down.z);
        let middle = (0.5 * VERTICAL_FOV_RAD - elevation_rad) / PIXEL_PITCH_RAD - 0.5;
        let first = (middle - (ROWS_SEEN - 1) as f32).max(0.0) as usize;
        for row in rows.iter().skip(first).step_by(2).take(ROWS_SEEN) {
            if let Some(pixels) = row.as_chunks::<SIDE>().0.get(column) {
                for (nearest_m, depth) in nearest_m.iter_mut().zip(pixels) {
                    *nearest_m = crate::smaller(*nearest_m, depth * DEPTH_FULL_SCALE_M);
                }
            }
        }
    }
    nearest_m
}

/// Edges on one side of the course that counted lately, and those of them that were displaced.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Side {
    all: f32,
    displaced: f32,
}

/// Whether edges move as far as the ranges shown ask for.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Parallax {
    views: [View; VIEWS],
    newest: usize,
    used: usize,
    left: Side,
    right: Side,
    pictures: u8,
    /// Until the motors are off: a vehicle that is held moves past nothing by which it could end.
    pub(super) is_raised: bool,
}

impl Parallax {
    /// Takes a frame of a vehicle in flight.
    pub(super) fn note(&mut self, frame: &DepthFrame, directions: &Directions, pose: &Pose) {
        let view = View::of(frame, directions, pose);
        for side in [&mut self.left, &mut self.right] {
            (side.all, side.displaced) = (KEEP * side.all, KEEP * side.displaced);
        }
        let mut earlier = (0..self.used).filter_map(|back| self.views.get((self.newest + VIEWS - back) % VIEWS));
        let far_enough = earlier.find(|earlier| view.level_m_from(earlier) >= BACK_M);
        let is_young = |earlier: &&View| view.stamp_ns.saturating_sub(earlier.stamp_ns) <= OLDEST_NS;
        if let Some(earlier) = far_enough.filter(is_young).copied() {
            self.compare(&view, &earlier);
        }
        let displaced = |side: &Side| side.all >= LEAST_EDGES && side.displaced > DISPLACED_SHARE * side.all;
        super::count(&mut self.pictures, displaced(&self.left) && displaced(&self.right));
        self.is_raised |= self.pictures >= RAISE_PICTURES;
        let newest = self.views.get(self.newest).filter(|_| self.used > 0);
        if newest.is_none_or(|newest| view.level_m_from(newest) >= EVERY_M) {
            self.newest = (self.newest + 1) % VIEWS;
            self.used = (self.used + 1).min(VIEWS);
            if let Some(newest) = self.views.get_mut(self.newest) {
                *newest = view;
            }
        }
    }

    /// A frame of which nothing can be said: what was seen before is not compared with any more; what was raised stays.
    pub(super) fn skip(&mut self) {
        (self.used, self.pictures) = (0, 0);
        (self.left, self.right) = (Side::default(), Side::default());
    }

    fn compare(&mut self, now: &View, then: &View) {
        let way = now.position_ned_m - then.position_ned_m;
        let course_rad = libm::atan2f(way.y, way.x) - now.yaw_rad;
        for edge in then.edges() {
            let heading_rad = then.yaw_rad + edge.bearing_rad;
            let (x, y) = (
                edge.range_m * libm::cosf(heading_rad) - way.x,
                edge.range_m * libm::sinf(heading_rad) - way.y,
            );
            let range_m = libm::hypotf(x, y);
            let bearing_rad = wrap_pi(libm::atan2f(y, x) - now.yaw_rad);
            let off_rad = wrap_pi(bearing_rad - course_rad);
            if range_m < NEAR_M || off_rad.abs() < LEAST_OFF_RAD || bearing_rad.abs() > MOST_BEARING_RAD {
                continue;
            }
            let outward = 1.0_f32.copysign(off_rad);
            let should_rad = outward * wrap_pi(bearing_rad + now.yaw_rad - heading_rad);
            let same =
                |e: &&Edge| e.is_right == edge.is_right && (e.range_m - range_m).abs() < SAME_M + SAME_PART * range_m;
            let farther_rad = now
                .edges()
                .filter(same)
                .map(|e| outward * wrap_pi(e.bearing_rad - bearing_rad))
                .min_by(|a, b| a.abs().total_cmp(&b.abs()))
                .filter(|farther_rad| farther_rad.abs() < SEARCHED_RAD);
            if let Some(farther_rad) = farther_rad
                && should_rad > 0.0
                && should_rad + farther_rad > LEAST_MOVED_RAD
            {
                let side = if off_rad < 0.0 { &mut self.left } else { &mut self.right };
                side.all += 1.0;
                if farther_rad > DISPLACED_PART * should_rad + DISPLACED_RAD {
                    side.displaced += 1.0;
                }
            }
        }
    }

    /// Whether edges are seen to move on both sides.
    #[cfg(test)]
    pub(super) fn sees_both_sides(&self) -> bool {
        self.left.all >= LEAST_EDGES && self.right.all >= LEAST_EDGES
    }
}
