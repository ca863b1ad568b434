//! The standard modes protocol: which modes there are, which one is flown. <https://mavlink.io/en/services/standard_modes.html>

use crate::flight::FlightMode;
use crate::service::prelude::*;
use crate::services::actions::set_mode;
use vigil_mavlink::common::MavModeProperty as Property;

const DO_SET_STANDARD_MODE: u16 = 262;

pub(super) const COMMANDS: &[(u16, Handler)] = &[(DO_SET_STANDARD_MODE, set_standard_mode)];

pub(super) const MESSAGES: &[Produced] = &[
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

fn set_standard_mode(command: &Command, source: Source, core: &mut Core) -> Answer {
    let wanted = command.param(1).unwrap_or(0.0);
    let is_wanted = |mode: &FlightMode| {
        let standard = standard(*mode);
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

fn standard(mode: FlightMode) -> MavStandardMode {
    use MavStandardMode as S;
    match mode {
        FlightMode::Position => S::MAV_STANDARD_MODE_POSITION_HOLD,
        FlightMode::Orbit => S::MAV_STANDARD_MODE_ORBIT,
        FlightMode::Altitude => S::MAV_STANDARD_MODE_ALTITUDE_HOLD,
        FlightMode::Return => S::MAV_STANDARD_MODE_SAFE_RECOVERY,
        FlightMode::Mission => S::MAV_STANDARD_MODE_MISSION,
        FlightMode::Land => S::MAV_STANDARD_MODE_LAND,
        FlightMode::Takeoff => S::MAV_STANDARD_MODE_TAKEOFF,
        _ => S::MAV_STANDARD_MODE_NON_STANDARD,
    }
}

fn available(index: usize) -> Option<MavMessage> {
    let mode = *FlightMode::ALL.get(index.checked_sub(1)?)?;
    let (.., px4_name) = mode.px4();
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
        standard_mode: standard(mode),
        mode_name: px4_name.into(),
    }))
}

fn current(core: &Core) -> Option<MavMessage> {
    let mode = core.commander.mode;
    Some(MavMessage::CURRENT_MODE(CURRENT_MODE_DATA {
        custom_mode: mode.custom_mode(),
        intended_custom_mode: core.commander.intended_mode.custom_mode(),
        standard_mode: standard(mode),
    }))
}
