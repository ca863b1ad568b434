//! The inside of the Python package `vigil` (docs/python.md): what is written in Rust. The modules in `tools/python/vigil` give it
//! its shapes, units and words; nobody else imports it.

mod actor;
mod attack;
mod campaign;
mod detect;
mod environment;
mod explain;
mod flight_log;
mod given;

/// Written in Rust; use the modules of `vigil` instead.
#[pyo3::pymodule]
mod _vigil {
    /// The version of Vigil.
    #[pymodule_export]
    const VERSION: &str = env!("CARGO_PKG_VERSION");

    #[pymodule_export]
    use crate::actor::{Actor, Policy};
    #[pymodule_export]
    use crate::attack::{FrameAttack, StateAttack};
    #[pymodule_export]
    use crate::campaign::fly;
    #[pymodule_export]
    use crate::detect::{Detector, Lstm, Monitor, train, write_detector};
    #[pymodule_export]
    use crate::environment::Flights;
    #[pymodule_export]
    use crate::explain::Explainer;
    #[pymodule_export]
    use crate::flight_log::read_log;
}
