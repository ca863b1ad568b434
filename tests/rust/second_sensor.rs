//! A second sensor that looks ahead: who hides obstacles from the depth frames is found before the vehicle touches them.

use vigil_firmware::FirmwareConfig;
use vigil_mavlink::common::OBSTACLE_DISTANCE_DATA;
use vigil_mavlink::mavlink::MessageData;
use vigil_sim::world::{Family, Outcome, generate};
use vigil_tests::{Pair, airborne, without};
use vigil_types::{DEPTH_COLS, DEPTH_FULL_SCALE_M, DepthFrame, GuidanceState, Reason, Reasons, row_elevation_rad};

const SEED: u64 = 4203;
/// Steps of a story: 25 s, enough to arrive.
const STEPS: usize = 500;

#[derive(Clone, Copy)]
struct Story {
    /// Sensors that the vehicle has.
    heads: usize,
    /// The firmware asks for them.
    asked_for: bool,
    /// Every obstacle is shown 7.8 m farther away than it is.
    hides: bool,
    /// Nobody checks the frames: as if the ground behind the obstacles were repainted too.
    unchecked: bool,
    /// Nothing of the second sensor arrives from this step on.
    silent_from: usize,
}

const SEEING: Story = Story {
    heads: 1,
    asked_for: true,
    hides: false,
    unchecked: false,
    silent_from: usize::MAX,
};

struct End {
    /// Everything that was wrong, whoever flew.
    reasons: Reasons,
    /// It was guided at some time.
    flew: bool,
    state: GuidanceState,
    speed_m_s: f32,
    outcome: Option<Outcome>,
}

/// As a process between driver and firmware could: everything but the ground is shown farther away.
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

fn fly(story: Story) -> End {
    let mut config = airborne(generate(Family::Validation, SEED), SEED);
    config.second_sensor_heads = story.heads;
    let mut firmware = FirmwareConfig::to_goal(config.course.goal_ned_m());
    firmware.second_sensor = story.asked_for;
    firmware.plausibility = !story.unchecked;
    let mut pair = Pair::of(&config, &firmware);
    let reports = pair.fly(STEPS, |pair, step| {
        if story.hides {
            hide(&mut pair.frame);
        }
        if step >= story.silent_from {
            pair.to_firmware = without(&pair.to_firmware, &[OBSTACLE_DISTANCE_DATA::ID]);
        }
        true
    });
    End {
        reasons: reports.iter().fold(Reasons::NONE, |all, r| all.union(r.reasons)),
        flew: reports.iter().any(|r| r.state == GuidanceState::Guided),
        state: reports[reports.len() - 1].state,
        speed_m_s: pair.speed_m_s(),
        outcome: pair.outcome(),
    }
}

#[test]
fn true_frames_are_believed_by_one_sensor_and_by_three() {
    for heads in [1, 3] {
        let end = fly(Story { heads, ..SEEING });
        assert_eq!(end.outcome, Some(Outcome::Success), "{heads}");
        assert!(!end.reasons.contains(Reason::SensorsDisagree), "{heads}");
    }
}

#[test]
fn who_hides_obstacles_leads_the_vehicle_into_one_unless_a_second_sensor_sees_it() {
    let hidden = Story {
        hides: true,
        unchecked: true,
        ..SEEING
    };
    let alone = Story {
        asked_for: false,
        ..hidden
    };
    assert_eq!(
        fly(alone).outcome,
        Some(Outcome::Collision),
        "nothing else finds this lie"
    );
    let end = fly(Story {
        unchecked: false,
        ..alone
    });
    assert_eq!(end.outcome, None, "the obstacles lie beneath the ground");
    assert!(end.reasons.contains(Reason::BeneathGround) && end.speed_m_s < 0.2);
    for heads in [1, 3] {
        let end = fly(Story { heads, ..hidden });
        assert_eq!(end.outcome, None, "{heads}: it neither collides nor arrives");
        assert!(end.reasons.contains(Reason::SensorsDisagree), "{heads}");
        assert!(end.speed_m_s < 0.2, "{heads}: still at {} m/s", end.speed_m_s);
    }
}

#[test]
fn a_sensor_that_was_asked_for_and_is_not_there_keeps_the_vehicle_from_flying_by_name() {
    let end = fly(Story { heads: 0, ..SEEING });
    assert!(end.reasons.contains(Reason::SecondSensorSilent) && !end.flew);
    assert_eq!(end.state, GuidanceState::Standby);
}

#[test]
fn a_sensor_that_falls_silent_in_flight_holds_the_vehicle_by_name() {
    let end = fly(Story {
        silent_from: 100,
        ..SEEING
    });
    assert!(end.flew && end.reasons.contains(Reason::SecondSensorSilent));
    assert_eq!((end.state, end.outcome), (GuidanceState::Hold, None));
    assert!(end.speed_m_s < 0.2, "still at {} m/s", end.speed_m_s);
}
