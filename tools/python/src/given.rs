//! What Python gives, checked.

use numpy::{PyArray1, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use vigil_types::{DEPTH_FULL_SCALE_M, DEPTH_PIXELS};

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

/// The goal's distance in metres and bearing in radians, as the networks take them.
pub fn position(distance_m: f32, bearing_rad: f32) -> PyResult<[f32; 2]> {
    if !(distance_m >= 0.0 && distance_m.is_finite() && bearing_rad.is_finite()) {
        return Err(refused(format!(
            "goal: a distance of 0 m or more and a bearing in radians, got {distance_m} and {bearing_rad}"
        )));
    }
    Ok(vigil_policy::actor::goal_inputs(vigil_types::GoalRelative {
        distance_m,
        bearing_rad,
    }))
}

/// Handed over without a copy.
pub fn array(py: Python<'_>, values: Vec<f32>) -> Bound<'_, PyArray1<f32>> {
    PyArray1::from_vec(py, values)
}
