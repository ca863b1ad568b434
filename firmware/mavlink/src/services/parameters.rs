//! The parameter protocol: the guidance computer's own parameters. <https://mavlink.io/en/services/parameter.html>

use crate::core::Core;
use crate::framing::Packet;
use crate::operator::ReplyTo;
use crate::parameter_table::{ParameterRequest, Parameters, SetRefusal};
use crate::service::{Service, Step};
use crate::status_text::WARNING;
use mavlink::dialects::common::{MavMessage, MavParamError, PARAM_ERROR_DATA};
use vigil_types::{Datagrams, Nanos};

#[derive(Debug, Clone, Default)]
pub(crate) struct ParameterService {
    pub table: Parameters,
    /// The last parameter that was not set, to be told of.
    refused: Option<(usize, SetRefusal)>,
}

impl ParameterService {
    /// Answers with a parameter's value in force.
    fn tell_value(&self, core: &mut Core, link: u8, index: usize) {
        if let Some(message) = self.table.value(index, core.vehicle.flavour()) {
            core.reply(link, &message);
        }
    }

    /// Answers on the link it came on. What there is not is told to who asked this very component: of a request to all
    /// another one may have it.
    fn request(&mut self, core: &mut Core, from: ReplyTo, is_for_me: bool, request: &ParameterRequest) {
        let link = from.link;
        match request {
            ParameterRequest::List => {
                for index in 0..self.table.count() {
                    self.tell_value(core, link, index);
                }
            }
            ParameterRequest::ReadIndex(index) => {
                if *index < self.table.count() {
                    self.tell_value(core, link, *index);
                } else if is_for_me {
                    // It came as 16 bits.
                    no_such_parameter(core, from, [0; 16], *index as i16);
                }
            }
            ParameterRequest::ReadName(name) => {
                if let Some(index) = self.table.find(name) {
                    self.tell_value(core, link, index);
                } else if is_for_me {
                    no_such_parameter(core, from, *name, -1);
                }
            }
            ParameterRequest::Set { name, raw, mav_type } => {
                let Some(index) = self.table.find(name) else {
                    if is_for_me {
                        core.counters.parameters_refused += 1;
                        no_such_parameter(core, from, *name, -1);
                    }
                    return;
                };
                let (flying, flavour) = (core.is_flying(), core.vehicle.flavour());
                if let Err(refusal) = self.table.set(index, *raw, *mav_type, flavour, flying) {
                    core.counters.parameters_refused += 1;
                    self.refused = Some((index, refusal));
                }
                // The value in force, whichever it is: that is the protocol's answer.
                self.tell_value(core, link, index);
            }
        }
    }
}

impl Service for ParameterService {
    fn hear(&mut self, core: &mut Core, _: Nanos, packet: &Packet<'_>, from: ReplyTo) -> bool {
        let Some((request, (system, component))) =
            ParameterRequest::from_payload(packet.message_id(), packet.payload())
        else {
            return false;
        };
        // Of requests to all components it answers what it has.
        if system == core.sender.system_id && core.is_for_me_or_all(system, component) {
            let is_for_me = component == core.sender.component_id;
            self.request(core, from, is_for_me, &request);
        }
        true
    }

    fn speak(&mut self, core: &mut Core, _: &Step<'_>, out: &mut Datagrams) {
        if let Some((index, refusal)) = self.refused.take() {
            let text = format_args!("{} not set: {}", self.table.name(index), refusal.name());
            core.tell(out, WARNING, text);
        }
    }
}

/// PARAM_ERROR to who asked for what there is not.
fn no_such_parameter(core: &mut Core, to: ReplyTo, name: [u8; 16], param_index: i16) {
    let error = PARAM_ERROR_DATA {
        param_index,
        target_system: to.system,
        target_component: to.component,
        param_id: name.into(),
        error: MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST,
    };
    core.reply(to.link, &MavMessage::PARAM_ERROR(error));
}
