//! Cost of the endpoint per millisecond and per datagram of simulated flight.
#![allow(missing_docs)]

use divan::{Bencher, black_box};
use vigil_autopilot::vehicle::{Vehicle, VehicleParams, VehicleView, Wind};
use vigil_autopilot::{Endpoint, EndpointConfig, LinkId};

fn main() {
    divan::main();
}

fn view() -> VehicleView {
    Vehicle::new(VehicleParams::default(), Wind::default(), 1)
        .map(|v| v.view())
        .expect("default parameters are valid")
}

/// One second of flight with all telemetry, 1000 calls of `step`.
#[divan::bench(args = [1, 3])]
fn second_of_telemetry(bencher: Bencher<'_, '_>, links: usize) {
    let mut config = EndpointConfig::default();
    config.links.truncate(links);
    let mut endpoint = Endpoint::new(config).expect("default configuration is valid");
    let view = view();
    endpoint.start_airborne(0, 2.5);
    let mut now_ns = 0;
    bencher.bench_local(|| {
        for ms in 0..1000 {
            now_ns += 1_000_000;
            black_box(endpoint.step(now_ns, black_box(&view)));
            if ms % 50 == 0 {
                endpoint.transmit(|_, datagram| {
                    black_box(datagram);
                });
            }
        }
    });
}

/// One velocity setpoint as the companion sends it.
#[divan::bench]
fn receive_a_setpoint(bencher: Bencher<'_, '_>) {
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
    bencher.bench_local(|| endpoint.receive(1, LinkId::ONBOARD, black_box(&packet)));
}
