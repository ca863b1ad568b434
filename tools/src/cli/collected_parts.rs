//! `vigil detector collect` on more than one machine: a unit is a dozen flights, and the whole is what one machine gathers.

use crate::campaign::part::{self, Part, Shard, Unit};
use crate::cli::output::{Interrupt, Progress, say};
use crate::detector_training::{BLOCK, Counts, Flights, Record, Recorded, fly_block};
use anyhow::{Context, Result, ensure};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD as BASE64;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use vigil_nnet::Isa;
use vigil_policy::FrozenPilot;

/// What parts call this command.
pub const COMMAND: &str = "detector collect";

/// One of the files that are gathered.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct GatheredSet {
    /// Its file's name.
    pub file: String,
    /// Of the first flight.
    pub first_seed: u64,
    /// Windows of each class that are wanted.
    pub windows: usize,
}

/// Everything that decides what the flights are, wherever they are flown.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Plan {
    recorded: Recorded,
    sets: Vec<GatheredSet>,
    /// Dozens of flights of each set; those that are not needed are left out of the whole.
    blocks: Vec<u64>,
}

impl Plan {
    fn units(&self) -> u64 {
        self.blocks.iter().sum()
    }

    /// The set of a unit, and its first seed.
    fn place(&self, unit: u64) -> Result<(&GatheredSet, u64)> {
        let mut left = unit;
        for (set, blocks) in self.sets.iter().zip(&self.blocks) {
            if left < *blocks {
                return Ok((set, set.first_seed.wrapping_add(left * BLOCK)));
            }
            left -= blocks;
        }
        anyhow::bail!("there is no dozen of flights number {unit}")
    }
}

/// A dozen flights: the content of a file of them, as Base64.
#[derive(Debug, Serialize, Deserialize)]
struct Dozen {
    first_seed: u64,
    flights: String,
}

impl Unit for Dozen {
    fn name(&self) -> String {
        format!("the {BLOCK} flights from seed {}", self.first_seed)
    }
}

impl Dozen {
    fn records(&self, recorded: &Recorded) -> Result<Vec<Record>> {
        let name = PathBuf::from(self.name());
        let bytes = BASE64.decode(&self.flights).with_context(|| self.name())?;
        Ok(Flights::from_bytes(&name, &bytes, recorded)?.records)
    }
}

/// Flies a share of `flights` flights of the first set and a fifth as many of each other, and leaves it in the folder.
///
/// # Errors
/// A part of something else in its place; a file that cannot be written.
pub fn fly_shard(
    (isa, pilot): (Isa, &FrozenPilot),
    sets: Vec<GatheredSet>,
    (shard, flights): (Shard, u64),
    folder: &Path,
    pool: &rayon::ThreadPool,
) -> Result<ExitCode> {
    let blocks = (0..sets.len()).map(|set| flights.div_ceil(if set == 0 { BLOCK } else { 5 * BLOCK }));
    let plan = Plan {
        recorded: Recorded::by(pilot)?,
        blocks: blocks.collect(),
        sets,
    };
    fly_plan(&plan, shard, folder, pool, &|first_seed| {
        Ok(fly_block(isa, pilot, first_seed)?)
    })
}

fn fly_plan(
    plan: &Plan,
    shard: Shard,
    folder: &Path,
    pool: &rayon::ThreadPool,
    fly: &(dyn Fn(u64) -> Result<Vec<Record>> + Sync),
) -> Result<ExitCode> {
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let path = shard.file(&folder.join("collect.json"));
    let part = Part::begin(COMMAND, plan.clone(), (shard, plan.units()), &path)?;
    let interrupt = Interrupt::on_ctrl_c()?;
    let bar = Progress::new(part.missing().len() as u64, "dozens of flights")?;
    part.fly(&path, (pool, &bar, &interrupt), |unit| {
        let (_, first_seed) = plan.place(unit)?;
        let flown = Flights {
            actor_sha256: plan.recorded.actor_sha256.clone(),
            records: fly(first_seed)?,
        };
        Ok(Dozen {
            first_seed,
            flights: BASE64.encode(flown.to_bytes(&path)?),
        })
    })?;
    Ok(interrupt.exit_code())
}

/// Makes the files of the parts: the first set at `file`, the others beside it by their names.
///
/// # Errors
/// Parts that contradict each other or are not all; too few windows in them; a file that cannot be written.
pub fn merge(parts: &[PathBuf], file: &Path) -> Result<ExitCode> {
    let (plan, dozens) = part::join::<Plan, Dozen>(parts)?;
    let mut dozens = dozens.iter();
    let mut whole = Vec::new();
    for (set, blocks) in plan.sets.iter().zip(&plan.blocks) {
        let want = Counts {
            attacked: set.windows,
            unattacked: set.windows,
        };
        let (mut counts, mut records) = (Counts::default(), Vec::new());
        for dozen in dozens.by_ref().take(usize::try_from(*blocks)?) {
            // As one machine does: it stops where there are enough.
            if counts.reach(want) {
                continue;
            }
            let some = dozen.records(&plan.recorded)?;
            some.iter().for_each(|record| counts.add(record));
            records.extend(some);
        }
        ensure!(
            counts.reach(want),
            "{} flights have {} attacked and {} unattacked windows for {}, and {} of each are wanted: fly the parts with more --flights",
            records.len(),
            counts.attacked,
            counts.unattacked,
            set.file,
            set.windows
        );
        whole.push((set, counts, records));
    }
    for (number, (set, counts, records)) in whole.into_iter().enumerate() {
        let path = match number {
            0 => file.to_owned(),
            _ => file.with_file_name(&set.file),
        };
        let flights = Flights {
            actor_sha256: plan.recorded.actor_sha256.clone(),
            records,
        };
        flights.save(&path)?;
        say!(
            "{:<20} {} flights from seed {}: {} attacked windows, {} unattacked",
            path.display(),
            flights.records.len(),
            set.first_seed,
            counts.attacked,
            counts.unattacked
        );
    }
    Ok(ExitCode::SUCCESS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detector_training::{Frame, Scenario, Step};

    /// 40 steps, attacked from the 20th on: 20 attacked windows of ten and 11 unattacked.
    fn flown(first_seed: u64) -> Vec<Record> {
        let step = |seed: u64, number: usize| Step {
            state: vec![seed as f32, number as f32 / 3.0],
            position: [0.5, -0.25].into(),
            output: [1.0, 0.1],
            frame: if number < 20 { Frame::Unaltered } else { Frame::Attacked },
            yaw_change: if number < 20 { 0.0 } else { 2.0 },
        };
        let record = |seed| Record {
            scenario: Scenario::drawn(seed, true),
            frame_ages: vec![0],
            outcome: None,
            steps: (0..40).map(|number| step(seed, number)).collect(),
        };
        (first_seed..first_seed + BLOCK).map(record).collect()
    }

    fn plan(windows: usize) -> Plan {
        let set = |file: &str, first_seed, windows| GatheredSet {
            file: file.to_owned(),
            first_seed,
            windows,
        };
        Plan {
            recorded: Recorded {
                actor_sha256: "an actor".to_owned(),
                state: 2,
                position: 2,
                frame_ages: vec![0],
            },
            sets: vec![set("learn", 3000, windows), set("choose", 4500, 40)],
            blocks: vec![3, 1],
        }
    }

    fn parts(plan: &Plan, folder: &Path) -> Vec<PathBuf> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
        let shards = ["3/3", "1/3", "2/3"].map(|shard| shard.parse::<Shard>().unwrap());
        for shard in shards {
            fly_plan(plan, shard, folder, &pool, &|first_seed| Ok(flown(first_seed))).unwrap();
        }
        shards.map(|shard| shard.file(&folder.join("collect.json"))).into()
    }

    #[test]
    fn parts_are_put_together_to_the_very_files_that_one_machine_writes() {
        let folder = tempfile::tempdir().unwrap();
        let plan = plan(200);
        let learn = folder.path().join("learn");
        merge(&parts(&plan, folder.path()), &learn).unwrap();
        // Two dozen have 264 unattacked windows, so the third was not needed.
        for (file, seed, dozens) in [("learn", 3000, 2), ("choose", 4500, 1)] {
            let one_machine = Flights {
                actor_sha256: "an actor".to_owned(),
                records: (0..dozens).flat_map(|dozen| flown(seed + dozen * BLOCK)).collect(),
            };
            let expected = one_machine.to_bytes(&learn).unwrap();
            let merged = std::fs::read(folder.path().join(file)).unwrap();
            assert!(merged == expected, "{file} differs");
            let again = Flights::from_bytes(&learn, &merged, &plan.recorded).unwrap();
            assert_eq!(again, one_machine);
        }
    }

    #[test]
    fn too_few_windows_and_too_few_parts_write_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let learn = folder.path().join("learn");
        let all = parts(&plan(600), folder.path());
        let told = merge(&all, &learn).unwrap_err().to_string();
        assert!(
            told.contains("396 unattacked windows") && told.contains("--flights"),
            "{told}"
        );
        let told = merge(&all[..2], &learn).unwrap_err().to_string();
        assert!(told.contains("fly --shard 2/3"), "{told}");
        assert!(!learn.exists());
    }
}
