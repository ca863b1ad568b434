//! The sensor of a foreign vehicle as a process: depth frames of a course at 20 Hz from the pose that is heard.

use super::flight::{ForeignConfig, ForeignFlight, PoseState};
use super::pose_link::PoseLink;
use crate::program::{STATUS_STEPS, Status, announce, ending_code, lidar_key, nearness, print_status};
use crate::world::Course;
use crate::{CompanionView, CourseChoice, SensorFault, VehicleChoice};
use anyhow::{Result, ensure};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::Ordering;
use vigil_io::clock::{monotonic_ns, sleep_until};
use vigil_io::gate::AllowUnsigned;
use vigil_io::link_spec::LinkSpec;
use vigil_io::shared_memory::{DEPTH_TOPIC, Domain, FramePublisher};
use vigil_types::{Nanos, NedVector, STEP_NS, VehicleMode};

/// Time between two looks at the links.
const SLICE_NS: Nanos = 2_000_000;
/// What keeps frames from being rendered is said again this often.
const TELL_NS: Nanos = 10_000_000_000;
/// A state of the pose that lasted shorter than this is not worth a word.
const BRIEF_NS: Nanos = 1_000_000_000;

/// Arguments of `vigil sensor render`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil sensor render --seed 7 --pose udpin://127.0.0.1:14540   validation course 7 around PX4's simulation
  vigil sensor render --course my.toml --pose tcpout://127.0.0.1:5763
                                                                ... around ArduPilot's
  vigil sensor render --seed 7 --pose udpin://127.0.0.1:14540 --truth
                                                                the true pose, where the simulator sends it
`vigil fly --vehicle px4|ardupilot --link URL` starts it together with the firmware (docs/foreign-vehicles.md).

Exit code: 0 ended on request; with --end-after 0 goal reached, 10 collision, 11 out of bounds, 12 time-out, 13 no flight; 1 error.")]
pub struct RenderArgs {
    /// Course to fly.
    #[command(flatten)]
    pub course: CourseChoice,

    /// Where the vehicle's pose is heard: a URL as of `vigil firmware --link`, with the options system=ID and
    /// unsigned=loopback|never|always. May be repeated: the newest report counts.
    #[arg(long, value_name = "URL[,OPTION]", required = true)]
    pub pose: Vec<LinkSpec>,

    /// Render and referee the true pose (HIL_STATE_QUATERNION) instead of what the vehicle believes; for simulators that send it.
    #[arg(long)]
    pub truth: bool,

    /// Number of this set of processes; shared memory follows from it.
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=99))]
    pub instance: u32,

    /// Simulation file (TOML), of which the LiDAR's table counts; see docs/simulation.md.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,

    /// Let the LiDAR fail, from the start or from a moment on (docs/sensor-faults.md).
    #[arg(long, value_name = "MODE[@SECONDS|@random]")]
    pub sensor_fault: Option<SensorFault>,

    /// The frame service to publish on.
    #[arg(long, value_name = "TOPIC", default_value = DEPTH_TOPIC)]
    pub frames: String,

    /// From whom packets without a signature are accepted: from this machine, nobody, everybody.
    #[arg(long, value_name = "WHO", value_enum, default_value_t)]
    pub allow_unsigned: AllowUnsigned,

    /// File with the secret of the depth frames' key: 64 hexadecimal digits or 32 bytes, mode 0600.
    #[arg(long, value_name = "FILE")]
    pub frame_key: Option<PathBuf>,

    /// Print one JSON status line five times a second to standard output.
    #[arg(long)]
    pub status: bool,

    /// End this many seconds after the flight ended (the default is to go on until Ctrl-C).
    #[arg(long, value_name = "SECONDS", value_parser = crate::config::seconds)]
    pub end_after: Option<f64>,
}

/// Runs the sensor until its end or Ctrl-C.
///
/// # Errors
/// Course and configuration errors, a link or a frame service in use.
pub fn run(args: &RenderArgs) -> Result<ExitCode> {
    let seed = args.course.seed_or_random();
    let course = args.course.load(seed)?;
    begins_at_home(&course)?;
    let (links, system) = PoseLink::open_all(&args.pose, args.allow_unsigned)?;
    let config = ForeignConfig {
        lidar: VehicleChoice::default().models(args.config.as_deref())?.lidar,
        seed,
        sensor_fault: args.sensor_fault,
        frame_key: lidar_key(args.frame_key.as_deref())?,
        system,
        truth: args.truth,
    };
    let stop = vigil_io::interrupt::set_by_interrupt()?;
    let domain = Domain::open(args.instance, "sensor")?;
    let mut publisher = FramePublisher::create(&domain, &args.frames)?;
    let epoch_ns = monotonic_ns().next_multiple_of(STEP_NS);
    let mut sensor = Sensor {
        flight: ForeignFlight::new(&course, &config, epoch_ns)?,
        links,
        companion: CompanionView::default(),
        poses: PosesSaid::default(),
        seen: String::new(),
    };
    announce(&start_lines(args, &course, seed));
    let (mut now_ns, mut due_ns, mut ended_ns) = (epoch_ns, epoch_ns, None);
    while !stop.load(Ordering::Relaxed) {
        sleep_until(now_ns);
        sensor.listen(monotonic_ns());
        if now_ns >= due_ns {
            // A stall is not made up for by a burst of old frames.
            let at_ns = now_ns / STEP_NS * STEP_NS;
            due_ns = at_ns + STEP_NS;
            let step = (at_ns - epoch_ns) / STEP_NS;
            let is_due = args.status && step.is_multiple_of(STATUS_STEPS);
            sensor.publish(at_ns, &mut publisher, is_due)?;
            sensor.poses.say(at_ns, &sensor.flight);
            if is_due && !print_status(&sensor.status(at_ns))? {
                break;
            }
        }
        if sensor.flight.ending().is_some() || sensor.flight.pose_state(now_ns).is_final() {
            let since_ns = now_ns - *ended_ns.get_or_insert(now_ns);
            if args.end_after.is_some_and(|s| since_ns as f64 >= s * 1e9) {
                break;
            }
        }
        now_ns = (now_ns + SLICE_NS).max(monotonic_ns() / SLICE_NS * SLICE_NS);
    }
    if args.status {
        print_status(&sensor.status(now_ns))?;
    }
    let ending = sensor.flight.ending().map(|e| e.outcome);
    Ok(ExitCode::from(args.end_after.map_or(0, |_| ending_code(ending))))
}

/// The vehicle is where it is: nobody puts it at a course's start.
fn begins_at_home(course: &Course) -> Result<()> {
    ensure!(
        course.start_ned_m() == NedVector::ZERO,
        "{}: the course begins at the vehicle's home: set start.north_m and start.east_m to 0",
        course.name
    );
    Ok(())
}

fn start_lines(args: &RenderArgs, course: &Course, seed: u64) -> String {
    let links: Vec<String> = args.pose.iter().map(ToString::to_string).collect();
    format!(
        "sensor     instance {}: {}, seed {seed}, around the {} of the vehicle heard on {}\n\
         frames     on `{}` in shared memory\n\
         end        Ctrl-C or SIGTERM",
        args.instance,
        course.name,
        if args.truth { "true pose" } else { "pose" },
        links.join(" and "),
        args.frames
    )
}

struct Sensor {
    flight: ForeignFlight,
    links: Vec<PoseLink>,
    companion: CompanionView,
    poses: PosesSaid,
    seen: String,
}

impl Sensor {
    fn listen(&mut self, now_ns: Nanos) {
        for link in &mut self.links {
            link.receive(now_ns, |datagram| {
                self.companion.observe(datagram);
                self.flight.receive(now_ns, datagram);
            });
        }
        let vehicle = &self.flight.vehicle;
        let wants_places = vehicle.home_ned_m().is_none() || !vehicle.is_origin_known();
        for link in &mut self.links {
            link.ask(now_ns, self.flight.wants_truth, wants_places);
            link.others_put_aside().iter().for_each(|line| announce(line));
        }
    }

    fn publish(&mut self, now_ns: Nanos, publisher: &mut FramePublisher, looks: bool) -> Result<()> {
        // Not tracked: nothing is published. The firmware holds for its frame's age, and says so.
        if self.flight.pose_state(now_ns) == PoseState::Tracking {
            publisher.publish_with(|frame| {
                self.flight.capture(now_ns, frame);
                if looks {
                    self.seen = nearness(frame);
                }
            })?;
        }
        Ok(())
    }

    fn status(&self, now_ns: Nanos) -> Status {
        let flight = &self.flight;
        let heartbeat = flight.vehicle.telemetry.heartbeat;
        // JSON has no numbers that are none.
        let pose = (flight.pose(now_ns)).map(|(motion, turn)| (motion.position_ned_m, motion.velocity_ned_m_s, turn));
        let finite =
            pose.filter(|(place, velocity, turn)| place.is_finite() && velocity.is_finite() && turn.is_valid());
        let (position_ned_m, velocity_ned_m_s, attitude) = finite.unwrap_or_default();
        let state = flight.pose_state(now_ns);
        Status {
            time_s: (now_ns - flight.epoch_ns) as f64 * 1e-9,
            at_ns: now_ns,
            position_ned_m: position_ned_m.to_array(),
            attitude: [attitude.w, attitude.x, attitude.y, attitude.z],
            speed_m_s: velocity_ned_m_s.norm(),
            // JSON has no infinity.
            goal_distance_m: Some(flight.goal_distance_m(now_ns))
                .filter(|m| m.is_finite())
                .unwrap_or(0.0),
            mode: heartbeat.map_or(VehicleMode::Unknown, |h| h.mode).name().to_owned(),
            armed: heartbeat.is_some_and(|h| h.armed),
            path_length_m: flight.path_length_m(),
            pose: (state != PoseState::Tracking).then(|| state.name().to_owned()),
            ..Status::of(&self.companion, &self.seen, flight.ending())
        }
    }
}

/// What was said of the pose.
#[derive(Default)]
struct PosesSaid {
    state: Option<(PoseState, Nanos)>,
    said: Option<(PoseState, Nanos)>,
    ended: bool,
}

impl PosesSaid {
    /// Says it to a person, on change and again while there are no frames.
    fn say(&mut self, now_ns: Nanos, flight: &ForeignFlight) {
        let state = flight.pose_state(now_ns);
        self.state = self.state.filter(|(known, _)| *known == state);
        let (_, since_ns) = *self.state.get_or_insert((state, now_ns));
        let is_brief = now_ns - since_ns < BRIEF_NS && state != PoseState::Tracking;
        let is_late = |at_ns| state != PoseState::Tracking && now_ns - at_ns >= TELL_NS;
        let is_due = self.said.is_none_or(|(said, at_ns)| said != state || is_late(at_ns));
        if is_due && !is_brief {
            self.said = Some((state, now_ns));
            let whose = flight.system.map_or(String::new(), |id| format!(" (system {id})"));
            let other = match (state, flight.other_system) {
                (PoseState::TwoVehicles, Some(other)) => format!("; the other is system {other}"),
                _ => String::new(),
            };
            announce(&format!("pose       {}{whose}{other}", state.name()));
        }
        if let (false, Some(ending)) = (self.ended, flight.ending()) {
            self.ended = true;
            announce(&format!(
                "flight     {} after {:.1} s",
                ending.outcome, ending.flight_time_s
            ));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_course_that_does_not_begin_at_home_is_refused() {
        let mut course = crate::testing::field(0.0, 10.0, "");
        course.start.heading_deg = 20.0;
        begins_at_home(&course).expect("only turned");
        course.start.east_m = 1.5;
        let error = begins_at_home(&course).expect_err("elsewhere").to_string();
        assert!(error.starts_with("test: ") && error.contains("start.east_m"), "{error}");
    }
}
