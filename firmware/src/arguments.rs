//! Command-line arguments that stand for rows of the table of parameters: their help, and what they accept.

use crate::config::FirmwareConfig;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::str::FromStr;
use vigil_types::parameters::{self, Kind, ParameterSpec, Preset};
use vigil_types::{Ablation, AlarmPolicy, Choice, PilotKind};

/// The help of an argument: the row's text, what is accepted and the default.
pub fn help(row: &ParameterSpec) -> String {
    let mut text = row.text.to_owned();
    if let Some(first) = text.get(..1) {
        text.replace_range(..1, &first.to_uppercase());
    }
    if let Kind::Real(range) | Kind::Whole(range) = row.kind
        && range.greatest < f64::from(u32::MAX)
    {
        text += &format!(" ({range})");
    }
    match (row.default, row.kind) {
        (Preset::Number(value), _) => text += &format!(" [default: {value}]"),
        (Preset::Switch(on), _) => text += if on { " [default: on]" } else { " [default: off]" },
        (Preset::Choice(place), Kind::Choice(words)) => {
            text += &words
                .get(place)
                .map_or_else(String::new, |(word, _)| format!(" [default: {word}]"));
        }
        _ => {}
    }
    text
}

/// Takes the names of a choice.
pub fn choice<T: Choice + Send + Sync>() -> impl TypedValueParser<Value = T> {
    let values = T::WORDS
        .iter()
        .map(|(name, text)| PossibleValue::new(*name).help(*text));
    PossibleValuesParser::new(values).try_map(|name| T::from_name(&name).ok_or("there is no such choice"))
}

/// Takes the numbers that a row accepts.
pub fn number<T>(row: &'static ParameterSpec) -> impl Fn(&str) -> Result<T, String> + Clone + Send + Sync + 'static
where
    T: FromStr + Copy + Into<f64>,
{
    move |text| match (text.parse::<T>(), row.range()) {
        (Ok(value), Some(range)) if range.contains(value.into()) => Ok(value),
        (_, range) => Err(format!(
            "give {}",
            range.map_or_else(String::new, |range| range.to_string())
        )),
    }
}

/// Takes `on` or `off`.
///
/// # Errors
/// Anything else, with what is allowed.
pub fn parse_switch(text: &str) -> Result<bool, String> {
    match text {
        "on" => Ok(true),
        "off" => Ok(false),
        _ => Err("give on or off".to_owned()),
    }
}

/// Takes `COUNT/WINDOW`: so many attack verdicts of so many.
fn parse_raise(text: &str) -> Result<(u8, u8), String> {
    let parsed = text
        .split_once('/')
        .and_then(|(count, window)| Some((count.parse().ok()?, window.parse().ok()?)));
    let within = |row: &ParameterSpec, value: u8| row.check(value.into()).is_ok();
    match parsed {
        Some((count, window))
            if within(&parameters::RAISE_WINDOW, window)
                && within(&parameters::RAISE_COUNT, count)
                && count <= window =>
        {
            Ok((count, window))
        }
        _ => Err("give COUNT/WINDOW, 1 to 32 each and the count not above the window, for example 5/6".to_owned()),
    }
}

/// Who decides, and what watches: the arguments that every command has that flies.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct PilotArgs {
    #[arg(long, value_parser = choice::<PilotKind>(), help = help(&parameters::PILOT))]
    pilot: Option<PilotKind>,

    #[arg(long, value_name = "FILE", help = help(&parameters::ACTOR_FILE))]
    actor: Option<PathBuf>,

    #[arg(long, value_name = "on|off", value_parser = parse_switch, help = help(&parameters::APF))]
    apf: Option<bool>,

    #[arg(long, value_parser = choice::<Ablation>(), help = help(&parameters::ABLATE))]
    ablate: Option<Ablation>,

    #[arg(long, value_name = "M/S", value_parser = number::<f32>(&parameters::SPEED_LIMIT), help = help(&parameters::SPEED_LIMIT))]
    speed_limit: Option<f32>,

    #[arg(long, value_name = "on|off", value_parser = parse_switch, help = help(&parameters::DETECTOR))]
    detector: Option<bool>,

    #[arg(long, value_name = "FILE", help = help(&parameters::DETECTOR_FILE))]
    detector_file: Option<PathBuf>,

    #[arg(long, value_name = "SCORE", value_parser = number::<f32>(&parameters::THRESHOLD), help = help(&parameters::THRESHOLD))]
    threshold: Option<f32>,

    /// Raise the alarm when COUNT of the last WINDOW verdicts are attack [default: as in docs/guidance.md].
    #[arg(long, value_name = "COUNT/WINDOW", value_parser = parse_raise)]
    raise: Option<(u8, u8)>,

    #[arg(long, value_name = "on|off", value_parser = parse_switch, help = help(&parameters::GUARD))]
    guard: Option<bool>,

    #[arg(long, value_parser = choice::<AlarmPolicy>(), help = help(&parameters::ALARM))]
    alarm: Option<AlarmPolicy>,

    #[arg(long, value_name = "on|off", value_parser = parse_switch, help = help(&parameters::PLAUSIBILITY))]
    plausibility: Option<bool>,

    #[arg(long, value_name = "on|off", value_parser = parse_switch, help = help(&parameters::SECOND_SENSOR))]
    second_sensor: Option<bool>,
}

impl PilotArgs {
    /// Sets what was given.
    pub fn apply(&self, config: &mut FirmwareConfig) {
        config.pilot.kind = self.pilot.unwrap_or(config.pilot.kind);
        config.pilot.actor_file = self.actor.clone().or(config.pilot.actor_file.take());
        config.pilot.apf = self.apf.unwrap_or(config.pilot.apf);
        config.pilot.ablate = self.ablate.unwrap_or(config.pilot.ablate);
        config.limits.speed_m_s = self.speed_limit.unwrap_or(config.limits.speed_m_s);
        config.detector.enabled = self.detector.or(config.detector.enabled);
        config.detector.file = self.detector_file.clone().or(config.detector.file.take());
        config.detector.threshold = self.threshold.or(config.detector.threshold);
        if let Some((count, window)) = self.raise {
            (config.detector.raise_count, config.detector.raise_window) = (count, window);
        }
        config.detector.guard = self.guard.or(config.detector.guard);
        config.detector.alarm = self.alarm.unwrap_or(config.detector.alarm);
        config.plausibility = self.plausibility.unwrap_or(config.plausibility);
        config.second_sensor = self.second_sensor.unwrap_or(config.second_sensor);
    }

    /// The actor's file, if one was given.
    pub fn actor_file(&self) -> Option<&Path> {
        self.actor.as_deref()
    }

    /// Asks for the second sensor that the vehicle has, if nothing was said of it.
    pub fn with_second_sensor(&self) -> Self {
        Self {
            second_sensor: self.second_sensor.or(Some(true)),
            ..self.clone()
        }
    }

    /// Hands on to a `firmware` process what was given.
    pub fn hand_on(&self, command: &mut Command) {
        let mut hand = |name: &str, value: Option<String>| {
            if let Some(value) = value {
                command.args([name, &value]);
            }
        };
        let switch = |on: bool| if on { "on" } else { "off" }.to_owned();
        hand("--pilot", self.pilot.map(|kind| kind.name().to_owned()));
        hand("--apf", self.apf.map(switch));
        hand("--ablate", self.ablate.map(|what| what.name().to_owned()));
        hand("--speed-limit", self.speed_limit.map(|limit| limit.to_string()));
        hand("--detector", self.detector.map(switch));
        hand("--threshold", self.threshold.map(|score| score.to_string()));
        hand("--raise", self.raise.map(|(count, window)| format!("{count}/{window}")));
        hand("--guard", self.guard.map(switch));
        hand("--alarm", self.alarm.map(|policy| policy.name().to_owned()));
        hand("--plausibility", self.plausibility.map(switch));
        hand("--second-sensor", self.second_sensor.map(switch));
        for (name, file) in [("--actor", &self.actor), ("--detector-file", &self.detector_file)] {
            if let Some(file) = file {
                command.arg(name).arg(file);
            }
        }
    }
}
