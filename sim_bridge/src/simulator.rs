//! World, vehicle, LiDAR, MAVLink endpoint and referee on one simulated clock.

use crate::config::{SimConfig, SimError, Start};
use crate::depth_sensor::DepthSensor;
use crate::vehicle::{ControlCommand, Truth, Vehicle};
use crate::world::{
    Outcome, Referee, Shot, World, ZONE_COLUMNS, ZONE_INTERVAL_NS, ZONE_MAX_RANGE_M, ZONE_MOST_HEADS, ZoneSensor,
};
use twox_hash::XxHash3_64;
use vigil_autopilot::{Endpoint, EndpointStatus, LinkId, Saved, SigningSetup, ZoneRanges};
use vigil_types::{Datagrams, DepthFrame, Nanos, NedVector, RANGE_SECTORS, STEP_NS};

const MILLISECOND_NS: Nanos = 1_000_000;

/// Milliseconds of physics in one step of the loop.
pub const STEP_MS: u32 = (STEP_NS / MILLISECOND_NS) as u32;

/// How a flight ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ending {
    /// The referee's verdict.
    pub outcome: Outcome,
    /// Simulated time from the vehicle's first lift-off.
    pub flight_time_s: f64,
}

/// One flight's simulation. It reads no clock and owns no socket: the caller passes bytes in and takes bytes out, so the
/// same code serves real time, lockstep and tests.
pub struct Simulator {
    world: World,
    /// Watches the present flight; a copy of how it was before any is kept.
    referee: Referee,
    fresh_referee: Referee,
    /// Where the vehicle stands at the start: metres from home, heading.
    start: (NedVector, f32),
    vehicle: Vehicle,
    sensor: DepthSensor,
    /// Present when there is a second sensor, and when it measures next.
    zones: Option<ZoneSensor>,
    zones_due_ns: Nanos,
    endpoint: Endpoint,
    goal_ned_m: NedVector,
    epoch_ns: Nanos,
    elapsed_ms: u64,
    /// How long the simulation stood still while the shared clock went on.
    stood_still_ns: Nanos,
    lifted_off_ms: Option<u64>,
    ending: Option<Ending>,
    path_length_m: f64,
    closest_goal_m: f32,
    /// Whether the estimate is away from the truth by more than a light error.
    estimate_wanders: bool,
    hash: u64,
}

impl Simulator {
    /// Sets up the flight of `config.course`. `epoch_ns` is the shared clock's reading at simulated time zero: 0 in
    /// lockstep, the monotonic clock when live, so that frame stamps compare with the firmware's clock.
    ///
    /// # Errors
    /// A model parameter that cannot be simulated; the message names it.
    pub fn new(config: &SimConfig, epoch_ns: Nanos) -> Result<Self, SimError> {
        let course = &config.course;
        let mut vehicle = Vehicle::new(config.vehicle, config.wind, config.seed)?;
        let mut endpoint = Endpoint::new(config.endpoint.clone())?;
        endpoint.set_hold_law(config.vehicle.control.hold);
        endpoint.restore(&config.saved)?;
        let airborne = config.start == Start::Airborne;
        let start_ned_m = course.start_ned_m() + NedVector::new(0.0, 0.0, -course.flight_height_m);
        vehicle.place(start_ned_m, course.start_heading_rad(), airborne);
        if airborne {
            endpoint.start_airborne(epoch_ns, course.flight_height_m);
        }
        let referee = Referee::new(course);
        Ok(Self {
            world: World::new(course),
            fresh_referee: referee.clone(),
            referee,
            start: (start_ned_m, course.start_heading_rad()),
            vehicle,
            sensor: DepthSensor::new(config.lidar, config.seed, config.sensor_fault, config.frame_key.clone())?,
            zones: (config.second_sensor_heads > 0).then(|| ZoneSensor::new(config.seed, config.second_sensor_heads)),
            zones_due_ns: 0,
            endpoint,
            goal_ned_m: course.goal_ned_m(),
            epoch_ns,
            elapsed_ms: 0,
            stood_still_ns: 0,
            lifted_off_ms: None,
            ending: None,
            path_length_m: 0.0,
            closest_goal_m: f32::INFINITY,
            estimate_wanders: config.vehicle.sensors.wander_m != [0.0; 2],
            hash: 0,
        })
    }

    /// Now, on the shared clock.
    pub fn now_ns(&self) -> Nanos {
        self.vehicle_ns() + self.stood_still_ns
    }

    /// Now, by the vehicle's own clock, which stands while the simulation does.
    fn vehicle_ns(&self) -> Nanos {
        self.epoch_ns + self.elapsed_ms * MILLISECOND_NS
    }

    /// The simulation stood still while the shared clock went on by `lasted_ns`, a multiple of a step. Nothing of it is made up for:
    /// a second of flight in an instant would be one in which nobody steers.
    pub fn stood_still(&mut self, lasted_ns: Nanos) {
        self.stood_still_ns += lasted_ns;
        self.endpoint.stood_still(lasted_ns);
    }

    /// Hands a datagram to the vehicle's MAVLink endpoint.
    pub fn receive(&mut self, link: u8, datagram: &[u8]) {
        self.receive_from(link, 0, datagram);
    }

    /// The same on a link with several ends: `peer` is another number for another end.
    pub fn receive_from(&mut self, link: u8, peer: u64, datagram: &[u8]) {
        self.endpoint
            .receive_from(self.vehicle_ns(), LinkId(link), peer, datagram);
    }

    /// Tells everybody on the vehicle's links something of them.
    pub fn warn(&mut self, text: &str) {
        self.endpoint.warn(text);
    }

    /// The vehicle's parameters and plans, for a later run.
    pub fn saved(&self) -> Saved {
        self.endpoint.saved()
    }

    /// The signing key that SETUP_SIGNING brought since the last call: for the owner of the links.
    pub fn take_signing_setup(&mut self) -> Option<SigningSetup> {
        self.endpoint.take_signing_setup()
    }

    /// Takes the datagrams that the vehicle wants to send.
    pub fn transmit(&mut self, mut send: impl FnMut(u8, &[u8])) {
        self.endpoint.transmit(|link, datagram| send(link.0, datagram));
    }

    /// Advances physics, autopilot and referee by one millisecond.
    pub fn advance_1ms(&mut self) {
        self.elapsed_ms += 1;
        let view = self.vehicle.view();
        self.endpoint.observe_truth(&self.vehicle.truth());
        let command = self.endpoint.step(self.vehicle_ns(), &view);
        if self.endpoint.take_reboot() && self.has_collided() {
            self.mend();
        }
        // A vehicle that hit something has broken propellers, whatever its autopilot asks.
        let crashed = self.has_collided();
        let before = self.vehicle.truth();
        self.vehicle
            .step(if crashed { &ControlCommand::MotorsOff } else { &command });
        let truth = self.vehicle.truth();
        self.world.set_time_ns(self.elapsed_ms * MILLISECOND_NS);
        if let Some(zones) = &mut self.zones
            && self.elapsed_ms * MILLISECOND_NS >= self.zones_due_ns
        {
            self.zones_due_ns += ZONE_INTERVAL_NS;
            let mut room = [f32::INFINITY; ZONE_MOST_HEADS * ZONE_COLUMNS];
            let measured_m = zones.measure(&self.world, truth.position_ned_m, truth.attitude, &mut room);
            let mut range_m = [f32::INFINITY; RANGE_SECTORS];
            range_m[..measured_m.len()].copy_from_slice(measured_m);
            self.endpoint.observe_ranges(ZoneRanges {
                range_m,
                columns: measured_m.len(),
                fov_rad: zones.fov_rad(),
                farthest_m: ZONE_MAX_RANGE_M,
            });
        }

        if self.lifted_off_ms.is_none() && !self.vehicle.view().on_ground {
            self.lifted_off_ms = Some(self.elapsed_ms);
        }
        if let Some(lifted_off_ms) = self.lifted_off_ms {
            if self.ending.is_none() {
                self.path_length_m += f64::from((truth.position_ned_m - before.position_ned_m).norm());
                self.closest_goal_m = self
                    .closest_goal_m
                    .min((self.goal_ned_m - truth.position_ned_m).horizontal_norm());
            }
            if self.estimate_wanders {
                let estimated_ned_m = self.vehicle.view().estimate.position_ned_m;
                self.referee.set_estimate_error(estimated_ned_m - truth.position_ned_m);
            }
            self.referee.set_motors(self.vehicle.view().armed);
            if self.ending.is_none()
                && let Some(outcome) = self.referee.observe(
                    &self.world,
                    self.elapsed_ms * MILLISECOND_NS,
                    truth.position_ned_m,
                    truth.attitude,
                    truth.velocity_ned_m_s,
                )
            {
                let flight_time_s = (self.elapsed_ms - lifted_off_ms) as f64 * 1e-3;
                self.ending = Some(Ending { outcome, flight_time_s });
                if outcome == Outcome::Collision {
                    // It would look as if it did not obey.
                    self.endpoint.break_down();
                }
            }
        }
    }

    fn has_collided(&self) -> bool {
        self.ending.is_some_and(|ending| ending.outcome == Outcome::Collision)
    }

    /// After a collision and a reboot: another flight, of a whole vehicle that stands at the start again.
    fn mend(&mut self) {
        let (start_ned_m, heading_rad) = self.start;
        self.vehicle.place(start_ned_m, heading_rad, false);
        self.referee = self.fresh_referee.clone();
        self.lifted_off_ms = None;
        self.ending = None;
        self.path_length_m = 0.0;
        self.closest_goal_m = f32::INFINITY;
    }

    /// Captures a depth frame into `frame`, as the LiDAR's fault leaves it, seals it, and authenticates it if there is a key.
    pub fn capture(&mut self, frame: &mut DepthFrame) {
        let truth = self.vehicle.truth();
        let estimate = self.vehicle.view().estimate;
        let shot = Shot {
            estimated_position_ned_m: estimate.position_ned_m,
            estimated_attitude: estimate.attitude,
            stamp_ns: self.now_ns(),
            ..Shot::at(truth.position_ned_m, truth.attitude)
        };
        let elapsed_ns = self.elapsed_ms * MILLISECOND_NS;
        self.sensor.capture(&self.world, elapsed_ns, shot, frame);
    }

    /// One step of lockstep: takes the firmware's datagrams of the previous step, advances [`STEP_MS`], captures a frame
    /// and collects the datagrams for the firmware. Mixes all of it into [`Self::state_hash`].
    pub fn lockstep(&mut self, from_firmware: &Datagrams, frame: &mut DepthFrame, to_firmware: &mut Datagrams) {
        for (link, datagram) in from_firmware.iter() {
            self.receive(link, datagram);
            self.hash = XxHash3_64::oneshot_with_seed(self.hash, datagram);
        }
        to_firmware.clear();
        for _ in 0..STEP_MS {
            self.advance_1ms();
        }
        self.endpoint.transmit(|link, datagram| {
            if link == LinkId::ONBOARD {
                to_firmware.push(link.0, datagram);
            }
        });
        self.capture(frame);
        self.hash = XxHash3_64::oneshot_with_seed(self.hash, &frame.header.checksum.to_le_bytes());
        self.hash = XxHash3_64::oneshot_with_seed(self.hash, &self.vehicle.state_hash().to_le_bytes());
    }

    /// A digest of everything that happened in lockstep so far: the firmware's bytes, every frame, the vehicle's full
    /// state at each step. Two flights with the same digest were the same flight.
    pub fn state_hash(&self) -> u64 {
        self.hash
    }

    /// How the flight ended, once it has.
    pub fn ending(&self) -> Option<Ending> {
        self.ending
    }

    /// The true state.
    pub fn truth(&self) -> Truth {
        self.vehicle.truth()
    }

    /// What the vehicle's MAVLink side is doing.
    pub fn status(&self) -> EndpointStatus {
        self.endpoint.status()
    }

    /// Metres flown from lift-off to the ending.
    pub fn path_length_m(&self) -> f64 {
        self.path_length_m
    }

    /// Smallest horizontal distance to the goal so far.
    pub fn closest_goal_m(&self) -> f32 {
        self.closest_goal_m
    }

    /// Distance of the vehicle's middle from the nearest obstacle now; infinite in an empty world.
    pub fn obstacle_distance_m(&self) -> f32 {
        self.world.clearance_m(self.vehicle.truth().position_ned_m)
    }

    /// Horizontal distance to the goal now.
    pub fn goal_distance_m(&self) -> f32 {
        (self.goal_ned_m - self.vehicle.truth().position_ned_m).horizontal_norm()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{command, packet};
    use crate::world::{Column, Family, generate};
    use vigil_autopilot::FlightMode;
    use vigil_mavlink::common::{MavFrame, MavMessage, PositionTargetTypemask, SET_POSITION_TARGET_LOCAL_NED_DATA};
    use vigil_types::DEPTH_FULL_SCALE_M;

    /// The digest of three seconds of hovering at a course's start.
    fn hover(config: &SimConfig, epoch_ns: Nanos) -> (u64, Box<DepthFrame>) {
        let mut simulator = Simulator::new(config, epoch_ns).expect("valid");
        let mut frame = Box::new(DepthFrame::EMPTY);
        let (from_firmware, mut to_firmware) = (Box::<Datagrams>::default(), Box::<Datagrams>::default());
        for _ in 0..60 {
            simulator.lockstep(&from_firmware, &mut frame, &mut to_firmware);
        }
        (simulator.state_hash(), frame)
    }

    #[test]
    fn movers_move_with_simulated_time_whatever_the_clock_says() {
        let mut config = SimConfig::new(generate(Family::Hard, 4), 4);
        config.start = Start::Airborne;
        let (hash, frame) = hover(&config, 0);
        assert_eq!(hover(&config, 0).0, hash);
        let moved = |other: &DepthFrame| {
            let apart_m = |(a, b): (&f32, &f32)| (a - b).abs() * DEPTH_FULL_SCALE_M;
            let pixels = frame.depth.iter().zip(&other.depth);
            pixels.filter(|p| apart_m(*p) > 0.5).count()
        };
        // Another epoch changes the stamps; what is seen differs by what the vehicle's own motion makes of that.
        let by_epoch = moved(&hover(&config, 77_000_000_000).1);
        // Movers that are elsewhere are seen elsewhere.
        for mover in &mut config.course.movers {
            mover.phase = (mover.phase + 0.3) % 1.0;
        }
        let by_phase = moved(&hover(&config, 0).1);
        assert!(by_phase > 200 && by_epoch * 10 < by_phase, "{by_phase} {by_epoch}");
    }

    /// A machine that was suspended, or a debugger: caught up with in an instant, the pause would be a second without setpoints.
    #[test]
    #[allow(deprecated, reason = "the frame that PX4 flies and clients send")]
    fn a_simulator_that_stood_still_for_a_second_says_so_and_flies_on_as_if_nothing_had_been() {
        let mut config = SimConfig::new(generate(Family::Validation, 1), 1);
        config.start = Start::Airborne;
        let setpoint = SET_POSITION_TARGET_LOCAL_NED_DATA {
            type_mask: PositionTargetTypemask::from_bits_retain(0x5C7),
            target_system: 1,
            target_component: 1,
            coordinate_frame: MavFrame::MAV_FRAME_BODY_NED,
            ..Default::default()
        };
        let setpoint = packet((1, 191), &MavMessage::SET_POSITION_TARGET_LOCAL_NED(setpoint));
        let offboard = command((1, 191), 176, [129.0, 6.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let mut simulator = Simulator::new(&config, 0).expect("valid");
        let mut said = Vec::new();
        for step in 0..80 {
            simulator.receive(0, &setpoint);
            if step == 1 {
                simulator.receive(0, &offboard);
            }
            if step == 40 {
                let before_ns = simulator.now_ns();
                simulator.stood_still(1_000_000_000);
                let since_ns = simulator.now_ns() - before_ns;
                assert_eq!(since_ns, 1_000_000_000, "frames have today's stamps");
            }
            for _ in 0..STEP_MS {
                simulator.advance_1ms();
                simulator.transmit(|_, datagram| said.extend_from_slice(datagram));
            }
        }
        let status = simulator.status();
        assert_eq!((status.mode, status.failsafe), (FlightMode::Offboard, None));
        let text = b"simulator stood still for 1.0 s";
        assert!(said.windows(text.len()).any(|window| window == text));
    }

    /// A vehicle that hit something says so, refuses to arm and to take off with the reason, and flies again after a reboot.
    #[test]
    fn a_vehicle_that_hit_something_says_why_it_does_not_fly_until_a_reboot_mends_it() {
        let mut config = SimConfig::new(generate(Family::Validation, 1), 1);
        // Where the vehicle is.
        let (north_m, east_m) = (config.course.start_ned_m().x, config.course.start_ned_m().y);
        config.course.columns.push(Column {
            north_m,
            east_m,
            radius_m: 0.3,
            height_m: 4.0,
        });
        config.start = Start::Airborne;
        let mut simulator = Simulator::new(&config, 0).unwrap();
        let mut said = Vec::new();
        for _ in 0..5_000 {
            simulator.advance_1ms();
            simulator.transmit(|_, datagram| said.extend_from_slice(datagram));
        }
        assert_eq!(simulator.ending().map(|e| e.outcome), Some(Outcome::Collision));
        let says = |said: &[u8], text: &str| said.windows(text.len()).any(|window| window == text.as_bytes());
        assert!(says(&said, "collision: motors off until a reboot"), "it is silent");
        assert!(simulator.truth().position_ned_m.z > -0.5, "it lies on the ground");
        let ask = |simulator: &mut Simulator, number: u16, first: f32, ms: u32| {
            let params = [first, 0.0, 0.0, 0.0, 0.0, 0.0, f32::NAN];
            simulator.receive(0, &command((245, 190), number, params));
            let mut said = Vec::new();
            for _ in 0..ms {
                simulator.advance_1ms();
                simulator.transmit(|_, datagram| said.extend_from_slice(datagram));
            }
            said
        };
        let (arm, take_off, reboot) = (400, 22, 246);
        for (command, name) in [(arm, "arming"), (take_off, "takeoff")] {
            let said = ask(&mut simulator, command, 1.0, 100);
            let denial = format!("{name} denied: broken by a collision");
            assert!(says(&said, &denial), "{name} is not refused");
        }
        assert!(!simulator.status().armed);
        let said = ask(&mut simulator, reboot, 1.0, 500);
        assert!(says(&said, "rebooted"));
        assert_eq!(simulator.ending(), None, "another flight begins");
        ask(&mut simulator, arm, 1.0, 100);
        assert!(simulator.status().armed, "{:?}", simulator.status());
        // It rises into the column that stands there: this flight has its own referee.
        ask(&mut simulator, take_off, 0.0, 3_000);
        assert_eq!(simulator.ending().map(|e| e.outcome), Some(Outcome::Collision));
    }

    /// Its feet take a drop of half a metre, as those of PX4's simulated vehicle take any.
    #[test]
    fn a_vehicle_that_is_killed_low_flies_again_and_one_that_falls_farther_is_broken() {
        for (height_m, breaks) in [(0.45, false), (1.2, true)] {
            let mut config = SimConfig::new(generate(Family::Validation, 1), 1);
            config.start = Start::Airborne;
            let mut simulator = Simulator::new(&config, 0).unwrap();
            let mut ask = |number: u16, params: [f32; 2], until: &dyn Fn(&Simulator) -> bool| {
                let [first, second] = params;
                let params = [first, second, 0.0, 0.0, 0.0, 0.0, f32::NAN];
                simulator.receive(0, &command((245, 190), number, params));
                let done = (0..10_000).any(|_| {
                    simulator.advance_1ms();
                    until(&simulator)
                });
                (done, simulator.ending().is_some(), simulator.status().armed)
            };
            let (land, disarm, kill) = (21, 400, 21196.0);
            ask(land, [0.0; 2], &|s| -s.truth().position_ned_m.z < height_m);
            let (_, has_ended, _) = ask(disarm, [0.0, kill], &|s| s.ending().is_some());
            assert_eq!(has_ended, breaks, "from {height_m} m");
            let (armed, ..) = ask(disarm, [1.0, 0.0], &|s| s.status().armed);
            assert_eq!(armed, !breaks, "from {height_m} m");
        }
    }
}
