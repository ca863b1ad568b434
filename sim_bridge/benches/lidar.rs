//! What a frame costs, stage by stage, the two ways of casting side by side, and a step of the environment. One thread.

use divan::Bencher;
use vigil_sim::environment::{Environment, true_state::TrueCourse};
use vigil_sim::vehicle::{VehicleParams, Wind};
use vigil_sim::world::{Course, Family, Lidar, LidarConfig, Method, Shot, World, generate};
use vigil_types::{Attitude, DepthFrame, HeadingVector, NedVector, VelocitySetpoint};

fn main() {
    divan::main();
}

/// Validation courses of low, middle and high numbers of obstacles.
const SEEDS: [u64; 3] = [1, 2, 3];

fn course(seed: u64) -> Course {
    generate(Family::Validation, seed)
}

/// A pose on the way, moving and turning with the count, so that no cache or branch learns one picture.
fn shot(count: u64) -> Shot {
    let f = (count % 200) as f32 / 200.0;
    let attitude = Attitude::from_euler_rad(0.1 * libm::sinf(9.0 * f), -0.05, 0.4 * libm::sinf(20.0 * f));
    let position_ned_m = NedVector::new(18.0 * f, 2.0 * libm::sinf(6.0 * f), -1.5);
    Shot {
        stamp_ns: count * 50_000_000,
        sequence: count,
        ..Shot::at(position_ned_m, attitude)
    }
}

fn lidar(method: Method) -> Lidar {
    Lidar::new(LidarConfig::default(), 1)
        .expect("valid")
        .with_method(method)
}

fn bench_cast(bencher: Bencher, seed: u64, method: Method) {
    let world = World::new(&course(seed));
    let mut lidar = lidar(method);
    let mut count = 0;
    bencher.bench_local(|| {
        count += 1;
        let s = shot(count);
        divan::black_box(lidar.cast(&world, s.position_ned_m, s.attitude)[0])
    });
}

#[divan::bench(args = SEEDS)]
fn cast_fast(bencher: Bencher, seed: u64) {
    bench_cast(bencher, seed, Method::Fast);
}

#[divan::bench(args = SEEDS)]
fn cast_reference(bencher: Bencher, seed: u64) {
    bench_cast(bencher, seed, Method::Reference);
}

#[divan::bench]
fn measure(bencher: Bencher) {
    let world = World::new(&course(1));
    let mut lidar = lidar(Method::Fast);
    let s = shot(1);
    lidar.cast(&world, s.position_ned_m, s.attitude);
    let mut count = 0;
    bencher.bench_local(|| {
        count += 1;
        lidar.measure(count);
    });
}

#[divan::bench]
fn project(bencher: Bencher) {
    let world = World::new(&course(1));
    let mut lidar = lidar(Method::Fast);
    let mut frame = Box::new(DepthFrame::EMPTY);
    lidar.capture(&world, &shot(1), &mut frame);
    bencher.bench_local(|| lidar.project(&mut frame));
}

#[divan::bench]
fn seal(bencher: Bencher) {
    let world = World::new(&course(1));
    let mut frame = Box::new(DepthFrame::EMPTY);
    lidar(Method::Fast).capture(&world, &shot(1), &mut frame);
    bencher.bench_local(|| frame.seal());
}

#[divan::bench(args = SEEDS)]
fn capture(bencher: Bencher, seed: u64) {
    let world = World::new(&course(seed));
    let mut lidar = lidar(Method::Fast);
    let mut frame = Box::new(DepthFrame::EMPTY);
    let mut count = 0;
    bencher.bench_local(|| {
        count += 1;
        lidar.capture(&world, &shot(count), &mut frame);
    });
}

#[divan::bench]
fn generate_validation_course(bencher: Bencher) {
    let mut seed = 0;
    bencher.bench_local(|| {
        seed += 1;
        course(seed)
    });
}

fn environment(seed: u64) -> Environment {
    Environment::unseen(&course(seed), VehicleParams::default(), Wind::default(), seed).expect("valid")
}

/// 50 ms of vehicle and referee, in circles: what a step costs but for its frame.
#[divan::bench(args = SEEDS)]
fn advance(bencher: Bencher, seed: u64) {
    let (mut environment, mut steps) = (environment(seed), 0);
    let setpoint = VelocitySetpoint {
        velocity_m_s: HeadingVector::new(0.5, 0.0, 0.0),
        yaw_rate_rad_s: 0.6,
    };
    bencher.bench_local(|| {
        steps += 1;
        if environment.advance_unseen(setpoint).is_some() || steps % 600 == 0 {
            environment = self::environment(seed);
        }
    });
}

/// The beginning of a flight: its course, world, vehicle and ways.
#[divan::bench]
fn begin(bencher: Bencher) {
    let mut seed = 0;
    bencher.bench_local(|| {
        seed += 1;
        let course = course(seed);
        let environment = Environment::unseen(&course, VehicleParams::default(), Wind::default(), seed);
        (
            environment.expect("valid").goal_distance_m(),
            TrueCourse::new(&course).way_m(course.start_ned_m()),
        )
    });
}
