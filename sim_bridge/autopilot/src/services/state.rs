//! HEARTBEAT, EXTENDED_SYS_STATE, and who owns the setpoints.
//! <https://mavlink.io/en/services/heartbeat.html>

use crate::flight::{FlightMode, LandedState};
use crate::service::prelude::*;
use vigil_mavlink::common::MavModeFlag as Flag;

/// PX4's `custom_mode` of a terminated flight.
const TERMINATION: u32 = 10 << 16;

pub(super) const MESSAGES: &[Produced] = &[
    Produced::from(HEARTBEAT_DATA::ID, [1.0, 1.0, 1.0], heartbeat),
    Produced::from(EXTENDED_SYS_STATE_DATA::ID, [5.0, 5.0, 1.0], extended_sys_state),
    Produced::from(NAMED_VALUE_FLOAT_DATA::ID, [1.0, 1.0, 1.0], setpoint_owner),
];

fn heartbeat(core: &Core) -> Option<MavMessage> {
    let c = &core.commander;
    // As PX4 has them, but for OFFBOARD, orbit and follow, which say AUTO: clients up to pymavlink 2.4.41 and MAVROS name the mode by these.
    let by_whom = match c.mode.needs_sticks() {
        true => Flag::MAV_MODE_FLAG_MANUAL_INPUT_ENABLED,
        false => Flag::MAV_MODE_FLAG_GUIDED_ENABLED | Flag::MAV_MODE_FLAG_AUTO_ENABLED,
    };
    let mut base_mode = Flag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | by_whom;
    base_mode.set(Flag::MAV_MODE_FLAG_STABILIZE_ENABLED, c.mode != FlightMode::Acro);
    base_mode.set(Flag::MAV_MODE_FLAG_SAFETY_ARMED, c.armed);
    let system_status = if c.terminated {
        MavState::MAV_STATE_FLIGHT_TERMINATION
    } else if c.failsafe.is_some() {
        MavState::MAV_STATE_CRITICAL
    } else if c.armed {
        MavState::MAV_STATE_ACTIVE
    } else {
        MavState::MAV_STATE_STANDBY
    };
    Some(MavMessage::HEARTBEAT(HEARTBEAT_DATA {
        custom_mode: if c.terminated {
            TERMINATION
        } else {
            c.mode.custom_mode()
        },
        mavtype: MavType::MAV_TYPE_QUADROTOR,
        autopilot: MavAutopilot::MAV_AUTOPILOT_PX4,
        base_mode,
        system_status,
        mavlink_version: 3,
    }))
}

fn extended_sys_state(core: &Core) -> Option<MavMessage> {
    let landed_state = match core.commander.landed {
        LandedState::OnGround => MavLandedState::MAV_LANDED_STATE_ON_GROUND,
        LandedState::TakingOff => MavLandedState::MAV_LANDED_STATE_TAKEOFF,
        LandedState::InAir => MavLandedState::MAV_LANDED_STATE_IN_AIR,
        LandedState::Landing => MavLandedState::MAV_LANDED_STATE_LANDING,
    };
    Some(MavMessage::EXTENDED_SYS_STATE(EXTENDED_SYS_STATE_DATA {
        vtol_state: MavVtolState::MAV_VTOL_STATE_UNDEFINED,
        landed_state,
    }))
}

/// "sp_owner": system · 256 + component of the owner of OFFBOARD, 0 for none.
fn setpoint_owner(core: &Core) -> Option<MavMessage> {
    let value = core.setpoints.owner().map_or(0.0, |owner| {
        f32::from(owner.id.system) * 256.0 + f32::from(owner.id.component)
    });
    Some(MavMessage::NAMED_VALUE_FLOAT(NAMED_VALUE_FLOAT_DATA {
        time_boot_ms: core.time_boot_ms(),
        value,
        name: "sp_owner".into(),
    }))
}
