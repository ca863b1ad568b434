//! What every service of the guidance computer shares: who it is, what is known of the vehicle, the answers owed, the texts for people.
//! It imports no service.

use crate::companion::{CompanionConfig, LinkCounters};
use crate::framing::{Command, CommandAck};
use crate::operator::{ReplyTo, result};
use crate::sender::Sender;
use crate::status_text::StatusText;
use crate::vehicle::Vehicle;
use ::core::fmt::Arguments;
use heapless::Vec;
use mavlink::dialects::common::{COMMAND_ACK_DATA, MavMessage, MavSeverity, PARAM_REQUEST_READ_DATA};
use mavlink::{MavlinkVersion, Message, MessageData};
use vigil_types::{Datagrams, GuidanceState, Nanos, Reasons, STEP_NS};

/// Answers that one step can owe: more than several links ask for in a step.
const REPLIES: usize = 128;
/// Bytes of the longest answer's payload.
const REPLY_LEN: usize = 32;
/// Texts of a step that whoever runs the program can show.
const TEXTS: usize = 16;
/// Texts that are kept for a vehicle's link that nobody answers on yet.
const KEPT: usize = 8;

/// Something that recurs at a fixed rate, whatever the jitter of the steps.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Periodic {
    next_ns: Nanos,
}

impl Periodic {
    /// Whether what recurs with this period is due in this step: the one nearest to its time.
    pub fn is_due(&mut self, now_ns: Nanos, period_ns: Nanos) -> bool {
        if now_ns + STEP_NS / 2 < self.next_ns {
            return false;
        }
        let on_grid_ns = self.next_ns + period_ns;
        // The first time, or after a gap, it begins anew.
        self.next_ns = if on_grid_ns > now_ns {
            on_grid_ns
        } else {
            now_ns + period_ns
        };
        true
    }
}

/// How often something was done in the present period, and when that ends.
#[derive(Debug, Clone, Copy, Default)]
pub struct Allowance {
    until_ns: Nanos,
    count: u32,
}

impl Allowance {
    /// Whether it may be done now: at most `most` times in a period, which begins with the first of them.
    pub fn takes(&mut self, now_ns: Nanos, period_ns: Nanos, most: u32) -> bool {
        if now_ns >= self.until_ns {
            (self.until_ns, self.count) = (now_ns.saturating_add(period_ns), 0);
        }
        self.count = self.count.saturating_add(1);
        self.count <= most
    }
}

/// An answer that is sent in the next step: on the link that the question came on, this message with this payload.
type Reply = (u8, u32, Vec<u8, REPLY_LEN>);

/// What the services share.
#[derive(Debug, Clone, Default)]
pub(crate) struct Core {
    pub config: CompanionConfig,
    pub sender: Sender,
    pub vehicle: Vehicle,
    /// The vehicle's system, once known.
    pub system_id: Option<u8>,
    pub counters: LinkCounters,
    /// State and reasons of the last step.
    pub said: Option<(GuidanceState, Reasons)>,
    /// Setpoints go to the vehicle.
    pub streaming: bool,
    /// The vehicle is to hold by itself while it still flies by our setpoints.
    pub letting_go: bool,
    /// It was let go of on purpose, as at the firmware's end: nobody needs to hear that guidance waits.
    pub let_go: bool,
    /// Mean time between the last positions or attitudes, whichever is longer.
    pub telemetry_interval_ns: Option<Nanos>,
    /// A ground station was heard for the first time: it gets the state.
    pub newcomer: bool,
    /// Packets came on the vehicle's link; on others, one bit each.
    pub vehicle_heard: bool,
    links_heard: u64,
    replies: Vec<Reply, REPLIES>,
    /// The texts of this step, or the last one.
    pub texts: Vec<StatusText, TEXTS>,
    /// The newest texts from before the vehicle was heard.
    kept: Vec<StatusText, KEPT>,
    /// Of the last text of several chunks.
    text_id: u16,
}

impl Core {
    pub fn new(config: CompanionConfig) -> Self {
        Self {
            config,
            // Until the vehicle is heard, 1: what a vehicle's system is unless somebody changed it.
            sender: Sender::new(config.system_id.unwrap_or(1), config.component_id),
            vehicle: Vehicle::new(config.flavour),
            system_id: config.system_id,
            ..Self::default()
        }
    }

    /// Whether guidance flies, or is about to.
    pub fn is_flying(&self) -> bool {
        !matches!(
            self.said,
            None | Some((GuidanceState::Standby | GuidanceState::Ready, _))
        )
    }

    /// Whether a packet for this system and component is for the guidance computer.
    pub fn is_for_me_or_all(&self, system: u8, component: u8) -> bool {
        (system == 0 || system == self.sender.system_id) && (component == 0 || component == self.sender.component_id)
    }

    /// Notes a link on which somebody was heard.
    pub fn note_link(&mut self, link: u8) {
        let bit = 1_u64.checked_shl(link.into()).unwrap_or(0);
        self.newcomer |= self.links_heard & bit != bit;
        self.links_heard |= bit;
    }

    /// Owes the acknowledgement of a command.
    pub fn acknowledge(&mut self, to: ReplyTo, command: u16, mav_result: u8, reasons: Reasons) {
        self.counters.commands_refused += u64::from(mav_result != result::ACCEPTED);
        let ack = CommandAck {
            command,
            result: mav_result,
            // Why it was refused, as the reasons' bits; the field has room for 32 of them.
            result_param2: reasons.0 as i32,
            target_system: to.system,
            target_component: to.component,
            ..CommandAck::default()
        };
        self.owe(to.link, COMMAND_ACK_DATA::ID, &ack.payload());
    }

    /// Owes a message as an answer.
    pub fn reply(&mut self, link: u8, message: &MavMessage) {
        let mut payload = [0; 255];
        let len = message.ser(MavlinkVersion::V2, &mut payload);
        self.owe(link, message.message_id(), payload.get(..len).unwrap_or_default());
    }

    fn owe(&mut self, link: u8, message_id: u32, bytes: &[u8]) {
        let mut payload = Vec::new();
        // No answer of a service is longer.
        let _ = payload.extend_from_slice(bytes);
        if self.replies.push((link, message_id, payload)).is_err() {
            self.counters.replies_dropped += 1;
        }
    }

    /// Begins a step: forgets the texts of the one before, and sends the answers owed.
    pub fn begin_step(&mut self, out: &mut Datagrams) {
        self.texts.clear();
        // Once the vehicle is heard, its link has a peer: what was said before reaches it now.
        if self.system_id.is_some() && !self.vehicle_heard && self.vehicle.telemetry.heartbeat.is_some() {
            self.vehicle_heard = true;
            for text in &core::mem::take(&mut self.kept) {
                self.say_text(out, text);
            }
        }
        for (link, message_id, payload) in &core::mem::take(&mut self.replies) {
            self.sender.payload(out, *link, *message_id, payload);
        }
    }

    /// Says a message to everybody.
    pub fn say(&mut self, out: &mut Datagrams, message: &MavMessage) {
        self.sender.message(out, self.config.link, message);
    }

    /// Says a command.
    pub fn command(&mut self, out: &mut Datagrams, command: &Command) {
        self.sender.command(out, self.config.link, command);
    }

    /// Says a text to everybody, and to whoever runs the program; also to a vehicle's link on which nobody answers yet, later.
    pub fn tell(&mut self, out: &mut Datagrams, severity: MavSeverity, text: Arguments<'_>) {
        self.tell_text(out, &StatusText::new(severity, text));
    }

    /// The same for a text that is there.
    pub fn tell_text(&mut self, out: &mut Datagrams, text: &StatusText) {
        if !self.vehicle_heard {
            if self.kept.is_full() {
                self.kept.remove(0);
            }
            let _ = self.kept.push(*text);
        }
        self.tell_now(out, text);
    }

    /// The same for what is of no interest later.
    pub fn tell_now(&mut self, out: &mut Datagrams, text: &StatusText) {
        self.say_text(out, text);
        // More than a step says at its worst.
        let _ = self.texts.push(*text);
    }

    /// Asks the vehicle's autopilot for a parameter.
    pub fn ask_for_parameter(&mut self, out: &mut Datagrams, system: u8, name: &str) {
        let read = PARAM_REQUEST_READ_DATA {
            param_index: -1,
            target_system: system,
            target_component: 1,
            param_id: name.into(),
        };
        self.say(out, &MavMessage::PARAM_REQUEST_READ(read));
    }

    /// Says a text to everybody, and to nobody else.
    pub fn say_text(&mut self, out: &mut Datagrams, text: &StatusText) {
        // Texts of one chunk have no number, so that 0 stays free.
        self.text_id = self.text_id % u16::MAX + 1;
        for message in text.messages(self.text_id) {
            self.say(out, &message);
        }
    }
}
