//! Just stop: guards a flight that somebody else flies. The vehicle follows its own mission or a pilot's sticks; when something
//! lies on its course, or nobody can see whether something does, it is told to hold. No setpoint is ever sent.

use vigil_types::{Heartbeat, Nanos, NedVector, VehicleMode};

/// Time from the frame that shows an obstacle to the beginning of braking: two frames that show it, the command, and the
/// autopilot's own delay.
const REACTION_S: f32 = 0.6;
/// What a multicopter brakes with, metres per second squared: PX4's MPC_ACC_HOR is 3 by default, ArduPilot's BRAKE 2.5; less is
/// reckoned with.
const BRAKING_M_S2: f32 = 1.5;
/// Kept between the place of the stop and the obstacle's clearance, metres.
const SPARE_M: f32 = 0.5;
/// Slower than this no course can be told, and nothing is run into, metres per second.
const STANDS_M_S: f32 = 0.25;
/// Steps in a row in which something must lie on the course: a single one may be noise.
const CONFIRMED: u8 = 2;
/// Without a picture for longer than this, a vehicle that moves is stopped.
const BLIND_NS: Nanos = 500_000_000;

/// What the guard knows in a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JustStopInput {
    /// Time of the step.
    pub now_ns: Nanos,
    /// The vehicle's newest heartbeat.
    pub heartbeat: Option<Heartbeat>,
    /// Whether the vehicle is in the air.
    pub airborne: bool,
    /// Its velocity, metres per second; `None` when it is not known, too old or not finite.
    pub velocity_ned_m_s: Option<NedVector>,
    /// What is seen of the course; `None` without a picture that can be believed.
    pub course: Option<Course>,
}

/// What is seen ahead, along the velocity.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Course {
    /// Metres to where the vehicle would come too near to something; `None` when nothing lies within the reach that was asked
    /// for.
    pub obstacle_m: Option<f32>,
}

/// Why the vehicle was stopped.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum StopCause {
    /// Something lies so many metres ahead on its course.
    Obstacle {
        /// Metres.
        ahead_m: f32,
    },
    /// It moves, and nobody can see where to: no picture, or no velocity.
    Blind,
}

/// Where the guard is.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum JustStopState {
    /// The vehicle is on the ground, disarmed, taking off, or landing: nothing to guard.
    #[default]
    Idle,
    /// It flies, and its course is free.
    Watching,
    /// It is told to hold.
    Stopping(StopCause),
    /// It holds. Whoever flies it may go on; the guard then watches again.
    Stopped(StopCause),
}

impl JustStopState {
    /// Why the vehicle is to hold, if it is.
    pub fn cause(self) -> Option<StopCause> {
        match self {
            Self::Stopping(cause) | Self::Stopped(cause) => Some(cause),
            Self::Idle | Self::Watching => None,
        }
    }
}

/// Metres within which something on the course stops a vehicle of this speed.
pub fn stopping_reach_m(speed_m_s: f32) -> f32 {
    speed_m_s * REACTION_S + speed_m_s * speed_m_s / (2.0 * BRAKING_M_S2) + SPARE_M
}

/// The guard. No clock, no allocation.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct JustStop {
    state: JustStopState,
    confirmed: u8,
    blind_since_ns: Option<Nanos>,
    stopping_since_ns: Nanos,
}

impl JustStop {
    /// One step; the state from now on. While it is [`JustStopState::Stopping`] the vehicle is to be told to hold.
    pub fn step(&mut self, input: &JustStopInput) -> JustStopState {
        let Some(heartbeat) = input.heartbeat.filter(|h| h.armed && input.airborne) else {
            *self = Self::default();
            return self.state;
        };
        // What goes up and down by itself, the grid of a level cannot judge.
        if matches!(heartbeat.mode, VehicleMode::Takeoff | VehicleMode::Land) {
            *self = Self::default();
            return self.state;
        }
        let speed_m_s = input.velocity_ned_m_s.map(NedVector::horizontal_norm);
        let moves = speed_m_s.is_none_or(|speed_m_s| speed_m_s > STANDS_M_S);
        let danger = match (input.course, speed_m_s) {
            (Some(course), Some(speed_m_s)) => {
                self.blind_since_ns = None;
                let ahead_m = course
                    .obstacle_m
                    .filter(|ahead_m| moves && *ahead_m <= stopping_reach_m(speed_m_s));
                self.confirmed = match ahead_m {
                    Some(_) => self.confirmed.saturating_add(1),
                    None => 0,
                };
                ahead_m
                    .filter(|_| self.confirmed >= CONFIRMED)
                    .map(|ahead_m| StopCause::Obstacle { ahead_m })
            }
            _ => {
                self.confirmed = 0;
                let since_ns = *self.blind_since_ns.get_or_insert(input.now_ns);
                let long = input.now_ns.saturating_sub(since_ns) > BLIND_NS;
                (moves && long).then_some(StopCause::Blind)
            }
        };
        let holds = heartbeat.mode == VehicleMode::Hold;
        self.state = match self.state {
            // A heartbeat of before the command says nothing of it.
            JustStopState::Stopping(cause) if holds && heartbeat.at_ns > self.stopping_since_ns => {
                JustStopState::Stopped(cause)
            }
            JustStopState::Stopping(cause) => JustStopState::Stopping(cause),
            JustStopState::Stopped(cause) if holds => JustStopState::Stopped(cause),
            JustStopState::Idle | JustStopState::Watching | JustStopState::Stopped(_) => match danger {
                // A vehicle that is braking already needs no telling.
                Some(cause) if !holds => {
                    self.stopping_since_ns = input.now_ns;
                    JustStopState::Stopping(cause)
                }
                _ => JustStopState::Watching,
            },
        };
        self.state
    }

    /// Where the guard is.
    pub fn state(&self) -> JustStopState {
        self.state
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vigil_types::STEP_NS;

    struct Flight {
        guard: JustStop,
        now_ns: Nanos,
        mode: VehicleMode,
        speed_m_s: f32,
        sees: bool,
    }

    impl Flight {
        fn at(speed_m_s: f32) -> Self {
            Self {
                guard: JustStop::default(),
                now_ns: 0,
                mode: VehicleMode::Mission,
                speed_m_s,
                sees: true,
            }
        }

        fn step(&mut self, obstacle_m: Option<f32>) -> JustStopState {
            self.now_ns += STEP_NS;
            self.guard.step(&JustStopInput {
                now_ns: self.now_ns,
                heartbeat: Some(Heartbeat {
                    at_ns: self.now_ns,
                    armed: true,
                    mode: self.mode,
                    failsafe: false,
                }),
                airborne: true,
                velocity_ned_m_s: Some(NedVector::new(self.speed_m_s, 0.0, 0.0)),
                course: self.sees.then_some(Course { obstacle_m }),
            })
        }
    }

    #[test]
    fn a_free_mission_is_left_alone_and_a_blocked_one_is_stopped_once() {
        let mut flight = Flight::at(3.0);
        for _ in 0..100 {
            assert_eq!(flight.step(None), JustStopState::Watching);
        }
        // 3 m/s stop within 1.8 m of reaction, 3 m of braking, and half a metre.
        assert_eq!(flight.step(Some(5.5)), JustStopState::Watching);
        assert_eq!(flight.step(Some(5.2)), JustStopState::Watching, "one frame may err");
        let cause = StopCause::Obstacle { ahead_m: 5.1 };
        assert_eq!(flight.step(Some(5.1)), JustStopState::Stopping(cause));
        assert_eq!(flight.step(None), JustStopState::Stopping(cause), "until it obeys");
        flight.mode = VehicleMode::Hold;
        assert_eq!(flight.step(None), JustStopState::Stopped(cause));
        flight.speed_m_s = 0.0;
        assert_eq!(flight.step(Some(1.0)), JustStopState::Stopped(cause));
    }

    #[test]
    fn whoever_flies_may_go_on_and_is_stopped_again_if_the_way_is_still_blocked() {
        let mut flight = Flight::at(2.0);
        flight.step(Some(1.0));
        flight.step(Some(1.0));
        flight.mode = VehicleMode::Hold;
        assert!(matches!(flight.step(Some(1.0)), JustStopState::Stopped(_)));
        (flight.mode, flight.speed_m_s) = (VehicleMode::Other, 0.1);
        assert_eq!(flight.step(Some(1.0)), JustStopState::Watching, "it does not move yet");
        flight.speed_m_s = 1.0;
        assert_eq!(flight.step(None), JustStopState::Watching, "away from it");
        flight.step(Some(0.9));
        assert!(matches!(flight.step(Some(0.9)), JustStopState::Stopping(_)));
    }

    #[test]
    fn a_vehicle_that_moves_unseen_is_stopped_and_one_that_hovers_is_not() {
        let mut flight = Flight::at(2.0);
        flight.step(None);
        flight.sees = false;
        for _ in 0..11 {
            assert_eq!(flight.step(None), JustStopState::Watching);
        }
        assert_eq!(flight.step(None), JustStopState::Stopping(StopCause::Blind));
        let mut hovers = Flight::at(0.1);
        hovers.sees = false;
        for _ in 0..40 {
            assert_eq!(hovers.step(None), JustStopState::Watching);
        }
    }

    #[test]
    fn on_the_ground_and_in_take_off_and_landing_nothing_is_stopped() {
        for mode in [VehicleMode::Takeoff, VehicleMode::Land] {
            let mut flight = Flight::at(2.0);
            flight.mode = mode;
            for _ in 0..10 {
                assert_eq!(flight.step(Some(0.5)), JustStopState::Idle);
            }
        }
    }
}
