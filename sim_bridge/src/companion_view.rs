//! What the guidance computer says of itself, read from its own telemetry as any ground station would.

use mavlink::dialects::common::MavMessage;
use vigil_mavlink::GUIDANCE_COMPONENT;
use vigil_mavlink::framing::{self, FramingCounters};

/// What "gd_reason" holds of the reasons; the others are in "gd_reason2".
const LOW_BITS: u64 = (1 << 24) - 1;

/// The last values heard from the guidance computer.
#[derive(Debug, Clone, Default)]
pub struct CompanionView {
    /// Guidance state's number, see [`vigil_types::GuidanceState`].
    pub state_code: Option<u8>,
    /// Bits of [`vigil_types::Reasons`].
    pub reason_bits: u64,
    /// Execution time of the last reported step, microseconds.
    pub step_us: f32,
    /// Missed steps since its start.
    pub slips: u64,
    /// The detector's last score; `None` while it sent none.
    pub score: Option<f32>,
}

impl CompanionView {
    /// Looks at a datagram that came from the guidance computer.
    pub fn observe(&mut self, datagram: &[u8]) {
        // A PX4 sends back what it hears of it, as its own and with names cut short.
        let mut counters = FramingCounters::default();
        for packet in framing::packets(datagram, &mut counters).filter(|p| p.component_id() == GUIDANCE_COMPONENT) {
            if let Ok(MavMessage::NAMED_VALUE_FLOAT(m)) = packet.message() {
                match m.name.to_str().unwrap_or_default() {
                    "gd_state" => self.state_code = Some(m.value as u8),
                    "gd_reason" => self.reason_bits = (self.reason_bits & !LOW_BITS) | (m.value as u64 & LOW_BITS),
                    "gd_reason2" => self.reason_bits = (self.reason_bits & LOW_BITS) | ((m.value as u64) << 24),
                    "step_us" => self.step_us = m.value,
                    "dt_score" => self.score = Some(m.value),
                    "slips" => self.slips = m.value as u64,
                    _ => {}
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_vehicle_sends_back_of_it_is_not_its_own() {
        let mut view = CompanionView::default();
        for (component, value) in [(191, 4.0), (1, 8.0)] {
            let name = "gd_reason".into();
            let own = vigil_mavlink::message!(NAMED_VALUE_FLOAT, name, value);
            view.observe(&framing::encode((1, component), 0, &own));
        }
        assert_eq!(view.reason_bits, 4);
    }
}
