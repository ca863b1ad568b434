//! The potential field as it is added to a frozen actor in flight: the paper's, where it helps one that deals with obstacles itself,
//! and a way out of standstills (docs/learning.md, "The field in flight").
//!
//! Where actor, attraction and repulsion cancel out, the field has a local minimum, and a vehicle without memory would hover there
//! for good: the field's known weakness (Koren, Borenstein 1991).

use crate::geometric::position_ned_m;
use crate::{NearestObstacle, PilotInput, Scan, apf};
use core::f32::consts::FRAC_PI_4;
use vigil_types::{ACTION_LIMIT, Action, Nanos, NedVector};

/// The field that is added to an actor takes surfaces within this angle of the nose: beyond it, it steers a second time
/// around what the actor has already dealt with.
const FIELD_HALF_ANGLE_RAD: f32 = FRAC_PI_4;
/// ... and nearer than this, metres: the trained actor keeps farther away by itself, and the field is there for where it does not. From
/// farther off it steers where the actor has long decided, and what it holds back from a gap stands still.
const FIELD_RANGE_M: f32 = 0.6;
/// What the field adds to turn from a standstill: more than the actor can turn against.
const ESCAPE_YAW: f32 = 2.0 * ACTION_LIMIT;
/// Not having moved by this in this time is a standstill.
const MOVED_M: f32 = 0.5;
const STANDSTILL_NS: Nanos = 4_000_000_000;
/// It is turned from for this long: 67° at 45 °/s.
const TURN_NS: Nanos = 1_500_000_000;
/// Within this of the last turn the next one goes to the same side: turns to and fro end where they began.
const SAME_SIDE_NS: Nanos = 30_000_000_000;
/// A pause in deciding is somebody else's standstill.
const PAUSE_NS: Nanos = 500_000_000;

/// The field of one flight: notices a standstill and turns from what is ahead. No allocation.
#[derive(Debug, Clone, Default)]
pub struct FlightField {
    /// Where the vehicle last got to, and when.
    progress: Option<(NedVector, Nanos)>,
    /// The side of the last turn, 1 is right, and when it began.
    last_turn: Option<(f32, Nanos)>,
    last_ns: Nanos,
}

impl FlightField {
    /// The actor's own action and the field's, clipped, both in units of `unit_m_s` ahead. `scan` is what the input's frame shows.
    pub fn add_to(&mut self, own: Action, unit_m_s: f32, input: &PilotInput<'_>, scan: &Scan) -> Action {
        let obstacle = scan.nearest_within(FIELD_HALF_ANGLE_RAD);
        let here = position_ned_m(input);
        let turn = Action::new(0.0, ESCAPE_YAW * self.side(here, input.now_ns, obstacle));
        let force = match obstacle.filter(|o| o.distance_m < apf::REPULSIVE_RANGE_M) {
            // The goal does not pull through what stands before it: how to pass that is the actor's.
            Some(obstacle) => apf::repulsion(obstacle, FIELD_RANGE_M),
            None => apf::attraction(input.goal),
        };
        apf::add(apf::add(own.scaled(1.0 / unit_m_s), force), turn).scaled(unit_m_s)
    }

    /// The side to turn to now: 1 is right, −1 left, 0 none. `obstacle` is the nearest one ahead.
    fn side(&mut self, here: NedVector, now_ns: Nanos, obstacle: Option<NearestObstacle>) -> f32 {
        if now_ns.saturating_sub(self.last_ns) > PAUSE_NS {
            *self = Self::default();
        }
        self.last_ns = now_ns;
        if let Some((side, begun_ns)) = self.last_turn
            && now_ns < begun_ns + TURN_NS
        {
            return side;
        }
        match self.progress {
            Some((at, since_ns)) if (here - at).horizontal_norm() < MOVED_M => {
                if now_ns.saturating_sub(since_ns) > STANDSTILL_NS {
                    let before = self
                        .last_turn
                        .filter(|(_, begun_ns)| now_ns.saturating_sub(*begun_ns) < SAME_SIDE_NS);
                    let side = match (before, obstacle) {
                        (Some((side, _)), _) => side,
                        (None, Some(obstacle)) if obstacle.bearing_rad > 0.0 => -1.0,
                        (None, _) => 1.0,
                    };
                    (self.progress, self.last_turn) = (None, Some((side, now_ns)));
                    return side;
                }
            }
            _ => self.progress = Some((here, now_ns)),
        }
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const STEP_NS: Nanos = 50_000_000;
    const AHEAD_LEFT: NearestObstacle = NearestObstacle::new(1.0, -0.1);

    /// Sides of `steps` steps from `from_s` on, at a north position that goes by `speed_m_s`.
    fn sides(field: &mut FlightField, from_s: u64, steps: u64, speed_m_s: f32) -> Vec<f32> {
        (0..steps)
            .map(|i| {
                let here = NedVector::new(speed_m_s * i as f32 * 0.05, 0.0, -1.5);
                field.side(here, from_s * 1_000_000_000 + i * STEP_NS, Some(AHEAD_LEFT))
            })
            .collect()
    }

    #[test]
    fn a_standstill_of_four_seconds_is_turned_from_for_a_second_and_a_half() {
        let sides = sides(&mut FlightField::default(), 1, 160, 0.0);
        assert!(sides[..80].iter().all(|s| *s == 0.0));
        assert_eq!(sides.iter().filter(|s| **s == 1.0).count(), 30);
        assert!(sides[115..].iter().all(|s| *s == 0.0));
    }

    #[test]
    fn whoever_still_stands_is_turned_on_to_the_same_side() {
        let mut field = FlightField::default();
        let mut turned = sides(&mut field, 1, 160, 0.0);
        // What is nearest lies on the other side now.
        let right = NearestObstacle::new(1.0, 0.1);
        let here = NedVector::new(0.0, 0.0, -1.5);
        turned.extend((160..240).map(|i| field.side(here, 1_000_000_000 + i * STEP_NS, Some(right))));
        assert_eq!(turned.iter().filter(|s| **s == 1.0).count(), 60);
        assert!(turned.iter().all(|s| *s >= 0.0));
    }

    #[test]
    fn who_moves_is_left_alone() {
        let sides = sides(&mut FlightField::default(), 1, 400, 0.2);
        assert!(sides.iter().all(|s| *s == 0.0));
    }

    #[test]
    fn a_hold_by_somebody_else_is_no_standstill() {
        let mut field = FlightField::default();
        sides(&mut field, 1, 60, 0.0);
        assert!(sides(&mut field, 60, 60, 0.0).iter().all(|s| *s == 0.0));
    }
}
