//! What the vehicle says of itself.

use crate::autopilot::Flavour;
use crate::framing::{Packet, Zeroed};
use crate::geography::Origin;
use mavlink::MessageData;
use mavlink::dialects::common::{
    ATTITUDE_DATA, ATTITUDE_QUATERNION_DATA, EXTENDED_SYS_STATE_DATA, GPS_GLOBAL_ORIGIN_DATA, HEARTBEAT_DATA,
    HOME_POSITION_DATA, LOCAL_POSITION_NED_DATA, MavMessage, SYS_STATUS_DATA,
};
use vigil_types::{
    Attitude, AttitudeSample, FrdVector, Heartbeat, Kinematics, Landed, Nanos, NedVector, VehicleMode, VehicleTelemetry,
};

/// A time since boot this much earlier than the last one is a restart; a smaller step back is a packet out of order.
const RESTART_MS: i32 = 1_000;

/// MAV_STATE numbers that mean a failsafe: CRITICAL, EMERGENCY, FLIGHT_TERMINATION.
const FAILSAFE_STATES: [u8; 3] = [5, 6, 8];
/// MAV_MODE_FLAG_SAFETY_ARMED.
const ARMED: u8 = 128;

/// The vehicle as its messages describe it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Vehicle {
    flavour: Flavour,
    pub telemetry: VehicleTelemetry,
    /// The autopilot that its heartbeat names, when it is a known one.
    pub named: Option<Flavour>,
    pub origin: Option<Origin>,
    /// Height of home above the local origin.
    pub home_height_m: f32,
    pub restarts: u32,
    /// Packets dropped because a newer one came before.
    pub late: u64,
    position_ms: Option<u32>,
    attitude_ms: Option<u32>,
}

impl Vehicle {
    pub fn new(flavour: Flavour) -> Self {
        Self {
            flavour,
            telemetry: VehicleTelemetry::default(),
            named: None,
            origin: None,
            home_height_m: 0.0,
            restarts: 0,
            late: 0,
            position_ms: None,
            attitude_ms: None,
        }
    }

    /// Whether the vehicle's autopilot is known to be another than the configured one.
    pub fn is_other_autopilot(&self) -> bool {
        self.named.is_some_and(|named| named != self.flavour)
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
            | HOME_POSITION_DATA::ID => match packet.message() {
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
        self.telemetry.heartbeat = Some(Heartbeat {
            at_ns: now_ns,
            armed: base_mode & ARMED != 0,
            mode: if self.is_other_autopilot() {
                VehicleMode::Unknown
            } else {
                self.flavour.mode(base_mode, custom_mode)
            },
            failsafe: FAILSAFE_STATES.contains(&state),
        });
    }

    fn message(&mut self, now_ns: Nanos, message: &MavMessage) {
        match message {
            MavMessage::LOCAL_POSITION_NED(m) if self.is_in_order(m.time_boot_ms, |v| &mut v.position_ms) => {
                self.telemetry.kinematics = Some(Kinematics {
                    at_ns: now_ns,
                    position_ned_m: NedVector::new(m.x, m.y, m.z),
                    velocity_ned_m_s: NedVector::new(m.vx, m.vy, m.vz),
                });
            }
            MavMessage::ATTITUDE(m) if self.is_in_order(m.time_boot_ms, |v| &mut v.attitude_ms) => {
                self.telemetry.attitude = Some(AttitudeSample {
                    at_ns: now_ns,
                    attitude: Attitude::from_euler_rad(m.roll, m.pitch, m.yaw),
                    rates_frd_rad_s: FrdVector::new(m.rollspeed, m.pitchspeed, m.yawspeed),
                });
            }
            MavMessage::ATTITUDE_QUATERNION(m) if self.is_in_order(m.time_boot_ms, |v| &mut v.attitude_ms) => {
                self.telemetry.attitude = Some(AttitudeSample {
                    at_ns: now_ns,
                    attitude: Attitude {
                        w: m.q1,
                        x: m.q2,
                        y: m.q3,
                        z: m.q4,
                    },
                    rates_frd_rad_s: FrdVector::new(m.rollspeed, m.pitchspeed, m.yawspeed),
                });
            }
            MavMessage::SYS_STATUS(m) => {
                self.telemetry.battery_remaining = u8::try_from(m.battery_remaining)
                    .ok()
                    .map(|percent| f32::from(percent) / 100.0);
            }
            MavMessage::GPS_GLOBAL_ORIGIN(m) => {
                self.origin = Origin::from_integers(m.latitude, m.longitude, m.altitude).or(self.origin);
            }
            MavMessage::HOME_POSITION(m) => {
                if m.z.is_finite() {
                    self.home_height_m = -m.z;
                }
                // GPS_GLOBAL_ORIGIN is exact; without it, home tells where the origin must be.
                self.origin = self
                    .origin
                    .or_else(|| Origin::from_integers(m.latitude, m.longitude, m.altitude)?.moved_back(m.x, m.y, -m.z));
            }
            _ => {}
        }
    }

    /// Whether a time since boot does not lie before the last of its kind; a long step back is a restart.
    fn is_in_order(&mut self, boot_ms: u32, last: impl Fn(&mut Self) -> &mut Option<u32>) -> bool {
        // Wraps after 49 days.
        let later_ms = last(self).map_or(0, |last_ms| boot_ms.wrapping_sub(last_ms) as i32);
        if later_ms <= -RESTART_MS {
            self.restart();
        } else if later_ms < 0 {
            self.late += 1;
            return false;
        }
        *last(self) = Some(boot_ms);
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
            named: self.named,
            restarts: self.restarts.wrapping_add(1),
            late: self.late,
            ..Self::new(self.flavour)
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
