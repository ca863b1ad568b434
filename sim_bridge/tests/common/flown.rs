//! Flights that are nothing but their way.

use vigil_sim::world::{Course, Outcome, Referee, World};
use vigil_types::{Attitude, NedVector};

/// How a flight along points ends, each of them north, east and height.
pub fn flown(course: &Course, way: &[[f32; 3]]) -> Outcome {
    let (world, mut referee) = (World::new(course), Referee::new(course));
    let places = way.windows(2).flat_map(|ends| {
        (0..=100_u8).map(|step| {
            let [n, e, height] = [0, 1, 2].map(|k| ends[0][k] + f32::from(step) / 100.0 * (ends[1][k] - ends[0][k]));
            NedVector::new(n, e, -height)
        })
    });
    let mut places = (1..).map(|k| k * 10_000_000).zip(places);
    places
        .find_map(|(at_ns, place)| referee.observe(&world, at_ns, place, Attitude::LEVEL_NORTH, NedVector::ZERO))
        .expect("an end")
}
