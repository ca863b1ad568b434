//! The smallest driver of a depth sensor: a wall 2.5 m ahead, 20 times a second. Listen to it with `vigil sensor check`.
//!
//! `cargo run --release -p vigil-io --example depth_publisher -- [INSTANCE] [SECONDS] [KEY_FILE]`

use std::path::Path;
use vigil_io::clock::{monotonic_ns, sleep_until};
use vigil_io::key_file::frame_key;
use vigil_io::shared_memory::{DEPTH_TOPIC, Domain, FramePublisher};
use vigil_types::{Attitude, DEPTH_FULL_SCALE_M, NedVector, STEP_NS};

const SENSOR_ID: u32 = 1;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |i: usize, usual| arguments.get(i).map_or(Ok(usual), |text| text.parse());
    let (instance, seconds) = (number(0, 0)?, number(1, 1)?);
    let key = arguments
        .get(2)
        .map(|path| frame_key(Path::new(path), SENSOR_ID))
        .transpose()?;
    let domain = Domain::open(instance, "driver")?;
    let mut publisher = FramePublisher::create(&domain, DEPTH_TOPIC)?;
    let mut due_ns = monotonic_ns();
    for sequence in 0..u64::from(20 * seconds) {
        sleep_until(due_ns);
        publisher.publish_with(|frame| {
            for (i, pixel) in frame.depth.iter_mut().enumerate() {
                // A real sensor's noise; a picture that never changes is a frozen sensor's.
                let noise_m = ((i as u64 * 7919 + sequence * 104_729) % 41) as f32 * 0.0005 - 0.01;
                *pixel = (2.5 + noise_m) / DEPTH_FULL_SCALE_M;
            }
            frame.header.stamp_ns = monotonic_ns();
            frame.header.sequence = sequence;
            frame.header.sensor_id = SENSOR_ID;
            frame.header.position_ned_m = NedVector::new(0.0, 0.0, -1.5);
            frame.header.attitude = Attitude::LEVEL_NORTH;
            match &key {
                Some(key) => frame.authenticate(key),
                None => frame.seal(),
            }
        })?;
        due_ns += STEP_NS;
    }
    println!("{} frames published on instance {instance}", 20 * seconds);
    Ok(())
}
