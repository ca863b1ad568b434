//! World, vehicle, LiDAR, MAVLink endpoint and referee on one simulated clock.

use crate::config::{SimConfig, Start};
use crate::depth_sensor::DepthSensor;
use crate::vehicle::{ControlCommand, Truth, Vehicle};
use crate::world::{Outcome, Referee, Shot, World, ZoneSensor};
use twox_hash::XxHash3_64;
use vigil_autopilot::{Endpoint, EndpointStatus, LinkId};
use vigil_types::{Datagrams, DepthFrame, Nanos, NedVector, STEP_NS};

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
    /// Present when there is a second sensor.
    zones: Option<ZoneSensor>,
    /// The vehicle's MAVLink side.
    pub endpoint: Endpoint,
    epoch_ns: Nanos,
    elapsed_ms: u64,
    /// How long the simulation stood still while the shared clock went on.
    stood_still_ns: Nanos,
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
    pub fn new(config: &SimConfig, epoch_ns: Nanos) -> anyhow::Result<Self> {
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
            endpoint,
            epoch_ns,
            elapsed_ms: 0,
            stood_still_ns: 0,
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

    /// Advances physics, autopilot and referee by one millisecond.
    pub fn advance_1ms(&mut self) {
        self.elapsed_ms += 1;
        let view = self.vehicle.view();
        self.endpoint.observe_truth(&self.vehicle.truth());
        let command = self.endpoint.step(self.vehicle_ns(), &view);
        if self.endpoint.take_reboot() && self.referee.has_collided() {
            self.mend();
        }
        // A vehicle that hit something has broken propellers, whatever its autopilot asks.
        let crashed = self.referee.has_collided();
        let before = self.vehicle.truth();
        self.vehicle
            .step(if crashed { &ControlCommand::MotorsOff } else { &command });
        let truth = self.vehicle.truth();
        let elapsed_ns = self.elapsed_ms * MILLISECOND_NS;
        self.world.set_time_ns(elapsed_ns);
        if let Some(zones) = &mut self.zones
            && let Some(ranges) = zones.measure(elapsed_ns, &self.world, truth.position_ned_m, truth.attitude)
        {
            self.endpoint.observe_ranges(ranges);
        }

        // The referee's first look is at the lift-off.
        if self.referee.started_ns.is_some() || !self.vehicle.view().on_ground {
            if self.referee.outcome().is_none() {
                self.path_length_m += f64::from((truth.position_ned_m - before.position_ned_m).norm());
                self.closest_goal_m = self.closest_goal_m.min(self.goal_distance_m());
            }
            if self.estimate_wanders {
                let estimated_ned_m = self.vehicle.view().estimate.position_ned_m;
                self.referee.estimate_error_ned_m = estimated_ned_m - truth.position_ned_m;
            }
            self.referee.motors_run = self.vehicle.view().armed;
            self.referee.observe(
                &self.world,
                elapsed_ns,
                truth.position_ned_m,
                truth.attitude,
                truth.velocity_ned_m_s,
            );
            if !crashed && self.referee.has_collided() {
                // It would look as if it did not obey.
                self.endpoint.break_down();
            }
        }
    }

    /// After a collision and a reboot: another flight, of a whole vehicle that stands at the start again.
    fn mend(&mut self) {
        let (start_ned_m, heading_rad) = self.start;
        self.vehicle.place(start_ned_m, heading_rad, false);
        self.referee = self.fresh_referee.clone();
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
        self.endpoint.transmit(|link, _, datagram| {
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
        let flight_time_s = (self.referee.duration_ns()? / MILLISECOND_NS) as f64 * 1e-3;
        self.referee.outcome().map(|outcome| Ending { outcome, flight_time_s })
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
        (self.referee.goal_ned_m - self.vehicle.truth().position_ned_m).horizontal_norm()
    }
}
