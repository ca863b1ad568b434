//! Tables for people: columns as wide as what stands in them, numbers to the right.

use comfy_table::{CellAlignment, ContentArrangement, Table, presets};
use std::fmt;

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
