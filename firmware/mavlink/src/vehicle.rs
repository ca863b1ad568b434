//! What the vehicle says of itself.

use crate::autopilot::Flavour;
use crate::following::Following;
use crate::framing::{Packet, Zeroed};
use crate::globe::Origin;
use crate::heading_error::HeadingError;
use crate::velocity_error::VelocityError;
use mavlink::MessageData;
use mavlink::dialects::common::{
    ATTITUDE_DATA, ATTITUDE_QUATERNION_DATA, EXTENDED_SYS_STATE_DATA, GPS_GLOBAL_ORIGIN_DATA, HEARTBEAT_DATA,
    HOME_POSITION_DATA, LOCAL_POSITION_NED_DATA, MavFrame, MavMessage, OBSTACLE_DISTANCE_DATA,
    POSITION_TARGET_GLOBAL_INT_DATA, SYS_STATUS_DATA,
};
use vigil_types::{
    Attitude, AttitudeSample, FrdVector, HeadingVector, Heartbeat, Kinematics, Landed, MissionMotion, Nanos, NedVector,
    RANGE_SECTORS, RANGE_SOURCES, SectorRanges, VehicleMode, VehicleTelemetry,
};

/// A time since boot this much earlier than the last is a restart, once another follows it; a smaller step back is a packet out of order.
pub const RESTART_MS: u32 = 1_000;

/// MAV_STATE numbers that mean a failsafe: CRITICAL, EMERGENCY, FLIGHT_TERMINATION.
const FAILSAFE_STATES: [u8; 3] = [5, 6, 8];
/// MAV_MODE_FLAG_SAFETY_ARMED.
const ARMED: u8 = 128;

/// What is older than this says nothing of how the vehicle moves now.
const FRESH_NS: Nanos = vigil_types::parameters::TELEMETRY_AGE.nanos();

/// Where home is reported in two ways that differ by more than this, metres, the vehicle fills only one of them.
const SAME_PLACE_M: f32 = 1.0;

/// A vehicle that stands this near home, metres, stands at it.
const AT_HOME_M: f32 = 2.0;

/// The ground under such a vehicle contradicts home's height from the first on, metres; by more than the second it is a home elsewhere.
const HOME_HEIGHT_ERROR_M: (f32, f32) = (0.3, 5.0);

/// What OBSTACLE_DISTANCE says, turned with the vehicle; `None` where it contradicts itself (a distance beyond its own limits, no width of a
/// sector), says nothing, or is turned otherwise. <https://mavlink.io/en/messages/common.html#OBSTACLE_DISTANCE>
fn sector_ranges(now_ns: Nanos, component: u8, m: &OBSTACLE_DISTANCE_DATA) -> Option<SectorRanges> {
    const UNKNOWN: u16 = u16::MAX;
    let step_deg = if m.increment_f != 0.0 {
        m.increment_f
    } else {
        f32::from(m.increment)
    };
    let is_turned_with_vehicle = m.frame == MavFrame::MAV_FRAME_BODY_FRD;
    let is_wide = step_deg.is_finite() && step_deg != 0.0 && step_deg.abs() <= 360.0 && m.angle_offset.is_finite();
    if !is_turned_with_vehicle || !is_wide || m.min_distance >= m.max_distance {
        return None;
    }
    let (least_cm, most_cm) = (m.min_distance, m.max_distance);
    let mut range_m = [f32::NAN; RANGE_SECTORS];
    for (range_m, distance_cm) in range_m.iter_mut().zip(m.distances) {
        *range_m = match distance_cm {
            UNKNOWN => f32::NAN,
            nothing if u32::from(nothing) == u32::from(most_cm) + 1 => f32::INFINITY,
            // The obstacle touches the sensor.
            0 => 0.0,
            seen if (least_cm..=most_cm).contains(&seen) => f32::from(seen) * 0.01,
            _ => return None,
        };
    }
    let says_something = range_m.iter().any(|range_m| !range_m.is_nan());
    says_something.then(|| SectorRanges {
        component,
        at_ns: now_ns,
        first_rad: m.angle_offset.to_radians(),
        step_rad: step_deg.to_radians(),
        range_m,
    })
}

/// Times since boot of one kind of message, milliseconds.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct BootTimes {
    last_ms: Option<u32>,
    /// Of the packet before, if it came from long before the last: it is late, or the first after a restart.
    back_ms: Option<u32>,
}

/// The vehicle as its messages describe it: the packets of one autopilot in, what they say out.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Vehicle {
    flavour: Flavour,
    /// The flavour was configured, not recognised.
    fixed: bool,
    /// Guidance has the vehicle: its autopilot is not recognised anew.
    pub in_flight: bool,
    /// Position, attitude, mode and what else is known, with the time of its arrival.
    pub telemetry: VehicleTelemetry,
    /// The autopilot that its heartbeat names, when it is a known one.
    pub named: Option<Flavour>,
    /// MAV_AUTOPILOT of its heartbeat.
    pub mav_autopilot: u8,
    /// Where the local origin is on the globe, as GPS_GLOBAL_ORIGIN has it or else HOME_POSITION implies.
    pub origin: Option<Origin>,
    /// The origin came by GPS_GLOBAL_ORIGIN and was not inferred from home.
    origin_known: bool,
    /// HOME_POSITION: the place in the local frame, and on the globe.
    home: Option<(NedVector, Option<Origin>)>,
    /// Home's height by the vehicle's own report while it stood there, metres down, where it contradicts the reported one.
    home_down_m: Option<f32>,
    /// Latitude and longitude, degrees, of the place to which its mission goes, as it was reported last in that mode.
    mission_place_deg: Option<(f64, f64)>,
    /// How it changes its speed in a mission, by its parameters.
    pub mission_motion: MissionMotion,
    /// The last usable OBSTACLE_DISTANCE of each component: of sensors beside the depth camera.
    pub sector_ranges: [Option<SectorRanges>; RANGE_SOURCES],
    /// How often the autopilot was seen to start anew.
    pub restarts: u32,
    /// Packets dropped because a newer one came before.
    pub late: u64,
    position_times: BootTimes,
    attitude_times: BootTimes,
    velocity_error: VelocityError,
    /// What is left of it, by the pictures.
    pub(crate) seen_error_m_s: NedVector,
    heading_error: HeadingError,
    following: Following,
    /// The greatest speed that the pilot may want, metres per second, where it is a parameter.
    pub(crate) speed_limit_m_s: Option<f32>,
}

impl Vehicle {
    /// `flavour`: what the vehicle must be; `None` recognises it from its heartbeat.
    pub fn new(flavour: Option<Flavour>) -> Self {
        Self {
            flavour: flavour.unwrap_or_default(),
            fixed: flavour.is_some(),
            ..Self::default()
        }
    }

    /// The configured flavour, or the recognised one; PX4 until the vehicle is heard, and where it names no known autopilot.
    pub fn flavour(&self) -> Flavour {
        self.flavour
    }

    /// Whether the vehicle reported where its local origin is on the globe.
    pub fn is_origin_known(&self) -> bool {
        self.origin_known
    }

    /// Home in the local frame: as the vehicle reports it there, or on the globe where it fills only those fields.
    pub fn home_ned_m(&self) -> Option<NedVector> {
        let reported = self.reported_home_ned_m()?;
        let down_m = self.home_down_m.unwrap_or(reported.z);
        Some(NedVector::new(reported.x, reported.y, down_m))
    }

    fn reported_home_ned_m(&self) -> Option<NedVector> {
        let (ned_m, place) = self.home?;
        let on_globe = match (self.origin.filter(|_| self.origin_known), place) {
            (Some(origin), Some(place)) => {
                let (north_m, east_m) = origin.north_east_m(place.latitude_deg, place.longitude_deg);
                let down_m = (origin.altitude_m - place.altitude_m) as f32;
                Some(NedVector::new(north_m, east_m, down_m))
            }
            _ => None,
        };
        let is_filled = ned_m.is_finite()
            && match on_globe {
                _ if ned_m != NedVector::ZERO => true,
                Some(place) => place.norm() < SAME_PLACE_M,
                // Zeros beside a place on the globe say nothing until the origin is known.
                None => place.is_none(),
            };
        if is_filled { Some(ned_m) } else { on_globe }
    }

    /// Metres north and east, in the local frame, of the place to which its mission goes; `None` when it has not reported it.
    pub fn mission_place_m(&self) -> Option<(f32, f32)> {
        let (latitude_deg, longitude_deg) = self.mission_place_deg?;
        Some(self.origin?.north_east_m(latitude_deg, longitude_deg))
    }

    /// Height of home above the local origin; 0 where it is not known.
    pub fn home_height_m(&self) -> f32 {
        self.home_ned_m().map_or(0.0, |home_ned_m| -home_ned_m.z)
    }

    /// Whether its velocity is the rate at which its position changes.
    pub fn estimate_agrees_with_itself(&self) -> bool {
        self.velocity_error.lacks_m_s() == NedVector::ZERO
    }

    /// What to add to the reported heading, radians, so that it is where the nose points.
    pub fn heading_lacks_rad(&self) -> f32 {
        self.heading_error.lacks_rad()
    }

    /// The velocity to ask for, so that the position moves as wanted from the nose while the reported heading and velocity are off
    /// ([`HeadingError`], [`VelocityError`]), and a vehicle that `obeys` does not lag behind ([`Following`]); as it is wanted where nothing
    /// fresh is known.
    pub(crate) fn asked_velocity(&mut self, now_ns: Nanos, wanted_m_s: HeadingVector, obeys: bool) -> HeadingVector {
        let seen_error_m_s = self.seen_error_m_s;
        let lacks_m_s = self.velocity_error.lacks_m_s() - seen_error_m_s;
        let lacks_rad = self.heading_lacks_rad();
        let is_fresh = self
            .telemetry
            .flight_data_age_ns(now_ns)
            .is_some_and(|age_ns| age_ns <= FRESH_NS);
        let known = self.telemetry.kinematics.zip(self.telemetry.attitude);
        let Some((kinematics, sample)) = known.filter(|_| is_fresh && self.telemetry.is_finite()) else {
            self.following.pause();
            return wanted_m_s;
        };
        let yaw_rad = sample.attitude.yaw_rad();
        let more_m_s = if obeys {
            let wanted_ned_m_s = wanted_m_s.to_ned(yaw_rad + lacks_rad);
            let moves_m_s = kinematics.velocity_ned_m_s - seen_error_m_s;
            let limit_m_s = self.speed_limit_m_s.unwrap_or(f32::MAX);
            self.following.take(now_ns, wanted_ned_m_s, limit_m_s, moves_m_s)
        } else {
            self.following.pause();
            NedVector::ZERO
        };
        let lacks_m_s = lacks_m_s - more_m_s;
        if lacks_m_s == NedVector::ZERO && lacks_rad == 0.0 {
            return wanted_m_s;
        }
        wanted_m_s.to_ned(lacks_rad).to_heading(0.0) - lacks_m_s.to_heading(yaw_rad)
    }

    /// How long ago the autopilot started, by its own clock.
    pub fn up_ns(&self) -> Option<Nanos> {
        let ms = self.position_times.last_ms.max(self.attitude_times.last_ms)?;
        Some(Nanos::from(ms) * 1_000_000)
    }

    /// Whether the vehicle's autopilot is known to be another than the one in force.
    pub fn is_other_autopilot(&self) -> bool {
        self.named.is_some_and(|named| named != self.flavour)
    }

    /// One that contradicts itself says nothing: the component's last usable one grows old. A component too many is heard once another is silent.
    fn take_ranges(&mut self, now_ns: Nanos, component: u8, m: &OBSTACLE_DISTANCE_DATA) {
        let place = |ranges: &SectorRanges| (if ranges.component == component { 0 } else { 2 }, ranges.at_ns);
        let is_silent = |ranges: &SectorRanges| now_ns.saturating_sub(ranges.at_ns) > FRESH_NS;
        let slots = self.sector_ranges.iter_mut();
        let free = slots.filter(|slot| slot.is_none_or(|r| r.component == component || is_silent(&r)));
        let slot = free.min_by_key(|slot| slot.as_ref().map_or((1, 0), place));
        if let (Some(slot), Some(ranges)) = (slot, sector_ranges(now_ns, component, m)) {
            *slot = Some(ranges);
        }
    }

    /// Takes a packet of the vehicle. Returns `false` when the message is one of interest and could not be read.
    pub fn receive(&mut self, now_ns: Nanos, packet: &Packet<'_>) -> bool {
        match packet.message_id() {
            // Read raw: an unknown type or state of a vehicle must not make it silent.
            HEARTBEAT_DATA::ID => self.heartbeat(now_ns, &Zeroed(packet.payload())),
            EXTENDED_SYS_STATE_DATA::ID => self.telemetry.landed = landed(Zeroed(packet.payload()).u8(1)),
            SYS_STATUS_DATA::ID
            | ATTITUDE_DATA::ID
            | ATTITUDE_QUATERNION_DATA::ID
            | LOCAL_POSITION_NED_DATA::ID
            | GPS_GLOBAL_ORIGIN_DATA::ID
            | HOME_POSITION_DATA::ID
            | OBSTACLE_DISTANCE_DATA::ID
            | POSITION_TARGET_GLOBAL_INT_DATA::ID => match packet.message() {
                Ok(MavMessage::OBSTACLE_DISTANCE(m)) => self.take_ranges(now_ns, packet.component_id(), &m),
                Ok(message) => self.message(now_ns, &message),
                Err(_) => return false,
            },
            _ => {}
        }
        true
    }

    fn heartbeat(&mut self, now_ns: Nanos, payload: &Zeroed<'_>) {
        let (custom_mode, autopilot, base_mode, state) = (payload.u32(0), payload.u8(5), payload.u8(6), payload.u8(7));
        self.named = Flavour::of_autopilot(autopilot);
        self.mav_autopilot = autopilot;
        if let (false, false, Some(named)) = (self.fixed, self.in_flight, self.named) {
            self.flavour = named;
        }
        let mode = match self.is_other_autopilot() {
            true => VehicleMode::Unknown,
            false => self.flavour.mode(base_mode, custom_mode),
        };
        if mode != VehicleMode::Mission {
            // The next mission goes elsewhere.
            self.mission_place_deg = None;
        }
        self.telemetry.heartbeat = Some(Heartbeat {
            at_ns: now_ns,
            armed: base_mode & ARMED != 0,
            mode,
            failsafe: FAILSAFE_STATES.contains(&state),
        });
    }

    fn message(&mut self, now_ns: Nanos, message: &MavMessage) {
        match message {
            MavMessage::LOCAL_POSITION_NED(m) if self.is_in_order(m.time_boot_ms, |v| &mut v.position_times) => {
                let position_ned_m = NedVector::new(m.x, m.y, m.z);
                let velocity_ned_m_s = NedVector::new(m.vx, m.vy, m.vz);
                let lacks_m_s = self
                    .velocity_error
                    .take(m.time_boot_ms, position_ned_m, velocity_ned_m_s);
                let velocity_ned_m_s = velocity_ned_m_s + lacks_m_s;
                self.telemetry.kinematics = Some(Kinematics::new(now_ns, position_ned_m, velocity_ned_m_s));
            }
            MavMessage::ATTITUDE(m) if self.is_in_order(m.time_boot_ms, |v| &mut v.attitude_times) => {
                let attitude = Attitude::from_euler_rad(m.roll, m.pitch, m.yaw);
                let rates_frd_rad_s = FrdVector::new(m.rollspeed, m.pitchspeed, m.yawspeed);
                self.attitude(now_ns, m.time_boot_ms, attitude, rates_frd_rad_s);
            }
            MavMessage::ATTITUDE_QUATERNION(m) if self.is_in_order(m.time_boot_ms, |v| &mut v.attitude_times) => {
                let (w, x, y, z) = (m.q1, m.q2, m.q3, m.q4);
                let rates_frd_rad_s = FrdVector::new(m.rollspeed, m.pitchspeed, m.yawspeed);
                self.attitude(now_ns, m.time_boot_ms, Attitude { w, x, y, z }, rates_frd_rad_s);
            }
            MavMessage::SYS_STATUS(m) => {
                self.telemetry.battery_remaining = u8::try_from(m.battery_remaining)
                    .ok()
                    .map(|percent| f32::from(percent) / 100.0);
            }
            MavMessage::GPS_GLOBAL_ORIGIN(m) => {
                if let Some(origin) = Origin::from_integers(m.latitude, m.longitude, m.altitude) {
                    (self.origin, self.origin_known) = (Some(origin), true);
                }
            }
            // In other modes the message has what they fly to.
            MavMessage::POSITION_TARGET_GLOBAL_INT(m)
                if self.telemetry.heartbeat.is_some_and(|h| h.mode == VehicleMode::Mission) =>
            {
                self.mission_place_deg = Origin::from_integers(m.lat_int, m.lon_int, 0)
                    .filter(|place| place.latitude_deg != 0.0 || place.longitude_deg != 0.0)
                    .map(|place| (place.latitude_deg, place.longitude_deg));
            }
            MavMessage::HOME_POSITION(m) => {
                let before = self.home_ned_m();
                let place = Origin::from_integers(m.latitude, m.longitude, m.altitude);
                self.home = Some((NedVector::new(m.x, m.y, m.z), place));
                // GPS_GLOBAL_ORIGIN is exact; without it, home shows where the origin must be.
                self.origin = self.origin.or_else(|| place?.moved_back(m.x, m.y, -m.z));
                self.home_down_m = self.home_down_m(before);
            }
            _ => {}
        }
    }

    fn attitude(&mut self, now_ns: Nanos, boot_ms: u32, attitude: Attitude, rates_frd_rad_s: FrdVector) {
        self.heading_error
            .take(boot_ms, attitude, rates_frd_rad_s, self.telemetry.is_airborne());
        self.telemetry.attitude = Some(AttitudeSample::new(now_ns, attitude, rates_frd_rad_s));
    }

    /// PX4 lets home's height follow its GNSS: by metres, every other second, in flight too. A vehicle that stands at home knows
    /// better, and in the air the ground stays where it was.
    fn home_down_m(&self, before: Option<NedVector>) -> Option<f32> {
        let reported = self.reported_home_ned_m()?;
        let (at, within_m, (least_m, most_m)) = if self.telemetry.stands() {
            (
                self.telemetry.kinematics?.position_ned_m,
                AT_HOME_M,
                HOME_HEIGHT_ERROR_M,
            )
        } else {
            (before?, SAME_PLACE_M, (0.0, f32::INFINITY))
        };
        let error_m = (at.z - reported.z).abs();
        ((at - reported).horizontal_norm() < within_m && error_m > least_m && error_m < most_m).then_some(at.z)
    }

    /// Whether a time since boot does not lie before the last of its kind; two that follow each other long before it are a restart.
    fn is_in_order(&mut self, boot_ms: u32, times: impl Fn(&mut Self) -> &mut BootTimes) -> bool {
        let BootTimes { last_ms, back_ms } = *times(self);
        // Wraps after 49 days.
        let later_ms = last_ms.map_or(0, |last_ms| boot_ms.wrapping_sub(last_ms) as i32);
        let is_long_before = later_ms <= -(RESTART_MS as i32);
        let follows = |back_ms: u32| (1..2 * RESTART_MS).contains(&boot_ms.wrapping_sub(back_ms));
        if is_long_before && back_ms.is_some_and(follows) {
            self.restart();
        } else if later_ms < 0 {
            self.late += 1;
            times(self).back_ms = is_long_before.then_some(boot_ms).or(back_ms);
            return false;
        }
        *times(self) = BootTimes {
            last_ms: Some(boot_ms),
            back_ms: None,
        };
        true
    }

    /// The autopilot started anew: what it said before is no longer true.
    fn restart(&mut self) {
        *self = Self {
            // The heartbeat that came last may already be the new one's; it also says which vehicle this is.
            telemetry: VehicleTelemetry {
                heartbeat: self.telemetry.heartbeat,
                ..VehicleTelemetry::default()
            },
            flavour: self.flavour,
            fixed: self.fixed,
            in_flight: self.in_flight,
            named: self.named,
            mav_autopilot: self.mav_autopilot,
            restarts: self.restarts.wrapping_add(1),
            late: self.late,
            ..Self::new(None)
        };
    }
}

/// MAV_LANDED_STATE.
fn landed(state: u8) -> Landed {
    match state {
        1 => Landed::OnGround,
        2 => Landed::InAir,
        3 => Landed::TakingOff,
        4 => Landed::Landing,
        _ => Landed::Unknown,
    }
}
