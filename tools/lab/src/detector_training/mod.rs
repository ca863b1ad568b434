//! Gathers data for the detectors by flying, trains them and measures how well they detect (docs/detectors.md).

mod comparison;
mod evaluation;
mod features;
mod fit;
mod flight_files;
mod lstm;
mod metrics;
mod pixels;
mod times;

pub use crate::explained::*;
pub(crate) use comparison::{ImageNetwork, TableRow, lstm_scores, pca_scores, row};
pub(crate) use evaluation::{EvaluationSize, Report, Role, Set, SetReport, evaluate, sets};
pub use features::Feature;
pub use fit::{Epoch, Examples, FitConfig, Fitted, fit, outputs};
pub(crate) use flight_files::{BLOCK, Recorded, WEAK_YAW, from_bytes, to_bytes};
pub use flight_files::{counts_of, load_flights, save_flights};
pub(crate) use lstm::draw_windows;
pub use lstm::{LstmConfig, WindowScorer, train};
pub(crate) use metrics::{Proportion, auc, true_positives_at};
pub(crate) use pixels::{States, gather_states};
pub(crate) use times::time;
