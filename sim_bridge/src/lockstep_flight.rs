//! A whole flight in lockstep: simulator and firmware take turns, faster than real time, the same bits for the same seed.

use crate::Simulator;
use crate::world::Outcome;
use serde::{Deserialize, Deserializer, Serialize};
use vigil_types::{Datagrams, DepthFrame, Nanos, NedVector, STEP_S};

/// What a lockstep flight came to.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct FlightRecord {
    /// How it ended; absent when the vehicle never took off.
    pub outcome: Option<Outcome>,
    /// Simulated seconds from lift-off (or from the airborne start) to the ending.
    pub flight_time_s: f64,
    /// Metres flown.
    pub path_length_m: f64,
    /// Smallest horizontal distance to the goal.
    #[serde(deserialize_with = "or_infinity")]
    pub closest_goal_m: f32,
    /// Smallest distance of the vehicle's middle from an obstacle, once a step; its radius is 0.30 m.
    #[serde(deserialize_with = "or_infinity")]
    pub closest_obstacle_m: f32,
    /// Steps taken.
    pub steps: u64,
    /// Digest of everything that happened, see [`Simulator::state_hash`]; hexadecimal.
    #[serde(serialize_with = "hexadecimal", deserialize_with = "from_hexadecimal")]
    pub state_hash: u64,
    /// True positions, one in [`PATH_STRIDE`] steps, NED metres; for drawing.
    #[serde(skip)]
    pub path_ned_m: Vec<NedVector>,
}

fn hexadecimal<S: serde::Serializer>(hash: &u64, s: S) -> Result<S::Ok, S::Error> {
    s.collect_str(&format_args!("{hash:016x}"))
}

fn from_hexadecimal<'de, D: Deserializer<'de>>(d: D) -> Result<u64, D::Error> {
    u64::from_str_radix(&String::deserialize(d)?, 16).map_err(serde::de::Error::custom)
}

/// JSON has no infinity: the distance of a flight that never began is null there.
fn or_infinity<'de, D: Deserializer<'de>>(d: D) -> Result<f32, D::Error> {
    Ok(Option::deserialize(d)?.unwrap_or(f32::INFINITY))
}

impl FlightRecord {
    /// Whether the goal was reached.
    pub fn is_success(&self) -> bool {
        self.outcome == Some(Outcome::Success)
    }
}

/// Steps between two points of [`FlightRecord::path_ned_m`].
pub const PATH_STRIDE: u64 = 4;

/// Flies until the referee ends the flight. `firmware`, in this process or another, is given each step's number and time, the frame and the
/// vehicle's datagrams, and puts its own into the last argument. What is between sensor and firmware, an attack for one, alters the
/// frame first.
///
/// # Errors
/// Whatever keeps the firmware from answering; the flight ends there.
pub fn fly_lockstep<E>(
    simulator: &mut Simulator,
    time_limit_s: f64,
    mut firmware: impl FnMut(u64, Nanos, &mut DepthFrame, &Datagrams, &mut Datagrams) -> Result<(), E>,
) -> Result<FlightRecord, E> {
    // A vehicle that never lifts off is never seen by the referee: 60 s are ample for arming and take-off.
    let most_steps = ((time_limit_s + 60.0) / f64::from(STEP_S)) as u64;
    let mut frame = Box::new(DepthFrame::EMPTY);
    let (mut to_firmware, mut from_firmware) = (Box::<Datagrams>::default(), Box::<Datagrams>::default());
    let mut path_ned_m = Vec::with_capacity((most_steps / PATH_STRIDE) as usize + 1);
    let mut closest_obstacle_m = f32::INFINITY;
    let mut step = 0;
    while step < most_steps && simulator.ending().is_none() {
        simulator.lockstep(&from_firmware, &mut frame, &mut to_firmware);
        from_firmware.clear();
        firmware(step, simulator.now_ns(), &mut frame, &to_firmware, &mut from_firmware)?;
        let has_ended = simulator.ending().is_some();
        if !has_ended {
            closest_obstacle_m = closest_obstacle_m.min(simulator.obstacle_distance_m());
        }
        if has_ended || step.is_multiple_of(PATH_STRIDE) {
            path_ned_m.push(simulator.truth().position_ned_m);
        }
        step += 1;
    }
    let ending = simulator.ending();
    Ok(FlightRecord {
        outcome: ending.map(|e| e.outcome),
        flight_time_s: ending.map_or(0.0, |e| e.flight_time_s),
        path_length_m: simulator.path_length_m(),
        closest_goal_m: simulator.closest_goal_m(),
        closest_obstacle_m,
        steps: step,
        state_hash: simulator.state_hash(),
        path_ned_m,
    })
}
