//! What `vigil evaluate` says of its flights: the table, and the JSON.

use super::Settings;
use crate::campaign::flights::Campaign;
use crate::campaign::{Flight, SensorRecord, WatchRecord, outcome_name};
use crate::cli::output::{self, Paint, say};
use crate::report::TextTable;
use crate::statistics::{quantile, wilson_95};
use anyhow::Result;
use serde::Serialize;
use std::collections::BTreeSet;
use std::path::Path;
use vigil_sim::world::Outcome;
use vigil_types::STEP_S;

/// The arm of flights whose sensor works.
pub(super) const NO_FAULT: &str = "no fault";

#[derive(Serialize)]
struct Rate {
    outcome: String,
    flights: usize,
    share: f64,
    wilson_95: (f64, f64),
}

/// How the flights with a fault ended.
#[derive(Default, Serialize)]
struct FaultTally {
    fault: String,
    flights: usize,
    /// Or left the course.
    collisions: usize,
    held: usize,
    arrived: usize,
    time_outs: usize,
}

impl FaultTally {
    /// Counts the flights with the fault of this name.
    fn of(fault: &str, flights: &[&Flight]) -> Self {
        let mut tally = Self {
            fault: fault.to_owned(),
            ..Self::default()
        };
        for flight in flights.iter().filter(|f| f.sensor_fault.as_deref() == Some(fault)) {
            tally.flights += 1;
            // One that guidance never flew was held from the start, on the ground as in the air.
            let is_held = flight.sensor.held_at_end || flight.sensor.flown_steps == 0;
            *match flight.record.outcome {
                Some(Outcome::Success) => &mut tally.arrived,
                Some(Outcome::Collision | Outcome::OutOfBounds) => &mut tally.collisions,
                Some(Outcome::TimeOut) if !is_held => &mut tally.time_outs,
                Some(Outcome::TimeOut) | None => &mut tally.held,
            } += 1;
        }
        tally
    }
}

/// Nothing in it depends on the machine or on the time that it took.
#[derive(Serialize)]
struct Report<'a> {
    version: &'static str,
    /// Ctrl-C came before all flights that were asked for had been flown.
    interrupted: bool,
    flights_asked_for: u64,
    first_seed: u64,
    #[serde(flatten)]
    settings: &'a Settings,
    simulated_s: f64,
    rates: &'a [Rate],
    #[serde(skip_serializing_if = "<[_]>::is_empty")]
    sensor_faults: &'a [FaultTally],
    flights: &'a [&'a Flight],
}

/// Every way a flight can end; `None` is a vehicle that never took off.
const OUTCOMES: [Option<Outcome>; 5] = [
    Some(Outcome::Success),
    Some(Outcome::Collision),
    Some(Outcome::OutOfBounds),
    Some(Outcome::TimeOut),
    None,
];

/// What the flights of a campaign took in the simulation, seconds.
pub(super) fn simulated_s(campaign: &Campaign<Settings, Flight>) -> f64 {
    let flights = campaign.flights();
    flights.map(|(_, f)| f.record.steps as f64 * f64::from(STEP_S)).sum()
}

/// How flights ended, each way with its share.
fn rates_of(flights: &[&Flight]) -> Vec<Rate> {
    let rate = |outcome| {
        let n = flights.iter().filter(|f| f.record.outcome == outcome).count();
        Rate {
            outcome: outcome_name(outcome).to_owned(),
            flights: n,
            share: n as f64 / flights.len().max(1) as f64,
            wilson_95: wilson_95(n, flights.len()),
        }
    };
    OUTCOMES.into_iter().map(rate).collect()
}

fn print_rates(rates: &[Rate], paint: &Paint) {
    let mut table = TextTable::new("outcome | > flights | > share | 95 % interval");
    let shown = || rates.iter().filter(|r| r.flights > 0 || r.outcome == "success");
    for r in shown() {
        let (low, high) = r.wilson_95;
        table.row([
            r.outcome.to_owned(),
            r.flights.to_string(),
            format!("{:.2} %", 100.0 * r.share),
            format!("{:.2} to {:.2} %", 100.0 * low, 100.0 * high),
        ]);
    }
    let good: Vec<bool> = shown().map(|r| r.outcome == "success").collect();
    paint.table(&table, &good);
}

/// How the flights were: times, attack, detector and sensor.
fn print_flights(flights: &[&Flight], is_attacked: bool) {
    let from_ground = flights.iter().filter(|f| f.from_ground).count();
    say!("from the ground  {from_ground} of {} flights", flights.len());
    let arrived = flights.iter().filter(|f| f.record.is_success());
    let times: Vec<f64> = arrived.map(|f| f.record.flight_time_s).collect();
    if let (Some(p50), Some(p95)) = (quantile(&times, 0.5), quantile(&times, 0.95)) {
        say!("time to goal     p50 {p50:.1} s, p95 {p95:.1} s");
    }
    if is_attacked {
        let each = || flights.iter().filter_map(|f| f.attack.as_ref());
        let (steps, effective) = each().fold((0, 0), |(n, m), a| (n + a.attacked_steps, m + a.effective_steps));
        say!(
            "attacked         {steps} steps in {} of {} flights; the yaw moved by 1.0 or more in {:.1} % of them",
            each().filter(|a| a.attacked_steps > 0).count(),
            flights.len(),
            100.0 * effective as f64 / steps.max(1) as f64
        );
        let used: u64 = flights.iter().filter_map(|f| f.altered_frames_used).sum();
        say!("altered frames   {used} of {steps} were used");
    }
    if flights.iter().any(|f| f.watch.is_some()) {
        let records = flights.iter().filter_map(|f| f.watch.as_ref());
        say!("detector         {}", WatchRecord::summary(records));
    }
    let of_sensor = SensorRecord::summary(flights.iter().map(|f| &f.sensor));
    say!("sensor           {of_sensor}");
}

/// The first seeds that failed, to be flown again.
fn print_failed(flights: &[&Flight]) {
    const SHOWN: usize = 12;
    // With all faults a seed may fail several times, each in its turn.
    let mut known = BTreeSet::new();
    let failed = flights
        .iter()
        .filter(|f| !f.record.is_success() && known.insert(f.seed));
    let failed: Vec<String> = failed.map(|f| f.seed.to_string()).collect();
    if !failed.is_empty() {
        let more = if failed.len() > SHOWN { " …" } else { "" };
        say!("failed seeds     {}{more}", failed[..failed.len().min(SHOWN)].join(" "));
    }
}

/// Prints the table of a campaign and writes its JSON. `took`: seconds and threads of the run on this machine, and the seconds that runs
/// before simulated.
pub(super) fn report(
    campaign: &Campaign<Settings, Flight>,
    json: &Path,
    took: Option<(f64, usize, f64)>,
) -> Result<()> {
    let (settings, jobs) = (campaign.settings(), campaign.jobs());
    // All with one fault before the next.
    let flights: Vec<&Flight> = jobs.arms.iter().flat_map(|arm| campaign.flights_of(arm)).collect();
    let faults = jobs.arms.iter().filter(|arm| *arm != NO_FAULT);
    let tallies: Vec<FaultTally> = faults.map(|fault| FaultTally::of(fault, &flights)).collect();
    let interrupted = campaign.is_interrupted();
    let rates = rates_of(&flights);
    let simulated_s = simulated_s(campaign);

    let paint = Paint::stdout();
    print_rates(&rates, &paint);
    if let Some(model) = &settings.vehicle_model {
        say!("vehicle          {model}");
    }
    print_flights(&flights, settings.attack.is_some());
    if !tallies.is_empty() {
        say!();
        let mut table = TextTable::new("sensor fault | > flights | > collision | > safe hold | > arrived | > time-out");
        for t in &tallies {
            let counts = [t.flights, t.collisions, t.held, t.arrived, t.time_outs].map(|n| n.to_string());
            table.row([t.fault.clone()].into_iter().chain(counts));
        }
        let good: Vec<bool> = tallies.iter().map(|tally| tally.collisions == 0).collect();
        paint.table(&table, &good);
        say!("");
    }
    if let Some((wall_s, threads, before_s)) = took {
        let new_s = simulated_s - before_s;
        let factor = new_s / wall_s / threads.min(flights.len()).max(1) as f64;
        say!("{new_s:.0} s simulated in {wall_s:.1} s on {threads} threads: {factor:.0} x real time per thread");
    }
    print_failed(&flights);

    let content = serde_json::to_vec_pretty(&Report {
        version: env!("CARGO_PKG_VERSION"),
        interrupted,
        flights_asked_for: jobs.count(),
        first_seed: jobs.first_seed,
        settings,
        simulated_s,
        rates: &rates,
        sensor_faults: &tallies,
        flights: &flights,
    })?;
    output::write(json, content)?;
    if !output::is_stdout(json) {
        say!("details          {}", json.display());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flight_that_guidance_never_flew_was_held_on_the_ground_as_in_the_air() {
        let flight = |outcome: Option<&str>, flown_steps: u64| {
            let of_sensor = SensorRecord {
                flown_steps,
                ..SensorRecord::default()
            };
            let flight = serde_json::json!({
                "seed": 4, "from_ground": false, "sensor_fault": "zeros", "outcome": outcome, "flight_time_s": 45.0,
                "path_length_m": 0.0, "closest_goal_m": 20.0, "closest_obstacle_m": 1.0, "steps": 900, "state_hash": "0",
                "sensor": of_sensor,
            });
            serde_json::from_value::<Flight>(flight).unwrap()
        };
        let flights = [
            flight(None, 0),
            flight(Some("time-out"), 0),
            flight(Some("time-out"), 900),
        ];
        let tally = FaultTally::of("zeros", &flights.iter().collect::<Vec<_>>());
        assert_eq!((tally.held, tally.time_outs), (2, 1));
    }
}
