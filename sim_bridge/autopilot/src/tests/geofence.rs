//! The geofence in flight.

use crate::testing::*;
use crate::tests::plans::{FENCE, item};

fn square(command: u16, (north, east): (f32, f32), half_m: f32) -> Vec<crate::plan::PlanItem> {
    [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)]
        .map(|(n, e)| (north + n * half_m, east + e * half_m))
        .map(|vertex| item(command, [4.0, 0.0, 0.0, 0.0], vertex, 0.0))
        .to_vec()
}

fn airborne(parameters: &[(&str, f64)]) -> Bench {
    let mut config = EndpointConfig::default();
    let parameters = parameters.iter().map(|(name, value)| ((*name).to_owned(), *value));
    config.parameters.extend(parameters);
    let mut b = Bench::with(config);
    b.take_off();
    b.sent.clear();
    b
}

/// Flies under OFFBOARD until the vehicle leaves that mode.
fn fly_out(b: &mut Bench, velocity: [f32; 3]) {
    b.fly(API, SCRIPT, velocity, 100);
    b.run_until(30, "leaves OFFBOARD", |b| b.status().mode != FlightMode::Offboard);
}

fn fence_status(b: &Bench) -> Option<FENCE_STATUS_DATA> {
    b.all(API).pop()
}

#[test]
fn leaving_a_polygon_holds_by_default() {
    let mut b = airborne(&[]);
    b.upload(FENCE, &square(5001, (0.0, 0.0), 8.0));
    fly_out(&mut b, [2.0, 0.0, 0.0]);
    let [x, ..] = b.position_m();
    assert!((8.0..8.4).contains(&x), "{x}");
    assert_eq!(b.status().failsafe, Some(Failsafe::GeofenceBreached));
    assert_eq!(b.status().mode, FlightMode::Hold);
    b.assert_said("geofence breached: hold");
    assert_eq!(
        b.last::<HEARTBEAT_DATA>(API).system_status,
        MavState::MAV_STATE_CRITICAL
    );
    b.run_ms(5_000);
    assert!(b.position_m()[0] < 10.5, "{:?}", b.position_m());
    let status = fence_status(&b).expect("sent");
    assert_eq!((status.breach_status, status.breach_count), (1, 1));
    assert_eq!(status.breach_type, FenceBreach::FENCE_BREACH_BOUNDARY);
    // The pilot takes over and flies back in: the breach is over, and the next one counts again.
    b.fly(API, SCRIPT, [-2.0, 0.0, 0.0], 100);
    b.run_until(10, "back inside", |b| {
        fence_status(b).is_some_and(|s| s.breach_status == 0)
    });
    assert_eq!(b.status().mode, FlightMode::Offboard);
    b.run_until(20, "out on the other side", |b| b.status().mode == FlightMode::Hold);
    assert!(b.position_m()[0] < -8.0);
    assert_eq!(fence_status(&b).map(|s| s.breach_count), Some(2));
}

#[test]
fn entering_a_forbidden_circle_is_a_breach_too() {
    let mut b = airborne(&[]);
    b.upload(FENCE, &[item(5004, [3.0, 0.0, 0.0, 0.0], (10.0, 0.0), 0.0)]);
    fly_out(&mut b, [1.5, 0.0, 0.0]);
    let [x, ..] = b.position_m();
    assert!((7.0..7.4).contains(&x), "{x}");
}

#[test]
fn the_action_is_a_parameter() {
    for (action, mode) in [(3.0, FlightMode::Return), (5.0, FlightMode::Land)] {
        let mut b = airborne(&[("GF_ACTION", action)]);
        b.upload(FENCE, &square(5001, (0.0, 0.0), 5.0));
        fly_out(&mut b, [1.5, 0.0, 0.0]);
        assert_eq!(b.status().mode, mode);
    }
    let mut b = airborne(&[("GF_ACTION", 4.0)]);
    b.upload(FENCE, &square(5001, (0.0, 0.0), 5.0));
    b.fly(API, SCRIPT, [1.5, 0.0, 0.0], 100);
    b.run_until(20, "terminated", |b| b.status().terminated);
    // A warning, or nothing at all, lets it fly on.
    for (action, warns) in [(1.0, true), (0.0, false)] {
        let mut b = airborne(&[("GF_ACTION", action)]);
        b.upload(FENCE, &square(5001, (0.0, 0.0), 5.0));
        b.fly(API, SCRIPT, [1.5, 0.0, 0.0], 100);
        b.run_until(20, "outside", |b| b.position_m()[0] > 8.0);
        assert_eq!(b.status().mode, FlightMode::Offboard);
        assert_eq!(b.texts().iter().any(|t| t == "geofence breached: warning"), warns);
    }
}

#[test]
fn distance_and_height_can_be_limited_without_a_plan() {
    let mut b = airborne(&[("GF_MAX_VER_DIST", 5.0)]);
    fly_out(&mut b, [0.0, 0.0, -1.0]);
    // By the estimate, which is a few centimetres off.
    assert!((4.9..5.4).contains(&b.height_m()), "{}", b.height_m());
    let breach = fence_status(&b).map(|s| s.breach_type);
    assert_eq!(breach, Some(FenceBreach::FENCE_BREACH_MAXALT));
    let mut b = airborne(&[("GF_MAX_HOR_DIST", 6.0)]);
    fly_out(&mut b, [0.0, 1.5, 0.0]);
    assert!((6.0..6.4).contains(&b.position_m()[1]), "{:?}", b.position_m());
}

#[test]
fn nobody_arms_outside() {
    let mut b = Bench::new();
    b.upload(FENCE, &square(5001, (50.0, 0.0), 20.0));
    assert_eq!(b.arm(), REJECTED);
    b.assert_said("outside the geofence");
    b.upload(FENCE, &[]);
    assert_eq!(b.arm(), ACCEPTED);
    assert_eq!(b.status().landed, LandedState::OnGround);
}

#[test]
fn system_status_shows_whether_there_is_a_geofence_and_whether_it_holds() {
    let mut b = Bench::new();
    let bits = |b: &mut Bench| {
        let status = b.fresh::<SYS_STATUS_DATA>(1_100);
        let has = |flags: MavSysStatusSensor| flags.contains(MavSysStatusSensor::MAV_SYS_STATUS_GEOFENCE);
        (
            has(status.onboard_control_sensors_present),
            has(status.onboard_control_sensors_enabled),
            has(status.onboard_control_sensors_health),
        )
    };
    assert_eq!(bits(&mut b), (false, false, true));
    b.upload(FENCE, &square(5001, (0.0, 0.0), 20.0));
    assert_eq!(bits(&mut b), (true, true, true));
    b.upload(FENCE, &square(5001, (50.0, 0.0), 20.0));
    assert_eq!(bits(&mut b), (true, true, false));
}
