//! One flight over one course, stepped at 20 Hz without MAVLink and guidance.

use vigil_policy::{PilotInput, RangeScan, apf};
use vigil_types::{
    Action, AttitudeSample, DepthFrame, Goal, GoalRelative, HeadingVector, Kinematics, NedVector, STEP_NS,
};
use vigil_vehicle::{ControlCommand, ParamsError, Truth, Vehicle, VehicleParams, Wind, YawCommand};
use vigil_world::{Course, Lidar, LidarConfig, Outcome, Referee, Shot, World};

/// Vertical speed per metre of height error, 1/s, and its limit: guidance's height hold (docs/guidance.md).
const HEIGHT_GAIN_PER_S: f32 = 0.8;
const VERTICAL_LIMIT_M_S: f32 = 0.5;
/// Physics steps in one step of the loop.
const PHYSICS_STEPS: u64 = STEP_NS / vigil_vehicle::STEP_NS;

/// Vehicle, LiDAR and referee of one flight, with the newest depth frame.
pub struct Flight {
    world: World,
    vehicle: Box<Vehicle>,
    lidar: Lidar,
    referee: Referee,
    goal: Goal,
    frame: Box<DepthFrame>,
    surroundings: Box<RangeScan>,
    sequence: u64,
    checkpoints: usize,
}

impl Flight {
    /// Begins hovering at the course's start with the first frame taken. The seed fixes all noise.
    ///
    /// # Errors
    /// None with the default vehicle; its parameters are checked all the same.
    pub fn new(course: &Course, wind: Wind, seed: u64) -> Result<Self, ParamsError> {
        Self::with_lidar(course, wind, LidarConfig::default(), seed)
    }

    /// The same with another LiDAR.
    ///
    /// # Errors
    /// Wind out of its range.
    ///
    /// # Panics
    /// A LiDAR out of its range.
    pub fn with_lidar(course: &Course, wind: Wind, lidar: LidarConfig, seed: u64) -> Result<Self, ParamsError> {
        let mut vehicle = Box::new(Vehicle::new(VehicleParams::default(), wind, seed)?);
        let start = course.start_ned_m();
        let height = NedVector::new(start.x, start.y, -course.flight_height_m);
        vehicle.place(height, course.start_heading_rad(), true);
        let lidar = Lidar::new(lidar, seed).unwrap_or_else(|e| panic!("{e}"));
        let mut flight = Self {
            world: World::new(course),
            vehicle,
            lidar,
            referee: Referee::new(course),
            goal: Goal {
                position_ned_m: course.goal_ned_m(),
            },
            frame: Box::new(DepthFrame::EMPTY),
            surroundings: Box::new(RangeScan::new()),
            sequence: 0,
            checkpoints: course.checkpoints.len(),
        };
        flight.look();
        Ok(flight)
    }

    /// Takes the next frame, where the vehicle is now.
    pub fn look(&mut self) {
        self.world.set_time_ns(self.vehicle.truth().at_ns);
        let (truth, estimate) = (self.vehicle.truth(), self.vehicle.view().estimate);
        let shot = Shot {
            position_ned_m: truth.position_ned_m,
            attitude: truth.attitude,
            estimated_position_ned_m: estimate.position_ned_m,
            estimated_attitude: estimate.attitude,
            stamp_ns: truth.at_ns,
            sequence: self.sequence,
            sensor_id: 0,
        };
        self.lidar.capture(&self.world, &shot, &mut self.frame);
        self.sequence += 1;
    }

    /// The newest frame.
    pub fn frame(&self) -> &DepthFrame {
        &self.frame
    }

    /// Distance and bearing to the goal as the vehicle believes.
    pub fn goal(&self) -> GoalRelative {
        let estimate = self.vehicle.view().estimate;
        let kinematics = Kinematics {
            at_ns: estimate.at_ns,
            position_ned_m: estimate.position_ned_m,
            velocity_ned_m_s: estimate.velocity_ned_m_s,
        };
        let attitude = AttitudeSample {
            at_ns: estimate.at_ns,
            attitude: estimate.attitude,
            rates_frd_rad_s: estimate.rates_frd_rad_s,
        };
        self.goal.relative_to(&kinematics, &attitude)
    }

    /// What a pilot may look at.
    pub fn input(&self) -> PilotInput<'_> {
        let estimate = self.vehicle.view().estimate;
        PilotInput {
            now_ns: estimate.at_ns,
            depth: &self.frame,
            goal: self.goal(),
            attitude: estimate.attitude,
            velocity_m_s: estimate.velocity_ned_m_s.to_heading(estimate.attitude.yaw_rad()),
            height_m: -estimate.position_ned_m.z,
        }
    }

    /// The paper's potential field here and now, of the nearest surface within ±`half_angle_rad` of the nose
    /// and nearer than `range_m`.
    pub fn field(&mut self, half_angle_rad: f32, range_m: f32) -> Action {
        let estimate = self.vehicle.view().estimate;
        let goal = self.goal();
        let input = PilotInput {
            now_ns: estimate.at_ns,
            depth: &self.frame,
            goal,
            attitude: estimate.attitude,
            velocity_m_s: estimate.velocity_ned_m_s.to_heading(estimate.attitude.yaw_rad()),
            height_m: -estimate.position_ned_m.z,
        };
        let obstacle = self.surroundings.observe(&input).nearest_within(half_angle_rad);
        apf::force(goal, obstacle, range_m)
    }

    /// Horizontal distance to the goal, the truth.
    pub fn goal_distance_m(&self) -> f32 {
        (self.goal.position_ned_m - self.vehicle.truth().position_ned_m).horizontal_norm()
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

    /// Flies one step of 50 ms under an action and takes the next frame. `Some` when the flight has ended.
    pub fn advance(&mut self, action: Action) -> Option<Outcome> {
        let outcome = self.advance_unseen(action);
        // The state in which a flight is cut off still counts.
        if matches!(outcome, None | Some(Outcome::TimeOut)) {
            self.look();
        }
        outcome
    }

    /// [`Self::advance`] without the next frame, whose rays are most of a step's cost.
    pub fn advance_unseen(&mut self, action: Action) -> Option<Outcome> {
        let action = action.clipped();
        let height_error_m = self.goal.position_ned_m.z - self.vehicle.view().estimate.position_ned_m.z;
        let down_m_s = (HEIGHT_GAIN_PER_S * height_error_m).clamp(-VERTICAL_LIMIT_M_S, VERTICAL_LIMIT_M_S);
        let command = ControlCommand::VelocityHeading {
            velocity_m_s: HeadingVector::new(action.forward_m_s, 0.0, down_m_s),
            yaw: YawCommand::Rate {
                yaw_rate_rad_s: action.yaw_rate_rad_s(),
            },
        };
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
