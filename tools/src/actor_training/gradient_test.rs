//! The assembled update against finite differences of its two losses.

use super::*;
use crate::actor_training::networks::squash;
use crate::actor_training::recurrent::{Recurrent, RecurrentParams};
use crate::actor_training::replay_buffer::State;
use crate::actor_training::shard::{five, mirrored};
use rand::RngExt;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use vigil_policy::actor::ACTOR_FRAMES;
use vigil_types::DEPTH_PIXELS;

struct Case {
    networks: Networks,
    weights: Weights,
    packed_actor: Aligned,
    packed_critic: Aligned,
    arranged: Arranged,
    frames: Vec<Vec<u8>>,
}

impl Case {
    fn new() -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let networks = Networks::new().unwrap();
        let config = TrainConfig::default();
        let mut learner = Learner::new(Arc::new(Networks::new().unwrap()), Isa::detect(), &config, &mut rng).unwrap();
        // Last layers large enough to matter.
        for (layers, params) in [
            (networks.actor_layers(), &mut learner.weights.actor),
            (networks.critic_layers(), &mut learner.weights.critic),
        ] {
            let (_, last) = layers.last().unwrap();
            for w in &mut params[last.at..last.at + last.len] {
                *w = rng.random_range(-0.6..0.6);
            }
        }
        learner.pack().unwrap();
        // Smooth pictures: blocks of 8 × 8 pixels.
        let frames = (0..ACTOR_FRAMES)
            .map(|_| {
                let blocks: Vec<u8> = (0..DEPTH_PIXELS / 64).map(|_| rng.random_range(10..250)).collect();
                (0..DEPTH_PIXELS)
                    .map(|p| blocks[(p / 256 / 8) * 32 + p % 256 / 8])
                    .collect()
            })
            .collect();
        Self {
            networks,
            packed_actor: learner.packed_actor.clone(),
            packed_critic: learner.packed_critic.clone(),
            arranged: learner.arranged,
            weights: learner.weights,
            frames,
        }
    }

    fn transition(&self) -> Transition<'_> {
        let state = State {
            frames: core::array::from_fn(|i| self.frames[i].as_slice()),
            position: [0.6, -0.3],
        };
        Transition {
            leaf: 0,
            state,
            action: [0.8, -0.4],
            teacher_action: Some([0.2, 0.3]),
            reward: 1.7,
            discount: 0.0,
            next: state,
            weight: 0.7,
        }
    }

    fn frozen<'a>(&'a self, weights: &'a Weights) -> UpdateContext<'a> {
        UpdateContext {
            networks: &self.networks,
            isa: Isa::detect(),
            weights,
            packed_actor: &self.packed_actor,
            packed_critic: &self.packed_critic,
            arranged: &self.arranged,
            saturation_penalty: 0.3,
            imitation: 0.4,
            imitation_width: 0.3,
            imitation_trains_encoder: false,
            by_value: 1.0,
            batch: 1.0,
        }
    }

    fn shard(&self, mirror: bool) -> Shard {
        let mut shard = Shard::new(&self.networks);
        let augmentation = Augmentation {
            mirror,
            frame_shares: [1.0; ACTOR_FRAMES],
        };
        let frozen = self.frozen(&self.weights);
        shard.learn(&frozen, &self.transition(), augmentation).unwrap();
        shard.finish(&frozen).unwrap();
        shard
    }

    /// Both losses with changed weights, in double precision where sums are formed here.
    fn losses(&self, weights: &Weights, mirror: bool) -> (f64, f64) {
        let f = self.frozen(weights);
        let (n, t) = (&self.networks, self.transition());
        let mut shard = Shard::new(n);
        shard
            .encode(&f, &weights.actor, &t.state, mirror, [0.0; ACTOR_FRAMES])
            .unwrap();
        let gru = |params: &[f32]| {
            let mut set = RecurrentParams::new(n.encoder.output_len());
            set.set(params).unwrap();
            Recurrent::new(n.encoder.output_len())
                .forward(f.isa, &set, &shard.features)
                .unwrap()
        };
        let position = mirrored(t.state.position, mirror);
        let state = gru(&weights.critic[n.critic_gru()]);
        let own_state = gru(&weights.actor[n.actor_gru()]);
        let mut value = |action: [f32; 2]| {
            n.critic_head
                .forward(
                    f.isa,
                    &weights.critic,
                    &[&state, &position, &action],
                    &mut shard.critic_head.tape,
                )
                .unwrap();
            f64::from(n.critic_head.output(&shard.critic_head.tape).unwrap()[0])
        };
        let error = value(mirrored(t.action, mirror)) - f64::from(t.reward);
        let critic = f64::from(t.weight) * error * error;
        n.actor_head
            .forward(
                f.isa,
                &weights.actor,
                &[&own_state, &position],
                &mut shard.actor_head.tape,
            )
            .unwrap();
        let pre = n.actor_head.output(&shard.actor_head.tape).unwrap();
        let penalty: f64 = pre.iter().map(|p| f64::from((p.abs() - 1.0).max(0.0)).powi(2)).sum();
        let action = squash(pre);
        let teacher_action = mirrored(t.teacher_action.unwrap(), mirror);
        // The test's action is nearer to the teacher's action than the width in one output and farther in the other.
        let far = |a: f32, g: f32| (a - g).abs() > f.imitation_width;
        assert_ne!(
            far(action[0], teacher_action[0]),
            far(action[1], teacher_action[1]),
            "{action:?} {teacher_action:?}"
        );
        let width = f64::from(f.imitation_width);
        let distance: f64 = (action.iter().zip(teacher_action))
            .map(|(&a, g)| {
                let off = f64::from((a - g).abs());
                if off > width {
                    off - width / 2.0
                } else {
                    off * off / (2.0 * width)
                }
            })
            .sum();
        let (penalty, distance) = (
            f64::from(f.saturation_penalty) * penalty,
            f64::from(f.imitation) * distance,
        );
        (critic, penalty + distance - value(action))
    }
}

/// Central difference along a direction `d` of length 1 in a layer.
fn slope(case: &Case, mirror: bool, change: impl Fn(&mut Weights, f32), loss: impl Fn((f64, f64)) -> f64) -> f64 {
    const STEP: f32 = 2e-3;
    let at = |h: f32| {
        let mut w = case.weights.clone();
        change(&mut w, h);
        loss(case.losses(&w, mirror))
    };
    (at(STEP) - at(-STEP)) / (2.0 * f64::from(STEP))
}

#[test]
fn every_layer_has_the_gradient_of_its_own_loss() {
    let case = Case::new();
    let encoder = case.networks.encoder_len();
    for mirror in [false, true] {
        let shard = case.shard(mirror);
        let mut layers = Vec::new();
        for (name, p) in case.networks.actor_layers() {
            layers.push((
                name,
                p,
                false,
                if p.at < encoder {
                    &shard.d_encoder
                } else {
                    &shard.d_actor
                },
            ));
        }
        for (name, p) in case.networks.critic_layers() {
            layers.push((name, p, true, &shard.d_critic));
        }
        for (name, p, is_critic, d) in layers {
            // Along the gradient itself the slope must be its length: one number that all weights of the layer enter.
            let own = &d[p.at..p.at + p.len];
            let length = adam::norm(&[own]);
            assert!(length > 1e-4, "{name}: dead, {length}");
            let change = |w: &mut Weights, h: f32| {
                let params = if is_critic { &mut w.critic } else { &mut w.actor };
                for (w, g) in params[p.at..p.at + p.len].iter_mut().zip(own) {
                    *w += h * (f64::from(*g) / length) as f32;
                }
            };
            let by_critic = is_critic || p.at < encoder;
            let found = slope(
                &case,
                mirror,
                change,
                |(critic, actor)| if by_critic { critic } else { actor },
            );
            assert!(
                (found - length).abs() < 0.01 * length + 1e-3,
                "{name}: slope {found}, gradient {length}"
            );
        }
    }
}

#[test]
fn the_actor_s_loss_stops_at_the_features() {
    let case = Case::new();
    let shard = case.shard(false);
    let encoder = case.networks.encoder_len();
    assert!(shard.d_actor[..encoder].iter().all(|g| *g == 0.0));
    assert!(shard.d_encoder[encoder..].iter().all(|g| *g == 0.0));
}

#[test]
fn a_weight_that_is_not_a_number_stops_training_by_name() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let config = TrainConfig::default();
    let networks = Arc::new(Networks::new().unwrap());
    let mut learner = Learner::new(networks, Isa::detect(), &config, &mut rng).unwrap();
    let case = Case::new();
    let before = learner.weights.clone();
    let mut bad = case.transition();
    bad.reward = f32::NAN;
    let error = learner.update(&[bad; 4], &mut rng).unwrap_err();
    assert!(
        error.to_string().contains("update 0: the loss of critic is not finite"),
        "{error}"
    );
    assert!(learner.weights == before);
}

#[test]
fn the_recurrent_part_is_the_graph_s_gru() {
    let case = Case::new();
    let n = &case.networks;
    let features: Vec<f32> = (0..ACTOR_FRAMES * n.encoder.output_len())
        .map(|i| libm::sinf(i as f32 * 0.7))
        .collect();
    let state = Recurrent::new(n.encoder.output_len())
        .forward(Isa::detect(), &case.arranged.actor, &features)
        .unwrap();
    let mut tape = vec![0.0; n.actor_recur.tape_len()];
    n.actor_recur
        .forward(Isa::detect(), &case.weights.actor, &five(&features), &mut tape)
        .unwrap();
    for (a, b) in state.iter().zip(n.actor_recur.output(&tape).unwrap()) {
        assert!((a - b).abs() < 1e-5, "{a} {b}");
    }
}

#[test]
fn drawn_frames_count_as_all_five_on_average() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for encoder_frames in 1..=ACTOR_FRAMES {
        let config = LearningConfig {
            encoder_frames,
            ..LearningConfig::default()
        };
        let mut sums = [0.0; ACTOR_FRAMES];
        for _ in 0..4000 {
            let augmentation = Augmentation::new(&config, &mut rng);
            assert_eq!(
                augmentation.frame_shares.iter().filter(|s| **s > 0.0).count(),
                encoder_frames
            );
            add(&mut sums, &augmentation.frame_shares);
        }
        let expected = if encoder_frames == 1 { 0.0 } else { 4000.0 };
        assert!(sums[..4].iter().all(|s| (s - expected).abs() < 400.0), "{sums:?}");
        assert_eq!(sums[4], 4000.0);
    }
}
