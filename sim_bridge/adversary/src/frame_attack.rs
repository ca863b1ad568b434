//! The attack in flight on whichever learned pilot flies.

use crate::config::{AttackConfig, AttackError, AttackOutcome};
use crate::policy_attack::PolicyAttack;
use crate::stream_attack::StreamAttack;
use vigil_nnet::Isa;
use vigil_policy::actor::ACTOR_OUTPUTS;
use vigil_policy::{FrozenPilot, PilotInput};
use vigil_types::DepthFrame;

/// Alters frames as they pass.
#[derive(Debug, Clone)]
#[expect(clippy::large_enum_variant, reason = "one per flight")]
pub enum FrameAttack {
    /// Against an actor of ours.
    Actor(StreamAttack),
    /// Against an imported policy.
    Policy(PolicyAttack),
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

    /// Lets what the pilot is given pass unaltered, but remembers it; returns what an actor decides. Ends a burst.
    ///
    /// # Errors
    /// None for a pilot of this project's frames.
    pub fn pass(&mut self, taken: &PilotInput<'_>) -> Result<Option<[f32; ACTOR_OUTPUTS]>, AttackError> {
        match self {
            Self::Actor(attack) => attack.pass(taken).map(Some),
            Self::Policy(attack) => {
                attack.pass(taken);
                Ok(None)
            }
        }
    }

    /// Alters what the pilot is given, as [`StreamAttack::attack_while`]: `delivered` becomes the frame taken with other pixels; after each
    /// iteration `go_on` says whether there is time for another.
    ///
    /// # Errors
    /// None for a pilot of this project's frames.
    pub fn attack_while(
        &mut self,
        taken: &PilotInput<'_>,
        delivered: &mut DepthFrame,
        go_on: impl FnMut() -> bool,
    ) -> Result<AttackOutcome, AttackError> {
        match self {
            Self::Actor(attack) => attack.attack_while(taken, delivered, go_on),
            Self::Policy(attack) => attack.attack_while(taken, delivered, go_on),
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
