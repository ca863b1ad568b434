//! Tables as files: comma-separated values, a column for each field of the rows' type.

use serde::de::DeserializeOwned;
use serde::{Serialize, Serializer};

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
}
