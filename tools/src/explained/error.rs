//! What can go wrong.

use std::path::PathBuf;
use vigil_adversary::AttackError;
use vigil_detector::{MonitorError, ShapError};
use vigil_nnet::ShapeError;
use vigil_nnet::network_file::FileError;
use vigil_sim::vehicle::ParamsError;

/// Why nothing could be gathered, trained or measured.
#[derive(Debug, thiserror::Error)]
pub enum DetectError {
    /// The vehicle.
    #[error(transparent)]
    Vehicle(#[from] ParamsError),
    /// The attack.
    #[error(transparent)]
    Attack(#[from] AttackError),
    /// A network that does not fit.
    #[error(transparent)]
    Network(#[from] ShapeError),
    /// An explanation.
    #[error(transparent)]
    Shap(#[from] ShapError),
    /// The detector's file.
    #[error(transparent)]
    Detector(#[from] FileError),
    /// The detector does not fit the actor.
    #[error(transparent)]
    Monitor(#[from] MonitorError),
    /// A file that cannot be read or written.
    #[error("cannot access {path}: {source}")]
    Access {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file of something else, or an older version.
    #[error("{path} holds no data of `vigil detector collect`: {message}; collect them anew")]
    Data {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        message: String,
    },
    /// Data of another actor.
    #[error("{path} was collected with the actor {found}, this is the actor {expected}; collect the data anew")]
    OtherActor {
        /// The file.
        path: PathBuf,
        /// Digest in the file.
        found: String,
        /// Digest of the actor.
        expected: String,
    },
    /// There is nothing to learn from.
    #[error("the data hold {attacked} attacked and {unattacked} unattacked windows for {purpose}; collect more")]
    TooFew {
        /// What for.
        purpose: &'static str,
        /// Attacked windows.
        attacked: usize,
        /// Others.
        unattacked: usize,
    },
    /// Training left the numbers.
    #[error("the loss in epoch {epoch} is not finite; lower the rate")]
    Diverged {
        /// Epoch.
        epoch: usize,
    },
}

/// Names the file in an error of the system.
pub fn access(path: &std::path::Path) -> impl FnOnce(std::io::Error) -> DetectError {
    let path = path.to_owned();
    move |source| DetectError::Access { path, source }
}
