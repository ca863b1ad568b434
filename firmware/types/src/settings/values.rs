//! What a setting may be: numbers, switches, texts, choices, paths, and lists and tables of settings.

use super::{Field, FromRow, Given, Refused, Rule, Setting, other_type, refused};
use crate::choice::Choice;
use crate::parameters::{ParameterSpec, Preset};
use crate::value_setting;
use std::borrow::ToOwned;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::string::{String, ToString};
use std::vec::Vec;
use toml::Value;
use toml::de::DeValue;

impl<T: Setting> Setting for Option<T> {
    fn from_given(given: &Given<'_>) -> Result<Self, Refused> {
        T::from_given(given).map(Some)
    }

    fn read(&mut self, given: &Given<'_>) -> Result<(), Refused> {
        match self {
            Some(value) => value.read(given),
            None => Self::from_given(given).map(|new| *self = new),
        }
    }

    fn write(&self) -> Option<Value> {
        self.as_ref()?.write()
    }

    fn tables(&mut self) -> Vec<Vec<Field<'_>>> {
        self.as_mut().map_or_else(Vec::new, Setting::tables)
    }
}

impl<T: Setting> Setting for Vec<T> {
    fn from_given(given: &Given<'_>) -> Result<Self, Refused> {
        let DeValue::Array(items) = given.get_ref() else {
            return Err(other_type(given, "a list"));
        };
        let numbered = items.iter().enumerate();
        numbered
            .map(|(i, item)| T::from_given(item).map_err(|refused| refused.within(&format!("[{i}]"))))
            .collect()
    }

    fn read(&mut self, given: &Given<'_>) -> Result<(), Refused> {
        Self::from_given(given).map(|new| *self = new)
    }

    fn write(&self) -> Option<Value> {
        let items: Vec<_> = self.iter().filter_map(Setting::write).collect();
        (!items.is_empty()).then_some(Value::Array(items))
    }

    fn tables(&mut self) -> Vec<Vec<Field<'_>>> {
        self.iter_mut().flat_map(Setting::tables).collect()
    }

    fn is_list(&self) -> bool {
        true
    }
}

impl<T: Setting, const N: usize> Setting for [T; N] {
    fn from_given(given: &Given<'_>) -> Result<Self, Refused> {
        let items = Vec::<T>::from_given(given)?;
        Self::try_from(items).map_err(|items| refused(given, format!("{N} values are needed, not {}", items.len())))
    }

    fn read(&mut self, given: &Given<'_>) -> Result<(), Refused> {
        Self::from_given(given).map(|new| *self = new)
    }

    fn write(&self) -> Option<Value> {
        Some(Value::Array(self.iter().filter_map(Setting::write).collect()))
    }
}

impl<T: Setting> Setting for BTreeMap<String, T> {
    fn from_given(given: &Given<'_>) -> Result<Self, Refused> {
        let DeValue::Table(table) = given.get_ref() else {
            return Err(other_type(given, "a table"));
        };
        let named = table.iter().map(|(name, value)| {
            let name = name.get_ref().to_string();
            let value = T::from_given(value).map_err(|refused| refused.within(&name))?;
            Ok((name, value))
        });
        named.collect()
    }

    fn read(&mut self, given: &Given<'_>) -> Result<(), Refused> {
        Self::from_given(given).map(|new| *self = new)
    }

    fn write(&self) -> Option<Value> {
        None
    }

    fn tables(&mut self) -> Vec<Vec<Field<'_>>> {
        let fields = self.iter_mut().map(|(name, setting)| Field {
            name,
            setting,
            rule: Rule::default(),
        });
        let fields: Vec<_> = fields.collect();
        if fields.is_empty() { Vec::new() } else { vec![fields] }
    }
}

pub(super) fn number(given: &Given<'_>) -> Option<f64> {
    match given.get_ref() {
        DeValue::Float(float) => float.as_str().parse().ok(),
        DeValue::Integer(integer) => Some(i64::from_str_radix(integer.as_str(), integer.radix()).ok()? as f64),
        _ => None,
    }
}

fn real(given: &Given<'_>) -> Result<f64, Refused> {
    number(given).ok_or_else(|| match given.get_ref() {
        DeValue::Integer(integer) => refused(given, format!("{integer} is too large or too small")),
        _ => other_type(given, "a number"),
    })
}

fn whole<T: TryFrom<i64>>(given: &Given<'_>) -> Result<T, Refused> {
    let DeValue::Integer(integer) = given.get_ref() else {
        return Err(other_type(given, "a whole number"));
    };
    let value = i64::from_str_radix(integer.as_str(), integer.radix()).ok();
    let value = value.and_then(|value| T::try_from(value).ok());
    value.ok_or_else(|| refused(given, format!("{integer} is too large or too small")))
}

/// A text.
///
/// # Errors
/// Anything else.
pub fn text<'a>(given: &'a Given<'_>) -> Result<&'a str, Refused> {
    match given.get_ref() {
        DeValue::String(text) => Ok(text),
        _ => Err(other_type(given, "a text")),
    }
}

/// What a text stands for.
///
/// # Errors
/// Another type, or a text that the type refuses.
pub fn parsed<T: std::str::FromStr<Err: ToString>>(given: &Given<'_>) -> Result<T, Refused> {
    text(given)?.parse().map_err(|e: T::Err| refused(given, e.to_string()))
}

/// One of a few values by its name.
///
/// # Errors
/// Another name, with those that there are.
pub fn named<T: Copy>(given: &Given<'_>, known: &mut dyn Iterator<Item = (&'static str, T)>) -> Result<T, Refused> {
    let name = text(given);
    let mut names = Vec::new();
    for (word, value) in known {
        if name == Ok(word) {
            return Ok(value);
        }
        names.push(word);
    }
    let names = names.join(", ");
    Err(match name {
        Ok(name) => refused(given, format!("there is no {name:?}, only {names}")),
        Err(_) => other_type(given, &format!("one of {names}")),
    })
}

impl<T> FromRow for Option<T> {
    fn default_of(_: &ParameterSpec) -> Self {
        None
    }
}

impl<T> FromRow for Vec<T> {
    fn default_of(_: &ParameterSpec) -> Self {
        Self::new()
    }
}

impl FromRow for bool {
    const OFF_WHERE_ABSENT: bool = true;

    fn default_of(row: &ParameterSpec) -> Self {
        row.is_on()
    }
}

macro_rules! numbers {
    ($($type:ty)+) => {$(
        impl FromRow for $type {
            fn default_of(row: &ParameterSpec) -> Self {
                row.number() as Self
            }
        }
    )+};
}
numbers! { f32 f64 u8 u16 u32 }

value_setting!(f64, real, |value: &f64| *value);
// As people write it: 0.4, not the double next to it.
value_setting!(f32, |given| real(given).map(|value| value as f32), |value: &f32| {
    value.to_string().parse().unwrap_or(f64::from(*value))
});
value_setting!(u8, whole, |value: &u8| i64::from(*value));
value_setting!(u16, whole, |value: &u16| i64::from(*value));
value_setting!(u32, whole, |value: &u32| i64::from(*value));
value_setting!(i32, whole, |value: &i32| *value);
value_setting!(u64, whole, |value: &u64| *value as i64);
value_setting!(usize, whole, |value: &usize| *value as i64);
value_setting!(bool, switch, |value: &bool| *value);
value_setting!(String, |given| text(given).map(str::to_owned), |text: &String| text
    .clone());
value_setting!(PathBuf, |given| text(given).map(PathBuf::from), |path: &PathBuf| {
    path.to_string_lossy().into_owned()
});

fn switch(given: &Given<'_>) -> Result<bool, Refused> {
    match given.get_ref() {
        DeValue::Boolean(on) => Ok(*on),
        _ => Err(other_type(given, "true or false")),
    }
}

/// One of a choice's values by its name.
pub(crate) fn choice<T: Choice>(given: &Given<'_>) -> Result<T, Refused> {
    let names = T::WORDS.iter().map(|(name, _)| *name);
    named(given, &mut names.zip(T::ALL.iter().copied()))
}

impl<T: Choice + Default> FromRow for T {
    fn default_of(row: &ParameterSpec) -> Self {
        match row.default {
            Preset::Choice(place) => T::ALL.get(place).copied().unwrap_or_default(),
            _ => T::default(),
        }
    }
}
