//! The way out of a standstill: where actor, attraction and repulsion cancel out, the potential field has a local minimum, and a
//! vehicle without memory would hover there for good. Local minima are the field's known weakness (Koren, Borenstein 1991).

use crate::NearestObstacle;
use vigil_types::{Nanos, NedVector};

/// Not having moved by this in this time is a standstill.
const MOVED_M: f32 = 0.5;
const STANDSTILL_NS: Nanos = 4_000_000_000;
/// It is turned from for this long: 67° at 45 °/s.
const TURN_NS: Nanos = 1_500_000_000;
/// A pause in deciding is somebody else's standstill.
const PAUSE_NS: Nanos = 500_000_000;

/// Notices a standstill and turns from what is ahead.
#[derive(Debug, Clone, Default)]
pub struct Escape {
    /// Where the vehicle last got to, and when.
    progress: Option<(NedVector, Nanos)>,
    /// Until when it turns, and to which side: 1 is right.
    turn: Option<(Nanos, f32)>,
    last_ns: Nanos,
}

impl Escape {
    /// The side to turn to now: 1 is right, −1 left, 0 none. `obstacle` is the nearest one ahead.
    pub fn side(&mut self, here: NedVector, now_ns: Nanos, obstacle: Option<NearestObstacle>) -> f32 {
        let paused = now_ns.saturating_sub(self.last_ns) > PAUSE_NS;
        self.last_ns = now_ns;
        if paused {
            (self.progress, self.turn) = (None, None);
        }
        if let Some((until_ns, side)) = self.turn {
            if now_ns < until_ns {
                return side;
            }
            (self.progress, self.turn) = (None, None);
        }
        match self.progress {
            Some((at, since_ns)) if (here - at).horizontal_norm() < MOVED_M => {
                if now_ns.saturating_sub(since_ns) > STANDSTILL_NS {
                    let side = if obstacle.is_some_and(|o| o.bearing_rad > 0.0) {
                        -1.0
                    } else {
                        1.0
                    };
                    self.turn = Some((now_ns + TURN_NS, side));
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
    extern crate std;

    use super::*;
    use std::vec::Vec;

    const STEP_NS: Nanos = 50_000_000;
    const AHEAD_LEFT: NearestObstacle = NearestObstacle {
        distance_m: 1.0,
        bearing_rad: -0.1,
    };

    /// Sides of `steps` steps from `from_s` on, at a north position that goes by `speed_m_s`.
    fn sides(escape: &mut Escape, from_s: u64, steps: u64, speed_m_s: f32) -> Vec<f32> {
        (0..steps)
            .map(|i| {
                let here = NedVector::new(speed_m_s * i as f32 * 0.05, 0.0, -1.5);
                escape.side(here, from_s * 1_000_000_000 + i * STEP_NS, Some(AHEAD_LEFT))
            })
            .collect()
    }

    #[test]
    fn a_standstill_of_four_seconds_is_turned_from_for_a_second_and_a_half() {
        let sides = sides(&mut Escape::default(), 1, 160, 0.0);
        assert!(sides[..80].iter().all(|s| *s == 0.0));
        assert_eq!(sides.iter().filter(|s| **s == 1.0).count(), 30);
        assert!(sides[115..].iter().all(|s| *s == 0.0));
    }

    #[test]
    fn who_moves_is_left_alone() {
        assert!(sides(&mut Escape::default(), 1, 400, 0.2).iter().all(|s| *s == 0.0));
    }

    #[test]
    fn a_hold_by_somebody_else_is_no_standstill() {
        let mut escape = Escape::default();
        sides(&mut escape, 1, 60, 0.0);
        assert!(sides(&mut escape, 60, 60, 0.0).iter().all(|s| *s == 0.0));
    }
}
