//! The speed governor: the fastest forward speed from which the vehicle can still stop clear of everything it knows.
//!
//! For each candidate speed the vehicle is simulated: a short time under the command, then braking to a stop. A
//! candidate is admissible if no point of the scan and no remembered obstacle comes too near on the way (the admissible
//! velocities of the dynamic window approach; Fox, Burgard, Thrun 1997).

use crate::memory::Memory;
use crate::surroundings::{SECTORS, Scan};
use vigil_types::{ACTION_LIMIT, HeadingVector, NedVector};

/// Distance kept between the vehicle's middle and any point seen: its radius of 0.30 m and 0.12 m.
const KEEP_CLEAR_M: f32 = 0.42;
/// Remembered obstacles are only known to a cell; squared cells, 0.35 m.
const KEEP_CLEAR_SQUARED_CELLS: u8 = 2;
/// A point that is too near already must not get nearer than by this.
const CREEP_M: f32 = 0.02;
/// Time under the command before braking begins: a step, the frame's age and the estimator's delay.
const REACTION_S: f32 = 0.2;
/// Lag of the velocity behind its setpoint; FACTS.md: 63 % of 1.5 m/s in 0.79 s, a stop from 1.5 m/s in 1.07 m.
const VELOCITY_LAG_S: f32 = 0.7;
/// Simulation step and number of steps: until nearly all of the speed is gone.
const STEP_S: f32 = 0.1;
const STEPS: usize = 18;
/// Speeds tried, as parts of the wanted one.
const PARTS: [f32; 7] = [1.0, 0.8, 0.6, 0.45, 0.3, 0.2, 0.1];

/// What the governor needs to know of the vehicle.
#[derive(Debug, Clone, Copy)]
pub struct Motion {
    /// Position now.
    pub position_ned_m: NedVector,
    /// Heading now, radians clockwise from north.
    pub yaw_rad: f32,
    /// Velocity now.
    pub velocity_m_s: HeadingVector,
    /// Yaw rate commanded, radians per second clockwise.
    pub yaw_rate_rad_s: f32,
}

/// The fastest admissible forward speed up to `wanted_m_s`; 0 if none is.
pub fn admissible_speed_m_s(motion: &Motion, scan: &Scan, memory: &Memory, wanted_m_s: f32) -> f32 {
    let wanted_m_s = wanted_m_s.clamp(0.0, ACTION_LIMIT);
    let mut limits = [0.0_f32; SECTORS];
    for (limit, range_m) in limits.iter_mut().zip(&scan.range_m) {
        let keep_m = (range_m - CREEP_M).clamp(0.0, KEEP_CLEAR_M);
        *limit = keep_m * keep_m;
    }
    PARTS
        .iter()
        .map(|part| part * wanted_m_s)
        .find(|&speed_m_s| stays_clear(motion, scan, &limits, memory, speed_m_s))
        .unwrap_or(0.0)
}

fn stays_clear(motion: &Motion, scan: &Scan, limits: &[f32; SECTORS], memory: &Memory, speed_m_s: f32) -> bool {
    let turn_rad = motion.yaw_rate_rad_s * STEP_S;
    let (turn_sin, turn_cos) = (libm::sinf(turn_rad), libm::cosf(turn_rad));
    let (yaw_sin, yaw_cos) = (libm::sinf(motion.yaw_rad), libm::cosf(motion.yaw_rad));
    let gain = STEP_S / VELOCITY_LAG_S;
    let (mut x, mut y) = (0.0_f32, 0.0_f32);
    let (mut vx, mut vy) = (motion.velocity_m_s.x, motion.velocity_m_s.y);
    let (mut nose_x, mut nose_y) = (1.0_f32, 0.0_f32);
    let allowed_cells = memory
        .clearance_squared_at(motion.position_ned_m.x, motion.position_ned_m.y)
        .min(KEEP_CLEAR_SQUARED_CELLS);
    for step in 0..STEPS {
        (nose_x, nose_y) = (
            nose_x * turn_cos - nose_y * turn_sin,
            nose_x * turn_sin + nose_y * turn_cos,
        );
        let command = if (step as f32) * STEP_S < REACTION_S {
            speed_m_s
        } else {
            0.0
        };
        vx += (command * nose_x - vx) * gain;
        vy += (command * nose_y - vy) * gain;
        x += vx * STEP_S;
        y += vy * STEP_S;
        let mut least = f32::INFINITY;
        for ((px, py), limit) in scan.forward_m.iter().zip(&scan.right_m).zip(limits) {
            let (dx, dy) = (px - x, py - y);
            let spare = dx * dx + dy * dy - limit;
            least = if spare < least { spare } else { least };
        }
        if least < 0.0 {
            return false;
        }
        let north_m = motion.position_ned_m.x + yaw_cos * x - yaw_sin * y;
        let east_m = motion.position_ned_m.y + yaw_sin * x + yaw_cos * y;
        if memory.clearance_squared_at(north_m, east_m) < allowed_cells {
            return false;
        }
    }
    true
}
