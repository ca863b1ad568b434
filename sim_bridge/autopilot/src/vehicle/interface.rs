//! What others see of the vehicle and ask of it: the seam between dynamics, MAVLink endpoint and simulator.

use vigil_types::{Attitude, FrdVector, HeadingVector, Nanos, NedVector};

/// Where a vehicle is and how it moves.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Motion {
    /// Simulated time.
    pub at_ns: Nanos,
    /// Metres from home (local origin, on the ground at the start).
    pub position_ned_m: NedVector,
    /// Metres per second.
    pub velocity_ned_m_s: NedVector,
    /// Body to NED.
    pub attitude: Attitude,
    /// Body rates.
    pub rates_frd_rad_s: FrdVector,
}

/// What the autopilot's estimator believes: what telemetry reports and what the controllers use. Never the truth.
pub type Estimate = Motion;
/// The simulator's truth: for the referee, the LiDAR and tests; telemetry never carries it.
pub type Truth = Motion;

/// Raw-ish sensor readings, for the telemetry that reports them.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sensors {
    /// Specific force, metres per second squared.
    pub accelerometer_frd_m_s2: FrdVector,
    /// Body rates.
    pub gyroscope_frd_rad_s: FrdVector,
    /// GPS position error included, metres from home.
    pub gps_position_ned_m: NedVector,
    /// GPS velocity.
    pub gps_velocity_ned_m_s: NedVector,
    /// Barometric height above home, metres.
    pub barometer_height_m: f32,
    /// Battery terminal voltage.
    pub battery_voltage_v: f32,
    /// Battery current.
    pub battery_current_a: f32,
    /// Battery charge, 0 to 1.
    pub battery_remaining: f32,
    /// Mean motor command, 0 to 1.
    pub throttle: f32,
    /// Commanded speed of each motor as a share of its top speed, in PX4's order: front right, rear left, front left,
    /// rear right.
    pub motors: [f32; 4],
}

/// Everything the MAVLink endpoint may look at.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct VehicleView {
    /// The estimator's belief.
    pub estimate: Estimate,
    /// Sensor readings.
    pub sensors: Sensors,
    /// The vehicle touches the ground (weight on it).
    pub on_ground: bool,
    /// The motors are allowed to turn.
    pub armed: bool,
}

/// How yaw is commanded beside a velocity or position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum YawCommand {
    /// Keep the heading that was held when this began.
    Hold,
    /// Turn to this heading, radians clockwise from north.
    Angle(f32),
    /// Turn at this rate, radians per second, clockwise.
    Rate(f32),
}

/// Which axes of a place are held; on the others a velocity is flown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Held {
    /// The place, with a velocity to feed forward.
    All,
    /// The horizontal place, while the vehicle climbs or descends.
    Level,
    /// The height alone; the velocity's vertical part is not used.
    Height,
}

/// A place to go to and hold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Goal {
    /// Metres from home.
    pub position_ned_m: NedVector,
    /// Metres per second.
    pub velocity_m_s: NedVector,
    /// What of the place counts.
    pub held: Held,
    /// Horizontal speed limit, metres per second.
    pub speed_limit_m_s: f32,
    /// Yaw.
    pub yaw: YawCommand,
}

impl Goal {
    /// All of a place, to stop there.
    pub const fn new(position_ned_m: NedVector, yaw: YawCommand, speed_limit_m_s: f32) -> Self {
        Self {
            position_ned_m,
            velocity_m_s: NedVector::ZERO,
            held: Held::All,
            speed_limit_m_s,
            yaw,
        }
    }
}

/// What the vehicle's controllers are asked to do in this millisecond. `Copy`, no allocation; the endpoint computes
/// one each step from its flight mode, and the vehicle shapes it with its own limits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ControlCommand {
    /// Motors stopped, whatever the state (disarmed, killed, terminated).
    MotorsOff,
    /// Armed on the ground: motors idle.
    Idle,
    /// Velocity along the heading (yaw-only frame), metres per second: the companion's setpoint.
    VelocityHeading(HeadingVector, YawCommand),
    /// Velocity in NED, metres per second.
    VelocityNed(NedVector, YawCommand),
    /// Go to and hold a place or a part of it.
    Position(Goal),
    /// Acceleration beside gravity's, m/s², within the limits of tilt and thrust: no velocity or place is held.
    Acceleration(NedVector, YawCommand),
    /// Attitude, body to NED; the rate at which its heading turns, radians per second, clockwise; and collective thrust, 0
    /// to 1: 0.5 hovers.
    Attitude(Attitude, f32, f32),
    /// Body rates, radians per second, and collective thrust as above.
    Rates(FrdVector, f32),
    /// Descend over the present point at this rate, metres per second, until on the ground.
    Descend(f32),
}

impl ControlCommand {
    /// Stands still in the air, the heading kept.
    pub const STOP: Self = Self::VelocityNed(NedVector::ZERO, YawCommand::Hold);
}
