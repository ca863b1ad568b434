//! What a run came to: distributions, the worst steps with their causes, advice; as a table, JSON and a picture.

use super::causes::{self, Cause, Work};
use super::{Machine, ObservedStep};
use crate::report::{Figure, Panel, Scale, Series, TextTable};
use crate::statistics::quantile;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// Bins of a histogram in each power of ten.
const BINS_PER_DECADE: i32 = 10;
/// How many of the worst steps are shown.
const WORST: usize = 5;

/// What is known of a run besides its steps.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct RunFacts {
    /// The command that ran it again.
    pub command: String,
    pub minutes: f64,
    /// How the flights ended, and how many each way.
    pub flights: BTreeMap<String, u64>,
    /// What else ran because it was asked for.
    pub load: Option<String>,
    /// Why the run ended before its time; none if it did not.
    #[serde(default)]
    pub ended_early: Option<String>,
    /// Share of the time that all processors were busy, this run's own work among it.
    pub busy: f64,
    /// FIFO priority of the loop's thread; none under normal scheduling.
    pub fifo: Option<i32>,
    /// Scheduling and memory as the system granted them, in words.
    pub granted: String,
    pub locked: bool,
    pub machine: Machine,
}

/// How times are spread, microseconds.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Distribution {
    pub p50_us: f64,
    pub p99_us: f64,
    pub p99_9_us: f64,
    pub max_us: f64,
    /// Where bins end that hold something (ten to a power of ten, the first ends at 1 µs), and how many they hold.
    pub bins: Vec<(f64, u64)>,
}

impl Distribution {
    fn of(times_ns: impl Iterator<Item = u64>) -> Self {
        let mut sorted_us: Vec<f64> = times_ns.map(|ns| ns as f64 * 1e-3).collect();
        sorted_us.sort_by(f64::total_cmp);
        let at = |share| quantile(&sorted_us, share).unwrap_or(0.0);
        let mut bins: Vec<(f64, u64)> = Vec::new();
        for us in &sorted_us {
            let power = (us.max(1.0).log10() * f64::from(BINS_PER_DECADE)).ceil();
            let end_us = 10f64.powf(power / f64::from(BINS_PER_DECADE));
            match bins.last_mut() {
                Some((end, count)) if *end >= end_us => *count += 1,
                _ => bins.push((end_us, 1)),
            }
        }
        Self {
            p50_us: at(0.5),
            p99_us: at(0.99),
            p99_9_us: at(0.999),
            max_us: at(1.0),
            bins,
        }
    }

    /// Its quantiles and the longest, in words.
    fn cells(&self) -> [String; 4] {
        [self.p50_us, self.p99_us, self.p99_9_us, self.max_us].map(told_us)
    }

    /// The outline of the histogram; counts by their logarithm, because the few at the end matter.
    fn outline(&self) -> Vec<(f64, f64)> {
        let factor = 10f64.powf(-1.0 / f64::from(BINS_PER_DECADE));
        let height = |count: u64| (1.0 + count as f64).log10();
        let mut points = Vec::new();
        let mut last = 0.0;
        for (end, count) in &self.bins {
            let begin = end * factor;
            if begin > last * 1.001 {
                points.extend([(last.max(1e-9), 0.0), (begin, 0.0)]);
            }
            points.extend([(begin, height(*count)), (*end, height(*count))]);
            last = *end;
        }
        points.push((last, 0.0));
        points.retain(|(x, _)| *x > 1e-6);
        points
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WorstStep {
    /// When it was, seconds from the run's start.
    pub at_s: f64,
    pub late_us: f64,
    pub took_us: f64,
    pub missed: u64,
    pub work: String,
    pub cause: String,
}

/// What was counted over all steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Totals {
    /// Times that the processor was taken from the loop.
    pub involuntary: u64,
    /// Time that it was ready without a processor, microseconds.
    pub queued_us: u64,
    pub minor_faults: u64,
    pub major_faults: u64,
    /// Time that the hypervisor gave to others, on any processor, milliseconds.
    pub stolen_ms: u64,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RealtimeReport {
    pub run: RunFacts,
    pub steps: u64,
    pub missed: u64,
    /// Lateness of wake-ups, the time of missed steps included.
    pub lateness: Distribution,
    /// From wake-up to the end of the step.
    pub duration: Distribution,
    pub totals: Totals,
    /// Why steps began more than 1 ms late: how many for each reason.
    pub late_causes: BTreeMap<String, u64>,
    /// Why steps took more than 1 ms longer than usual.
    pub long_causes: BTreeMap<String, u64>,
    pub latest: Vec<WorstStep>,
    pub longest: Vec<WorstStep>,
    /// What would make the loop more punctual.
    pub advice: Vec<String>,
}

impl RealtimeReport {
    /// Of a run's steps.
    pub fn of(run: RunFacts, steps: &[ObservedStep]) -> Self {
        let lateness = Distribution::of(steps.iter().map(ObservedStep::lateness_ns));
        let duration = Distribution::of(steps.iter().map(|step| step.took_ns));
        // Steps with other work take other times.
        let mut usual: BTreeMap<Work, Vec<u64>> = BTreeMap::new();
        for step in steps {
            usual.entry(step.work).or_default().push(step.took_ns);
        }
        usual.values_mut().for_each(|times_ns| times_ns.sort_unstable());
        let usual_ns = |step: &ObservedStep| {
            let same = usual.get(&step.work);
            same.map_or(0, |times_ns| times_ns[times_ns.len() / 2])
        };
        type Of<'a, T> = &'a dyn Fn(&ObservedStep) -> T;
        let worst = |key: Of<u64>, cause: Of<Option<Cause>>| -> Vec<WorstStep> {
            let mut sorted: Vec<&ObservedStep> = steps.iter().collect();
            sorted.sort_by_key(|step| (std::cmp::Reverse(key(step)), step.at_ns));
            let shown = |step: &&ObservedStep| WorstStep {
                at_s: (step.at_ns / 1_000_000) as f64 / 1000.0,
                late_us: step.lateness_ns() as f64 * 1e-3,
                took_us: step.took_ns as f64 * 1e-3,
                missed: step.missed,
                work: step.work.to_string(),
                cause: cause(step).map_or_else(|| "no later or longer than usual".to_owned(), |cause| cause.text(step)),
            };
            sorted.iter().take(WORST).map(shown).collect()
        };
        let long_cause = |step: &ObservedStep| causes::of_duration(step, usual_ns(step));
        let mut report = Self {
            steps: steps.len() as u64,
            missed: steps.iter().map(|step| step.missed).sum(),
            latest: worst(&ObservedStep::lateness_ns, &causes::of_lateness),
            longest: worst(&|step| step.took_ns, &long_cause),
            late_causes: count(steps.iter().filter_map(causes::of_lateness)),
            long_causes: count(steps.iter().filter_map(long_cause)),
            totals: totals(steps),
            lateness,
            duration,
            run,
            advice: Vec::new(),
        };
        report.advice = report.advise();
        report
    }

    fn caused(&self, cause: Cause) -> u64 {
        let of = |causes: &BTreeMap<String, u64>| causes.get(cause.name()).copied().unwrap_or(0);
        of(&self.late_causes) + of(&self.long_causes)
    }

    /// What fits what was found, and nothing else.
    fn advise(&self) -> Vec<String> {
        let (run, machine) = (&self.run, &self.run.machine);
        let mut advice = Vec::new();
        let queued = self.caused(Cause::Queued);
        if run.fifo.is_none() {
            advice.push(format!(
                "priority: the loop ran with normal scheduling, and {queued} steps waited more than 1 ms for a processor; give vigil-lab CAP_SYS_NICE \
                 (`sudo setcap cap_sys_nice,cap_ipc_lock+ep …/vigil-lab`) or its user an rtprio limit, and leave rate.priority at 50"
            ));
        } else if queued > 0 {
            advice.push(format!(
                "isolation: {queued} steps waited more than 1 ms for a processor in spite of FIFO priority: keep one free (isolcpus=N on the kernel's command \
                 line, or AllowedCPUs= of the other units) and start the firmware on it (`taskset -c N`, CPUAffinity=N)"
            ));
            if machine.realtime_us_per_s.is_some_and(|us| us >= 0) {
                advice.push(
                    "throttling: the kernel stops FIFO threads that compute for most of a second; `sysctl kernel.sched_rt_runtime_us=-1` turns that off, \
                     where nothing else with FIFO priority can run away"
                        .to_owned(),
                );
            }
        }
        if !run.locked {
            advice.push(format!(
                "memory: it is not locked, and {} pages were read from the disk; give the program CAP_IPC_LOCK or a memlock limit that is unlimited",
                self.totals.major_faults
            ));
        } else if self.caused(Cause::Disk) > 0 {
            advice.push(
                "memory: steps waited for the disk although memory is locked: a file is mapped after the start; look for the log's folder on a slow disk"
                    .to_owned(),
            );
        }
        if machine.governors.iter().any(|governor| governor != "performance") {
            advice.push(format!(
                "clock: the governor is {}; `cpupower frequency-set -g performance` keeps the clock up",
                machine.governors.join(", ")
            ));
        }
        let woken_late = self.caused(Cause::WokenLate);
        if woken_late > 0 {
            advice.push(format!(
                "kernel: {woken_late} steps were woken more than 1 ms late with a processor free: {}{}",
                match machine.preempt_rt {
                    true => "keep processors from deep sleep (`cpupower idle-set -D 10`) and interrupts off the loop's (/proc/irq/*/smp_affinity)",
                    false => "a kernel with PREEMPT_RT, and processors kept from deep sleep (`cpupower idle-set -D 10`)",
                },
                if machine.virtual_machine { "; in a virtual machine the host decides" } else { "" }
            ));
        }
        let stolen = self.caused(Cause::Stolen);
        if stolen > 0 || self.totals.stolen_ms > 0 {
            advice.push(format!(
                "hypervisor: {} ms of the processors went to other machines, {stolen} steps suffered by more than 1 ms: pin the machine's processors on the host, or fly on \
                 hardware of your own",
                self.totals.stolen_ms
            ));
        }
        if self.caused(Cause::Blocked) > 0 {
            advice.push(
                "blocked: steps waited within themselves, which the loop does not do: write an issue with this report"
                    .to_owned(),
            );
        }
        if machine.processors < 2 {
            advice.push("processors: the sensor's driver and the log's writer share the loop's only one".to_owned());
        }
        advice
    }

    /// The distributions as histograms over a common axis, the counts by their logarithm.
    pub fn figure(&self) -> Figure {
        let panel = |title: &str, of: &Distribution| {
            let [p50, p99, p99_9, max] = of.cells();
            let quantiles = format!("{title}: p50 {p50}, p99 {p99}, p99.9 {p99_9}, max {max}");
            Panel::of(quantiles, "log10(1 + steps)", [Series::line(title, of.outline())])
        };
        let last_us = self.lateness.max_us.max(self.duration.max_us).max(50_000.0);
        let decades = last_us.log10().ceil() as i32;
        Figure {
            x_scale: Scale::Logarithmic((0..=decades).map(|power| 10f64.powi(power)).collect()),
            ..Figure::over(
                "time (µs); a step is due every 50 000",
                10f64.powi(decades),
                vec![panel("Wake-up late", &self.lateness), panel("Step", &self.duration)],
            )
        }
    }
}

fn count(causes: impl Iterator<Item = Cause>) -> BTreeMap<String, u64> {
    let mut counted = BTreeMap::new();
    for cause in causes {
        *counted.entry(cause.name().to_owned()).or_default() += 1;
    }
    counted
}

fn totals(steps: &[ObservedStep]) -> Totals {
    let sum = |of: fn(&ObservedStep) -> u64| steps.iter().map(of).sum();
    let (queued_ns, stolen_ns): (u64, u64) = (sum(|s| s.counted.queued_ns), sum(|s| s.counted.stolen_ns));
    Totals {
        involuntary: sum(|s| s.counted.involuntary),
        queued_us: queued_ns / 1000,
        minor_faults: sum(|s| s.counted.minor_faults),
        major_faults: sum(|s| s.counted.major_faults),
        stolen_ms: stolen_ns / 1_000_000,
    }
}

/// A text, or what stands for an empty one.
pub(super) fn or<'a>(text: &'a str, none: &'a str) -> &'a str {
    if text.is_empty() { none } else { text }
}

impl fmt::Display for RealtimeReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.fmt_run(f)?;
        writeln!(f)?;
        let mut table = TextTable::new(" | > p50 | > p99 | > p99.9 | > max");
        for (name, of) in [("wake-up late", &self.lateness), ("step", &self.duration)] {
            table.row([name.to_owned()].into_iter().chain(of.cells()));
        }
        writeln!(f, "{table}\n")?;
        let totals = &self.totals;
        writeln!(
            f,
            "counted     put aside {} times, ready without a processor for {:.1} ms; {} pages touched first, {} read from the disk; \
             {} ms stolen",
            totals.involuntary,
            totals.queued_us as f64 / 1000.0,
            totals.minor_faults,
            totals.major_faults,
            totals.stolen_ms
        )?;
        self.fmt_causes(f)?;
        let advice: Vec<_> = self.advice.iter().map(|text| format!("advice      {text}")).collect();
        let none = "advice      none: nothing that was counted would be better elsewhere";
        f.write_str(or(&advice.join("\n"), none))
    }
}

impl RealtimeReport {
    /// What ran, and where.
    fn fmt_run(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (run, machine) = (&self.run, &self.run.machine);
        let flights = run.flights.iter().map(|(outcome, n)| format!("{n} {outcome}"));
        writeln!(
            f,
            "loop        {:.1} min, {} steps, {} missed; flights: {}",
            run.minutes,
            self.steps,
            self.missed,
            flights.collect::<Vec<_>>().join(", ")
        )?;
        writeln!(
            f,
            "machine     {}, {} processors{}; Linux {}",
            machine.processor,
            machine.processors,
            if machine.virtual_machine {
                " of a virtual machine"
            } else {
                ""
            },
            machine.kernel
        )?;
        let governors = machine.governors.join(", ");
        let (governors, isolated) = (or(&governors, "not known"), or(&machine.isolated, "none"));
        writeln!(f, "            governor {governors}; isolated processors: {isolated}")?;
        writeln!(f, "scheduling  {}", run.granted)?;
        let load = run.load.as_ref().map(|load| format!("`{load}`"));
        writeln!(
            f,
            "load        {}; all processors busy for {:.0} % of the time",
            load.as_deref().unwrap_or("none asked for"),
            run.busy * 100.0
        )?;
        if let Some(reason) = &run.ended_early {
            writeln!(f, "ended early {reason}")?;
        }
        Ok(())
    }

    /// What made steps late or long, and the worst of them.
    fn fmt_causes(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (what, causes) in [
            ("more than 1 ms late", &self.late_causes),
            ("1 ms longer than usual", &self.long_causes),
        ] {
            let causes: Vec<_> = causes.iter().map(|(cause, n)| format!("{n} {cause}")).collect();
            writeln!(f, "{what}: {}", or(&causes.join(", "), "none"))?;
        }
        for (what, worst) in [("latest", &self.latest), ("longest", &self.longest)] {
            let Some(step) = worst.first() else { continue };
            writeln!(
                f,
                "{what:<11} at {:.2} s: {} late, {} long ({}): {}",
                step.at_s,
                told_us(step.late_us),
                told_us(step.took_us),
                step.work,
                step.cause
            )?;
        }
        Ok(())
    }
}

/// A time with the unit that suits it.
fn told_us(us: f64) -> String {
    match us {
        us if us < 10.0 => format!("{us:.1} µs"),
        us if us < 10_000.0 => format!("{us:.0} µs"),
        us => format!("{:.1} ms", us / 1000.0),
    }
}

#[cfg(test)]
mod tests {
    use super::super::Counters;
    use super::*;
    use crate::report::Picture as _;
    use vigil_types::STEP_NS;

    /// A run of a thousand steps, each 200 µs long and 30 µs late.
    fn punctual() -> Vec<ObservedStep> {
        let step = |number: u64| ObservedStep {
            at_ns: number * STEP_NS,
            late_ns: 30_000,
            took_ns: 200_000,
            counted: Counters {
                processor_ns: 205_000,
                voluntary: 1,
                ..Counters::default()
            },
            ..ObservedStep::default()
        };
        (0..1000).map(step).collect()
    }

    fn run() -> RunFacts {
        RunFacts {
            fifo: Some(50),
            locked: true,
            granted: "SCHED_FIFO priority 50; memory locked".to_owned(),
            machine: Machine {
                processors: 4,
                ..Machine::default()
            },
            ..RunFacts::default()
        }
    }

    fn assert_begin(advice: &[String], begins: &[&str]) {
        assert_eq!(advice.len(), begins.len(), "{advice:?}");
        let mut pairs = advice.iter().zip(begins);
        assert!(pairs.all(|(text, begin)| text.starts_with(begin)), "{advice:?}");
    }

    #[test]
    fn quantiles_are_the_times_that_so_many_steps_do_not_exceed_and_bins_hold_every_step() {
        let of = Distribution::of((1..=1000).map(|us| us * 1000));
        assert_eq!(
            (of.p50_us, of.p99_us, of.p99_9_us, of.max_us),
            (500.0, 990.0, 999.0, 1000.0)
        );
        assert_eq!(of.bins.iter().map(|(_, count)| count).sum::<u64>(), 1000);
        for pair in of.bins.windows(2) {
            assert!(pair[0].0 < pair[1].0);
        }
        // From 794.3 to 1000 µs.
        let (end, count) = *of.bins.last().unwrap();
        assert!((end - 1000.0).abs() < 1e-6 && count == 206, "{end} {count}");
        assert_eq!(Distribution::of(std::iter::empty()), Distribution::default());
    }

    #[test]
    fn a_punctual_run_misses_nothing_and_gets_no_advice() {
        let report = RealtimeReport::of(run(), &punctual());
        assert_eq!((report.steps, report.missed), (1000, 0));
        assert!(report.late_causes.is_empty() && report.long_causes.is_empty());
        assert_eq!(report.advice, [""; 0]);
        assert!(report.to_string().contains("advice      none"));
    }

    #[test]
    fn the_worst_steps_are_reported_with_their_causes_and_the_advice_fits_them() {
        let mut steps = punctual();
        // Others had the processor for 61 ms: one step was missed.
        (steps[300].late_ns, steps[300].missed) = (11_000_000, 1);
        steps[300].counted.queued_ns = 60_900_000;
        // A step computed for 9 ms in the middle of its work.
        (steps[700].took_ns, steps[700].counted.processor_ns) = (9_000_000, 9_000_000);
        let report = RealtimeReport::of(run(), &steps);
        assert_eq!((report.steps, report.missed), (1000, 1));
        assert_eq!(report.late_causes, BTreeMap::from([("queued".to_owned(), 1)]));
        assert_eq!(report.long_causes, BTreeMap::from([("computed".to_owned(), 1)]));
        assert_eq!((report.latest[0].late_us, report.latest[0].at_s), (61_000.0, 15.0));
        assert_eq!((report.longest[0].took_us, report.longest[0].at_s), (9_000.0, 35.0));
        let text = report.to_string();
        assert!(text.contains("60.90 ms for a processor that others had"), "{text}");
        assert_begin(&report.advice, &["isolation: 1 steps"]);

        let normal = RunFacts {
            fifo: None,
            locked: false,
            ..run()
        };
        let advice = RealtimeReport::of(normal, &steps).advice;
        assert_begin(&advice, &["priority: ", "memory: "]);
    }

    #[test]
    fn the_machine_is_advised_on_what_it_has() {
        let mut steps = punctual();
        steps[10].late_ns = 3_000_000;
        steps[20].late_ns = 4_000_000;
        steps[20].counted.stolen_ns = 10_000_000;
        let mut run = run();
        run.machine.governors = vec!["powersave".to_owned()];
        run.machine.processors = 1;
        let advice = RealtimeReport::of(run, &steps).advice;
        let clock = "clock: the governor is powersave";
        assert_begin(
            &advice,
            &[clock, "kernel: 1 steps", "hypervisor: 10 ms", "processors: "],
        );
    }

    #[test]
    fn steps_with_more_work_are_compared_with_their_like() {
        let mut steps = punctual();
        for step in steps.iter_mut().step_by(2) {
            step.work.0[2] = true;
            (step.took_ns, step.counted.processor_ns) = (2_000_000, 2_000_000);
        }
        assert!(RealtimeReport::of(run(), &steps).long_causes.is_empty());
    }

    #[test]
    fn a_report_comes_back_from_its_file_and_draws_the_same_picture() {
        let mut steps = punctual();
        steps[5].late_ns = 2_000_000;
        let report = RealtimeReport::of(run(), &steps);
        let again: RealtimeReport = serde_json::from_str(&serde_json::to_string(&report).unwrap()).unwrap();
        assert_eq!(again, report);
        assert_eq!(again.to_string(), report.to_string());
        let picture = report.figure().svg();
        assert_eq!(again.figure().svg(), picture);
        let texts = "Wake-up late: p50 30 µs|max 2000 µs|Step: p50 200 µs|log10(1 + steps)";
        assert!(texts.split('|').all(|text| picture.contains(text)), "{picture}");
    }
}
