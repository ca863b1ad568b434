//! Missions in flight.

use crate::plan::PlanItem;
use crate::testing::*;
use crate::tests::plans::{FENCE, MISSION, action, item, waypoint};

const TAKEN: MavMissionResult = MavMissionResult::MAV_MISSION_ACCEPTED;

fn start(b: &mut Bench) -> u8 {
    b.set_mode(API, SCRIPT, 4, 4)
}

/// In the air, on a mission of these items.
fn flying(plan: &[PlanItem]) -> Bench {
    let mut b = Bench::airborne();
    b.upload(MISSION, plan);
    assert_eq!(start(&mut b), ACCEPTED);
    b
}

/// The items that were sent as reached, each once, in order.
fn reached(b: &Bench) -> Vec<u16> {
    let messages = b.all::<MISSION_ITEM_REACHED_DATA>(API).into_iter();
    let mut reached: Vec<u16> = messages.map(|r| r.seq).collect();
    reached.dedup();
    reached
}

fn progress(b: &Bench) -> (u16, MissionState) {
    (current(b).seq, current(b).mission_state)
}

fn current(b: &Bench) -> MISSION_CURRENT_DATA {
    b.last(API)
}

#[test]
fn a_whole_mission_from_the_ground_to_the_ground() {
    let mut b = Bench::new();
    let place = (12.0, 8.0);
    let plan = [
        item(22, [0.0, 0.0, 0.0, f32::NAN], (0.0, 0.0), 4.0),
        waypoint((12.0, 0.0), 4.0),
        item(19, [3.0, 0.0, 0.0, f32::NAN], place, 5.0),
        item(21, [0.0, 0.0, 0.0, f32::NAN], place, 0.0),
    ];
    b.upload(MISSION, &plan);
    assert_eq!(start(&mut b), ACCEPTED);
    assert_eq!(b.status().mode, FlightMode::Mission);
    b.run_ms(1_000);
    assert_eq!(b.status().landed, LandedState::OnGround, "not armed yet");
    assert_eq!(b.arm(), ACCEPTED);
    b.run_until(3, "leaves the ground", |b| b.status().landed == LandedState::TakingOff);
    b.run_until(15, "take-off", |b| reached(b) == [0]);
    assert!(b.is_at((0.0, 0.0), 4.0, 1.0), "{:?}", b.position_m());
    assert_eq!(progress(&b), (1, MissionState::MISSION_STATE_ACTIVE));
    b.run_until(20, "first waypoint", |b| reached(b) == [0, 1]);
    assert!(b.is_at((12.0, 0.0), 4.0, 1.1), "{:?}", b.position_m());
    assert!(b.yaw_rad().abs() < 0.1, "the nose was ahead");
    b.run_until(20, "loiter", |b| b.is_at(place, 5.0, 0.3));
    b.run_ms(1_000);
    assert_eq!(reached(&b), [0, 1], "it stays for three seconds");
    b.run_until(5, "loitered", |b| reached(b) == [0, 1, 2]);
    b.run_until(30, "landed", |b| b.status().landed == LandedState::OnGround);
    b.run_until(4, "disarmed", |b| !b.status().armed);
    assert!(b.is_at(place, 0.0, 0.7), "{:?}", b.position_m());
    b.run_ms(1_100);
    assert_eq!(reached(&b), [0, 1, 2, 3]);
    assert_eq!(current(&b).mission_state, MissionState::MISSION_STATE_COMPLETE);
    assert_eq!(b.status().mode, FlightMode::Hold);
}

#[test]
fn without_a_take_off_item_it_climbs_before_it_travels() {
    let mut b = Bench::new();
    // MAV_CMD_MISSION_START arms, too.
    let params = [0.0; 7];
    assert_eq!(b.command_long(GCS, STATION, 300, params), DENIED);
    b.assert_said("mission denied: no mission");
    b.upload(MISSION, &[waypoint((10.0, 0.0), 5.0)]);
    assert_eq!(b.ask(300, &[9.0]), DENIED);
    b.assert_said("mission denied: there is no item 9");
    assert_eq!(b.command_long(GCS, STATION, 300, params), ACCEPTED);
    assert!(b.status().armed);
    b.run_until(15, "height", |b| b.height_m() > 4.5);
    assert!(b.position_m()[0].abs() < 0.5, "{:?}", b.position_m());
    b.run_until(20, "finished", |b| b.status().mode == FlightMode::Hold);
    b.run_ms(4_000);
    assert!(b.is_at((10.0, 0.0), 5.0, 0.3), "holds there: {:?}", b.position_m());
    assert_eq!(current(&b).mission_state, MissionState::MISSION_STATE_COMPLETE);
    // Once more, from the first item.
    assert_eq!(start(&mut b), ACCEPTED);
    assert_eq!(current(&b).mission_state, MissionState::MISSION_STATE_ACTIVE);
}

#[test]
fn delay_speed_and_jump_do_what_they_say() {
    let mut b = flying(&[
        action(178, [1.0, 1.5, -1.0, 0.0]),
        waypoint((20.0, 0.0), 3.0),
        action(93, [4.0, -1.0, -1.0, -1.0]),
        action(177, [1.0, 1.0, 0.0, 0.0]),
        // A camera command: there is no camera.
        action(2000, [0.0, 1.0, 1.0, 0.0]),
    ]);
    b.run_ms(6_000);
    let speed = b.velocity_m_s().horizontal_norm();
    assert!((speed - 1.5).abs() < 0.2, "{speed}");
    b.run_until(20, "there", |b| reached(b) == [0, 1]);
    let there_ns = b.now_ns;
    b.run_until(10, "waited", |b| reached(b) == [0, 1, 2]);
    let waited_s = (b.now_ns - there_ns) as f64 * 1e-9;
    assert!((4.0..4.2).contains(&waited_s), "{waited_s}");
    b.run_until(10, "jumped once, finished", |b| b.status().mode == FlightMode::Hold);
    assert_eq!(reached(&b), [0, 1, 2, 1, 2, 4]);
}

#[test]
fn a_loop_of_items_that_take_no_time_does_not_flood_the_links() {
    let endless = [action(178, [1.0, 3.0, -1.0, 0.0]), action(177, [0.0, -1.0, 0.0, 0.0])];
    let mut b = flying(&endless);
    b.sent.clear();
    b.run_ms(2_000);
    assert!(b.count(API, MISSION_CURRENT_DATA::ID) <= 45);
    assert_eq!(b.status().mode, FlightMode::Mission);
    assert!((b.height_m() - 3.0).abs() < 0.3, "it holds meanwhile");
}

#[test]
fn the_current_item_can_be_chosen() {
    let mut b = Bench::airborne();
    let places = [((30.0, 0.0), 3.0), ((0.0, 10.0), 3.0), ((0.0, 10.0), 5.0)];
    let mut plan = places.map(|(place, height_m)| waypoint(place, height_m)).to_vec();
    plan.push(action(177, [0.0, 1.0, 0.0, 0.0]));
    b.upload(MISSION, &plan);
    b.sent.clear();
    b.tell(message!(MISSION_SET_CURRENT, seq = 1));
    assert_eq!(current(&b).seq, 1, "sent at once");
    b.tell(message!(MISSION_SET_CURRENT, seq = 9));
    assert_eq!(current(&b).seq, 1);
    b.assert_said("no mission item 9");
    assert_eq!(start(&mut b), ACCEPTED);
    b.run_until(15, "second waypoint", |b| reached(b) == [1]);
    // In flight: back to the first, by a jump that is made the current item, as in PX4's own flight test.
    b.tell(message!(MISSION_SET_CURRENT, seq = 3));
    b.run_ms(1_000);
    assert_eq!(current(&b).seq, 0, "jumped");
    b.run_until(30, "first waypoint", |b| b.position_m()[0] > 28.0);
    b.tell(message!(MISSION_SET_CURRENT, seq = 2));
    b.run_until(30, "third waypoint", |b| b.position_m()[0] < 2.0 && b.height_m() > 4.0);
}

#[test]
fn there_is_no_mission_to_start_without_items_or_outside_the_geofence() {
    let mut b = Bench::airborne();
    assert_eq!(start(&mut b), REJECTED);
    b.assert_said("mission denied: no mission");
    assert_eq!(b.status().mode, FlightMode::Hold);
    b.upload(MISSION, &[waypoint((5.0, 0.0), 3.0), waypoint((60.0, 0.0), 3.0)]);
    b.upload(FENCE, &[item(5003, [50.0, 0.0, 0.0, 0.0], (0.0, 0.1), 0.0)]);
    assert_eq!(start(&mut b), REJECTED);
    b.assert_said("item 1 is outside");
    assert_eq!(b.status().mode, FlightMode::Hold);
}

#[test]
fn a_mission_that_is_cleared_or_replaced_in_flight_is_not_flown_on() {
    let mut b = flying(&[waypoint((60.0, 0.0), 3.0)]);
    b.run_ms(3_000);
    b.upload(MISSION, &[waypoint((0.0, 15.0), 4.0)]);
    assert_eq!(b.status().mode, FlightMode::Mission);
    b.run_until(30, "new waypoint", |b| b.position_m()[1] > 14.0);
    b.upload(MISSION, &[waypoint((60.0, 0.0), 3.0)]);
    assert_eq!(start(&mut b), ACCEPTED);
    b.upload(MISSION, &[]);
    assert_eq!(b.status().mode, FlightMode::Hold);
}

/// As in PX4. On the ground, and after its end, a mission that marks no item begins with its first.
#[test]
fn a_mission_that_is_edited_in_flight_goes_on_where_it_is_or_with_the_item_that_is_marked() {
    let plan = [4.0, 8.0, 12.0, 30.0].map(|north| waypoint((north, 0.0), 3.0));
    let at = |b: &mut Bench| (b.fresh::<MISSION_CURRENT_DATA>(1_100).seq, b.status().mode);
    let marked = |b: &mut Bench| b.download(MISSION).iter().position(|item| item.current == 1);
    let mut b = flying(&plan);
    b.run_until(15, "second waypoint", |b| reached(b) == [0, 1]);
    assert_eq!(b.ask(178, &[1.0, 1.5, -1.0]), ACCEPTED);
    assert_eq!(b.upload(MISSION, &plan[..3]), TAKEN);
    assert_eq!(at(&mut b), (2, FlightMode::Mission));
    assert_eq!(b.upload_marked(&plan, 3), TAKEN);
    assert_eq!((at(&mut b), marked(&mut b)), ((3, FlightMode::Mission), Some(3)));
    b.run_ms(3_000);
    let speed_m_s = b.velocity_m_s().horizontal_norm();
    assert!((speed_m_s - 1.5).abs() < 0.2, "{speed_m_s}: as fast as before");
    assert_eq!(b.upload(MISSION, &plan[..2]), TAKEN);
    assert_eq!(at(&mut b).0, 1, "as many as there are");
    b.run_until(30, "finished", |b| b.status().mode == FlightMode::Hold);
    assert_eq!((at(&mut b).0, marked(&mut b)), (1, Some(0)));
    assert_eq!(b.upload(MISSION, &plan), TAKEN);
    assert_eq!(at(&mut b).0, 0);
    let mut b = Bench::new();
    assert_eq!(b.upload_marked(&plan, 2), TAKEN);
    assert_eq!(at(&mut b).0, 2);
    assert_eq!(b.upload(MISSION, &plan), TAKEN);
    assert_eq!(at(&mut b).0, 0);
}

#[test]
fn an_item_that_does_not_continue_pauses_the_mission() {
    let mut stop = waypoint((6.0, 0.0), 3.0);
    stop.autocontinue = 0;
    let mut b = flying(&[stop, waypoint((12.0, 0.0), 3.0)]);
    b.run_until(15, "paused", |b| b.status().mode == FlightMode::Hold);
    b.run_ms(1_100);
    assert_eq!(reached(&b), [0]);
    assert_eq!(progress(&b), (1, MissionState::MISSION_STATE_PAUSED));
    assert_eq!(start(&mut b), ACCEPTED);
    b.run_until(15, "second waypoint", |b| reached(b) == [0, 1]);
}

#[test]
fn speed_can_be_changed_on_the_way() {
    let mut b = flying(&[waypoint((80.0, 0.0), 3.0)]);
    b.run_ms(100);
    let change = |b: &mut Bench, kind: f32, speed: f32| b.ask(178, &[kind, speed, -1.0]);
    assert_eq!(change(&mut b, 1.0, 2.0), ACCEPTED);
    b.run_ms(5_000);
    let speed = b.velocity_m_s().horizontal_norm();
    assert!((speed - 2.0).abs() < 0.2, "{speed}");
    assert_eq!(change(&mut b, 2.0, 2.0), DENIED);
    assert_eq!(change(&mut b, 1.0, f32::NAN), DENIED);
    assert_eq!(b.set_mode(API, SCRIPT, 4, 6), ACCEPTED);
    assert_eq!(change(&mut b, 1.0, 2.0), ACCEPTED, "for the next way");
}

#[test]
fn an_acceptance_radius_below_what_can_be_flown_does_not_hang_the_mission() {
    let mut b = flying(&[item(16, [0.0, 0.001, 0.0, f32::NAN], (5.0, 0.0), 3.0)]);
    b.run_until(20, "finished", |b| b.status().mode == FlightMode::Hold);
    assert!(b.is_at((5.0, 0.0), 3.0, 0.6), "{:?}", b.position_m());
}

#[test]
fn the_nose_points_at_a_region_of_interest() {
    let (there, nowhere) = (item(195, [0.0; 4], (10.0, 10.0), 0.0), action(197, [0.0; 4]));
    let mut b = flying(&[there, waypoint((10.0, 0.0), 3.0), nowhere, waypoint((20.0, 0.0), 3.0)]);
    b.run_until(30, "half way", |b| b.position_m()[0] > 7.0);
    let nose = b.yaw_rad();
    let [x, y, _] = b.position_m();
    assert!((nose - (10.0 - y).atan2(10.0 - x)).abs() < 0.4, "{nose}");
    b.run_until(30, "the end", |b| b.status().mode == FlightMode::Hold);
    assert!(b.yaw_rad().abs() < 0.3, "along the way again");
    // By command, in hold.
    let (lat, lon) = on_globe((20.0, -30.0));
    let place = [0.0, 0.0, 0.0, 0.0, lat as f32, lon as f32, 488.0];
    assert_eq!(b.ask(195, &place), ACCEPTED);
    b.run_ms(4_000);
    let nose = b.yaw_rad();
    assert!((nose + core::f32::consts::FRAC_PI_2).abs() < 0.1, "{nose}");
    assert_eq!(b.ask(197, &[]), ACCEPTED);
}

/// What plans of other vehicles carry besides places: none of it keeps the mission from its end.
#[test]
fn commands_to_what_the_vehicle_has_not_are_taken_and_passed_over() {
    let commands = [
        187, 189, 200, 201, 260, 534, 42600, 112, 114, 400, 203, 204, 530, 2001, 2501,
    ];
    let mut plan = vec![item(22, [0.0, 0.0, 0.0, f32::NAN], (0.0, 0.0), 3.0)];
    plan.extend(commands.map(|command| action(command, [0.0; 4])));
    plan.push(item(4501, [0.0; 4], (3.0, 0.0), 3.0));
    plan.push(waypoint((6.0, 0.0), 3.0));
    plan.push(action(179, [1.0, 0.0, 0.0, 0.0]));
    plan.push(action(20, [0.0; 4]));
    let mut b = Bench::new();
    b.set_parameter("RTL_RETURN_ALT", ParameterValue::Real(4.0));
    assert_eq!(b.upload(MISSION, &plan), TAKEN);
    assert_eq!(start(&mut b), ACCEPTED);
    assert_eq!(b.arm(), ACCEPTED);
    let last = plan.len() as u16 - 2;
    b.run_until(40, "home moved", |b| reached(b).last() == Some(&last));
    let all: Vec<u16> = (0..=last).collect();
    assert_eq!(reached(&b), all);
    b.run_until(60, "landed", |b| !b.status().armed);
    assert!(b.is_at((6.0, 0.0), 0.0, 0.9), "home was moved: {:?}", b.position_m());
    // What means something and is not done is refused, as is what PX4 does not take at all or not in the frame.
    let refused =
        [113, 115, 181, 183, 185, 202, 207, 208, 220, 224, 533, 2010].map(|command| action(command, [0.0; 4]));
    let placed = [20, 178, 179, 189].map(|command| item(command, [1.0, 1.0, 0.0, 0.0], (1.0, 4.0), 3.0));
    for refused in refused.into_iter().chain(placed).chain([action(16, [0.0; 4])]) {
        let answer = b.upload(MISSION, &[refused]);
        assert_ne!(answer, TAKEN, "{}", refused.command);
    }
}

#[test]
fn a_mission_that_leaves_the_fence_is_refused_at_its_upload_with_its_item() {
    let mut b = Bench::new();
    let circle = [item(5003, [30.0, 0.0, 0.0, 0.0], (0.0, 0.0), 0.0)];
    assert_eq!(b.upload(FENCE, &circle), TAKEN);
    let inside = waypoint((10.0, 0.0), 3.0);
    for outside in [waypoint((0.0, 31.0), 3.0), item(21, [0.0; 4], (-40.0, 0.0), 0.0)] {
        let answer = b.upload(MISSION, &[inside, inside, outside]);
        assert_eq!(answer, MavMissionResult::MAV_MISSION_DENIED);
        b.assert_said("item 2: outside the geofence");
        assert!(b.download(MISSION).is_empty());
    }
    // What has no place, or no consequence, is no reason.
    assert_eq!(b.upload(MISSION, &[inside, action(20, [0.0; 4])]), TAKEN);
    b.set_parameter("GF_ACTION", ParameterValue::Integer(1));
    assert_eq!(b.upload(MISSION, &[waypoint((0.0, 31.0), 3.0)]), TAKEN);
    // MAVSDK's example has a circle of radius 0 in its fence.
    let empty = [circle[0], item(5003, [0.0; 4], (0.0, 0.0), 0.0)];
    assert_eq!(b.upload(FENCE, &empty), TAKEN);
    b.assert_said("geofence: a circle of radius 0 holds nothing");
    assert_eq!(b.download(FENCE).len(), 2);
}

/// As in PX4, where a mode can be chosen before what it flies is there: arming is then what is refused.
#[test]
fn mission_and_offboard_can_be_chosen_disarmed_and_arming_waits_for_what_they_fly() {
    let mut b = Bench::new();
    assert_eq!(start(&mut b), ACCEPTED);
    assert_eq!(b.status().mode, FlightMode::Mission);
    assert_eq!(b.arm(), REJECTED);
    assert_eq!(b.texts().last().map(String::as_str), Some("arming denied: no mission"));
    assert_eq!(b.upload(MISSION, &[waypoint((6.0, 0.0), 3.0)]), TAKEN);
    assert_eq!(b.arm(), ACCEPTED);
    b.run_until(20, "flies it", |b| reached(b) == [0]);

    let mut b = Bench::new();
    assert_eq!(b.set_mode(API, SCRIPT, 6, 0), ACCEPTED);
    let status = b.status();
    assert_eq!((status.mode, status.setpoint_owner), (FlightMode::Offboard, None));
    assert_eq!(b.arm(), REJECTED);
    let text = b.texts().pop();
    assert_eq!(text.as_deref(), Some("arming denied: no setpoints"));
    b.stream(API, SCRIPT, [0.0, 0.0, -0.5]);
    b.run_ms(200);
    assert_eq!(b.arm(), ACCEPTED);
    assert_eq!(b.status().setpoint_owner, Some(SCRIPT));
    b.run_until(5, "flies them", |b| b.height_m() > 1.0);
}

/// PX4 reports where it flies to in every mode that flies to a place.
#[test]
fn where_it_flies_to_is_reported_on_the_globe_in_hold_go_to_return_and_landing() {
    let mut b = Bench::airborne();
    b.set_parameter("RTL_RETURN_ALT", ParameterValue::Real(5.0));
    let place = |b: &mut Bench| {
        b.sent.clear();
        let answer = b.ask(512, &[87.0]);
        let target = b.first::<POSITION_TARGET_GLOBAL_INT_DATA>(API);
        assert_eq!(answer == ACCEPTED, target.is_some());
        target.map(|m| {
            let (lat, lon) = (f64::from(m.lat_int) * 1e-7, f64::from(m.lon_int) * 1e-7);
            let (north, east) = crate::geo::ORIGIN.north_east_m(lat, lon);
            (north.round(), east.round(), (m.alt - 488.0).round())
        })
    };
    assert_eq!(place(&mut b), Some((0.0, 0.0, 3.0)), "hold");
    assert_eq!(b.go_to((8.0, -3.0), 492.0), ACCEPTED);
    assert_eq!(place(&mut b), Some((8.0, -3.0, 4.0)), "go-to");
    b.run_ms(15_000);
    assert_eq!(b.set_mode(API, SCRIPT, 4, 5), ACCEPTED);
    assert_eq!(place(&mut b), Some((8.0, -3.0, 5.0)), "climbs");
    b.run_ms(5_000);
    assert_eq!(place(&mut b), Some((0.0, 0.0, 5.0)), "flies home");
    b.run_until(60, "lands", |b| b.status().landed == LandedState::Landing);
    assert_eq!(place(&mut b).map(|(.., height)| height), Some(0.0), "down");
    b.run_until(60, "landed", |b| !b.status().armed);
    assert_eq!(place(&mut b), None, "on the ground");
}
