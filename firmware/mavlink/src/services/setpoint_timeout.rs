//! How long the vehicle keeps to its last setpoint when no more come: read while the vehicle is handed over, and set where
//! that is too long.
//!
//! An ArduPilot's Copter flies on for `GUID_TIMEOUT`, 3 s unless somebody changed it
//! (<https://ardupilot.org/copter/docs/parameters.html#guid-timeout>); a PX4 leaves OFFBOARD after `COM_OF_LOSS_T`, 1 s
//! (<https://docs.px4.io/main/en/advanced_config/parameter_reference#COM_OF_LOSS_T>). Either holds for whoever sends setpoints
//! after us too. So a vehicle that has a limit for the guidance computer alone, `VGL_OF_LOSS_T` as the simulated one, is
//! asked for that first, and the other is then left alone. Nothing waits for this: a vehicle that does not answer is flown
//! all the same, and people read it.

use super::{Service, Step};
use crate::autopilot::Flavour;
use crate::companion::CompanionConfig;
use crate::core::Core;
use crate::framing::{Packet, Zeroed};
use crate::status_text::{INFO, NOTICE, StatusText, WARNING};
use core::fmt::Arguments;
use mavlink::MessageData;
use mavlink::dialects::common::{
    MavMessage, MavParamType, MavSeverity, PARAM_ERROR_DATA, PARAM_SET_DATA, PARAM_VALUE_DATA,
};
use vigil_types::{Datagrams, Nanos, VehicleRequest};

/// Questions before a vehicle counts as not answering, and attempts to set the value.
const ATTEMPTS: u8 = 4;
/// Questions for a parameter that few vehicles have.
const OWN_ATTEMPTS: u8 = 2;
/// Pause between two of them.
const RETRY_NS: Nanos = 500_000_000;
/// A value counts as set when it is as near as this: what an autopilot may round.
const SAME_S: f32 = 1e-3;

/// What is asked of the vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
enum Stage {
    #[default]
    Nothing,
    Reading,
    /// It was this long.
    Setting(f32),
}

/// Follows the one parameter.
#[derive(Debug, Clone, Default)]
pub(crate) struct SetpointTimeoutService {
    flavour: Flavour,
    /// The vehicle may have the parameter of the guidance computer alone.
    own: bool,
    /// The longest wanted, seconds; `None` leaves the parameter alone.
    longest_s: Option<f32>,
    stage: Stage,
    attempts: u8,
    sent_ns: Nanos,
    /// The vehicle was being taken in the step before.
    taking: bool,
    /// What was found, to be said; once for each hand-over.
    found: Option<StatusText>,
}

impl SetpointTimeoutService {
    /// The parameter's name.
    fn name(&self) -> &'static str {
        match self.flavour {
            Flavour::Px4 if self.own => "VGL_OF_LOSS_T",
            Flavour::Px4 => "COM_OF_LOSS_T",
            Flavour::ArduPilot => "GUID_TIMEOUT",
        }
    }

    /// Whether there is another parameter to ask for; then that one is meant from now on.
    fn takes_the_other(&mut self) -> bool {
        let has_other = self.flavour == Flavour::Px4 && self.own;
        if has_other {
            self.own = false;
            self.attempts = 0;
        }
        has_other
    }

    fn end(&mut self, severity: MavSeverity, found: Arguments<'_>) {
        (self.stage, self.found) = (Stage::Nothing, Some(StatusText::new(severity, found)));
    }

    /// The vehicle does not answer, or does not let it be set.
    fn give_up(&mut self, longest_s: f32) {
        let name = self.name();
        match self.stage {
            Stage::Setting(s) => self.end(WARNING, format_args!("{name} stays {s} s, wanted {longest_s} s")),
            _ => self.end(WARNING, format_args!("{name} is not reported by the vehicle")),
        }
    }

    /// What to ask in this step. `taking`: guidance asks for the vehicle. What then began goes on to its end, in flight too.
    fn step(&mut self, now_ns: Nanos, taking: bool, flavour: Flavour) -> Stage {
        self.flavour = flavour;
        let Some(longest_s) = self.longest_s else {
            return Stage::Nothing;
        };
        if taking && !core::mem::replace(&mut self.taking, taking) {
            (self.stage, self.found) = (Stage::Reading, None);
            (self.attempts, self.own) = (0, true);
        }
        self.taking = taking;
        let waits = self.attempts > 0 && now_ns.saturating_sub(self.sent_ns) < RETRY_NS;
        if self.stage == Stage::Nothing || waits {
            return Stage::Nothing;
        }
        let own = self.flavour == Flavour::Px4 && self.own;
        if own && self.stage == Stage::Reading && self.attempts >= OWN_ATTEMPTS {
            self.takes_the_other();
        } else if self.attempts >= ATTEMPTS {
            self.give_up(longest_s);
            return Stage::Nothing;
        }
        self.attempts += 1;
        self.sent_ns = now_ns;
        self.stage
    }
}

impl Service for SetpointTimeoutService {
    fn new(config: &CompanionConfig) -> Self {
        Self {
            own: true,
            longest_s: config.setpoint_timeout_s,
            ..Self::default()
        }
    }

    fn hear_vehicle(&mut self, _: &mut Core, _: Nanos, packet: &Packet<'_>) {
        let payload = Zeroed(packet.payload());
        let Some(longest_s) = self.longest_s else { return };
        match packet.message_id() {
            PARAM_VALUE_DATA::ID if payload.is_parameter(8, self.name()) => {
                let value_s = f32::from_le_bytes(payload.bytes(0));
                // Either autopilot's is a REAL32; what is not a time is no answer.
                if !(value_s.is_finite() && value_s >= 0.0) {
                    return;
                }
                let (short, name) = (value_s <= longest_s + SAME_S, self.name());
                match self.stage {
                    Stage::Reading if short => self.end(INFO, format_args!("{name} is {value_s} s")),
                    Stage::Reading => (self.stage, self.attempts) = (Stage::Setting(value_s), 0),
                    // Anything else than a short value is the answer of a vehicle that did not set it; it is asked again.
                    Stage::Setting(before_s) if short => {
                        self.end(NOTICE, format_args!("{name} was {before_s} s, set to {value_s} s"));
                    }
                    Stage::Setting(_) | Stage::Nothing => {}
                }
            }
            PARAM_ERROR_DATA::ID if payload.is_parameter(4, self.name()) => {
                let sets = matches!(self.stage, Stage::Setting(_));
                if sets || self.stage == Stage::Reading && !self.takes_the_other() {
                    self.give_up(longest_s);
                }
            }
            _ => {}
        }
    }

    fn speak(&mut self, core: &mut Core, step: &Step<'_>, out: &mut Datagrams) {
        let Some(system) = core.system_id else { return };
        let taking = matches!(step.request, VehicleRequest::FlyExternal { .. }) && !core.vehicle.is_other_autopilot();
        match self.step(step.report.now_ns, taking, core.vehicle.flavour()) {
            Stage::Nothing => {}
            Stage::Reading => core.ask_for_parameter(out, system, self.name()),
            Stage::Setting(_) => {
                let set = PARAM_SET_DATA {
                    param_value: self.longest_s.unwrap_or_default(),
                    target_system: system,
                    target_component: 1,
                    param_id: self.name().into(),
                    param_type: MavParamType::MAV_PARAM_TYPE_REAL32,
                };
                core.say(out, &MavMessage::PARAM_SET(set));
            }
        }
        if let Some(found) = self.found.take() {
            core.tell_text(out, &found);
        }
    }
}
