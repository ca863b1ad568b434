//! `vigil log`: what can be made of a flight log.

use crate::cli::output::{self, is_stdout, say};
use crate::cli::replay::{check_not_over, find_log};
use crate::flight_derived::{Derivable, derive};
use crate::flight_report::{self, EXPLAINED};
use anyhow::{Context, Result, ensure};
use clap::builder::RangedU64ValueParser;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Commands of `vigil log`.
#[derive(Debug, Clone, clap::Subcommand)]
pub enum LogCommand {
    /// One HTML file that shows the flight: map, plots, film, events. Opens from disk, without a network.
    Report(ReportArgs),
    /// An animated picture (GIF) or a video (mp4) of the flight: from behind, from above, what the sensor saw and what in it moved the
    /// actor, score, who flies.
    Film(crate::cli::lab::Words),
    /// Replay the flight and put into its log what follows from it: the pilot's map, its planned path, SHAP of the pixels.
    Derive(DeriveArgs),
    /// The flight as ULog (.ulg), which PX4's Flight Review, pyulog and PlotJuggler open.
    Ulg(UlgArgs),
}

/// Arguments of `vigil log ulg`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil log ulg runs/fly-1760000000-7               flight-0001.ulg beside the log
  vigil log ulg flight-0001.mcap -o f.ulg && ulog_info f.ulg

It holds what the guidance computer knows: position, attitude, setpoints, status, battery, texts, and its own topic vigil_status. A log
that was cut off or is damaged is converted as far as it is whole.")]
pub struct UlgArgs {
    /// A flight log (MCAP), or a folder that holds one.
    log: PathBuf,

    /// Where it goes [default: beside the log, as .ulg]; `-` is standard output.
    #[arg(short = 'o', long, value_name = "FILE")]
    output: Option<PathBuf>,
}

/// Arguments of `vigil log report`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil log report runs/fly-1760000000-7             the log in a flight's folder
  vigil log report flight-0001.mcap -o report.html   a log file, a name of your own
  vigil log report flight-0001.mcap --shap 0         quicker: the frames without an explanation of their pixels

`vigil fly` leaves a report beside each log. A log that was cut off or is damaged is shown as far as it is whole.")]
pub struct ReportArgs {
    /// A flight log (MCAP), or a folder that holds one.
    log: PathBuf,

    /// Where the report goes [default: beside the log, as .html]; `-` is standard output.
    #[arg(short = 'o', long, value_name = "FILE")]
    output: Option<PathBuf>,

    /// Frames around the first alarm whose pixels are explained by DeepSHAP, at most 60; 0 leaves it out.
    #[arg(long, value_name = "FRAMES", default_value_t = EXPLAINED, value_parser = RangedU64ValueParser::<usize>::new().range(..=60))]
    shap: usize,
}

/// Arguments of `vigil log derive`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil log derive runs/fly-1760000000-7            map and way twice a second, SHAP of the pixels once a second
  vigil log derive flight-0001.mcap --only map      quicker: without SHAP

What was derived earlier is replaced; what a replay reads stays as it is, bit for bit. It needs the actor and detector that flew.")]
pub struct DeriveArgs {
    /// A flight log (MCAP), or a folder that holds one.
    log: PathBuf,

    /// Derive this alone.
    #[arg(long, value_enum, value_name = "WHAT")]
    only: Option<Derivable>,
}

/// Takes the name of a film.
///
/// # Errors
/// One whose ending says neither GIF nor mp4.
pub fn film_name(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    match is_stdout(&path) || is_video(&path) || has_ending(&path, "gif") {
        true => Ok(path),
        false => Err("a film is a GIF or an mp4: give a name that ends in .gif or .mp4".to_owned()),
    }
}

fn has_ending(path: &Path, ending: &str) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case(ending))
}

/// Whether a film of this name is a video.
pub fn is_video(path: &Path) -> bool {
    has_ending(path, "mp4")
}

/// Does what was asked.
///
/// # Errors
/// A log that is missing, unreadable or of another version, a report that cannot be written.
pub fn run(command: &LogCommand) -> Result<ExitCode> {
    match command {
        LogCommand::Report(args) => {
            let (log, to) = from_and_to(&args.log, args.output.as_deref(), flight_report::beside)?;
            let (bytes, incomplete) = write_report(&log, &to, args.shap)?;
            if !is_stdout(&to) {
                say!("{} ({:.1} MB)", to.display(), bytes as f64 / 1e6);
            }
            say_what_is_missing(incomplete);
        }
        LogCommand::Ulg(args) => {
            let log = find_log(&args.log)?;
            let converted = vigil_log::ulog(&log).with_context(|| format!("no ULog of {}", log.display()))?;
            let (log, to) = from_and_to(&log, args.output.as_deref(), |log| log.with_extension("ulg"))?;
            ensure!(converted.records > 0, "{} holds no whole step", log.display());
            output::write(&to, &converted.bytes)?;
            if !is_stdout(&to) {
                let megabytes = converted.bytes.len() as f64 / 1e6;
                say!("{} ({} records, {megabytes:.1} MB)", to.display(), converted.records);
            }
            say_what_is_missing(converted.incomplete);
        }
        LogCommand::Derive(args) => {
            let log = find_log(&args.log)?;
            let derived =
                derive(&log, args.only).with_context(|| format!("nothing was derived from {}", log.display()))?;
            let (maps, frames) = (derived.maps, derived.explained);
            say!("{}: {maps} maps, {frames} explained frames", log.display());
            if let Some(step) = derived.gap_before_step {
                say!("records are missing before step {step}: what follows cannot be replayed");
            }
        }
        LogCommand::Film(_) => return crate::cli::lab::hand_on(),
    }
    Ok(ExitCode::SUCCESS)
}

/// The log, and where what is made of it goes.
fn from_and_to(log: &Path, to: Option<&Path>, beside: fn(&Path) -> PathBuf) -> Result<(PathBuf, PathBuf)> {
    let log = find_log(log)?;
    let to = to.map_or_else(|| beside(&log), Path::to_owned);
    output::prepare(&to)?;
    check_not_over(&log, &to)?;
    Ok((log, to))
}

/// Writes the report of `log` to `to`; returns its size, and why it is not all of the flight where it is not.
///
/// # Errors
/// A log that cannot be read, a report that cannot be written.
pub fn write_report(log: &Path, to: &Path, explained_frames: usize) -> Result<(usize, Option<String>)> {
    let (flight, incomplete) = flight_report::read(log, explained_frames).context("no report")?;
    let page = flight_report::html(flight)?;
    output::write(to, &page)?;
    Ok((page.len(), incomplete))
}

fn say_what_is_missing(incomplete: Option<String>) {
    if let Some(why) = incomplete {
        say!("it is not all of the flight: {why}");
    }
}
