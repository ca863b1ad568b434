//! Whether a vehicle takes off, whatever its autopilot calls it: what is seen from below flight height is not what is seen in flight, and
//! an estimate moves then by more than the vehicle does (a real PX4's rose half a metre above the ground on which it stood).

use vigil_types::{Kinematics, VehicleMode, VehicleTelemetry};

/// A vehicle that climbs faster than this and moves slower than that over the ground goes straight up, metres per second; one that
/// climbs fast, with a gust, slower than it climbs and than the last.
const CLIMBS_M_S: f32 = 0.3;
const STRAIGHT_UP_M_S: f32 = 0.5;
const BLOWN_M_S: f32 = 1.0;
/// A vehicle is still leaving the ground up to this height above it, metres, while it is slower than this over the ground, metres per
/// second: PX4 says IN_AIR and MISSION before it climbs, and its velocity is off by up to 0.7 m/s there.
const LEAVES_GROUND_M: f32 = 1.0;
const LEAVES_GROUND_M_S: f32 = 1.0;

/// Follows a vehicle off its ground.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TakeOff {
    /// How far down the ground is that it is about to leave, metres; `None` in the air.
    ground_z_m: Option<f32>,
}

impl TakeOff {
    /// Whether it goes straight up and does not hold, or is still about to, by telemetry that is to be believed.
    pub fn goes_on(&mut self, telemetry: &VehicleTelemetry, kinematics: &Kinematics) -> bool {
        let (z_m, velocity) = (kinematics.position_ned_m.z, kinematics.velocity_ned_m_s);
        let speed_m_s = velocity.horizontal_norm();
        let is_low = |ground_z_m: &f32| speed_m_s < LEAVES_GROUND_M_S && ground_z_m - z_m < LEAVES_GROUND_M;
        self.ground_z_m = if telemetry.is_airborne() {
            self.ground_z_m.filter(is_low)
        } else {
            Some(z_m)
        };
        let holds = telemetry.heartbeat.is_some_and(|h| h.mode == VehicleMode::Hold);
        let climb_m_s = -velocity.z;
        let goes_up = climb_m_s > CLIMBS_M_S && speed_m_s < climb_m_s.clamp(STRAIGHT_UP_M_S, BLOWN_M_S);
        !holds && (self.ground_z_m.is_some() || goes_up)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vigil_types::{Landed, NedVector};

    /// Whether it goes on so high above the ground, at this velocity.
    fn goes_on(take_off: &mut TakeOff, landed: Landed, height_m: f32, north_m_s: f32, down_m_s: f32) -> bool {
        let telemetry = VehicleTelemetry {
            landed,
            ..VehicleTelemetry::default()
        };
        let position_ned_m = NedVector::new(0.0, 0.0, 0.4 - height_m);
        let kinematics = Kinematics::new(0, position_ned_m, NedVector::new(north_m_s, 0.0, down_m_s));
        take_off.goes_on(&telemetry, &kinematics)
    }

    #[test]
    fn a_climb_that_a_gust_blows_aside_is_a_take_off_and_a_climb_to_a_place_is_none() {
        let climbs = |down_m_s, north_m_s| goes_on(&mut TakeOff::default(), Landed::InAir, 0.4, north_m_s, down_m_s);
        assert!(climbs(-0.8, 0.6) && climbs(-0.4, 0.4));
        assert!(!climbs(-0.5, 0.6) && !climbs(-3.0, 1.1) && !climbs(-0.2, 0.1));
    }

    #[test]
    fn a_vehicle_that_its_autopilot_calls_airborne_before_it_climbs_is_still_taking_off() {
        let mut take_off = TakeOff::default();
        let mut takes_off = |landed, height_m, north_m_s| goes_on(&mut take_off, landed, height_m, north_m_s, 0.0);
        assert!(takes_off(Landed::OnGround, 0.0, 0.0));
        assert!(takes_off(Landed::InAir, 0.1, 0.7), "its estimate moves");
        assert!(!takes_off(Landed::InAir, 1.1, 0.0), "it has left the ground");
        assert!(!takes_off(Landed::InAir, 0.5, 0.0), "and is low in flight");
        assert!(takes_off(Landed::OnGround, 0.0, 0.0));
        assert!(!takes_off(Landed::InAir, 0.3, 1.2), "it goes somewhere");
    }
}
