//! Arming, disarming, termination, reboot.

use crate::service::prelude::*;

const COMPONENT_ARM_DISARM: u16 = 400;
const DO_FLIGHTTERMINATION: u16 = 185;
const PREFLIGHT_REBOOT_SHUTDOWN: u16 = 246;
/// Parameter 2 of COMPONENT_ARM_DISARM that forces.
const FORCE: f32 = 21196.0;

pub(super) const COMMANDS: &[(u16, Handler)] = &[
    (COMPONENT_ARM_DISARM, arm_or_disarm),
    (DO_FLIGHTTERMINATION, terminate),
    (PREFLIGHT_REBOOT_SHUTDOWN, reboot),
];

fn arm_or_disarm(command: &Command, source: Source, core: &mut Core) -> Answer {
    let forced = command.param(2) == Some(FORCE);
    match command.param(1) {
        Some(1.0) => Ok(core.arm(source)?),
        Some(0.0) => Ok(core.disarm(forced)?),
        _ => Err(Refusal::DENIED),
    }
}

fn terminate(command: &Command, _source: Source, core: &mut Core) -> Answer {
    if command.param(1).is_none_or(|p| p <= 0.5) || !core.commander.armed {
        return Err(Refusal::DENIED);
    }
    core.terminate();
    Ok(())
}

/// 0 does nothing, 1 restarts the autopilot; anything else there is (shutdown, boot loader) does not exist in a simulation.
fn reboot(command: &Command, _source: Source, core: &mut Core) -> Answer {
    match command.param(1) {
        Some(0.0) => Ok(()),
        Some(1.0) => reboot_now(core),
        _ => Err(Refusal::DENIED.saying("denied: it reboots only, end the simulator instead")),
    }
}

/// Restarts the autopilot unless its motors may be needed.
pub(super) fn reboot_now(core: &mut Core) -> Answer {
    let c = &core.commander;
    if !c.armed || (c.terminated && c.is_on_ground()) {
        core.reboot();
        Ok(())
    } else {
        // DENIED as PX4's.
        Err(Refusal::DENIED.saying("reboot denied: armed"))
    }
}
