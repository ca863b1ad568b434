//! What the guidance computer keeps over restarts: parameters that were set over MAVLink, and that a person took the
//! vehicle over (docs/firmware.md, "State").

use crate::config::FirmwareConfig;
use crate::tunables::Tunables;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;
use vigil_io::background::Background;
use vigil_io::state::{StateError, StateFile, exact};
use vigil_mavlink::{ParameterValue, Parameters};
use vigil_types::parameters::{self, Kind};
use vigil_types::settings::{Value, section};
use vigil_types::{Duty, settings};

/// Tables that may wait to be stored; the newest is offered again in the next step.
const CAPACITY: usize = 8;
/// How often the writer looks.
const PAUSE: Duration = Duration::from_millis(100);

settings! {
    /// The file's content.
    struct Saved {
        /// A person took the vehicle over, and no operator engaged since.
        taken_over: bool = &parameters::TAKEN_OVER,
        /// Parameters that were set, by name.
        parameters: BTreeMap<String, f64> = section(),
    }
}

/// What is to be kept, as a step leaves it: the parameters, and whether a person took the vehicle over.
type Kept = (Parameters, bool);

/// What an earlier run left, put into the configuration.
pub struct LoadedParameters {
    file: StateFile<Saved>,
    saved: Saved,
}

/// Has the file written when a parameter was set, by a thread of its own: the loop must not wait for a disk.
pub struct ParameterStore {
    writer: Background<Kept>,
    offered: Kept,
}

impl ParameterStore {
    /// Reads the file of an instance and puts what it holds into `config`, over what the configuration file and the
    /// command line say.
    ///
    /// # Errors
    /// A file that is damaged, or that holds a wrong type, an unknown name or a value out of range; it is left as it is.
    pub fn load(folder: &Path, config: &mut FirmwareConfig) -> Result<LoadedParameters, StateError> {
        let file = StateFile::<Saved>::in_folder(folder, &format!("firmware{}", config.instance));
        let saved = file.load()?;
        let table = Tunables::full_table(&config.stack());
        let mut names = Vec::new();
        for (name, value) in &saved.parameters {
            // Whoever wanted to be left alone could not be guarded again by the parameter, which only a firmware that guards has.
            if config.duty != Duty::Fly && parameters::DUTY.mavlink.is_some_and(|own| own.name == name) && *value == 0.0
            {
                continue;
            }
            table
                .check(name, *value)
                .map_err(|e| e.to_string())
                .and_then(|checked| put(config, name, checked))
                .map_err(|e| file.refused_at(name, &format!("{name} = {value}: {e}")))?;
            names.push(name.as_str());
        }
        config.state.taken_over |= saved.taken_over;
        if saved.taken_over {
            tracing::warn!(
                "from {}: a person took the vehicle over; guidance engages when an operator says so",
                file.path().display()
            );
        }
        if !names.is_empty() {
            tracing::info!("from {}: {}", file.path().display(), names.join(", "));
        }
        Ok(LoadedParameters { file, saved })
    }

    /// Looks at what a step left. Never waits and allocates nothing.
    pub fn observe(&mut self, table: &Parameters, taken_over: bool) {
        if (table, taken_over) != (&self.offered.0, self.offered.1) {
            let kept = (table.clone(), taken_over);
            if self.writer.offer(kept.clone()) {
                self.offered = kept;
            }
        }
    }
}

impl LoadedParameters {
    /// Starts the writer; `table` is what the flight begins with.
    ///
    /// # Errors
    /// When the thread cannot be started.
    pub fn start(self, table: &Parameters) -> std::io::Result<ParameterStore> {
        let Self { mut file, mut saved } = self;
        let begun_with = table.clone();
        let offered = (table.clone(), saved.taken_over);
        let mut unstored = false;
        let writer = Background::start(
            "parameters",
            CAPACITY,
            PAUSE,
            move |offered: &mut dyn Iterator<Item = Kept>| {
                for (table, taken_over) in offered {
                    note(&mut saved, &begun_with, &table);
                    (saved.taken_over, unstored) = (taken_over, true);
                }
                // A disk that refused is tried again in the next round.
                unstored = unstored && !file.store(&saved);
            },
        );
        let writer = writer?;
        Ok(ParameterStore { writer, offered })
    }
}

/// What was set stays in the file, also when it was set back; what was never set is left to the configuration.
fn note(saved: &mut Saved, begun_with: &Parameters, table: &Parameters) {
    for (now, before) in table.all().iter().zip(begun_with.all()) {
        if now.value != before.value || saved.parameters.contains_key(now.name) {
            let value = match now.value {
                ParameterValue::Real(v) => exact(v),
                ParameterValue::Integer(v) => v.into(),
            };
            saved.parameters.insert(now.name.to_owned(), value);
        }
    }
}

/// Puts a value of a MAVLink parameter where the configuration has it.
fn put(config: &mut FirmwareConfig, name: &str, value: ParameterValue) -> Result<(), String> {
    let parameter = parameters::of_mavlink_name(name).ok_or("there is no parameter of that name")?;
    let value = match (parameter.kind, value) {
        (Kind::Choice(words), ParameterValue::Integer(code)) => {
            let word = usize::try_from(code).ok().and_then(|code| words.get(code));
            let (word, _) = word.ok_or_else(|| format!("there is no choice {code}"))?;
            Value::from(*word)
        }
        (Kind::Switch, ParameterValue::Integer(code)) => Value::from(code != 0),
        (_, ParameterValue::Real(v)) => exact(v).into(),
        (_, ParameterValue::Integer(v)) => v.into(),
    };
    *config = config.with(parameter, &value)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use vigil_types::AtGoal;

    /// Starts with a state; why it is refused, or the configuration that flies.
    fn start(text: &[u8]) -> Result<FirmwareConfig, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("firmware0.toml");
        std::fs::write(&path, text).unwrap();
        let mut config = FirmwareConfig::default();
        let result = ParameterStore::load(folder.path(), &mut config);
        assert_eq!(std::fs::read(&path).unwrap(), text, "the bytes are kept");
        result.map(|_| config).map_err(|e| e.to_string())
    }

    /// A run in which an operator changes what flies: what the file then holds.
    fn run(folder: &Path, config: &mut FirmwareConfig, change: impl FnOnce(&mut FirmwareConfig)) -> String {
        let table = |config: &FirmwareConfig| Tunables::of(&config.stack(), None, false).parameters();
        let loaded = ParameterStore::load(folder, config).unwrap();
        let mut store = loaded.start(&table(config)).unwrap();
        change(config);
        store.observe(&table(config), config.state.taken_over);
        drop(store);
        std::fs::read_to_string(folder.join("firmware0.toml")).unwrap_or_default()
    }

    #[test]
    fn each_parameter_of_the_table_is_kept_and_put_where_the_configuration_has_it() {
        let mut config = FirmwareConfig::default();
        let table = Tunables::full_table(&config.stack());
        for parameter in table.all() {
            let mut with = |value: f32| {
                let checked = table.check(parameter.name, value.into()).unwrap();
                put(&mut config, parameter.name, checked).unwrap();
                config.clone()
            };
            assert_ne!(with(parameter.least), with(parameter.greatest), "{}", parameter.name);
        }
    }

    #[test]
    fn what_was_set_is_in_force_after_a_restart_and_what_was_not_set_is_left_to_the_configuration() {
        let folder = tempfile::tempdir().unwrap();
        let state = folder.path().join("made");
        let mut config = FirmwareConfig::default();
        let text = run(&state, &mut config, |config| {
            assert_eq!(*config, FirmwareConfig::default(), "there is none yet");
            config.limits.speed_m_s = 0.7;
            config.at_goal = AtGoal::Land;
        });
        assert_eq!(text, "[parameters]\nGD_AT_GOAL = 1.0\nGD_SPEED_LIM = 0.7\n");

        let mut again = FirmwareConfig::default();
        again.pilot.cruise_m_s = 1.1;
        let text = run(&state, &mut again, |again| {
            assert_eq!((again.limits.speed_m_s, again.at_goal), (0.7, AtGoal::Land));
            assert_eq!(again.pilot.cruise_m_s, 1.1);
            // Set back, it stays set: the configuration may say something else tomorrow.
            again.at_goal = AtGoal::Hold;
        });
        assert_eq!(text, "[parameters]\nGD_AT_GOAL = 0.0\nGD_SPEED_LIM = 0.7\n");
    }

    #[test]
    fn a_take_over_is_in_force_after_a_restart_until_an_operator_engaged() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("firmware0.toml");
        let run_until = |taken_over: bool| {
            let mut begun_with = false;
            run(folder.path(), &mut FirmwareConfig::default(), |config| {
                begun_with = config.stack().guidance.taken_over;
                config.state.taken_over = taken_over;
            });
            begun_with
        };
        assert!(!run_until(false) && !path.exists(), "nothing to keep");
        assert!(!run_until(true));
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "taken_over = true\n");
        assert!(run_until(true), "the next start knows");
        assert!(run_until(false), "engaged by an operator in this one");
        assert!(!run_until(false));
        assert!(start(b"taken_over = 1").unwrap_err().contains("firmware0.toml"));
    }

    #[test]
    fn who_wanted_to_be_left_alone_is_guarded_again_after_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("firmware0.toml"), "[parameters]\nGD_DUTY = 0.0\n").unwrap();
        let mut config = FirmwareConfig {
            duty: Duty::FlyAround,
            ..FirmwareConfig::default()
        };
        ParameterStore::load(folder.path(), &mut config).unwrap();
        assert_eq!(config.duty, Duty::FlyAround);
    }

    #[test]
    fn the_detectors_parameters_are_kept_while_it_is_off() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("firmware0.toml"), "[parameters]\nDT_THRESH = 0.4\n").unwrap();
        let text = run(folder.path(), &mut FirmwareConfig::default(), |config| {
            assert_eq!(config.detector.threshold, Some(0.4));
            config.limits.goal_radius_m = 2.5;
        });
        assert_eq!(text, "[parameters]\nDT_THRESH = 0.4\nGD_GOAL_RAD = 2.5\n");
    }

    #[test]
    fn a_file_with_wrong_types_names_or_values_or_a_damaged_one_is_refused_by_name_and_kept() {
        for (text, reason) in [
            ("[parameters]\nGD_SPEED_LIM = \"fast\"", "line 2"),
            ("[parameters]\nGD_AT_GOAL = true", "GD_AT_GOAL"),
            ("parameters = 5", "line 1"),
            ("[colours]\nsky = 1", "colours"),
            ("[parameters]\nGD_SPEED", "line 2"),
            ("[parameters]\nGD_AT_GOAL = 0.5", "whole numbers"),
            (
                "[parameters]\nGD_SPEED_LIM = 99.0",
                "line 2: GD_SPEED_LIM = 99: allowed: 0.1 to 3",
            ),
            ("[parameters]\nGD_SPEED_LIM = nan", "allowed: 0.1 to 3"),
            ("[parameters]\nGD_SPEED_LIM = 1e300", "allowed: 0.1 to 3"),
            ("[parameters]\nMPC_XY_CRUISE = 1.0", "no parameter of that name"),
        ] {
            let error = start(text.as_bytes()).unwrap_err();
            assert!(error.contains("firmware0.toml: mend or delete it"), "{error}");
            assert!(error.contains(reason), "{text}: {error}");
        }
        assert!(
            start(b"[parameters]\nGD_SPEED_LIM = 0.\xFF")
                .unwrap_err()
                .contains("firmware0.toml")
        );
        assert_eq!(
            start(b"[parameters]\nGD_SPEED_LIM = 0.1").unwrap().limits.speed_m_s,
            0.1
        );
    }
}
