//! Figures: what reports, campaigns and training runs draw with.

mod chart;

pub use chart::{Figure, Panel, Series};
