//! MANUAL_CONTROL: a joystick's sticks. <https://mavlink.io/en/messages/common.html#MANUAL_CONTROL>

use crate::core::Core;
use crate::flight::Deflections;
use crate::service::{Service, Source};
use vigil_mavlink::MavMessage;
use vigil_mavlink::common::MANUAL_CONTROL_DATA;
use vigil_mavlink::framing::Packet;
use vigil_mavlink::mavlink::MessageData;

pub(crate) struct Manual;

impl Service for Manual {
    fn receive(&mut self, packet: &Packet<'_>, source: Source, core: &mut Core) {
        if packet.message_id() != MANUAL_CONTROL_DATA::ID {
            return;
        }
        let Ok(MavMessage::MANUAL_CONTROL(m)) = packet.message() else {
            core.refusals.not_parsed += 1;
            return;
        };
        // The message names its target alone, without a component. z is the throttle: 0 down, 500 neutral, 1000 up.
        let axes = [m.x, m.y, m.r];
        let is_sound = axes.iter().all(|a| (-1000..=1000).contains(a)) && (0..=1000).contains(&m.z);
        if m.target != core.id.system || !is_sound {
            core.refusals.setpoint_value += 1;
            return;
        }
        let [forward, right, clockwise] = axes.map(|a| f32::from(a) * 1e-3);
        let up = (f32::from(m.z) - 500.0) / 500.0;
        let sticks = Deflections {
            forward,
            right,
            up,
            clockwise,
        };
        if !core.sticks.take(core.now_ns, source.id, sticks) {
            core.refusals.setpoint_foreign += 1;
        }
    }
}
