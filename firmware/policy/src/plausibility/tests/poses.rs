//! The pose in the frame header against the telemetry.

use super::*;

#[test]
fn a_pose_that_is_not_the_vehicle_s_is_implausible() {
    let far = |m: f32| move |f: &mut DepthFrame| f.header.position_ned_m = NedVector::new(m, m, m);
    found("out of this world", Reason::ImplausiblePose, 3, far(1e30));
    found("overflowing", Reason::ImplausiblePose, 3, far(f32::MAX));
    let mut flight = found("25 m off", Reason::ImplausiblePose, 3, far(25.0));
    let faults = flight.fly(30, good);
    assert!(faults[5].contains(Reason::ImplausiblePose) && faults[29].is_empty());
    found("turned by 20°", Reason::ImplausiblePose, 3, |f| {
        f.header.attitude = turned_by_exactly(f.header.attitude, 0.35);
    });
    let mut kept = None;
    found("frozen", Reason::ImplausiblePose, 12, |f| {
        f.header.position_ned_m = *kept.get_or_insert(f.header.position_ned_m)
    });
}

#[test]
fn a_position_that_jumps_in_flight_is_implausible_until_ten_poses_fit_and_on_the_ground_it_may() {
    for jump_m in [2.0, 12.0] {
        let mut flight = Flight::new();
        assert_eq!(flight.fly(20, good), [Reasons::NONE; 20]);
        // Telemetry and header agree on it, and so does every picture from there on.
        flight.position.x -= jump_m;
        let faults = flight.fly(30, good);
        let is_it = |d: &&Reasons| d.contains(Reason::ImplausiblePose);
        assert_eq!(faults.iter().take_while(is_it).count(), 10, "{jump_m} m: {faults:?}");
        assert!(faults[10..].iter().all(|d| d.is_empty()), "{jump_m} m: {faults:?}");
    }
    let mut flight = Flight::new();
    (flight.position.z, flight.speed_m_s) = (-0.12, 0.0);
    flight.fly(5, good);
    flight.position.x -= 12.0;
    assert_eq!(flight.fly(5, good), [Reasons::NONE; 5]);
}
