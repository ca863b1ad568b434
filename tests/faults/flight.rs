//! A flight of the programs in real time, to which something is done.

use crate::campaign::{Ending, Trial};
use anyhow::{Result, bail, ensure};
use rustix::process::Signal;
use std::path::Path;
use std::process::Stdio;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use vigil_sim::program::Status;
use vigil_sim::world::{Family, generate};
use vigil_tests::{Pair, Running};
use vigil_types::{NedVector, STEP_NS};

/// A program that says nothing for so long is not coming.
const SILENCE: Duration = Duration::from_secs(20);
/// A flight takes 20 s; one that takes so long has not arrived.
pub const FLIGHT_LIMIT: Duration = Duration::from_secs(120);

/// Where the campaign takes place.
#[derive(Clone)]
pub struct Site<'a> {
    pub seed: u64,
    pub quick: bool,
    /// Instances that real-time flights may use, one each.
    pub instances: Vec<u32>,
    pub kills: usize,
    pub stop: &'a AtomicBool,
}

/// The programs of one flight over a validation course.
pub struct Flight {
    pub instance: u32,
    pub simulator: Running,
    pub firmware: Running,
    pub adversary: Option<Running>,
    seed: u64,
    goal: NedVector,
    extra: Vec<String>,
    sim_extra: Vec<String>,
    diagnostics: Diagnostics,
    last: Option<Status>,
}

/// Where the programs' diagnostics go.
#[derive(Clone)]
struct Diagnostics(std::path::PathBuf);

impl Diagnostics {
    fn of(&self, who: &str) -> Stdio {
        let file = std::fs::File::options()
            .create(true)
            .append(true)
            .open(self.0.join(format!("{who}.log")));
        file.map_or_else(|_| Stdio::null(), Stdio::from)
    }
}

/// What a flight needs besides instance and seed.
#[derive(Default)]
pub struct Extras {
    pub firmware: Vec<String>,
    pub simulator: Vec<String>,
    /// A process that passes frames on sits between sensor and firmware.
    pub adversary: bool,
}

impl Flight {
    /// Starts the programs; the vehicle hovers at the start.
    pub fn start(instance: u32, seed: u64, folder: &Path, extras: Extras) -> Result<Self> {
        let folder = folder.join(format!("{instance}"));
        std::fs::create_dir_all(&folder)?;
        let course = generate(Family::Validation, seed);
        let goal = course.goal_ned_m();
        let diagnostics = Diagnostics(folder);
        let mut sim_extra = extras.simulator;
        if extras.adversary {
            sim_extra.extend(["--frames".to_owned(), "depth-raw".to_owned()]);
        }
        let simulator = start_simulator(instance, seed, &sim_extra, diagnostics.of("simulator"));
        let adversary = extras
            .adversary
            .then(|| start_adversary(instance, seed, goal, diagnostics.of("adversary")));
        let firmware = start_firmware(instance, goal, &extras.firmware, diagnostics.of("firmware"));
        Ok(Self {
            instance,
            simulator,
            firmware,
            adversary,
            seed,
            goal,
            extra: extras.firmware,
            sim_extra,
            diagnostics,
            last: None,
        })
    }

    pub fn restart_firmware(&mut self) {
        self.firmware = start_firmware(self.instance, self.goal, &self.extra, self.diagnostics.of("firmware"));
    }

    /// Starts the simulator again: a new vehicle at the start of the course.
    pub fn restart_simulator(&mut self) {
        self.last = None;
        self.simulator = start_simulator(
            self.instance,
            self.seed,
            &self.sim_extra,
            self.diagnostics.of("simulator"),
        );
    }

    pub fn restart_adversary(&mut self) {
        self.adversary = Some(start_adversary(
            self.instance,
            self.seed,
            self.goal,
            self.diagnostics.of("adversary"),
        ));
    }

    pub fn last(&self) -> Option<&Status> {
        self.last.as_ref()
    }

    /// Follows the flight until `done`, its end, the limit, or Ctrl-C; whether `done` was.
    ///
    /// # Errors
    /// A program that ended or fell silent.
    pub fn follow(
        &mut self,
        limit: Duration,
        stop: &AtomicBool,
        mut done: impl FnMut(&Status) -> bool,
    ) -> Result<bool> {
        let begun = Instant::now();
        while begun.elapsed() < limit && !stop.load(Ordering::Relaxed) {
            let Some(status) = self.simulator.status(SILENCE) else {
                bail!("the simulator fell silent");
            };
            let (is_done, is_over) = (done(&status), status.outcome.is_some());
            self.last = Some(status);
            if is_done {
                return Ok(true);
            }
            if is_over {
                return Ok(false);
            }
        }
        Ok(false)
    }

    /// Follows until it flies by its pilot's decisions.
    pub fn take_off(&mut self, stop: &AtomicBool) -> Result<()> {
        let flies = |s: &Status| s.guidance.as_deref() == Some("guided") && s.speed_m_s > 0.3;
        if !self.follow(Duration::from_secs(40), stop, flies)? && !stop.load(Ordering::Relaxed) {
            bail!("it does not fly: {:?}", self.last);
        }
        Ok(())
    }

    /// The programs that should run and do not.
    pub fn fallen(&mut self) -> Vec<&'static str> {
        let mut fallen = Vec::new();
        if !self.simulator.is_running() {
            fallen.push("simulator");
        }
        if !self.firmware.is_running() {
            fallen.push("firmware");
        }
        if self.adversary.as_mut().is_some_and(|adversary| !adversary.is_running()) {
            fallen.push("adversary");
        }
        fallen
    }

    /// Ends the firmware as a person would; what it says.
    ///
    /// # Errors
    /// It ends with another code than 0.
    pub fn end_firmware(&mut self) -> Result<Vec<String>> {
        ensure!(self.firmware.is_running(), "the firmware ended before its time");
        self.firmware.signal(Signal::TERM);
        let said = self.firmware.rest();
        match self.firmware.wait() {
            Some(0) => Ok(said),
            code => bail!("the firmware ended with {code:?}"),
        }
    }
}

/// How the flight of a seed ends in lockstep with nothing done to it: the pilots' own collisions are told apart.
fn collides_by_itself(seed: u64) -> bool {
    let mut pair = Pair::new(Family::Validation, seed);
    for _ in 0..(FLIGHT_LIMIT.as_nanos() as u64 / STEP_NS) {
        pair.simulate();
        pair.decide(true);
        if pair.simulator.ending().is_some() {
            break;
        }
    }
    let outcome = pair.simulator.ending().map(|ending| ending.outcome);
    Ending::of(outcome) == Some(Ending::Collided)
}

/// The seeds of trials that collided, and which of them do with nothing done to the flight, in words.
pub fn collided_anyway<'a>(trials: impl Iterator<Item = (&'a Trial, u64)>) -> String {
    let mut told = String::new();
    for (_, seed) in trials.filter(|(trial, _)| trial.ending == Ending::Collided) {
        let separator = if told.is_empty() { "collided: seed" } else { "," };
        let anyway = if collides_by_itself(seed) {
            " (without the fault too)"
        } else {
            ""
        };
        told += &format!("{separator} {seed}{anyway}");
    }
    told
}

fn start_simulator(instance: u32, seed: u64, extra: &[String], diagnostics: Stdio) -> Running {
    let line = format!("sim --status --airborne --instance {instance} --seed {seed}");
    start(&line, extra, diagnostics)
}

fn start_firmware(instance: u32, goal: NedVector, extra: &[String], diagnostics: Stdio) -> Running {
    let to = to_goal(goal);
    let line = format!("firmware --instance {instance} --engage auto {to}");
    start(&line, extra, diagnostics)
}

/// Passes frames on; one of them is altered by less than the sensor's noise.
fn start_adversary(instance: u32, seed: u64, goal: NedVector, diagnostics: Stdio) -> Running {
    let to = to_goal(goal);
    let least = "--attack noise --epsilon 0.01 --iterations 1 --burst 1";
    let line = format!("adversary --instance {instance} --seed {seed} {to} {least}");
    start(&line, &[], diagnostics)
}

fn to_goal(goal: NedVector) -> String {
    format!("--goal={},{} --height {}", goal.x, goal.y, -goal.z)
}

/// Starts `vigil` with the arguments of a line, and more.
fn start(line: &str, extra: &[String], diagnostics: Stdio) -> Running {
    let arguments: Vec<&str> = line.split(' ').chain(extra.iter().map(String::as_str)).collect();
    Running::start_saying(&arguments, diagnostics)
}
