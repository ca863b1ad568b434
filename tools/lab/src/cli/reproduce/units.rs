//! What is flown and computed: each unit of data is one or two other `vigil` commands, run in this process.

use super::data::{Data, Unit};
use super::{MadeBy, ReproduceArgs};
use crate::cli::detector::detector_of;
use crate::cli::output::{self, Interrupt, say};
use anyhow::{Context, Result};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs::DirEntry;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::LazyLock;

/// A unit of data and how it is measured; `units.toml` says how to read it.
#[derive(Deserialize)]
pub struct Spec {
    pub name: String,
    /// For the line that says what is going on.
    what: String,
    seeds: String,
    commands: Vec<String>,
    pub files: Vec<String>,
}

/// In the order in which they are measured.
pub static SPECS: LazyLock<Vec<Spec>> = LazyLock::new(|| {
    let units: Result<BTreeMap<String, Vec<Spec>>, _> =
        toml::from_str(include_str!("../../../../assets/reproduce/units.toml"));
    // A test reads it.
    units.map_or_else(|_| Vec::new(), |mut units| units.remove("unit").unwrap_or_default())
});

/// Units that only the repository has: training takes hours, and the peers need 5 GB of Python.
pub const COMMITTED_ONLY: [&str; 2] = ["training-runs", "peers"];

/// What is asked for, and by what it is made.
pub struct Setting<'a> {
    pub args: &'a ReproduceArgs,
    pub made_by: &'a MadeBy,
}

impl Spec {
    fn lines(&self, quick: bool) -> impl Iterator<Item = String> {
        let of_size = move |word: &str| match word.split_once('/') {
            Some((few, all)) => if quick { few } else { all }.to_owned(),
            None => word.to_owned(),
        };
        let line = move |command: &String| command.split(' ').map(of_size).collect::<Vec<_>>().join(" ");
        self.commands.iter().map(line)
    }

    /// The command as a user would type it in the repository.
    pub fn command(&self, setting: &Setting<'_>) -> String {
        let detector = setting.args.detector.as_deref();
        let detector = detector.unwrap_or(Path::new("detector/frozen/lstm_ad.safetensors"));
        let detector = detector.display().to_string();
        let mut commands = Vec::new();
        for line in self.lines(setting.args.quick) {
            let mut words = format!("vigil {}", line.replace("DETECTOR", &detector));
            for (name, file) in extra(&line, setting) {
                words += &format!(" {name} {}", file.display());
            }
            commands.push(words);
        }
        commands.join(" && ")
    }

    /// Runs the commands. False when Ctrl-C came before they were done.
    pub fn measure(
        &self,
        setting: &Setting<'_>,
        data: &mut Data,
        interrupt: &Interrupt,
        run: &dyn Fn(Vec<OsString>) -> Result<ExitCode>,
    ) -> Result<bool> {
        let folder = data.folder.join(&self.name);
        std::fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
        // The attacker's copy: a campaign that is gone on with must name the same file.
        let copy = folder.join("known-detector.safetensors");
        for line in self.lines(setting.args.quick) {
            if line.contains("DETECTOR") {
                detector_of(&setting.made_by.actor_sha256, setting.args.detector.as_deref())?.save(&copy)?;
            }
            let mut words: Vec<OsString> = vec!["vigil".into()];
            words.extend(line.split(' ').map(|word| match word {
                "DETECTOR" => copy.clone().into_os_string(),
                word => word.into(),
            }));
            let place = match line.starts_with("evaluate") {
                true => folder.join(&self.files[0]),
                false => folder.clone(),
            };
            words.extend(["-o".into(), place.into_os_string()]);
            let goes_on = ["evaluate", "attack completion", "attack defended"];
            if goes_on.iter().any(|command| line.starts_with(command)) {
                words.push("--resume".into());
            }
            if let Some(threads) = setting.args.threads {
                words.extend(["--threads".into(), threads.to_string().into()]);
            }
            for (name, file) in extra(&line, setting) {
                words.extend([name.into(), file.as_os_str().to_owned()]);
            }
            output::quietly(|| run(words)).with_context(|| format!("vigil {line}"))?;
            if interrupt.came() {
                return Ok(false);
            }
        }
        let entries = std::fs::read_dir(&folder).with_context(|| format!("cannot read {}", folder.display()))?;
        let is_other = |entry: &DirEntry| !self.files.iter().any(|file| entry.file_name() == **file);
        for entry in entries.flatten().filter(is_other) {
            // What stays takes room, no more.
            let _ = std::fs::remove_file(entry.path());
        }
        data.enter(&self.name, self.unit(setting), &self.files)?;
        Ok(true)
    }

    /// What the index says of it, but for the files.
    pub fn unit(&self, setting: &Setting<'_>) -> Unit {
        Unit {
            command: self.command(setting),
            seeds: self.seeds.clone(),
            commit: setting.made_by.commit.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            ..Unit::default()
        }
    }
}

/// Actor and detector, by the names that the command has for them.
fn extra<'a>(line: &str, setting: &Setting<'a>) -> Vec<(&'static str, &'a PathBuf)> {
    let mut words = Vec::new();
    if let Some(actor) = &setting.args.actor {
        words.push(("--actor", actor));
    }
    let name = match line.split(' ').take(2).collect::<Vec<_>>()[..] {
        ["evaluate", ..] => Some("--detector-file"),
        ["attack", "defended"] | ["detector", "figures" | "times" | "evaluate" | "table"] => Some("--detector"),
        _ => None,
    };
    if let (Some(name), Some(file)) = (name, &setting.args.detector) {
        words.push((name, file));
    }
    words
}

/// Takes units that were measured elsewhere; those that are there already must be the same.
///
/// # Errors
/// Units that are damaged, of another command or contradict those that are there; a folder that cannot be written.
pub fn take(names: &[&str], setting: &Setting<'_>, from: &Data, data: &mut Data) -> Result<()> {
    for spec in SPECS.iter().filter(|spec| names.contains(&&*spec.name)) {
        let Some(unit) = from.unit(&spec.name) else { continue };
        from.check(&spec.name, &spec.unit(setting), &spec.files)?;
        anyhow::ensure!(
            data.unit(&spec.name).is_none_or(|there| there == unit),
            "{} and {} contradict each other: {} came out differently. Flights come out the same on every machine, times do not: \
             leave one of the two out",
            from.folder.display(),
            data.folder.display(),
            spec.name
        );
        for file in unit.files.keys() {
            let to = data.folder.join(file);
            output::prepare(&to)?;
            output::write(&to, from.content(unit, file)?)?;
        }
        data.enter(&spec.name, spec.unit(setting), &spec.files)?;
        say!("{}: taken from {}", spec.what, from.folder.display());
    }
    Ok(())
}

/// Measures what is missing of some units. False when Ctrl-C came first.
pub fn measure(
    names: &[&str],
    setting: &Setting<'_>,
    data: &mut Data,
    run: &dyn Fn(Vec<OsString>) -> Result<ExitCode>,
) -> Result<bool> {
    let interrupt = Interrupt::on_ctrl_c()?;
    let wanted: Vec<&Spec> = SPECS.iter().filter(|spec| names.contains(&&*spec.name)).collect();
    for (number, spec) in wanted.iter().enumerate() {
        let place = format!("[{}/{}] {}", number + 1, wanted.len(), spec.what);
        let command = spec.command(setting);
        if data.has(&spec.name, &command) {
            say!("{place}: is there");
            continue;
        }
        say!("{place}: {command}");
        if interrupt.came() || !spec.measure(setting, data, &interrupt, run)? {
            return Ok(false);
        }
    }
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_commands_of_all_units_are_commands() {
        use clap::CommandFactory as _;
        for quick in [true, false] {
            let args = &ReproduceArgs {
                quick,
                ..ReproduceArgs::default()
            };
            let made_by = &MadeBy::by(args).unwrap();
            let setting = Setting { args, made_by };
            for spec in SPECS.iter() {
                for line in spec.command(&setting).split(" && ") {
                    let parsed = crate::cli::Cli::command().try_get_matches_from(line.split(' '));
                    assert!(parsed.is_ok(), "{line}: {}", parsed.unwrap_err());
                }
            }
        }
    }
}
