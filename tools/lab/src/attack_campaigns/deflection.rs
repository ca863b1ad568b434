//! The paper's table II: how far the yaw can be bent in front of a wall.

use super::{Common, Strength, write_json};
use crate::campaign::flights::check_seeds;
use crate::report::TextTable;
use anyhow::{Result, ensure};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::process::ExitCode;
use vigil_adversary::{Beside, Method, StateAttack};
use vigil_nnet::Isa;
use vigil_policy::actor::memory::SCAN_AGES;
use vigil_policy::{FrozenActor, PilotInput};
use vigil_sim::world::{Course, Family, Lidar, LidarConfig, Shot, Wall, World, generate};
use vigil_tools::cli::output::{Interrupt, say};
use vigil_types::{
    Action, Attitude, DepthFrame, GoalRelative, HeadingVector, NedVector, STEP_NS, YAW_RATE_PER_UNIT_RAD_S,
};

/// Gap to the wall, metres (the paper's rows), and the paper's deflection there, °/s.
pub const GAPS: [(f32, f32); 5] = [(1.0, 0.0), (1.5, 62.0), (2.0, 53.0), (2.5, 30.0), (3.0, 25.0)];
/// Bearing of the goal, degrees (the paper's columns).
const BEARINGS_DEG: [f32; 7] = [-30.0, -20.0, -10.0, 0.0, 10.0, 20.0, 30.0];
/// Width of the wall: at a gap of 1 m it fills the 120° of view, farther away its edges are seen.
const WALL_WIDTH_M: f32 = 4.0;

/// Arguments of `vigil attack deflection`.
#[derive(Debug, Clone, clap::Args)]
pub struct DeflectionArgs {
    #[command(flatten)]
    strength: Strength,

    /// Distance of the goal, metres.
    #[arg(long, value_name = "M", default_value_t = 10.0)]
    goal_distance: f32,

    /// States of each cell, with sensor noise of their own.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..))]
    states: u64,

    /// Seed of the sensor noise.
    #[arg(long, default_value_t = 5000)]
    seed: u64,

    #[command(flatten)]
    common: Common,
}

#[derive(Clone, Serialize, Deserialize)]
pub struct Cell {
    pub method: Method,
    pub gap_m: f32,
    pub bearing_deg: f32,
    /// Mean yaw decision without the attack, and mean absolute change by it.
    clean_deg_s: f32,
    pub deflection_deg_s: f32,
}

/// What `table-2.json` holds.
#[derive(Serialize, Deserialize)]
pub struct Report {
    version: String,
    actor_sha256: String,
    seed: u64,
    pub states_per_cell: u64,
    pub epsilon_255: f32,
    pub iterations: u32,
    pub goal_distance_m: f32,
    pub wall_width_m: f32,
    /// Ctrl-C came: cells are missing.
    interrupted: bool,
    pub cells: Vec<Cell>,
}

/// Attacks hovering states before the wall, with both readings of the paper's attack.
pub fn run(args: &DeflectionArgs) -> Result<ExitCode> {
    ensure!(
        args.goal_distance > 0.0 && args.goal_distance <= 1000.0,
        "--goal-distance must be above 0 and at most 1000 m, got {}",
        args.goal_distance
    );
    check_seeds(args.seed, args.states)?;
    let victim = args.common.victim()?;
    let folder = args.common.folder()?;
    let of = |method: Method| GAPS.map(|(gap, _)| BEARINGS_DEG.map(|b| (method, gap, b))).concat();
    let places = [Method::BimAccumulating, Method::BimClipped].map(of).concat();
    let interrupt = Interrupt::on_ctrl_c()?;
    let cells: Vec<Cell> = args.common.pool()?.install(|| {
        places
            .par_iter()
            .filter(|_| !interrupt.came())
            .map(|(method, gap_m, bearing_deg)| cell(args, &victim, *method, *gap_m, *bearing_deg))
            .collect::<Result<_>>()
    })?;
    let interrupted = cells.len() < places.len();
    if interrupted {
        say!("interrupted: {} of {} cells were tried", cells.len(), places.len());
    }
    // What is missing would stand in the wrong place.
    let shown = if interrupted { &[] } else { &cells[..] };
    for block in shown.chunks(GAPS.len() * BEARINGS_DEG.len()) {
        let method = block[0].method.name();
        say!(
            "yaw deflection, °/s: {method}, ε = {}/255, {} iterations",
            args.strength.epsilon,
            args.strength.iterations
        );
        let bearings = BEARINGS_DEG.map(|b| format!("> {b}°")).join(" | ");
        let mut table = TextTable::new(&format!("gap to wall | {bearings} | > mean | > the paper"));
        for (row, (gap_m, paper)) in block.chunks(BEARINGS_DEG.len()).zip(GAPS) {
            let mean = row.iter().map(|c| c.deflection_deg_s).sum::<f32>() / row.len() as f32;
            let cells = row.iter().map(|c| format!("{:.0}", c.deflection_deg_s));
            let cells = [format!("{gap_m:.1} m")].into_iter().chain(cells);
            table.row(cells.chain([format!("{mean:.0}"), format!("{paper:.0}")]));
        }
        say!("{table}");
        say!();
    }
    let report = Report {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        actor_sha256: victim.sha256(),
        seed: args.seed,
        states_per_cell: args.states,
        epsilon_255: args.strength.epsilon,
        iterations: args.strength.iterations,
        goal_distance_m: args.goal_distance,
        wall_width_m: WALL_WIDTH_M,
        interrupted,
        cells,
    };
    write_json(&folder.join("table-2.json"), &report)?;
    Ok(interrupt.exit_code())
}

fn cell(args: &DeflectionArgs, victim: &FrozenActor, method: Method, gap_m: f32, bearing_deg: f32) -> Result<Cell> {
    let mut attack = StateAttack::new(Isa::detect(), victim, &args.strength.of(method))?;
    let goal = GoalRelative {
        distance_m: args.goal_distance,
        bearing_rad: bearing_deg.to_radians(),
    };
    let to_deg_s = YAW_RATE_PER_UNIT_RAD_S.to_degrees();
    let (mut clean, mut deflection) = (0.0, 0.0);
    for i in 0..args.states {
        let seed = args.seed.wrapping_add(i);
        attack.reseed(seed);
        let (mut frame, beside) = hovering_before_wall(victim, goal, gap_m, seed)?;
        let outcome = attack.attack(&mut frame.depth, &beside)?;
        clean += to_deg_s * outcome.clean[1];
        deflection += to_deg_s * outcome.yaw_change().abs();
    }
    let count = args.states as f32;
    Ok(Cell {
        method,
        gap_m,
        bearing_deg,
        clean_deg_s: clean / count,
        deflection_deg_s: deflection / count,
    })
}

/// The newest frame of a vehicle that hovers at flight height and looks straight at a wall, long enough for the actor to remember nothing
/// else; and what it remembers.
fn hovering_before_wall(
    victim: &FrozenActor,
    goal: GoalRelative,
    gap_m: f32,
    seed: u64,
) -> Result<(Box<DepthFrame>, Beside)> {
    let course = wall_ahead(gap_m);
    let (world, mut lidar) = (World::new(&course), Lidar::new(LidarConfig::default(), seed)?);
    let position_ned_m = NedVector::new(0.0, 0.0, -course.flight_height_m);
    let mut actor = victim.actor(Isa::detect())?;
    let mut frame = Box::new(DepthFrame::EMPTY);
    for sequence in 0..=SCAN_AGES[0] as u64 {
        let shot = Shot {
            stamp_ns: sequence * STEP_NS,
            sequence,
            ..Shot::at(position_ned_m, Attitude::LEVEL_NORTH)
        };
        lidar.capture(&world, &shot, &mut frame);
        actor.decide(&PilotInput {
            now_ns: shot.stamp_ns,
            depth: &frame,
            goal,
            attitude: Attitude::LEVEL_NORTH,
            velocity_m_s: HeadingVector::ZERO,
            height_m: course.flight_height_m,
        })?;
        actor.note_action(Action::HOVER);
    }
    Ok((frame, Beside::of(&actor)))
}

/// Nothing but a wall north of home, its near face at the gap.
fn wall_ahead(gap_m: f32) -> Course {
    let thickness_m = 0.2;
    let north_m = gap_m + thickness_m / 2.0;
    let mut empty = generate(Family::Validation, 1);
    empty.clear_obstacles();
    Course {
        name: "a wall ahead".to_owned(),
        family: None,
        ceiling_height_m: None,
        checkpoints: Vec::new(),
        walls: vec![Wall {
            from_m: [north_m, -WALL_WIDTH_M / 2.0],
            to_m: [north_m, WALL_WIDTH_M / 2.0],
            thickness_m,
            height_m: 4.0,
        }],
        ..empty
    }
}
