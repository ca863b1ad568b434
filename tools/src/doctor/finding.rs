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
