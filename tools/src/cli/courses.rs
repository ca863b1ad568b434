//! `vigil courses`: draw, write and check courses.

use crate::cli::output::{self, put, say};
use crate::cli::view::ViewerArgs;
use anyhow::{Result, ensure};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use vigil_log::Scene;
use vigil_sim::world::{Course, Image, Mesh};
use vigil_sim::{CourseChoice, Models, SimConfig, Simulator, Start};
use vigil_types::{DEPTH_COLS, DEPTH_FULL_SCALE_M, DEPTH_ROWS, DepthFrame};

/// What `vigil courses` can be used for.
pub(super) const EXAMPLES: &str = "\
Examples:
  vigil courses draw --seed 7 -o 7.png               top view of validation course 7
  vigil courses draw --seed 7 -o 7.svg               the same as vectors, for print
  vigil courses view --seed 7                        the course in 3-D in the Rerun viewer, moving obstacles included
  vigil courses view --course my.toml --save my.rrd  the same as a recording: `rerun my.rrd` opens it
  vigil courses view --seed 7 -o view.png            what the LiDAR sees at its start, as a picture
  vigil courses write --family training --seed 3     the course as TOML, to edit and fly with --course
  vigil courses check my.toml                        is it well formed, and is there a path to the goal?";

/// Commands of `vigil courses`.
#[derive(Debug, Clone, clap::Subcommand)]
pub enum CoursesCommand {
    /// Draw a course from above, as a PNG or an SVG.
    Draw {
        #[command(flatten)]
        course: CourseChoice,
        /// The picture; its ending, .png or .svg, says which.
        #[arg(short, long, default_value = "course.png")]
        output: PathBuf,
    },
    /// Open a course in 3-D in the Rerun viewer, or draw the depth frame seen at its start.
    View {
        #[command(flatten)]
        course: CourseChoice,
        /// Draw the depth frame as a PNG (near is bright) instead of opening the viewer.
        #[arg(short, long, value_name = "FILE", conflicts_with = "save")]
        output: Option<PathBuf>,
        /// Write a recording for the viewer instead of opening it.
        #[arg(long, value_name = "FILE")]
        save: Option<PathBuf>,
        #[command(flatten)]
        viewer: ViewerArgs,
    },
    /// Write a course as TOML to a file or standard output.
    Write {
        #[command(flatten)]
        course: CourseChoice,
        /// The file; standard output when absent.
        #[arg(short, long)]
        output: Option<PathBuf>,
    },
    /// Check course files: form, values, and a path from start to goal.
    Check {
        /// Course files.
        #[arg(required = true)]
        files: Vec<PathBuf>,
    },
}

/// Runs the command.
///
/// # Errors
/// Unreadable or malformed courses (file, line, field), a picture that cannot be written, no viewer.
pub fn run(command: &CoursesCommand) -> Result<ExitCode> {
    match command {
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
                output::write(output, vigil_sim::world::draw_svg(&course, &[]))?;
                say!("{}", output.display());
            } else {
                write_png(&vigil_sim::world::draw(&course, &[]), output)?;
            }
        }
        CoursesCommand::View {
            course,
            output,
            save,
            viewer,
        } => {
            if let Some(output) = output {
                vigil_sim::world::check_png_name(output)?;
            }
            let seed = course.seed_or_random();
            let course = course.load(seed)?;
            let frame = seen_at_start(&course, seed)?;
            match output {
                Some(output) => write_png(&depth_image(&frame), output)?,
                None => {
                    viewer.course(&in_3d(&course, &frame)?, save.as_deref())?;
                    if let Some(save) = save {
                        say!("{}", save.display());
                    }
                }
            }
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

/// The frame that the sensor takes at the start, at flight height.
fn seen_at_start(course: &Course, seed: u64) -> Result<Box<DepthFrame>> {
    let mut config = SimConfig::with_models(course.clone(), seed, Models::default());
    config.start = Start::Airborne;
    let mut frame = Box::new(DepthFrame::EMPTY);
    Simulator::new(&config, 0)?.capture(&mut frame);
    Ok(frame)
}

/// Moving obstacles are shown for so long, at this pace.
const MOVERS_S: f64 = 60.0;
const MOVERS_STEP_S: f64 = 0.2;

/// What the viewer's script draws of a course, as JSON: NED metres, radians clockwise from north, ranges in millimetres (0: no return).
fn in_3d(course: &Course, frame: &DepthFrame) -> Result<String> {
    let still = Course {
        movers: Vec::new(),
        ..course.clone()
    };
    let movers: Vec<Scene> = (0..=(MOVERS_S / MOVERS_STEP_S) as u64)
        .map(|step| (step as f64 * MOVERS_STEP_S * 1e9) as u64)
        .map(|at_ns| crate::cli::scene::of_solids(course.movers.iter().map(|m| m.solid_at(at_ns))))
        .collect();
    let range_mm = |value: &f32| match *value {
        value if value < 1.0 => (value * DEPTH_FULL_SCALE_M * 1000.0) as u32,
        _ => 0,
    };
    let every_second = |row: &[f32]| row.iter().step_by(2).map(range_mm).collect::<Vec<u32>>();
    let depth: Vec<Vec<u32>> = frame.depth.chunks(DEPTH_COLS).step_by(2).map(every_second).collect();
    let bounds = &course.bounds;
    let json = serde_json::json!({
        "name": course.name,
        "family": course.family.map(|family| family.name()),
        "seed": course.seed,
        "start_ned_m": course.start_ned_m().to_array(),
        "heading_rad": course.start_heading_rad(),
        "goal_ned_m": course.goal_ned_m().to_array(),
        "goal_radius_m": course.goal_radius_m,
        "time_limit_s": course.time_limit_s,
        "bounds": { "north_m": bounds.north_m, "east_m": bounds.east_m, "top_m": bounds.top_m },
        "ceiling_height_m": course.ceiling_height_m,
        "way_ne_m": course.corridor(),
        "obstacles": course.solids().len(),
        "wires": course.wires.len(),
        "meshes": course.meshes.len(),
        "solids": crate::cli::scene::of(&still).solids,
        "movers": if course.movers.is_empty() { Vec::new() } else { movers },
        "movers_step_s": MOVERS_STEP_S,
        "depth_mm": depth,
    });
    Ok(serde_json::to_string(&json)?)
}

fn check(files: &[PathBuf]) -> ExitCode {
    let mut is_good = true;
    for file in files {
        match obstacles_of(file) {
            Ok(found) => say!("{}: ok, {found}", file.display()),
            Err(fault) => {
                say!("{fault}");
                is_good = false;
            }
        }
    }
    output::checked(is_good)
}

/// What a course has that is as it should be.
fn obstacles_of(file: &Path) -> Result<String> {
    let course = Course::load(file)?;
    let (name, corridor) = (file.display(), course.corridor());
    ensure!(
        corridor.is_some(),
        "{name}: no path from start to goal with the vehicle's clearance"
    );
    let why = match course.movers.is_empty() {
        true => "`time_limit_s` is too short for the path at 1 m/s",
        false => "the movers leave no time to get to the goal",
    };
    ensure!(course.earliest_arrival_s(0.0).is_some(), "{name}: {why}");
    let counted = |count: usize, what: &str| format!("{count} {what}{}", if count == 1 { "" } else { "s" });
    let mut found = counted(course.solids().len() + course.movers.len(), "obstacle");
    if !course.wires.is_empty() {
        found += &format!(", {}", counted(course.wires.len(), "wire"));
    }
    for (triangles, open_edges) in course.meshes.iter().filter_map(Mesh::triangles_and_open_edges) {
        let (triangles, open_edges) = (counted(triangles, "triangle"), counted(open_edges, "open edge"));
        found += &format!(", a mesh of {triangles} with {open_edges}");
    }
    Ok(found)
}

fn write_png(image: &Image, path: &Path) -> Result<()> {
    if output::is_stdout(path) {
        return output::write(path, image.to_png()?);
    }
    image.write_png(path)?;
    say!("{}", path.display());
    Ok(())
}

/// A depth frame as a grey image, 4 pixels for each: brightness is 1 / (1 + range / 3 m), so that near things stand out.
fn depth_image(frame: &DepthFrame) -> Image {
    const SCALE: usize = 4;
    Image::from_fn(DEPTH_COLS * SCALE, DEPTH_ROWS * SCALE, |x, y| {
        output::range_grey(frame.depth[(y / SCALE) * DEPTH_COLS + x / SCALE])
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_stands_still_is_counted_by_kind_and_not_by_the_pieces_that_are_drawn() {
        let arena = Path::new(env!("CARGO_MANIFEST_DIR")).join("../sim_bridge/courses/arena.toml");
        let shown = in_3d(&Course::load(&arena).unwrap(), &DepthFrame::EMPTY).unwrap();
        let shown: serde_json::Value = serde_json::from_str(&shown).unwrap();
        let counts = ["obstacles", "wires", "meshes"].map(|kind| shown[kind].as_u64());
        assert_eq!(counts, [10, 1, 0].map(Some));
        assert!(shown["solids"].as_array().is_some_and(|pieces| pieces.len() > 11));
    }

    #[test]
    fn a_time_limit_below_the_way_is_named_where_nothing_moves() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("short.toml");
        let text = "name = \"short\"\ntime_limit_s = 9.0\ngoal = { north_m = 20.0, east_m = 0.0 }\n\
                    bounds = { north_m = [-4.0, 26.0], east_m = [-10.0, 10.0], top_m = 6.0 }\n";
        std::fs::write(&file, text).unwrap();
        let error = obstacles_of(&file).unwrap_err().to_string();
        assert!(
            error.ends_with("`time_limit_s` is too short for the path at 1 m/s"),
            "{error}"
        );
    }
}
