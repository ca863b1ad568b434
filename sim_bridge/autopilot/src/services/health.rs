//! SYS_STATUS: which sensors there are and whether they work, and whether the vehicle can be armed.

use crate::service::prelude::*;
use crate::services::battery;
use vigil_mavlink::common::{MavSysStatusSensor as Sensor, MavSysStatusSensorExtended as Extended};

pub(super) const MESSAGES: &[Produced] = &[Produced::from(SYS_STATUS_DATA::ID, [1.0, 5.0, 1.0], sys_status)];

fn sys_status(core: &Core) -> Option<MavMessage> {
    let mut present = Sensor::MAV_SYS_STATUS_SENSOR_3D_GYRO
        | Sensor::MAV_SYS_STATUS_SENSOR_3D_ACCEL
        | Sensor::MAV_SYS_STATUS_SENSOR_3D_MAG
        | Sensor::MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
        | Sensor::MAV_SYS_STATUS_SENSOR_GPS
        | Sensor::MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
        | Sensor::MAV_SYS_STATUS_AHRS
        | Sensor::MAV_SYS_STATUS_SENSOR_BATTERY
        | Sensor::MAV_SYS_STATUS_PREARM_CHECK;
    present.set(Sensor::MAV_SYS_STATUS_GEOFENCE, core.has_fence());
    let mut health = present;
    // Healthy also without a geofence: ground stations take the bit's absence for a breach.
    health.set(Sensor::MAV_SYS_STATUS_GEOFENCE, core.fence_watch.breach.is_none());
    let lost = core.lost_sensors;
    health.set(Sensor::MAV_SYS_STATUS_SENSOR_GPS, lost.gps_since_ns.is_none());
    let has_barometer = lost.barometer.is_none();
    health.set(Sensor::MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE, has_barometer);
    health.set(Sensor::MAV_SYS_STATUS_SENSOR_3D_MAG, lost.magnetometer.is_none());
    health.set(Sensor::MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS, !core.commander.broken);
    let e = &core.view.estimate;
    let has_pose = e.attitude.is_valid() && e.position_ned_m.is_finite() && core.knows_position();
    health.set(Sensor::MAV_SYS_STATUS_AHRS, has_pose);
    health.set(Sensor::MAV_SYS_STATUS_PREARM_CHECK, core.arming_check().is_ok());
    let s = &core.view.sensors;
    Some(MavMessage::SYS_STATUS(SYS_STATUS_DATA {
        onboard_control_sensors_present: present,
        onboard_control_sensors_enabled: present,
        onboard_control_sensors_health: health,
        load: 100,
        voltage_battery: (s.battery_voltage_v * 1e3) as u16,
        current_battery: (s.battery_current_a * 100.0) as i16,
        battery_remaining: battery::percent(core),
        // The crate's default of a bit mask is its first flag.
        onboard_control_sensors_present_extended: Extended::empty(),
        onboard_control_sensors_enabled_extended: Extended::empty(),
        onboard_control_sensors_health_extended: Extended::empty(),
        errors_comm: (core.framing.bad_crc + core.framing.truncated).min(u64::from(u16::MAX)) as u16,
        ..Default::default()
    }))
}
