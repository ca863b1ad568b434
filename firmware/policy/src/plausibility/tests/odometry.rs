//! What a reported velocity is off by, by the pictures.

use super::*;

/// Steps of a flight whose velocity is reported with this error; what the pictures say of it at the end.
fn seen_error_m_s(flight: &mut Flight, steps: usize, error_m_s: NedVector) -> NedVector {
    for _ in 0..steps {
        flight.look();
        let kinematics = flight.telemetry.kinematics.as_mut().unwrap();
        kinematics.velocity_ned_m_s = kinematics.velocity_ned_m_s + error_m_s;
        assert_eq!(flight.check(), Reasons::NONE);
    }
    flight.plausibility.velocity_error_m_s()
}

#[test]
fn a_velocity_that_is_off_for_seconds_is_found_by_the_pictures_within_half_a_second() {
    let mut flight = Flight::new();
    flight.plausibility.note_estimate(0.0, false);
    // Now to one side, now to the other, and at the end right again; what is below 0.03 m/s does not count.
    for (north, east) in [(0.1, -0.25), (-0.1, 0.25), (0.2, 0.2), (0.0, 0.0)] {
        let error_m_s = NedVector::new(north, east, 0.0);
        let seen_m_s = seen_error_m_s(&mut flight, 12, error_m_s);
        assert!((seen_m_s - error_m_s).norm() < 0.09, "{seen_m_s:?} of {error_m_s:?}");
    }
}

#[test]
fn an_estimate_that_agrees_with_itself_is_believed_and_so_is_one_in_a_mission() {
    let error_m_s = NedVector::new(0.1, -0.25, 0.0);
    let mut flight = Flight::new();
    assert_eq!(seen_error_m_s(&mut flight, 30, error_m_s), NedVector::ZERO);
    flight.plausibility.note_estimate(0.0, false);
    assert!(seen_error_m_s(&mut flight, 12, error_m_s).norm() > 0.2);
    for _ in 0..2 {
        flight.look();
        flight.telemetry.heartbeat.as_mut().unwrap().mode = VehicleMode::Mission;
        flight.check();
    }
    assert_eq!(flight.plausibility.velocity_error_m_s(), NedVector::ZERO);
}

/// Who holds the frames can make the vehicle drift, but slowly.
#[test]
fn who_alters_frames_can_say_little_of_the_velocity() {
    let mut flight = Flight::new();
    flight.plausibility.note_estimate(0.0, false);
    let mut factor = 1.0;
    let mut most_m_s = 0.0_f32;
    for _ in 0..60 {
        factor *= 1.01;
        flight.fly(1, |frame| {
            frame
                .depth
                .iter_mut()
                .for_each(|depth| *depth = (*depth * factor).min(1.0))
        });
        most_m_s = most_m_s.max(flight.plausibility.velocity_error_m_s().norm());
    }
    assert!((0.1..=0.4001).contains(&most_m_s), "{most_m_s}");
}
