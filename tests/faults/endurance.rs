//! Hours of flight, goal after goal on a ring of eight, in one process of the firmware: does it fly on, and does memory stay flat?
//!
//! An operator goes with it who does what a person would: the next goal when one is reached, another one when a goal is not
//! reached in time, a landing and a new take-off where a sensor stays in doubt.

use crate::campaign::{Folder, tell};
use anyhow::{Context, Result, bail, ensure};
use serde::Serialize;
use std::fmt::Write as _;
use std::net::UdpSocket;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use vigil_firmware::FirmwareConfig;
use vigil_sim::program::Status;
use vigil_sim::world::{Course, World};
use vigil_sim::{SimConfig, Start};
use vigil_tests::ground::{Request, STATION, packet};
use vigil_tests::{Pair, Running};
use vigil_types::{GuidanceState, NedVector, Reason, Reasons, STEP_NS, STEP_S};

/// The ring's course.
pub const ORBIT: &str = include_str!("orbit.toml");
/// The ring: north and east of home, metres.
const GOALS: [[f32; 2]; 8] = [
    [5.86, -14.14],
    [20.0, -20.0],
    [34.14, -14.14],
    [40.0, 0.0],
    [34.14, 14.14],
    [20.0, 20.0],
    [5.86, 14.14],
    [0.0, 0.0],
];
const HEIGHT_M: f32 = 1.5;
/// A battery for a day: what is tried is not how long a battery lasts.
const CAPACITY_AH: f64 = 1000.0;
/// A goal that is not reached in this time is given up.
const LEG_LIMIT_S: f64 = 90.0;
/// A doubt that lasts longer is answered by a landing.
const DOUBT_LIMIT_S: f64 = 10.0;
/// An operator says nothing twice within this time.
const PATIENCE_S: f64 = 2.0;
/// The vehicle's radius: nearer to an obstacle it has touched it.
const RADIUS_M: f32 = 0.30;
/// What is measured before this counts as the start, but no more than a third of the flight: buffers have then been touched, and the
/// simulated vehicle's own log has its megabyte.
const WARM_S: f64 = 1200.0;

/// Reasons of the sensor that do not end while the vehicle hovers.
const SENSOR_FAULTS: [Reason; 2] = [Reason::FrozenSensor, Reason::InconsistentPicture];

/// The operator: what he saw, and what he did.
#[derive(Debug, Default, Serialize)]
pub struct Operator {
    pub goals: u64,
    pub given_up: u64,
    /// Landings because a sensor stayed in doubt.
    pub landings: u64,
    pub alarms: u64,
    /// Holds by reason, the goal's and the operator's own left out.
    pub holds: std::collections::BTreeMap<&'static str, u64>,
    #[serde(skip)]
    leg_since_s: f64,
    #[serde(skip)]
    doubt_since_s: Option<f64>,
    #[serde(skip)]
    said_s: f64,
    #[serde(skip)]
    held: Reasons,
    #[serde(skip)]
    alarmed: bool,
}

impl Operator {
    pub fn goal(&self) -> [f32; 2] {
        GOALS[((self.goals + self.given_up) % GOALS.len() as u64) as usize]
    }

    /// Looks, and says what he asks for.
    pub fn look(&mut self, now_s: f64, state: GuidanceState, reasons: Reasons) -> Option<Request> {
        let own = [Reason::GoalReached, Reason::Operator];
        let held = (reasons.iter()).filter(|reason| state == GuidanceState::Hold && !own.contains(reason));
        let held = held.fold(Reasons::NONE, |all, reason| all.with_if(true, reason));
        for reason in held.iter().filter(|reason| !self.held.contains(*reason)) {
            *self.holds.entry(reason.name()).or_default() += 1;
        }
        self.held = held;
        let alarmed = reasons.contains(Reason::Recovering);
        self.alarms += u64::from(alarmed && !self.alarmed);
        self.alarmed = alarmed;

        let doubted = SENSOR_FAULTS.iter().any(|doubt| held.contains(*doubt));
        let doubt_since_s = *self.doubt_since_s.get_or_insert(now_s);
        if !doubted {
            self.doubt_since_s = None;
        }
        if now_s - self.said_s < PATIENCE_S {
            return None;
        }
        let flies = matches!(state, GuidanceState::Guided | GuidanceState::Hold);
        let request = if flies && doubted && now_s - doubt_since_s > DOUBT_LIMIT_S {
            self.landings += 1;
            Request::Land
        } else if flies && reasons.contains(Reason::GoalReached) {
            self.goals += 1;
            Request::Goal(self.goal())
        } else if flies && now_s - self.leg_since_s > LEG_LIMIT_S {
            self.given_up += 1;
            Request::Goal(self.goal())
        } else if state == GuidanceState::Ready {
            Request::Engage
        } else {
            return None;
        };
        self.said_s = now_s;
        if matches!(request, Request::Goal(_) | Request::Engage) {
            self.leg_since_s = now_s;
        }
        Some(request)
    }
}

/// Steps of a time; exact, which the step's seconds in single precision are not.
fn steps_of(seconds: f64) -> u64 {
    (seconds * 1e9 / STEP_NS as f64).round() as u64
}

/// Resident memory of a process, KiB.
pub fn resident_kib(process: u32) -> Result<u64> {
    let path = format!("/proc/{process}/status");
    let text = std::fs::read_to_string(&path).with_context(|| format!("cannot read {path}"))?;
    let line = text
        .lines()
        .find_map(|line| line.strip_prefix("VmRSS:"))
        .context("no VmRSS")?;
    Ok(line.trim().trim_end_matches(" kB").parse()?)
}

/// Memory of a process over the flight, KiB.
#[derive(Debug, Default, Serialize)]
pub struct Memory {
    pub of: &'static str,
    /// At the end of the warm-up: after 20 minutes, but no more than a third of the flight.
    pub start_kib: u64,
    pub end_kib: u64,
    pub most_kib: u64,
    /// Time, seconds, and size.
    pub samples: Vec<(f64, u64)>,
    #[serde(skip)]
    warm_s: f64,
}

impl Memory {
    fn new(of: &'static str, flight_s: f64) -> Self {
        Self {
            warm_s: WARM_S.min(flight_s / 3.0),
            of,
            ..Self::default()
        }
    }

    fn sample(&mut self, now_s: f64, process: u32) -> Result<()> {
        let kib = resident_kib(process)?;
        if now_s <= self.warm_s || self.samples.is_empty() {
            self.start_kib = kib;
        }
        self.end_kib = kib;
        self.most_kib = self.most_kib.max(kib);
        self.samples.push((now_s, kib));
        Ok(())
    }

    /// Grown by no more than 1 MiB from the warm-up on.
    fn is_flat(&self) -> bool {
        self.end_kib <= self.start_kib + 1024
    }
}

#[derive(Debug, Default, Serialize)]
pub struct Record {
    mode: &'static str,
    asked_for_s: f64,
    flown_s: f64,
    wall_s: f64,
    steps: u64,
    operator: Operator,
    /// Obstacles touched.
    collisions: u64,
    /// Digest of everything that happened; lockstep only.
    state_hash: Option<String>,
    /// What the firmware said at its end; real time only.
    firmware_said: Vec<String>,
    memory: Vec<Memory>,
    interrupted: bool,
    #[serde(skip)]
    touching: bool,
}

impl Record {
    fn new(mode: &'static str, asked_for_s: f64, processes: &[&'static str]) -> Self {
        Self {
            mode,
            asked_for_s,
            memory: processes.iter().map(|of| Memory::new(of, asked_for_s)).collect(),
            ..Self::default()
        }
    }

    /// The vehicle is so far from the nearest obstacle.
    fn is_away(&mut self, clearance_m: f32) {
        let touches = clearance_m < RADIUS_M;
        self.collisions += u64::from(touches && !self.touching);
        self.touching = touches;
    }

    fn text(&self) -> String {
        let Operator { goals, holds, .. } = &self.operator;
        let (given_up, landings, alarms) = (self.operator.given_up, self.operator.landings, self.operator.alarms);
        let [flown_h, wall_h] = [self.flown_s, self.wall_s].map(|s| s / 3600.0);
        let (mode, steps, collisions) = (self.mode, self.steps, self.collisions);
        let mut text = format!(
            "{flown_h:.2} h of flight ({mode}) in {wall_h:.2} h: {steps} steps, {goals} goals reached, {given_up} given up, \
             {landings} landings for a doubted sensor, {alarms} alarms, {collisions} collisions\n"
        );
        for (reason, count) in holds {
            let _ = writeln!(text, "held      {reason} {count}");
        }
        for memory in &self.memory {
            let (of, start, end, most) = (memory.of, memory.start_kib, memory.end_kib, memory.most_kib);
            let grew = if memory.is_flat() { "" } else { ": it grew" };
            text += &format!("memory    {of}: {start} KiB warmed up, {end} KiB at the end, most {most} KiB{grew}\n");
        }
        for line in &self.firmware_said {
            let _ = writeln!(text, "{line}");
        }
        if let Some(hash) = &self.state_hash {
            let _ = writeln!(text, "hash      {hash}");
        }
        if self.interrupted {
            text += "interrupted\n";
        }
        text
    }

    fn finish(&mut self, begun: Instant, folder: &Folder) -> Result<bool> {
        self.wall_s = begun.elapsed().as_secs_f64();
        folder.write("endurance.json", &serde_json::to_string_pretty(self)?)?;
        tell(&self.text());
        Ok(self.collisions == 0 && self.memory.iter().all(Memory::is_flat) && !self.interrupted)
    }
}

fn course() -> Result<Course> {
    Ok(Course::from_toml_str(ORBIT, "orbit.toml")?)
}

/// Firmware and simulator in this process, as fast as it goes. `true`: nothing touched, memory flat.
pub fn lockstep(duration_s: f64, seed: u64, folder: &Folder, stop: &AtomicBool) -> Result<bool> {
    let begun = Instant::now();
    let mut config = SimConfig::new(course()?, seed);
    config.start = Start::Ground;
    config.vehicle.battery.capacity_ah = CAPACITY_AH;
    let mut record = Record::new("lockstep", duration_s, &["all of it"]);
    let first = record.operator.goal();
    let firmware_config = FirmwareConfig::to_goal(NedVector::new(first[0], first[1], -HEIGHT_M));
    let mut pair = Pair::of(&config, &firmware_config);
    let mut sequence = 0_u8;
    let (steps, per_hour) = (steps_of(duration_s), steps_of(3600.0));
    let mut request: Option<Request> = None;
    let mut step = 0;
    while step < steps && !stop.load(Ordering::Relaxed) {
        pair.simulate();
        if let Some(request) = request {
            sequence = sequence.wrapping_add(1);
            pair.to_firmware
                .push(0, &packet(STATION, sequence, &request.message(1)));
        }
        let report = pair.decide(true);
        let now_s = step as f64 * f64::from(STEP_S);
        request = record.operator.look(now_s, report.state, report.reasons);
        record.is_away(pair.simulator.obstacle_distance_m());
        step += 1;
        if step.is_multiple_of(per_hour / 60) {
            record.memory[0].sample(now_s, std::process::id())?;
        }
        if step.is_multiple_of(per_hour) {
            tell(&format!(
                "{:>3} h flown in {:.0} s: {} goals, hash {:016x}, {} KiB",
                step / per_hour,
                begun.elapsed().as_secs_f64(),
                record.operator.goals,
                pair.simulator.state_hash(),
                record.memory[0].end_kib
            ));
        }
    }
    (record.steps, record.flown_s) = (step, step as f64 * f64::from(STEP_S));
    record.state_hash = Some(format!("{:016x}", pair.simulator.state_hash()));
    record.interrupted = step < steps;
    record.finish(begun, folder)
}

fn start([north_m, east_m]: [f32; 2], seed: u64, instance: u32, folder: &Folder) -> Result<(Running, Running)> {
    let course_file = folder.write("orbit.toml", ORBIT)?;
    let models_file = folder.write(
        "simulation.toml",
        &format!("[vehicle.battery]\ncapacity_ah = {CAPACITY_AH:?}\n"),
    )?;
    let simulator = Running::start(&format!(
        "sim --status --instance {instance} --seed {seed} --course {} --config {}",
        course_file.display(),
        models_file.display()
    ));
    let firmware = Running::start(&format!(
        "firmware --instance {instance} --engage auto --goal={north_m},{east_m} --height {HEIGHT_M}"
    ));
    Ok((simulator, firmware))
}

/// The programs in real time, with the privileges that they get. `true`: no step missed, nothing touched, memory flat.
pub fn real_time(duration_s: f64, seed: u64, instance: u32, folder: &Folder, stop: &AtomicBool) -> Result<bool> {
    let begun = Instant::now();
    let mut record = Record::new("real time", duration_s, &["firmware", "simulator"]);
    let (simulator, mut firmware) = start(record.operator.goal(), seed, instance, folder)?;
    // The ground stations' port of the simulator's vehicle.
    let station = UdpSocket::bind(("127.0.0.1", 0))?;
    station.connect(("127.0.0.1", u16::try_from(18570 + instance)?))?;
    let system = u8::try_from(instance + 1)?;
    let world = World::new(&course()?);
    let mut sequence = 0_u8;
    let (mut since_s, mut flown_s, mut sampled_s, mut told_s) = (None::<f64>, 0.0, f64::NEG_INFINITY, 0.0);
    let mut missed = 0;
    while flown_s < duration_s && !stop.load(Ordering::Relaxed) {
        let Status {
            time_s,
            position_ned_m: [x, y, z],
            guidance,
            reasons,
            slips,
            ..
        } = simulator.wait_for_status("the simulator's next status", |_| true);
        ensure!(firmware.is_running(), "the firmware ended in flight");
        missed = slips;
        let named = reasons.iter().filter_map(|name| Reason::from_name(name));
        let reasons = named.fold(Reasons::NONE, |all, r| all.with_if(true, r));
        let Some(state) = guidance.and_then(|name| GuidanceState::from_name(&name)) else {
            if begun.elapsed() > Duration::from_secs(60) {
                bail!("the firmware does not speak");
            }
            continue;
        };
        if state == GuidanceState::Guided {
            since_s.get_or_insert(time_s);
        }
        flown_s = since_s.map_or(0.0, |since_s| time_s - since_s);
        if let Some(request) = record.operator.look(time_s, state, reasons) {
            sequence = sequence.wrapping_add(1);
            station.send(&packet(STATION, sequence, &request.message(system)))?;
        }
        record.is_away(world.clearance_m(NedVector::new(x, y, z)));
        if time_s - sampled_s >= 20.0 {
            sampled_s = time_s;
            for (memory, process) in record.memory.iter_mut().zip([firmware.id(), simulator.id()]) {
                memory.sample(flown_s, process)?;
            }
        }
        if flown_s - told_s >= 300.0 {
            told_s = flown_s;
            let (goals, kib) = (record.operator.goals, record.memory[0].end_kib);
            tell(&format!(
                "{flown_s:>5.0} s flown: {goals} goals, {missed} steps missed, firmware {kib} KiB"
            ));
        }
    }
    firmware.signal(rustix::process::Signal::TERM);
    record.firmware_said = firmware.rest();
    ensure!(firmware.wait() == Some(0), "the firmware did not end well");
    (record.steps, record.flown_s, record.interrupted) = (steps_of(flown_s), flown_s, flown_s < duration_s);
    Ok(record.finish(begun, folder)? && missed == 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_operator_gives_the_next_goal_once_and_lands_where_a_doubt_lasts() {
        use GuidanceState::{Guided, Hold, Ready};
        let mut operator = Operator::default();
        let (none, reached) = (Reasons::NONE, Reasons::of(Reason::GoalReached));
        let doubt = Reasons::of(Reason::InconsistentPicture);
        for (now_s, state, reasons, asked) in [
            (5.0, Guided, none, None),
            (20.0, Hold, reached, Some(Request::Goal(GOALS[1]))),
            // It was just said.
            (20.2, Hold, reached, None),
            (30.0, Hold, doubt, None),
            (39.0, Hold, doubt, None),
            (40.5, Hold, doubt, Some(Request::Land)),
            (50.0, Ready, none, Some(Request::Engage)),
            (100.0, Guided, none, None),
            (141.0, Guided, none, Some(Request::Goal(GOALS[2]))),
        ] {
            assert_eq!(operator.look(now_s, state, reasons), asked, "{now_s} s");
        }
        assert_eq!((operator.goals, operator.given_up, operator.landings), (1, 1, 1));
        assert_eq!(operator.holds["inconsistent picture"], 1);
        assert_eq!((steps_of(3600.0), steps_of(86_400.0)), (72_000, 1_728_000));
    }
}
