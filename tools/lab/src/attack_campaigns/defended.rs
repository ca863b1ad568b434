//! What the detector is worth: the same flights attacked and not, undefended, with the stop alone, with recovery.
//!
//! Each flight is a line of `defended.jsonl` as soon as it has ended, so a campaign of hours loses at most the flights in the air, and
//! `--resume` flies what is missing.

use super::{Common, Seeds, Strength, write_json};
use crate::campaign::flights::{Campaign, Existing, Jobs};
use crate::campaign::{self, Flight, Tally, WatchRecord};
use crate::cli::detector::detector_of;
use crate::report::{TextTable, to_csv};
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
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, clap::ValueEnum)]
    #[serde(rename_all = "kebab-case")]
    pub enum Arm {
        /// Not attacked, no detector.
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
pub struct Settings {
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

/// A line of `defended.csv`: its columns and what stands in them.
fn line(arm: Arm, flight: &Flight) -> [(&'static str, String); 15] {
    let attack = flight.attack.unwrap_or_default();
    let watch = flight.watch.clone().unwrap_or_default();
    let first_alarm_step = watch.first_alarm_step.map(|step| step.to_string());
    [
        ("arm", arm.name().to_owned()),
        ("seed", flight.seed.to_string()),
        // Of a vehicle that never took off there is none.
        (
            "outcome",
            flight.record.outcome.map_or("none", Outcome::name).to_owned(),
        ),
        ("flight_time_s", format!("{:.2}", flight.record.flight_time_s)),
        // Of the vehicle's middle.
        ("closest_obstacle_m", format!("{:.2}", flight.record.closest_obstacle_m)),
        ("attacked_steps", attack.attacked_steps.to_string()),
        ("effective_steps", attack.effective_steps.to_string()),
        ("judged_steps", watch.judged_steps.to_string()),
        ("alarms", watch.alarms.to_string()),
        ("guard_alarms", watch.guard_alarms.to_string()),
        ("astray_alarms", watch.astray_alarms.to_string()),
        ("disagreement_alarms", watch.disagreement_alarms.to_string()),
        ("first_alarm_step", first_alarm_step.unwrap_or_default()),
        ("stop_steps", watch.stop_steps.to_string()),
        ("recovery_steps", watch.recovery_steps.to_string()),
    ]
}

/// The flights of a campaign by seed and arm.
type Flown<'a> = BTreeMap<(u64, Arm), &'a Flight>;

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
    fn of(arm: Arm, flown: &Flown<'_>) -> Option<Self> {
        let of_arm = flown.iter().filter(|((_, flew), _)| *flew == arm);
        let flights: Vec<&Flight> = of_arm.map(|(_, flight)| *flight).collect();
        let outcomes: Vec<_> = flights.iter().map(|flight| flight.record.outcome).collect();
        let attacks = || flights.iter().filter_map(|flight| flight.attack);
        let watches = || flights.iter().filter_map(|flight| flight.watch.as_ref());
        let sum = |of: fn(&WatchRecord) -> u64| watches().map(of).sum::<u64>();
        let monitored = sum(|w| w.judged_steps).max(1) as f64;
        let alarms = sum(|w| w.alarms);
        let failed = flights.iter().filter(|flight| !flight.record.is_success());
        (!flights.is_empty()).then(|| Self {
            arm,
            tally: Tally::of(&outcomes),
            attacked_steps: attacks().map(|attack| attack.attacked_steps).sum(),
            effective_steps: attacks().map(|attack| attack.effective_steps).sum(),
            alarmed_flights: watches().filter(|w| w.alarms > 0).count(),
            alarms,
            guard_alarms: sum(|w| w.guard_alarms),
            astray_alarms: sum(|w| w.astray_alarms),
            disagreement_alarms: sum(|w| w.disagreement_alarms),
            alarms_per_hour: alarms as f64 / (monitored * f64::from(STEP_S) / 3600.0),
            stopping_share: sum(|w| w.stop_steps) as f64 / monitored,
            recovering_share: sum(|w| w.recovery_steps) as f64 / monitored,
            failed_seeds: failed.map(|flight| flight.seed).collect(),
        })
    }

    fn table(rows: &[Self]) -> TextTable {
        let columns = format!("arm | > flights | {} | yaw moved ≥ 1.0 | alarms", Tally::COLUMNS);
        let mut table = TextTable::new(&columns);
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

fn pair(flown: &Flown<'_>, without: Arm, with: Arm) -> Option<Pair> {
    let (mut flights, mut won, mut lost) = (0, 0, 0);
    for ((seed, _), flight) in flown.iter().filter(|((_, arm), _)| *arm == with) {
        if let Some(other) = flown.get(&(*seed, without)) {
            flights += 1;
            let (other, own) = (other.record.is_success(), flight.record.is_success());
            won += usize::from(own && !other);
            lost += usize::from(!own && other);
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
    let mut campaign = Campaign::new(COMMAND, settings, jobs)?.keep_in(&lines, existing)?;
    let interrupt = campaign.fly(&args.common.pool()?, |seed, arm, _| fly(args, arms[arm], &attack, seed))?;
    report(&campaign, &lines.with_extension("json"))?;
    Ok(interrupt.exit_code())
}

/// What lines call this command.
pub const COMMAND: &str = "attack defended";

/// Prints and writes the tables.
pub fn report(campaign: &Campaign<Settings, Flight>, json: &Path) -> Result<()> {
    let (settings, first_seed) = (campaign.settings(), campaign.jobs().first_seed);
    let flown = campaign.flights().map(|(arm, flight)| {
        let arm = Arm::from_name(arm).with_context(|| format!("there is no arm {arm}"))?;
        Ok(((flight.seed, arm), flight))
    });
    let flown: Flown<'_> = flown.collect::<Result<_>>()?;
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
    let row = |arm| Row::of(arm, &flown);
    let rows: Vec<Row> = Arm::ALL.into_iter().filter_map(row).collect();
    say!("{}", Row::table(&rows));
    let pairs: Vec<Pair> = [
        (Arm::None, Arm::NoneWatched),
        (Arm::Undefended, Arm::Stop),
        (Arm::Undefended, Arm::Recover),
    ]
    .into_iter()
    .filter_map(|(without, with)| pair(&flown, without, with))
    .inspect(|p| {
        let ([with, without], Pair { flights, won, lost, .. }) = ([p.with, p.without].map(Arm::name), p);
        say!("{with} against {without}: of {flights} courses {won} completed only with, {lost} only without");
    })
    .collect();
    campaign.is_interrupted();
    if output::is_file(json) {
        let table = json.with_extension("csv");
        let lines: Vec<_> = flown.iter().map(|((_, arm), flight)| line(*arm, flight)).collect();
        let heading = lines
            .first()
            .map(|line| line.each_ref().map(|(name, _)| (*name).to_owned()));
        let cells = lines.into_iter().map(|line| line.map(|(_, cell)| cell));
        let rows = to_csv(heading.into_iter().chain(cells));
        let text = format!("# {}\n{rows}", serde_json::to_string(settings)?);
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
    use crate::campaign::SensorRecord;

    fn flight(seed: u64, outcome: Outcome) -> Flight {
        let mut watch = WatchRecord::default();
        (watch.judged_steps, watch.alarms) = (418, 1);
        let record = serde_json::json!({
            "seed": seed, "from_ground": false, "outcome": outcome, "flight_time_s": 1.0, "path_length_m": 1.0,
            "closest_goal_m": 1.0, "closest_obstacle_m": 1.0, "steps": 418, "state_hash": "0", "watch": watch,
            "sensor": SensorRecord::default(),
        });
        serde_json::from_value(record).unwrap()
    }

    #[test]
    fn arms_are_compared_on_the_courses_that_both_flew() {
        let flights = [
            (Arm::Undefended, flight(1, Outcome::Collision)),
            (Arm::Recover, flight(1, Outcome::Success)),
            (Arm::Undefended, flight(2, Outcome::Success)),
            (Arm::Recover, flight(2, Outcome::TimeOut)),
            (Arm::Undefended, flight(3, Outcome::TimeOut)),
            (Arm::Recover, flight(3, Outcome::Success)),
            (Arm::Recover, flight(4, Outcome::Success)),
        ];
        let flown: Flown<'_> = flights.iter().map(|(arm, f)| ((f.seed, *arm), f)).collect();
        let pair = pair(&flown, Arm::Undefended, Arm::Recover).unwrap();
        assert_eq!((pair.flights, pair.won, pair.lost), (3, 2, 1));
        let row = Row::of(Arm::Recover, &flown).unwrap();
        assert_eq!((row.tally.flights, row.tally.completed, row.tally.time_outs), (4, 3, 1));
        assert_eq!(row.failed_seeds, [2]);
        // Four alarms in 4 · 418 steps of 0.05 s.
        assert!((row.alarms_per_hour - 4.0 / (4.0 * 418.0 * 0.05 / 3600.0)).abs() < 1e-3);
        assert!(Row::of(Arm::Stop, &flown).is_none());
    }
}
