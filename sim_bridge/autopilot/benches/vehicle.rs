//! Cost of the vehicle in simulation: `cargo bench -p vigil-autopilot --bench vehicle`.

use divan::{Bencher, black_box};
use vigil_autopilot::vehicle::{ControlCommand, Vehicle, VehicleParams, Wind, YawCommand};
use vigil_types::{HeadingVector, NedVector};

fn main() {
    divan::main();
}

fn hovering() -> Vehicle {
    let wind = Wind {
        mean_ned_m_s: [2.0, 1.0, 0.0],
        gust_m_s: 0.5,
        ..Wind::CALM
    };
    let mut vehicle = Vehicle::new(VehicleParams::default(), wind, 1).expect("the default parameters are valid");
    vehicle.place(NedVector::new(0.0, 0.0, -1.5), 0.0, true);
    vehicle
}

const CRUISE: ControlCommand = ControlCommand::VelocityHeading {
    velocity_m_s: HeadingVector::new(1.5, 0.0, 0.0),
    yaw: YawCommand::Rate(0.2),
};

/// One simulation step: 50 physics steps.
#[divan::bench]
fn fifty_steps(bencher: Bencher) {
    let mut vehicle = hovering();
    bencher.bench_local(|| {
        for _ in 0..50 {
            vehicle.step(black_box(&CRUISE));
        }
    });
}

#[divan::bench]
fn view(bencher: Bencher) {
    let vehicle = hovering();
    bencher.bench_local(|| black_box(&vehicle).view());
}

#[divan::bench]
fn state_hash(bencher: Bencher) {
    let vehicle = hovering();
    bencher.bench_local(|| black_box(&vehicle).state_hash());
}
