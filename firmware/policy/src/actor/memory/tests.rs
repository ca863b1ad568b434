use super::*;

const STEP_NS: Nanos = 50_000_000;

/// A vehicle and what stands: a wall along the north axis at `east_m`, seen by rays.
struct Flight {
    memory: ActorMemory,
    at: Odometry,
    wall_east_m: Option<f32>,
}

impl Flight {
    fn beside_a_wall(east_m: f32) -> Self {
        Self {
            memory: ActorMemory::default(),
            at: Odometry {
                at_ns: 0,
                position_ned_m: NedVector::new(0.0, 0.0, -1.5),
                yaw_rad: 0.0,
            },
            wall_east_m: Some(east_m),
        }
    }

    fn scan(&self) -> [f32; SCAN] {
        core::array::from_fn(|k| {
            let east = libm::sinf(self.at.yaw_rad + scan_bearing_rad(k));
            match self.wall_east_m {
                Some(wall) if east > 1e-3 => proximity((wall - self.at.position_ned_m.y) / east),
                _ => 0.0,
            }
        })
    }

    fn step(&mut self, north_m: f32, yaw_rad: f32) {
        self.at.at_ns += STEP_NS;
        self.at.position_ned_m.x += north_m;
        self.at.yaw_rad = yaw_rad;
        let scan = self.scan();
        self.memory.remember(&scan, self.at);
    }

    fn steps(&mut self, steps: usize, north_m: f32, yaw_rad: f32) {
        (0..steps).for_each(|_| self.step(north_m, yaw_rad));
    }

    fn ring(&self) -> (&[f32], &[f32]) {
        self.memory.context()[OLDER_SCANS..OLDER_SCANS + 2 * RING].split_at(RING)
    }
}

#[test]
fn a_wall_that_was_seen_is_still_there_when_the_vehicle_looks_away() {
    let mut flight = Flight::beside_a_wall(2.0);
    flight.steps(20, 0.0, FRAC_PI_2);
    let (near, _) = flight.ring();
    // Bins within 52° of the nose.
    let in_view = near[..8].iter().chain(&near[RING - 7..]);
    assert!(
        in_view.copied().all(|near| near == 0.0),
        "what is in view is not observed twice: {near:?}"
    );
    flight.steps(20, 0.0, 0.0);
    let (near, fresh) = flight.ring();
    // 2 m to the right: a quarter of the way round.
    let right = near[RING / 4];
    assert!((range_m(right) - 2.0).abs() < 0.25, "{} m", range_m(right));
    assert!((fresh[RING / 4] - libm::expf(-0.1)).abs() < 0.02, "{}", fresh[RING / 4]);
    assert_eq!(near[3 * RING / 4], 0.0, "nothing on the left");
    // Turned about, it is on the left.
    flight.steps(10, 0.0, PI);
    let (near, _) = flight.ring();
    assert!((range_m(near[3 * RING / 4]) - 2.0).abs() < 0.25);
}

#[test]
fn what_a_ray_passes_through_is_forgotten_and_so_is_what_is_old() {
    let mut flight = Flight::beside_a_wall(2.0);
    flight.steps(20, 0.0, FRAC_PI_2);
    // The wall is gone: seen once more, then looked away.
    flight.wall_east_m = None;
    flight.step(0.0, FRAC_PI_2);
    flight.step(0.0, -FRAC_PI_2);
    let (near, _) = flight.ring();
    assert!(near.iter().all(|near| *near == 0.0), "{near:?}");
    let mut flight = Flight::beside_a_wall(2.0);
    flight.step(0.0, FRAC_PI_2);
    flight.step(0.0, -FRAC_PI_2);
    assert!(flight.ring().0.iter().any(|near| *near > 0.0));
    flight.at.at_ns += FORGOTTEN_NS;
    flight.step(0.0, -FRAC_PI_2);
    assert!(flight.ring().0.iter().all(|near| *near == 0.0), "after 40 s");
}

#[test]
fn older_scans_are_reported_as_they_would_be_seen_from_here() {
    let mut flight = Flight::beside_a_wall(2.0);
    flight.steps(60, 0.05, 0.6);
    let context = *flight.memory.context();
    for (older, age) in context.chunks_exact(MOVED).zip(SCAN_AGES) {
        let (mut seen, mut right) = (0, 0);
        for (k, near) in older.iter().enumerate().filter(|(_, near)| **near > 0.0) {
            let bearing_rad = (k as f32 + 0.5) * (PI / MOVED as f32) - FRAC_PI_2;
            let truly_m = 2.0 / libm::sinf(0.6 + bearing_rad);
            seen += 1;
            right += usize::from((range_m(*near) / truly_m - 1.0).abs() < 0.15);
        }
        assert!(seen > 25 && right * 10 > seen * 9, "{age} steps ago: {right} of {seen}");
    }
}

#[test]
fn a_vehicle_knows_where_it_has_been() {
    let mut flight = Flight::beside_a_wall(50.0);
    flight.steps(100, 0.05, 0.0);
    let trail = &flight.memory.context()[CONTEXT - TRAIL..];
    assert!(trail[TRAIL / 2] > 0.5, "behind it: {trail:?}");
    assert_eq!((trail[0], trail[TRAIL / 4]), (0.0, 0.0), "not ahead, not aside");
    // However long it flies to and fro, it remembers where it began.
    for turn in 0..40 {
        flight.steps(100, if turn % 2 == 0 { 0.05 } else { -0.05 }, 0.0);
    }
    assert!(flight.memory.trail.len() <= TRAIL_PLACES);
    assert!(flight.memory.trail.iter().any(|(north_m, _)| *north_m < 1.5));
}

#[test]
fn odometry_that_jumps_means_that_everything_is_forgotten_and_counted() {
    let mut flight = Flight::beside_a_wall(2.0);
    flight.steps(20, 0.0, FRAC_PI_2);
    flight.step(0.0, -FRAC_PI_2);
    assert!(flight.ring().0.iter().any(|near| *near > 0.0));
    // Half a second without frames is no time for 5 m; three seconds are.
    for (missing, forgotten) in [(0, 1), (10, 2), (60, 2)] {
        flight.at.at_ns += missing * STEP_NS;
        flight.step(5.0, -FRAC_PI_2);
        assert!(flight.ring().0.iter().all(|near| *near == 0.0));
        assert_eq!(flight.memory.forgotten(), forgotten, "{missing} frames missing");
    }
    flight.step(f32::NAN, -FRAC_PI_2);
    assert_eq!(flight.memory.forgotten(), 3);
}

#[test]
fn of_what_is_no_scan_nothing_is_remembered_and_no_surface_is_too_many() {
    let mut flight = Flight::beside_a_wall(2.0);
    flight.step(0.0, FRAC_PI_2);
    let before = *flight.memory.context();
    flight.memory.remember(&[f32::NAN; SCAN], flight.at);
    assert_eq!(*flight.memory.context(), before);
    // A hall of walls that never ends: the list is full, and what is near is known.
    for step in 0..20_000_u64 {
        flight.at.at_ns += STEP_NS / 50;
        flight.at.position_ned_m.x += 0.02;
        flight.at.yaw_rad = 0.01 * step as f32;
        let scan = flight.scan();
        flight.memory.remember(&scan, flight.at);
    }
    assert!(flight.memory.cells.len() <= CELLS);
    let (near, _) = flight.ring();
    assert!(near.iter().any(|near| *near > 0.4), "2 m away: {near:?}");
}

#[test]
fn bearings_are_those_of_the_arc_tangent() {
    for k in 0..720 {
        let angle = (k as f32 - 360.0) * PI / 361.0;
        let got = bearing_rad(3.0 * libm::cosf(angle), 3.0 * libm::sinf(angle));
        assert!((got - angle).abs() < 4e-4, "{angle} {got}");
    }
}
