//! The vehicle's answer to setpoints, measured as the real autopilots' were (setpoints at 20 Hz, no wind, truth at 50 Hz, seconds from
//! the command), and the bands it must lie in: our vehicle's against ArduCopter 4.6.3 with stock parameters, the models of other people's
//! vehicles against PX4 1.18 and ArduCopter 4.6 (docs/vehicle.md).

use vigil_autopilot::vehicle::{ControlCommand, Goal, Truth, Vehicle, VehicleModel, VehicleParams, Wind, YawCommand};
use vigil_types::{HeadingVector, NedVector, wrap_pi};

/// A vehicle that has hovered for a while at 10 m.
fn hovering(params: VehicleParams, seed: u64) -> Vehicle {
    let mut vehicle = Vehicle::new(params, Wind::CALM, seed).unwrap();
    vehicle.place(NedVector::new(0.0, 0.0, -10.0), 0.7, true);
    fly(&mut vehicle, 3.0, HOVER);
    vehicle
}

/// Our vehicle.
fn ours(seed: u64) -> Vehicle {
    hovering(VehicleParams::default(), seed)
}

const HOVER: ControlCommand = setpoint(0.0, 0.0, 0.0, 0.0);

const fn setpoint(forward: f32, right: f32, down: f32, yaw_rate_rad_s: f32) -> ControlCommand {
    ControlCommand::VelocityHeading(
        HeadingVector::new(forward, right, down),
        YawCommand::Rate(yaw_rate_rad_s),
    )
}

/// Flies with this setpoint and gives the truth at 50 Hz.
fn fly(vehicle: &mut Vehicle, seconds: f64, command: ControlCommand) -> Vec<Truth> {
    let mut truth_after_20_ms = || {
        for _ in 0..20 {
            vehicle.step(&command);
        }
        vehicle.truth()
    };
    (0..(seconds * 50.0) as usize).map(|_| truth_after_20_ms()).collect()
}

/// The greatest way level from where it is, while it flies with this setpoint.
fn furthest_m(vehicle: &mut Vehicle, seconds: f64, command: ControlCommand) -> f32 {
    let from = vehicle.truth().position_ned_m;
    let truths = fly(vehicle, seconds, command);
    let travels_m = truths.iter().map(|t| (t.position_ned_m - from).horizontal_norm());
    travels_m.fold(0.0, f32::max)
}

/// The mean angle of the nose before the velocity.
fn nose_before_course_deg(truths: &[Truth]) -> f32 {
    let angle = |t: &Truth| wrap_pi(t.attitude.yaw_rad() - t.velocity_ned_m_s.y.atan2(t.velocity_ned_m_s.x));
    (truths.iter().map(angle).sum::<f32>() / truths.len() as f32).to_degrees()
}

/// Times of 10, 63 and 90 % and the overshoot as a share of the step, of samples at 50 Hz of a quantity that goes from 0 to `step`.
fn answer(samples: &[f64], step: f64) -> ([f64; 3], f64) {
    let time_of = |share: f64| {
        let reached = samples.iter().position(|v| v / step >= share);
        let i = reached.expect("the step is reached");
        let before = if i == 0 { 0.0 } else { samples[i - 1] / step };
        let after = samples[i] / step;
        0.02 * (i as f64 + (share - before) / (after - before))
    };
    let most = samples.iter().fold(0.0f64, |m, v| m.max(v / step));
    ([0.10, 0.63, 0.90].map(time_of), most - 1.0)
}

/// The mean answer of a few seeds: what is left of estimator noise.
fn mean_answer(step: f32, axis: usize) -> ([f64; 3], f64) {
    let on = |n| if n == axis { step } else { 0.0 };
    let command = setpoint(on(0), on(1), on(2), on(3));
    let runs = [1, 2, 3];
    let mut mean: Vec<f64> = Vec::new();
    for seed in runs {
        let truths = fly(&mut ours(seed), 8.0, command);
        let samples: Vec<f64> = truths.iter().map(|t| f64::from(motion(t)[axis])).collect();
        mean.resize(samples.len(), 0.0);
        for (mean, sample) in mean.iter_mut().zip(samples) {
            *mean += sample / runs.len() as f64;
        }
    }
    answer(&mean, f64::from(step))
}

/// The vehicle's figure lies this near to the real one's.
fn assert_near(what: &str, ours: impl Into<f64>, real: impl Into<f64>, band: impl Into<f64>) {
    let (ours, real, band) = (ours.into(), real.into(), band.into());
    assert!(
        (ours - real).abs() <= band,
        "{what}: {ours:.3}, the real one {real:.3} (±{band:.3})"
    );
}

/// What a setpoint commands: velocity forward, right and down, and the turning rate.
fn motion(truth: &Truth) -> [f32; 4] {
    let v = truth.velocity_ned_m_s.to_heading(truth.attitude.yaw_rad());
    [v.x, v.y, v.z, truth.rates_frd_rad_s.z]
}

/// The band about the real autopilot's times: ±15 % or ±0.05 s, whichever is larger.
#[test]
fn steps_of_velocity_and_yaw_rate_answer_like_the_real_autopilot() {
    let rate = 45f32.to_radians();
    for (what, axis, step, real_times_s) in [
        ("0.5 m/s", 0, 0.5, [0.22f64, 0.62, 1.05]),
        ("1.5 m/s forward", 0, 1.5, [0.35, 0.79, 1.25]),
        ("1.5 m/s back", 0, -1.5, [0.35, 0.79, 1.25]),
        ("1.5 m/s right", 1, 1.5, [0.35, 0.79, 1.25]),
        ("3.0 m/s", 0, 3.0, [0.45, 1.06, 1.59]),
        ("down 0.5 m/s", 2, 0.5, [0.20, 0.50, 0.70]),
        ("up 0.5 m/s", 2, -0.5, [0.20, 0.50, 0.70]),
        ("yaw 45 °/s", 3, rate, [0.15, 0.32, 0.41]),
        ("yaw −45 °/s", 3, -rate, [0.15, 0.32, 0.41]),
    ] {
        let (times_s, overshoot) = mean_answer(step, axis);
        let ([tenth, most, nearly], over) = (times_s, overshoot * 100.0);
        println!("| {what} | {tenth:.2} | {most:.2} | {nearly:.2} | {over:.1} % |");
        for ((share, measured), real) in [10, 63, 90].into_iter().zip(times_s).zip(real_times_s) {
            let band = (0.15 * real).max(0.05);
            assert_near(&format!("{what}: {share} %"), measured, real, band);
        }
        let wanted = [0.005..=0.05, 0.005..=0.05, 0.05..=0.15, 0.15..=0.25][axis].clone();
        assert!(
            wanted.contains(&overshoot),
            "{what}: overshoot {overshoot:.3}, wanted {wanted:?}"
        );
    }
}

#[test]
fn it_stops_from_cruise_within_the_real_distance() {
    let mut vehicle = ours(1);
    fly(&mut vehicle, 6.0, setpoint(1.5, 0.0, 0.0, 0.0));
    let furthest = furthest_m(&mut vehicle, 6.0, HOVER);
    println!("| stop from 1.5 m/s | {furthest:.2} m |");
    assert!((furthest - 1.07).abs() < 0.16, "{furthest}");
}

#[test]
fn it_hovers_on_the_spot() {
    let mut worst = 0f32;
    for seed in 1..=4 {
        let truths = fly(&mut ours(seed), 10.0, HOVER);
        let n = truths.len() as f32;
        let places = truths.iter().map(|t| t.position_ned_m);
        let mean = places.clone().fold(NedVector::ZERO, |m, place| m + place * (1.0 / n));
        let off = places.map(|place| (place - mean).norm()).fold(0.0, f32::max);
        worst = worst.max(off);
        println!("| hover, seed {seed}, furthest from the mean of 10 s | {off:.3} m |");
    }
    // The real one: 0.04 m.
    assert!(worst <= 0.05, "{worst}");
    assert!(worst > 0.002, "a hover without any error is no estimate: {worst}");
}

#[test]
fn the_yaw_rate_is_clipped_where_the_real_one_is() {
    let truths = fly(&mut ours(1), 4.0, setpoint(0.0, 0.0, 0.0, 90f32.to_radians()));
    let settled = &truths[100..];
    let mean = settled.iter().map(|t| t.rates_frd_rad_s.z).sum::<f32>() / settled.len() as f32;
    println!("| yaw rate at a setpoint of 90 °/s | {:.1} °/s |", mean.to_degrees());
    assert!((mean.to_degrees() - 60.0).abs() < 1.0);
}

#[test]
fn in_a_turn_the_velocity_lags_the_heading_as_the_real_one_does() {
    let truths = fly(&mut ours(1), 14.0, setpoint(1.5, 0.0, 0.0, 20f32.to_radians()));
    let lag_deg = nose_before_course_deg(&truths[250..]);
    println!("| velocity behind heading at 1.5 m/s, 20 °/s | {lag_deg:.1}° |");
    assert!((lag_deg - 11.0).abs() < 1.5, "{lag_deg}");
}

/// Seconds until a share of the step is reached; infinite where it never is.
fn time_of(samples: &[f32], level: f32) -> f32 {
    let reached = samples.iter().position(|v| v / level >= 1.0);
    reached.map_or(f32::INFINITY, |i| 0.02 * (i + 1) as f32)
}

/// Steps of an autopilot as measured: m/s, times of 10, 63 and 90 %, and what it settles at after 8 s as a share.
/// 10 and 63 %: within 20 % or 0.1 s (0.16 s where a tenth is 0.05 m/s: the real one's estimate has that error). 90 %: within 40 %, as it
/// hangs on an integral. Settled: within 0.06.
fn assert_steps(model: VehicleModel, steps: [(f32, [f32; 3], f32); 3]) {
    for (step, real_times_s, settles_at) in steps {
        let truths = fly(&mut hovering(model.params(), 1), 9.0, setpoint(step, 0.0, 0.0, 0.0));
        let samples: Vec<f32> = truths.iter().map(|t| motion(t)[0]).collect();
        let times = [0.10, 0.63, 0.90].map(|share| time_of(&samples, share * step));
        let settled = samples[350..].iter().sum::<f32>() / samples[350..].len() as f32 / step;
        println!("{} {step} m/s: {times:.2?}, settles at {settled:.2}", model.name());
        for (i, (ours, real)) in times.into_iter().zip(real_times_s).enumerate() {
            let band = match i {
                0 if step < 1.0 => 0.16,
                2 => (0.4 * real).max(0.1),
                _ => (0.2 * real).max(0.1),
            };
            assert_near(&format!("{} {step} m/s, seconds", model.name()), ours, real, band);
        }
        let what = format!("{} {step} m/s settles", model.name());
        assert_near(&what, settled, settles_at, 0.06);
    }
}

#[test]
fn px4_answers_a_velocity_as_the_real_one_does() {
    let px4_sih = [
        (0.5, [0.30, 0.88, 5.6], 0.88),
        (1.5, [0.34, 0.92, 6.7], 0.92),
        (3.0, [0.32, 0.92, 7.3], 0.92),
    ];
    assert_steps(VehicleModel::Px4Sih, px4_sih);
    let px4_light = [
        (0.5, [0.19, 0.72, 1.02], 1.0),
        (1.5, [0.33, 0.76, 1.19], 1.0),
        (3.0, [0.31, 0.76, 1.17], 1.0),
    ];
    assert_steps(VehicleModel::Px4Light, px4_light);
}

#[test]
fn px4_brakes_by_offboard_as_the_real_one_does() {
    for (model, speed, real_m) in [
        (VehicleModel::Px4Sih, 1.5, 2.4),
        (VehicleModel::Px4Sih, 3.0, 4.4),
        (VehicleModel::Px4Light, 1.5, 1.8),
        (VehicleModel::Px4Light, 3.0, 3.1),
    ] {
        let mut vehicle = hovering(model.params(), 2);
        fly(&mut vehicle, 8.0, setpoint(speed, 0.0, 0.0, 0.0));
        let ours_m = furthest_m(&mut vehicle, 6.0, HOVER);
        let what = format!("{} stops from {speed} m/s", model.name());
        println!("{what} in {ours_m:.2} m, the real one {real_m}");
        assert_near(&what, ours_m, real_m, 0.3 * real_m);
    }
}

#[test]
fn px4_turns_and_climbs_as_the_real_one_does() {
    for model in [VehicleModel::Px4Sih, VehicleModel::Px4Light] {
        let name = model.name();
        let times_within = |what: &str, samples: &[f32], step: f32, real: &[f32], band_s: f32| {
            let times = [0.10, 0.63, 0.90].map(|share| time_of(samples, share * step));
            println!("{name} {what}: {times:.2?}");
            for (ours, real) in times.into_iter().zip(real) {
                assert_near(&format!("{name} {what}"), ours, *real, band_s);
            }
        };
        let rate = 45f32.to_radians();
        let truths = fly(&mut hovering(model.params(), 3), 4.0, setpoint(0.0, 0.0, 0.0, rate));
        let turning: Vec<f32> = truths.iter().map(|t| t.rates_frd_rad_s.z).collect();
        times_within("yaw 45 °/s", &turning, rate, &[0.20, 0.44, 0.60], 0.1);
        let most = turning.iter().fold(0f32, |m, r| m.max(r / rate)) - 1.0;
        assert!(most < 0.12, "{most}");
        for (what, down, real) in [("up", -0.5, [0.13, 0.28]), ("down", 0.5, [0.13, 0.35])] {
            let truths = fly(&mut hovering(model.params(), 4), 4.0, setpoint(0.0, 0.0, down, 0.0));
            let climbing: Vec<f32> = truths.iter().map(|t| t.velocity_ned_m_s.z).collect();
            times_within(what, &climbing, down, &real, 0.12);
        }
    }
}

#[test]
fn with_strong_drag_the_nose_leads_the_course() {
    let mut vehicle = hovering(VehicleModel::Px4Sih.params(), 5);
    let truths = fly(&mut vehicle, 16.0, setpoint(1.3, 0.0, 0.0, 30f32.to_radians()));
    let lead_deg = nose_before_course_deg(&truths[300..]);
    println!("nose ahead of the course at 1.3 m/s, 30 °/s: {lead_deg:.1}°");
    assert!((lead_deg - 26.0).abs() < 6.0, "{lead_deg}");
}

/// A hold of 20 s with the noisy estimate: how far the place wanders, north, east, down.
fn wander_m(params: VehicleParams, seed: u64) -> [f32; 3] {
    let mut vehicle = hovering(params, seed);
    let place = vehicle.view().estimate.position_ned_m;
    let hold = ControlCommand::Position(Goal::new(place, YawCommand::Hold, 5.0));
    fly(&mut vehicle, 10.0, hold);
    let truths = fly(&mut vehicle, 20.0, hold);
    [0, 1, 2].map(|axis| {
        let places_m = truths.iter().map(|t| t.position_ned_m.to_array()[axis]);
        places_m.clone().fold(f32::MIN, f32::max) - places_m.fold(f32::MAX, f32::min)
    })
}

#[test]
fn a_noisy_estimate_wanders_as_gps_and_barometer_do_and_the_truth_is_another() {
    for model in VehicleModel::ALL {
        let (mut level, mut down) = (0.0, 0.0);
        let seeds = 40;
        for seed in 0..seeds {
            let [x, y, z] = wander_m(model.params().with_noisy_estimate(), seed);
            level += (x + y) / 2.0 / seeds as f32;
            down += z / seeds as f32;
        }
        let name = model.name();
        println!("{name}: a hold of 20 s wanders {level:.2} m, in height {down:.2} m");
        // Measured: 0.5 by 0.7 by 0.3 m, and of PX4 main 0.36 m within 8 s in height.
        assert!((0.4..=0.8).contains(&level), "{level}");
        let most_m = if name.starts_with("px4") { 1.0 } else { 0.5 };
        assert!((0.2..=most_m).contains(&down), "{down}");
    }
    // PX4's heading wanders: measured in 15 flights of SIH, 4.3° (rms), 1.8° within a second, 4.6° within eight. Ours does not.
    let mut sums = [[0.0f32; 3]; 2];
    for (sums, model) in sums.iter_mut().zip([VehicleModel::Px4Sih, VehicleModel::Ours]) {
        for seed in 0..40 {
            let mut vehicle = hovering(model.params().with_noisy_estimate(), seed);
            let mut off_deg = || {
                let truth = fly(&mut vehicle, 1.0, HOVER).pop().unwrap();
                wrap_pi(vehicle.view().estimate.attitude.yaw_rad() - truth.attitude.yaw_rad()).to_degrees()
            };
            let off = [(); 9].map(|()| off_deg());
            for (sum, error) in sums.iter_mut().zip([off[0], off[1] - off[0], off[8] - off[0]]) {
                *sum += error * error / 40.0;
            }
        }
    }
    let [px4, ours] = sums.map(|of| of.map(f32::sqrt));
    println!("heading off by, within 1 and 8 s: PX4 {px4:.1?}°, ours {ours:.1?}°");
    for (ours, real) in px4.into_iter().zip([4.3, 1.8, 4.6]) {
        assert!((ours - real).abs() < 0.3 * real, "{ours:.1}°, the real one {real:.1}°");
    }
    assert!(ours.into_iter().all(|off| off < 0.6), "{ours:?}");
    // The report is 0.2 to 0.5 m from the truth, in height up to 1 m.
    let (mut level, mut down) = (Vec::new(), Vec::new());
    for seed in 0..200 {
        let vehicle = hovering(VehicleParams::default().with_noisy_estimate(), seed);
        let off = vehicle.view().estimate.position_ned_m - vehicle.truth().position_ned_m;
        level.push(off.horizontal_norm());
        down.push(off.z.abs());
    }
    level.sort_by(f32::total_cmp);
    down.sort_by(f32::total_cmp);
    let (half, most) = (level[100], down[190]);
    println!("off by {half:.2} m (half of them), in height {most:.2} m (95 %)");
    assert!((0.2..=0.5).contains(&half) && (0.7..=1.3).contains(&most));
}
