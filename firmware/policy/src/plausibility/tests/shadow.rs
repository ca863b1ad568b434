//! Who shows everything but the ground farther away, and who only looks as if.

use super::*;

/// Shows everything above 20° below the horizon farther away, metres.
fn recede(by_m: f32) -> impl FnMut(&mut DepthFrame) {
    move |frame| {
        for (pixel, depth) in frame.depth.iter_mut().enumerate() {
            if row_elevation_rad((pixel / DEPTH_COLS) as f32) > -0.349 && *depth < 1.0 {
                *depth = (*depth + by_m / DEPTH_FULL_SCALE_M).min(1.0);
            }
        }
    }
}

/// Walls around, nearer than the ground could be seen.
fn walled_in(frame: &mut DepthFrame) {
    frame.depth.fill(1.2 / DEPTH_FULL_SCALE_M);
}

/// How many steps a flight lasts until something lies beneath the ground.
fn steps_until_beneath(flight: &mut Flight, steps: usize, spoil: impl FnMut(&mut DepthFrame)) -> Option<usize> {
    let faults = flight.fly(steps, spoil);
    faults.iter().position(|faults| faults.contains(Reason::BeneathGround))
}

#[test]
fn who_shows_everything_but_the_ground_farther_away_is_found_within_half_a_second() {
    for by_m in [4.0, 7.8, 12.0] {
        let mut flight = Flight::new();
        assert_eq!(steps_until_beneath(&mut flight, 40, recede(by_m)), Some(7), "{by_m} m");
        assert_eq!(flight.plausibility.shadow.is_beneath, Some(true));
    }
    // Growing by 8 m in five seconds: found before it has come to 4 m.
    let mut by_m = 0.0;
    let found = steps_until_beneath(&mut Flight::new(), 100, |frame| {
        by_m += 0.08;
        recede(by_m)(frame);
    });
    assert!(found.is_some_and(|steps| steps < 50), "{found:?}");
}

#[test]
fn a_picture_beneath_the_ground_holds_until_forty_agree_and_the_second_time_until_the_motors_are_off() {
    let mut flight = Flight::new();
    flight.fly(12, recede(7.8));
    let faults = flight.fly(60, good);
    let is_it = |d: &&Reasons| d.contains(Reason::BeneathGround);
    assert_eq!(faults.iter().take_while(is_it).count(), 39, "{faults:?}");
    assert_eq!(flight.plausibility.shadow.is_beneath, Some(false));
    flight.fly(12, recede(7.8));
    let faults = flight.fly(80, good);
    assert!(faults.iter().all(|faults| faults.contains(Reason::BeneathGround)));
    flight.telemetry.heartbeat.as_mut().unwrap().armed = false;
    assert_eq!(flight.check(), Reasons::NONE);
}

#[test]
fn where_no_ground_is_seen_nothing_is_known_and_what_was_raised_stays() {
    let mut flight = Flight::new();
    flight.fly(10, walled_in);
    assert_eq!(flight.plausibility.shadow.is_beneath, None);
    let mut flight = Flight::new();
    flight.fly(12, recede(7.8));
    let faults = flight.fly(80, walled_in);
    assert!(faults.iter().all(|faults| faults.contains(Reason::BeneathGround)));
    flight.telemetry.heartbeat.as_mut().unwrap().mode = VehicleMode::Mission;
    // A mission is not held for it, and what flies by setpoints again is.
    assert!(!flight.check().contains(Reason::BeneathGround));
    assert_eq!(steps_until_beneath(&mut flight, 1, walled_in), Some(0));
}

#[test]
fn a_height_and_a_tilt_that_are_estimated_wrong_and_a_slope_convict_nobody() {
    // What falls away ahead by 5 % shows as the level ground does to a sensor that looks up as much more.
    for (height_error_m, roll_rad, slope) in [(0.4, 0.0, 0.0), (-0.8, 0.0, 0.0), (0.0, 0.03, 0.0), (0.0, 0.0, 0.05)] {
        let mut flight = Flight::new();
        flight.speed_m_s = 0.0;
        for _ in 0..40 {
            flight.look();
            flight.frame.header.attitude = Attitude::from_euler_rad(roll_rad, -slope, flight.yaw_rad);
            flight.misplace(NedVector::new(0.0, 0.0, -height_error_m));
            let is_raised = flight.check().contains(Reason::BeneathGround);
            assert!(!is_raised, "{height_error_m} m, {roll_rad}, {slope}");
        }
    }
}
