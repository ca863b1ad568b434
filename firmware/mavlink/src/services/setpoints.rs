//! Velocity setpoints to the vehicle: SET_POSITION_TARGET_LOCAL_NED.

use super::{Service, Step};
use crate::core::Core;
use crate::report;
use vigil_types::{Datagrams, Nanos, VelocitySetpoint};

#[derive(Debug, Clone, Default)]
pub(crate) struct SetpointService;

impl SetpointService {
    /// A zero setpoint, three times against loss, if it was streaming: an autopilot may keep the last velocity for seconds.
    pub fn end(&mut self, core: &mut Core, now_ns: Nanos, out: &mut Datagrams) {
        if let (true, Some(system)) = (core.streaming, core.system_id) {
            for _ in 0..3 {
                core.say(out, &report::setpoint(now_ns, system, &VelocitySetpoint::HOLD));
            }
        }
        core.streaming = false;
    }
}

impl Service for SetpointService {
    fn speak(&mut self, core: &mut Core, step: &Step<'_>, out: &mut Datagrams) {
        let report = step.report;
        core.streaming = report.setpoint.is_some() && core.system_id.is_some();
        if let (Some(setpoint), Some(system)) = (&report.setpoint, core.system_id) {
            let (now_ns, obeys) = (report.now_ns, report.has_vehicle());
            let asked = VelocitySetpoint {
                velocity_m_s: core.vehicle.asked_velocity(now_ns, setpoint.velocity_m_s, obeys),
                ..*setpoint
            };
            core.say(out, &report::setpoint(now_ns, system, &asked));
        }
    }
}
