//! What a decision of the geometric pilot costs, reading a frame alone, and checking it: `cargo bench -p vigil-policy`.

#[path = "../tests/common/mod.rs"]
mod common;

use common::{Scene, block, column, input, walk};
use divan::Bencher;
use vigil_policy::{GeometricConfig, GeometricPilot, Pilot, PlausibilityCheck, RangeScan};
use vigil_types::{
    AttitudeSample, DepthFrame, FrdVector, Heartbeat, Kinematics, NedVector, VehicleMode, VehicleTelemetry,
};

fn main() {
    divan::main();
}

/// Frames of a walk forward through clutter, so that search and memory have work.
fn frames() -> Vec<DepthFrame> {
    let mut solids = vec![block([9.0, 9.3], [-3.0, 6.0]), block([6.0, 7.0], [-7.0, -5.0])];
    solids.extend((0..10_i16).map(|i| column(3.0 + f32::from(i), f32::from(i * 37 % 11) - 5.0, 0.15)));
    walk(&Scene::new(solids), 40)
}

#[divan::bench]
fn surroundings_of_a_frame(bencher: Bencher) {
    let frames = frames();
    let mut surroundings = RangeScan::new();
    let mut i = 0;
    bencher.bench_local(|| {
        i = (i + 1) % frames.len();
        surroundings
            .observe(&input(&frames[i], frames[i].header.attitude))
            .range_m[0]
    });
}

#[divan::bench]
fn decide(bencher: Bencher) {
    let frames = frames();
    let mut pilot = Box::new(GeometricPilot::new(GeometricConfig::default()));
    let mut i = 0;
    bencher.bench_local(|| {
        i = (i + 1) % frames.len();
        pilot.decide(&input(&frames[i], frames[i].header.attitude))
    });
}

/// Plausibility of a frame in flight, compared with the one before and with two kept ones.
#[divan::bench]
fn check(bencher: Bencher) {
    let frames = frames();
    let mut plausibility = Box::new(PlausibilityCheck::default());
    let mut i = 0;
    bencher.bench_local(|| {
        i = (i + 1) % frames.len();
        if i == 0 {
            // The walk begins again: for one that has flown it, a jump.
            *plausibility = PlausibilityCheck::default();
        }
        let header = frames[i].header;
        let telemetry = VehicleTelemetry {
            heartbeat: Some(Heartbeat {
                at_ns: header.stamp_ns,
                armed: true,
                mode: VehicleMode::External,
                failsafe: false,
            }),
            kinematics: Some(Kinematics::new(
                header.stamp_ns,
                header.position_ned_m,
                NedVector::new(1.0, 0.0, 0.0),
            )),
            attitude: Some(AttitudeSample::new(header.stamp_ns, header.attitude, FrdVector::ZERO)),
            ..VehicleTelemetry::default()
        };
        let faults = plausibility.check(&frames[i], &telemetry);
        assert!(faults.is_empty(), "{faults:?} in frame {i}");
        faults
    });
}
