//! What flight remembers: modes, maneuvers, sticks. How they change is in the other files, which know the core; these types do
//! not.

use crate::config::Source;
use crate::flight::mode::FlightMode;
use crate::vehicle::{ControlCommand, Estimate, Goal};
use vigil_types::{FrdVector, Nanos, NedVector};

/// Deceleration that the end of a climb is planned with; below what the vehicle's position control brakes with.
const CLIMB_BRAKING_M_S2: f32 = 0.4;
/// Margin on that distance, for the jerk limit's delay.
const CLIMB_MARGIN_M: f32 = 0.5;
/// Whether the vehicle is on the ground, as EXTENDED_SYS_STATE has it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LandedState {
    /// Weight on the ground.
    #[default]
    OnGround,
    /// Climbing in a take-off.
    TakingOff,
    /// In the air.
    InAir,
    /// Descending in a landing.
    Landing,
}

vigil_types::named! {
    /// A failsafe in force: the vehicle acts by itself until a new mode command comes.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum Failsafe {
        /// The owner's setpoints stopped in OFFBOARD.
        SetpointLost => "setpoint lost",
        /// The vehicle left its geofence.
        GeofenceBreached => "geofence breached",
        /// The sticks stopped in a mode that is flown by them.
        ManualControlLost => "manual control lost",
        /// The GPS receiver stopped, and with it the position.
        PositionLost => "position lost",
    }
}

/// Why arming, disarming or a mode change is refused: what somebody distinguishes, and all else as text.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(crate) enum Denial {
    #[error("{0} denied: flight terminated, reboot first")]
    Terminated(&'static str),
    #[error("arming denied: vehicle is tilted")]
    Tilted,
    /// None, or refused ones.
    #[error("offboard denied: {0}")]
    NoSetpoints(String),
    #[error("mission denied: no mission")]
    NoMission,
    #[error("denied: outside the geofence")]
    OutsideFence,
    #[error("arming denied: {0} lost")]
    SensorLost(&'static str),
    #[error("{0}")]
    Other(String),
}

/// Flight state.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Commander {
    pub armed: bool,
    pub terminated: bool,
    /// Hit something: nothing flies until a reboot.
    pub broken: bool,
    pub mode: FlightMode,
    /// The mode that was asked for; during a failsafe another one is flown.
    pub intended_mode: FlightMode,
    pub(super) maneuver: Maneuver,
    /// The last command that its maneuver gave.
    pub(super) flown: Option<ControlCommand>,
    pub failsafe: Option<Failsafe>,
    /// Somebody had the sticks in the last step.
    pub(super) had_sticks: bool,
    /// When the action of NAV_RCL_ACT follows the hold of lost sticks.
    pub(super) acts_ns: Option<Nanos>,
    /// Whose setpoints were lost.
    pub(super) lost_owner: Option<Source>,
    pub landed: LandedState,
    /// Contact with the ground (or its absence) and since when.
    pub(super) contact: bool,
    pub(super) contact_since_ns: Nanos,
    /// Since when it neither moves nor is asked for a thrust that could carry it.
    pub(super) rests_since_ns: Nanos,
    /// Was in the air since it was armed.
    pub(super) has_flown: bool,
    /// Since when it is armed on the ground.
    pub(super) idle_since_ns: Nanos,
    /// What follow mode follows.
    pub follow_target: Option<FollowTarget>,
    /// What the nose points at in hold and on missions: metres north and east of the local origin.
    pub region_of_interest_m: Option<(f32, f32)>,
    /// Speed that DO_CHANGE_SPEED asked for, until disarming.
    pub(super) speed_m_s: Option<f32>,
    /// Where Return mode flies to: metres north and east of the local origin.
    pub(super) return_to_m: (f32, f32),
}

impl Commander {
    pub fn is_on_ground(&self) -> bool {
        self.landed == LandedState::OnGround
    }
}

/// A climb straight up: at a constant rate, then by position control.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Climb {
    pub(super) target_ned_m: NedVector,
    pub(super) rate_m_s: f32,
}

/// What is being flown. The mode decides what follows when it is done.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Maneuver {
    /// Stop, then hold where it stopped, at `height_m` if given.
    Brake {
        /// When, and at which level velocity, metres per second.
        began: Option<(Nanos, NedVector)>,
        height_m: Option<f32>,
    },
    /// Waits for arming to take off to this height.
    Grounded { height_m: Option<f32> },
    /// Climbs straight up.
    Climb(Climb),
    /// Goes to a position and holds it.
    Station(Goal),
    /// Descends straight down until on the ground.
    Descend,
    /// Obeys the owner's setpoints.
    Offboard,
    /// Flown by sticks; in altitude mode at this height (positive down) while the throttle is centred.
    Sticks { held_down_m: Option<f32> },
    /// Keeps its place beside a target; where it waits while there is none.
    Follow { waits_ned_m: Option<NedVector> },
    /// Circles a point.
    Orbit(Orbit),
}

impl Default for Maneuver {
    fn default() -> Self {
        Self::Brake {
            began: None,
            height_m: None,
        }
    }
}

impl Maneuver {
    pub fn climb(from_ned_m: NedVector, target_z_m: f32, rate_m_s: f32) -> Self {
        Self::Climb(Climb {
            target_ned_m: NedVector::new(from_ned_m.x, from_ned_m.y, target_z_m),
            rate_m_s,
        })
    }
}

impl Climb {
    /// Whether what is left of the way is so long that the rate limits the climb.
    pub(super) fn is_cruising(&self, z_m: f32) -> bool {
        let braking_m = self.rate_m_s * self.rate_m_s / (2.0 * CLIMB_BRAKING_M_S2);
        z_m - self.target_ned_m.z > braking_m + CLIMB_MARGIN_M
    }

    /// Whether the height is reached and the vehicle rests there.
    pub fn is_done(&self, estimate: &Estimate) -> bool {
        (estimate.position_ned_m.z - self.target_ned_m.z).abs() < 0.2 && estimate.velocity_ned_m_s.z.abs() < 0.2
    }
}

/// Where the nose points (ORBIT_YAW_BEHAVIOUR).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Facing {
    Centre,
    /// As it was.
    Unchanged,
    Tangent,
}

/// A circle and how it is flown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Orbit {
    pub centre_ned_m: NedVector,
    pub radius_m: f32,
    pub is_clockwise: bool,
    pub speed_m_s: f32,
    pub facing: Facing,
    /// Angle that is left; `None` is without end.
    pub left_rad: Option<f32>,
    /// Bearing from the centre in the last step on the circle.
    pub bearing_rad: Option<f32>,
}

/// What a sensor reports after INJECT_FAILURE instead of what it measures: nothing any more (`Some(None)`), or the same reading again and
/// again, which the estimator notices and does without.
pub(crate) type SensorFault<T> = Option<Option<T>>;

/// Sensors that INJECT_FAILURE has taken away.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct LostSensors {
    /// Since when.
    pub gps_since_ns: Option<Nanos>,
    /// Height above home, metres.
    pub barometer: SensorFault<f32>,
    /// Field in gauss.
    pub magnetometer: SensorFault<FrdVector>,
}

impl LostSensors {
    /// The first that is lost.
    pub fn name(&self) -> Option<&'static str> {
        match self.gps_since_ns {
            Some(_) => Some("GPS"),
            None if self.barometer.is_some() => Some("barometer"),
            None => self.magnetometer.is_some().then_some("compass"),
        }
    }
}

/// What FOLLOW_TARGET reported: when it came, and where the target was.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FollowTarget {
    pub reported: (Nanos, NedVector),
    /// The report that velocity and course were worked out with last.
    pub fused: (Nanos, NedVector),
    pub velocity_ned_m_s: NedVector,
    /// Where it goes, clockwise from north: kept while it stands.
    pub course_rad: f32,
}

/// Deflections forward, right, up and clockwise, each from −1 to 1.
pub(crate) type Deflections = [f32; 4];

/// The newest sticks, and whose they are. Two stations' sticks never mix: who streams keeps the vehicle until silent.
#[derive(Debug, Default)]
pub(crate) struct Sticks {
    owners: Option<(Source, Nanos, Deflections)>,
    /// Another station's, which has the vehicle as soon as the owner is silent.
    waiting: Option<(Source, Nanos, Deflections)>,
}

impl Sticks {
    /// Takes what a station sends; `false` if another one has the vehicle.
    pub fn take(&mut self, now_ns: Nanos, max_age_ns: Nanos, from: Source, deflections: Deflections) -> bool {
        self.owners = self.fresh(now_ns, max_age_ns);
        let is_others = self.owners.is_some_and(|(owner, ..)| owner != from);
        let place = if is_others { &mut self.waiting } else { &mut self.owners };
        *place = Some((from, now_ns, deflections));
        !is_others
    }

    /// A station that waited gives up; an owner's sticks grow old.
    pub fn release(&mut self, from: Source) {
        self.waiting.take_if(|(waiting, ..)| *waiting == from);
    }

    fn fresh(&self, now_ns: Nanos, max_age_ns: Nanos) -> Option<(Source, Nanos, Deflections)> {
        let mut all = [self.owners, self.waiting].into_iter().flatten();
        all.find(|(_, at_ns, _)| now_ns.saturating_sub(*at_ns) <= max_age_ns)
    }

    /// The sticks, unless they are older than that.
    pub fn current(&self, now_ns: Nanos, max_age_ns: Nanos) -> Option<Deflections> {
        self.fresh(now_ns, max_age_ns).map(|(_, _, deflections)| deflections)
    }
}
