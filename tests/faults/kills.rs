//! Processes killed and stopped at random moments of real-time flights, and started again.

use crate::campaign::{Draw, Ending, Folder, Row, Trial, joined, spread};
use crate::flight::{Extras, FLIGHT_LIMIT, Flight, Site, collided_anyway};
use anyhow::{Result, bail};
use rustix::process::Signal;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use vigil_tests::{processes_of, side_by_side, vigil};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Who {
    Simulator,
    Firmware,
    Adversary,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum How {
    /// SIGKILL, and a new one after up to two seconds.
    Kill,
    /// SIGSTOP, and SIGCONT after up to three seconds.
    Stop,
}

/// Latest moment of a fault, seconds of guided flight; flights take 15 s and more.
const LATEST_S: f64 = 9.0;
/// A vehicle whose guidance is gone must be in its own hold after this, seconds of simulated time, and of the time between two statuses.
const OWN_HOLD_S: f64 = 0.5 + 0.2;
/// A wait for something that takes parts of a second.
const SOON: Duration = Duration::from_secs(10);
/// Flights of `vigil fly` that are killed.
const FLIGHTS_KILLED: usize = 10;
/// Seeds that the kinds of trials lie apart.
const APART: u64 = 1000;

pub fn rows(site: &Site<'_>, folder: &Folder) -> Result<Vec<Row>> {
    let work = tempfile::tempdir()?;
    let who = [Who::Firmware, Who::Simulator, Who::Adversary];
    let cases = [How::Kill, How::Stop]
        .into_iter()
        .flat_map(|how| who.map(|who| (who, how)));
    // The quick part has the first and the last.
    let cases: Vec<(Who, How)> = cases.step_by(if site.quick { 5 } else { 1 }).collect();
    let mut rows = Vec::new();
    // Trials of all cases at once: a quick part is as long as its longest flight.
    let count = |how| match (site.quick, how) {
        (true, _) => 1,
        (false, How::Kill) => site.kills,
        (false, How::Stop) => site.kills.div_ceil(4),
    };
    let all: Vec<(usize, usize)> = (cases.iter().enumerate())
        .flat_map(|(case, (_, how))| (0..count(*how)).map(move |number| (case, number)))
        .collect();
    let flown = side_by_side(all.len(), &site.instances, |i, instance| {
        let (case, number) = all[i];
        let (who, how) = cases[case];
        let seed = seed_of(site, case, number);
        let stopped = site.stop.load(Ordering::Relaxed);
        (!stopped).then(|| (case, trial(who, how, instance, seed, work.path(), site.stop)))
    });
    for (case, (who, how)) in cases.iter().enumerate() {
        let of_case = flown.iter().filter(|(of, _)| *of == case).map(|(_, result)| result);
        let trials: Vec<Trial> = of_case.clone().map(|(trial, _)| trial.clone()).collect();
        let delays = of_case.filter_map(|(_, delay_s)| *delay_s).collect();
        let what = match how {
            How::Kill => "killed, started again",
            How::Stop => "stopped for up to 3 s",
        };
        let who_held = match who {
            Who::Firmware => "vehicle's own hold after",
            _ => "guidance's hold after",
        };
        let seeds = (0..).map(|number| seed_of(site, case, number));
        let measured = joined([spread(who_held, "s", delays), collided_anyway(trials.iter().zip(seeds))]);
        let name = format!("{} {what}", format!("{who:?}").to_lowercase());
        rows.push(Row::of(name, &trials, measured));
    }
    if !site.quick && !site.stop.load(Ordering::Relaxed) {
        rows.push(whole_flights(site, folder)?);
    }
    Ok(rows)
}

fn seed_of(site: &Site<'_>, case: usize, number: usize) -> u64 {
    site.seed + case as u64 * APART + number as u64
}

/// A flight with one fault, and the seconds from it to the hold that must come of it.
fn trial(who: Who, how: How, instance: u32, seed: u64, work: &Path, stop: &AtomicBool) -> (Trial, Option<f64>) {
    let extras = Extras {
        adversary: who == Who::Adversary,
        ..Extras::default()
    };
    let mut flight = match Flight::start(instance, seed, work, extras) {
        Ok(flight) => flight,
        Err(error) => return (Trial::wrong(Ending::Crashed, format!("{error:#}")), None),
    };
    let result = fault(&mut flight, who, how, seed, stop);
    let (fallen, trial) = (flight.fallen(), format!("{who:?}, {how:?}, seed {seed}"));
    match result {
        Ok((ending, delay_s)) if fallen.is_empty() => {
            let wrong = match delay_s {
                Some(delay_s) if delay_s > OWN_HOLD_S => Some(format!("{trial}: hold after {delay_s:.2} s")),
                _ if matches!(ending, Ending::Held | Ending::TimeOut) && !stop.load(Ordering::Relaxed) => {
                    Some(format!("{trial}: it does not go on"))
                }
                _ => flight.end_firmware().err().map(|error| format!("{error:#}")),
            };
            (Trial { ending, wrong }, delay_s)
        }
        Ok((_, delay_s)) => {
            let wrong = format!("{trial}: {} ended", fallen.join(", "));
            (Trial::wrong(Ending::Crashed, wrong), delay_s)
        }
        Err(error) => {
            let ending = [Ending::Crashed, Ending::TimeOut][usize::from(fallen.is_empty())];
            (Trial::wrong(ending, format!("{trial}: {error:#}")), None)
        }
    }
}

fn fault(flight: &mut Flight, who: Who, how: How, seed: u64, stop: &AtomicBool) -> Result<(Ending, Option<f64>)> {
    let mut draw = Draw::new(seed);
    let moment_s = draw.between(0.0, LATEST_S);
    let (pause_s, stopped_s) = (draw.between(0.0, 2.0), draw.between(0.05, 3.0));
    flight.take_off(stop)?;
    let begun_s = flight.last.as_ref().map_or(0.0, |s| s.time_s);
    flight.follow(FLIGHT_LIMIT, stop, |s| s.time_s >= begun_s + moment_s)?;
    let at_s = flight.last.as_ref().map_or(0.0, |s| s.time_s);
    let mut delay_s = None;
    match (who, how) {
        (Who::Firmware, How::Kill) => {
            flight.firmware.signal(Signal::KILL);
            let left = flight.follow(SOON, stop, |s| s.mode != "offboard")?;
            if !left && flight.last.is_some() && flight.outcome().is_none() {
                bail!("the vehicle flies on without guidance");
            }
            delay_s = flight.last.as_ref().map(|s| s.time_s - at_s);
            std::thread::sleep(Duration::from_secs_f64(pause_s));
            flight.firmware = flight.programs.firmware();
        }
        (Who::Simulator, How::Kill) => {
            flight.simulator.signal(Signal::KILL);
            std::thread::sleep(Duration::from_secs_f64(0.2 + pause_s));
            // A new vehicle at the start of the course.
            (flight.last, flight.simulator) = (None, flight.programs.simulator());
        }
        (Who::Adversary, How::Kill | How::Stop) => {
            let signal = if how == How::Kill { Signal::KILL } else { Signal::STOP };
            if let Some(adversary) = &flight.adversary {
                adversary.signal(signal);
            }
            let stopped = Instant::now();
            let for_s = if how == How::Kill { 1.0 + pause_s } else { stopped_s };
            let held = |s: &vigil_sim::program::Status| s.guidance.as_deref() == Some("hold");
            // A pause below the age of a stale frame is no hold.
            if for_s > 0.8 && flight.follow(SOON, stop, held)? {
                delay_s = flight.last.as_ref().map(|s| s.time_s - at_s);
            }
            std::thread::sleep(Duration::from_secs_f64(for_s).saturating_sub(stopped.elapsed()));
            match (how, &flight.adversary) {
                (How::Stop, Some(adversary)) => adversary.signal(Signal::CONT),
                _ => flight.adversary = Some(flight.programs.adversary()),
            }
        }
        (Who::Firmware | Who::Simulator, How::Stop) => {
            let is_firmware = who == Who::Firmware;
            let process = [&flight.simulator, &flight.firmware][usize::from(is_firmware)];
            process.signal(Signal::STOP);
            std::thread::sleep(Duration::from_secs_f64(stopped_s));
            process.signal(Signal::CONT);
        }
    }
    flight.fly_to_its_end(stop)?;
    let last = flight.last.as_ref();
    let outcome = flight.outcome();
    let holds = last.is_some_and(|s| s.guidance.as_deref() == Some("hold") && !s.reasons.is_empty());
    let otherwise = if holds { Ending::Held } else { Ending::TimeOut };
    Ok((Ending::of(outcome).unwrap_or(otherwise), delay_s))
}

/// `vigil fly` killed: its children must end with it, and the next flight find its ports free.
fn whole_flights(site: &Site<'_>, folder: &Folder) -> Result<Row> {
    let instance = site.instances[0].to_string();
    let runs = folder.path("killed");
    let mut trials = Vec::new();
    let mut draw = Draw::new(site.seed);
    let mut delays = Vec::new();
    for number in 0..FLIGHTS_KILLED {
        let line = format!("fly --instance {instance} --seed {number} --attack noise -o");
        let mut flight = Command::new(vigil())
            .args(line.split(' '))
            .arg(&runs)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()?;
        std::thread::sleep(Duration::from_secs_f64(draw.between(0.3, 6.0)));
        if let Some(status) = flight.try_wait()? {
            let wrong = format!("flight {number} ended by itself: {status}");
            trials.push(Trial::wrong(Ending::Crashed, wrong));
            continue;
        }
        flight.kill()?;
        flight.wait()?;
        let killed = Instant::now();
        while processes_of(&instance) > 0 && killed.elapsed() < SOON {
            std::thread::sleep(Duration::from_millis(20));
        }
        delays.push(killed.elapsed().as_secs_f64());
        trials.push(match processes_of(&instance) {
            0 => Trial::right(Ending::Named),
            left => Trial::wrong(Ending::Named, format!("{left} processes outlive the flight")),
        });
    }
    // Logs of killed flights are not what is shown here.
    let _ = std::fs::remove_dir_all(&runs);
    Ok(Row::of(
        "`vigil fly` killed",
        &trials,
        spread("all of its processes ended after", "s", delays),
    ))
}
