//! Takes a depth frame of a generated course and prints it: near is dense, nothing in reach is blank.
//!
//! `cargo run --release -p vigil-sim --example depth_frame -- 7`

use vigil_sim::world::{Family, Lidar, LidarConfig, Shot, World, generate};
use vigil_types::{Attitude, DEPTH_COLS, DEPTH_FULL_SCALE_M, DEPTH_ROWS, DepthFrame, NedVector};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let seed = std::env::args().nth(1).map_or(Ok(7), |seed| seed.parse())?;
    let course = generate(Family::Validation, seed);
    let world = World::new(&course);
    let start = course.start_ned_m();
    let position_ned_m = NedVector::new(start.x, start.y, -course.flight_height_m);
    let attitude = Attitude::LEVEL_NORTH;
    let shot = Shot::at(position_ned_m, attitude);
    let mut frame = Box::new(DepthFrame::EMPTY);
    Lidar::new(LidarConfig::default(), seed)?.capture(&world, &shot, &mut frame);

    let mut seen = 0;
    for row in (0..DEPTH_ROWS).step_by(8) {
        let line = (0..DEPTH_COLS).step_by(4).map(|col| {
            let range_m = frame.depth[row * DEPTH_COLS + col] * DEPTH_FULL_SCALE_M;
            seen += u32::from(range_m < 20.0);
            match range_m {
                0.0..4.0 => '#',
                4.0..8.0 => '+',
                8.0..20.0 => '.',
                _ => ' ',
            }
        });
        println!("{}", line.collect::<String>());
    }
    let nearest_m = frame.depth.iter().fold(1.0f32, |a, b| a.min(*b)) * DEPTH_FULL_SCALE_M;
    println!(
        "course {seed}: nearest {nearest_m:.2} m; clearance {:.2} m",
        world.clearance_m(position_ned_m)
    );
    assert!(seen > 0, "a course has something to see");
    Ok(())
}
