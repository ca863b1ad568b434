//! The parameter protocol: the guidance computer's own parameters. <https://mavlink.io/en/services/parameter.html>

use super::{Service, Step};
use crate::core::{Core, Periodic};
use crate::framing::Packet;
use crate::operator::ReplyTo;
use crate::parameter_table::{ParameterRequest, Parameters};
use crate::status_text::WARNING;
use mavlink::dialects::common::{MavMessage, MavParamError, PARAM_ERROR_DATA};
use vigil_types::{Datagrams, Nanos};

/// Pause between two texts about parameters that were not set.
const REFUSALS_NS: Nanos = 250_000_000;

#[derive(Debug, Clone, Default)]
pub(crate) struct ParameterService {
    pub table: Parameters,
    /// The last parameter that was not set, and why.
    refused: Option<(usize, &'static str)>,
    refusals: Periodic,
}

impl ParameterService {
    /// Answers with a parameter's value in force.
    fn tell_value(&self, core: &mut Core, link: u8, index: usize) {
        if let Some(message) = self.table.value(index, core.vehicle.flavour()) {
            core.reply(link, &message);
        }
    }

    /// Answers on the link it came on. What there is not is reported to who asked this very component: of a request to all
    /// another one may have it.
    fn request(&mut self, core: &mut Core, from: ReplyTo, is_for_me: bool, request: &ParameterRequest) {
        let ParameterRequest::One { name, index, set } = request else {
            for place in 0..self.table.all().len() {
                self.tell_value(core, from.link, place);
            }
            return;
        };
        let Some(place) = self.table.find(name, *index) else {
            if is_for_me {
                core.counters.parameters_refused += u64::from(set.is_some());
                let error = PARAM_ERROR_DATA {
                    param_index: *index,
                    target_system: from.system,
                    target_component: from.component,
                    param_id: (*name).into(),
                    error: MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST,
                };
                core.reply(from.link, &MavMessage::PARAM_ERROR(error));
            }
            return;
        };
        if let Some((raw, mav_type)) = set {
            let (flying, flavour) = (core.is_flying(), core.vehicle.flavour());
            if let Err(why) = self.table.set(place, *raw, *mav_type, flavour, flying) {
                core.counters.parameters_refused += 1;
                self.refused = Some((place, why));
            }
        }
        // The value in force, whichever it is: that is the protocol's answer.
        self.tell_value(core, from.link, place);
    }
}

impl Service for ParameterService {
    fn hear(&mut self, core: &mut Core, _: Nanos, packet: &Packet<'_>, from: ReplyTo) -> bool {
        let Some(request) = ParameterRequest::from_payload(packet.message_id(), packet.payload()) else {
            return false;
        };
        // Of requests to all components it answers what it has.
        if let Some((system, component)) = packet.target()
            && system == core.sender.system_id
            && core.is_for_me_or_all(system, component)
        {
            let is_for_me = component == core.sender.component_id;
            self.request(core, from, is_for_me, &request);
        }
        true
    }

    fn speak(&mut self, core: &mut Core, step: &Step<'_>, out: &mut Datagrams) {
        // A flood of requests must not become one of texts.
        if self.refused.is_some() && !self.refusals.is_due(step.report.now_ns, REFUSALS_NS) {
            return;
        }
        if let Some((place, why)) = self.refused.take() {
            let name = self.table.all().get(place).map_or("", |parameter| parameter.name);
            core.tell(out, WARNING, format_args!("{name} not set: {why}"));
        }
    }
}
