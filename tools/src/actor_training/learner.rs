//! Why an update cannot be made.

use vigil_nnet::ShapeError;

/// Why training cannot go on.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum UpdateError {
    /// Not a number, or infinite.
    #[error("update {update}: the {what} of {layer} is not finite; lower the learning rates or the gradient norm")]
    NotFinite {
        /// Number of the update.
        update: u64,
        /// Loss or gradient.
        what: &'static str,
        /// Which layer.
        layer: &'static str,
    },
    /// A network and its buffers do not fit, which would be a mistake here.
    #[error(transparent)]
    Shape(#[from] ShapeError),
}
