//! Figures, beside the tables of the flight tier: what campaigns and training runs draw.

mod bars;
mod chart;
mod picture;
mod plate;

pub use bars::{Bar, BarRow, Bars};
pub use chart::{Figure, Panel, Scale, Series};
pub use picture::Picture;
pub use plate::{ColourScale, Plate};
pub use vigil_tools::report::*;
