//! ATTITUDE, ATTITUDE_QUATERNION and ATTITUDE_TARGET.

use crate::flight::attitude_target;
use crate::service::prelude::*;

pub(super) const MESSAGES: &[Produced] = &[
    Produced::from(ATTITUDE_DATA::ID, [50.0, 50.0, 20.0], attitude),
    Produced::from(ATTITUDE_QUATERNION_DATA::ID, [50.0, 20.0, 10.0], attitude_quaternion),
    Produced::from(ATTITUDE_TARGET_DATA::ID, [0.0, 5.0, 2.0], target),
];

fn attitude(core: &Core) -> Option<MavMessage> {
    let (mut m, a) = (ATTITUDE_DATA::default(), core.view.estimate.attitude);
    [m.roll, m.pitch, m.yaw] = [a.roll_rad(), a.pitch_rad(), a.yaw_rad()];
    [m.rollspeed, m.pitchspeed, m.yawspeed] = core.view.estimate.rates_frd_rad_s.to_array();
    m.time_boot_ms = core.time_boot_ms();
    Some(MavMessage::ATTITUDE(m))
}

fn attitude_quaternion(core: &Core) -> Option<MavMessage> {
    let (mut m, a) = (ATTITUDE_QUATERNION_DATA::default(), core.view.estimate.attitude);
    [m.q1, m.q2, m.q3, m.q4] = [a.w, a.x, a.y, a.z];
    [m.rollspeed, m.pitchspeed, m.yawspeed] = core.view.estimate.rates_frd_rad_s.to_array();
    m.time_boot_ms = core.time_boot_ms();
    Some(MavMessage::ATTITUDE_QUATERNION(m))
}

fn target(core: &Core) -> Option<MavMessage> {
    Some(MavMessage::ATTITUDE_TARGET(attitude_target(core)))
}
