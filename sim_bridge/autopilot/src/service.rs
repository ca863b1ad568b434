//! What a protocol service is.

use crate::LinkId;
pub(crate) use crate::config::Source;
use crate::core::Core;
use crate::flight::Denial;
use vigil_mavlink::MavMessage;
use vigil_mavlink::common::MavResult;
use vigil_mavlink::framing::{Command, CommandAck, Packet};
use vigil_types::Nanos;

/// Why a command is not carried out, and what people read of it.
#[derive(Debug)]
pub(crate) struct Refusal(MavResult, Option<String>);

/// What came of a command.
pub(crate) type Answer = Result<(), Refusal>;

impl Refusal {
    pub const DENIED: Self = Self(MavResult::MAV_RESULT_DENIED, None);
    /// Not now: the same command may be accepted in another state.
    pub const REJECTED: Self = Self(MavResult::MAV_RESULT_TEMPORARILY_REJECTED, None);
    pub const UNSUPPORTED: Self = Self(MavResult::MAV_RESULT_UNSUPPORTED, None);
    pub const FAILED: Self = Self(MavResult::MAV_RESULT_FAILED, None);

    /// The same, said as a text.
    pub fn saying(self, text: impl ToString) -> Self {
        Self(self.0, Some(text.to_string()))
    }
}

impl From<Denial> for Refusal {
    fn from(denial: Denial) -> Self {
        Self::REJECTED.saying(denial)
    }
}

/// Counts a refusal, says it, and acknowledges the command to whom it came from.
pub(crate) fn acknowledge(answer: Answer, command: u16, to: Source, core: &mut Core) {
    let accepted = Refusal(MavResult::MAV_RESULT_ACCEPTED, None);
    let Refusal(result, text) = answer.err().unwrap_or(accepted);
    if let Some(text) = text {
        core.warn_refused(&text);
    }
    match result {
        MavResult::MAV_RESULT_UNSUPPORTED => core.refusals.command_unsupported += 1,
        MavResult::MAV_RESULT_DENIED | MavResult::MAV_RESULT_TEMPORARILY_REJECTED => core.refusals.command_denied += 1,
        _ => {}
    }
    let ack = CommandAck {
        command,
        result: result as u8,
        target_system: to.id.system,
        target_component: to.id.component,
        ..CommandAck::default()
    };
    core.outbox
        .build(to.link, |header, out| ack.serialize(header, out).ok());
}

/// Keeps something of a client instead of what was kept of it; of more clients than `most` the oldest gives way.
pub(crate) fn keep<T>(kept: &mut Vec<(Source, T)>, most: usize, client: Source, new: T) {
    kept.retain(|(of, _)| *of != client);
    if kept.len() >= most {
        kept.remove(0);
    }
    kept.push((client, new));
}

/// A message that a service can produce: streamed, requested once (512) or at an interval (511).
#[derive(Clone, Copy)]
pub(crate) struct Produced {
    /// MAVLink message id.
    pub id: u32,
    /// Messages per second on an onboard, API and GCS link; 0 is on request only.
    pub rate_hz: [f32; 3],
    /// How it is built of what all services share: `None` if there is nothing to tell. Without, [`Service::produce`] builds it,
    /// of its own state or differently on each link.
    pub build: Option<fn(&Core) -> Option<MavMessage>>,
    /// How a REQUEST_MESSAGE is answered that depends on its further parameters.
    pub request: Option<Handler>,
}

impl Produced {
    /// One that is built of what all services share.
    pub const fn from(id: u32, rate_hz: [f32; 3], build: fn(&Core) -> Option<MavMessage>) -> Self {
        let build = Some(build);
        Self {
            build,
            ..Self::stateful(id, rate_hz)
        }
    }

    /// One that its service builds.
    pub const fn stateful(id: u32, rate_hz: [f32; 3]) -> Self {
        Self {
            id,
            rate_hz,
            build: None,
            request: None,
        }
    }
}

/// How a command is served that needs nothing but what all services share.
pub(crate) type Handler = fn(&Command, Source, &mut Core) -> Answer;

/// One protocol service. All methods have a default, so that a service implements what it needs.
///
/// It knows the core; neither the core nor the endpoint knows it. To add one: a type in `services`, and its line in the table
/// of `services::all`.
pub(crate) trait Service {
    /// Runs once, before everything else.
    fn start(&mut self, _core: &mut Core) {}

    /// A packet that is addressed to the vehicle or to everybody, except commands.
    fn receive(&mut self, _packet: &Packet<'_>, _source: Source, _core: &mut Core) {}

    /// Whether it serves the command of this number.
    fn serves(&self, _command: u16) -> bool {
        false
    }

    /// One of its commands, addressed to the vehicle. The dispatcher sends the acknowledgement.
    fn command(&mut self, _command: &Command, _source: Source, _core: &mut Core) -> Answer {
        Err(Refusal::UNSUPPORTED)
    }

    /// The messages it can produce.
    fn messages(&self) -> &'static [Produced] {
        &[]
    }

    /// Builds one of its messages that it has to build itself for a link; `None` if there is nothing to tell.
    fn produce(&self, _message_id: u32, _link: LinkId, _core: &Core) -> Option<MavMessage> {
        None
    }

    /// When [`Service::step`] wants to run next.
    fn due_ns(&self) -> Nanos {
        Nanos::MAX
    }

    /// Runs in the first step at or after [`Service::due_ns`].
    fn step(&mut self, _core: &mut Core) {}
}

/// The services of a vehicle, in the order in which commands are offered to them.
pub(crate) type Services = [Box<dyn Service + Send>];

/// What most services use: the core, this module, and MAVLink's messages.
pub(crate) mod prelude {
    pub(crate) use super::{Answer, Handler, Produced, Refusal, Service, Source, acknowledge, keep};
    pub(crate) use crate::LinkId;
    pub(crate) use crate::core::Core;
    pub(crate) use vigil_mavlink::MavMessage;
    pub(crate) use vigil_mavlink::common::*;
    pub(crate) use vigil_mavlink::framing::{Command, Packet};
    pub(crate) use vigil_mavlink::mavlink::MessageData;
    pub(crate) use vigil_mavlink::message;
    pub(crate) use vigil_types::Nanos;
}
