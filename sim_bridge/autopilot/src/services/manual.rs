//! Sticks: MANUAL_CONTROL of a joystick, RC_CHANNELS_OVERRIDE of a script that plays the transmitter.
//! <https://mavlink.io/en/messages/common.html#MANUAL_CONTROL>

use crate::flight::Deflections;
use crate::service::prelude::*;

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
    let sticks = Deflections {
        forward,
        right,
        up,
        clockwise,
    };
    core.take_sticks(source, sticks);
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
    let sticks = Deflections {
        forward: -back,
        right,
        up,
        clockwise,
    };
    core.take_sticks(source, sticks);
}
