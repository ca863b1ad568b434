//! The paper's attack on states: the newest frame, given what the actor remembers of the older ones.

use crate::config::{AttackConfig, AttackError, AttackOutcome};
use crate::perturb::{Perturber, limit, saturate};
use crate::surrogate::{Beside, Ends, Surrogate, SurrogateActor};
use vigil_nnet::Isa;
use vigil_policy::FrozenActor;
use vigil_policy::actor::{ACTOR_HIDDEN, ACTOR_OUTPUTS};
use vigil_types::DEPTH_PIXELS;

/// Alters single states: a frame `[128][256]` of ranges over 100 m, and what the actor holds beside it. Unlike [`crate::StreamAttack`] it
/// remembers nothing, so that states can be attacked in any order.
#[derive(Debug, Clone)]
pub struct StateAttack {
    isa: Isa,
    surrogate: SurrogateActor,
    perturber: Perturber,
}

impl StateAttack {
    /// An attack by one who has this actor's weights. Allocates; attacking does not.
    ///
    /// # Errors
    /// A configuration out of range, parameters of another length.
    pub fn new(isa: Isa, actor: &FrozenActor, config: &AttackConfig) -> Result<Self, AttackError> {
        Ok(Self {
            isa,
            surrogate: SurrogateActor::new(isa, &actor.params)?,
            perturber: Perturber::new(*config)?,
        })
    }

    /// Attacks otherwise from now on, and draws from the beginning again.
    ///
    /// # Errors
    /// A configuration out of range; the earlier one stays.
    pub fn configure(&mut self, config: &AttackConfig) -> Result<(), AttackError> {
        self.perturber = Perturber::new(*config)?;
        Ok(())
    }

    /// Draws from the beginning again, from another seed: with one seed for each state the results do not depend on which
    /// thread attacks which state.
    pub fn reseed(&mut self, seed: u64) {
        self.perturber.config.seed = seed;
        self.perturber.reset();
    }

    /// Outputs `[forward velocity, yaw]` in ±1.5 for a state as it is.
    ///
    /// # Errors
    /// A frame of another length.
    pub fn decide(&mut self, frame: &[f32], beside: &Beside) -> Result<[f32; ACTOR_OUTPUTS], AttackError> {
        let before = self.look(frame, beside)?;
        Ok(saturate(self.isa, before))
    }

    /// Gradient of the yaw output, before its saturation, at the pixels of a frame; `gradient` is as long.
    ///
    /// # Errors
    /// A frame or gradient of another length.
    pub fn yaw_gradient(&mut self, frame: &[f32], beside: &Beside, gradient: &mut [f32]) -> Result<(), AttackError> {
        check(gradient)?;
        self.look(frame, beside)?;
        let mut yaw: Ends = [0.0; ACTOR_OUTPUTS + ACTOR_HIDDEN];
        yaw[1] = 1.0;
        Ok(self.surrogate.gradient(&yaw, gradient)?)
    }

    /// Alters `frame` in place; its ranges stay within 0 to 1.
    ///
    /// # Errors
    /// A frame of another length; nothing is altered.
    pub fn attack(&mut self, frame: &mut [f32], beside: &Beside) -> Result<AttackOutcome, AttackError> {
        self.attack_each(frame, beside, |_, _, _| {})
    }

    /// The same, showing `each` every iteration: its number from 1, its outcome, the frame. With
    /// [`crate::Method::BimAccumulating`] iteration k is what an attack of k iterations gives.
    ///
    /// # Errors
    /// A frame of another length; nothing is altered.
    pub fn attack_each(
        &mut self,
        frame: &mut [f32],
        beside: &Beside,
        mut each: impl FnMut(u32, AttackOutcome, &[f32]),
    ) -> Result<AttackOutcome, AttackError> {
        let before = self.look(frame, beside)?;
        let (isa, clean) = (self.isa, saturate(self.isa, before));
        let target = limit(self.perturber.config.towards.sign(clean[1]));
        let outcome = |outputs| AttackOutcome {
            clean,
            attacked: saturate(isa, outputs),
        };
        let last = self.perturber.run(
            &mut self.surrogate,
            target,
            frame,
            before,
            None,
            |iteration, outputs, frame| {
                each(iteration, outcome(outputs), frame);
                true
            },
        )?;
        Ok(outcome(last))
    }

    fn look(&mut self, frame: &[f32], beside: &Beside) -> Result<[f32; ACTOR_OUTPUTS], AttackError> {
        check(frame)?;
        self.surrogate.beside = *beside;
        Ok(self.surrogate.look(frame)?)
    }
}

/// Refuses frames of another length than [`DEPTH_PIXELS`].
fn check(frame: &[f32]) -> Result<(), AttackError> {
    Ok(vigil_nnet::shape::expect("frame", frame, DEPTH_PIXELS)?)
}
