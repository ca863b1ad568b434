//! States to compare on: what the actor sees and remembers on development courses.

use anyhow::Result;
use vigil_adversary::Beside;
use vigil_policy::PilotInput;
use vigil_policy::actor::{ACTOR_HIDDEN, ACTOR_OUTPUTS, Actor};
use vigil_sim::world::{Course, Family, Lidar, LidarConfig, Shot, World, generate};
use vigil_types::{
    ACTION_LIMIT, Attitude, AttitudeSample, DepthFrame, FrdVector, Goal, HeadingVector, Kinematics, NedVector, STEP_NS,
};

/// Steps between two states of a flight.
const EVERY_STEPS: u64 = 12;
/// States of a flight, at most.
const STATES: u64 = 8;
/// A flight ends this near to a surface, metres.
const NEAR_M: f32 = 0.6;
const STEP_S: f32 = STEP_NS as f32 * 1e-9;

/// What the networks take, a frame of normalised range, what is remembered and the low-dimensional observation, and what the actor made
/// of it.
#[derive(Debug, Clone)]
pub struct State {
    pub frame: Vec<f32>,
    pub beside: Beside,
    pub hidden: [f32; ACTOR_HIDDEN],
    pub action: [f32; ACTOR_OUTPUTS],
}

impl State {
    /// The networks' inputs.
    pub fn inputs(&self) -> [&[f32]; 3] {
        [&self.frame, &self.beside.context, &self.beside.low_dim]
    }
}

/// Moves through a course as the actor decides, obeying at once: states at equal distances in time.
pub fn watch(actor: &mut Actor, seed: u64) -> Result<Vec<State>> {
    let course: Course = generate(Family::Validation, seed);
    let mut world = World::new(&course);
    let mut lidar = Lidar::new(LidarConfig::default(), seed)?;
    let mut frame = Box::new(DepthFrame::EMPTY);
    let goal = Goal {
        position_ned_m: course.goal_ned_m(),
    };
    let start = course.start_ned_m();
    let mut position_ned_m = NedVector::new(start.x, start.y, -course.flight_height_m);
    let mut yaw_rad = course.start_heading_rad();
    let mut states = Vec::new();
    actor.reset();
    for step in 0..=STATES * EVERY_STEPS {
        let attitude = Attitude::from_euler_rad(0.0, 0.0, yaw_rad);
        let at_ns = step * STEP_NS;
        world.set_time_ns(at_ns);
        let shot = Shot {
            stamp_ns: at_ns,
            sequence: step,
            ..Shot::at(position_ned_m, attitude)
        };
        lidar.capture(&world, &shot, &mut frame);
        let kinematics = Kinematics::new(at_ns, position_ned_m, NedVector::new(0.0, 0.0, 0.0));
        let sample = AttitudeSample::new(at_ns, attitude, FrdVector::new(0.0, 0.0, 0.0));
        let action = actor.decide(&PilotInput {
            now_ns: at_ns,
            attitude,
            height_m: -position_ned_m.z,
            ..PilotInput::at_rest(&frame, goal.relative_to(&kinematics, &sample))
        })?;
        if step > 0 && step % EVERY_STEPS == 0 {
            states.push(State {
                frame: frame.depth.to_vec(),
                beside: Beside::of(actor),
                hidden: *actor.state(),
                action,
            });
        }
        let [forward_m_s, yaw] = action;
        let velocity = HeadingVector::new(forward_m_s.clamp(-ACTION_LIMIT, ACTION_LIMIT), 0.0, 0.0).to_ned(yaw_rad);
        position_ned_m = position_ned_m + velocity * STEP_S;
        yaw_rad += yaw * vigil_types::YAW_RATE_PER_UNIT_RAD_S * STEP_S;
        if world.clearance_m(position_ned_m) < NEAR_M {
            break;
        }
    }
    Ok(states)
}
