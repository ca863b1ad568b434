//! The fault campaign: kills, stops, hostile frames, floods, full disks, spoofing and attacks on signing, and flights that last hours.
//!
//! `tests/faults/run` builds and starts it; docs/faults.md describes what is tried and what must come of it.

mod campaign;
mod disk;
mod endurance;
mod flight;
mod flood;
mod frames;
mod kills;
mod links;

use anyhow::Result;
use campaign::{Folder, Table, tell};
use clap::{Args, Parser, Subcommand, ValueEnum};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Tries the faults that the stack must survive, and shows how each ended.
#[derive(Parser)]
#[command(
    name = "tests/faults/run",
    after_help = "\
Examples:
  tests/faults/run                              the whole campaign, about an hour; a table in runs/faults
  tests/faults/run --quick                      a part of it, half a minute
  tests/faults/run --only frames,spoofing       some kinds only
  tests/faults/run endurance real-time 1h       an hour in flight, goal after goal
  tests/faults/run endurance lockstep 24h       a day of simulated flight; prints the state's hash
  tests/faults/run flood udp 127.0.0.1:14030 --content garbage --seconds 10
                                                20 000 datagrams a second to a link, as a stranger

Real-time flights use the instances --instance to --instance + --side-by-side - 1.
Exit code: 0 nothing collided, crashed or went otherwise than it must, 1 something did, 130 interrupted."
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// The campaign (what runs when no command is given).
    Campaign(CampaignArgs),
    /// Hours of flight, goal after goal, in one process of the firmware.
    Endurance(EnduranceArgs),
    /// Sends datagrams to a link as a stranger.
    Flood {
        #[command(flatten)]
        flood: flood::Flood,

        /// How long.
        #[arg(long, default_value_t = 10.0)]
        seconds: f64,
    },
}

/// A kind of fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Kind {
    /// Frames that no sensor sends.
    Frames,
    /// Setpoints of others.
    Spoofing,
    /// Attacks on MAVLink signing.
    Signing,
    /// Disks without room.
    Disk,
    /// Processes killed and stopped.
    Kills,
    /// Strangers who flood the vehicle's link.
    Floods,
}

#[derive(Args)]
struct CampaignArgs {
    /// A part of each kind that takes half a minute in all.
    #[arg(long)]
    quick: bool,

    /// These kinds only.
    #[arg(long, value_enum, value_delimiter = ',')]
    only: Vec<Kind>,

    /// Trials of each kill; a quarter of it of each stop.
    #[arg(long, default_value_t = 100)]
    kills: usize,

    /// First seed of courses and moments.
    #[arg(long, default_value_t = 1)]
    seed: u64,

    /// First instance of real-time flights.
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u32).range(0..=90))]
    instance: u32,

    /// Real-time flights at the same time.
    #[arg(long, default_value_t = 6, value_parser = clap::value_parser!(u32).range(1..=9))]
    side_by_side: u32,

    /// Where the table goes.
    #[arg(short = 'o', long, value_name = "DIR", default_value = "runs/faults")]
    out: PathBuf,
}

/// How time passes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Pace {
    /// As on a vehicle.
    RealTime,
    /// As fast as it goes.
    Lockstep,
}

#[derive(Args)]
struct EnduranceArgs {
    /// How time passes.
    #[arg(value_enum)]
    pace: Pace,

    /// How long: 90s, 30m, 24h.
    #[arg(value_parser = duration_s)]
    duration: f64,

    /// Seed of noise and wind.
    #[arg(long, default_value_t = 1)]
    seed: u64,

    /// Instance of the real-time flight.
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u32).range(0..=99))]
    instance: u32,

    /// Where the record goes.
    #[arg(short = 'o', long, value_name = "DIR", default_value = "runs/endurance")]
    out: PathBuf,
}

/// A duration in seconds: a number and s, m or h.
fn duration_s(text: &str) -> Result<f64, String> {
    let of_unit = |(unit, factor): (char, f64)| Some(text.strip_suffix(unit)?.parse::<f64>().ok()? * factor);
    let duration_s = [('s', 1.0), ('m', 60.0), ('h', 3600.0)].into_iter().find_map(of_unit);
    (duration_s.filter(|s| *s > 0.0 && s.is_finite()))
        .ok_or_else(|| "give a number and s, m or h, for example 90s, 30m, 24h".to_owned())
}

fn main() -> ExitCode {
    match run(Cli::parse()) {
        Ok(code) => code,
        Err(error) => {
            tell(&format!("faults: {error:#}"));
            ExitCode::FAILURE
        }
    }
}

fn run(cli: Cli) -> Result<ExitCode> {
    let stop = vigil_io::interrupt::set_by_interrupt()?;
    let good = match cli.command {
        Command::Campaign(args) => fly_campaign(&args, &stop)?,
        Command::Endurance(args) => {
            let folder = Folder::make(&args.out)?;
            match args.pace {
                Pace::RealTime => endurance::real_time(args.duration, args.seed, args.instance, &folder, &stop)?,
                Pace::Lockstep => endurance::lockstep(args.duration, args.seed, &folder, &stop)?,
            }
        }
        Command::Flood { flood, seconds } => {
            let begun = Instant::now();
            let sent = flood.send(|| begun.elapsed().as_secs_f64() >= seconds || stop.load(Ordering::Relaxed));
            let rate = sent as f64 / begun.elapsed().as_secs_f64();
            tell(&format!("{sent} sent, {rate:.0} a second"));
            true
        }
    };
    Ok(match (stop.load(Ordering::Relaxed), good) {
        (true, _) => ExitCode::from(130),
        (false, true) => ExitCode::SUCCESS,
        (false, false) => ExitCode::FAILURE,
    })
}

fn fly_campaign(args: &CampaignArgs, stop: &AtomicBool) -> Result<bool> {
    let folder = Folder::make(&args.out)?;
    let mut table = Table {
        seed: args.seed,
        quick: args.quick,
        ..Table::default()
    };
    let site = flight::Site {
        seed: args.seed,
        quick: args.quick,
        instances: (args.instance..args.instance + args.side_by_side).collect(),
        kills: args.kills,
        stop,
    };
    let wanted = |kind| args.only.is_empty() || args.only.contains(&kind);
    type Part = fn(&flight::Site<'_>, &Folder) -> Result<Vec<campaign::Row>>;
    // Whether its flights last as long as on a vehicle.
    let parts: [(Kind, bool, Part); 6] = [
        (Kind::Frames, false, frames::rows),
        (Kind::Spoofing, false, links::spoofing),
        (Kind::Disk, false, disk::rows),
        (Kind::Signing, true, links::signing),
        (Kind::Floods, true, flood::rows),
        (Kind::Kills, true, kills::rows),
    ];
    let (in_turn, together): (Vec<_>, Vec<_>) = parts
        .into_iter()
        .filter(|(kind, ..)| wanted(*kind))
        .partition(|(_, is_real_time, _)| !(args.quick && *is_real_time && args.side_by_side >= 3));
    for (.., part) in in_turn {
        if !stop.load(Ordering::Relaxed) {
            let rows = part(&site, &folder)?;
            table.add(rows, &folder)?;
        }
    }
    // The quick part's real-time flights at the same time, each with instances of its own.
    let share = site.instances.len() / together.len().max(1);
    let rows = std::thread::scope(|scope| {
        let running: Vec<_> = (together.into_iter().zip(site.instances.chunks(share.max(1))))
            .map(|((.., part), instances)| {
                let site = flight::Site {
                    instances: instances.to_vec(),
                    ..site.clone()
                };
                let folder = &folder;
                scope.spawn(move || part(&site, folder))
            })
            .collect();
        let joined = running.into_iter().map(|part| part.join());
        joined
            .map(|rows| rows.unwrap_or_else(|_| anyhow::bail!("a part of the campaign panicked")))
            .collect::<Result<Vec<_>>>()
    })?;
    for rows in rows {
        table.add(rows, &folder)?;
    }
    if stop.load(Ordering::Relaxed) {
        table.interrupted = true;
        table.add(Vec::new(), &folder)?;
    }
    tell(&format!("table: {}", folder.path("faults.md").display()));
    Ok(table.is_good())
}
