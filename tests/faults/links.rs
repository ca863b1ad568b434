//! Those who speak in another's name: setpoints of a second guidance computer, and attacks on MAVLink signing.

use crate::campaign::{Draw, Ending, Folder, Row, Trial, in_lockstep};
use crate::flight::{Extras, Flight, Site};
use anyhow::{Context, Result};
use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, UNIX_EPOCH};
use vigil_autopilot::{EndpointConfig, LinkId};
use vigil_mavlink::common::*;
use vigil_mavlink::framing::MAX_PACKET_LEN;
use vigil_mavlink::message;
use vigil_mavlink::signing::{
    SIGNATURE_LEN, Signing, SigningKey, SigningMemory, UNITS_PER_SECOND, timestamp_of_unix_ns,
};
use vigil_sim::world::{Family, Outcome};
use vigil_tests::ground::{heartbeat, packet};
use vigil_tests::{Pair, side_by_side};
use vigil_types::NedVector;
use vigil_types::files::{Access, replace};

/// A flight that has not ended after this has not arrived: two minutes.
const FLIGHT_STEPS: usize = 2400;
/// Claimants of a setpoint stream in each step: (component, link, end of the link).
const CLAIMANTS: [(u8, LinkId, u64); 4] = [
    (191, LinkId::ONBOARD, 7),
    (191, LinkId::API, 1),
    (191, LinkId::GCS, 3),
    (196, LinkId::API, 2),
];

/// Full speed into whatever is there.
#[expect(deprecated, reason = "the frame that the guidance computer sends")]
fn setpoint(number: usize) -> MavMessage {
    message!(
        SET_POSITION_TARGET_LOCAL_NED,
        time_boot_ms = number as u32,
        vx = 1.5,
        vy = -1.5,
        target_system = 1,
        target_component = 1,
        coordinate_frame = MavFrame::MAV_FRAME_BODY_NED,
        type_mask = PositionTargetTypemask::from_bits_truncate(0x5C7)
    )
}

/// How a flight in lockstep ended, where, and the foreign setpoints refused.
fn spoofed(seed: u64, by: &[(u8, LinkId, u64)]) -> (Option<Outcome>, NedVector, u64) {
    let mut pair = Pair::with(Family::Validation, seed, |simulation, _| {
        simulation.endpoint = EndpointConfig::default();
    });
    pair.fly(FLIGHT_STEPS, |pair, step| {
        // From the second second on: whoever is first would be somebody's guidance computer.
        for (component, link, end) in by.iter().filter(|_| step > 40) {
            let bytes = packet((1, *component), step as u8, &setpoint(step));
            pair.simulator.receive_from(link.0, *end, &bytes);
        }
        true
    });
    let refused = pair.simulator.status().refusals.setpoint_foreign;
    (pair.outcome(), pair.simulator.truth().position_ned_m, refused)
}

/// The row of spoofed setpoints: the same flights, bit for bit, as without them.
pub fn spoofing(site: &Site<'_>, _: &Folder) -> Result<Vec<Row>> {
    let flights = if site.quick { 1 } else { 20 };
    let flown = in_lockstep(site, flights, |_, seed| (spoofed(seed, &[]), spoofed(seed, &CLAIMANTS)));
    let mut refused = 0;
    let mut trials = Vec::new();
    for (number, (alone, (outcome, position, count))) in flown.into_iter().enumerate() {
        refused += count;
        let ending = Ending::of(outcome).unwrap_or(Ending::TimeOut);
        let (is_same, seed) = ((alone.0, alone.1) == (outcome, position), site.seed + number as u64);
        let another = || format!("seed {seed}: another flight than without them");
        let wrong = (!is_same || count == 0).then(another);
        trials.push(Trial { ending, wrong });
    }
    Ok(vec![Row::of(
        "setpoints of four others, each step",
        &trials,
        format!("{refused} setpoints refused; each flight ends to the bit where it ends without them"),
    )])
}

const KEY: [u8; 32] = [0x5A; 32];
const OTHER_KEY: [u8; 32] = [0xA5; 32];
/// Packets of an attack a second.
const ATTACK_RATE: u64 = 200;

vigil_types::named! {
    #[derive(Debug, Clone, Copy)]
    enum Attack {
        UnsignedSetup => "unsigned SETUP_SIGNING",
        SetupOfAnotherKey => "SETUP_SIGNING signed with another key",
        Replay => "a signed landing, captured and sent again",
        ZeroKeyOfAHolder => "a key of zeros from one who has the key",
        RatchetOfAHolder => "stamps ever 55 s ahead from one who has the key",
        RandomPackets => "random commands and keys, where nobody may speak unsigned",
    }
}

fn sign(signing: &mut Signing, ahead_s: i64, bytes: &[u8]) -> Vec<u8> {
    let unix_ns = UNIX_EPOCH.elapsed().map_or(0, |since| since.as_nanos() as u64);
    let at = timestamp_of_unix_ns(unix_ns).saturating_add_signed(ahead_s * UNITS_PER_SECOND as i64);
    let mut out = [0; MAX_PACKET_LEN + SIGNATURE_LEN];
    signing
        .sign(at, bytes, &mut out)
        .map_or_else(|_| Vec::new(), |len| out[..len].to_vec())
}

/// A key file of its own for each end.
fn key_file(folder: &Path, name: &str) -> Result<PathBuf> {
    let path = folder.join(name);
    replace(&path, &KEY, Access::Private)?;
    Ok(path)
}

/// The rows of attacks on signing: a flight each, attacked on all links of both ends.
pub fn signing(site: &Site<'_>, _: &Folder) -> Result<Vec<Row>> {
    let attacks = if site.quick { &Attack::ALL[..1] } else { &Attack::ALL };
    let rows = side_by_side(attacks.len(), &site.instances, |number, instance| {
        let stopped = site.stop.load(Ordering::Relaxed);
        (!stopped).then(|| attacked(site, attacks[number], instance, site.seed + number as u64))
    });
    rows.into_iter().collect()
}

/// Sends the attack's packets, one after the other, to each of the ports of the vehicle of this system until it is over.
fn keep_sending(attack: Attack, system: u8, ends: [u16; 5], over: &AtomicBool, sent: &AtomicU64) {
    let Ok(socket) = UdpSocket::bind("127.0.0.1:0") else {
        return;
    };
    let [mut holder, mut stranger, mut captor] =
        [KEY, OTHER_KEY, KEY].map(|key| Signing::new(SigningKey(key), 7, SigningMemory::default()));
    let land = |target_system, target_component| {
        message!(
            COMMAND_LONG,
            command = MavCmd::MAV_CMD_NAV_LAND,
            target_system,
            target_component
        )
    };
    let setup = |key| message!(SETUP_SIGNING, target_system = 0, target_component = 0, secret_key = key);
    let mut draw = Draw::new(7);
    // An hour ago.
    let captured = sign(&mut captor, -3600, &packet((255, 190), 0, &land(system, 0)));
    let mut next = |number: u64| {
        let say = |message: &MavMessage| packet((255, 190), number as u8, message);
        match attack {
            Attack::UnsignedSetup => say(&setup(OTHER_KEY)),
            Attack::SetupOfAnotherKey => sign(&mut stranger, 0, &say(&setup(OTHER_KEY))),
            Attack::Replay => captured.clone(),
            Attack::ZeroKeyOfAHolder => sign(&mut holder, 0, &say(&setup([0; 32]))),
            // Twenty of them a second apart.
            Attack::RatchetOfAHolder => {
                let ahead = (number / ATTACK_RATE).min(20) as i64;
                let heartbeat = say(&heartbeat(MavAutopilot::MAV_AUTOPILOT_INVALID));
                sign(&mut holder, 55 * ahead, &heartbeat)
            }
            Attack::RandomPackets => {
                let key = [(); 32].map(|()| draw.bits() as u8);
                let sender = (draw.below(255) as u8 + 1, draw.below(255) as u8 + 1);
                let message = match number.is_multiple_of(10) {
                    true => setup(key),
                    false => land(draw.below(3) as u8, draw.below(256) as u8),
                };
                packet(sender, number as u8, &message)
            }
        }
    };
    let mut number = 0;
    while !over.load(Ordering::Relaxed) {
        std::thread::sleep(Duration::from_micros(1_000_000 / ATTACK_RATE));
        for end in ends {
            number += 1;
            let went = socket.send_to(&next(number), ("127.0.0.1", end)).is_ok();
            sent.fetch_add(u64::from(went), Ordering::Relaxed);
        }
    }
}

fn attacked(site: &Site<'_>, attack: Attack, instance: u32, seed: u64) -> Result<Row> {
    let work = tempfile::tempdir()?;
    let files = [
        key_file(work.path(), "firmware.key")?,
        key_file(work.path(), "vehicle.key")?,
    ];
    let [firmware_key, vehicle_key] = files.each_ref().map(|path| path.display().to_string());
    let port = |base: u32| u16::try_from(base + instance);
    let (main, ground) = (port(14030)?, port(25_000)?);
    // Who may speak unsigned may land the vehicle: that is no attack.
    let unsigned = match attack {
        Attack::RandomPackets => "never",
        _ => "loopback",
    };
    let extras = Extras {
        firmware: format!(
            "--signing-key {firmware_key} --link udpin://127.0.0.1:{main},system={} --link udpin://127.0.0.1:{ground} \
             --allow-unsigned {unsigned}",
            instance + 1
        ),
        simulator: format!("--signing-key {vehicle_key} --allow-unsigned {unsigned}"),
        ..Extras::default()
    };
    let ends = [main, ground, port(14280)?, port(14580)?, port(18570)?];
    let mut flight = Flight::start(instance, seed, work.path(), extras)?;
    let (done, sent) = (AtomicBool::new(false), AtomicU64::new(0));
    let flown = std::thread::scope(|scope| {
        let (over, sent) = (&done, &sent);
        scope.spawn(move || keep_sending(attack, (instance + 1) as u8, ends, over, sent));
        let flown = flight
            .take_off(site.stop)
            .and_then(|()| flight.fly_to_its_end(site.stop));
        done.store(true, Ordering::Relaxed);
        flown
    });
    let fallen = flight.fallen();
    let outcome = flight.outcome();
    let said = flight.end_firmware();
    let mut changed = Vec::new();
    for file in &files {
        let kept = std::fs::read(file).with_context(|| format!("cannot read {}", file.display()))?;
        if kept != KEY {
            changed.push(file.file_name().unwrap_or_default().to_string_lossy().into_owned());
        }
    }
    let ending = match fallen.is_empty() {
        true => Ending::of(outcome).unwrap_or(Ending::TimeOut),
        false => Ending::Crashed,
    };
    let wrong = match (flown, said) {
        (Err(error), _) | (_, Err(error)) => Some(format!("{error:#}")),
        _ if !changed.is_empty() => Some(format!("changed: {}", changed.join(", "))),
        _ if ending != Ending::Arrived => Some(format!("{outcome:?}")),
        _ => None,
    };
    Ok(Row::of(
        format!("signing: {}", attack.name()),
        &[Trial { ending, wrong }],
        format!("{} packets; no key changed", sent.load(Ordering::Relaxed)),
    ))
}
