//! Campaigns in parts: which flights a shard flies, the file that it leaves, and how the parts become one again
//! (docs/cluster.md).

use crate::cli::output::{self, Interrupt, Progress};
use anyhow::{Context, Result, bail, ensure};
use rayon::ThreadPool;
use rayon::prelude::*;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fmt;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use vigil_nnet::Isa;

/// Ten million flights have some 4 GB.
const SIZE_LIMIT: u64 = 8 << 30;
/// Value of the entry `format`.
const FORMAT: &str = "vigil campaign part 1";
/// More parts than flights are of no use, and a person has typed a wrong number.
const MOST_SHARDS: u64 = 1_000_000;

/// One of several equal shares of a campaign: number K of N, `K/N`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub struct Shard {
    /// From 1 on.
    number: u64,
    of: u64,
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = text
            .split_once('/')
            .and_then(|(number, of)| Some((number.parse().ok()?, of.parse().ok()?)));
        match parsed {
            Some((number, of)) if (1..=MOST_SHARDS).contains(&of) && (1..=of).contains(&number) => {
                Ok(Self { number, of })
            }
            _ => Err(format!(
                "give K/N, part K of N, both from 1 on and N at most {MOST_SHARDS}: 1/8 to 8/8"
            )),
        }
    }
}

impl TryFrom<String> for Shard {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Shard> for String {
    fn from(shard: Shard) -> Self {
        shard.to_string()
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

impl Shard {
    /// The share of `total` units: neighbours, and shares that differ by one at most.
    pub fn units(self, total: u64) -> Range<u64> {
        let edge = |number: u64| (u128::from(total) * u128::from(number) / u128::from(self.of)) as u64;
        edge(self.number - 1)..edge(self.number)
    }

    /// K, from 1 on.
    pub fn number(self) -> u64 {
        self.number
    }

    /// N.
    pub fn of(self) -> u64 {
        self.of
    }

    /// All N.
    pub fn all(of: u64) -> impl Iterator<Item = Self> {
        (1..=of).map(move |number| Self { number, of })
    }

    /// Where a part goes whose whole would be `whole`: `NAME.K-of-N.part.json` beside it; standard output stays.
    pub fn file(self, whole: &Path) -> PathBuf {
        if output::is_stdout(whole) {
            return whole.to_owned();
        }
        let stem = whole.file_stem().unwrap_or_default().to_string_lossy();
        whole.with_file_name(format!("{stem}.{}-of-{}.part.json", self.number, self.of))
    }
}

/// A flight, or whatever else a campaign consists of.
pub trait Unit: Serialize + DeserializeOwned + Send {
    /// What errors call it.
    fn name(&self) -> String;
}

/// What has to be the same for two programs to give the same bits.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Program {
    version: String,
    sha256: String,
    /// Kernels with and without fused multiply-add round differently.
    arithmetic: String,
    /// Of the working tree in which it ran, if there was one: to be told, not compared.
    git_commit: Option<String>,
}

impl Program {
    /// The one that runs.
    ///
    /// # Errors
    /// Its file cannot be read.
    pub fn this() -> Result<Self> {
        let file = std::env::current_exe().context("cannot find this program's file")?;
        let bytes = std::fs::read(&file).with_context(|| format!("cannot read {}", file.display()))?;
        Ok(Self {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            sha256: sha256(&bytes),
            arithmetic: if Isa::detect() == Isa::PORTABLE {
                "portable"
            } else {
                "fused"
            }
            .to_owned(),
            git_commit: output::git_commit(),
        })
    }

    /// How another program differs from this one, if it does, in words.
    pub fn difference(&self, other: &Self) -> Option<String> {
        let commit = |program: &Self| program.git_commit.clone().unwrap_or_else(|| "unknown".to_owned());
        if self.sha256 != other.sha256 || self.version != other.version {
            return Some(format!(
                "the program was version {}, commit {}, SHA-256 {}, and is version {}, commit {}, SHA-256 {}; all parts \
                 have to come from the same file",
                self.version,
                commit(self),
                self.sha256,
                other.version,
                commit(other),
                other.sha256
            ));
        }
        (self.arithmetic != other.arithmetic).then(|| {
            format!(
                "the processor's arithmetic was {}, and is {}: their flights differ in the last bits",
                self.arithmetic, other.arithmetic
            )
        })
    }
}

/// SHA-256 in hexadecimal.
pub fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// What one shard of a campaign came to.
#[derive(Debug, Serialize, Deserialize)]
pub struct Part<P, U> {
    format: String,
    command: String,
    program: Program,
    shard: Shard,
    /// Of the whole campaign.
    units: u64,
    /// Everything that decides what the units are.
    plan: P,
    done: BTreeMap<u64, U>,
}

/// The file: the part, and the digest of its JSON without spaces.
#[derive(Serialize, Deserialize)]
struct Sealed<T> {
    sha256: String,
    part: T,
}

impl<P: Serialize + DeserializeOwned, U: Unit> Part<P, U> {
    /// A part to be flown: what `path` holds of it already, or nothing yet.
    ///
    /// # Errors
    /// A file that is there and is no part, or a part of something else.
    pub fn begin(command: &str, plan: P, (shard, units): (Shard, u64), path: &Path) -> Result<Self> {
        ensure!(
            shard.of <= units,
            "--shard {shard}: the campaign has {units} flights, so at most so many parts"
        );
        let new = Self {
            format: FORMAT.to_owned(),
            command: command.to_owned(),
            program: Program::this()?,
            shard,
            units,
            plan,
            done: BTreeMap::new(),
        };
        if output::is_stdout(path) || !path.exists() {
            return Ok(new);
        }
        let kept = Self::load(path).context("name another file with -o, or remove it")?;
        if let Some(difference) = kept.difference(&new)? {
            bail!(
                "{} is of another campaign: {difference}. Name another file with -o, or remove it",
                path.display()
            );
        }
        ensure!(
            kept.shard == shard,
            "{} is shard {}, not {shard}",
            path.display(),
            kept.shard
        );
        Ok(kept)
    }

    /// The numbers of its units that are still to be done.
    pub fn missing(&self) -> Vec<u64> {
        let own = self.shard.units(self.units);
        own.filter(|unit| !self.done.contains_key(unit)).collect()
    }

    /// Does what is missing, and writes the file. The file says what was done also after an interruption; the same command
    /// goes on with it.
    ///
    /// # Errors
    /// Whatever a unit fails with, or the file.
    pub fn fly(
        mut self,
        path: &Path,
        (pool, bar, interrupt): (&ThreadPool, &Progress, &Interrupt),
        fly: impl Fn(u64) -> Result<U> + Sync,
    ) -> Result<()> {
        self.done
            .extend(fly_units(self.missing(), (pool, bar, interrupt), fly)?);
        bar.finish();
        let left = self.missing().len();
        self.save(path)?;
        let share = self.shard.units(self.units);
        let file = match output::is_stdout(path) {
            true => "standard output".to_owned(),
            false => path.display().to_string(),
        };
        output::say!(
            "shard {}        {} of {} flights, in {file}",
            self.shard,
            self.done.len(),
            share.end - share.start
        );
        if left > 0 {
            output::say!("interrupted      the same command goes on with the {left} flights that are left");
        }
        Ok(())
    }

    fn save(&self, path: &Path) -> Result<()> {
        let sealed = Sealed {
            sha256: self.digest()?,
            part: self,
        };
        let mut json = serde_json::to_vec(&sealed)?;
        json.push(b'\n');
        output::write(path, json)
    }

    fn digest(&self) -> Result<String> {
        Ok(sha256(&serde_json::to_vec(self)?))
    }

    /// Reads a part.
    ///
    /// # Errors
    /// A file that is none, or that was altered; it is named.
    pub fn load(path: &Path) -> Result<Self> {
        let name = path.display();
        let bytes = read(path)?;
        let Sealed { sha256, part } = serde_json::from_slice::<Sealed<Self>>(&bytes)
            .with_context(|| format!("{name} is cut off, or no part of a campaign"))?;
        ensure!(
            part.digest()? == sha256,
            "{name} was altered: its content does not have the SHA-256 that it says"
        );
        let own = part.shard.units(part.units);
        ensure!(
            part.done.keys().all(|unit| own.contains(unit)),
            "{name} holds flights that are not of shard {}",
            part.shard
        );
        Ok(part)
    }

    /// How another part's campaign differs from this one's, if it does.
    fn difference(&self, other: &Self) -> Result<Option<String>> {
        if self.command != other.command {
            return Ok(Some(format!("it was `{}`, and is `{}`", self.command, other.command)));
        }
        // The plan first: its names say more.
        let (a, b) = (serde_json::to_value(&self.plan)?, serde_json::to_value(&other.plan)?);
        let difference = difference(&a, &b, "");
        Ok(difference.or_else(|| self.program.difference(&other.program)))
    }
}

/// Flies units, in any order; those that an interruption leaves out are absent.
///
/// # Errors
/// Whatever a unit fails with.
pub fn fly_units<U: Send>(
    units: Vec<u64>,
    (pool, bar, interrupt): (&ThreadPool, &Progress, &Interrupt),
    fly: impl Fn(u64) -> Result<U> + Sync,
) -> Result<Vec<(u64, U)>> {
    pool.install(|| {
        units
            .into_par_iter()
            .filter(|_| !interrupt.came())
            .map(|unit| {
                let done = fly(unit)?;
                bar.inc(1);
                Ok((unit, done))
            })
            .collect()
    })
}

fn read(path: &Path) -> Result<Vec<u8>> {
    vigil_types::files::read(path, SIZE_LIMIT).with_context(|| format!("cannot read {}", path.display()))
}

/// The command of which a file is a part.
///
/// # Errors
/// A file that is no part of this version.
pub fn command_of(path: &Path) -> Result<String> {
    #[derive(Deserialize)]
    struct Head {
        format: String,
        command: String,
    }
    let name = path.display();
    let Sealed { part, .. } = serde_json::from_slice::<Sealed<Head>>(&read(path)?)
        .with_context(|| format!("{name} is cut off, or no part of a campaign"))?;
    ensure!(
        part.format == FORMAT,
        "{name} has the format \"{}\", this program reads \"{FORMAT}\"",
        part.format
    );
    Ok(part.command)
}

/// The plan and all units, in order, of which `paths` are the parts. Parts may come in any order, more than once, and of
/// several divisions of the campaign.
///
/// # Errors
/// Parts that contradict each other, or that do not make the whole; which, and what is missing.
pub fn join<P: Serialize + DeserializeOwned, U: Unit>(paths: &[PathBuf]) -> Result<(P, Vec<U>)> {
    let (first_path, others) = paths.split_first().context("name the parts")?;
    // Before they are read: the parts of another command hold other things.
    let command = command_of(first_path)?;
    for path in others {
        let other = command_of(path)?;
        ensure!(
            command == other,
            "{} and {} are of different campaigns: it was `{command}`, and is `{other}`",
            first_path.display(),
            path.display()
        );
    }
    let mut whole = Part::<P, U>::load(first_path)?;
    let mut shards = vec![whole.shard];
    for path in others {
        let part = Part::<P, U>::load(path)?;
        if let Some(difference) = whole.difference(&part)? {
            bail!(
                "{} and {} are of different campaigns: {difference}",
                first_path.display(),
                path.display()
            );
        }
        shards.push(part.shard);
        for (number, unit) in part.done {
            if let Some(other) = whole.done.get(&number) {
                ensure!(
                    serde_json::to_value(other)? == serde_json::to_value(&unit)?,
                    "{} and an earlier part contradict each other: {} came out differently",
                    path.display(),
                    unit.name()
                );
            } else {
                whole.done.insert(number, unit);
            }
        }
    }
    let missing: Vec<u64> = (0..whole.units).filter(|unit| !whole.done.contains_key(unit)).collect();
    ensure!(missing.is_empty(), missing_in_words(&missing, whole.units, &shards));
    Ok((whole.plan, whole.done.into_values().collect()))
}

fn missing_in_words(missing: &[u64], units: u64, shards: &[Shard]) -> String {
    const MOST: usize = 12;
    let of = shards.first().map_or(1, |shard| shard.of);
    let (names, what) = if shards.iter().all(|shard| shard.of == of) {
        let mut names: Vec<String> = Shard::all(of)
            .filter(|shard| shard.units(units).any(|unit| missing.binary_search(&unit).is_ok()))
            .map(|shard| match shards.contains(&shard) {
                true => format!("{shard} (interrupted)"),
                false => shard.to_string(),
            })
            .collect();
        if names.len() > MOST {
            names.truncate(MOST);
            names.push("…".to_owned());
        }
        (names, "fly --shard")
    } else {
        let numbers = missing.iter().take(MOST).map(|unit| unit.to_string());
        (numbers.collect(), "the parts lack the numbers")
    };
    format!(
        "{} of {units} flights are missing: {what} {}",
        missing.len(),
        names.join(", ")
    )
}

/// The first place where two plans differ, with both values.
fn difference(a: &Value, b: &Value, place: &str) -> Option<String> {
    if a == b {
        return None;
    }
    if let (Value::Object(a), Value::Object(b)) = (a, b) {
        let names = a.keys().chain(b.keys().filter(|name| !a.contains_key(*name)));
        return names
            .filter_map(|name| {
                let place = match place {
                    "" => name.clone(),
                    _ => format!("{place}.{name}"),
                };
                let of = |map: &serde_json::Map<String, Value>| map.get(name).cloned().unwrap_or(Value::Null);
                difference(&of(a), &of(b), &place)
            })
            .next();
    }
    let told = |value: &Value| match value {
        Value::Null => "absent".to_owned(),
        _ => value.to_string(),
    };
    Some(format!("{place} was {}, and is {}", told(a), told(b)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shares_of_any_division_are_the_whole_and_differ_by_one_at_most() {
        for (total, of) in [(1u64, 1u64), (10, 3), (7, 7), (1_000_000, 997), (u64::MAX, 3)] {
            let shares: Vec<Range<u64>> = (1..=of).map(|number| Shard { number, of }.units(total)).collect();
            assert_eq!((shares[0].start, shares[of as usize - 1].end), (0, total));
            assert!(shares.windows(2).all(|pair| pair[0].end == pair[1].start));
            let lengths = shares.iter().map(|share| share.end - share.start);
            assert!(lengths.clone().max().unwrap() - lengths.min().unwrap() <= 1);
        }
    }

    #[test]
    fn a_shard_is_a_number_of_a_number() {
        assert_eq!("3/8".parse::<Shard>().unwrap().to_string(), "3/8");
        for wrong in ["0/8", "9/8", "3", "3/0", "a/b", "-1/2", "3/8/9", "1/99999999", ""] {
            assert!(wrong.parse::<Shard>().is_err(), "{wrong}");
        }
        let shard: Shard = "3/8".parse().unwrap();
        assert_eq!(
            shard.file(Path::new("runs/a.json")),
            Path::new("runs/a.3-of-8.part.json")
        );
        assert_eq!(shard.file(Path::new("-")), Path::new("-"));
    }

    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    struct Throw {
        seed: u64,
        range_m: f32,
    }

    impl Unit for Throw {
        fn name(&self) -> String {
            format!("the throw of seed {}", self.seed)
        }
    }

    type Throws = Part<f64, Throw>;

    /// Awkward numbers: not all have a short decimal.
    fn throw(seed: u64) -> Throw {
        Throw {
            seed,
            range_m: (seed as f32 + 0.1).sqrt() / 3.0,
        }
    }

    fn throws(folder: &Path, name: &str, plan: f64, shard: &str, units: Range<u64>) -> PathBuf {
        let path = folder.join(name);
        let mut part = Throws::begin("throw", plan, (shard.parse().unwrap(), 10), &path).unwrap();
        part.done.extend(units.map(|unit| (unit, throw(unit))));
        part.save(&path).unwrap();
        path
    }

    fn refused(paths: &[PathBuf]) -> String {
        format!("{:#}", join::<f64, Throw>(paths).unwrap_err())
    }

    #[test]
    fn parts_make_the_same_whole_in_any_order_more_than_once_and_of_any_division() {
        let folder = tempfile::tempdir().unwrap();
        let half = throws(folder.path(), "1", 0.1, "1/2", 0..5);
        let thirds = [("2/3", 3..6), ("3/3", 6..10)];
        let [second, third] = thirds.map(|(shard, units)| throws(folder.path(), &shard[..1], 0.1, shard, units));
        let expected: Vec<Throw> = (0..10).map(throw).collect();
        for parts in [
            vec![half.clone(), second.clone(), third.clone()],
            vec![third.clone(), second.clone(), half.clone(), third.clone()],
        ] {
            assert_eq!(join::<f64, Throw>(&parts).unwrap(), (0.1, expected.clone()));
        }
    }

    #[test]
    fn parts_that_contradict_each_other_or_are_too_few_are_refused_and_it_is_said_why() {
        let folder = tempfile::tempdir().unwrap();
        let part = |name: &str, plan, shard, units| throws(folder.path(), name, plan, shard, units);
        let first = part("first", 0.5, "1/2", 0..5);
        let windy = part("windy", 0.75, "2/2", 5..10);
        let told = refused(&[first.clone(), windy]);
        assert!(told.contains("was 0.5, and is 0.75"), "{told}");

        let told = refused(std::slice::from_ref(&first));
        assert_eq!(told, "5 of 10 flights are missing: fly --shard 2/2");
        let short = part("short", 0.5, "2/2", 5..8);
        let told = refused(&[first.clone(), short]);
        assert_eq!(told, "2 of 10 flights are missing: fly --shard 2/2 (interrupted)");
        let last = part("last", 0.5, "3/3", 6..10);
        let told = refused(&[first.clone(), last]);
        assert_eq!(told, "1 of 10 flights are missing: the parts lack the numbers 5");

        let path = folder.path().join("other");
        let mut other = Throws::begin("throw", 0.5, ("1/2".parse().unwrap(), 10), &path).unwrap();
        other
            .done
            .extend((0..5).map(|unit| (unit, throw(unit + u64::from(unit == 3)))));
        other.save(&path).unwrap();
        let told = refused(&[first.clone(), path.clone()]);
        assert!(told.contains("the throw of seed 4 came out differently"), "{told}");

        other.done.clear();
        other.program.sha256 = "another".to_owned();
        other.save(&path).unwrap();
        let told = refused(&[first.clone(), path.clone()]);
        assert!(told.contains("SHA-256 another"), "{told}");

        let bytes = std::fs::read(&first).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() - 9]).unwrap();
        assert!(refused(&[first.clone(), path.clone()]).contains("is cut off"));
        let altered = String::from_utf8(bytes).unwrap().replace("\"seed\":3", "\"seed\":4");
        std::fs::write(&path, altered).unwrap();
        assert!(refused(&[path]).contains("was altered"));
    }

    #[test]
    fn a_part_is_gone_on_with_and_one_of_another_campaign_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = throws(folder.path(), "part", 0.5, "2/2", 5..8);
        let begin = |plan, shard: &str| Throws::begin("throw", plan, (shard.parse().unwrap(), 10), &path);
        assert_eq!(begin(0.5, "2/2").unwrap().missing(), [8, 9]);
        let told = |result: Result<Throws>| format!("{:#}", result.unwrap_err());
        assert!(told(begin(0.75, "2/2")).contains("of another campaign: "));
        assert!(told(begin(0.5, "1/2")).contains("is shard 2/2, not 1/2"));
        assert!(told(begin(0.5, "2/11")).contains("at most so many parts"));
    }

    #[test]
    fn what_differs_between_two_plans_is_named_with_both_values() {
        let value = |text: &str| serde_json::from_str::<Value>(text).unwrap();
        let told = |a, b| difference(&value(a), &value(b), "");
        assert_eq!(told(r#"{"a":1,"b":{"c":2}}"#, r#"{"a":1,"b":{"c":2}}"#), None);
        assert_eq!(
            told(r#"{"a":1,"b":{"c":2}}"#, r#"{"a":1,"b":{"c":3}}"#).as_deref(),
            Some("b.c was 2, and is 3")
        );
        assert_eq!(
            told(r"{}", r#"{"wind":3}"#).as_deref(),
            Some("wind was absent, and is 3")
        );
    }
}
