//! INJECT_FAILURE: switching sensors off, letting them stick, and making them whole again. <https://docs.px4.io/main/en/debug/failure_injection.html>
//!
//! What follows is flight's business: without GPS the vehicle lands when the position is no longer known.

use crate::flight::SensorFault;
use crate::service::prelude::*;
use crate::services::sensors::field_gauss;
use crate::vehicle_parameters::ParamId;

const INJECT_FAILURE: u16 = 420;
/// FAILURE_UNIT_SENSOR_*.
const MAGNETOMETER: f32 = 2.0;
const BAROMETER: f32 = 3.0;
const GPS: f32 = 4.0;
/// FAILURE_TYPE_*.
const OK: f32 = 0.0;
const OFF: f32 = 1.0;
const STUCK: f32 = 2.0;

pub(super) const COMMANDS: &[(u16, Handler)] = &[(INJECT_FAILURE, inject)];

fn inject(command: &Command, _source: Source, core: &mut Core) -> Answer {
    if core.param(ParamId::FailureEnabled) != 1.0 {
        return Err(Refusal::DENIED.saying("failure injection denied: set SYS_FAILURE_EN to 1"));
    }
    let Some(kind @ (OK | OFF | STUCK)) = command.param(2) else {
        // Wrong, slow or noisy readings are not modelled.
        return Err(Refusal::UNSUPPORTED);
    };
    // 0 is all of a kind, and there is one of each.
    if !matches!(command.param(3), None | Some(0.0 | 1.0)) {
        return Err(Refusal::DENIED);
    }
    let name = match command.param(1) {
        Some(GPS) if matches!(kind, OK | OFF) => {
            let now_ns = core.now_ns;
            let since_ns = core.lost_sensors.gps_since_ns;
            core.lost_sensors.gps_since_ns = matches!(kind, OFF).then(|| since_ns.unwrap_or(now_ns));
            "GPS"
        }
        Some(BAROMETER) => {
            core.lost_sensors.barometer = fault(kind, core.view.sensors.barometer_height_m);
            "barometer"
        }
        Some(MAGNETOMETER) => {
            core.lost_sensors.magnetometer = fault(kind, field_gauss(core));
            "compass"
        }
        _ => return Err(Refusal::UNSUPPORTED),
    };
    let (severity, what) = match kind {
        OK => (MavSeverity::MAV_SEVERITY_INFO, "back"),
        STUCK => (MavSeverity::MAV_SEVERITY_WARNING, "stuck"),
        _ => (MavSeverity::MAV_SEVERITY_WARNING, "lost"),
    };
    core.text(severity, &format!("{name} {what}"));
    Ok(())
}

fn fault<T>(kind: f32, reading: T) -> SensorFault<T> {
    match kind {
        OFF => Some(None),
        STUCK => Some(Some(reading)),
        _ => None,
    }
}
