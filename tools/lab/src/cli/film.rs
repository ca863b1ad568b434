//! `vigil log film`: a flight as an animated picture or a video.

use crate::cli::output::{self, is_stdout, say};
use crate::flight_film::{Gif, Video, film};
use anyhow::{Context, Result, bail};
use clap::builder::RangedU64ValueParser;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use vigil_log::Story;
use vigil_tools::cli::log::{film_name, is_video};
use vigil_tools::cli::replay::find_log;

/// Arguments of `vigil log film`.
#[derive(Debug, Clone, clap::Args)]
#[command(
    override_usage = "vigil log film [OPTIONS] <LOG>",
    after_help = "\
Examples:
  vigil log film runs/fly-1760000000-7                    flight-0001.gif beside the log
  vigil log film flight-0001.mcap -o attacked.gif --speed 3 --title \"detector off\"
  vigil log film flight-0001.mcap -o attacked.mp4         a video; the program ffmpeg makes it

`vigil fly --record FILE` does it after a flight. The frames' pixels are explained anew for at most --shap pictures, which takes most of
the time. Moving obstacles stand where they began."
)]
pub struct FilmArgs {
    /// A flight log (MCAP), or a folder that holds one.
    #[arg(required_unless_present = "check")]
    log: Option<PathBuf>,

    /// Where the film goes; its ending, .gif or .mp4, says which [default: beside the log, as .gif]; `-` is a GIF on standard output.
    #[arg(short = 'o', long, value_name = "FILE", value_parser = film_name)]
    output: Option<PathBuf>,

    /// Seconds of flight in a second of film, 0.5 to 20; a long flight is shown faster, so that the film stays small.
    #[arg(long, value_name = "FACTOR", default_value_t = 2.0, value_parser = speed)]
    speed: f64,

    /// What stands in the banner [default: the course].
    #[arg(long, value_name = "TEXT")]
    title: Option<String>,

    /// Pictures whose pixels are explained by DeepSHAP, evenly over the film, at most 200; 0 leaves it out.
    #[arg(long, value_name = "PICTURES", default_value_t = 40, value_parser = RangedU64ValueParser::<usize>::new().range(..=200))]
    shap: usize,

    /// Only look whether a film of this name can be made.
    #[arg(long, hide = true, requires = "output")]
    check: bool,
}

fn speed(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(speed) if (0.5..=20.0).contains(&speed) => Ok(speed),
        _ => Err("give a number from 0.5 to 20".to_owned()),
    }
}

/// Films a flight, or looks whether that can be done.
///
/// # Errors
/// A log that cannot be read, a flight that never took off, a film that cannot be written.
pub fn run(args: &FilmArgs) -> Result<ExitCode> {
    // Whether a film of this name can be made.
    let check = |to: &Path| is_video(to).then(Video::check).transpose();
    if let Some(to) = args.output.as_deref().filter(|_| args.check) {
        check(to)?;
        return Ok(ExitCode::SUCCESS);
    }
    let log = find_log(args.log.as_deref().context("no log")?)?;
    let to = args.output.clone().unwrap_or_else(|| log.with_extension("gif"));
    output::prepare(&to)?;
    let course = Story::about(&log)?.remove("course");
    let title = args.title.clone().or(course).unwrap_or_default();
    let shown = (args.speed, &*title);
    check(&to)?;
    let none = || format!("no film of {}", log.display());
    let ((pictures, incomplete), bytes) = if is_video(&to) {
        let mut video = Video::begin(&to).with_context(none)?;
        let filmed = film(&log, shown, args.shap, &mut |canvas, cs| video.picture(canvas, cs)).with_context(none)?;
        video.finish().with_context(none)?;
        let Ok(file) = std::fs::metadata(&to) else {
            bail!("ffmpeg left no film {}", to.display());
        };
        (filmed, file.len())
    } else {
        let mut gif = Gif::begin().with_context(none)?;
        let filmed = film(&log, shown, args.shap, &mut |canvas, cs| gif.picture(canvas, cs)).with_context(none)?;
        let bytes = gif.finish().with_context(none)?;
        output::write(&to, &bytes)?;
        (filmed, bytes.len() as u64)
    };
    let missing = incomplete.map(|why| format!("it is not all of the flight: {why}"));
    if is_stdout(&to) {
        missing.iter().for_each(|missing| output::tell!("{missing}"));
    } else {
        say!("{} ({pictures} pictures, {:.1} MB)", to.display(), bytes as f64 / 1e6);
        missing.iter().for_each(|missing| say!("{missing}"));
    }
    Ok(ExitCode::SUCCESS)
}
