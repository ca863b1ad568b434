//! A tiny analytic world for the pilot's tests: solids, an exact depth image of them and a vehicle of first-order lags.
//! Independent of the simulator, so that an error there cannot hide one here.
#![allow(dead_code, reason = "each test program uses a part")]

use vigil_policy::{Pilot, PilotInput};
use vigil_types::{
    Action, Attitude, AttitudeSample, DEPTH_COLS, DEPTH_FULL_SCALE_M, DepthFrame, FrdVector, Goal, GoalRelative,
    HeadingVector, Kinematics, NedVector, STEP_NS, STEP_S, column_bearing_rad, row_elevation_rad,
};

/// Axis-aligned box or vertical cylinder, NED metres; heights positive up.
#[derive(Debug, Clone, Copy)]
pub enum Solid {
    Block {
        north: [f32; 2],
        east: [f32; 2],
        up: [f32; 2],
    },
    /// 4 m high.
    Column { north: f32, east: f32, radius: f32 },
}

#[derive(Debug, Clone, Default)]
pub struct Scene {
    pub solids: Vec<Solid>,
}

/// A ceiling from this height on.
pub fn ceiling(up: f32) -> Solid {
    beam([-100.0, 100.0], [-100.0, 100.0], [up, 4.0])
}

pub fn block(north: [f32; 2], east: [f32; 2]) -> Solid {
    beam(north, east, [0.0, 4.0])
}

pub fn beam(north: [f32; 2], east: [f32; 2], up: [f32; 2]) -> Solid {
    Solid::Block { north, east, up }
}

pub fn column(north: f32, east: f32, radius: f32) -> Solid {
    Solid::Column { north, east, radius }
}

fn slab(origin: f32, direction: f32, range: [f32; 2]) -> (f32, f32) {
    if direction == 0.0 {
        return if (range[0]..=range[1]).contains(&origin) {
            (f32::NEG_INFINITY, f32::INFINITY)
        } else {
            (1.0, -1.0)
        };
    }
    let (a, b) = ((range[0] - origin) / direction, (range[1] - origin) / direction);
    (a.min(b), a.max(b))
}

impl Solid {
    fn hit(&self, from: [f32; 3], dir: [f32; 3]) -> Option<f32> {
        let (near, far) = match *self {
            Solid::Block { north, east, up } => {
                let n = slab(from[0], dir[0], north);
                let e = slab(from[1], dir[1], east);
                let u = slab(from[2], dir[2], up);
                (n.0.max(e.0).max(u.0), n.1.min(e.1).min(u.1))
            }
            Solid::Column { north, east, radius } => {
                let (n, e) = (from[0] - north, from[1] - east);
                let a = dir[0] * dir[0] + dir[1] * dir[1];
                let b = n * dir[0] + e * dir[1];
                let root = (b * b - a * (n * n + e * e - radius * radius)).sqrt();
                let u = slab(from[2], dir[2], [0.0, 4.0]);
                if root.is_nan() {
                    return None;
                }
                (((-b - root) / a).max(u.0), ((-b + root) / a).min(u.1))
            }
        };
        (near <= far && near > 0.0).then_some(near)
    }

    /// Horizontal distance of a position at this height from the solid; infinite if it is wholly above or below.
    pub fn distance(&self, position: NedVector) -> f32 {
        let up = -position.z;
        match *self {
            Solid::Block {
                north,
                east,
                up: [low, high],
            } => {
                if up + 0.1 < low || up - 0.1 > high {
                    return f32::INFINITY;
                }
                let outside = |x: f32, [low, high]: [f32; 2]| (low - x).max(x - high).max(0.0);
                outside(position.x, north).hypot(outside(position.y, east))
            }
            Solid::Column { north, east, radius } => (position.x - north).hypot(position.y - east) - radius,
        }
    }
}

impl Scene {
    pub fn new(solids: impl Into<Vec<Solid>>) -> Self {
        Self { solids: solids.into() }
    }

    pub fn range(&self, position: NedVector, attitude: Attitude, row: usize, col: usize) -> f32 {
        let (b, e) = (column_bearing_rad(col as f32), row_elevation_rad(row as f32));
        let d = attitude.to_ned(FrdVector::new(e.cos() * b.cos(), e.cos() * b.sin(), -e.sin()));
        let (from, dir) = ([position.x, position.y, -position.z], [d.x, d.y, -d.z]);
        let floor = if dir[2] < 0.0 { -from[2] / dir[2] } else { f32::INFINITY };
        let hits = self.solids.iter().filter_map(|s| s.hit(from, dir));
        hits.fold(floor, f32::min)
    }

    pub fn render(&self, position: NedVector, attitude: Attitude, stamp_ns: u64, frame: &mut DepthFrame) {
        frame.header.stamp_ns = stamp_ns;
        frame.header.position_ned_m = position;
        frame.header.attitude = attitude;
        // Like the sensor, every second row is measured; the row below repeats it.
        for (pair, rows) in frame.depth.chunks_exact_mut(2 * DEPTH_COLS).enumerate() {
            let (measured, repeated) = rows.split_at_mut(DEPTH_COLS);
            for (col, pixel) in measured.iter_mut().enumerate() {
                let range = self.range(position, attitude, 2 * pair, col);
                *pixel = if range < 60.0 { range / DEPTH_FULL_SCALE_M } else { 1.0 };
            }
            repeated.copy_from_slice(measured);
        }
    }

    pub fn distance(&self, position: NedVector) -> f32 {
        self.solids
            .iter()
            .map(|s| s.distance(position))
            .fold(f32::INFINITY, f32::min)
    }
}

pub fn frame_of(scene: &Scene, position: NedVector, attitude: Attitude) -> Box<DepthFrame> {
    let mut frame = Box::new(DepthFrame::EMPTY);
    scene.render(position, attitude, 0, &mut frame);
    frame
}

/// What is seen on a slow walk north through a scene, a frame for each step.
pub fn walk(scene: &Scene, steps: u64) -> Vec<DepthFrame> {
    let look = |step| {
        let mut frame = DepthFrame::EMPTY;
        let here = NedVector::new(0.05 * step as f32, 0.0, -1.5);
        let attitude = Attitude::from_euler_rad(0.02, -0.05, 0.01 * step as f32);
        scene.render(here, attitude, step * STEP_NS, &mut frame);
        frame.header.sequence = step;
        frame
    };
    (0..steps).map(look).collect()
}

pub fn input(frame: &DepthFrame, attitude: Attitude) -> PilotInput<'_> {
    let goal = relative((20.0, 0.0), frame.header.position_ned_m, attitude);
    PilotInput {
        attitude,
        ..PilotInput::at_rest(frame, goal)
    }
}

/// A goal at 1.5 m height as the vehicle sees it.
fn relative((north, east): (f32, f32), position_ned_m: NedVector, attitude: Attitude) -> GoalRelative {
    let goal = Goal {
        position_ned_m: NedVector::new(north, east, -1.5),
    };
    let kinematics = Kinematics::new(0, position_ned_m, NedVector::ZERO);
    let attitude = AttitudeSample::new(0, attitude, FrdVector::ZERO);
    goal.relative_to(&kinematics, &attitude)
}

/// How a flight of [`fly`] went.
#[derive(Debug, Clone, Default)]
pub struct Flight {
    pub reached: bool,
    pub time_s: f32,
    /// Least distance between the vehicle's middle and any solid.
    pub least_clearance_m: f32,
    pub positions: Vec<NedVector>,
    pub actions: Vec<Action>,
}

impl Flight {
    #[track_caller]
    pub fn assert_arrived(&self, clear_m: f32) {
        let (time_s, at) = (self.time_s, self.positions.last());
        assert!(self.reached, "not there after {time_s} s, at {at:?}");
        let least_m = self.least_clearance_m;
        assert!(least_m > clear_m, "came within {least_m} m");
    }
}

/// Flies a pilot at 1.5 m height until it is within 1 m of the goal, or for `limit_s`. The velocity follows its setpoint with
/// a lag of 0.6 s, the yaw rate with 0.3 s; the body pitches as it accelerates.
pub fn fly(
    scene: &Scene,
    pilot: &mut dyn Pilot,
    start_yaw_rad: f32,
    goal_north_east: (f32, f32),
    limit_s: f32,
) -> Flight {
    let mut position = NedVector::new(0.0, 0.0, -1.5);
    let (mut yaw, mut yaw_rate) = (start_yaw_rad, 0.0_f32);
    let mut velocity = NedVector::ZERO;
    let mut pitch_rad = 0.0_f32;
    let mut frame = Box::new(DepthFrame::EMPTY);
    let mut flight = Flight {
        least_clearance_m: f32::INFINITY,
        ..Flight::default()
    };
    for step in 0..(limit_s / STEP_S) as u64 {
        let now_ns = step * STEP_NS;
        let attitude = Attitude::from_euler_rad(0.0, pitch_rad, yaw);
        frame.header.sequence = step;
        scene.render(position, attitude, now_ns, &mut frame);
        let relative = relative(goal_north_east, position, attitude);
        flight.time_s = now_ns as f32 * 1e-9;
        flight.positions.push(position);
        flight.least_clearance_m = flight.least_clearance_m.min(scene.distance(position));
        if relative.distance_m < 1.0 {
            flight.reached = true;
            break;
        }
        let action = pilot.decide(&PilotInput {
            now_ns,
            depth: &frame,
            goal: relative,
            attitude,
            velocity_m_s: velocity.to_heading(yaw),
            height_m: 1.5,
        });
        flight.actions.push(action);
        for _ in 0..10 {
            let dt = STEP_S / 10.0;
            let wanted = HeadingVector::new(action.forward_m_s, 0.0, 0.0).to_ned(yaw);
            let acceleration = (wanted - velocity) * (1.0 / 0.6);
            velocity = velocity + acceleration * dt;
            position = position + velocity * dt;
            yaw_rate += (action.yaw_rate_rad_s() - yaw_rate) * dt / 0.3;
            yaw += yaw_rate * dt;
            pitch_rad = -(acceleration.to_heading(yaw).x / 9.81).clamp(-0.3, 0.3);
        }
    }
    flight
}
