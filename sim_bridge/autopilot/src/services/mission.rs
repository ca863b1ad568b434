//! Starting, pausing and following a mission. <https://mavlink.io/en/services/mission.html>

use crate::flight::FlightMode;
use crate::plan::PlanKind;
use crate::service::prelude::*;
use crate::services::arming::answer;

const DO_CHANGE_SPEED: u16 = 178;
const MISSION_START: u16 = 300;

pub(crate) struct MissionService;

impl Service for MissionService {
    fn receive(&mut self, packet: &Packet<'_>, _source: Source, core: &mut Core) {
        if let Some(MISSION_SET_CURRENT_DATA { seq, .. }) = core.read(packet)
            && !set_current(usize::from(seq), core)
        {
            core.refusals.plan += 1;
            core.warn(&format!("there is no mission item {seq}"));
        }
    }

    fn serves(&self, command: u16) -> bool {
        matches!(command, DO_CHANGE_SPEED | MISSION_START)
    }

    fn command(&mut self, command: &Command, source: Source, core: &mut Core) -> Answer {
        match command.number {
            MISSION_START => start(command, source, core),
            DO_CHANGE_SPEED => match (command.param(1), command.param(2)) {
                // Airspeed and ground speed are one without wind; rates of climb are parameters.
                (Some(0.0 | 1.0), Some(speed_m_s)) if speed_m_s > 0.0 => {
                    core.change_speed(Some(speed_m_s));
                    Answer::ACCEPTED
                }
                // −1 changes nothing, −2 goes back to the default.
                (Some(0.0 | 1.0), Some(-1.0)) => Answer::ACCEPTED,
                (Some(0.0 | 1.0), Some(-2.0)) => {
                    core.change_speed(None);
                    Answer::ACCEPTED
                }
                _ => Answer::DENIED,
            },
            _ => Answer::UNSUPPORTED,
        }
    }

    fn messages(&self) -> &'static [Produced] {
        const {
            &[
                Produced::from(MISSION_CURRENT_DATA::ID, [0.0, 1.0, 1.0], current),
                Produced::from(MISSION_ITEM_REACHED_DATA::ID, [0.0, 1.0, 1.0], reached),
            ]
        }
    }
}

fn set_current(index: usize, core: &mut Core) -> bool {
    let is_set = core.plans.mission.set_current(index);
    if is_set {
        core.mission_changed();
    }
    is_set
}

/// Starts with the item of parameter 1 (−1: the current one), and arms, as PX4 does.
fn start(command: &Command, source: Source, core: &mut Core) -> Answer {
    match command.param(1) {
        None | Some(-1.0) => {}
        Some(first) if first >= 0.0 && set_current(first as usize, core) => {}
        Some(_) => return Answer::DENIED,
    }
    if let Err(denial) = core.mission_check() {
        answer(Err(denial), core);
        return Answer::DENIED;
    }
    let outcome = core.change_mode(FlightMode::Mission, source);
    answer(outcome.and_then(|()| core.arm(source)), core)
}

fn current(core: &Core) -> Option<MavMessage> {
    const IN_MISSION_MODE: u8 = 1;
    const SUSPENDED: u8 = 2;
    let is_flown = core.commander.mode() == FlightMode::Mission;
    let mission = &core.plans.mission;
    Some(MavMessage::MISSION_CURRENT(MISSION_CURRENT_DATA {
        seq: mission.current(),
        total: mission.len() as u16,
        mission_state: mission.state(is_flown),
        mission_mode: if is_flown { IN_MISSION_MODE } else { SUSPENDED },
        mission_id: core.plans.wire(PlanKind::Mission).id,
        fence_id: core.plans.wire(PlanKind::Fence).id,
        rally_points_id: core.plans.wire(PlanKind::Rally).id,
    }))
}

/// Sent when an item is reached, and again from time to time, because a packet may be lost.
fn reached(core: &Core) -> Option<MavMessage> {
    let seq = core.plans.mission.reached()?;
    Some(MavMessage::MISSION_ITEM_REACHED(MISSION_ITEM_REACHED_DATA { seq }))
}
