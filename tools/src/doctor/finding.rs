//! One line of a report.

use serde::Serialize;

/// How bad a finding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// As it should be.
    Good,
    /// Flies, but not as well or as safely as it could.
    Warning,
    /// Does not fly, or must not.
    Failure,
}

impl Severity {
    /// Good where it is as it should be, else `bad`.
    pub(crate) fn good_if(is_good: bool, bad: Self) -> Self {
        if is_good { Self::Good } else { bad }
    }
}

/// What was looked at, what was found, what is wanted, and why.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// A message, a parameter or a thing: the same word in every report.
    pub name: String,
    /// How bad it is.
    pub severity: Severity,
    /// The value found, with its unit; absent where there was none.
    pub value: Option<String>,
    /// What is wanted.
    pub wanted: String,
    /// Why that is wanted and what to do where it is not so; empty where all is good.
    pub why: String,
}

impl Finding {
    pub(crate) fn new(name: &str, severity: Severity, value: Option<String>, wanted: &str, why: &str) -> Self {
        Self {
            name: name.to_owned(),
            severity,
            value,
            wanted: wanted.to_owned(),
            why: why.to_owned(),
        }
    }

    /// A finding in one line.
    pub fn line(&self) -> String {
        let value = self.value.as_deref().unwrap_or("nothing");
        let mut line = format!("{:<20} {value}", self.name);
        if self.severity > Severity::Good {
            line += &format!(" (wanted: {}): {}", self.wanted, self.why);
        }
        line
    }
}

/// Findings, as they are added.
pub(super) struct Report(pub(super) Vec<Finding>);

impl Report {
    pub(super) fn failure(&mut self, name: &str, value: String, wanted: &str, why: &str) {
        self.grade(name, Severity::Failure, Some(value), wanted, why);
    }

    pub(super) fn warning(&mut self, name: &str, value: String, wanted: &str, why: &str) {
        self.grade(name, Severity::Warning, Some(value), wanted, why);
    }

    /// A warning of what was not sent.
    pub(super) fn absent(&mut self, name: &str, wanted: &str, why: &str) {
        self.grade(name, Severity::Warning, None, wanted, why);
    }

    pub(super) fn good(&mut self, name: &str, value: String) {
        self.grade(name, Severity::Good, Some(value), "", "");
    }

    /// A value with its grade; of a good one it is not said why.
    pub(super) fn grade(&mut self, name: &str, severity: Severity, value: Option<String>, wanted: &str, why: &str) {
        let why = if severity == Severity::Good { "" } else { why };
        self.0.push(Finding::new(name, severity, value, wanted, why));
    }
}
