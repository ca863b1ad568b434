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
use vigil_sim::vehicle::{HoldLaw, VehicleModel, VehicleParams};
use vigil_sim::world::{Column, Course, Family, Lidar, LidarConfig, Outcome, Shot, World, generate};
use vigil_sim::{LIDAR_SENSOR_ID, SimConfig, Start};
use vigil_tests::mission::bytes_of;
use vigil_tests::{Pair, mission};
use vigil_types::{
    Attitude, Datagrams, DepthFrame, Duty, EngagePolicy, Nanos, NedVector, PilotKind, Reason, STEP_NS, VehicleMode,
};

const LOCAL_POSITION_NED: u32 = 32;
const GPS_GLOBAL_ORIGIN: u32 = 49;

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

/// A mission as it was flown.
#[derive(Debug, Clone, Copy)]
struct Flown {
    end: End,
    /// Least distance to an obstacle, metres.
    nearest_m: f32,
    stop: Option<Stop>,
}

/// How a mission was stopped, from where it was first told to hold.
#[derive(Debug, Clone, Copy)]
struct Stop {
    at_ned_m: NedVector,
    speed_m_s: f32,
    /// Metres to the nearest column there.
    obstacle_m: f32,
    /// How far it went on, and where it was at the end, metres.
    way_m: f32,
    rests_m: f32,
}

/// What a mission takes that is begun, and stopped as soon as it is seen to move: measured on `px4-sih` and `px4-light`, metres.
const START_AND_STOP_M: f32 = 3.4;
/// PX4's own hold takes 1.31 to 1.48 s times the speed (docs/vehicle.md), metres per metre per second.
const HOLD_WAY_S: f32 = 1.4;

impl Stop {
    /// The way that the vehicle needs: what it took, what its own hold takes where it was told a nearer place, or what it would have
    /// taken had it begun to move.
    fn needed_m(&self) -> f32 {
        if self.speed_m_s < 0.3 {
            START_AND_STOP_M
        } else {
            self.way_m.max(HOLD_WAY_S * self.speed_m_s)
        }
    }

    fn follow(&mut self, here: NedVector) {
        self.rests_m = (here - self.at_ned_m).horizontal_norm();
        self.way_m = self.way_m.max(self.rests_m);
    }
}

/// Metres over the ground from a place to a column's surface.
fn away_m(from_ned_m: NedVector, column: &Column) -> f32 {
    (column.north_m - from_ned_m.x).hypot(column.east_m - from_ned_m.y) - column.radius_m
}

/// The vehicle never tells where its local origin is on the globe.
fn keep_origin_from(told: &mut Datagrams) {
    let mut kept = Datagrams::default();
    for (link, datagram) in told.iter() {
        let mut counters = FramingCounters::default();
        if packets(datagram, &mut counters).all(|packet| packet.message_id() != GPS_GLOBAL_ORIGIN) {
            kept.push(link, datagram);
        }
    }
    *told = kept;
}

/// Flies the mission over a course; how it ended, and the least distance to an obstacle on the way.
fn fly(course: Course, seed: u64, speed_m_s: f32, duty: Duty) -> (End, f32) {
    let flown = fly_with(VehicleParams::default(), course, seed, speed_m_s, duty);
    (flown.end, flown.nearest_m)
}

fn fly_with(vehicle: VehicleParams, course: Course, seed: u64, speed_m_s: f32, duty: Duty) -> Flown {
    fly_as(vehicle, course, seed, speed_m_s, duty, |_| mission::start())
}

/// The same as a ground station's `command` has it.
fn fly_as(
    vehicle: VehicleParams,
    course: Course,
    seed: u64,
    speed_m_s: f32,
    duty: Duty,
    command: fn(&SimConfig) -> Vec<u8>,
) -> Flown {
    let columns = course.columns.clone();
    let mut simulation = SimConfig::new(course, seed);
    simulation.start = Start::Airborne;
    simulation.vehicle = vehicle;
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
    let mut stop: Option<Stop> = None;
    for step in 0..2400 {
        if step == 40 {
            pair.simulator.receive(0, &command(&simulation));
        }
        pair.simulate();
        // The simulated autopilot speaks as PX4 does. An ArduCopter is told no place and brakes by its mode: so is one without an origin.
        if vehicle.control.hold == HoldLaw::Brake {
            keep_origin_from(&mut pair.to_firmware);
        }
        let report = pair.decide(true);
        assert!(
            report.setpoint.is_none() || duty == Duty::FlyAround,
            "who only stops gives no setpoints"
        );
        nearest_m = nearest_m.min(pair.simulator.obstacle_distance_m());
        let truth = pair.simulator.truth();
        if stop.is_none() && report.reasons.contains(Reason::CollisionCourse) {
            stop = Some(Stop {
                at_ned_m: truth.position_ned_m,
                speed_m_s: truth.velocity_ned_m_s.horizontal_norm(),
                obstacle_m: columns
                    .iter()
                    .map(|c| away_m(truth.position_ned_m, c))
                    .fold(f32::INFINITY, f32::min),
                way_m: 0.0,
                rests_m: 0.0,
            });
        }
        stop.iter_mut().for_each(|stop| stop.follow(truth.position_ned_m));
        let end = match pair.simulator.ending().map(|ending| ending.outcome) {
            Some(Outcome::Success) => Some(End::Arrived),
            Some(Outcome::Collision) => Some(End::Collision),
            Some(_) => Some(End::Other),
            None => None,
        };
        if let Some(end) = end {
            return Flown { end, nearest_m, stop };
        }
        let holds = report.telemetry.heartbeat.is_some_and(|h| h.mode == VehicleMode::Hold);
        stood = match holds && report.reasons.contains(Reason::CollisionCourse) {
            true => stood + 1,
            false => 0,
        };
        if stood == 100 {
            let end = End::Stopped;
            return Flown { end, nearest_m, stop };
        }
    }
    let end = End::Other;
    Flown { end, nearest_m, stop }
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

/// DO_REPOSITION leaves the vehicle in hold, which is not standing still.
#[test]
fn a_go_to_through_an_obstacle_is_stopped_before_it_and_a_free_one_arrives() {
    let go_to = |course: Course, seed: u64, duty| {
        let flown = fly_as(VehicleParams::default(), course, seed, 3.0, duty, mission::go_to);
        (flown.end, flown.nearest_m)
    };
    let blocked: Vec<u64> = (1..20)
        .filter(|seed| go_to(generate(Family::Training, *seed), *seed, Duty::Fly).0 == End::Collision)
        .take(3)
        .collect();
    assert_eq!(blocked.len(), 3, "{blocked:?}");
    for seed in blocked {
        let course = generate(Family::Training, seed);
        let (end, nearest_m) = go_to(course.clone(), seed, Duty::JustStop);
        assert_eq!(end, End::Stopped, "course {seed}, nearest {nearest_m} m");
        assert_eq!(
            go_to(emptied(course), seed, Duty::JustStop).0,
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

/// A PX4's hold projects its place from the velocity alone, and flies back to it where speed was being gained.
#[test]
fn a_px4_is_told_the_mode_and_then_the_place_where_it_can_stop_and_one_that_refuses_the_place_holds_by_its_mode() {
    for (flavour, refuses_places) in [(Flavour::Px4, false), (Flavour::Px4, true), (Flavour::ArduPilot, false)] {
        let mut f = Guarded::before_a_wall(flavour, 40.0);
        f.peer.refuses_places = refuses_places;
        let mut told_at_m = None;
        for _ in 0..400 {
            f.step();
            if told_at_m.is_none() && f.mode_changes() > 0 {
                told_at_m = Some(f.peer.north_m);
            }
        }
        let told_at_m = told_at_m.expect("it was told to hold");
        assert!(f.holds() && f.nearest_m > 0.3, "{flavour:?} {}", f.nearest_m);
        let asked = 1 + usize::from(refuses_places);
        assert_eq!(f.mode_changes(), asked, "the mode first, and again after a refusal");
        let Some((x, y, [speed_m_s, flags, altitude_m])) = f.peer.places.first().copied() else {
            assert_eq!(flavour, Flavour::ArduPilot);
            continue;
        };
        let place_m = (x - 473_977_420) as f32 / 89.932;
        // From 3 m/s: braking at MPC_ACC_HOR takes 2.6 m, the hold of a PX4 4.3 m.
        assert!((2.6..4.3).contains(&(place_m - told_at_m)), "{place_m} {told_at_m}");
        assert!((y - 85_455_940).abs() < 20 && place_m < 40.0 - 0.3);
        assert_eq!((speed_m_s, flags), (1.0, 1.0), "slowly, and in hold");
        assert!(altitude_m.is_nan(), "at its height");
        assert_eq!(f.was_told("refused"), refuses_places, "{:?}", f.texts);
        assert!(f.peer.places.len() <= 2, "{}", f.peer.places.len());
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

/// An open field with one column so far north, so far beside the straight way.
fn column_at(north_m: f32, east_m: f32, radius_m: f32) -> Course {
    let mut course = emptied(generate(Family::Training, 1));
    course.columns = vec![Column {
        north_m,
        east_m,
        radius_m,
        height_m: 5.0,
    }];
    course
}

/// Of one model and missions at 2 to 5 m/s: towards a column that is 3.5 to 18 m away, and every fourth one past a column 3 m beside the way.
#[derive(Debug, Default)]
struct Tally {
    blocked: u32,
    collided: u32,
    stopped: u32,
    arrived: u32,
    /// Told to hold no earlier than 1.5 times the way that it needs, and 1 m and its radius more.
    in_time: u32,
    free: u32,
    false_stops: u32,
    nearest_m: f32,
}

fn missions_of(vehicle: VehicleParams, duty: Duty, first_seed: u64, count: u64) -> Tally {
    let mut tally = Tally {
        nearest_m: f32::INFINITY,
        ..Tally::default()
    };
    // The golden ratio and its square spread seeds evenly.
    let spread = |n: u64, of: f64| (n as f64 * of).fract() as f32;
    for n in first_seed..first_seed + count {
        let speed_m_s = 2.0 + 3.0 * spread(n, 0.618_034);
        let away_m = 3.5 + 14.5 * spread(n, 0.381_966);
        let radius_m = 0.15 + 0.4 * spread(n, 0.754_878);
        let is_free = n % 4 == 3;
        let east_m = if is_free {
            3.0
        } else {
            0.3 * (2.0 * spread(n, 0.569_84) - 1.0)
        };
        let mut course = column_at(0.0, 0.0, radius_m);
        let start = course.start_ned_m();
        let goal = course.goal_ned_m();
        // Along the straight way from start to goal.
        let way = goal - start;
        let (north, east) = (way.x / way.horizontal_norm(), way.y / way.horizontal_norm());
        course.columns[0].north_m = start.x + north * away_m - east * east_m;
        course.columns[0].east_m = start.y + east * away_m + north * east_m;
        let flown = fly_with(vehicle, course, n, speed_m_s, duty);
        if std::env::var_os("EACH").is_some() {
            println!("{n}: {speed_m_s:.1} m/s, {away_m:.1} m, free {is_free}: {flown:?}");
        }
        if is_free {
            tally.free += 1;
            tally.false_stops += u32::from(flown.stop.is_some());
        } else {
            tally.blocked += 1;
            tally.collided += u32::from(flown.end == End::Collision);
            tally.stopped += u32::from(flown.end == End::Stopped);
            tally.arrived += u32::from(flown.end == End::Arrived);
            let is_late = |s: Stop| s.obstacle_m <= 1.5 * s.needed_m() + 1.3;
            tally.in_time += u32::from(flown.stop.is_some_and(is_late));
            tally.nearest_m = tally.nearest_m.min(flown.nearest_m);
        }
    }
    tally
}

#[test]
fn a_mission_towards_something_is_stopped_before_it_on_every_vehicle_model_with_a_noisy_estimate_too() {
    for model in VehicleModel::ALL {
        for vehicle in [model.params(), model.params().with_noisy_estimate()] {
            let tally = missions_of(vehicle, Duty::JustStop, 1, 4);
            println!("{} {tally:?}", model.name());
            assert_eq!((tally.collided, tally.stopped), (0, tally.blocked), "{}", model.name());
        }
    }
}

/// The course of one column on the straight way from start to goal, so many metres away.
fn column_on_the_way(away_m: f32) -> Course {
    let mut course = column_at(0.0, 0.0, 0.4);
    let start = course.start_ned_m();
    let way = course.goal_ned_m() - start;
    let share = away_m / way.horizontal_norm();
    (course.columns[0].north_m, course.columns[0].east_m) = (start.x + way.x * share, start.y + way.y * share);
    course
}

/// PX4 told to hold at 1.9 m/s and 2.7 m/s² goes on to 3.1 m/s, and flies 3 m back to the point that it projected
/// (`sim_bridge/tests/vehicle_models.rs`).
#[test]
fn a_px4_that_is_stopped_while_it_gains_speed_comes_to_rest_where_it_can_and_does_not_fly_back() {
    for model in [VehicleModel::Px4Sih, VehicleModel::Px4Light] {
        for away_m in [6.5, 8.0] {
            let flown = fly_with(model.params(), column_on_the_way(away_m), 1, 5.0, Duty::JustStop);
            println!("{} {away_m} m: {flown:?}", model.name());
            let stop = flown.stop.expect("it was stopped");
            assert_eq!(flown.end, End::Stopped, "{flown:?}");
            assert!(stop.speed_m_s < 3.0, "it gains speed: {stop:?}");
            assert!(stop.way_m - stop.rests_m < 1.2, "{stop:?}");
        }
    }
}

/// ArduCopter's BRAKE loses speed in proportion to it.
#[test]
fn an_arducopter_brakes_in_a_second_and_a_half_times_its_speed_and_that_is_reckoned_with() {
    for speed_m_s in [2.0, 3.5, 5.0] {
        let vehicle = VehicleModel::ArduCopter.params();
        let flown = fly_with(vehicle, column_on_the_way(17.0), 1, speed_m_s, Duty::JustStop);
        println!("{speed_m_s} m/s: {flown:?}");
        let stop = flown.stop.expect("it was stopped");
        assert_eq!(flown.end, End::Stopped, "{flown:?}");
        // What the firmware needs to tell it is in this way.
        let way_s = stop.way_m / stop.speed_m_s;
        assert!((1.2..2.0).contains(&way_s), "{way_s} s: {stop:?}");
        assert!(flown.nearest_m > 0.3, "{flown:?}");
    }
}

#[test]
fn two_missions_in_a_row_through_the_same_wall_are_held_before_they_move_where_it_is_too_near() {
    let course = column_on_the_way(3.5);
    let start = course.start_ned_m();
    let mut simulation = SimConfig::new(course, 1);
    simulation.start = Start::Airborne;
    simulation.vehicle = VehicleModel::Px4Sih.params();
    simulation.saved = mission::plan(&simulation, 5.0);
    let config = FirmwareConfig {
        duty: Duty::JustStop,
        engage: EngagePolicy::Command,
        ..FirmwareConfig::to_goal(simulation.course.goal_ned_m())
    };
    let mut pair = Pair::of(&simulation, &config);
    let mut stops = 0;
    for step in 0..600 {
        if step == 60 || step == 300 {
            pair.simulator.receive(0, &mission::start());
        }
        pair.simulate();
        pair.decide(true);
        stops += usize::from(pair.texts().iter().any(|text| text.contains("stop: something")));
        let moved_m = (pair.simulator.truth().position_ned_m - start).horizontal_norm();
        assert!(moved_m < 1.2, "step {step}: it moved {moved_m} m");
    }
    assert_eq!(stops, 2);
}

/// `MODEL=px4-sih FIRST_SEED=1 MISSIONS=40 cargo test --release -p vigil-tests --test just_stop -- --ignored --nocapture on_a_model`;
/// with NOISY=1 its estimate wanders, with AROUND=1 it is flown around, with EACH=1 every mission is shown.
#[test]
#[ignore = "missions of one vehicle model: minutes"]
fn missions_on_a_model() {
    let variable = |name: &str| std::env::var(name).ok();
    let number = |name: &str, otherwise| variable(name).map_or(otherwise, |text| text.parse().expect("a number"));
    let name = variable("MODEL").unwrap_or_else(|| "px4-sih".to_owned());
    let model = VehicleModel::ALL
        .into_iter()
        .find(|m| m.name() == name)
        .expect("a model's name");
    let vehicle = match variable("NOISY").is_some() {
        true => model.params().with_noisy_estimate(),
        false => model.params(),
    };
    let duty = match variable("AROUND").is_some() {
        true => Duty::FlyAround,
        false => Duty::JustStop,
    };
    println!(
        "{name} {:?}",
        missions_of(vehicle, duty, number("FIRST_SEED", 1), number("MISSIONS", 40))
    );
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
