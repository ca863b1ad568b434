//! ATTITUDE, ATTITUDE_QUATERNION and ATTITUDE_TARGET.

use crate::flight::attitude_target;
use crate::service::prelude::*;

pub(super) const MESSAGES: &[Produced] = &[
    Produced::from(ATTITUDE_DATA::ID, [50.0, 50.0, 20.0], attitude),
    Produced::from(ATTITUDE_QUATERNION_DATA::ID, [50.0, 20.0, 10.0], attitude_quaternion),
    Produced::from(ATTITUDE_TARGET_DATA::ID, [0.0, 5.0, 2.0], target),
];

fn attitude(core: &Core) -> Option<MavMessage> {
    let e = &core.view.estimate;
    Some(MavMessage::ATTITUDE(ATTITUDE_DATA {
        time_boot_ms: core.time_boot_ms(),
        roll: e.attitude.roll_rad(),
        pitch: e.attitude.pitch_rad(),
        yaw: e.attitude.yaw_rad(),
        rollspeed: e.rates_frd_rad_s.x,
        pitchspeed: e.rates_frd_rad_s.y,
        yawspeed: e.rates_frd_rad_s.z,
    }))
}

fn attitude_quaternion(core: &Core) -> Option<MavMessage> {
    let e = &core.view.estimate;
    Some(MavMessage::ATTITUDE_QUATERNION(ATTITUDE_QUATERNION_DATA {
        time_boot_ms: core.time_boot_ms(),
        q1: e.attitude.w,
        q2: e.attitude.x,
        q3: e.attitude.y,
        q4: e.attitude.z,
        rollspeed: e.rates_frd_rad_s.x,
        pitchspeed: e.rates_frd_rad_s.y,
        yawspeed: e.rates_frd_rad_s.z,
        ..Default::default()
    }))
}

fn target(core: &Core) -> Option<MavMessage> {
    Some(MavMessage::ATTITUDE_TARGET(attitude_target(core)))
}
