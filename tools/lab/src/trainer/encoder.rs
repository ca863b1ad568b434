//! What the encoder learns before it is frozen: the collision scan, from single frames taken anywhere on courses of all families. There
//! is no teacher but the simulator, and afterwards a frame is encoded once, not in each of the transitions that hold it.

use crate::trainer::config::EncoderConfig;
use crate::trainer::learner::finite;
use crate::trainer::noise::normal;
use anyhow::Result;
use core::f32::consts::{PI, TAU};
use core::sync::atomic::{AtomicBool, Ordering};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use vigil_nnet::train::adam::{self, Adam};
use vigil_nnet::{Aligned, Graph, Isa, Purpose, ShapeError};
use vigil_policy::actor::ActorSpec;
use vigil_policy::actor::memory::{SCAN, proximity, scan_bearing_rad};
use vigil_sim::environment::true_state::TruePlan;
use vigil_sim::world::{Course, Family, Lidar, LidarConfig, Shot, World, generate};
use vigil_types::{Attitude, DEPTH_COLS, DepthFrame, NedVector};

/// Parts of a batch; fixed, so that the sums do not depend on the threads.
const SHARDS: usize = 4;
/// Seeds of the courses whose frames teach the encoder; no others use them.
const FIRST_SEED: u64 = 900_000_000;
const STREAM: u64 = 1 << 40;
const GRADIENT_NORM: f32 = 5.0;
/// Frames taken on one course before the next.
const FRAMES_A_COURSE: u32 = 48;
const FAMILIES: [Family; 4] = [Family::Training, Family::Validation, Family::Dense, Family::Hard];
/// Standard deviation of roll and pitch, and their limit, radians.
const TILT_RAD: f32 = 0.09;
const MOST_TILT_RAD: f32 = 0.35;
/// Standard deviation of the height about the course's, metres.
const HEIGHT_M: f32 = 0.12;
/// The middle of the vehicle is at least so far from everything, metres.
const CLEAR_M: f32 = 0.3;
/// Movers are met within this time of a flight.
const TIME_NS: u64 = 90_000_000_000;

/// Takes frames anywhere.
struct Photographer {
    rng: ChaCha8Rng,
    next_seed: u64,
    left: u32,
    course: Course,
    world: World,
    plan: TruePlan,
    lidar: Lidar,
    frame: Box<DepthFrame>,
    target: [f32; SCAN],
}

impl Photographer {
    fn new(seed: u64, number: u64) -> Self {
        let first_seed = FIRST_SEED.wrapping_add(seed << 22).wrapping_add(number << 18);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(STREAM + 1 + number);
        let course = generate(Family::Training, first_seed);
        Self {
            next_seed: first_seed,
            left: 0,
            world: World::new(&course),
            plan: TruePlan::new(&course),
            lidar: Lidar::new(LidarConfig::default(), rng.random()).unwrap_or_else(|e| panic!("{e}")),
            frame: Box::new(DepthFrame::EMPTY),
            target: [0.0; SCAN],
            rng,
            course,
        }
    }

    /// Takes the next frame, and the scan that it should give.
    fn take(&mut self) -> &mut Self {
        if self.left == 0 {
            let family = FAMILIES[self.rng.random_range(0..FAMILIES.len())];
            self.course = generate(family, self.next_seed);
            self.next_seed += 1;
            (self.world, self.plan) = (World::new(&self.course), TruePlan::new(&self.course));
            self.left = FRAMES_A_COURSE;
        }
        self.left -= 1;
        let at_ns = self.rng.random_range(0..TIME_NS);
        self.world.set_time_ns(at_ns);
        let b = &self.course.bounds;
        let height_m = self.course.flight_height_m;
        let position_ned_m = loop {
            let north = self.rng.random_range(b.north_m[0]..b.north_m[1]);
            let east = self.rng.random_range(b.east_m[0]..b.east_m[1]);
            let here = NedVector::new(north, east, -(height_m + HEIGHT_M * normal(&mut self.rng)));
            if self.world.clearance_m(here) > CLEAR_M {
                break here;
            }
        };
        let yaw_rad = self.rng.random_range(-PI..PI);
        let mut tilt = || (TILT_RAD * normal(&mut self.rng)).clamp(-MOST_TILT_RAD, MOST_TILT_RAD);
        let attitude = Attitude::from_euler_rad(tilt(), tilt(), yaw_rad);
        let shot = Shot {
            stamp_ns: at_ns,
            sequence: self.rng.random(),
            ..Shot::at(position_ned_m, attitude)
        };
        self.lidar.capture(&self.world, &shot, &mut self.frame);
        let yaw_rad = attitude.yaw_rad();
        let directions = (0..SCAN).map(|k| (yaw_rad + scan_bearing_rad(k)).rem_euclid(TAU));
        let ranges_m = self.plan.free_ranges_m(position_ned_m, at_ns, directions);
        for (target, range_m) in self.target.iter_mut().zip(ranges_m) {
            *target = proximity(range_m);
        }
        self
    }
}

struct Shard {
    photographer: Photographer,
    tape: Aligned,
    work: Aligned,
    d_encoder: Aligned,
    loss: f32,
}

impl Shard {
    /// Loss and gradient of fresh frames; `count` is the number of values in the whole batch.
    fn add_up(
        &mut self,
        graph: &Graph,
        isa: Isa,
        (params, packed): (&[f32], &[f32]),
        frames: usize,
        count: f32,
    ) -> Result<(), ShapeError> {
        self.d_encoder.fill(0.0);
        self.loss = 0.0;
        for _ in 0..frames {
            let Photographer { rng, frame, target, .. } = self.photographer.take();
            if rng.random_bool(0.5) {
                target.reverse();
                frame.depth.chunks_exact_mut(DEPTH_COLS).for_each(<[f32]>::reverse);
            }
            graph.forward(isa, params, &[&frame.depth], &mut self.tape)?;
            let mut d = [0.0; SCAN];
            let seen = graph.output(&self.tape)?;
            for ((d, seen), target) in d.iter_mut().zip(seen).zip(&*target) {
                let error = seen - target;
                self.loss += error * error / count;
                *d = 2.0 * error / count;
            }
            let gradient = Some(&mut self.d_encoder[..]);
            graph.backward(isa, packed, &self.tape, &d, gradient, &mut self.work)?;
        }
        Ok(())
    }
}

/// First weights: the variance is kept, and each filter's weights sum to 0, so that what all frames have in common does not pass.
fn initial(spec: ActorSpec, rng: &mut ChaCha8Rng) -> (Vec<f32>, Vec<f32>) {
    let (mut params, mut shares) = (Vec::new(), Vec::new());
    for layer in spec.convolutions() {
        let fan_in = layer.kernel * layer.kernel * layer.channels;
        // ELU passes on about two thirds of the variance; frames vary less than features do.
        let limit = if layer.channels == 1 { 4.0 } else { 1.0 } * (4.5 / fan_in as f32).sqrt();
        let mut weights: Vec<f32> = (0..layer.weight_len())
            .map(|_| rng.random_range(-limit..limit))
            .collect();
        for filter in 0..layer.filters {
            let mean = weights.iter().skip(filter).step_by(layer.filters).sum::<f32>() / fan_in as f32;
            for w in weights.iter_mut().skip(filter).step_by(layer.filters) {
                *w -= mean;
            }
        }
        params.extend(weights);
        params.resize(params.len() + layer.filters, 0.0);
        shares.resize(params.len(), (64.0 / fan_in as f32).min(1.0));
    }
    let scan = spec.scan();
    let limit = (1.0 / scan.inputs as f32).sqrt();
    params.extend((0..scan.weight_len()).map(|_| rng.random_range(-limit..limit)));
    // A proximity of 0.3 at first.
    params.resize(params.len() + scan.outputs, -0.85);
    shares.resize(params.len(), (64.0 / scan.inputs as f32).min(1.0));
    (params, shares)
}

/// Teaches an encoder; returns its parameters, or none where it was stopped. `report` gets the mean squared error of the proximity after each
/// hundred updates.
///
/// # Errors
/// A loss that is not finite.
pub fn teach_encoder(
    config: &EncoderConfig,
    seed: u64,
    isa: Isa,
    stop: &AtomicBool,
    report: &mut (dyn FnMut(u64, f32) + Send),
) -> Result<Option<Vec<f32>>> {
    let spec = ActorSpec::FULL;
    let graph = spec.encoder_graph(Purpose::Gradients, false)?;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(STREAM);
    let (mut params, shares) = initial(spec, &mut rng);
    let len = params.len();
    params.resize(graph.param_len(), 0.0);
    let mut adam = Adam::new(len);
    let mut packed = vec![0.0; params.len()];
    let shard = |number: u64| Shard {
        photographer: Photographer::new(seed, number),
        tape: Aligned::zeros(graph.tape_len()),
        work: Aligned::zeros(graph.work_len()),
        d_encoder: Aligned::zeros(graph.param_len()),
        loss: 0.0,
    };
    let mut shards: Vec<Shard> = (0..SHARDS as u64).map(shard).collect();
    let mut mean_loss = 0.0;
    for update in 0..config.updates {
        if stop.load(Ordering::Relaxed) {
            return Ok(None);
        }
        graph.pack(&params, &mut packed)?;
        let share = config.batch.div_ceil(SHARDS);
        let count = (share * SHARDS * SCAN) as f32;
        let each = |shard: &mut Shard| shard.add_up(&graph, isa, (&params, &packed), share, count);
        shards.par_iter_mut().try_for_each(each)?;
        let (total, others) = shards.split_at_mut(1);
        let total = &mut total[0];
        for other in others {
            total.loss += other.loss;
            let pairs = total.d_encoder.iter_mut().zip(&*other.d_encoder);
            pairs.for_each(|(to, from)| *to += from);
        }
        let d = &mut total.d_encoder[..len];
        let norm = adam::norm(d);
        finite(update, "gradient", "encoder", norm as f32)?;
        let scale = adam::shortening(norm, GRADIENT_NORM);
        let rate = config.rate * (1.0 - 0.97 * (update as f32 / config.updates as f32));
        adam.step_by_shares(rate, &shares, scale, &mut params[..len], d);
        mean_loss += total.loss / 100.0;
        if (update + 1).is_multiple_of(100) {
            report(update + 1, mean_loss);
            mean_loss = 0.0;
        }
    }
    params.truncate(len);
    Ok(Some(params))
}
