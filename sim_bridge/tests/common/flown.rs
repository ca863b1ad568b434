//! Flights that are nothing but their way.

use vigil_sim::world::{Course, Outcome, Referee, World};
use vigil_types::{Attitude, NedVector};

/// Flies through `points` in straight lines at `speed_m_s`, a truth every `period_ms`; the outcome and where it came.
pub fn fly(
    course: &Course,
    points: &[[f32; 3]],
    speed_m_s: f32,
    period_ms: u64,
) -> (Option<Outcome>, NedVector, Referee) {
    let (world, mut referee) = (World::new(course), Referee::new(course));
    let mut now_ms = 0;
    let mut at = NedVector::ZERO;
    for segment in points.windows(2) {
        let [from, to] = [0, 1].map(|end| NedVector::new(segment[end][0], segment[end][1], segment[end][2]));
        let way = to - from;
        let steps = (way.norm() / (speed_m_s * period_ms as f32 * 1e-3)).ceil().max(1.0);
        let velocity = way * (speed_m_s / way.norm().max(1e-6));
        for k in 0..=steps as usize {
            at = from + way * (k as f32 / steps);
            if let Some(outcome) = referee.observe(&world, now_ms * 1_000_000, at, Attitude::LEVEL_NORTH, velocity) {
                return (Some(outcome), at, referee);
            }
            now_ms += period_ms;
        }
    }
    (None, at, referee)
}
