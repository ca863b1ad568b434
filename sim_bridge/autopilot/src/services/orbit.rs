//! DO_ORBIT and ORBIT_EXECUTION_STATUS. <https://mavlink.io/en/messages/common.html#MAV_CMD_DO_ORBIT>

use crate::flight::{Facing, Orbit};
use crate::geo;
use crate::service::prelude::*;
use crate::services::actions;

const DO_ORBIT: u16 = 34;
/// Used where the command gives none (PX4's defaults are the same).
const DEFAULT_RADIUS_M: f32 = 5.0;
const DEFAULT_SPEED_M_S: f32 = 2.0;

pub(super) const COMMANDS: &[(u16, Handler)] = &[(DO_ORBIT, begin)];

pub(super) const MESSAGES: &[Produced] = &[Produced::from(ORBIT_EXECUTION_STATUS_DATA::ID, [0.0, 2.0, 2.0], status)];

/// Parameter 1 radius (negative: counter-clockwise), 2 speed, 3 where the nose points, 4 angle in radians (0: without
/// end), 5 to 7 the centre.
fn begin(command: &Command, _source: Source, core: &mut Core) -> Answer {
    let radius_m = command.param(1).unwrap_or(DEFAULT_RADIUS_M);
    let speed_m_s = command.param(2).unwrap_or(DEFAULT_SPEED_M_S);
    let angle_rad = command.param(4).unwrap_or(0.0);
    let facing = match command.param(3) {
        None | Some(0.0) => Facing::Centre,
        // There are no sticks: what they would turn stays.
        Some(1.0 | 2.0 | 4.0) => Facing::Unchanged,
        Some(3.0) => Facing::Tangent,
        // As the orbit that is being flown has it.
        Some(5.0) => core.orbit().map_or(Facing::Centre, |orbit| orbit.facing),
        Some(_) => return Err(Refusal::DENIED),
    };
    let is_sound = (1.0..=1000.0).contains(&radius_m.abs()) && (0.1..=50.0).contains(&speed_m_s.abs());
    if !is_sound || !angle_rad.is_finite() {
        return Err(Refusal::DENIED);
    }
    let orbit = Orbit {
        centre_ned_m: actions::place(command, core)?,
        radius_m: radius_m.abs(),
        is_clockwise: (radius_m > 0.0) == (speed_m_s > 0.0),
        speed_m_s: speed_m_s.abs(),
        facing,
        left_rad: (angle_rad != 0.0).then_some(angle_rad.abs()),
        bearing_rad: None,
    };
    Ok(core.begin_orbit(orbit)?)
}

/// Nothing while it does not circle.
fn status(core: &Core) -> Option<MavMessage> {
    let orbit = core.orbit()?;
    let (lat, lon, altitude_m) = geo::to_global(&core.home, orbit.centre_ned_m);
    Some(MavMessage::ORBIT_EXECUTION_STATUS(ORBIT_EXECUTION_STATUS_DATA {
        time_usec: core.time_boot_us(),
        radius: orbit.radius_m * if orbit.is_clockwise { 1.0 } else { -1.0 },
        x: geo::deg_e7(lat),
        y: geo::deg_e7(lon),
        z: altitude_m as f32,
        frame: MavFrame::MAV_FRAME_GLOBAL_INT,
    }))
}
