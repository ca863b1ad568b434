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

use crate::motion::Motion;
use vigil_guidance::just_stop::{Course, JustStop, JustStopConfig, JustStopInput, JustStopState};
use vigil_policy::plausibility::has_jumped;
use vigil_policy::{Lookout, Scan};
use vigil_types::{
    Attitude, DepthFrame, FrdVector, GuardNotice, HORIZONTAL_FOV_RAD, Kinematics, Nanos, NedVector, Reason, Reasons,
    StopCause, VehicleMode, VehicleRequest, VehicleTelemetry, wrap_pi,
};

const G_M_S2: f32 = 9.81;
/// Steepest tilt whose thrust is believed, as the sine of the thrust's elevation.
const LEAST_LIFT: f32 = 0.3;
/// So near to the edge of the field of view a course does not count as seen: the vehicle has a width.
const FOV_MARGIN_RAD: f32 = 0.17;

/// Guidance takes a stopped vehicle within this time, or not at all.
const TAKE_NS: Nanos = 15_000_000_000;
/// Slower than this the vehicle stands, metres per second.
const STANDING_M_S: f32 = 0.3;
/// The mission goes on when the straight way to its place is free for so many metres, seen in so many steps in a row.
const FREE_M: f32 = 8.0;
const FREE_STEPS: u16 = 20;

/// Lookout and guard.
pub(crate) struct Guarding {
    config: JustStopConfig,
    lookout: Lookout,
    guard: JustStop,
    last: Option<Kinematics>,
    detour: Detour,
    /// Consecutive steps in which the straight way to the mission's place was free.
    free_steps: u16,
}

/// How a stopped mission gets around what is there.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
enum Detour {
    /// It does not.
    #[default]
    None,
    /// Guidance is to fly to this place, metres north and east, since then.
    Wanted { place_m: (f32, f32), since_ns: Nanos },
    /// Guidance flies there.
    Flown { place_m: (f32, f32) },
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
    /// Where guidance is to fly, once the vehicle stands: metres north and east, and height above the local origin.
    pub fly_to_m: Option<(f32, f32, f32)>,
}

/// What they are given.
#[derive(Debug, Clone, Copy)]
pub(crate) struct GuardingInput<'a> {
    pub now_ns: Nanos,
    pub telemetry: &'a VehicleTelemetry,
    /// How the vehicle moves, where the telemetry is to be believed.
    pub motion: Option<Motion>,
    /// The newest frame that can be believed and is fresh.
    pub frame: Option<&'a DepthFrame>,
    /// What was stopped is to be flown around.
    pub flies_around: bool,
    /// Where the vehicle's mission leads, metres north and east.
    pub mission_place_m: Option<(f32, f32)>,
}

impl Guarding {
    pub fn new(config: JustStopConfig) -> Self {
        Self {
            config,
            lookout: Lookout::new(),
            guard: JustStop::default(),
            last: None,
            detour: Detour::None,
            free_steps: 0,
        }
    }

    /// What was seen last.
    pub fn scan(&self) -> &Scan {
        self.lookout.scan()
    }

    /// Looks; the course, if it could be seen, and whether the position jumped.
    fn look(&mut self, input: &GuardingInput<'_>) -> (Option<Course>, bool) {
        let GuardingInput {
            now_ns,
            telemetry,
            motion,
            frame,
            ..
        } = *input;
        // Frames taken on the ground show the ground at the vehicle's own height.
        let airborne = telemetry.is_airborne();
        let jumped = motion.is_some_and(|motion| self.has_jumped(motion.kinematics));
        if jumped || !airborne {
            self.lookout.reset();
        }
        let mut course = None;
        if let (Some(motion), Some(depth), true) = (motion, frame, airborne) {
            self.lookout
                .observe(&motion.pilot_input(now_ns, depth, NedVector::ZERO));
            course = Some(self.course(&motion.kinematics, motion.sample.attitude));
        }
        (course, jumped && airborne)
    }

    /// One step in which somebody else flies.
    pub fn step(&mut self, input: &GuardingInput<'_>) -> Guarded {
        let GuardingInput { now_ns, telemetry, .. } = *input;
        let kinematics = input.motion.map(|motion| motion.kinematics);
        let (course, jumped) = self.look(input);
        let before = self.guard.state();
        let state = self.guard.step(
            &self.config,
            &JustStopInput {
                now_ns,
                heartbeat: telemetry.heartbeat,
                airborne: telemetry.is_airborne(),
                speed_m_s: kinematics.map(|k| k.velocity_ned_m_s.horizontal_norm()),
                course,
            },
        );
        let (fly_to_m, notice) = self.plan_detour(input, kinematics, before, state);
        let notice = match (state, before) {
            (JustStopState::Unguarded, before) if before != JustStopState::Unguarded => Some(GuardNotice::Unguarded),
            _ if jumped => Some(GuardNotice::Jumped),
            _ => notice,
        };
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
            notice,
            fly_to_m,
        }
    }

    /// What becomes of a stop: where guidance is to fly, and what people are told.
    fn plan_detour(
        &mut self,
        input: &GuardingInput<'_>,
        kinematics: Option<Kinematics>,
        before: JustStopState,
        state: JustStopState,
    ) -> (Option<(f32, f32, f32)>, Option<GuardNotice>) {
        let mode = input.telemetry.heartbeat.map(|h| h.mode);
        match (self.detour, state) {
            // Guidance let go of it.
            (Detour::Flown { .. }, _) => {
                self.detour = Detour::None;
                let back = mode == Some(VehicleMode::Mission);
                (None, back.then_some(GuardNotice::HandedBack))
            }
            (_, JustStopState::Stopping(StopCause::Obstacle { .. }))
                if input.flies_around && state != before && mode == Some(VehicleMode::Mission) =>
            {
                match input.mission_place_m {
                    Some(place_m) => {
                        self.detour = Detour::Wanted {
                            place_m,
                            since_ns: input.now_ns,
                        };
                        (None, None)
                    }
                    None => (None, Some(GuardNotice::StaysStopped)),
                }
            }
            (Detour::Wanted { since_ns, .. }, _) if input.now_ns.saturating_sub(since_ns) > TAKE_NS => {
                self.detour = Detour::None;
                (None, Some(GuardNotice::StaysStopped))
            }
            (Detour::Wanted { place_m, .. }, JustStopState::Stopped(_)) => {
                let standing = kinematics.filter(|k| k.velocity_ned_m_s.norm() < STANDING_M_S);
                (standing.map(|k| (place_m.0, place_m.1, -k.position_ned_m.z)), None)
            }
            (Detour::Wanted { .. }, JustStopState::Stopping(_)) | (Detour::None, _) => (None, None),
            // Somebody took it on.
            (Detour::Wanted { .. }, _) => {
                self.detour = Detour::None;
                (None, None)
            }
        }
    }

    /// Guidance was engaged to fly around.
    pub fn engaged(&mut self) {
        if let Detour::Wanted { place_m, .. } = self.detour {
            self.detour = Detour::Flown { place_m };
            self.free_steps = 0;
        }
    }

    /// One step in which guidance has the vehicle. `guided`: it flies; `reached`: it is at the mission's place.
    pub fn accompany(&mut self, input: &GuardingInput<'_>, guided: bool, reached: bool) -> VehicleRequest {
        self.look(input);
        let (Detour::Flown { place_m }, Some(Motion { kinematics: k, sample })) = (self.detour, input.motion) else {
            return VehicleRequest::None;
        };
        let way = NedVector::new(place_m.0 - k.position_ned_m.x, place_m.1 - k.position_ned_m.y, 0.0);
        let off_nose_rad = wrap_pi(libm::atan2f(way.y, way.x) - sample.attitude.yaw_rad());
        let free = guided
            && off_nose_rad.abs() < 0.25 * HORIZONTAL_FOV_RAD
            && self
                .lookout
                .obstacle_ahead_m(k.position_ned_m, way, way.horizontal_norm().min(FREE_M))
                .is_none();
        // Once free for long enough, it stays so until the vehicle has changed its mode.
        self.free_steps = match (self.free_steps >= FREE_STEPS, free) {
            (true, _) => self.free_steps,
            (false, true) => self.free_steps.saturating_add(1),
            (false, false) => 0,
        };
        if reached || self.free_steps >= FREE_STEPS {
            VehicleRequest::Resume
        } else {
            VehicleRequest::None
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
        self.last.replace(now).is_some_and(|last| has_jumped(&last, &now))
    }
}

/// Acceleration along the velocity, metres per second squared, as the thrust's lean gives it: what drag takes away is not
/// counted, which errs to the careful side.
fn gain_m_s2(attitude: Attitude, velocity: NedVector, speed_m_s: f32) -> f32 {
    let thrust = attitude.to_ned(FrdVector::new(0.0, 0.0, -1.0));
    let lift = (-thrust.z).max(LEAST_LIFT);
    G_M_S2 * (thrust.x * velocity.x + thrust.y * velocity.y) / (lift * speed_m_s)
}
