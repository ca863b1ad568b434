//! The true state: what an expert and a critic know of a flight while training, and no pilot in flight.

use super::shortest_path::{HALF_BAND_M, ShortestPath};
use crate::vehicle::Truth;
use crate::world::{Course, Mover, Rectangle, Solid, VEHICLE};
use core::f32::consts::{PI, TAU};
use vigil_types::{GoalRelative, NedVector};

/// Ranges all around, the first ahead, then clockwise.
pub const RAYS: usize = 48;
/// Directions in which the length of the path is compared, the first ahead, then clockwise.
const DIRECTIONS: usize = 8;
/// Nearest movers that are observed.
const MOVERS: usize = 2;
const MOVER_VALUES: usize = 6;
const OWN: usize = RAYS;
const OWN_VALUES: usize = 7;
const WAY: usize = OWN + OWN_VALUES;
/// Where the nearest mover's values begin.
pub const MOVER: usize = WAY + DIRECTIONS;
/// Values of a true state: [`RAYS`] contrasts 1 / (1 + range / 3 m); velocity forward and right / 1.5 m/s, yaw rate / 45 °/s, goal's
/// distance / 20 m, sine and cosine of its bearing, length of the path / 20 m; what a metre in each of 8 directions adds to that
/// length; of the two nearest movers contrast, direction times contrast (forward, right), velocity (forward, right; m/s), seconds
/// until it turns / 5.
pub const TRUE_STATE: usize = MOVER + MOVERS * MOVER_VALUES;

const CONTRAST_M: f32 = 3.0;
const SPEED_M_S: f32 = 1.5;
const DISTANCE_M: f32 = 20.0;
const TURN_RAD_S: f32 = PI / 4.0;
const TURN_AHEAD_S: f32 = 5.0;
/// A mover's velocity is the difference over this time.
const MOVER_STEP_NS: u64 = 10_000_000;

/// A course as the true state sees it.
pub struct TrueCourse {
    path: ShortestPath,
    plan: TruePlan,
}

/// A solid in the plan view.
#[derive(Clone, Copy)]
enum Outline {
    Circle { at: [f32; 2], radius_m: f32 },
    Rectangle(Rectangle),
}

impl Outline {
    /// The outline grown by a disc: a rectangle becomes two, and a circle at each corner.
    fn grown(self, by_m: f32) -> Vec<Self> {
        match self {
            Self::Circle { at, radius_m } => vec![Self::Circle {
                at,
                radius_m: radius_m + by_m,
            }],
            Self::Rectangle(inner) => {
                let [length, width] = inner.half_m;
                let sides = [[length + by_m, width], [length, width + by_m]]
                    .map(|half_m| Self::Rectangle(Rectangle { half_m, ..inner }));
                let round = inner.corners().map(|at| Self::Circle { at, radius_m: by_m });
                sides.into_iter().chain(round).collect()
            }
        }
    }

    fn of(solid: &Solid) -> Self {
        let circle = || Self::Circle {
            at: [solid.centre_ned_m().x, solid.centre_ned_m().y],
            radius_m: solid.plan_half_extents_m().0,
        };
        solid.plan_rectangle().map_or_else(circle, Self::Rectangle)
    }

    /// Distance from a point along a direction of length 1; infinite where it does not meet the outline.
    fn range_m(&self, from: [f32; 2], direction: [f32; 2]) -> f32 {
        match *self {
            Self::Circle { at, radius_m } => {
                let to = [at[0] - from[0], at[1] - from[1]];
                let ahead = to[0] * direction[0] + to[1] * direction[1];
                let under = radius_m * radius_m - (to[0] * to[0] + to[1] * to[1] - ahead * ahead);
                let half = under.sqrt();
                if under < 0.0 || ahead + half < 0.0 {
                    f32::INFINITY
                } else {
                    (ahead - half).max(0.0)
                }
            }
            Self::Rectangle(Rectangle { centre, half_m, along }) => {
                let turn = |v: [f32; 2]| [v[0] * along[0] + v[1] * along[1], v[1] * along[0] - v[0] * along[1]];
                let (p, d) = (turn([from[0] - centre[0], from[1] - centre[1]]), turn(direction));
                let (mut near, mut far) = (f32::NEG_INFINITY, f32::INFINITY);
                for k in 0..2 {
                    // A division by zero gives the infinities that the comparison needs, beside the outline as well as in it.
                    let inverse = 1.0 / if d[k].abs() < 1e-9 { 1e-9 } else { d[k] };
                    let (a, b) = ((-half_m[k] - p[k]) * inverse, (half_m[k] - p[k]) * inverse);
                    near = near.max(a.min(b));
                    far = far.min(a.max(b));
                }
                if near > far || far < 0.0 {
                    f32::INFINITY
                } else {
                    near.max(0.0)
                }
            }
        }
    }
}

/// Distance along a direction of length 1 to the first of outlines; infinite where it meets none.
fn nearest_m<'a>(outlines: impl Iterator<Item = &'a Outline>, from: [f32; 2], direction: [f32; 2]) -> f32 {
    let ranges_m = outlines.map(|o| o.range_m(from, direction));
    ranges_m.fold(f32::INFINITY, f32::min)
}

/// What stands and moves on a course, in the plan view of the flight band: what a collision scan is measured from.
pub struct TruePlan {
    outlines: Vec<Outline>,
    movers: Vec<Mover>,
}

impl TruePlan {
    /// Of a course.
    pub fn new(course: &Course) -> Self {
        Self {
            outlines: course.solids_in_band(HALF_BAND_M).iter().map(Outline::of).collect(),
            movers: course.movers_in_band(HALF_BAND_M).copied().collect(),
        }
    }

    /// How far the vehicle's middle can go along each of these directions (radians clockwise from north) before its body, a disc of
    /// [`VEHICLE`]'s radius, touches something, metres; infinite where nothing is in the way.
    pub fn free_ranges_m(
        &self,
        position_ned_m: NedVector,
        at_ns: u64,
        directions_rad: impl Iterator<Item = f32>,
    ) -> Vec<f32> {
        let here = [position_ned_m.x, position_ned_m.y];
        let moving = self.movers.iter().map(|m| Outline::of(&m.solid_at(at_ns)));
        let grown: Vec<Outline> = self
            .outlines
            .iter()
            .copied()
            .chain(moving)
            .flat_map(|o| o.grown(VEHICLE.radius_m))
            .collect();
        directions_rad
            .map(|angle_rad| nearest_m(grown.iter(), here, unit(angle_rad)))
            .collect()
    }
}

impl TrueCourse {
    /// Searches the course's ways once.
    pub fn new(course: &Course) -> Self {
        Self {
            path: ShortestPath::new(course),
            plan: TruePlan::new(course),
        }
    }

    /// Length of the shortest free path from a place, metres.
    pub fn path_m(&self, position_ned_m: NedVector) -> f32 {
        self.path.length_m(position_ned_m.x, position_ned_m.y)
    }

    /// The true state of a vehicle; `goal` as it is, not as it is estimated.
    pub fn state(&self, truth: &Truth, goal: GoalRelative) -> [f32; TRUE_STATE] {
        let mut state = [0.0; TRUE_STATE];
        let here = [truth.position_ned_m.x, truth.position_ned_m.y];
        let yaw_rad = truth.attitude.yaw_rad();
        let movers: Vec<Solid> = self.plan.movers.iter().map(|m| m.solid_at(truth.at_ns)).collect();
        let moving: Vec<Outline> = movers.iter().map(Outline::of).collect();
        for (k, slot) in state[..RAYS].iter_mut().enumerate() {
            let direction = unit(yaw_rad + k as f32 * (TAU / RAYS as f32));
            *slot = contrast(nearest_m(self.plan.outlines.iter().chain(&moving), here, direction));
        }
        let velocity = truth.velocity_ned_m_s.to_heading(yaw_rad);
        let path_m = self.path.length_m(here[0], here[1]);
        state[OWN..WAY].copy_from_slice(&[
            velocity.x / SPEED_M_S,
            velocity.y / SPEED_M_S,
            truth.rates_frd_rad_s.z / TURN_RAD_S,
            goal.distance_m / DISTANCE_M,
            libm::sinf(goal.bearing_rad),
            libm::cosf(goal.bearing_rad),
            path_m / DISTANCE_M,
        ]);
        for (k, slot) in state[WAY..MOVER].iter_mut().enumerate() {
            let [north, east] = unit(yaw_rad + k as f32 * (TAU / DIRECTIONS as f32));
            let there_m = self.path.length_m(here[0] + north, here[1] + east);
            *slot = (there_m - path_m).clamp(-2.0, 2.0);
        }
        let mut near: Vec<(f32, usize)> = movers
            .iter()
            .enumerate()
            .map(|(i, solid)| (solid.plan_distance_m(here[0], here[1]).max(0.0), i))
            .collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (slot, (distance_m, i)) in state[MOVER..].chunks_exact_mut(MOVER_VALUES).zip(near) {
            let (mover, centre) = (&self.plan.movers[i], movers[i].centre_ned_m());
            let later = mover.solid_at(truth.at_ns + MOVER_STEP_NS).centre_ned_m();
            let velocity = ((later - centre) * (1e9 / MOVER_STEP_NS as f32)).to_heading(yaw_rad);
            let to = (centre - truth.position_ned_m).to_heading(yaw_rad);
            let (near, length_m) = (contrast(distance_m), libm::hypotf(to.x, to.y).max(1e-3));
            slot.copy_from_slice(&[
                near,
                near * to.x / length_m,
                near * to.y / length_m,
                velocity.x,
                velocity.y,
                mover.turns_in_s(truth.at_ns).min(TURN_AHEAD_S) / TURN_AHEAD_S,
            ]);
        }
        state
    }
}

/// The range of a contrast, metres.
pub fn range_m(contrast: f32) -> f32 {
    CONTRAST_M * (1.0 / contrast - 1.0)
}

fn contrast(range_m: f32) -> f32 {
    1.0 / (1.0 + range_m / CONTRAST_M)
}

fn unit(angle_rad: f32) -> [f32; 2] {
    [libm::cosf(angle_rad), libm::sinf(angle_rad)]
}

/// A true state as it would be in a mirror: left and right change places.
pub fn mirror(state: &[f32; TRUE_STATE]) -> [f32; TRUE_STATE] {
    let mut seen = *state;
    for k in 1..RAYS {
        seen[k] = state[RAYS - k];
    }
    for k in [OWN + 1, OWN + 2, OWN + 4] {
        seen[k] = -state[k];
    }
    for k in 1..DIRECTIONS {
        seen[WAY + k] = state[WAY + DIRECTIONS - k];
    }
    for mover in seen[MOVER..].chunks_exact_mut(MOVER_VALUES) {
        mover[2] = -mover[2];
        mover[4] = -mover[4];
    }
    seen
}

#[cfg(test)]
mod tests {
    use super::*;
    use vigil_types::Attitude;

    fn course(movers: &str) -> Course {
        let solids = "column = [{ north_m = 5.0, east_m = 0.0, radius_m = 0.5, height_m = 3.0 }]
wall = [{ from_m = [-2.0, 3.0], to_m = [22.0, 3.0], thickness_m = 0.2, height_m = 3.0 }]
";
        crate::testing::field(0.0, 8.0, &format!("{solids}{movers}"))
    }

    fn hovering(yaw_rad: f32) -> Truth {
        Truth {
            at_ns: 0,
            position_ned_m: NedVector::new(0.0, 0.0, -1.5),
            velocity_ned_m_s: NedVector::ZERO,
            attitude: Attitude::from_euler_rad(0.0, 0.0, yaw_rad),
            rates_frd_rad_s: vigil_types::FrdVector::new(0.0, 0.0, 0.0),
        }
    }

    const GOAL: GoalRelative = GoalRelative {
        distance_m: 20.0,
        bearing_rad: 0.0,
    };

    #[test]
    fn ranges_go_clockwise_from_the_nose() {
        let course = TrueCourse::new(&course(""));
        let ahead = course.state(&hovering(0.0), GOAL);
        assert!((ahead[0] - contrast(4.5)).abs() < 1e-4, "the column: {}", ahead[0]);
        assert!((ahead[RAYS / 4] - contrast(2.9)).abs() < 1e-4, "the wall on the right");
        assert_eq!(ahead[3 * RAYS / 4], 0.0, "nothing on the left");
        let right = course.state(&hovering(PI / 2.0), GOAL);
        assert!((right[0] - contrast(2.9)).abs() < 1e-4);
        assert!((right[3 * RAYS / 4] - contrast(4.5)).abs() < 1e-4);
        // The path: ahead it becomes shorter, behind longer.
        assert!(ahead[WAY] < -0.5 && ahead[WAY + 4] > 0.5, "{:?}", &ahead[WAY..MOVER]);
    }

    #[test]
    fn a_mover_is_reported_with_its_velocity_and_when_it_turns() {
        let course = TrueCourse::new(&course(
            "[[mover]]\nfrom_m = [3.0, -2.0]\nto_m = [3.0, 2.0]\nspeed_m_s = 0.5\nphase = 0.25\nheight_m = 2.0\nshape = { column = { radius_m = 0.3 } }\n",
        ));
        let state = course.state(&hovering(0.0), GOAL);
        let mover = &state[MOVER..MOVER + MOVER_VALUES];
        assert!((mover[0] - contrast(2.7)).abs() < 1e-4, "{mover:?}");
        assert!((mover[4] - 0.5).abs() < 1e-3 && mover[3].abs() < 1e-3, "{mover:?}");
        assert!((mover[5] - 4.0 / 5.0).abs() < 1e-3, "{mover:?}");
        assert_eq!(state[MOVER + MOVER_VALUES..], [0.0; MOVER_VALUES], "there is no other");
    }

    #[test]
    fn a_mirror_changes_left_and_right_and_twice_nothing() {
        let course = TrueCourse::new(&course(""));
        let state = course.state(&hovering(0.3), GOAL);
        let seen = mirror(&state);
        assert_eq!(seen[RAYS / 4], state[3 * RAYS / 4]);
        assert_eq!(seen[0], state[0]);
        assert_eq!(mirror(&seen), state);
    }
}
