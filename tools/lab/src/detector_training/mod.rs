//! Gathers data for the detectors by flying, trains them and measures how well they detect (docs/detectors.md).

mod comparison;
mod evaluation;
mod explained_flight;
mod features;
mod fit;
mod flight_files;
mod lstm;
mod metrics;
mod pixels;
mod times;

pub use crate::explained::*;
pub use comparison::{ImageNetwork, TableRow, image_fit, lstm_scores, pca_scores, row};
pub use evaluation::{AfterReport, EvaluationSize, Report, Role, RowsReport, Set, SetReport, evaluate, fly_sets, sets};
pub use explained_flight::{ExplainedFrame, ExplainedStep, Portrait, portray};
pub use features::{Extractor, Feature, Rows};
pub use fit::{Epoch, Examples, FitConfig, Fitted, fit, outputs};
pub use flight_files::{BLOCK, Class, Counts, Flights, Recorded, WEAK_YAW, of_other_actor};
pub use lstm::{LstmConfig, WindowScorer, train, train_steps};
pub use metrics::{Proportion, Separation, auc, corners, roc, true_positives_at};
pub use pixels::{State, States, gather_states};
pub use times::{Times, time};
