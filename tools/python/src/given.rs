//! What Python gives, checked.

use numpy::{PyArray1, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use vigil_policy::PilotInput;
use vigil_policy::actor::{GOAL_INPUTS, LOW_DIM, LowDim};
use vigil_types::{
    Attitude, DEPTH_FULL_SCALE_M, DEPTH_PIXELS, DepthFrame, GoalRelative, HeadingVector, Nanos, NedVector, STEP_NS,
};

/// An error that is the caller's.
pub fn refused(e: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(e.to_string())
}

/// An error that is not.
pub fn failed(e: impl std::fmt::Display) -> PyErr {
    PyRuntimeError::new_err(e.to_string())
}

/// The values of an array that lies in one piece, all finite, of the length that is expected.
pub fn values<'a>(what: &str, array: &'a PyReadonlyArrayDyn<'_, f32>, len: usize) -> PyResult<&'a [f32]> {
    let slice = array.as_slice().map_err(|_| {
        refused(format!(
            "{what}: the array has to lie in one piece (numpy.ascontiguousarray)"
        ))
    })?;
    if slice.len() != len {
        let shape = array.shape();
        return Err(refused(format!("{what}: expected {len} values, got shape {shape:?}")));
    }
    match slice.iter().position(|x| !x.is_finite()) {
        Some(at) => Err(refused(format!(
            "{what}: value {at} is {}, not a finite number",
            slice[at]
        ))),
        None => Ok(slice),
    }
}

/// Frames in metres as the networks take them: ranges over 100 m.
pub fn frames(what: &str, array: &PyReadonlyArrayDyn<'_, f32>, count: usize) -> PyResult<Vec<f32>> {
    let metres = values(what, array, count * DEPTH_PIXELS)?;
    if let Some(range) = metres.iter().find(|range| !(0.0..=DEPTH_FULL_SCALE_M).contains(*range)) {
        return Err(refused(format!(
            "{what}: ranges are 0 to {DEPTH_FULL_SCALE_M} m, one is {range} m"
        )));
    }
    Ok(metres.iter().map(|range| range / DEPTH_FULL_SCALE_M).collect())
}

/// Values of a position as an environment made for an actor gives it: distance (m) and bearing (rad) of the goal; north, east and height
/// (m), heading (rad), velocity forward and right (m/s) as the vehicle believes; time (s).
pub const POSITION: usize = 9;

/// Hands a pilot's input to `decide`: of a frame in metres and an environment's position, or of a goal alone, distance in metres and bearing
/// in radians: the vehicle then stands where its flight began, and the time is `next_ns`, which becomes that of the step after.
pub fn at_moment<T>(
    frame: &PyReadonlyArrayDyn<'_, f32>,
    position: &[f32],
    next_ns: &mut Nanos,
    decide: impl FnOnce(&PilotInput<'_>) -> PyResult<T>,
) -> PyResult<T> {
    let pixels = frames("frame", frame, 1)?;
    let other = || {
        refused(format!(
            "goal: a distance in metres and a bearing in radians, or the {POSITION} values of an environment's position, got {} \
                 values",
            position.len()
        ))
    };
    let (&[distance_m, bearing_rad], odometry) = position.split_first_chunk::<2>().ok_or_else(other)?;
    let (place, yaw_rad, velocity_m_s, time_s) = match *odometry {
        [] => (NedVector::new(0.0, 0.0, -HOVER_M), 0.0, HeadingVector::ZERO, None),
        [north_m, east_m, height_m, yaw_rad, forward, right, time_s] => {
            let place = NedVector::new(north_m, east_m, -height_m);
            (place, yaw_rad, HeadingVector::new(forward, right, 0.0), Some(time_s))
        }
        _ => return Err(other()),
    };
    let all_finite = position.iter().all(|value| value.is_finite());
    if !(distance_m >= 0.0 && all_finite) {
        return Err(refused(format!(
            "goal: a distance of 0 m or more and finite numbers, got {position:?}"
        )));
    }
    if let Some(time_s) = time_s.filter(|time_s| *time_s > MOST_TIME_S) {
        return Err(refused(format!(
            "goal: a time of at most {MOST_TIME_S} s, got {time_s} s"
        )));
    }
    // Tenths of a millisecond: a float32 of seconds has no more.
    let now_ns = time_s.map_or(*next_ns, |time_s| {
        (f64::from(time_s.max(0.0)) * 1e4).round() as Nanos * 100_000
    });
    *next_ns = now_ns + STEP_NS;
    let attitude = Attitude::from_euler_rad(0.0, 0.0, yaw_rad);
    let mut depth = Box::new(DepthFrame::EMPTY);
    depth.depth.copy_from_slice(&pixels);
    depth.header.stamp_ns = now_ns;
    depth.header.position_ned_m = place;
    depth.header.attitude = attitude;
    decide(&PilotInput {
        now_ns,
        depth: &depth,
        goal: GoalRelative {
            distance_m,
            bearing_rad,
        },
        attitude,
        velocity_m_s,
        height_m: -place.z,
    })
}

/// Latest time of a decision, seconds: thirty years, whose nanoseconds leave room for those of a flight.
const MOST_TIME_S: f32 = 1e9;

/// Height of a vehicle of which only the goal is given, metres: the courses'.
const HOVER_M: f32 = 2.5;

/// What a decision was made from beside the split point: an actor's low-dimensional observation, or an imported policy's goal.
pub fn beside(given: &[f32], of_actor: bool) -> PyResult<LowDim> {
    let expected = if of_actor { LOW_DIM } else { GOAL_INPUTS };
    let finite = given.iter().all(|value| value.is_finite());
    let found = LowDim::from_values(given).filter(|_| finite && given.len() == expected);
    found.ok_or_else(|| {
        refused(match of_actor {
            true => format!("low_dim: {LOW_DIM} finite values (Actor.low_dim), got {given:?}"),
            false => format!("goal: distance and bearing as the network takes them, got {given:?}"),
        })
    })
}

/// Numbers for Python.
pub type Floats<'py> = Bound<'py, PyArray1<f32>>;

/// Handed over without a copy.
pub fn array(py: Python<'_>, values: Vec<f32>) -> Floats<'_> {
    PyArray1::from_vec(py, values)
}
