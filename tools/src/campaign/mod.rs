//! One flight of the whole stack in lockstep, attacked or not: what every campaign repeats.

pub mod flights;
mod recording;
mod sensor_record;
mod watch;

pub use recording::Recording;
pub use sensor_record::{FaultChoice, SensorRecord};
pub use watch::WatchRecord;

use crate::statistics::wilson_95;
use anyhow::Result;
use serde::{Deserialize, Serialize};
use std::convert::Infallible;
use std::path::Path;
use vigil_adversary::{Attack, AttackRecord};
use vigil_firmware::{FirmwareConfig, LockstepFirmware};
use vigil_sim::lockstep_flight::{FlightRecord, fly_lockstep};
use vigil_sim::vehicle::Wind;
use vigil_sim::world::{Family, Outcome, generate};
use vigil_sim::{SimConfig, Simulator, Start};
use vigil_types::{Datagrams, DepthFrame, FrameKeys, Nanos, PilotKind};

/// What a flight came to.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Flight {
    /// Of course, sensor noise and attack.
    pub seed: u64,
    /// Began on the ground.
    pub from_ground: bool,
    /// What was wrong with the sensor.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor_fault: Option<String>,
    /// How it ended.
    #[serde(flatten)]
    pub record: FlightRecord,
    /// What the attack did, if there was one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub attack: Option<AttackRecord>,
    /// What the detector did, if there was one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub watch: Option<WatchRecord>,
    /// What was found wrong with the sensor.
    pub sensor: SensorRecord,
    /// Altered frames that a pilot was shown; absent without an attack.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub altered_frames_used: Option<u64>,
}

/// How a row of flights ended.
#[derive(Debug, Serialize, Deserialize)]
pub struct Tally {
    /// How many.
    pub flights: usize,
    /// Of these, how many reached the goal.
    pub completed: usize,
    /// Their share, 0 to 1.
    pub completion: f64,
    /// Wilson's 95 % interval of it.
    pub wilson_95: (f64, f64),
    /// Flights that ended at an obstacle or the ground.
    pub collisions: usize,
    /// Flights that left the course.
    pub out_of_bounds: usize,
    /// Flights that took too long.
    pub time_outs: usize,
}

impl Tally {
    /// Counts; `None` is a vehicle that never took off.
    pub fn of(outcomes: &[Option<Outcome>]) -> Self {
        let count = |outcome| outcomes.iter().filter(|o| **o == Some(outcome)).count();
        let completed = count(Outcome::Success);
        Self {
            flights: outcomes.len(),
            completed,
            completion: completed as f64 / outcomes.len().max(1) as f64,
            wilson_95: wilson_95(completed, outcomes.len()),
            collisions: count(Outcome::Collision),
            out_of_bounds: count(Outcome::OutOfBounds),
            time_outs: count(Outcome::TimeOut),
        }
    }

    /// The headings of [`Self::cells`].
    pub const COLUMNS: &str = "> completion | 95 % interval | > collision | > bounds | > time-out";

    /// Share, interval and how the others ended.
    pub fn cells(&self) -> [String; 5] {
        let (low, high) = self.wilson_95;
        [
            format!("{:.1} %", 100.0 * self.completion),
            format!("{:.1} to {:.1} %", 100.0 * low, 100.0 * high),
            self.collisions.to_string(),
            self.out_of_bounds.to_string(),
            self.time_outs.to_string(),
        ]
    }
}

/// The share of attacked steps that moved the yaw by 1.0 or more, in words.
pub fn effective_share(attacked_steps: u64, effective_steps: u64) -> String {
    if attacked_steps == 0 {
        "—".to_owned()
    } else {
        let share = 100.0 * effective_steps as f64 / attacked_steps as f64;
        format!("{share:.0} % of {attacked_steps} steps")
    }
}

/// How a flight ended; `None` is a vehicle that never took off.
pub fn outcome_name(outcome: Option<Outcome>) -> &'static str {
    outcome.map_or("never took off", Outcome::name)
}

/// A number from 0 to 1 for each seed. Multiples of the golden ratio spread neighbouring seeds evenly.
pub fn spread(seed: u64) -> f64 {
    // Multiples of larger seeds are no longer apart in an f64.
    ((seed % (1 << 32)) as f64 * 0.618_033_988_749_895) % 1.0
}

/// A wind of mean speed `mean_m_s` from a direction that depends on the seed, with gusts a third as strong.
pub fn wind(mean_m_s: f64, seed: u64) -> Wind {
    Wind::gusty(mean_m_s, std::f64::consts::TAU * spread(seed))
}

/// A validation course in the air, flown by the actor (the one built in when no file is given) without a detector.
pub fn actor_flight(actor: Option<&Path>, apf: bool, seed: u64) -> (SimConfig, FirmwareConfig) {
    let mut config = SimConfig::new(generate(Family::Validation, seed), seed);
    config.start = Start::Airborne;
    let mut firmware = FirmwareConfig::to_goal(config.course.goal_ned_m());
    firmware.pilot.kind = PilotKind::Actor;
    firmware.pilot.actor_file = actor.map(Path::to_owned);
    firmware.pilot.apf = apf;
    firmware.detector.enabled = Some(false);
    (config, firmware)
}

/// Flies a course to its end.
///
/// # Errors
/// A configuration that must not fly, an actor that is refused, an attack out of range.
pub fn fly(config: &SimConfig, firmware: &FirmwareConfig, attack: Option<&Attack>) -> Result<Flight> {
    fly_recorded(config, firmware, attack, None)
}

/// Flies a course to its end and keeps its log, if a recording is given: the same flight, bit for bit, with or without.
///
/// # Errors
/// As [`fly`], and a log that cannot be written.
pub fn fly_recorded(
    config: &SimConfig,
    firmware: &FirmwareConfig,
    attack: Option<&Attack>,
    recording: Option<Recording>,
) -> Result<Flight> {
    let mut simulator = Simulator::new(config, 0)?;
    let mut flying = LockstepFirmware::new(firmware)?;
    let begun = recording.map(|recording| recording.begin(config, firmware, &mut flying));
    let mut recording = begun.transpose()?;
    let current = config.frame_key.clone();
    if current.is_some() {
        flying.require_frame_keys(FrameKeys { current, other: None });
    }
    let mut adversary = attack
        .map(|attack| attack.interceptor(config.seed, config.course.goal_ned_m()))
        .transpose()?;
    let mut done = attack.map(|_| AttackRecord::default());
    let (mut watch, mut sensor) = (WatchRecord::default(), SensorRecord::default());
    let mut altered_frames_used = 0;
    let step = |step: u64, now_ns: Nanos, frame: &mut DepthFrame, received: &Datagrams, sent: &mut Datagrams| {
        let clean = recording.as_ref().map(|_| Box::new(frame.clone()));
        // Only a frame of another size is refused, and the simulator makes none.
        let passed = adversary.as_mut().map(|adversary| adversary.pass(step, frame));
        let passed = passed.transpose().ok().flatten();
        if let (Some(passed), Some(done)) = (&passed, &mut done) {
            done.observe(step, passed.as_ref());
            if let (Some(recording), Some(clean)) = (&mut recording, &clean) {
                recording.note(passed.as_ref(), clean);
            }
        }
        let report = flying.step(now_ns, Some(frame), received, sent);
        watch.observe(step, report);
        sensor.observe(step, report);
        let is_used = report.frame_sequence == Some(frame.header.sequence);
        altered_frames_used += u64::from(is_used && passed.flatten().is_some());
        Ok::<(), Infallible>(())
    };
    let Ok(record) = fly_lockstep(&mut simulator, f64::from(config.course.time_limit_s), step);
    if let Some(recording) = recording {
        flying.finish();
        recording.end(config, &record)?;
    }
    Ok(Flight {
        seed: config.seed,
        from_ground: config.start == Start::Ground,
        sensor_fault: config.sensor_fault.map(|fault| fault.to_string()),
        record,
        attack: done,
        watch: (watch.judged_steps > 0).then_some(watch),
        sensor,
        altered_frames_used: done.map(|_| altered_frames_used),
    })
}

#[cfg(test)]
mod tests {
    #[test]
    fn large_seeds_are_spread_as_small_ones_are() {
        let of = |seed: u64| super::spread((1 << 60) + seed);
        assert!((of(1) - of(2)).abs() > 0.3);
    }
}
