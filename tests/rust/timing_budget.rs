//! The step's time budget on the machine at hand: 50 ms for everything from frame to setpoint.

use std::time::{Duration, Instant};
use vigil_tests::Pair;
use vigil_types::{GuidanceState, STEP_NS};
use vigil_world::Family;

#[test]
fn a_step_of_guided_flight_takes_a_small_part_of_its_period() {
    let mut pair = Pair::new(Family::Validation, 21);
    let mut times: Vec<Duration> = Vec::new();
    while pair.simulator.ending().is_none() {
        pair.simulate();
        let begun = Instant::now();
        let report = pair.decide(true);
        let took = begun.elapsed();
        if report.state == GuidanceState::Guided {
            times.push(took);
        }
    }
    times.sort();
    let at = |q: f64| times[((times.len() - 1) as f64 * q) as usize];
    println!(
        "{} guided steps: p50 {:?}, p99 {:?}, max {:?}",
        times.len(),
        at(0.5),
        at(0.99),
        at(1.0)
    );
    assert!(times.len() > 100);
    // What holds on any machine that can fly at all: the usual step fits its period with room for a slow one. Missed
    // steps and jitter depend on the machine's scheduler and are measured, not asserted (docs/results.md).
    assert!(at(0.5) < Duration::from_nanos(STEP_NS / 2));
}
