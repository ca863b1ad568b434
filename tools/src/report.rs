//! Tables and pictures as files and tables for people: what campaigns and reports write.

use comfy_table::{CellAlignment, ContentArrangement, Table, presets};
use serde::de::DeserializeOwned;
use serde::{Serialize, Serializer};
use std::fmt;

/// The rows below a heading of their fields' names; nothing where there is no row.
///
/// # Panics
/// A row with fields within fields.
pub fn to_csv<R: Serialize>(rows: impl IntoIterator<Item = R>) -> String {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for row in rows {
        writer
            .serialize(row)
            .unwrap_or_else(|e| panic!("a row of plain fields: {e}"));
    }
    let bytes = writer
        .into_inner()
        .unwrap_or_else(|e| panic!("memory takes every row: {e}"));
    String::from_utf8(bytes).unwrap_or_else(|e| panic!("what was text stays text: {e}"))
}

/// Reads rows below their heading.
///
/// # Errors
/// A row that does not fit, with its line.
pub fn from_csv<R: DeserializeOwned>(text: &str) -> Result<Vec<R>, csv::Error> {
    csv::Reader::from_reader(text.as_bytes()).deserialize().collect()
}

/// Writes a number with N decimals: `#[serde(serialize_with = "decimals::<4, _, _>")]`.
pub fn decimals<const N: usize, T: Copy + Into<f64>, S: Serializer>(
    value: &T,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    serializer.collect_str(&format_args!("{:.N$}", (*value).into()))
}

/// The same for a number that may be missing: an empty field.
pub fn maybe_decimals<const N: usize, T: Copy + Into<f64>, S: Serializer>(
    value: &Option<T>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    match value {
        Some(value) => decimals::<N, T, S>(value, serializer),
        None => serializer.serialize_none(),
    }
}

/// A file's content, 8 bits a channel, compressed well; `set` states colours and whatever else is to be stated.
///
/// # Panics
/// Pixels of another size.
pub fn png_bytes(
    size: (u32, u32),
    pixels: &[u8],
    set: impl for<'a> FnOnce(&mut png::Encoder<'a, &'a mut Vec<u8>>),
) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, size.0, size.1);
    encoder.set_compression(png::Compression::High);
    set(&mut encoder);
    let written = encoder
        .write_header()
        .and_then(|mut writer| writer.write_image_data(pixels));
    // Writing to memory fails only for a picture of the wrong size.
    written.unwrap_or_else(|e| unreachable!("{e}"));
    bytes
}

/// Blanks between two columns.
const GAP: u16 = 2;

/// A table without lines, below a heading.
pub struct TextTable(Table);

impl TextTable {
    /// An empty table. A bar stands between two headings; below one that begins with `>` all keeps to the right, as numbers do.
    pub fn new(headings: &str) -> Self {
        let column = |heading: &str| match heading.strip_prefix('>') {
            Some(numbers) => (numbers.trim_start().to_owned(), CellAlignment::Right),
            None => (heading.to_owned(), CellAlignment::Left),
        };
        let (headings, sides): (Vec<String>, Vec<CellAlignment>) = headings.split(" | ").map(column).unzip();
        let mut table = Table::new();
        table
            .load_style(presets::NOTHING)
            // However narrow the terminal is, a row stays a line: others cut and search it.
            .set_content_arrangement(ContentArrangement::Disabled)
            .set_header(headings);
        for (column, side) in table.column_iter_mut().zip(sides) {
            column.set_padding((0, GAP)).set_cell_alignment(side);
        }
        Self(table)
    }

    /// Adds a row.
    pub fn row(&mut self, cells: impl IntoIterator<Item = String>) {
        self.0.add_row(cells.into_iter().collect::<Vec<_>>());
    }

    /// The heading and the rows, line by line.
    pub fn lines(&self) -> Vec<String> {
        self.0.lines().map(|line| line.trim_end().to_owned()).collect()
    }
}

impl fmt::Display for TextTable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.lines().join("\n"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Row {
        name: String,
        #[serde(serialize_with = "decimals::<2, _, _>")]
        share: f32,
        #[serde(serialize_with = "maybe_decimals::<1, _, _>")]
        late_s: Option<f64>,
    }

    #[test]
    fn a_table_is_written_with_its_heading_and_decimals_and_read_again() {
        let row = |name: &str, late_s| Row {
            name: name.to_owned(),
            share: 0.25,
            late_s,
        };
        let rows = [row("plain", Some(1.5)), row("with, comma", None)];
        let text = to_csv(&rows);
        assert_eq!(text, "name,share,late_s\nplain,0.25,1.5\n\"with, comma\",0.25,\n");
        assert_eq!(from_csv::<Row>(&text).unwrap(), rows);
        let error = from_csv::<Row>("name,share,late_s\nplain,much,1.5\n")
            .unwrap_err()
            .to_string();
        assert!(error.contains("line: 2"), "{error}");
    }

    #[test]
    fn columns_are_as_wide_as_what_stands_in_them() {
        let mut table = TextTable::new("outcome | > flights | 95 % interval");
        table.row(["success".to_owned(), "1000".to_owned(), "98.7 to 99.7 %".to_owned()]);
        table.row(["out of bounds".to_owned(), "1".to_owned(), "—".to_owned()]);
        assert_eq!(
            table.to_string(),
            "outcome        flights  95 % interval\n\
             success           1000  98.7 to 99.7 %\n\
             out of bounds        1  —"
        );
    }
}
