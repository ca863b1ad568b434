//! What is flown as it comes: offboard setpoints, a target that is followed, and sticks: MANUAL_CONTROL of a joystick,
//! RC_CHANNELS_OVERRIDE of a script that plays the transmitter. <https://docs.px4.io/main/en/flight_modes/offboard.html>,
//! <https://mavlink.io/en/messages/common.html#FOLLOW_TARGET>, <https://mavlink.io/en/messages/common.html#MANUAL_CONTROL>

use crate::flight::{SetpointDefect, attitude_setpoint, global_setpoint, position_setpoint};
use crate::geo::{self, BELOW_HOME_M, MAX_DISTANCE_M};
use crate::service::prelude::*;
use crate::vehicle::ControlCommand;
use crate::vehicle_parameters::ParamId;
use vigil_mavlink::Allowance;
use vigil_types::NedVector;

/// Claimants and new reasons of refusals are reported this often at most: there may be any number of made-up ones.
const SAID_NS: Nanos = 1_000_000_000;
/// The same reason is said to the same sender again after this time.
const REPEATED_NS: Nanos = 5_000_000_000;
/// Where both messages of positions have their frame.
const FRAME_AT: usize = 52;

#[derive(Default)]
pub(crate) struct SetpointService {
    said: Allowance,
    /// The refusal that was said last, and when.
    refusal: Option<(Nanos, Source, SetpointDefect)>,
    told_of_ground: Allowance,
}

impl SetpointService {
    /// Counts a setpoint that is not flown, and says why: from a stream that is refused nobody hears "no setpoints".
    fn refuse(&mut self, defect: SetpointDefect, source: Source, core: &mut Core) {
        match defect {
            SetpointDefect::Value(_) => core.refusals.setpoint_value += 1,
            _ => core.refusals.setpoint_form += 1,
        }
        core.setpoints.refused = Some((core.now_ns, defect));
        let is_due = self.refusal.is_none_or(|(at_ns, to, of)| {
            let since_ns = core.now_ns.saturating_sub(at_ns);
            since_ns >= REPEATED_NS || ((to, of) != (source, defect) && since_ns >= SAID_NS)
        });
        if is_due {
            self.refusal = Some((core.now_ns, source, defect));
            core.warn(&format!("setpoints of {}: {defect}", source.id));
        }
    }
}

impl Service for SetpointService {
    fn receive(&mut self, packet: &Packet<'_>, source: Source, core: &mut Core) {
        let speed_limit_m_s = core.param(ParamId::MaxSpeedMS);
        let heading_rad = core.view.estimate.attitude.yaw_rad();
        // What is not parsed is a frame that the protocol does not have.
        let no_frame = SetpointDefect::Frame(packet.payload().get(FRAME_AT).copied().unwrap_or(0));
        let command = match packet.message_id() {
            SET_POSITION_TARGET_LOCAL_NED_DATA::ID => {
                let read = core.read(packet);
                read.map(|m| position_setpoint(&m, speed_limit_m_s, heading_rad))
            }
            SET_POSITION_TARGET_GLOBAL_INT_DATA::ID => {
                let read = core.read(packet);
                read.map(|m| global_setpoint(&m, speed_limit_m_s))
            }
            SET_ATTITUDE_TARGET_DATA::ID => core.read(packet).map(|m| attitude_setpoint(&m)),
            SET_ACTUATOR_CONTROL_TARGET_DATA::ID => Some(Err(SetpointDefect::Actuators)),
            _ => return,
        };
        let command = match command.unwrap_or(Err(no_frame)) {
            Ok(command) => command,
            Err(defect) => {
                self.refuse(defect, source, core);
                if !matches!(defect, SetpointDefect::Incomplete(_)) {
                    return;
                }
                ControlCommand::STOP
            }
        };
        // A place below home is flown as PX4 flies it, to the ground; it was hardly meant so.
        if let ControlCommand::Position(goal) = &command
            && goal.position_ned_m.z > BELOW_HOME_M
            && self.told_of_ground.takes(core.now_ns, REPEATED_NS, 1)
        {
            let down_m = goal.position_ned_m.z;
            core.warn(&format!("setpoints of {}: {down_m:.0} m below home", source.id));
        }
        let Some(is_warned) = core.setpoints.take(core.now_ns, source, command) else {
            return core.regain_offboard(source);
        };
        core.refusals.setpoint_foreign += 1;
        if !is_warned
            && let Some(owner) = core.setpoints.owner
            && self.said.takes(core.now_ns, SAID_NS, 1)
        {
            let text = match owner.id == source.id {
                true => format!("setpoints of a second {source} ignored"),
                false => format!("setpoints of {} ignored: owner {}", source.id, owner.id),
            };
            core.warn(&text);
        }
    }
}

/// Pulse of a channel at rest, and its travel to either side.
const CENTRE_US: f32 = 1500.0;
const TRAVEL_US: f32 = 500.0;
/// What a receiver can send.
const PULSES_US: core::ops::RangeInclusive<u16> = 800..=2200;

/// z is the throttle: 0 down, 500 neutral, 1000 up. The largest number is an axis that there is not: centred, unless all are.
pub(super) fn joystick(m: MANUAL_CONTROL_DATA, source: Source, core: &mut Core) {
    let or = |axis: i16, centre: i16| if axis == i16::MAX { centre } else { axis };
    let (axes, throttle) = ([m.x, m.y, m.r].map(|axis| or(axis, 0)), or(m.z, 500));
    let is_sound = axes.iter().all(|a| (-1000..=1000).contains(a)) && (0..=1000).contains(&throttle);
    if !is_sound || [m.x, m.y, m.z, m.r] == [i16::MAX; 4] {
        core.refusals.setpoint_value += 1;
        return;
    }
    let [forward, right, clockwise] = axes.map(|a| f32::from(a) * 1e-3);
    let up = (f32::from(throttle) - 500.0) / 500.0;
    core.take_sticks(source, [forward, right, up, clockwise]);
}

/// Channels 1 to 4 as transmitters have them: roll, pitch (a higher pulse is the stick pulled back), throttle, yaw. 0 and the
/// largest number leave a channel alone, which is then centred; all four so are nobody's sticks: also where they are given
/// back to a receiver that there is not, the sticks are let go of.
pub(super) fn channels(m: RC_CHANNELS_OVERRIDE_DATA, source: Source, core: &mut Core) {
    let raw = [m.chan1_raw, m.chan2_raw, m.chan3_raw, m.chan4_raw];
    let is_left_alone = |pulse: &u16| matches!(*pulse, 0 | u16::MAX);
    if raw.iter().all(is_left_alone) {
        core.sticks.release(source);
        return;
    }
    if !raw
        .iter()
        .all(|pulse| is_left_alone(pulse) || PULSES_US.contains(pulse))
    {
        core.refusals.setpoint_value += 1;
        return;
    }
    let [right, back, up, clockwise] = raw.map(|pulse| match is_left_alone(&pulse) {
        true => 0.0,
        false => ((f32::from(pulse) - CENTRE_US) / TRAVEL_US).clamp(-1.0, 1.0),
    });
    core.take_sticks(source, [-back, right, up, clockwise]);
}

/// Bit of `est_capabilities`: the velocity is given.
const HAS_VELOCITY: u8 = 1 << 1;
/// Faster targets are mistakes.
const ABSURD_VELOCITY_M_S: f32 = 100.0;

#[derive(Default)]
pub(crate) struct Follow {
    said: Allowance,
}

impl Service for Follow {
    fn receive(&mut self, packet: &Packet<'_>, source: Source, core: &mut Core) {
        let Some(m) = core.read::<FOLLOW_TARGET_DATA>(packet) else {
            return;
        };
        let (lat, lon) = (f64::from(m.lat) * 1e-7, f64::from(m.lon) * 1e-7);
        let (x, y) = geo::ORIGIN.north_east_m(lat, lon);
        let down_m = (geo::ORIGIN.altitude_m - f64::from(m.alt)) as f32;
        let position = NedVector::new(x, y, down_m);
        let [vx, vy, vz] = m.vel;
        let velocity = (m.est_capabilities & HAS_VELOCITY != 0).then(|| NedVector::new(vx, vy, vz));
        let is_place = lat.abs() <= 90.0 && lon.abs() <= 180.0 && m.alt.is_finite();
        let is_near = position.horizontal_norm() <= MAX_DISTANCE_M && down_m.abs() <= MAX_DISTANCE_M;
        let is_slow = velocity.is_none_or(|v| v.norm() <= ABSURD_VELOCITY_M_S);
        let defect = match (is_place, is_near, is_slow) {
            (true, true, true) => return core.see_target(position, velocity),
            (false, ..) => "lat, lon or alt is no place",
            (_, false, _) => "too far from home",
            _ => "vel is NaN or absurd",
        };
        // A vehicle that waits for its target would otherwise not tell why.
        core.refusals.setpoint_value += 1;
        if self.said.takes(core.now_ns, REPEATED_NS, 1) {
            core.warn(&format!("target of {}: {defect}", source.id));
        }
    }
}
