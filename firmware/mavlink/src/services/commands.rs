//! The command protocol: operators' requests to guidance. <https://mavlink.io/en/services/command.html>

use super::{Service, Step};
use crate::core::{Allowance, Core};
use crate::framing::{Command, Packet};
use crate::operator::{LET_GO, PendingRequest, ReplyTo, decode, request_name, result, result_of, why};
use crate::report::InBrackets;
use crate::status_text::{StatusText, WARNING};
use core::fmt::Arguments;
use heapless::{Deque, Vec};
use vigil_types::{Datagrams, Nanos, OperatorRequest, Reasons, RequestOutcome};

/// Requests that guidance can owe an answer to.
const REQUESTS: usize = 32;
/// Texts about refused requests in a second; a flood of requests must not become one of texts.
const REFUSALS_PER_SECOND: usize = 4;
const REFUSALS_NS: Nanos = 1_000_000_000;

#[derive(Debug, Clone, Default)]
pub(crate) struct CommandService {
    /// Of operators, the oldest first.
    pub requests: Deque<PendingRequest, REQUESTS>,
    /// Texts about the requests that were refused since the last step.
    refused: Vec<StatusText, REFUSALS_PER_SECOND>,
    allowance: Allowance,
}

impl CommandService {
    /// Acknowledges a request; one that is refused with the reasons of the last step, and with a text.
    pub fn answer(&mut self, core: &mut Core, pending: &PendingRequest, outcome: RequestOutcome) {
        let (state, reasons) = core.said.unwrap_or_default();
        let name = pending.name();
        let why = match outcome {
            RequestOutcome::Accepted => {
                match pending.request {
                    OperatorRequest::Disengage => (core.letting_go, core.let_go) = (pending.lets_go, pending.lets_go),
                    OperatorRequest::Engage => (core.letting_go, core.let_go) = (false, false),
                    _ => {}
                }
                Reasons::NONE
            }
            RequestOutcome::TooFar { distance_m, limit_m } => {
                self.refuse(name, format_args!(": {distance_m} m from home, at most {limit_m} m"));
                Reasons::NONE
            }
            RequestOutcome::TemporarilyRejected | RequestOutcome::Denied => {
                let state = state.name();
                match pending.request {
                    OperatorRequest::Goal { .. } | OperatorRequest::FixedGoal { .. } => self.refuse(
                        name,
                        format_args!(": outside the fence, too far, or at or below the ground"),
                    ),
                    OperatorRequest::Land => {
                        self.refuse(name, format_args!(" in {state}: guidance does not have the vehicle"))
                    }
                    OperatorRequest::Engage if reasons.is_empty() => {
                        self.refuse(name, format_args!(" in {state}: not clear for long enough"));
                    }
                    OperatorRequest::Engage | OperatorRequest::Disengage => {
                        self.refuse(name, format_args!(" in {state}{}", InBrackets(reasons)));
                    }
                }
                reasons
            }
        };
        core.acknowledge(pending.reply, pending.command, result_of(outcome), why);
    }

    fn command(&mut self, core: &mut Core, command: &Command, reply: ReplyTo) {
        match decode(command, &core.vehicle) {
            Ok(request) => {
                let pending = PendingRequest {
                    request,
                    lets_go: command.param(2) == Some(LET_GO),
                    command: command.number,
                    reply,
                };
                if self.requests.push_back(pending).is_err() {
                    self.refuse(pending.name(), format_args!(": too many requests"));
                    core.acknowledge(reply, command.number, result::TEMPORARILY_REJECTED, Reasons::NONE);
                }
            }
            Err(mav_result) => {
                self.refuse(request_name(command.number), format_args!(": {}", why(mav_result)));
                core.acknowledge(reply, command.number, mav_result, Reasons::NONE);
            }
        }
    }

    /// To be said in the next step, as far as there is room.
    fn refuse(&mut self, name: Option<&str>, why: Arguments<'_>) {
        if let (false, Some(name)) = (self.refused.is_full(), name) {
            let text = StatusText::new(WARNING, format_args!("{name} refused{why}"));
            let _ = self.refused.push(text);
        }
    }
}

impl Service for CommandService {
    fn hear(&mut self, core: &mut Core, _: Nanos, packet: &Packet<'_>, from: ReplyTo) -> bool {
        let Some(command) = packet.command() else { return false };
        // Only what is addressed to this very component: a broadcast command is the vehicle's to answer.
        if command.target_system == core.sender.system_id && command.target_component == core.sender.component_id {
            self.command(core, &command, from);
        }
        true
    }

    fn speak(&mut self, core: &mut Core, step: &Step<'_>, out: &mut Datagrams) {
        let now_ns = step.report.now_ns;
        for text in &core::mem::take(&mut self.refused) {
            if self.allowance.takes(now_ns, REFUSALS_NS, REFUSALS_PER_SECOND as u32) {
                core.tell_text(out, text);
            }
        }
    }
}
