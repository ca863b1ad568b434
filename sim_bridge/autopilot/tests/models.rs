//! Other people's vehicles: the models' answers against the measured ones of PX4 1.18 and ArduCopter 4.6 (docs/vehicle.md), measured as
//! those were: setpoints at 20 Hz, samples at 50 Hz, seconds from the command.

use vigil_autopilot::vehicle::{ControlCommand, Truth, Vehicle, VehicleModel, VehicleParams, Wind, YawCommand};
use vigil_types::{HeadingVector, NedVector, wrap_pi};

fn hovering(params: VehicleParams, seed: u64) -> Vehicle {
    let mut vehicle = Vehicle::new(params, Wind::CALM, seed).unwrap();
    vehicle.place(NedVector::new(0.0, 0.0, -10.0), 0.7, true);
    fly(&mut vehicle, 3.0, setpoint(0.0, 0.0, 0.0));
    vehicle
}

fn setpoint(forward: f32, down: f32, yaw_rate_rad_s: f32) -> ControlCommand {
    ControlCommand::VelocityHeading {
        velocity_m_s: HeadingVector::new(forward, 0.0, down),
        yaw: YawCommand::Rate { yaw_rate_rad_s },
    }
}

/// Flies with this setpoint and gives the truth at 50 Hz.
fn fly(vehicle: &mut Vehicle, seconds: f64, command: ControlCommand) -> Vec<Truth> {
    (0..(seconds * 50.0) as usize)
        .map(|_| {
            for _ in 0..20 {
                vehicle.step(&command);
            }
            vehicle.truth()
        })
        .collect()
}

fn forward_m_s(truth: &Truth) -> f32 {
    truth.velocity_ned_m_s.to_heading(truth.attitude.yaw_rad()).x
}

/// Seconds until a share of the step is reached; infinite where it never is.
fn time_of(samples: &[f32], level: f32) -> f32 {
    let reached = samples.iter().position(|v| v / level >= 1.0);
    reached.map_or(f32::INFINITY, |i| 0.02 * (i + 1) as f32)
}

/// What a measured step of an autopilot is compared by: times of 10, 63 and 90 %, and what it settles at after 8 s as a share.
struct Measured {
    step: f32,
    times_s: [f32; 3],
    settles_at: f32,
}

/// 10 and 63 %: within 20 % or 0.1 s (0.16 s where a tenth is 0.05 m/s: the real one's estimate has that error). 90 %: within 40 %, as it
/// hangs on an integral. Settled: within 0.06.
fn assert_steps(model: VehicleModel, steps: &[Measured]) {
    for measured in steps {
        let step = measured.step;
        let mut vehicle = hovering(model.params(), 1);
        let samples: Vec<f32> = fly(&mut vehicle, 9.0, setpoint(step, 0.0, 0.0))
            .iter()
            .map(forward_m_s)
            .collect();
        let times = [0.10, 0.63, 0.90].map(|share| time_of(&samples, share * step));
        let settled = samples[350..].iter().sum::<f32>() / samples[350..].len() as f32 / step;
        println!("{} {step} m/s: {times:.2?}, settles at {settled:.2}", model.name());
        for (i, (ours, real)) in times.into_iter().zip(measured.times_s).enumerate() {
            let band = match i {
                0 if step < 1.0 => 0.16,
                2 => (0.4 * real).max(0.1),
                _ => (0.2 * real).max(0.1),
            };
            assert!(
                (ours - real).abs() <= band,
                "{} {step} m/s: {ours:.2} s, the real one {real:.2} s",
                model.name()
            );
        }
        assert!(
            (settled - measured.settles_at).abs() <= 0.06,
            "{} {step} m/s settles at {settled:.2}",
            model.name()
        );
    }
}

#[test]
fn px4_answers_a_velocity_as_the_real_one_does() {
    let measured = |step, times_s, settles_at| Measured {
        step,
        times_s,
        settles_at,
    };
    assert_steps(
        VehicleModel::Px4Sih,
        &[
            measured(0.5, [0.30, 0.88, 5.6], 0.88),
            measured(1.5, [0.34, 0.92, 6.7], 0.92),
            measured(3.0, [0.32, 0.92, 7.3], 0.92),
        ],
    );
    assert_steps(
        VehicleModel::Px4Light,
        &[
            measured(0.5, [0.19, 0.72, 1.02], 1.0),
            measured(1.5, [0.33, 0.76, 1.19], 1.0),
            measured(3.0, [0.31, 0.76, 1.17], 1.0),
        ],
    );
}

/// Metres that it goes on within 6 s of a command of zero.
fn stop_m(model: VehicleModel, speed: f32) -> f32 {
    let mut vehicle = hovering(model.params(), 2);
    fly(&mut vehicle, 8.0, setpoint(speed, 0.0, 0.0));
    let from = vehicle.truth().position_ned_m;
    let truths = fly(&mut vehicle, 6.0, setpoint(0.0, 0.0, 0.0));
    let ways_m = truths.iter().map(|t| (t.position_ned_m - from).horizontal_norm());
    ways_m.fold(0.0, f32::max)
}

#[test]
fn px4_brakes_by_offboard_as_the_real_one_does() {
    for (model, speed, real_m) in [
        (VehicleModel::Px4Sih, 1.5, 2.4),
        (VehicleModel::Px4Sih, 3.0, 4.4),
        (VehicleModel::Px4Light, 1.5, 1.8),
        (VehicleModel::Px4Light, 3.0, 3.1),
    ] {
        let ours_m = stop_m(model, speed);
        println!(
            "{} stops from {speed} m/s in {ours_m:.2} m, the real one {real_m}",
            model.name()
        );
        assert!(
            (ours_m / real_m - 1.0).abs() <= 0.3,
            "{} from {speed} m/s: {ours_m:.2} m",
            model.name()
        );
    }
}

#[test]
fn px4_turns_and_climbs_as_the_real_one_does() {
    for model in [VehicleModel::Px4Sih, VehicleModel::Px4Light] {
        let mut vehicle = hovering(model.params(), 3);
        let rate = 45f32.to_radians();
        let turning: Vec<f32> = fly(&mut vehicle, 4.0, setpoint(0.0, 0.0, rate))
            .iter()
            .map(|t| t.rates_frd_rad_s.z)
            .collect();
        let times = [0.10, 0.63, 0.90].map(|share| time_of(&turning, share * rate));
        let most = turning.iter().fold(0f32, |m, r| m.max(r / rate)) - 1.0;
        println!("{} yaw 45 °/s: {times:.2?}, overshoot {most:.2}", model.name());
        for (ours, real) in times.into_iter().zip([0.20f32, 0.44, 0.60]) {
            assert!(
                (ours - real).abs() <= 0.1,
                "{}: {ours:.2} s, the real one {real:.2} s",
                model.name()
            );
        }
        assert!(most < 0.12, "{most}");

        for (sign, real) in [(-1.0f32, [0.13f32, 0.28]), (1.0, [0.13, 0.35])] {
            let mut vehicle = hovering(model.params(), 4);
            let climbing: Vec<f32> = fly(&mut vehicle, 4.0, setpoint(0.0, 0.5 * sign, 0.0))
                .iter()
                .map(|t| t.velocity_ned_m_s.z)
                .collect();
            let times = [0.10, 0.63, 0.90].map(|share| time_of(&climbing, share * 0.5 * sign));
            println!("{} {:+.1} m/s down: {times:.2?}", model.name(), 0.5 * sign);
            for (ours, real) in times.into_iter().zip(real) {
                assert!(
                    (ours - real).abs() <= 0.12,
                    "{}: {ours:.2} s, the real one {real:.2} s",
                    model.name()
                );
            }
        }
    }
}

#[test]
fn with_strong_drag_the_nose_leads_the_course() {
    let mut vehicle = hovering(VehicleModel::Px4Sih.params(), 5);
    let truths = fly(&mut vehicle, 16.0, setpoint(1.3, 0.0, 30f32.to_radians()));
    let settled = &truths[300..];
    let lead = settled
        .iter()
        .map(|t| wrap_pi(t.attitude.yaw_rad() - t.velocity_ned_m_s.y.atan2(t.velocity_ned_m_s.x)))
        .sum::<f32>()
        / settled.len() as f32;
    println!("nose ahead of the course at 1.3 m/s, 30 °/s: {:.1}°", lead.to_degrees());
    assert!((lead.to_degrees() - 26.0).abs() < 6.0, "{}", lead.to_degrees());
}

/// A hold of 20 s with the noisy estimate: how far the place wanders, north, east, down.
fn wander_m(params: VehicleParams, seed: u64) -> [f32; 3] {
    let mut vehicle = hovering(params, seed);
    let place = vehicle.view().estimate.position_ned_m;
    let hold = ControlCommand::Position {
        position_ned_m: place,
        velocity_m_s: NedVector::ZERO,
        speed_limit_m_s: 5.0,
        yaw: YawCommand::Hold,
    };
    fly(&mut vehicle, 10.0, hold);
    let truths = fly(&mut vehicle, 20.0, hold);
    let range = |axis: fn(&Truth) -> f32| {
        let (low, high) = truths
            .iter()
            .map(axis)
            .fold((f32::MAX, f32::MIN), |(l, h), v| (l.min(v), h.max(v)));
        high - low
    };
    [
        range(|t| t.position_ned_m.x),
        range(|t| t.position_ned_m.y),
        range(|t| t.position_ned_m.z),
    ]
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
        println!(
            "{}: a hold of 20 s wanders {level:.2} m, in height {down:.2} m",
            model.name()
        );
        // Measured: 0.5 by 0.7 by 0.3 m, and of PX4 main 0.36 m within 8 s in height.
        assert!((0.4..=0.8).contains(&level), "{level}");
        let most_m = if model.name().starts_with("px4") { 1.0 } else { 0.5 };
        assert!((0.2..=most_m).contains(&down), "{down}");
    }
    // PX4's heading wanders: measured in 15 flights of SIH, 4.3° (rms), 1.8° within a second, 4.6° within eight. Ours does not.
    let mut sums = [[0.0f32; 3]; 2];
    for (sums, model) in sums.iter_mut().zip([VehicleModel::Px4Sih, VehicleModel::Ours]) {
        for seed in 0..40 {
            let mut vehicle = hovering(model.params().with_noisy_estimate(), seed);
            let mut off_deg = || {
                let truth = fly(&mut vehicle, 1.0, setpoint(0.0, 0.0, 0.0)).pop().unwrap();
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
    println!(
        "off by {:.2} m (half of them), in height {:.2} m (95 %)",
        level[100], down[190]
    );
    assert!((0.2..=0.5).contains(&level[100]) && (0.7..=1.3).contains(&down[190]));
}
