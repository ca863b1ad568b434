//! Sticks: MANUAL_CONTROL of a joystick, RC_CHANNELS_OVERRIDE of a script that plays the transmitter.
//! <https://mavlink.io/en/messages/common.html#MANUAL_CONTROL>

use crate::flight::Deflections;
use crate::service::prelude::*;

pub(crate) struct Manual;

/// Pulse of a channel at rest, and its travel to either side.
const CENTRE_US: f32 = 1500.0;
const TRAVEL_US: f32 = 500.0;
/// What a receiver can send.
const PULSES_US: core::ops::RangeInclusive<u16> = 800..=2200;

impl Service for Manual {
    fn receive(&mut self, packet: &Packet<'_>, source: Source, core: &mut Core) {
        let sticks = if let Some(m) = core.read(packet) {
            joystick(&m).ok_or(())
        } else if let Some(m) = core.read(packet)
            && let Some(sticks) = channels(&m).transpose()
        {
            sticks
        } else {
            // Also where all four are given back to a receiver that there is not: the sticks are let go of.
            return;
        };
        match sticks {
            Err(()) => core.refusals.setpoint_value += 1,
            Ok(sticks) if !core.take_sticks(source, sticks) => core.refusals.setpoint_foreign += 1,
            Ok(_) => {}
        }
    }
}

/// z is the throttle: 0 down, 500 neutral, 1000 up.
fn joystick(m: &MANUAL_CONTROL_DATA) -> Option<Deflections> {
    let axes = [m.x, m.y, m.r];
    let is_sound = axes.iter().all(|a| (-1000..=1000).contains(a)) && (0..=1000).contains(&m.z);
    if !is_sound {
        return None;
    }
    let [forward, right, clockwise] = axes.map(|a| f32::from(a) * 1e-3);
    Some(Deflections {
        forward,
        right,
        up: (f32::from(m.z) - 500.0) / 500.0,
        clockwise,
    })
}

/// Channels 1 to 4 as transmitters have them: roll, pitch (a higher pulse is the stick pulled back), throttle, yaw. 0 and the
/// largest number leave a channel alone, which is then centred; all four so are nobody's sticks.
fn channels(m: &RC_CHANNELS_OVERRIDE_DATA) -> Result<Option<Deflections>, ()> {
    let raw = [m.chan1_raw, m.chan2_raw, m.chan3_raw, m.chan4_raw];
    let is_left_alone = |pulse: &u16| matches!(*pulse, 0 | u16::MAX);
    if raw.iter().all(is_left_alone) {
        return Ok(None);
    }
    if !raw
        .iter()
        .all(|pulse| is_left_alone(pulse) || PULSES_US.contains(pulse))
    {
        return Err(());
    }
    let [right, back, up, clockwise] = raw.map(|pulse| {
        if is_left_alone(&pulse) {
            0.0
        } else {
            ((f32::from(pulse) - CENTRE_US) / TRAVEL_US).clamp(-1.0, 1.0)
        }
    });
    Ok(Some(Deflections {
        forward: -back,
        right,
        up,
        clockwise,
    }))
}
