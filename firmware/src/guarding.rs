//! Guards somebody else's flight: what the lookout sees, what the guard makes of it, what the vehicle is asked
//! (docs/just-stop.md).
#![deny(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::std_instead_of_core,
    clippy::alloc_instead_of_core
)]

use vigil_guidance::just_stop::{Course, JustStop, JustStopConfig, JustStopInput, JustStopState};
use vigil_policy::{Lookout, PilotInput, Scan};
use vigil_types::{
    Attitude, DepthFrame, FrdVector, GoalRelative, GuardNotice, HORIZONTAL_FOV_RAD, Kinematics, Nanos, NedVector,
    Reason, Reasons, StopCause, VehicleRequest, VehicleTelemetry, wrap_pi,
};

const G_M_S2: f32 = 9.81;
/// Steepest tilt whose thrust is believed, as the sine of the thrust's elevation.
const LEAST_LIFT: f32 = 0.3;
/// So near to the edge of the field of view a course does not count as seen: the vehicle has a width.
const FOV_MARGIN_RAD: f32 = 0.17;
/// A position this far from where the velocity led since the last one has jumped; the second allows for each second between them.
const JUMP_M: f32 = 1.0;
const JUMP_M_S: f32 = 10.0;

/// Lookout and guard.
pub(crate) struct Guarding {
    config: JustStopConfig,
    lookout: Lookout,
    guard: JustStop,
    last: Option<Kinematics>,
}

/// What they want in a step.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Guarded {
    /// What the vehicle is asked.
    pub request: VehicleRequest,
    /// Why, for the report.
    pub reasons: Reasons,
    /// The lookout looked: what it sees may be told as obstacles.
    pub looked: bool,
    /// What to tell people.
    pub notice: Option<GuardNotice>,
}

impl Guarding {
    pub fn new(config: JustStopConfig) -> Self {
        Self {
            config,
            lookout: Lookout::new(),
            guard: JustStop::default(),
            last: None,
        }
    }

    /// What was seen last.
    pub fn scan(&self) -> &Scan {
        self.lookout.scan()
    }

    /// One step. `known`: the telemetry is fresh; `frame`: the newest that can be believed and is fresh.
    pub fn step(
        &mut self,
        now_ns: Nanos,
        telemetry: &VehicleTelemetry,
        known: bool,
        frame: Option<&DepthFrame>,
    ) -> Guarded {
        // Frames taken on the ground show the ground at the vehicle's own height.
        let airborne = telemetry.is_airborne();
        let (kinematics, attitude) = match (telemetry.kinematics, telemetry.attitude) {
            (Some(k), Some(a)) if known && telemetry.is_finite() => (Some(k), Some(a.attitude)),
            _ => (None, None),
        };
        let jumped = kinematics.is_some_and(|kinematics| self.has_jumped(kinematics));
        if jumped || !airborne {
            self.lookout.reset();
        }
        let mut course = None;
        if let (Some(k), Some(attitude), Some(depth), true) = (kinematics, attitude, frame, airborne) {
            self.lookout.observe(&PilotInput {
                now_ns,
                depth,
                goal: GoalRelative {
                    distance_m: 0.0,
                    bearing_rad: 0.0,
                },
                attitude,
                velocity_m_s: k.velocity_ned_m_s.to_heading(attitude.yaw_rad()),
                height_m: -k.position_ned_m.z,
            });
            course = Some(self.course(&k, attitude));
        }
        let before = self.guard.state();
        let state = self.guard.step(
            &self.config,
            &JustStopInput {
                now_ns,
                heartbeat: telemetry.heartbeat,
                airborne,
                speed_m_s: kinematics.map(|k| k.velocity_ned_m_s.horizontal_norm()),
                course,
            },
        );
        Guarded {
            request: match state {
                JustStopState::Stopping(cause) => VehicleRequest::Hold(cause),
                _ => VehicleRequest::None,
            },
            // A blind stop has its reasons among guidance's own.
            reasons: Reasons::NONE.with_if(
                matches!(state.cause(), Some(StopCause::Obstacle { .. })),
                Reason::CollisionCourse,
            ),
            looked: course.is_some(),
            notice: match (state, before) {
                (JustStopState::Unguarded, before) if before != JustStopState::Unguarded => {
                    Some(GuardNotice::Unguarded)
                }
                _ if jumped && airborne => Some(GuardNotice::Jumped),
                _ => None,
            },
        }
    }

    /// What is seen along the velocity.
    fn course(&self, kinematics: &Kinematics, attitude: Attitude) -> Course {
        let velocity = kinematics.velocity_ned_m_s;
        let speed_m_s = velocity.horizontal_norm();
        if speed_m_s <= 0.0 {
            return Course::default();
        }
        let reach_m = self.config.reach_m(speed_m_s, gain_m_s2(attitude, velocity, speed_m_s));
        let off_nose_rad = wrap_pi(libm::atan2f(velocity.y, velocity.x) - attitude.yaw_rad());
        Course {
            obstacle_m: self
                .lookout
                .obstacle_ahead_m(kinematics.position_ned_m, velocity, reach_m),
            unseen: off_nose_rad.abs() > 0.5 * HORIZONTAL_FOV_RAD - FOV_MARGIN_RAD,
        }
    }

    /// Whether the vehicle is told to be where it cannot have come to since the last position.
    fn has_jumped(&mut self, now: Kinematics) -> bool {
        let Some(last) = self.last.replace(now) else {
            return false;
        };
        let passed_s = now.at_ns.saturating_sub(last.at_ns) as f32 * 1e-9;
        let led_to_ned_m = last.position_ned_m + last.velocity_ned_m_s * passed_s;
        (now.position_ned_m - led_to_ned_m).norm() > JUMP_M + JUMP_M_S * passed_s
    }
}

/// Acceleration along the velocity, metres per second squared, as the thrust's lean gives it: what drag takes away is not
/// counted, which errs to the careful side.
fn gain_m_s2(attitude: Attitude, velocity: NedVector, speed_m_s: f32) -> f32 {
    let thrust = attitude.to_ned(FrdVector::new(0.0, 0.0, -1.0));
    let lift = (-thrust.z).max(LEAST_LIFT);
    G_M_S2 * (thrust.x * velocity.x + thrust.y * velocity.y) / (lift * speed_m_s)
}
