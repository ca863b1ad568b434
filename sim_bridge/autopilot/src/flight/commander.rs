//! Arming, mode changes, failsafes and the landed state: the decisions that PX4's commander takes.

use crate::config::Source;
use crate::core::Core;
use crate::flight::mode::FlightMode;
use crate::flight::setpoint_owner::Setpoints;
use crate::flight::state::{Commander, Denial, Failsafe, LandedState, LostSensors, Maneuver, Sticks};
use crate::vehicle::{ControlCommand, Goal, YawCommand};
use crate::vehicle_parameters::ParamId;
use vigil_mavlink::GUIDANCE_COMPONENT;
use vigil_mavlink::common::{
    CURRENT_MODE_DATA, EXTENDED_SYS_STATE_DATA, HEARTBEAT_DATA, HOME_POSITION_DATA, MavSeverity, NAMED_VALUE_FLOAT_DATA,
};
use vigil_types::{Nanos, NedVector};

/// Contact that lasts this long is "on the ground"; a bounce is not.
const LANDED_AFTER_NS: Nanos = 300_000_000;
/// How long the position is known without GPS; PX4's EKF2_NOAID_TOUT.
const POSITION_KEPT_NS: Nanos = 5_000_000_000;
/// A thrust below this sinks (0.5 hovers), so that who is still at it for so long stands on something.
const SINKING_THRUST: f32 = 0.48;
const RESTING_M_S: f32 = 0.1;
const RESTING_NS: Nanos = 1_000_000_000;
/// No contact for this long is "in the air".
const AIRBORNE_AFTER_NS: Nanos = 50_000_000;
/// Tilt beyond which the vehicle does not arm: it lies on its side.
const ARMING_TILT_RAD: f32 = core::f32::consts::FRAC_PI_4;

/// What a failsafe does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Response {
    Enter(FlightMode),
    Terminate,
    Disarm,
}

fn broken(what: &str) -> Denial {
    Denial::Other(format!("{what} denied: broken by a collision, reboot first"))
}

impl Core {
    /// Whether the vehicle could be armed now.
    pub fn arming_check(&self) -> Result<(), Denial> {
        if self.commander.terminated {
            return Err(Denial::Terminated("arming"));
        }
        if self.commander.broken {
            return Err(broken("arming"));
        }
        let attitude = self.view.estimate.attitude;
        if attitude.roll_rad().abs() > ARMING_TILT_RAD || attitude.pitch_rad().abs() > ARMING_TILT_RAD {
            return Err(Denial::Tilted);
        }
        if !self.is_inside_fence() {
            return Err(Denial::OutsideFence);
        }
        if let Some(name) = self.lost_sensors.name() {
            return Err(Denial::SensorLost(name));
        }
        if self.commander.armed {
            return Ok(());
        }
        // A mode can be chosen before what it needs is there.
        let denied = |why: &str| Err(Denial::Other(format!("arming denied: {why}")));
        match self.commander.mode {
            mode if mode.needs_sticks() => match self.current_sticks() {
                None => denied("no manual control"),
                Some([.., up, _]) if up > mode.arming_throttle() => denied("throttle is up"),
                Some(_) => Ok(()),
            },
            FlightMode::Mission => match self.mission_check() {
                Err(Denial::NoMission) => denied("no mission"),
                outcome => outcome,
            },
            FlightMode::Offboard if !self.has_setpoints() => denied("no setpoints"),
            mode @ (FlightMode::Land | FlightMode::Return | FlightMode::Follow | FlightMode::Orbit) => {
                denied(&format!("not in {}, change the mode", mode.name()))
            }
            _ => Ok(()),
        }
    }

    /// Whether the owner of OFFBOARD streams, or where there is none somebody does.
    fn has_setpoints(&self) -> bool {
        match self.setpoints.owner {
            Some(_) => self.owners_setpoint().is_some(),
            None => {
                let max_age_ns = self.setpoint_max_age_ns();
                self.setpoints.streaming(self.now_ns, max_age_ns).next().is_some()
            }
        }
    }

    /// Arms. Armed already is accepted. In OFFBOARD that was chosen before anybody streamed, the commander decides who owns it.
    pub fn arm(&mut self, commander: Source) -> Result<(), Denial> {
        if self.commander.armed && !self.commander.terminated {
            return Ok(());
        }
        self.arming_check()?;
        if self.commander.mode == FlightMode::Offboard && self.setpoints.owner.is_none() {
            self.take_ownership(commander)?;
        }
        self.commander.armed = true;
        self.commander.has_flown = !self.commander.is_on_ground();
        self.commander.idle_since_ns = self.now_ns;
        if self.commander.mode == FlightMode::Takeoff {
            self.begin_climb(None);
        }
        self.inform("armed");
        self.announce::<HEARTBEAT_DATA>();
        Ok(())
    }

    /// Disarms; in the air only when forced.
    pub fn disarm(&mut self, forced: bool) -> Result<(), Denial> {
        if !self.commander.armed {
            return Ok(());
        }
        if !forced && !self.commander.is_on_ground() && !self.commander.terminated {
            return Err(Denial::Other("disarming denied: not landed".to_owned()));
        }
        self.disarm_with(if forced { "disarmed: kill" } else { "disarmed" });
        Ok(())
    }

    fn disarm_with(&mut self, text: &str) {
        self.commander.armed = false;
        self.commander.failsafe = None;
        self.commander.speed_m_s = None;
        self.commander.region_of_interest_m = None;
        self.enter(FlightMode::Hold, Maneuver::default());
        self.inform(text);
        self.announce::<HEARTBEAT_DATA>();
    }

    /// Stops the motors for good: only a reboot ends it.
    pub fn terminate(&mut self) {
        if !self.commander.terminated {
            self.commander.terminated = true;
            self.text(MavSeverity::MAV_SEVERITY_EMERGENCY, "flight terminated");
            self.announce::<HEARTBEAT_DATA>();
        }
    }

    /// The vehicle hit something: its motors are off until a reboot.
    pub fn break_down(&mut self) {
        if std::mem::replace(&mut self.commander.broken, true) {
            return;
        }
        let text = "collision: motors off until a reboot";
        self.text(MavSeverity::MAV_SEVERITY_EMERGENCY, text);
        if self.commander.armed {
            self.disarm_with("disarmed: collision");
        }
    }

    /// Starts the autopilot anew; the caller has checked that the vehicle is disarmed or terminated.
    pub fn reboot(&mut self) {
        self.commander = Commander {
            landed: self.commander.landed,
            contact: self.commander.contact,
            contact_since_ns: self.commander.contact_since_ns,
            rests_since_ns: self.now_ns,
            ..Commander::default()
        };
        self.setpoints = Setpoints::default();
        self.sticks = Sticks::default();
        self.lost_sensors = LostSensors::default();
        self.home_m = (0.0, 0.0);
        self.announce::<HOME_POSITION_DATA>();
        self.rebooted = true;
        self.inform("rebooted");
        self.announce::<HEARTBEAT_DATA>();
        self.announce::<NAMED_VALUE_FLOAT_DATA>();
    }

    /// A mode command of `commander`. Clears a failsafe. Accepted also while disarmed: the mode acts once armed.
    pub fn change_mode(&mut self, mode: FlightMode, commander: Source) -> Result<(), Denial> {
        self.position_check(mode)?;
        match mode {
            FlightMode::Offboard => return self.enter_offboard(commander),
            FlightMode::Mission => return self.begin_mission(),
            FlightMode::Takeoff => return self.take_off(None),
            // While disarmed a mode that is flown by sticks waits for them.
            _ if mode.needs_sticks() && self.commander.armed && self.current_sticks().is_none() => {
                return Err(Denial::Other(format!("{} denied: no manual control", mode.name())));
            }
            _ => {}
        }
        self.clear_failsafe();
        self.begin(mode);
        Ok(())
    }

    /// Enters a mode that needs nothing to begin with, any other as Hold.
    fn begin(&mut self, mode: FlightMode) {
        match mode {
            FlightMode::Follow => self.enter(mode, Maneuver::Follow { waits_ned_m: None }),
            FlightMode::Return => self.begin_return(),
            FlightMode::Land => self.enter(mode, Maneuver::Descend),
            _ if mode.needs_sticks() => self.enter(mode, Maneuver::Sticks { held_down_m: None }),
            _ => self.enter(FlightMode::Hold, Maneuver::default()),
        }
    }

    fn enter_offboard(&mut self, commander: Source) -> Result<(), Denial> {
        let max_age_ns = self.setpoint_max_age_ns();
        if self.commander.mode == FlightMode::Offboard
            && let Some(owner) = self.setpoints.owner
        {
            // Whoever streams itself and is not the owner wants something else than what is flown.
            let claims = self.setpoints.claims(self.now_ns, max_age_ns, commander);
            return if claims == [commander] && commander != owner {
                Err(Denial::Other(format!("offboard denied: {owner} owns it")))
            } else {
                Ok(())
            };
        }
        match self.take_ownership(commander) {
            // While disarmed a mode waits for what it needs: arming is refused until then.
            Err(Denial::NoSetpoints(_)) if !self.commander.armed => {
                self.clear_failsafe();
                self.enter(FlightMode::Offboard, Maneuver::Offboard);
                Ok(())
            }
            outcome => outcome,
        }
    }

    /// Enters OFFBOARD for whom the setpoints of now and the commander make its owner.
    fn take_ownership(&mut self, commander: Source) -> Result<(), Denial> {
        let max_age_ns = self.setpoint_max_age_ns();
        let claims = self.setpoints.claims(self.now_ns, max_age_ns, commander);
        match claims.as_slice() {
            [] => {
                let is_fresh = |(at_ns, _): &(Nanos, _)| self.now_ns.saturating_sub(*at_ns) <= max_age_ns;
                let refused = self.setpoints.refused.filter(is_fresh);
                let why = refused.map_or("no setpoints".to_owned(), |(_, defect)| defect.to_string());
                Err(Denial::NoSetpoints(why))
            }
            &[owner] => {
                self.clear_failsafe();
                self.enter(FlightMode::Offboard, Maneuver::Offboard);
                self.setpoints.set_owner(Some(owner));
                self.inform(&format!("setpoint owner: {owner}"));
                self.announce::<NAMED_VALUE_FLOAT_DATA>();
                Ok(())
            }
            several => {
                let names: Vec<String> = several.iter().map(|source| source.id.to_string()).collect();
                Err(Denial::Other(format!(
                    "offboard denied: setpoints from {}",
                    names.join(", ")
                )))
            }
        }
    }

    /// Climbs to `height_m` above home, or by MIS_TAKEOFF_ALT where none is given; stays at its height where that is below it.
    pub fn take_off(&mut self, height_m: Option<f32>) -> Result<(), Denial> {
        if self.commander.broken {
            return Err(broken("takeoff"));
        }
        if self.commander.terminated {
            return Err(Denial::Terminated("takeoff"));
        }
        self.position_check(FlightMode::Takeoff)?;
        self.clear_failsafe();
        if self.commander.armed {
            self.begin_climb(height_m);
        } else {
            self.enter(FlightMode::Takeoff, Maneuver::Grounded { height_m });
        }
        Ok(())
    }

    pub(super) fn begin_climb(&mut self, height_m: Option<f32>) {
        let waiting = match self.commander.maneuver {
            Maneuver::Grounded { height_m } => height_m,
            _ => None,
        };
        let here = self.view.estimate.position_ned_m;
        let default_m = self.param(ParamId::TakeoffAltitudeM) - here.z;
        let wanted_m = height_m.or(waiting).unwrap_or(default_m);
        if wanted_m < -here.z {
            let text = "already higher than take-off altitude";
            self.text(MavSeverity::MAV_SEVERITY_CRITICAL, text);
        }
        let height_m = wanted_m.max(-here.z);
        let rate_m_s = self.param(ParamId::TakeoffSpeedMS);
        self.enter(FlightMode::Takeoff, Maneuver::climb(here, -height_m, rate_m_s));
        self.inform(&format!("take-off to {height_m:.1} m"));
    }

    /// Returns to home or the nearest rally point.
    pub(super) fn begin_return(&mut self) {
        let here = self.view.estimate.position_ned_m;
        let rally_first = self.param(ParamId::ReturnType) == 1.0;
        let (north, east) = self.plans.rally.nearest_m((here.x, here.y), self.home_m, rally_first);
        self.commander.return_to_m = (north, east);
        let away_m = libm::hypotf(here.x - north, here.y - east);
        let maneuver = if self.commander.is_on_ground() {
            Maneuver::Descend
        } else {
            let radius_m = self.param(ParamId::AcceptanceRadiusM);
            let return_m = self.param(ParamId::ReturnAltitudeM);
            // PX4 climbs by RTL_CONE_ANG, 45 degrees, and at the least so that it cannot meet the ground on the way.
            let is_near = away_m <= self.param(ParamId::ReturnMinDistanceM);
            let wanted_m = if is_near { away_m.min(return_m) } else { return_m };
            let height_m = wanted_m.max(2.0 * radius_m.min(away_m));
            Maneuver::climb(here, -height_m.max(-here.z), self.param(ParamId::AutoUpMS))
        };
        self.enter(FlightMode::Return, maneuver);
    }

    /// Whether the mode can be flown by what is known of the position.
    fn position_check(&self, mode: FlightMode) -> Result<(), Denial> {
        match mode.is_flown_without_position() || self.knows_position() {
            true => Ok(()),
            false => Err(Denial::Other(format!("{} denied: position lost", mode.name()))),
        }
    }

    /// Whether it flies, and the mode can be entered.
    pub(super) fn in_air_check(&self, mode: FlightMode) -> Result<(), Denial> {
        match self.commander.armed && !self.commander.is_on_ground() {
            true => self.position_check(mode),
            false => Err(Denial::Other("denied: not in the air".to_owned())),
        }
    }

    /// Goes to a position and holds there.
    pub fn go_to(&mut self, position_ned_m: NedVector, yaw: YawCommand, speed_m_s: Option<f32>) -> Result<(), Denial> {
        self.in_air_check(FlightMode::Hold)?;
        if !self.fence_allows((position_ned_m.x, position_ned_m.y), -position_ned_m.z) {
            return Err(Denial::OutsideFence);
        }
        self.clear_failsafe();
        let speed_limit_m_s = match speed_m_s {
            Some(speed_m_s) => speed_m_s.clamp(0.5, self.param(ParamId::MaxSpeedMS)),
            None => self.cruise_speed_m_s(self.commander.speed_m_s),
        };
        let goal = Goal::new(position_ned_m, yaw, speed_limit_m_s);
        self.enter(FlightMode::Hold, Maneuver::Station(goal));
        Ok(())
    }

    /// Brakes, and holds where it stops.
    pub fn stop_here(&mut self) -> Result<(), Denial> {
        self.in_air_check(FlightMode::Hold)?;
        self.clear_failsafe();
        self.enter(FlightMode::Hold, Maneuver::default());
        Ok(())
    }

    /// Changes mode and maneuver; leaving OFFBOARD clears its owner.
    pub(super) fn enter(&mut self, mode: FlightMode, maneuver: Maneuver) {
        self.commander.maneuver = maneuver;
        self.commander.intended_mode = mode;
        if self.setpoints.owner.is_some() && mode != FlightMode::Offboard {
            self.setpoints.set_owner(None);
            self.inform("setpoint owner: none");
            self.announce::<NAMED_VALUE_FLOAT_DATA>();
        }
        if self.commander.mode != mode {
            self.commander.mode = mode;
            self.inform(&format!("mode: {}", mode.name()));
            self.announce::<HEARTBEAT_DATA>();
            self.announce::<CURRENT_MODE_DATA>();
        }
    }

    pub(super) fn clear_failsafe(&mut self) {
        if self.commander.failsafe.take().is_some() {
            self.announce::<HEARTBEAT_DATA>();
        }
    }

    /// Age up to which a stream of setpoints is one.
    pub(super) fn setpoint_max_age_ns(&self) -> Nanos {
        self.param_ns(ParamId::OffboardLossS)
    }

    /// The same for the owner: shorter where that is the guidance computer, whose every setpoint is a decision on a
    /// fresh frame.
    fn owner_max_age_ns(&self) -> Nanos {
        let max_age_ns = self.setpoint_max_age_ns();
        let guidance = (self.id().system, GUIDANCE_COMPONENT);
        match self.setpoints.owner {
            Some(owner) if (owner.id.system, owner.id.component) == guidance => {
                max_age_ns.min(self.param_ns(ParamId::GuidanceLossS))
            }
            _ => max_age_ns,
        }
    }

    /// The owner's setpoint, if it is fresh.
    pub fn owners_setpoint(&self) -> Option<ControlCommand> {
        self.setpoints.current(self.now_ns, self.owner_max_age_ns())
    }

    /// Horizontal speed of a way: what was asked for, else MPC_XY_CRUISE.
    pub(super) fn cruise_speed_m_s(&self, asked_m_s: Option<f32>) -> f32 {
        let speed_m_s = asked_m_s.unwrap_or(self.param(ParamId::CruiseSpeedMS));
        speed_m_s.min(self.param(ParamId::MaxSpeedMS))
    }

    /// The setpoints that were lost come again: OFFBOARD goes on, as PX4's does.
    pub fn regain_offboard(&mut self, source: Source) {
        let c = &self.commander;
        if c.failsafe == Some(Failsafe::SetpointLost) && c.lost_owner == Some(source) && !c.terminated {
            // The only reason against it is that nobody streams.
            let _ = self.take_ownership(source);
        }
    }

    /// The owner's setpoints stopped: the action of COM_OBL_RC_ACT, and CRITICAL until they come again or the next mode command.
    pub(super) fn lose_setpoints(&mut self) {
        self.commander.lost_owner = self.setpoints.owner;
        let response = match self.param(ParamId::OffboardLossAction) as i32 {
            0 => Response::Enter(FlightMode::Position),
            1 => Response::Enter(FlightMode::Altitude),
            2 => Response::Enter(FlightMode::Stabilized),
            3 => Response::Enter(FlightMode::Return),
            4 => Response::Enter(FlightMode::Land),
            6 => Response::Terminate,
            7 => Response::Disarm,
            _ => Response::Enter(FlightMode::Hold),
        };
        self.respond(response, Failsafe::SetpointLost);
    }

    /// The sticks stopped in a mode that is flown by them: hold, and after COM_FAIL_ACT_T the action of NAV_RCL_ACT.
    pub(super) fn lose_sticks(&mut self) {
        self.commander.acts_ns = Some(self.now_ns.saturating_add(self.param_ns(ParamId::FailsafeDelayS)));
        self.respond(Response::Enter(FlightMode::Hold), Failsafe::ManualControlLost);
    }

    /// Sticks that stop have their consequence in modes that fly without them too, unless COM_RCL_EXCEPT excepts the mode or
    /// the vehicle comes down anyway; then the action that follows, unless somebody took the vehicle meanwhile.
    pub(super) fn watch_lost_sticks(&mut self) {
        const COMES_DOWN: i32 = 1 << 30;
        let has_sticks = self.current_sticks().is_some();
        let had_sticks = std::mem::replace(&mut self.commander.had_sticks, has_sticks);
        let exception = match self.commander.mode {
            FlightMode::Mission => 1,
            FlightMode::Hold | FlightMode::Takeoff => 2,
            FlightMode::Offboard => 4,
            FlightMode::Follow | FlightMode::Orbit => 0,
            _ => COMES_DOWN,
        };
        let excepted = self.param(ParamId::SticksLossExceptions) as i32 | COMES_DOWN;
        let is_free = self.commander.failsafe.is_none() && !self.commander.is_on_ground();
        if had_sticks && !has_sticks && is_free && excepted & exception == 0 {
            self.lose_sticks();
        }
        if self.commander.failsafe != Some(Failsafe::ManualControlLost) {
            self.commander.acts_ns = None;
        }
        let now_ns = self.now_ns;
        if self.commander.acts_ns.take_if(|at_ns| *at_ns <= now_ns).is_none() {
            return;
        }
        let response = match self.param(ParamId::SticksLossAction) as i32 {
            2 => Response::Enter(FlightMode::Return),
            3 => Response::Enter(FlightMode::Land),
            5 => Response::Terminate,
            6 => Response::Disarm,
            _ => return,
        };
        self.respond(response, Failsafe::ManualControlLost);
    }

    pub(super) fn respond(&mut self, response: Response, failsafe: Failsafe) {
        let name = match response {
            Response::Enter(mode) => mode.name(),
            Response::Terminate => "terminate",
            Response::Disarm => "disarm",
        };
        let text = format!("{}: {name}", failsafe.name());
        self.text(MavSeverity::MAV_SEVERITY_CRITICAL, &text);
        match response {
            Response::Enter(mode) => self.fail_over(mode, failsafe),
            Response::Terminate => {
                self.fail_over(FlightMode::Hold, failsafe);
                self.terminate();
            }
            Response::Disarm => self.disarm_with("disarmed: failsafe"),
        }
    }

    /// Changes to Return, Land, Hold or a mode that is flown by sticks, by itself; CRITICAL until the next mode command.
    fn fail_over(&mut self, action: FlightMode, failsafe: Failsafe) {
        let intended = self.commander.intended_mode;
        self.begin(action);
        self.commander.intended_mode = intended;
        self.commander.failsafe = Some(failsafe);
        self.announce::<HEARTBEAT_DATA>();
    }

    /// Whether the position is still known: for a while after the last fix the estimator goes by its inertial sensors.
    pub fn knows_position(&self) -> bool {
        let since_ns = self.lost_sensors.gps_since_ns;
        since_ns.is_none_or(|since_ns| self.now_ns.saturating_sub(since_ns) < POSITION_KEPT_NS)
    }

    /// Lands when the position is lost in a mode that needs it.
    pub(super) fn watch_position(&mut self) {
        let c = &self.commander;
        let needs_position = !c.mode.is_flown_without_position();
        if c.armed && !c.is_on_ground() && needs_position && !self.knows_position() {
            self.respond(Response::Enter(FlightMode::Land), Failsafe::PositionLost);
        }
    }

    /// Follows contact with the ground, and disarms by itself after a landing or a wait.
    pub(super) fn watch_ground(&mut self) {
        let now_ns = self.now_ns;
        let is_resting = self.is_resting();
        let c = &mut self.commander;
        if !is_resting {
            c.rests_since_ns = now_ns;
        }
        let contact = self.view.on_ground || now_ns.saturating_sub(c.rests_since_ns) >= RESTING_NS;
        if contact != c.contact {
            c.contact = contact;
            c.contact_since_ns = now_ns;
        }
        let lasted_ns = now_ns.saturating_sub(c.contact_since_ns);
        let was_on_ground = c.is_on_ground();
        let on_ground = if c.contact {
            was_on_ground || lasted_ns >= LANDED_AFTER_NS
        } else {
            was_on_ground && lasted_ns < AIRBORNE_AFTER_NS
        };
        let landed = if on_ground {
            LandedState::OnGround
        } else {
            match (c.mode, c.maneuver) {
                (FlightMode::Takeoff, _) | (FlightMode::Mission, Maneuver::Climb(_)) => LandedState::TakingOff,
                (_, Maneuver::Descend) => LandedState::Landing,
                _ => LandedState::InAir,
            }
        };
        if on_ground && !was_on_ground {
            c.idle_since_ns = now_ns;
        }
        if !on_ground {
            c.has_flown = true;
        }
        if landed != c.landed {
            c.landed = landed;
            self.announce::<EXTENDED_SYS_STATE_DATA>();
        }
        if self.commander.armed && on_ground {
            self.disarm_when_idle();
        }
    }

    /// Whether it does not move although it is asked for less thrust than carries it: something else does. A thrust just below
    /// the weight leaves too little load on the feet to be felt.
    fn is_resting(&self) -> bool {
        let v = self.view.estimate.velocity_ned_m_s;
        self.wanted_thrust().is_some_and(|thrust| thrust < SINKING_THRUST)
            && v.z.abs() < RESTING_M_S
            && v.horizontal_norm() < 3.0 * RESTING_M_S
    }

    /// The vehicle is about to leave the ground: the time until it disarms itself begins anew.
    pub(super) fn expect_lift_off(&mut self) {
        self.commander.idle_since_ns = self.now_ns;
    }

    fn disarm_when_idle(&mut self) {
        let (limit, text) = match self.commander.has_flown {
            true => (ParamId::DisarmLandS, "disarmed: landed"),
            false => (ParamId::DisarmPreflightS, "disarmed: no take-off"),
        };
        let idle_ns = self.now_ns.saturating_sub(self.commander.idle_since_ns);
        if self.param(limit) > 0.0 && idle_ns >= self.param_ns(limit) {
            self.disarm_with(text);
        }
    }

    /// See [`crate::Endpoint::start_airborne`].
    pub fn start_airborne(&mut self, height_m: f32) {
        let c = &mut self.commander;
        (c.armed, c.has_flown, c.landed) = (true, true, LandedState::InAir);
        (c.contact, c.contact_since_ns) = (false, self.now_ns);
        let stop = Maneuver::Brake {
            began: None,
            height_m: Some(height_m),
        };
        self.enter(FlightMode::Hold, stop);
    }
}
