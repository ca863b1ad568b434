//! An environment flown by actions: guidance's law makes the setpoints, as in flight, and pilots see what they see there.

use vigil_guidance::{GuidanceConfig, guided_setpoint};
use vigil_policy::{PilotInput, RangeScan, apf};
use vigil_sim::environment::Environment;
use vigil_sim::vehicle::{Estimate, ParamsError, Truth, VehicleParams, Wind};
use vigil_sim::world::{Course, Lidar, LidarConfig, Outcome};
use vigil_types::{Action, DepthFrame, GoalRelative};

/// One flight over one course, stepped at 20 Hz by actions.
pub struct Flight {
    environment: Environment,
    guidance: GuidanceConfig,
    surroundings: Box<RangeScan>,
}

impl Flight {
    /// Begins hovering at the course's start with the first frame taken. The seed fixes all noise.
    ///
    /// # Errors
    /// Wind out of its range.
    pub fn new(course: &Course, wind: Wind, seed: u64) -> Result<Self, ParamsError> {
        Self::with_lidar(course, wind, LidarConfig::default(), seed)
    }

    /// The same with another vehicle.
    ///
    /// # Errors
    /// A vehicle out of its range.
    pub fn with_vehicle(course: &Course, vehicle: VehicleParams, seed: u64) -> Result<Self, ParamsError> {
        let environment = Environment::of(course, vehicle, Wind::default(), LidarConfig::default(), seed)?;
        Ok(Self::around(environment))
    }

    /// The same with another LiDAR.
    ///
    /// # Errors
    /// Wind out of its range.
    ///
    /// # Panics
    /// A LiDAR out of its range.
    pub fn with_lidar(course: &Course, wind: Wind, lidar: LidarConfig, seed: u64) -> Result<Self, ParamsError> {
        let environment = Environment::of(course, VehicleParams::default(), wind, lidar, seed)?;
        Ok(Self::around(environment))
    }

    /// Begins without a frame, for a LiDAR that many flights share ([`look_through`](Self::look_through)).
    ///
    /// # Errors
    /// Wind out of its range.
    pub fn unseen(course: &Course, wind: Wind, seed: u64) -> Result<Self, ParamsError> {
        let environment = Environment::unseen(course, VehicleParams::default(), wind, seed)?;
        Ok(Self::around(environment))
    }

    fn around(environment: Environment) -> Self {
        Self {
            environment,
            guidance: GuidanceConfig::default(),
            surroundings: Box::new(RangeScan::new()),
        }
    }

    /// Takes the next frame, where the vehicle is now.
    pub fn look(&mut self) {
        self.environment.look();
    }

    /// The next frame's pixels, times `scale`, through somebody else's LiDAR.
    ///
    /// # Panics
    /// Pixels of another number than the LiDAR's [`shape`](Lidar::shape).
    pub fn look_through(&mut self, lidar: &mut Lidar, scale: f32, pixels: &mut [f32]) {
        self.environment.look_through(lidar, scale, pixels);
    }

    /// Takes the newest frame again.
    pub fn look_again(&mut self) {
        self.environment.look_again();
    }

    /// The newest frame.
    pub fn frame(&self) -> &DepthFrame {
        self.environment.frame()
    }

    /// Distance and bearing to the goal as the vehicle believes.
    pub fn goal(&self) -> GoalRelative {
        self.environment.goal_relative()
    }

    /// What a pilot may look at.
    pub fn input(&self) -> PilotInput<'_> {
        input(&self.environment)
    }

    /// The paper's potential field here and now, of the nearest surface within ±`half_angle_rad` of the nose
    /// and nearer than `range_m`.
    pub fn field(&mut self, half_angle_rad: f32, range_m: f32) -> Action {
        let input = input(&self.environment);
        let obstacle = self.surroundings.observe(&input).nearest_within(half_angle_rad);
        apf::force(input.goal, obstacle, range_m)
    }

    /// Horizontal distance to the goal in metres, the truth.
    pub fn goal_distance_m(&self) -> f32 {
        self.environment.goal_distance_m()
    }

    /// Distance of the vehicle's middle from the nearest obstacle in metres, the truth.
    pub fn obstacle_distance_m(&self) -> f32 {
        self.environment.obstacle_distance_m()
    }

    /// How many checkpoints were passed, of how many.
    pub fn checkpoints(&self) -> (usize, usize) {
        self.environment.checkpoints()
    }

    /// Time since the start, seconds; the whole flight's once it has ended.
    pub fn time_s(&self) -> f64 {
        self.environment.time_s()
    }

    /// How the vehicle believes to move.
    pub fn estimate(&self) -> Estimate {
        self.environment.estimate()
    }

    /// How the vehicle really moves, which no pilot knows.
    pub fn truth(&self) -> Truth {
        self.environment.truth()
    }

    /// Flies one step of 50 ms under an action and takes the next frame. `Some` when the flight has ended.
    pub fn advance(&mut self, action: Action) -> Option<Outcome> {
        self.environment.advance(self.setpoint(action))
    }

    /// [`Self::advance`] without the next frame.
    pub fn advance_unseen(&mut self, action: Action) -> Option<Outcome> {
        self.environment.advance_unseen(self.setpoint(action))
    }

    fn setpoint(&self, action: Action) -> vigil_types::VelocitySetpoint {
        let position_ned_m = self.environment.estimate().position_ned_m;
        guided_setpoint(&self.guidance, action, self.environment.goal(), position_ned_m)
    }
}

fn input(environment: &Environment) -> PilotInput<'_> {
    let estimate = environment.estimate();
    PilotInput {
        now_ns: estimate.at_ns,
        depth: environment.frame(),
        goal: environment.goal_relative(),
        attitude: estimate.attitude,
        velocity_m_s: estimate.velocity_ned_m_s.to_heading(estimate.attitude.yaw_rad()),
        height_m: -estimate.position_ned_m.z,
    }
}
