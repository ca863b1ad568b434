//! Just stop: guards a flight that somebody else flies. The vehicle follows its own mission or a pilot's sticks; when something
//! lies on its course, or nobody can see whether something does, it is told to hold. No setpoint is ever sent.

use vigil_types::{Heartbeat, Nanos, StopCause, VehicleMode, parameters};

/// Slower than this no course can be told, and nothing is run into, metres per second.
const STANDS_M_S: f32 = 0.25;
/// A vehicle in hold that is faster than this is on its way to a place, if it does not slow down: by less than this in this many steps,
/// metres per second.
const GOES_M_S: f32 = 0.5;
const SLOWS_M_S: f32 = 0.15;
const SLOWS_STEPS: usize = 8;
/// Steps in a row in which something must lie on the course: a single one may be noise.
const CONFIRMED: u8 = 2;
/// Without a picture for longer than this, a vehicle that moves is stopped.
const BLIND_NS: Nanos = 500_000_000;
/// Step of the reckoned stop, seconds, and the most of them: 20 s.
const RECKON_S: f32 = 0.05;
const RECKON_STEPS: usize = 400;
/// Fastest that a vehicle is believed to gain speed, metres per second squared.
const GREATEST_GAIN_M_S2: f32 = 6.0;
/// A vehicle that gains more than this is still on its way to [`MISSION_GAIN_M_S2`], metres per second squared: after a start, and above
/// this speed, metres per second, which it has by then. There a gain may be what is not yet known of drag or wind.
const STARTS_M_S2: f32 = 0.3;
const GAINS_M_S2: f32 = 1.0;
const STARTED_M_S: f32 = 1.5;
/// What an autopilot gains speed with in a mission: PX4's MPC_ACC_HOR is 3, Copter's WPNAV_ACCEL 2.5 by default, metres per second squared.
const MISSION_GAIN_M_S2: f32 = 3.0;
/// The way of a hold from steady flight is this time times the speed: measured 1.3 to 1.5 s on PX4 (HOLD from 1.8 to 3.3 m/s) and about
/// 1.5 s on ArduCopter (BRAKE).
const HOLD_WAY_S: f32 = 1.5;
/// From a command until the autopilot acts on it, seconds.
const TOLD_S: f32 = 0.1;
/// After so long in a hold that was told, a vehicle that goes on as before has taken the mode and not obeyed it.
const OBEYS_NS: Nanos = 2_000_000_000;

/// How the vehicle stops. [`JustStopConfig::default`] is what docs/just-stop.md states.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JustStopConfig {
    /// From the frame that shows an obstacle until the vehicle begins to change its acceleration, seconds.
    pub reaction_s: f32,
    /// What it brakes with, metres per second squared. PX4: MPC_ACC_HOR, 3 by default; Copter's BRAKE: 7.5.
    pub braking_m_s2: f32,
    /// How fast it gets there, metres per second cubed. PX4: MPC_JERK_AUTO, 4 by default; Copter: PSC_JERK_XY, 5.
    pub jerk_m_s3: f32,
    /// Kept between its stop and what it must not touch, metres.
    pub spare_m: f32,
    /// Moved so long where the sensor does not look, it is stopped; `None` is never.
    pub unseen_limit_ns: Option<Nanos>,
}

impl Default for JustStopConfig {
    fn default() -> Self {
        Self {
            reaction_s: parameters::STOP_REACTION.number_f32(),
            braking_m_s2: parameters::STOP_BRAKING.number_f32(),
            jerk_m_s3: parameters::STOP_JERK.number_f32(),
            spare_m: parameters::STOP_SPARE.number_f32(),
            unseen_limit_ns: Some((parameters::STOP_UNSEEN.number() * 1e9) as Nanos),
        }
    }
}

impl JustStopConfig {
    /// Metres within which something on the course stops a vehicle of this speed, metres per second, that gains speed with this
    /// acceleration, metres per second squared. An autopilot takes its acceleration back as fast as its jerk allows: who is told to
    /// hold while it gains speed goes on gaining it for a while; and until it is told, who has begun to gain speed gains more.
    pub fn reach_m(&self, speed_m_s: f32, gain_m_s2: f32) -> f32 {
        let steady_m = speed_m_s.max(0.0) * (self.reaction_s + HOLD_WAY_S);
        self.spare_m + self.braking_way_m(speed_m_s, gain_m_s2, self.reaction_s).max(steady_m)
    }

    /// Metres to where an autopilot that is told to hold now can come to rest from this speed, metres per second, that it gains with
    /// this acceleration, metres per second squared.
    pub fn way_m(&self, speed_m_s: f32, gain_m_s2: f32) -> f32 {
        self.braking_way_m(speed_m_s, gain_m_s2, TOLD_S)
    }

    /// Metres of a stop that is begun after so many seconds.
    fn braking_way_m(&self, speed_m_s: f32, gain_m_s2: f32, reaction_s: f32) -> f32 {
        let mut speed_m_s = speed_m_s.max(0.0);
        // It may cease braking in the moment in which it is looked at.
        let mut gain_m_s2 = if gain_m_s2.is_finite() {
            gain_m_s2.clamp(-0.5 * self.braking_m_s2, GREATEST_GAIN_M_S2)
        } else {
            GREATEST_GAIN_M_S2
        };
        let mut way_m = 0.0;
        let grows_from_m_s2 = if speed_m_s < STARTED_M_S {
            STARTS_M_S2
        } else {
            GAINS_M_S2
        };
        let reaction_steps = (reaction_s / RECKON_S + 0.5) as usize;
        for step in 0..RECKON_STEPS {
            if step < reaction_steps {
                if gain_m_s2 > grows_from_m_s2 {
                    gain_m_s2 = (gain_m_s2 + self.jerk_m_s3 * RECKON_S).min(gain_m_s2.max(MISSION_GAIN_M_S2));
                }
            } else {
                gain_m_s2 = (gain_m_s2 - self.jerk_m_s3 * RECKON_S).max(-self.braking_m_s2);
            }
            let before_m_s = speed_m_s;
            speed_m_s = (speed_m_s + gain_m_s2 * RECKON_S).max(0.0);
            way_m += 0.5 * (before_m_s + speed_m_s) * RECKON_S;
            if speed_m_s <= 0.0 {
                break;
            }
        }
        way_m
    }

    /// Metres that a mission takes which is begun and stopped again as soon as its vehicle is seen to move: what lies nearer on its
    /// course stops it before it moves.
    pub fn start_reach_m(&self) -> f32 {
        self.reach_m(2.0 * STANDS_M_S, MISSION_GAIN_M_S2)
    }
}

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
    /// It flies and never told where it is and how fast: it cannot be guarded, and it could not hold its position either.
    Unguarded,
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
    /// The last speeds, newest first, metres per second.
    speeds_m_s: [f32; SLOWS_STEPS],
}

impl JustStop {
    /// One step; the state from now on. While it is [`JustStopState::Stopping`] the vehicle is to be told to hold.
    pub fn step(&mut self, config: &JustStopConfig, input: &JustStopInput) -> JustStopState {
        // What goes up and down by itself, the grid of a level cannot judge.
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
        let danger = self.danger(config, input, &heartbeat).filter(|_| !holds || goes);
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
            JustStopState::Stopped(cause) if holds && (danger.is_none() || self.may_obey_yet(input.now_ns)) => {
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

    /// Whether the vehicle that was told to hold may still be on its way to a stand.
    fn may_obey_yet(&self, now_ns: Nanos) -> bool {
        !self.begun.stood && now_ns.saturating_sub(self.begun.at_ns) < OBEYS_NS
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

    /// Why the vehicle must not go on as it does, if it must not.
    fn danger(&mut self, config: &JustStopConfig, input: &JustStopInput, heartbeat: &Heartbeat) -> Option<StopCause> {
        let moves = input.speed_m_s.is_none_or(|speed_m_s| speed_m_s > STANDS_M_S);
        let longer = |since_ns: &mut Option<Nanos>, holds: bool, limit_ns: Nanos| {
            *since_ns = since_ns.or(Some(input.now_ns)).filter(|_| holds);
            since_ns.is_some_and(|since_ns| input.now_ns.saturating_sub(since_ns) > limit_ns)
        };
        let seen = input.course.filter(|_| input.speed_m_s.is_some());
        let blind = longer(&mut self.blind_since_ns, seen.is_none(), BLIND_NS);
        let unseen = longer(
            &mut self.unseen_since_ns,
            moves && seen.is_some_and(|course| course.unseen),
            config.unseen_limit_ns.unwrap_or(Nanos::MAX),
        );
        // A mission that stands has not begun yet, or is sent on.
        let starts = !moves && heartbeat.mode == VehicleMode::Mission;
        let obstacle_m = seen.and_then(|course| match (moves, starts) {
            (true, _) => course.obstacle_m,
            (false, true) => course.start_obstacle_m,
            (false, false) => None,
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

        /// Seconds until it is stopped; `None` within 5 s.
        fn stopped_after_s(&mut self) -> Option<(f32, StopCause)> {
            (1..=100).find_map(|step| Some((step as f32 * 0.05, self.step(None).cause()?)))
        }
    }

    #[test]
    fn the_reach_is_that_of_a_stop_with_delay_jerk_and_braking() {
        let config = JustStopConfig::default();
        // 2.4 m in 0.4 s; half a second to 2 m/s² costs 0.5 m/s; 5.5² / 4 = 7.56 m from there; half a metre spare.
        let ramp_m = 6.0 * 0.5 - 4.0 * 0.125 / 6.0;
        let by_hand_m = 2.4 + ramp_m + 7.5625 + 0.5;
        assert!(
            (config.reach_m(6.0, 0.0) - by_hand_m).abs() < 0.15,
            "{}",
            config.reach_m(6.0, 0.0)
        );
        // The ways of real autopilots' holds from steady flight, and 0.4 s until they are told.
        for (speed_m_s, way_m) in [(1.8, 2.4), (2.6, 3.4), (3.3, 4.9), (5.0, 7.5)] {
            let needed_m = way_m + 0.4 * speed_m_s;
            let reach_m = config.reach_m(speed_m_s, 0.0);
            assert!(
                reach_m >= needed_m && reach_m <= 1.3 * needed_m + 1.0,
                "{speed_m_s}: {reach_m}"
            );
        }
        // PX4 told at 1.9 m/s while it gains 2.7 m/s² needs 6.6 m; half as much again and a metre is early enough.
        assert!(
            (6.6..1.5 * 6.6 + 1.0).contains(&config.reach_m(1.9, 2.7)),
            "{}",
            config.reach_m(1.9, 2.7)
        );
        assert!((config.reach_m(0.0, 0.0) - 0.5).abs() < 1e-6);
        // What drag still hides of a steady flight costs less than a metre; in a start it is the beginning of more.
        assert!(config.reach_m(2.6, 0.6) < config.reach_m(2.6, 0.0) + 1.0);
        let costs_m = |speed_m_s| config.reach_m(speed_m_s, 0.6) - config.reach_m(speed_m_s, 0.0);
        assert!(costs_m(1.4) > costs_m(1.6) + 0.5, "{} {}", costs_m(1.4), costs_m(1.6));
        // From 3 m/s braking at MPC_ACC_HOR takes 2.6 m, and the hold of a PX4 4.3 m: the place that it is told lies between.
        assert!(
            (2.6..4.3).contains(&config.way_m(3.0, 0.0)),
            "{}",
            config.way_m(3.0, 0.0)
        );
        assert!(config.way_m(1.9, 2.7) > config.way_m(2.8, 0.0) + 1.0);
        // Who gains 3 m/s² gains another 1.2 m/s during the reaction and 1.125 while it is taken back.
        assert!(config.reach_m(2.0, 3.0) > config.reach_m(4.3, 0.0));
        assert!(config.reach_m(6.0, -2.0) < config.reach_m(6.0, 0.0) - 0.5);
        assert!(config.reach_m(3.0, f32::NAN).is_finite() && config.reach_m(f32::MAX, 9.0) > 1e6);
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
        for _ in 0..20 {
            held.step(None);
        }
        held.mode = VehicleMode::Hold;
        brake(2.9, &mut held, |state| state == JustStopState::Watching);
    }

    #[test]
    fn a_vehicle_that_takes_the_mode_and_flies_on_is_told_again() {
        let mut flight = Flight::at(2.0);
        flight.step(Some(5.0));
        flight.step(Some(5.0));
        flight.mode = VehicleMode::Hold;
        let mut told = 0;
        for _ in 0..100 {
            let before = flight.guard.state();
            let state = flight.step(Some(3.0));
            told += u32::from(matches!(state, JustStopState::Stopping(_)) && state != before);
        }
        assert!(told >= 1, "{told}");
        assert!(matches!(flight.guard.state(), JustStopState::Stopping(_)));
    }

    #[test]
    fn a_mission_that_begins_before_a_wall_is_held_before_it_moves_each_time_it_is_sent_on() {
        let mut flight = Flight::at(0.05);
        flight.start_obstacle_m = Some(3.5);
        for _ in 0..2 {
            flight.mode = VehicleMode::Mission;
            flight.step(None);
            assert!(matches!(flight.step(None), JustStopState::Stopping(_)));
            flight.mode = VehicleMode::Hold;
            assert!(matches!(flight.step(None), JustStopState::Stopped(_)));
        }
        // Who holds, or flies by sticks, has not begun a mission.
        let mut flight = Flight::at(0.05);
        (flight.start_obstacle_m, flight.mode) = (Some(3.5), VehicleMode::Other);
        assert_eq!(flight.stopped_after_s(), None);
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
            "then it is watched"
        );
    }

    #[test]
    fn whoever_flies_may_go_on_and_is_stopped_again_if_the_way_is_still_blocked() {
        let mut flight = Flight::at(2.0);
        flight.step(Some(1.0));
        flight.step(Some(1.0));
        flight.mode = VehicleMode::Hold;
        assert!(matches!(flight.step(Some(1.0)), JustStopState::Stopped(_)));
        (flight.mode, flight.speed_m_s) = (VehicleMode::Other, Some(0.1));
        assert_eq!(flight.step(Some(1.0)), JustStopState::Watching, "it does not move yet");
        flight.speed_m_s = Some(1.0);
        assert_eq!(flight.step(None), JustStopState::Watching, "away from it");
        flight.step(Some(0.9));
        assert!(matches!(flight.step(Some(0.9)), JustStopState::Stopping(_)));
    }

    #[test]
    fn who_takes_the_vehicle_over_during_a_stop_has_it_and_is_watched_like_anybody() {
        let mut flight = Flight::at(2.0);
        flight.step(Some(1.0));
        assert!(matches!(flight.step(Some(1.0)), JustStopState::Stopping(_)));
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
            flight.step(Some(1.0));
            assert!(matches!(flight.step(Some(1.0)), JustStopState::Stopping(_)));
        }
    }

    #[test]
    fn a_vehicle_that_never_told_its_position_is_unguarded_and_one_that_ceases_to_is_stopped() {
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
