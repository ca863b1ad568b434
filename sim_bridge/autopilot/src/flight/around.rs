//! Circling a point, and following a target: FOLLOW_TARGET. <https://docs.px4.io/main/en/flight_modes_mc/orbit.html>,
//! <https://docs.px4.io/main/en/flight_modes_mc/follow_me.html>

use crate::core::Core;
use crate::flight::mode::FlightMode;
use crate::flight::state::{Denial, Facing, FollowTarget, Maneuver, Orbit};
use crate::vehicle::{ControlCommand, Goal, YawCommand};
use crate::vehicle_parameters::ParamId;
use core::f32::consts::TAU;
use vigil_types::{Nanos, NedVector, wrap_pi};

/// Largest acceleration towards the centre; a smaller circle is flown more slowly.
const CENTRIPETAL_MAX_M_S2: f32 = 2.0;
/// Beyond this distance from the circle the vehicle flies to it before it circles.
const CAPTURE_M: f32 = 3.0;
/// The vehicle's velocity follows a command that turns with about this delay; the command leads by as much.
const VELOCITY_DELAY_S: f32 = 0.6;
/// Points of the circle that are compared with the geofence.
const FENCE_POINTS: u16 = 32;

/// A target that was silent for longer is lost: reports come once a second.
const LOST_AFTER_NS: Nanos = 3_000_000_000;
/// Reports are fused no sooner after one another than this, as in PX4: between two that are milliseconds apart their resolution of a
/// centimetre looks like metres per second.
const FUSED_AFTER_NS: Nanos = 500_000_000;
/// Slower than this it stands, and its course is what it was.
const STANDING_M_S: f32 = 0.5;
/// No lower than this, metres above home; the least of FLW_TGT_HT.
const LEAST_HEIGHT_M: f32 = 1.0;
/// Speed by which the vehicle may outrun its target to get to its place.
const CATCH_UP_M_S: f32 = 3.0;

impl Core {
    /// Begins to circle.
    pub fn begin_orbit(&mut self, mut orbit: Orbit) -> Result<(), Denial> {
        self.in_air_check(FlightMode::Orbit)?;
        let centre = orbit.centre_ned_m;
        let leaves_fence = (0..FENCE_POINTS).any(|i| {
            let bearing = f32::from(i) * TAU / f32::from(FENCE_POINTS);
            let north = centre.x + orbit.radius_m * libm::cosf(bearing);
            let east = centre.y + orbit.radius_m * libm::sinf(bearing);
            !self.fence_allows((north, east), -centre.z)
        });
        if leaves_fence {
            return Err(Denial::OutsideFence);
        }
        self.clear_failsafe();
        let most_m_s = libm::sqrtf(CENTRIPETAL_MAX_M_S2 * orbit.radius_m).min(self.param(ParamId::MaxSpeedMS));
        orbit.speed_m_s = orbit.speed_m_s.min(most_m_s);
        self.enter(FlightMode::Orbit, Maneuver::Orbit(orbit));
        Ok(())
    }

    /// What is being circled.
    pub fn orbit(&self) -> Option<Orbit> {
        match self.commander.maneuver {
            Maneuver::Orbit(orbit) => Some(orbit),
            _ => None,
        }
    }

    pub(super) fn fly_orbit(&mut self, mut orbit: Orbit) -> ControlCommand {
        let estimate = &self.view.estimate;
        let off = estimate.position_ned_m - orbit.centre_ned_m;
        let distance_m = off.horizontal_norm();
        // Over the centre every direction is as good: the nose's.
        let bearing = if distance_m > 0.1 {
            libm::atan2f(off.y, off.x)
        } else {
            estimate.attitude.yaw_rad()
        };
        let sense = if orbit.is_clockwise { 1.0 } else { -1.0 };
        let off_circle_m = (distance_m - orbit.radius_m).abs();
        if off_circle_m < CAPTURE_M {
            let turned = orbit.bearing_rad.map_or(0.0, |last| sense * wrap_pi(bearing - last));
            orbit.left_rad = orbit.left_rad.map(|left| left - turned);
            orbit.bearing_rad = Some(bearing);
        }
        if orbit.left_rad.is_some_and(|left| left <= 0.0) {
            self.enter(FlightMode::Hold, Maneuver::default());
            return ControlCommand::STOP;
        }
        let ahead_rad = sense * orbit.speed_m_s / orbit.radius_m * VELOCITY_DELAY_S;
        let tangent = bearing + sense * core::f32::consts::FRAC_PI_2;
        let speed_m_s = orbit.speed_m_s * (1.0 - off_circle_m / CAPTURE_M).clamp(0.0, 1.0);
        let yaw = match orbit.facing {
            Facing::Centre => YawCommand::Angle(bearing + core::f32::consts::PI),
            Facing::Tangent => YawCommand::Angle(tangent),
            Facing::Unchanged => YawCommand::Hold,
        };
        self.commander.maneuver = Maneuver::Orbit(orbit);
        let on_circle = |angle: f32, length: f32| (libm::cosf(angle) * length, libm::sinf(angle) * length);
        let (x, y) = on_circle(bearing, orbit.radius_m);
        let (vx, vy) = on_circle(tangent + ahead_rad, speed_m_s);
        let speed_limit_m_s = orbit.speed_m_s.max(self.cruise_speed_m_s(None));
        ControlCommand::Position(Goal {
            velocity_m_s: NedVector::new(vx, vy, 0.0),
            ..Goal::new(orbit.centre_ned_m + NedVector::new(x, y, 0.0), yaw, speed_limit_m_s)
        })
    }

    /// Takes a report of where the target is; `velocity_ned_m_s` is worked out from reports half a second and more apart where it is not
    /// given.
    pub fn see_target(&mut self, position_ned_m: NedVector, velocity_ned_m_s: Option<NedVector>) {
        let now_ns = self.now_ns;
        let fresh = |t: &FollowTarget| now_ns.saturating_sub(t.fused.0) < LOST_AFTER_NS;
        let last = self.commander.follow_target.filter(fresh);
        let now = (now_ns, position_ned_m);
        let since_ns = last.map_or(0, |last| now_ns - last.fused.0);
        let is_fused = last.is_none() || since_ns >= FUSED_AFTER_NS;
        let measured = match last {
            Some(last) if is_fused => (position_ned_m - last.fused.1) * (1e9 / since_ns as f32),
            Some(last) => last.velocity_ned_m_s,
            None => NedVector::ZERO,
        };
        let velocity_ned_m_s = velocity_ned_m_s.unwrap_or(measured);
        let away = position_ned_m - self.view.estimate.position_ned_m;
        // The first course of one that stands is away from the vehicle: behind it is where the vehicle is.
        let before = self.commander.follow_target;
        let before_rad = before.map_or(libm::atan2f(away.y, away.x), |t| t.course_rad);
        let moves = velocity_ned_m_s.horizontal_norm() > STANDING_M_S;
        let now_rad = libm::atan2f(velocity_ned_m_s.y, velocity_ned_m_s.x);
        // FLW_TGT_RS: 0 follows every turn at once, 1 none.
        let kept = before.map_or(0.0, |_| self.param(ParamId::FollowResponsiveness));
        self.commander.follow_target = Some(FollowTarget {
            reported: now,
            fused: last.filter(|_| !is_fused).map_or(now, |last| last.fused),
            velocity_ned_m_s,
            course_rad: if moves && is_fused {
                wrap_pi(before_rad + (1.0 - kept) * wrap_pi(now_rad - before_rad))
            } else {
                before_rad
            },
        });
    }

    /// Keeps its place beside the target (FLW_TGT_*), the nose at it; without one it waits where it is.
    pub(super) fn fly_follow(&mut self, waits_ned_m: Option<NedVector>) -> ControlCommand {
        let now_ns = self.now_ns;
        let here = self.view.estimate.position_ned_m;
        let is_fresh = |t: &FollowTarget| now_ns.saturating_sub(t.reported.0) <= LOST_AFTER_NS;
        let Some(target) = self.commander.follow_target.filter(is_fresh) else {
            let position_ned_m = waits_ned_m.unwrap_or(here);
            self.commander.maneuver = Maneuver::Follow {
                waits_ned_m: Some(position_ned_m),
            };
            let speed_limit_m_s = self.cruise_speed_m_s(self.commander.speed_m_s);
            return ControlCommand::Position(Goal::new(position_ned_m, YawCommand::Hold, speed_limit_m_s));
        };
        self.commander.maneuver = Maneuver::Follow { waits_ned_m: None };
        let (at_ns, reported_ned_m) = target.reported;
        let age_s = now_ns.saturating_sub(at_ns) as f32 * 1e-9;
        let velocity_m_s = NedVector::new(target.velocity_ned_m_s.x, target.velocity_ned_m_s.y, 0.0);
        let now_at = reported_ned_m + velocity_m_s * age_s;
        let bearing_rad = target.course_rad + self.param(ParamId::FollowAngleDeg).to_radians();
        let distance_m = self.param(ParamId::FollowDistanceM);
        let height_m = self.param(ParamId::FollowHeightM);
        // FLW_TGT_ALT_M 2 counts the height from the target; the world is level, so that 0 and 1 are the same.
        let down_m = match self.param(ParamId::FollowAltitudeMode) as i32 {
            // A target may be reported anywhere: not into the ground.
            2 => (now_at.z - height_m).min(-LEAST_HEIGHT_M),
            _ => -height_m,
        };
        let [north_m, east_m] = [libm::cosf(bearing_rad), libm::sinf(bearing_rad)].map(|part| distance_m * part);
        let place = NedVector::new(now_at.x + north_m, now_at.y + east_m, down_m);
        let speed_m_s = velocity_m_s.horizontal_norm() + CATCH_UP_M_S.min(self.param(ParamId::FollowSpeedMS));
        let speed_limit_m_s = speed_m_s.min(self.param(ParamId::MaxSpeedMS));
        let yaw = YawCommand::Angle(libm::atan2f(now_at.y - here.y, now_at.x - here.x));
        ControlCommand::Position(Goal {
            velocity_m_s,
            ..Goal::new(place, yaw, speed_limit_m_s)
        })
    }
}
