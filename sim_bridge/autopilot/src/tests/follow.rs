//! Follow-me.

use crate::geo;
use crate::testing::*;

/// A report as MAVSDK sends it, once a second.
pub(super) fn report(b: &mut Bench, place: (f32, f32), velocity: Option<[f32; 3]>) {
    let (lat, lon) = on_globe(place);
    let message = message!(
        FOLLOW_TARGET,
        lat = geo::deg_e7(lat),
        lon = geo::deg_e7(lon),
        alt = 488.0,
        vel = velocity.unwrap_or_default(),
        est_capabilities = if velocity.is_some() { 0b11 } else { 0b01 }
    );
    b.send(API, SCRIPT, &message);
}

/// In the air, behind a target by 5 m once there is one.
fn following() -> Bench {
    let mut b = Bench::airborne();
    b.set_parameter("FLW_TGT_DST", ParameterValue::Real(5.0));
    assert_eq!(b.set_mode(API, SCRIPT, 4, 8), ACCEPTED);
    b
}

/// Walks east at 1.5 m/s, reported so often, later perhaps with a velocity; it is then where it should be.
fn walk(b: &mut Bench, reports: u32, every_ms: u64, has_velocity: impl Fn(u32) -> bool) {
    let mut east = 10.0;
    for i in 0..reports {
        report(b, (6.0, east), has_velocity(i).then_some([0.0, 1.5, 0.0]));
        b.run_ms(every_ms);
        east += 1.5e-3 * every_ms as f32;
    }
    let [x, y, _] = b.position_m();
    let is_behind = (x - 6.0).abs() < 0.6 && (y - (east - 5.0)).abs() < 1.0;
    assert!(is_behind, "{x} {y} of {east}");
}

#[test]
fn it_keeps_its_place_behind_who_walks_and_waits_where_the_reports_end() {
    let mut b = following();
    b.set_parameter("FLW_TGT_HT", ParameterValue::Real(4.0));
    b.run_ms(2_000);
    assert_eq!(b.status().mode, FlightMode::Follow);
    assert!(b.position_m()[0].abs() < 0.2, "waits for the first report");
    walk(&mut b, 25, 1_000, |second| second > 12);
    assert!((b.height_m() - 4.0).abs() < 0.3, "{}", b.height_m());
    let nose = b.yaw_rad();
    assert!((nose - core::f32::consts::FRAC_PI_2).abs() < 0.2, "looks at it: {nose}");
    b.run_ms(12_000);
    let stopped = b.position_m();
    b.run_ms(3_000);
    assert!((b.position_m()[1] - stopped[1]).abs() < 0.1);
    assert_eq!(b.status().mode, FlightMode::Follow);
}

#[test]
fn a_target_that_is_nowhere_near_is_not_followed() {
    let mut b = Bench::airborne();
    assert_eq!(b.set_mode(API, SCRIPT, 4, 8), ACCEPTED);
    report(&mut b, (30_000.0, 0.0), None);
    report(&mut b, (5.0, 0.0), Some([f32::NAN, 0.0, 0.0]));
    b.run_ms(3_000);
    assert!(b.position_m()[0].abs() < 0.2);
    assert_eq!(b.status().refusals.setpoint_value, 2);
    b.run_ms(3_000);
    report(&mut b, (5.0, 0.0), Some([0.0, f32::INFINITY, 0.0]));
    b.run_ms(6_000);
    // What MAVSDK makes of a place that is not a number, with a velocity.
    for _ in 0..15 {
        let (lat, lon, alt, vel) = (i32::MIN, i32::MIN, f32::NAN, [2.0, 1.0, 0.5]);
        let message = message!(FOLLOW_TARGET, lat, lon, alt, vel, est_capabilities = 0b10);
        b.send(API, SCRIPT, &message);
        b.run_ms(300);
    }
    assert!(b.position_m()[0].abs() < 0.2);
    // Who waits for it to follow hears why it does not, once in a while.
    let texts = b.texts().into_iter();
    let reasons: Vec<String> = texts
        .filter_map(|text| Some(text.strip_prefix("target of 245/190: ")?.to_owned()))
        .collect();
    let wanted = "too far from home; vel is NaN or absurd; lat, lon or alt is no place";
    assert_eq!(reasons.join("; "), wanted);
}

/// Between reports milliseconds apart a centimetre of their resolution looks like metres per second.
#[test]
fn reports_that_come_thick_and_fast_of_a_target_that_stands_do_not_make_it_run() {
    for every_ms in [5, 20, 50] {
        let mut b = following();
        let mut farthest_m = 0.0_f32;
        for i in 0..20_000 / every_ms {
            // A receiver's noise of some centimetres; two reports in one datagram now and then.
            let jitter_m = 0.03 * (i as f32 * 1.7).sin();
            report(&mut b, (10.0 + jitter_m, jitter_m), None);
            if i % 7 == 0 {
                report(&mut b, (10.0, 0.0), None);
            }
            b.run_ms(every_ms);
            let [x, y, _] = b.position_m();
            farthest_m = farthest_m.max((x - 10.0).hypot(y));
        }
        let [x, y, _] = b.position_m();
        assert!(farthest_m < 10.5, "every {every_ms} ms: {farthest_m} m away");
        assert!(((x - 10.0).hypot(y) - 5.0).abs() < 0.6, "every {every_ms} ms: {x} {y}");
    }
    // Who walks is followed as well as by slow reports.
    walk(&mut following(), 1_000, 20, |_| false);
}
