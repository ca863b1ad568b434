//! A course around a vehicle that is not ours: depth frames from the pose that it reports by MAVLink, and the referee's verdict.

use crate::SensorFault;
use crate::depth_sensor::DepthSensor;
use crate::simulator::Ending;
use crate::world::{Course, LidarConfig, LidarConfigError, Referee, Shot, World};
use mavlink::dialects::common::{HIL_STATE_QUATERNION_DATA, MavMessage};
use vigil_mavlink::Vehicle;
use vigil_mavlink::framing::{self, FramingCounters, Packet};
use vigil_types::{Attitude, DepthFrame, FrameKey, Kinematics, Nanos, NedVector, named};

/// A report older than this is no pose; the firmware's own limit of telemetry.
const REPORT_AGE_NS: Nanos = vigil_types::parameters::TELEMETRY_AGE.nanos();

/// How far a report may be from where the one before leads, metres, and how much farther per second between them.
const JUMP_M: f32 = 1.0;
const JUMP_M_S: f32 = 10.0;

/// Height above home from which the vehicle flies, and the referee decides, metres.
const LIFT_OFF_M: f32 = 0.5;

/// The sensor is never lower above the ground than this, metres: a vehicle stands on its gear, but its position is 0 there, or
/// below where the estimator errs, and from the plane of the ground no ground is seen.
const LOWEST_SENSOR_M: f32 = 0.1;

named! {
    /// What is known of the vehicle's pose.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum PoseState {
        /// Nothing was heard of an autopilot.
        Silent => "no autopilot is heard",
        /// Two autopilots are heard and none was named: whose pose would be rendered is chance, so none is.
        TwoVehicles => "two vehicles are heard: name one by the link's option system=",
        /// An autopilot is heard, but never a LOCAL_POSITION_NED.
        NoPosition => "the vehicle never reports LOCAL_POSITION_NED",
        /// Position is reported, but never ATTITUDE or ATTITUDE_QUATERNION.
        NoAttitude => "the vehicle reports neither ATTITUDE nor ATTITUDE_QUATERNION",
        /// The true pose is to be rendered, but it is not reported (HIL_STATE_QUATERNION and GPS_GLOBAL_ORIGIN).
        NoTruth => "the vehicle does not report HIL_STATE_QUATERNION and GPS_GLOBAL_ORIGIN",
        /// All is fresh: frames are rendered.
        Tracking => "pose is tracked",
        /// Position or attitude is older than 0.3 s: no frames until both are fresh again.
        Stopped => "the vehicle's pose stopped",
        /// The reported position jumped in flight. Nobody knows where the vehicle was in between, so there are no further
        /// frames and no verdict: the flight is to be flown anew.
        Jumped => "the vehicle's position jumped in flight",
        /// The vehicle started anew in flight, with the same end.
        Restarted => "the vehicle restarted in flight",
        /// A position, velocity or attitude is not finite, or a quaternion is not of unit length: no frames until one is good.
        NotFinite => "the vehicle's pose is not finite",
    }
}

impl PoseState {
    /// Whether it gets better by itself only if somebody does something about it: a flight need not be waited for.
    pub const fn is_final(self) -> bool {
        matches!(self, Self::Jumped | Self::Restarted)
    }
}

/// Seconds since a report, as far as it can be carried on.
fn since_s(at_ns: Nanos, now_ns: Nanos) -> f32 {
    now_ns.saturating_sub(at_ns).min(REPORT_AGE_NS) as f32 * 1e-9
}

/// Where a vehicle that reported this is at `now_ns`, by its velocity.
fn carried_on(reported: &Kinematics, now_ns: Nanos) -> NedVector {
    reported.position_ned_m + reported.velocity_ned_m_s * since_s(reported.at_ns, now_ns)
}

fn is_finite(reported: &Kinematics) -> bool {
    reported.position_ned_m.is_finite() && reported.velocity_ned_m_s.is_finite()
}

fn is_fresh(at_ns: Nanos, now_ns: Nanos) -> bool {
    now_ns.saturating_sub(at_ns) <= REPORT_AGE_NS
}

/// How a foreign flight is set up.
#[derive(Debug, Clone, Default)]
pub struct ForeignConfig {
    /// LiDAR model.
    pub lidar: LidarConfig,
    /// Seed of the LiDAR's noise.
    pub seed: u64,
    /// What fails of the LiDAR, if anything.
    pub sensor_fault: Option<SensorFault>,
    /// The key with which frames are authenticated.
    pub frame_key: Option<FrameKey>,
    /// The vehicle's MAVLink system; the first autopilot that is heard, if none.
    pub system: Option<u8>,
    /// Render and referee HIL_STATE_QUATERNION, the truth of a simulated vehicle, instead of what the vehicle believes.
    pub truth: bool,
}

/// One flight of a foreign vehicle over a course. It reads no clock and owns no socket. The course's origin is the vehicle's home
/// (HOME_POSITION; without it the origin of LOCAL_POSITION_NED) as it was at lift-off.
pub struct ForeignFlight {
    world: World,
    referee: Referee,
    sensor: DepthSensor,
    pub(super) vehicle: Vehicle,
    /// The vehicle's system, once it is known.
    pub(super) system: Option<u8>,
    system_is_named: bool,
    /// A vehicle that is heard beside it, where none was named.
    pub(super) other_system: Option<u8>,
    pub(super) wants_truth: bool,
    truth: Option<(Kinematics, Attitude)>,
    /// The last position that was good, by which a jump is found.
    last: Option<Kinematics>,
    restarts: u32,
    /// [`PoseState::Jumped`] or [`PoseState::Restarted`], whichever came first.
    lost: Option<PoseState>,
    pub(super) epoch_ns: Nanos,
    home_ned_m: NedVector,
    path_length_m: f64,
}

impl ForeignFlight {
    /// Sets the course up. `epoch_ns` is the clock's reading at which the movers begin.
    ///
    /// # Errors
    /// A parameter of the LiDAR that cannot be simulated.
    pub fn new(course: &Course, config: &ForeignConfig, epoch_ns: Nanos) -> Result<Self, LidarConfigError> {
        Ok(Self {
            world: World::new(course),
            referee: Referee::new(course),
            sensor: DepthSensor::new(config.lidar, config.seed, config.sensor_fault, config.frame_key.clone())?,
            vehicle: Vehicle::new(None),
            system: config.system,
            system_is_named: config.system.is_some(),
            other_system: None,
            wants_truth: config.truth,
            truth: None,
            last: None,
            restarts: 0,
            lost: None,
            epoch_ns,
            home_ned_m: NedVector::ZERO,
            path_length_m: 0.0,
        })
    }

    /// Takes a datagram that arrived at `now_ns`. Packets of others than the vehicle's autopilot are passed over.
    pub fn receive(&mut self, now_ns: Nanos, datagram: &[u8]) {
        for packet in framing::packets(datagram, &mut FramingCounters::default()) {
            self.packet(now_ns, &packet);
        }
    }

    fn packet(&mut self, now_ns: Nanos, packet: &Packet<'_>) {
        if !packet.is_of_autopilot(&mut self.system) {
            if !self.system_is_named && packet.is_autopilots_heartbeat() {
                self.other_system = Some(packet.system_id());
            }
            return;
        }
        let before = self.vehicle.telemetry.kinematics;
        self.vehicle.receive(now_ns, packet);
        if self.vehicle.restarts != self.restarts {
            self.restarts = self.vehicle.restarts;
            // It begins anew: where it was is nothing to go by. In flight nobody knows where it is.
            (self.last, self.truth) = (None, None);
            self.lose(PoseState::Restarted);
        }
        if self.wants_truth
            && let Ok(MavMessage::HIL_STATE_QUATERNION(m)) = packet.message()
        {
            self.note_truth(now_ns, &m);
        }
        if self.vehicle.telemetry.kinematics != before
            && let Some(motion) = self.vehicle.telemetry.kinematics
        {
            self.note_position(motion);
            if !self.wants_truth {
                self.referee_step(now_ns);
            }
        }
    }

    fn note_truth(&mut self, now_ns: Nanos, m: &HIL_STATE_QUATERNION_DATA) {
        let Some(origin) = self.vehicle.origin else { return };
        let degrees = |e7: i32| f64::from(e7) * 1e-7;
        let (north_m, east_m) = origin.north_east_m(degrees(m.lat), degrees(m.lon));
        let down_m = (origin.altitude_m - f64::from(m.alt) * 1e-3) as f32;
        let m_s = |cm_s: i16| f32::from(cm_s) * 0.01;
        let [w, x, y, z] = m.attitude_quaternion;
        let position_ned_m = NedVector::new(north_m, east_m, down_m);
        let velocity_ned_m_s = NedVector::new(m_s(m.vx), m_s(m.vy), m_s(m.vz));
        let motion = Kinematics::new(now_ns, position_ned_m, velocity_ned_m_s);
        self.truth = Some((motion, Attitude { w, x, y, z }));
        self.referee_step(now_ns);
    }

    fn note_position(&mut self, new: Kinematics) {
        if !is_finite(&new) {
            return;
        }
        if let Some(last) = self.last.replace(new) {
            // After a gap nothing more is allowed than after the longest that is no gap.
            let allowed_m = JUMP_M + JUMP_M_S * since_s(last.at_ns, new.at_ns);
            let astray_m = (new.position_ned_m - carried_on(&last, new.at_ns)).norm();
            if astray_m > allowed_m {
                self.lose(PoseState::Jumped);
            }
        }
        if !self.has_lifted_off() {
            self.home_ned_m = self.vehicle.home_ned_m().unwrap_or(NedVector::ZERO);
        }
    }

    /// The referee's first look is at the lift-off.
    fn has_lifted_off(&self) -> bool {
        self.referee.started_ns.is_some()
    }

    /// On the ground an estimator may still find its place. After the end nothing counts.
    fn lose(&mut self, how: PoseState) {
        if self.has_lifted_off() && self.referee.outcome().is_none() {
            self.lost.get_or_insert(how);
        }
    }

    /// What is rendered and refereed: position and attitude in the local frame.
    fn rendered(&self) -> Option<(Kinematics, Attitude)> {
        if self.wants_truth {
            return self.truth;
        }
        let telemetry = &self.vehicle.telemetry;
        Some((telemetry.kinematics?, telemetry.attitude?.attitude))
    }

    /// The pose that is rendered, on the course, at `now_ns`.
    pub fn pose(&self, now_ns: Nanos) -> Option<(Kinematics, Attitude)> {
        let (motion, attitude) = self.rendered()?;
        let position_ned_m = carried_on(&motion, now_ns) - self.home_ned_m;
        let motion = Kinematics::new(now_ns, position_ned_m, motion.velocity_ned_m_s);
        Some((motion, attitude))
    }

    /// Shows the referee what was just reported.
    fn referee_step(&mut self, now_ns: Nanos) {
        if self.pose_state(now_ns) != PoseState::Tracking || self.referee.outcome().is_some() {
            return;
        }
        let Some((motion, attitude)) = self.pose(now_ns) else {
            return;
        };
        let position_ned_m = motion.position_ned_m;
        // Before home is known an estimate's height may be anything: one that stands does not fly.
        let lifts_off = !self.vehicle.telemetry.stands() && -position_ned_m.z >= LIFT_OFF_M;
        if !self.has_lifted_off() && !lifts_off {
            return;
        }
        if let Some(last) = self.referee.last_ned_m {
            self.path_length_m += f64::from((position_ned_m - last).norm());
        }
        self.world.set_time_ns(now_ns.saturating_sub(self.epoch_ns));
        self.referee
            .observe(&self.world, now_ns, position_ned_m, attitude, motion.velocity_ned_m_s);
    }

    /// What is known of the pose at `now_ns`.
    pub fn pose_state(&self, now_ns: Nanos) -> PoseState {
        if let Some(lost) = self.lost {
            return lost;
        }
        let telemetry = &self.vehicle.telemetry;
        let (Some(position), Some(attitude)) = (telemetry.kinematics, telemetry.attitude) else {
            return match self.system.and(telemetry.heartbeat) {
                None => PoseState::Silent,
                Some(_) if self.other_system.is_some() => PoseState::TwoVehicles,
                Some(_) if telemetry.kinematics.is_none() => PoseState::NoPosition,
                Some(_) => PoseState::NoAttitude,
            };
        };
        let is_old = !is_fresh(position.at_ns, now_ns) || !is_fresh(attitude.at_ns, now_ns);
        match self.rendered() {
            _ if self.other_system.is_some() => PoseState::TwoVehicles,
            None => PoseState::NoTruth,
            Some((rendered, _)) if is_old || !is_fresh(rendered.at_ns, now_ns) => PoseState::Stopped,
            Some((rendered, turn))
                if !is_finite(&rendered)
                    || !is_finite(&position)
                    || !turn.is_valid()
                    || !attitude.attitude.is_valid() =>
            {
                PoseState::NotFinite
            }
            Some(_) => PoseState::Tracking,
        }
    }

    /// Renders and seals the depth frame of `now_ns`, from the reported position carried on by the reported velocity. `false`,
    /// and the frame is as it was, where the pose is not tracked.
    pub fn capture(&mut self, now_ns: Nanos, frame: &mut DepthFrame) -> bool {
        let (PoseState::Tracking, Some(reported), Some(estimate), Some((motion, attitude))) = (
            self.pose_state(now_ns),
            self.vehicle.telemetry.kinematics,
            self.vehicle.telemetry.attitude,
            self.pose(now_ns),
        ) else {
            return false;
        };
        let elapsed_ns = now_ns.saturating_sub(self.epoch_ns);
        self.world.set_time_ns(elapsed_ns);
        let mut position_ned_m = motion.position_ned_m;
        position_ned_m.z = position_ned_m.z.min(-LOWEST_SENSOR_M);
        let shot = Shot {
            estimated_position_ned_m: carried_on(&reported, now_ns),
            estimated_attitude: estimate.attitude,
            stamp_ns: now_ns,
            ..Shot::at(position_ned_m, attitude)
        };
        self.sensor.capture(&self.world, elapsed_ns, shot, frame);
        true
    }

    /// How the flight ended, once it has. A flight whose position jumped, or whose vehicle restarted, before has no ending.
    pub fn ending(&self) -> Option<Ending> {
        let flight_time_s = self.referee.duration_s()?;
        self.referee.outcome().map(|outcome| Ending { outcome, flight_time_s })
    }

    /// Metres flown from lift-off to the ending.
    pub fn path_length_m(&self) -> f64 {
        self.path_length_m
    }

    /// Horizontal distance to the goal; infinite while the pose is not known.
    pub fn goal_distance_m(&self, now_ns: Nanos) -> f32 {
        self.pose(now_ns).map_or(f32::INFINITY, |(motion, _)| {
            (self.referee.goal_ned_m - motion.position_ned_m).horizontal_norm()
        })
    }
}

#[cfg(test)]
mod tests;
