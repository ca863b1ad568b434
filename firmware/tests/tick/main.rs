//! Stories of whole flights through the tick, against a vehicle that speaks only MAVLink.

mod alarm;
#[path = "../common/mod.rs"]
mod common;

use common::{Flight, OFFBOARD, TestVehicle, config, monitored_config, set_parameter, undecided_detector};
use vigil_firmware::config::GoalConfig;
use vigil_firmware::{FirmwareConfig, LockstepFirmware};
use vigil_mavlink::common::{MavParamType, OBSTACLE_DISTANCE_DATA};
use vigil_mavlink::framing::encode;
use vigil_types::{AlarmCause, AtGoal, Datagrams, GuidanceState, NedVector, Reason, Reasons, STEP_S, Verdict};

impl Flight {
    /// A flight that has reached its guided state.
    fn guided() -> Self {
        Self::guided_by(&config())
    }

    fn guided_by(config: &FirmwareConfig) -> Self {
        let mut flight = Self::new(TestVehicle::hovering(2.5), config);
        flight.until(GuidanceState::Guided, 10.0);
        flight
    }

    /// Sets a parameter as a ground station does, and gives what the firmware then says it is.
    fn set(&mut self, name: &str, param_value: f32, param_type: MavParamType) -> f32 {
        let message = set_parameter(name, param_value, param_type);
        let (frame, mut received) = (self.vehicle.frame(self.now_ns), self.vehicle.telemetry());
        received.push(0, &encode((255, 190), 0, &message));
        self.step_with(Some(&frame), &received);
        let mut values = only!(self.vehicle.heard.iter().rev(), PARAM_VALUE);
        let named = values.find(|value| value.param_id.to_str() == Ok(name));
        named.unwrap().param_value
    }

    /// The greatest speed of the next seconds.
    fn fastest_m_s(&mut self, seconds: u64) -> f32 {
        let mut fastest = 0.0f32;
        for _ in 0..seconds * 20 {
            self.step();
            fastest = fastest.max(self.velocity()[0]);
        }
        fastest
    }

    /// The velocity last sent to the vehicle.
    fn velocity(&self) -> [f32; 4] {
        let s = self.vehicle.setpoints.last().unwrap();
        [s.vx, s.vy, s.vz, s.yaw_rate]
    }
}

#[test]
fn from_the_ground_to_the_goal_and_down_again() {
    let config = FirmwareConfig {
        at_goal: AtGoal::Land,
        ..config()
    };
    let mut flight = Flight::new(TestVehicle::on_ground(), &config);
    assert_eq!(flight.step().state, GuidanceState::Standby);
    flight.until(GuidanceState::Engaging, 5.0);
    flight.until(GuidanceState::Guided, 30.0);
    assert!(flight.vehicle.armed && flight.vehicle.mode == OFFBOARD && flight.vehicle.is_in_air());
    let speed = |flight: &Flight| flight.vehicle.velocity_ned_m_s.horizontal_norm();
    while flight.last.state == GuidanceState::Guided {
        flight.step();
        assert!(speed(&flight) <= 1.5 + 1e-4);
        assert!(flight.now_ns < 90_000_000_000, "too slow: {:?}", flight.last);
    }
    assert!(flight.last.reasons.contains(Reason::GoalReached), "{:?}", flight.last);
    let goal_m = flight.vehicle.position_ned_m - vigil_types::NedVector::new(20.0, 5.0, -2.5);
    assert!(goal_m.norm() < 1.5, "{goal_m:?}");
    flight.until(GuidanceState::Land, 10.0);
    flight.fastest_m_s(10);
    assert!(!flight.vehicle.armed && !flight.vehicle.is_in_air());
    assert_eq!(flight.vehicle.bad_packets, 0);
}

#[test]
fn a_heading_that_turns_without_a_turn_leads_neither_the_eye_nor_the_course_astray() {
    let mut flight = Flight::guided();
    let yaw_rad = |flight: &Flight| flight.last.telemetry.attitude.unwrap().attitude.yaw_rad();
    // 10° in five seconds.
    for _ in 0..100 {
        flight.vehicle.heading_error_rad += 0.1f32.to_radians();
        flight.step();
        assert_eq!(flight.last.state, GuidanceState::Guided, "{:?}", flight.last.reasons);
    }
    let off_rad = yaw_rad(&flight) - flight.vehicle.yaw_rad;
    assert!(off_rad.abs() < 1f32.to_radians(), "{off_rad}");
    // It is asked to fly where its nose points: beside where it believes that it points.
    let [forward_m_s, right_m_s, ..] = flight.velocity();
    let asked_rad = right_m_s.atan2(forward_m_s);
    assert!(
        (asked_rad + 9.6f32.to_radians()).abs() < 1f32.to_radians(),
        "{asked_rad}"
    );
    // Where the frames were not turned with the heading, their poses would contradict it.
    let reasons = flight.last.reasons;
    assert!(!reasons.contains(Reason::ImplausiblePose), "{reasons:?}");
}

#[test]
fn a_vanished_vehicle_means_hold_within_half_a_second_named_and_recovers() {
    let mut flight = Flight::guided();
    let lost_ns = flight.now_ns;
    while flight.last.state == GuidanceState::Guided {
        let frame = flight.vehicle.frame(flight.now_ns);
        flight.step_with(Some(&frame), &Datagrams::default());
    }
    assert!(
        flight.last.reasons.contains(Reason::StaleTelemetry),
        "{:?}",
        flight.last
    );
    assert!(flight.now_ns - lost_ns <= 500_000_000);
    flight.until(GuidanceState::Guided, 10.0);
}

#[test]
fn a_frame_of_another_sensor_is_no_frame() {
    let config = FirmwareConfig {
        sensor_id: 2,
        ..config()
    };
    let mut flight = Flight::new(TestVehicle::hovering(2.5), &config);
    for _ in 0..40 {
        assert_eq!(flight.step().state, GuidanceState::Standby);
    }
    assert_eq!((flight.last.frames_refused, flight.last.frame_age_ns), (40, None));
}

#[test]
fn telemetry_that_is_not_finite_stops_the_vehicle() {
    let mut flight = Flight::guided();
    let good = flight.vehicle.position_ned_m;
    flight.vehicle.position_ned_m.y = f32::NAN;
    let report = flight.step();
    assert_eq!(report.state, GuidanceState::Hold);
    assert!(report.reasons.contains(Reason::NotFinite), "{report:?}");
    assert_eq!(flight.velocity()[..2], [0.0, 0.0]);
    flight.vehicle.position_ned_m = good;
    flight.until(GuidanceState::Guided, 5.0);
}

const REAL: MavParamType = MavParamType::MAV_PARAM_TYPE_REAL32;

#[test]
fn a_speed_limit_set_in_flight_holds_at_once_and_cruise_is_set_before_the_flight_only() {
    let mut flight = Flight::new(TestVehicle::hovering(2.5), &config());
    flight.step();
    assert_eq!(flight.set("PLT_CRUISE", 1.25, REAL), 1.25);
    flight.until(GuidanceState::Guided, 10.0);
    let fastest = flight.fastest_m_s(3);
    assert!((1.0..=1.25).contains(&fastest), "{fastest}");
    assert_eq!(flight.set("PLT_CRUISE", 1.5, REAL), 1.25, "not in flight");
    assert_eq!(flight.set("GD_SPEED_LIM", 0.5, REAL), 0.5);
    let fastest = flight.fastest_m_s(3);
    assert!((0.4..=0.5).contains(&fastest), "{fastest}");
    assert_eq!(flight.set("GD_SPEED_LIM", 9.0, REAL), 0.5, "out of range");
    assert_eq!(flight.last.state, GuidanceState::Guided);
}

#[test]
fn goal_radius_and_action_set_in_flight_end_it_sooner_and_on_the_ground() {
    let mut flight = Flight::guided();
    assert_eq!(flight.set("GD_GOAL_RAD", 8.0, REAL), 8.0);
    let land = f32::from_bits(1);
    let set = flight.set("GD_AT_GOAL", land, MavParamType::MAV_PARAM_TYPE_INT32);
    assert_eq!(set.to_bits(), 1);
    flight.until(GuidanceState::Hold, 60.0);
    assert!(flight.last.reasons.contains(Reason::GoalReached));
    let goal = vigil_types::NedVector::new(20.0, 5.0, -2.5);
    let distance_m = (goal - flight.vehicle.position_ned_m).horizontal_norm();
    assert!((6.0..=8.2).contains(&distance_m), "{distance_m}");
    flight.until(GuidanceState::Land, 10.0);
}

#[test]
fn a_goal_beyond_the_limit_is_refused_before_anything_flies_with_both_distances() {
    let mut config = config();
    config.goal = Some(GoalConfig {
        north_m: 600.0,
        east_m: 0.0,
        height_m: None,
    });
    let error = LockstepFirmware::new(&config).err().unwrap().to_string();
    for part in ["600 m", "500 m", "goal_m", "[limits]"] {
        assert!(error.contains(part), "{error}");
    }
    config.limits.goal_m = 1000.0;
    assert!(LockstepFirmware::new(&config).is_ok());
}

#[test]
fn what_the_pilot_sees_is_reported_four_times_a_second_and_only_while_it_looks() {
    // A wall that stays 6 m ahead of a vehicle that flies is what a frozen sensor shows.
    let mut flight = Flight::guided_by(&FirmwareConfig {
        plausibility: false,
        ..config()
    });
    let count = |flight: &Flight| obstacles(&flight.vehicle).len();
    let before = count(&flight);
    for _ in 0..100 {
        let mut frame = flight.vehicle.frame(flight.now_ns);
        // A wall 6 m ahead in the whole field of view: normalised by 100 m.
        frame.depth.fill(0.06);
        frame.seal();
        let telemetry = flight.vehicle.telemetry();
        flight.step_with(Some(&frame), &telemetry);
    }
    let sent = count(&flight) - before;
    assert!((19..=21).contains(&sent), "{sent} in 5 s");
    let last = obstacles(&flight.vehicle).pop().unwrap();
    assert!(last.distances[36].abs_diff(600) < 60, "{:?}", last.distances);

    let seen = count(&flight);
    for _ in 0..40 {
        let telemetry = flight.vehicle.telemetry();
        flight.step_with(None, &telemetry);
    }
    assert!(
        count(&flight) - seen <= 2,
        "a stale frame is not sent as if it were new"
    );
}

fn obstacles(vehicle: &TestVehicle) -> Vec<&OBSTACLE_DISTANCE_DATA> {
    only!(&vehicle.heard, OBSTACLE_DISTANCE).collect()
}

/// The values of a name that the vehicle heard, newest last.
fn values(vehicle: &TestVehicle, name: &str) -> Vec<f32> {
    let values = only!(&vehicle.heard, NAMED_VALUE_FLOAT).filter(|value| value.name.to_str() == Ok(name));
    values.map(|value| value.value).collect()
}

/// The texts that begin so, with their severity.
fn texts(vehicle: &TestVehicle, begin: &str) -> Vec<(u8, String)> {
    let texts =
        only!(&vehicle.heard, STATUSTEXT).map(|sent| (sent.severity as u8, sent.text.to_str().unwrap().to_owned()));
    texts.filter(|(_, text)| text.starts_with(begin)).collect()
}
