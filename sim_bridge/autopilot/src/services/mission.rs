//! Starting, pausing and following a mission. <https://mavlink.io/en/services/mission.html>

use crate::flight::FlightMode;
use crate::plan::PlanKind;
use crate::plan::mission::DO_CHANGE_SPEED;
use crate::service::prelude::*;

const MISSION_START: u16 = 300;

pub(super) const COMMANDS: &[(u16, Handler)] = &[(DO_CHANGE_SPEED, change_speed), (MISSION_START, start)];

pub(super) const MESSAGES: &[Produced] = &[
    Produced::from(MISSION_CURRENT_DATA::ID, [0.0, 1.0, 1.0], current),
    Produced::from(MISSION_ITEM_REACHED_DATA::ID, [0.0, 1.0, 1.0], reached),
];

pub(super) fn set_current(m: MISSION_SET_CURRENT_DATA, _source: Source, core: &mut Core) {
    if !make_current(usize::from(m.seq), core) {
        core.refusals.plan += 1;
        core.warn_refused(&format!("there is no mission item {}", m.seq));
    }
}

fn make_current(index: usize, core: &mut Core) -> bool {
    let is_set = core.plans.mission.set_current(index);
    if is_set {
        core.mission_changed();
    }
    is_set
}

fn change_speed(command: &Command, _source: Source, core: &mut Core) -> Answer {
    // Airspeed and ground speed are one without wind; rates of climb are parameters.
    let (Some(0.0 | 1.0), Some(speed_m_s)) = (command.param(1), command.param(2)) else {
        return Err(Refusal::DENIED);
    };
    // −1 changes nothing, −2 goes back to the default.
    match speed_m_s {
        -1.0 => {}
        -2.0 => core.change_speed(None),
        _ if speed_m_s > 0.0 => core.change_speed(Some(speed_m_s)),
        _ => return Err(Refusal::DENIED),
    }
    Ok(())
}

/// Starts with the item of parameter 1 (−1: the current one), and arms, as PX4 does.
fn start(command: &Command, source: Source, core: &mut Core) -> Answer {
    core.mission_check().map_err(|denial| Refusal::DENIED.saying(denial))?;
    match command.param(1) {
        None | Some(-1.0) => {}
        Some(first) if first >= 0.0 && make_current(first as usize, core) => {}
        Some(first) => return Err(Refusal::DENIED.saying(format!("mission denied: there is no item {first}"))),
    }
    core.change_mode(FlightMode::Mission, source)?;
    Ok(core.arm(source)?)
}

fn current(core: &Core) -> Option<MavMessage> {
    const IN_MISSION_MODE: u8 = 1;
    const SUSPENDED: u8 = 2;
    let is_flown = core.commander.mode == FlightMode::Mission;
    let mission = &core.plans.mission;
    let count = mission.len() as u16;
    Some(MavMessage::MISSION_CURRENT(MISSION_CURRENT_DATA {
        seq: mission.current(),
        total: if count == 0 { u16::MAX } else { count },
        mission_state: mission.state(is_flown),
        mission_mode: if is_flown { IN_MISSION_MODE } else { SUSPENDED },
        mission_id: core.plans.wire(PlanKind::Mission).id,
        fence_id: core.plans.wire(PlanKind::Fence).id,
        rally_points_id: core.plans.wire(PlanKind::Rally).id,
    }))
}

/// Sent when an item is reached, and again from time to time, because a packet may be lost.
fn reached(core: &Core) -> Option<MavMessage> {
    let seq = core.plans.mission.reached?;
    Some(MavMessage::MISSION_ITEM_REACHED(MISSION_ITEM_REACHED_DATA { seq }))
}
