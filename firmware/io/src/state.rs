//! Files that keep what outlives a restart: tables that people can read, written as a whole.

use std::marker::PhantomData;
use std::path::{Path, PathBuf};
use vigil_types::files::{Access, FileError, at};
use vigil_types::settings::{Section, from_toml, to_toml};

/// Parameters and plans take some kilobytes.
const SIZE_LIMIT: u64 = 16 << 20;

/// Why a state cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum StateError {
    /// The file cannot be read.
    #[error("cannot read {0}")]
    Read(#[from] FileError),
    /// The file's content is not accepted, by the parser's report of line and field; it is left as it is.
    #[error("{0}: mend or delete it: {1}")]
    Content(PathBuf, String),
}

/// `NAME.toml` in a folder, written when something changed.
pub struct StateFile<T> {
    path: PathBuf,
    /// What the file holds, as far as known.
    stored: Option<String>,
    failing: bool,
    content: PhantomData<T>,
}

impl<T: Section + Clone> StateFile<T> {
    /// The file of that name, which need not be there.
    pub fn in_folder(folder: &Path, name: &str) -> Self {
        Self {
            path: folder.join(format!("{name}.toml")),
            stored: None,
            failing: false,
            content: PhantomData,
        }
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What an earlier run left; the default if there was none. Whose state it is checks names and limits.
    ///
    /// # Errors
    /// [`StateError`]: the file cannot be read, is damaged or holds wrong types; the message names file, line and field.
    pub fn load(&self) -> Result<T, StateError> {
        match vigil_types::files::read_text(&self.path, SIZE_LIMIT) {
            Ok(text) => from_toml(&text).map_err(|e| self.refused(&e)),
            Err(e) if e.kind() == std::io::ErrorKind::InvalidData => Err(self.refused(&e.to_string())),
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(T::default()),
            Err(error) => Err(at(&self.path)(error).into()),
        }
    }

    /// The error that names the file.
    pub fn refused(&self, message: &str) -> StateError {
        StateError::Content(self.path.clone(), message.to_owned())
    }

    /// The error that names the file and the line on which `key` is set; without the line where there is none.
    pub fn refused_at(&self, key: &str, message: &str) -> StateError {
        let text = vigil_types::files::read_text(&self.path, SIZE_LIMIT).unwrap_or_default();
        let sets = |line: &str| {
            let name = line.split_once('=').map(|(name, _)| name.trim().trim_matches('"'));
            name == Some(key)
        };
        match text.lines().position(sets) {
            Some(at) => self.refused(&format!("line {}: {message}", at + 1)),
            None => self.refused(message),
        }
    }

    /// Writes what changed; whether it is on the disk now. A disk that refuses is reported once and does not end the flight.
    pub fn store(&mut self, saved: &T) -> bool {
        // NaN differs from itself, its text does not.
        let text = to_toml(saved);
        if self.stored.as_ref() == Some(&text) {
            return true;
        }
        match self.write(&text) {
            Ok(()) => (self.stored, self.failing) = (Some(text), false),
            Err(e) => {
                if !std::mem::replace(&mut self.failing, true) {
                    tracing::warn!("cannot store {}: {e}; it will be tried again", self.path.display());
                }
            }
        }
        !self.failing
    }

    fn write(&self, text: &str) -> std::io::Result<()> {
        if let Some(folder) = self.path.parent() {
            std::fs::create_dir_all(folder)?;
        }
        vigil_types::files::replace(&self.path, text.as_bytes(), Access::Shared)
    }
}

/// A float as people write it: 0.4, not the double next to it.
pub fn exact(value: f32) -> f64 {
    value.to_string().parse().unwrap_or(f64::from(value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use vigil_types::settings;
    use vigil_types::settings::free;

    settings! {
        struct Saved {
            value: u64 = free(0),
        }
    }

    #[test]
    fn what_a_disk_refused_is_not_taken_for_stored_and_can_be_tried_again() {
        let folder = tempfile::tempdir().unwrap();
        let in_the_way = folder.path().join("state");
        let mut file = StateFile::<Saved>::in_folder(&in_the_way, "own");
        assert!(file.store(&Saved { value: 1 }));
        std::fs::remove_dir_all(&in_the_way).unwrap();
        std::fs::write(&in_the_way, "").unwrap();
        assert!(!file.store(&Saved { value: 2 }) && !file.store(&Saved { value: 2 }));
        std::fs::remove_file(&in_the_way).unwrap();
        assert!(file.store(&Saved { value: 2 }));
        assert_eq!(file.load().unwrap(), Saved { value: 2 });
    }
}
