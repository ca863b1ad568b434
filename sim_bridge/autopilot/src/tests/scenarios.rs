//! PX4's own flight tests for multicopters (`test/mavsdk_tests` of its sources), as flights of this vehicle: what a client
//! sends, what it asks for and how long it waits are theirs.

use crate::testing::*;
use crate::tests::follow::report;
use crate::tests::plans::{MISSION, action, waypoint};

const START_MISSION: u16 = 300;
const SQUARE_M: f32 = 20.0;
const HEIGHT_M: f32 = 10.0;

/// MAVSDK's mission with "return to launch" as its last item.
pub(super) fn upload_square(b: &mut Bench) {
    let corners = [(SQUARE_M, 0.0), (SQUARE_M, SQUARE_M), (0.0, SQUARE_M)];
    let mut plan: Vec<_> = corners.map(|corner| waypoint(corner, HEIGHT_M)).to_vec();
    plan.push(action(20, [0.0; 4]));
    assert_eq!(b.upload(MISSION, &plan), MavMissionResult::MAV_MISSION_ACCEPTED);
}

pub(super) fn start_mission(b: &mut Bench) {
    assert_eq!(b.ask(START_MISSION, &[]), ACCEPTED);
}

pub(super) fn current_item(b: &Bench) -> Option<u16> {
    b.all::<MISSION_CURRENT_DATA>(API).pop().map(|m| m.seq)
}

pub(super) fn wait_until_disarmed(b: &mut Bench, limit_s: u64) {
    b.run_until(limit_s, "disarmed", |b| !b.status().armed);
    assert_eq!(b.status().landed, LandedState::OnGround);
}

fn attitude(pitch_deg: f32, thrust: f32) -> MavMessage {
    attitude_setpoint(0x07, pitch_deg, 0.0, thrust)
}

fn gps_altitude_m(b: &Bench) -> f32 {
    b.last::<GPS_RAW_INT_DATA>(API).alt_ellipsoid as f32 * 1e-3
}

#[test]
fn a_flight_by_attitude_climbs_by_gps_flies_forward_falls_and_disarms() {
    let mut b = Bench::new();
    b.run_ms(1_500);
    let start_m = gps_altitude_m(&b);
    assert!(start_m > 0.0);
    b.hold(API, SCRIPT, &attitude(0.0, 0.0), 100);
    assert_eq!(b.set_mode(API, SCRIPT, 6, 0), ACCEPTED);
    assert_eq!(b.arm(), ACCEPTED);
    for _ in 0..200 {
        b.hold(API, SCRIPT, &attitude(0.0, 0.8), 50);
        if gps_altitude_m(&b) - start_m >= 10.0 {
            break;
        }
    }
    b.hold(API, SCRIPT, &attitude(-20.0, 0.8), 3_000);
    let pitch_deg = b.view().estimate.attitude.pitch_rad().to_degrees();
    assert!((pitch_deg + 20.0).abs() < 5.0, "{pitch_deg}");
    b.hold(API, SCRIPT, &attitude(0.0, 0.4), 6_000);
    for _ in 0..2_400 {
        b.hold(API, SCRIPT, &attitude(0.0, 0.0), 50);
        if !b.status().armed {
            break;
        }
    }
    assert!(!b.status().armed, "{:?}", b.status());
    assert_eq!(b.status().landed, LandedState::OnGround);
}

#[test]
fn a_straight_mission_keeps_its_speed() {
    let mut b = Bench::new();
    // A fly-through item of MAVSDK: no stay, its own radius.
    let plan: Vec<_> = (0..5).map(|i| waypoint((SQUARE_M * i as f32, 0.0), HEIGHT_M)).collect();
    b.upload(MISSION, &plan);
    assert_eq!(b.arm(), ACCEPTED);
    start_mission(&mut b);
    b.run_until(60, "the second item", |b| current_item(b) == Some(2));
    let mut slowest_m_s = f32::INFINITY;
    while current_item(&b) == Some(2) {
        b.run_ms(100);
        slowest_m_s = slowest_m_s.min(b.velocity_m_s().horizontal_norm());
    }
    assert!(slowest_m_s > 4.0, "{slowest_m_s}");
    b.run_until(60, "the end", |b| b.status().mode == FlightMode::Hold);
    assert_eq!(b.ask(20, &[]), ACCEPTED);
    wait_until_disarmed(&mut b, 180);
}

#[test]
fn a_target_is_followed_from_every_side_though_its_reports_are_noisy() {
    // Standard normal deviates, drawn once.
    const NOISE: [f32; 12] = [0.3, -1.1, 0.6, 1.4, -0.2, -0.7, 0.1, 0.9, -1.6, 0.4, -0.5, 0.8];
    for has_velocity in [false, true] {
        let mut b = Bench::new();
        b.set_parameter("MIS_TAKEOFF_ALT", ParameterValue::Real(10.0));
        b.set_parameter("FLW_TGT_HT", ParameterValue::Real(10.0));
        b.set_parameter("FLW_TGT_DST", ParameterValue::Real(8.0));
        b.set_parameter("FLW_TGT_MAX_VEL", ParameterValue::Real(15.0));
        b.set_parameter("FLW_TGT_FA", ParameterValue::Real(0.0));
        b.take_off();
        assert_eq!(b.set_mode(API, SCRIPT, 4, 8), ACCEPTED);
        b.run_ms(1_000);
        let mut north_m = 0.0;
        let mut angle_deg: f32 = 0.0;
        for second in 0..75 {
            let turned = match second {
                5 => Some(180.0),
                20 => Some(0.0),
                35 => Some(45.0),
                55 => Some(-45.0),
                _ => None,
            };
            if let Some(turned) = turned {
                angle_deg = turned;
                b.set_parameter("FLW_TGT_FA", ParameterValue::Real(angle_deg));
            }
            if matches!(second, 15..20 | 30..35 | 45..55 | 65..75) {
                let [x, y, z] = b.position_m();
                let off_x = x - north_m - 8.0 * angle_deg.to_radians().cos();
                let off_y = y - 8.0 * angle_deg.to_radians().sin();
                assert!(off_x.abs() < 11.0 && off_y.abs() < 11.0, "{second}: {off_x} {off_y}");
                assert!((z + 10.0).abs() < 1.5, "{second}: {z}");
            }
            if second > 5 {
                north_m += 2.0;
            }
            let noise = |n: usize| NOISE[(second * 3 + n) % NOISE.len()];
            let velocity = has_velocity.then_some([2.0, 0.0, 0.0]);
            report(&mut b, (north_m + noise(0), noise(1)), velocity);
            b.run_ms(1_000);
        }
        assert_eq!(b.command_long(API, SCRIPT, 21, [f32::NAN; 7]), ACCEPTED);
        wait_until_disarmed(&mut b, 300);
    }
}
