//! One command to the autopilot at a time: repeated until it is answered, given up after four attempts.
//! <https://mavlink.io/en/services/command.html>

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

/// Why a command failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Failure {
    /// MAV_RESULT.
    Refused(u8),
    NotAnswered,
    /// Accepted, but it never showed in the telemetry.
    NoEffect,
}

impl core::fmt::Display for Failure {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Refused(mav_result) => write!(f, "refused: {}", result::name(*mav_result)),
            Self::NotAnswered => f.write_str("not answered"),
            Self::NoEffect => f.write_str("accepted, but without effect"),
        }
    }
}

/// What to do in this step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Next {
    Wait,
    /// Send it; the number is COMMAND_LONG's confirmation.
    Send(u8),
    Failed(Failure),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Answer {
    None,
    Accepted,
    InProgress,
    /// Refused for now.
    Later,
    Refused(u8),
}

/// Follows one command number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Tracker {
    current: Option<Current>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Current {
    number: u16,
    sent: u8,
    /// When it was sent, or last answered.
    at_ns: Nanos,
    answer: Answer,
}

impl Tracker {
    /// What to do about the wanted command in this step. Another command than before begins anew.
    pub fn next(&mut self, now_ns: Nanos, wanted: &Wanted) -> Next {
        let current = match self.current {
            Some(current) if current.number == wanted.number => current,
            _ => Current {
                number: wanted.number,
                sent: 0,
                at_ns: now_ns,
                answer: Answer::None,
            },
        };
        let waited_ns = now_ns.saturating_sub(current.at_ns);
        let patience_ns = match current.answer {
            Answer::None | Answer::Later => RETRY_NS,
            Answer::Accepted => wanted.effect_ns,
            Answer::InProgress => PROGRESS_NS,
            Answer::Refused(mav_result) => return Next::Failed(Failure::Refused(mav_result)),
        };
        let first = current.sent == 0;
        if !first && waited_ns < patience_ns {
            return Next::Wait;
        }
        if current.sent >= ATTEMPTS {
            return Next::Failed(match current.answer {
                Answer::Accepted | Answer::InProgress => Failure::NoEffect,
                Answer::Later => Failure::Refused(result::TEMPORARILY_REJECTED),
                Answer::None | Answer::Refused(_) => Failure::NotAnswered,
            });
        }
        self.current = Some(Current {
            sent: current.sent + 1,
            at_ns: now_ns,
            answer: Answer::None,
            ..current
        });
        Next::Send(current.sent)
    }

    /// Takes an acknowledgement; one of another command is ignored.
    pub fn acknowledge(&mut self, now_ns: Nanos, ack: &CommandAck) {
        let Some(current) = self.current.as_mut().filter(|c| c.number == ack.command) else {
            return;
        };
        current.at_ns = now_ns;
        current.answer = match ack.result {
            result::ACCEPTED => Answer::Accepted,
            result::IN_PROGRESS => Answer::InProgress,
            result::TEMPORARILY_REJECTED => Answer::Later,
            refused => Answer::Refused(refused),
        };
    }

    /// Whether the command with this number was accepted and nothing else asked since.
    pub fn is_accepted(&self, number: u16) -> bool {
        self.current
            .is_some_and(|c| c.number == number && c.answer == Answer::Accepted)
    }

    /// The command that is followed.
    pub fn number(&self) -> Option<u16> {
        self.current.map(|c| c.number)
    }

    pub fn reset(&mut self) {
        self.current = None;
    }
}
