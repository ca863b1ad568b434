//! One command to the autopilot at a time: repeated until it is answered, given up after four attempts.
//! <https://mavlink.io/en/services/command.html>

use crate::autopilot::Flavour;
use crate::framing::CommandAck;
use crate::operator::result;
use vigil_types::Nanos;

/// Attempts before a command counts as not answered.
const ATTEMPTS: u8 = 4;
/// Pause between attempts.
const RETRY_NS: Nanos = 500_000_000;
/// IN_PROGRESS is waited for this long after its last sign.
const PROGRESS_NS: Nanos = 10_000_000_000;

/// A command of the hand-over.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Wanted {
    pub number: u16,
    pub params: [f32; 7],
    /// Latitude and longitude in place of parameters 5 and 6, 1e-7 degrees: it goes as a COMMAND_INT.
    pub place: Option<(i32, i32)>,
    /// How long its effect may take to be seen after it was accepted; then it is sent again.
    pub effect_ns: Nanos,
}

/// Why a command failed: the last answer to it, a MAV_RESULT, if one came.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Failure(Option<u8>);

impl core::fmt::Display for Failure {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self.0 {
            None => f.write_str("not answered"),
            // It never showed in the telemetry.
            Some(result::ACCEPTED | result::IN_PROGRESS) => f.write_str("accepted, but without effect"),
            Some(refused) => write!(f, "refused: {}", result::name(refused)),
        }
    }
}

/// What to do in this step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Next {
    Wait,
    /// Send it; the number is COMMAND_LONG's confirmation.
    Send(Wanted, u8),
    /// A command with this number failed, which people read once.
    Failed(u16, Failure),
    /// The same for a vehicle that names another autopilot than the configured one.
    OtherAutopilot(Flavour),
}

/// Follows one command number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Tracker {
    /// The command that is followed.
    pub number: Option<u16>,
    sent: u8,
    /// When it was sent, or last answered.
    at_ns: Nanos,
    /// MAV_RESULT, since it was sent last.
    answer: Option<u8>,
}

impl Tracker {
    /// What to do about the wanted command in this step. Another command than before begins anew.
    pub fn next(&mut self, now_ns: Nanos, wanted: &Wanted) -> Next {
        if self.number != Some(wanted.number) {
            *self = Self {
                number: Some(wanted.number),
                ..Self::default()
            };
        }
        let failed = Next::Failed(wanted.number, Failure(self.answer));
        let patience_ns = match self.answer {
            None | Some(result::TEMPORARILY_REJECTED) => RETRY_NS,
            Some(result::ACCEPTED) => wanted.effect_ns,
            Some(result::IN_PROGRESS) => PROGRESS_NS,
            Some(_) => return failed,
        };
        if self.sent > 0 && now_ns.saturating_sub(self.at_ns) < patience_ns {
            return Next::Wait;
        }
        if self.sent >= ATTEMPTS {
            return failed;
        }
        let confirmation = self.sent;
        (self.sent, self.at_ns, self.answer) = (confirmation + 1, now_ns, None);
        Next::Send(*wanted, confirmation)
    }

    /// Takes an acknowledgement; one of another command is ignored.
    pub fn acknowledge(&mut self, now_ns: Nanos, ack: &CommandAck) {
        if self.number == Some(ack.command) {
            (self.at_ns, self.answer) = (now_ns, Some(ack.result));
        }
    }

    /// Whether the command with this number was accepted and nothing else asked since.
    pub fn is_accepted(&self, number: u16) -> bool {
        (self.number, self.answer) == (Some(number), Some(result::ACCEPTED))
    }
}
