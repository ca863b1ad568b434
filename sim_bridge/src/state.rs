//! The file that keeps a vehicle's parameters and plans over restarts.

use anyhow::{Context, Result};
use std::path::{Path, PathBuf};
use vigil_endpoint::Saved;

/// `vehicleN.toml` in a folder, written when something changed.
pub(crate) struct StateFile {
    path: PathBuf,
    /// What the file holds, as far as known.
    stored: Option<String>,
    failing: bool,
}

impl StateFile {
    /// The file of a vehicle.
    pub fn in_folder(folder: &Path, instance: u32) -> Self {
        Self {
            path: folder.join(format!("vehicle{instance}.toml")),
            stored: None,
            failing: false,
        }
    }

    /// What an earlier run left; nothing if there was none. The vehicle checks names and limits.
    ///
    /// # Errors
    /// The file cannot be read or holds wrong types; the message names file, line and field.
    pub fn load(&self) -> Result<Saved> {
        let path = self.path.display();
        match std::fs::read_to_string(&self.path) {
            Ok(text) => toml::from_str(&text).with_context(|| format!("{path}: mend or delete it")),
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(Saved::default()),
            Err(e) => Err(e).with_context(|| format!("cannot read {path}")),
        }
    }

    /// Writes what changed. A disk that refuses is told once and does not end the flight.
    pub fn store(&mut self, saved: &Saved) {
        // NaN differs from itself, its text does not.
        let Ok(text) = toml::to_string(saved) else {
            return;
        };
        if self.stored.as_ref() == Some(&text) {
            return;
        }
        let result = self.write(&text);
        match result {
            Ok(()) => self.stored = Some(text),
            Err(e) if !self.failing => {
                tracing::warn!("cannot store {}: {e}; it will be tried again", self.path.display())
            }
            Err(_) => {}
        }
        self.failing = self.stored.is_none();
    }

    fn write(&self, text: &str) -> std::io::Result<()> {
        if let Some(folder) = self.path.parent() {
            std::fs::create_dir_all(folder)?;
        }
        let new = self.path.with_extension("toml.new");
        std::fs::write(&new, text)?;
        // In place at once: whoever is killed here leaves the old state or the new one.
        std::fs::rename(&new, &self.path)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{SimConfig, Simulator};
    use vigil_world::{Family, generate};

    fn load(text: &str) -> Result<Saved> {
        let folder = tempfile::tempdir()?;
        std::fs::write(folder.path().join("vehicle3.toml"), text)?;
        StateFile::in_folder(folder.path(), 3).load()
    }

    /// Starts a vehicle with a state; why it does not start, or what it would save.
    fn start(text: &str) -> Result<Saved> {
        let mut config = SimConfig::new(generate(Family::Validation, 1), 1);
        config.saved = load(text)?;
        Ok(Simulator::new(&config, 0)?.saved())
    }

    #[test]
    fn a_state_is_what_it_was_after_a_restart() {
        let item = "command = 16\nframe = 3\nautocontinue = 1\nparams = [0.0, 0.5, 0.0, nan]\nx = 473977420\ny = 85455940\nz = 3.0\n";
        let text = format!(
            "[parameters]\nCOM_OBL_RC_ACT = 4.0\nMIS_TAKEOFF_ALT = 3.1\n\n[[mission]]\n{item}\n[[rally]]\n{item}"
        )
        .replacen("[[rally]]\ncommand = 16", "[[rally]]\ncommand = 5100", 1);
        let saved = start(&text).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let mut file = StateFile::in_folder(&folder.path().join("made"), 3);
        assert_eq!(file.load().unwrap(), Saved::default(), "there is none yet");
        file.store(&saved);
        let mut config = SimConfig::new(generate(Family::Validation, 1), 1);
        config.saved = file.load().unwrap();
        let again = Simulator::new(&config, 0).unwrap().saved();
        assert_eq!(toml::to_string(&again).unwrap(), toml::to_string(&saved).unwrap());
        assert_eq!(again.parameters["MIS_TAKEOFF_ALT"], 3.1);
        assert!(toml::to_string(&again).unwrap().contains("command = 5100"));
    }

    #[test]
    fn a_state_with_wrong_types_names_or_values_is_refused_by_file_and_field() {
        for (text, told) in [
            ("[parameters]\nMIS_TAKEOFF_ALT = \"high\"", "line 2"),
            ("[parameters]\nMIS_TAKEOFF_ALT = true", "vehicle3.toml"),
            ("parameters = 5", "line 1"),
            ("[[mission]]\ncommand = 70000", "u16"),
            ("[colours]\nsky = 1", "colours"),
            ("[parameters]\nCOM_OBL_RC_ACT = 4.5", "COM_OBL_RC_ACT"),
            ("[parameters]\nMIS_TAKEOFF_ALT = -1.0", "MIS_TAKEOFF_ALT"),
            ("[parameters]\nMIS_TAKEOFF_ALT = nan", "MIS_TAKEOFF_ALT"),
            ("[parameters]\nNOT_THERE = 1.0", "NOT_THERE"),
            (
                "[[rally]]\ncommand = 16\nframe = 3\nautocontinue = 1\nparams = [0.0, 0.0, 0.0, 0.0]\nx = 1\ny = 1\nz = 3.0",
                "rally points",
            ),
        ] {
            let error = start(text).err().map(|e| format!("{e:#}")).unwrap_or_default();
            assert!(error.contains(told), "{text}: {error}");
        }
    }

    #[test]
    fn a_disk_that_refuses_is_tried_again() {
        let folder = tempfile::tempdir().unwrap();
        let blocked = folder.path().join("file");
        std::fs::write(&blocked, "in the way").unwrap();
        let mut file = StateFile::in_folder(&blocked, 0);
        file.store(&Saved::default());
        std::fs::remove_file(&blocked).unwrap();
        file.store(&Saved::default());
        assert!(blocked.join("vehicle0.toml").exists());
    }
}
