//! Figures, tables as files and tables for people: what reports, campaigns and training runs write.

mod bars;
mod chart;
mod csv_file;
mod picture;
mod plate;
mod text_table;

pub use bars::{Bar, BarRow, Bars};
pub use chart::{Figure, Panel, Scale, Series};
pub use csv_file::{csv_line, decimals, from_csv, maybe_decimals, to_csv};
pub use picture::{Picture, Raster, png_bytes};
pub use plate::{ColourScale, Plate};
pub use text_table::{Column, TextTable, numbers, words};
