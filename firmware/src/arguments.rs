//! Command-line arguments that stand for rows of the table of parameters: their help, and what they accept.

use crate::config::FirmwareConfig;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use std::ffi::OsString;
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

/// `NAME: TYPE => SET, TEXT;` for each argument: where the configuration has its value, and how it is handed on.
macro_rules! pilot_args {
    ($($(#[$meta:meta])* $field:ident: $type:ty => $set:expr, $text:expr;)+) => {
        /// Who decides, and what watches: the arguments that every command has that flies.
        #[derive(Debug, Clone, Default, clap::Args)]
        pub struct PilotArgs {
            $($(#[$meta])* $field: Option<$type>,)+
        }

        impl PilotArgs {
            /// Sets what was given.
            pub fn apply(&self, config: &mut FirmwareConfig) {
                $(if let Some(value) = &self.$field {
                    let set: fn(&mut FirmwareConfig, &$type) = $set;
                    set(config, value);
                })+
            }

            /// Hands on to a `firmware` process what was given.
            pub fn hand_on(&self, command: &mut Command) {
                $(if let Some(value) = &self.$field {
                    let text: fn(&$type) -> OsString = $text;
                    command.arg(format!("--{}", stringify!($field).replace('_', "-"))).arg(text(value));
                })+
            }
        }
    };
}

pilot_args! {
    #[arg(long, value_parser = choice::<PilotKind>(), help = help(&parameters::PILOT))]
    pilot: PilotKind => |config, &kind| config.pilot.kind = kind, |kind| kind.name().into();
    #[arg(long, value_name = "FILE", help = help(&parameters::ACTOR_FILE))]
    actor: PathBuf => |config, path| config.pilot.actor_file = Some(path.clone()), |path| path.into();
    #[arg(long, value_name = "on|off", value_parser = parse_switch, help = help(&parameters::APF))]
    apf: bool => |config, &on| config.pilot.apf = on, switch;
    #[arg(long, value_parser = choice::<Ablation>(), help = help(&parameters::ABLATE))]
    ablate: Ablation => |config, &what| config.pilot.ablate = what, |what| what.name().into();
    #[arg(long, value_name = "M/S", value_parser = number::<f32>(&parameters::SPEED_LIMIT), help = help(&parameters::SPEED_LIMIT))]
    speed_limit: f32 => |config, &limit| config.limits.speed_m_s = limit, |limit| limit.to_string().into();
    #[arg(long, value_name = "on|off", value_parser = parse_switch, help = help(&parameters::DETECTOR))]
    detector: bool => |config, &on| config.detector.enabled = Some(on), switch;
    #[arg(long, value_name = "FILE", help = help(&parameters::DETECTOR_FILE))]
    detector_file: PathBuf => |config, path| config.detector.file = Some(path.clone()), |path| path.into();
    #[arg(long, value_name = "SCORE", value_parser = number::<f32>(&parameters::THRESHOLD), help = help(&parameters::THRESHOLD))]
    threshold: f32 => |config, &score| config.detector.threshold = Some(score), |score| score.to_string().into();
    /// Raise the alarm when COUNT of the last WINDOW verdicts are attack [default: as in docs/guidance.md].
    #[arg(long, value_name = "COUNT/WINDOW", value_parser = parse_raise)]
    raise: (u8, u8) => |config, &of| (config.detector.raise_count, config.detector.raise_window) = of,
        |(count, window)| format!("{count}/{window}").into();
    #[arg(long, value_name = "on|off", value_parser = parse_switch, help = help(&parameters::GUARD))]
    guard: bool => |config, &on| config.detector.guard = Some(on), switch;
    #[arg(long, value_parser = choice::<AlarmPolicy>(), help = help(&parameters::ALARM))]
    alarm: AlarmPolicy => |config, &policy| config.detector.alarm = policy, |policy| policy.name().into();
    #[arg(long, value_name = "on|off", value_parser = parse_switch, help = help(&parameters::PLAUSIBILITY))]
    plausibility: bool => |config, &on| config.plausibility = on, switch;
    #[arg(long, value_name = "on|off", value_parser = parse_switch, help = help(&parameters::SECOND_SENSOR))]
    second_sensor: bool => |config, &on| config.second_sensor = on, switch;
}

fn switch(on: &bool) -> OsString {
    if *on { "on" } else { "off" }.into()
}

impl PilotArgs {
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
}
