//! What the detector is worth: the same flights attacked and not, undefended, with the stop alone, with recovery.
//!
//! Each flight is a line of `defended.csv` as soon as it has ended, so a campaign of hours loses at most the flights in the air, and
//! `--resume` flies what is missing.

use super::{Common, write_json};
use crate::campaign::part::{self, Part, Shard, Unit};
use crate::campaign::{self, Flown, Tally};
use crate::cli::output::{self, Interrupt, Progress, say};
use crate::report::{TextTable, csv_line, decimals, from_csv, numbers, words};
use anyhow::{Context, Result, bail, ensure};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Mutex;
use vigil_adversary::{Attack, AttackArgs};
use vigil_adversary::{AttackConfig, Burst, Method, Towards};
use vigil_detector::FrozenDetector;
use vigil_firmware::FirmwareConfig;
use vigil_firmware::arguments::parse_switch;
use vigil_types::AlarmPolicy;
use vigil_types::STEP_S;
use vigil_world::Outcome;

/// Arguments of `vigil attack defended`.
#[derive(Debug, Clone, clap::Args)]
pub struct DefendedArgs {
    /// Flights of each arm, on the same courses in all arms.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..))]
    flights: u64,

    /// Seed of the first validation course.
    #[arg(long, default_value_t = 5000)]
    seed: u64,

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

    /// ε in 1/255 of the image's range.
    #[arg(long, default_value_t = 1.0)]
    epsilon: f32,

    /// Iterations.
    #[arg(long, default_value_t = 20)]
    iterations: u32,

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

    /// Fly only what the folder's defended.csv does not have yet, once Ctrl-C or a kill ended an earlier run.
    #[arg(long, conflicts_with = "shard")]
    resume: bool,

    /// Fly part K of N only and leave it in the folder as defended.K-of-N.part.json; `vigil merge` makes the whole of all parts.
    /// A part that is there already is gone on with.
    #[arg(long, value_name = "K/N")]
    shard: Option<Shard>,

    /// So many small sensors of 45° each, side by side, must see nothing nearer than the frames show (docs/second-sensor.md).
    #[arg(long, value_name = "COUNT", default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..=5))]
    second_sensor_heads: u8,

    #[command(flatten)]
    common: Common,
}

/// Who flies against what.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Arm {
    /// Not attacked, no detector.
    None,
    /// Not attacked, detector and recovery on: what do they cost?
    NoneWatched,
    /// Attacked, no detector.
    Undefended,
    /// Attacked; an alarm stops the vehicle.
    Stop,
    /// Attacked; an alarm stops the vehicle, then the recovery pilot flies on.
    Recover,
}

impl Arm {
    const ALL: [Self; 5] = [
        Self::None,
        Self::NoneWatched,
        Self::Undefended,
        Self::Stop,
        Self::Recover,
    ];

    fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::NoneWatched => "none-watched",
            Self::Undefended => "undefended",
            Self::Stop => "stop",
            Self::Recover => "recover",
        }
    }

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

/// What every flight of a campaign has in common; the first line of `defended.csv`.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Settings {
    version: String,
    actor_sha256: String,
    detector_sha256: String,
    /// Verdicts that raise the alarm, and of how many.
    raise: (u8, u8),
    guard: bool,
    #[serde(default, skip_serializing_if = "is_none")]
    second_sensor_heads: u8,
    first_seed: u64,
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

#[allow(clippy::trivially_copy_pass_by_ref, reason = "what serde calls it with")]
fn is_none(heads: &u8) -> bool {
    *heads == 0
}

/// Everything that decides what the flights are, wherever they are flown.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Plan {
    settings: Settings,
    flights: u64,
    /// In their order, each once.
    arms: Vec<Arm>,
}

impl Plan {
    fn units(&self) -> u64 {
        self.flights.saturating_mul(self.arms.len() as u64)
    }

    /// All arms of a course before the next course: an interrupted campaign is one of fewer courses.
    fn place(&self, unit: u64) -> Result<(u64, Arm)> {
        let arms = self.arms.len().max(1) as u64;
        let arm = self
            .arms
            .get((unit % arms) as usize)
            .context("an arm for each flight")?;
        Ok((self.settings.first_seed.wrapping_add(unit / arms), *arm))
    }
}

/// A flight of a part: its line of `defended.csv`, to the letter.
#[derive(Debug, Serialize, Deserialize)]
#[serde(transparent)]
struct Written(String);

impl Written {
    fn line(&self) -> Result<Line> {
        let lines = from_csv::<Line>(&format!("{COLUMNS}\n{}", self.0));
        let line = lines.ok().and_then(|mut lines| lines.pop());
        line.with_context(|| format!("not a flight: {:?}", self.0))
    }
}

impl Unit for Written {
    fn name(&self) -> String {
        format!("the flight {}", self.0.trim_end())
    }
}

/// A flight: a line of `defended.csv`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Line {
    arm: Arm,
    seed: u64,
    #[serde(with = "outcome_or_none")]
    outcome: Option<Outcome>,
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
    /// Of these because the actor was led astray.
    astray_alarms: u64,
    /// Of these because it disagreed with the planner.
    disagreement_alarms: u64,
    /// Step of the first alarm, if there was one.
    first_alarm_step: Option<u64>,
    stop_steps: u64,
    recovery_steps: u64,
}

/// A flight has a line of 100 bytes.
const SIZE_LIMIT: u64 = 1 << 30;
const COLUMNS: &str = "arm,seed,outcome,flight_time_s,closest_obstacle_m,attacked_steps,effective_steps,judged_steps,alarms,guard_alarms,astray_alarms,disagreement_alarms,first_alarm_step,stop_steps,recovery_steps";

/// An outcome by its name, and `none` for a vehicle that never took off.
mod outcome_or_none {
    use serde::{Deserialize, Deserializer, Serializer};
    use vigil_world::Outcome;

    const NO_FLIGHT: &str = "none";

    pub fn serialize<S: Serializer>(outcome: &Option<Outcome>, s: S) -> Result<S::Ok, S::Error> {
        s.serialize_str(outcome.map_or(NO_FLIGHT, Outcome::name))
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<Option<Outcome>, D::Error> {
        match String::deserialize(d)?.as_str() {
            NO_FLIGHT => Ok(None),
            name => name.parse().map(Some).map_err(serde::de::Error::custom),
        }
    }
}
impl Line {
    fn of(arm: Arm, seed: u64, flown: &Flown) -> Self {
        let attack = flown.attack.unwrap_or_default();
        let watch = flown.watch.clone().unwrap_or_default();
        Self {
            arm,
            seed,
            outcome: flown.record.outcome,
            flight_time_s: flown.record.flight_time_s,
            closest_obstacle_m: flown.record.closest_obstacle_m,
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
        self.outcome == Some(Outcome::Success)
    }
}

/// The flights of a campaign, on disk and in memory.
struct Log {
    path: PathBuf,
    heading: String,
    lines: BTreeMap<(u64, Arm), Line>,
}

impl Log {
    /// Without flights.
    fn new(path: PathBuf, settings: &Settings) -> Result<Self> {
        Ok(Self {
            path,
            heading: format!("# {}\n{COLUMNS}\n", serde_json::to_string(settings)?),
            lines: BTreeMap::new(),
        })
    }

    /// Reads what there is, when it is to be gone on with. A line that a killed process left half written is flown again.
    fn open(path: PathBuf, settings: &Settings, resume: bool) -> Result<Self> {
        let mut log = Self::new(path, settings)?;
        let name = log.path.display().to_string();
        if !log.path.exists() {
            return Ok(log);
        }
        ensure!(
            resume,
            "{name} holds a campaign's flights; add --resume to fly what it lacks, or name another folder with --output"
        );
        let text =
            vigil_types::files::read_text(&log.path, SIZE_LIMIT).with_context(|| format!("cannot read {name}"))?;
        let Some(lines) = text.strip_prefix(&log.heading) else {
            bail!("{name} is of another campaign (its first line tells which); name another folder with --output");
        };
        let whole = lines.rfind('\n').map_or("", |end| &lines[..end]);
        for (number, text) in whole.lines().enumerate() {
            let line = Written(text.to_owned())
                .line()
                .with_context(|| format!("{name}, line {}", number + 3))?;
            log.lines.insert((line.seed, line.arm), line);
        }
        Ok(log)
    }

    /// Writes all flights in their order: what a finished campaign leaves does not depend on threads or interruptions.
    fn write(&self) -> Result<std::fs::File> {
        let mut text = self.heading.clone();
        for line in self.lines.values() {
            text += &csv_line(line);
        }
        output::write(&self.path, text)?;
        std::fs::OpenOptions::new()
            .append(true)
            .open(&self.path)
            .with_context(|| format!("cannot write {}", self.path.display()))
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
    /// Flights with an alarm, alarms, and alarms per hour of judged flight.
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
        let outcomes: Vec<_> = lines.iter().map(|line| line.outcome).collect();
        let sum = |of: fn(&Line) -> u64| lines.iter().map(|line| of(line)).sum::<u64>();
        let judged = sum(|l| l.judged_steps).max(1) as f64;
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
            alarms_per_hour: alarms as f64 / (judged * f64::from(STEP_S) / 3600.0),
            stopping_share: sum(|l| l.stop_steps) as f64 / judged,
            recovering_share: sum(|l| l.recovery_steps) as f64 / judged,
            failed_seeds: lines.iter().filter(|l| !l.is_success()).map(|l| l.seed).collect(),
        })
    }

    fn table(rows: &[Self]) -> TextTable {
        let mut table = TextTable::new(
            [words("arm"), numbers("flights")]
                .into_iter()
                .chain(Tally::columns())
                .chain([words("yaw moved ≥ 1.0"), words("alarms")]),
        );
        for row in rows {
            let name = [row.arm.name().to_owned(), row.tally.flights.to_string()];
            let effective = campaign::effective_share(row.attacked_steps, row.effective_steps);
            table.row(
                name.into_iter()
                    .chain(row.tally.cells())
                    .chain([effective, row.alarms_in_words()]),
            );
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
        epsilon: args.epsilon,
        iterations: args.iterations,
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
    let settings = Settings {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        actor_sha256: args.common.pilot()?.sha256(),
        detector_sha256: match &args.detector {
            Some(file) => FrozenDetector::load(file)?.sha256(),
            None => FrozenDetector::built_in()?.sha256(),
        },
        raise: (detector.raise_count, detector.raise_window),
        guard: args.guard,
        second_sensor_heads: args.second_sensor_heads,
        first_seed: args.seed,
        apf: args.apf,
        attack: attack.config,
        burst: attack.burst,
        evades_sha256: attack.evade.as_ref().map(FrozenDetector::sha256),
        evades_guard: args.evade_guard,
    };
    let arms = Arm::ALL.into_iter().filter(|arm| args.arms.contains(arm));
    let plan = Plan {
        settings,
        flights: args.flights,
        arms: arms.collect(),
    };
    if let Some(shard) = args.shard {
        return fly_shard(args, &attack, plan, shard, folder);
    }
    let log = Log::open(folder.join(CSV), &plan.settings, args.resume)?;
    fly_missing(args, &attack, log, &plan, folder)
}

/// What parts call this command.
pub const COMMAND: &str = "attack defended";
const CSV: &str = "defended.csv";

fn fly_shard(args: &DefendedArgs, attack: &Attack, plan: Plan, shard: Shard, folder: &Path) -> Result<ExitCode> {
    let path = shard.file(&folder.join("defended.json"));
    let part = Part::begin(COMMAND, plan.clone(), (shard, plan.units()), &path)?;
    let (pool, interrupt) = (args.common.pool()?, Interrupt::on_ctrl_c()?);
    let bar = Progress::new(part.missing().len() as u64, "flights")?;
    part.fly(&path, (&pool, &bar, &interrupt), |unit| {
        let (seed, arm) = plan.place(unit)?;
        Ok(Written(csv_line(Line::of(arm, seed, &fly(args, arm, attack, seed)?))))
    })?;
    Ok(interrupt.exit_code())
}

/// Makes the whole of its parts: the table, the JSON, and the flights beside it, as one machine would have written them.
///
/// # Errors
/// Parts that contradict each other or are not all; a file that cannot be written.
pub fn merge(parts: &[PathBuf], json: &Path) -> Result<ExitCode> {
    let (plan, flights) = part::join::<Plan, Written>(parts)?;
    let lines: Vec<Line> = flights.iter().map(Written::line).collect::<Result<_>>()?;
    let path = match output::is_stdout(json) {
        true => PathBuf::from(CSV),
        false => json.with_extension("csv"),
    };
    let mut log = Log::new(path, &plan.settings)?;
    log.lines = lines.into_iter().map(|line| ((line.seed, line.arm), line)).collect();
    log.write()?;
    report(&plan.settings, &log, json)?;
    Ok(ExitCode::SUCCESS)
}

fn fly_missing(args: &DefendedArgs, attack: &Attack, mut log: Log, plan: &Plan, folder: &Path) -> Result<ExitCode> {
    let missing: Vec<(u64, Arm)> = (0..plan.units())
        .map(|unit| plan.place(unit))
        .filter(|key| !key.as_ref().is_ok_and(|key| log.lines.contains_key(key)))
        .collect::<Result<_>>()?;
    let interrupt = Interrupt::on_ctrl_c()?;
    let bar = Progress::new(missing.len() as u64, "flights")?;
    let file = Mutex::new(log.write()?);
    let flown: Vec<Line> = args.common.pool()?.install(|| {
        missing
            .into_iter()
            .take_while(|_| !interrupt.came())
            .par_bridge()
            .map(|(seed, arm)| {
                let line = Line::of(arm, seed, &fly(args, arm, attack, seed)?);
                let mut file = file.lock().map_err(|_| anyhow::anyhow!("another flight failed"))?;
                write!(file, "{}", csv_line(&line)).with_context(|| format!("cannot write {}", log.path.display()))?;
                bar.inc(1);
                Ok(line)
            })
            .collect::<Result<_>>()
    })?;
    bar.finish();
    log.lines
        .extend(flown.into_iter().map(|line| ((line.seed, line.arm), line)));
    log.write()?;
    if interrupt.came() {
        say!("interrupted: the same command with --resume goes on");
    }
    report(&plan.settings, &log, &folder.join("defended.json"))?;
    Ok(interrupt.exit_code())
}

/// Prints and writes the tables.
fn report(settings: &Settings, log: &Log, json: &Path) -> Result<()> {
    say!(
        "{}, ε = {}/255, {} iterations, {}, burst {}, field {}; validation courses from seed {}, the same in every arm",
        settings.attack.method.name(),
        settings.attack.epsilon_255,
        settings.attack.iterations,
        settings.attack.towards.name(),
        settings.burst,
        if settings.apf { "on" } else { "off" },
        settings.first_seed
    );
    let rows: Vec<Row> = Arm::ALL
        .into_iter()
        .filter_map(|arm| Row::of(arm, log.lines.values()))
        .collect();
    say!("{}", Row::table(&rows));
    let pairs: Vec<Pair> = [
        (Arm::None, Arm::NoneWatched),
        (Arm::Undefended, Arm::Stop),
        (Arm::Undefended, Arm::Recover),
    ]
    .into_iter()
    .filter_map(|(without, with)| pair(&log.lines, without, with))
    .inspect(|p| {
        say!(
            "{} against {}: of {} courses {} completed only with, {} only without",
            p.with.name(),
            p.without.name(),
            p.flights,
            p.won,
            p.lost
        );
    })
    .collect();
    say!("flights   {}", log.path.display());
    write_json(json, &Report { settings, rows, pairs })
}

fn fly(args: &DefendedArgs, arm: Arm, attack: &Attack, seed: u64) -> Result<Flown> {
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
            outcome: Some(outcome),
            flight_time_s: 21.35,
            closest_obstacle_m: 0.62,
            attacked_steps: 100,
            effective_steps: 87,
            judged_steps: 418,
            alarms: 1,
            guard_alarms: 0,
            astray_alarms: 0,
            disagreement_alarms: 0,
            first_alarm_step: Some(212),
            stop_steps: 14,
            recovery_steps: 120,
        }
    }

    fn settings(burst: u64) -> Settings {
        Settings {
            version: "0".to_owned(),
            actor_sha256: "a".to_owned(),
            detector_sha256: "d".to_owned(),
            raise: (2, 3),
            guard: true,
            second_sensor_heads: 0,
            first_seed: 7,
            apf: false,
            attack: AttackConfig::PAPER,
            burst: Burst::Steps(burst),
            evades_sha256: None,
            evades_guard: false,
        }
    }

    #[test]
    fn a_killed_campaign_goes_on_with_every_flight_that_had_ended() {
        let folder = std::env::temp_dir().join(format!("vigil-defended-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("defended.csv");
        let _ = std::fs::remove_file(&path);

        let mut log = Log::open(path.clone(), &settings(100), false).unwrap();
        let flown = [
            line(Arm::Recover, 7, Outcome::Success),
            line(Arm::Stop, 7, Outcome::TimeOut),
        ];
        let mut file = log.write().unwrap();
        for line in &flown {
            write!(file, "{}", csv_line(line)).unwrap();
        }
        // The third was being written when the process was killed.
        write!(file, "undefended,7,coll").unwrap();

        let again = Log::open(path.clone(), &settings(100), true).unwrap();
        assert_eq!(
            again.lines.values().cloned().collect::<Vec<_>>(),
            [flown[1].clone(), flown[0].clone()]
        );
        // Rewritten, it is whole and in order.
        again.write().unwrap();
        log.lines.clone_from(&again.lines);
        assert_eq!(Log::open(path.clone(), &settings(100), true).unwrap().lines, log.lines);

        let refused = |settings, resume| format!("{:#}", Log::open(path.clone(), &settings, resume).err().unwrap());
        assert!(refused(settings(100), false).contains("--resume"));
        assert!(refused(settings(50), true).contains("another campaign"));
        std::fs::write(&path, format!("{}stop,x,\n", again.heading)).unwrap();
        assert!(refused(settings(100), true).contains("line 3"));
        std::fs::remove_dir_all(&folder).unwrap();
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
