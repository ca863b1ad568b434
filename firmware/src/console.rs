//! Prints for a person what the loop does, from a thread of its own: writing to a terminal may wait, the loop may not.

use crate::alarms::in_brackets;
use crate::frame_keeper::{FrameRefusals, Refusal};
use std::time::Duration;
use vigil_io::background::Background;
use vigil_io::links::LinkStatistics;
use vigil_io::throttle::Throttle;
use vigil_mavlink::StatusText;
use vigil_mavlink::common::MavSeverity;
use vigil_mavlink::signing::SigningCounters;
use vigil_types::{GuidanceState, Nanos, Reasons, StepReport};

/// Announcements that may wait to be printed; more are left out.
const CAPACITY: usize = 64;
/// How often the printer looks.
const PAUSE: Duration = Duration::from_millis(50);

/// How the companion begins the text of a change of state.
const STATE_TEXT: &str = "guidance: ";

#[derive(Debug, Clone, Copy)]
#[allow(clippy::large_enum_variant, reason = "they wait in a ring that is allocated once")]
enum News {
    State {
        from: GuidanceState,
        to: GuidanceState,
        reasons: Reasons,
    },
    Slips(u64),
    Refused(SigningCounters),
    OtherVehicle(u8),
    FramesRefused {
        total: u64,
        last: Refusal,
    },
    Text(StatusText),
}

/// Announces changes of the guidance state and missed steps.
pub struct Console {
    printer: Background<(Nanos, News)>,
    state: GuidanceState,
    slips: u64,
    refused: Throttle,
    other_system: Option<u8>,
    frames_refused: Throttle,
}

impl Console {
    /// Starts the printer; times are printed relative to `start_ns`.
    ///
    /// # Errors
    /// When the thread cannot be started.
    pub fn start(start_ns: Nanos) -> std::io::Result<Self> {
        let print = move |news: &mut dyn Iterator<Item = (Nanos, News)>| {
            news.for_each(|(at_ns, news)| print(at_ns.saturating_sub(start_ns) as f64 * 1e-9, news));
        };
        Ok(Self {
            printer: Background::start("console", CAPACITY, PAUSE, print)?,
            state: GuidanceState::Standby,
            slips: 0,
            refused: Throttle::default(),
            other_system: None,
            frames_refused: Throttle::default(),
        })
    }

    /// Looks at what a step left: its report, what others get by STATUSTEXT (changes of state are announced here), and what the links and
    /// the frames came to since start. Never waits and allocates nothing.
    pub fn observe(
        &mut self,
        report: &StepReport,
        texts: &[StatusText],
        line: &LinkStatistics,
        frames: &FrameRefusals,
    ) {
        let at_ns = report.now_ns;
        if report.state != self.state {
            let (from, to, reasons) = (self.state, report.state, report.reasons);
            self.announce(at_ns, News::State { from, to, reasons });
            self.state = to;
        }
        if report.timing.slips != self.slips {
            self.slips = report.timing.slips;
            self.announce(at_ns, News::Slips(self.slips));
        }
        for text in texts.iter().filter(|text| !text.text().starts_with(STATE_TEXT)) {
            self.announce(at_ns, News::Text(*text));
        }
        if self.refused.is_due(at_ns, line.signing.refused()) {
            self.announce(at_ns, News::Refused(line.signing));
        }
        // A vehicle that calls and is not the one that is asked for: once.
        if let (Some(system), None) = (line.other_system, self.other_system) {
            self.other_system = Some(system);
            self.announce(at_ns, News::OtherVehicle(system));
        }
        let total = frames.total();
        if let Some(last) = frames.last()
            && self.frames_refused.is_due(at_ns, total)
        {
            self.announce(at_ns, News::FramesRefused { total, last });
        }
    }

    fn announce(&mut self, at_ns: Nanos, news: News) {
        // Where too many wait it is lost; telemetry and log have it.
        self.printer.offer((at_ns, news));
    }
}

fn print(at_s: f64, news: News) {
    match news {
        News::State { from, to, reasons } => {
            let reasons: Vec<_> = reasons.iter().map(|reason| reason.name()).collect();
            let separator = if reasons.is_empty() { "" } else { ": " };
            let (from, to, reasons) = (from.name(), to.name(), reasons.join(", "));
            tracing::info!("{at_s:8.2} s  {from} → {to}{separator}{reasons}");
        }
        News::Refused(signing) => {
            let (total, reasons) = (signing.refused(), in_brackets(signing.refusals(), ""));
            tracing::warn!("{at_s:8.2} s  {total} packets refused since start{reasons}: docs/firmware.md, \"Signing\"");
        }
        News::OtherVehicle(system) => tracing::warn!(
            "{at_s:8.2} s  a vehicle of system {system} calls, which is not this link's: give the link with \
             system={system} if it is yours (docs/firmware.md, \"Who is the vehicle\")"
        ),
        News::FramesRefused { total, last } => tracing::warn!(
            "{at_s:8.2} s  {total} depth frames refused since start; the last one: {last} (docs/sensor-interface.md)"
        ),
        News::Text(text) => {
            let line = text.text();
            match text.severity() {
                MavSeverity::MAV_SEVERITY_WARNING => tracing::warn!("{at_s:8.2} s  {line}"),
                MavSeverity::MAV_SEVERITY_NOTICE | MavSeverity::MAV_SEVERITY_INFO | MavSeverity::MAV_SEVERITY_DEBUG => {
                    tracing::info!("{at_s:8.2} s  {line}")
                }
                _ => tracing::error!("{at_s:8.2} s  {line}"),
            }
        }
        News::Slips(total) => tracing::warn!("{at_s:8.2} s  {total} steps missed since start"),
    }
}
