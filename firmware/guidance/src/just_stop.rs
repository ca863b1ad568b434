//! Just stop: guards a flight that somebody else flies. The vehicle follows its own mission or a pilot's sticks; when something
//! lies on its course, or nobody can see whether something does, it is ordered to hold. No setpoint is ever sent.

pub use crate::stopping_distance::{Gain, JustStopConfig};
use vigil_types::{Heartbeat, Nanos, StopCause, VehicleMode};

/// Slower than this no course can be known, and nothing is run into, metres per second.
pub(crate) const STANDS_M_S: f32 = 0.25;
/// A hold on a wandering estimate sways at up to this speed, metres per second: a mission that has been flown for no longer than
/// this may not have begun to move.
const SWAYS_M_S: f32 = 0.8;
const BEGINS_NS: Nanos = 500_000_000;
/// A vehicle in hold that is faster than this is on its way to a place, if it does not slow down: by less than this in this many steps,
/// metres per second.
const GOES_M_S: f32 = 0.5;
const SLOWS_M_S: f32 = 0.15;
const SLOWS_STEPS: usize = 8;
/// Steps in a row in which something must lie on the course: a single one may be noise.
const CONFIRMED: u8 = 2;
/// Without a picture for longer than this, a vehicle that moves is stopped.
const BLIND_NS: Nanos = 500_000_000;
/// After so long in a hold that was ordered, a vehicle that goes on as before has taken the mode and not obeyed it.
const OBEYS_NS: Nanos = 2_000_000_000;
/// So long after a stop was begun, a vehicle may fly back to its place, which lies behind it.
const RETURNS_NS: Nanos = 8_000_000_000;

/// What the guard knows in a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JustStopInput {
    /// Time of the step.
    pub now_ns: Nanos,
    /// The vehicle's newest heartbeat.
    pub heartbeat: Option<Heartbeat>,
    /// Whether the vehicle is in the air.
    pub airborne: bool,
    /// It climbs straight up, as a take-off that is an item of a mission does: the autopilot says IN_AIR and MISSION then.
    pub climbing: bool,
    /// Its horizontal speed, metres per second; `None` when it is not known, too old or not finite.
    pub speed_m_s: Option<f32>,
    /// What is seen of the course; `None` without a picture that can be believed.
    pub course: Option<Course>,
}

/// What is seen along the velocity.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Course {
    /// Metres to where the vehicle would come too near to something; `None` when nothing lies within
    /// [`JustStopConfig::reach_m`].
    pub obstacle_m: Option<f32>,
    /// Metres to the same towards the mission's next place, within [`JustStopConfig::start_reach_m`] and not beyond that place; `None` also
    /// where the place is not known.
    pub start_obstacle_m: Option<f32>,
    /// The velocity points out of the sensor's field of view.
    pub unseen: bool,
}

/// Where the guard is.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum JustStopState {
    /// The vehicle is on the ground, disarmed, taking off, or landing: nothing to guard.
    #[default]
    Idle,
    /// It flies and never reported where it is and how fast: it cannot be guarded, and it could not hold its position either.
    Unguarded,
    /// It flies, and its course is free.
    Watching,
    /// It is ordered to hold.
    Stopping(StopCause),
    /// It holds. Whoever flies it may go on; the guard then watches again.
    Stopped(StopCause),
}

impl JustStopState {
    /// Why the vehicle is to hold, if it is.
    pub fn cause(self) -> Option<StopCause> {
        match self {
            Self::Stopping(cause) | Self::Stopped(cause) => Some(cause),
            Self::Idle | Self::Unguarded | Self::Watching => None,
        }
    }
}

/// A stop as it was begun.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Begun {
    at_ns: Nanos,
    mode: VehicleMode,
    /// The vehicle has stood since.
    stood: bool,
}

/// The guard. No clock, no allocation.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct JustStop {
    state: JustStopState,
    confirmed: u8,
    located: bool,
    blind_since_ns: Option<Nanos>,
    unseen_since_ns: Option<Nanos>,
    begun: Begun,
    /// Since when it flies its mission.
    mission_since_ns: Option<Nanos>,
    /// The last speeds, newest first, metres per second.
    speeds_m_s: [f32; SLOWS_STEPS],
}

impl JustStop {
    /// One step; the state from now on. While it is [`JustStopState::Stopping`] the vehicle is to be ordered to hold.
    pub fn step(&mut self, config: &JustStopConfig, input: &JustStopInput) -> JustStopState {
        // What goes up and down by itself, the grid of a level cannot show.
        let guarded = |h: &Heartbeat| {
            let by_itself = matches!(h.mode, VehicleMode::Takeoff | VehicleMode::Land);
            h.armed && input.airborne && !by_itself && !(input.climbing && h.mode != VehicleMode::Hold)
        };
        let Some(heartbeat) = input.heartbeat.filter(guarded) else {
            *self = Self::default();
            return self.state;
        };
        self.located |= input.speed_m_s.is_some();
        if !self.located {
            self.state = JustStopState::Unguarded;
            return self.state;
        }
        let holds = heartbeat.mode == VehicleMode::Hold;
        let goes = self.goes(input.speed_m_s);
        // What is braking in hold already needs no telling; what goes somewhere in it does.
        let rests = holds && !goes;
        let danger = self.danger(config, input, &heartbeat, rests).filter(|_| !rests);
        self.begun.stood |= input.speed_m_s.is_some_and(|speed_m_s| speed_m_s < STANDS_M_S);
        // A heartbeat of before the command says nothing of it.
        let newer = heartbeat.at_ns > self.begun.at_ns;
        self.state = match self.state {
            JustStopState::Stopping(cause) if holds && newer && !(self.begun.mode == VehicleMode::Hold && goes) => {
                JustStopState::Stopped(cause)
            }
            // Somebody chose yet another mode: this stop is over, and what comes of that mode is looked at anew.
            JustStopState::Stopping(_) if newer && heartbeat.mode != self.begun.mode => {
                self.confirmed = 0;
                JustStopState::Watching
            }
            JustStopState::Stopping(cause) => JustStopState::Stopping(cause),
            JustStopState::Stopped(cause)
                if holds
                    && (danger.is_none() || self.may_obey_yet(input.now_ns) || self.returns(danger, input.now_ns)) =>
            {
                JustStopState::Stopped(cause)
            }
            JustStopState::Idle | JustStopState::Unguarded | JustStopState::Watching | JustStopState::Stopped(_) => {
                match danger {
                    Some(cause) => {
                        self.begun = Begun {
                            at_ns: input.now_ns,
                            mode: heartbeat.mode,
                            stood: false,
                        };
                        JustStopState::Stopping(cause)
                    }
                    None => JustStopState::Watching,
                }
            }
        };
        self.state
    }

    /// Whether the vehicle that was ordered to hold may still be on its way to a stand.
    fn may_obey_yet(&self, now_ns: Nanos) -> bool {
        !self.begun.stood && now_ns.saturating_sub(self.begun.at_ns) < OBEYS_NS
    }

    /// Whether the vehicle may be on its way back to the place of its stop, where it has just been.
    fn returns(&self, danger: Option<StopCause>, now_ns: Nanos) -> bool {
        danger == Some(StopCause::Unseen) && now_ns.saturating_sub(self.begun.at_ns) < RETURNS_NS
    }

    /// Whether the vehicle moves and does not slow down.
    fn goes(&mut self, speed_m_s: Option<f32>) -> bool {
        let Some(speed_m_s) = speed_m_s else { return false };
        let [.., oldest_m_s] = self.speeds_m_s;
        self.speeds_m_s.rotate_right(1);
        if let Some(newest) = self.speeds_m_s.first_mut() {
            *newest = speed_m_s;
        }
        speed_m_s > GOES_M_S && oldest_m_s - speed_m_s < SLOWS_M_S
    }

    /// Why the vehicle must not go on as it does, if it must not. `rests`: it is in hold and on its way nowhere.
    fn danger(
        &mut self,
        config: &JustStopConfig,
        input: &JustStopInput,
        heartbeat: &Heartbeat,
        rests: bool,
    ) -> Option<StopCause> {
        let moves = input.speed_m_s.is_none_or(|speed_m_s| speed_m_s > STANDS_M_S);
        let longer = |since_ns: &mut Option<Nanos>, holds: bool, limit_ns: Nanos| {
            *since_ns = since_ns.or(Some(input.now_ns)).filter(|_| holds);
            since_ns.is_some_and(|since_ns| input.now_ns.saturating_sub(since_ns) > limit_ns)
        };
        let seen = input.course.filter(|_| input.speed_m_s.is_some());
        let blind = longer(&mut self.blind_since_ns, seen.is_none(), BLIND_NS);
        let unseen = longer(
            &mut self.unseen_since_ns,
            // A hold on a wandering estimate sways to all sides; what begins then goes nowhere yet.
            moves && !rests && seen.is_some_and(|course| course.unseen),
            config.unseen_limit_ns.unwrap_or(Nanos::MAX),
        );
        // A mission that stands has not begun yet, or is sent on; so is one that has just begun, in a hold that sways.
        let flies_mission = heartbeat.mode == VehicleMode::Mission;
        let goes_on = longer(&mut self.mission_since_ns, flies_mission, BEGINS_NS);
        let sways = input.speed_m_s.is_some_and(|speed_m_s| speed_m_s < SWAYS_M_S);
        let starts = flies_mission && (!moves || sways && !goes_on);
        let obstacle_m = seen.and_then(|course| {
            let ahead_m = course.obstacle_m.filter(|_| moves);
            ahead_m.or(course.start_obstacle_m.filter(|_| starts))
        });
        self.confirmed = match obstacle_m {
            Some(_) => self.confirmed.saturating_add(1),
            None => 0,
        };
        // A vehicle that returns by itself, or acts on a failsafe, has a reason that weighs more than what might be there.
        let may_wait = heartbeat.mode != VehicleMode::Return && !heartbeat.failsafe;
        match obstacle_m {
            Some(ahead_m) if self.confirmed >= CONFIRMED => Some(StopCause::Obstacle { ahead_m }),
            _ if blind && moves && may_wait => Some(StopCause::Blind),
            _ if unseen && may_wait => Some(StopCause::Unseen),
            _ => None,
        }
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
        failsafe: bool,
        speed_m_s: Option<f32>,
        climbing: bool,
        start_obstacle_m: Option<f32>,
        sees: bool,
        unseen: bool,
    }

    impl Flight {
        fn at(speed_m_s: f32) -> Self {
            Self {
                guard: JustStop::default(),
                now_ns: 0,
                mode: VehicleMode::Mission,
                failsafe: false,
                speed_m_s: Some(speed_m_s),
                climbing: false,
                start_obstacle_m: None,
                sees: true,
                unseen: false,
            }
        }

        fn step(&mut self, obstacle_m: Option<f32>) -> JustStopState {
            self.now_ns += STEP_NS;
            self.guard.step(
                &JustStopConfig::default(),
                &JustStopInput {
                    now_ns: self.now_ns,
                    heartbeat: Some(Heartbeat {
                        at_ns: self.now_ns,
                        armed: true,
                        mode: self.mode,
                        failsafe: self.failsafe,
                    }),
                    airborne: true,
                    climbing: self.climbing,
                    speed_m_s: self.speed_m_s,
                    course: self.sees.then_some(Course {
                        obstacle_m,
                        start_obstacle_m: self.start_obstacle_m,
                        unseen: self.unseen,
                    }),
                },
            )
        }

        /// So many steps; the state after the last.
        fn steps(&mut self, count: u32, obstacle_m: Option<f32>) -> JustStopState {
            (0..count).fold(self.guard.state(), |_, _| self.step(obstacle_m))
        }

        /// Seconds until it is stopped; `None` within 5 s.
        fn stopped_after_s(&mut self) -> Option<(f32, StopCause)> {
            (1..=100).find_map(|step| Some((step as f32 * 0.05, self.step(None).cause()?)))
        }
    }

    #[test]
    fn a_free_mission_is_left_alone_and_a_blocked_one_is_stopped_once() {
        let mut flight = Flight::at(3.0);
        for _ in 0..100 {
            assert_eq!(flight.step(None), JustStopState::Watching);
        }
        assert_eq!(flight.step(Some(4.2)), JustStopState::Watching, "one frame may err");
        let cause = StopCause::Obstacle { ahead_m: 4.1 };
        assert_eq!(flight.step(Some(4.1)), JustStopState::Stopping(cause));
        assert_eq!(flight.step(None), JustStopState::Stopping(cause), "until it obeys");
        flight.mode = VehicleMode::Hold;
        assert_eq!(flight.step(None), JustStopState::Stopped(cause));
        flight.speed_m_s = Some(0.0);
        assert_eq!(flight.step(Some(1.0)), JustStopState::Stopped(cause));
    }

    /// A PX4 that is sent to a place by DO_REPOSITION is in hold all the way.
    #[test]
    fn a_go_to_in_hold_is_stopped_and_a_hold_that_brakes_is_left_alone() {
        let mut flight = Flight::at(2.0);
        flight.mode = VehicleMode::Hold;
        for _ in 0..20 {
            assert_eq!(flight.step(None), JustStopState::Watching);
        }
        flight.step(Some(3.0));
        let cause = StopCause::Obstacle { ahead_m: 2.9 };
        assert_eq!(flight.step(Some(2.9)), JustStopState::Stopping(cause));
        assert_eq!(flight.step(Some(2.8)), JustStopState::Stopping(cause), "it goes on");
        let brake = |from_m_s: f32, flight: &mut Flight, wanted: fn(JustStopState) -> bool| {
            for i in 0..40 {
                flight.speed_m_s = Some((from_m_s - 0.1 * i as f32).max(0.0));
                let state = flight.step(Some(2.0));
                assert!(i < 3 || wanted(state), "{i}: {state:?}");
            }
        };
        brake(2.0, &mut flight, |state| matches!(state, JustStopState::Stopped(_)));
        // Sent on into it again, it is stopped again; sent away from it, it is left alone.
        for speed_m_s in [0.2, 0.4, 0.6, 0.8] {
            flight.speed_m_s = Some(speed_m_s);
            flight.step(Some(1.5));
        }
        assert!(matches!(flight.guard.state(), JustStopState::Stopping(_)));
        let mut away = Flight::at(0.0);
        away.mode = VehicleMode::Hold;
        for i in 0..40 {
            away.speed_m_s = Some(0.1 * i as f32);
            assert_eq!(away.step(None), JustStopState::Watching);
        }
        // A person's hold before a wall: it brakes, and nobody need say so.
        let mut held = Flight::at(3.0);
        held.steps(20, None);
        held.mode = VehicleMode::Hold;
        brake(2.9, &mut held, |state| state == JustStopState::Watching);
    }

    #[test]
    fn a_vehicle_that_takes_the_mode_and_flies_on_is_ordered_again() {
        let mut flight = Flight::at(2.0);
        flight.steps(2, Some(5.0));
        flight.mode = VehicleMode::Hold;
        let mut orders = 0;
        for _ in 0..100 {
            let before = flight.guard.state();
            let state = flight.step(Some(3.0));
            orders += u32::from(matches!(state, JustStopState::Stopping(_)) && state != before);
        }
        assert!(orders >= 1, "{orders}");
        assert!(matches!(flight.guard.state(), JustStopState::Stopping(_)));
    }

    #[test]
    fn a_mission_that_begins_before_a_wall_is_held_before_it_moves_each_time_it_is_sent_on() {
        let mut flight = Flight::at(0.05);
        flight.start_obstacle_m = Some(3.5);
        for _ in 0..2 {
            flight.mode = VehicleMode::Mission;
            assert!(matches!(flight.steps(2, None), JustStopState::Stopping(_)));
            flight.mode = VehicleMode::Hold;
            assert!(matches!(flight.step(None), JustStopState::Stopped(_)));
        }
        // Who holds, or flies by sticks, has not begun a mission.
        let mut flight = Flight::at(0.05);
        (flight.start_obstacle_m, flight.mode) = (Some(3.5), VehicleMode::Other);
        assert_eq!(flight.stopped_after_s(), None);
    }

    /// A hold on a wandering estimate moves at 0.4 m/s while it stands.
    #[test]
    fn a_mission_that_begins_in_a_swaying_hold_is_held_too_and_a_slow_one_on_its_way_is_left_alone() {
        let begins = |held_steps| {
            let mut flight = Flight::at(0.4);
            flight.mode = VehicleMode::Mission;
            flight.steps(held_steps, None);
            flight.start_obstacle_m = Some(3.5);
            flight.steps(2, None)
        };
        assert!(matches!(begins(0), JustStopState::Stopping(_)));
        assert_eq!(begins(20), JustStopState::Watching);
        // That it swayed backwards says nothing of the mission.
        let mut flight = Flight::at(0.4);
        (flight.mode, flight.unseen) = (VehicleMode::Hold, true);
        assert_eq!(flight.stopped_after_s(), None);
        flight.mode = VehicleMode::Mission;
        assert!(flight.stopped_after_s().is_some_and(|(after_s, _)| after_s > 0.9));
    }

    #[test]
    fn a_vehicle_that_flies_back_to_its_place_is_not_stopped_for_what_it_cannot_see_there() {
        let mut flight = Flight::at(2.0);
        flight.steps(2, Some(1.0));
        flight.mode = VehicleMode::Hold;
        flight.unseen = true;
        let obstacle = StopCause::Obstacle { ahead_m: 1.0 };
        assert_eq!(flight.steps(7 * 20, None), JustStopState::Stopped(obstacle));
        let then = flight.steps(2 * 20, None);
        assert_eq!(then, JustStopState::Stopping(StopCause::Unseen), "it is on another way");
    }

    #[test]
    fn a_climb_straight_up_within_a_mission_is_a_take_off_and_is_not_stopped() {
        let mut flight = Flight::at(0.3);
        flight.climbing = true;
        for _ in 0..40 {
            assert_eq!(flight.step(Some(0.1)), JustStopState::Idle);
        }
        flight.climbing = false;
        flight.step(Some(0.5));
        assert!(
            matches!(flight.step(Some(0.5)), JustStopState::Stopping(_)),
            "then it is monitored"
        );
    }

    #[test]
    fn whoever_flies_may_go_on_and_is_stopped_again_if_the_way_is_still_blocked() {
        let mut flight = Flight::at(2.0);
        flight.steps(2, Some(1.0));
        flight.mode = VehicleMode::Hold;
        assert!(matches!(flight.step(Some(1.0)), JustStopState::Stopped(_)));
        (flight.mode, flight.speed_m_s) = (VehicleMode::Other, Some(0.1));
        assert_eq!(flight.step(Some(1.0)), JustStopState::Watching, "it does not move yet");
        flight.speed_m_s = Some(1.0);
        assert_eq!(flight.step(None), JustStopState::Watching, "away from it");
        assert!(matches!(flight.steps(2, Some(0.9)), JustStopState::Stopping(_)));
    }

    #[test]
    fn who_takes_the_vehicle_over_during_a_stop_has_it_and_is_monitored_like_anybody() {
        let mut flight = Flight::at(2.0);
        assert!(matches!(flight.steps(2, Some(1.0)), JustStopState::Stopping(_)));
        flight.mode = VehicleMode::Return;
        assert_eq!(flight.step(Some(1.0)), JustStopState::Watching);
        assert_eq!(flight.step(None), JustStopState::Watching, "home lies the other way");
    }

    #[test]
    fn a_vehicle_that_moves_unseen_is_stopped_and_one_that_hovers_is_not() {
        let mut flight = Flight::at(2.0);
        flight.step(None);
        flight.sees = false;
        let (after_s, cause) = flight.stopped_after_s().expect("stopped");
        assert_eq!(cause, StopCause::Blind);
        assert!((0.5..0.65).contains(&after_s), "{after_s}");

        let mut backwards = Flight::at(2.0);
        backwards.unseen = true;
        let (after_s, cause) = backwards.stopped_after_s().expect("stopped");
        assert_eq!(cause, StopCause::Unseen);
        assert!((1.0..1.15).contains(&after_s), "{after_s}");

        for sees in [true, false] {
            let mut hovers = Flight::at(0.1);
            (hovers.sees, hovers.unseen) = (sees, true);
            assert_eq!(hovers.stopped_after_s(), None);
        }
    }

    #[test]
    fn a_return_or_a_failsafe_is_stopped_by_what_is_there_and_not_by_what_might_be() {
        for (mode, failsafe) in [(VehicleMode::Return, false), (VehicleMode::Mission, true)] {
            let mut flight = Flight::at(2.0);
            (flight.mode, flight.failsafe, flight.unseen) = (mode, failsafe, true);
            assert_eq!(flight.stopped_after_s(), None);
            assert!(matches!(flight.steps(2, Some(1.0)), JustStopState::Stopping(_)));
        }
    }

    #[test]
    fn a_vehicle_that_never_reported_its_position_is_unguarded_and_one_that_ceases_to_is_stopped() {
        let mut flight = Flight::at(0.0);
        flight.speed_m_s = None;
        assert_eq!(flight.stopped_after_s(), None);
        assert_eq!(flight.guard.state(), JustStopState::Unguarded);
        flight.speed_m_s = Some(2.0);
        assert_eq!(flight.step(None), JustStopState::Watching);
        flight.speed_m_s = None;
        assert!(matches!(flight.stopped_after_s(), Some((_, StopCause::Blind))));
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
