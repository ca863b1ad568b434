//! Course files: TOML in and out, and errors that name file, line and field.

use crate::world::check::FieldProblem;
use crate::world::course::Course;
use std::path::Path;
use toml::de::{DeTable, DeValue};
use vigil_types::files::{self, at};
use vigil_types::settings::{self, Refused};

/// A course of a thousand obstacles has 100 kB.
const SIZE_LIMIT: u64 = 4 << 20;

/// Why a course could not be read or written: file, line (from 1), field (as `column[2].radius_m`, from 0) and what would be right.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct CourseError(String);

fn failed<'a>(what: &'a str, path: &'a Path) -> impl FnOnce(std::io::Error) -> CourseError + 'a {
    move |error| CourseError(format!("cannot {what} course {}", at(path)(error)))
}

impl Course {
    /// Reads a course from TOML text and checks it; `file_name` is for messages, and meshes are looked for beside it.
    ///
    /// # Errors
    /// [`CourseError`] with line and field.
    pub fn from_toml_str(text: &str, file_name: &str) -> Result<Self, CourseError> {
        Self::read(text, file_name, Path::new(file_name))
    }

    fn read(text: &str, file_name: &str, path: &Path) -> Result<Self, CourseError> {
        let invalid = |at: usize, field: &str, problem: &str| {
            let line = 1 + text.bytes().take(at).filter(|b| *b == b'\n').count();
            // A text that is not TOML at all has no field.
            let field = (!field.is_empty()).then(|| format!("`{field}`: "));
            CourseError(format!("{file_name}:{line}: {}{problem}", field.unwrap_or_default()))
        };
        let refused = |r: Refused| invalid(r.at, &r.key, &r.message);
        let root = settings::parse(text).map_err(refused)?;
        let mut course: Self = settings::from_table(root.get_ref()).map_err(refused)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let checked = course.read_meshes(folder).and_then(|()| course.check());
        checked.map_err(|wrong| invalid(offset_of(root.get_ref(), &wrong.field), &wrong.field, &wrong.problem))?;
        Ok(course)
    }

    fn read_meshes(&mut self, folder: &Path) -> Result<(), FieldProblem> {
        for (i, mesh) in self.meshes.iter_mut().enumerate() {
            mesh.check_values(i)?;
            mesh.read(folder).map_err(|problem| FieldProblem {
                field: format!("mesh[{i}].file"),
                problem,
            })?;
        }
        Ok(())
    }

    /// Reads and checks a course file.
    ///
    /// # Errors
    /// [`CourseError`].
    pub fn load(path: &Path) -> Result<Self, CourseError> {
        let text = files::read_text(path, SIZE_LIMIT).map_err(failed("read", path))?;
        Self::read(&text, &path.display().to_string(), path)
    }

    /// The course as TOML text.
    ///
    /// # Errors
    /// What TOML cannot hold: a seed of 2⁶³ or more, a path that is not Unicode.
    pub fn to_toml_string(&self) -> Result<String, CourseError> {
        let problem = if i64::try_from(self.seed).is_err() {
            format!("seed {} is not below 2⁶³", self.seed)
        } else if let Some(mesh) = self.meshes.iter().find(|mesh| mesh.file.to_str().is_none()) {
            let file = mesh.file.display();
            format!("mesh {file} lies in a folder whose name is not Unicode: move it")
        } else {
            return Ok(settings::to_toml(self));
        };
        Err(CourseError(format!(
            "the course cannot be written as TOML: its {problem}"
        )))
    }

    /// Writes the course to a file.
    ///
    /// # Errors
    /// As of [`to_toml_string`](Self::to_toml_string), and what the system says.
    pub fn save(&self, path: &Path) -> Result<(), CourseError> {
        let text = self.to_toml_string()?;
        files::replace(path, text.as_bytes(), files::Access::Shared).map_err(failed("write", path))
    }
}

/// Byte offset of the innermost existing part of a dotted path; 0 if none of it is in the text.
fn offset_of(root: &DeTable<'_>, field: &str) -> usize {
    let mut offset = 0;
    let mut table = Some(root);
    for part in field.split('.') {
        let (key, index) = match part.split_once('[') {
            Some((key, rest)) => (key, rest.trim_end_matches(']').parse::<usize>().ok()),
            None => (part, None),
        };
        let Some((name, value)) = table.and_then(|t| t.iter().find(|(k, _)| k.get_ref() == key)) else {
            break;
        };
        offset = name.span().start;
        let mut value = value.get_ref();
        if let (Some(i), DeValue::Array(items)) = (index, value)
            && let Some(item) = items.get(i)
        {
            offset = item.span().start;
            value = item.get_ref();
        }
        table = match value {
            DeValue::Table(t) => Some(t),
            _ => None,
        };
    }
    offset
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = r#"name = "two columns"
goal = { north_m = 20.0, east_m = 5.0 }

[bounds]
north_m = [-4.0, 26.0]
east_m = [-12.0, 12.0]
top_m = 6.0

[[column]]
north_m = 8.0
east_m = 1.0
radius_m = 0.4
height_m = 3.0

[[column]]
north_m = 12.0
east_m = 4.0
radius_m = 0.3
height_m = 3.0

[[wall]]
from_m = [5.0, -6.0]
to_m = [5.0, -2.0]
thickness_m = 0.2
height_m = 2.5

[[mover]]
from_m = [16.0, 0.0]
to_m = [16.0, 4.0]
speed_m_s = 0.5
height_m = 2.0
shape = { column = { radius_m = 0.35 } }

[[wire]]
from_m = [5.0, 0.0, 1.0]
to_m = [5.0, 2.0, 1.0]
radius_m = 0.02
"#;

    fn error_of(text: &str) -> String {
        Course::from_toml_str(text, "bad.toml")
            .expect_err("must be refused")
            .to_string()
    }

    #[test]
    fn a_course_written_and_read_is_the_same_course() {
        let course = Course::from_toml_str(GOOD, "good.toml").expect("good");
        assert_eq!(course.columns.len(), 2);
        assert_eq!(course.flight_height_m, 1.5);
        let again = Course::from_toml_str(&course.to_toml_string().expect("writable"), "again").expect("again");
        assert_eq!(course, again);
        let seed = u64::MAX;
        let unwritable = Course { seed, ..course }
            .to_toml_string()
            .expect_err("too large for TOML");
        assert!(unwritable.to_string().contains(&seed.to_string()), "{unwritable}");
    }

    #[test]
    fn each_mistake_is_named_by_file_line_and_field() {
        // What is replaced (\n is a line's end), by what, and the line and field that are named.
        let cases = r#"
            radius_m = 0.3 => radius_m = -0.3 => 18: `column[1].radius_m`
            radius_m = 0.3 => radius_m = nan => 18: `column[1].radius_m`
            radius_m = 0.3 => radius_m = "wide" => 18: `column[1].radius_m`
            radius_m = 0.3 => raduis_m = 0.3 => 18: `column[1]`: there is no key `raduis_m` here
            radius_m = 0.3 =>  => 15: `column[1]`: `radius_m` is missing
            to_m = [5.0, -2.0] => to_m = [5.0] => 23: `wall[0].to_m`
            to_m = [5.0, -2.0] => to_m = [5.0, inf] => 23: `wall[0].to_m[1]`
            to_m = [5.0, -2.0] => to_m = [5.0, -6.0] => 23: `wall[0].to_m`
            east_m = 5.0 } => east_m = 50.0 } => 2: `goal`
            top_m = 6.0 => top_m = 1.6 => 7: `bounds.top_m`: is 1.6, must be at least 1.7 m: the flight height of 1.5 m
            north_m = [-4.0, 26.0] => north_m = [26.0, -4.0] => 5: `bounds.north_m`
            north_m = 8.0\neast_m = 1.0 => north_m = 0.2\neast_m = 0.1 => 9: `column[0]`
            name = "two columns" => name = "two columns => 1:
            name = "two columns" => name = "two\u0001columns" => 1: `name`: holds a control character
            [bounds] => flight_height_m = -1\n[bounds] => 4: `flight_height_m`
            speed_m_s = 0.5 => speed_m_s = 1.5 => 30: `mover[0].speed_m_s`
            to_m = [16.0, 4.0] => to_m = [16.0, 0.0] => 29: `mover[0].to_m`
            to_m = [16.0, 4.0] => to_m = [22.0, 7.5] => 27: `mover[0]`: covers the goal
            shape = { column => shape = { box = { length_m = 1, width_m = 1 }, column => 32: `mover[0].shape`: one of `column` and `box`
            column = { radius_m = 0.35 } => column = { radius_m = 0.0 } => 32: `mover[0].shape.column.radius_m`
            to_m = [5.0, 2.0, 1.0] => to_m = [5.0, 0.0, 1.0] => 36: `wire[0].to_m`: is the same point as from_m
            radius_m = 0.02 => radius_m = 0.06 => 37: `wire[0].radius_m`: is 0.06, must be from 0.005 to 0.05 m
            from_m = [5.0, 0.0, 1.0] => from_m = [5.0, nan, 1.0] => 35: `wire[0].from_m[1]`: is NaN
            [5.0, 0.0, 1.0]\nto_m = [5.0, 2.0, 1.0] => [0.2, -1.0, 1.0]\nto_m = [0.2, 1.0, 1.0] => 34: `wire[0]`: covers the start
            [5.0, 0.0, 1.0]\nto_m = [5.0, 2.0, 1.0] => [20.0, 4.0, 1.8]\nto_m = [20.0, 6.0, 1.2] => 34: `wire[0]`: covers the goal
        "#;
        let mut count = 0;
        for case in cases.lines().filter(|case| !case.trim().is_empty()) {
            let parts: Vec<String> = case
                .split(" => ")
                .map(|part| part.trim_start().replace("\\n", "\n"))
                .collect();
            let [from, to, expected] = parts.as_slice() else {
                panic!("{case}")
            };
            let text = GOOD.replacen(from, to, 1);
            assert_ne!(text, GOOD, "{from} is not in the text");
            let message = error_of(&text);
            assert!(message.starts_with(&format!("bad.toml:{expected}")), "{to}: {message}");
            count += 1;
        }
        assert_eq!(count, 25);
    }

    #[test]
    fn a_file_that_is_not_there_is_named() {
        let e = Course::load(Path::new("no/such/course.toml")).expect_err("absent");
        assert!(e.to_string().starts_with("cannot read course no/such/course.toml: "));
    }
}
