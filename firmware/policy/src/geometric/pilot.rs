//! The geometric pilot: goal seeking plus the paper's potential field, on what the depth frames show.
//!
//! `docs/pilot.md` explains the design. In short, one step: read the [`RangeScan`], enter it into the grid of what was seen, search
//! the path to the goal, take the farthest point of the path that can be flown to in a straight line as the waypoint, add
//! seeking and field, and let the governor limit the speed.

use crate::geometric::evasion::{self, Guesses, Plan, Wanted};
use crate::geometric::governor::{self, Motion};
use crate::geometric::movers::MoverTracker;
use crate::geometric::occupancy_grid::{DOUBTFUL_HIT, HIT, MARK_RANGE_M, OccupancyGrid};
use crate::geometric::path_planner::{PathPlanner, Search};
use crate::geometric::range_scan::FAR_M;
use crate::{Pilot, PilotInput, RangeScan, Scan, apf};
use core::f32::consts::PI;
use vigil_types::{
    ACTION_LIMIT, Action, GoalRelative, HeadingVector, Nanos, NedVector, YAW_RATE_PER_UNIT_RAD_S, parameters, wrap_pi,
};

/// What can be set of the geometric pilot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GeometricConfig {
    /// Fastest forward speed in metres per second, at most [`ACTION_LIMIT`].
    pub cruise_m_s: f32,
    /// Range of the repulsive field in metres.
    pub repulsive_range_m: f32,
}

impl Default for GeometricConfig {
    fn default() -> Self {
        Self {
            cruise_m_s: parameters::CRUISE.number_f32(),
            repulsive_range_m: parameters::REPULSIVE_RANGE.number_f32(),
        }
    }
}

/// Yaw output per radian between nose and waypoint.
const YAW_GAIN: f32 = 3.0;
/// Full speed up to this angle between nose and waypoint, none from [`TURN_IN_PLACE_RAD`] on.
const ALIGNED_RAD: f32 = 5.0 * PI / 180.0;
const TURN_IN_PLACE_RAD: f32 = 45.0 * PI / 180.0;
/// Farthest waypoint along the path, metres.
const LOOKAHEAD_M: f32 = 4.0;
/// Nearest waypoint: taken even where the straight line to it is tight.
const SHORT_LOOKAHEAD_M: f32 = 0.9;
/// A waypoint nearer than this has no bearing to speak of, metres.
pub(crate) const LEAST_LEAD_M: f32 = 0.05;
/// Around the vehicle itself the line may be as tight as it is, metres.
const SIGHT_FROM_M: f32 = 0.5;
/// A waypoint farther off the nose than this has chosen the side to pass on; the field does not overrule it.
const SIDE_CHOSEN_RAD: f32 = 10.0 * PI / 180.0;
/// Around a mover this much more is forgotten of what it has left in the grid, metres.
const TRACE_M: f32 = 0.3;
/// Movers farther away are left to later steps, metres.
const MOVERS_WITHIN_M: f32 = 6.0;
/// Cells that the search settles in one step.
const SEARCH_BUDGET: usize = 1500;
/// A position that jumps by more makes the memory worthless, metres.
const JUMP_M: f32 = 2.0;
/// Yaw output while looking around for a path.
const LOOK_AROUND_YAW: f32 = ACTION_LIMIT;
/// Not having moved by this in this time is being stuck; a full turn to look around takes 8 s.
const STUCK_M: f32 = 0.5;
const STUCK_NS: Nanos = 10_000_000_000;

/// Clearance of a straight line to a waypoint: 0.75 m, in cells, squared.
const SIGHT_SQUARED_CELLS: u8 = 9;
/// A straight line towards the goal that is clear this far is taken whatever the path, metres: as far as surfaces are remembered.
const GOAL_SIGHT_M: f32 = MARK_RANGE_M;
/// The repulsive field takes points within 45° of the nose that the vehicle would pass nearer than this, metres: its radius and
/// 0.20 m. Points beside the path would push it out of every gap.
const REPULSIVE_HALF_WIDTH_M: f32 = 0.50;

/// The pilot. A large value (about 120 kB) without pointers; no allocation.
#[derive(Debug, Clone)]
pub struct GeometricPilot {
    /// Flies when an attack on the depth frames is detected: every frame may have been altered, so what only one of them shows
    /// neither enters the grid nor moves the vehicle.
    distrusts: bool,
    config: GeometricConfig,
    surroundings: RangeScan,
    grid: OccupancyGrid,
    planner: PathPlanner,
    movers: MoverTracker,
    last_position_ned_m: Option<NedVector>,
    last_sequence: Option<u64>,
    /// Where the vehicle last got to, and when.
    progress: Option<(NedVector, Nanos)>,
    /// How it got out of the way of what moves in the step before.
    evading: Option<Plan>,
}

impl GeometricPilot {
    /// A pilot that remembers nothing.
    pub fn new(config: GeometricConfig) -> Self {
        Self::of(false, config)
    }

    /// The same; one that distrusts takes the actor's place, and believes what it sees only when several frames say it
    /// (docs/detection.md).
    pub(crate) fn of(distrusts: bool, config: GeometricConfig) -> Self {
        Self {
            distrusts,
            config,
            surroundings: RangeScan::new(),
            grid: OccupancyGrid::default(),
            planner: PathPlanner::new(),
            movers: MoverTracker::default(),
            last_position_ned_m: None,
            last_sequence: None,
            progress: None,
            evading: None,
        }
    }

    /// What it remembers of obstacles.
    pub fn grid(&self) -> &OccupancyGrid {
        &self.grid
    }

    /// The last path found, NED metres (north, east), from where the vehicle was when the search began; empty without one.
    pub fn path_ned_m(&self) -> &[(f32, f32)] {
        self.planner.points()
    }

    /// The last step's scan.
    pub fn surroundings(&self) -> &RangeScan {
        &self.surroundings
    }

    /// The farthest point of the path that can be flown to in a straight line; `None` without a path.
    fn waypoint(&self, here: NedVector, goal: NedVector) -> Option<NedVector> {
        let at = |&(north, east): &(f32, f32)| NedVector::new(north, east, here.z);
        let from_here = |p: NedVector| (p - here).horizontal_norm();
        let points = self.planner.points();
        let end = at(points.last()?);
        // The path is made of eighths of a turn: on open ground it is up to 8 % longer than the straight line, and as much as
        // 31° off it.
        let goal_m = from_here(goal);
        let towards_goal = |distance_m: f32| here + (goal - here) * (distance_m / goal_m.max(distance_m));
        if self.in_sight(here, towards_goal(GOAL_SIGHT_M)) {
            return Some(towards_goal(LOOKAHEAD_M));
        }
        // The path began where the vehicle was when the search began: drop what lies behind.
        let (nearest, _) = points
            .iter()
            .enumerate()
            .min_by(|(_, a), (_, b)| from_here(at(a)).total_cmp(&from_here(at(b))))?;
        let mut best = None;
        for point in points.iter().skip(nearest).map(at).step_by(2) {
            let distance_m = from_here(point);
            if distance_m > LOOKAHEAD_M {
                break;
            }
            if best.is_none() && distance_m >= SHORT_LOOKAHEAD_M {
                best = Some(point);
            } else if distance_m > SHORT_LOOKAHEAD_M {
                if !self.in_sight(here, point) {
                    break;
                }
                best = Some(point);
            }
        }
        Some(best.unwrap_or(if from_here(goal) < from_here(end) + 1.0 {
            goal
        } else {
            end
        }))
    }

    /// Whether the straight line between two points is clear by [`SIGHT_SQUARED_CELLS`].
    fn in_sight(&self, from: NedVector, to: NedVector) -> bool {
        const SAMPLE_M: f32 = 0.2;
        let line = to - from;
        let length_m = line.horizontal_norm();
        let samples = (length_m / SAMPLE_M).min(64.0) as usize;
        (1..=samples).all(|i| {
            let along_m = i as f32 * SAMPLE_M;
            let point = from + line * (along_m / length_m);
            along_m < SIGHT_FROM_M || self.grid.clearance_squared_at(point.x, point.y) >= SIGHT_SQUARED_CELLS
        })
    }

    /// The repulsive field of the nearest point that the vehicle would run into, going on as it points.
    fn repulsion(&self, seen: &Scan, bearing_of_waypoint_rad: f32) -> Action {
        let in_the_way = |x: f32, y: f32, _: f32| y.abs() < REPULSIVE_HALF_WIDTH_M && y.abs() <= x;
        let Some(obstacle) = seen.nearest_where(in_the_way) else {
            return Action::HOVER;
        };
        let push = apf::repulsion(obstacle, self.config.repulsive_range_m);
        let side_chosen = bearing_of_waypoint_rad.abs() > SIDE_CHOSEN_RAD;
        if side_chosen && push.yaw * bearing_of_waypoint_rad < 0.0 {
            return Action::HOVER;
        }
        push
    }

    /// Standing still until now was not this pilot's doing: it is not stuck.
    pub(crate) fn excuse_standstill(&mut self) {
        self.progress = None;
    }

    /// Whether an action that is carried on for `carried_s` runs into something remembered, even if the vehicle is ordered to stop after it. To be
    /// asked after [`Pilot::decide`], with the same input.
    pub(crate) fn foresees_collision(&self, input: &PilotInput<'_>, action: Action, carried_s: f32) -> bool {
        let motion = motion_of(input, position_ned_m(input), action.yaw);
        governor::on_collision_course(&motion, &self.grid, action.forward_m_s, carried_s)
    }

    /// Forgets everything after a jump of the position, and what is remembered of the obstacles when the vehicle has not
    /// got anywhere for [`STUCK_NS`]: then the memory, not the world, may be what blocks it.
    fn doubt(&mut self, here: NedVector, now_ns: Nanos) {
        let moved_m = |from: NedVector| (here - from).horizontal_norm();
        if self.last_position_ned_m.is_some_and(|last| moved_m(last) > JUMP_M) {
            self.reset();
        }
        self.last_position_ned_m = Some(here);
        let since_ns = self.progress.filter(|(at, _)| moved_m(*at) < STUCK_M).map(|(_, ns)| ns);
        let is_stuck = since_ns.is_some_and(|since_ns| now_ns.saturating_sub(since_ns) > STUCK_NS);
        if is_stuck {
            self.grid.clear();
            self.planner.clear();
        }
        if is_stuck || since_ns.is_none() {
            self.progress = Some((here, now_ns));
        }
    }

    /// Enters the frame into the grid, searches on, and gives the farthest point of the path that can be flown to in a straight
    /// line; `None` without a path. Bounded work: a slice of the search a step.
    pub(crate) fn plan(&mut self, input: &PilotInput<'_>) -> Option<NedVector> {
        let yaw_rad = input.attitude.yaw_rad();
        let header = &input.depth.header;
        let here = position_ned_m(input);
        self.doubt(here, input.now_ns);

        let (scan, hit) = if self.distrusts {
            (self.surroundings.observe_distrusting(input), DOUBTFUL_HIT)
        } else {
            (self.surroundings.observe(input), HIT)
        };
        if self.grid.follow(here) {
            self.planner.working = false;
        }
        if self.last_sequence != Some(header.sequence) {
            self.last_sequence = Some(header.sequence);
            if !self.distrusts {
                self.movers.observe(scan, here, yaw_rad, header.stamp_ns);
            }
            for mover in self.movers.traces() {
                self.grid
                    .forget_around(mover.north_m, mover.east_m, mover.radius_m + TRACE_M);
            }
            let movers = &self.movers;
            self.grid.observe(scan, hit, here, yaw_rad, |north_m, east_m| {
                movers.is_of_a_mover(north_m, east_m)
            });
        }

        let (sin, cos) = (libm::sinf(input.goal.bearing_rad), libm::cosf(input.goal.bearing_rad));
        let goal = here + (HeadingVector::new(cos, sin, 0.0) * input.goal.distance_m).to_ned(yaw_rad);
        if !self.planner.working {
            self.grid.measure_clearance();
            self.planner.start(&self.grid, here, goal);
        }
        if self.planner.advance(&self.grid, SEARCH_BUDGET) == Search::NoPath {
            self.planner.clear();
        }

        self.waypoint(here, goal)
    }

    /// The scan without what moves; `None` if nothing does.
    fn standing(&self, seen: &Scan, here: NedVector, yaw_rad: f32) -> Option<Scan> {
        self.movers.movers().next()?;
        let (sin, cos) = (libm::sinf(yaw_rad), libm::cosf(yaw_rad));
        let mut standing = seen.clone();
        let points = standing.forward_m.iter_mut().zip(&mut standing.right_m);
        let directions = standing.direction_forward.iter().zip(&standing.direction_right);
        for (((x, y), range_m), (dx, dy)) in points.zip(&mut standing.range_m).zip(directions) {
            let (north_m, east_m) = (here.x + cos * *x - sin * *y, here.y + sin * *x + cos * *y);
            if self.movers.is_of_a_mover(north_m, east_m) {
                (*x, *y, *range_m) = (FAR_M * dx, FAR_M * dy, f32::INFINITY);
            }
        }
        Some(standing)
    }

    /// How to get out of the way of what moves near the vehicle; `None` where the wanted action does not get into it.
    fn evade(&self, input: &PilotInput<'_>, here: NedVector, waypoint: NedVector, wanted: Action) -> Option<Plan> {
        let near = |north_m: f32, east_m: f32| libm::hypotf(north_m - here.x, east_m - here.y) < MOVERS_WITHIN_M;
        let movers = self.movers.movers().filter(|m| {
            near(m.north_m, m.east_m)
                || (!m.is_located() && m.off_lane_m(here.x, here.y, evasion::HORIZON_S) < MOVERS_WITHIN_M)
        });
        movers.clone().next()?;
        let age_s = input.now_ns.saturating_sub(input.depth.header.stamp_ns) as f32 * 1e-9;
        let motion = motion_of(input, here, wanted.yaw);
        let guesses = Guesses::new(movers.clone(), age_s);
        let wanted = Wanted {
            action: wanted,
            cruise_m_s: self.config.cruise_m_s,
            waypoint,
        };
        evasion::evade(&motion, &wanted, movers, &guesses, &self.grid, self.evading)
    }

    /// Steers for what [`Self::plan`] gave for the same input; and the plan behind it where it gets out of the way of what moves.
    pub(crate) fn steer(&self, input: &PilotInput<'_>, waypoint: Option<NedVector>) -> (Action, Option<Plan>) {
        let (yaw_rad, here) = (input.attitude.yaw_rad(), position_ned_m(input));
        let Some(waypoint) = waypoint else {
            let side = if input.goal.bearing_rad < 0.0 { -1.0 } else { 1.0 };
            return (Action::new(0.0, side * LOOK_AROUND_YAW), None);
        };
        let to_waypoint = waypoint - here;
        let target = GoalRelative::new(
            to_waypoint.horizontal_norm(),
            wrap_pi(libm::atan2f(to_waypoint.y, to_waypoint.x) - yaw_rad),
        );
        let seeking = Action::new(self.config.cruise_m_s, YAW_GAIN * target.bearing_rad);
        // One frame alone moves the recovery pilot neither aside nor to a stop: it goes by its grid.
        let seen = if self.distrusts {
            &Scan::EMPTY
        } else {
            self.surroundings.scan()
        };
        let field = apf::add(apf::attraction(target), self.repulsion(seen, target.bearing_rad));
        let wanted = apf::add(seeking.clipped(), field);

        let alignment = (TURN_IN_PLACE_RAD - target.bearing_rad.abs()) / (TURN_IN_PLACE_RAD - ALIGNED_RAD);
        let near_goal_m_s = 0.6 + 0.6 * input.goal.distance_m;
        let wanted_m_s = wanted
            .forward_m_s
            .min(self.config.cruise_m_s * alignment.clamp(0.0, 1.0))
            .min(near_goal_m_s);
        // Backward only out of the way of what moves: the field of a waypoint behind asks for it too.
        let wanted = Action::new(wanted_m_s.max(0.0), wanted.yaw);
        let plan = self.evade(input, here, waypoint, wanted);
        let wanted = plan.map_or(wanted, |plan| plan.action);
        if wanted.forward_m_s < 0.0 {
            return (wanted, plan);
        }
        let motion = motion_of(input, here, wanted.yaw);
        let standing = self.standing(seen, here, yaw_rad);
        let standing = standing.as_ref().unwrap_or(seen);
        let forward_m_s = governor::admissible_speed_m_s(&motion, standing, &self.grid, wanted.forward_m_s);
        (Action::new(forward_m_s, wanted.yaw), plan)
    }
}

/// Where the vehicle is now: where it was at capture, and how far it has come since.
pub(crate) fn position_ned_m(input: &PilotInput<'_>) -> NedVector {
    input.depth.header.position_ned_m + RangeScan::moved_since_capture_m(input)
}

/// How the vehicle moves under a yaw output.
fn motion_of(input: &PilotInput<'_>, position_ned_m: NedVector, yaw: f32) -> Motion {
    Motion {
        position_ned_m,
        yaw_rad: input.attitude.yaw_rad(),
        velocity_m_s: input.velocity_m_s,
        yaw_rate_rad_s: yaw * YAW_RATE_PER_UNIT_RAD_S,
    }
}

impl Pilot for GeometricPilot {
    fn decide(&mut self, input: &PilotInput<'_>) -> Action {
        let waypoint = self.plan(input);
        let (action, plan) = self.steer(input, waypoint);
        self.evading = plan;
        action
    }

    fn reset(&mut self) {
        self.grid.clear();
        self.planner.clear();
        self.movers = MoverTracker::default();
        self.evading = None;
        self.last_position_ned_m = None;
        self.last_sequence = None;
        self.progress = None;
    }
}
