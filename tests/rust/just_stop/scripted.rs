//! Scripted autopilots: both flavours, refusals, silence and jumps.

use super::models::column_at;
use super::*;

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
        let mut course = column_at(wall_m + 4.0, 0.0, 4.0);
        course.columns[0].height_m = 8.0;
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
            stamp_ns: self.now_ns,
            sequence: self.sequence,
            sensor_id: LIDAR_SENSOR_ID,
            ..Shot::at(position_ned_m, Attitude::LEVEL_NORTH)
        };
        self.lidar.capture(&self.world, &shot, &mut self.frame);
        let frame = self.sees.then_some(&*self.frame);
        let report = self.firmware.step(self.now_ns, frame, &received, &mut self.sent);
        assert_eq!(report.setpoint, None);
        self.texts.extend(vigil_tests::texts(&self.sent));
        for (_, datagram) in self.sent.iter() {
            self.peer.receive(self.now_ns, datagram);
        }
    }

    fn run_s(&mut self, s: f32) {
        for _ in 0..(s * 20.0) as u32 {
            self.step();
        }
    }

    fn was_said(&self, part: &str) -> bool {
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
        assert!(f.was_said("stop: something "), "{:?}", f.texts);
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
fn a_px4_is_sent_the_mode_and_then_the_place_where_it_can_stop_and_one_that_refuses_the_place_holds_by_its_mode() {
    for (flavour, refuses_places) in [(Flavour::Px4, false), (Flavour::Px4, true), (Flavour::ArduPilot, false)] {
        // A heartbeat comes once a second: here not between the place and its refusal.
        let wall_m = 41.0;
        let mut f = Guarded::before_a_wall(flavour, wall_m);
        f.peer.refuses_places = refuses_places;
        let mut told_at_m = None;
        for _ in 0..400 {
            f.step();
            if told_at_m.is_none() && f.mode_changes() > 0 {
                told_at_m = Some(f.peer.north_m);
            }
        }
        let told_at_m = told_at_m.expect("it was ordered to hold");
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
        assert!((y - 85_455_940).abs() < 20 && place_m < wall_m - 0.3);
        assert_eq!((speed_m_s, flags), (1.0, 1.0), "slowly, and in hold");
        assert!(altitude_m.is_nan(), "at its height");
        assert_eq!(f.was_said("refused"), refuses_places, "{:?}", f.texts);
        assert!(f.peer.places.len() <= 2, "{}", f.peer.places.len());
    }
}

#[test]
fn a_px4_that_is_set_to_brake_slowly_is_stopped_by_what_its_parameters_say_and_one_that_sends_none_is_named() {
    for answers in [true, false] {
        let mut f = Guarded::before_a_wall(Flavour::Px4, 30.0);
        (f.peer.gain_m_s2, f.peer.reports_parameters) = (0.8, answers);
        f.run_s(25.0);
        assert!(f.holds() && f.peer.speed_north_m_s == 0.0);
        let shown = (answers, f.nearest_m, &f.texts);
        // Braking from 3 m/s takes it 5.6 m, where 4.9 are reckoned with.
        assert!(if answers { f.nearest_m > 1.5 } else { f.nearest_m < 1.0 }, "{shown:?}");
        assert_eq!(f.was_said("MPC_ACC_HOR is not known"), !answers, "{shown:?}");
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
        assert!(f.holds() && f.was_said("does not look"), "{:?}", f.texts);
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
        assert!(f.holds() && f.was_said("nobody sees the course"), "{:?}", f.texts);
    }
}

#[test]
fn a_vehicle_that_never_reports_its_position_is_said_to_be_unguarded_and_is_not_commanded() {
    for flavour in BOTH {
        let mut f = Guarded::before_a_wall(flavour, 8.0);
        f.tells_position = false;
        f.run_s(3.0);
        assert!(f.was_said("not guarded"), "{:?}", f.texts);
        assert_eq!((f.peer.mode, f.mode_changes()), (Mode::Mission, 0));
    }
}

#[test]
fn a_mission_faster_than_it_can_be_stopped_is_said_to_be_unguarded_once() {
    for (flavour, cruise_m_s) in [(Flavour::Px4, 5.0), (Flavour::Px4, 10.0), (Flavour::ArduPilot, 10.0)] {
        let mut f = Guarded::before_a_wall(flavour, 400.0);
        f.peer.cruise_m_s = cruise_m_s;
        f.run_s(8.0);
        let unguarded = f.texts.iter().filter(|text| text.contains("not guarded: faster"));
        let times = unguarded.count();
        assert_eq!(times, usize::from(cruise_m_s > 5.5), "{cruise_m_s} m/s: {:?}", f.texts);
    }
}

#[test]
fn a_position_that_jumps_is_reported_and_the_flight_is_guarded_by_what_is_seen_from_there() {
    for flavour in BOTH {
        let mut f = Guarded::before_a_wall(flavour, 30.0);
        f.run_s(3.0);
        f.peer.north_m += 12.0;
        f.step();
        assert!(f.was_said("the position jumped"), "{:?}", f.texts);
        f.run_s(10.0);
        assert!(f.holds() && f.nearest_m > 0.3, "{flavour:?} {}", f.nearest_m);
    }
}

#[test]
fn a_stop_that_is_refused_is_asked_for_again_and_reported() {
    for flavour in BOTH {
        let mut f = Guarded::before_a_wall(flavour, 20.0);
        f.peer.quirks.push(Quirk {
            command: 176,
            answer: Some(MavResult::MAV_RESULT_DENIED),
            times: 1,
        });
        f.run_s(12.0);
        assert!(f.holds() && f.was_said("refused"), "{:?}", f.texts);
    }
}

/// `cargo test --release -p vigil-tests --test just_stop -- --ignored --nocapture scripted`
#[test]
#[ignore = "200 missions of scripted vehicles: a minute"]
fn two_hundred_missions_of_scripted_vehicles() {
    for flavour in BOTH {
        let (mut collisions, mut nearest_m) = (0, f32::INFINITY);
        for n in 0..100_u16 {
            let part = |of: u16| f32::from(n % of) / f32::from(of - 1);
            let (north_m, east_m) = (7.0 + 13.0 * part(25), 0.4 * (2.0 * part(7) - 1.0));
            let course = column_at(north_m, east_m, 0.15 + 0.5 * part(5));
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
