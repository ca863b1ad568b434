//! How long the vehicle keeps to its last setpoint when no more come: read while the vehicle is handed over, and set where
//! that is too long.
//!
//! An ArduPilot's Copter flies on for `GUID_TIMEOUT`, 3 s unless somebody changed it
//! (<https://ardupilot.org/copter/docs/parameters.html#guid-timeout>); a PX4 leaves OFFBOARD after `COM_OF_LOSS_T`, 1 s
//! (<https://docs.px4.io/main/en/advanced_config/parameter_reference#COM_OF_LOSS_T>). Either holds for whoever sends setpoints
//! after us too. So a vehicle that has a limit for the guidance computer alone, `VGL_OF_LOSS_T` as the simulated one, is
//! asked for that first, and the other is then left alone. Nothing waits for this: a vehicle that does not answer is flown
//! all the same, and people read it.

use crate::autopilot::Flavour;
use crate::companion::CompanionConfig;
use crate::core::Core;
use crate::framing::{Packet, Zeroed};
use crate::service::{Service, Step};
use crate::status_text::{INFO, NOTICE, WARNING};
use mavlink::MessageData;
use mavlink::dialects::common::{MavMessage, MavParamType, PARAM_ERROR_DATA, PARAM_SET_DATA, PARAM_VALUE_DATA};
use vigil_types::{Datagrams, Nanos, VehicleRequest};

/// Questions before a vehicle counts as not answering, and attempts to set the value.
const ATTEMPTS: u8 = 4;
/// Questions for a parameter that few vehicles have.
const OWN_ATTEMPTS: u8 = 2;
/// Pause between two of them.
const RETRY_NS: Nanos = 500_000_000;
/// A value counts as set when it is as near as this: what an autopilot may round.
const SAME_S: f32 = 1e-3;

/// What was found; said once for each hand-over.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Finding {
    /// Short enough, seconds.
    Good(f32),
    /// It was too long, and was set: before and after, seconds.
    Set(f32, f32),
    /// It is too long, and the vehicle did not let it be set: the value and the longest wanted, seconds.
    Stays(f32, f32),
    /// The vehicle did not tell.
    NotReported,
}

/// What to do in a step.
#[derive(Debug, Clone, Copy)]
enum Next {
    Nothing,
    /// Ask for the value.
    Read,
    /// Set it, seconds.
    Set(f32),
    Tell(Finding),
}

#[derive(Debug, Clone, Copy, PartialEq, Default)]
enum Stage {
    /// No hand-over, or its finding was said.
    #[default]
    Idle,
    Reading,
    /// It was this long.
    Setting(f32),
    /// To be said.
    Found(Finding),
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

    /// One step. `taking`: guidance asks for the vehicle. What then began goes on to its end, in flight too.
    fn step(&mut self, now_ns: Nanos, taking: bool, flavour: Flavour) -> Next {
        self.flavour = flavour;
        let Some(longest_s) = self.longest_s else {
            return Next::Nothing;
        };
        if taking && !core::mem::replace(&mut self.taking, taking) {
            self.stage = Stage::Reading;
            self.attempts = 0;
            self.own = true;
        }
        self.taking = taking;
        let gives_up = match self.stage {
            Stage::Idle => return Next::Nothing,
            Stage::Found(finding) => {
                self.stage = Stage::Idle;
                return Next::Tell(finding);
            }
            Stage::Reading => Finding::NotReported,
            Stage::Setting(value_s) => Finding::Stays(value_s, longest_s),
        };
        if self.attempts > 0 && now_ns.saturating_sub(self.sent_ns) < RETRY_NS {
            return Next::Nothing;
        }
        let own = self.flavour == Flavour::Px4 && self.own;
        if own && self.stage == Stage::Reading && self.attempts >= OWN_ATTEMPTS {
            self.takes_the_other();
        } else if self.attempts >= ATTEMPTS {
            self.stage = Stage::Idle;
            return Next::Tell(gives_up);
        }
        self.attempts += 1;
        self.sent_ns = now_ns;
        match self.stage {
            Stage::Setting(_) => Next::Set(longest_s),
            Stage::Idle | Stage::Reading | Stage::Found(_) => Next::Read,
        }
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
                let short = value_s <= longest_s + SAME_S;
                match self.stage {
                    Stage::Reading if short => self.stage = Stage::Found(Finding::Good(value_s)),
                    Stage::Reading => {
                        self.stage = Stage::Setting(value_s);
                        self.attempts = 0;
                    }
                    // Anything else than a short value is the answer of a vehicle that did not set it; it is asked again.
                    Stage::Setting(before_s) if short => self.stage = Stage::Found(Finding::Set(before_s, value_s)),
                    Stage::Setting(_) | Stage::Idle | Stage::Found(_) => {}
                }
            }
            PARAM_ERROR_DATA::ID if payload.is_parameter(4, self.name()) => match self.stage {
                Stage::Reading => {
                    if !self.takes_the_other() {
                        self.stage = Stage::Found(Finding::NotReported);
                    }
                }
                Stage::Setting(value_s) => self.stage = Stage::Found(Finding::Stays(value_s, longest_s)),
                Stage::Idle | Stage::Found(_) => {}
            },
            _ => {}
        }
    }

    fn speak(&mut self, core: &mut Core, step: &Step<'_>, out: &mut Datagrams) {
        let Some(system) = core.system_id else { return };
        let taking = matches!(step.request, VehicleRequest::FlyExternal { .. }) && !core.vehicle.is_other_autopilot();
        let next = self.step(step.report.now_ns, taking, core.vehicle.flavour());
        let name = self.name();
        match next {
            Next::Nothing => {}
            Next::Read => core.ask_for_parameter(out, system, name),
            Next::Set(param_value) => {
                let set = PARAM_SET_DATA {
                    param_value,
                    target_system: system,
                    target_component: 1,
                    param_id: name.into(),
                    param_type: MavParamType::MAV_PARAM_TYPE_REAL32,
                };
                core.say(out, &MavMessage::PARAM_SET(set));
            }
            Next::Tell(Finding::Good(s)) => core.tell(out, INFO, format_args!("{name} is {s} s")),
            Next::Tell(Finding::Set(before_s, s)) => {
                core.tell(out, NOTICE, format_args!("{name} was {before_s} s, set to {s} s"));
            }
            Next::Tell(Finding::Stays(s, wanted_s)) => {
                core.tell(out, WARNING, format_args!("{name} stays {s} s, wanted {wanted_s} s"));
            }
            Next::Tell(Finding::NotReported) => {
                core.tell(out, WARNING, format_args!("{name} is not reported by the vehicle"));
            }
        }
    }
}
