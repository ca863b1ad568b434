//! What Python gives, checked.

use numpy::{PyArray1, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;
use vigil_policy::PilotInput;
use vigil_policy::actor::LowDim;
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

/// The values of an array that lies in one piece, of the length that is expected.
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
    Ok(slice)
}

/// Does `work` on another thread, while this one, which alone hears of Ctrl-C, looks for it; `stopped` then asks the work to end.
pub fn interruptible<T: Send>(
    py: Python<'_>,
    stopped: &AtomicBool,
    work: impl FnOnce() -> PyResult<T> + Send,
) -> PyResult<T> {
    let (done, finished) = channel();
    py.detach(move || {
        std::thread::scope(|scope| {
            let worker = scope.spawn(move || done.send(work()));
            loop {
                match finished.recv_timeout(Duration::from_millis(100)) {
                    Ok(result) => return result,
                    Err(RecvTimeoutError::Disconnected) => match worker.join() {
                        Err(panic) => std::panic::resume_unwind(panic),
                        Ok(_) => return Err(failed("it ended without a result")),
                    },
                    Err(RecvTimeoutError::Timeout) => {
                        let heard = Python::attach(|py| py.check_signals());
                        heard.inspect_err(|_| stopped.store(true, Relaxed))?;
                    }
                }
            }
        })
    })
}

/// Frames in metres as the networks take them: ranges over 100 m.
pub fn frames(what: &str, array: &PyReadonlyArrayDyn<'_, f32>, count: usize) -> PyResult<Vec<f32>> {
    let metres = values(what, array, count * DEPTH_PIXELS)?;
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
    let [
        distance_m,
        bearing_rad,
        north_m,
        east_m,
        height_m,
        yaw_rad,
        forward,
        right,
        time_s,
    ]: [f32; POSITION] = match *position {
        [distance_m, bearing_rad] => [distance_m, bearing_rad, 0.0, 0.0, HOVER_M, 0.0, 0.0, 0.0, 0.0],
        _ => position.try_into().map_err(refused)?,
    };
    let now_ns = match position.len() {
        // Tenths of a millisecond: a float32 of seconds has no more.
        POSITION => (f64::from(time_s.max(0.0)) * 1e4).round() as Nanos * 100_000,
        _ => *next_ns,
    };
    *next_ns = now_ns + STEP_NS;
    let attitude = Attitude::from_euler_rad(0.0, 0.0, yaw_rad);
    let mut depth = Box::new(DepthFrame::EMPTY);
    depth.depth.copy_from_slice(&pixels);
    depth.header.stamp_ns = now_ns;
    depth.header.position_ned_m = NedVector::new(north_m, east_m, -height_m);
    depth.header.attitude = attitude;
    decide(&PilotInput {
        now_ns,
        depth: &depth,
        goal: GoalRelative {
            distance_m,
            bearing_rad,
        },
        attitude,
        velocity_m_s: HeadingVector::new(forward, right, 0.0),
        height_m,
    })
}

/// Height of a vehicle of which only the goal is given, metres: the courses'.
const HOVER_M: f32 = 2.5;

/// What a decision was made from beside the split point: an actor's low-dimensional observation, or an imported policy's goal.
pub fn beside(given: &[f32]) -> PyResult<LowDim> {
    LowDim::from_values(given).ok_or_else(|| refused(format!("beside: {} values", given.len())))
}

/// Numbers for Python.
pub type Floats<'py> = Bound<'py, PyArray1<f32>>;

/// Handed over without a copy.
pub fn array(py: Python<'_>, values: Vec<f32>) -> Floats<'_> {
    PyArray1::from_vec(py, values)
}
