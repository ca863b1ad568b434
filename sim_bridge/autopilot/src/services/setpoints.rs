//! Offboard setpoints as they come. <https://docs.px4.io/main/en/flight_modes/offboard.html>

use crate::core::Core;
use crate::flight::{SetpointDefect, Taken, attitude_setpoint, global_setpoint, position_setpoint};
use crate::service::{Service, Source};
use crate::vehicle_parameters::ParamId;
use vigil_mavlink::MavMessage;
use vigil_mavlink::common::{
    MavSeverity, SET_ATTITUDE_TARGET_DATA, SET_POSITION_TARGET_GLOBAL_INT_DATA, SET_POSITION_TARGET_LOCAL_NED_DATA,
};
use vigil_mavlink::framing::Packet;
use vigil_mavlink::mavlink::MessageData;
use vigil_types::Nanos;

/// Claimants are told of this often at most: there may be any number of made-up ones.
const TOLD_NS: Nanos = 1_000_000_000;

#[derive(Default)]
pub(crate) struct SetpointService {
    told_next_ns: Nanos,
}

impl Service for SetpointService {
    fn receive(&mut self, packet: &Packet<'_>, source: Source, core: &mut Core) {
        let ids = [
            SET_POSITION_TARGET_LOCAL_NED_DATA::ID,
            SET_POSITION_TARGET_GLOBAL_INT_DATA::ID,
            SET_ATTITUDE_TARGET_DATA::ID,
        ];
        if !ids.contains(&packet.message_id()) {
            return;
        }
        let speed_limit_m_s = core.param(ParamId::MaxSpeedMS);
        let heading_rad = core.view.estimate.attitude.yaw_rad();
        let command = match packet.message() {
            Ok(MavMessage::SET_POSITION_TARGET_LOCAL_NED(m)) => position_setpoint(&m, speed_limit_m_s, heading_rad),
            Ok(MavMessage::SET_POSITION_TARGET_GLOBAL_INT(m)) => global_setpoint(&m, &core.home, speed_limit_m_s),
            Ok(MavMessage::SET_ATTITUDE_TARGET(m)) => attitude_setpoint(&m),
            _ => {
                core.refusals.not_parsed += 1;
                return;
            }
        };
        match command {
            Err(SetpointDefect::Form) => core.refusals.setpoint_form += 1,
            Err(SetpointDefect::Value) => core.refusals.setpoint_value += 1,
            Ok(command) => match core.setpoints.take(core.now_ns, source, command) {
                Taken::Own => {}
                Taken::Ignored => core.refusals.setpoint_foreign += 1,
                Taken::IgnoredFirst => {
                    core.refusals.setpoint_foreign += 1;
                    if core.now_ns >= self.told_next_ns
                        && let Some(owner) = core.setpoints.owner()
                    {
                        self.told_next_ns = core.now_ns + TOLD_NS;
                        let text = match owner.id == source.id {
                            true => format!("setpoints of a second {source} ignored"),
                            false => format!("setpoints of {} ignored: owner {}", source.id, owner.id),
                        };
                        core.text(MavSeverity::MAV_SEVERITY_WARNING, &text);
                    }
                }
            },
        }
    }
}
