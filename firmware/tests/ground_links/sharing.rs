//! Links beside each other: two stations, floods, slow lines and lines that break.

use super::*;

#[test]
fn a_ground_stations_serial_line_that_disappears_and_returns_is_served_again_and_the_flight_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let device = folder.path().join("ttyStation");
    let vehicle = Far::new();
    let mut line = PseudoTerminal::open();
    symlink(&line.device, &device).unwrap();
    let ground = format!("serial://{}:57600,unsigned=always", device.display());
    let gate = SigningGate::new(None, AllowUnsigned::Loopback);
    let mut links = RoutedLinks::open(&vehicle.url().parse().unwrap(), &[ground.parse().unwrap()], gate).unwrap();
    let mut sent = Datagrams::default();
    sent.push(0, &heartbeat(ME));
    let mut step = |at_step: Nanos| {
        let mut received = Datagrams::default();
        links.receive(at_step * STEP_NS, &mut received);
        links.send(&sent);
        received.len()
    };
    let land = command(STATION, ME, MavCmd::MAV_CMD_NAV_LAND);
    line.master.write_all(&land).unwrap();
    assert_eq!((1..100).map(&mut step).sum::<usize>(), 1);
    assert_eq!(vehicle.heard().len(), 99);

    drop(line);
    std::fs::remove_file(&device).unwrap();
    (100..200).for_each(|at| assert_eq!(step(at), 0));
    assert_eq!(vehicle.heard().len(), 100, "each setpoint goes out");

    line = PseudoTerminal::open();
    symlink(&line.device, &device).unwrap();
    // It is looked for once a second.
    (200..230).for_each(|at| assert_eq!(step(at), 0));
    line.master.write_all(&land).unwrap();
    assert_eq!((230..330).map(&mut step).sum::<usize>(), 1);
    let mut bytes = [0; 4096];
    let len = line.master.read(&mut bytes).unwrap();
    assert!(seen_in(&bytes[..len]).contains(&(ME, HEARTBEAT)), "and hears again");
}

#[test]
fn a_flood_on_one_link_starves_none_of_the_others() {
    // 50 Mbit/s: 312 KB in a step. Commands for the vehicle and for the guidance computer, of senders made up by the
    // hundred, on the first station's link.
    const STEPS: usize = 100;
    let mut rig = Rig::unsigned();
    rig.introduce();
    let mut from_other = [0, 0];
    let mut from_flood = 0;
    let (mut to_vehicle, mut own_at_vehicle, mut at_other, mut of_vehicle) = (0, 0, 0, 0);
    for step in 0..STEPS {
        let mut flooded = 0;
        let mut made_up = step as u8;
        while flooded < 312_000 {
            made_up = made_up.wrapping_add(1);
            let target = if made_up.is_multiple_of(2) { VEHICLE } else { ME };
            let mut datagram = Vec::new();
            while datagram.len() < 1400 {
                datagram.extend(command((made_up | 2, made_up), target, MavCmd::MAV_CMD_NAV_LAND));
            }
            flooded += datagram.len();
            // The socket's queue is full at some time; the rest is lost, as on any network.
            let _ = rig.stations[0].0.send(&datagram);
        }
        rig.vehicle.say(&heartbeat(VEHICLE));
        rig.stations[1].say(&command(OTHER_STATION, VEHICLE, MavCmd::MAV_CMD_NAV_TAKEOFF));
        rig.stations[1].say(&command(OTHER_STATION, ME, MavCmd::MAV_CMD_NAV_GUIDED_ENABLE));
        for (link, (from, _)) in rig.own(&[command(ME, VEHICLE, MavCmd::MAV_CMD_DO_SET_MODE)]) {
            match (link, from) {
                (0, VEHICLE) => of_vehicle += 1,
                (2, OTHER_STATION) => from_other[1] += 1,
                _ => from_flood += 1,
            }
        }
        for (from, _) in rig.vehicle.heard() {
            match from {
                ME => own_at_vehicle += 1,
                OTHER_STATION => from_other[0] += 1,
                _ => to_vehicle += 1,
            }
        }
        at_other += rig.stations[1]
            .heard()
            .iter()
            .filter(|(from, _)| *from == VEHICLE)
            .count();
        rig.stations[0].raw();
    }
    assert_eq!(own_at_vehicle, STEPS, "each setpoint goes out");
    assert_eq!(from_other, [STEPS, STEPS], "each command of the other station arrives");
    assert_eq!(
        (of_vehicle, at_other),
        (STEPS, STEPS),
        "and the vehicle's telemetry everywhere"
    );
    assert!(
        from_flood <= 8 * STEPS,
        "{from_flood} packets of the flood reached the flight stack"
    );
    assert!(to_vehicle > STEPS, "what there is room for is passed on");
    assert!(rig.links.routing().crowded_out > 1000);
}

#[test]
fn on_a_slow_line_to_the_vehicle_the_setpoints_go_first() {
    let line = PseudoTerminal::open();
    let station = Far::new();
    let vehicle = format!("serial://{}:57600,unsigned=always", line.device)
        .parse()
        .unwrap();
    let gate = SigningGate::new(None, AllowUnsigned::Loopback);
    let mut links = RoutedLinks::open(&vehicle, &[station.url().parse().unwrap()], gate).unwrap();
    let mut sent = Datagrams::default();
    sent.push(0, &heartbeat(ME));
    links.send(&sent);
    station.raw();
    let mut framer = StreamFramer::default();
    let mut counters = FramingCounters::default();
    let (mut own, mut others, mut sequences) = (0, 0, Vec::new());
    for step in 1..=100 {
        for _ in 0..60 {
            let _ = station.0.send(&heartbeat(STATION));
        }
        links.receive(step * STEP_NS, &mut Datagrams::default());
        links.send(&sent);
        let mut bytes = [0; 65_536];
        while let Ok(len) = (&line.master).read(&mut bytes) {
            framer.feed(&bytes[..len], &mut counters, |p| {
                match (p.system_id(), p.component_id()) {
                    ME => {
                        own += 1;
                        sequences.push(p.sequence());
                    }
                    _ => others += 1,
                }
            });
        }
    }
    assert_eq!((own, counters.bad_crc), (101, 0));
    assert!(sequences.is_sorted_by(|a, b| a.wrapping_add(1) == *b), "{sequences:?}");
    // 5760 bytes per second in 5 s, of which the setpoints take 101 times 21.
    let passed = others * heartbeat(STATION).len();
    assert!((20_000..28_800).contains(&passed), "{passed} bytes of the station's");
}

#[test]
fn a_ground_link_carries_no_more_than_its_rate() {
    let mut rig = Rig::new([",rate=2000", ""], SigningGate::new(None, AllowUnsigned::Loopback));
    let mut heard = [0, 0];
    for _ in 0..200 {
        for _ in 0..40 {
            rig.vehicle.say(&heartbeat(VEHICLE));
        }
        rig.own(&[heartbeat(ME)]);
        for (count, station) in heard.iter_mut().zip(&rig.stations) {
            *count += station.raw().iter().map(Vec::len).sum::<usize>();
        }
    }
    assert!((18_000..21_500).contains(&heard[0]), "{} bytes in 10 s", heard[0]);
    assert!(heard[1] > 150_000, "the other has no limit: {} bytes", heard[1]);
}

/// The whole flight stack behind the links.
struct Flight {
    rig: Rig,
    firmware: Firmware,
    vehicle: TestVehicle,
    step: u64,
}

impl Flight {
    fn new() -> Self {
        let config = FirmwareConfig {
            engage: EngagePolicy::Command,
            ..config()
        };
        let mut flight = Self {
            rig: Rig::unsigned(),
            firmware: Firmware::of(&config).unwrap(),
            vehicle: TestVehicle::hovering(2.5),
            step: 0,
        };
        flight.steps(20);
        flight
    }

    fn steps(&mut self, count: usize) {
        for _ in 0..count {
            let now_ns = self.rig.now_ns + STEP_NS;
            self.rig.now_ns = now_ns;
            let frame = self.vehicle.frame(now_ns);
            for (_, datagram) in self.vehicle.telemetry().iter() {
                self.rig.vehicle.say(datagram);
            }
            let links = &mut self.rig.links;
            step_over(&mut self.firmware, links, (now_ns, self.step), Some(&frame));
            for bytes in self.rig.vehicle.raw() {
                self.vehicle.hear(&bytes);
            }
            self.vehicle.advance();
            self.step += 1;
        }
    }

    /// What a station hears in the next two steps of the guidance computer's messages.
    fn heard_by(&mut self, station: usize) -> Vec<MavMessage> {
        self.steps(2);
        let mut messages = Vec::new();
        for bytes in self.rig.stations[station].raw() {
            for packet in packets(&bytes, &mut FramingCounters::default()) {
                if (packet.system_id(), packet.component_id()) == ME {
                    messages.push(packet.message().unwrap());
                }
            }
        }
        messages
    }
}

#[test]
fn two_ground_stations_at_once_each_get_their_answers_and_both_see_what_the_other_changed() {
    let mut flight = Flight::new();
    flight.rig.stations[0].say(&heartbeat(STATION));
    flight.rig.stations[1].say(&heartbeat(OTHER_STATION));
    flight.steps(2);
    flight.rig.hush();
    let set = set_parameter("GD_SPEED_LIM", 0.75, MavParamType::MAV_PARAM_TYPE_REAL32);
    flight.rig.stations[0].say(&packet(STATION, &set));
    let set_home = MavCmd::MAV_CMD_DO_SET_HOME;
    flight.rig.stations[1].say(&command(OTHER_STATION, ME, set_home));
    let first = flight.heard_by(0);
    let has_value = |messages: &[MavMessage]| {
        messages
            .iter()
            .any(|m| matches!(m, MavMessage::PARAM_VALUE(m) if m.param_value == 0.75))
    };
    let acks = |messages: &[MavMessage]| {
        let results = messages.iter().filter_map(|message| match message {
            MavMessage::COMMAND_ACK(m) => Some((m.command, m.result, m.target_system)),
            _ => None,
        });
        results.collect::<Vec<_>>()
    };
    assert!(has_value(&first) && acks(&first).is_empty());
    let second = flight.heard_by(1);
    assert!(has_value(&second), "the other station's value is sent to both");
    let unsupported = (set_home, MavResult::MAV_RESULT_UNSUPPORTED, OTHER_STATION.0);
    assert_eq!(acks(&second), [unsupported]);

    let waits = flight.vehicle.setpoints.is_empty() && flight.vehicle.mode == LOITER;
    assert!(waits, "nothing moves unless somebody engages");
    // One engages, the other stops the flight: the last word counts, whoever's it is.
    let guided = |param1: f32, from| {
        let (target_system, target_component) = ME;
        let command = MavCmd::MAV_CMD_NAV_GUIDED_ENABLE;
        let message = message!(COMMAND_LONG, param1, command, target_system, target_component);
        packet(from, &message)
    };
    flight.rig.stations[0].say(&guided(1.0, STATION));
    flight.steps(60);
    let speed = |vehicle: &TestVehicle| vehicle.setpoints.last().map_or(0.0, |s| s.vx);
    assert!(speed(&flight.vehicle) > 0.3, "it flies");
    assert!(speed(&flight.vehicle) <= 0.75, "and keeps the speed that was set");
    flight.rig.stations[1].say(&guided(0.0, OTHER_STATION));
    flight.steps(60);
    assert_eq!(speed(&flight.vehicle), 0.0, "it stopped");
}
