//! What the actor observes, as the trainer stores it and sees it in a mirror, and how an environment makes it.

use std::sync::Arc;
use vigil_nnet::{Aligned, Isa, ShapeError};
use vigil_policy::actor::memory::{CONTEXT, MOVED, Odometry, RING, SCAN, SCAN_AGES, TRAIL};
use vigil_policy::actor::senses::{LOW_DIM, Senses};
use vigil_policy::actor::{ActorSpec, FrameEncoder};
use vigil_policy::{PilotInput, RangeScan};
use vigil_types::{Action, Attitude, DepthFrame, wrap_pi};

/// Values of the first half's input: the scan, then what is remembered.
pub const FIRST_HALF: usize = SCAN + CONTEXT;
/// Values of an observation: the first half's, then the low-dimensional ones.
pub const OBSERVATION: usize = FIRST_HALF + LOW_DIM;

/// Turns an observation into that of a mirrored world: left and right change places.
pub fn mirror(observation: &mut [f32]) {
    let (scan, rest) = observation.split_at_mut(SCAN);
    scan.reverse();
    let (moved, rest) = rest.split_at_mut(SCAN_AGES.len() * MOVED);
    moved.chunks_exact_mut(MOVED).for_each(<[f32]>::reverse);
    let (ring, rest) = rest.split_at_mut(2 * RING);
    // The first bin is ahead, or of the trail likewise.
    ring.chunks_exact_mut(RING).for_each(|bins| bins[1..].reverse());
    let (trail, low) = rest.split_at_mut(TRAIL);
    trail[1..].reverse();
    for k in [1, 4, 5, 7] {
        low[k] = -low[k];
    }
}

/// The frozen encoder.
pub struct Encoder {
    frames: FrameEncoder,
    isa: Isa,
    params: Aligned,
}

impl Encoder {
    /// Of these parameters.
    pub fn new(isa: Isa, encoder: &[f32]) -> Result<Self, ShapeError> {
        let (frames, params) = (FrameEncoder::new(ActorSpec::FULL)?, Aligned::from(encoder));
        Ok(Self { frames, isa, params })
    }
}

/// Observes step by step, as the actor in flight does.
pub struct Observer {
    encoder: Arc<Encoder>,
    frames: FrameEncoder,
    senses: Senses,
    drifting: Drifting,
    /// The newest observation.
    pub now: [f32; OBSERVATION],
}

/// How the odometry that the memory gets differs from the estimate.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize, clap::Args)]
pub struct Drift {
    /// The odometry that the actor remembers by seems longer by this share of the path ...
    #[arg(long = "drift-scale", value_name = "SHARE")]
    #[arg(default_value_t = 0.0, allow_negative_numbers = true)]
    pub scale: f32,

    /// Turning of the odometry that is none of the vehicle's, radians per second.
    #[arg(long = "drift-yaw", value_name = "DEG_S", value_parser = radians)]
    #[arg(help = "... and turns by so much that the vehicle does not, degrees per second")]
    #[arg(default_value_t = 0.0, allow_negative_numbers = true)]
    pub yaw_rad_s: f32,
}

/// Takes degrees.
fn radians(degrees: &str) -> Result<f32, std::num::ParseFloatError> {
    degrees.parse().map(f32::to_radians)
}

/// Odometry as an estimator that drifts would have it.
#[derive(Debug, Clone)]
pub struct Drifting {
    drift: Drift,
    /// Where the vehicle last was by the estimate, and by odometry that drifts.
    last: Option<(Odometry, Odometry)>,
    frame: Box<DepthFrame>,
}

impl Drifting {
    /// At the start of a flight.
    pub fn new(drift: Drift) -> Self {
        Self {
            drift,
            last: None,
            frame: Box::new(DepthFrame::EMPTY),
        }
    }

    /// What the estimate becomes.
    pub fn of(&mut self, at: Odometry) -> Odometry {
        let drifted = match self.last {
            Some((truly, believed)) => {
                let waited_s = at.at_ns.saturating_sub(truly.at_ns) as f32 * 1e-9;
                let turned_rad = wrap_pi(at.yaw_rad - truly.yaw_rad) + self.drift.yaw_rad_s * waited_s;
                let yaw_rad = wrap_pi(believed.yaw_rad + turned_rad);
                let moved = (at.position_ned_m - truly.position_ned_m)
                    .to_heading(at.yaw_rad)
                    .to_ned(yaw_rad);
                Odometry {
                    at_ns: at.at_ns,
                    position_ned_m: believed.position_ned_m + moved * (1.0 + self.drift.scale),
                    yaw_rad,
                }
            }
            None => at,
        };
        self.last = Some((at, drifted));
        drifted
    }

    /// Hands a pilot's input whose position and heading have drifted to `decide`; the goal is where it is.
    pub fn with<T>(&mut self, input: &PilotInput<'_>, decide: impl FnOnce(&PilotInput<'_>) -> T) -> T {
        if self.drift == Drift::default() {
            return decide(input);
        }
        let drifted = self.of(Odometry::of(input));
        self.frame.as_mut().clone_from(input.depth);
        let moved = RangeScan::moved_since_capture_m(input);
        self.frame.header.position_ned_m = drifted.position_ned_m - moved;
        decide(&PilotInput {
            depth: &self.frame,
            // Of the attitude now an actor takes the heading alone.
            attitude: Attitude::from_euler_rad(0.0, 0.0, drifted.yaw_rad),
            ..*input
        })
    }
}

impl Observer {
    /// One that has seen nothing.
    pub fn new(encoder: Arc<Encoder>, drift: Drift) -> Self {
        Self {
            frames: encoder.frames.clone(),
            senses: Senses::default(),
            encoder,
            drifting: Drifting::new(drift),
            now: [0.0; OBSERVATION],
        }
    }

    /// Takes a step's frame and odometry; `last` is the action before it.
    pub fn observe(&mut self, input: &PilotInput<'_>, last: Action) -> Result<(), ShapeError> {
        let Encoder { isa, params, .. } = &*self.encoder;
        let mut scan = [0.0; SCAN];
        self.frames.encode(*isa, params, &input.depth.depth, &mut scan)?;
        let odometry = self.drifting.of(Odometry::of(input));
        let low = self.senses.observe(&scan, odometry, input, last);
        self.now[..SCAN].copy_from_slice(&scan);
        self.now[SCAN..FIRST_HALF].copy_from_slice(self.senses.context());
        self.now[FIRST_HALF..].copy_from_slice(&low);
        Ok(())
    }
}
