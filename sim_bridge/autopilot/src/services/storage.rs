//! PREFLIGHT_STORAGE: keeping parameters, and their defaults again.
//! <https://mavlink.io/en/messages/common.html#MAV_CMD_PREFLIGHT_STORAGE>

use crate::service::prelude::*;

const PREFLIGHT_STORAGE: u16 = 245;
/// MAV_PREFLIGHT_STORAGE_ACTION_*.
const READ: f32 = 0.0;
const WRITE: f32 = 1.0;
const RESET: f32 = 2.0;
const RESET_CALIBRATION: f32 = 3.0;
const RESET_ALL: f32 = 4.0;

pub(super) const COMMANDS: &[(u16, Handler)] = &[(PREFLIGHT_STORAGE, store)];

fn store(command: &Command, _source: Source, core: &mut Core) -> Answer {
    if core.commander.armed {
        return Err(Refusal::REJECTED.saying("parameter storage denied: armed"));
    }
    match command.param(1) {
        // Whatever is set is kept at once, where the simulator keeps anything (`--state`); calibrations change nothing.
        Some(READ | WRITE | RESET_CALIBRATION) => Ok(()),
        Some(RESET | RESET_ALL) => {
            core.parameters.reset();
            core.inform("parameters reset to their defaults");
            Ok(())
        }
        _ => Err(Refusal::DENIED),
    }
}
