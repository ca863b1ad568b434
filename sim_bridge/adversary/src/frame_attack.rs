//! The attack in flight on whichever learned pilot flies.

use crate::config::{AttackConfig, AttackError, AttackOutcome};
use crate::policy_attack::PolicyAttack;
use crate::stream_attack::StreamAttack;
use vigil_nnet::Isa;
use vigil_policy::FrozenPilot;
use vigil_policy::actor::PositionalInputs;

/// Alters frames as they pass.
#[derive(Debug, Clone)]
pub enum FrameAttack {
    /// Against an actor of ours.
    Actor(StreamAttack),
    /// Against an imported policy.
    Policy(PolicyAttack),
}

impl From<StreamAttack> for FrameAttack {
    fn from(attack: StreamAttack) -> Self {
        Self::Actor(attack)
    }
}

impl FrameAttack {
    /// An attack by one who has this pilot's weights. Allocates; attacking and passing do not.
    ///
    /// # Errors
    /// A configuration out of range, parameters of another length.
    pub fn on(pilot: &FrozenPilot, isa: Isa, config: &AttackConfig) -> Result<Self, AttackError> {
        Ok(match pilot {
            FrozenPilot::Actor(actor) => Self::Actor(StreamAttack::new(isa, actor, config)?),
            FrozenPilot::Imported(policy) => Self::Policy(PolicyAttack::new(isa, policy, config)?),
        })
    }

    /// Lets a frame (`[rows][cols]` ranges over 100 m) pass unaltered, but remembers it. Ends a burst.
    ///
    /// # Errors
    /// A frame of another length; nothing is remembered of it.
    pub fn pass(&mut self, frame: &mut [f32], position: PositionalInputs) -> Result<(), AttackError> {
        match self {
            Self::Actor(attack) => attack.pass(frame, position),
            Self::Policy(attack) => attack.pass(frame),
        }
    }

    /// Alters a frame in place, as [`StreamAttack::attack_while`]: after each iteration `go_on` says whether there is time for another.
    ///
    /// # Errors
    /// A frame of another length; nothing is altered or remembered.
    pub fn attack_while(
        &mut self,
        frame: &mut [f32],
        position: PositionalInputs,
        go_on: impl FnMut() -> bool,
    ) -> Result<AttackOutcome, AttackError> {
        match self {
            Self::Actor(attack) => attack.attack_while(frame, position, go_on),
            Self::Policy(attack) => attack.attack_while(frame, &position, go_on),
        }
    }

    /// Forgets the frames and draws from the beginning again: another flight.
    pub fn reset(&mut self) {
        match self {
            Self::Actor(attack) => attack.reset(),
            Self::Policy(attack) => attack.reset(),
        }
    }
}
