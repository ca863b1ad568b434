//! What a frame costs, stage by stage, and a step of the environment. One thread.

use divan::Bencher;
use parry3d::math::Vector;
use parry3d::query::{Ray, RayCast};
use parry3d::shape::TriMesh;
use vigil_sim::environment::{Environment, true_state::TrueCourse};
use vigil_sim::vehicle::{VehicleParams, Wind};
use vigil_sim::world::{
    Course, Family, LIDAR_BEAMS, LIDAR_FIRINGS, Lidar, LidarConfig, Mesh, Shot, World, beam_direction_frd, generate,
};
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

fn lidar() -> Lidar {
    Lidar::new(LidarConfig::default(), 1).expect("valid")
}

/// What is to be timed is given the number of its run.
fn bench<T>(bencher: Bencher, mut run: impl FnMut(u64) -> T) {
    let mut count = 0;
    bencher.bench_local(|| {
        count += 1;
        run(count)
    });
}

fn bench_cast(bencher: Bencher, world: &World) {
    let mut lidar = lidar();
    bench(bencher, |count| {
        let s = shot(count);
        divan::black_box(lidar.cast(world, s.position_ned_m, s.attitude)[0])
    });
}

#[divan::bench(args = SEEDS)]
fn cast_fast(bencher: Bencher, seed: u64) {
    bench_cast(bencher, &World::new(&course(seed)));
}

/// What the meshes are: a hall with vaulted walls and pillars, as fine everywhere as a scan; and pieces as large as a hand, all over the place.
const MESHES: [&str; 2] = ["hall", "rubble"];

/// 100 000 triangles, NED metres.
fn triangles(mesh: &str) -> Vec<[NedVector; 3]> {
    let mut all = Vec::new();
    if mesh == "rubble" {
        let mut bits = 0;
        let mut next = |wide: f32| {
            bits = vigil_sim::world::split_mix(bits);
            wide * (bits >> 40) as f32 / (1u64 << 24) as f32
        };
        while all.len() < 100_000 {
            let at = NedVector::new(next(24.0) - 3.0, next(20.0) - 10.0, -next(5.0) - 0.2);
            all.push([0; 3].map(|_| at + NedVector::new(next(0.2), next(0.2), next(0.2))));
        }
        return all;
    }
    // Round something, `rise` its height, of as many quarters in each direction.
    let mut tube = |centre: [f32; 2], radius: [f32; 2], rise: f32, [around, up]: [usize; 2], closes: f32| {
        let at = |i: usize, j: usize| {
            let (a, f) = (core::f32::consts::TAU * i as f32 / around as f32, j as f32 / up as f32);
            let r = 1.0 - closes * f * f * f + 0.01 * libm::sinf(7.0 * a + 9.0 * f);
            NedVector::new(
                centre[0] + r * radius[0] * libm::cosf(a),
                centre[1] + r * radius[1] * libm::sinf(a),
                -rise * f - 0.06,
            )
        };
        for (i, j) in (0..around).flat_map(|i| (0..up).map(move |j| (i, j))) {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            all.extend([[a, b, c], [a, c, d]]);
        }
    };
    tube([9.0, 0.0], [16.0, 11.0], 6.0, [340, 100], 0.99);
    for pillar in 0..16_u8 {
        let (row, column) = (f32::from(pillar / 4), f32::from(pillar % 4));
        let centre = [-1.0 + 6.5 * row, -7.0 + 4.5 * column];
        tube(centre, [0.35, 0.35], 5.0, [20, 50], 0.1);
    }
    all
}

#[divan::bench(args = MESHES)]
fn mesh_fast(bencher: Bencher, mesh: &str) {
    let mut course = course(1);
    course.clear_obstacles();
    let mesh = Mesh::of_triangles(&triangles(mesh)).expect("a mesh");
    course.meshes.push(mesh);
    bench_cast(bencher, &World::new(&course));
}

/// The library's own casting against the same triangles, along the same beams. Our builds do not optimise it: for a fair figure
/// `--config 'profile.release.package.parry3d.opt-level=3'`.
#[divan::bench(args = MESHES)]
fn mesh_parry(bencher: Bencher, mesh: &str) {
    let triangles = triangles(mesh);
    let points = triangles.iter().flatten().map(|p| Vector::new(p.x, p.y, p.z)).collect();
    let numbers = (0..triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]);
    let mesh = TriMesh::new(points, numbers.collect()).expect("a mesh");
    bench(bencher, |count| {
        let s = shot(count);
        let origin = Vector::from(s.position_ned_m.to_array());
        let nearest = |beam: usize| {
            let direction_frd = beam_direction_frd(beam / LIDAR_FIRINGS, beam % LIDAR_FIRINGS);
            let direction = s.attitude.to_ned(direction_frd).to_array();
            let ray = Ray::new(origin, Vector::from(direction));
            mesh.cast_local_ray(&ray, 100.0, true).unwrap_or(100.0)
        };
        (0..LIDAR_BEAMS).map(nearest).fold(0.0, f32::max)
    });
}

#[divan::bench]
fn measure(bencher: Bencher) {
    let mut lidar = captured().0;
    bench(bencher, |count| lidar.measure(count));
}

/// A sensor that took a frame.
fn captured() -> (Lidar, Box<DepthFrame>) {
    let (mut lidar, mut frame) = (lidar(), Box::new(DepthFrame::EMPTY));
    lidar.capture(&World::new(&course(1)), &shot(1), &mut frame);
    (lidar, frame)
}

#[divan::bench]
fn project(bencher: Bencher) {
    let (mut lidar, mut frame) = captured();
    bencher.bench_local(|| lidar.project(&mut frame));
}

#[divan::bench]
fn seal(bencher: Bencher) {
    let mut frame = captured().1;
    bencher.bench_local(|| frame.seal());
}

#[divan::bench(args = SEEDS)]
fn capture(bencher: Bencher, seed: u64) {
    bench_capture(bencher, &course(seed));
}

/// Among trees: some twenty trunks, and a hundred branches of 24 triangles each.
#[divan::bench(args = SEEDS)]
fn capture_forest(bencher: Bencher, seed: u64) {
    bench_capture(bencher, &generate(Family::Forest, seed));
}

fn bench_capture(bencher: Bencher, course: &Course) {
    let world = World::new(course);
    let mut lidar = lidar();
    let mut frame = Box::new(DepthFrame::EMPTY);
    bench(bencher, |count| lidar.capture(&world, &shot(count), &mut frame));
}

#[divan::bench]
fn generate_validation_course(bencher: Bencher) {
    bench(bencher, course);
}

fn environment(seed: u64) -> Environment {
    Environment::unseen(&course(seed), VehicleParams::default(), Wind::default(), seed).expect("valid")
}

/// 50 ms of vehicle and referee, in circles: what a step costs but for its frame.
#[divan::bench(args = SEEDS)]
fn advance(bencher: Bencher, seed: u64) {
    let mut environment = environment(seed);
    let setpoint = VelocitySetpoint {
        velocity_m_s: HeadingVector::new(0.5, 0.0, 0.0),
        yaw_rate_rad_s: 0.6,
    };
    bench(bencher, |steps| {
        if environment.advance_unseen(setpoint).is_some() || steps % 600 == 0 {
            environment = self::environment(seed);
        }
    });
}

/// The beginning of a flight: its course, world, vehicle and ways.
#[divan::bench]
fn begin(bencher: Bencher) {
    bench(bencher, |seed| {
        let course = course(seed);
        let environment = Environment::unseen(&course, VehicleParams::default(), Wind::default(), seed);
        (
            environment.expect("valid").goal_distance_m(),
            TrueCourse::new(&course).path_m(course.start_ned_m()),
        )
    });
}
