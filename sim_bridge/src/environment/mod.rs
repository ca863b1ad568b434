//! One flight over one course as a function of setpoints, without MAVLink, guidance and pilots: what training runs in.
//!
//! The caller makes the setpoints; the vehicle, the LiDAR and the referee are the simulator's.
//!
//! ```
//! use vigil_sim::environment::Environment;
//! use vigil_types::{HeadingVector, VelocitySetpoint};
//! use vigil_sim::vehicle::Wind;
//! use vigil_sim::world::{Family, generate};
//!
//! let mut environment = Environment::new(&generate(Family::Validation, 7), Wind::default(), 7)?;
//! let ahead = VelocitySetpoint { velocity_m_s: HeadingVector::new(1.0, 0.0, 0.0), yaw_rate_rad_s: 0.0 };
//! let before_m = environment.goal_distance_m();
//! for _ in 0..40 {
//!     assert_eq!(environment.advance(ahead), None, "two seconds are no flight");
//! }
//! assert!(environment.goal_distance_m() < before_m && environment.frame().header.sequence == 40);
//! # Ok::<(), vigil_sim::vehicle::ParamsError>(())
//! ```

mod shortest_path;
pub mod true_state;

pub use shortest_path::ShortestPath;

use crate::vehicle::{ControlCommand, Estimate, ParamsError, Truth, Vehicle, VehicleParams, Wind, YawCommand};
use crate::world::{Course, Lidar, LidarConfig, Outcome, Referee, Shot, World};
use vigil_types::{AttitudeSample, DepthFrame, Goal, GoalRelative, Kinematics, NedVector, STEP_NS, VelocitySetpoint};

/// Physics steps in one step of the loop.
const PHYSICS_STEPS: u64 = STEP_NS / crate::vehicle::STEP_NS;

/// Vehicle, LiDAR and referee of one flight, with the newest depth frame. It advances in steps of 50 ms; the same setpoints give
/// the same bits.
pub struct Environment {
    world: World,
    vehicle: Box<Vehicle>,
    /// The vehicle's own LiDAR and its newest frame, from the first look on.
    eye: Option<Box<(Lidar, DepthFrame)>>,
    lidar: LidarConfig,
    seed: u64,
    referee: Referee,
    goal: Goal,
    sequence: u64,
    checkpoints: usize,
}

impl Environment {
    /// Begins hovering at the course's start with the first frame taken. The seed fixes all noise.
    ///
    /// # Errors
    /// Wind out of its range.
    pub fn new(course: &Course, wind: Wind, seed: u64) -> Result<Self, ParamsError> {
        Self::of(course, VehicleParams::default(), wind, LidarConfig::default(), seed)
    }

    /// The same with another LiDAR and another vehicle: a model's ([`crate::vehicle::VehicleModel::params`]) or one drawn between the
    /// models ([`VehicleParams::drawn`]).
    ///
    /// # Errors
    /// Wind or vehicle out of their range.
    ///
    /// # Panics
    /// A LiDAR out of its range.
    pub fn of(
        course: &Course,
        vehicle: VehicleParams,
        wind: Wind,
        lidar: LidarConfig,
        seed: u64,
    ) -> Result<Self, ParamsError> {
        let mut environment = Self::unseen(course, vehicle, wind, seed)?;
        environment.lidar = lidar;
        environment.look();
        Ok(environment)
    }

    /// Begins without a frame, for one that is shown pictures by a LiDAR that many share ([`look_through`](Self::look_through)).
    ///
    /// # Errors
    /// Wind or vehicle out of their range.
    pub fn unseen(course: &Course, vehicle: VehicleParams, wind: Wind, seed: u64) -> Result<Self, ParamsError> {
        let mut vehicle = Box::new(Vehicle::new(vehicle, wind, seed)?);
        let start = course.start_ned_m();
        let height = NedVector::new(start.x, start.y, -course.flight_height_m);
        vehicle.place(height, course.start_heading_rad(), true);
        Ok(Self {
            world: World::new(course),
            vehicle,
            eye: None,
            lidar: LidarConfig::default(),
            seed,
            referee: Referee::new(course),
            goal: Goal {
                position_ned_m: course.goal_ned_m(),
            },
            sequence: 0,
            checkpoints: course.checkpoints.len(),
        })
    }

    /// Takes the next frame, where the vehicle is now.
    ///
    /// # Panics
    /// A LiDAR out of its range.
    pub fn look(&mut self) {
        let (shot, seed, lidar) = (self.shot(), self.seed, self.lidar);
        let eye = self.eye.get_or_insert_with(|| {
            let lidar = Lidar::new(lidar, seed).unwrap_or_else(|e| panic!("{e}"));
            Box::new((lidar, DepthFrame::EMPTY))
        });
        eye.0.capture(&self.world, &shot, &mut eye.1);
    }

    /// Takes the newest frame again, with its noise.
    pub fn look_again(&mut self) {
        self.sequence -= 1;
        self.look();
    }

    /// The pixels that [`look`](Self::look) would take, times `scale`, through somebody else's LiDAR.
    ///
    /// # Panics
    /// Pixels of another number than the LiDAR's [`shape`](Lidar::shape).
    pub fn look_through(&mut self, lidar: &mut Lidar, scale: f32, pixels: &mut [f32]) {
        let shot = self.shot();
        lidar.look(&self.world, &shot, self.seed, scale, pixels);
    }

    /// Where the next frame is taken.
    fn shot(&mut self) -> Shot {
        self.world.set_time_ns(self.vehicle.truth().at_ns);
        let (truth, estimate) = (self.vehicle.truth(), self.vehicle.view().estimate);
        let shot = Shot {
            estimated_position_ned_m: estimate.position_ned_m,
            estimated_attitude: estimate.attitude,
            stamp_ns: truth.at_ns,
            sequence: self.sequence,
            ..Shot::at(truth.position_ned_m, truth.attitude)
        };
        self.sequence += 1;
        shot
    }

    /// The newest frame; one without returns where none was taken.
    pub fn frame(&self) -> &DepthFrame {
        self.eye.as_ref().map_or(&DepthFrame::EMPTY, |eye| &eye.1)
    }

    /// Where to fly.
    pub fn goal(&self) -> Goal {
        self.goal
    }

    /// How the vehicle believes to move: what its telemetry would tell.
    pub fn estimate(&self) -> Estimate {
        self.vehicle.view().estimate
    }

    /// Distance and bearing to the goal as the vehicle believes.
    pub fn goal_relative(&self) -> GoalRelative {
        let estimate = self.estimate();
        let kinematics = Kinematics::new(estimate.at_ns, estimate.position_ned_m, estimate.velocity_ned_m_s);
        let attitude = AttitudeSample::new(estimate.at_ns, estimate.attitude, estimate.rates_frd_rad_s);
        self.goal.relative_to(&kinematics, &attitude)
    }

    /// Horizontal distance to the goal in metres, the truth.
    pub fn goal_distance_m(&self) -> f32 {
        (self.goal.position_ned_m - self.vehicle.truth().position_ned_m).horizontal_norm()
    }

    /// Distance of the vehicle's middle from the nearest obstacle, metres; infinite in an empty world.
    pub fn obstacle_distance_m(&self) -> f32 {
        self.world.clearance_m(self.vehicle.truth().position_ned_m)
    }

    /// How many checkpoints were passed, of how many.
    pub fn checkpoints(&self) -> (usize, usize) {
        (self.referee.checkpoints_passed(), self.checkpoints)
    }

    /// Time since the start, seconds; the whole flight's once it has ended.
    pub fn time_s(&self) -> f64 {
        let now_s = self.vehicle.truth().at_ns as f64 * 1e-9;
        self.referee.duration_s().unwrap_or(now_s)
    }

    /// How the vehicle really moves, which no pilot knows.
    pub fn truth(&self) -> Truth {
        self.vehicle.truth()
    }

    /// Flies one step of 50 ms under a setpoint and takes the next frame. `Some` when the flight has ended.
    pub fn advance(&mut self, setpoint: VelocitySetpoint) -> Option<Outcome> {
        let outcome = self.advance_unseen(setpoint);
        // The state in which a flight is cut off still counts.
        if matches!(outcome, None | Some(Outcome::TimeOut)) {
            self.look();
        }
        outcome
    }

    /// [`Self::advance`] without the next frame, whose rays are most of a step's cost.
    pub fn advance_unseen(&mut self, setpoint: VelocitySetpoint) -> Option<Outcome> {
        let command = ControlCommand::VelocityHeading(setpoint.velocity_m_s, YawCommand::Rate(setpoint.yaw_rate_rad_s));
        for _ in 0..PHYSICS_STEPS {
            self.vehicle.step(&command);
            let truth = self.vehicle.truth();
            self.world.set_time_ns(truth.at_ns);
            let outcome = self.referee.observe(
                &self.world,
                truth.at_ns,
                truth.position_ned_m,
                truth.attitude,
                truth.velocity_ned_m_s,
            );
            if outcome.is_some() {
                return outcome;
            }
        }
        None
    }
}
