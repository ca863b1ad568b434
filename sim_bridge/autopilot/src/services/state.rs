//! HEARTBEAT, EXTENDED_SYS_STATE, who owns the setpoints, and the standard modes protocol: which modes there are, which one is
//! flown. <https://mavlink.io/en/services/heartbeat.html>, <https://mavlink.io/en/services/standard_modes.html>

use crate::flight::{FlightMode, LandedState};
use crate::service::prelude::*;
use crate::services::actions::set_mode;
use vigil_mavlink::common::{MavModeFlag as Flag, MavModeProperty as Property};

pub(super) const COMMANDS: &[(u16, Handler)] = &[(DO_SET_STANDARD_MODE, set_standard_mode)];

pub(super) const MESSAGES: &[Produced] = &[
    Produced::from(HEARTBEAT_DATA::ID, [1.0, 1.0, 1.0], heartbeat),
    Produced::from(EXTENDED_SYS_STATE_DATA::ID, [5.0, 5.0, 1.0], extended_sys_state),
    Produced::from(NAMED_VALUE_FLOAT_DATA::ID, [1.0, 1.0, 1.0], setpoint_owner),
    Produced {
        request: Some(tell_available),
        ..Produced::from(AVAILABLE_MODES_DATA::ID, [0.0; 3], |_| available(1))
    },
    Produced::from(CURRENT_MODE_DATA::ID, [0.0, 0.5, 0.5], current),
    // The modes are always the same.
    Produced::from(AVAILABLE_MODES_MONITOR_DATA::ID, [0.0, 0.3, 0.3], |_| {
        Some(message!(AVAILABLE_MODES_MONITOR))
    }),
];

/// PX4's `custom_mode` of a terminated flight.
const TERMINATION: u32 = 10 << 16;

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
    let value = core.setpoints.owner.map_or(0.0, |owner| {
        f32::from(owner.id.system) * 256.0 + f32::from(owner.id.component)
    });
    Some(MavMessage::NAMED_VALUE_FLOAT(NAMED_VALUE_FLOAT_DATA {
        time_boot_ms: core.time_boot_ms(),
        value,
        name: "sp_owner".into(),
    }))
}

const DO_SET_STANDARD_MODE: u16 = 262;

fn set_standard_mode(command: &Command, source: Source, core: &mut Core) -> Answer {
    let wanted = command.param(1).unwrap_or(0.0);
    let is_wanted = |mode: &FlightMode| {
        let standard = mode.standard();
        standard != MavStandardMode::MAV_STANDARD_MODE_NON_STANDARD && f32::from(standard as u8) == wanted
    };
    let mut commanded = FlightMode::ALL.into_iter().filter(|mode| mode.is_commanded());
    match commanded.find(is_wanted) {
        None => Err(Refusal::FAILED),
        mode => set_mode(mode, source, core),
    }
}

/// Parameter 2 is the index from 1, or 0 for all of them.
fn tell_available(request: &Command, source: Source, core: &mut Core) -> Answer {
    let wanted = request.param(2).unwrap_or(0.0);
    let indices = (1..=FlightMode::ALL.len()).filter(|index| wanted == 0.0 || wanted == *index as f32);
    let messages: Vec<_> = indices.filter_map(available).collect();
    messages
        .iter()
        .for_each(|message| core.outbox.send(source.link, message));
    if messages.is_empty() {
        Err(Refusal::DENIED)
    } else {
        Ok(())
    }
}

fn available(index: usize) -> Option<MavMessage> {
    let mode = *FlightMode::ALL.get(index.checked_sub(1)?)?;
    let (.., px4_name, standard_mode) = mode.px4();
    let is_advanced = matches!(mode, FlightMode::Acro | FlightMode::Manual | FlightMode::Offboard);
    let is_automatic = !mode.needs_sticks() && mode != FlightMode::Offboard;
    let mut properties = Property::empty();
    properties.set(Property::MAV_MODE_PROPERTY_NOT_USER_SELECTABLE, !mode.is_commanded());
    properties.set(Property::MAV_MODE_PROPERTY_ADVANCED, is_advanced);
    properties.set(Property::MAV_MODE_PROPERTY_AUTO_MODE, is_automatic);
    Some(MavMessage::AVAILABLE_MODES(AVAILABLE_MODES_DATA {
        custom_mode: mode.custom_mode(),
        properties,
        number_modes: FlightMode::ALL.len() as u8,
        mode_index: index as u8,
        standard_mode,
        mode_name: px4_name.into(),
    }))
}

fn current(core: &Core) -> Option<MavMessage> {
    let mode = core.commander.mode;
    Some(MavMessage::CURRENT_MODE(CURRENT_MODE_DATA {
        custom_mode: mode.custom_mode(),
        intended_custom_mode: core.commander.intended_mode.custom_mode(),
        standard_mode: mode.standard(),
    }))
}
