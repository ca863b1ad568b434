//! Tables and pictures as files and tables for people: what campaigns and reports write.

mod csv_file;
mod png_file;
mod text_table;

pub use csv_file::{decimals, from_csv, maybe_decimals, to_csv};
pub use png_file::png_bytes;
pub use text_table::TextTable;
