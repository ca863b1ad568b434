use super::*;
use crate::world::Outcome;
use vigil_mavlink::MavMessage;
use vigil_mavlink::common::*;
use vigil_mavlink::framing::encode;
use vigil_mavlink::message;
use vigil_types::{DEPTH_COLS, DEPTH_FULL_SCALE_M, STEP_NS};

/// Pixels in the middle of the image.
const AHEAD: usize = 64 * DEPTH_COLS + 128;

/// A scripted vehicle 2.5 m above home that reports every 50 ms, as an ArduPilot does with ATTITUDE.
struct Scripted {
    flight: ForeignFlight,
    step: u64,
    height_m: f32,
    base_mode: MavModeFlag,
    frame: Box<DepthFrame>,
}

impl Scripted {
    fn new(column_at_m: Option<f32>) -> Self {
        Self::with(column_at_m, ForeignConfig::default())
    }

    fn with(column_at_m: Option<f32>, config: ForeignConfig) -> Self {
        let column =
            |north_m| format!("column = [{{ north_m = {north_m:?}, east_m = 0.0, radius_m = 0.5, height_m = 5.0 }}]");
        let mut course = crate::testing::field(0.0, 10.0, &column_at_m.map(column).unwrap_or_default());
        course.goal.north_m = 15.0;
        course.flight_height_m = 2.5;
        Self {
            flight: ForeignFlight::new(&course, &config, 0).expect("valid"),
            step: 0,
            height_m: 2.5,
            base_mode: MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED,
            frame: Box::new(DepthFrame::EMPTY),
        }
    }

    fn hear(&mut self, message: &MavMessage) {
        self.hear_of((1, 1), message);
    }

    fn hear_of(&mut self, from: (u8, u8), message: &MavMessage) {
        self.flight.receive(self.step * STEP_NS, &encode(from, 0, message));
    }

    fn heartbeat(&mut self, system: u8) {
        let (autopilot, mavtype) = (MavAutopilot::MAV_AUTOPILOT_ARDUPILOTMEGA, MavType::MAV_TYPE_QUADROTOR);
        let base_mode = self.base_mode;
        self.hear_of((system, 1), &message!(HEARTBEAT, autopilot, mavtype, base_mode));
    }

    fn attitude(&mut self) {
        let time_boot_ms = self.step as u32 * 50;
        self.hear(&message!(ATTITUDE, time_boot_ms));
    }

    fn position(&mut self, north_m: f32, north_m_s: f32) {
        let (time_boot_ms, z) = (self.step as u32 * 50, -self.height_m);
        self.hear(&message!(
            LOCAL_POSITION_NED,
            time_boot_ms,
            x = north_m,
            z,
            vx = north_m_s
        ));
    }

    /// Reports at `north_m` in the next step; whether there is a frame, and the state.
    fn report(&mut self, north_m: f32, north_m_s: f32) -> (bool, PoseState) {
        self.step += 1;
        self.heartbeat(1);
        self.attitude();
        self.position(north_m, north_m_s);
        self.look()
    }

    fn look(&mut self) -> (bool, PoseState) {
        let now_ns = self.step * STEP_NS;
        let is_captured = self.flight.capture(now_ns, &mut self.frame);
        (is_captured, self.flight.pose_state(now_ns))
    }

    /// Flies north at 2 m/s from `north_m` until it ends.
    fn fly_north(&mut self, north_m: f32) -> Option<Outcome> {
        (0..200).find_map(|step| {
            self.report(north_m + step as f32 * 0.1, 2.0);
            self.flight.ending().map(|ending| ending.outcome)
        })
    }

    fn ahead_m(&self) -> f32 {
        self.frame.depth[AHEAD] * DEPTH_FULL_SCALE_M
    }
}

#[test]
fn a_way_through_a_column_is_a_collision_and_a_free_one_arrives() {
    assert_eq!(Scripted::new(Some(8.0)).fly_north(0.0), Some(Outcome::Collision));
    let mut free = Scripted::new(None);
    assert_eq!(free.fly_north(0.0), Some(Outcome::Success));
    let ending = free.flight.ending().expect("ended");
    assert!((free.flight.path_length_m() - 2.0 * ending.flight_time_s).abs() < 0.2);
}

#[test]
fn the_column_ahead_is_seen_at_its_range_also_between_two_reports() {
    let mut vehicle = Scripted::new(Some(8.0));
    vehicle.report(0.0, 2.0);
    assert!((vehicle.ahead_m() - 7.5).abs() < 0.2, "{}", vehicle.ahead_m());
    vehicle.step += 4;
    assert!(vehicle.look().0);
    // 0.2 s at 2 m/s later.
    assert!((vehicle.ahead_m() - 7.1).abs() < 0.2, "{}", vehicle.ahead_m());
}

#[test]
fn each_way_to_have_no_pose_has_its_name_and_no_frames() {
    let mut vehicle = Scripted::new(None);
    assert_eq!(vehicle.look(), (false, PoseState::Silent));
    // A ground station is no vehicle.
    vehicle.hear_of((255, 190), &message!(HEARTBEAT));
    assert_eq!(vehicle.look(), (false, PoseState::Silent));
    vehicle.heartbeat(1);
    assert_eq!(vehicle.look(), (false, PoseState::NoPosition));
    vehicle.position(0.0, 0.0);
    assert_eq!(vehicle.look(), (false, PoseState::NoAttitude));
    vehicle.attitude();
    assert_eq!(vehicle.look(), (true, PoseState::Tracking));
    assert_eq!(vehicle.report(f32::NAN, 0.0), (false, PoseState::NotFinite));
    assert_eq!(vehicle.report(0.0, 0.0), (true, PoseState::Tracking));
    vehicle.step += 7;
    assert_eq!(vehicle.look(), (false, PoseState::Stopped));
    assert_eq!(vehicle.report(0.5, 0.0), (true, PoseState::Tracking));
    // Whose pose that is cannot be known any more.
    vehicle.heartbeat(2);
    assert_eq!(vehicle.look(), (false, PoseState::TwoVehicles));
}

#[test]
fn of_two_vehicles_the_one_that_is_named_is_rendered() {
    let config = ForeignConfig {
        system: Some(1),
        ..Default::default()
    };
    let mut vehicle = Scripted::with(None, config);
    vehicle.heartbeat(2);
    assert_eq!(vehicle.look(), (false, PoseState::Silent));
    assert_eq!(vehicle.report(0.0, 0.0), (true, PoseState::Tracking));
    vehicle.heartbeat(2);
    assert_eq!(vehicle.look(), (true, PoseState::Tracking));
}

#[test]
fn one_that_is_not_armed_does_not_fly_wherever_its_estimate_strays() {
    let mut vehicle = Scripted::new(Some(8.0));
    vehicle.base_mode = MavModeFlag::empty();
    vehicle.report(0.0, 0.0);
    assert_eq!(
        vehicle.report(8.0, 0.0),
        (true, PoseState::Tracking),
        "no jump in flight"
    );
    assert_eq!(vehicle.flight.ending(), None);
    vehicle.base_mode = MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED;
    vehicle.report(8.0, 0.0);
    assert!(vehicle.flight.ending().is_some());
}

#[test]
fn a_jump_through_a_column_is_no_collision_but_the_end_of_judging() {
    let mut vehicle = Scripted::new(Some(8.0));
    assert_eq!(vehicle.report(5.0, 0.0), (true, PoseState::Tracking));
    assert_eq!(vehicle.report(11.0, 0.0), (false, PoseState::Jumped));
    assert_eq!(vehicle.report(11.0, 0.0), (false, PoseState::Jumped));
    assert_eq!(vehicle.flight.ending(), None);
    assert!(PoseState::Jumped.is_final());
}

#[test]
fn on_the_ground_the_estimator_may_find_its_place_and_home_is_where_the_course_begins() {
    let mut vehicle = Scripted::new(Some(8.0));
    vehicle.height_m = 0.0;
    vehicle.report(0.0, 0.0);
    // The estimator is reset, and home with it.
    vehicle.hear(&message!(
        HOME_POSITION,
        latitude = 473_977_420,
        longitude = 85_455_940,
        altitude = 488_000,
        x = 30.0
    ));
    assert_eq!(vehicle.report(30.0, 0.0), (true, PoseState::Tracking));
    vehicle.height_m = 2.5;
    vehicle.report(30.0, 0.0);
    assert!((vehicle.ahead_m() - 7.5).abs() < 0.2, "{}", vehicle.ahead_m());
    // The header has the position as the firmware hears it from the vehicle.
    assert_eq!(vehicle.frame.header.position_ned_m, NedVector::new(30.0, 0.0, -2.5));
    assert_eq!(vehicle.fly_north(30.0), Some(Outcome::Collision));
}

/// PX4 main (August 2025, SIH) reported homes from 2.2 m above the ground to 1.2 m below it within 18 s.
#[test]
fn a_home_whose_height_follows_the_gnss_does_not_carry_the_course_with_it() {
    let mut vehicle = Scripted::new(None);
    let home = |z| message!(HOME_POSITION, x = 0.3, z);
    let landed = |landed_state| message!(EXTENDED_SYS_STATE, landed_state);
    vehicle.height_m = -0.3;
    vehicle.report(0.0, 0.0);
    vehicle.hear(&landed(MavLandedState::MAV_LANDED_STATE_ON_GROUND));
    vehicle.hear(&home(-2.2));
    vehicle.report(0.0, 0.0);
    assert_eq!(vehicle.flight.home_ned_m.z, 0.3, "the ground under it");
    // A home elsewhere is as it is reported.
    vehicle.hear(&message!(HOME_POSITION, x = 9.0, z = -2.2));
    assert_eq!(vehicle.flight.vehicle.home_ned_m().expect("a home").z, -2.2);
    vehicle.hear(&home(-2.2));
    vehicle.hear(&landed(MavLandedState::MAV_LANDED_STATE_IN_AIR));
    for z in [1.2, -0.9] {
        vehicle.height_m = 2.5;
        vehicle.position(0.0, 0.0);
        vehicle.hear(&home(z));
        let home_ned_m = vehicle.flight.vehicle.home_ned_m().expect("a home");
        assert_eq!(home_ned_m.z, 0.3, "in the air it stays");
    }
}

#[test]
fn a_vehicle_that_stands_on_the_ground_or_believes_to_be_below_it_sees_the_ground_before_it() {
    for height_m in [0.0, -0.4] {
        let mut vehicle = Scripted::new(None);
        vehicle.height_m = height_m;
        assert_eq!(vehicle.report(0.0, 0.0), (true, PoseState::Tracking));
        let seen = vehicle.frame.depth.iter().filter(|depth| **depth < 1.0).count();
        assert!(seen > vehicle.frame.depth.len() / 4, "{seen} pixels have a return");
        let told_m = vehicle.frame.header.position_ned_m.z;
        assert_eq!(told_m, -height_m, "as the firmware hears it");
    }
}

#[test]
fn a_vehicle_that_starts_anew_in_flight_has_no_verdict() {
    let mut vehicle = Scripted::new(None);
    vehicle.step = 100;
    assert_eq!(vehicle.report(5.0, 0.0), (true, PoseState::Tracking));
    for time_boot_ms in [10, 20] {
        vehicle.hear(&message!(LOCAL_POSITION_NED, time_boot_ms));
    }
    assert_eq!(vehicle.look(), (false, PoseState::Restarted));
    assert!(PoseState::Restarted.is_final());
}

#[test]
fn the_true_pose_is_rendered_where_it_is_wanted_and_waited_for_where_it_is_missing() {
    let config = ForeignConfig {
        truth: true,
        ..Default::default()
    };
    let mut vehicle = Scripted::with(Some(8.0), config);
    assert_eq!(vehicle.report(0.0, 0.0), (false, PoseState::NoTruth));
    let (latitude, longitude) = (473_977_420, 85_455_940);
    let altitude = 488_000;
    vehicle.hear(&message!(GPS_GLOBAL_ORIGIN, latitude, longitude, altitude));
    // A hundred units of latitude north of where it believes to be: 1.11 m.
    vehicle.hear(&message!(
        HIL_STATE_QUATERNION,
        attitude_quaternion = [1.0, 0.0, 0.0, 0.0],
        lat = latitude + 100,
        lon = longitude,
        alt = 490_500
    ));
    assert_eq!(vehicle.look(), (true, PoseState::Tracking));
    assert!((vehicle.ahead_m() - 6.39).abs() < 0.2, "{}", vehicle.ahead_m());
    assert_eq!(vehicle.frame.header.position_ned_m.x, 0.0, "what it believes");
}
