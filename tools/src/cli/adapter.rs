//! `vigil sensor ouster` and `vigil sensor z16`: what devices send becomes depth frames.

use crate::cli::output::{Interrupt, say, tell};
use anyhow::{Context, Result, bail};
use std::io::{ErrorKind, Read};
use std::net::{IpAddr, SocketAddr, UdpSocket};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::mpsc::{RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::time::Duration;
use vigil_io::clock::{monotonic_ns, sleep_until};
use vigil_io::gate::AllowUnsigned;
use vigil_io::key_file::frame_key;
use vigil_io::link_spec::LinkSpec;
use vigil_io::shared_memory::{DEPTH_TOPIC, Domain, FramePublisher, is_timely};
use vigil_mavlink::Vehicle;
use vigil_mavlink::framing::{FramingCounters, packets};
use vigil_sensors::adapters::{DepthStream, Fault, OusterAdapter, OusterDevice, PoseTrack, Tally};
use vigil_sensors::{Mount, Pinhole, View};
use vigil_sim::foreign::PoseLink;
use vigil_types::{Attitude, DepthFrame, FrameKey, FrdVector, Nanos, NedVector};

/// The device's packets are waited for so long before the vehicle's are looked at again.
const LOOK: Duration = Duration::from_millis(2);
/// Nothing for so long is worth a word.
const SILENCE_NS: Nanos = 500_000_000;
/// Room for the packets of some turns: a sensor sends 30 MB in a second.
const RECEIVE_BUFFER: usize = 4 << 20;
/// A metadata file is longer than this only by mistake.
const METADATA_LIMIT: u64 = 1 << 20;
/// Position and attitude that came farther apart are no pose, seconds.
const MOST_APART_S: f32 = 0.3;

/// The frames of a sensor: where they are published.
#[derive(Debug, Clone, clap::Args)]
pub struct ServiceArgs {
    /// Number of the set of processes.
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=99))]
    pub instance: u32,

    /// The frame service.
    #[arg(long, value_name = "TOPIC", default_value = DEPTH_TOPIC)]
    pub frames: String,

    /// The sensor's number.
    #[arg(long, default_value_t = 1)]
    pub sensor_id: u32,
}

/// What all adapters are given.
#[derive(Debug, Clone, clap::Args)]
pub struct CommonArgs {
    /// Where the sensor sits and how it is turned: metres forward, right and down of the vehicle's middle, then roll, pitch and yaw in
    /// degrees.
    #[arg(long, value_name = "X,Y,Z,ROLL,PITCH,YAW", value_parser = mount, default_value = "0,0,0,0,0,0", allow_hyphen_values = true)]
    mount: Mount,

    /// Where the vehicle's pose is heard: a URL as of `vigil firmware --link`. May be repeated.
    #[arg(long, value_name = "URL[,OPTION]", required_unless_present = "still")]
    pose: Vec<LinkSpec>,

    /// Instead of a vehicle: a level sensor that stands still this many metres above the ground, to be tried on the bench.
    #[arg(long, value_name = "METRES", conflicts_with = "pose")]
    still: Option<f32>,

    #[command(flatten)]
    service: ServiceArgs,

    /// File with the secret of the frames' key.
    #[arg(long, value_name = "FILE")]
    frame_key: Option<PathBuf>,

    /// From whom MAVLink packets without a signature are accepted: from this machine, nobody, everybody.
    #[arg(long, value_name = "WHO", value_enum, default_value_t)]
    allow_unsigned: AllowUnsigned,
}

/// Arguments of `vigil sensor ouster`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  vigil sensor ouster --metadata os0.json --pose udpin://0.0.0.0:14545 --mount 0.1,0,-0.05,0,0,0
  vigil sensor ouster --metadata os0.json --still 1.5        on the bench; beside it: vigil sensor check
The sensor sends LEGACY packets to this machine, 20 turns a second (lidar_mode 1024x20). What is refused is said on the terminal.

Exit code: 0 ended on request, 1 it could not begin. docs/sensor-interface.md, \"Adapters\".")]
pub struct OusterArgs {
    /// The sensor's metadata file (JSON), as its web page and its tools save it.
    #[arg(long, value_name = "FILE")]
    metadata: PathBuf,

    /// Where the packets arrive.
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "0.0.0.0:7502")]
    listen: SocketAddr,

    /// The sensor's address; packets of others are passed over.
    #[arg(long, value_name = "ADDRESS")]
    from: Option<IpAddr>,

    #[command(flatten)]
    common: CommonArgs,
}

/// Arguments of `vigil sensor z16`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "\
Examples:
  v4l2-ctl -d /dev/video2 --set-fmt-video=width=848,height=480,pixelformat='Z16 ' --stream-mmap --stream-to=- |
    vigil sensor z16 - --size 848,480 --focal 421.3,421.3 --centre 423.1,238.9 --pose udpin://0.0.0.0:14545
  vigil sensor z16 recorded.z16 --rate 30 --size 640,480 --focal 382,382 --centre 320,240 --still 1.5

A stream of images of 16-bit little-endian units one behind the other, rectified, depth along the camera's axis, 0 for no return.

Exit code: 0 the stream ended, or it ended on request; 1 it could not begin. docs/sensor-interface.md, \"Adapters\".")]
pub struct DepthStreamArgs {
    /// The stream: a file, a named pipe, or `-` for standard input.
    #[arg(value_name = "FILE")]
    input: PathBuf,

    /// Width and height, pixels.
    #[arg(long, value_name = "W,H", value_parser = pair::<usize>)]
    size: [usize; 2],

    /// Focal lengths, pixels.
    #[arg(long, value_name = "FX,FY", value_parser = pair::<f32>)]
    focal: [f32; 2],

    /// Principal point, pixels.
    #[arg(long, value_name = "CX,CY", value_parser = pair::<f32>)]
    centre: [f32; 2],

    /// Metres of a unit.
    #[arg(long, value_name = "METRES", default_value_t = 0.001)]
    unit: f32,

    /// How old an image is when it has arrived: exposure, matching and transfer, milliseconds.
    #[arg(long, value_name = "MS", default_value_t = 0)]
    latency_ms: u32,

    /// Images in a second of a recorded file; without it they are taken as they come.
    #[arg(long, value_name = "HZ", value_parser = clap::value_parser!(u32).range(1..=120))]
    rate: Option<u32>,

    #[command(flatten)]
    common: CommonArgs,
}

fn numbers<T: std::str::FromStr, const N: usize>(text: &str, what: &str) -> Result<[T; N], String> {
    let numbers: Option<Vec<T>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
    numbers
        .and_then(|numbers| numbers.try_into().ok())
        .ok_or_else(|| format!("{what} separated by commas are needed"))
}

fn pair<T: std::str::FromStr>(text: &str) -> Result<[T; 2], String> {
    numbers(text, "two numbers")
}

fn mount(text: &str) -> Result<Mount, String> {
    let [x, y, z, roll, pitch, yaw] = numbers::<f32, 6>(text, "six numbers")?;
    let turn = Attitude::from_euler_rad(roll.to_radians(), pitch.to_radians(), yaw.to_radians());
    Mount::new(FrdVector::new(x, y, z), turn).map_err(|e| e.to_string())
}

/// Where poses come from.
#[derive(Default)]
struct PoseSource {
    /// The sensor stands there, level, and nothing is heard.
    still_ned_m: Option<NedVector>,
    links: Vec<PoseLink>,
    vehicle: Vehicle,
    system: Option<u8>,
    counters: FramingCounters,
    track: PoseTrack,
}

impl PoseSource {
    fn open(args: &CommonArgs) -> Result<Self> {
        if let Some(height_m) = args.still
            && !(0.0..=1000.0).contains(&height_m)
        {
            bail!("--still {height_m}: a height from 0 to 1000 m is needed");
        }
        let (links, system) = PoseLink::open_all(&args.pose, args.allow_unsigned)?;
        Ok(Self {
            still_ned_m: args.still.map(|height_m| NedVector::new(0.0, 0.0, -height_m)),
            links,
            system,
            ..Self::default()
        })
    }

    /// Hears what arrived. Never waits.
    fn listen(&mut self, now_ns: Nanos) {
        for link in &mut self.links {
            link.receive(now_ns, |datagram| {
                for packet in packets(datagram, &mut self.counters) {
                    if packet.is_of_autopilot(&mut self.system) {
                        self.vehicle.receive(now_ns, &packet);
                    }
                }
            });
        }
        let telemetry = &self.vehicle.telemetry;
        if let (Some(position), Some(attitude)) = (telemetry.kinematics, telemetry.attitude) {
            // The position at the attitude's time.
            let lead_s = (attitude.at_ns as f64 - position.at_ns as f64) as f32 * 1e-9;
            if lead_s.abs() <= MOST_APART_S {
                let position_ned_m = position.position_ned_m + position.velocity_ned_m_s * lead_s;
                self.track.note(attitude.at_ns, position_ned_m, attitude.attitude);
            }
        }
        for link in &mut self.links {
            link.ask(now_ns, false, false);
        }
    }

    fn at(&self, stamp_ns: Nanos) -> Option<(NedVector, Attitude)> {
        let still = self
            .still_ned_m
            .map(|position_ned_m| (position_ned_m, Attitude::LEVEL_NORTH));
        still.or_else(|| self.track.at(stamp_ns))
    }
}

/// Whether a frame of this stamp may be published at `now_ns` after one of `last_ns`: timely, and newer.
fn may_follow(stamp_ns: Nanos, last_ns: Option<Nanos>, now_ns: Nanos) -> bool {
    is_timely(stamp_ns, now_ns) && last_ns.is_none_or(|last_ns| stamp_ns > last_ns)
}

/// Where images go, and what is said of those that are none.
struct Output {
    publisher: FramePublisher,
    key: Option<FrameKey>,
    pose: PoseSource,
    frame: Box<DepthFrame>,
    published: u64,
    tally: Tally,
    heard_ns: Nanos,
    /// So long a silence is the next that is worth a word.
    next_silence_ns: Nanos,
    /// The same after an image.
    silence_ns: Nanos,
    interrupt: Interrupt,
}

impl Output {
    fn open(args: &CommonArgs, what: &str, view: Option<View>) -> Result<Self> {
        let interrupt = Interrupt::on_ctrl_c()?;
        let (instance, frames, id) = (args.service.instance, &args.service.frames, args.service.sensor_id);
        let key = args.frame_key.as_ref().map(|path| frame_key(path, id)).transpose()?;
        let pose = PoseSource::open(args)?;
        let publisher = FramePublisher::create(&Domain::open(instance, "adapter")?, frames)?;
        let mut frame = Box::new(DepthFrame::EMPTY);
        frame.header.sensor_id = id;
        say!("device     {what}");
        let unproven = if key.is_some() { "" } else { ", not authenticated" };
        say!("frames     on `{frames}` of instance {instance}, sensor {id}{unproven}");
        if let Some(view) = view {
            say!("view       {view}");
            if !view.is_whole() {
                tell!(
                    "warning: where the device does not look frames show no return, which is free space to a pilot; the firmware holds (blind sensor) where the ground should be seen there"
                );
            }
        }
        Ok(Self {
            publisher,
            key,
            pose,
            frame,
            published: 0,
            tally: Tally::default(),
            heard_ns: monotonic_ns(),
            next_silence_ns: SILENCE_NS,
            silence_ns: SILENCE_NS,
            interrupt,
        })
    }

    fn heard(&mut self, now_ns: Nanos) {
        (self.heard_ns, self.next_silence_ns) = (now_ns, self.silence_ns);
    }

    fn refuse(&mut self, now_ns: Nanos, fault: Fault) {
        if let Some(line) = self.tally.note(now_ns, fault) {
            tell!("vigil: {line}");
        }
    }

    /// Hears the vehicle, and says where the device is silent.
    fn look_around(&mut self) {
        let now_ns = monotonic_ns();
        self.pose.listen(now_ns);
        let silent_ns = now_ns.saturating_sub(self.heard_ns);
        if silent_ns > self.next_silence_ns {
            self.next_silence_ns = silent_ns + 2 * SILENCE_NS;
            let since_s = silent_ns as f64 * 1e-9;
            self.refuse(now_ns, Fault::Silence { since_s });
        }
    }

    /// Publishes the image in the frame, taken at `stamp_ns`, with the newest that the vehicle said of its pose.
    fn publish(&mut self, stamp_ns: Nanos) -> Result<()> {
        let now_ns = monotonic_ns();
        self.pose.listen(now_ns);
        let last_ns = (self.published > 0).then_some(self.frame.header.stamp_ns);
        if !may_follow(stamp_ns, last_ns, now_ns) {
            let age_s = (now_ns as f64 - stamp_ns as f64) * 1e-9;
            self.refuse(now_ns, Fault::Stamp { age_s });
            return Ok(());
        }
        let Some((position_ned_m, attitude)) = self.pose.at(stamp_ns) else {
            self.refuse(now_ns, Fault::NoPose);
            return Ok(());
        };
        let header = &mut self.frame.header;
        (header.stamp_ns, header.sequence) = (stamp_ns, self.published);
        (header.position_ned_m, header.attitude) = (position_ned_m, attitude);
        match &self.key {
            Some(key) => self.frame.authenticate(key),
            None => self.frame.seal(),
        }
        self.publisher.publish(&self.frame)?;
        self.published += 1;
        Ok(())
    }

    fn end(&self) -> ExitCode {
        say!("frames     {} published", self.published);
        for line in self.tally.summary() {
            say!("refused    {line}");
        }
        ExitCode::SUCCESS
    }
}

/// Runs `vigil sensor ouster`.
///
/// # Errors
/// A metadata file that cannot be used, an address or a frame service in use.
pub fn ouster(args: &OusterArgs) -> Result<ExitCode> {
    let path = &args.metadata;
    let text = vigil_types::files::read_text(path, METADATA_LIMIT)
        .with_context(|| format!("--metadata {}", path.display()))?;
    let device = OusterDevice::from_metadata(&text).with_context(|| format!("--metadata {}", path.display()))?;
    let (beams, columns, turns, on) = (device.beams(), device.columns, device.rate_hz, args.listen);
    let what = format!("{beams} beams, {columns} columns, {turns} turns a second, on {on}");
    let mut adapter = OusterAdapter::new(device, args.common.mount)?;
    let socket = UdpSocket::bind(args.listen).with_context(|| format!("--listen {}", args.listen))?;
    socket.set_read_timeout(Some(LOOK))?;
    // The system may give less; then packets are lost sooner, which is said.
    let _ = rustix::net::sockopt::set_socket_recv_buffer_size(&socket, RECEIVE_BUFFER);
    let mut out = Output::open(&args.common, &what, adapter.view)?;
    if adapter.device.rate_hz < 20.0 {
        tell!(
            "warning: fewer than 20 turns a second: some steps of the loop have no new picture; lidar_mode 1024x20 is right"
        );
    }
    let mut buffer = vec![0; 1 << 16];
    while !out.interrupt.came() {
        match socket.recv_from(&mut buffer) {
            Ok((len, peer)) if args.from.is_none_or(|from| from == peer.ip()) => {
                let arrived_ns = monotonic_ns();
                out.heard(arrived_ns);
                match adapter.packet(&buffer[..len], arrived_ns, &mut out.frame.depth) {
                    Ok(Some(stamp_ns)) => out.publish(stamp_ns)?,
                    Ok(None) => {}
                    Err(fault) => out.refuse(arrived_ns, fault),
                }
            }
            Ok(_) => {}
            Err(e) => match e.kind() {
                ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted => {}
                _ => return Err(e).context("the socket of the sensor's packets"),
            },
        }
        out.look_around();
    }
    Ok(out.end())
}

/// Runs `vigil sensor z16`.
///
/// # Errors
/// A camera that cannot be, a file that cannot be read, a frame service in use.
pub fn z16(args: &DepthStreamArgs) -> Result<ExitCode> {
    let camera = Pinhole::new(args.size, args.focal, args.centre)?;
    let mut stream = DepthStream::new(camera, args.common.mount, args.unit)?;
    let shown = args.input.display();
    let mut input: Box<dyn Read + Send> = match args.input.to_str() {
        Some("-") => Box::new(std::io::stdin()),
        _ => Box::new(std::fs::File::open(&args.input).with_context(|| shown.to_string())?),
    };
    let [width, height] = args.size;
    let what = format!("{width} x {height} pixels of {} m, from {shown}", args.unit);
    let mut out = Output::open(&args.common, &what, Some(stream.view))?;
    let (sender, images) = sync_channel(1);
    let (bytes, rate) = (stream.image_bytes(), args.rate);
    if let Some(rate_hz) = rate {
        out.silence_ns = SILENCE_NS.max(2_000_000_000 / Nanos::from(rate_hz));
    }
    // Ends with the process where the stream does not.
    std::thread::spawn(move || read_images(&mut *input, bytes, rate, &sender));
    while !out.interrupt.came() {
        match images.recv_timeout(LOOK) {
            Ok(arrival) => {
                let (arrived_ns, image) = arrival.with_context(|| shown.to_string())?;
                out.heard(arrived_ns);
                match stream.image(&image, &mut out.frame.depth) {
                    Ok(()) => out.publish(arrived_ns.saturating_sub(u64::from(args.latency_ms) * 1_000_000))?,
                    // Less than an image is the rest of a stream that ended.
                    Err(fault) => out.refuse(arrived_ns, fault),
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break,
        }
        out.look_around();
    }
    Ok(out.end())
}

/// An image and when it arrived, or why there are no more.
type Arrival = std::io::Result<(Nanos, Vec<u8>)>;

/// Reads images until the stream's end. Of a live stream one that nobody is ready for is dropped: the next is newer.
fn read_images(input: &mut dyn Read, bytes: usize, rate_hz: Option<u32>, sender: &SyncSender<Arrival>) {
    let mut due_ns = monotonic_ns();
    loop {
        let mut image = Vec::with_capacity(bytes);
        match Read::take(&mut *input, bytes as u64).read_to_end(&mut image) {
            Ok(0) => return,
            Ok(_) => {}
            Err(error) => {
                let _ = sender.send(Err(error));
                return;
            }
        }
        let is_rest = image.len() < bytes;
        if let Some(hz) = rate_hz {
            sleep_until(due_ns);
            due_ns += 1_000_000_000 / u64::from(hz);
        }
        let arrival = Ok((monotonic_ns(), image));
        let is_wanted = match rate_hz.is_some() || is_rest {
            true => sender.send(arrival).is_ok(),
            false => !matches!(sender.try_send(arrival), Err(TrySendError::Disconnected(_))),
        };
        if !is_wanted {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vigil_mavlink::common::MavAutopilot;
    use vigil_mavlink::framing::encode;
    use vigil_mavlink::message;
    use vigil_types::STEP_NS;

    #[test]
    fn a_stamp_of_long_ago_of_the_future_or_not_newer_than_the_last_is_no_frame() {
        const NOW_NS: Nanos = 90_000_000_000;
        const OLDEST_NS: Nanos = 1_000_000_000;
        assert!(may_follow(NOW_NS - OLDEST_NS, None, NOW_NS) && may_follow(NOW_NS + STEP_NS, None, NOW_NS));
        assert!(!may_follow(NOW_NS - OLDEST_NS - 1, None, NOW_NS) && !may_follow(NOW_NS + STEP_NS + 1, None, NOW_NS));
        assert!(may_follow(NOW_NS, Some(NOW_NS - 1), NOW_NS) && !may_follow(NOW_NS, Some(NOW_NS), NOW_NS));
    }

    /// With LOCAL_POSITION_NED the firmware compares what frames say of the pose.
    #[test]
    fn poses_are_reported_in_the_vehicles_local_frame_wherever_home_is() {
        let mut source = PoseSource::default();
        const NOW_NS: Nanos = 1_000_000_000;
        for message in [
            message!(HEARTBEAT, autopilot = MavAutopilot::MAV_AUTOPILOT_PX4),
            message!(
                HOME_POSITION,
                latitude = 473_977_420,
                longitude = 85_455_940,
                x = 30.0,
                z = 1.0
            ),
            message!(LOCAL_POSITION_NED, x = 31.0, z = -2.0),
            message!(ATTITUDE_QUATERNION, q1 = 1.0),
        ] {
            let bytes = encode((1, 1), 0, &message);
            for packet in packets(&bytes, &mut source.counters) {
                source.vehicle.receive(NOW_NS, &packet);
            }
        }
        assert!(source.vehicle.home_ned_m().is_some_and(|home| home.x == 30.0));
        source.listen(NOW_NS);
        let (position_ned_m, _) = source.at(NOW_NS).expect("a pose");
        assert_eq!(position_ned_m, NedVector::new(31.0, 0.0, -2.0));
    }
}
