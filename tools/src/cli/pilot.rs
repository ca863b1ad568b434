//! Which pilot flies: the arguments that `vigil fly` and `vigil evaluate` share.

use std::path::{Path, PathBuf};
use std::process::Command;
use vigil_firmware::FirmwareConfig;
use vigil_firmware::config::{AlarmChoice, PilotKind};
use vigil_firmware::program::{parse_raise, parse_switch, parse_threshold};

/// Who decides.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct PilotArgs {
    /// Who decides [default: actor].
    #[arg(long, value_enum)]
    pilot: Option<PilotKind>,

    /// The frozen actor to fly [default: the one built in].
    #[arg(long, value_name = "FILE")]
    actor: Option<PathBuf>,

    /// Whether the potential field is added to the actor's action [default: on].
    #[arg(long, value_name = "on|off", value_parser = parse_switch)]
    apf: Option<bool>,

    /// Whether a detector watches the actor [default: on, where the actor flies].
    #[arg(long, value_name = "on|off", value_parser = parse_switch)]
    detector: Option<bool>,

    /// The frozen detector [default: the one built in].
    #[arg(long, value_name = "FILE")]
    detector_file: Option<PathBuf>,

    /// Score above which a verdict is attack, 0.01 to 0.999 [default: the detector's own].
    #[arg(long, value_name = "SCORE", value_parser = parse_threshold)]
    threshold: Option<f32>,

    /// Raise the alarm when COUNT of the last WINDOW verdicts are attack [default: as in docs/guidance.md].
    #[arg(long, value_name = "COUNT/WINDOW", value_parser = parse_raise)]
    raise: Option<(u8, u8)>,

    /// Whether the recovery pilot raises the alarm as well when the actor is about to fly into something [default: on, with the
    /// detector].
    #[arg(long, value_name = "on|off", value_parser = parse_switch)]
    guard: Option<bool>,

    /// What an alarm brings about [default: recover].
    #[arg(long, value_enum)]
    alarm: Option<AlarmChoice>,

    /// Whether frames are judged before the pilots see them, so that a sensor that is dead, frozen or wrong holds the flight
    /// [default: on].
    #[arg(long, value_name = "on|off", value_parser = parse_switch)]
    plausibility: Option<bool>,
}

impl PilotArgs {
    /// Sets what was given.
    pub fn apply(&self, config: &mut FirmwareConfig) {
        config.pilot.kind = self.pilot.unwrap_or(config.pilot.kind);
        config.pilot.actor_file = self.actor.clone().or(config.pilot.actor_file.take());
        config.pilot.apf = self.apf.unwrap_or(config.pilot.apf);
        config.detector.enabled = self.detector.or(config.detector.enabled);
        config.detector.file = self.detector_file.clone().or(config.detector.file.take());
        config.detector.threshold = self.threshold.or(config.detector.threshold);
        if let Some((count, window)) = self.raise {
            (config.detector.raise_count, config.detector.raise_window) = (count, window);
        }
        config.detector.guard = self.guard.unwrap_or(config.detector.guard);
        config.detector.alarm = self.alarm.unwrap_or(config.detector.alarm);
        config.plausibility = self.plausibility.unwrap_or(config.plausibility);
    }

    /// The actor's file, if one was given.
    pub fn actor_file(&self) -> Option<&Path> {
        self.actor.as_deref()
    }

    /// Hands on to a `firmware` process what was given.
    pub fn hand_on(&self, command: &mut Command) {
        if let Some(pilot) = self.pilot {
            command.args(["--pilot", pilot.name()]);
        }
        if let Some(detector) = self.detector {
            command.args(["--detector", if detector { "on" } else { "off" }]);
        }
        if let Some(file) = &self.actor {
            command.arg("--actor").arg(file);
        }
        if let Some(apf) = self.apf {
            command.args(["--apf", if apf { "on" } else { "off" }]);
        }
        if let Some(file) = &self.detector_file {
            command.arg("--detector-file").arg(file);
        }
        if let Some(threshold) = self.threshold {
            command.args(["--threshold", &threshold.to_string()]);
        }
        if let Some((count, window)) = self.raise {
            command.args(["--raise", &format!("{count}/{window}")]);
        }
        if let Some(guard) = self.guard {
            command.args(["--guard", if guard { "on" } else { "off" }]);
        }
        if let Some(alarm) = self.alarm {
            command.args(["--alarm", alarm.name()]);
        }
        if let Some(plausibility) = self.plausibility {
            command.args(["--plausibility", if plausibility { "on" } else { "off" }]);
        }
    }
}
