//! The geometric pilot and the recovery pilot in small worlds drawn by hand: flights; inputs that no healthy flight
//! gives, and the same inputs twice; and frames that somebody has altered.

mod common;

use common::{Flight, Scene, beam, block, ceiling, column, fly, frame_of, input};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use vigil_policy::{GeometricConfig, GeometricPilot, Pilot, PilotInput, RecoveryPilot};
use vigil_types::{
    ACTION_LIMIT, Action, Attitude, DEPTH_COLS, DEPTH_FULL_SCALE_M, DEPTH_ROWS, DepthFrame, GoalRelative,
    HeadingVector, NedVector,
};

fn pilot() -> Box<GeometricPilot> {
    Box::new(GeometricPilot::new(GeometricConfig::default()))
}

fn flight(scene: &Scene, goal: (f32, f32), limit_s: f32) -> Flight {
    fly(scene, pilot().as_mut(), 0.0, goal, limit_s)
}

const CLEAR_M: f32 = 0.33;

#[test]
fn open_space_is_flown_straight_at_cruise_speed() {
    let f = flight(&Scene::default(), (20.0, 0.0), 30.0);
    f.assert_arrived(CLEAR_M);
    assert!(f.time_s < 15.0, "{} s", f.time_s);
    assert!(f.positions.iter().all(|p| p.y.abs() < 0.2));
}

#[test]
fn a_goal_behind_is_turned_to_before_flying() {
    let f = flight(&Scene::default(), (-15.0, 1.0), 40.0);
    f.assert_arrived(CLEAR_M);
    assert!(f.positions.iter().all(|p| p.x < 1.0));
}

#[test]
fn a_goal_just_behind_is_not_flown_to_backward() {
    // At the recovery pilot's speed: there the field outweighs the seeking.
    let mut pilot = Box::new(GeometricPilot::new(GeometricConfig {
        cruise_m_s: 0.8,
        ..GeometricConfig::default()
    }));
    let f = fly(&Scene::default(), pilot.as_mut(), 0.0, (-3.0, 0.2), 40.0);
    assert!(f.reached);
    // A turn by 150° takes more than three seconds.
    assert!(f.positions.iter().take(60).all(|p| p.x > -0.2));
}

#[test]
fn columns_walls_dead_ends_gaps_and_forests_are_passed() {
    let trap = [
        block([10.0, 10.3], [-4.0, 4.0]),
        block([3.0, 10.0], [-4.3, -4.0]),
        block([3.0, 10.0], [4.0, 4.3]),
    ];
    let gap_of_two_metres = [block([8.0, 8.3], [-12.0, 2.0]), block([8.0, 8.3], [4.0, 12.0])];
    let mut forest = Vec::new();
    for i in 0..6_i16 {
        for j in -4..5_i16 {
            let shift = if i % 2 == 0 { 0.0 } else { 1.2 };
            forest.push(column(4.0 + 2.4 * f32::from(i), 2.4 * f32::from(j) + shift, 0.1));
        }
    }
    for (solids, goal_east_m, limit_s) in [
        (vec![column(6.0, 0.0, 0.3)], 0.0, 30.0),
        (vec![block([8.0, 8.3], [-6.0, 3.0])], 0.0, 40.0),
        (trap.to_vec(), 0.0, 60.0),
        (gap_of_two_metres.to_vec(), 0.0, 40.0),
        (forest, 5.0, 60.0),
    ] {
        flight(&Scene::new(solids), (20.0, goal_east_m), limit_s).assert_arrived(CLEAR_M);
    }
}

#[test]
fn what_lies_below_or_above_is_no_obstacle() {
    let scene = Scene::new([
        beam([5.0, 7.0], [-10.0, 10.0], [0.0, 1.0]),
        beam([9.0, 11.0], [-10.0, 10.0], [2.0, 4.0]),
        ceiling(2.3),
    ]);
    let f = flight(&scene, (20.0, 0.0), 30.0);
    assert!(f.reached && f.time_s < 15.5, "{} s", f.time_s);
    assert!(f.positions.iter().all(|p| p.y.abs() < 0.3));
}

fn scene() -> Scene {
    Scene::new([column(5.0, 0.3, 0.4), block([8.0, 8.3], [-3.0, 5.0])])
}

fn within_limits(a: Action) -> bool {
    a.is_finite() && (0.0..=ACTION_LIMIT).contains(&a.forward_m_s) && a.yaw.abs() <= ACTION_LIMIT
}

#[test]
fn after_a_reset_nothing_of_the_first_flight_is_left() {
    let mut used = pilot();
    let first = Scene::new([block([4.0, 5.0], [-9.0, 2.0])]);
    fly(&first, used.as_mut(), 0.0, (14.0, 2.0), 6.0);
    used.reset();
    let again = fly(&scene(), used.as_mut(), 0.3, (14.0, 2.0), 20.0);
    let fresh = fly(&scene(), pilot().as_mut(), 0.3, (14.0, 2.0), 20.0);
    assert!(again.actions == fresh.actions);
}

#[test]
fn a_position_that_jumps_makes_the_memory_void() {
    let mut jumped = pilot();
    fly(&scene(), jumped.as_mut(), 0.0, (14.0, 0.0), 3.0);
    let elsewhere = NedVector::new(300.0, -80.0, -1.5);
    let mut frame = frame_of(&Scene::default(), elsewhere, Attitude::LEVEL_NORTH);
    let mut fresh = pilot();
    for sequence in 1000..1010 {
        frame.header.sequence = sequence;
        let after = jumped.decide(&input(&frame, Attitude::LEVEL_NORTH));
        assert_eq!(after, fresh.decide(&input(&frame, Attitude::LEVEL_NORTH)));
    }
}

#[test]
fn any_frame_and_any_pose_give_an_action_within_limits() {
    let mut pilot = pilot();
    let mut frame = Box::new(DepthFrame::EMPTY);
    let mut noise = ChaCha8Rng::seed_from_u64(1);
    let mut next = || noise.random::<f32>();
    for step in 0..120_u64 {
        let fill = [0.0, 1.0, next(), 0.002][step as usize % 4];
        let speckle = next();
        for pixel in frame.depth.iter_mut() {
            *pixel = if next() < speckle { next() } else { fill };
        }
        let huge = if step % 10 == 9 { 1e9 } else { 3.0 };
        frame.header.sequence = step;
        frame.header.stamp_ns = step * 50_000_000;
        frame.header.position_ned_m = NedVector::new(huge * next(), -huge * next(), -1.5);
        frame.header.attitude = Attitude::from_euler_rad(next() - 0.5, 3.0 * next() - 1.5, 7.0 * next());
        let action = pilot.decide(&PilotInput {
            now_ns: if step % 7 == 0 {
                0
            } else {
                step * 50_000_000 + 20_000_000
            },
            depth: &frame,
            goal: GoalRelative::new(10.0 * huge * next(), 6.2 * next() - 3.1),
            attitude: Attitude::from_euler_rad(0.5 * next(), next() - 0.5, 7.0 * next()),
            velocity_m_s: HeadingVector::new(4.0 * next() - 2.0, 2.0 * next() - 1.0, 0.0),
            height_m: 1.5,
        });
        assert!(within_limits(action), "step {step}: {action:?}");
    }
}

#[test]
fn a_wall_before_the_nose_is_never_flown_at() {
    let scene = Scene::new([block([0.75, 1.0], [-20.0, 20.0])]);
    let frame = frame_of(&scene, NedVector::new(0.0, 0.0, -1.5), Attitude::LEVEL_NORTH);
    let mut pilot = pilot();
    for _ in 0..40 {
        let action = pilot.decide(&input(&frame, Attitude::LEVEL_NORTH));
        assert!(action.forward_m_s <= 0.3, "{action:?}");
    }
}

#[test]
fn an_enclosed_vehicle_turns_and_looks_and_touches_nothing() {
    let cage = [
        block([2.0, 2.2], [-2.2, 2.2]),
        block([-2.2, -2.0], [-2.2, 2.2]),
        block([-2.0, 2.0], [-2.2, -2.0]),
        block([-2.0, 2.0], [2.0, 2.2]),
    ];
    let flight = fly(&Scene::new(cage), pilot().as_mut(), 0.0, (14.0, 2.0), 25.0);
    let least_m = flight.least_clearance_m;
    assert!(!flight.reached && least_m > 0.35, "{least_m}");
    assert!(flight.actions.iter().all(|a| within_limits(*a)));
    assert!(flight.actions.iter().filter(|a| a.yaw.abs() > 1.49).count() > 100);
}

/// Alters frames as an attack on the actor by accumulating BIM does (ε = 1/255, 20 iterations; measured on the trained
/// actor): pixels move by up to 7.8 m to either side, σ 3.2 m, neighbours by a common part that changes slowly.
struct Altered {
    pilot: Box<RecoveryPilot>,
    frame: Box<DepthFrame>,
    blocks: Vec<f32>,
    noise: ChaCha8Rng,
}

const BLOCK: usize = 8;
const COMMON_M: f32 = 1.4;
const OWN_M: f32 = 2.8;
const LIMIT_M: f32 = 7.84;

impl Altered {
    fn new(seed: u64) -> Self {
        let mut altered = Self {
            pilot: Box::default(),
            frame: Box::new(DepthFrame::EMPTY),
            blocks: vec![0.0; DEPTH_ROWS * DEPTH_COLS / (BLOCK * BLOCK)],
            noise: ChaCha8Rng::seed_from_u64(seed),
        };
        for i in 0..altered.blocks.len() {
            altered.blocks[i] = COMMON_M * altered.normal();
        }
        altered
    }

    /// About normal: the sum of four uniform numbers.
    fn normal(&mut self) -> f32 {
        let sum: f32 = self.noise.random::<[f32; 4]>().iter().sum();
        (sum - 2.0) * 1.732
    }
}

impl Pilot for Altered {
    fn decide(&mut self, input: &PilotInput<'_>) -> Action {
        for i in 0..self.blocks.len() {
            // Correlated 0.67 after five steps.
            self.blocks[i] = 0.923 * self.blocks[i] + 0.385 * COMMON_M * self.normal();
        }
        self.frame.header = input.depth.header;
        for (i, clean) in input.depth.depth.iter().enumerate() {
            let block = i / DEPTH_COLS / BLOCK * (DEPTH_COLS / BLOCK) + i % DEPTH_COLS / BLOCK;
            let by_m = (self.blocks[block] + OWN_M * self.normal()).clamp(-LIMIT_M, LIMIT_M);
            self.frame.depth[i] = (clean + by_m / DEPTH_FULL_SCALE_M).clamp(0.0, 1.0);
        }
        let input = PilotInput {
            depth: &self.frame,
            ..*input
        };
        self.pilot.observe(&input, true);
        self.pilot.decide(&input)
    }

    fn reset(&mut self) {}
}

#[test]
fn columns_walls_and_gaps_are_passed_as_open_space_is() {
    let gap = [block([8.0, 8.3], [-12.0, 2.0]), block([8.0, 8.3], [4.5, 12.0])];
    let rows_of_columns = (0..4).flat_map(|row: u8| {
        (0..4).map(move |i: u8| {
            let north = 4.0 + 4.0 * f32::from(row);
            column(north, -6.0 + 4.0 * f32::from(i) + 2.0 * f32::from(row % 2), 0.35)
        })
    });
    for (solids, limit_s) in [
        (vec![], 60.0),
        (vec![column(6.0, 0.0, 0.3)], 90.0),
        (vec![block([8.0, 8.3], [-6.0, 3.0])], 90.0),
        (gap.to_vec(), 90.0),
        (rows_of_columns.collect(), 90.0),
    ] {
        let f = fly(&Scene::new(solids), &mut Altered::new(1), 0.0, (20.0, 0.0), limit_s);
        f.assert_arrived(0.31);
    }
}
