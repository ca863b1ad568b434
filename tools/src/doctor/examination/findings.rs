//! What is found in what a vehicle sent: each value graded, with what is wanted and why.

use super::{EKF_STATUS_REPORT, Examination, GOOD_HZ, Gaps, SECOND_NS, late_ns, s};
use crate::doctor::GroundTilt;
use crate::doctor::finding::{Finding, Report, Severity};
use crate::doctor::parameters::{self, BEFORE_BY_SPEED, STICKS_BY_SPEED};
use crate::sensor_check::median;
use std::collections::BTreeSet;
use vigil_mavlink::common::{
    ATTITUDE_DATA, ATTITUDE_QUATERNION_DATA, ESTIMATOR_STATUS_DATA, EXTENDED_SYS_STATE_DATA, HEARTBEAT_DATA,
    LOCAL_POSITION_NED_DATA, SYS_STATUS_DATA,
};
use vigil_mavlink::mavlink::MessageData;
use vigil_types::{Landed, Nanos, wrap_pi};

/// MAV_TYPEs of multicopters.
const MULTICOPTERS: [u8; 6] = [2, 13, 14, 15, 29, 35];
/// Rates of position and attitude: below the first the vehicle holds again and again, below the second it flies with little margin.
const LEAST_HZ: f64 = 4.0;
/// Two headings, and two heights, that differ by more than this are not of one frame.
const HEADING_RAD: f32 = 0.35;
const HEIGHT_M: f32 = 3.0;
/// The sensor's mounting is off by more than this: radians.
const TILT_RAD: f32 = 0.05;
/// The vehicle's clock may run this much faster or slower than ours.
const CLOCK_RATIO: f64 = 0.03;
/// Answers to TIMESYNC: seconds there and back.
const SLOW_S: f64 = 0.1;
const TOO_SLOW_S: f64 = 0.3;
/// The vehicle's wall clock and ours may differ by this, seconds: signing refuses more than a minute.
const WALL_S: f64 = 10.0;
/// Battery below which guidance does not begin, by default.
const LOW_BATTERY: f32 = vigil_types::parameters::BATTERY.number_f32();
/// A message that comes every two seconds or more often has stopped if it did not come for so long.
const STOPPED_NS: Nanos = 3 * SECOND_NS;
/// What the end of a message leaves open.
const BY_HEIGHT: &str = "without it the height alone says whether the vehicle flies";
const OLD_CHECKS: &str = "battery and pre-arm check are what they were";
const OLD_TRUST: &str = "whether the position can be relied on is what it was";
/// What reports the vehicle's state.
const TOLD_OF: [(&str, u32, &str); 4] = [
    ("EXTENDED_SYS_STATE", EXTENDED_SYS_STATE_DATA::ID, BY_HEIGHT),
    ("SYS_STATUS", SYS_STATUS_DATA::ID, OLD_CHECKS),
    ("ESTIMATOR_STATUS", ESTIMATOR_STATUS_DATA::ID, OLD_TRUST),
    ("EKF_STATUS_REPORT", EKF_STATUS_REPORT, OLD_TRUST),
];

impl Examination {
    /// What was found up to `now_ns`.
    pub fn findings(&self, now_ns: Nanos) -> Vec<Finding> {
        let mut report = Report(Vec::new());
        if !self.heartbeat(now_ns, &mut report) {
            return report.0;
        }
        self.vehicle_state(&mut report);
        self.company(now_ns, &mut report);
        self.streams(now_ns, &mut report);
        self.changes(now_ns, &mut report);
        self.time(&mut report);
        self.estimator(&mut report);
        self.arming(&mut report);
        self.coordinates(&mut report);
        self.signing(&mut report);
        self.read_parameters(&mut report);
        self.mounting(&mut report);
        report.0
    }

    fn heartbeat(&self, now_ns: Nanos, report: &mut Report) -> bool {
        if self.vehicle.telemetry.heartbeat.is_none() {
            let others: Vec<String> = self.other_systems.iter().map(u8::to_string).collect();
            let value = (!others.is_empty()).then(|| format!("other vehicles: system {}", others.join(", ")));
            report.grade(
                "HEARTBEAT",
                Severity::Failure,
                value,
                "the heartbeat of an autopilot (component 1), once a second",
                "nobody is heard: is the link's address that to which the vehicle sends, is its port in use by another program, does it \
                 pass a firewall, does the vehicle sign?",
            );
            return false;
        }
        let rate_hz = self.arrivals.get(&HEARTBEAT_DATA::ID).and_then(|a| a.rate_hz(now_ns));
        let name = match self.vehicle.named {
            Some(flavour) => flavour.name().to_owned(),
            None => format!("MAV_AUTOPILOT {}", self.vehicle.mav_autopilot),
        };
        let who = format!("system {}, {name}", self.system.unwrap_or_default());
        let gaps = self.gaps(&[HEARTBEAT_DATA::ID], now_ns);
        match (self.config.flavour, self.vehicle.named) {
            _ if rate_hz.is_none() || gaps.count > 0 => report.failure(
                "HEARTBEAT",
                match rate_hz {
                    Some(_) => format!("{who}, away for {} at the longest", s(gaps.longest_ns)),
                    None => format!("{who}, and then silence"),
                },
                "once a second",
                "without it guidance holds: link lost",
            ),
            (Some(wanted), Some(named)) if wanted != named => report.failure(
                "HEARTBEAT",
                who,
                wanted.name(),
                "the vehicle is not flown: name what it is with --vehicle, or leave that out",
            ),
            (None, None) => report.warning(
                "HEARTBEAT",
                who,
                "PX4 (12) or ArduPilot (3)",
                "an autopilot that is not known is flown as PX4",
            ),
            _ => report.good("HEARTBEAT", who),
        }
        true
    }

    /// What it is, and whether it could fly now.
    fn vehicle_state(&self, report: &mut Report) {
        if let Some(kind) = self.vehicle_type.filter(|kind| !MULTICOPTERS.contains(kind)) {
            report.failure(
                "MAV_TYPE",
                kind.to_string(),
                "a multicopter (2, 13, 14, 15, 29, 35)",
                "setpoints of velocity that may be zero are for what can hover",
            );
        }
        if self.vehicle.telemetry.heartbeat.is_some_and(|h| h.failsafe) {
            report.failure(
                "failsafe",
                "the vehicle reports CRITICAL or EMERGENCY".to_owned(),
                "none",
                "guidance holds while it lasts; the vehicle's texts say what it is",
            );
        } else if self.was_in_failsafe {
            report.warning(
                "failsafe",
                "the vehicle reported CRITICAL or EMERGENCY for a while".to_owned(),
                "none",
                "guidance holds while one lasts; the vehicle's texts say what it was",
            );
        }
        if let Some(battery) = self.vehicle.telemetry.battery_remaining {
            let [value, least] = [battery, LOW_BATTERY].map(|charge| format!("{:.0} %", 100.0 * charge));
            let severity = Severity::good_if(battery >= LOW_BATTERY, Severity::Failure);
            let (wanted, why) = (format!("at least {least}"), "guidance does not begin below");
            report.grade("battery", severity, Some(value), &wanted, why);
        }
    }

    /// Who else is there.
    fn company(&self, now_ns: Nanos, report: &mut Report) {
        if self.config.system.is_none() && !self.other_systems.is_empty() {
            let ids: Vec<String> = self.other_systems.iter().map(u8::to_string).collect();
            report.failure(
                "vehicles",
                format!("system {} and {}", self.system.unwrap_or_default(), ids.join(", ")),
                "one, or one that is named",
                "whose telemetry is flown by would be chance: add system=ID to the link",
            );
        }
        let ids = |of: &BTreeSet<(u8, u8)>| of.iter().map(id).collect::<Vec<_>>().join(", ");
        let mut rates = self.companions.values().filter_map(|a| a.rate_hz(now_ns));
        let doubled = rates.any(|hz| hz > 1.6);
        let names: Vec<String> = self.companions.keys().map(id).collect();
        if doubled || names.len() > 1 {
            let each = if doubled { " (with the heartbeats of two)" } else { "" };
            report.failure(
                "companions",
                format!("{}{each}", names.join(", ")),
                "one",
                "two guidance computers give setpoints in turn, and the vehicle obeys both: stop one of them",
            );
        } else if let Some(name) = names.first() {
            report.good("companions", format!("one, {name}"));
        }
        if !self.setpoints_of.is_empty() {
            report.failure(
                "setpoints",
                format!("sent by {}", ids(&self.setpoints_of)),
                "none before the flight",
                "somebody already steers the vehicle: stop that program",
            );
        }
        if !self.sticks_of.is_empty() {
            report.warning("RC override",
                format!("MANUAL_CONTROL or RC_CHANNELS_OVERRIDE by {}", ids(&self.sticks_of)),
                "none, or a pilot who means it",
                "sticks by MAVLink may take the vehicle out of OFFBOARD or GUIDED: switch the ground station's joystick off",
            );
        }
    }

    fn streams(&self, now_ns: Nanos, report: &mut Report) {
        self.stream("LOCAL_POSITION_NED", &[LOCAL_POSITION_NED_DATA::ID], now_ns, report);
        let of_attitude = [ATTITUDE_DATA::ID, ATTITUDE_QUATERNION_DATA::ID];
        self.stream("ATTITUDE", &of_attitude, now_ns, report);
        let times = self.unusable;
        if times > 0 {
            report.failure(
                "values",
                format!("{times} times a position, velocity or attitude that is no number"),
                "finite numbers, and a quaternion of unit length",
                "the estimator failed: guidance holds",
            );
        }
        for (name, id, why) in TOLD_OF {
            let last_ns = self.arrivals.get(&id).and_then(|arrivals| arrivals.last_ns);
            if let Some(silent_ns) = last_ns.map(|last_ns| now_ns.saturating_sub(last_ns))
                && silent_ns > STOPPED_NS
            {
                let value = format!("it came, and stopped {} ago", s(silent_ns));
                report.warning(name, value, "1 Hz or more", why);
            }
        }
        if self.vehicle.telemetry.landed == Landed::Unknown {
            report.absent("EXTENDED_SYS_STATE", "1 Hz or more", BY_HEIGHT);
        }
    }

    /// One stream that guidance flies by, in one of some messages.
    fn stream(&self, name: &str, ids: &[u32], now_ns: Nanos, report: &mut Report) {
        let rates = ids.iter().filter_map(|id| self.arrivals.get(id)?.rate_hz(now_ns));
        let hz = rates.reduce(f64::max);
        let gaps = self.gaps(ids, now_ns);
        let last_ns = ids.iter().filter_map(|id| self.arrivals.get(id)?.last_ns).max();
        let severity = match hz {
            Some(_) if gaps.longest_ns > SECOND_NS => Severity::Failure,
            Some(hz) if hz >= GOOD_HZ && gaps.count == 0 => Severity::Good,
            Some(hz) if hz >= LEAST_HZ => Severity::Warning,
            _ => Severity::Failure,
        };
        let (count, sum, longest) = (gaps.count, s(gaps.sum_ns), s(gaps.longest_ns));
        let value = match hz {
            Some(hz) if count > 0 => Some(format!(
                "{hz:.1} Hz, but away {count} times, {sum} in all, {longest} at the longest"
            )),
            Some(hz) => Some(format!("{hz:.1} Hz")),
            None => last_ns.map(|last_ns| format!("it came, and stopped {} ago", s(now_ns.saturating_sub(last_ns)))),
        };
        let why = match (hz, last_ns) {
            (Some(_), _) if count > 0 => {
                "guidance holds by what is older than 0.3 s: the link fails, the line is full, or the vehicle's estimator stops"
            }
            (Some(_), _) => {
                "guidance holds by what is older than 0.3 s: somebody slows the stream down, or the line is full"
            }
            (None, Some(_)) => {
                "guidance holds: did the estimator lose its position (GPS), did somebody switch the stream off, did the link fail?"
            }
            (None, None) => {
                "it never came, though it was asked for: does the estimator have a position (GPS, or another source), and may \
                 this link ask (SET_MESSAGE_INTERVAL)?"
            }
        };
        report.grade(name, severity, value, "10 Hz or more, without a gap", why);
    }

    /// The gaps of the one of some messages that has the fewest: each says the same.
    fn gaps(&self, ids: &[u32], now_ns: Nanos) -> Gaps {
        let steady = ids.iter().filter_map(|id| {
            let arrivals = self.arrivals.get(id).filter(|arrivals| arrivals.is_steady)?;
            Some(arrivals.gaps(now_ns, late_ns(*id)))
        });
        steady.min_by_key(|gaps| gaps.sum_ns).unwrap_or_default()
    }

    /// What must not change under who looks: the vehicle's run, its clock, its place, its heading.
    fn changes(&self, now_ns: Nanos, report: &mut Report) {
        if let Some(restarted_ns) = self.restarted_ns {
            report.failure("restart",
                format!("the vehicle started anew {} ago", s(now_ns - restarted_ns)),
                "a vehicle that keeps running",
                "in flight that is a fall: look for its cause (power, a watchdog, a simulation that was restarted) and examine it again",
            );
        }
        if let Some(ahead_s) = self.clock_jumps_s {
            report.failure(
                "clock jumps",
                format!("the vehicle's time since its start jumped ahead by {ahead_s:.1} s"),
                "none",
                "what it stamps is believed by its order and age",
            );
        }
        let (count, most_m) = self.position_jumps;
        if count > 0 {
            report.failure("position jumps",
                format!("{count}, by {most_m:.1} m at the most"),
                "none",
                "the estimator changes its mind (GPS glitch, a reset, two vehicles of one system): guidance holds (implausible pose)",
            );
        }
        let (count, most_rad) = self.heading_jumps;
        if count > 0 {
            report.failure(
                "heading jumps",
                format!("{count}, by {:.0}° at the most", most_rad.to_degrees()),
                "none",
                "the estimator changes its mind (compass, a reset): setpoints in the body's frame then go elsewhere",
            );
        }
    }

    fn time(&self, report: &mut Report) {
        if let Some(((boot_ms, at_ns), (later_ms, later_ns))) = self.boot
            && later_ns - at_ns > SECOND_NS
        {
            let ratio = f64::from(later_ms - boot_ms) * 1e6 / (later_ns - at_ns) as f64;
            let severity = Severity::good_if((ratio - 1.0).abs() <= CLOCK_RATIO, Severity::Failure);
            let since = self.restarted_ns.map_or("", |_| " since its restart");
            report.grade(
                "clock",
                severity,
                Some(format!("{ratio:.3} of real time{since}")),
                "1.00",
                "the vehicle's time runs otherwise than ours: a simulation must run in real time (PX4: PX4_SIM_SPEED_FACTOR=1; ArduPilot: \
                 --speedup 1), and the machine must keep up with it",
            );
        }
        let mut trips = self.round_trips_s.clone();
        trips.sort_by(f64::total_cmp);
        if let Some(middle_s) = trips.get(trips.len() / 2) {
            let severity = match *middle_s {
                s if s > TOO_SLOW_S => Severity::Failure,
                s if s > SLOW_S => Severity::Warning,
                _ => Severity::Good,
            };
            report.grade(
                "TIMESYNC",
                severity,
                Some(format!("{:.0} ms there and back", middle_s * 1e3)),
                "at most 100 ms",
                "setpoints and telemetry are that old: guidance flies by what was",
            );
        }
        match self.unix_time_us {
            Some((unix_us, at_ns)) if unix_us > 0 => {
                let ours_us = self.config.unix_time_at_zero_us + at_ns / 1000;
                let apart_s = (unix_us as f64 - ours_us as f64) * 1e-6;
                let severity = Severity::good_if(apart_s.abs() <= WALL_S, Severity::Warning);
                report.grade(
                    "SYSTEM_TIME",
                    severity,
                    Some(format!("{apart_s:+.1} s from this machine's clock")),
                    "within 10 s",
                    "the logs' times differ, and signing refuses what is a minute old: set one of the clocks",
                );
            }
            _ => report.absent(
                "SYSTEM_TIME",
                "the vehicle's wall clock",
                "without it the vehicle's and Vigil's logs cannot be laid side by side by time of day",
            ),
        }
    }

    fn coordinates(&self, report: &mut Report) {
        let home = self.vehicle.home_ned_m();
        match home {
            Some(home) => report.good("HOME_POSITION", format!("{:.1} m north, {:.1} m east, {:.1} m up", home.x, home.y, 0.0 - home.z)),
            None => report.absent("HOME_POSITION",
                "where home is",
                "goals are then from the local origin, where the estimator began: an ArduPilot sets home when it is armed or has GPS, a PX4 \
                 when it has a global position",
            ),
        }
        let t = &self.vehicle.telemetry;
        let (Some(k), Some(attitude)) = (t.kinematics, t.attitude) else {
            return;
        };
        let Some((up_m, heading_rad)) = self.global else { return };
        if let Some(home) = home {
            let local_up_m = home.z - k.position_ned_m.z;
            let apart_m = (local_up_m - up_m).abs();
            let value = format!("{local_up_m:.1} m by LOCAL_POSITION_NED, {up_m:.1} m by GLOBAL_POSITION_INT");
            if apart_m <= HEIGHT_M {
                report.good("height", value);
            } else {
                let is_upside_down = (local_up_m + up_m).abs() <= HEIGHT_M;
                let why = match is_upside_down {
                    true => "the local frame's z points up: it must point down (NED, not ENU)",
                    false => "the two frames' origins differ: a goal's height would be wrong by as much",
                };
                report.failure("height", value, "the same height above home", why);
            }
        }
        if let Some(heading_rad) = heading_rad {
            let yaw_rad = attitude.attitude.yaw_rad();
            let [yaw_deg, heading_deg] = [yaw_rad, heading_rad].map(|rad| wrap_pi(rad).to_degrees());
            let value = format!("{yaw_deg:.0}° by ATTITUDE, {heading_deg:.0}° by GLOBAL_POSITION_INT");
            let apart = |other: f32| wrap_pi(other - heading_rad).abs();
            if apart(yaw_rad) <= HEADING_RAD {
                report.good("heading", value);
            } else {
                let why = match apart(std::f32::consts::FRAC_PI_2 - yaw_rad) <= HEADING_RAD {
                    true => "attitude is sent in east-north-up: yaw must be clockwise from north (NED)",
                    false => "setpoints are in the body's frame: the vehicle would fly another way than it looks",
                };
                report.failure("heading", value, "one heading", why);
            }
        }
    }

    fn signing(&self, report: &mut Report) {
        match (self.is_signed, self.config.has_key) {
            (true, true) => report.good("signing", "signed with the key".to_owned()),
            (true, false) => report.failure(
                "signing",
                "the vehicle signs its packets, and there is no key here".to_owned(),
                "the vehicle's key",
                "it will refuse commands and setpoints without a signature: give --signing-key",
            ),
            (false, true) => report.failure(
                "signing",
                "packets without a signature".to_owned(),
                "packets signed with the key",
                "the vehicle has another key or none: give it this one (SETUP_SIGNING)",
            ),
            (false, false) if self.config.is_local => {
                report.good("signing", "none, on a link within this machine".to_owned());
            }
            (false, false) => report.warning(
                "signing",
                "none".to_owned(),
                "signed packets where others reach the link",
                "whoever reaches the link may command the vehicle: docs/firmware.md, Signing",
            ),
        }
    }

    fn read_parameters(&self, report: &mut Report) {
        let value_of = |name: &str| self.parameters.get(name).and_then(|asked| asked.value);
        let of_others: &[&str] = match value_of(STICKS_BY_SPEED) {
            Some(_) => &BEFORE_BY_SPEED,
            None => &[STICKS_BY_SPEED],
        };
        for row in parameters::of(self.vehicle.flavour()).filter(|row| !of_others.contains(&row.name)) {
            match value_of(row.name) {
                Some(value) => {
                    let found = format!("{value} {}", row.unit).trim_end().to_owned();
                    report.grade(row.name, (row.grade)(value), Some(found), row.wanted, row.why);
                }
                None => report.absent(row.name,
                    row.wanted,
                    "the vehicle did not tell this parameter: it may be of a version that does not have it, or not answer on this link",
                ),
            }
        }
    }

    fn mounting(&self, report: &mut Report) {
        let Some((attitude, position_ned_m)) = self.frame else {
            return;
        };
        let t = &self.vehicle.telemetry;
        if let (Some(k), Some(a)) = (t.kinematics, t.attitude) {
            let yaw_apart = wrap_pi(attitude.yaw_rad() - a.attitude.yaw_rad()).abs();
            let apart_m = (position_ned_m - k.position_ned_m).norm();
            let value = format!("{apart_m:.1} m and {:.0}° from the vehicle's", yaw_apart.to_degrees());
            let severity = Severity::good_if(yaw_apart <= HEADING_RAD && apart_m <= HEIGHT_M, Severity::Failure);
            report.grade(
                "frame pose",
                severity,
                Some(value),
                "the vehicle's own",
                "the pose in the frames' header is of another frame or vehicle: guidance holds (implausible pose)",
            );
        }
        let median_of = |of: fn(&GroundTilt) -> f32| median(self.tilts.iter().map(of).collect());
        let (Some(pitch), Some(roll)) = (median_of(|t| t.pitch_rad), median_of(|t| t.roll_rad)) else {
            return;
        };
        let severity = Severity::good_if(pitch.abs().max(roll.abs()) <= TILT_RAD, Severity::Warning);
        let (pitch, roll) = (pitch.to_degrees(), roll.to_degrees());
        report.grade(
            "mount",
            severity,
            Some(format!("the ground leans by {pitch:.1}° in pitch and {roll:.1}° in roll")),
            "at most 3° over level ground",
            "the sensor is mounted at another angle than its driver states (or the ground is not level): give its driver the mount \
             (--mount of `vigil sensor`; docs/sensor-interface.md, Projection); the pose in the frames' header stays the vehicle's own",
        );
    }
}

fn id((system, component): &(u8, u8)) -> String {
    format!("{system}/{component}")
}
