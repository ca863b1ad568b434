//! `vigil detector collect`: the flights that a detector learns from and those that choose the epoch, each set a campaign.

use crate::campaign::flights::{Campaign, Existing, Jobs};
use crate::cli::detector::Stage;
use crate::cli::output::{self, Interrupt, Progress, say};
use crate::detector_training::{
    BLOCK, LstmConfig, Record, Recorded, Scenario, WEAK_YAW, counts_of, fly, from_bytes, load_flights, save_flights,
    to_bytes,
};
use anyhow::{Context, Result, ensure};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD as BASE64;
use rayon::ThreadPool;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// What lines call this command.
pub const COMMAND: &str = "detector collect";
/// The only arm.
const ARM: &str = "flights";
/// The flights to learn from, without an end, and below them those that choose: first seeds, on training courses.
const SETS: [(&str, u64); 2] = [("learn", 3000), ("choose", 1500)];
/// Flights without one attacked window after which none is expected any more.
const FLIGHTS_IN_VAIN: usize = 240;

/// Arguments of `vigil detector collect`.
#[derive(Debug, Clone, clap::Args)]
pub struct CollectArgs {
    /// Attacked windows to learn from, and at least as many others; a fifth as many choose the epoch.
    #[arg(long, default_value_t = LstmConfig::default().windows as u64, value_parser = clap::value_parser!(u64).range(100..))]
    windows: u64,

    /// Fly only some flights of this set and leave them in the folder as learn.jsonl or choose.jsonl, for another machine
    /// (docs/cluster.md).
    #[arg(long, value_parser = SETS.map(|(name, _)| name), requires_all = ["seed", "flights"])]
    set: Option<String>,

    /// With --set: the first flight; the usual ones begin at 3000 to learn, and at 1500 to choose.
    #[arg(long, requires = "set")]
    seed: Option<u64>,

    /// With --set: how many flights.
    #[arg(long, requires = "set", value_parser = clap::value_parser!(u64).range(1..))]
    flights: Option<u64>,
}

/// A flight in its line: the content of a file of it, as Base64.
type Packed = String;

impl Stage<'_> {
    /// Flies what the folder does not have yet.
    ///
    /// # Errors
    /// Flights of another actor in the folder, a file that cannot be written.
    pub fn collect(&self, args: &CollectArgs, pool: &ThreadPool) -> Result<()> {
        if let (Some(set), Some(first_seed), Some(flights)) = (&args.set, args.seed, args.flights) {
            let mut campaign = self.campaign(set, first_seed, flights)?;
            let interrupt = campaign.fly(pool, |seed, _, _| self.fly(seed))?;
            let hint = if interrupt.came() {
                "; the same command goes on"
            } else {
                ""
            };
            say!("flights          {}{hint}", self.lines(set).display());
            return Ok(());
        }
        for ((set, seed), windows) in SETS.into_iter().zip([args.windows, args.windows / 5]) {
            let path = self.lines(set).with_extension("safetensors");
            let flights = if path.exists() {
                let kept = load_flights(&path, &self.pilot)?;
                ensure!(
                    has(&counts_of(&kept), windows),
                    "{} holds fewer than {windows} windows of each class: remove it, or name another folder with -o",
                    path.display()
                );
                kept
            } else {
                let lines = self.lines(set);
                let Some(flights) = self.gather(set, seed, windows, pool)? else {
                    let lines = lines.display();
                    say!("interrupted: what was flown is kept in {lines}; the same command goes on");
                    return Ok(());
                };
                save_flights(&path, &self.pilot, &flights)?;
                // What it held is in the file just written.
                let _ = std::fs::remove_file(lines);
                flights
            };
            let [attacked, weak, lingering, unattacked] = counts_of(&flights);
            let seed = flights.first().map_or(seed, |record| record.scenario.seed);
            say!(
                "{:<20} {} flights from seed {seed}: {attacked} attacked windows, {unattacked} unattacked, \
                 {weak} weak, {lingering} lingering",
                format!("{set}.safetensors"),
                flights.len()
            );
        }
        Ok(())
    }

    fn lines(&self, set: &str) -> PathBuf {
        self.folder.join(format!("{set}.jsonl"))
    }

    fn campaign(&self, set: &str, first_seed: u64, flights: u64) -> Result<Campaign<Recorded, Packed>> {
        let folder = self.folder;
        std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
        let campaign = Campaign::new(COMMAND, Recorded::by(&self.pilot)?, jobs(first_seed, flights))?;
        campaign.keep_in(&self.lines(set), Existing::Resume)
    }

    /// A dozen after the other until there are as many windows of each class; none when Ctrl-C came first.
    fn gather(&self, set: &str, first_seed: u64, windows: u64, pool: &ThreadPool) -> Result<Option<Vec<Record>>> {
        // Each flight has a window or more.
        let mut campaign = self.campaign(set, first_seed, windows)?;
        let mut jobs = jobs(first_seed, BLOCK);
        let (bar, interrupt) = (Progress::new(windows, "attacked windows")?, Interrupt::on_ctrl_c()?);
        let mut records = Vec::new();
        while !has(&counts_of(&records), windows) {
            campaign.fly_some(&jobs, pool, &interrupt, |seed, _| self.fly(seed))?;
            if interrupt.came() {
                bar.finish();
                return Ok(None);
            }
            for seed in (0..BLOCK).map(|i| jobs.first_seed.wrapping_add(i)) {
                let packed = campaign.flight(seed, 0).context("it was flown")?;
                records.push(unpacked(campaign.settings(), seed, packed)?);
            }
            let [attacked, .., unattacked] = counts_of(&records);
            ensure!(
                attacked > 0 || records.len() < FLIGHTS_IN_VAIN,
                "no attack in {FLIGHTS_IN_VAIN} flights moved the yaw output by {WEAK_YAW}: a detector has nothing to learn from"
            );
            jobs.first_seed += BLOCK;
            bar.set_message(format!("{unattacked} unattacked, {} flights", records.len()));
            bar.set_position(attacked as u64);
        }
        bar.finish();
        Ok(Some(records))
    }

    /// Two of three flights are attacked.
    fn fly(&self, seed: u64) -> Result<Packed> {
        let scenario = Scenario::drawn(seed, !seed.is_multiple_of(3));
        let flown = fly(self.isa, &self.pilot, &scenario, &mut |_, _| Ok(()))?;
        Ok(BASE64.encode(to_bytes(&self.pilot, &[flown])?))
    }
}

/// Whether there are so many attacked windows and as many unattacked.
fn has([attacked, .., unattacked]: &[usize; 4], windows: u64) -> bool {
    *attacked.min(unattacked) as u64 >= windows
}

fn jobs(first_seed: u64, flights: u64) -> Jobs {
    let arms = vec![ARM.to_owned()];
    Jobs {
        first_seed,
        flights,
        arms,
    }
}

fn unpacked(recorded: &Recorded, seed: u64, packed: &Packed) -> Result<Record> {
    let name = || format!("the flight of seed {seed}");
    let bytes = BASE64.decode(packed).with_context(name)?;
    let mut flights = from_bytes(Path::new(&name()), &bytes, recorded)?;
    flights.pop().with_context(name)
}

/// Puts the lines of several files into one, which `vigil detector collect` takes its flights from.
pub fn merge(files: &[PathBuf], lines: &Path) -> Result<ExitCode> {
    ensure!(
        output::is_file(lines),
        "flights to learn from go into a file: name it with -o"
    );
    Campaign::<Recorded, Packed>::load(files, lines)?;
    say!("flights          {}", lines.with_extension("jsonl").display());
    Ok(ExitCode::SUCCESS)
}
