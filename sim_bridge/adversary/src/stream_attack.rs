//! The attack in flight: the newest frame only, as it passes.

use crate::config::{AttackConfig, AttackError, AttackOutcome};
use crate::detector_evasion::DetectorEvasion;
use crate::perturb::{Perturber, Scene, before_saturation, limit};
use crate::surrogate::{Surrogate, SurrogateActor};
use vigil_detector::FrozenDetector;
use vigil_nnet::{Graph, GraphBuilder, Isa, NodeId, Purpose, ShapeError};
use vigil_policy::FrozenActor;
use vigil_policy::actor::{
    ACTOR_FRAMES, ACTOR_HIDDEN, ACTOR_LIMIT, ACTOR_OUTPUTS, ActorSpec, FRAMES_IN_A_ROW, PositionalInputs,
};

/// Alters frames as they pass. It remembers what it delivered, as the actor does, and what it was given, so as to know what the
/// actor would have decided.
#[derive(Debug, Clone)]
pub struct StreamAttack {
    isa: Isa,
    surrogate: SurrogateActor,
    perturber: Perturber,
    params: Vec<f32>,
    memory: Memory,
    delivered: Trail,
    clean: Trail,
    /// Where the burst under way aims, so that it does not turn back half-way.
    direction: Option<f32>,
    /// Least and greatest yaw output that the next attack may aim at.
    yaw_bounds: Option<(f32, f32)>,
    /// The detector whose score is to stay low.
    evasion: Option<Box<DetectorEvasion>>,
    spec: ActorSpec,
}

impl StreamAttack {
    /// An attack by one who has this actor's weights. Allocates; attacking and
    /// passing do not.
    ///
    /// # Errors
    /// A configuration out of range, parameters of another length.
    pub fn new(isa: Isa, actor: &FrozenActor, config: &AttackConfig) -> Result<Self, AttackError> {
        let attack = Self::on(actor.inputs.spec(), isa, &actor.params, config)?;
        Ok(attack.with_frame_ages(actor.inputs.frame_ages))
    }

    /// The same for an actor of other dimensions.
    ///
    /// # Errors
    /// A configuration out of range, parameters of another actor.
    pub fn on(spec: ActorSpec, isa: Isa, params: &[f32], config: &AttackConfig) -> Result<Self, AttackError> {
        let surrogate = SurrogateActor::on_newest(spec, isa, params)?;
        Ok(Self {
            isa,
            perturber: Perturber::new(*config, surrogate.pixels(), spec.rows, spec.cols)?,
            surrogate,
            params: params.to_vec(),
            memory: Memory::new(spec)?,
            delivered: Trail::new(spec, FRAMES_IN_A_ROW),
            clean: Trail::new(spec, FRAMES_IN_A_ROW),
            direction: None,
            yaw_bounds: None,
            evasion: None,
            spec,
        })
    }

    /// The same attack on an actor whose five frames were taken so many decisions ago, oldest first (0 for the newest).
    #[must_use]
    pub fn with_frame_ages(mut self, ages: [usize; ACTOR_FRAMES]) -> Self {
        (self.delivered, self.clean) = (Trail::new(self.spec, ages), Trail::new(self.spec, ages));
        self
    }

    /// Makes the attack adaptive: it deceives this detector along with the actor. Whenever the detector's score comes near its
    /// threshold, an iteration lowers the score instead of bending the yaw.
    ///
    /// # Errors
    /// A detector whose background sample or parameters do not fit.
    pub fn evading(mut self, detector: &FrozenDetector) -> Result<Self, AttackError> {
        let evasion = DetectorEvasion::new(self.spec, self.isa, &self.params, detector)?;
        self.evasion = Some(Box::new(evasion));
        Ok(self)
    }

    /// From now on aims at no yaw output below the first or above the second, both within ±1.5 and in this order; without bounds, at a limit.
    pub(crate) fn keep_yaw_within(&mut self, bounds: Option<(f32, f32)>) {
        self.yaw_bounds = bounds;
    }

    /// Lets a frame (`[rows][cols]` ranges over 100 m) pass unaltered, but remembers it. Ends a burst. `position` is
    /// `[distance / 20 m, bearing / 1 rad]`.
    ///
    /// # Errors
    /// A frame of another length; nothing is remembered of it.
    pub fn pass(&mut self, frame: &mut [f32], position: impl Into<PositionalInputs>) -> Result<(), AttackError> {
        let position = position.into();
        self.check(frame)?;
        self.surrogate.look(&[0.0; ACTOR_HIDDEN], frame, &position)?;
        let features = self.surrogate.features()?;
        self.delivered.push(features);
        self.clean.push(features);
        self.direction = None;
        if let Some(evasion) = &mut self.evasion {
            evasion.begin_step();
        }
        self.explain_delivered(&position)
    }

    /// Alters a frame (`[rows][cols]` ranges over 100 m, which stay within 0 to 1) in place; `position` is
    /// `[distance / 20 m, bearing / 1 rad]`. `clean` of the outcome is what the actor would decide
    /// had no frame been altered at all. A burst keeps the direction of its first frame.
    ///
    /// # Errors
    /// A frame of another length; nothing is altered or remembered.
    pub fn attack(
        &mut self,
        frame: &mut [f32],
        position: impl Into<PositionalInputs>,
    ) -> Result<AttackOutcome, AttackError> {
        self.attack_while(frame, position, || true)
    }

    /// The same within a deadline: after each iteration `go_on` says whether there is time for another.
    ///
    /// # Errors
    /// A frame of another length; nothing is altered or remembered.
    pub fn attack_while(
        &mut self,
        frame: &mut [f32],
        position: impl Into<PositionalInputs>,
        mut go_on: impl FnMut() -> bool,
    ) -> Result<AttackOutcome, AttackError> {
        let position = position.into();
        self.check(frame)?;
        if !self.delivered.started {
            // The actor takes the first frame of all for the missing older ones. What they will hold cannot be known before it
            // is altered, so they count as unaltered meanwhile.
            self.surrogate.look(&[0.0; ACTOR_HIDDEN], frame, &position)?;
            self.clean.push(self.surrogate.features()?);
        }
        let trail = if self.delivered.started {
            &self.delivered
        } else {
            &self.clean
        };
        let older = self.memory.older_state(self.isa, &self.params, trail)?;
        let before = self.surrogate.look(&older, frame, &position)?;
        self.clean.push(self.surrogate.features()?);
        let clean = self.memory.decide(self.isa, &self.params, &self.clean, &position)?;
        let towards = self.perturber.config().towards;
        let direction = *self.direction.get_or_insert_with(|| towards.sign(clean[1]));
        let scene = Scene {
            older: &older,
            position: &position,
            target: match self.yaw_bounds {
                None => limit(direction),
                Some((low, high)) => before_saturation((direction * ACTOR_LIMIT).clamp(low, high)),
            },
        };
        if let Some(evasion) = &mut self.evasion {
            evasion.begin_step();
        }
        self.perturber.run(
            &mut self.surrogate,
            &scene,
            frame,
            before,
            self.evasion.as_deref_mut(),
            |_, _, _| go_on(),
        )?;
        self.delivered.push(self.surrogate.features()?);
        let attacked = self.memory.decide(self.isa, &self.params, &self.delivered, &position)?;
        self.explain_delivered(&position)?;
        Ok(AttackOutcome { clean, attacked })
    }

    /// The detector explains what the actor decided on.
    fn explain_delivered(&mut self, position: &PositionalInputs) -> Result<(), AttackError> {
        if let Some(evasion) = &mut self.evasion {
            let state = self.memory.state(self.isa, &self.params, &self.delivered, position)?;
            evasion.look(&state, position)?;
        }
        Ok(())
    }

    /// Forgets the frames and draws from the beginning again: another flight.
    pub fn reset(&mut self) {
        let seed = self.perturber.config().seed;
        self.perturber.reset(seed);
        self.delivered.started = false;
        self.clean.started = false;
        self.direction = None;
        self.yaw_bounds = None;
        if let Some(evasion) = &mut self.evasion {
            evasion.reset();
        }
    }

    fn check(&self, frame: &[f32]) -> Result<(), AttackError> {
        if frame.len() == self.surrogate.pixels() {
            Ok(())
        } else {
            Err(AttackError::Shape(ShapeError::Length {
                what: "frame",
                expected: self.surrogate.pixels(),
                got: frame.len(),
            }))
        }
    }
}

/// Features of as many frames as the actor remembers, a ring.
#[derive(Debug, Clone)]
struct Trail {
    features: Vec<f32>,
    width: usize,
    started: bool,
    ages: [usize; ACTOR_FRAMES],
    /// Slot of the newest frame.
    newest: usize,
}

impl Trail {
    fn new(spec: ActorSpec, ages: [usize; ACTOR_FRAMES]) -> Self {
        let kept = 1 + ages.iter().max().unwrap_or(&0);
        Self {
            features: vec![0.0; kept * spec.features()],
            width: spec.features(),
            started: false,
            ages,
            newest: 0,
        }
    }

    fn kept(&self) -> usize {
        self.features.len() / self.width
    }

    /// The first frame stands for the missing older ones, as in the actor.
    fn push(&mut self, newest: &[f32]) {
        self.newest = (self.newest + 1) % self.kept();
        let (slot, kept) = (self.newest, self.kept());
        let slots = self.features.chunks_exact_mut(self.width);
        let (first, count) = if self.started { (slot, 1) } else { (0, kept) };
        for slot in slots.skip(first).take(count) {
            slot.copy_from_slice(newest);
        }
        self.started = true;
    }

    fn frame(&self, age: usize) -> &[f32] {
        let slot = (self.newest + self.kept() - age) % self.kept();
        &self.features[slot * self.width..(slot + 1) * self.width]
    }

    /// The five frames of the last decision, oldest first.
    fn frames(&self) -> impl Iterator<Item = &[f32]> {
        self.ages.iter().map(|age| self.frame(*age))
    }

    /// The four frames that the next decision will hold beside its newest.
    fn older(&self) -> impl Iterator<Item = &[f32]> {
        let before = self.ages.iter().filter(|age| **age > 0);
        before.map(|age| self.frame(age - 1))
    }
}

/// The actor behind its encoder: features to the decision, and to the GRU's state before the next frame.
#[derive(Debug, Clone)]
struct Memory {
    decision: Graph,
    /// The GRU's last state in `decision`.
    state: NodeId,
    older: Graph,
    decision_tape: Vec<f32>,
    older_tape: Vec<f32>,
}

impl Memory {
    fn new(spec: ActorSpec) -> Result<Self, ShapeError> {
        let (decision, state) = {
            let mut b = GraphBuilder::new();
            let params = spec.reserve(&mut b);
            let features = Self::features(&mut b, spec, ACTOR_FRAMES)?;
            let position = b.input(spec.positional().inputs, false)?;
            let state = spec.recur(&mut b, &params, &features)?;
            let outputs = spec.head(&mut b, &params, state, position)?;
            (b.finish(outputs, Purpose::Gradients)?, state)
        };
        let older = {
            let mut b = GraphBuilder::new();
            let params = spec.reserve(&mut b);
            let features = Self::features(&mut b, spec, ACTOR_FRAMES - 1)?;
            let state = spec.recur(&mut b, &params, &features)?;
            b.finish(state, Purpose::Gradients)?
        };
        Ok(Self {
            decision_tape: vec![0.0; decision.tape_len()],
            older_tape: vec![0.0; older.tape_len()],
            decision,
            state,
            older,
        })
    }

    fn features(b: &mut GraphBuilder, spec: ActorSpec, frames: usize) -> Result<Vec<NodeId>, ShapeError> {
        (0..frames).map(|_| b.input(spec.features(), false)).collect()
    }

    /// What the actor decides on these five frames.
    fn decide(
        &mut self,
        isa: Isa,
        params: &[f32],
        trail: &Trail,
        position: &PositionalInputs,
    ) -> Result<[f32; ACTOR_OUTPUTS], ShapeError> {
        let mut inputs: [&[f32]; ACTOR_FRAMES + 1] = [position; ACTOR_FRAMES + 1];
        for (input, features) in inputs.iter_mut().zip(trail.frames()) {
            *input = features;
        }
        self.decision.forward(isa, params, &inputs, &mut self.decision_tape)?;
        let mut outputs = [0.0; ACTOR_OUTPUTS];
        outputs.copy_from_slice(self.decision.output(&self.decision_tape)?);
        Ok(outputs)
    }

    /// The GRU's state that the decision on these five frames is made from.
    fn state(
        &mut self,
        isa: Isa,
        params: &[f32],
        trail: &Trail,
        position: &PositionalInputs,
    ) -> Result<[f32; ACTOR_HIDDEN], ShapeError> {
        self.decide(isa, params, trail, position)?;
        let mut state = [0.0; ACTOR_HIDDEN];
        state.copy_from_slice(self.decision.value(&self.decision_tape, self.state)?);
        Ok(state)
    }

    /// The GRU's state before the next frame: the oldest of the five will have dropped out.
    fn older_state(&mut self, isa: Isa, params: &[f32], trail: &Trail) -> Result<[f32; ACTOR_HIDDEN], ShapeError> {
        let mut inputs: [&[f32]; ACTOR_FRAMES - 1] = [&[]; ACTOR_FRAMES - 1];
        for (input, features) in inputs.iter_mut().zip(trail.older()) {
            *input = features;
        }
        self.older.forward(isa, params, &inputs, &mut self.older_tape)?;
        let mut state = [0.0; ACTOR_HIDDEN];
        state.copy_from_slice(self.older.output(&self.older_tape)?);
        Ok(state)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Towards;
    use vigil_policy::actor::PositionalInputs;
    use vigil_types::DEPTH_PIXELS;

    #[test]
    fn an_attack_within_bounds_bends_the_yaw_to_the_bound_and_without_them_to_the_limit() {
        let actor = FrozenActor::built_in().unwrap();
        let config = AttackConfig {
            towards: Towards::Right,
            ..AttackConfig::PAPER
        };
        let position = PositionalInputs::at_rest([1.0, 0.0], actor.inputs);
        let attacked = |bounds: Option<(f32, f32)>| {
            let mut adversary = StreamAttack::new(Isa::detect(), &actor, &config).unwrap();
            adversary.keep_yaw_within(bounds);
            // A wall at 8 m; all five frames are altered.
            let last = (0..8).map(|_| adversary.attack(&mut vec![0.08; DEPTH_PIXELS], position).unwrap());
            last.last().unwrap().attacked[1]
        };
        assert!(attacked(None) > 1.4, "{}", attacked(None));
        for bound in [-0.4, 0.3] {
            let yaw = attacked(Some((-1.5, bound)));
            assert!((yaw - bound).abs() < 0.3, "{yaw} where {bound} was aimed at");
        }
    }
}
