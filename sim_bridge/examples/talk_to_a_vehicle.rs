//! A companion computer of your own: reads the vehicle's telemetry and moves it by setpoints, MAVLink bytes in, bytes out.
//!
//! `cargo run --release -p vigil-sim --example talk_to_a_vehicle`

use vigil_mavlink::common::{MavCmd, MavFrame, PositionTargetTypemask};
use vigil_mavlink::framing::{FramingCounters, encode, packets};
use vigil_mavlink::{MavMessage, message};
use vigil_sim::world::{Family, generate};
use vigil_sim::{SimConfig, Simulator, Start};
use vigil_types::{Datagrams, DepthFrame};

/// 1 m/s forward, level.
fn setpoint() -> MavMessage {
    // Position, acceleration and heading are left out.
    let type_mask = PositionTargetTypemask::from_bits_retain(0x5C7);
    #[expect(deprecated, reason = "its vehicles still speak it")]
    let message = message!(
        SET_POSITION_TARGET_LOCAL_NED,
        vx = 1.0,
        type_mask,
        coordinate_frame = MavFrame::MAV_FRAME_BODY_NED,
        target_system = 1,
        target_component = 1
    );
    message
}

/// PX4's Offboard mode.
fn offboard() -> MavMessage {
    message!(
        COMMAND_LONG,
        command = MavCmd::MAV_CMD_DO_SET_MODE,
        param1 = 1.0,
        param2 = 6.0,
        target_system = 1,
        target_component = 1
    )
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut config = SimConfig::new(generate(Family::Training, 3), 3);
    config.start = Start::Airborne;
    let mut simulator = Simulator::new(&config, 0)?;
    let mut frame = Box::new(DepthFrame::EMPTY);
    let (mut sent, mut received) = (Box::<Datagrams>::default(), Box::<Datagrams>::default());
    let mut counters = FramingCounters::default();
    let (mut sequence, mut place_m, mut answers) = (0u8, None, Vec::new());
    let begun = simulator.truth().position_ned_m;
    for step in 0..80 {
        simulator.lockstep(&sent, &mut frame, &mut received);
        for (_, datagram) in received.iter() {
            for packet in packets(datagram, &mut counters) {
                match packet.message() {
                    Ok(MavMessage::LOCAL_POSITION_NED(at)) => place_m = Some((at.x, at.y, at.z)),
                    Ok(MavMessage::COMMAND_ACK(ack)) => answers.push(ack.result),
                    _ => {}
                }
            }
        }
        sent.clear();
        // PX4 wants to hear setpoints before it goes by them.
        let mut messages = vec![setpoint()];
        messages.extend((step == 20).then(offboard));
        for message in messages {
            sent.push(0, &encode((1, 191), sequence, &message));
            sequence = sequence.wrapping_add(1);
        }
    }
    let moved_m = (simulator.truth().position_ned_m - begun).horizontal_norm();
    println!("the vehicle says that it is at {place_m:?}, and answered {answers:?}; it moved by {moved_m:.1} m");
    assert!(moved_m > 1.0, "it obeys");
    Ok(())
}
