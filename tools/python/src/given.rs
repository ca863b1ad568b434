//! What Python gives, checked.

use numpy::{PyArray1, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use vigil_policy::ActorInputs;
use vigil_policy::actor::PositionalInputs;
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

/// What an actor with these inputs decides from beside its frames: its positional inputs as an environment made for it gives them, or distance in
/// metres and bearing in radians of where it is led; an actor that is told of movers then stands still and has seen none.
pub fn position(given: &[f32], inputs: ActorInputs) -> PyResult<PositionalInputs> {
    let count = inputs.spec().positional().inputs;
    let &[distance_m, bearing_rad] = given else {
        let whole = PositionalInputs::from_values(given).filter(|_| given.len() == count);
        let whole = whole.filter(|_| given.iter().all(|value| value.is_finite()));
        return whole.ok_or_else(|| {
            refused(format!(
                "goal: a distance in metres and a bearing in radians, or the {count} finite values of an environment's position, got {} values",
                given.len()
            ))
        });
    };
    if !(distance_m >= 0.0 && distance_m.is_finite() && bearing_rad.is_finite()) {
        return Err(refused(format!(
            "goal: a distance of 0 m or more and a bearing in radians, got {distance_m} and {bearing_rad}"
        )));
    }
    let goal = vigil_types::GoalRelative {
        distance_m,
        bearing_rad,
    };
    Ok(PositionalInputs::at_rest(goal, inputs))
}

/// Handed over without a copy.
pub fn array(py: Python<'_>, values: Vec<f32>) -> Bound<'_, PyArray1<f32>> {
    PyArray1::from_vec(py, values)
}
