//! Just stop: the vehicle flies its own mission straight to the goal, through whatever stands there; Vigil only guards it.

use std::fmt::Write;
use std::sync::atomic::{AtomicU64, Ordering};
use vigil_autopilot::Saved;
use vigil_firmware::{FirmwareConfig, LockstepFirmware};
use vigil_mavlink::common::{COMMAND_LONG_DATA, MavCmd};
use vigil_mavlink::framing::{MAX_PACKET_LEN, serialize};
use vigil_mavlink::{MavHeader, MavMessage, globe};
use vigil_sim::{SimConfig, Simulator, Start};
use vigil_types::{Datagrams, DepthFrame, Duty, Reason, VehicleMode};
use vigil_world::{Course, Family, Outcome, generate};

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

/// The vehicle's plan: one waypoint, the goal, at so many metres per second.
fn plan(config: &SimConfig, speed_m_s: f32) -> Saved {
    let goal = config.course.goal_ned_m();
    let home = config.endpoint.home;
    let (latitude, longitude) = globe::to_global((home.latitude_deg, home.longitude_deg), goal.x, goal.y);
    let text = format!(
        "[parameters]\nMPC_XY_CRUISE = {speed_m_s:?}\n[[mission]]\ncommand = 16\nframe = 6\nautocontinue = 1\n\
         params = [0.0, 0.0, 0.0, nan]\nx = {}\ny = {}\nz = {:?}\n",
        (latitude * 1e7).round() as i32,
        (longitude * 1e7).round() as i32,
        -goal.z
    );
    toml::from_str(&text).expect("a plan")
}

/// A command of a ground station: fly the mission.
fn start_mission() -> Vec<u8> {
    let message = MavMessage::COMMAND_LONG(COMMAND_LONG_DATA {
        command: MavCmd::MAV_CMD_DO_SET_MODE,
        param1: 129.0,
        param2: 4.0,
        param3: 4.0,
        target_system: 1,
        target_component: 1,
        ..COMMAND_LONG_DATA::DEFAULT
    });
    let header = MavHeader {
        system_id: 255,
        component_id: 190,
        sequence: 0,
    };
    let mut out = [0; MAX_PACKET_LEN];
    let len = serialize(header, &message, &mut out).expect("fits");
    out[..len].to_vec()
}

/// Flies the mission over a course; how it ended, and the least distance to an obstacle on the way.
fn fly(course: Course, seed: u64, speed_m_s: f32, duty: Duty) -> (End, f32) {
    let mut simulation = SimConfig::new(course, seed);
    simulation.start = Start::Airborne;
    simulation.saved = plan(&simulation, speed_m_s);
    let mut simulator = Simulator::new(&simulation, 0).expect("valid");
    let config = FirmwareConfig {
        duty,
        engage: vigil_types::EngagePolicy::Command,
        ..FirmwareConfig::to_goal(simulation.course.goal_ned_m())
    };
    let mut firmware = LockstepFirmware::new(&config).expect("a firmware");
    let mut frame = Box::new(DepthFrame::EMPTY);
    let (mut to_firmware, mut from_firmware) = (Box::<Datagrams>::default(), Box::<Datagrams>::default());
    let (mut nearest_m, mut stood) = (f32::INFINITY, 0);
    for step in 0..2400 {
        if step == 40 {
            simulator.receive(0, &start_mission());
        }
        simulator.lockstep(&from_firmware, &mut frame, &mut to_firmware);
        from_firmware.clear();
        let report = firmware.step(simulator.now_ns(), Some(&frame), &to_firmware, &mut from_firmware);
        assert_eq!(report.setpoint, None, "a guard gives no setpoints");
        nearest_m = nearest_m.min(simulator.obstacle_distance_m());
        let end = match simulator.ending().map(|ending| ending.outcome) {
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

/// `cargo test --release -p vigil-tests --test just_stop -- --ignored --nocapture`
#[test]
#[ignore = "200 missions, each flown with and without the guard: minutes"]
fn two_hundred_missions() {
    for speed_m_s in [2.0, 3.0, 4.0] {
        let mut table = String::new();
        for family in [Family::Training, Family::Validation] {
            let next = AtomicU64::new(1);
            let counts = std::sync::Mutex::new([[0; 4]; 2]);
            let nearest = std::sync::Mutex::new(f32::INFINITY);
            std::thread::scope(|scope| {
                for _ in 0..2 {
                    scope.spawn(|| {
                        loop {
                            let seed = next.fetch_add(1, Ordering::Relaxed);
                            if seed > 100 {
                                break;
                            }
                            let alone = fly(generate(family, seed), seed, speed_m_s, Duty::Fly).0;
                            let (guarded, nearest_m) = fly(generate(family, seed), seed, speed_m_s, Duty::JustStop);
                            let row = usize::from(alone == End::Collision);
                            counts.lock().expect("no panic")[row][guarded as usize] += 1;
                            if guarded == End::Stopped {
                                let mut nearest = nearest.lock().expect("no panic");
                                *nearest = nearest.min(nearest_m);
                            }
                            if guarded == End::Collision || guarded == End::Other {
                                println!("{family:?} {seed} at {speed_m_s} m/s: alone {alone:?}, guarded {guarded:?}");
                            }
                        }
                    });
                }
            });
            let counts = counts.into_inner().expect("no panic");
            for (row, way) in counts.iter().zip(["free", "blocked"]) {
                writeln!(
                    table,
                    "{family:?}, {speed_m_s} m/s, way {way}: {} arrived, {} stopped, {} collisions, {} other",
                    row[0], row[1], row[2], row[3]
                )
                .expect("a text");
            }
            let nearest_m = nearest.into_inner().expect("no panic");
            writeln!(table, "{family:?}: nearest obstacle of a stopped one {nearest_m:.2} m").expect("a text");
        }
        print!("{table}");
    }
}
