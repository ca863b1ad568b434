//! Contact with the flat ground at height 0.

use crate::vehicle::body::Body;
use crate::vehicle::math::Vec3;
use crate::vehicle::params::{AirframeParams, GroundParams};

/// A contact point with the place where its foot stands.
#[derive(Debug, Clone, Copy)]
struct Point {
    /// In the body, metres from the centre of mass.
    offset_frd_m: Vec3,
    /// Where friction holds it (north, east), while it touches.
    anchor_m: Option<(f64, f64)>,
}

/// Four feet and four arm tips, each a spring-damper towards the ground's normal. Friction is a spring to where the
/// point first touched, limited to `friction · normal`: beyond that the point slides and takes its anchor along. So a
/// resting vehicle stays exactly where it stands, also in wind.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ground {
    points: [Point; 8],
    params: GroundParams,
    /// No point is further from the centre of mass than this, metres.
    reach_m: f64,
}

impl Ground {
    pub(crate) fn new(params: &GroundParams, airframe: &AirframeParams) -> Self {
        let (t, g) = (airframe.gear_half_track_m, airframe.gear_height_m);
        let (f, r) = (airframe.arm_forward_m, airframe.arm_right_m);
        // Arm tips stand a little above the centre of mass: where the propellers are.
        let up = -0.04;
        let offsets = [
            Vec3::new(t, t, g),
            Vec3::new(-t, -t, g),
            Vec3::new(t, -t, g),
            Vec3::new(-t, t, g),
            Vec3::new(f, r, up),
            Vec3::new(-f, -r, up),
            Vec3::new(f, -r, up),
            Vec3::new(-f, r, up),
        ];
        Self {
            points: offsets.map(|offset_frd_m| Point {
                offset_frd_m,
                anchor_m: None,
            }),
            params: *params,
            reach_m: offsets.iter().fold(0.0, |m: f64, o| m.max(o.norm())),
        }
    }

    /// Height of the centre of mass above the ground when the vehicle stands on its feet with this weight.
    pub(crate) fn standing_height_m(&self, airframe: &AirframeParams, weight_n: f64) -> f64 {
        airframe.gear_height_m - 0.25 * weight_n / self.params.stiffness_n_m
    }

    /// Lets go of all anchors.
    pub(crate) fn release(&mut self) {
        for p in &mut self.points {
            p.anchor_m = None;
        }
    }

    /// The ground's force (NED) and torque (FRD) on the body, `None` in the air.
    pub(crate) fn contact(&mut self, body: &Body) -> Option<(Vec3, Vec3)> {
        if body.position_ned_m.z < -self.reach_m {
            self.release();
            return None;
        }
        let (mut force_ned_n, mut torque_frd_n_m) = (Vec3::zeros(), Vec3::zeros());
        let mut touches = false;
        let (stiffness, damping) = (self.params.stiffness_n_m, self.params.damping_n_s_m);
        for point in &mut self.points {
            let arm = body.attitude * point.offset_frd_m;
            let place = body.position_ned_m + arm;
            if place.z <= 0.0 {
                point.anchor_m = None;
                continue;
            }
            let velocity = body.velocity_ned_m_s + body.attitude * body.rates_frd_rad_s.cross(&point.offset_frd_m);
            // The ground pushes, it never pulls.
            let normal = (stiffness * place.z + damping * velocity.z).max(0.0);
            let (north, east) = point.anchor_m.unwrap_or((place.x, place.y));
            let mut fx = stiffness * (north - place.x) - damping * velocity.x;
            let mut fy = stiffness * (east - place.y) - damping * velocity.y;
            let (limit, wanted) = (self.params.friction * normal, (fx * fx + fy * fy).sqrt());
            point.anchor_m = if wanted > limit {
                fx *= limit / wanted;
                fy *= limit / wanted;
                // Slides: the spring keeps no more stretch than friction can hold.
                Some((place.x + fx / stiffness, place.y + fy / stiffness))
            } else {
                Some((north, east))
            };
            let force = Vec3::new(fx, fy, -normal);
            force_ned_n += force;
            torque_frd_n_m += body.attitude.inverse_transform_vector(&arm.cross(&force));
            touches = true;
        }
        touches.then_some((force_ned_n, torque_frd_n_m))
    }

    /// Anchors, for the state hash.
    pub(crate) fn anchors_m(&self) -> impl Iterator<Item = (f64, f64)> {
        self.points.iter().filter_map(|p| p.anchor_m)
    }
}
