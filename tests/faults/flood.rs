//! Strangers who flood the firmware's link to its vehicle, and when each setpoint arrives at the vehicle's side.

use crate::campaign::{Ending, Folder, Row, Trial};
use crate::flight::{Extras, Flight, Site};
use anyhow::{Context, Result};
use clap::ValueEnum;
use std::io::{ErrorKind, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use vigil_io::Link;
use vigil_io::clock::{monotonic_ns, sleep_until};
use vigil_io::gate::SigningGate;
use vigil_io::link_url::LinkUrl;
use vigil_io::links::{Gated, PeerRule};
use vigil_mavlink::common::*;
use vigil_mavlink::framing::{FramingCounters, packets};
use vigil_mavlink::mavlink::MessageData;
use vigil_tests::ground::{Request, heartbeat, packet};
use vigil_types::{Datagrams, Nanos, STEP_NS};

/// Ends of strangers that send in turn.
const STRANGERS: usize = 12;
/// A burst of datagrams comes each millisecond.
const BURST_NS: Nanos = 1_000_000;
/// Setpoints come each step; one that comes half a step later than it ought to is late.
const LATE_NS: Nanos = STEP_NS + STEP_NS / 2;
/// The vehicle holds by itself after so long without a setpoint (`VGL_OF_LOSS_T`). More than this is wrong on any machine; one that
/// does other work too may be late, and the quick part, which runs anywhere, only reports it.
const LOST_NS: Nanos = 400_000_000;
/// Datagrams a second in the campaign.
const RATE: u32 = 20_000;
/// Strangers come this long before the vehicle.
const BEFORE: Duration = Duration::from_secs(2);
/// Between two looks at what is to be passed on.
const POLL: Duration = Duration::from_micros(200);
/// Port of the firmware's link at instance 0; far from the default ports.
const PORT: u16 = 24_000;

/// What strangers send.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Content {
    /// One byte, the first of a packet.
    OneByte,
    /// Random bytes with a packet's first byte before them.
    Garbage,
    /// MAVLink of a ground station and of other components.
    Station,
    /// Heartbeats of other vehicles.
    Vehicles,
    /// All of it in turn.
    Mixed,
}

impl Content {
    fn datagrams(self) -> Vec<Vec<u8>> {
        match self {
            Self::OneByte => vec![vec![0xFD]],
            Self::Garbage => {
                let mut draw = crate::campaign::Draw::new(1);
                let mut some = |len: usize| (0..len).map(|_| draw.bits() as u8).collect::<Vec<u8>>();
                (0..64).map(|i| [vec![0xFD], some(20 + 4 * i)].concat()).collect()
            }
            Self::Station => {
                vec![
                    packet((255, 190), 0, &heartbeat(MavAutopilot::MAV_AUTOPILOT_INVALID)),
                    packet((255, 190), 1, &Request::Land.message(1)),
                    packet((1, 50), 2, &MavMessage::STATUSTEXT(STATUSTEXT_DATA::DEFAULT)),
                    packet((1, 1), 3, &MavMessage::STATUSTEXT(STATUSTEXT_DATA::DEFAULT)),
                ]
            }
            // Above all instances' own.
            Self::Vehicles => (110..200)
                .map(|system| packet((system, 1), 0, &heartbeat(MavAutopilot::MAV_AUTOPILOT_PX4)))
                .collect(),
            Self::Mixed => Self::value_variants()[..4]
                .iter()
                .flat_map(|content| content.datagrams())
                .collect(),
        }
    }
}

/// Over what a stranger comes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Transport {
    /// Datagrams.
    Udp,
    /// Connections.
    Tcp,
}

#[derive(clap::Args)]
pub struct Flood {
    /// Over what.
    #[arg(value_enum)]
    transport: Transport,

    /// To whom.
    address: SocketAddr,

    /// What is sent.
    #[arg(long, value_enum, default_value_t = Content::Mixed)]
    content: Content,

    /// Datagrams a second.
    #[arg(long, default_value_t = RATE, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    rate: u32,
}

impl Flood {
    /// Floods until `done`; how many were sent.
    pub fn send(&self, done: impl Fn() -> bool) -> u64 {
        let content = self.content.datagrams();
        let sockets = (0..STRANGERS).filter_map(|_| UdpSocket::bind("127.0.0.1:0").ok());
        let sockets: Vec<UdpSocket> = sockets.collect();
        let mut calls: Vec<Option<TcpStream>> = (0..STRANGERS).map(|_| None).collect();
        let mut due_ns = monotonic_ns();
        let (mut owed, mut number, mut sent) = (0.0, 0_usize, 0);
        while !done() {
            due_ns += BURST_NS;
            sleep_until(due_ns);
            owed += f64::from(self.rate) * BURST_NS as f64 * 1e-9;
            while owed >= 1.0 {
                owed -= 1.0;
                number += 1;
                let bytes = &content[number % content.len()];
                let stranger = number % STRANGERS;
                let taken = if self.transport == Transport::Tcp {
                    call(&mut calls[stranger], self.address, bytes)
                } else {
                    let socket = sockets.get(stranger);
                    socket.is_some_and(|socket| socket.send_to(bytes, self.address).is_ok())
                };
                sent += u64::from(taken);
            }
        }
        sent
    }
}

/// Who was hung up on calls again.
fn call(socket: &mut Option<TcpStream>, address: SocketAddr, bytes: &[u8]) -> bool {
    if let Some(open) = socket {
        match open.write(bytes) {
            Ok(_) => return true,
            Err(error) if error.kind() == ErrorKind::WouldBlock => return false,
            Err(_) => *socket = None,
        }
    }
    if let Ok(open) = TcpStream::connect_timeout(&address, Duration::from_millis(50))
        && open.set_nonblocking(true).is_ok()
    {
        *socket = Some(open);
    }
    false
}

/// Passes everything on between the firmware's link and the simulator's vehicle, and notes when setpoints come out of the firmware's.
struct Tap {
    vehicle: UdpSocket,
    link: Gated,
}

impl Tap {
    fn open(instance: u32, link: SocketAddr, transport: Transport) -> Result<Self> {
        let port = u16::try_from(14030 + instance)?;
        let vehicle = UdpSocket::bind(("127.0.0.1", port)).with_context(|| format!("UDP port {port}"))?;
        vehicle.connect(("127.0.0.1", u16::try_from(14280 + instance)?))?;
        vehicle.set_nonblocking(true)?;
        let url = match transport {
            Transport::Udp => LinkUrl::UdpOut(link),
            Transport::Tcp => LinkUrl::TcpOut(link),
        };
        let link = Gated::open(&url, PeerRule::Anyone, SigningGate::open())?;
        Ok(Self { vehicle, link })
    }

    /// Passes on until asked to end; when setpoints came. What a socket refuses, a link may lose too.
    fn run(mut self, done: &AtomicBool) -> Vec<Nanos> {
        // Where it is permitted this thread comes before the flood's, as a vehicle's own computer does.
        let _ = vigil_firmware::realtime::request(40);
        let (mut passed, mut buffer, mut setpoints_ns) = (Box::<Datagrams>::default(), [0; 2048], Vec::new());
        while !done.load(Ordering::Relaxed) {
            passed.clear();
            let now_ns = monotonic_ns();
            self.link.receive(now_ns, &mut passed);
            for (_, datagram) in passed.iter() {
                let is_setpoint = |id| id == SET_POSITION_TARGET_LOCAL_NED_DATA::ID;
                if packets(datagram, &mut FramingCounters::default()).any(|packet| is_setpoint(packet.message_id())) {
                    setpoints_ns.push(now_ns);
                }
                let _ = self.vehicle.send(datagram);
            }
            passed.clear();
            while let Ok(len) = self.vehicle.recv(&mut buffer)
                && passed.push(0, &buffer[..len])
            {}
            self.link.send(&passed);
            std::thread::sleep(POLL);
        }
        setpoints_ns
    }
}

pub fn rows(site: &Site<'_>, _: &Folder) -> Result<Vec<Row>> {
    let cases: Vec<(Transport, Option<Content>)> = if site.quick {
        vec![(Transport::Udp, Some(Content::Mixed))]
    } else {
        let contents = || std::iter::once(None).chain(Content::value_variants().iter().copied().map(Some));
        [Transport::Udp, Transport::Tcp]
            .into_iter()
            .flat_map(|transport| contents().map(move |content| (transport, content)))
            .collect()
    };
    let mut rows = Vec::new();
    for (number, (transport, content)) in cases.into_iter().enumerate() {
        if !site.stop.load(Ordering::Relaxed) {
            rows.push(fly(site, site.seed + number as u64, transport, content)?);
        }
    }
    Ok(rows)
}

fn named(transport: Transport, content: Option<Content>) -> String {
    let transport = format!("{transport:?}").to_uppercase();
    match content.and_then(|content| content.to_possible_value()) {
        None => format!("no strangers, {transport}"),
        Some(value) => format!("strangers, {transport}: {}", value.get_name()),
    }
}

/// The steps that the firmware says it missed, in a line of its summary.
fn missed_steps(line: &str) -> Option<u64> {
    let missed = line.strip_prefix("loop")?.split(',').nth(1)?;
    missed.trim().strip_suffix(" missed")?.parse().ok()
}

fn fly(site: &Site<'_>, seed: u64, transport: Transport, content: Option<Content>) -> Result<Row> {
    let instance = site.instances[0];
    let link = SocketAddr::from(([127, 0, 0, 1], PORT + u16::try_from(instance)?));
    // A link that is still there would be somebody else's.
    drop(TcpListener::bind(link).with_context(|| format!("port {link}"))?);
    let scheme = format!("{transport:?}").to_lowercase();
    let extras = Extras {
        firmware: format!("--link {scheme}in://{link},system={}", instance + 1),
        ..Extras::default()
    };
    let work = tempfile::tempdir()?;
    let done = AtomicBool::new(false);
    let flood = content.map(|content| Flood {
        transport,
        address: link,
        content,
        rate: RATE,
    });
    let mut flight = Flight::start(instance, seed, work.path(), extras)?;
    let tap = Tap::open(instance, link, transport)?;
    let (flown, said, rate, setpoints_ns) = std::thread::scope(|scope| {
        let over = &done;
        let flooding = flood.as_ref().map(|flood| {
            scope.spawn(move || {
                let begun = Instant::now();
                flood.send(|| over.load(Ordering::Relaxed)) as f64 / begun.elapsed().as_secs_f64()
            })
        });
        let tapped = scope.spawn(move || {
            // The strangers come first.
            std::thread::sleep(BEFORE);
            tap.run(over)
        });
        let flown = flight
            .take_off(site.stop)
            .and_then(|()| flight.fly_to_its_end(site.stop));
        let said = flight.end_firmware();
        done.store(true, Ordering::Relaxed);
        let rate = flooding.map_or(0.0, |flooding| flooding.join().expect("a flood does not fail"));
        (flown, said, rate, tapped.join().expect("a tap does not fail"))
    });
    let mut gaps_ns: Vec<Nanos> = setpoints_ns.windows(2).map(|pair| pair[1] - pair[0]).collect();
    gaps_ns.sort_unstable();
    let late = gaps_ns.iter().filter(|gap| **gap > LATE_NS).count();
    let at = |share: f64| {
        let gap = gaps_ns.get(((gaps_ns.len().max(1) - 1) as f64 * share) as usize);
        gap.map_or(0.0, |gap| *gap as f64 * 1e-6)
    };
    let [p50, p99, most] = [0.5, 0.99, 1.0].map(at);
    let ending = Ending::of(flight.outcome()).unwrap_or(match flight.simulator.is_running() {
        true => Ending::TimeOut,
        false => Ending::Crashed,
    });
    let said = said?;
    let missed = said.iter().find_map(|line| missed_steps(line));
    let limit_ns = if site.quick { LOST_NS } else { LATE_NS };
    let too_late = gaps_ns.iter().filter(|gap| **gap > limit_ns).count();
    let wrong = match (&flown, too_late, missed) {
        (Err(error), ..) => Some(format!("{error:#}")),
        (_, 1.., _) => Some(format!(
            "{too_late} setpoints late, at most {most:.1} ms after the one before"
        )),
        (_, _, Some(1..)) if !site.quick => Some(format!("{} steps missed", missed.unwrap_or(0))),
        _ if ending == Ending::TimeOut && !site.stop.load(Ordering::Relaxed) => Some("it does not arrive".to_owned()),
        _ => None,
    };
    let flooded = content.map_or(String::new(), |_| format!("{rate:.0} a second; "));
    let measured = format!(
        "{flooded}{} setpoints, {p50:.1} / {p99:.1} / {most:.1} ms apart (p50 / p99 / most), {late} late, \
         {} steps missed",
        setpoints_ns.len(),
        missed.map_or("unknown".to_owned(), |missed| missed.to_string())
    );
    Ok(Row::of(named(transport, content), &[Trial { ending, wrong }], measured))
}
