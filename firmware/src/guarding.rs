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

use vigil_guidance::just_stop::{Course, JustStop, JustStopInput, JustStopState, StopCause, stopping_reach_m};
use vigil_policy::{Lookout, PilotInput, Scan};
use vigil_types::{DepthFrame, GoalRelative, Nanos, Reason, Reasons, VehicleRequest, VehicleTelemetry};

/// Lookout and guard.
pub(crate) struct Guarding {
    lookout: Lookout,
    guard: JustStop,
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
}

impl Guarding {
    pub fn new() -> Self {
        Self {
            lookout: Lookout::new(),
            guard: JustStop::default(),
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
        let mut course = None;
        match (kinematics, attitude, frame) {
            (Some(k), Some(attitude), Some(depth)) if airborne => {
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
                let reach_m = stopping_reach_m(k.velocity_ned_m_s.horizontal_norm());
                course = Some(Course {
                    obstacle_m: self
                        .lookout
                        .obstacle_ahead_m(k.position_ned_m, k.velocity_ned_m_s, reach_m),
                });
            }
            _ if !airborne => self.lookout.reset(),
            _ => {}
        }
        let state = self.guard.step(&JustStopInput {
            now_ns,
            heartbeat: telemetry.heartbeat,
            airborne,
            velocity_ned_m_s: kinematics.map(|k| k.velocity_ned_m_s),
            course,
        });
        let request = match state {
            JustStopState::Stopping(StopCause::Obstacle { ahead_m }) => VehicleRequest::Hold {
                obstacle_m: Some(ahead_m),
            },
            JustStopState::Stopping(StopCause::Blind) => VehicleRequest::Hold { obstacle_m: None },
            _ => VehicleRequest::None,
        };
        Guarded {
            request,
            // A blind stop has its reasons among guidance's own.
            reasons: Reasons::NONE.with_if(
                matches!(state.cause(), Some(StopCause::Obstacle { .. })),
                Reason::CollisionCourse,
            ),
            looked: course.is_some(),
        }
    }
}
