//! Tells a person what the loop does, from a thread of its own: writing to a terminal may wait, the loop may not.

use crate::frame_keeper::{FrameRefusals, Refusal};
use std::time::Duration;
use vigil_io::background::Background;
use vigil_mavlink::StatusText;
use vigil_mavlink::common::MavSeverity;
use vigil_types::{GuidanceState, Nanos, Reasons, StepReport};

/// Announcements that may wait to be printed; more are left out.
const CAPACITY: usize = 64;
/// How often the printer looks.
const PAUSE: Duration = Duration::from_millis(50);
/// Refused packets and frames are told of this often at most: an attacker must not fill the terminal.
const REFUSED_NS: Nanos = 10_000_000_000;

/// How the companion begins the text of a change of state.
const STATE_TEXT: &str = "guidance: ";

#[derive(Debug, Clone, Copy)]
#[allow(clippy::large_enum_variant, reason = "they wait in a ring that is allocated once")]
enum Announcement {
    State {
        at_ns: Nanos,
        from: GuidanceState,
        to: GuidanceState,
        reasons: Reasons,
    },
    Slips {
        at_ns: Nanos,
        total: u64,
    },
    Refused {
        at_ns: Nanos,
        total: u64,
    },
    OtherVehicle {
        at_ns: Nanos,
        system: u8,
    },
    FramesRefused {
        at_ns: Nanos,
        total: u64,
        last: Refusal,
    },
    Text {
        at_ns: Nanos,
        text: StatusText,
    },
}

/// Announces changes of the guidance state and missed steps.
pub struct Console {
    printer: Background<Announcement>,
    state: GuidanceState,
    slips: u64,
    refused: u64,
    refused_next_ns: Nanos,
    other_system: Option<u8>,
    frames_refused: u64,
    frames_next_ns: Nanos,
}

impl Console {
    /// Starts the printer; times are told relative to `start_ns`.
    ///
    /// # Errors
    /// When the thread cannot be started.
    pub fn start(start_ns: Nanos) -> std::io::Result<Self> {
        let print = move |announcements: &mut dyn Iterator<Item = Announcement>| {
            announcements.for_each(|announcement| print(announcement, start_ns));
        };
        Ok(Self {
            printer: Background::start("console", CAPACITY, PAUSE, print)?,
            state: GuidanceState::Standby,
            slips: 0,
            refused: 0,
            refused_next_ns: 0,
            other_system: None,
            frames_refused: 0,
            frames_next_ns: 0,
        })
    }

    /// Looks at a step. Never waits and allocates nothing.
    pub fn observe(&mut self, report: &StepReport) {
        let at_ns = report.now_ns;
        if report.state != self.state {
            self.announce(Announcement::State {
                at_ns,
                from: self.state,
                to: report.state,
                reasons: report.reasons,
            });
            self.state = report.state;
        }
        if report.timing.slips != self.slips {
            self.slips = report.timing.slips;
            self.announce(Announcement::Slips {
                at_ns,
                total: self.slips,
            });
        }
    }

    /// Is told what others are told by STATUSTEXT; changes of state it announces itself. Never waits and allocates nothing.
    pub fn text(&mut self, at_ns: Nanos, text: &StatusText) {
        if !text.text().starts_with(STATE_TEXT) {
            self.announce(Announcement::Text { at_ns, text: *text });
        }
    }

    /// Is told how many packets signing refused since start. Never waits and allocates nothing.
    pub fn refused(&mut self, at_ns: Nanos, total: u64) {
        if total > self.refused && at_ns >= self.refused_next_ns {
            self.refused = total;
            self.refused_next_ns = at_ns + REFUSED_NS;
            self.announce(Announcement::Refused { at_ns, total });
        }
    }

    /// Is told of a vehicle that calls and is not the one that is asked for. Never waits and allocates nothing.
    pub fn other_vehicle(&mut self, at_ns: Nanos, system: Option<u8>) {
        if let Some(system) = system
            && self.other_system.is_none()
        {
            self.other_system = Some(system);
            self.announce(Announcement::OtherVehicle { at_ns, system });
        }
    }

    /// Is told which frames were refused since start. Never waits and allocates nothing.
    pub fn frames_refused(&mut self, at_ns: Nanos, refusals: &FrameRefusals) {
        let total = refusals.total();
        if let Some(last) = refusals.last()
            && total > self.frames_refused
            && at_ns >= self.frames_next_ns
        {
            self.frames_refused = total;
            self.frames_next_ns = at_ns.saturating_add(REFUSED_NS);
            self.announce(Announcement::FramesRefused { at_ns, total, last });
        }
    }

    fn announce(&mut self, announcement: Announcement) {
        // Where too many wait it is lost; telemetry and log have it.
        self.printer.offer(announcement);
    }
}

fn print(announcement: Announcement, start_ns: Nanos) {
    let seconds = |at_ns: Nanos| at_ns.saturating_sub(start_ns) as f64 * 1e-9;
    match announcement {
        Announcement::State {
            at_ns,
            from,
            to,
            reasons,
        } => {
            let reasons: Vec<_> = reasons.iter().map(|reason| reason.name()).collect();
            tracing::info!(
                "{:8.2} s  {} → {}{}{}",
                seconds(at_ns),
                from.name(),
                to.name(),
                if reasons.is_empty() { "" } else { ": " },
                reasons.join(", ")
            );
        }
        Announcement::Refused { at_ns, total } => {
            tracing::warn!(
                "{:8.2} s  {total} packets refused since start: unsigned or wrongly signed (docs/firmware.md, \
                         \"Signing\")",
                seconds(at_ns)
            );
        }
        Announcement::OtherVehicle { at_ns, system } => {
            tracing::warn!(
                "{:8.2} s  a vehicle of system {system} calls, which is not the one asked for: give the link with \
                         system={system} if it is yours (docs/firmware.md, \"Who is the vehicle\")",
                seconds(at_ns)
            );
        }
        Announcement::FramesRefused { at_ns, total, last } => {
            tracing::warn!(
                "{:8.2} s  {total} depth frames refused since start; the last one: {last} (docs/sensor-interface.md)",
                seconds(at_ns)
            );
        }
        Announcement::Text { at_ns, text } => {
            let (seconds, told) = (seconds(at_ns), text.text());
            match text.severity() {
                MavSeverity::MAV_SEVERITY_WARNING => tracing::warn!("{seconds:8.2} s  {told}"),
                MavSeverity::MAV_SEVERITY_NOTICE | MavSeverity::MAV_SEVERITY_INFO | MavSeverity::MAV_SEVERITY_DEBUG => {
                    tracing::info!("{seconds:8.2} s  {told}")
                }
                _ => tracing::error!("{seconds:8.2} s  {told}"),
            }
        }
        Announcement::Slips { at_ns, total } => {
            tracing::warn!("{:8.2} s  {total} steps missed since start", seconds(at_ns));
        }
    }
}
