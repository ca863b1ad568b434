mod odometry;
mod parallax;
mod poses;
mod shadow;

use super::*;
use core::f32::consts::PI;
use std::{boxed::Box, vec::Vec};
use vigil_types::{
    AttitudeSample, DEPTH_COLS, DEPTH_FULL_SCALE_M, DEPTH_PIXELS, FrdVector, Heartbeat, Kinematics, STEP_NS, STEP_S,
    column_bearing_rad, row_elevation_rad,
};

/// A hall with a floor and pillars, and a vehicle that flies through it at 1.5 m/s while it turns and sways.
struct Flight {
    plausibility: Box<PlausibilityCheck>,
    frame: Box<DepthFrame>,
    telemetry: VehicleTelemetry,
    step: u64,
    yaw_rate_rad_s: f32,
    /// How far the sensor is turned on its mount.
    mount_rad: f32,
    /// How much wider the sensor's view is than it is taken for.
    width: f32,
    speed_m_s: f32,
    climb_m_s: f32,
    /// How far the vehicle rolls to and fro.
    sway_rad: f32,
    /// A roll that the estimate takes for one to the other side.
    misread_roll_rad: f32,
    position: NedVector,
    yaw_rad: f32,
}

/// North, east and radius of the pillars; the hall's walls are 6 m to either side and 60 m ahead.
const PILLARS: [(f32, f32, f32); 6] = [
    (6.0, 2.0, 0.4),
    (9.0, -2.2, 0.5),
    (13.0, 1.8, 0.3),
    (17.0, -2.0, 0.6),
    (22.0, 2.2, 0.4),
    (28.0, -1.8, 0.5),
];

fn range_m(from: NedVector, ray: NedVector) -> f32 {
    let mut nearest = f32::INFINITY;
    let mut hit = |t: f32| {
        if t > 0.0 && t < nearest {
            nearest = t;
        }
    };
    hit(-from.z / ray.z);
    hit((60.0 - from.x) / ray.x);
    hit((6.0 - from.y) / ray.y);
    hit((-6.0 - from.y) / ray.y);
    for (north, east, radius) in PILLARS {
        let (x, y) = (from.x - north, from.y - east);
        let (a, b) = (ray.x * ray.x + ray.y * ray.y, x * ray.x + y * ray.y);
        let root = b * b - a * (x * x + y * y - radius * radius);
        if root > 0.0 {
            hit((-b - libm::sqrtf(root)) / a);
        }
    }
    nearest
}

/// Where a pixel of a view so many times as wide looks.
fn ray(pixel: usize, width: f32) -> FrdVector {
    let bearing = width * column_bearing_rad((pixel % DEPTH_COLS) as f32);
    let elevation = row_elevation_rad((pixel / DEPTH_COLS) as f32);
    let (level, up) = (libm::cosf(elevation), libm::sinf(elevation));
    FrdVector::new(level * libm::cosf(bearing), level * libm::sinf(bearing), -up)
}

impl Flight {
    fn new() -> Self {
        let mut flight = Self {
            plausibility: Box::default(),
            frame: Box::new(DepthFrame::EMPTY),
            telemetry: VehicleTelemetry::default(),
            step: 20,
            yaw_rate_rad_s: 0.2,
            mount_rad: 0.0,
            width: 1.0,
            speed_m_s: 1.5,
            climb_m_s: 0.0,
            sway_rad: 0.03,
            misread_roll_rad: 0.0,
            position: NedVector::new(0.0, 0.0, -1.5),
            yaw_rad: -0.1,
        };
        flight.look();
        flight
    }

    /// Flies a step and takes the next frame, which is as it should be.
    fn look(&mut self) {
        self.step += 1;
        let time_s = self.step as f32 * STEP_S;
        let sway = libm::sinf(2.0 * time_s);
        self.yaw_rad += self.yaw_rate_rad_s * sway * STEP_S;
        let velocity = vigil_types::HeadingVector::new(self.speed_m_s, 0.0, -self.climb_m_s).to_ned(self.yaw_rad);
        self.position = self.position + velocity * STEP_S;
        let (roll_rad, pitch_rad) = (self.sway_rad * sway, -0.08 * self.speed_m_s / 1.5);
        let rolled = |more_rad| Attitude::from_euler_rad(roll_rad + more_rad, pitch_rad, self.yaw_rad);
        let attitude = rolled(self.misread_roll_rad);
        let sensor = turned_by_exactly(rolled(-self.misread_roll_rad), self.mount_rad);
        let mut noise = self.step as u32;
        for (pixel, depth) in self.frame.depth.iter_mut().enumerate() {
            let range_m = range_m(self.position, sensor.to_ned(ray(pixel, self.width)));
            let noise_m = 0.04 * (random(&mut noise) - 0.5);
            *depth = ((range_m + noise_m) / DEPTH_FULL_SCALE_M).min(1.0);
        }
        let now_ns = self.step * STEP_NS;
        let header = &mut self.frame.header;
        (header.stamp_ns, header.sequence) = (now_ns, self.step);
        (header.position_ned_m, header.attitude) = (self.position, attitude);
        self.telemetry = VehicleTelemetry {
            heartbeat: Some(Heartbeat {
                at_ns: now_ns,
                armed: true,
                mode: VehicleMode::External,
                failsafe: false,
            }),
            kinematics: Some(Kinematics::new(now_ns, self.position, velocity)),
            attitude: Some(AttitudeSample::new(now_ns, attitude, FrdVector::ZERO)),
            ..VehicleTelemetry::default()
        };
    }

    /// Flies on; each frame is spoiled before it is checked. The faults after each step.
    fn fly(&mut self, steps: usize, mut spoil: impl FnMut(&mut DepthFrame)) -> Vec<Reasons> {
        let step = |_| {
            self.look();
            spoil(&mut self.frame);
            self.check()
        };
        (0..steps).map(step).collect()
    }

    fn check(&mut self) -> Reasons {
        self.plausibility.check(&self.frame, &self.telemetry)
    }

    /// The vehicle is taken to be elsewhere by so much.
    fn misplace(&mut self, error_m: NedVector) {
        let kinematics = self.telemetry.kinematics.as_mut().unwrap();
        for position_ned_m in [&mut self.frame.header.position_ned_m, &mut kinematics.position_ned_m] {
            *position_ned_m = *position_ned_m + error_m;
        }
    }

    /// The first doubt of the next steps and after how many steps it came.
    fn first_fault(&mut self, steps: usize, spoil: impl FnMut(&mut DepthFrame)) -> Option<(usize, Reasons)> {
        let faults = self.fly(steps, spoil).into_iter().enumerate();
        faults.into_iter().find(|(_, faults)| !faults.is_empty())
    }
}

fn turned_by_exactly(attitude: Attitude, angle: f32) -> Attitude {
    let (s, c) = (libm::sinf(angle / 2.0), libm::cosf(angle / 2.0));
    let Attitude { w, x, y, z } = attitude;
    Attitude {
        w: w * c - z * s,
        x: x * c + y * s,
        y: y * c - x * s,
        z: z * c + w * s,
    }
}

fn good(_: &mut DepthFrame) {}

/// The next of a row of numbers from 0 to 1 that look random.
fn random(state: &mut u32) -> f32 {
    *state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
    (*state >> 8) as f32 / (1 << 24) as f32
}

/// Each range that is seen longer or shorter by so many 255ths of 100 m.
fn rough(size: f32) -> impl FnMut(&mut DepthFrame) {
    let mut state = 1;
    move |frame| {
        for depth in frame.depth.iter_mut().filter(|depth| **depth < 1.0) {
            let sign = if random(&mut state) < 0.5 { 1.0 } else { -1.0 };
            *depth = (*depth + sign * size / 255.0).clamp(0.0, 1.0);
        }
    }
}

fn mirror(frame: &mut DepthFrame) {
    frame.depth.chunks_exact_mut(DEPTH_COLS).for_each(<[f32]>::reverse);
}

/// These pixels stay as they are in the first frame.
fn freeze(pixels: core::ops::Range<usize>) -> impl FnMut(&mut DepthFrame) {
    let mut kept: Option<Box<[f32; DEPTH_PIXELS]>> = None;
    move |frame| {
        let kept = kept.get_or_insert_with(|| Box::new(frame.depth));
        frame.depth[pixels.clone()].copy_from_slice(&kept[pixels.clone()]);
    }
}

/// A story in which the sensor fails after 2 s of good flight, and how soon it is found at the latest.
fn found(name: &str, reason: Reason, within_steps: usize, spoil: impl FnMut(&mut DepthFrame)) -> Flight {
    let mut flight = Flight::new();
    assert_eq!(flight.first_fault(40, good), None, "{name}: before");
    let (steps, faults) = flight
        .first_fault(60, spoil)
        .unwrap_or_else(|| panic!("{name} is not found"));
    assert!(
        faults.contains(reason) && steps < within_steps,
        "{name}: {faults:?} after {steps} steps"
    );
    flight
}

#[test]
fn a_good_flight_is_not_doubted_nor_is_one_at_half_the_frame_rate() {
    assert_eq!(Flight::new().first_fault(200, good), None);
    let mut flight = Flight::new();
    for step in 0..200 {
        flight.look();
        if step % 2 == 0 {
            assert_eq!(flight.check(), Reasons::NONE, "step {step}");
        }
    }
}

#[test]
fn what_a_sensor_sees_is_smooth_for_the_most_part_and_what_an_attacker_adds_pixel_by_pixel_is_not() {
    let mut flight = Flight::new();
    let mut least = 1.0_f32;
    for _ in 0..60 {
        flight.look();
        flight.check();
        least = least.min(flight.plausibility.smooth_share().expect("something is seen"));
    }
    assert!(least > 0.7, "{least}");
    for size in [1.0, 5.0, 20.0] {
        flight.fly(1, rough(size));
        let share = flight.plausibility.smooth_share().expect("something is seen");
        assert!(share < 0.6, "{size}/255: {share}");
    }
    // A sky says nothing.
    flight.frame.depth = [1.0; DEPTH_PIXELS];
    flight.check();
    assert_eq!(flight.plausibility.smooth_share(), None);
}

#[test]
fn a_sensor_that_sees_nothing_is_blind_within_two_frames_and_sees_again_after_three() {
    found("zeros", Reason::BlindSensor, 2, |f| f.depth = [0.0; DEPTH_PIXELS]);
    for (name, pixels) in [("ones", DEPTH_PIXELS), ("upper half dead", DEPTH_PIXELS / 2)] {
        let mut flight = found(name, Reason::BlindSensor, 2, |f| f.depth[..pixels].fill(1.0));
        let faults = flight.fly(4, good);
        assert!(
            faults[1].contains(Reason::BlindSensor) && faults[2].is_empty(),
            "{name}: {faults:?}"
        );
    }
    let half = |columns: core::ops::Range<usize>, value: f32| {
        move |frame: &mut DepthFrame| {
            for row in frame.depth.chunks_exact_mut(DEPTH_COLS) {
                row[columns.clone()].fill(value);
            }
        }
    };
    found("left half dead", Reason::BlindSensor, 2, half(0..128, 1.0));
    found("right half dead", Reason::BlindSensor, 2, half(128..256, 1.0));
    found("columns of zeros", Reason::BlindSensor, 2, half(100..108, 0.0));
    let mut state = 1;
    found("ranges of anywhere", Reason::BlindSensor, 2, |f| {
        f.depth.fill_with(|| random(&mut state))
    });
    let name = "ranges of which each is 7.8 m too long or too short";
    found(name, Reason::BlindSensor, 2, rough(20.0));
    found("lower half dead", Reason::BlindSensor, 2, |f| {
        f.depth[DEPTH_PIXELS / 2..].fill(1.0)
    });
}

#[test]
fn what_leaves_the_view_by_itself_is_no_dead_side() {
    let without_wall = |f: &mut DepthFrame| {
        for depth in &mut f.depth[..DEPTH_PIXELS / 2] {
            if *depth * DEPTH_FULL_SCALE_M > 12.0 {
                *depth = 1.0;
            }
        }
    };
    // The last pillar before open sky leaves over the edge.
    let mut flight = Flight::new();
    flight.yaw_rate_rad_s = 0.0;
    flight.position.x = 20.0;
    assert_eq!(flight.first_fault(200, without_wall), None);
    // A single frame without an upper half: a hiccup, no dead sensor.
    let mut flight = Flight::new();
    assert_eq!(flight.first_fault(40, good), None);
    flight.fly(1, |f| f.depth[..DEPTH_PIXELS / 2].fill(1.0));
    assert_eq!(flight.first_fault(40, good), None);
}

#[test]
fn what_moves_beside_the_vehicle_and_goes_away_is_no_fault() {
    // Somebody 0.6 m wide and 0.9 m away crosses the view from left to right, stays before it a while, and goes on.
    for stays in [0, 40] {
        let mut flight = Flight::new();
        flight.speed_m_s = 0.3;
        let mut step = 0_usize;
        let faults = flight.fly(200, |frame| {
            step += 1;
            let moving = step.min(step.saturating_sub(stays).max(90));
            let middle = 2 * moving as i32 - 60;
            for (pixel, depth) in frame.depth.iter_mut().enumerate() {
                let column = (pixel % DEPTH_COLS) as i32 - middle;
                if column.abs() < 39 {
                    let noise_m = 0.01 * libm::sinf((pixel + 7 * step) as f32);
                    *depth = depth.min((0.9 + noise_m) / DEPTH_FULL_SCALE_M);
                }
            }
        });
        let first = faults.iter().position(|faults| !faults.is_empty());
        assert_eq!(first, None, "stays {stays}");
    }
}

#[test]
fn a_picture_or_a_part_of_it_that_stays_is_frozen() {
    found("the whole", Reason::FrozenSensor, 5, freeze(0..DEPTH_PIXELS));
    found("the upper half", Reason::FrozenSensor, 8, freeze(0..DEPTH_PIXELS / 2));
    let (mut stay, mut noise) = (freeze(0..DEPTH_PIXELS), 1);
    found("under fresh noise", Reason::FrozenSensor, 20, |f| {
        stay(f);
        for depth in &mut f.depth {
            *depth = (*depth + 0.0004 * (random(&mut noise) - 0.5)).clamp(1e-4, 1.0);
        }
    });
}

#[test]
fn a_picture_that_thaws_is_known_again_from_an_earlier_one_even_while_the_vehicle_stands() {
    let mut stay = freeze(0..DEPTH_PIXELS);
    let mut flight = Flight::new();
    assert_eq!(flight.first_fault(40, good), None);
    assert!(flight.first_fault(5, &mut stay).is_some());
    // It stops within a metre.
    flight.fly(10, &mut stay);
    flight.speed_m_s = 0.0;
    let held = flight.fly(100, &mut stay);
    assert!(held.iter().all(|d| d.contains(Reason::FrozenSensor)), "while it is");
    let faults = flight.fly(40, good);
    assert!(faults[39].is_empty(), "{:?}", faults[39]);
    // The second time it stays until the motors are off.
    flight.speed_m_s = 1.5;
    flight.fly(20, good);
    assert!(flight.first_fault(40, freeze(0..DEPTH_PIXELS)).is_some());
    assert!(flight.fly(40, good).iter().all(|d| d.contains(Reason::FrozenSensor)));
    flight.look();
    flight.telemetry.heartbeat.as_mut().unwrap().armed = false;
    assert_eq!(flight.check(), Reasons::NONE);
}

#[test]
fn a_mirrored_or_turned_sensor_is_found_by_the_way_its_picture_moves() {
    let mut flight = Flight::new();
    let (_, faults) = flight.first_fault(80, mirror).expect("mirrored from the start");
    assert_eq!(faults, Reasons::of(Reason::InconsistentPicture));
    assert!(
        flight.fly(40, good).iter().all(|d| !d.is_empty()),
        "until the end of the flight"
    );
    found("mirrored in flight", Reason::InconsistentPicture, 20, mirror);
    for degrees in [-5.0_f32, 5.0] {
        let mut flight = Flight::new();
        flight.mount_rad = degrees.to_radians();
        let (_, faults) = flight.first_fault(80, good).expect("turned");
        assert_eq!(faults, Reasons::of(Reason::InconsistentPicture), "{degrees}");
    }
}

#[test]
fn a_climb_straight_up_whose_roll_is_estimated_wrong_is_no_mirrored_sensor() {
    let mut flight = Flight::new();
    (flight.speed_m_s, flight.yaw_rate_rad_s, flight.sway_rad) = (0.0, 0.0, 0.0);
    flight.position.z = -0.6;
    for (seconds, climb_m_s, misread_rad) in [(3.0, 0.5, 0.008), (4.0, 0.0, 0.0)] {
        flight.climb_m_s = climb_m_s;
        let steps = (seconds / STEP_S) as usize;
        for _ in 0..steps {
            flight.misread_roll_rad += misread_rad / steps as f32;
            let (fault, at) = (flight.first_fault(1, good), flight.position);
            assert_eq!(fault, None, "{climb_m_s} m/s, at {at:?}");
        }
    }
}

/// Whether a flight of 15 s is doubted whose estimate is wrong: the error of its position runs round a circle in six seconds, at this
/// speed.
fn faults_of_a_drifting_flight(mount_rad: f32, width: f32, error_m_s: f32) -> Reasons {
    faults_of_a_flight((mount_rad, width), true, |time_s| {
        let phase = time_s * 2.0 * PI / 6.0;
        let error_m = error_m_s * 6.0 / (2.0 * PI);
        NedVector::new(libm::sinf(phase), libm::cosf(phase), 0.3 * libm::sinf(phase)) * error_m
    })
}

/// What is found of a sensor that is turned and as wide as this, while the estimate, which agrees with itself or not, is off by so much.
fn faults_of_a_flight(mount: (f32, f32), agrees: bool, error_ned_m: impl Fn(f32) -> NedVector) -> Reasons {
    let mut flight = Flight::new();
    (flight.mount_rad, flight.width) = mount;
    flight.plausibility.note_estimate(0.0, agrees);
    let mut faults = (0..300).map(|step| {
        flight.look();
        flight.misplace(error_ned_m(step as f32 * STEP_S));
        flight.check()
    });
    faults.find(|faults| !faults.is_empty()).unwrap_or(Reasons::NONE)
}

#[test]
fn an_estimate_that_drifts_convicts_nobody_and_a_sensor_that_sits_wrong_is_found_beside_it() {
    // Of a GPS's it is 0.06 m/s.
    for error_m_s in [0.03, 0.06, 0.12] {
        let faults = faults_of_a_drifting_flight(0.0, 1.0, error_m_s);
        assert_eq!(faults, Reasons::NONE, "{error_m_s} m/s");
    }
    let turned_rad = 5.0_f32.to_radians();
    for (mount_rad, width, error_m_s) in [
        (turned_rad, 1.0, 0.06),
        (0.0, 0.75, 0.0),
        (0.0, 0.75, 0.06),
        (0.0, 1.25, 0.06),
    ] {
        let faults = faults_of_a_drifting_flight(mount_rad, width, error_m_s);
        let is_found = faults == Reasons::of(Reason::InconsistentPicture);
        assert!(
            is_found,
            "{error_m_s} m/s, turned by {mount_rad}, {width} as wide: {faults:?}"
        );
    }
}

#[test]
fn an_estimate_that_wanders_while_the_vehicle_hovers_convicts_nobody() {
    // A real PX4's (SIH), held for half a minute: 0.7 m, at up to 0.25 m/s.
    let mut flight = Flight::new();
    assert_eq!(flight.first_fault(40, good), None);
    (flight.speed_m_s, flight.yaw_rate_rad_s, flight.sway_rad) = (0.0, 0.0, 0.0);
    // Its velocity does not say so.
    flight.plausibility.note_estimate(0.0, false);
    for step in 0..600 {
        let (s, c) = (libm::sinf(0.025 * step as f32), libm::cosf(0.02 * step as f32));
        flight.look();
        flight.misplace(NedVector::new(0.35 * s, 0.35 * (c - 1.0), 0.3 * s));
        assert_eq!(flight.check(), Reasons::NONE, "{step}");
    }
}

#[test]
fn an_estimate_that_drifts_for_seconds_to_one_side_looks_like_a_turned_sensor_and_convicts_none_if_it_contradicts_itself()
 {
    let aside = |time_s: f32| NedVector::new(0.0, 0.16 * time_s, 0.0);
    let faults = |agrees| faults_of_a_flight((0.0, 1.0), agrees, aside);
    assert_eq!(faults(true), Reasons::of(Reason::InconsistentPicture));
    assert_eq!(faults(false), Reasons::NONE);
}

#[test]
fn an_estimate_that_drifted_while_no_frames_came_convicts_nobody_and_a_mirrored_sensor_is_found_after_the_gap() {
    let after_a_gap = |steps: u64| {
        let mut flight = Flight::new();
        flight.yaw_rate_rad_s = 0.0;
        assert!(flight.fly(30, good).iter().all(|d| d.is_empty()));
        flight.step += steps;
        flight
    };
    // 0.25 m in five seconds, to the side.
    let drifted = |flight: &mut Flight| {
        let faults = (0..40).map(|_| {
            flight.look();
            flight.misplace(NedVector::new(0.0, 0.25, 0.0));
            flight.check()
        });
        faults.fold(Reasons::NONE, Reasons::union)
    };
    assert_eq!(drifted(&mut after_a_gap(100)), Reasons::NONE);
    let (_, faults) = after_a_gap(100).first_fault(80, mirror).expect("mirrored");
    assert_eq!(faults, Reasons::of(Reason::InconsistentPicture));
}

#[test]
fn on_the_ground_what_is_near_is_no_fault_and_nothing_is_held_against_the_next_flight() {
    let mut flight = Flight::new();
    flight.position.z = -0.12;
    flight.speed_m_s = 0.0;
    for armed in [false, true] {
        for _ in 0..40 {
            flight.look();
            flight.telemetry.heartbeat.as_mut().unwrap().armed = armed;
            assert_eq!(flight.check(), Reasons::NONE);
        }
    }
    flight.look();
    flight.frame.depth = [1.0; DEPTH_PIXELS];
    flight.check();
    assert!(flight.check().contains(Reason::BlindSensor));
    // Up, while it may well move up and down.
    while flight.position.z > -2.0 {
        flight.position.z -= 0.04;
        flight.look();
        let (faults, z) = (flight.check(), flight.position.z);
        assert!(z > -0.3 || faults.is_empty(), "{faults:?} at {z}");
    }
}

#[test]
fn an_estimate_that_moves_while_the_vehicle_stands_or_takes_off_convicts_no_sensor() {
    for (landed, mode) in [
        (Landed::OnGround, VehicleMode::Hold),
        (Landed::TakingOff, VehicleMode::Takeoff),
        // An item of a mission, as PX4 names it.
        (Landed::InAir, VehicleMode::Mission),
        (Landed::InAir, VehicleMode::External),
    ] {
        let mut flight = Flight::new();
        if mode == VehicleMode::Mission {
            (flight.speed_m_s, flight.climb_m_s) = (0.0, 0.6);
        }
        let stays = flight.frame.clone();
        let step = |flight: &mut Flight| {
            flight.look();
            flight.frame.depth = stays.depth;
            flight.telemetry.landed = landed;
            flight.telemetry.heartbeat.as_mut().unwrap().mode = mode;
            flight.check()
        };
        let faults = (0..20).map(|_| step(&mut flight)).fold(Reasons::NONE, Reasons::union);
        let expected = match mode {
            VehicleMode::External => Reasons::of(Reason::FrozenSensor),
            _ => Reasons::NONE,
        };
        assert_eq!(faults, expected, "{landed:?}, {mode:?}");
    }
}

#[test]
fn whatever_valid_frames_hold_is_judged_without_a_panic() {
    let mut flight = Flight::new();
    let mut state = 7;
    let mut next = move || random(&mut state);
    for round in 0..60 {
        flight.look();
        let step = 1 + (next() * 300.0) as usize;
        for depth in flight.frame.depth.iter_mut().step_by(step) {
            *depth = [0.0, 1.0, next(), f32::MIN_POSITIVE][(next() * 4.0) as usize % 4];
        }
        if round % 3 == 0 {
            flight.telemetry = VehicleTelemetry::default();
        }
        flight.check();
    }
}
