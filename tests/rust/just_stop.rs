//! Just stop: the vehicle flies its own mission straight to the goal, through whatever stands there; Vigil only guards it.

#[path = "../../firmware/mavlink/tests/common/peer.rs"]
#[allow(
    dead_code,
    missing_docs,
    reason = "the scripted vehicles of the MAVLink crate's tests, of which some is used here"
)]
mod peer;

use peer::{Mode, Peer, Quirk};
use std::fmt::Write;
use std::sync::atomic::{AtomicU64, Ordering};
use vigil_firmware::config::PilotConfig;
use vigil_firmware::{FirmwareConfig, LockstepFirmware};
use vigil_mavlink::common::MavResult;
use vigil_mavlink::framing::{FramingCounters, packets};
use vigil_mavlink::{Flavour, MavMessage};
use vigil_sim::{LIDAR_SENSOR_ID, SimConfig, Start};
use vigil_tests::mission::bytes_of;
use vigil_tests::{Pair, mission};
use vigil_types::{
    Attitude, Datagrams, DepthFrame, Duty, EngagePolicy, Nanos, NedVector, PilotKind, Reason, STEP_NS, VehicleMode,
};
use vigil_world::{Column, Course, Family, Lidar, LidarConfig, Outcome, Shot, World, generate};

const LOCAL_POSITION_NED: u32 = 32;

/// What a mission came to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum End {
    /// At the goal.
    Arrived,
    /// The guard stopped it, and it stood for five seconds.
    Stopped,
    /// It hit something.
    Collision,
    /// Neither within two minutes, or out of the course's bounds.
    Other,
}

/// Flies the mission over a course; how it ended, and the least distance to an obstacle on the way.
fn fly(course: Course, seed: u64, speed_m_s: f32, duty: Duty) -> (End, f32) {
    let mut simulation = SimConfig::new(course, seed);
    simulation.start = Start::Airborne;
    simulation.saved = mission::plan(&simulation, speed_m_s);
    let config = FirmwareConfig {
        duty,
        engage: EngagePolicy::Command,
        pilot: PilotConfig {
            kind: PilotKind::Geometric,
            ..PilotConfig::default()
        },
        ..FirmwareConfig::to_goal(simulation.course.goal_ned_m())
    };
    let mut pair = Pair::of(&simulation, &config);
    let (mut nearest_m, mut stood) = (f32::INFINITY, 0);
    for step in 0..2400 {
        if step == 40 {
            pair.simulator.receive(0, &mission::start());
        }
        pair.simulate();
        let report = pair.decide(true);
        assert!(
            report.setpoint.is_none() || duty == Duty::FlyAround,
            "who only stops gives no setpoints"
        );
        nearest_m = nearest_m.min(pair.simulator.obstacle_distance_m());
        let end = match pair.simulator.ending().map(|ending| ending.outcome) {
            Some(Outcome::Success) => Some(End::Arrived),
            Some(Outcome::Collision) => Some(End::Collision),
            Some(_) => Some(End::Other),
            None => None,
        };
        if let Some(end) = end {
            return (end, nearest_m);
        }
        let holds = report.telemetry.heartbeat.is_some_and(|h| h.mode == VehicleMode::Hold);
        stood = match holds && report.reasons.contains(Reason::CollisionCourse) {
            true => stood + 1,
            false => 0,
        };
        if stood == 100 {
            return (End::Stopped, nearest_m);
        }
    }
    (End::Other, nearest_m)
}

/// The same course with everything taken away that stands.
fn emptied(mut course: Course) -> Course {
    (course.columns, course.boxes, course.walls) = (vec![], vec![], vec![]);
    (course.overhangs, course.movers) = (vec![], vec![]);
    course
}

#[test]
fn a_mission_through_an_obstacle_is_stopped_before_it_and_a_free_one_arrives() {
    // The first seeds whose straight way is blocked.
    let blocked: Vec<u64> = (1..20)
        .filter(|seed| fly(generate(Family::Training, *seed), *seed, 3.0, Duty::Fly).0 == End::Collision)
        .take(3)
        .collect();
    assert_eq!(blocked.len(), 3, "{blocked:?}");
    for seed in blocked {
        let course = generate(Family::Training, seed);
        let (end, nearest_m) = fly(course.clone(), seed, 3.0, Duty::JustStop);
        assert_eq!(end, End::Stopped, "course {seed}, nearest {nearest_m} m");
        assert_eq!(
            fly(emptied(course), seed, 3.0, Duty::JustStop).0,
            End::Arrived,
            "course {seed}"
        );
    }
}

#[test]
fn a_mission_that_was_stopped_is_flown_around_and_handed_back() {
    for seed in [2, 3] {
        let (end, nearest_m) = fly(generate(Family::Training, seed), seed, 3.0, Duty::FlyAround);
        assert_eq!(end, End::Arrived, "course {seed}, nearest {nearest_m} m");
    }
}

/// A scripted vehicle of another autopilot that flies north over a course, guarded.
struct Guarded {
    peer: Peer,
    firmware: LockstepFirmware,
    world: World,
    lidar: Lidar,
    now_ns: Nanos,
    sequence: u64,
    frame: Box<DepthFrame>,
    sent: Datagrams,
    /// Frames are delivered; positions are.
    sees: bool,
    tells_position: bool,
    texts: Vec<String>,
    nearest_m: f32,
}

impl Guarded {
    /// In its mission at 2.5 m height; a wall across its way, so far north.
    fn before_a_wall(flavour: Flavour, wall_m: f32) -> Self {
        let mut course = emptied(generate(Family::Training, 1));
        course.columns = vec![Column {
            north_m: wall_m + 4.0,
            east_m: 0.0,
            radius_m: 4.0,
            height_m: 8.0,
        }];
        Self::over(flavour, &course)
    }

    fn over(flavour: Flavour, course: &Course) -> Self {
        let config = FirmwareConfig {
            duty: Duty::JustStop,
            ..FirmwareConfig::default()
        };
        Self {
            peer: Peer {
                mode: Mode::Mission,
                height_m: 2.5,
                ..Peer::in_the_air(flavour)
            },
            firmware: LockstepFirmware::new(&config).expect("a firmware"),
            world: World::new(course),
            lidar: Lidar::new(LidarConfig::default(), 1).expect("a LiDAR"),
            now_ns: 60_000_000_000,
            sequence: 0,
            frame: Box::new(DepthFrame::EMPTY),
            sent: Datagrams::default(),
            sees: true,
            tells_position: true,
            texts: Vec::new(),
            nearest_m: f32::INFINITY,
        }
    }

    fn step(&mut self) {
        self.now_ns += STEP_NS;
        let mut received = Datagrams::default();
        let mut counters = FramingCounters::default();
        for datagram in self.peer.step(self.now_ns) {
            let id = packets(&datagram, &mut counters).next().expect("a packet").message_id();
            if self.tells_position || id != LOCAL_POSITION_NED {
                received.push(0, &datagram);
            }
        }
        let position_ned_m = NedVector::new(self.peer.north_m, self.peer.east_m, -self.peer.height_m);
        self.nearest_m = self.nearest_m.min(self.world.clearance_m(position_ned_m));
        self.sequence += 1;
        let shot = Shot {
            position_ned_m,
            attitude: Attitude::LEVEL_NORTH,
            estimated_position_ned_m: position_ned_m,
            estimated_attitude: Attitude::LEVEL_NORTH,
            stamp_ns: self.now_ns,
            sequence: self.sequence,
            sensor_id: LIDAR_SENSOR_ID,
        };
        self.lidar.capture(&self.world, &shot, &mut self.frame);
        let frame = self.sees.then_some(&*self.frame);
        let report = self.firmware.step(self.now_ns, frame, &received, &mut self.sent);
        assert_eq!(report.setpoint, None);
        for (_, datagram) in self.sent.iter() {
            for packet in packets(datagram, &mut counters) {
                if let Ok(MavMessage::STATUSTEXT(text)) = packet.message()
                    && text.chunk_seq == 0
                {
                    self.texts.push(text.text.to_str().expect("UTF-8").to_owned());
                }
            }
            self.peer.receive(self.now_ns, datagram);
        }
    }

    fn run_s(&mut self, s: f32) {
        for _ in 0..(s * 20.0) as u32 {
            self.step();
        }
    }

    fn was_told(&self, part: &str) -> bool {
        self.texts.iter().any(|text| text.contains(part))
    }

    fn holds(&self) -> bool {
        matches!(self.peer.mode, Mode::Loiter | Mode::Brake)
    }

    fn mode_changes(&self) -> usize {
        self.peer.commands.iter().filter(|c| c.command == 176).count()
    }
}

const BOTH: [Flavour; 2] = [Flavour::Px4, Flavour::ArduPilot];

#[test]
fn a_mission_through_a_wall_is_stopped_on_either_autopilot_and_stopped_again_when_it_is_sent_on() {
    for flavour in BOTH {
        let mut f = Guarded::before_a_wall(flavour, 15.0);
        f.run_s(12.0);
        assert!(f.holds() && f.nearest_m > 0.3, "{flavour:?} {}", f.nearest_m);
        assert!(f.was_told("stop: something "), "{:?}", f.texts);
        assert_eq!(f.mode_changes(), 1);
        let (at_m, texts) = (f.peer.north_m, f.texts.len());
        assert!((8.0..14.5).contains(&at_m), "{at_m}");
        // A ground station knows better.
        f.peer.mode = Mode::Mission;
        f.run_s(6.0);
        assert!(f.holds() && f.nearest_m > 0.3, "{flavour:?} {}", f.nearest_m);
        assert!(f.texts.len() > texts && f.peer.north_m < 14.6);
    }
}

#[test]
fn a_vehicle_that_another_companion_flies_is_stopped_too() {
    for flavour in BOTH {
        let mut f = Guarded::before_a_wall(flavour, 12.0);
        // Its setpoints go past us.
        f.peer.mode = Mode::External;
        for _ in 0..200 {
            if f.peer.mode == Mode::External {
                let now_ns = f.now_ns + STEP_NS;
                f.peer.setpoints.push((now_ns, [2.0, 0.0, 0.0, 0.0]));
                f.peer.speed_north_m_s = 2.0;
            }
            f.step();
        }
        assert!(f.holds() && f.nearest_m > 0.3, "{flavour:?} {}", f.nearest_m);
    }
}

#[test]
fn sticks_that_fly_where_the_sensor_does_not_look_are_stopped() {
    for flavour in BOTH {
        let mut f = Guarded::before_a_wall(flavour, 30.0);
        f.peer.mode = Mode::Manual;
        for _ in 0..60 {
            if f.peer.mode == Mode::Manual {
                f.peer.speed_north_m_s = -1.5;
                f.peer.north_m -= 1.5 * 0.05;
            }
            f.step();
        }
        assert!(f.holds() && f.was_told("does not look"), "{:?}", f.texts);
    }
}

#[test]
fn a_sensor_that_falls_silent_stops_the_mission() {
    for flavour in BOTH {
        let mut f = Guarded::before_a_wall(flavour, 60.0);
        f.run_s(4.0);
        assert_eq!(f.peer.mode, Mode::Mission);
        f.sees = false;
        f.run_s(2.0);
        assert!(f.holds() && f.was_told("nobody sees the course"), "{:?}", f.texts);
    }
}

#[test]
fn a_vehicle_that_never_reports_its_position_is_said_to_be_unguarded_and_is_not_commanded() {
    for flavour in BOTH {
        let mut f = Guarded::before_a_wall(flavour, 8.0);
        f.tells_position = false;
        f.run_s(3.0);
        assert!(f.was_told("not guarded"), "{:?}", f.texts);
        assert_eq!((f.peer.mode, f.mode_changes()), (Mode::Mission, 0));
    }
}

#[test]
fn a_position_that_jumps_is_told_and_the_flight_is_guarded_by_what_is_seen_from_there() {
    for flavour in BOTH {
        let mut f = Guarded::before_a_wall(flavour, 30.0);
        f.run_s(3.0);
        f.peer.north_m += 12.0;
        f.step();
        assert!(f.was_told("the position jumped"), "{:?}", f.texts);
        f.run_s(10.0);
        assert!(f.holds() && f.nearest_m > 0.3, "{flavour:?} {}", f.nearest_m);
    }
}

#[test]
fn a_stop_that_is_refused_is_asked_for_again_and_told() {
    for flavour in BOTH {
        let mut f = Guarded::before_a_wall(flavour, 20.0);
        f.peer.quirks.push(Quirk {
            command: 176,
            answer: Some(MavResult::MAV_RESULT_DENIED),
            times: 1,
        });
        f.run_s(12.0);
        assert!(f.holds() && f.was_told("refused"), "{:?}", f.texts);
    }
}

/// `cargo test --release -p vigil-tests --test just_stop -- --ignored --nocapture scripted`
#[test]
#[ignore = "200 missions of scripted vehicles: a minute"]
fn two_hundred_missions_of_scripted_vehicles() {
    for flavour in BOTH {
        let (mut collisions, mut nearest_m) = (0, f32::INFINITY);
        for n in 0..100_u16 {
            let mut course = emptied(generate(Family::Training, 1));
            let part = |of: u16| f32::from(n % of) / f32::from(of - 1);
            course.columns = vec![Column {
                north_m: 7.0 + 13.0 * part(25),
                east_m: 0.4 * (2.0 * part(7) - 1.0),
                radius_m: 0.15 + 0.5 * part(5),
                height_m: 5.0,
            }];
            let mut f = Guarded::over(flavour, &course);
            f.peer.cruise_m_s = 2.0 + 2.0 * part(9);
            f.run_s(14.0);
            collisions += u32::from(f.nearest_m <= 0.3);
            nearest_m = nearest_m.min(f.nearest_m);
            assert!(f.holds(), "mission {n}");
        }
        println!("{flavour:?}: 100 missions, {collisions} collisions, nearest obstacle {nearest_m:.2} m");
        assert_eq!(collisions, 0);
    }
}

/// `FIRST_SEED=1 cargo test --release -p vigil-tests --test just_stop -- --ignored --nocapture two_hundred_missions_through`
#[test]
#[ignore = "200 missions at each of three speeds, flown alone, guarded and flown around: minutes"]
fn two_hundred_missions_through_what_stands_there() {
    let first_seed: u64 = std::env::var("FIRST_SEED").map_or(1, |text| text.parse().expect("FIRST_SEED is a number"));
    for speed_m_s in [2.0, 3.0, 4.0] {
        let next = AtomicU64::new(0);
        // Of missions that alone end in a collision, and of the others: how the guarded ones end, by duty.
        let counts = std::sync::Mutex::new([[[0_u32; 4]; 2]; 2]);
        std::thread::scope(|scope| {
            for _ in 0..2 {
                scope.spawn(|| {
                    loop {
                        let n = next.fetch_add(1, Ordering::Relaxed);
                        if n >= 200 {
                            break;
                        }
                        let family = if n < 100 { Family::Training } else { Family::Validation };
                        let seed = first_seed + n % 100;
                        let alone = fly(generate(family, seed), seed, speed_m_s, Duty::Fly).0;
                        for (row, duty) in [Duty::JustStop, Duty::FlyAround].into_iter().enumerate() {
                            let (end, nearest_m) = fly(generate(family, seed), seed, speed_m_s, duty);
                            let blocked = usize::from(alone == End::Collision);
                            counts.lock().expect("no panic")[row][blocked][end as usize] += 1;
                            if matches!(end, End::Collision | End::Other) || row == 1 && end != End::Arrived {
                                println!("{family:?} {seed}, {speed_m_s} m/s, {duty:?}: {end:?}, {nearest_m:.2} m");
                            }
                        }
                    }
                });
            }
        });
        let mut table = String::new();
        for (of_duty, duty) in counts
            .into_inner()
            .expect("no panic")
            .iter()
            .zip(["just-stop", "fly-around"])
        {
            for (ends, way) in of_duty.iter().zip(["free", "blocked"]) {
                let [arrived, stopped, collisions, other] = ends;
                writeln!(
                    table,
                    "{speed_m_s} m/s, {duty}, way {way}: {arrived} arrived, {stopped} stopped, {collisions} collisions, {other} other"
                )
                .expect("a text");
            }
        }
        print!("{table}");
    }
}
