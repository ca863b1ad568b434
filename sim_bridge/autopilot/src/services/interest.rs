//! Regions of interest: what the nose points at in hold and on missions. There is no gimbal.
//! <https://mavlink.io/en/messages/common.html#MAV_CMD_DO_SET_ROI_LOCATION>

use crate::plan::mission::{DO_SET_ROI, DO_SET_ROI_LOCATION, DO_SET_ROI_NONE, NAV_ROI, ROI_LOCATION};
use crate::service::prelude::*;
use crate::services::actions;

/// MAV_ROI.
const ROI_NONE: f32 = 0.0;

pub(super) const COMMANDS: &[(u16, Handler)] = &[
    (NAV_ROI, look_at),
    (DO_SET_ROI_LOCATION, look_at),
    (DO_SET_ROI_NONE, look_at),
    (DO_SET_ROI, look_at),
];

fn look_at(command: &Command, _source: Source, core: &mut Core) -> Answer {
    let place_m = match (command.number, command.param(1)) {
        (DO_SET_ROI_LOCATION, _) | (NAV_ROI | DO_SET_ROI, Some(ROI_LOCATION)) => {
            actions::latitude_longitude_deg(command).ok_or(Refusal::DENIED)?;
            let place = actions::place_at(command, None, core)?;
            Some((place.x, place.y))
        }
        (DO_SET_ROI_NONE, _) | (NAV_ROI | DO_SET_ROI, Some(ROI_NONE)) => None,
        // Other vehicles and mission items are not looked at.
        _ => return Err(Refusal::DENIED),
    };
    core.commander.region_of_interest_m = place_m;
    Ok(())
}
