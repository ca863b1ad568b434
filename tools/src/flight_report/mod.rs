//! The report of one flight: one HTML file that needs no network, made from a flight log.

mod film;
mod flight_data;
mod log_seen;
mod page;
mod words;

pub use flight_data::{outline_of, read};
pub use log_seen::{LogSeen, StepSeen, WHO};
pub use page::{DATA_LIMIT, html};

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use vigil_adversary::AttackArgs;

/// Frames around the first alarm whose pixels are explained, unless asked otherwise.
pub const EXPLAINED: usize = 12;

/// What is known of a flight, for its log: the command that flies it again, our commit, the attack, and `more`.
pub fn about<'a>(
    command: String,
    attack: &AttackArgs,
    more: impl IntoIterator<Item = (&'a str, Option<String>)>,
) -> BTreeMap<String, String> {
    let known = [
        ("command", Some(command)),
        ("git_commit", crate::cli::output::git_commit()),
        ("attack", attack.attack.map(|method| method.name().to_owned())),
    ];
    known
        .into_iter()
        .chain(more)
        .filter_map(|(name, value)| Some((name.to_owned(), value?)))
        .collect()
}

/// The command line that flies the same again: `arguments` are those of the process, with its name first, without the options
/// `dropped` (each with a value) and with `added` behind.
pub fn command_again(
    arguments: impl IntoIterator<Item = impl Into<OsString>>,
    command: &str,
    dropped: &[&str],
    added: &[&str],
) -> String {
    let mut again = vec!["vigil".to_owned(), command.to_owned()];
    let text = |argument: OsString| argument.to_string_lossy().into_owned();
    let arguments = arguments.into_iter().map(|argument| text(argument.into()));
    let mut named = false;
    let mut arguments = arguments.skip(1).filter(|a| {
        let is_command = !named && a == command;
        named |= is_command;
        !is_command
    });
    while let Some(argument) = arguments.next() {
        let (name, has_value) = match argument.split_at_checked(2) {
            // `-oFILE`
            Some((short, value)) if !short.ends_with('-') && dropped.contains(&short) => (short, !value.is_empty()),
            _ => argument
                .split_once('=')
                .map_or((argument.as_str(), false), |(n, _)| (n, true)),
        };
        if !dropped.contains(&name) {
            again.push(quoted(&argument));
        } else if !has_value {
            arguments.next();
        }
    }
    again.extend(added.iter().map(|a| quoted(a)));
    again.join(" ")
}

/// An argument as a shell reads it back.
pub fn quoted(argument: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=@:,+%".contains(c);
    match !argument.is_empty() && argument.chars().all(plain) {
        true => argument.to_owned(),
        false => format!("'{}'", argument.replace('\'', "'\\''")),
    }
}

/// The name of the report beside a log: `flight-0001.mcap` → `flight-0001.html`.
pub fn beside(log: &Path) -> PathBuf {
    log.with_extension("html")
}

#[cfg(test)]
mod tests {
    use super::command_again;

    #[test]
    fn the_command_that_flies_again_has_the_drawn_seed_and_not_this_flights_folder() {
        let again = |line: &str| {
            let line = line.split('|').map(str::to_owned);
            command_again(line, "fly", &["-o", "--log", "--seed"], &["--seed", "7"])
        };
        for (line, command) in [
            ("/usr/bin/vigil", "vigil fly --seed 7"),
            ("vigil|-v|fly", "vigil fly -v --seed 7"),
            ("vigil|fly|--seed=9|--apf|off", "vigil fly --apf off --seed 7"),
            (
                "vigil|fly|-o|my runs|--log=x|-oruns|--course|it's.toml",
                "vigil fly --course 'it'\\''s.toml' --seed 7",
            ),
        ] {
            assert_eq!(again(line), command);
        }
    }
}
