//! Flying a mission item by item. <https://docs.px4.io/main/en/flight_modes_mc/mission.html>

use crate::core::Core;
use crate::flight::mode::FlightMode;
use crate::flight::state::{Denial, Maneuver};
use crate::plan::{Leg, MissionItem, Purpose, Stage};
use crate::vehicle::{Goal, YawCommand};
use crate::vehicle_parameters::ParamId;
use vigil_mavlink::common::{HOME_POSITION_DATA, MISSION_CURRENT_DATA, MISSION_ITEM_REACHED_DATA};
use vigil_types::{Nanos, NedVector};

/// Smallest distance at which a place counts as reached: the estimate wanders by about as much.
const MIN_ACCEPTANCE_M: f32 = 0.2;
/// A landing begins when the vehicle is this near to its place and this slow.
const LANDING_RADIUS_M: f32 = 0.5;
const LANDING_SPEED_M_S: f32 = 0.5;
/// On a shorter way the vehicle does not turn towards its place.
const TURN_DISTANCE_M: f32 = 2.0;
/// Deceleration within which a short way on is flown to its end.
const PASSING_BRAKING_M_S2: f32 = 0.6;
/// Time between the end of an item and the begin of the next.
const ITEM_PAUSE_NS: Nanos = 50_000_000;

impl Core {
    /// Enters mission mode: begins, or goes on with the current item. While disarmed it waits for arming.
    ///
    /// A mode can be chosen before what it flies is there, as in PX4: arming is then what is refused.
    pub(super) fn begin_mission(&mut self) -> Result<(), Denial> {
        if self.commander.armed {
            self.mission_check()?;
        }
        self.clear_failsafe();
        self.plans.mission.start();
        self.plans.mission.not_before_ns = self.now_ns;
        self.enter(FlightMode::Mission, Maneuver::default());
        self.announce::<MISSION_CURRENT_DATA>();
        Ok(())
    }

    /// Whether there is a mission, within the geofence.
    pub fn mission_check(&self) -> Result<(), Denial> {
        if self.plans.mission.is_empty() {
            return Err(Denial::NoMission);
        }
        match self.plans.mission.legs().find(|(_, leg)| !self.fence_allows_leg(leg)) {
            Some((index, _)) => Err(Denial::Other(format!(
                "mission denied: item {index} is outside the geofence"
            ))),
            None => Ok(()),
        }
    }

    /// Whether a flight of a mission leads to where the vehicle may be.
    pub fn fence_allows_leg(&self, leg: &Leg) -> bool {
        let place = leg.place.north_east_m;
        place.is_none_or(|place| self.fence_allows(place, leg.place.height_m.unwrap_or(0.0)))
    }

    /// The mission was replaced, or its current item changed by command: begins it if missions are being flown.
    pub fn mission_changed(&mut self) {
        self.announce::<MISSION_CURRENT_DATA>();
        if self.commander.mode != FlightMode::Mission {
            return;
        }
        if let Err(denial) = self.begin_mission() {
            self.warn(&denial.to_string());
            self.enter(FlightMode::Hold, Maneuver::default());
        }
    }

    /// One step of mission mode: decides which maneuver is flown.
    pub(super) fn step_mission(&mut self) {
        let Some(item) = self.plans.mission.item() else {
            return;
        };
        let on_ground = self.commander.is_on_ground();
        match (item, self.plans.mission.stage) {
            (_, Stage::Fresh) if self.now_ns >= self.plans.mission.not_before_ns => self.begin_item(item, on_ground),
            (_, Stage::Waiting { until_ns }) if self.now_ns >= until_ns => self.end_item(true),
            (MissionItem::Leg(leg), Stage::Climbing) if self.has_climbed() => self.travel(&leg),
            (MissionItem::Leg(leg), Stage::Travelling) if self.has_arrived(&leg) => self.arrive(&leg),
            (_, Stage::Landing) if on_ground => self.end_item(true),
            _ => {}
        }
    }

    fn begin_item(&mut self, item: MissionItem, on_ground: bool) {
        match item {
            MissionItem::Leg(leg) if !on_ground => self.travel(&leg),
            MissionItem::Leg(leg) if leg.purpose == Purpose::Land => self.end_item(true),
            MissionItem::Leg(leg) => self.leave_ground(&leg),
            MissionItem::Return => {
                self.plans.mission.advance(false);
                self.announce::<MISSION_CURRENT_DATA>();
                self.begin_return();
            }
            MissionItem::Delay(wait_ns) => self.wait(wait_ns),
            MissionItem::Speed(speed_m_s) => {
                self.plans.mission.speed_m_s = speed_m_s;
                self.end_item(true);
            }
            MissionItem::Interest(place_m) => {
                self.commander.region_of_interest_m = place_m;
                self.end_item(true);
            }
            MissionItem::Home => {
                let here = self.view.estimate.position_ned_m;
                self.home_m = (here.x, here.y);
                self.announce::<HOME_POSITION_DATA>();
                self.end_item(true);
            }
            MissionItem::PassedOver => self.end_item(true),
            MissionItem::Jump { .. } => self.end_item(false),
        }
    }

    fn wait(&mut self, wait_ns: Nanos) {
        let until_ns = self.now_ns.saturating_add(wait_ns);
        self.plans.mission.stage = Stage::Waiting { until_ns };
    }

    /// Climbs before the first way, as PX4 does even where the mission has no take-off.
    fn leave_ground(&mut self, leg: &Leg) {
        let default_m = self.param(ParamId::TakeoffAltitudeM);
        let height_m = match (leg.place.height_m, leg.purpose) {
            (Some(height_m), Purpose::TakeOff) if height_m > 0.3 => height_m,
            (Some(height_m), _) => height_m.max(default_m),
            (None, _) => default_m,
        };
        let here = self.view.estimate.position_ned_m;
        let rate_m_s = self.param(ParamId::TakeoffSpeedMS);
        self.commander.maneuver = Maneuver::climb(here, -height_m, rate_m_s);
        self.plans.mission.stage = Stage::Climbing;
    }

    fn has_climbed(&self) -> bool {
        match self.commander.maneuver {
            Maneuver::Climb(climb) => climb.is_done(&self.view.estimate),
            _ => true,
        }
    }

    fn travel(&mut self, leg: &Leg) {
        let here = self.view.estimate.position_ned_m;
        let (north, east) = leg.place.north_east_m.unwrap_or((here.x, here.y));
        let z_m = match (leg.place.height_m, leg.purpose) {
            // Flies there at the height it has, then descends.
            (_, Purpose::Land) | (None, _) => here.z,
            (Some(height_m), _) => -height_m,
        };
        let (d_north, d_east) = (north - here.x, east - here.y);
        let yaw = match leg.yaw_rad {
            Some(yaw_rad) => YawCommand::Angle(yaw_rad),
            None if libm::hypotf(d_north, d_east) > TURN_DISTANCE_M => YawCommand::Angle(libm::atan2f(d_east, d_north)),
            None => YawCommand::Hold,
        };
        let speed_m_s = self.cruise_speed_m_s(self.plans.mission.speed_m_s);
        let goal = Goal::new(NedVector::new(north, east, z_m), yaw, speed_m_s);
        self.commander.maneuver = Maneuver::Station(goal);
        self.plans.mission.passing_m_s = self.passing_at((here.x, here.y), (north, east), leg);
        self.plans.mission.stage = Stage::Travelling;
    }

    /// Velocity with which a place is passed: that of the way to it, as far as the way on goes in the same direction.
    /// Zero where the vehicle stops.
    fn passing_at(&self, from: (f32, f32), at: (f32, f32), leg: &Leg) -> (f32, f32) {
        const STOPS: (f32, f32) = (0.0, 0.0);
        let passes =
            matches!(leg.purpose, Purpose::Visit { stay_ns: 0 } | Purpose::TakeOff) && !self.plans.mission_pauses();
        let Some(to) = self.plans.mission.next_place_m().filter(|_| passes) else {
            return STOPS;
        };
        let (in_north, in_east) = (at.0 - from.0, at.1 - from.1);
        let (out_north, out_east) = (to.0 - at.0, to.1 - at.1);
        let (in_m, out_m) = (libm::hypotf(in_north, in_east), libm::hypotf(out_north, out_east));
        if in_m < MIN_ACCEPTANCE_M || out_m < MIN_ACCEPTANCE_M {
            return STOPS;
        }
        let along = (in_north * out_north + in_east * out_east) / (in_m * out_m);
        // On a short way on, no faster than can be braked there.
        let speed_m_s = self.cruise_speed_m_s(self.plans.mission.speed_m_s) * along.max(0.0);
        let speed_m_s = speed_m_s.min(libm::sqrtf(2.0 * PASSING_BRAKING_M_S2 * out_m));
        (in_north / in_m * speed_m_s, in_east / in_m * speed_m_s)
    }

    /// What the vehicle's velocity towards a place does not fall below: it passes the place instead of stopping there.
    /// Nothing once it is behind.
    pub(super) fn passing_velocity_m_s(&self, place_ned_m: NedVector) -> NedVector {
        let (north, east) = self.plans.mission.passing_m_s;
        let left = place_ned_m - self.view.estimate.position_ned_m;
        if self.plans.mission.stage == Stage::Travelling && left.x * north + left.y * east > 0.0 {
            NedVector::new(north, east, 0.0)
        } else {
            NedVector::ZERO
        }
    }

    /// Changes the speed of ways: of the mission's while one is flown, else of the present one and those that follow until
    /// disarming. `None` goes back to MPC_XY_CRUISE.
    pub fn change_speed(&mut self, speed_m_s: Option<f32>) {
        let max_m_s = self.param(ParamId::MaxSpeedMS);
        let wanted = speed_m_s.map(|speed_m_s| speed_m_s.clamp(0.5, max_m_s));
        if self.commander.mode == FlightMode::Mission {
            self.plans.mission.speed_m_s = wanted;
        } else {
            self.commander.speed_m_s = wanted;
        }
        let now_m_s = self.cruise_speed_m_s(wanted);
        if let Maneuver::Station(goal) = &mut self.commander.maneuver {
            goal.speed_limit_m_s = now_m_s;
        }
    }

    fn has_arrived(&self, leg: &Leg) -> bool {
        let Maneuver::Station(goal) = self.commander.maneuver else {
            return true;
        };
        let estimate = &self.view.estimate;
        let off = goal.position_ned_m - estimate.position_ned_m;
        let radius_m = match leg.purpose {
            Purpose::Land if estimate.velocity_ned_m_s.horizontal_norm() > LANDING_SPEED_M_S => return false,
            Purpose::Land => LANDING_RADIUS_M,
            _ => leg.acceptance_m.unwrap_or(self.param(ParamId::AcceptanceRadiusM)),
        };
        let radius_m = radius_m.max(MIN_ACCEPTANCE_M);
        off.horizontal_norm() <= radius_m && off.z.abs() <= self.param(ParamId::HeightAcceptanceM)
    }

    fn arrive(&mut self, leg: &Leg) {
        match leg.purpose {
            Purpose::Visit { stay_ns: 0 } | Purpose::TakeOff => self.end_item(true),
            Purpose::Visit { stay_ns } => self.wait(stay_ns),
            Purpose::Land => {
                self.plans.mission.stage = Stage::Landing;
                self.commander.maneuver = Maneuver::Descend;
            }
        }
    }

    /// The current item is done; after the last one the vehicle holds where it is.
    fn end_item(&mut self, is_reached: bool) {
        self.plans.mission.not_before_ns = self.now_ns + ITEM_PAUSE_NS;
        let pauses = self.plans.mission_pauses();
        let goes_on = self.plans.mission.advance(is_reached);
        if is_reached {
            self.announce::<MISSION_ITEM_REACHED_DATA>();
        }
        self.announce::<MISSION_CURRENT_DATA>();
        if goes_on && !pauses {
            return;
        }
        let what = if goes_on { "paused by item" } else { "finished" };
        self.inform(&format!("mission {what}"));
        let maneuver = match self.commander.maneuver {
            station @ Maneuver::Station(_) => station,
            _ => Maneuver::default(),
        };
        self.enter(FlightMode::Hold, maneuver);
    }
}
