//! Two pictures and the way between them: does one follow from the other?

use super::picture::{COLS, Directions, MIDDLE_COLUMN, Picture, ROWS, Seen, bearing_rad, place_of};
use vigil_types::{Attitude, FrdVector, NedVector};

/// Where and how turned the sensor was.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Pose {
    pub position_ned_m: NedVector,
    pub attitude: Attitude,
}

/// The motion from one pose to another, as a map of points in the first pose's body axes into the second's.
#[derive(Debug, Clone, Copy)]
pub(super) struct Map {
    x: FrdVector,
    y: FrdVector,
    z: FrdVector,
    shift: FrdVector,
}

impl Map {
    /// From the axes at `from` to those at `to`.
    pub(super) fn between(from: &Pose, to: &Pose) -> Self {
        let axis = |x, y, z| to.attitude.to_frd(from.attitude.to_ned(FrdVector::new(x, y, z)));
        Self {
            x: axis(1.0, 0.0, 0.0),
            y: axis(0.0, 1.0, 0.0),
            z: axis(0.0, 0.0, 1.0),
            shift: to.attitude.to_frd(from.position_ned_m - to.position_ned_m),
        }
    }

    /// The same motion as a sensor measures it that is turned to the right on its mount, given cosine and sine.
    pub(super) fn turned(&self, (cos, sin): (f32, f32)) -> Self {
        let back = |v: FrdVector| FrdVector::new(cos * v.x + sin * v.y, cos * v.y - sin * v.x, v.z);
        Self {
            x: back(self.x * cos + self.y * sin),
            y: back(self.y * cos + self.x * -sin),
            z: back(self.z),
            shift: back(self.shift),
        }
    }

    /// The same motion as a sensor measures it that exchanges left and right.
    pub(super) fn mirrored(&self) -> Self {
        let back = |v: FrdVector| FrdVector::new(v.x, -v.y, v.z);
        Self {
            x: back(self.x),
            y: back(-self.y),
            z: back(self.z),
            shift: back(self.shift),
        }
    }

    /// How far the motion leads aside, metres; a turn to the side, or a roll, counts as [`METRES_PER_RADIAN`].
    pub(super) fn aside_m(&self) -> f32 {
        self.shift.y.abs() + METRES_PER_RADIAN * (self.x.y.abs() + self.z.y.abs())
    }

    /// The same motion over a longer or a shorter way.
    pub(super) fn stretched(&self, factor: f32) -> Self {
        Self {
            shift: self.shift * factor,
            ..*self
        }
    }

    /// The same motion with every point moved on, in the axes that it leads to.
    pub(super) fn shifted(&self, by: FrdVector) -> Self {
        Self {
            shift: self.shift + by,
            ..*self
        }
    }

    #[inline]
    fn apply(&self, p: FrdVector) -> FrdVector {
        self.x * p.x + self.y * p.y + self.z * p.z + self.shift
    }
}

/// Standard deviation of what is compared, at a range: noise, the estimate's error, interpolation.
#[inline]
pub(super) fn sigma_m(range_m: f32) -> f32 {
    0.06 + 0.02 * range_m
}

/// A turn of a radian counts as so many metres of way.
const METRES_PER_RADIAN: f32 = 3.0;
/// A squared error counts for no more than this many variances: what is hidden, moves, or lies at an edge decides nothing.
pub(super) const MOST_COST: f32 = 9.0;
/// A surface nearer than this is not lost for being far.
const NEAR_M: f32 = 20.0;

#[inline]
pub(super) fn cost(error_m: f32, range_m: f32) -> f32 {
    let e = error_m / sigma_m(range_m);
    let squared = e * e;
    if squared < MOST_COST { squared } else { MOST_COST }
}

/// What became of a point of one picture in the other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Found {
    /// Out of view, at an edge, or too far off: says nothing.
    Unknown,
    /// A surface nearer (negative) or farther (positive) than the point by so many metres, at the point's range.
    Surface { error_m: f32, range_m: f32 },
    /// Nothing, though the point is near.
    Nothing { range_m: f32 },
}

/// Looks in `to` for the point that `from` shows in a cell. Gives the place in `to` too.
#[inline]
pub(super) fn look(
    directions: &Directions,
    cell: (usize, usize),
    seen: Seen,
    map: &Map,
    to: &Picture,
) -> (Found, (f32, f32)) {
    look_widened(directions, cell, seen, map, to, 0.0)
}

/// The same where both views are wider by a small share than they are said to be.
#[inline]
pub(super) fn look_widened(
    directions: &Directions,
    (row, column): (usize, usize),
    seen: Seen,
    map: &Map,
    to: &Picture,
    widening: f32,
) -> (Found, (f32, f32)) {
    const NOWHERE: (f32, f32) = (0.0, 0.0);
    let Seen::Surface(range_m) = seen else {
        return (Found::Unknown, NOWHERE);
    };
    let mut seen_along = directions.of(row, column);
    if widening != 0.0 {
        let turn = widening * bearing_rad(column);
        seen_along = seen_along + FrdVector::new(-seen_along.y, seen_along.x, 0.0) * turn;
    }
    let point = map.apply(seen_along * range_m);
    let Some(place) = place_of(point) else {
        return (Found::Unknown, NOWHERE);
    };
    let place = (place.0, (place.1 - MIDDLE_COLUMN) / (1.0 + widening) + MIDDLE_COLUMN);
    if !(0.0..=2.0 * MIDDLE_COLUMN).contains(&place.1) {
        return (Found::Unknown, NOWHERE);
    }
    let range_m = point.norm();
    let found = match to.between(place.0, place.1) {
        Seen::Surface(there_m) => Found::Surface {
            error_m: there_m - range_m,
            range_m,
        },
        Seen::Nothing if range_m < NEAR_M => Found::Nothing { range_m },
        Seen::Nothing | Seen::Mixed => Found::Unknown,
    };
    (found, place)
}

impl Found {
    /// What it says against the motion assumed; `None` if nothing.
    #[inline]
    pub(super) fn cost(self) -> Option<f32> {
        match self {
            Self::Unknown => None,
            Self::Surface { error_m, range_m } => Some(cost(error_m, range_m)),
            Self::Nothing { .. } => Some(MOST_COST),
        }
    }

    /// The other picture sees through the point, which no motion explains.
    #[inline]
    pub(super) fn is_seen_through(self) -> bool {
        match self {
            Self::Unknown => false,
            Self::Surface { error_m, range_m } => error_m > 0.5 + 0.15 * range_m,
            Self::Nothing { .. } => true,
        }
    }

    /// What the other picture shows there is no nearer than this, metres.
    #[inline]
    pub(super) fn is_beyond(self, limit_m: f32) -> bool {
        match self {
            Self::Surface { error_m, range_m } => range_m + error_m > limit_m,
            Self::Unknown | Self::Nothing { .. } => true,
        }
    }

    /// The other picture shows the point.
    #[inline]
    pub(super) fn agrees(self) -> bool {
        matches!(self, Self::Surface { error_m, range_m } if error_m.abs() < 2.0 * sigma_m(range_m))
    }
}

/// Cells of a picture in which a step looks: every eighth, others in each of eight steps, so that all of the view is
/// looked at in 0.4 s.
pub(super) fn samples(phase: usize) -> impl Iterator<Item = (usize, usize)> + Clone {
    // An odd stride over rows of even length visits every column.
    (0..ROWS * COLS / 8).map(move |i| {
        let cell = i * 8 + (phase + 3 * (i / 8)) % 8;
        (cell / COLS, cell % COLS)
    })
}

/// How far two poses are apart, metres; turns count as [`METRES_PER_RADIAN`].
pub(super) fn apart_m(a: &Pose, b: &Pose) -> f32 {
    (a.position_ned_m - b.position_ned_m).norm() + METRES_PER_RADIAN * turn_rad(a.attitude, b.attitude)
}

/// The angle φ between two attitudes as 2 sin(φ/2), radians.
pub(super) fn turn_rad(p: Attitude, q: Attitude) -> f32 {
    let alike = alike(p, q).min(1.0);
    2.0 * libm::sqrtf(1.0 - alike * alike)
}

/// The cosine of half the angle between two attitudes.
pub(super) fn alike(p: Attitude, q: Attitude) -> f32 {
    (p.w * q.w + p.x * q.x + p.y * q.y + p.z * q.z).abs()
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f32::consts::PI;

    #[test]
    fn a_point_is_where_the_motion_takes_it() {
        let from = Pose {
            position_ned_m: NedVector::new(1.0, 2.0, -1.5),
            attitude: Attitude::from_euler_rad(0.05, -0.1, 0.4),
        };
        let to = Pose {
            position_ned_m: NedVector::new(1.7, 2.2, -1.4),
            attitude: Attitude::from_euler_rad(-0.02, 0.03, 0.7),
        };
        let world = NedVector::new(6.0, 5.0, -2.0);
        let seen = |pose: &Pose| pose.attitude.to_frd(world - pose.position_ned_m);
        let near = |a: FrdVector, b: FrdVector| (a - b).norm() < 1e-5;
        let map = Map::between(&from, &to);
        assert!(near(map.apply(seen(&from)), seen(&to)));
        let mirror = |v: FrdVector| FrdVector::new(v.x, -v.y, v.z);
        assert!(near(map.mirrored().apply(mirror(seen(&from))), mirror(seen(&to))));
        let angle = 5.0 * PI / 180.0;
        let (cos, sin) = (libm::cosf(angle), libm::sinf(angle));
        let turned = |v: FrdVector| FrdVector::new(cos * v.x + sin * v.y, cos * v.y - sin * v.x, v.z);
        assert!(near(
            map.turned((cos, sin)).apply(turned(seen(&from))),
            turned(seen(&to))
        ));
    }

    #[test]
    fn eight_steps_look_at_every_cell_once() {
        let mut seen = [0; ROWS * COLS];
        for phase in 0..8 {
            for (row, column) in samples(phase) {
                seen[row * COLS + column] += 1;
            }
        }
        assert!(seen.iter().all(|n| *n == 1));
    }
}
