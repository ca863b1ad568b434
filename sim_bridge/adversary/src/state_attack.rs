//! The paper's attack: all five frames of a state.

use crate::config::{AttackConfig, AttackError, AttackOutcome};
use crate::perturb::{Perturber, Scene, limit, saturate};
use crate::surrogate::{Ends, Surrogate, SurrogateActor};
use vigil_nnet::{Isa, ShapeError};
use vigil_policy::FrozenActor;
use vigil_policy::actor::{ACTOR_HIDDEN, ACTOR_OUTPUTS, ActorSpec, PositionalInputs};

/// Alters whole states. Not possible in flight, where the older four frames have been delivered ([`crate::StreamAttack`]).
#[derive(Debug, Clone)]
pub struct StateAttack {
    isa: Isa,
    surrogate: SurrogateActor,
    perturber: Perturber,
}

/// Before the first of five frames the GRU's state is zero; the surrogate on whole states does not read it.
const NOTHING_OLDER: [f32; ACTOR_HIDDEN] = [0.0; ACTOR_HIDDEN];

impl StateAttack {
    /// An attack by one who has this actor's weights. Allocates; attacking does not.
    ///
    /// # Errors
    /// A configuration out of range, parameters of another length.
    pub fn new(isa: Isa, actor: &FrozenActor, config: &AttackConfig) -> Result<Self, AttackError> {
        Self::on(actor.inputs.spec(), isa, &actor.params, config)
    }

    /// The same for an actor of other dimensions.
    ///
    /// # Errors
    /// A configuration out of range, parameters of another actor.
    pub fn on(spec: ActorSpec, isa: Isa, params: &[f32], config: &AttackConfig) -> Result<Self, AttackError> {
        let surrogate = SurrogateActor::on_state(spec, isa, params)?;
        Ok(Self {
            isa,
            perturber: Perturber::new(*config, surrogate.pixels(), spec.rows, spec.cols)?,
            surrogate,
        })
    }

    /// Attacks otherwise from now on, and draws from the beginning again.
    ///
    /// # Errors
    /// A configuration out of range; the earlier one stays.
    pub fn configure(&mut self, config: &AttackConfig) -> Result<(), AttackError> {
        self.perturber.configure(*config)
    }

    /// Draws from the beginning again, from another seed: with one seed for each state the results do not depend on which
    /// thread attacks which state.
    pub fn reseed(&mut self, seed: u64) {
        self.perturber.reset(seed);
    }

    /// Outputs `[forward velocity, yaw]` in ±1.5 for a state as it is: `frames` `[5][rows][cols]` ranges over 100 m, oldest first,
    /// `position` `[distance / 20 m, bearing / 1 rad]`.
    ///
    /// # Errors
    /// Frames of another length.
    pub fn decide(
        &mut self,
        frames: &[f32],
        position: impl Into<PositionalInputs>,
    ) -> Result<[f32; ACTOR_OUTPUTS], AttackError> {
        let position = position.into();
        let before = self.look(frames, &position)?;
        Ok(saturate(self.isa, before))
    }

    /// Gradient of the yaw output, before its saturation, at the pixels of a state; `frames` and `gradient` are
    /// `[5][rows][cols]`, oldest first.
    ///
    /// # Errors
    /// Frames of another length.
    pub fn yaw_gradient(
        &mut self,
        frames: &[f32],
        position: impl Into<PositionalInputs>,
        gradient: &mut [f32],
    ) -> Result<(), AttackError> {
        let position = position.into();
        self.check(gradient)?;
        self.look(frames, &position)?;
        let mut yaw: Ends = [0.0; ACTOR_OUTPUTS + ACTOR_HIDDEN];
        yaw[1] = 1.0;
        Ok(self.surrogate.gradient(&yaw, gradient)?)
    }

    /// Alters `frames` in place: `[5][rows][cols]` ranges over 100 m, oldest first, which stay within 0 to 1. `position` is
    /// `[distance / 20 m, bearing / 1 rad]`.
    ///
    /// # Errors
    /// Frames of another length; nothing is altered.
    pub fn attack(
        &mut self,
        frames: &mut [f32],
        position: impl Into<PositionalInputs>,
    ) -> Result<AttackOutcome, AttackError> {
        self.attack_each(frames, position, |_, _, _| {})
    }

    /// The same, showing `each` every iteration: its number from 1, its outcome, the frames `[5][rows][cols]`. With
    /// [`crate::Method::BimAccumulating`] iteration k is what an attack of k iterations gives.
    ///
    /// # Errors
    /// Frames of another length; nothing is altered.
    pub fn attack_each(
        &mut self,
        frames: &mut [f32],
        position: impl Into<PositionalInputs>,
        mut each: impl FnMut(u32, AttackOutcome, &[f32]),
    ) -> Result<AttackOutcome, AttackError> {
        let position = position.into();
        let before = self.look(frames, &position)?;
        let (isa, clean) = (self.isa, saturate(self.isa, before));
        let scene = Scene {
            older: &NOTHING_OLDER,
            position: &position,
            target: limit(self.perturber.config().towards.sign(clean[1])),
        };
        let outcome = |outputs| AttackOutcome {
            clean,
            attacked: saturate(isa, outputs),
        };
        let last = self.perturber.run(
            &mut self.surrogate,
            &scene,
            frames,
            before,
            None,
            |iteration, outputs, frames| {
                each(iteration, outcome(outputs), frames);
                true
            },
        )?;
        Ok(outcome(last))
    }

    fn look(&mut self, frames: &[f32], position: &PositionalInputs) -> Result<[f32; ACTOR_OUTPUTS], AttackError> {
        self.check(frames)?;
        Ok(self.surrogate.look(&NOTHING_OLDER, frames, position)?)
    }

    fn check(&self, frames: &[f32]) -> Result<(), AttackError> {
        if frames.len() == self.surrogate.pixels() {
            Ok(())
        } else {
            Err(AttackError::Shape(ShapeError::Length {
                what: "state's frames",
                expected: self.surrogate.pixels(),
                got: frames.len(),
            }))
        }
    }
}
