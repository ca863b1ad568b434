//! Who shows what stands there farther away and leaves its edges where they are, and who only looks as if.

use super::*;

/// Shows everything but the ground farther away, metres, and the ground before it.
fn repaint(by_m: f32) -> impl FnMut(&mut DepthFrame) {
    move |frame| {
        let header = frame.header;
        for (pixel, depth) in frame.depth.iter_mut().enumerate() {
            let falls = header.attitude.to_ned(ray(pixel, 1.0)).z;
            let ground = match falls > 0.0 {
                true => -header.position_ned_m.z / (falls * DEPTH_FULL_SCALE_M),
                false => f32::INFINITY,
            };
            if *depth < 0.9 * ground {
                *depth = (*depth + by_m / DEPTH_FULL_SCALE_M).min(ground).min(1.0);
            }
        }
    }
}

/// Steps until the picture is inconsistent, and whether it ever lay beneath the ground.
fn found(flight: &mut Flight, steps: usize, spoil: impl FnMut(&mut DepthFrame)) -> (Option<usize>, bool) {
    let faults = flight.fly(steps, spoil);
    let at = |reason| faults.iter().position(|faults: &Reasons| faults.contains(reason));
    (at(Reason::InconsistentPicture), at(Reason::BeneathGround).is_some())
}

#[test]
fn who_repaints_the_ground_before_what_is_shown_farther_away_is_found_by_the_edges_that_do_not_move_so() {
    for by_m in [2.0, 4.0, 7.8] {
        let mut flight = Flight::new();
        let (steps, beneath) = found(&mut flight, 200, repaint(by_m));
        assert!(
            steps.is_some_and(|steps| steps < 150) && !beneath,
            "{by_m} m: {steps:?}"
        );
        // It stays until the motors are off, also when the attack becomes one of moved regions.
        flight.fly(10, |frame| {
            for (pixel, depth) in frame.depth.iter_mut().enumerate() {
                let region = pixel / DEPTH_COLS / 16 + pixel % DEPTH_COLS / 32;
                *depth = [0.05, 0.08][region % 2];
            }
        });
        assert!(flight.plausibility.restored().is_some() && flight.plausibility.parallax.is_raised);
        let faults = flight.fly(60, good);
        assert!(faults.iter().all(|faults| faults.contains(Reason::InconsistentPicture)));
        flight.telemetry.heartbeat.as_mut().unwrap().armed = false;
        assert_eq!(flight.check(), Reasons::NONE);
    }
}

#[test]
fn what_is_wiped_from_a_picture_in_flight_is_missed_at_once_and_known_when_it_comes_back() {
    let mut wipe = repaint(DEPTH_FULL_SCALE_M);
    let mut flight = Flight::new();
    assert_eq!(flight.first_fault(40, good), None);
    // It stops within a metre.
    assert_eq!(flight.fly(10, &mut wipe)[0], Reasons::of(Reason::InconsistentPicture));
    flight.speed_m_s = 0.0;
    let held = flight.fly(60, &mut wipe);
    assert!(held.iter().all(|d| d.contains(Reason::InconsistentPicture)));
    let faults = flight.fly(40, good);
    assert!(faults[39].is_empty(), "{:?}", faults[39]);
}

#[test]
fn true_ranges_odometry_of_a_tenth_too_much_and_a_hall_without_edges_convict_nobody() {
    let mut flight = Flight::new();
    assert_eq!(flight.fly(100, good), [Reasons::NONE; 100]);
    assert!(flight.plausibility.parallax.sees_both_sides());
    assert_eq!(flight.fly(200, good), [Reasons::NONE; 200]);
    let mut flight = Flight::new();
    for _ in 0..300 {
        flight.look();
        flight.misplace(NedVector::new(0.1 * flight.position.x, 0.0, 0.0));
        flight.check();
        assert!(!flight.plausibility.parallax.is_raised);
    }
    let mut flight = Flight::new();
    flight.fly(60, |frame| frame.depth.fill(0.05));
    assert!(!flight.plausibility.parallax.is_raised && !flight.plausibility.parallax.sees_both_sides());
}
