//! What the autopilot changes its speed with in a mission and in its hold, by its own parameters: whoever guards its flights reckons with it.
//!
//! PX4: `MPC_ACC_HOR`, `MPC_JERK_AUTO` (<https://docs.px4.io/main/en/advanced_config/parameter_reference#MPC_ACC_HOR>); Copter:
//! `WPNAV_ACCEL`, in centimetres, `PSC_JERK_XY` (<https://ardupilot.org/copter/docs/parameters.html#wpnav-accel>). A change is heard too:
//! either autopilot sends everybody a parameter that is set. One that does not answer is guarded by what is configured, and that is said.

use super::{Service, Step};
use crate::autopilot::Flavour;
use crate::companion::CompanionConfig;
use crate::core::Core;
use crate::framing::{Packet, Zeroed};
use crate::status_text::NOTICE;
use mavlink::MessageData;
use mavlink::dialects::common::PARAM_VALUE_DATA;
use vigil_types::{Datagrams, Nanos};

/// Questions for each before the vehicle counts as not answering, and the pause after each.
const ATTEMPTS: u8 = 4;
const RETRY_NS: Nanos = 500_000_000;

/// The parameters, and the unit of each in metres per second squared and cubed.
const fn named(flavour: Flavour) -> [(&'static str, f32); 2] {
    match flavour {
        Flavour::Px4 => [("MPC_ACC_HOR", 1.0), ("MPC_JERK_AUTO", 1.0)],
        Flavour::ArduPilot => [("WPNAV_ACCEL", 0.01), ("PSC_JERK_XY", 1.0)],
    }
}

/// Asks for them.
#[derive(Debug, Clone, Default)]
pub(crate) struct MissionMotionService {
    wanted: bool,
    /// Of the vehicle that was asked so often.
    restarts: u32,
    attempts: [u8; 2],
    sent_ns: Nanos,
}

impl Service for MissionMotionService {
    fn new(config: &CompanionConfig) -> Self {
        Self {
            wanted: config.guards,
            ..Self::default()
        }
    }

    fn hear_vehicle(&mut self, core: &mut Core, _: Nanos, packet: &Packet<'_>) {
        if packet.message_id() != PARAM_VALUE_DATA::ID || !self.wanted {
            return;
        }
        let payload = Zeroed(packet.payload());
        let value = f32::from_le_bytes(payload.bytes(0));
        let flavour = core.vehicle.flavour();
        let motion = &mut core.vehicle.mission_motion;
        let known = [&mut motion.gain_m_s2, &mut motion.jerk_m_s3];
        for ((name, unit), known) in named(flavour).into_iter().zip(known) {
            if payload.is_parameter(8, name) && value.is_finite() && value > 0.0 {
                *known = Some(value * unit);
            }
        }
        if flavour == Flavour::Px4 {
            motion.braking_m_s2 = motion.gain_m_s2;
        }
    }

    fn speak(&mut self, core: &mut Core, step: &Step<'_>, out: &mut Datagrams) {
        let now_ns = step.report.now_ns;
        // Before it is heard there is nobody to answer.
        let Some(system) = core.system_id.filter(|_| self.wanted && core.vehicle_heard) else {
            return;
        };
        if self.restarts != core.vehicle.restarts {
            (self.restarts, self.attempts) = (core.vehicle.restarts, [0; 2]);
        }
        if self.sent_ns > 0 && now_ns.saturating_sub(self.sent_ns) < RETRY_NS {
            return;
        }
        let motion = core.vehicle.mission_motion;
        let known = [motion.gain_m_s2, motion.jerk_m_s3];
        let each = named(core.vehicle.flavour()).into_iter().zip(known);
        let mut unknown = each.zip(&mut self.attempts).filter(|((_, known), _)| known.is_none());
        let Some((((name, _), _), attempts)) = unknown.find(|(_, attempts)| **attempts <= ATTEMPTS) else {
            return;
        };
        (self.sent_ns, *attempts) = (now_ns, *attempts + 1);
        if *attempts > ATTEMPTS {
            let text = format_args!("{name} is not known: guarded by what is configured");
            core.tell(out, NOTICE, text);
        } else {
            core.ask_for_parameter(out, system, name);
        }
    }
}
