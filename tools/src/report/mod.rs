//! Figures, tables as files and tables for people: what reports, campaigns and training runs write.

mod chart;
mod csv_file;
mod text_table;

pub use chart::{Figure, Panel, Series};
pub use csv_file::{csv_line, decimals, from_csv, maybe_decimals, to_csv};
pub use text_table::{Column, TextTable, numbers, words};
