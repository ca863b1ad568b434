//! What all parts of the campaign share: the table, the folder of results, random draws.

use crate::flight::Site;
use anyhow::{Context, Result};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use vigil_sim::world::Outcome;
use vigil_tests::side_by_side;

/// Prints something for a person at once; where nobody listens nothing can be said.
pub fn tell(text: &str) {
    let _ = writeln!(std::io::stderr(), "{}", text.trim_end());
}

/// Where results go.
pub struct Folder(PathBuf);

impl Folder {
    /// The folder, made if it is not there.
    pub fn make(path: &Path) -> Result<Self> {
        std::fs::create_dir_all(path).with_context(|| format!("cannot make {}", path.display()))?;
        Ok(Self(path.to_owned()))
    }

    /// Writes a file whole; its path.
    pub fn write(&self, name: &str, content: &str) -> Result<PathBuf> {
        let path = self.0.join(name);
        vigil_types::files::replace(&path, content.as_bytes(), vigil_types::files::Access::Shared)
            .with_context(|| format!("cannot write {}", path.display()))?;
        Ok(path)
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }
}

vigil_types::named! {
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
    #[serde(rename_all = "snake_case")]
    pub enum Ending {
        /// The goal was reached.
        Arrived => "arrived",
        /// The vehicle held to the end, and said why.
        Held => "held",
        /// A program ended, or a command was refused, and said why.
        Named => "ended by name",
        TimeOut => "time-outs",
        /// Something was touched, or the course left.
        Collided => "collided",
        /// A program of ours ended that should not have.
        Crashed => "crashed",
    }
}

impl Ending {
    /// How a flight ended by the simulator's word; `None` where it arrived nowhere and touched nothing.
    pub fn of(outcome: Option<Outcome>) -> Option<Self> {
        match outcome? {
            Outcome::Success => Some(Self::Arrived),
            Outcome::Collision | Outcome::OutOfBounds => Some(Self::Collided),
            Outcome::TimeOut => None,
        }
    }
}

/// A trial's ending and, if there was one, what was not as it must be.
#[derive(Debug, Clone)]
pub struct Trial {
    pub ending: Ending,
    /// What was wrong besides, in words.
    pub wrong: Option<String>,
}

impl Trial {
    pub fn right(ending: Ending) -> Self {
        Self { ending, wrong: None }
    }

    pub fn wrong(ending: Ending, what: impl Into<String>) -> Self {
        Self {
            ending,
            wrong: Some(what.into()),
        }
    }
}

#[derive(Debug, Serialize)]
pub struct Row {
    pub fault: String,
    pub trials: usize,
    #[serde(flatten)]
    endings: BTreeMap<Ending, usize>,
    /// Trials in which something was not as it must be, and the first of these.
    wrong: usize,
    first_wrong: Option<String>,
    pub measured: String,
}

impl Row {
    pub fn of(fault: impl Into<String>, trials: &[Trial], measured: impl Into<String>) -> Self {
        let count = |ending| trials.iter().filter(|trial| trial.ending == ending).count();
        Self {
            fault: fault.into(),
            trials: trials.len(),
            endings: Ending::ALL.map(|ending| (ending, count(ending))).into(),
            wrong: trials.iter().filter(|trial| trial.wrong.is_some()).count(),
            first_wrong: trials.iter().find_map(|trial| trial.wrong.clone()),
            measured: measured.into(),
        }
    }

    /// How many ended how, and how many were wrong, each as `say` has it.
    fn counts(&self, separator: &str, say: impl Fn(usize, &str) -> String) -> String {
        let endings = self.endings.iter().map(|(ending, count)| say(*count, ending.name()));
        let all: Vec<String> = endings.chain([say(self.wrong, "wrong")]).collect();
        all.join(separator)
    }

    pub fn is_good(&self) -> bool {
        self.endings[&Ending::Collided] + self.endings[&Ending::Crashed] + self.wrong == 0
    }
}

/// The table so far; kept on the disk after each row.
#[derive(Default, Serialize)]
pub struct Table {
    pub seed: u64,
    pub quick: bool,
    pub rows: Vec<Row>,
    pub interrupted: bool,
}

impl Table {
    /// Adds rows, prints them and keeps them.
    pub fn add(&mut self, rows: Vec<Row>, folder: &Folder) -> Result<()> {
        for row in rows {
            let counts = row.counts(", ", |count, how| format!("{count} {how}"));
            let mut line = format!("{:<46} {:>4} trials: {counts}", row.fault, row.trials);
            if !row.measured.is_empty() {
                line += &format!("; {}", row.measured);
            }
            if let Some(wrong) = &row.first_wrong {
                line += &format!("; WRONG: {wrong}");
            }
            tell(&line);
            self.rows.push(row);
        }
        folder.write("faults.json", &serde_json::to_string_pretty(self)?)?;
        folder.write("faults.md", &self.markdown())?;
        Ok(())
    }

    pub fn is_good(&self) -> bool {
        !self.interrupted && self.rows.iter().all(Row::is_good)
    }

    pub fn markdown(&self) -> String {
        let mut text = String::from(
            "| Fault | Trials | Arrived | Held | Ended by name | Time-out | Collided | Crashed | Wrong | Measured |\n\
             | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |\n",
        );
        for row in &self.rows {
            let counts = row.counts(" | ", |count, _| count.to_string());
            let _ = writeln!(text, "| {} | {} | {counts} | {} |", row.fault, row.trials, row.measured);
        }
        text
    }
}

/// Random draws whose stream never changes (xorshift64*).
#[derive(Debug, Clone)]
pub struct Draw(u64);

impl Draw {
    /// A stream of its own for each seed.
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    /// 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }

    /// From 0 to below `end`.
    pub fn below(&mut self, end: usize) -> usize {
        ((self.bits() >> 11) % end as u64) as usize
    }

    /// Within a range.
    pub fn between(&mut self, from: f64, to: f64) -> f64 {
        from + (self.bits() >> 11) as f64 / (1_u64 << 53) as f64 * (to - from)
    }
}

/// Largest and median of what was measured, in words; nothing where nothing was.
pub fn spread(what: &str, unit: &str, mut values: Vec<f64>) -> String {
    values.sort_by(f64::total_cmp);
    match (values.get(values.len() / 2), values.last()) {
        (Some(median), Some(most)) => format!("{what} median {median:.2} {unit}, at most {most:.2} {unit}"),
        _ => String::new(),
    }
}

/// What was measured, without what is empty.
pub fn joined<const N: usize>(texts: [String; N]) -> String {
    let said: Vec<String> = texts.into_iter().filter(|text| !text.is_empty()).collect();
    said.join("; ")
}

/// Runs lockstep flights `0..count` of the site's seeds, as many at a time as there are cores and instances, until Ctrl-C: the
/// trial gets its number and its seed.
pub fn in_lockstep<T: Send + Sync>(site: &Site<'_>, count: usize, trial: impl Fn(usize, u64) -> T + Sync) -> Vec<T> {
    // One flight at a time for each instance: it takes a core.
    let threads = std::thread::available_parallelism()
        .map_or(1, usize::from)
        .min(site.instances.len());
    side_by_side(count, &site.instances[..threads], |number, _| {
        let stopped = site.stop.load(std::sync::atomic::Ordering::Relaxed);
        (!stopped).then(|| trial(number, site.seed + number as u64))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_counts_each_ending_once_and_shows_the_first_wrong() {
        let trials = [
            Trial::right(Ending::Arrived),
            Trial::wrong(Ending::Held, "late"),
            Trial::wrong(Ending::Held, "later"),
        ];
        let row = Row::of("a fault", &trials, "");
        assert_eq!(row.counts(" ", |count, _| count.to_string()), "1 2 0 0 0 0 2");
        assert!(!row.is_good());
        assert_eq!(row.first_wrong.as_deref(), Some("late"));
        assert!(Row::of("another", &trials[..1], "").is_good());
    }

    #[test]
    fn trials_side_by_side_are_each_flown_once_and_reported_in_order() {
        let flown = side_by_side(50, &[3, 4, 5], |number, instance| Some((number, instance)));
        assert!(flown.iter().map(|(number, _)| *number).eq(0..50));
        assert!(flown.iter().all(|(_, instance)| (3..6).contains(instance)));
    }
}
