//! SYS_STATUS, BATTERY_STATUS and ESTIMATOR_STATUS: which sensors there are and whether they work, whether the vehicle can be armed,
//! what is left of the battery, and what the estimator believes it knows. <https://mavlink.io/en/services/battery.html>

use crate::service::prelude::*;
use vigil_mavlink::common::EstimatorStatusFlags as Flags;
use vigil_mavlink::common::{MavSysStatusSensor as Sensor, MavSysStatusSensorExtended as Extended};

pub(super) const MESSAGES: &[Produced] = &[
    Produced::from(SYS_STATUS_DATA::ID, [1.0, 5.0, 1.0], sys_status),
    Produced::from(BATTERY_STATUS_DATA::ID, [0.5, 0.5, 0.5], battery),
    Produced::from(ESTIMATOR_STATUS_DATA::ID, [0.0, 1.0, 1.0], estimator_status),
];

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
    health.set(Sensor::MAV_SYS_STATUS_GEOFENCE, core.fence_status.breach_status == 0);
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
        battery_remaining: percent(core),
        // The crate's default of a bit mask is its first flag.
        onboard_control_sensors_present_extended: Extended::empty(),
        onboard_control_sensors_enabled_extended: Extended::empty(),
        onboard_control_sensors_health_extended: Extended::empty(),
        errors_comm: (core.framing.bad_crc + core.framing.truncated).min(u64::from(u16::MAX)) as u16,
        ..Default::default()
    }))
}

/// Charge in per cent.
fn percent(core: &Core) -> i8 {
    libm::roundf(core.view.sensors.battery_remaining.clamp(0.0, 1.0) * 100.0) as i8
}

fn battery(core: &Core) -> Option<MavMessage> {
    let s = &core.view.sensors;
    // Cells are not modelled: the first entry holds the pack's voltage, the rest is unknown.
    let mut voltages = [u16::MAX; 10];
    voltages[0] = (s.battery_voltage_v * 1e3) as u16;
    let battery_remaining = percent(core);
    let charge_state = match battery_remaining {
        ..=5 => MavBatteryChargeState::MAV_BATTERY_CHARGE_STATE_CRITICAL,
        6..=15 => MavBatteryChargeState::MAV_BATTERY_CHARGE_STATE_LOW,
        _ => MavBatteryChargeState::MAV_BATTERY_CHARGE_STATE_OK,
    };
    Some(message!(
        BATTERY_STATUS,
        current_consumed = -1,
        energy_consumed = -1,
        temperature = i16::MAX,
        voltages,
        current_battery = (s.battery_current_a * 100.0) as i16,
        battery_function = MavBatteryFunction::MAV_BATTERY_FUNCTION_ALL,
        mavtype = MavBatteryType::MAV_BATTERY_TYPE_LIPO,
        battery_remaining,
        charge_state,
        // The crate's default of a bit mask is its first flag.
        fault_bitmask = MavBatteryFault::empty()
    ))
}

/// The flags of what is valid. The modelled estimator has errors but no innovations: test ratios and accuracies are not
/// known (NaN).
fn estimator_status(core: &Core) -> Option<MavMessage> {
    let e = &core.view.estimate;
    let mut flags = Flags::empty();
    flags.set(Flags::ESTIMATOR_ATTITUDE, e.attitude.is_valid());
    let velocity = Flags::ESTIMATOR_VELOCITY_HORIZ | Flags::ESTIMATOR_VELOCITY_VERT;
    flags.set(velocity, e.velocity_ned_m_s.is_finite());
    let position = Flags::ESTIMATOR_POS_HORIZ_REL
        | Flags::ESTIMATOR_POS_HORIZ_ABS
        | Flags::ESTIMATOR_POS_VERT_ABS
        | Flags::ESTIMATOR_PRED_POS_HORIZ_REL
        | Flags::ESTIMATOR_PRED_POS_HORIZ_ABS;
    flags.set(position, e.position_ned_m.is_finite() && core.knows_position());
    Some(MavMessage::ESTIMATOR_STATUS(ESTIMATOR_STATUS_DATA {
        time_usec: core.time_boot_us(),
        vel_ratio: f32::NAN,
        pos_horiz_ratio: f32::NAN,
        pos_vert_ratio: f32::NAN,
        mag_ratio: f32::NAN,
        hagl_ratio: f32::NAN,
        tas_ratio: f32::NAN,
        pos_horiz_accuracy: f32::NAN,
        pos_vert_accuracy: f32::NAN,
        flags,
    }))
}
