//! Records a made-up flight of 12 s whose every number is known, for readers to be checked against:
//! `cargo run --release -p vigil-log --example sample_log -- DIRECTORY`. Prints the log's path.
//!
//! At step k the vehicle is 0.1·k m north, 0.5 m east and 1.5 m above home, heading east; pixel i of the frame is
//! ((i + k) mod 1000) / 1000; even steps have a new frame.

use mavlink::dialects::common::{
    HEARTBEAT_DATA, LOCAL_POSITION_NED_DATA, MavMessage, SET_POSITION_TARGET_LOCAL_NED_DATA, STATUSTEXT_DATA,
};
use mavlink::{MAVLinkV2MessageRaw, MavHeader};
use std::error::Error;
use std::f32::consts::FRAC_PI_2;
use std::path::PathBuf;
use vigil_log::{FlightInfo, LogPlace, Recorder, RecorderConfig, WhenFull};
use vigil_types::{
    Action, Attitude, AttitudeSample, Datagrams, DepthFrame, FrdVector, Goal, GuidanceState, HeadingVector, Heartbeat,
    Kinematics, Landed, NedVector, Reason, Reasons, STEP_NS, StepReport, StepTiming, VehicleMode, VehicleTelemetry,
    VelocitySetpoint,
};

const STEPS: u64 = 240;
/// 2026-01-02 03:04:05 UTC.
const EPOCH_OFFSET_NS: u64 = 1_767_323_045_000_000_000;

fn main() -> Result<(), Box<dyn Error>> {
    let directory = std::env::args_os().nth(1).ok_or("give a directory")?;
    let mut recorder = Recorder::start(RecorderConfig {
        when_full: WhenFull::Wait,
        epoch_offset_ns: EPOCH_OFFSET_NS,
        scene: serde_json::from_str(SCENE)?,
        ..RecorderConfig::new(
            LogPlace::Directory(PathBuf::from(directory)),
            FlightInfo {
                program: concat!("sample_log ", env!("CARGO_PKG_VERSION")).to_owned(),
                instance: 2,
                seed: Some(42),
                config_toml: "goal = [20.0, 5.0, 1.5]\n".to_owned(),
                ..FlightInfo::default()
            },
        )
    })?;
    let mut frame = Box::new(DepthFrame::EMPTY);
    let (mut received, mut sent) = (Datagrams::default(), Datagrams::default());
    for step in 0..STEPS {
        for (i, value) in (0_u64..).zip(frame.depth.iter_mut()) {
            *value = ((i + step) % 1000) as f32 / 1000.0;
        }
        frame.header.stamp_ns = step * STEP_NS;
        frame.header.sequence = step / 2;
        frame.seal();
        let report = report(step);
        traffic(step, &mut received, &mut sent);
        let frame = step.is_multiple_of(2).then_some(&*frame);
        recorder.record(|slot| slot.fill(report.now_ns, report.timing, frame, &received, &sent, &report));
    }
    let summary = recorder.finish();
    if let Some(failure) = summary.failure {
        return Err(failure.into());
    }
    println!("{}", summary.path.display());
    Ok(())
}

const SCENE: &str = r#"{ "solids": [
    { "cuboid": { "centre_ned_m": [8, -2, -1.5], "half_extents_m": [0.1, 3, 1.5], "yaw_rad": 0.4 } },
    { "cylinder": { "centre_ned_m": [12, 3, -2], "radius_m": 0.4, "half_height_m": 2 } }
] }"#;

fn report(step: u64) -> StepReport {
    let now_ns = step * STEP_NS;
    let position_ned_m = NedVector::new(0.1 * step as f32, 0.5, -1.5);
    let kinematics = Kinematics::new(now_ns, position_ned_m, NedVector::new(2.0, 0.0, 0.0));
    let attitude = AttitudeSample::new(now_ns, Attitude::from_euler_rad(0.0, 0.0, FRAC_PI_2), FrdVector::ZERO);
    let goal = Goal {
        position_ned_m: NedVector::new(20.0, 5.0, -1.5),
    };
    let guided = (20..220).contains(&step);
    StepReport {
        now_ns,
        timing: StepTiming {
            step,
            previous_execution_ns: 300_000,
            wake_late_ns: 50_000,
            slips: 0,
        },
        state: match step {
            0..20 => GuidanceState::Ready,
            20..220 => GuidanceState::Guided,
            _ => GuidanceState::Hold,
        },
        reasons: Reasons::NONE.with_if(step >= 220, Reason::GoalReached),
        telemetry: VehicleTelemetry {
            heartbeat: Some(Heartbeat {
                at_ns: now_ns,
                armed: true,
                mode: if guided {
                    VehicleMode::External
                } else {
                    VehicleMode::Hold
                },
                failsafe: false,
            }),
            kinematics: Some(kinematics),
            attitude: Some(attitude),
            landed: Landed::InAir,
            battery_remaining: Some(0.75),
        },
        goal: Some(goal),
        goal_relative: Some(goal.relative_to(&kinematics, &attitude)),
        action: guided.then_some(Action::new(1.5, -0.25)),
        setpoint: guided.then_some(VelocitySetpoint {
            velocity_m_s: HeadingVector::new(1.5, 0.0, 0.0),
            yaw_rate_rad_s: -0.125,
        }),
        frame_sequence: Some(step / 2),
        frame_age_ns: Some(step % 2 * STEP_NS),
        ..StepReport::default()
    }
}

/// Two packets in one datagram from the vehicle, one setpoint to it, and now and then bytes that are no packet and a
/// packet with a wrong checksum.
fn traffic(step: u64, received: &mut Datagrams, sent: &mut Datagrams) {
    received.clear();
    sent.clear();
    let position = MavMessage::LOCAL_POSITION_NED(LOCAL_POSITION_NED_DATA {
        time_boot_ms: (step * STEP_NS / 1_000_000) as u32,
        x: 0.1 * step as f32,
        y: 0.5,
        z: -1.5,
        ..Default::default()
    });
    let heartbeat = MavMessage::HEARTBEAT(HEARTBEAT_DATA::default());
    received.push(0, &[packet(1, step, &heartbeat), packet(1, step, &position)].concat());
    if step % 50 == 7 {
        received.push(1, b"\x00\xFE\xFDnoise");
    }
    if step % 50 == 8 {
        let mut altered = packet(1, step, &MavMessage::STATUSTEXT(STATUSTEXT_DATA::default()));
        if let Some(last) = altered.last_mut() {
            *last ^= 0xFF;
        }
        received.push(0, &altered);
    }
    let setpoint = MavMessage::SET_POSITION_TARGET_LOCAL_NED(SET_POSITION_TARGET_LOCAL_NED_DATA {
        vx: 1.5,
        ..Default::default()
    });
    sent.push(0, &packet(191, step, &setpoint));
}

fn packet(component_id: u8, step: u64, message: &MavMessage) -> Vec<u8> {
    let mut raw = MAVLinkV2MessageRaw::new();
    raw.serialize_message(
        MavHeader {
            system_id: 1,
            component_id,
            sequence: step as u8,
        },
        message,
    );
    raw.raw_bytes().to_vec()
}
