//! Guards somebody else's flight: what the forward check sees, what the guard makes of it, what the vehicle is asked
//! (docs/just-stop.md).
#![deny(clippy::std_instead_of_core, clippy::alloc_instead_of_core)]

mod air;

use crate::motion::Motion;
use air::Air;
use vigil_guidance::just_stop::{Course, Gain, JustStop, JustStopConfig, JustStopInput, JustStopState};
use vigil_policy::plausibility::has_jumped;
use vigil_policy::{Aside, ForwardCheck, Scan, TakeOff};
use vigil_types::{
    Attitude, DepthFrame, FrdVector, GuardNotice, HORIZONTAL_FOV_RAD, Kinematics, MissionMotion, Nanos, NedVector,
    Reason, Reasons, STEP_S, StopCause, VERTICAL_FOV_RAD, VehicleMode, VehicleRequest, VehicleTelemetry, wrap_pi,
};

const G_M_S2: f32 = 9.81;
/// Steepest tilt whose thrust is believed, as the sine of the thrust's elevation.
const LEAST_LIFT: f32 = 0.3;
/// A vehicle that loses more than this has begun to brake, metres per second squared.
const BRAKES_M_S2: f32 = 0.5;
/// So near to the edge of the field of view a course does not count as seen: the vehicle has a width.
const FOV_MARGIN_RAD: f32 = 0.17;
/// A course that is no farther than this off the way to the mission's place leads there.
const TURNS_RAD: f32 = 0.5;

/// So far ahead a turn is reckoned, seconds.
const TURN_S: f32 = 0.5;

/// A vehicle that was too fast is slow enough again when it needs no more than this part of what is looked ahead.
const SLOW_AGAIN: f32 = 0.9;
/// Kept besides in front of what is going to be flown around, metres.
const TURNING_ROOM_M: f32 = 1.0;
/// Guidance takes a stopped vehicle within this time, or not at all.
const TAKE_NS: Nanos = 15_000_000_000;
/// Slower than this the vehicle stands, metres per second.
const STANDING_M_S: f32 = 0.3;
/// The mission goes on when the straight way to its place is free for so many metres, seen in so many steps in a row.
const FREE_M: f32 = 8.0;
const FREE_STEPS: u16 = 20;
/// And so far to both sides of it, besides what is kept clear of any course.
const BESIDE_M: f32 = 0.4;

/// Forward check and guard.
pub(crate) struct Guarding {
    config: JustStopConfig,
    /// How the vehicle stops in this step: by what it says of itself too; who is going to fly around what stopped it needs room to turn.
    reckoned: JustStopConfig,
    forward_check: ForwardCheck,
    guard: JustStop,
    last: Option<Kinematics>,
    take_off: TakeOff,
    /// It needs more to stop than is looked ahead.
    too_fast: bool,
    air: Option<Air>,
    /// Where the vehicle that is ordered to hold can come to rest, metres north and east.
    stop_place_m: Option<(f32, f32)>,
    detour: Detour,
    /// Consecutive steps in which the straight way to the mission's place was free.
    free_steps: u16,
    /// Stamp of the last frame that was looked at in the air, and the greatest age of one of late, seconds.
    frame_ns: Option<Nanos>,
    oldest_s: f32,
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
    /// The forward check looked: what it sees may be sent as obstacles.
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
    /// The vehicle's estimate has disagreed with itself in this flight.
    pub drifts: bool,
    /// The newest frame that can be believed and is fresh.
    pub frame: Option<&'a DepthFrame>,
    /// What was stopped is to be flown around.
    pub flies_around: bool,
    /// Where the vehicle's mission leads, metres north and east.
    pub mission_place_m: Option<(f32, f32)>,
    /// How the vehicle changes its speed on the way there, as far as it is known.
    pub mission_motion: MissionMotion,
}

/// Frames younger than this are as young as a sensor's are; older than the second nobody sees the course; and the age of one is forgotten
/// in the third time, seconds.
const YOUNG_S: f32 = 0.2;
const OLDEST_S: f32 = 1.0;
const OLDEST_FORGOTTEN_S: f32 = 3.0;

impl Guarding {
    pub fn new(config: JustStopConfig) -> Self {
        Self {
            config,
            reckoned: config,
            forward_check: ForwardCheck::default(),
            guard: JustStop::default(),
            last: None,
            take_off: TakeOff::default(),
            too_fast: false,
            air: None,
            stop_place_m: None,
            detour: Detour::None,
            free_steps: 0,
            frame_ns: None,
            oldest_s: 0.0,
        }
    }

    /// Forgets everything, in place; whether guidance was flying around something.
    pub fn reset(&mut self) -> bool {
        self.forward_check.reset();
        (self.guard, self.last, self.take_off) = (JustStop::default(), None, TakeOff::default());
        (self.too_fast, self.air, self.stop_place_m) = (false, None, None);
        (self.free_steps, self.frame_ns, self.oldest_s) = (0, None, 0.0);
        matches!(core::mem::take(&mut self.detour), Detour::Flown { .. })
    }

    /// What was seen last.
    pub fn scan(&self) -> &Scan {
        self.forward_check.scan()
    }

    /// Looks; the course, if it could be seen, whether the position jumped, and whether it takes off.
    fn look(&mut self, input: &GuardingInput<'_>) -> (Option<Course>, bool, bool) {
        let GuardingInput {
            now_ns,
            telemetry,
            motion,
            frame,
            ..
        } = *input;
        let room_m = if input.flies_around { TURNING_ROOM_M } else { 0.0 };
        self.reckoned = self.config.reckoning_with(input.mission_motion);
        self.reckoned.spare_m += room_m;
        // Frames taken on the ground show the ground at the vehicle's own height.
        let airborne = telemetry.is_airborne();
        self.reckoned.reaction_s += self.late_s(now_ns, frame, airborne);
        let jumped = motion.is_some_and(|motion| self.has_jumped(motion.kinematics));
        let climbs = motion.is_some_and(|motion| self.take_off.goes_on(telemetry, &motion.kinematics));
        // From below flight height too, and a take-off that is an item of a mission is reported as MISSION in the air.
        if jumped || !airborne || climbs {
            self.forward_check.reset();
        }
        match motion {
            Some(Motion { kinematics, sample }) if !jumped => {
                let lean = lean_ned_m_s2(sample.attitude);
                let air = self.air.unwrap_or_else(|| Air::new(&kinematics, lean));
                self.air = Some(air.follow(&kinematics, lean));
            }
            _ => self.air = None,
        }
        let mut course = None;
        if let (Some(motion), Some(depth), true) = (motion, frame, airborne) {
            self.forward_check
                .observe(&motion.pilot_input(now_ns, depth, NedVector::ZERO));
            let flies_mission = telemetry.heartbeat.is_some_and(|h| h.mode == VehicleMode::Mission);
            let place_m = input.mission_place_m.filter(|_| flies_mission);
            course = Some(self.course(&motion, place_m, input.drifts));
        }
        (course, jumped && airborne, climbs)
    }

    /// What comes into view is seen with the next frame, and that may be as late as the last ones were: by how much later than a sensor's
    /// are, seconds.
    fn late_s(&mut self, now_ns: Nanos, frame: Option<&DepthFrame>, airborne: bool) -> f32 {
        let seen_ns = frame.map_or(self.frame_ns, |frame| Some(frame.header.stamp_ns));
        self.frame_ns = seen_ns.filter(|_| airborne);
        let age_ns = self.frame_ns.map_or(0, |stamp_ns| now_ns.saturating_sub(stamp_ns));
        let faded_s = self.oldest_s * (1.0 - STEP_S / OLDEST_FORGOTTEN_S);
        self.oldest_s = faded_s.max((age_ns as f32 * 1e-9).min(OLDEST_S));
        (self.oldest_s - YOUNG_S).max(0.0)
    }

    /// One step in which somebody else flies.
    pub fn step(&mut self, input: &GuardingInput<'_>) -> Guarded {
        let GuardingInput { now_ns, telemetry, .. } = *input;
        let kinematics = input.motion.map(|motion| motion.kinematics);
        let (course, jumped, climbing) = self.look(input);
        let before = self.guard.state();
        let state = self.guard.step(
            &self.reckoned,
            &JustStopInput {
                now_ns,
                heartbeat: telemetry.heartbeat,
                airborne: telemetry.is_airborne(),
                climbing,
                speed_m_s: kinematics.map(|k| k.velocity_ned_m_s.horizontal_norm()),
                course,
            },
        );
        let request = self.ask_to_hold(input.motion.as_ref(), course, state);
        let (fly_to_m, notice) = self.plan_detour(input, kinematics, before, state);
        let notice = match (state, before) {
            (JustStopState::Unguarded, before) if before != JustStopState::Unguarded => Some(GuardNotice::Unguarded),
            _ if jumped => Some(GuardNotice::Jumped),
            (JustStopState::Watching, _) if self.becomes_too_fast(kinematics) => Some(GuardNotice::TooFast),
            _ => notice,
        };
        Guarded {
            request,
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

    /// Whether it was slow enough to be stopped before what is seen, and is no longer.
    fn becomes_too_fast(&mut self, kinematics: Option<Kinematics>) -> bool {
        let needs_m = kinematics.map_or(0.0, |k| {
            self.reckoned
                .reach_m(k.velocity_ned_m_s.horizontal_norm(), Gain::default())
        });
        let longest_m = if self.too_fast {
            SLOW_AGAIN * ForwardCheck::FARTHEST_M
        } else {
            ForwardCheck::FARTHEST_M
        };
        let before = core::mem::replace(&mut self.too_fast, needs_m > longest_m);
        self.too_fast && !before
    }

    /// What the vehicle is asked in this state: to hold, and where, until it stands.
    fn ask_to_hold(&mut self, motion: Option<&Motion>, course: Option<Course>, state: JustStopState) -> VehicleRequest {
        let moves = motion.is_some_and(|m| m.kinematics.velocity_ned_m_s.horizontal_norm() > STANDING_M_S);
        let cause = match state {
            JustStopState::Stopping(cause) => cause,
            // The autopilot took the mode before it could be sent the place.
            JustStopState::Stopped(cause) if moves && self.stop_place_m.is_some() => cause,
            _ => {
                self.stop_place_m = None;
                return VehicleRequest::None;
            }
        };
        if let (Some(motion), JustStopState::Stopping(_)) = (motion, state) {
            let ahead_m = match (course.and_then(|course| course.obstacle_m), cause) {
                (Some(ahead_m), _) | (None, StopCause::Obstacle { ahead_m }) => ahead_m,
                (None, StopCause::Blind | StopCause::Unseen) => f32::INFINITY,
            };
            let velocity = motion.kinematics.velocity_ned_m_s;
            let gain = self.gain_along(velocity);
            // Once it brakes, it is on its way to where it was sent.
            if self.stop_place_m.is_none() || gain.gain_m_s2 > -BRAKES_M_S2 {
                self.stop_place_m = Some(self.stop_place_m(&motion.kinematics, gain, ahead_m));
            }
        }
        VehicleRequest::Hold {
            cause: Some(cause),
            place_m: self.stop_place_m,
        }
    }

    /// Metres north and east of where the vehicle can come to rest, or else of what must not be passed.
    fn stop_place_m(&self, kinematics: &Kinematics, gain: Gain, ahead_m: f32) -> (f32, f32) {
        let (here, velocity) = (kinematics.position_ned_m, kinematics.velocity_ned_m_s);
        let speed_m_s = velocity.horizontal_norm();
        let stopping_m = self.reckoned.stopping_m(speed_m_s, gain).min(ahead_m.max(0.0));
        let share = if speed_m_s > STANDING_M_S {
            stopping_m / speed_m_s
        } else {
            0.0
        };
        (here.x + velocity.x * share, here.y + velocity.y * share)
    }

    /// What the vehicle gains along its velocity.
    fn gain_along(&self, velocity: NedVector) -> Gain {
        self.air.map_or(Gain::default(), |air| air.gain_along(velocity))
    }

    /// What becomes of a stop: where guidance is to fly, and what people read.
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
        let to_place = NedVector::new(place_m.0 - k.position_ned_m.x, place_m.1 - k.position_ned_m.y, 0.0);
        let off_nose_rad = wrap_pi(libm::atan2f(to_place.y, to_place.x) - sample.attitude.yaw_rad());
        // A mission follows its own line, on an estimate that wanders: it is given room to both sides.
        let distance_m = to_place.horizontal_norm();
        let aside = NedVector::new(-to_place.y, to_place.x, 0.0) * (BESIDE_M / distance_m.max(BESIDE_M));
        let is_clear = |from| {
            self.forward_check
                .obstacle_ahead_m(from, to_place, distance_m.min(FREE_M), Aside::TURNS)
                .is_none()
        };
        let free = guided
            && off_nose_rad.abs() < 0.25 * HORIZONTAL_FOV_RAD
            && [k.position_ned_m, k.position_ned_m + aside, k.position_ned_m - aside]
                .into_iter()
                .all(is_clear);
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

    /// What is seen along the velocity, and towards the mission's place where it leads there.
    fn course(&self, motion: &Motion, place_m: Option<(f32, f32)>, drifts: bool) -> Course {
        let (kinematics, attitude) = (&motion.kinematics, motion.sample.attitude);
        let (here, velocity) = (kinematics.position_ned_m, kinematics.velocity_ned_m_s);
        let speed_m_s = velocity.horizontal_norm();
        let aside = if drifts { Aside::drifts(speed_m_s) } else { Aside::TURNS };
        let to_place = place_m.map(|(north_m, east_m)| NedVector::new(north_m - here.x, east_m - here.y, 0.0));
        let towards_place_m = |reach_m: f32| {
            let to_place = to_place?;
            let reach_m = reach_m.min(to_place.horizontal_norm());
            self.forward_check.obstacle_ahead_m(here, to_place, reach_m, aside)
        };
        let start_obstacle_m = towards_place_m(self.reckoned.start_reach_m());
        if speed_m_s <= 0.0 {
            return Course {
                start_obstacle_m,
                ..Course::default()
            };
        }
        let reach_m = self.reckoned.reach_m(speed_m_s, self.gain_along(velocity));
        let course_rad = libm::atan2f(velocity.y, velocity.x);
        let off_nose_rad = wrap_pi(course_rad - attitude.yaw_rad());
        // A start out of a hold that sways, or on an estimate that wanders, turns towards the place.
        let turns = to_place
            .is_some_and(|to_place| wrap_pi(libm::atan2f(to_place.y, to_place.x) - course_rad).abs() < TURNS_RAD);
        let along_m = |from, velocity| self.forward_check.obstacle_ahead_m(from, velocity, reach_m, aside);
        let ahead_m = along_m(here, velocity).filter(|_| {
            // In a turn the course sweeps over what stands beside the way: it is no course that is flown.
            let turned = to_place.and_then(|to_place| self.turned(kinematics, to_place));
            turned.is_none_or(|(there, velocity)| along_m(there, velocity).is_some())
        });
        // Behind a corner the mission gains speed anew.
        let then_m = if turns {
            towards_place_m(reach_m)
        } else {
            start_obstacle_m
        };
        Course {
            obstacle_m: ahead_m.into_iter().chain(then_m).reduce(f32::min),
            start_obstacle_m,
            // Tilted steeply, against a wind or drag, it looks at the ground.
            unseen: off_nose_rad.abs() > 0.5 * HORIZONTAL_FOV_RAD - FOV_MARGIN_RAD
                || off_middle_share(attitude, velocity) > libm::sinf(0.5 * VERTICAL_FOV_RAD),
        }
    }

    /// Place and velocity of a vehicle in [`TURN_S`] that is turning towards this place, by what its tilt gains it aside.
    fn turned(&self, now: &Kinematics, to_place: NedVector) -> Option<(NedVector, NedVector)> {
        let velocity = now.velocity_ned_m_s;
        let gain = self.air?.gain_ned_m_s2;
        let aside = NedVector::new(-velocity.y, velocity.x, 0.0) * (1.0 / velocity.horizontal_norm());
        let gain_m_s2 = gain.x * aside.x + gain.y * aside.y;
        let towards = to_place.x * aside.x + to_place.y * aside.y;
        let then = velocity + aside * (gain_m_s2 * TURN_S);
        (gain_m_s2 * towards > 0.0).then(|| (now.position_ned_m + (velocity + then) * (0.5 * TURN_S), then))
    }

    /// Whether the vehicle is reported to be where it cannot have come to since the last position.
    fn has_jumped(&mut self, now: Kinematics) -> bool {
        self.last.replace(now).is_some_and(|last| has_jumped(&last, &now))
    }
}

/// Sine of the angle by which a level course lies above or below the sensor's middle.
fn off_middle_share(attitude: Attitude, velocity: NedVector) -> f32 {
    let down = attitude.to_ned(FrdVector::new(0.0, 0.0, 1.0));
    ((down.x * velocity.x + down.y * velocity.y) / velocity.horizontal_norm()).abs()
}

/// Acceleration over the ground as the thrust's lean gives it, metres per second squared: without what drag and wind take away.
fn lean_ned_m_s2(attitude: Attitude) -> NedVector {
    let thrust = attitude.to_ned(FrdVector::new(0.0, 0.0, -1.0));
    let lift = (-thrust.z).max(LEAST_LIFT);
    NedVector::new(G_M_S2 * thrust.x / lift, G_M_S2 * thrust.y / lift, 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use vigil_types::STEP_NS;

    /// Flies north, tilted forward by 17°, for so long under a drag of 1/s, its velocity known this often: what it gains at the end, and
    /// the truth.
    fn gain_after_m_s2(seconds: f32, step_ns: Nanos) -> (f32, f32) {
        let attitude = Attitude::from_euler_rad(0.0, -0.297, 0.0);
        let lean = lean_ned_m_s2(attitude);
        let mut now = Kinematics::new(0, NedVector::ZERO, NedVector::ZERO);
        let mut air = Air::new(&now, lean);
        let step_s = step_ns as f32 * 1e-9;
        for _ in 0..(seconds / step_s) as u32 {
            now.at_ns += step_ns;
            now.velocity_ned_m_s = now.velocity_ned_m_s + (lean - now.velocity_ned_m_s) * step_s;
            air = air.follow(&now, lean);
        }
        let north = NedVector::new(1.0, 0.0, 0.0);
        (air.gain_along(north).gain_m_s2, lean.x - now.velocity_ned_m_s.x)
    }

    #[test]
    fn a_steady_tilt_against_drag_is_no_gain_of_speed_and_a_start_is_one() {
        assert!(gain_after_m_s2(0.3, STEP_NS).0 > 2.2);
        for seconds in [1.5, 2.0, 3.0, 8.0] {
            let (gain_m_s2, true_m_s2) = gain_after_m_s2(seconds, STEP_NS);
            assert!(
                (gain_m_s2 - true_m_s2).abs() < 0.4,
                "{seconds}: {gain_m_s2} {true_m_s2}"
            );
        }
        // What a standing vehicle leans against is the wind.
        let mut standing = Kinematics::new(0, NedVector::ZERO, NedVector::ZERO);
        let lean = lean_ned_m_s2(Attitude::from_euler_rad(0.0, -0.15, 0.0));
        let mut air = Air::new(&standing, lean);
        for _ in 0..80 {
            standing.at_ns += STEP_NS;
            air = air.follow(&standing, lean);
        }
        assert!((air.wind_m_s2 - lean.x).abs() < 0.2, "{air:?}");
        // Its velocity comes only twice a second.
        let (gain_m_s2, _) = gain_after_m_s2(20.0, 10 * STEP_NS);
        assert!(gain_m_s2.abs() < 0.3, "{gain_m_s2}");
    }
}
