//! Regions of interest: what the nose points at in hold and on missions. There is no gimbal.
//! <https://mavlink.io/en/messages/common.html#MAV_CMD_DO_SET_ROI_LOCATION>

use crate::core::Core;
use crate::service::{Answer, Service, Source};
use crate::services::actions;
use vigil_mavlink::framing::Command;

const NAV_ROI: u16 = 80;
const DO_SET_ROI_LOCATION: u16 = 195;
const DO_SET_ROI_NONE: u16 = 197;
const DO_SET_ROI: u16 = 201;
/// MAV_ROI.
const ROI_NONE: f32 = 0.0;
const ROI_LOCATION: f32 = 3.0;

#[derive(Default)]
pub(crate) struct Interest;

impl Service for Interest {
    fn commands(&self) -> &'static [u16] {
        &[NAV_ROI, DO_SET_ROI_LOCATION, DO_SET_ROI_NONE, DO_SET_ROI]
    }

    fn command(&mut self, command: &Command, _source: Source, core: &mut Core) -> Answer {
        let is_place = match (command.number, command.param(1)) {
            (DO_SET_ROI_LOCATION, _) | (NAV_ROI | DO_SET_ROI, Some(ROI_LOCATION)) => true,
            (DO_SET_ROI_NONE, _) | (NAV_ROI | DO_SET_ROI, Some(ROI_NONE)) => false,
            // Other vehicles and mission items are not looked at.
            _ => return Answer::DENIED,
        };
        let place_m = if is_place {
            if command.latitude_longitude_deg().is_none() {
                return Answer::DENIED;
            }
            match actions::place_at(command, None, core) {
                Some(place) => Some((place.x, place.y)),
                None => return Answer::DENIED,
            }
        } else {
            None
        };
        core.commander.region_of_interest_m = place_m;
        Answer::ACCEPTED
    }
}
