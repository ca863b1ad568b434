//! The iterations: from the loss's gradient to altered pixels.

use crate::config::{AttackConfig, AttackError, Method, PATCH_GAIN, REPLAYED_FRAMES, SPSA_QUERIES, SWELL_FRAMES};
use crate::detector_evasion::DetectorEvasion;
use crate::surrogate::{Ends, Surrogate};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use vigil_nnet::{Activation, Isa};
use vigil_policy::actor::{ACTOR_HIDDEN, ACTOR_LIMIT, ACTOR_OUTPUTS};
use vigil_types::{
    Attitude, DEPTH_COLS, DEPTH_FULL_SCALE_M, DEPTH_PIXELS, DEPTH_ROWS, NedVector, column_bearing_rad,
    row_elevation_rad,
};

/// The yaw output's limit before its saturation: 1.5 · tanh(10) is the limit to the last bit.
const LIMIT: f32 = 10.0;
/// Steps of the projected methods, in ε over iterations: enough to cross the whole range and come back (Madry et al., 2018).
const STEP_GAIN: f32 = 2.5;
/// [`Method::Recede`] leaves alone what is seen farther down than this, 20°: the ground near the vehicle.
const GROUND_BELOW_RAD: f32 = 0.349;
/// Height above the ground of states without a pose, metres: the flight height of most courses.
const STATES_HEIGHT_M: f32 = 1.5;
/// [`Method::Repaint`] takes for the ground what lies less than a tenth of its range before it.
const GROUND_PART: f32 = 0.9;
/// The patch's share of rows and columns; their product is 1 / [`PATCH_GAIN`].
const PATCH_ROWS: usize = 4;
const PATCH_COLS: usize = 8;

/// Outputs from their values before saturation, in the actor's own bits.
pub(crate) fn saturate(isa: Isa, mut before: [f32; ACTOR_OUTPUTS]) -> [f32; ACTOR_OUTPUTS] {
    Activation::Tanh { scale: ACTOR_LIMIT }.apply_in_place(isa, &mut before);
    before
}

/// The yaw limit on the side of `direction`, −1 left or 1 right, before its saturation.
pub(crate) fn limit(direction: f32) -> f32 {
    direction * LIMIT
}

/// A yaw output before its saturation.
pub(crate) fn before_saturation(yaw: f32) -> f32 {
    libm::atanhf(yaw / ACTOR_LIMIT).clamp(-LIMIT, LIMIT)
}

/// Alters pixels. One for each attacker; keeps its buffers.
#[derive(Debug, Clone)]
pub(crate) struct Perturber {
    pub config: AttackConfig,
    /// Frames attacked since the last reset: each draws from a stream of its own.
    calls: u64,
    clean: Vec<f32>,
    gradient: Vec<f32>,
    /// [`Method::Momentum`]: the running sum. [`Method::Patch`]: 1 within it. [`Method::Spsa`]: what is tried.
    extra: Vec<f32>,
    /// [`Method::Replay`]: what is shown again.
    kept: Vec<f32>,
    /// [`Method::Repaint`]: attitude and height above the ground, metres, from which the next frame was taken.
    seen_from: (Attitude, f32),
}

impl Perturber {
    pub fn new(config: AttackConfig) -> Result<Self, AttackError> {
        config.check()?;
        Ok(Self {
            config,
            calls: 0,
            clean: vec![0.0; DEPTH_PIXELS],
            gradient: vec![0.0; DEPTH_PIXELS],
            extra: vec![0.0; DEPTH_PIXELS],
            kept: match config.method {
                Method::Replay => vec![0.0; REPLAYED_FRAMES as usize * DEPTH_PIXELS],
                _ => Vec::new(),
            },
            seen_from: (Attitude::LEVEL_NORTH, STATES_HEIGHT_M),
        })
    }

    /// Whence the next frames are taken: attitude, and height above the ground in metres.
    pub fn see_from(&mut self, attitude: Attitude, height_m: f32) {
        self.seen_from = (attitude, height_m);
    }

    /// Draws from the beginning again.
    pub fn reset(&mut self) {
        self.calls = 0;
    }

    /// Alters `frame`, which `surrogate` looked at last and saw `before` (outputs before saturation). After each iteration
    /// `each` gets its number from 1, the outputs before saturation, and the frame; it says whether to go on. Returns
    /// the last outputs before saturation.
    pub fn run(
        &mut self,
        surrogate: &mut impl Surrogate,
        target: f32,
        frame: &mut [f32],
        before: [f32; ACTOR_OUTPUTS],
        mut evasion: Option<&mut DetectorEvasion>,
        mut each: impl FnMut(u32, [f32; ACTOR_OUTPUTS], &[f32]) -> bool,
    ) -> Result<[f32; ACTOR_OUTPUTS], AttackError> {
        let mut rng = ChaCha8Rng::seed_from_u64(self.config.seed);
        rng.set_stream(self.calls);
        let call = self.calls;
        self.calls = call.wrapping_add(1);
        self.clean.copy_from_slice(frame);
        let (method, epsilon) = (self.config.method, self.config.epsilon());
        let mut outputs = before;
        let iterations = match method {
            Method::Fgsm => 1,
            _ if method.alters_at_once() => {
                match method {
                    Method::Noise => {
                        let size = self.config.reach(frame.len());
                        for (x, clean) in frame.iter_mut().zip(&self.clean) {
                            let sign = if rng.random::<bool>() { size } else { -size };
                            *x = (clean + sign).clamp(0.0, 1.0);
                        }
                    }
                    Method::Recede => self.recede(1.0, frame),
                    Method::Swell => self.recede((call as f32 / SWELL_FRAMES as f32).min(1.0), frame),
                    Method::Repaint => self.repaint(frame),
                    Method::Blind => frame.fill(1.0),
                    _ => self.replay(call, frame),
                }
                self.spare_ahead(frame);
                outputs = surrogate.look(frame)?;
                each(self.config.iterations, outputs, frame);
                return Ok(outputs);
            }
            Method::Pgd => {
                for (x, clean) in frame.iter_mut().zip(&self.clean) {
                    *x = (clean + rng.random_range(-epsilon..=epsilon)).clamp(0.0, 1.0);
                }
                self.spare_ahead(frame);
                outputs = surrogate.look(frame)?;
                self.config.iterations
            }
            _ => self.config.iterations,
        };
        self.extra.fill(0.0);
        for iteration in 1..=iterations {
            if method == Method::Spsa {
                self.estimate(surrogate, target, frame, &mut rng)?;
            } else {
                let d = ends(surrogate, target, outputs, evasion.as_deref_mut())?;
                surrogate.gradient(&d, &mut self.gradient)?;
            }
            self.move_together();
            if method == Method::Patch && iteration == 1 {
                self.place_patch();
            }
            self.step(frame, epsilon, iterations);
            self.spare_ahead(frame);
            outputs = surrogate.look(frame)?;
            if !each(iteration, outputs, frame) {
                break;
            }
        }
        Ok(outputs)
    }

    /// Gives the pixels of each square of [`AttackConfig::region_pixels`] the mean of their gradients. Squares at the right and lower edge are
    /// cut off.
    fn move_together(&mut self) {
        let side = self.config.region_pixels as usize;
        if side == 1 {
            return;
        }
        for band in self.gradient.chunks_mut(side * DEPTH_COLS) {
            for left in (0..DEPTH_COLS).step_by(side) {
                let within = left..(left + side).min(DEPTH_COLS);
                let lines = band.chunks_exact(DEPTH_COLS);
                let (count, sum) = (
                    (lines.len() * within.len()) as f32,
                    lines.flat_map(|line| &line[within.clone()]).sum::<f32>(),
                );
                for line in band.chunks_exact_mut(DEPTH_COLS) {
                    line[within.clone()].fill(sum / count);
                }
            }
        }
    }

    /// One step down the loss.
    fn step(&mut self, frame: &mut [f32], epsilon: f32, iterations: u32) {
        let even = epsilon / iterations as f32;
        let projected = (STEP_GAIN * even).min(epsilon);
        match self.config.method {
            Method::Fgsm => self.along_sign(frame, epsilon, epsilon),
            Method::BimClipped | Method::Pgd => self.along_sign(frame, projected, epsilon),
            // A pixel cannot move by more than 1, so this projects nothing.
            Method::BimAccumulating | Method::Spsa => self.along_sign(frame, epsilon, 1.0),
            Method::Momentum => {
                let size = self.gradient.iter().map(|g| f64::from(g.abs())).sum::<f64>() / frame.len() as f64;
                let scale = if size > 0.0 { (1.0 / size) as f32 } else { 0.0 };
                for (sum, g) in self.extra.iter_mut().zip(&mut self.gradient) {
                    *sum += *g * scale;
                    *g = *sum;
                }
                self.along_sign(frame, even, epsilon);
            }
            Method::L2 => {
                let radius = f64::from(epsilon) * (frame.len() as f64).sqrt();
                let length = norm(self.gradient.iter().copied());
                if length > 0.0 {
                    let step = (f64::from(STEP_GAIN) / f64::from(iterations)).min(1.0) * radius;
                    let scale = (step / length) as f32;
                    let floor = self.config.floor();
                    for ((x, g), clean) in frame.iter_mut().zip(&self.gradient).zip(&self.clean) {
                        *x = (*x - scale * g).clamp(floor.min(*clean), 1.0);
                    }
                }
                let moved = norm(frame.iter().zip(&self.clean).map(|(x, clean)| x - clean));
                if moved > radius {
                    let shrink = (radius / moved) as f32;
                    for (x, clean) in frame.iter_mut().zip(&self.clean) {
                        *x = (clean + shrink * (*x - clean)).clamp(0.0, 1.0);
                    }
                }
            }
            Method::Patch => {
                for (g, inside) in self.gradient.iter_mut().zip(&self.extra) {
                    *g *= inside;
                }
                self.along_sign(frame, PATCH_GAIN * projected, PATCH_GAIN * epsilon);
            }
            // Make no steps.
            Method::Noise | Method::Recede | Method::Swell | Method::Repaint | Method::Blind | Method::Replay => {}
        }
    }

    /// `x − step · sign(g)`, within `reach` of the clean pixel and 0..=1, and not nearer than [`AttackConfig::floor`] if it was not already.
    fn along_sign(&self, frame: &mut [f32], step: f32, reach: f32) {
        let floor = self.config.floor();
        for ((x, g), clean) in frame.iter_mut().zip(&self.gradient).zip(&self.clean) {
            let sign = if *g > 0.0 { step } else { 0.0 } - if *g < 0.0 { step } else { 0.0 };
            // Not `clamp`: its check of the bounds keeps the compiler from vectors.
            let least = (clean - reach).max(floor.min(*clean));
            *x = (*x - sign).max(least).min((clean + reach).min(1.0));
        }
    }

    /// Keeps what passes first, and then shows it again.
    fn replay(&mut self, call: u64, frame: &mut [f32]) {
        let slot = (call % REPLAYED_FRAMES) as usize * frame.len();
        let kept = &mut self.kept[slot..slot + frame.len()];
        if call < REPLAYED_FRAMES {
            kept.copy_from_slice(frame);
        } else {
            frame.copy_from_slice(kept);
        }
    }

    /// An estimate of the loss's gradient from the yaw output alone: all pixels, or squares of them, are moved to and fro by ε at once, by
    /// random signs, and the loss's difference counts for each of them by its sign.
    fn estimate(
        &mut self,
        surrogate: &mut impl Surrogate,
        target: f32,
        frame: &[f32],
        rng: &mut ChaCha8Rng,
    ) -> Result<(), AttackError> {
        let (epsilon, side) = (self.config.epsilon(), self.config.region_pixels as usize);
        // Nobody who sees decisions alone sees more than the saturated output.
        let yaw_of = |before: f32| ACTOR_LIMIT * libm::tanhf(before);
        let aim = yaw_of(target);
        let per_row = DEPTH_COLS.div_ceil(side);
        self.gradient.fill(0.0);
        for _ in 0..SPSA_QUERIES / 2 {
            let stream = rng.random::<u64>();
            let mut difference = 0.0;
            for way in [1.0, -1.0] {
                for (row, (to, from)) in self
                    .extra
                    .chunks_exact_mut(DEPTH_COLS)
                    .zip(frame.chunks_exact(DEPTH_COLS))
                    .enumerate()
                {
                    for (col, (to, from)) in to.iter_mut().zip(from).enumerate() {
                        let sign = sign_of(stream, row / side * per_row + col / side);
                        *to = (from + way * epsilon * sign).clamp(0.0, 1.0);
                    }
                }
                let outputs = surrogate.look(&self.extra)?;
                let error = yaw_of(outputs[1]) - aim;
                difference += way * error * error;
            }
            for (row, line) in self.gradient.chunks_exact_mut(DEPTH_COLS).enumerate() {
                for (col, g) in line.iter_mut().enumerate() {
                    *g += difference * sign_of(stream, row / side * per_row + col / side);
                }
            }
        }
        Ok(())
    }

    /// Shows everything that is seen above [`GROUND_BELOW_RAD`] farther away, by a share of the reach. What gives no return goes on
    /// giving none.
    fn recede(&self, share: f32, frame: &mut [f32]) {
        let by = share * self.config.reach(frame.len());
        let above = |row: &usize| row_elevation_rad(*row as f32) >= -GROUND_BELOW_RAD;
        let rows = (0..DEPTH_ROWS).take_while(above).count();
        for x in frame[..rows * DEPTH_COLS].iter_mut().filter(|x| **x < 1.0) {
            *x = (*x + by).min(1.0);
        }
    }

    /// Shows everything but the ground farther away, by the reach, and paints before it the flat ground that would be seen there.
    fn repaint(&self, frame: &mut [f32]) {
        let by = self.config.reach(frame.len());
        let (attitude, height_m) = self.seen_from;
        let down = attitude.to_frd(NedVector::new(0.0, 0.0, 1.0));
        for (row, line) in frame.chunks_exact_mut(DEPTH_COLS).enumerate() {
            let (up, level) = libm::sincosf(row_elevation_rad(row as f32));
            for (col, x) in line.iter_mut().enumerate().filter(|(_, x)| **x < 1.0) {
                let (right, ahead) = libm::sincosf(column_bearing_rad(col as f32));
                let falls = level * (down.x * ahead + down.y * right) - down.z * up;
                let ground = match falls > 0.0 {
                    true => height_m / (falls * DEPTH_FULL_SCALE_M),
                    false => f32::INFINITY,
                };
                if *x < GROUND_PART * ground {
                    *x = (*x + by).min(ground).min(1.0);
                }
            }
        }
    }

    /// Leaves the columns within [`AttackConfig::truthful_ahead_deg`] of the nose as they were.
    fn spare_ahead(&self, frame: &mut [f32]) {
        let spared_rad = self.config.truthful_ahead_deg.to_radians();
        if spared_rad == 0.0 {
            return;
        }
        let is_spared = |col: &usize| column_bearing_rad(*col as f32).abs() <= spared_rad;
        let spared = (0..DEPTH_COLS).filter(is_spared);
        let (Some(first), count) = (spared.clone().next(), spared.count()) else {
            return;
        };
        let lines = frame
            .chunks_exact_mut(DEPTH_COLS)
            .zip(self.clean.chunks_exact(DEPTH_COLS));
        for (line, clean) in lines {
            line[first..first + count].copy_from_slice(&clean[first..first + count]);
        }
    }

    /// Finds the patch, in half-patch strides, with the largest sum of gradients.
    fn place_patch(&mut self) {
        let (height, width) = (DEPTH_ROWS / PATCH_ROWS, DEPTH_COLS / PATCH_COLS);
        let weight = |top: usize, left: usize| -> f64 {
            let lines = self.gradient.chunks_exact(DEPTH_COLS).skip(top).take(height);
            lines
                .flat_map(|line| line.iter().skip(left).take(width))
                .map(|g| f64::from(g.abs()))
                .sum()
        };
        let mut best = (f64::NEG_INFINITY, 0, 0);
        for top in (0..=DEPTH_ROWS - height).step_by(height / 2) {
            for left in (0..=DEPTH_COLS - width).step_by(width / 2) {
                let sum = weight(top, left);
                if sum > best.0 {
                    best = (sum, top, left);
                }
            }
        }
        let (_, top, left) = best;
        for line in self.extra.chunks_exact_mut(DEPTH_COLS).skip(top).take(height) {
            line[left..left + width].fill(1.0);
        }
    }
}

/// Where the gradient of this iteration begins. The loss is the squared distance of the yaw, before its saturation, to the target. An attacker
/// who evades goes down the detector's score instead whenever that is too high (Bryniarski et al., "Evading Adversarial
/// Example Detection Defenses with Orthogonal Projected Gradient Descent", 2022: the selective variant).
fn ends(
    surrogate: &impl Surrogate,
    target: f32,
    outputs: [f32; ACTOR_OUTPUTS],
    evasion: Option<&mut DetectorEvasion>,
) -> Result<Ends, AttackError> {
    let mut d: Ends = [0.0; ACTOR_OUTPUTS + ACTOR_HIDDEN];
    if let Some(evasion) = evasion {
        let state = surrogate.state()?;
        if evasion.look(state)? > 0.0 {
            d[ACTOR_OUTPUTS..].copy_from_slice(&evasion.gradient(state)?);
            return Ok(d);
        }
    }
    d[1] = 2.0 * (outputs[1] - target);
    Ok(d)
}

/// A random sign for each number of a stream (the finaliser of SplitMix64).
fn sign_of(stream: u64, number: usize) -> f32 {
    let mut z = stream.wrapping_add((number as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    if (z ^ (z >> 31)) & 1 == 0 { 1.0 } else { -1.0 }
}

fn norm(values: impl Iterator<Item = f32>) -> f64 {
    values.map(|v| f64::from(v) * f64::from(v)).sum::<f64>().sqrt()
}
