//! The distance that a vehicle needs to stop, reckoned from its speed and from what it gains.

use crate::just_stop::STANDS_M_S;
use vigil_types::{MissionMotion, Nanos, parameters};

/// Step of the reckoned stop, seconds, and the most of them: 20 s.
const RECKON_S: f32 = 0.05;
const RECKON_STEPS: usize = 400;
/// Fastest that a vehicle is believed to gain speed, metres per second squared.
const GREATEST_GAIN_M_S2: f32 = 6.0;
/// What an autopilot gains speed with in a mission at the least: PX4's MPC_ACC_HOR is 3, Copter's WPNAV_ACCEL 2.5 by default, metres per
/// second squared.
const MISSION_GAIN_M_S2: f32 = 3.0;
/// Of what its parameter says, an autopilot brakes with this part: velocities are not followed at once.
const BRAKES_BY: f32 = 2.0 / 3.0;
/// The least that is believed of either, metres per second squared and cubed.
const LEAST_BRAKING_M_S2: f32 = 0.3;
const LEAST_JERK_M_S3: f32 = 0.5;
/// A vehicle that shows a faster change of its acceleration than is configured is believed up to so many times that.
const MOST_JERK: f32 = 1.5;
/// The distance of a hold from steady flight is this time times the speed: measured 1.3 to 1.5 s on PX4 (HOLD from 1.8 to 3.3 m/s) and about
/// 1.5 s on ArduCopter (BRAKE).
const HOLD_TRAVEL_S: f32 = 1.5;
/// A gust or a lull moves a vehicle that stops by this time squared times what the wind takes away, beyond what is measured in a calm.
const GUST_S2: f32 = 1.0;
const CALM_M_S2: f32 = 0.3;
/// PX4 plans its speed, and the vehicle follows: the plan is ahead by this time times what the vehicle gains, less what that changes by in
/// the second time; by nothing and by all of it once that was gained for the times after.
const PLANS_AHEAD_S: f32 = 0.2;
const WANES_S: f32 = 1.0;
const GAINED_FOR_S: [f32; 2] = [0.6, 1.0];
const LEAST_GAIN_M_S2: f32 = 0.1;
/// From a command until the autopilot acts on it, seconds.
const ORDERED_S: f32 = 0.1;

/// How the vehicle stops. [`JustStopConfig::default`] is what docs/just-stop.md states.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JustStopConfig {
    /// From the frame that shows an obstacle until the vehicle begins to change its acceleration, seconds.
    pub reaction_s: f32,
    /// What it brakes with, metres per second squared. PX4: MPC_ACC_HOR, 3 by default; Copter's BRAKE: 7.5.
    pub braking_m_s2: f32,
    /// How fast it gets there, metres per second cubed. PX4: MPC_JERK_AUTO, 4 by default; Copter: PSC_JERK_XY, 5.
    pub jerk_m_s3: f32,
    /// What it gains speed with in a mission, metres per second squared.
    pub mission_gain_m_s2: f32,
    /// Its autopilot's plan is ahead of it by this time times what it gains, seconds.
    pub plans_ahead_s: f32,
    /// Kept between its stop and what it must not touch, metres.
    pub spare_m: f32,
    /// Moved so long where the sensor does not look, it is stopped; `None` is never.
    pub unseen_limit_ns: Option<Nanos>,
}

/// What a vehicle gains along its velocity.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Gain {
    /// Metres per second squared.
    pub gain_m_s2: f32,
    /// How fast this grows: a start is still on its way to all that its autopilot gains speed with. Metres per second cubed.
    pub growth_m_s3: f32,
    /// The fastest that it has grown in this flight: an autopilot takes its acceleration back as fast as it gives it.
    pub shown_m_s3: f32,
    /// What the wind alone takes away from it, while it stands: metres per second squared.
    pub wind_m_s2: f32,
}

impl Default for JustStopConfig {
    fn default() -> Self {
        Self {
            reaction_s: parameters::STOP_REACTION.number_f32(),
            braking_m_s2: parameters::STOP_BRAKING.number_f32(),
            jerk_m_s3: parameters::STOP_JERK.number_f32(),
            mission_gain_m_s2: MISSION_GAIN_M_S2,
            plans_ahead_s: 0.0,
            spare_m: parameters::STOP_SPARE.number_f32(),
            unseen_limit_ns: Some((parameters::STOP_UNSEEN.number() * 1e9) as Nanos),
        }
    }
}

impl JustStopConfig {
    /// The same with what the autopilot says of itself, where that is worse than what is configured.
    #[must_use]
    pub fn reckoning_with(self, said: MissionMotion) -> Self {
        let gain_m_s2 = said.gain_m_s2.unwrap_or(0.0);
        let braking_m_s2 = said.braking_m_s2.map_or(f32::INFINITY, |m_s2| BRAKES_BY * m_s2);
        Self {
            mission_gain_m_s2: gain_m_s2.clamp(self.mission_gain_m_s2, GREATEST_GAIN_M_S2),
            braking_m_s2: braking_m_s2.max(LEAST_BRAKING_M_S2).min(self.braking_m_s2),
            jerk_m_s3: said
                .jerk_m_s3
                .unwrap_or(f32::INFINITY)
                .max(LEAST_JERK_M_S3)
                .min(self.jerk_m_s3),
            // Only PX4 brakes by a parameter.
            plans_ahead_s: said.braking_m_s2.map_or(self.plans_ahead_s, |_| PLANS_AHEAD_S),
            ..self
        }
    }

    /// Metres within which something on the course stops a vehicle of this speed, metres per second, that gains speed with this
    /// acceleration, metres per second squared. An autopilot takes its acceleration back as fast as its jerk allows: who is ordered to
    /// hold while it gains speed goes on gaining it for a while; and until it is ordered, who has begun to gain speed gains more.
    pub fn reach_m(&self, speed_m_s: f32, gain: Gain) -> f32 {
        let steady_m = speed_m_s.max(0.0) * (self.reaction_s + HOLD_TRAVEL_S);
        let windy_m_s2 = gain.wind_m_s2 - CALM_M_S2;
        let gust_m = if windy_m_s2 > 0.0 {
            GUST_S2 * windy_m_s2.min(GREATEST_GAIN_M_S2)
        } else {
            0.0
        };
        let ahead_m_s = self.plan_ahead_m_s(speed_m_s, gain);
        let braking_m = self.braking_distance_m(speed_m_s.max(0.0) + ahead_m_s, gain, self.reaction_s);
        self.spare_m + gust_m + braking_m.max(steady_m)
    }

    /// Metres to where an autopilot that is ordered to hold now can come to rest from this speed, metres per second, that it gains with
    /// this acceleration, metres per second squared.
    pub fn stopping_m(&self, speed_m_s: f32, gain: Gain) -> f32 {
        self.braking_distance_m(speed_m_s, gain, ORDERED_S)
    }

    /// By how much the autopilot's plan is faster than the vehicle, metres per second.
    fn plan_ahead_m_s(&self, speed_m_s: f32, gain: Gain) -> f32 {
        let gain_m_s2 = gain.gain_m_s2.min(GREATEST_GAIN_M_S2);
        let [none_s, all_s] = GAINED_FOR_S;
        let share = ((speed_m_s / gain_m_s2.max(LEAST_GAIN_M_S2) - none_s) / (all_s - none_s)).clamp(0.0, 1.0);
        self.plans_ahead_s * share * (gain_m_s2 - gain.growth_m_s3.abs() * WANES_S).max(0.0)
    }

    /// Metres of a stop that is begun after so many seconds.
    fn braking_distance_m(&self, speed_m_s: f32, gain: Gain, reaction_s: f32) -> f32 {
        let mut speed_m_s = speed_m_s.max(0.0);
        // It may cease braking in the moment in which it is looked at.
        let mut gain_m_s2 = if gain.gain_m_s2.is_finite() {
            gain.gain_m_s2.clamp(-0.5 * self.braking_m_s2, GREATEST_GAIN_M_S2)
        } else {
            GREATEST_GAIN_M_S2
        };
        let grown_m_s2 = gain_m_s2.max(self.mission_gain_m_s2);
        let growth_m_s3 = gain.growth_m_s3.min(self.jerk_m_s3).max(0.0);
        let jerk_m_s3 = gain.shown_m_s3.max(self.jerk_m_s3).min(MOST_JERK * self.jerk_m_s3);
        let mut stopping_m = 0.0;
        let reaction_steps = (reaction_s / RECKON_S + 0.5) as usize;
        for step in 0..RECKON_STEPS {
            if step < reaction_steps {
                gain_m_s2 = (gain_m_s2 + growth_m_s3 * RECKON_S).min(grown_m_s2);
            } else {
                gain_m_s2 = (gain_m_s2 - jerk_m_s3 * RECKON_S).max(-self.braking_m_s2);
            }
            let before_m_s = speed_m_s;
            speed_m_s = (speed_m_s + gain_m_s2 * RECKON_S).max(0.0);
            stopping_m += 0.5 * (before_m_s + speed_m_s) * RECKON_S;
            if speed_m_s <= 0.0 {
                break;
            }
        }
        stopping_m
    }

    /// Metres that a mission takes which is begun and stopped again as soon as its vehicle is seen to move: what lies nearer on its
    /// course stops it before it moves.
    pub fn start_reach_m(&self) -> f32 {
        let gain = Gain {
            gain_m_s2: self.mission_gain_m_s2,
            ..Gain::default()
        };
        self.reach_m(2.0 * STANDS_M_S, gain)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A steady gain.
    fn gain(gain_m_s2: f32) -> Gain {
        Gain {
            gain_m_s2,
            ..Gain::default()
        }
    }

    #[test]
    fn the_reach_is_that_of_a_stop_with_delay_jerk_and_braking() {
        let config = JustStopConfig::default();
        let reach_m = |speed_m_s, gain_m_s2| config.reach_m(speed_m_s, gain(gain_m_s2));
        let stopping_m = |speed_m_s, gain_m_s2| config.stopping_m(speed_m_s, gain(gain_m_s2));
        // 2.4 m in 0.4 s; half a second to 2 m/s² costs 0.5 m/s; 5.5² / 4 = 7.56 m from there; half a metre spare.
        let ramp_m = 6.0 * 0.5 - 4.0 * 0.125 / 6.0;
        let by_hand_m = 2.4 + ramp_m + 7.5625 + 0.5;
        assert!((reach_m(6.0, 0.0) - by_hand_m).abs() < 0.15, "{}", reach_m(6.0, 0.0));
        // The distances of real autopilots' holds from steady flight, and 0.4 s until they are ordered.
        for (speed_m_s, stopping_m) in [(1.8, 2.4), (2.6, 3.4), (3.3, 4.9), (5.0, 7.5)] {
            let needed_m = stopping_m + 0.4 * speed_m_s;
            let reach_m = reach_m(speed_m_s, 0.0);
            assert!(
                reach_m >= needed_m && reach_m <= 1.3 * needed_m + 1.0,
                "{speed_m_s}: {reach_m}"
            );
        }
        // PX4 ordered at 1.9 m/s while it gains 2.7 m/s² needs 6.6 m; half as much again and a metre is early enough.
        let start_m = reach_m(1.9, 2.7);
        assert!((6.6..1.5 * 6.6 + 1.0).contains(&start_m), "{start_m}");
        assert!((reach_m(0.0, 0.0) - 0.5).abs() < 1e-6);
        // From 3 m/s braking at MPC_ACC_HOR takes 2.6 m, and the hold of a PX4 4.3 m: the place that it is sent lies between.
        assert!((2.6..4.3).contains(&stopping_m(3.0, 0.0)), "{}", stopping_m(3.0, 0.0));
        assert!(stopping_m(1.9, 2.7) > stopping_m(2.8, 0.0) + 1.0);
        // Who gains 3 m/s² gains another 1.2 m/s during the reaction and 1.125 while it is taken back.
        assert!(reach_m(2.0, 3.0) > reach_m(4.3, 0.0));
        assert!(reach_m(6.0, -2.0) < reach_m(6.0, 0.0) - 0.5);
        let in_wind_m = |wind_m_s2| {
            let gain = Gain {
                wind_m_s2,
                ..Gain::default()
            };
            config.reach_m(3.0, gain)
        };
        assert!(in_wind_m(1.5) > in_wind_m(0.0) + 1.0, "gusts");
        assert_eq!(in_wind_m(0.2), in_wind_m(0.0), "a calm");
        assert!(in_wind_m(f32::NAN).is_finite() && in_wind_m(f32::MAX).is_finite());
        assert!(reach_m(3.0, f32::NAN).is_finite() && reach_m(f32::MAX, 9.0) > 1e6);
    }

    #[test]
    fn a_start_that_still_grows_needs_more_than_one_that_is_over_and_a_quick_autopilot_less() {
        let config = JustStopConfig::default();
        let reach_m = |growth_m_s3, shown_m_s3| {
            let gain_m_s2 = 1.5;
            let gain = Gain {
                gain_m_s2,
                growth_m_s3,
                shown_m_s3,
                ..Gain::default()
            };
            config.reach_m(1.0, gain)
        };
        assert!(reach_m(4.0, 0.0) > reach_m(0.0, 0.0) + 1.0);
        assert_eq!(reach_m(100.0, 0.0), reach_m(4.0, 0.0), "no faster than is configured");
        assert_eq!(reach_m(-4.0, 0.0), reach_m(0.0, 0.0), "what wanes may cease to");
        assert_eq!(reach_m(f32::NAN, f32::NAN), reach_m(4.0, 0.0));
        // ArduCopter gives and takes its acceleration with 5 m/s³.
        assert!(reach_m(0.0, 5.0) < reach_m(0.0, 4.0) - 0.1);
        assert_eq!(
            reach_m(0.0, 1.0),
            reach_m(0.0, 4.0),
            "a slow start says nothing of a stop"
        );
        assert_eq!(reach_m(0.0, 100.0), reach_m(0.0, 6.0), "a jolt is no autopilot's");
    }

    /// Measured on PX4 in SIH as shipped: ordered to hold at 2.7 m/s in the middle of a start to 5 m/s, it needs 8.9 to 9.7 m from the frame on.
    #[test]
    fn a_px4_in_the_middle_of_a_start_needs_more_than_its_own_acceleration_shows() {
        let said = MissionMotion {
            braking_m_s2: Some(3.0),
            ..MissionMotion::default()
        };
        let px4 = JustStopConfig::default().reckoning_with(said);
        let reach_m = |config: JustStopConfig, growth_m_s3| {
            let gain = Gain {
                growth_m_s3,
                shown_m_s3: 2.9,
                ..gain(2.15)
            };
            config.reach_m(2.7, gain)
        };
        let other = JustStopConfig::default();
        let [px4_m, other_m] = [px4, other].map(|config| reach_m(config, -0.1));
        assert!((9.7..1.5 * 9.7 + 1.0).contains(&px4_m), "{px4_m}");
        assert!(other_m < 9.2, "{other_m}");
        // One that ends has no plan far ahead, nor has one that begins.
        assert_eq!(reach_m(px4, -3.0), reach_m(other, -3.0));
        assert_eq!(px4.reach_m(1.2, gain(2.15)), other.reach_m(1.2, gain(2.15)));
        assert_eq!(px4.reach_m(0.0, gain(0.0)), other.reach_m(0.0, gain(0.0)));
    }
}
