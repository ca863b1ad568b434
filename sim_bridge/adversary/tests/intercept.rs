//! When the adversary acts, and what it leaves of a frame.

use vigil_adversary::{
    AttackConfig, Burst, FrameAttack, Interceptor, SINGLE_BURST_FIRST, SINGLE_BURST_LAST, goal_seen_from,
};
use vigil_nnet::Isa;
use vigil_policy::{Decider, FrozenActor, LearnedPilot, Pilot, PilotInput};
use vigil_types::{
    Attitude, AttitudeSample, DepthFrame, FrdVector, Goal, HeadingVector, Kinematics, NedVector, STEP_NS,
};

fn attack(actor: &FrozenActor, iterations: u32) -> FrameAttack {
    let settings = AttackConfig {
        iterations,
        ..AttackConfig::PAPER
    };
    FrameAttack::on(&actor.into(), Isa::detect(), &settings).unwrap()
}

#[test]
fn one_burst_lies_where_its_seed_says_and_seeds_spread_it_over_the_flight() {
    let mut firsts = Vec::new();
    for seed in 0..200 {
        let steps = Burst::Steps(50).steps(seed);
        assert_eq!(steps, Burst::Steps(50).steps(seed));
        assert_eq!(steps.end - steps.start, 50);
        assert!((SINGLE_BURST_FIRST..=SINGLE_BURST_LAST).contains(&steps.start));
        // Whatever its length, one seed's burst begins at the same moment: lengths can be compared flight by flight.
        assert_eq!(Burst::Steps(5).steps(seed), steps.start..steps.start + 5);
        firsts.push(steps.start);
    }
    firsts.sort_unstable();
    assert!(firsts[20] < 60 && firsts[180] > 160, "{firsts:?}");
    assert_eq!(Burst::Continuous.steps(1), 0..u64::MAX);
}

#[test]
fn burst_lengths_are_read_from_the_command_line() {
    assert_eq!("50".parse(), Ok(Burst::Steps(50)));
    assert_eq!("continuous".parse(), Ok(Burst::Continuous));
    for bad in ["0", "-3", "always", ""] {
        assert!(bad.parse::<Burst>().is_err());
    }
}

#[test]
fn an_altered_frame_passes_every_check_of_the_receiver_and_only_its_pixels_differ() {
    let attack = attack(&FrozenActor::built_in().unwrap(), 2);
    let goal = NedVector::new(20.0, 5.0, -1.5);
    let mut interceptor = Interceptor::new(attack, Burst::Steps(5).steps(3), goal);
    for step in 0..SINGLE_BURST_LAST + 10 {
        let mut frame = DepthFrame::EMPTY;
        frame.header.sensor_id = 1;
        frame.header.sequence = step;
        for (i, x) in frame.depth.iter_mut().enumerate() {
            *x = (i % 250) as f32 / 1000.0;
        }
        frame.seal();
        let given = frame.clone();
        let passed = interceptor.pass(step, &mut frame).unwrap();
        assert_eq!(frame.check(1), Ok(()));
        if Burst::Steps(5).steps(3).contains(&step) {
            assert!(passed.is_some());
            assert_ne!(frame.depth, given.depth);
            frame.header.checksum = given.header.checksum;
            assert_eq!(frame.header, given.header);
        } else {
            assert_eq!((passed, frame), (None, given));
        }
    }
}

#[test]
fn the_goal_is_seen_as_the_pilot_sees_it() {
    let mut frame = DepthFrame::EMPTY;
    frame.header.position_ned_m = NedVector::new(3.0, -2.0, -1.4);
    frame.header.attitude = Attitude::from_euler_rad(0.05, -0.1, 2.9);
    let goal = Goal {
        position_ned_m: NedVector::new(-9.0, 4.0, -1.5),
    };
    let kinematics = Kinematics::new(0, frame.header.position_ned_m, NedVector::ZERO);
    let attitude = AttitudeSample::new(0, frame.header.attitude, FrdVector::ZERO);
    assert_eq!(
        goal_seen_from(&frame.header, goal.position_ned_m),
        goal.relative_to(&kinematics, &attitude)
    );
}

#[test]
fn the_adversary_knows_what_the_actor_remembers_and_how_it_moves() {
    let actor = FrozenActor::built_in().unwrap();
    let attack = attack(&actor, 3);
    let goal = NedVector::new(9.0, -1.0, -1.5);
    let mut bursts = (0..).map(|seed| Burst::Steps(20).steps(seed));
    let early = bursts.find(|steps| steps.contains(&(SINGLE_BURST_FIRST + 10))).unwrap();
    let mut interceptor = Interceptor::new(attack, early, goal);
    let mut pilot = LearnedPilot::new(Decider::Actor(actor.actor(Isa::detect()).unwrap()), false);
    let mut attacked = 0;
    for step in 0..60 {
        let mut frame = DepthFrame::EMPTY;
        frame.header.sequence = step;
        frame.header.stamp_ns = step * STEP_NS;
        // 1.25 m/s along the heading, in binary fractions.
        frame.header.position_ned_m = NedVector::new(0.0625 * step as f32, 0.0, -1.5);
        frame.header.attitude = Attitude::LEVEL_NORTH;
        // A wall ahead, open on the right only.
        let range = (6.0 - frame.header.position_ned_m.x) / 100.0;
        for (i, depth) in frame.depth.iter_mut().enumerate() {
            *depth = if i % 256 < 190 { range } else { 1.0 };
        }
        let passed = interceptor.pass(step, &mut frame).unwrap();
        let forward_m_s = if step == 0 { 0.0 } else { 1.25 };
        let action = pilot.decide(&PilotInput {
            velocity_m_s: HeadingVector::new(forward_m_s, 0.0, 0.0),
            ..PilotInput::at_rest(&frame, goal_seen_from(&frame.header, goal))
        });
        if let Some(outcome) = passed {
            attacked += 1;
            assert_eq!(outcome.attacked, [action.forward_m_s, action.yaw], "step {step}");
        }
    }
    assert_eq!(attacked, 20, "the whole burst");
}
