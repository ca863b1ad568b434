//! The simulator as a process: real time with sockets and shared memory, or lockstep with a firmware process.

use crate::lockstep_flight::fly_lockstep;
use crate::saved_state::state_file;
use crate::udp::ports_in_words;
use crate::vehicle_links::{LinksConfig, VehicleLinks};
use crate::world::Outcome;
use crate::{
    CompanionView, CourseChoice, Ending, LIDAR_SENSOR_ID, STEP_MS, SensorFault, SimConfig, Simulator, Start,
    VehicleChoice,
};
use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use vigil_autopilot::{ConfigError, EndpointConfig, LinkId, LinkRole};
use vigil_io::clock::{monotonic_ns, sleep_until, unix_us_at_zero};
use vigil_io::key_file::frame_key;
use vigil_io::shared_memory::{DEPTH_TOPIC, Domain, FramePublisher, LockstepClient, LockstepError};
use vigil_types::{
    DEPTH_COLS, DEPTH_FULL_SCALE_M, DEPTH_ROWS, DepthFrame, FrameKey, GuidanceState, Nanos, Reasons, STEP_NS,
};

/// Later than this, the simulation has stood still (a suspended machine, a debugger, a stopped process); what is less is caught up with.
const STANDSTILL_NS: Nanos = 250_000_000;
/// Real time between two looks at the sockets, in milliseconds of physics.
const SLICE_MS: u64 = 2;
/// Steps between two status lines: five a second.
pub(crate) const STATUS_STEPS: u64 = 4;
/// How often the vehicle's state is looked at for changes to store.
const SAVE_MS: u64 = 1000;
/// Exit code when Ctrl-C ends a flight in lockstep.
const INTERRUPTED: u8 = 130;
/// How long lockstep waits for the firmware before it names it as missing.
const LOCKSTEP_TIMEOUT: Duration = Duration::from_secs(10);

/// Arguments of `vigil sim`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil sim                             a vehicle on the ground of a random validation course, MAVLink on 14540 and 14550
  vigil sim --course my.toml            on your own course
  vigil sim --instance 1                a second one beside it, for scripts on port 14541
  vigil sim --link tcpin://127.0.0.1:5760 --link serial:///dev/ttyUSB0:57600,unsigned=always
                                        two further links for ground stations
  vigil sim --signing-key vigil.key --allow-unsigned never
                                        obeys signed packets only (docs/mavlink.md, Signing)
  vigil sim --vehicle-model px4-sih --noisy-estimate
                                        a vehicle that answers as PX4's own simulated one does
  vigil sim --sensor-fault frozen@8     the LiDAR shows the same image from 8 s on
  vigil sim --lockstep --seed 7         lockstep with `vigil firmware --lockstep`; prints the flight's record")]
pub struct SimArgs {
    /// Course to fly.
    #[command(flatten)]
    pub course: CourseChoice,

    /// Number of this set of processes; ports and shared memory follow from it.
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=99))]
    pub instance: u32,

    /// Simulation file (TOML) that changes LiDAR, vehicle, sensors or wind; see docs/simulation.md.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,

    /// Vehicle to simulate.
    #[command(flatten)]
    pub vehicle: VehicleChoice,

    /// Begin hovering at flight height, armed, in Hold.
    #[arg(long)]
    pub airborne: bool,

    /// Let the LiDAR fail, from the start or from a moment on (docs/sensor-faults.md).
    #[arg(long, value_name = "MODE[@SECONDS|@random]")]
    pub sensor_fault: Option<SensorFault>,

    /// So many small time-of-flight sensors of 45° each beside the LiDAR, side by side, sent as OBSTACLE_DISTANCE (docs/second-sensor.md).
    #[arg(long, value_name = "COUNT", default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..=5))]
    pub second_sensor_heads: u8,

    /// Take turns with a firmware process instead of running in real time, and end with the flight.
    #[arg(long)]
    pub lockstep: bool,

    /// The frame service to publish on; another than `depth` leaves room for a process in between (`vigil adversary`).
    #[arg(long, value_name = "TOPIC", default_value = DEPTH_TOPIC, conflicts_with = "lockstep")]
    pub frames: String,

    /// Links to others.
    #[command(flatten)]
    pub links: LinksConfig,

    /// File with the secret of the depth frames' key, as the sensor's driver has it: 64 hexadecimal digits or 32 bytes, mode 0600. Without it
    /// frames carry no tag.
    #[arg(long, value_name = "FILE")]
    pub frame_key: Option<PathBuf>,

    /// Folder that keeps the vehicle's parameters and plans over restarts. Without it they end with the process.
    #[arg(long, value_name = "DIR", conflicts_with = "lockstep")]
    pub state: Option<PathBuf>,

    /// Print one JSON status line five times a second to standard output.
    #[arg(long, conflicts_with = "lockstep")]
    pub status: bool,

    /// End this many seconds after the flight ended (the default is to go on until Ctrl-C).
    #[arg(long, value_name = "SECONDS", value_parser = crate::config::seconds, conflicts_with = "lockstep")]
    pub end_after: Option<f64>,
}

/// One status line of a real-time simulation.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Status {
    /// Simulated seconds since the simulator's start.
    pub time_s: f64,
    /// The same moment on the clock that simulator and firmware share.
    pub at_ns: Nanos,
    /// True position, metres from home.
    pub position_ned_m: [f32; 3],
    /// True attitude, body to NED: w, x, y, z.
    pub attitude: [f32; 4],
    /// True speed.
    pub speed_m_s: f32,
    /// Horizontal distance to the goal.
    pub goal_distance_m: f32,
    /// The vehicle's flight mode.
    pub mode: String,
    /// Motors armed.
    pub armed: bool,
    /// Guidance state as in the firmware's telemetry; absent while nothing was heard.
    pub guidance: Option<String>,
    /// Reasons as in the firmware's telemetry.
    pub reasons: Vec<String>,
    /// The newest depth frame as the sensor took it, small: [`NEARNESS_ROWS`] rows of [`NEARNESS_COLS`] digits of how near the nearest
    /// return is: 9 is within a metre, 0 nothing within 9 m.
    #[serde(default)]
    pub nearness: String,
    /// The detector's last score as in the firmware's telemetry; absent while it sent none.
    #[serde(default)]
    pub score: Option<f32>,
    /// Execution time of a recent firmware step, microseconds.
    pub step_us: f32,
    /// Steps the firmware missed.
    pub slips: u64,
    /// How the flight ended, once it has.
    pub outcome: Option<Outcome>,
    /// Seconds from lift-off to the ending.
    pub flight_time_s: f64,
    /// Metres flown from lift-off to the ending.
    pub path_length_m: f64,
    /// Of a foreign vehicle: why its pose cannot be rendered; absent while it can.
    #[serde(default)]
    pub pose: Option<String>,
}

impl Status {
    /// What is said of every vehicle in the same way: the firmware's telemetry, the frame, the ending.
    pub(crate) fn of(companion: &CompanionView, nearness: &str, ending: Option<Ending>) -> Self {
        let state = companion.state_code.and_then(GuidanceState::from_code);
        let reasons = Reasons(companion.reason_bits);
        Self {
            guidance: state.map(|state| state.name().to_owned()),
            reasons: reasons.iter().map(|reason| reason.name().to_owned()).collect(),
            nearness: nearness.to_owned(),
            score: companion.score,
            step_us: companion.step_us,
            slips: companion.slips,
            outcome: ending.map(|e| e.outcome),
            flight_time_s: ending.map_or(0.0, |e| e.flight_time_s),
            ..Self::default()
        }
    }
}

/// Runs the simulator until its end or Ctrl-C.
///
/// # Errors
/// Course and configuration errors (file, line, field), a port in use, a second simulator on the same instance, a
/// firmware missing in lockstep.
pub fn run(args: SimArgs) -> Result<ExitCode> {
    let config = configure(&args)?;
    let stop = vigil_io::interrupt::set_by_interrupt()?;
    let domain = Domain::open(args.instance, "simulator")?;
    if args.lockstep {
        run_lockstep(&args, &config, &domain, stop)
    } else {
        run_real_time(&args, &config, &domain, &stop)
    }
}

fn configure(args: &SimArgs) -> Result<SimConfig> {
    let seed = args.course.seed_or_random();
    let models = args.vehicle.models(args.config.as_deref())?;
    let mut config = SimConfig::with_models(args.course.load(seed)?, seed, models);
    config.start = if args.airborne { Start::Airborne } else { Start::Ground };
    config.sensor_fault = args.sensor_fault;
    config.second_sensor_heads = args.second_sensor_heads.into();
    config.frame_key = lidar_key(args.frame_key.as_deref())?;
    if let Some(folder) = &args.state {
        config.saved = state_file(folder, args.instance).load()?;
    }
    if !args.lockstep {
        // In lockstep nobody else is on the link, and the flight must not depend on the instance.
        let extra = args.links.link.iter().map(|_| LinkRole::Gcs);
        let started_ns = monotonic_ns();
        config.endpoint = EndpointConfig {
            system_id: (args.instance + 1) as u8,
            links: LinkRole::ALL.into_iter().chain(extra).collect(),
            // The machine's time, on the clock that the endpoint's steps have.
            unix_time_at_zero_us: unix_us_at_zero(started_ns),
            started_ns,
            ..EndpointConfig::default()
        };
    }
    Ok(config)
}

/// The key of the LiDAR's frames, if they have one.
pub(crate) fn lidar_key(file: Option<&Path>) -> Result<Option<FrameKey>> {
    Ok(file.map(|path| frame_key(path, LIDAR_SENSOR_ID)).transpose()?)
}

/// The simulator; a state that it refuses is named with file and line.
fn simulator(args: &SimArgs, config: &SimConfig, epoch_ns: Nanos) -> Result<Simulator> {
    Simulator::new(config, epoch_ns).map_err(|error| match (error.downcast_ref(), &args.state) {
        (Some(ConfigError::Plan { .. } | ConfigError::Parameter(_)), Some(folder)) => {
            let message = error.to_string();
            let names = config.saved.parameters.keys();
            let key = names
                .filter(|name| message.contains(name.as_str()))
                .max_by_key(|name| name.len());
            state_file(folder, args.instance)
                .refused_at(key.map_or("", String::as_str), &message)
                .into()
        }
        _ => error,
    })
}

/// Prints something for a person at once.
pub(crate) fn announce(text: &str) {
    // Where nobody listens, nothing can be said; the vehicle does not end for it.
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// What a person reads at start, a line for each thing.
fn start_lines(args: &SimArgs, config: &SimConfig) -> String {
    let place = match config.start {
        Start::Ground => "on the ground",
        Start::Airborne => "hovering",
    };
    let links = &args.links;
    let extra: String = links.link.iter().map(|link| format!(", and {link}")).collect();
    let signing = match &links.signing_key {
        Some(file) => format!("signed with {}", file.display()),
        None if links.accept_first_key => "not signed until SETUP_SIGNING brings a key".to_owned(),
        None => "not signed".to_owned(),
    };
    let unsigned = links.allow_unsigned.in_words();
    format!(
        "simulator  instance {}: {}, seed {}, vehicle {place}\n\
         links      MAVLink on UDP 127.0.0.1: {}{extra}\n\
         frames     on `{}` in shared memory\n\
         signing    {signing}, {unsigned}\n\
         end        Ctrl-C or SIGTERM",
        args.instance,
        config.course.name,
        config.seed,
        ports_in_words(args.instance),
        args.frames
    )
}

fn run_lockstep(args: &SimArgs, config: &SimConfig, domain: &Domain, stop: Arc<AtomicBool>) -> Result<ExitCode> {
    let mut simulator = simulator(args, config, 0)?;
    announce(&format!(
        "simulator  instance {}: {}, seed {}, in lockstep with `vigil firmware --lockstep`, for which it waits {} s\n\
         end        with the flight, or Ctrl-C or SIGTERM",
        args.instance,
        config.course.name,
        config.seed,
        LOCKSTEP_TIMEOUT.as_secs()
    ));
    let interrupted = |steps: u64| {
        announce(&format!("interrupted after {steps} steps"));
        Ok(ExitCode::from(INTERRUPTED))
    };
    let mut client = match LockstepClient::connect(domain, LOCKSTEP_TIMEOUT, move || stop.load(Ordering::Relaxed)) {
        Err(LockstepError::Cancelled) => return interrupted(0),
        client => client?,
    };
    let mut steps = 0;
    let limit_s = f64::from(config.course.time_limit_s);
    let flown = fly_lockstep(&mut simulator, limit_s, |step, now_ns, frame, received, sent| {
        steps = step;
        client.exchange(step, now_ns, Some(frame), received, sent)
    });
    let record = match flown {
        Err(LockstepError::Cancelled) => {
            // A firmware that does not answer even this ends by itself.
            let _ = client.finish(steps);
            return interrupted(steps);
        }
        record => record?,
    };
    client.finish(record.steps)?;
    vigil_types::files::print_line(&serde_json::to_string(&record)?)?;
    Ok(ExitCode::from(ending_code(simulator.ending().map(|e| e.outcome))))
}

/// Exit code of a flight: 0 success, 10 collision, 11 out of bounds, 12 time-out, 13 no flight.
pub fn ending_code(outcome: Option<Outcome>) -> u8 {
    match outcome {
        Some(Outcome::Success) => 0,
        Some(Outcome::Collision) => 10,
        Some(Outcome::OutOfBounds) => 11,
        Some(Outcome::TimeOut) => 12,
        None => 13,
    }
}

/// What has arrived on the links, to the vehicle.
fn receive(links: &mut VehicleLinks, simulator: &mut Simulator, companion: &mut CompanionView) {
    links.receive(simulator.now_ns(), |link, peer, datagram| {
        if link == LinkId::ONBOARD {
            companion.observe(datagram);
        }
        simulator.receive_from(link.0, peer, datagram);
    });
    if let Some(text) = links.refused_key() {
        simulator.endpoint.warn(text);
    }
    if let Some(setup) = simulator.endpoint.take_signing_setup() {
        links.set_key(&setup);
    }
}

fn run_real_time(args: &SimArgs, config: &SimConfig, domain: &Domain, stop: &AtomicBool) -> Result<ExitCode> {
    let mut links = VehicleLinks::open(args.instance, &args.links)?;
    let mut publisher = FramePublisher::create(domain, &args.frames)?;
    // Frames are taken at multiples of the step on the shared clock, which is where the firmware expects them.
    let mut epoch_ns = monotonic_ns().next_multiple_of(STEP_NS);
    let mut simulator = simulator(args, config, epoch_ns)?;
    announce(&start_lines(args, config));
    let mut state = args.state.as_ref().map(|folder| state_file(folder, args.instance));
    let mut companion = CompanionView::default();
    let mut elapsed_ms = 0u64;
    let mut ended_at_ms = None;
    let mut seen = String::new();
    tracing::info!(
        course = config.course.name,
        seed = config.seed,
        instance = args.instance,
        "simulator is running"
    );

    while !stop.load(Ordering::Relaxed) {
        let due_ns = epoch_ns + elapsed_ms * 1_000_000;
        sleep_until(due_ns);
        let late_ns = monotonic_ns().saturating_sub(due_ns) / STEP_NS * STEP_NS;
        if late_ns >= STANDSTILL_NS {
            epoch_ns += late_ns;
            simulator.stood_still(late_ns);
            tracing::warn!("stood still for {:.1} s", late_ns as f64 * 1e-9);
        }
        receive(&mut links, &mut simulator, &mut companion);
        for _ in 0..SLICE_MS {
            simulator.advance_1ms();
        }
        elapsed_ms += SLICE_MS;
        simulator
            .endpoint
            .transmit(|link, is_telemetry, datagram| links.send(link, is_telemetry, datagram));
        if elapsed_ms.is_multiple_of(u64::from(STEP_MS)) {
            // A reader that is not there is no fault of the simulator's: frames are published regardless.
            let is_due = args.status && (elapsed_ms / u64::from(STEP_MS)).is_multiple_of(STATUS_STEPS);
            publisher.publish_with(|frame| {
                simulator.capture(frame);
                if is_due {
                    seen = nearness(frame);
                }
            })?;
            if is_due && !print_status(&status(&simulator, &companion, &seen, elapsed_ms))? {
                break;
            }
        }
        if elapsed_ms.is_multiple_of(SAVE_MS)
            && let Some(state) = &mut state
        {
            state.store(&simulator.endpoint.saved());
        }
        let Some(ending) = simulator.ending() else {
            // A vehicle that was mended begins another flight.
            ended_at_ms = None;
            continue;
        };
        let since_ms = *ended_at_ms.get_or_insert_with(|| {
            tracing::info!(outcome = %ending.outcome, time_s = ending.flight_time_s, "the flight ended");
            elapsed_ms
        });
        let lasted_s = (elapsed_ms - since_ms) as f64 * 1e-3;
        if args.end_after.is_some_and(|end_s| lasted_s >= end_s) {
            break;
        }
    }
    if let Some(state) = &mut state {
        state.store(&simulator.endpoint.saved());
    }
    if args.status {
        print_status(&status(&simulator, &companion, &seen, elapsed_ms))?;
    }
    tell_refused(&simulator, &links);
    let ending = simulator.ending().map(|e| e.outcome);
    Ok(ExitCode::from(args.end_after.map_or(0, |_| ending_code(ending))))
}

/// What the vehicle and its links refused, if anything.
fn tell_refused(simulator: &Simulator, links: &VehicleLinks) {
    let endpoint = simulator.status();
    let refused = endpoint.refusals.named().into_iter().chain(links.signing().refusals());
    let listed: Vec<String> = refused
        .filter(|(_, count)| *count > 0)
        .map(|(what, count)| format!("{count} {what}"))
        .collect();
    if !listed.is_empty() {
        tracing::info!("refused: {}", listed.join(", "));
    }
}

/// Columns of [`Status::nearness`].
pub const NEARNESS_COLS: usize = 64;
/// Its rows.
pub const NEARNESS_ROWS: usize = 8;

/// A frame as [`Status::nearness`] has it.
pub(crate) fn nearness(frame: &DepthFrame) -> String {
    const SQUARE: (usize, usize) = (DEPTH_ROWS / NEARNESS_ROWS, DEPTH_COLS / NEARNESS_COLS);
    let mut nearest = [[1.0_f32; NEARNESS_COLS]; NEARNESS_ROWS];
    for (r, row) in frame.depth.chunks_exact(DEPTH_COLS).enumerate() {
        for (c, range) in row.iter().enumerate() {
            let seen = &mut nearest[r / SQUARE.0][c / SQUARE.1];
            *seen = seen.min(*range);
        }
    }
    let digit = |range: &f32| char::from(b'0' + (10.0 - range * DEPTH_FULL_SCALE_M).clamp(0.0, 9.0) as u8);
    nearest.as_flattened().iter().map(digit).collect()
}

fn status(simulator: &Simulator, companion: &CompanionView, nearness: &str, elapsed_ms: u64) -> Status {
    let truth = simulator.truth();
    let endpoint = simulator.status();
    Status {
        time_s: elapsed_ms as f64 * 1e-3,
        at_ns: simulator.now_ns(),
        position_ned_m: truth.position_ned_m.to_array(),
        attitude: [truth.attitude.w, truth.attitude.x, truth.attitude.y, truth.attitude.z],
        speed_m_s: truth.velocity_ned_m_s.norm(),
        goal_distance_m: simulator.goal_distance_m(),
        mode: endpoint.mode.name().to_owned(),
        armed: endpoint.armed,
        path_length_m: simulator.path_length_m(),
        ..Status::of(companion, nearness, simulator.ending())
    }
}

/// `false` means that nobody reads any more: that ends the simulator like Ctrl-C.
pub(crate) fn print_status(status: &Status) -> Result<bool> {
    let mut out = std::io::stdout().lock();
    match writeln!(out, "{}", serde_json::to_string(status)?).and_then(|()| out.flush()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(false),
        written => written.map(|()| true).context("cannot write standard output"),
    }
}
