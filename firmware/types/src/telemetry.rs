//! What the guidance computer knows of its vehicle, whatever autopilot it is.

use crate::{Attitude, FrdVector, Nanos, NedVector, named};

named! {
    /// The vehicle's flight mode, reduced to what guidance must tell apart. The log knows it by its number, which never changes meaning.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
    pub enum VehicleMode {
        /// Not known yet.
        #[default]
        Unknown = 0 => "unknown",
        /// It obeys setpoints from outside: OFFBOARD (PX4), GUIDED (ArduPilot).
        External = 1 => "external",
        /// It holds its position by itself.
        Hold = 2 => "hold",
        /// It is taking off by itself.
        Takeoff = 3 => "take-off",
        /// It is landing by itself.
        Land = 4 => "land",
        /// It returns home by itself.
        Return = 5 => "return",
        /// It flies a mission by itself.
        Mission = 6 => "mission",
        /// A person's sticks fly it, or any mode that takes no setpoints.
        Other = 7 => "other",
    }
}

named! {
    /// Whether the vehicle is on the ground, by its own estimate (EXTENDED_SYS_STATE). Numbers as [`VehicleMode`]'s.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
    pub enum Landed {
        /// Not known yet.
        #[default]
        Unknown = 0 => "unknown",
        /// On the ground.
        OnGround = 1 => "on the ground",
        /// Taking off.
        TakingOff = 2 => "taking off",
        /// In the air.
        InAir = 3 => "in the air",
        /// Landing.
        Landing = 4 => "landing",
    }
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

impl Kinematics {
    /// Position and velocity as they arrived at that time.
    pub const fn new(at_ns: Nanos, position_ned_m: NedVector, velocity_ned_m_s: NedVector) -> Self {
        Self {
            at_ns,
            position_ned_m,
            velocity_ned_m_s,
        }
    }
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

impl AttitudeSample {
    /// Attitude and rates as they arrived at that time.
    pub const fn new(at_ns: Nanos, attitude: Attitude, rates_frd_rad_s: FrdVector) -> Self {
        Self {
            at_ns,
            attitude,
            rates_frd_rad_s,
        }
    }
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

/// How an autopilot changes its speed in a mission and in its hold, by its own parameters; `None` what is not known.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MissionMotion {
    /// What it gains speed with: PX4's MPC_ACC_HOR, Copter's WPNAV_ACCEL; metres per second squared.
    pub gain_m_s2: Option<f32>,
    /// What it brakes with: PX4's MPC_ACC_HOR (Copter's BRAKE has no parameter); metres per second squared.
    pub braking_m_s2: Option<f32>,
    /// PX4's MPC_JERK_AUTO, Copter's PSC_JERK_XY; metres per second cubed.
    pub jerk_m_s3: Option<f32>,
}

impl VehicleTelemetry {
    /// Whether the vehicle is off the ground, by its own word, or by its height when it does not say.
    pub fn is_airborne(&self) -> bool {
        match self.landed {
            Landed::OnGround => false,
            Landed::InAir | Landed::TakingOff | Landed::Landing => true,
            Landed::Unknown => self.kinematics.is_some_and(|k| -k.position_ned_m.z > AIRBORNE_HEIGHT_M),
        }
    }

    /// Whether the vehicle certainly stands: it is not armed, or says that it is on the ground.
    pub fn stands(&self) -> bool {
        !self.heartbeat.is_some_and(|heartbeat| heartbeat.armed) || self.landed == Landed::OnGround
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

/// Sectors that one report may have: as many as OBSTACLE_DISTANCE has
/// (<https://mavlink.io/en/messages/common.html#OBSTACLE_DISTANCE>).
pub const RANGE_SECTORS: usize = 72;
/// Components of a vehicle whose reports are looked at side by side.
pub const RANGE_SOURCES: usize = 4;

/// What a second sensor sees at the vehicle's own height: the nearest surface in each of a row of sectors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SectorRanges {
    /// The component of the vehicle that it came from.
    pub component: u8,
    /// When it arrived.
    pub at_ns: Nanos,
    /// Bearing of the first sector's middle, radians, clockwise from the nose.
    pub first_rad: f32,
    /// From one sector's middle to the next, radians; negative where they are given counter-clockwise.
    pub step_rad: f32,
    /// Horizontal distance in metres, infinite where nothing is within the sensor's reach; NaN where nothing is known.
    pub range_m: [f32; RANGE_SECTORS],
}

impl SectorRanges {
    /// The sectors of which something is known: bearing of the middle, radians, and distance, metres.
    pub fn known(&self) -> impl Iterator<Item = (f32, f32)> + '_ {
        let each = self.range_m.iter().enumerate();
        each.filter(|(_, range_m)| !range_m.is_nan())
            .map(|(i, range_m)| (self.first_rad + i as f32 * self.step_rad, *range_m))
    }
}
