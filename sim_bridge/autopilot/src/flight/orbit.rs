//! Circling a point. <https://docs.px4.io/main/en/flight_modes_mc/orbit.html>

use crate::core::Core;
use crate::flight::mode::FlightMode;
use crate::flight::state::{Denial, Facing, Maneuver, Orbit};
use crate::vehicle::{ControlCommand, YawCommand};
use crate::vehicle_parameters::ParamId;
use core::f32::consts::TAU;
use vigil_types::{NedVector, wrap_pi};

/// Largest acceleration towards the centre; a smaller circle is flown more slowly.
const CENTRIPETAL_MAX_M_S2: f32 = 2.0;
/// Beyond this distance from the circle the vehicle flies to it before it circles.
const CAPTURE_M: f32 = 3.0;
/// The vehicle's velocity follows a command that turns with about this delay; the command leads by as much.
const VELOCITY_DELAY_S: f32 = 0.6;
/// Points of the circle that are compared with the geofence.
const FENCE_POINTS: u16 = 32;

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
        ControlCommand::Position {
            position_ned_m: orbit.centre_ned_m + NedVector::new(x, y, 0.0),
            velocity_m_s: NedVector::new(vx, vy, 0.0),
            speed_limit_m_s: orbit.speed_m_s.max(self.cruise_speed_m_s(None)),
            yaw,
        }
    }
}
