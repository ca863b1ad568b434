//! Circling a point.

use crate::testing::*;
use crate::tests::plans::{FENCE, item};
use core::f32::consts::{FRAC_PI_2, PI, TAU};
use vigil_types::wrap_pi;

const CENTRE: (f32, f32) = (8.0, -4.0);

fn orbit(b: &mut Bench, radius: f32, speed: f32, facing: f32, angle: f32) -> u8 {
    let (params, frame) = ([radius, speed, facing, angle], MavFrame::MAV_FRAME_GLOBAL);
    b.command_at(MavCmd::MAV_CMD_DO_ORBIT, params, frame, on_globe(CENTRE), 493.0)
}

fn off_centre(b: &Bench) -> (f32, f32) {
    let [x, y, _] = b.position_m();
    ((x - CENTRE.0).hypot(y - CENTRE.1), (y - CENTRE.1).atan2(x - CENTRE.0))
}

#[test]
fn it_circles_either_way_with_the_nose_at_the_centre() {
    for (radius, speed, facing) in [(6.0, 2.0, 0.0), (-6.0, 2.0, 5.0), (10.0, 3.0, 0.0)] {
        let mut b = Bench::airborne();
        assert_eq!(orbit(&mut b, radius, speed, facing, 0.0), ACCEPTED);
        assert_eq!(b.status().mode, FlightMode::Orbit);
        assert_eq!(b.last::<HEARTBEAT_DATA>(API).custom_mode, 0x0103_0000);
        b.run_ms(15_000);
        let mut turned = 0.0;
        let (_, mut last) = off_centre(&b);
        for _ in 0..100 {
            b.run_ms(100);
            let (distance, bearing) = off_centre(&b);
            assert!((distance - radius.abs()).abs() < 0.5, "{radius}: {distance}");
            assert!((b.height_m() - 5.0).abs() < 0.3, "{}", b.height_m());
            let nose = wrap_pi(b.yaw_rad() - bearing - PI);
            assert!(nose.abs() < 0.35, "{nose}");
            turned += wrap_pi(bearing - last);
            last = bearing;
        }
        let wanted = 10.0 * speed / radius;
        assert!((turned / wanted - 1.0).abs() < 0.12, "{radius}: {turned} of {wanted}");
        assert_eq!(b.last::<ORBIT_EXECUTION_STATUS_DATA>(API).radius, radius);
    }
}

#[test]
fn an_orbit_of_a_given_angle_ends_in_hold_and_any_mode_command_ends_it() {
    let mut b = Bench::airborne();
    assert_eq!(orbit(&mut b, 5.0, 2.0, 3.0, 0.0), ACCEPTED);
    b.run_ms(8_000);
    // Facing 5: the nose stays along the circle.
    assert_eq!(orbit(&mut b, 5.0, 2.0, 5.0, TAU), ACCEPTED);
    b.run_ms(3_000);
    let nose = wrap_pi(b.yaw_rad() - off_centre(&b).1 - FRAC_PI_2);
    assert!(nose.abs() < 0.5, "{nose}");
    b.run_until(60, "once around", |b| b.status().mode == FlightMode::Hold);
    assert_eq!(orbit(&mut b, 5.0, 2.0, 1.0, 0.0), ACCEPTED);
    b.run_ms(3_000);
    assert_eq!(b.set_mode(API, SCRIPT, 4, 6), ACCEPTED);
    assert_eq!(b.status().mode, FlightMode::Land);
}

#[test]
fn an_orbit_that_cannot_be_flown_is_refused() {
    let mut b = Bench::airborne();
    for (radius, speed, facing) in [
        (0.0, 2.0, 0.0),
        (5000.0, 2.0, 0.0),
        (f32::INFINITY, 2.0, 0.0),
        (5.0, 0.0, 0.0),
        (5.0, 900.0, 0.0),
        (5.0, 2.0, 9.0),
    ] {
        let answer = orbit(&mut b, radius, speed, facing, 0.0);
        assert_eq!(answer, DENIED, "{radius} {speed} {facing}");
    }
    b.upload(FENCE, &[item(5003, [12.0, 0.0, 0.0, 0.0], (0.0, 0.1), 0.0)]);
    assert_eq!(orbit(&mut b, 5.0, 2.0, 0.0, 0.0), REJECTED);
    assert_eq!(b.status().mode, FlightMode::Hold);
    let mut b = Bench::new();
    assert_eq!(orbit(&mut b, 5.0, 2.0, 0.0, 0.0), REJECTED);
}
