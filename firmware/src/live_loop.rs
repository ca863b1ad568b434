//! A real-time flight: the fixed-rate loop over the monotonic clock, shared memory and MAVLink.

use crate::alarms::{AlarmTally, in_brackets};
use crate::config::FirmwareConfig;
use crate::console::Console;
use crate::frame_keeper::FrameRefusals;
use crate::rate::RateSchedule;
use crate::realtime::{self, Granted};
use crate::saved::ParameterStore;
use crate::service::ServiceManager;
use crate::stack::TickInput;
use crate::step::Firmware;
use crate::timing::{Durations, Spread};
use anyhow::{Result, anyhow};
use std::sync::atomic::{AtomicBool, Ordering};
use vigil_io::Link;
use vigil_io::clock::{monotonic_ns, sleep_until};
use vigil_io::links::LinkStatistics;
use vigil_io::router::{RoutedLinks, RoutingCounters};
use vigil_io::shared_memory::{DEPTH_TOPIC, Domain, FrameSubscriber};
use vigil_log::{LogPlace, Recorder, RecorderConfig, Scene, SceneError, epoch_offset_ns};
use vigil_mavlink::LinkCounters;
use vigil_mavlink::framing::FramingCounters;
use vigil_mavlink::signing::SigningCounters;
use vigil_types::{Datagrams, GuidanceState, Nanos, StepReport};

/// Steps between a request to end and the end: guidance brakes and sends zeros in them.
const FAREWELL_STEPS: u64 = 5;
/// The most of them while the vehicle, which flies by our setpoints, has not yet been seen to hold by itself.
const LET_GO_STEPS: u64 = 60;

/// What came of a flight.
#[derive(Debug, Clone, PartialEq)]
pub struct FlightSummary {
    /// Steps run.
    pub steps: u64,
    /// Steps missed.
    pub slips: u64,
    /// Time from wake-up to the end of a step.
    pub execution: Spread,
    /// Lateness of wake-ups.
    pub wake_late: Spread,
    /// Valid frames used.
    pub frames: u64,
    /// Frames refused, by reason.
    pub frames_refused: FrameRefusals,
    /// What the alarms came to.
    pub alarms: AlarmTally,
    /// Failures of the transport to receive.
    pub frame_failures: u64,
    /// What MAVLink refused or dropped.
    pub link: LinkCounters,
    /// What the vehicle's link did not take or could not deliver, and what signing refused on all links.
    pub line: LinkStatistics,
    /// What became of packets between the links.
    pub routing: RoutingCounters,
    /// Guidance state at the end.
    pub state: GuidanceState,
    /// The vehicle flew by our setpoints until the end: whether it was seen in a mode of its own before they ended.
    pub holds: Option<bool>,
    /// What became of the log, if there was one.
    pub log: Option<vigil_log::Summary>,
}

impl std::fmt::Display for FlightSummary {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (steps, slips, state) = (self.steps, self.slips, self.state.name());
        writeln!(f, "loop      {steps} steps, {slips} missed, ended in {state}")?;
        match self.holds {
            Some(true) => writeln!(f, "vehicle   holds by itself")?,
            Some(false) => writeln!(
                f,
                "vehicle   did not take its hold mode: its failsafe of lost setpoints follows (PX4: COM_OBL_RC_ACT, ArduPilot: GUID_TIMEOUT)"
            )?,
            None => {}
        }
        writeln!(f, "step      {}", self.execution)?;
        writeln!(f, "wake-up   {} late", self.wake_late)?;
        let (used, refused) = (self.frames, self.frames_refused.total());
        let reasons = in_brackets(self.frames_refused.by_reason(), "for their ");
        write!(f, "frames    {used} used, {refused} refused{reasons}")?;
        if self.frame_failures > 0 {
            write!(f, ", {} times the transport failed", self.frame_failures)?;
        }
        write!(f, "\nalarms    {}", self.alarms)?;
        let line = &self.line;
        if line.foreign + line.unsent > 0 {
            write!(
                f,
                "\nlink      {} of strangers not read, {} packets not sent for want of a peer or of room",
                line.foreign, line.unsent
            )?;
        }
        if line.connections > 1 {
            write!(f, "\nlink      connected {} times", line.connections)?;
        }
        if self.link.slow_streams > 0 {
            write!(
                f,
                "\nlink      {} times the vehicle's telemetry came too slowly and was asked for again",
                self.link.slow_streams
            )?;
        }
        write_routing(f, &self.routing)?;
        let damaged = |f: &FramingCounters| f.bad_crc + f.truncated + f.incompatible;
        let refused = damaged(&self.link.framing) + damaged(&line.framing) + self.link.unreadable;
        if refused > 0 {
            write!(
                f,
                "\nmavlink   {} packets, {refused} refused",
                self.link.framing.packets
            )?;
        }
        write_signing(f, &line.signing)?;
        match &self.log {
            None => write!(f, "\nlog       none"),
            Some(log) => {
                write!(f, "\nlog       {} ({} records", log.path.display(), log.records)?;
                if log.dropped > 0 {
                    write!(f, ", {} missing", log.dropped)?;
                }
                write!(f, ")")?;
                log.failure
                    .iter()
                    .try_for_each(|failure| write!(f, "\nlog       {failure}"))
            }
        }
    }
}

/// Nothing where nothing was passed on or refused.
fn write_routing(f: &mut std::fmt::Formatter<'_>, routing: &RoutingCounters) -> std::fmt::Result {
    let RoutingCounters {
        forwarded,
        over_rate,
        impostors,
        crowded_out,
    } = *routing;
    if forwarded + over_rate + impostors + crowded_out == 0 {
        return Ok(());
    }
    write!(
        f,
        "\nlinks     {forwarded} packets passed on, {} beyond a link's rate or share, {impostors} of impostors",
        over_rate + crowded_out
    )
}

/// Nothing where there was nothing to verify.
fn write_signing(f: &mut std::fmt::Formatter<'_>, signing: &SigningCounters) -> std::fmt::Result {
    if signing.signed + signing.refused() == 0 {
        return Ok(());
    }
    let (signed, unsigned, refused) = (signing.signed, signing.unsigned_allowed, signing.refused());
    let reasons = in_brackets(signing.refusals(), "");
    write!(
        f,
        "\nsigning   {signed} packets signed, {unsigned} unsigned accepted, {refused} refused{reasons}"
    )
}

/// The loop, ready to step. Not `Send`: it belongs to the thread that made it.
pub struct LiveLoop {
    schedule: RateSchedule,
    firmware: Firmware,
    frames: FrameSubscriber,
    /// How often the transport failed to receive; each shows as a missing frame.
    frame_failures: u64,
    links: RoutedLinks,
    /// What the links receive in the next step. A request of the person at the terminal is put there before: it reaches the flight
    /// stack as any operator's does, and is in the log.
    received: Box<Datagrams>,
    execution: Durations,
    wake_late: Durations,
    last: StepReport,
    used_frames: u64,
    alarms: AlarmTally,
    console: Console,
    parameters: Option<ParameterStore>,
    /// What flies: parameters that were kept are part of it.
    config: FirmwareConfig,
    _domain: Domain,
}

/// The grid of deadlines from now on.
fn schedule(config: &FirmwareConfig, now_ns: Nanos) -> RateSchedule {
    RateSchedule::new(now_ns, Nanos::from(config.rate.offset_ms) * 1_000_000)
}

fn no_thread(what: &str) -> impl Fn(std::io::Error) -> anyhow::Error {
    move |e| anyhow!("cannot start the {what}: {e}")
}

impl LiveLoop {
    /// Opens everything a flight needs; [`LiveLoop::start`] comes next.
    ///
    /// # Errors
    /// Whatever keeps the flight from beginning, each telling what to do.
    pub fn open(config: &FirmwareConfig) -> Result<Self> {
        // Before anything else that another firmware of this instance would change too.
        let domain = Domain::open_alone(config.instance, "firmware")?;
        // Parameters that were kept are part of the configuration that flies, and that the log holds.
        let mut config = config.clone();
        config.make_state_folder()?;
        let folder = config.state.directory.clone();
        let saved = folder.map(|folder| ParameterStore::load(&folder, &mut config));
        let saved = saved.transpose()?;
        let frames = FrameSubscriber::create(&domain, DEPTH_TOPIC)?;
        let links = RoutedLinks::open(&config.vehicle_link(), &config.links, config.gate()?)?;
        let frame_keys = config.frame_keys()?;
        let mut firmware = Firmware::of(&config)?;
        firmware.stack.require_frame_keys(frame_keys);
        let parameters = saved.map(|saved| saved.start(firmware.stack.companion.parameters()));
        let parameters = parameters
            .transpose()
            .map_err(no_thread("thread that stores parameters"))?;
        // What is refused leaves no empty log.
        if let Some(recorder) = recorder_config(&config)? {
            let epoch_offset_ns = epoch_offset_ns(monotonic_ns());
            firmware.record(Recorder::start(RecorderConfig {
                epoch_offset_ns,
                ..recorder
            })?);
        }
        let now_ns = monotonic_ns();
        Ok(Self {
            schedule: schedule(&config, now_ns),
            firmware,
            frames,
            frame_failures: 0,
            links,
            received: Box::default(),
            execution: Durations::default(),
            wake_late: Durations::default(),
            last: StepReport::default(),
            used_frames: 0,
            alarms: AlarmTally::new(config.is_monitored()),
            console: Console::start(now_ns).map_err(no_thread("console thread"))?,
            parameters,
            config,
            _domain: domain,
        })
    }

    /// Asks the system for real-time scheduling and locked memory, and starts the grid of deadlines now.
    pub fn start(&mut self) -> Granted {
        // The memory of a sensor that publishes already is mapped here, and not in a step.
        self.frame_failures += u64::from(self.frames.newest().is_err());
        // Last of all: everything is allocated, and the recorder's thread was started with its ordinary priority.
        let granted = realtime::request(self.config.rate.priority.into());
        self.schedule = schedule(&self.config, monotonic_ns());
        granted
    }

    /// Waits for the next deadline and runs one step. Allocates nothing in steady state.
    pub fn step(&mut self) -> &StepReport {
        sleep_until(self.schedule.next_deadline_ns());
        let now_ns = monotonic_ns();
        let timing = self.schedule.begin(now_ns);
        self.links.receive(now_ns, &mut self.received);
        let frame = self.frames.newest();
        self.frame_failures += u64::from(frame.is_err());
        let frame = frame.ok().flatten();
        let input = TickInput {
            now_ns,
            timing,
            frame: frame.as_deref(),
            frame_known_altered: false,
            received: &self.received,
        };
        let report = *self.firmware.step(&input, |sent| self.links.send(sent));
        self.received.clear();
        let stack = &mut self.firmware.stack;
        let (texts, refusals) = (stack.companion.status_texts(), stack.frames.refusals());
        self.console
            .observe(&report, texts, &self.links.statistics(), &refusals);
        if let Some(store) = &mut self.parameters {
            store.observe(stack.companion.parameters(), stack.guidance.taken_over());
        }
        self.alarms.observe(&report);
        if report.frame_sequence.is_some() && report.frame_sequence != self.last.frame_sequence {
            self.used_frames += 1;
        }
        self.last = report;
        self.wake_late.record(timing.wake_late_ns);
        let execution_ns = self.schedule.end(monotonic_ns());
        self.execution.record(execution_ns);
        &self.last
    }

    /// How long the last step took, from wake-up to its end.
    pub fn last_execution_ns(&self) -> u64 {
        self.schedule.timing().previous_execution_ns
    }

    /// Brakes, has the vehicle hold by itself while it is still sent zeros, closes the log.
    pub fn finish(mut self) -> FlightSummary {
        // What follows is the program's own end, and no person's take-over to be kept. Dropped last: it waits for its writer.
        let _store = self.parameters.take();
        let flew = self.last.has_vehicle();
        self.firmware.stack.disengage_command(&mut self.received);
        for step in 0..LET_GO_STEPS {
            if step >= FAREWELL_STEPS && !self.last.has_vehicle() {
                break;
            }
            self.step();
        }
        self.firmware.shut_down(monotonic_ns(), |sent| self.links.send(sent));
        FlightSummary {
            steps: self.schedule.timing().step,
            slips: self.schedule.timing().slips,
            execution: self.execution.spread(),
            wake_late: self.wake_late.spread(),
            frames: self.used_frames,
            frames_refused: self.firmware.stack.frames.refusals(),
            alarms: self.alarms,
            frame_failures: self.frame_failures,
            link: self.firmware.stack.companion.counters(),
            line: self.links.statistics(),
            routing: self.links.routing(),
            state: self.last.state,
            holds: flew.then(|| !self.last.has_vehicle()),
            log: self.firmware.finish(),
        }
    }
}

/// What the configuration says about the log.
///
/// # Errors
/// A scene file that is not usable.
pub fn recorder_config(config: &FirmwareConfig) -> Result<Option<RecorderConfig>, SceneError> {
    let Some(directory) = &config.log.directory else {
        return Ok(None);
    };
    Ok(Some(RecorderConfig {
        scene: config.log.scene.as_deref().map(Scene::load).transpose()?,
        content: config.log.content,
        ..RecorderConfig::new(LogPlace::Directory(directory.clone()), config.flight_info())
    }))
}

/// Flies until `stop` is set. `started` gets what flies, parameters that were kept included, and what the system granted, just before the
/// loop begins.
///
/// # Errors
/// As of [`LiveLoop::open`]; once the loop runs nothing ends it but `stop`.
pub fn fly(
    config: &FirmwareConfig,
    stop: &AtomicBool,
    started: impl FnOnce(&FirmwareConfig, &Granted),
) -> Result<FlightSummary> {
    let mut flight = LiveLoop::open(config)?;
    let manager = ServiceManager::find();
    let manager = manager.map_err(no_thread("thread that reports to the service manager"))?;
    let granted = flight.start();
    started(&flight.config, &granted);
    while !stop.load(Ordering::Relaxed) {
        let report = flight.step();
        if let Some(manager) = &manager {
            manager.observe(report);
        }
    }
    if let Some(manager) = manager {
        manager.end();
    }
    Ok(flight.finish())
}
