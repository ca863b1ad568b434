//! Ids of messages that are announced besides their stream.

use vigil_mavlink::common::{
    CURRENT_MODE_DATA, EXTENDED_SYS_STATE_DATA, FENCE_STATUS_DATA, HEARTBEAT_DATA, HOME_POSITION_DATA,
    MISSION_CURRENT_DATA, MISSION_ITEM_REACHED_DATA, NAMED_VALUE_FLOAT_DATA,
};
use vigil_mavlink::mavlink::MessageData;

pub(crate) const CURRENT_MODE: u32 = CURRENT_MODE_DATA::ID;
pub(crate) const HOME_POSITION: u32 = HOME_POSITION_DATA::ID;
pub(crate) const HEARTBEAT: u32 = HEARTBEAT_DATA::ID;
pub(crate) const EXTENDED_SYS_STATE: u32 = EXTENDED_SYS_STATE_DATA::ID;
pub(crate) const FENCE_STATUS: u32 = FENCE_STATUS_DATA::ID;
pub(crate) const MISSION_CURRENT: u32 = MISSION_CURRENT_DATA::ID;
pub(crate) const MISSION_ITEM_REACHED: u32 = MISSION_ITEM_REACHED_DATA::ID;
/// The setpoint owner.
pub(crate) const NAMED_VALUE_FLOAT: u32 = NAMED_VALUE_FLOAT_DATA::ID;
