//! Stories of whole flights through the tick, against a vehicle that speaks only MAVLink.

mod common;

use common::{LOITER, OFFBOARD, TestVehicle, config};
use vigil_firmware::config::{AtGoalChoice, Engage};
use vigil_firmware::{FirmwareConfig, LockstepFirmware};
use vigil_types::{Datagrams, DepthFrame, GuidanceState, Nanos, Reason, STEP_NS, StepReport};

/// Vehicle and firmware in step; either side's contribution can be left out of a step.
struct Flight {
    vehicle: TestVehicle,
    firmware: LockstepFirmware,
    now_ns: Nanos,
    last: StepReport,
    sent: Datagrams,
}

impl Flight {
    fn new(vehicle: TestVehicle, config: &FirmwareConfig) -> Self {
        Self {
            vehicle,
            firmware: LockstepFirmware::new(config).unwrap(),
            now_ns: 1_000_000_000,
            last: StepReport::default(),
            sent: Datagrams::default(),
        }
    }

    /// A flight that has reached its guided state.
    fn guided() -> Self {
        let mut flight = Self::new(TestVehicle::hovering(2.5), &config());
        flight.until(GuidanceState::Guided, 10.0);
        flight
    }

    fn step_with(&mut self, frame: Option<&DepthFrame>, telemetry: &Datagrams) -> StepReport {
        self.last = *self.firmware.step(self.now_ns, frame, telemetry, &mut self.sent);
        for (_, datagram) in self.sent.iter() {
            self.vehicle.hear(datagram);
        }
        self.vehicle.advance();
        self.now_ns += STEP_NS;
        self.last
    }

    fn step(&mut self) -> StepReport {
        let (frame, telemetry) = (self.vehicle.frame(self.now_ns), self.vehicle.telemetry());
        self.step_with(Some(&frame), &telemetry)
    }

    fn until(&mut self, state: GuidanceState, limit_s: f64) {
        let deadline_ns = self.now_ns + (limit_s * 1e9) as Nanos;
        while self.last.state != state {
            assert!(self.now_ns < deadline_ns, "not {state:?} in time: {:?}", self.last);
            self.step();
        }
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
        at_goal: AtGoalChoice::Land,
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
    for _ in 0..200 {
        flight.step();
    }
    assert!(!flight.vehicle.armed && !flight.vehicle.is_in_air());
    assert_eq!(flight.vehicle.bad_packets, 0);
}

#[test]
fn without_an_operator_nothing_moves_unless_it_was_told_to_engage_by_itself() {
    let config = FirmwareConfig {
        engage: Engage::Command,
        ..config()
    };
    let mut flight = Flight::new(TestVehicle::hovering(2.5), &config);
    flight.until(GuidanceState::Ready, 5.0);
    for _ in 0..100 {
        assert_eq!(flight.step().state, GuidanceState::Ready);
    }
    assert!(flight.vehicle.setpoints.is_empty() && flight.vehicle.mode == LOITER);
}

#[test]
fn a_stale_frame_means_hold_within_half_a_second_and_fresh_frames_mean_flight_again() {
    let mut flight = Flight::guided();
    let lost_ns = flight.now_ns;
    while flight.last.state == GuidanceState::Guided {
        let telemetry = flight.vehicle.telemetry();
        flight.step_with(None, &telemetry);
    }
    assert_eq!(flight.last.state, GuidanceState::Hold);
    assert!(flight.last.reasons.contains(Reason::StaleFrame));
    assert!(flight.now_ns - lost_ns <= 500_000_000);
    assert_eq!(flight.velocity()[..2], [0.0, 0.0]);
    assert_eq!(flight.velocity()[3], 0.0);
    assert_eq!(flight.last.action, None, "the pilot is not asked about a stale frame");
    flight.until(GuidanceState::Guided, 5.0);
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
fn a_bad_frame_is_refused_by_its_reason_and_stops_the_vehicle_in_that_very_step() {
    let mut flight = Flight::guided();
    let mut frame = flight.vehicle.frame(flight.now_ns);
    frame.depth[5] = f32::NAN;
    frame.seal();
    let telemetry = flight.vehicle.telemetry();
    let report = flight.step_with(Some(&frame), &telemetry);
    assert_eq!(report.state, GuidanceState::Hold);
    assert!(report.reasons.contains(Reason::BadFrame));
    assert_eq!(report.frames_refused, 1);
    assert_eq!(flight.velocity()[..2], [0.0, 0.0]);
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

#[test]
fn noise_on_the_link_is_no_telemetry_and_no_crash() {
    let mut flight = Flight::new(TestVehicle::hovering(2.5), &config());
    let mut noise = Datagrams::default();
    for seed in 0u32..200 {
        let bytes: Vec<u8> = (0..100u32)
            .map(|i| (seed.wrapping_mul(0x9E37_79B9).wrapping_add(i.wrapping_mul(0x85EB_CA6B)) >> 13) as u8)
            .collect();
        // Some begin like a packet.
        let start = [&[0xFD, 60], &[0xFE, 60], &[][..]][seed as usize % 3];
        noise.push(0, &[start, &bytes].concat());
    }
    for _ in 0..20 {
        let frame = flight.vehicle.frame(flight.now_ns);
        let report = flight.step_with(Some(&frame), &noise);
        assert!(report.reasons.contains(Reason::LinkLost));
        assert_eq!(report.telemetry, Default::default());
    }
}

#[test]
fn the_same_inputs_give_the_same_bytes() {
    let fly = || {
        let mut flight = Flight::new(TestVehicle::on_ground(), &config());
        let mut bytes = Vec::new();
        for _ in 0..600 {
            flight.step();
            for (link, datagram) in flight.sent.iter() {
                bytes.push(link);
                bytes.extend_from_slice(datagram);
            }
        }
        (bytes, flight.last)
    };
    assert_eq!(fly(), fly());
}
