//! Just stop: the vehicle flies its own mission straight to the goal, through whatever stands there; Vigil only guards it.

mod models;
mod scripted;

use vigil_firmware::{FirmwareConfig, LockstepFirmware};
use vigil_mavlink::Flavour;
use vigil_mavlink::common::MavResult;
use vigil_mavlink::framing::{FramingCounters, packets};
use vigil_sim::vehicle::{HoldLaw, VehicleModel, VehicleParams, Wind};
use vigil_sim::world::{BoxObstacle, Column, Course, Family, Lidar, LidarConfig, Outcome, Shot, World, generate};
use vigil_sim::{LIDAR_SENSOR_ID, SimConfig};
use vigil_tests::peer::{Mode, Peer, Quirk};
use vigil_tests::{Pair, airborne, mission, side_by_side, without};
use vigil_types::{
    Attitude, Datagrams, DepthFrame, Duty, EngagePolicy, Nanos, NedVector, PilotKind, Reason, STEP_NS, VehicleMode,
};

const LOCAL_POSITION_NED: u32 = 32;
const GPS_GLOBAL_ORIGIN: u32 = 49;
const PARAM_VALUE: u32 = 22;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum End {
    Arrived,
    /// The guard stopped it, and it stood for five seconds.
    Stopped,
    Collision,
    /// Neither within two minutes, or out of the course's bounds.
    Other,
}

#[derive(Debug, Clone, Copy)]
struct Flown {
    end: End,
    /// Least distance to an obstacle, metres.
    nearest_m: f32,
    stop: Option<Stop>,
}

/// How a mission was stopped, from where it was first ordered to hold.
#[derive(Debug, Clone, Copy)]
struct Stop {
    at_ned_m: NedVector,
    speed_m_s: f32,
    /// Metres to the nearest column there.
    obstacle_m: f32,
    /// How far it went on, and where it was at the end, metres.
    stopping_m: f32,
    rests_m: f32,
}

/// What a mission takes that is begun, and stopped as soon as it is seen to move: measured on `px4-sih` and `px4-light`, metres.
const START_AND_STOP_M: f32 = 3.4;

/// PX4's own hold takes 1.31 to 1.48 s times the speed (docs/vehicle.md), metres per metre per second.
const HOLD_TRAVEL_S: f32 = 1.4;

impl Stop {
    /// The way that the vehicle needs: what it took, what its own hold takes where it was sent a nearer place, or what it would have
    /// taken had it begun to move.
    fn needed_m(&self) -> f32 {
        if self.speed_m_s < 0.3 {
            START_AND_STOP_M
        } else {
            self.stopping_m.max(HOLD_TRAVEL_S * self.speed_m_s)
        }
    }

    fn follow(&mut self, here: NedVector) {
        self.rests_m = (here - self.at_ned_m).horizontal_norm();
        self.stopping_m = self.stopping_m.max(self.rests_m);
    }
}

/// Metres over the ground from a place to a column's surface.
fn away_m(from_ned_m: NedVector, column: &Column) -> f32 {
    (column.north_m - from_ned_m.x).hypot(column.east_m - from_ned_m.y) - column.radius_m
}

/// Flies the straight mission over a course.
fn fly(course: Course, seed: u64, speed_m_s: f32, duty: Duty) -> Flown {
    fly_as(VehicleParams::default(), course, seed, duty, &Plan::straight(speed_m_s))
}

/// A mission to the course's goal.
#[derive(Debug, Clone)]
struct Plan {
    speed_m_s: f32,
    /// By way of these places, metres north and east.
    via_m: Vec<(f32, f32)>,
    /// Where the nose points, degrees from north, if not to the next place.
    nose_deg: Option<f32>,
    wind: Wind,
    /// A frame comes in every so many steps.
    frame_every: usize,
    /// How a ground station has it begun.
    command: fn(&SimConfig) -> Vec<u8>,
}

impl Plan {
    fn straight(speed_m_s: f32) -> Self {
        Self {
            speed_m_s,
            via_m: vec![],
            nose_deg: None,
            wind: Wind::default(),
            frame_every: 1,
            command: |_| mission::start(),
        }
    }
}

fn fly_as(vehicle: VehicleParams, course: Course, seed: u64, duty: Duty, plan: &Plan) -> Flown {
    let columns = course.columns.clone();
    let mut simulation = airborne(course, seed);
    simulation.vehicle = vehicle;
    simulation.wind = plan.wind;
    simulation.saved = mission::plan(&simulation, plan.speed_m_s, &plan.via_m, plan.nose_deg);
    let mut config = FirmwareConfig::to_goal(simulation.course.goal_ned_m());
    (config.duty, config.engage) = (duty, EngagePolicy::Command);
    config.pilot.kind = PilotKind::Geometric;
    let mut pair = Pair::of(&simulation, &config);
    let (mut end, mut nearest_m, mut stood) = (End::Other, f32::INFINITY, 0);
    let mut stop: Option<Stop> = None;
    for step in 0..2400 {
        if step == 40 {
            pair.simulator.receive(0, &(plan.command)(&simulation));
        }
        pair.simulate();
        // The simulated autopilot speaks as PX4 does. An ArduCopter is sent no place and brakes by its mode, by
        // no parameter: so is one without either.
        if vehicle.control.hold == HoldLaw::Brake {
            // Where its local origin is on the globe, and what it brakes with.
            pair.to_firmware = without(&pair.to_firmware, &[GPS_GLOBAL_ORIGIN, PARAM_VALUE]);
        }
        let report = pair.decide(step % plan.frame_every == 0);
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
                stopping_m: 0.0,
                rests_m: 0.0,
            });
        }
        stop.iter_mut().for_each(|stop| stop.follow(truth.position_ned_m));
        if let Some(outcome) = pair.outcome() {
            end = match outcome {
                Outcome::Success => End::Arrived,
                Outcome::Collision => End::Collision,
                _ => End::Other,
            };
            break;
        }
        let holds = report.telemetry.heartbeat.is_some_and(|h| h.mode == VehicleMode::Hold);
        let stands = holds && truth.velocity_ned_m_s.horizontal_norm() < 0.4;
        stood += u32::from(stands && report.reasons.contains(Reason::CollisionCourse));
        if stood == 100 {
            end = End::Stopped;
            break;
        }
    }
    Flown { end, nearest_m, stop }
}

/// The same course with everything taken away that stands.
fn emptied(mut course: Course) -> Course {
    course.clear_obstacles();
    course
}

/// On the first courses whose straight way is blocked it is stopped before what stands there, and arrives where nothing does.
fn is_stopped_only_before_something(plan: &Plan) {
    let fly = |course, seed, duty| fly_as(VehicleParams::default(), course, seed, duty, plan);
    let blocked: Vec<u64> = (1..20)
        .filter(|seed| fly(generate(Family::Training, *seed), *seed, Duty::Fly).end == End::Collision)
        .take(3)
        .collect();
    assert_eq!(blocked.len(), 3, "{blocked:?}");
    for seed in blocked {
        let course = generate(Family::Training, seed);
        let flown = fly(course.clone(), seed, Duty::JustStop);
        assert_eq!(flown.end, End::Stopped, "course {seed}: {flown:?}");
        let flown = fly(emptied(course), seed, Duty::JustStop);
        assert_eq!(flown.end, End::Arrived, "course {seed}");
    }
}

#[test]
fn a_mission_through_an_obstacle_is_stopped_before_it_and_a_free_one_arrives() {
    is_stopped_only_before_something(&Plan::straight(3.0));
}

/// DO_REPOSITION leaves the vehicle in hold, which is not standing still.
#[test]
fn a_go_to_through_an_obstacle_is_stopped_before_it_and_a_free_one_arrives() {
    is_stopped_only_before_something(&Plan {
        command: mission::go_to,
        ..Plan::straight(3.0)
    });
}

#[test]
fn a_mission_that_was_stopped_is_flown_around_and_handed_back() {
    for seed in [2, 3] {
        let flown = fly(generate(Family::Training, seed), seed, 3.0, Duty::FlyAround);
        assert_eq!(flown.end, End::Arrived, "course {seed}: {flown:?}");
    }
}
