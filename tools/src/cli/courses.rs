//! `vigil courses`: draw, write and check courses.

use crate::cli::output::{self, put, say};
use anyhow::{Result, ensure};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use vigil_sim::{CourseChoice, Models, SimConfig, Simulator, Start};
use vigil_types::{DEPTH_COLS, DEPTH_FULL_SCALE_M, DEPTH_ROWS, DepthFrame};
use vigil_world::Image;

/// Arguments of `vigil courses`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil courses draw --seed 7 -o 7.png               top view of validation course 7
  vigil courses draw --seed 7 -o 7.svg               the same as vectors, for print
  vigil courses view --seed 7 -o view.png            what the LiDAR sees at its start
  vigil courses write --family training --seed 3     the course as TOML, to edit and fly with --course
  vigil courses check my.toml                        is it well formed, and is there a way to the goal?")]
pub struct CoursesArgs {
    #[command(subcommand)]
    command: CoursesCommand,
}

#[derive(Debug, Clone, clap::Subcommand)]
enum CoursesCommand {
    /// Draw a course from above, as a PNG or an SVG.
    Draw {
        #[command(flatten)]
        course: CourseChoice,
        /// The picture; its ending, .png or .svg, says which.
        #[arg(short, long, default_value = "course.png")]
        output: PathBuf,
    },
    /// Draw the depth frame seen at the start as a PNG (near is bright).
    View {
        #[command(flatten)]
        course: CourseChoice,
        /// The picture.
        #[arg(short, long, default_value = "view.png")]
        output: PathBuf,
    },
    /// Write a course as TOML to a file or standard output.
    Write {
        #[command(flatten)]
        course: CourseChoice,
        /// The file; standard output when absent.
        #[arg(short, long)]
        output: Option<PathBuf>,
    },
    /// Check course files: form, values, and a way from start to goal.
    Check {
        /// Course files.
        #[arg(required = true)]
        files: Vec<PathBuf>,
    },
}

/// Runs the command.
///
/// # Errors
/// Unreadable or malformed courses (file, line, field), a picture that cannot be written.
pub fn run(args: &CoursesArgs) -> Result<ExitCode> {
    match &args.command {
        CoursesCommand::Draw { course, output } => {
            let ending = output.extension().map(|e| e.to_ascii_lowercase());
            let is_svg = ending.as_deref().is_some_and(|e| e == "svg");
            ensure!(
                is_svg || ending.as_deref().is_none_or(|e| e == "png"),
                "cannot write picture {}: courses are drawn as PNG or SVG files; name it {} or {}",
                output.display(),
                output.with_extension("png").display(),
                output.with_extension("svg").display()
            );
            let course = course.load(course.seed_or_random())?;
            if is_svg {
                output::write(output, vigil_world::draw_svg(&course, &[]))?;
                say!("{}", output.display());
            } else {
                write_png(&vigil_world::draw(&course, &[]), output)?;
            }
        }
        CoursesCommand::View { course, output } => {
            vigil_world::check_png_name(output)?;
            let seed = course.seed_or_random();
            let mut config = SimConfig::with_models(course.load(seed)?, seed, Models::default());
            config.start = Start::Airborne;
            let mut frame = Box::new(DepthFrame::EMPTY);
            Simulator::new(&config, 0)?.capture(&mut frame);
            write_png(&depth_image(&frame), output)?;
        }
        CoursesCommand::Write { course, output } => {
            let text = course.load(course.seed_or_random())?.to_toml_string()?;
            match output {
                Some(path) => output::write(path, text)?,
                None => put!("{text}"),
            }
        }
        CoursesCommand::Check { files } => return Ok(check(files)),
    }
    Ok(ExitCode::SUCCESS)
}

fn check(files: &[PathBuf]) -> ExitCode {
    let mut good = true;
    for file in files {
        let choice = CourseChoice {
            course: Some(file.clone()),
            ..CourseChoice::default()
        };
        let verdict = match choice.load(0) {
            Ok(course) if course.corridor().is_some() => {
                let obstacles = course.solids().len() + course.movers.len();
                if course.earliest_arrival_s(0.0).is_some() {
                    format!("{}: ok, {obstacles} obstacles", file.display())
                } else {
                    good = false;
                    format!("{}: the movers leave no time to get to the goal", file.display())
                }
            }
            Ok(_) => {
                good = false;
                format!(
                    "{}: no way from start to goal with the vehicle's clearance",
                    file.display()
                )
            }
            Err(error) => {
                good = false;
                error.to_string()
            }
        };
        say!("{verdict}");
    }
    if good {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(crate::cli::output::EXIT_DIFFERS)
    }
}

fn write_png(image: &Image, path: &Path) -> Result<()> {
    image.write_png(path)?;
    say!("{}", path.display());
    Ok(())
}

/// A depth frame as a grey image, 4 pixels for each: brightness is 1 / (1 + range / 3 m), so that near things stand out.
fn depth_image(frame: &DepthFrame) -> Image {
    const SCALE: usize = 4;
    Image::from_fn(DEPTH_COLS * SCALE, DEPTH_ROWS * SCALE, |x, y| {
        let range_m = frame.depth[(y / SCALE) * DEPTH_COLS + x / SCALE] * DEPTH_FULL_SCALE_M;
        [(255.0 / (1.0 + range_m / 3.0)) as u8; 3]
    })
}
