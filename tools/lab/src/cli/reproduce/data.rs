//! What was measured: units of data in a folder, each with the command it came from, in an index that also says whether a file
//! is still what was measured. `docs/measured` is such a folder, and `vigil reproduce` makes one of the same kind.

use crate::campaign::flights::sha256;
use crate::cli::output;
use anyhow::{Context, Result, anyhow, bail, ensure};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The largest file of a unit holds a campaign's flights, a megabyte.
const SIZE_LIMIT: u64 = 256 << 20;
const INDEX: &str = "index.toml";

/// What was measured by one command.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Unit {
    /// The command, as a user would type it.
    pub command: String,
    /// What it was measured on: seeds of courses or of noise.
    pub seeds: String,
    /// The commit of the program that measured.
    pub commit: String,
    pub version: String,
    /// What has to be known besides.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub note: String,
    /// Each file, from the index's folder, and its SHA-256.
    pub files: BTreeMap<String, String>,
}

#[derive(Debug, Clone, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Index {
    #[serde(default)]
    units: BTreeMap<String, Unit>,
}

/// A folder of units.
#[derive(Debug, Clone)]
pub struct Data {
    /// Where it lies; each unit's command writes to a folder of its name in it.
    pub folder: PathBuf,
    index: Index,
    /// Measured by this command, not read from the repository.
    pub is_fresh: bool,
}

impl Data {
    /// What the repository holds.
    pub fn committed(folder: &Path) -> Result<Self> {
        ensure!(
            folder.join(INDEX).exists(),
            "{} is missing: the committed data are in docs/measured of the repository; run this command in its root, or name the \
             folder with --data",
            folder.join(INDEX).display()
        );
        Self::open(folder, false)
    }

    /// A folder's; fresh is what this command has measured so far in its output folder.
    pub fn open(folder: &Path, is_fresh: bool) -> Result<Self> {
        let path = folder.join(INDEX);
        let index = match path.exists() {
            false => Index::default(),
            true => {
                let text = vigil_types::files::read_text(&path, SIZE_LIMIT)
                    .with_context(|| format!("cannot read {}", path.display()))?;
                toml::from_str(&text).with_context(|| format!("{} is damaged", path.display()))?
            }
        };
        Ok(Self {
            folder: folder.to_owned(),
            index,
            is_fresh,
        })
    }

    pub fn unit(&self, name: &str) -> Option<&Unit> {
        self.index.units.get(name)
    }

    /// Whether a unit was measured by this command and is whole.
    pub fn has(&self, name: &str, command: &str) -> bool {
        let whole = |unit: &Unit| unit.files.keys().all(|file| self.content(unit, file).is_ok());
        self.unit(name)
            .is_some_and(|unit| unit.command == command && whole(unit))
    }

    /// Enters a unit once its files lie in its folder: from then on it is not measured again.
    pub fn enter(&mut self, name: &str, mut unit: Unit, files: &[String]) -> Result<()> {
        for file in files {
            let file = format!("{name}/{file}");
            let path = self.folder.join(&file);
            let content = vigil_types::files::read(&path, SIZE_LIMIT)
                .with_context(|| format!("cannot read {}", path.display()))?;
            unit.files.insert(file, sha256(&content));
        }
        self.index.units.insert(name.to_owned(), unit);
        output::write(&self.folder.join(INDEX), toml::to_string_pretty(&self.index)?)
    }

    /// Finds a unit to be the one that was to be measured, with these files and none else, each of them whole.
    pub fn check(&self, name: &str, expected: &Unit, files: &[String]) -> Result<()> {
        let unit = self.known(name)?;
        let of_command = Unit {
            files: BTreeMap::new(),
            ..unit.clone()
        };
        let mut names: Vec<String> = files.iter().map(|file| format!("{name}/{file}")).collect();
        names.sort();
        ensure!(
            of_command == *expected && unit.files.keys().eq(&names),
            "{} is damaged: it says of {name} what `{}` does not leave",
            self.folder.join(INDEX).display(),
            expected.command
        );
        unit.files
            .keys()
            .try_for_each(|file| self.content(unit, file).map(drop))
    }

    /// A file of a unit, if it is what was measured.
    ///
    /// # Errors
    /// It is missing or damaged.
    pub fn content(&self, unit: &Unit, file: &str) -> Result<Vec<u8>> {
        let path = self.folder.join(file);
        let mend = match self.is_fresh {
            true => "start again in another folder".to_owned(),
            false => format!("restore it with git, or measure anew: {}", unit.command),
        };
        let content = vigil_types::files::read(&path, SIZE_LIMIT)
            .map_err(|e| anyhow!("cannot read {}: {e}; {mend}", path.display()))?;
        let expected = unit.files.get(file).map_or("", String::as_str);
        ensure!(
            sha256(&content) == expected,
            "{} is not what was measured: its SHA-256 differs from the one in {}; {mend}",
            path.display(),
            self.folder.join(INDEX).display()
        );
        Ok(content)
    }

    /// The text of the unit's only file with this ending.
    ///
    /// # Errors
    /// No such unit, a file that is missing or damaged.
    pub fn text(&self, name: &str, ending: &str) -> Result<String> {
        let unit = self.known(name)?;
        let mut named = unit.files.keys().filter(|file| file.ends_with(ending));
        let (Some(file), None) = (named.next(), named.next()) else {
            bail!(
                "{}: the unit {name} must name one file that ends in {ending}",
                self.folder.join(INDEX).display()
            );
        };
        let path = self.folder.join(file);
        String::from_utf8(self.content(unit, file)?).with_context(|| format!("{} is not text", path.display()))
    }

    /// The unit's JSON.
    ///
    /// # Errors
    /// As [`Self::text`], and a file of something else.
    pub fn json<T: DeserializeOwned>(&self, name: &str) -> Result<T> {
        let text = self.text(name, ".json")?;
        serde_json::from_str(&text).with_context(|| self.other(name))
    }

    /// What an error says of a unit whose files are whole but hold something else.
    pub fn other(&self, name: &str) -> String {
        format!(
            "{}: the data of {name} are not of this version of vigil",
            self.folder.display()
        )
    }

    fn known(&self, name: &str) -> Result<&Unit> {
        self.unit(name)
            .with_context(|| format!("{} has no unit {name}", self.folder.join(INDEX).display()))
    }

    /// The folders that hold the unit's files, each checked.
    pub fn folders(&self, name: &str) -> Result<Vec<PathBuf>> {
        let unit = self.known(name)?;
        let mut folders = Vec::new();
        for file in unit.files.keys() {
            self.content(unit, file)?;
            let path = self.folder.join(file);
            let folder = path.parent().unwrap_or(&self.folder).to_owned();
            if !folders.contains(&folder) {
                folders.push(folder);
            }
        }
        Ok(folders)
    }
}

/// Where the items' numbers come from.
pub struct Sources {
    /// What was measured now; absent with `--committed`.
    pub fresh: Option<Data>,
    /// What the repository holds.
    pub committed: Data,
}

impl Sources {
    /// Where a unit is: measured now if it can be, otherwise committed.
    pub fn of(&self, unit: &str) -> &Data {
        match &self.fresh {
            Some(fresh) if fresh.unit(unit).is_some() => fresh,
            _ => &self.committed,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unit(command: &str) -> Unit {
        Unit {
            command: command.to_owned(),
            ..Unit::default()
        }
    }

    #[test]
    fn a_unit_is_there_when_its_files_are_whole_and_its_command_is_the_same() {
        let folder = tempfile::tempdir().unwrap();
        let mut data = Data::open(folder.path(), true).unwrap();
        let file = data.folder.join("wall").join("table.json");
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        let mut enter = || data.enter("wall", unit("vigil wall"), &["table.json".to_owned()]);
        assert!(enter().is_err(), "no file yet");
        std::fs::write(&file, "[1, 2]").unwrap();
        enter().unwrap();

        let again = Data::open(folder.path(), true).unwrap();
        assert!(again.has("wall", "vigil wall") && !again.has("wall", "vigil wall --states 2"));
        assert!(!again.has("others", "vigil wall"));
        assert_eq!(again.json::<Vec<u8>>("wall").unwrap(), [1, 2]);

        std::fs::write(&file, "[1, 3]").unwrap();
        assert!(!again.has("wall", "vigil wall"));
    }
}
