//! Settings files: TOML from which structures are read and to which they are written, all by the same code. A structure that
//! [`settings!`](crate::settings!) declares states each of its fields once: name, type, default and what is accepted.

mod values;

use crate::parameters::{Kind, ParameterSpec, Preset, Range};
use std::borrow::ToOwned;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::vec::Vec;
use toml::de::{DeTable, DeValue};
pub use toml::{Spanned, Value};
pub(crate) use values::choice;
use values::number;
pub use values::{named, parsed, text};

/// A settings file has a page or two.
const SIZE_LIMIT: u64 = 1 << 20;

/// A value as a file gives it, with its place.
pub type Given<'a> = Spanned<DeValue<'a>>;

/// Why a settings file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SettingsError {
    /// It cannot be read.
    #[error("cannot read {0}")]
    Read(#[from] crate::files::FileError),
    /// Its content is not accepted.
    #[error("{}: {message}", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// Line, key and what is allowed.
        message: String,
    },
}

/// A value that is not accepted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refused {
    /// Where in the text, bytes from its start.
    pub at: usize,
    /// Dotted path of the key, as `wall[2].height_m`, counted from 0; empty where the text is not TOML at all.
    pub key: String,
    /// What is wrong and what would be right.
    pub message: String,
}

/// Refuses a value.
pub fn refused(given: &Given<'_>, message: impl Into<String>) -> Refused {
    Refused::new(given.span().start, message)
}

/// Refuses a value that is of another type.
fn other_type(given: &Given<'_>, needed: &str) -> Refused {
    refused(
        given,
        format!("{needed} is needed, this is of type {}", given.get_ref().type_str()),
    )
}

impl Refused {
    fn new(at: usize, message: impl Into<String>) -> Self {
        let (key, message) = (String::new(), message.into());
        Self { at, key, message }
    }

    fn within(mut self, name: &str) -> Self {
        let dot = if self.key.is_empty() || self.key.starts_with('[') {
            ""
        } else {
            "."
        };
        self.key = format!("{name}{dot}{}", self.key);
        self
    }

    /// With line and column in the text.
    fn in_text(&self, text: &str) -> String {
        let before = text.get(..self.at).unwrap_or(text);
        let line = before.matches('\n').count() + 1;
        let column = before.rsplit('\n').next().map_or(0, |last| last.chars().count()) + 1;
        let Self { key, message, .. } = self;
        match key.as_str() {
            "" => format!("line {line}, column {column}: {message}"),
            _ => format!("line {line}, column {column}: `{key}`: {message}"),
        }
    }
}

/// A type whose values a settings file may hold.
pub trait Setting {
    /// The value that is given.
    ///
    /// # Errors
    /// What is not accepted, with what is.
    fn from_given(given: &Given<'_>) -> Result<Self, Refused>
    where
        Self: Sized;

    /// Takes over what is given; what a table does not name stays.
    ///
    /// # Errors
    /// What is not accepted, with what is.
    fn read(&mut self, given: &Given<'_>) -> Result<(), Refused>;

    /// The value for a file; `None` where nothing is to be written, or [`Setting::tables`] are.
    fn write(&self) -> Option<Value>;

    /// The fields of a table, or of each of several.
    fn tables(&mut self) -> Vec<Vec<Field<'_>>> {
        Vec::new()
    }

    /// Whether it is an array of tables.
    fn is_list(&self) -> bool {
        false
    }
}

/// A table of settings, as [`settings!`](crate::settings!) declares it.
pub trait Section: Default {
    /// Its fields, in the order of their declaration.
    fn fields(&mut self) -> Vec<Field<'_>>;
}

/// A field of a table.
pub struct Field<'a> {
    /// Its key.
    pub name: &'a str,
    /// Its value.
    pub setting: &'a mut dyn Setting,
    /// What is accepted.
    pub rule: Rule,
}

/// What a field accepts.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Rule {
    /// Each number lies within.
    pub range: Option<Range>,
    /// The table must name it.
    pub is_required: bool,
    /// It is written only where it is on.
    pub is_quiet: bool,
    /// Longest list.
    pub most: Option<usize>,
}

/// A default with a rule: where a field's come from.
#[derive(Debug, Clone, Copy)]
pub struct With<T> {
    /// The default.
    pub value: T,
    /// What is accepted.
    pub rule: Rule,
}

/// A default; everything of its type is accepted.
pub fn free<T>(value: T) -> With<T> {
    let rule = Rule::default();
    With { value, rule }
}

/// A table of its own.
pub fn section<T: Default>() -> With<T> {
    free(T::default())
}

/// What the table must name.
pub fn required<T: Default>() -> With<T> {
    let mut with = section();
    with.rule.is_required = true;
    with
}

/// A default; each number lies from `least` to `greatest`.
pub fn within<T>(value: T, (least, greatest): (f64, f64), unit: &'static str) -> With<T> {
    let mut with = free(value);
    with.rule.range = Some(Range::of(least, greatest, unit));
    with
}

/// What the table must name, of a row of the table of parameters.
pub fn required_row<T: Default>(row: &'static ParameterSpec) -> With<T> {
    let mut with = required();
    with.rule.range = row.range();
    with
}

/// A list of a row of the table of parameters, of at most so many.
pub fn at_most<T: FromRow>(most: usize, row: &'static ParameterSpec) -> With<T> {
    let mut with = With::from(row);
    with.rule.most = Some(most);
    with
}

impl<T: FromRow> From<&'static ParameterSpec> for With<T> {
    fn from(row: &'static ParameterSpec) -> Self {
        let rule = Rule {
            // The numbers of a switch and of a choice are MAVLink's.
            range: match row.kind {
                Kind::Real(range) | Kind::Whole(range) => Some(range),
                _ => None,
            },
            is_quiet: T::OFF_WHERE_ABSENT && matches!(row.default, Preset::Absent(_)),
            ..Rule::default()
        };
        let value = T::default_of(row);
        Self { value, rule }
    }
}

/// A type that values of the table of parameters have.
pub trait FromRow {
    /// Without a default it is off.
    const OFF_WHERE_ABSENT: bool = false;

    /// The row's default.
    fn default_of(row: &ParameterSpec) -> Self;
}

/// Implements [`Setting`] for a type that is a single value, by a function that reads it and one that writes it.
#[macro_export]
macro_rules! value_setting {
    ($type:ty, $new:expr, $write:expr) => {
        impl $crate::settings::Setting for $type {
            fn from_given(given: &$crate::settings::Given<'_>) -> Result<Self, $crate::settings::Refused> {
                $new(given)
            }

            fn read(&mut self, given: &$crate::settings::Given<'_>) -> Result<(), $crate::settings::Refused> {
                *self = Self::from_given(given)?;
                Ok(())
            }

            fn write(&self) -> Option<$crate::settings::Value> {
                Some($crate::settings::Value::from($write(self)))
            }
        }
    };
}

/// Implements [`Setting`] for a type with a few named values: one of [`named!`](crate::named), or given as an array of names with values.
#[macro_export]
macro_rules! named_setting {
    ($type:ty) => {
        $crate::named_setting!($type, <$type>::ALL.map(|value| (value.name(), value)));
    };
    ($type:ty, $names:expr) => {
        $crate::value_setting!(
            $type,
            |given| $crate::settings::named(given, &mut $names.into_iter()),
            |value: &$type| $names
                .into_iter()
                .find(|(_, known)| known == value)
                .map_or("", |(name, _)| name)
        );
    };
}

pub use {named_setting, value_setting};

/// Declares tables of settings: `NAME: TYPE = SOURCE,` for each field, where the source ([`settings::With`](crate::settings::With))
/// is a row of the table of parameters, or a default as [`free`](crate::settings::free) and its neighbours make it; `=> "KEY"` behind it
/// where the file has another name. After `..` stands a field that is no setting, with its first value.
#[macro_export]
macro_rules! settings {
    ($($(#[$meta:meta])* $vis:vis struct $name:ident {
        $($(#[$doc:meta])* $field_vis:vis $field:ident: $type:ty = $source:expr $(=> $key:literal)?,)*
        $(.. $(#[$own_doc:meta])* $own:ident: $own_type:ty = $own_value:expr,)?
    })+) => {$(
        $(#[$meta])*
        #[derive(Debug, Clone, PartialEq)]
        $vis struct $name {
            $($(#[$doc])* $field_vis $field: $type,)*
            $($(#[$own_doc])* $own: $own_type,)?
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $crate::settings::With::<$type>::from($source).value,)* $($own: $own_value,)? }
            }
        }

        impl $crate::settings::Section for $name {
            fn fields(&mut self) -> Vec<$crate::settings::Field<'_>> {
                vec![$($crate::settings::Field {
                    name: [$($key,)? stringify!($field)][0],
                    setting: &mut self.$field,
                    rule: $crate::settings::With::<$type>::from($source).rule,
                },)*]
            }
        }
    )+};
}

impl<T: Section> Setting for T {
    fn from_given(given: &Given<'_>) -> Result<Self, Refused> {
        let mut new = Self::default();
        new.read(given)?;
        Ok(new)
    }

    fn read(&mut self, given: &Given<'_>) -> Result<(), Refused> {
        match given.get_ref() {
            DeValue::Table(table) => read_table(table, given.span().start, &mut self.fields()),
            _ => Err(other_type(given, "a table")),
        }
    }

    fn write(&self) -> Option<Value> {
        None
    }

    fn tables(&mut self) -> Vec<Vec<Field<'_>>> {
        vec![self.fields()]
    }
}

fn read_table(table: &DeTable<'_>, start: usize, fields: &mut [Field<'_>]) -> Result<(), Refused> {
    for (name, given) in table {
        let name = name.get_ref().as_ref();
        let Some(field) = fields.iter_mut().find(|field| field.name == name) else {
            return Err(unknown(table, name, fields));
        };
        read_field(field, given).map_err(|refused| refused.within(name))?;
    }
    match fields
        .iter()
        .find(|field| field.rule.is_required && !table.contains_key(field.name))
    {
        Some(field) => Err(Refused::new(start, format!("`{}` is missing", field.name))),
        None => Ok(()),
    }
}

fn read_field(field: &mut Field<'_>, given: &Given<'_>) -> Result<(), Refused> {
    let outside = |value: &f64| field.rule.range.filter(|range| !range.contains(*value));
    let beyond = |(value, range): (f64, Range)| refused(given, format!("{value} is not allowed: {range}"));
    let find = |values: Vec<f64>| values.into_iter().find_map(|value| Some((value, outside(&value)?)));
    if let Some(found) = find(number(given).into_iter().collect()) {
        return Err(beyond(found));
    }
    if let (Some(most), DeValue::Array(items)) = (field.rule.most, given.get_ref())
        && items.len() > most
    {
        return Err(refused(
            given,
            format!("at most {most} are allowed, these are {}", items.len()),
        ));
    }
    field.setting.read(given)?;
    find(numbers_of(field.setting)).map_or(Ok(()), |found| Err(beyond(found)))
}

fn unknown(table: &DeTable<'_>, name: &str, fields: &[Field<'_>]) -> Refused {
    let at = table.iter().map(|(key, _)| key).find(|key| key.get_ref() == name);
    let known: Vec<_> = fields.iter().map(|field| format!("`{}`", field.name)).collect();
    let message = format!("there is no key `{name}` here, only {}", known.join(", "));
    Refused::new(at.map_or(0, |key| key.span().start), message)
}

fn numbers_of(setting: &dyn Setting) -> Vec<f64> {
    let number = |value: &Value| value.as_float().or(value.as_integer().map(|value| value as f64));
    match setting.write() {
        Some(Value::Array(items)) => items.iter().filter_map(number).collect(),
        value => value.iter().filter_map(number).collect(),
    }
}

/// A number that is not accepted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("`{key}` is {value}, must be {range}")]
pub struct Outside {
    /// Dotted path of the key.
    pub key: String,
    /// Its value.
    pub value: f64,
    /// What is accepted.
    pub range: Range,
}

/// Checks every number.
///
/// # Errors
/// The first that is not allowed.
pub fn check<S: Section + Clone>(settings: &S) -> Result<(), Outside> {
    check_fields("", settings.clone().fields())
}

fn check_fields(within: &str, fields: Vec<Field<'_>>) -> Result<(), Outside> {
    for field in fields {
        let key = format!("{within}{}", field.name);
        if let Some(range) = field.rule.range {
            let numbers = numbers_of(field.setting);
            if let Some(value) = numbers.into_iter().find(|value| !range.contains(*value)) {
                return Err(Outside { key, value, range });
            }
        }
        for table in field.setting.tables() {
            check_fields(&format!("{key}."), table)?;
        }
    }
    Ok(())
}

/// Reads TOML; what it does not name keeps its default.
///
/// # Errors
/// Line, key and what is allowed.
pub fn from_toml<S: Section>(text: &str) -> Result<S, String> {
    let read = parse(text).and_then(|root| from_table(root.get_ref()));
    read.map_err(|refused| refused.in_text(text))
}

/// Reads TOML over settings; what it does not name stays.
///
/// # Errors
/// Line, key and what is allowed; the settings are then of no use.
pub fn read_over(settings: &mut impl Section, text: &str) -> Result<(), String> {
    let read = parse(text).and_then(|root| read_table(root.get_ref(), 0, &mut settings.fields()));
    read.map_err(|refused| refused.in_text(text))
}

/// What a text of TOML says, not yet as settings.
///
/// # Errors
/// It is not TOML.
pub fn parse(text: &str) -> Result<Spanned<DeTable<'_>>, Refused> {
    DeTable::parse(text).map_err(|e| {
        let at = e.span().map_or(0, |span| span.start);
        Refused::new(at, e.message().trim().replace('\n', ", "))
    })
}

/// Reads what was parsed; what it does not name keeps its default.
///
/// # Errors
/// Place, key and what is allowed.
pub fn from_table<S: Section>(root: &DeTable<'_>) -> Result<S, Refused> {
    let mut settings = S::default();
    read_table(root, 0, &mut settings.fields())?;
    Ok(settings)
}

/// Reads a file; what it does not name keeps its default.
///
/// # Errors
/// [`SettingsError`], with file, line, key and what is allowed.
pub fn load<S: Section>(path: &Path) -> Result<S, SettingsError> {
    let text = crate::files::read_text(path, SIZE_LIMIT).map_err(crate::files::at(path))?;
    from_toml(&text).map_err(|message| SettingsError::Content {
        path: path.to_owned(),
        message,
    })
}

/// Writes TOML that [`from_toml`] reads back unchanged.
pub fn to_toml<S: Section + Clone>(settings: &S) -> String {
    let mut out = String::new();
    write_fields(&mut out, "", settings.clone().fields());
    out
}

/// A key as TOML wants it: quoted where it is not of letters, digits, `_` and `-` alone.
fn key(name: &str) -> String {
    let is_bare = !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-');
    if is_bare {
        name.to_owned()
    } else {
        Value::from(name).to_string()
    }
}

fn write_fields(out: &mut String, within: &str, fields: Vec<Field<'_>>) {
    for field in &fields {
        if let Some(value) = field.setting.write()
            && !(field.rule.is_quiet && value == Value::Boolean(false))
        {
            // Writing to a string does not fail.
            let _ = writeln!(out, "{} = {value}", key(field.name));
        }
    }
    for field in fields {
        let path = format!("{within}{}", key(field.name));
        let (opens, closes) = if field.setting.is_list() {
            ("[[", "]]")
        } else {
            ("[", "]")
        };
        for table in field.setting.tables() {
            let gap = if out.is_empty() { "" } else { "\n" };
            let _ = writeln!(out, "{gap}{opens}{path}{closes}");
            write_fields(out, &format!("{path}."), table);
        }
    }
}

#[cfg(test)]
mod tests;
