//! A flight of the programs in real time, to which something is done.

use crate::campaign::{Ending, Trial};
use anyhow::{Result, bail, ensure};
use rustix::process::Signal;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use vigil_sim::program::Status;
use vigil_sim::world::{Family, Outcome, generate};
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

/// What a flight needs besides instance and seed.
#[derive(Default)]
pub struct Extras {
    /// Further arguments, between spaces.
    pub firmware: String,
    pub simulator: String,
    /// A process that passes frames on sits between sensor and firmware.
    pub adversary: bool,
}

/// How the programs of a flight are started; what they say goes into files of the folder.
pub struct Programs {
    instance: u32,
    seed: u64,
    goal: NedVector,
    folder: PathBuf,
    extras: Extras,
}

impl Programs {
    pub fn simulator(&self) -> Running {
        let frames = ["", " --frames depth-raw"][usize::from(self.extras.adversary)];
        let (seed, extra) = (self.seed, &self.extras.simulator);
        let line = format!("sim --status --airborne --seed {seed}{frames} {extra}");
        self.start("simulator", &line)
    }

    pub fn firmware(&self) -> Running {
        let line = format!("firmware --engage auto {} {}", self.to_goal(), self.extras.firmware);
        self.start("firmware", &line)
    }

    /// Passes frames on; one of them is altered by less than the sensor's noise.
    pub fn adversary(&self) -> Running {
        let least = "--attack noise --epsilon 0.01 --iterations 1 --burst 1";
        let line = format!("adversary --seed {} {} {least}", self.seed, self.to_goal());
        self.start("adversary", &line)
    }

    fn to_goal(&self) -> String {
        let goal = self.goal;
        format!("--goal={},{} --height {}", goal.x, goal.y, -goal.z)
    }

    /// Starts `vigil` with the arguments of a line.
    fn start(&self, who: &str, line: &str) -> Running {
        let log = self.folder.join(format!("{who}.log"));
        let log = File::options().create(true).append(true).open(log);
        let line = format!("{line} --instance {}", self.instance);
        Running::start_saying(&line, log.map_or_else(|_| Stdio::null(), Stdio::from))
    }
}

/// The programs of one flight over a validation course.
pub struct Flight {
    pub programs: Programs,
    pub simulator: Running,
    pub firmware: Running,
    pub adversary: Option<Running>,
    pub last: Option<Status>,
}

impl Flight {
    /// Starts the programs; the vehicle hovers at the start.
    pub fn start(instance: u32, seed: u64, folder: &Path, extras: Extras) -> Result<Self> {
        let folder = folder.join(format!("{instance}"));
        std::fs::create_dir_all(&folder)?;
        let programs = Programs {
            instance,
            seed,
            goal: generate(Family::Validation, seed).goal_ned_m(),
            folder,
            extras,
        };
        let simulator = programs.simulator();
        let adversary = programs.extras.adversary.then(|| programs.adversary());
        Ok(Self {
            simulator,
            adversary,
            firmware: programs.firmware(),
            programs,
            last: None,
        })
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
            if is_done || is_over {
                return Ok(is_done);
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

    /// Follows a flight that has taken off until the referee's verdict.
    pub fn fly_to_its_end(&mut self, stop: &AtomicBool) -> Result<bool> {
        self.follow(FLIGHT_LIMIT, stop, |s| s.outcome.is_some())
    }

    /// The referee's verdict, if there was one.
    pub fn outcome(&self) -> Option<Outcome> {
        self.last.as_ref().and_then(|s| s.outcome)
    }

    /// The programs that should run and do not.
    pub fn fallen(&mut self) -> Vec<&'static str> {
        let always = [("simulator", &mut self.simulator), ("firmware", &mut self.firmware)];
        let adversary = self.adversary.as_mut().map(|adversary| ("adversary", adversary));
        let all = always.into_iter().chain(adversary);
        let fallen = all.filter_map(|(name, program)| (!program.is_running()).then_some(name));
        fallen.collect()
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

/// How the flight of a seed ends in lockstep with nothing done to it: the pilots' own collisions are distinguished.
fn collides_by_itself(seed: u64) -> bool {
    let mut pair = Pair::new(Family::Validation, seed);
    pair.fly((FLIGHT_LIMIT.as_nanos() as u64 / STEP_NS) as usize, |_, _| true);
    Ending::of(pair.outcome()) == Some(Ending::Collided)
}

/// The seeds of trials that collided, and which of them do with nothing done to the flight, in words.
pub fn collided_anyway<'a>(trials: impl Iterator<Item = (&'a Trial, u64)>) -> String {
    let collided = trials.filter(|(trial, _)| trial.ending == Ending::Collided);
    let without_too = |seed| ["", " (without the fault too)"][usize::from(collides_by_itself(seed))];
    let seeds: Vec<String> = collided
        .map(|(_, seed)| format!("{seed}{}", without_too(seed)))
        .collect();
    let begin = if seeds.is_empty() { "" } else { "collided: seed " };
    begin.to_owned() + &seeds.join(", ")
}
