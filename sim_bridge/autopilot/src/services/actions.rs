//! Modes and actions: arming, disarming, termination, reboot; take-off, land, hold, return, OFFBOARD, go to, orbit; and regions of
//! interest, which the nose points at in hold and on missions: there is no gimbal.
//! <https://mavlink.io/en/services/command.html>, mode numbers as in PX4.

use crate::core::padded;
use crate::flight::{Facing, FlightMode, Orbit};
use crate::geo::{self, BELOW_HOME_M, MAX_DISTANCE_M, MAX_HEIGHT_M, height_m};
use crate::plan::mission::{
    DO_SET_ROI, DO_SET_ROI_LOCATION, DO_SET_ROI_NONE, NAV_LAND, NAV_RETURN_TO_LAUNCH, NAV_ROI, NAV_TAKEOFF,
    ROI_LOCATION,
};
use crate::service::prelude::*;
use crate::vehicle::YawCommand;
use vigil_mavlink::common::MavModeFlag as Flag;
use vigil_mavlink::framing::CommandForm;
use vigil_types::NedVector;

pub(super) const COMMANDS: &[(u16, Handler)] = &[
    (NAV_RETURN_TO_LAUNCH, |_, source, core| {
        set_mode(Some(FlightMode::Return), source, core)
    }),
    (NAV_LAND, |_, source, core| {
        set_mode(Some(FlightMode::Land), source, core)
    }),
    (NAV_TAKEOFF, take_off),
    (DO_SET_MODE, do_set_mode),
    (DO_CHANGE_ALTITUDE, change_altitude),
    (DO_REPOSITION, reposition),
    (COMPONENT_ARM_DISARM, arm_or_disarm),
    (DO_FLIGHTTERMINATION, terminate),
    (PREFLIGHT_REBOOT_SHUTDOWN, reboot),
    (NAV_ROI, look_at),
    (DO_SET_ROI_LOCATION, look_at),
    (DO_SET_ROI_NONE, look_at),
    (DO_SET_ROI, look_at),
    (DO_ORBIT, orbit),
];

pub(super) const MESSAGES: &[Produced] = &[Produced::from(
    ORBIT_EXECUTION_STATUS_DATA::ID,
    [0.0, 2.0, 2.0],
    orbit_status,
)];

const DO_SET_MODE: u16 = 176;
const DO_CHANGE_ALTITUDE: u16 = 186;
const DO_REPOSITION: u16 = 192;
/// MAV_DO_REPOSITION_FLAGS_CHANGE_MODE.
const MAY_CHANGE_MODE: f32 = 1.0;

/// SET_MODE, the message.
pub(crate) struct SetMode;

impl Service for SetMode {
    fn receive(&mut self, packet: &Packet<'_>, source: Source, core: &mut Core) {
        // The crate's type of SET_MODE refuses base modes that clients do send: read it raw.
        if packet.message_id() == SET_MODE_DATA::ID {
            let [_, _, main, sub, target_system, base] = padded(packet.payload());
            if target_system == core.id().system {
                // PX4 hands it on as the command, which is what it acknowledges.
                let answer = set_mode(requested(base, main, sub), source, core);
                acknowledge(answer, DO_SET_MODE, source, core);
            }
        }
    }
}

fn do_set_mode(command: &Command, source: Source, core: &mut Core) -> Answer {
    let [base, main, sub] = [1, 2, 3].map(|n| command.param(n).unwrap_or(0.0) as u8);
    set_mode(requested(base, main, sub), source, core)
}

/// The custom mode, or what PX4's commander flies of a base mode without one.
fn requested(base: u8, main: u8, sub: u8) -> Option<FlightMode> {
    let has = |flag: Flag| base & flag.bits() != 0;
    match base {
        _ if has(Flag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED) => FlightMode::from_px4(main, sub),
        _ if has(Flag::MAV_MODE_FLAG_AUTO_ENABLED) => Some(FlightMode::Mission),
        _ if !has(Flag::MAV_MODE_FLAG_MANUAL_INPUT_ENABLED) => None,
        _ if has(Flag::MAV_MODE_FLAG_GUIDED_ENABLED) => Some(FlightMode::Position),
        _ if has(Flag::MAV_MODE_FLAG_STABILIZE_ENABLED) => Some(FlightMode::Stabilized),
        _ => Some(FlightMode::Manual),
    }
}

pub(super) fn set_mode(mode: Option<FlightMode>, source: Source, core: &mut Core) -> Answer {
    let mode = mode.ok_or_else(|| Refusal::REJECTED.saying("mode denied: not flown by this vehicle"))?;
    Ok(core.change_mode(mode, source)?)
}

/// Places are flown to that are on the globe.
fn check_frame(frame: u8) -> Answer {
    let text = || Refusal::DENIED.saying(format!("denied: frame {frame} is not flown, 0, 3, 5 and 6 are"));
    geo::is_global(frame).then_some(()).ok_or_else(text)
}

fn too_far() -> Refusal {
    Refusal::DENIED.saying("denied: too far from home")
}

/// Whether a height above home is one to fly at.
fn check_height(height_m: f32) -> Answer {
    if height_m < -BELOW_HOME_M {
        let text = format!("denied: {:.0} m below home; altitudes are AMSL", -height_m);
        return Err(Refusal::DENIED.saying(text));
    }
    // NaN fails the comparison.
    (height_m <= MAX_HEIGHT_M).then_some(()).ok_or_else(too_far)
}

/// Parameter 7 is the altitude; NaN is MIS_TAKEOFF_ALT above the vehicle.
fn take_off(command: &Command, _source: Source, core: &mut Core) -> Answer {
    let height = command.param(7).map(height_m);
    if height.is_some_and(|height| height > MAX_HEIGHT_M) {
        return Err(too_far());
    }
    Ok(core.take_off(height)?)
}

/// Latitude and longitude of parameters 5 and 6; `None` for "where the vehicle is": NaN, in an integer the largest, or the
/// smallest, which is a NaN that was cast.
pub(super) fn latitude_longitude_deg(command: &Command) -> Option<(f64, f64)> {
    let is_here = |degrees: i32| matches!(degrees, i32::MIN | i32::MAX);
    match command.form {
        CommandForm::Int { x, y, .. } if is_here(x) || is_here(y) => None,
        _ => command.latitude_longitude_deg(),
    }
}

/// Metres north and east of the local origin.
pub(super) fn to_local((lat, lon): (f64, f64)) -> Result<(f32, f32), Refusal> {
    let is_on_globe = lat.abs() <= 90.0 && lon.abs() <= 180.0;
    let refusal = || Refusal::DENIED.saying("denied: no such latitude or longitude");
    is_on_globe
        .then(|| geo::ORIGIN.north_east_m(lat, lon))
        .ok_or_else(refusal)
}

/// The place of parameters 5 and 6 in a global frame, its height above home given; `None` is the vehicle's. PX4 reads a command's altitude
/// above sea level whatever the frame says.
fn place(command: &Command, height_m: Option<f32>, core: &Core) -> Result<NedVector, Refusal> {
    check_frame(command.frame())?;
    height_m.map_or(Ok(()), check_height)?;
    let here = core.view.estimate.position_ned_m;
    let (x, y) = latitude_longitude_deg(command).map_or(Ok((here.x, here.y)), to_local)?;
    let z = height_m.map_or(here.z, |height_m| -height_m);
    let position = NedVector::new(x, y, z);
    // NaN fails the comparison.
    let is_near = position.horizontal_norm() <= MAX_DISTANCE_M;
    is_near.then_some(position).ok_or_else(too_far)
}

/// Goes to a place: parameter 1 speed (−1: default), 2 that the mode may change, 4 yaw in radians (NaN: unchanged), 5 to 7 the
/// place.
/// Without any place it stops where it is: so ground stations pause a flight.
fn reposition(command: &Command, _source: Source, core: &mut Core) -> Answer {
    if command.param(2) != Some(MAY_CHANGE_MODE) {
        return Err(Refusal::UNSUPPORTED.saying("denied: parameter 2 is not 1, change the mode"));
    }
    let is_placed = latitude_longitude_deg(command).is_some();
    if !is_placed && command.param(7).is_none() && command.param(4).is_none() {
        return Ok(core.stop_here()?);
    }
    let position = place(command, command.param(7).map(height_m), core)?;
    let yaw = match command.param(4) {
        Some(yaw_rad) if yaw_rad.is_finite() => YawCommand::Angle(yaw_rad),
        _ => YawCommand::Hold,
    };
    let speed_m_s = command.param(1).filter(|s| s.is_finite() && *s > 0.0);
    Ok(core.go_to(position, yaw, speed_m_s)?)
}

/// Climbs or descends where it is: parameter 1 the altitude, 2 the frame that it is in.
fn change_altitude(command: &Command, _source: Source, core: &mut Core) -> Answer {
    let (Some(altitude_m), Some(frame @ 0.0..=11.0)) = (command.param(1), command.param(2)) else {
        return Err(Refusal::DENIED);
    };
    let height = height_m(altitude_m);
    check_frame(frame as u8)?;
    check_height(height)?;
    let here = core.view.estimate.position_ned_m;
    let place = NedVector::new(here.x, here.y, -height);
    Ok(core.go_to(place, YawCommand::Hold, None)?)
}

const COMPONENT_ARM_DISARM: u16 = 400;
const DO_FLIGHTTERMINATION: u16 = 185;
const PREFLIGHT_REBOOT_SHUTDOWN: u16 = 246;
/// Parameter 2 of COMPONENT_ARM_DISARM that forces.
const FORCE: f32 = 21196.0;

fn arm_or_disarm(command: &Command, source: Source, core: &mut Core) -> Answer {
    let forced = command.param(2) == Some(FORCE);
    match command.param(1) {
        Some(1.0) => Ok(core.arm(source)?),
        Some(0.0) => Ok(core.disarm(forced)?),
        _ => Err(Refusal::DENIED),
    }
}

fn terminate(command: &Command, _source: Source, core: &mut Core) -> Answer {
    if command.param(1).is_none_or(|p| p <= 0.5) || !core.commander.armed {
        return Err(Refusal::DENIED);
    }
    core.terminate();
    Ok(())
}

/// 0 does nothing, 1 restarts the autopilot; anything else there is (shutdown, boot loader) does not exist in a simulation.
fn reboot(command: &Command, _source: Source, core: &mut Core) -> Answer {
    match command.param(1) {
        Some(0.0) => Ok(()),
        Some(1.0) => reboot_now(core),
        _ => Err(Refusal::DENIED.saying("denied: it reboots only, end the simulator instead")),
    }
}

/// Restarts the autopilot unless its motors may be needed.
pub(super) fn reboot_now(core: &mut Core) -> Answer {
    let c = &core.commander;
    if !c.armed || (c.terminated && c.is_on_ground()) {
        core.reboot();
        Ok(())
    } else {
        // DENIED as PX4's.
        Err(Refusal::DENIED.saying("reboot denied: armed"))
    }
}

/// MAV_ROI.
const ROI_NONE: f32 = 0.0;

fn look_at(command: &Command, _source: Source, core: &mut Core) -> Answer {
    let place_m = match (command.number, command.param(1)) {
        (DO_SET_ROI_LOCATION, _) | (NAV_ROI | DO_SET_ROI, Some(ROI_LOCATION)) => {
            latitude_longitude_deg(command).ok_or(Refusal::DENIED)?;
            let place = place(command, None, core)?;
            Some((place.x, place.y))
        }
        (DO_SET_ROI_NONE, _) | (NAV_ROI | DO_SET_ROI, Some(ROI_NONE)) => None,
        // Other vehicles and mission items are not looked at.
        _ => return Err(Refusal::DENIED),
    };
    core.commander.region_of_interest_m = place_m;
    Ok(())
}

const DO_ORBIT: u16 = 34;
/// Used where the command gives none (PX4's defaults are the same).
const DEFAULT_RADIUS_M: f32 = 5.0;
const DEFAULT_SPEED_M_S: f32 = 2.0;

/// Parameter 1 radius (negative: counter-clockwise), 2 speed, 3 where the nose points, 4 angle in radians (0: without
/// end), 5 to 7 the centre.
fn orbit(command: &Command, _source: Source, core: &mut Core) -> Answer {
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
        centre_ned_m: place(command, command.param(7).map(height_m), core)?,
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
fn orbit_status(core: &Core) -> Option<MavMessage> {
    let orbit = core.orbit()?;
    let (x, y, altitude_m) = geo::to_global(orbit.centre_ned_m);
    Some(MavMessage::ORBIT_EXECUTION_STATUS(ORBIT_EXECUTION_STATUS_DATA {
        time_usec: core.time_boot_us(),
        radius: orbit.radius_m * if orbit.is_clockwise { 1.0 } else { -1.0 },
        x,
        y,
        z: altitude_m as f32,
        frame: MavFrame::MAV_FRAME_GLOBAL_INT,
    }))
}
