//! Offboard setpoints as they come. <https://docs.px4.io/main/en/flight_modes/offboard.html>

use crate::core::Core;
use crate::flight::{SetpointDefect, Taken, attitude_setpoint, global_setpoint, position_setpoint};
use crate::parameters::ParamId;
use crate::service::{Service, Source};
use vigil_mavlink::MavMessage;
use vigil_mavlink::common::{
    MavSeverity, SET_ATTITUDE_TARGET_DATA, SET_POSITION_TARGET_GLOBAL_INT_DATA, SET_POSITION_TARGET_LOCAL_NED_DATA,
};
use vigil_mavlink::framing::Packet;
use vigil_mavlink::mavlink::MessageData;

pub(crate) struct SetpointService;

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
            Ok(command) => match core.setpoints.take(core.now_ns, source.id, command) {
                Taken::Own => {}
                Taken::Ignored => core.refusals.setpoint_foreign += 1,
                Taken::IgnoredFirst => {
                    core.refusals.setpoint_foreign += 1;
                    let owner = core.setpoints.owner().unwrap_or(core.id);
                    let text = format!("setpoints of {} ignored: owner {owner}", source.id);
                    core.text(MavSeverity::MAV_SEVERITY_WARNING, &text);
                }
            },
        }
    }
}
