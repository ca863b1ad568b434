//! An attacker who knows the guard: he keeps the actor where the guard has nothing to say.

use vigil_guidance::AlarmConfig;
use vigil_policy::actor::{ACTOR_LIMIT, ACTOR_OUTPUTS};
use vigil_policy::{PilotInput, RecoveryPilot};
use vigil_types::{Action, STEP_S};

/// So much of what the guard does not count as apart ([`AlarmConfig::apart_yaw`]) he leaves between the actor's yaw output and the
/// planner's: the planner turns on between the frame that he planned with and the next.
const APART: f32 = 0.9;
/// Shares of the way that the guard lets the actor fall behind: from the first on he lets it catch up, to the second.
const BEHIND: (f32, f32) = (0.7, 0.4);
/// Below this the frames show the ground beside the vehicle; the guard does not look yet either, metres.
const LOWEST_M: f32 = 1.0;

/// Flies the guard's planner over the frames that were delivered, as the guard does, and says how far the next one may bend the actor:
/// never so far from the planner that they disagree, and back to the planner's own yaw once the last action was on a collision course,
/// because two such steps raise the alarm, or the guard's `LedAstray` comes near.
#[derive(Debug, Clone, Default)]
pub(crate) struct GuardEvasion {
    planner: Box<RecoveryPilot>,
    /// What the guard looks at, as guidance has it by default.
    guard: AlarmConfig,
    behind_m: f32,
    catching_up: bool,
    /// What the planner wanted in the last step, and whether the actor's action ran into something.
    last: Option<(Action, bool)>,
}

impl GuardEvasion {
    /// Least and greatest yaw output that the guard lets pass; `None` before it looks.
    pub fn yaw_bounds(&self) -> Option<(f32, f32)> {
        let (planned, on_collision_course) = self.last?;
        let apart = if on_collision_course || self.catching_up {
            0.0
        } else {
            APART * self.guard.apart_yaw
        };
        let bound = |yaw: f32| yaw.clamp(-ACTOR_LIMIT, ACTOR_LIMIT);
        Some((bound(planned.yaw - apart), bound(planned.yaw + apart)))
    }

    /// Takes up a frame as it was delivered, and what the actor makes of it.
    pub fn delivered(&mut self, input: &PilotInput<'_>, decided: [f32; ACTOR_OUTPUTS]) {
        if input.height_m < LOWEST_M {
            return;
        }
        self.planner.observe(input, false);
        let [forward_m_s, yaw] = decided;
        let action = Action { forward_m_s, yaw };
        self.last = Some((
            self.planner.decide(input),
            self.planner.foresees_collision(input, action),
        ));
        self.fall_behind(self.planner.speed_along_path_m_s(input).unwrap_or(0.0));
    }

    fn fall_behind(&mut self, along_path_m_s: f32) {
        self.behind_m = (self.behind_m + (self.guard.path_speed_m_s - along_path_m_s) * STEP_S).max(0.0);
        let (most, least) = BEHIND;
        let turns_at = if self.catching_up { least } else { most };
        self.catching_up = self.behind_m > turns_at * self.guard.astray_limit_m;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_actor_is_bent_within_what_the_guard_tolerates_and_let_go_before_it_would_collide() {
        let mut evasion = GuardEvasion::default();
        assert_eq!(evasion.yaw_bounds(), None, "the guard does not look yet");
        let mut bounds = |yaw: f32, on_collision_course: bool| {
            let planned = Action { forward_m_s: 0.8, yaw };
            evasion.last = Some((planned, on_collision_course));
            evasion.yaw_bounds().unwrap()
        };
        assert_eq!(
            bounds(0.0, false),
            (-1.5, 1.5),
            "the whole range is within 2.0 of straight on"
        );
        let (low, high) = bounds(1.5, false);
        assert!((low + 0.3).abs() < 1e-6 && high == 1.5, "{low} {high}");
        assert_eq!(bounds(-0.7, true), (-0.7, -0.7));
    }

    #[test]
    fn it_catches_up_before_the_guard_finds_it_astray_and_strays_again() {
        let mut evasion = GuardEvasion::default();
        let limit_m = evasion.guard.astray_limit_m;
        let mut farthest_m = 0.0_f32;
        for _ in 0..2000 {
            // Straight away from the goal whenever it may.
            evasion.fall_behind(if evasion.catching_up { 1.5 } else { -1.0 });
            farthest_m = farthest_m.max(evasion.behind_m);
        }
        assert!(
            farthest_m <= 0.7 * limit_m + 0.1 && farthest_m > 0.7 * limit_m,
            "{farthest_m} m of {limit_m}"
        );
        assert!(evasion.behind_m > 0.4 * limit_m - 0.2, "it strays again");
    }
}
