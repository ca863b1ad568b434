//! What the guidance computer knows of its vehicle, whatever autopilot it is.

use crate::{Attitude, FrdVector, Nanos, NedVector};

crate::named! {
    /// The vehicle's flight mode, reduced to what guidance must tell apart.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
    pub enum VehicleMode {
        /// Not known yet.
        #[default]
        Unknown => "unknown",
        /// It obeys setpoints from outside: OFFBOARD (PX4), GUIDED (ArduPilot).
        External => "external",
        /// It holds its position by itself.
        Hold => "hold",
        /// It is taking off by itself.
        Takeoff => "take-off",
        /// It is landing by itself.
        Land => "land",
        /// It returns home by itself.
        Return => "return",
        /// It flies a mission by itself.
        Mission => "mission",
        /// A person's sticks fly it, or any mode that takes no setpoints.
        Other => "other",
    }
}

/// Whether the vehicle is on the ground, by its own estimate (EXTENDED_SYS_STATE).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Landed {
    /// Not known yet.
    #[default]
    Unknown,
    /// On the ground.
    OnGround,
    /// Taking off.
    TakingOff,
    /// In the air.
    InAir,
    /// Landing.
    Landing,
}

/// The autopilot's last HEARTBEAT.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Heartbeat {
    /// When it arrived.
    pub at_ns: Nanos,
    /// Motors armed.
    pub armed: bool,
    /// Flight mode.
    pub mode: VehicleMode,
    /// The vehicle says that it is in a failsafe (MAV_STATE CRITICAL or EMERGENCY).
    pub failsafe: bool,
}

/// The vehicle's last LOCAL_POSITION_NED.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Kinematics {
    /// When it arrived.
    pub at_ns: Nanos,
    /// Metres from the local origin.
    pub position_ned_m: NedVector,
    /// Metres per second.
    pub velocity_ned_m_s: NedVector,
}

/// The vehicle's last attitude.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AttitudeSample {
    /// When it arrived.
    pub at_ns: Nanos,
    /// Body to NED.
    pub attitude: Attitude,
    /// Body rates in radians per second.
    pub rates_frd_rad_s: FrdVector,
}

/// Everything known of the vehicle; `None` means never received.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct VehicleTelemetry {
    /// Liveness, arming and mode.
    pub heartbeat: Option<Heartbeat>,
    /// Position and velocity.
    pub kinematics: Option<Kinematics>,
    /// Attitude and rates.
    pub attitude: Option<AttitudeSample>,
    /// On the ground or in the air.
    pub landed: Landed,
    /// Battery charge, 0 to 1.
    pub battery_remaining: Option<f32>,
}

/// Height at which a vehicle that does not tell whether it has landed counts as being in the air, metres above the local
/// origin.
const AIRBORNE_HEIGHT_M: f32 = 0.5;

impl VehicleTelemetry {
    /// Whether the vehicle is off the ground, by its own word, or by its height when it does not say.
    pub fn is_airborne(&self) -> bool {
        match self.landed {
            Landed::OnGround => false,
            Landed::InAir | Landed::TakingOff | Landed::Landing => true,
            Landed::Unknown => self.kinematics.is_some_and(|k| -k.position_ned_m.z > AIRBORNE_HEIGHT_M),
        }
    }

    /// Age of the oldest of heartbeat-independent flight data (position and attitude), or `None` if any was never received.
    pub fn flight_data_age_ns(&self, now_ns: Nanos) -> Option<Nanos> {
        let oldest = self.kinematics?.at_ns.min(self.attitude?.at_ns);
        Some(now_ns.saturating_sub(oldest))
    }

    /// Whether position, velocity, attitude and rates are all received and finite.
    pub fn is_finite(&self) -> bool {
        match (&self.kinematics, &self.attitude) {
            (Some(k), Some(a)) => {
                k.position_ned_m.is_finite()
                    && k.velocity_ned_m_s.is_finite()
                    && a.attitude.is_valid()
                    && a.rates_frd_rad_s.is_finite()
            }
            _ => false,
        }
    }
}
