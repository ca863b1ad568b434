//! Every fault of the depth sensor holds the vehicle, by name, before it touches anything; a scanner's packets fly it.

#[path = "../../tools/sensors/tests/common/device.rs"]
mod device;
#[path = "../../tools/sensors/tests/common/rays.rs"]
mod rays;

use device::Device;
use vigil_sensors::Mount;
use vigil_sensors::adapters::{OusterAdapter, OusterDevice};
use vigil_sim::world::{Family, Outcome, World, generate};
use vigil_tests::Pair;
use vigil_types::{Attitude, FrdVector, GuidanceState, Reason, Reasons, StepReport};

const SEED: u64 = 4203;
/// Steps of a story: 12 s.
const STEPS: usize = 240;

/// The flight at its end, everything that was wrong while guidance flew, and its last state.
fn fly(fault: &str, plausibility: bool) -> (Pair, Reasons, GuidanceState) {
    let mut pair = Pair::with(Family::Validation, SEED, |simulation, firmware| {
        simulation.sensor_fault = Some(fault.parse().unwrap());
        firmware.plausibility = plausibility;
        if !plausibility {
            // The control: the guard would stop before what a wrong picture leads into.
            firmware.detector.guard = Some(false);
        }
    });
    let reports = pair.fly(STEPS, |_, _| true);
    let flies = |r: &&StepReport| matches!(r.state, GuidanceState::Guided | GuidanceState::Hold);
    let flown = reports.iter().filter(flies);
    let reasons = flown.fold(Reasons::NONE, |all, r| all.union(r.reasons));
    (pair, reasons, reports[reports.len() - 1].state)
}

/// The fault holds the vehicle, and is among what was found.
fn holds(fault: &str, reasons: &[Reason], plausibility: bool) -> Pair {
    let (pair, found, state) = fly(fault, plausibility);
    let is_named = reasons.iter().any(|reason| found.contains(*reason));
    assert!(is_named, "{fault}: {:?}", found.iter().collect::<Vec<_>>());
    assert_eq!((pair.outcome(), state), (None, GuidanceState::Hold), "{fault}");
    pair
}

#[test]
fn a_fault_stops_the_vehicle_and_is_named_and_without_the_check_it_does_neither() {
    use Reason::{BlindSensor, FrozenSensor, ImplausiblePose, InconsistentPicture};
    let stories = [
        // A dead sensor is blind.
        (
            "zeros@4 ones@4 dead-left@4 dead-right@4 dead-bottom@4",
            &[BlindSensor][..],
        ),
        // A frozen picture is frozen whole and in part.
        (
            "frozen frozen@4 frozen-left@4 frozen-right@4 stuck-columns@4",
            &[FrozenSensor],
        ),
        // Fresh noise on an old picture: which of the two shows first depends on the way flown.
        ("frozen-noisy@4", &[FrozenSensor, InconsistentPicture]),
        // A sensor that sits wrong is found by the way its picture moves.
        ("mirrored mirrored@4 shifted turned", &[InconsistentPicture]),
        // A pose that is not the vehicle's is implausible.
        ("far-position@4 displaced-position@4 frozen-pose@4", &[ImplausiblePose]),
    ];
    for (fault, reasons) in stories
        .iter()
        .flat_map(|(faults, reasons)| faults.split(' ').map(move |f| (f, reasons)))
    {
        let speed_m_s = holds(fault, reasons, true).speed_m_s();
        assert!(speed_m_s < 0.2, "{fault}: still at {speed_m_s} m/s");
        let (pair, found, state) = fly(fault, false);
        let is_named = reasons.iter().any(|reason| found.contains(*reason));
        assert!(!is_named, "{fault}: named by nobody else");
        let goal_m = pair.simulator.goal_distance_m();
        let flies_on = pair.outcome().is_some() || state != GuidanceState::Hold;
        assert!(flies_on, "{fault}: without the check it flies on, {goal_m} m to go");
    }
}

#[test]
fn stamps_and_poses_that_no_valid_frame_has_need_no_judge() {
    let stories = [
        ("delayed@4", Reason::StaleFrame),
        ("frozen-stamp@4", Reason::BadFrame),
        ("earlier-stamp@4", Reason::BadFrame),
        ("bad-quaternion@4", Reason::BadFrame),
    ];
    for (fault, reason) in stories {
        holds(fault, &[reason], false);
    }
}

#[test]
fn a_vehicle_flies_a_course_by_a_scanners_packets() {
    let world = World::new(&generate(Family::Validation, 7));
    let device = Device::new(64, (FrdVector::new(0.05, 0.0, -0.05), Attitude::LEVEL_NORTH));
    let described = OusterDevice::from_metadata(&device.metadata(false)).expect("metadata");
    let mount = Mount::new(device.mount.0, device.mount.1).expect("a mount");
    let mut adapter = OusterAdapter::new(described, mount).expect("an adapter");
    let mut pair = Pair::new(Family::Validation, 7);
    let reports = pair.fly(1600, |pair, step| {
        let truth = pair.simulator.truth();
        // Twenty seconds before the simulation began the device was on: its stamps are never negative.
        let ahead_ns = pair.simulator.now_ns() + 20 * 1_000_000_000;
        let pose = (truth.position_ned_m, truth.attitude);
        let mut taken = None;
        for packet in device.turn(&world, pose, step as u16, ahead_ns) {
            // Captured now; pose and numbers as the driver of a vehicle has them.
            let image = adapter.packet(&packet, ahead_ns, &mut pair.frame.depth);
            taken = taken.or(image.expect("sound packets"));
        }
        taken.expect("a frame a turn");
        pair.frame.seal();
        true
    });
    assert_eq!(pair.outcome(), Some(Outcome::Success), "{} steps", reports.len());
}
