//! What each command makes the vehicle do, from the ground to the air and back.

use proptest::prelude::*;
use vigil_autopilot::vehicle::{
    ControlCommand, Goal, Held, SensorParams, Truth, Vehicle, VehicleParams, Wind, YawCommand,
};
use vigil_types::{Attitude, FrdVector, HeadingVector, NedVector, wrap_pi};

const BREEZE: Wind = Wind {
    mean_ned_m_s: [4.0, -2.0, 0.0],
    gust_m_s: 0.8,
    gust_time_s: 3.0,
};

const HOVER: ControlCommand = ControlCommand::STOP;

fn vehicle(wind: Wind, seed: u64) -> Vehicle {
    Vehicle::new(VehicleParams::default(), wind, seed).unwrap()
}

/// Noise and estimator error off: for what is measured against an exact figure.
fn precise() -> Vehicle {
    let params = VehicleParams {
        sensors: SensorParams::perfect(),
        ..VehicleParams::default()
    };
    Vehicle::new(params, Wind::CALM, 1).unwrap()
}

fn airborne(mut vehicle: Vehicle) -> Vehicle {
    vehicle.place(NedVector::new(0.0, 0.0, -5.0), 0.0, true);
    vehicle
}

/// Steps for this long and gives the truth after each millisecond.
fn fly(vehicle: &mut Vehicle, seconds: f64, command: &ControlCommand) -> Vec<Truth> {
    (0..(seconds * 1000.0) as u64)
        .map(|_| {
            vehicle.step(command);
            vehicle.truth()
        })
        .collect()
}

/// The greatest of what is read of each.
fn most(truths: &[Truth], read: impl Fn(&Truth) -> f32) -> f32 {
    truths.iter().map(read).fold(f32::MIN, f32::max)
}

fn velocity(north: f32, east: f32, down: f32) -> ControlCommand {
    ControlCommand::VelocityNed(NedVector::new(north, east, down), YawCommand::Hold)
}

fn velocity_ahead(ahead: f32, right: f32, down: f32, yaw: YawCommand) -> ControlCommand {
    ControlCommand::VelocityHeading(HeadingVector::new(ahead, right, down), yaw)
}

fn down(down: f32) -> NedVector {
    NedVector::new(0.0, 0.0, down)
}

fn towards(held: Held, velocity_m_s: NedVector, goal: Goal) -> ControlCommand {
    ControlCommand::Position(Goal {
        held,
        velocity_m_s,
        ..goal
    })
}

fn at_height(velocity_m_s: NedVector, down_m: f32, yaw: YawCommand) -> ControlCommand {
    let goal = Goal::new(down(down_m), yaw, f32::INFINITY);
    towards(Held::Height, velocity_m_s, goal)
}

fn climb(place: NedVector, down_m_s: f32, speed_limit_m_s: f32, yaw: YawCommand) -> ControlCommand {
    let goal = Goal::new(place, yaw, speed_limit_m_s);
    towards(Held::Level, down(down_m_s), goal)
}

fn go_to(place: NedVector, speed_limit_m_s: f32, yaw: YawCommand) -> ControlCommand {
    ControlCommand::Position(Goal::new(place, yaw, speed_limit_m_s))
}

#[test]
fn a_disarmed_vehicle_rests_where_it_stands_even_in_wind() {
    let mut v = vehicle(BREEZE, 1);
    fly(&mut v, 1.0, &ControlCommand::MotorsOff);
    let before = v.truth();
    fly(&mut v, 20.0, &ControlCommand::MotorsOff);
    let after = v.truth();
    assert!((after.position_ned_m - before.position_ned_m).norm() < 2e-3);
    assert!(after.velocity_ned_m_s.norm() < 1e-2);
    assert!((-after.position_ned_m.z - v.standing_height_m() as f32).abs() < 2e-3);
    let view = v.view();
    assert!(view.on_ground && !view.armed);
    assert_eq!(view.sensors.throttle, 0.0);
}

#[test]
fn an_armed_vehicle_stays_on_the_ground_until_it_is_ordered_to_climb() {
    let mut v = vehicle(Wind::CALM, 2);
    let stand = v.truth().position_ned_m;
    let sideways = velocity(1.0, 0.0, 0.0);
    let here = go_to(stand, 1.0, YawCommand::Hold);
    for command in [ControlCommand::Idle, HOVER, sideways, here] {
        fly(&mut v, 3.0, &command);
        let view = v.view();
        assert!(view.armed && view.on_ground, "{command:?}");
        assert!((v.truth().position_ned_m - stand).norm() < 0.01, "{command:?}");
    }
    fly(&mut v, 2.0, &velocity(0.0, 0.0, -1.0));
    assert!(!v.view().on_ground);
    assert!(v.truth().position_ned_m.z < -0.8);
}

#[test]
fn it_takes_off_hovers_lands_softly_and_idles() {
    for wind in [Wind::CALM, BREEZE] {
        let mut v = vehicle(wind, 3);
        fly(&mut v, 0.5, &ControlCommand::Idle);
        let top = NedVector::new(0.0, 0.0, -2.5);
        fly(&mut v, 8.0, &go_to(top, 2.0, YawCommand::Hold));
        let off = (v.truth().position_ned_m - top).norm();
        assert!(off < 0.4, "{off} m from the hover point in {wind:?}");
        assert!(!v.view().on_ground);
        let above = v.truth().position_ned_m;

        let descent = fly(&mut v, 8.0, &ControlCommand::Descend(0.7));
        let touches = |t: &&Truth| -t.position_ned_m.z <= v.standing_height_m() as f32 + 0.002;
        let touch = descent.iter().find(touches).expect("it reaches the ground");
        assert!(touch.velocity_ned_m_s.z < 0.9, "{}", touch.velocity_ned_m_s.z);
        assert!((touch.position_ned_m - above).horizontal_norm() < 0.6);
        let fastest = most(&descent, |t| t.velocity_ned_m_s.z);
        assert!(fastest < 1.0, "{fastest}");
        // Landed for good: upright, still, idling.
        let view = v.view();
        assert!(view.on_ground && view.armed);
        assert!(view.sensors.throttle < 0.05, "{}", view.sensors.throttle);
        let end = v.truth();
        assert!(end.velocity_ned_m_s.norm() < 0.02);
        assert!(end.attitude.roll_rad().abs() < 0.02 && end.attitude.pitch_rad().abs() < 0.02);

        fly(&mut v, 0.5, &ControlCommand::MotorsOff);
        assert!(!v.view().armed);
    }
}

#[test]
fn a_position_is_approached_within_the_speed_limit_and_without_passing_it() {
    let mut v = airborne(precise());
    let goal = NedVector::new(6.0, -8.0, -7.0);
    let truths = fly(&mut v, 14.0, &go_to(goal, 2.0, YawCommand::Hold));
    let fastest = most(&truths, |t| t.velocity_ned_m_s.horizontal_norm());
    assert!(fastest > 1.9 && fastest < 2.1, "{fastest}");
    let direction = NedVector::new(0.6, -0.8, 0.0);
    let past = most(&truths, |t| {
        let d = t.position_ned_m - goal;
        d.x * direction.x + d.y * direction.y
    });
    assert!(past < 0.15, "passed by {past} m");
    assert!((v.truth().position_ned_m - goal).norm() < 0.05);
    // Smooth: the acceleration never jumps by more than a few tenths within 20 ms.
    let velocities: Vec<NedVector> = truths.iter().step_by(20).map(|t| t.velocity_ned_m_s).collect();
    for v in velocities.windows(3) {
        let jump = ((v[2] - v[1]) - (v[1] - v[0])).norm() * 50.0;
        assert!(jump < 0.6, "{jump}");
    }
}

#[test]
fn a_heading_is_reached_the_short_way_round_and_then_held() {
    let mut v = precise();
    v.place(NedVector::new(0.0, 0.0, -5.0), 2.8, true);
    let here = v.truth().position_ned_m;
    let truths = fly(&mut v, 4.0, &go_to(here, 1.0, YawCommand::Angle(-2.8)));
    let is_near = |t: &Truth| t.attitude.yaw_rad().abs() > 2.7;
    assert!(truths.iter().all(is_near), "turned the long way");
    assert!(wrap_pi(v.truth().attitude.yaw_rad() + 2.8).abs() < 0.02);
    fly(&mut v, 5.0, &velocity(1.0, 1.0, 0.0));
    assert!(wrap_pi(v.truth().attitude.yaw_rad() + 2.8).abs() < 0.03);
}

#[test]
fn velocity_follows_the_frame_it_is_given_in() {
    let east = std::f32::consts::FRAC_PI_2;
    for (command, north, easting) in [
        (velocity(1.0, 0.0, 0.0), 1.0, 0.0),
        (velocity_ahead(1.0, 0.0, 0.0, YawCommand::Hold), 0.0, 1.0),
        (velocity_ahead(0.0, 1.0, 0.0, YawCommand::Hold), -1.0, 0.0),
    ] {
        let mut v = precise();
        v.place(NedVector::new(0.0, 0.0, -5.0), east, true);
        fly(&mut v, 5.0, &command);
        let off = v.truth().velocity_ned_m_s - NedVector::new(north, easting, 0.0);
        assert!(off.x.abs() < 0.05 && off.y.abs() < 0.05, "{off:?}");
    }
}

#[test]
fn an_attitude_is_reached_and_half_thrust_carries_the_weight() {
    let mut v = airborne(precise());
    let wanted = Attitude::from_euler_rad(0.2, -0.1, 0.5);
    let truths = fly(&mut v, 2.0, &ControlCommand::Attitude(wanted, 0.0, 0.5));
    let a = v.truth().attitude;
    assert!((a.roll_rad() - 0.2).abs() < 0.01);
    assert!((a.pitch_rad() + 0.1).abs() < 0.01);
    assert!((a.yaw_rad() - 0.5).abs() < 0.02);
    let level = ControlCommand::Attitude(Attitude::LEVEL_NORTH, 0.0, 0.5);
    let hovering = fly(&mut airborne(precise()), 2.0, &level);
    assert!(hovering.iter().all(|t| t.velocity_ned_m_s.norm() < 0.02));
    // Tilted, half thrust no longer does.
    let sink = truths[1999].velocity_ned_m_s.z;
    assert!(sink > 0.1, "{sink}");
}

#[test]
fn an_acceleration_is_flown_and_none_keeps_the_velocity() {
    let mut v = airborne(precise());
    let north = NedVector::new(1.0, 0.0, 0.0);
    fly(&mut v, 2.0, &ControlCommand::Acceleration(north, YawCommand::Hold));
    let faster = v.truth().velocity_ned_m_s;
    // The tilt takes a moment to build up, and there is drag.
    assert!((1.4..2.0).contains(&faster.x) && faster.y.abs() < 0.1, "{faster:?}");
    assert!((v.truth().position_ned_m.z + 5.0).abs() < 0.1);
    let none = ControlCommand::Acceleration(NedVector::ZERO, YawCommand::Rate(0.5));
    fly(&mut v, 1.0, &none);
    assert!(v.truth().velocity_ned_m_s.x > 0.8 * faster.x);
    assert!((v.truth().attitude.yaw_rad() - 0.5).abs() < 0.15);
}

#[test]
fn a_velocity_at_a_height_and_a_climb_at_a_place_keep_what_they_name() {
    let mut v = airborne(precise());
    let east = at_height(NedVector::new(0.0, 2.0, 9.0), -7.0, YawCommand::Hold);
    fly(&mut v, 8.0, &east);
    let t = v.truth();
    assert!((t.velocity_ned_m_s.y - 2.0).abs() < 0.05, "{t:?}");
    assert!((t.position_ned_m.z + 7.0).abs() < 0.05, "{t:?}");
    let up = climb(NedVector::new(3.0, 10.0, 50.0), -0.5, 3.0, YawCommand::Hold);
    fly(&mut v, 10.0, &up);
    let t = v.truth();
    assert!((t.velocity_ned_m_s.z + 0.5).abs() < 0.05, "{t:?}");
    let (north, east) = (t.position_ned_m.x, t.position_ned_m.y);
    assert!((north - 3.0).abs() < 0.1 && (east - 10.0).abs() < 0.1, "{t:?}");
}

#[test]
fn rates_are_reached_about_each_axis() {
    for (axis, rate_rad_s) in [(0, 0.5), (1, -0.5), (2, 0.8)] {
        let on = |n: usize| if n == axis { rate_rad_s } else { 0.0 };
        let wanted = FrdVector::new(on(0), on(1), on(2));
        let mut v = airborne(precise());
        fly(&mut v, 0.8, &ControlCommand::Rates(wanted, 0.5));
        let off = v.truth().rates_frd_rad_s - wanted;
        assert!(off.to_array()[axis].abs() < 0.05 && off.norm() < 0.08, "{off:?}");
    }
}

#[test]
fn it_recovers_a_hover_from_an_upset() {
    let mut v = vehicle(Wind::CALM, 4);
    v.place(NedVector::new(0.0, 0.0, -30.0), 0.0, true);
    fly(&mut v, 0.7, &ControlCommand::Rates(FrdVector::new(3.5, 0.0, 0.0), 0.5));
    assert!(v.truth().attitude.roll_rad().abs() > 1.2);
    fly(&mut v, 8.0, &HOVER);
    let t = v.truth();
    assert!(t.velocity_ned_m_s.norm() < 0.1 && t.position_ned_m.z < -15.0, "{t:?}");
}

#[test]
fn motors_off_in_the_air_is_a_fall_that_ends_on_the_ground() {
    for roll_rad in [0.0, 1.5, 3.0] {
        let mut v = airborne(vehicle(Wind::CALM, 5));
        let tipped = Attitude::from_euler_rad(roll_rad, 0.0, 0.0);
        fly(&mut v, 0.5, &ControlCommand::Attitude(tipped, 0.0, 0.5));
        let falling = fly(&mut v, 0.4, &ControlCommand::MotorsOff);
        let speed_gained = falling[399].velocity_ned_m_s.z - falling[199].velocity_ned_m_s.z;
        // Gravity's 1.96 m/s, less the drag of a fall that is already fast.
        assert!((1.5..2.0).contains(&speed_gained), "{speed_gained} from {roll_rad}");
        fly(&mut v, 6.0, &ControlCommand::MotorsOff);
        let t = v.truth();
        let (speed, rate) = (t.velocity_ned_m_s.norm(), t.rates_frd_rad_s.norm());
        assert!(speed < 0.05 && rate < 0.2, "{t:?}");
        assert!(t.position_ned_m.z < 0.0, "sank into the ground: {t:?}");
        assert!(!v.view().armed && v.view().on_ground);
    }
}

#[test]
fn it_holds_its_place_in_wind_and_gusts() {
    let mut v = airborne(vehicle(BREEZE, 6));
    let truths = fly(&mut v, 20.0, &HOVER);
    let start = NedVector::new(0.0, 0.0, -5.0);
    let off = most(&truths, |t| (t.position_ned_m - start).norm());
    assert!(off < 0.5, "{off}");
    // The wind comes from behind: it leans back, nose up.
    let lean = truths.iter().map(|t| t.attitude.pitch_rad()).sum::<f32>() / truths.len() as f32;
    assert!(lean > 0.03, "mean pitch {lean}");
}

#[test]
fn a_command_that_is_not_finite_is_a_hold() {
    let nan = f32::NAN;
    let nowhere = Attitude {
        w: nan,
        ..Attitude::LEVEL_NORTH
    };
    for command in [
        velocity(nan, 0.0, 0.0),
        velocity_ahead(1.0, f32::INFINITY, 0.0, YawCommand::Rate(nan)),
        go_to(NedVector::new(nan, 0.0, 0.0), 2.0, YawCommand::Hold),
        ControlCommand::Descend(nan),
        ControlCommand::Attitude(nowhere, 0.0, 0.9),
        ControlCommand::Attitude(Attitude::LEVEL_NORTH, nan, 0.9),
        ControlCommand::Acceleration(NedVector::new(1.0, nan, 0.0), YawCommand::Hold),
        at_height(NedVector::new(1.0, 0.0, 0.0), nan, YawCommand::Hold),
        climb(NedVector::ZERO, f32::INFINITY, 2.0, YawCommand::Hold),
        ControlCommand::Rates(FrdVector::new(nan, 0.0, 0.0), 0.9),
    ] {
        let mut v = airborne(precise());
        fly(&mut v, 3.0, &velocity(1.5, 0.0, 0.0));
        fly(&mut v, 5.0, &command);
        let t = v.truth();
        assert!(t.velocity_ned_m_s.norm() < 0.03, "{command:?}: {t:?}");
        assert!((t.position_ned_m.z + 5.0).abs() < 0.1, "{command:?}");
    }
}

#[test]
fn a_state_hash_sees_a_difference_of_one_step_of_one_command() {
    let mut a = airborne(vehicle(Wind::CALM, 1));
    let mut b = a.clone();
    assert_eq!(a.state_hash(), b.state_hash());
    for i in 0..100 {
        a.step(&velocity(1.0, 0.0, 0.0));
        b.step(&velocity(1.0, if i == 40 { 1e-6 } else { 0.0 }, 0.0));
    }
    assert_ne!(a.state_hash(), b.state_hash());
}

#[test]
fn flying_drains_the_battery_and_sags_its_voltage() {
    let mut v = vehicle(Wind::CALM, 1);
    fly(&mut v, 1.0, &ControlCommand::MotorsOff);
    let resting = v.view().sensors;
    let mut v = airborne(vehicle(Wind::CALM, 1));
    fly(&mut v, 30.0, &HOVER);
    let flying = v.view().sensors;
    assert!(flying.battery_voltage_v < resting.battery_voltage_v - 0.2);
    // A 2 kg quadcopter of this size hovers on 15 to 25 A.
    let current_a = flying.battery_current_a;
    assert!((15.0..25.0).contains(&current_a), "{current_a}");
    let used_ah = (1.0 - flying.battery_remaining) * 5.0;
    assert!((used_ah - current_a * 30.0 / 3600.0).abs() < 0.02, "{used_ah}");
}

#[test]
fn at_rest_the_accelerometer_feels_gravity_and_the_estimate_is_off_by_centimetres() {
    let mut v = vehicle(Wind::CALM, 9);
    let (mut specific, mut squares, mut angle_squares) = (0.0f64, 0.0f64, 0.0f64);
    let n = 2_000;
    for _ in 0..n {
        fly(&mut v, 0.1, &ControlCommand::MotorsOff);
        let (view, truth) = (v.view(), v.truth());
        specific += f64::from(view.sensors.accelerometer_frd_m_s2.z);
        squares += f64::from((view.estimate.position_ned_m - truth.position_ned_m).norm()).powi(2);
        let tilt = view.estimate.attitude.roll_rad() - truth.attitude.roll_rad();
        angle_squares += f64::from(tilt).powi(2);
    }
    let n = f64::from(n);
    assert!((specific / n + 9.806_65).abs() < 0.01);
    // 4 cm per axis are 7 cm in all; 200 s are only a few correlation times.
    let deviation = (squares / n).sqrt();
    assert!((0.02..0.2).contains(&deviation), "{deviation}");
    let tilt_deg = (angle_squares / n).sqrt().to_degrees();
    assert!((0.1..0.6).contains(&tilt_deg), "{tilt_deg}");
}

fn number() -> impl Strategy<Value = f32> + Clone {
    prop_oneof![4 => -20f32..20.0, 1 => prop::num::f32::ANY]
}

fn any_command() -> impl Strategy<Value = ControlCommand> {
    let yaw = prop_oneof![
        Just(YawCommand::Hold),
        number().prop_map(YawCommand::Angle),
        number().prop_map(YawCommand::Rate),
    ];
    let three = || (number(), number(), number()).prop_map(|(x, y, z)| NedVector::new(x, y, z));
    prop_oneof![
        Just(ControlCommand::MotorsOff),
        Just(ControlCommand::Idle),
        (three(), yaw.clone()).prop_map(|(v, yaw)| velocity_ahead(v.x, v.y, v.z, yaw)),
        (three(), three(), number(), yaw.clone()).prop_map(|(place, velocity, limit, yaw)| towards(
            Held::All,
            velocity,
            Goal::new(place, yaw, limit)
        )),
        (three(), number(), number()).prop_map(|(angles, yaw_rate_rad_s, thrust)| {
            let wanted = Attitude::from_euler_rad(angles.x, angles.y, angles.z);
            ControlCommand::Attitude(wanted, yaw_rate_rad_s, thrust)
        }),
        (three(), yaw.clone()).prop_map(|(a, yaw)| ControlCommand::Acceleration(a, yaw)),
        (three(), number(), yaw.clone()).prop_map(|(v, down_m, yaw)| at_height(v, down_m, yaw)),
        (three(), number(), number(), yaw).prop_map(|(place, down, limit, yaw)| climb(place, down, limit, yaw)),
        (three(), number()).prop_map(|(r, thrust)| ControlCommand::Rates(FrdVector::new(r.x, r.y, r.z), thrust)),
        number().prop_map(ControlCommand::Descend),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn whatever_it_is_sent_the_state_stays_finite_and_above_the_ground(
        commands in prop::collection::vec((any_command(), 1u64..800), 1..12),
        seed in any::<u64>(),
    ) {
        let mut v = vehicle(BREEZE, seed);
        v.place(NedVector::new(0.0, 0.0, -3.0), 1.0, true);
        for (command, steps) in commands {
            for _ in 0..steps {
                v.step(&command);
            }
            let t = v.truth();
            prop_assert!(t.position_ned_m.is_finite() && t.velocity_ned_m_s.is_finite(), "{t:?}");
            prop_assert!(t.attitude.is_valid() && t.rates_frd_rad_s.is_finite(), "{t:?}");
            prop_assert!(t.velocity_ned_m_s.norm() < 100.0 && t.rates_frd_rad_s.norm() < 100.0, "{t:?}");
            prop_assert!(t.position_ned_m.z < 0.15, "{t:?}");
            let e = v.view().estimate;
            prop_assert!(e.position_ned_m.is_finite() && e.attitude.is_valid(), "{e:?}");
        }
    }
}
