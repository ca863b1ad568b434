//! The attack in flight: the newest frame only, as it passes.

use crate::config::{AttackConfig, AttackError, AttackOutcome};
use crate::detector_evasion::DetectorEvasion;
use crate::perturb::{Perturber, before_saturation, limit};
use crate::surrogate::{Beside, Surrogate, SurrogateActor};
use vigil_detector::FrozenDetector;
use vigil_nnet::Isa;
use vigil_policy::actor::{ACTOR_LIMIT, ACTOR_OUTPUTS, Actor, ActorSpec};
use vigil_policy::{FrozenActor, PilotInput};
use vigil_types::{Action, DepthFrame};

/// Alters frames as they pass. Two actors of its own fly along, one on what it delivered and one on what was taken: so it knows what the
/// actor remembers, what it observes of itself, and what it would have decided.
#[derive(Debug, Clone)]
pub struct StreamAttack {
    isa: Isa,
    surrogate: SurrogateActor,
    perturber: Perturber,
    delivered: Actor,
    clean: Actor,
    /// What the first would decide on the frame that is about to be altered.
    foreseen: Actor,
    /// Where the burst under way aims, so that it does not turn back half-way.
    direction: Option<f32>,
    /// Least and greatest yaw output that the next attack may aim at, both within ±1.5 and in this order; without them it aims at a limit.
    pub(crate) yaw_bounds: Option<(f32, f32)>,
    /// The detector whose score is to stay low.
    evasion: Option<Box<DetectorEvasion>>,
}

impl StreamAttack {
    /// An attack by one who has this actor's weights.
    ///
    /// # Errors
    /// A configuration out of range, parameters of another length.
    pub fn new(isa: Isa, actor: &FrozenActor, config: &AttackConfig) -> Result<Self, AttackError> {
        let delivered = Actor::new(ActorSpec::FULL, isa, &actor.params)?.cruising_at(actor.cruise_m_s);
        Ok(Self {
            isa,
            surrogate: SurrogateActor::new(isa, &actor.params)?,
            perturber: Perturber::new(*config)?,
            clean: delivered.clone(),
            foreseen: delivered.clone(),
            delivered,
            direction: None,
            yaw_bounds: None,
            evasion: None,
        })
    }

    /// Makes the attack adaptive: it deceives this detector along with the actor. Whenever the detector's score comes near its
    /// threshold, an iteration lowers the score instead of bending the yaw.
    ///
    /// # Errors
    /// A detector whose background sample or parameters do not fit.
    pub fn evading(mut self, detector: &FrozenDetector) -> Result<Self, AttackError> {
        let evasion = DetectorEvasion::new(self.isa, self.delivered.params(), detector)?;
        self.evasion = Some(Box::new(evasion));
        Ok(self)
    }

    /// Lets what the actor is given pass unaltered, but remembers it; returns what the actor decides. Ends a burst.
    ///
    /// # Errors
    /// None for an actor of this project's frames.
    pub fn pass(&mut self, taken: &PilotInput<'_>) -> Result<[f32; ACTOR_OUTPUTS], AttackError> {
        let [forward_m_s, yaw] = self.delivered.decide(taken)?;
        self.clean.decide_beside(&self.delivered, taken)?;
        self.clean.note_action(Action { forward_m_s, yaw });
        self.direction = None;
        if let Some(evasion) = &mut self.evasion {
            evasion.begin_step(self.delivered.low_dim());
            evasion.look(self.delivered.state())?;
        }
        Ok([forward_m_s, yaw])
    }

    /// Alters what the actor is given: `delivered` becomes the frame taken with other pixels, each within 0 to 1; it is to be sealed again.
    /// `clean` of the outcome is what the actor would decide had no frame been altered at all, flown as it is: its last action is the one
    /// that was flown. A burst keeps the direction of its first frame. After each iteration `go_on` says whether there is
    /// time for another.
    ///
    /// # Errors
    /// None for an actor of this project's frames.
    pub fn attack_while(
        &mut self,
        taken: &PilotInput<'_>,
        delivered: &mut DepthFrame,
        mut go_on: impl FnMut() -> bool,
    ) -> Result<AttackOutcome, AttackError> {
        delivered.clone_from(taken.depth);
        let clean = self.clean.decide(taken)?;
        // What the actor will hold beside this frame: what it would hold beside it unaltered. (But for a flight's first frame, which stands
        // for the missing older ones.)
        self.foreseen.remember_as(&self.delivered);
        self.foreseen.decide_beside(&self.clean, taken)?;
        self.surrogate.beside = Beside::of(&self.foreseen);
        let before = self.surrogate.look(&delivered.depth)?;
        self.perturber.see_from(taken.depth.header.attitude, taken.height_m);
        let towards = self.perturber.config.towards;
        let direction = *self.direction.get_or_insert_with(|| towards.sign(clean[1]));
        let target = match self.yaw_bounds {
            None => limit(direction),
            Some((low, high)) => before_saturation((direction * ACTOR_LIMIT).clamp(low, high)),
        };
        if let Some(evasion) = &mut self.evasion {
            evasion.begin_step(self.foreseen.low_dim());
        }
        self.perturber.run(
            &mut self.surrogate,
            target,
            &mut delivered.depth,
            before,
            self.evasion.as_deref_mut(),
            |_, _, _| go_on(),
        )?;
        let attacked = self.delivered.decide(&PilotInput {
            depth: delivered,
            ..*taken
        })?;
        let [forward_m_s, yaw] = attacked;
        self.clean.note_action(Action { forward_m_s, yaw });
        if let Some(evasion) = &mut self.evasion {
            evasion.look(self.delivered.state())?;
        }
        Ok(AttackOutcome { clean, attacked })
    }

    /// Forgets the frames and draws from the beginning again: another flight.
    pub fn reset(&mut self) {
        self.perturber.reset();
        self.delivered.reset();
        self.clean.reset();
        self.direction = None;
        self.yaw_bounds = None;
        if let Some(evasion) = &mut self.evasion {
            evasion.reset();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Towards;
    use vigil_types::{GoalRelative, STEP_NS};

    #[test]
    fn an_attack_within_bounds_bends_the_yaw_to_the_bound_and_without_them_to_the_limit() {
        let actor = FrozenActor::built_in().unwrap();
        let config = AttackConfig {
            towards: Towards::Right,
            ..AttackConfig::PAPER
        };
        let attacked = |bounds: Option<(f32, f32)>| {
            let mut adversary = StreamAttack::new(Isa::detect(), &actor, &config).unwrap();
            adversary.yaw_bounds = bounds;
            // A wall at 8 m; all frames of 1.5 s are altered.
            let (mut frame, mut altered) = (DepthFrame::EMPTY, DepthFrame::EMPTY);
            frame.depth.fill(0.08);
            let last = (0..30).map(|step| {
                let taken = PilotInput {
                    now_ns: step * STEP_NS,
                    height_m: 1.5,
                    ..PilotInput::at_rest(&frame, GoalRelative::new(20.0, 0.0))
                };
                adversary.attack_while(&taken, &mut altered, || true).unwrap()
            });
            last.last().unwrap().attacked[1]
        };
        assert!(attacked(None) > 1.4, "{}", attacked(None));
        for bound in [-0.4, 0.3] {
            let yaw = attacked(Some((-1.5, bound)));
            assert!((yaw - bound).abs() < 0.3, "{yaw} where {bound} was aimed at");
        }
    }
}
