//! The vehicle's answer to setpoints, measured as the real autopilot's was (ArduCopter 4.6.3, stock parameters: body-frame
//! velocity and yaw-rate setpoints at 20 Hz, no wind, truth at 50 Hz, seconds from the command), and the bands it must lie in.

use vigil_autopilot::vehicle::{ControlCommand, Truth, Vehicle, VehicleParams, Wind, YawCommand};
use vigil_types::{HeadingVector, NedVector, wrap_pi};

/// A vehicle that has hovered for a while at 10 m.
fn hovering(seed: u64) -> Vehicle {
    let mut vehicle = Vehicle::new(VehicleParams::default(), Wind::CALM, seed).unwrap();
    vehicle.place(NedVector::new(0.0, 0.0, -10.0), 0.7, true);
    fly(&mut vehicle, 3.0, |_| setpoint(0.0, 0.0, 0.0, 0.0));
    vehicle
}

fn setpoint(forward: f32, right: f32, down: f32, yaw_rate_rad_s: f32) -> ControlCommand {
    ControlCommand::VelocityHeading {
        velocity_m_s: HeadingVector::new(forward, right, down),
        yaw: YawCommand::Rate { yaw_rate_rad_s },
    }
}

/// Flies with a setpoint every 50 ms (seconds since the beginning → setpoint) and gives the truth at 50 Hz.
fn fly(vehicle: &mut Vehicle, seconds: f64, command: impl Fn(f64) -> ControlCommand) -> Vec<Truth> {
    let mut current = command(0.0);
    let mut truths = Vec::new();
    for ms in 0..(seconds * 1000.0) as u64 {
        if ms.is_multiple_of(50) {
            current = command(ms as f64 * 1e-3);
        }
        vehicle.step(&current);
        if (ms + 1).is_multiple_of(20) {
            truths.push(vehicle.truth());
        }
    }
    truths
}

/// Times of 10, 63 and 90 % and the overshoot as a share of the step.
#[derive(Debug)]
struct Answer {
    times_s: [f64; 3],
    overshoot: f64,
}

/// Reads an answer off samples at 50 Hz of a quantity that goes from 0 to `step`.
fn answer(samples: &[f64], step: f64) -> Answer {
    let time_of = |share: f64| {
        let i = samples
            .iter()
            .position(|v| v / step >= share)
            .expect("the step is reached");
        let before = if i == 0 { 0.0 } else { samples[i - 1] / step };
        let after = samples[i] / step;
        0.02 * (i as f64 + (share - before) / (after - before))
    };
    let most = samples.iter().fold(0.0f64, |m, v| m.max(v / step));
    Answer {
        times_s: [time_of(0.10), time_of(0.63), time_of(0.90)],
        overshoot: most - 1.0,
    }
}

/// The mean answer of a few seeds: what is left of estimator noise.
fn mean_answer(step: f64, command: impl Fn(f64) -> ControlCommand, read: impl Fn(&Truth) -> f64) -> Answer {
    let runs = [1, 2, 3];
    let mut mean: Vec<f64> = Vec::new();
    for seed in runs {
        let mut vehicle = hovering(seed);
        let samples: Vec<f64> = fly(&mut vehicle, 8.0, &command).iter().map(&read).collect();
        mean.resize(samples.len(), 0.0);
        mean.iter_mut()
            .zip(&samples)
            .for_each(|(m, s)| *m += s / runs.len() as f64);
    }
    answer(&mean, step)
}

/// The real autopilot's figures with the band: ±15 % or ±0.05 s, whichever is larger.
fn assert_in_band(what: &str, answer: &Answer, real_times_s: [f64; 3], overshoot: std::ops::RangeInclusive<f64>) {
    println!(
        "| {what} | {:.2} | {:.2} | {:.2} | {:.1} % |",
        answer.times_s[0],
        answer.times_s[1],
        answer.times_s[2],
        answer.overshoot * 100.0
    );
    for (name, measured, real) in ["10 %", "63 %", "90 %"]
        .into_iter()
        .zip(answer.times_s)
        .zip(real_times_s)
        .map(|((n, m), r)| (n, m, r))
    {
        let band = (0.15 * real).max(0.05);
        assert!(
            (measured - real).abs() <= band,
            "{what}: {name} after {measured:.2} s, the real one after {real:.2} s (±{band:.2})"
        );
    }
    assert!(
        overshoot.contains(&answer.overshoot),
        "{what}: overshoot {:.3}, wanted {overshoot:?}",
        answer.overshoot
    );
}

/// Velocity along a direction of the heading frame.
fn along(truth: &Truth, direction: (f64, f64)) -> f64 {
    let v = truth.velocity_ned_m_s.to_heading(truth.attitude.yaw_rad());
    f64::from(v.x) * direction.0 + f64::from(v.y) * direction.1
}

fn velocity_step(speed: f32, direction: (f64, f64)) -> Answer {
    let (x, y) = (direction.0 as f32, direction.1 as f32);
    mean_answer(
        f64::from(speed),
        |_| setpoint(speed * x, speed * y, 0.0, 0.0),
        |t| along(t, direction),
    )
}

#[test]
fn horizontal_velocity_steps_answer_like_the_real_autopilot() {
    let forward = (1.0, 0.0);
    assert_in_band(
        "0.5 m/s",
        &velocity_step(0.5, forward),
        [0.22, 0.62, 1.05],
        0.005..=0.05,
    );
    for (name, direction) in [
        ("1.5 m/s forward", forward),
        ("1.5 m/s back", (-1.0, 0.0)),
        ("1.5 m/s right", (0.0, 1.0)),
    ] {
        assert_in_band(name, &velocity_step(1.5, direction), [0.35, 0.79, 1.25], 0.005..=0.05);
    }
    assert_in_band(
        "3.0 m/s",
        &velocity_step(3.0, forward),
        [0.45, 1.06, 1.59],
        0.005..=0.05,
    );
}

#[test]
fn a_vertical_velocity_step_answers_like_the_real_autopilot() {
    for (name, speed) in [("down 0.5 m/s", 0.5f32), ("up 0.5 m/s", -0.5)] {
        let answer = mean_answer(
            f64::from(speed),
            |_| setpoint(0.0, 0.0, speed, 0.0),
            |t| f64::from(t.velocity_ned_m_s.z),
        );
        assert_in_band(name, &answer, [0.20, 0.50, 0.70], 0.05..=0.15);
    }
}

#[test]
fn a_yaw_rate_step_answers_like_the_real_autopilot() {
    for (name, rate) in [("yaw 45 °/s", 45f32), ("yaw −45 °/s", -45.0)] {
        let rate = rate.to_radians();
        let answer = mean_answer(
            f64::from(rate),
            |_| setpoint(0.0, 0.0, 0.0, rate),
            |t| f64::from(t.rates_frd_rad_s.z),
        );
        assert_in_band(name, &answer, [0.15, 0.32, 0.41], 0.15..=0.25);
    }
}

#[test]
fn it_stops_from_cruise_within_the_real_distance() {
    let mut vehicle = hovering(1);
    fly(&mut vehicle, 6.0, |_| setpoint(1.5, 0.0, 0.0, 0.0));
    let start = vehicle.truth().position_ned_m;
    let truths = fly(&mut vehicle, 6.0, |_| setpoint(0.0, 0.0, 0.0, 0.0));
    let furthest = truths
        .iter()
        .map(|t| (t.position_ned_m - start).horizontal_norm())
        .fold(0.0, f32::max);
    println!("| stop from 1.5 m/s | {furthest:.2} m |");
    assert!((furthest - 1.07).abs() < 0.16, "{furthest}");
}

#[test]
fn it_hovers_on_the_spot() {
    let mut worst = 0f32;
    for seed in 1..=4 {
        let mut vehicle = hovering(seed);
        let truths = fly(&mut vehicle, 10.0, |_| setpoint(0.0, 0.0, 0.0, 0.0));
        let n = truths.len() as f32;
        let mean = truths
            .iter()
            .fold(NedVector::ZERO, |m, t| m + t.position_ned_m * (1.0 / n));
        let off = truths
            .iter()
            .map(|t| (t.position_ned_m - mean).norm())
            .fold(0.0, f32::max);
        worst = worst.max(off);
        println!("| hover, seed {seed}, furthest from the mean of 10 s | {off:.3} m |");
    }
    // The real one: 0.04 m.
    assert!(worst <= 0.05, "{worst}");
    assert!(worst > 0.002, "a hover without any error is no estimate: {worst}");
}

#[test]
fn the_yaw_rate_is_clipped_where_the_real_one_is() {
    let mut vehicle = hovering(1);
    let truths = fly(&mut vehicle, 4.0, |_| setpoint(0.0, 0.0, 0.0, 90f32.to_radians()));
    let settled = &truths[100..];
    let mean = settled.iter().map(|t| t.rates_frd_rad_s.z).sum::<f32>() / settled.len() as f32;
    println!("| yaw rate at a setpoint of 90 °/s | {:.1} °/s |", mean.to_degrees());
    assert!((mean.to_degrees() - 60.0).abs() < 1.0);
}

#[test]
fn in_a_turn_the_velocity_lags_the_heading_as_the_real_one_does() {
    let mut vehicle = hovering(1);
    let truths = fly(&mut vehicle, 14.0, |_| setpoint(1.5, 0.0, 0.0, 20f32.to_radians()));
    let settled = &truths[250..];
    let lag = settled
        .iter()
        .map(|t| wrap_pi(t.attitude.yaw_rad() - t.velocity_ned_m_s.y.atan2(t.velocity_ned_m_s.x)))
        .sum::<f32>()
        / settled.len() as f32;
    println!(
        "| velocity behind heading at 1.5 m/s, 20 °/s | {:.1}° |",
        lag.to_degrees()
    );
    assert!((lag.to_degrees() - 11.0).abs() < 1.5, "{}", lag.to_degrees());
}
