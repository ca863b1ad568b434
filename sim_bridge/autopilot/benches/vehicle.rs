//! Cost of the simulated vehicle and of its endpoint: `cargo bench -p vigil-autopilot --bench vehicle`.

use divan::{Bencher, black_box};
use vigil_autopilot::vehicle::{ControlCommand, Vehicle, VehicleParams, Wind, YawCommand};
use vigil_autopilot::{Endpoint, EndpointConfig, LinkId};
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

const CRUISE: ControlCommand =
    ControlCommand::VelocityHeading(HeadingVector::new(1.5, 0.0, 0.0), YawCommand::Rate(0.2));

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

/// One second of flight with all telemetry, 1000 calls of `step`.
#[divan::bench(args = [1, 3])]
fn second_of_telemetry(bencher: Bencher, links: usize) {
    let mut config = EndpointConfig::default();
    config.links.truncate(links);
    let mut endpoint = Endpoint::new(config).expect("default configuration is valid");
    let view = hovering().view();
    endpoint.start_airborne(0, 2.5);
    let mut now_ns = 0;
    bencher.bench_local(|| {
        for ms in 0..1000 {
            now_ns += 1_000_000;
            black_box(endpoint.step(now_ns, black_box(&view)));
            if ms % 50 == 0 {
                endpoint.transmit(|_, _, datagram| {
                    black_box(datagram);
                });
            }
        }
    });
}

/// One velocity setpoint as the companion sends it.
#[divan::bench]
fn receive_a_setpoint(bencher: Bencher) {
    use vigil_mavlink::common::{MavFrame, PositionTargetTypemask};
    use vigil_mavlink::framing::encode;
    #[allow(deprecated)]
    let message = vigil_mavlink::message!(
        SET_POSITION_TARGET_LOCAL_NED,
        vx = 1.0,
        type_mask = PositionTargetTypemask::from_bits_retain(0x5C7),
        coordinate_frame = MavFrame::MAV_FRAME_BODY_NED,
        target_system = 1,
        target_component = 1
    );
    let packet = encode((1, 191), 0, &message);
    let mut endpoint = Endpoint::new(EndpointConfig::default()).expect("default configuration is valid");
    bencher.bench_local(|| endpoint.receive_from(1, LinkId::ONBOARD, 0, black_box(&packet)));
}
