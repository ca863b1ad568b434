//! What an actor decides from beside its frames: where it is led and, if its file asks for it, what moves near it.
//!
//! Five frames show a GRU over them badly how a thing moves, while a Kalman filter over the same
//! frames knows it to a few centimetres per second. So an actor may be told the tracks of [`MoverTracker`] as further positional inputs.

use crate::actor::ActorInputs;
use crate::geometric::movers::{MoverTracker, Track};
use crate::geometric::position_ned_m;
use crate::geometric::range_scan::Scan;
use crate::seeing::LOW_DIM;
use crate::{PilotInput, larger, smaller};
use vigil_types::{GoalRelative, NedVector};

/// Distance that the actor's first positional input counts as 1, metres.
pub const DISTANCE_SCALE_M: f32 = 20.0;
/// A goal farther away looks to the actor as if it were this far: its courses' goals are 20.6 m away, and nothing beyond was
/// ever shown to it, metres.
pub const FARTHEST_KNOWN_M: f32 = 21.0;
/// Bearing that its second positional input counts as 1, radians.
pub const BEARING_SCALE_RAD: f32 = 1.0;

/// Positional inputs of an actor that is told of the goal alone: distance and bearing.
pub const GOAL_INPUTS: usize = 2;
/// Movers that an actor is told of: the nearest.
const MOVERS: usize = 2;
const MOVER_INPUTS: usize = 6;
const OWN_INPUTS: usize = 2;
/// Positional inputs of an actor that is told of movers.
pub const WITH_MOVERS: usize = GOAL_INPUTS + OWN_INPUTS + MOVERS * MOVER_INPUTS;

/// Own speed that counts as 1, metres per second.
const SPEED_SCALE_M_S: f32 = 1.5;
/// A gap to a mover of this length counts as a half, metres.
const CONTRAST_M: f32 = 3.0;
/// A mover that is not seen is told for so long, seconds.
const TOLD_S: f32 = 6.0;
/// Whose middle is nearer than its radius has no direction, metres.
const LEAST_WAY_M: f32 = 1e-3;

/// An actor's positional inputs: 2 or 16 values, or the 8 of [`LOW_DIM`].
///
/// | Values | |
/// | --- | --- |
/// | 0, 1 | distance to the goal, at most [`FARTHEST_KNOWN_M`], in units of [`DISTANCE_SCALE_M`]; bearing of the goal or of the path in units of [`BEARING_SCALE_RAD`] |
/// | 2, 3 | own velocity forward and right in level axes along the heading, in units of 1.5 m/s |
/// | 4 to 9 | the nearest mover: 1 / (1 + gap / 3 m); that times its direction, forward and right; its velocity forward and right, m/s; 1 while it is seen, falling to 0 in the 6 s after |
/// | 10 to 15 | the next one |
///
/// All six are 0 where there is no mover.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PositionalInputs {
    values: [f32; WITH_MOVERS],
    len: usize,
}

impl PositionalInputs {
    /// Of an actor that is told of the goal alone.
    pub fn of_goal(goal: GoalRelative) -> Self {
        goal_inputs(goal).into()
    }

    /// Of an actor that decides from `inputs`: one that is told of movers stands still and has seen nothing move.
    pub fn at_rest(goal: impl Into<Self>, inputs: ActorInputs) -> Self {
        let len = if inputs.told_of_movers {
            WITH_MOVERS
        } else {
            GOAL_INPUTS
        };
        Self { len, ..goal.into() }
    }

    /// Those of a record, as they were given to an actor; `None` for a number of values that no actor has.
    pub fn from_values(recorded: &[f32]) -> Option<Self> {
        let mut values = [0.0; WITH_MOVERS];
        let to = values.get_mut(..recorded.len())?;
        to.copy_from_slice(recorded);
        matches!(recorded.len(), GOAL_INPUTS | LOW_DIM | WITH_MOVERS).then_some(Self {
            values,
            len: recorded.len(),
        })
    }

    fn with_movers(mut self, input: &PilotInput<'_>, tracker: &MoverTracker) -> Self {
        self.len = WITH_MOVERS;
        let (_, told) = self.values.split_at_mut(GOAL_INPUTS);
        let (own, told) = told.split_at_mut(OWN_INPUTS);
        let velocity = input.velocity_m_s;
        own.copy_from_slice(&[velocity.x / SPEED_SCALE_M_S, velocity.y / SPEED_SCALE_M_S]);
        let (here, yaw_rad) = (position_ned_m(input), input.attitude.yaw_rad());
        let mut nearest: [Option<(f32, &Track)>; MOVERS] = [None; MOVERS];
        for track in tracker.movers().filter(|track| track.unseen_s() < TOLD_S) {
            let way_m = libm::hypotf(track.north_m - here.x, track.east_m - here.y);
            let mut candidate = Some((larger(way_m - track.radius_m, 0.0), track));
            for slot in &mut nearest {
                let is_nearer = match (&candidate, &*slot) {
                    (Some((gap_m, _)), Some((other_m, _))) => gap_m < other_m,
                    (candidate, slot) => candidate.is_some() && slot.is_none(),
                };
                if is_nearer {
                    core::mem::swap(slot, &mut candidate);
                }
            }
        }
        for (slot, (gap_m, track)) in told.chunks_exact_mut(MOVER_INPUTS).zip(nearest.iter().flatten()) {
            let to = NedVector::new(track.north_m - here.x, track.east_m - here.y, 0.0).to_heading(yaw_rad);
            let velocity = NedVector::new(track.north_m_s, track.east_m_s, 0.0).to_heading(yaw_rad);
            let near = 1.0 / (1.0 + gap_m / CONTRAST_M);
            let way_m = larger(libm::hypotf(to.x, to.y), LEAST_WAY_M);
            slot.copy_from_slice(&[
                near,
                near * to.x / way_m,
                near * to.y / way_m,
                velocity.x,
                velocity.y,
                1.0 - track.unseen_s() / TOLD_S,
            ]);
        }
        self
    }
}

impl From<GoalRelative> for PositionalInputs {
    fn from(goal: GoalRelative) -> Self {
        Self::of_goal(goal)
    }
}

impl From<[f32; GOAL_INPUTS]> for PositionalInputs {
    /// The values of an actor that is told of the goal alone.
    fn from(goal: [f32; GOAL_INPUTS]) -> Self {
        let mut values = [0.0; WITH_MOVERS];
        if let Some(first) = values.first_chunk_mut() {
            *first = goal;
        }
        Self {
            values,
            len: GOAL_INPUTS,
        }
    }
}

impl From<[f32; LOW_DIM]> for PositionalInputs {
    /// The low-dimensional observation of an actor that looks and remembers.
    fn from(low_dim: [f32; LOW_DIM]) -> Self {
        let mut values = [0.0; WITH_MOVERS];
        if let Some(first) = values.first_chunk_mut() {
            *first = low_dim;
        }
        Self { values, len: LOW_DIM }
    }
}

impl core::ops::Deref for PositionalInputs {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        self.values.get(..self.len).unwrap_or_default()
    }
}

/// What an actor is told of the goal, the first positional inputs.
pub fn goal_inputs(goal: GoalRelative) -> [f32; GOAL_INPUTS] {
    [
        smaller(goal.distance_m, FARTHEST_KNOWN_M) / DISTANCE_SCALE_M,
        goal.bearing_rad / BEARING_SCALE_RAD,
    ]
}

/// Makes an actor's positional inputs, step by step: follows what moves, if the actor is told of it. No allocation.
#[derive(Debug, Clone)]
pub struct PositionalSense {
    tracker: Option<MoverTracker>,
    last_sequence: Option<u64>,
}

impl PositionalSense {
    /// One that has seen nothing.
    pub fn new(told_of_movers: bool) -> Self {
        Self {
            tracker: told_of_movers.then(MoverTracker::new),
            last_sequence: None,
        }
    }

    /// The inputs of a step in which the actor is led to `goal`. `scan` is what the step's frame shows
    /// ([`RangeScan::observe`](crate::geometric::range_scan::RangeScan::observe)); to be asked once in every step.
    pub fn inputs(&mut self, input: &PilotInput<'_>, scan: &Scan, goal: GoalRelative) -> PositionalInputs {
        let inputs = PositionalInputs::of_goal(goal);
        let Some(tracker) = &mut self.tracker else {
            return inputs;
        };
        let header = &input.depth.header;
        if self.last_sequence != Some(header.sequence) {
            self.last_sequence = Some(header.sequence);
            tracker.observe(scan, position_ned_m(input), input.attitude.yaw_rad(), header.stamp_ns);
        }
        inputs.with_movers(input, tracker)
    }

    /// Forgets what it has seen.
    pub fn reset(&mut self) {
        self.last_sequence = None;
        if let Some(tracker) = &mut self.tracker {
            tracker.clear();
        }
    }
}
