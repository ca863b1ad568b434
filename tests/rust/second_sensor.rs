//! A second sensor that looks ahead: who hides obstacles from the depth frames is found before the vehicle touches them.

use vigil_firmware::FirmwareConfig;
use vigil_mavlink::common::OBSTACLE_DISTANCE_DATA;
use vigil_mavlink::mavlink::MessageData;
use vigil_sim::world::{Family, Outcome};
use vigil_tests::{Pair, reasons, without};
use vigil_types::{
    DEPTH_COLS, DEPTH_FULL_SCALE_M, DepthFrame, GuidanceState, Reason, Reasons, StepReport, row_elevation_rad,
};

const SEED: u64 = 4203;
/// Steps of a story: 25 s, enough to arrive.
const STEPS: usize = 500;

/// As a process between driver and firmware could: everything but the ground is shown 7.8 m farther away than it is.
fn hide(frame: &mut DepthFrame) {
    for (row, line) in frame.depth.chunks_exact_mut(DEPTH_COLS).enumerate() {
        if row_elevation_rad(row as f32) > -0.35 {
            line.iter_mut()
                .filter(|range| **range < 1.0)
                .for_each(|range| *range = (*range + 7.8 / DEPTH_FULL_SCALE_M).min(1.0));
        }
    }
    frame.seal();
}

/// The flight at its end, everything that was wrong, whoever flew, and every step. The vehicle has so many heads of a second sensor;
/// `spoil` has its hand between vehicle and firmware.
fn fly(
    heads: usize,
    change: impl FnOnce(&mut FirmwareConfig),
    spoil: impl Fn(&mut Pair, usize),
) -> (Pair, Reasons, Vec<StepReport>) {
    let mut pair = Pair::with(Family::Validation, SEED, |simulation, firmware| {
        (simulation.second_sensor_heads, firmware.second_sensor) = (heads, true);
        change(firmware);
    });
    let reports = pair.fly(STEPS, |pair, step| {
        spoil(pair, step);
        true
    });
    (pair, reasons(&reports), reports)
}

fn flew(reports: &[StepReport]) -> bool {
    reports.iter().any(|r| r.state == GuidanceState::Guided)
}

#[test]
fn true_frames_are_believed_by_one_sensor_and_by_three() {
    for heads in [1, 3] {
        let (pair, reasons, _) = fly(heads, |_| {}, |_, _| {});
        assert_eq!(pair.outcome(), Some(Outcome::Success), "{heads}");
        assert!(!reasons.contains(Reason::SensorsDisagree), "{heads}");
    }
}

#[test]
fn who_hides_obstacles_leads_the_vehicle_into_one_unless_a_second_sensor_sees_it() {
    let hides = |pair: &mut Pair, _| hide(&mut pair.frame);
    // Nobody checks the frames: as if the ground behind the obstacles were repainted too.
    let unchecked = |firmware: &mut FirmwareConfig| firmware.plausibility = false;
    let (pair, ..) = fly(1, |f| (f.second_sensor, f.plausibility) = (false, false), hides);
    assert_eq!(pair.outcome(), Some(Outcome::Collision), "nothing else finds this lie");
    let (pair, reasons, _) = fly(1, |f| f.second_sensor = false, hides);
    assert_eq!(pair.outcome(), None, "the obstacles lie beneath the ground");
    assert!(reasons.contains(Reason::BeneathGround) && pair.speed_m_s() < 0.2);
    for heads in [1, 3] {
        let (pair, reasons, _) = fly(heads, unchecked, hides);
        assert_eq!(pair.outcome(), None, "{heads}: it neither collides nor arrives");
        assert!(reasons.contains(Reason::SensorsDisagree), "{heads}");
        assert!(pair.speed_m_s() < 0.2, "{heads}: still at {} m/s", pair.speed_m_s());
    }
}

#[test]
fn a_sensor_that_was_asked_for_and_is_not_there_keeps_the_vehicle_from_flying_by_name() {
    let (_, reasons, reports) = fly(0, |_| {}, |_, _| {});
    assert!(reasons.contains(Reason::SecondSensorSilent) && !flew(&reports));
    assert_eq!(reports[reports.len() - 1].state, GuidanceState::Standby);
}

#[test]
fn a_sensor_that_falls_silent_in_flight_holds_the_vehicle_by_name() {
    let silence = |pair: &mut Pair, step| {
        if step >= 100 {
            pair.to_firmware = without(&pair.to_firmware, &[OBSTACLE_DISTANCE_DATA::ID]);
        }
    };
    let (pair, reasons, reports) = fly(1, |_| {}, silence);
    assert!(flew(&reports) && reasons.contains(Reason::SecondSensorSilent));
    let state = reports[reports.len() - 1].state;
    assert_eq!((state, pair.outcome()), (GuidanceState::Hold, None));
    assert!(pair.speed_m_s() < 0.2, "still at {} m/s", pair.speed_m_s());
}
