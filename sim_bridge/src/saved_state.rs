//! The file that keeps a vehicle's parameters and plans over restarts.

use std::path::Path;
use vigil_autopilot::Saved;
use vigil_io::state::StateFile;

/// The file of a vehicle.
pub(crate) fn state_file(folder: &Path, instance: u32) -> StateFile<Saved> {
    StateFile::in_folder(folder, &format!("vehicle{instance}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::{Family, generate};
    use crate::{SimConfig, Simulator};

    fn load(text: &str) -> anyhow::Result<Saved> {
        let folder = tempfile::tempdir()?;
        std::fs::write(folder.path().join("vehicle3.toml"), text)?;
        Ok(state_file(folder.path(), 3).load()?)
    }

    /// Starts a vehicle with a state; why it does not start, or what it would save.
    fn start(text: &str) -> anyhow::Result<Saved> {
        let mut config = SimConfig::new(generate(Family::Validation, 1), 1);
        config.saved = load(text)?;
        Ok(Simulator::new(&config, 0)?.endpoint.saved())
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
        let mut file = state_file(&folder.path().join("made"), 3);
        assert_eq!(file.load().unwrap(), Saved::default(), "there is none yet");
        file.store(&saved);
        let mut config = SimConfig::new(generate(Family::Validation, 1), 1);
        config.saved = file.load().unwrap();
        let again = Simulator::new(&config, 0).unwrap().endpoint.saved();
        let toml = vigil_types::settings::to_toml::<Saved>;
        assert_eq!(toml(&again), toml(&saved));
        assert_eq!(again.parameters["MIS_TAKEOFF_ALT"], 3.1);
        assert!(toml(&again).contains("command = 5100"));
    }

    #[test]
    fn a_state_with_wrong_types_names_or_values_is_refused_by_file_and_field() {
        for (text, reason) in [
            ("[parameters]\nMIS_TAKEOFF_ALT = \"high\"", "line 2"),
            ("[parameters]\nMIS_TAKEOFF_ALT = true", "vehicle3.toml"),
            ("[parameters]\nMIS_TAKEOFF", "line 2"),
            ("parameters = 5", "line 1"),
            (
                "[[mission]]\ncommand = 70000",
                "line 2, column 11: `mission[0].command`: 70000 is too large",
            ),
            ("[colours]\nsky = 1", "colours"),
            ("[parameters]\nCOM_OBL_RC_ACT = 4.5", "COM_OBL_RC_ACT"),
            ("[parameters]\nMIS_TAKEOFF_ALT = -1.0", "MIS_TAKEOFF_ALT"),
            ("[parameters]\nMIS_TAKEOFF_ALT = nan", "MIS_TAKEOFF_ALT"),
            ("[parameters]\nNOT_THERE = 1.0", "NOT_THERE"),
            (
                "[[rally]]\ncommand = 16\nframe = 3\nautocontinue = 1\nparams = [0.0, 0.0, 0.0, 0.0]\nx = 1\ny = 1\nz = 3.0",
                "rally points: item 0 (command 16, frame 3): not a rally point",
            ),
        ] {
            let error = start(text).err().map(|e| format!("{e:#}")).unwrap_or_default();
            assert!(error.contains(reason), "{text}: {error}");
        }
    }
}
