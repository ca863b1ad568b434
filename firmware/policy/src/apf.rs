//! The paper's artificial potential field, in action units (docs/paper.md, "Attractive field" and "Repulsive field").
//!
//! Both fields are functions of one bearing and one distance. All results are clipped to ±[`vigil_types::ACTION_LIMIT`]. An input
//! that is not finite or a negative distance yields no force, so that a field can never be the source of a NaN.

use core::f32::consts::{FRAC_PI_2, PI};
use vigil_types::{Action, GoalRelative};

/// Distance below which an obstacle repels: the paper's equation says 3 m, its text 5 m (docs/paper.md, "contradicts itself", 2).
pub const REPULSIVE_RANGE_M: f32 = vigil_types::parameters::REPULSIVE_RANGE.number_f32();

/// Distance below which the attractive field pulls harder and turns at any bearing.
const NEAR_GOAL_M: f32 = 5.0;

/// Keeps 1/d² finite; the force is at its limit long before.
const MIN_DISTANCE_M: f32 = 1e-3;

/// The nearest point of an obstacle, as the repulsive field takes it: the paper's `d_ob` and `θ_ob`, given as a goal's.
pub type NearestObstacle = GoalRelative;

/// The attractive field of a goal at bearing θ and distance d:
///
/// - `F(v_x)` = 20 cos θ / d² for d < 5 m, else 2 cos θ / d
/// - `F(ω)` = tan(2θ/5) for d < 5 m; (tan(θ/3))³ for d ≥ 5 m and |θ| > π/2; else 0
///
/// Clipped to ±[`vigil_types::ACTION_LIMIT`]. A bearing outside [−π, π] is limited to it.
pub fn attraction(goal: GoalRelative) -> Action {
    let (theta, d) = (goal.bearing_rad, goal.distance_m);
    if !theta.is_finite() || !d.is_finite() || d < 0.0 {
        return Action::HOVER;
    }
    let theta = theta.clamp(-PI, PI);
    let d = d.max(MIN_DISTANCE_M);
    let cos = libm::cosf(theta);
    let near = d < NEAR_GOAL_M;
    let yaw = if near {
        libm::tanf(2.0 * theta / 5.0)
    } else if theta.abs() > FRAC_PI_2 {
        let t = libm::tanf(theta / 3.0);
        t * t * t
    } else {
        0.0
    };
    Action::new(if near { 20.0 * cos / (d * d) } else { 2.0 * cos / d }, yaw).clipped()
}

/// The repulsive field of the nearest point of an obstacle at bearing θ and distance d, which acts on the yaw only:
///
/// - `F(ω)` = −3 + 3 tan(θ/2) for d < `range_m`, 0 < θ < π/2 (the obstacle is to the right: turn left)
/// - `F(ω)` = 3 + 3 tan(θ/2) for d < `range_m`, −π/2 < θ < 0
/// - else 0: also dead ahead, where the paper names no side
///
/// Clipped to ±[`vigil_types::ACTION_LIMIT`].
pub fn repulsion(obstacle: NearestObstacle, range_m: f32) -> Action {
    let (theta, d) = (obstacle.bearing_rad, obstacle.distance_m);
    // Written so that a NaN in any of the three is "not within range".
    let within = d >= 0.0 && d < range_m && theta.abs() < FRAC_PI_2;
    let side = if !within || theta == 0.0 {
        return Action::HOVER;
    } else if theta > 0.0 {
        -3.0
    } else {
        3.0
    };
    Action::new(0.0, side + 3.0 * libm::tanf(0.5 * theta)).clipped()
}

/// Both fields added and clipped to ±[`vigil_types::ACTION_LIMIT`]: the "APF force added to the action" of the paper's Algorithm 1,
/// whose repulsive range is [`REPULSIVE_RANGE_M`].
pub fn force(goal: GoalRelative, obstacle: Option<NearestObstacle>, repulsive_range_m: f32) -> Action {
    let pull = attraction(goal);
    let push = obstacle.map_or(Action::HOVER, |o| repulsion(o, repulsive_range_m));
    add(pull, push)
}

/// The sum of two actions, clipped to ±[`vigil_types::ACTION_LIMIT`].
pub fn add(a: Action, b: Action) -> Action {
    Action::new(a.forward_m_s + b.forward_m_s, a.yaw + b.yaw).clipped()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A goal, or an obstacle.
    fn at(distance_m: f32, bearing_deg: f32) -> GoalRelative {
        GoalRelative::new(distance_m, bearing_deg.to_radians())
    }

    #[track_caller]
    fn close(a: f32, b: f32) {
        assert!((a - b).abs() < 1e-4, "{a} is not {b}");
    }

    #[test]
    fn goals_pull_with_two_over_d_or_near_by_with_twenty_over_d_squared_and_turn_near_by_or_when_behind() {
        for (distance_m, bearing_deg, forward_m_s, yaw) in [
            // 2 cos 60° / 8
            (8.0, 60.0, 0.125, 0.0),
            // 2 cos 120° / 10; tan³ 40° = 0.83910³
            (10.0, 120.0, -0.1, 0.590_80),
            (10.0, -120.0, -0.1, -0.590_80),
            // tan³ 60° = 5.196: clipped
            (10.0, 180.0, -0.2, 1.5),
            // π/2 itself belongs to "else".
            (10.0, 89.9, 0.000_349, 0.0),
            // 20 cos 60° / 16; tan 24°
            (4.0, 60.0, 0.625, 0.445_23),
            // 20 cos 180° / 16; tan 72° = 3.078: clipped
            (4.0, -180.0, -1.25, -1.5),
            // The branch changes at 5 m: 20/25 just inside, 2/5 at it.
            (4.999_9, 0.0, 0.800_03, 0.0),
            (5.0, 0.0, 0.4, 0.0),
        ] {
            let f = attraction(at(distance_m, bearing_deg));
            close(f.forward_m_s, forward_m_s);
            close(f.yaw, yaw);
        }
    }

    #[test]
    fn at_the_goal_itself_the_pull_is_its_limit_and_finite() {
        for d in [0.0, 1e-30, 1e-3, 0.1] {
            close(attraction(at(d, 0.0)).forward_m_s, 1.5);
            close(attraction(at(d, 180.0)).forward_m_s, -1.5);
            assert!(attraction(at(d, 90.0)).is_finite());
        }
    }

    #[test]
    fn an_obstacle_turns_the_vehicle_away_from_itself_up_to_the_beam_and_its_range() {
        for (distance_m, bearing_deg, yaw) in [
            // −3 + 3 tan 30° = −1.26795
            (2.0, 60.0, -1.267_95),
            (2.0, -60.0, 1.267_95),
            // −3 + 3 tan 5° = −2.7375: clipped
            (2.0, 10.0, -1.5),
            (0.0, -10.0, 1.5),
            // The limits towards dead ahead are the two sides.
            (1.0, 1e-4, -1.5),
            (1.0, -1e-4, 1.5),
        ] {
            let f = repulsion(at(distance_m, bearing_deg), 3.0);
            close(f.yaw, yaw);
            assert_eq!(f.forward_m_s, 0.0);
        }
        assert!(repulsion(at(1.0, 89.99), 3.0).yaw.abs() < 1e-3);
        assert!(repulsion(at(1.0, -89.99), 3.0).yaw.abs() < 1e-3);
        for (distance_m, bearing_deg) in [(1.0, 90.0), (1.0, -120.0), (3.0, 20.0), (1.0, 0.0)] {
            let o = at(distance_m, bearing_deg);
            assert_eq!(repulsion(o, 3.0), Action::HOVER, "{o:?}");
        }
        close(repulsion(at(4.0, 10.0), 5.0).yaw, -1.5);
    }

    #[test]
    fn the_sum_is_clipped_not_its_parts_alone() {
        let f = force(at(10.0, 120.0), Some(at(1.0, 60.0)), REPULSIVE_RANGE_M);
        close(f.yaw, 0.590_80 - 1.267_95);
        close(f.forward_m_s, -0.1);
        close(force(at(2.0, 180.0), Some(at(1.0, -5.0)), REPULSIVE_RANGE_M).yaw, 1.5);
        assert_eq!(
            force(at(10.0, 20.0), None, REPULSIVE_RANGE_M),
            attraction(at(10.0, 20.0))
        );
    }

    #[test]
    fn nothing_that_is_not_finite_becomes_a_force() {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert_eq!(attraction(at(bad, 10.0)), Action::HOVER);
            assert_eq!(attraction(at(2.0, bad)), Action::HOVER);
            assert_eq!(repulsion(at(bad, 10.0), 3.0), Action::HOVER);
            assert_eq!(repulsion(at(1.0, bad), 3.0), Action::HOVER);
        }
        assert_eq!(attraction(at(-1.0, 10.0)), Action::HOVER);
        assert_eq!(repulsion(at(-1.0, 10.0), 3.0), Action::HOVER);
    }
}
