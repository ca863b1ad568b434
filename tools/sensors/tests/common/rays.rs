//! A ray caster of its own, written without the LiDAR model's code: what any sensor would measure on a course.

use vigil_sim::world::{Solid, World};
use vigil_types::{Attitude, FrdVector, NedVector};

/// What a ray meets first: its range in metres and which solid (the ground and the ceiling count as solids too).
pub fn cast(world: &World, from: NedVector, direction: NedVector) -> Option<(f64, usize)> {
    let d = direction.to_array().map(f64::from);
    let o = from.to_array().map(f64::from);
    let norm = d.iter().map(|x| x * x).sum::<f64>().sqrt();
    let d = d.map(|x| x / norm);
    let mut nearest: Option<(f64, usize)> = None;
    let mut meet = |range_m: Option<f64>, what| {
        if let Some(range_m) = range_m.filter(|r| *r > 1e-6)
            && nearest.is_none_or(|(n, _)| range_m < n)
        {
            nearest = Some((range_m, what));
        }
    };
    let plane = |height_m: f64| (d[2] != 0.0).then(|| (-height_m - o[2]) / d[2]);
    meet(plane(0.0), usize::MAX);
    if let Some(height_m) = world.ceiling_height_m() {
        meet(plane(f64::from(height_m)), usize::MAX - 1);
    }
    for (i, solid) in world.solids().enumerate() {
        meet(range_of(&solid, o, d), i);
    }
    nearest
}

fn range_of(solid: &Solid, o: [f64; 3], d: [f64; 3]) -> Option<f64> {
    let c = solid.centre_ned_m().to_array().map(f64::from);
    let o = [o[0] - c[0], o[1] - c[1], o[2] - c[2]];
    // Of a ray along the faces both are infinite: of one sign where it is not between them.
    let slab = |o: f64, d: f64, half: f64| {
        let (a, b) = ((-half - o) / d, (half - o) / d);
        (a.min(b), a.max(b))
    };
    let (enter, leave) = match *solid {
        Solid::Cuboid {
            half_extents_m,
            yaw_rad,
            ..
        } => {
            let (s, c) = f64::from(yaw_rad).sin_cos();
            let turn = |v: [f64; 3]| [c * v[0] + s * v[1], c * v[1] - s * v[0], v[2]];
            let (o, d) = (turn(o), turn(d));
            (0..3).fold((f64::NEG_INFINITY, f64::INFINITY), |(enter, leave), k| {
                let (a, b) = slab(o[k], d[k], f64::from(half_extents_m[k]));
                (enter.max(a), leave.min(b))
            })
        }
        Solid::Cylinder {
            radius_m,
            half_height_m,
            ..
        } => {
            let (a, b, c) = (
                d[0] * d[0] + d[1] * d[1],
                o[0] * d[0] + o[1] * d[1],
                o[0] * o[0] + o[1] * o[1] - f64::from(radius_m).powi(2),
            );
            let root = (b * b - a * c).sqrt();
            let round = if a > 0.0 {
                ((-b - root) / a, (-b + root) / a)
            } else {
                (f64::NEG_INFINITY, f64::INFINITY)
            };
            let flat = slab(o[2], d[2], f64::from(half_height_m));
            if root.is_nan() {
                return None;
            }
            (round.0.max(flat.0), round.1.min(flat.1))
        }
    };
    (enter <= leave && enter > 0.0).then_some(enter)
}

/// A direction of a sensor's axes in the vehicle's, into which they are turned by `turn`.
pub fn in_vehicle(turn: Attitude, direction: FrdVector) -> FrdVector {
    let [x, y, z] = turn.to_ned(direction).to_array();
    FrdVector::new(x, y, z)
}
