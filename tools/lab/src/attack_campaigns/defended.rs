//! What the detector is worth: the same flights attacked and not, undefended, with the stop alone, with recovery.
//!
//! Each flight is a line of `defended.jsonl` as soon as it has ended, so a campaign of hours loses at most the flights in the air, and
//! `--resume` flies what is missing.

use super::{Common, Seeds, Strength, write_json};
use crate::campaign::flights::{Campaign, Existing, Jobs};
use crate::campaign::{self, Flight, Tally};
use crate::cli::detector::detector_of;
use crate::report::{TextTable, decimals, numbers, to_csv, words};
use anyhow::{Context, Result, ensure};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::num::NonZeroU8;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use vigil_adversary::{Attack, AttackArgs, AttackConfig, Burst, Method, Towards};
use vigil_detector::FrozenDetector;
use vigil_firmware::FirmwareConfig;
use vigil_firmware::arguments::parse_switch;
use vigil_sim::world::Outcome;
use vigil_tools::cli::output::{self, say};
use vigil_types::{AlarmPolicy, STEP_S, named};

/// Arguments of `vigil attack defended`.
#[derive(Debug, Clone, clap::Args)]
pub struct DefendedArgs {
    /// Flights of each arm, on the same courses in all arms.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..))]
    flights: u64,

    #[command(flatten)]
    seeds: Seeds,

    /// Arms to fly.
    #[arg(
        long,
        value_enum,
        value_delimiter = ',',
        default_value = "none,none-watched,undefended,stop,recover"
    )]
    arms: Vec<Arm>,

    /// The attack.
    #[arg(long, value_enum, value_name = "METHOD", default_value_t = Method::BimAccumulating)]
    attack: Method,

    /// Steps attacked, once in a flight at a moment drawn from its seed, or `continuous`.
    #[arg(long, value_name = "STEPS|continuous", default_value = "100")]
    burst: Burst,

    /// The yaw limit aimed at.
    #[arg(long, value_enum, default_value_t = Towards::Away)]
    towards: Towards,

    #[command(flatten)]
    strength: Strength,

    /// Adaptive: deceive this detector as well.
    #[arg(long, value_name = "FILE")]
    evade: Option<PathBuf>,

    /// Pixels of squares of this side move together, so that what shows one surface goes on showing one.
    #[arg(long, value_name = "PIXELS", default_value_t = AttackConfig::PAPER.region_pixels)]
    region: u32,

    /// Adaptive: stay within what the guard lets pass as well.
    #[arg(long)]
    evade_guard: bool,

    /// Adaptive: leave what lies within so many degrees of the nose as it is, where a second sensor looks.
    #[arg(long, value_name = "DEGREES", default_value_t = 0.0)]
    truthful_ahead: f32,

    /// The detector that judges the actor [default: the one built in].
    #[arg(long, value_name = "FILE")]
    detector: Option<PathBuf>,

    /// Add the potential field to the actor.
    #[arg(long)]
    apf: bool,

    /// Whether the recovery pilot raises the alarm as well when the actor is about to fly into something.
    #[arg(long, value_name = "on|off", value_parser = parse_switch, default_value = "on", action = clap::ArgAction::Set)]
    guard: bool,

    /// So many small sensors of 45° each, side by side, must see nothing nearer than the frames show (docs/second-sensor.md).
    #[arg(long, value_name = "COUNT", default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..=5))]
    second_sensor_heads: u8,

    #[command(flatten)]
    common: Common,
}

named! {
    /// Who flies against what.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize, clap::ValueEnum)]
    #[serde(rename_all = "kebab-case")]
    pub enum Arm {
        /// Not attacked, no detector.
        #[default]
        None => "none",
        /// Not attacked, detector and recovery on: what do they cost?
        NoneWatched => "none-watched",
        /// Attacked, no detector.
        Undefended => "undefended",
        /// Attacked; an alarm stops the vehicle.
        Stop => "stop",
        /// Attacked; an alarm stops the vehicle, then the recovery pilot flies on.
        Recover => "recover",
    }
}

impl Arm {
    fn attacked(self) -> bool {
        !matches!(self, Self::None | Self::NoneWatched)
    }

    fn alarm(self) -> Option<AlarmPolicy> {
        match self {
            Self::None | Self::Undefended => None,
            Self::Stop => Some(AlarmPolicy::Stop),
            Self::NoneWatched | Self::Recover => Some(AlarmPolicy::Recover),
        }
    }
}

/// What every flight of a campaign has in common.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Settings {
    version: String,
    actor_sha256: String,
    detector_sha256: String,
    /// Verdicts that raise the alarm, and of how many.
    raise: (u8, u8),
    guard: bool,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    second_sensor_heads: Option<NonZeroU8>,
    apf: bool,
    attack: AttackConfig,
    burst: Burst,
    /// Digest of the detector that the attacker deceives as well.
    #[serde(skip_serializing_if = "Option::is_none")]
    evades_sha256: Option<String>,
    /// Whether the attacker stays within what the guard lets pass.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    evades_guard: bool,
}

/// A flight: a line of `defended.csv`.
#[derive(Debug, Clone, Default, Serialize)]
struct Line {
    arm: Arm,
    seed: u64,
    /// Its name, and `none` for a vehicle that never took off.
    outcome: &'static str,
    #[serde(serialize_with = "decimals::<2, _, _>")]
    flight_time_s: f64,
    /// Of the vehicle's middle.
    #[serde(serialize_with = "decimals::<2, _, _>")]
    closest_obstacle_m: f32,
    attacked_steps: u64,
    effective_steps: u64,
    judged_steps: u64,
    alarms: u64,
    /// Alarms of these that the guard raised, not the verdict.
    guard_alarms: u64,
    /// Of these because the actor went astray.
    astray_alarms: u64,
    /// Of these because it disagreed with the planner.
    disagreement_alarms: u64,
    first_alarm_step: Option<u64>,
    stop_steps: u64,
    recovery_steps: u64,
}

impl Line {
    fn of(arm: Arm, flight: &Flight) -> Self {
        let attack = flight.attack.unwrap_or_default();
        let watch = flight.watch.clone().unwrap_or_default();
        Self {
            arm,
            seed: flight.seed,
            outcome: flight.record.outcome.map_or("none", Outcome::name),
            flight_time_s: flight.record.flight_time_s,
            closest_obstacle_m: flight.record.closest_obstacle_m,
            attacked_steps: attack.attacked_steps,
            effective_steps: attack.effective_steps,
            judged_steps: watch.judged_steps,
            alarms: watch.alarms,
            guard_alarms: watch.guard_alarms,
            astray_alarms: watch.astray_alarms,
            disagreement_alarms: watch.disagreement_alarms,
            first_alarm_step: watch.first_alarm_step,
            stop_steps: watch.stop_steps,
            recovery_steps: watch.recovery_steps,
        }
    }

    fn is_success(&self) -> bool {
        self.outcome == Outcome::Success.name()
    }
}

/// What an arm came to.
#[derive(Serialize)]
struct Row {
    arm: Arm,
    #[serde(flatten)]
    tally: Tally,
    attacked_steps: u64,
    effective_steps: u64,
    /// Flights with an alarm, alarms, and alarms per hour of monitored flight.
    alarmed_flights: usize,
    alarms: u64,
    guard_alarms: u64,
    astray_alarms: u64,
    disagreement_alarms: u64,
    alarms_per_hour: f64,
    stopping_share: f64,
    recovering_share: f64,
    failed_seeds: Vec<u64>,
}

impl Row {
    fn of<'a>(arm: Arm, lines: impl Iterator<Item = &'a Line>) -> Option<Self> {
        let lines: Vec<&Line> = lines.filter(|line| line.arm == arm).collect();
        let outcomes: Vec<_> = lines.iter().map(|line| Outcome::from_name(line.outcome)).collect();
        let sum = |of: fn(&Line) -> u64| lines.iter().map(|line| of(line)).sum::<u64>();
        let monitored = sum(|l| l.judged_steps).max(1) as f64;
        let alarms = sum(|l| l.alarms);
        (!lines.is_empty()).then(|| Self {
            arm,
            tally: Tally::of(&outcomes),
            attacked_steps: sum(|l| l.attacked_steps),
            effective_steps: sum(|l| l.effective_steps),
            alarmed_flights: lines.iter().filter(|l| l.alarms > 0).count(),
            alarms,
            guard_alarms: sum(|l| l.guard_alarms),
            astray_alarms: sum(|l| l.astray_alarms),
            disagreement_alarms: sum(|l| l.disagreement_alarms),
            alarms_per_hour: alarms as f64 / (monitored * f64::from(STEP_S) / 3600.0),
            stopping_share: sum(|l| l.stop_steps) as f64 / monitored,
            recovering_share: sum(|l| l.recovery_steps) as f64 / monitored,
            failed_seeds: lines.iter().filter(|l| !l.is_success()).map(|l| l.seed).collect(),
        })
    }

    fn table(rows: &[Self]) -> TextTable {
        let names = [words("arm"), numbers("flights")].into_iter().chain(Tally::columns());
        let mut table = TextTable::new(names.chain([words("yaw moved ≥ 1.0"), words("alarms")]));
        for row in rows {
            let name = [row.arm.name().to_owned(), row.tally.flights.to_string()];
            let effective = campaign::effective_share(row.attacked_steps, row.effective_steps);
            let cells = name.into_iter().chain(row.tally.cells());
            table.row(cells.chain([effective, row.alarms_in_words()]));
        }
        table
    }

    fn alarms_in_words(&self) -> String {
        if self.arm.alarm().is_none() {
            return "—".to_owned();
        }
        format!(
            "{} ({} by the guard: {} led astray, {} disagreements) in {} flights, {:.1} per hour; stopping {:.1} %, recovering {:.1} % of the time",
            self.alarms,
            self.guard_alarms,
            self.astray_alarms,
            self.disagreement_alarms,
            self.alarmed_flights,
            self.alarms_per_hour,
            100.0 * self.stopping_share,
            100.0 * self.recovering_share
        )
    }
}

/// Of the courses flown in both arms: those that only the second completed, and those that only the first did.
#[derive(Debug, PartialEq, Serialize)]
struct Pair {
    without: Arm,
    with: Arm,
    flights: usize,
    won: usize,
    lost: usize,
}

fn pair(lines: &BTreeMap<(u64, Arm), Line>, without: Arm, with: Arm) -> Option<Pair> {
    let (mut flights, mut won, mut lost) = (0, 0, 0);
    for line in lines.values().filter(|line| line.arm == with) {
        if let Some(other) = lines.get(&(line.seed, without)) {
            flights += 1;
            won += usize::from(line.is_success() && !other.is_success());
            lost += usize::from(!line.is_success() && other.is_success());
        }
    }
    (flights > 0).then_some(Pair {
        without,
        with,
        flights,
        won,
        lost,
    })
}

#[derive(Serialize)]
struct Report<'a> {
    settings: &'a Settings,
    first_seed: u64,
    rows: Vec<Row>,
    pairs: Vec<Pair>,
}

/// Flies what is missing, prints and writes the table.
///
/// # Errors
/// A file that is no actor or no detector, a folder that cannot be written, flights of another campaign there.
pub fn run(args: &DefendedArgs) -> Result<ExitCode> {
    let folder = args.common.folder()?;
    let attack = AttackArgs {
        attack: Some(args.attack),
        epsilon: args.strength.epsilon,
        iterations: args.strength.iterations,
        burst: args.burst,
        towards: args.towards,
        attack_actor: None,
        evade: args.evade.clone(),
        region: args.region,
        evade_guard: args.evade_guard,
        truthful_ahead: args.truthful_ahead,
    };
    let attack = attack
        .attack(args.common.actor.as_deref())?
        .context("an attack was asked for")?;
    let detector = FirmwareConfig::default().detector;
    let arms: Vec<Arm> = Arm::ALL.into_iter().filter(|arm| args.arms.contains(arm)).collect();
    let (actor_sha256, file) = (args.common.pilot()?.sha256(), args.detector.as_deref());
    let frozen = match arms.iter().any(|arm| arm.alarm().is_some()) {
        true => detector_of(&actor_sha256, file)?,
        false => file.map_or_else(FrozenDetector::built_in, FrozenDetector::load)?,
    };
    let settings = Settings {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        actor_sha256,
        detector_sha256: frozen.sha256(),
        raise: (detector.raise_count, detector.raise_window),
        guard: args.guard,
        second_sensor_heads: NonZeroU8::new(args.second_sensor_heads),
        apf: args.apf,
        attack: attack.config,
        burst: attack.burst,
        evades_sha256: attack.evade.as_ref().map(FrozenDetector::sha256),
        evades_guard: args.evade_guard,
    };
    let jobs = Jobs {
        first_seed: args.seeds.seed,
        flights: args.flights,
        arms: arms.iter().map(|arm| arm.name().to_owned()).collect(),
    };
    let lines = folder.join("defended.jsonl");
    let table = lines.with_extension("csv");
    ensure!(
        lines.exists() || !table.exists(),
        "{} holds a campaign of an earlier version; name another folder with --output",
        table.display()
    );
    let existing = match args.seeds.resume {
        true => Existing::Resume,
        false => Existing::Refuse,
    };
    let mut campaign = Campaign::new(COMMAND, settings, jobs.clone())?.keep_in(&lines, existing)?;
    let interrupt = campaign.fly(&jobs, &args.common.pool()?, |seed, arm, _| {
        fly(args, arms[arm], &attack, seed)
    })?;
    report(&campaign, &lines.with_extension("json"))?;
    Ok(interrupt.exit_code())
}

/// What lines call this command.
pub const COMMAND: &str = "attack defended";

/// Makes one table of the flights in several files.
pub fn merge(files: &[PathBuf], json: &Path) -> Result<()> {
    report(&Campaign::load(files, json)?, json)
}

/// Prints and writes the tables.
fn report(campaign: &Campaign<Settings, Flight>, json: &Path) -> Result<()> {
    let (settings, first_seed) = (campaign.settings(), campaign.jobs().first_seed);
    let lines = campaign.flights().map(|(arm, flight)| {
        let arm = Arm::from_name(arm).with_context(|| format!("there is no arm {arm}"))?;
        Ok(((flight.seed, arm), Line::of(arm, flight)))
    });
    let lines: BTreeMap<(u64, Arm), Line> = lines.collect::<Result<_>>()?;
    say!(
        "{}, ε = {}/255, {} iterations, {}, burst {}, field {}; validation courses from seed {}, the same in every arm",
        settings.attack.method.name(),
        settings.attack.epsilon_255,
        settings.attack.iterations,
        settings.attack.towards.name(),
        settings.burst,
        if settings.apf { "on" } else { "off" },
        first_seed
    );
    let row = |arm| Row::of(arm, lines.values());
    let rows: Vec<Row> = Arm::ALL.into_iter().filter_map(row).collect();
    say!("{}", Row::table(&rows));
    let pairs: Vec<Pair> = [
        (Arm::None, Arm::NoneWatched),
        (Arm::Undefended, Arm::Stop),
        (Arm::Undefended, Arm::Recover),
    ]
    .into_iter()
    .filter_map(|(without, with)| pair(&lines, without, with))
    .inspect(|p| {
        let ([with, without], Pair { flights, won, lost, .. }) = ([p.with, p.without].map(Arm::name), p);
        say!("{with} against {without}: of {flights} courses {won} completed only with, {lost} only without");
    })
    .collect();
    campaign.is_interrupted();
    if output::is_file(json) {
        let table = json.with_extension("csv");
        let text = format!("# {}\n{}", serde_json::to_string(settings)?, to_csv(lines.values()));
        output::write(&table, text)?;
        say!("flights   {}", table.display());
    }
    let report = Report {
        settings,
        first_seed,
        rows,
        pairs,
    };
    write_json(json, &report)
}

fn fly(args: &DefendedArgs, arm: Arm, attack: &Attack, seed: u64) -> Result<Flight> {
    let (mut config, mut firmware) = campaign::actor_flight(args.common.actor.as_deref(), args.apf, seed);
    firmware.detector.enabled = Some(arm.alarm().is_some());
    firmware.detector.file.clone_from(&args.detector);
    firmware.detector.guard = (!args.guard).then_some(false);
    // Part of what defends: the undefended fly without.
    config.second_sensor_heads = args.second_sensor_heads.into();
    firmware.second_sensor = args.second_sensor_heads > 0 && arm.alarm().is_some();
    firmware.detector.alarm = arm.alarm().unwrap_or(firmware.detector.alarm);
    campaign::fly(&config, &firmware, arm.attacked().then_some(attack))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(arm: Arm, seed: u64, outcome: Outcome) -> Line {
        Line {
            arm,
            seed,
            outcome: outcome.name(),
            judged_steps: 418,
            alarms: 1,
            ..Line::default()
        }
    }

    #[test]
    fn arms_are_compared_on_the_courses_that_both_flew() {
        let flown = [
            line(Arm::Undefended, 1, Outcome::Collision),
            line(Arm::Recover, 1, Outcome::Success),
            line(Arm::Undefended, 2, Outcome::Success),
            line(Arm::Recover, 2, Outcome::TimeOut),
            line(Arm::Undefended, 3, Outcome::TimeOut),
            line(Arm::Recover, 3, Outcome::Success),
            line(Arm::Recover, 4, Outcome::Success),
        ];
        let lines: BTreeMap<_, _> = flown.iter().map(|l| ((l.seed, l.arm), l.clone())).collect();
        let pair = pair(&lines, Arm::Undefended, Arm::Recover).unwrap();
        assert_eq!((pair.flights, pair.won, pair.lost), (3, 2, 1));
        let row = Row::of(Arm::Recover, lines.values()).unwrap();
        assert_eq!((row.tally.flights, row.tally.completed, row.tally.time_outs), (4, 3, 1));
        assert_eq!(row.failed_seeds, [2]);
        // Four alarms in 4 · 418 steps of 0.05 s.
        assert!((row.alarms_per_hour - 4.0 / (4.0 * 418.0 * 0.05 / 3600.0)).abs() < 1e-3);
        assert!(Row::of(Arm::Stop, lines.values()).is_none());
    }
}
