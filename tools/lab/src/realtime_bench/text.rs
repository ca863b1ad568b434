//! A run's report as text.

use super::report::{RealtimeReport, told_us};
use crate::report::TextTable;
use std::fmt;

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
