//! BATTERY_STATUS. <https://mavlink.io/en/services/battery.html>

use crate::service::prelude::*;

pub(super) const MESSAGES: &[Produced] = &[Produced::from(BATTERY_STATUS_DATA::ID, [0.5, 0.5, 0.5], battery)];

/// Charge in per cent.
pub(super) fn percent(core: &Core) -> i8 {
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
