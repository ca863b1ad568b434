//! Offboard setpoints as they come. <https://docs.px4.io/main/en/flight_modes/offboard.html>

use crate::flight::{SetpointDefect, attitude_setpoint, global_setpoint, position_setpoint};
use crate::service::prelude::*;
use crate::services::BELOW_HOME_M;
use crate::vehicle::ControlCommand;
use crate::vehicle_parameters::ParamId;
use vigil_mavlink::Allowance;

/// Claimants and new reasons of refusals are reported this often at most: there may be any number of made-up ones.
const SAID_NS: Nanos = 1_000_000_000;
/// The same reason is said to the same sender again after this time.
const REPEATED_NS: Nanos = 5_000_000_000;
/// Where both messages of positions have their frame.
const FRAME_AT: usize = 52;

#[derive(Default)]
pub(crate) struct SetpointService {
    said: Allowance,
    /// The refusal that was said last, and when.
    refusal: Option<(Nanos, Source, SetpointDefect)>,
    told_of_ground: Allowance,
}

impl SetpointService {
    /// Counts a setpoint that is not flown, and says why: from a stream that is refused nobody hears "no setpoints".
    fn refuse(&mut self, defect: SetpointDefect, source: Source, core: &mut Core) {
        match defect {
            SetpointDefect::Value(_) => core.refusals.setpoint_value += 1,
            _ => core.refusals.setpoint_form += 1,
        }
        core.setpoints.refuse(core.now_ns, defect);
        let is_due = self.refusal.is_none_or(|(at_ns, to, of)| {
            let since_ns = core.now_ns.saturating_sub(at_ns);
            since_ns >= REPEATED_NS || ((to, of) != (source, defect) && since_ns >= SAID_NS)
        });
        if is_due {
            self.refusal = Some((core.now_ns, source, defect));
            core.warn(&format!("setpoints of {}: {defect}", source.id));
        }
    }

    /// A place below home is flown as PX4 flies it, to the ground; it was hardly meant so.
    fn warn_of_ground(&mut self, command: &ControlCommand, source: Source, core: &mut Core) {
        let down_m = match command {
            ControlCommand::Position { position_ned_m, .. } => position_ned_m.z,
            ControlCommand::VelocityAtHeight { down_m, .. } => *down_m,
            _ => return,
        };
        if down_m > BELOW_HOME_M && self.told_of_ground.takes(core.now_ns, REPEATED_NS, 1) {
            core.warn(&format!("setpoints of {}: {down_m:.0} m below home", source.id));
        }
    }
}

impl Service for SetpointService {
    fn receive(&mut self, packet: &Packet<'_>, source: Source, core: &mut Core) {
        let speed_limit_m_s = core.param(ParamId::MaxSpeedMS);
        let heading_rad = core.view.estimate.attitude.yaw_rad();
        // What is not parsed is a frame that the protocol does not have.
        let no_frame = SetpointDefect::Frame(packet.payload().get(FRAME_AT).copied().unwrap_or(0));
        let command = match packet.message_id() {
            SET_POSITION_TARGET_LOCAL_NED_DATA::ID => {
                let read = core.read(packet);
                read.map(|m| position_setpoint(&m, speed_limit_m_s, heading_rad))
            }
            SET_POSITION_TARGET_GLOBAL_INT_DATA::ID => {
                let read = core.read(packet);
                read.map(|m| global_setpoint(&m, &core.home, speed_limit_m_s))
            }
            SET_ATTITUDE_TARGET_DATA::ID => core.read(packet).map(|m| attitude_setpoint(&m)),
            SET_ACTUATOR_CONTROL_TARGET_DATA::ID => Some(Err(SetpointDefect::Actuators)),
            _ => return,
        };
        let command = match command.unwrap_or(Err(no_frame)) {
            Ok(command) => command,
            Err(defect) => {
                self.refuse(defect, source, core);
                if !matches!(defect, SetpointDefect::Incomplete(_)) {
                    return;
                }
                ControlCommand::STOP
            }
        };
        self.warn_of_ground(&command, source, core);
        let Some(is_warned) = core.setpoints.take(core.now_ns, source, command) else {
            return core.regain_offboard(source);
        };
        core.refusals.setpoint_foreign += 1;
        if !is_warned
            && let Some(owner) = core.setpoints.owner()
            && self.said.takes(core.now_ns, SAID_NS, 1)
        {
            let text = match owner.id == source.id {
                true => format!("setpoints of a second {source} ignored"),
                false => format!("setpoints of {} ignored: owner {}", source.id, owner.id),
            };
            core.warn(&text);
        }
    }
}
