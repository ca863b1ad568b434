//! A campaign: every seed flown in every arm, one line of JSON for each flight as soon as it has ended, and the campaign that files of
//! such lines make together (docs/cluster.md).

use crate::cli::output::{self, Interrupt, Progress, say};
use anyhow::{Context, Result, anyhow, bail, ensure};
use rayon::ThreadPool;
use rayon::prelude::*;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{BufRead, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use vigil_nnet::Isa;
use vigil_types::STEP_S;

/// Ten million flights have some 8 GB.
const SIZE_LIMIT: u64 = 16 << 30;
/// A heading is shorter.
const HEADING_LIMIT: u64 = 1 << 20;
/// Value of a heading's entry `format`.
const FORMAT: &str = "vigil campaign 1";
/// Hexadecimal digits that a line names its heading by.
const DIGITS: usize = 16;

/// What is flown: each of the seeds in each of the arms.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Jobs {
    /// Seed of the first flight of an arm.
    pub first_seed: u64,
    /// Flights of an arm.
    pub flights: u64,
    /// Names of the arms, each once.
    pub arms: Vec<String>,
}

impl Jobs {
    /// How many flights there are.
    pub fn count(&self) -> u64 {
        self.flights.saturating_mul(self.arms.len() as u64)
    }

    fn end(&self) -> u64 {
        self.first_seed.saturating_add(self.flights)
    }

    /// The seeds from the first to the last of both, in the arms of both.
    fn extend(&mut self, other: &Self) {
        let end = self.end().max(other.end());
        self.first_seed = self.first_seed.min(other.first_seed);
        self.flights = end - self.first_seed;
        for arm in &other.arms {
            if !self.arms.contains(arm) {
                self.arms.push(arm.clone());
            }
        }
    }
}

/// Everything that decides what a flight of a seed is: flights of two such are not mixed.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Origin<S> {
    command: String,
    version: String,
    /// Of the program's file.
    program_sha256: String,
    /// Kernels with and without fused multiply-add round differently.
    arithmetic: String,
    /// Settings of the command, actor and detector by their digests.
    settings: S,
}

/// The first line of a file, and of each file that was appended to it.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Heading<S> {
    format: String,
    #[serde(flatten)]
    jobs: Jobs,
    #[serde(flatten)]
    origin: Origin<S>,
    /// Of our working tree, if it ran in or from one: for the reader, not compared.
    git_commit: Option<String>,
}

/// A flight.
#[derive(Serialize, Deserialize)]
struct Line<F> {
    seed: u64,
    arm: String,
    /// Digest of its origin.
    of: String,
    flight: F,
}

/// What to do with flights that are there already.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Existing {
    /// They make room.
    Replace,
    /// They are kept, and not flown again.
    Resume,
    /// They are an error.
    Refuse,
}

impl Existing {
    /// What a command does whose flights are soon flown again.
    pub fn replaced_unless(resume: bool) -> Self {
        if resume { Self::Resume } else { Self::Replace }
    }
}

/// Flights of one origin, in a file and in memory.
pub struct Campaign<S, F> {
    heading: Heading<S>,
    /// What it was made for; the heading's has the jobs of the files that were read, too.
    asked_for: Jobs,
    of: String,
    /// By seed and the arm's number.
    flown: BTreeMap<(u64, usize), F>,
    file: Option<(PathBuf, Mutex<File>)>,
}

/// Refuses more flights than there are seeds from `first_seed` on.
pub fn check_seeds(first_seed: u64, flights: u64) -> Result<()> {
    ensure!(
        first_seed.checked_add(flights).is_some(),
        "--seed: seeds end below 2^64 - 1, {flights} flights from {first_seed} on do not fit"
    );
    Ok(())
}

impl<S, F> Campaign<S, F>
where
    S: Serialize + DeserializeOwned + Sync,
    F: Serialize + DeserializeOwned + Send + Sync,
{
    /// A campaign of this program without flights.
    ///
    /// # Errors
    /// The program's file cannot be read; seeds beyond the last.
    pub fn new(command: &str, settings: S, jobs: Jobs) -> Result<Self> {
        check_seeds(jobs.first_seed, jobs.flights)?;
        let is_portable = Isa::detect() == Isa::PORTABLE;
        Self::of_heading(Heading {
            format: FORMAT.to_owned(),
            jobs,
            origin: Origin {
                command: command.to_owned(),
                version: env!("CARGO_PKG_VERSION").to_owned(),
                program_sha256: program_sha256()?,
                arithmetic: if is_portable { "portable" } else { "fused" }.to_owned(),
                settings,
            },
            git_commit: output::git_commit(),
        })
    }

    fn of_heading(heading: Heading<S>) -> Result<Self> {
        let mut of = sha256(&serde_json::to_vec(&heading.origin)?);
        of.truncate(DIGITS);
        Ok(Self {
            asked_for: heading.jobs.clone(),
            heading,
            of,
            flown: BTreeMap::new(),
            file: None,
        })
    }

    /// What its flights have in common.
    pub fn settings(&self) -> &S {
        &self.heading.origin.settings
    }

    /// What was to be flown.
    pub fn jobs(&self) -> &Jobs {
        &self.heading.jobs
    }

    /// The flights that there are and the name of each one's arm, by seed.
    pub fn flights(&self) -> impl Iterator<Item = (&str, &F)> {
        let arms = &self.jobs().arms;
        let flown = self.flown.iter();
        flown.map(|((_, arm), flight)| (arms[*arm].as_str(), flight))
    }

    /// The flights of an arm, by seed.
    pub fn flights_of<'a>(&'a self, name: &'a str) -> impl Iterator<Item = &'a F> {
        let flights = self.flights().filter(move |(arm, _)| *arm == name);
        flights.map(|(_, flight)| flight)
    }

    /// A flight, if it was flown.
    pub fn flight(&self, seed: u64, arm: usize) -> Option<&F> {
        self.flown.get(&(seed, arm))
    }

    /// Whether flights that it was made for are missing; says how many are, and of the other files' which.
    pub fn is_interrupted(&self) -> bool {
        let (flown, all) = (self.flown.len() as u64, self.jobs().count());
        let interrupted = !self.missing(&self.asked_for).is_empty();
        if interrupted {
            let goes_on = "; the same command with --resume goes on";
            let hint = self.file.as_ref().map_or("", |_| goes_on);
            say!("interrupted      {flown} of {all} flights were flown{hint}");
        } else if flown < all {
            say!("incomplete       {}", self.missing_in_words());
        }
        interrupted
    }

    /// Keeps its flights in a file from now on, each as soon as it has ended; not where `path` is standard output or a device.
    ///
    /// # Errors
    /// A file that cannot be read, is of another campaign or of none, flights that are not to be there.
    pub fn keep_in(mut self, path: &Path, existing: Existing) -> Result<Self> {
        if !output::is_file(path) {
            return Ok(self);
        }
        let name = path.display();
        if existing == Existing::Replace {
            check_replaceable(path)?;
        } else if path.exists() {
            ensure!(
                existing == Existing::Resume,
                "{name} holds a campaign's flights; add --resume to fly what it lacks, or name another place with -o"
            );
            self.read(path)
                .context("name another place with -o, or remove the file")?;
        }
        self.write(path)?;
        let file = OpenOptions::new().append(true).open(path);
        self.file = Some((path.to_owned(), Mutex::new(file.with_context(|| cannot_write(path))?)));
        Ok(self)
    }

    /// Flies what it was made for and the file has not, each by its seed and its arm's place; leaves the file in the order of the seeds.
    ///
    /// # Errors
    /// Whatever a flight fails with, or the file; the flights that had ended are kept.
    pub fn fly(
        &mut self,
        pool: &ThreadPool,
        fly: impl Fn(u64, usize, &Progress) -> Result<F> + Sync,
    ) -> Result<Interrupt> {
        let wanted = &self.asked_for.clone();
        let (missing, interrupt) = (self.missing(wanted).len() as u64, Interrupt::on_ctrl_c()?);
        let (all, there) = (wanted.count(), wanted.count() - missing);
        if there > 0 {
            say!("resumed          {there} of {all} flights are there already");
        }
        let bar = Progress::new(missing, "flights")?;
        let flown = self.fly_some(wanted, pool, &interrupt, |seed, arm| {
            let flight = fly(seed, arm, &bar);
            bar.inc(1);
            flight
        });
        bar.finish();
        flown?;
        if let Some((path, _)) = &self.file {
            self.write(path)?;
        }
        Ok(interrupt)
    }

    /// All arms of a seed before the next: an interrupted campaign is one of fewer seeds.
    fn missing(&self, wanted: &Jobs) -> Vec<(u64, usize)> {
        let arm_of = |name: &String| self.jobs().arms.iter().position(|arm| arm == name);
        let arms: Vec<usize> = wanted.arms.iter().filter_map(arm_of).collect();
        let all = (wanted.first_seed..wanted.end()).flat_map(|seed| arms.iter().map(move |arm| (seed, *arm)));
        all.filter(|job| !self.flown.contains_key(job)).collect()
    }

    /// Flies what `wanted` has and the file has not, until the interrupt comes.
    pub fn fly_some(
        &mut self,
        wanted: &Jobs,
        pool: &ThreadPool,
        interrupt: &Interrupt,
        fly: impl Fn(u64, usize) -> Result<F> + Sync,
    ) -> Result<()> {
        let missing = self.missing(wanted);
        let fly_all = || {
            let missing = missing.into_iter().take_while(|_| !interrupt.came()).par_bridge();
            let flown = missing.map(|(seed, arm)| {
                let flight = fly(seed, arm)?;
                if let Some((path, file)) = &self.file {
                    let line = self.line(seed, arm, &flight)?;
                    let mut file = file.lock().map_err(|_| anyhow!("another flight failed"))?;
                    file.write_all(line.as_bytes()).with_context(|| cannot_write(path))?;
                }
                Ok(((seed, arm), flight))
            });
            flown.collect::<Result<Vec<_>>>()
        };
        let flown = interrupt.saying(
            "interrupted: flights that have begun are flown to their end; another interrupt ends the program without them",
            || pool.install(fly_all),
        );
        self.flown.extend(flown?);
        Ok(())
    }

    fn line(&self, seed: u64, arm: usize, flight: &F) -> Result<String> {
        let line = Line {
            seed,
            arm: self.jobs().arms[arm].clone(),
            of: self.of.clone(),
            flight,
        };
        Ok(serde_json::to_string(&line)? + "\n")
    }

    /// Writes all flights by seed: what a finished campaign leaves does not depend on threads, machines or interruptions.
    pub fn write(&self, path: &Path) -> Result<()> {
        let mut text = serde_json::to_string(&self.heading)? + "\n";
        for ((seed, arm), flight) in &self.flown {
            text += &self.line(*seed, *arm, flight)?;
        }
        output::write(path, text)
    }

    /// The campaign that files of its flights make, in any order; a flight may be there more than once. The flights are written beside
    /// the report at `json`.
    ///
    /// # Errors
    /// Files of different campaigns, programs or actors, flights that contradict each other, and flights that are missing: which.
    pub fn load(files: &[PathBuf], json: &Path) -> Result<Self> {
        let first = files.first().context("name the files")?;
        let text = read(first)?;
        let heading = text.lines().next().unwrap_or_default();
        let mut whole = Self::of_heading(heading_of(first, heading)?)?;
        files.iter().try_for_each(|file| whole.read(file))?;
        let missing = whole.missing_in_words();
        ensure!(missing.is_empty(), "{missing}");
        if output::is_file(json) {
            let lines = json.with_extension("jsonl");
            check_replaceable(&lines)?;
            whole.write(&lines)?;
        }
        Ok(whole)
    }

    /// Takes the flights of a file.
    fn read(&mut self, path: &Path) -> Result<()> {
        let (text, name) = (read(path)?, path.display());
        // A process that was killed leaves half a line at the end; an editor leaves a whole one without its newline.
        let (lines, tail) = text.split_at(text.rfind('\n').map_or(0, |end| end + 1));
        let is_whole = serde_json::from_str::<Value>(tail).is_ok();
        let whole = if is_whole { &text } else { lines };
        let begins = whole.lines().next().is_some_and(is_heading);
        ensure!(begins, "{name} has no heading: it is no campaign's");
        for line in whole.lines().filter(|line| is_heading(line)) {
            let other: Heading<Value> = heading_of(path, line)?;
            if let Some(difference) = self.difference(&other.origin)? {
                bail!("{name} is of another campaign: {difference}");
            }
            ensure!(
                other.jobs.count() > 0,
                "{name} is of no flight: its heading asks for none"
            );
            self.heading.jobs.extend(&other.jobs);
        }
        let lines = (1..).zip(whole.lines());
        for (number, line) in lines.filter(|(_, line)| !is_heading(line)) {
            let line: Line<F> =
                serde_json::from_str(line).with_context(|| format!("{name}, line {number} is damaged"))?;
            let arm = self.jobs().arms.iter().position(|arm| *arm == line.arm);
            let arm =
                arm.filter(|_| line.of == self.of && (self.jobs().first_seed..self.jobs().end()).contains(&line.seed));
            let arm = arm.with_context(|| format!("{name}, line {number} is of another campaign than the headings"))?;
            let flight = serde_json::to_value(&line.flight)?;
            ensure!(
                is_possible(&flight),
                "{name}, line {number} is damaged: its time, or a count of it, is none of a flight of so many steps"
            );
            let own = flight.get("seed").map_or(Some(line.seed), Value::as_u64);
            ensure!(
                own == Some(line.seed),
                "{name}, line {number} is of another seed than its flight"
            );
            if let Some(other) = self.flown.get(&(line.seed, arm)) {
                ensure!(
                    serde_json::to_value(other)? == flight,
                    "{name}, line {number} contradicts an earlier flight of seed {}",
                    line.seed
                );
                continue;
            }
            self.flown.insert((line.seed, arm), line.flight);
        }
        Ok(())
    }

    /// How another origin differs from this one's, if it does.
    fn difference(&self, other: &Origin<Value>) -> Result<Option<String>> {
        let own = &self.heading.origin;
        if own.command != other.command {
            return Ok(Some(format!("it is of `{}`, not of `{}`", other.command, own.command)));
        }
        // As they are read, since a float32 has fewer digits there than as a number of JSON's.
        let own: Origin<Value> = serde_json::from_str(&serde_json::to_string(own)?)?;
        // The settings first: their names say more.
        let settings = difference(&own.settings, &other.settings, "");
        let [own, other] = [&own, other].map(serde_json::to_value);
        Ok(settings.or(difference(&own?, &other?, "")))
    }

    /// The flights that are missing, as arguments that fly them; empty if none is.
    fn missing_in_words(&self) -> String {
        const MOST: usize = 12;
        let jobs = self.jobs();
        let seeds: Vec<u64> = self.flown.keys().map(|(seed, _)| *seed).collect();
        let arms = seeds.chunk_by(|a, b| a == b);
        let whole = arms.filter(|arms| arms.len() == jobs.arms.len()).map(|arms| arms[0]);
        // Files may name seeds that lie far apart.
        let mut next = jobs.first_seed;
        let before = whole.chain([jobs.end()]).map(|seed| {
            let from = std::mem::replace(&mut next, seed.saturating_add(1));
            (from, seed.saturating_sub(from))
        });
        let runs: Vec<(u64, u64)> = before.filter(|(_, count)| *count > 0).collect();
        if runs.is_empty() {
            return String::new();
        }
        let words = |(seed, count): &(u64, u64)| format!("--seed {seed} --flights {count}");
        format!(
            "{} of {} flights are missing: fly {}{}",
            jobs.count() - self.flown.len() as u64,
            jobs.count(),
            runs.iter().take(MOST).map(words).collect::<Vec<_>>().join(", "),
            if runs.len() > MOST { ", …" } else { "" }
        )
    }
}

/// Whether a flight may have come to this: it lasts as long as its steps, and nothing happens more often than there are steps.
fn is_possible(flight: &Value) -> bool {
    let Some(steps) = flight.get("steps").and_then(Value::as_u64) else {
        return true;
    };
    let parts = ["watch", "sensor", "attack"].map(|part| flight.get(part).and_then(Value::as_object));
    let counts = parts.into_iter().flatten().flat_map(serde_json::Map::values);
    let mut counts = counts
        .chain(flight.get("altered_frames_used"))
        .filter_map(Value::as_u64);
    let time_s = flight.get("flight_time_s").and_then(Value::as_f64);
    let most_s = (steps as f64 + 1.0) * f64::from(STEP_S);
    steps <= u64::from(u32::MAX)
        && counts.all(|count| count <= steps)
        && time_s.is_some_and(|time_s| (0.0..=most_s).contains(&time_s))
}

/// The command whose flights a file has.
pub fn command_of(path: &Path) -> Result<String> {
    let text = read(path)?;
    let heading: Heading<Value> = heading_of(path, text.lines().next().unwrap_or_default())?;
    Ok(heading.origin.command)
}

fn heading_of<S: DeserializeOwned>(path: &Path, line: &str) -> Result<Heading<S>> {
    let name = path.display();
    let what = || format!("{name} does not begin with the heading of a campaign's flights");
    let heading: Heading<S> = serde_json::from_str(line).with_context(what)?;
    let format = &heading.format;
    ensure!(
        format == FORMAT,
        "{name} has the format \"{format}\", this program reads \"{FORMAT}\""
    );
    Ok(heading)
}

/// Whether a line is a heading; others' writers sort its entries.
fn is_heading(line: &str) -> bool {
    let has = |line: Value| line.get("format").is_some() && line.get("flight").is_none();
    // Most lines are flights, of which this is soon known.
    line.contains("\"format\"") && serde_json::from_str(line).is_ok_and(has)
}

fn read(path: &Path) -> Result<String> {
    let text = vigil_types::files::read_text(path, SIZE_LIMIT);
    let mut text = text.with_context(|| format!("cannot read {}", path.display()))?;
    // Some editors put a mark in front.
    if text.starts_with('\u{feff}') {
        text.remove(0);
    }
    Ok(text)
}

fn cannot_write(path: &Path) -> String {
    format!("cannot write {}", path.display())
}

/// Refuses a file that holds something else than a campaign's flights.
fn check_replaceable(path: &Path) -> Result<()> {
    let (mut line, name) = (Vec::new(), path.display());
    if path.is_file() {
        let file = File::open(path).map(|file| std::io::BufReader::new(file.take(HEADING_LIMIT)));
        let result = file.and_then(|mut file| file.read_until(b'\n', &mut line));
        result.with_context(|| format!("cannot read {name}"))?;
    }
    let heading = String::from_utf8_lossy(&line);
    let heading = heading.trim_start_matches('\u{feff}');
    ensure!(
        line.is_empty() || is_heading(heading) && heading.contains("\"vigil campaign "),
        "{name} is there and is no campaign's: name another place with -o"
    );
    Ok(())
}

/// SHA-256 of the file of the program that runs.
pub fn program_sha256() -> Result<String> {
    let file = std::env::current_exe().context("cannot find this program's file")?;
    let program = std::fs::read(&file).with_context(|| format!("cannot read {}", file.display()))?;
    Ok(sha256(&program))
}

/// SHA-256 in hexadecimal.
pub fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The first place where two origins differ, with both values. A writer that drops `.0` changes no number.
pub fn difference(a: &Value, b: &Value, place: &str) -> Option<String> {
    match (a, b) {
        (Value::Number(a), Value::Number(b)) if a.is_f64() != b.is_f64() && a.as_f64() == b.as_f64() => return None,
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            let mut pairs = a.iter().zip(b);
            return pairs.find_map(|(a, b)| difference(a, b, place));
        }
        (Value::Object(a), Value::Object(b)) => {
            let names = a.keys().chain(b.keys().filter(|name| !a.contains_key(*name)));
            let of = |map: &serde_json::Map<String, Value>, name| map.get(name).cloned().unwrap_or(Value::Null);
            let mut differences = names.map(|name| difference(&of(a, name), &of(b, name), &format!("{place}.{name}")));
            return differences.find_map(|difference| difference);
        }
        _ if a == b => return None,
        _ => {}
    }
    let value = |value: &Value| match value {
        Value::Null => "absent".to_owned(),
        _ => value.to_string(),
    };
    let place = place.trim_start_matches('.');
    Some(format!("{place} was {}, and is {}", value(b), value(a)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flight_counts_no_more_than_its_steps_and_lasts_as_long() {
        let flight = |steps: u64, time_s: f64, alarms: u64| {
            let watch = serde_json::json!({"alarms": alarms, "first_alarm_step": null});
            is_possible(&serde_json::json!({"steps": steps, "flight_time_s": time_s, "watch": watch}))
        };
        assert!(flight(338, 16.87, 338) && flight(1200, 0.0, 0));
        for (steps, time_s, alarms) in [
            (1 << 63, 16.87, 0),
            (338, -5.0, 0),
            (338, 1e308, 0),
            (338, f64::NAN, 0),
            (338, 16.87, u64::MAX),
        ] {
            assert!(!flight(steps, time_s, alarms), "{steps} {time_s} {alarms}");
        }
    }
}
