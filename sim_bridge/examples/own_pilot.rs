//! A pilot of your own on our courses: turns to the goal, away from what is near, and slows down before it.
//!
//! `cargo run --release -p vigil-sim --example own_pilot -- 7`

use vigil_sim::environment::Environment;
use vigil_sim::vehicle::Wind;
use vigil_sim::world::{Family, generate};
use vigil_types::{
    DEPTH_COLS, DEPTH_FULL_SCALE_M, DEPTH_ROWS, DepthFrame, GoalRelative, HeadingVector, VelocitySetpoint,
};

/// Nearest range in each of the frame's columns, over the rows about the horizon, metres.
fn nearest_m(frame: &DepthFrame) -> Vec<f32> {
    let rows = DEPTH_ROWS / 2 - 6..DEPTH_ROWS / 2 + 2;
    let nearest = |col: usize| {
        rows.clone()
            .map(|row| frame.depth[row * DEPTH_COLS + col])
            .fold(1.0, f32::min)
    };
    (0..DEPTH_COLS).map(|col| nearest(col) * DEPTH_FULL_SCALE_M).collect()
}

/// The decision, 20 times a second.
fn decide(frame: &DepthFrame, goal: GoalRelative) -> VelocitySetpoint {
    let near = nearest_m(frame);
    let half = DEPTH_COLS / 2;
    let push = |range_m: &f32| (3.0 - range_m).max(0.0);
    let (left, right): (f32, f32) = (near[..half].iter().map(push).sum(), near[half..].iter().map(push).sum());
    let ahead_m = near[half - 24..half + 24].iter().copied().fold(f32::INFINITY, f32::min);
    VelocitySetpoint {
        velocity_m_s: HeadingVector::new((0.5 * (ahead_m - 0.8)).clamp(0.0, 1.2), 0.0, 0.0),
        yaw_rate_rad_s: (goal.bearing_rad + 0.02 * (left - right)).clamp(-0.8, 0.8),
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let seed = std::env::args().nth(1).map_or(Ok(7), |seed| seed.parse())?;
    let mut environment = Environment::new(&generate(Family::Training, seed), Wind::default(), seed)?;
    let outcome = loop {
        let setpoint = decide(environment.frame(), environment.goal_relative());
        if let Some(outcome) = environment.advance(setpoint) {
            break outcome;
        }
    };
    let (time_s, left_m) = (environment.time_s(), environment.goal_distance_m());
    println!("course {seed}: {outcome} after {time_s:.1} s, {left_m:.1} m from the goal");
    Ok(())
}
