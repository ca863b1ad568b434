//! INJECT_FAILURE: switching sensors off and on again. <https://docs.px4.io/main/en/debug/failure_injection.html>
//!
//! What follows is flight's business: without GPS the vehicle lands when the position is no longer known.

use crate::core::Core;
use crate::service::{Answer, Service, Source};
use vigil_mavlink::common::MavSeverity;
use vigil_mavlink::framing::Command;

const INJECT_FAILURE: u16 = 420;
/// FAILURE_UNIT_SENSOR_*.
const MAGNETOMETER: f32 = 2.0;
const BAROMETER: f32 = 3.0;
const GPS: f32 = 4.0;
/// FAILURE_TYPE_*.
const OK: f32 = 0.0;
const OFF: f32 = 1.0;

#[derive(Default)]
pub(crate) struct Failures;

impl Service for Failures {
    fn command(&mut self, command: &Command, _source: Source, core: &mut Core) -> Option<Answer> {
        if command.number != INJECT_FAILURE {
            return None;
        }
        if !core.injects_failures() {
            core.text(
                MavSeverity::MAV_SEVERITY_WARNING,
                "failure injection denied: set SYS_FAILURE_EN to 1",
            );
            return Some(Answer::DENIED);
        }
        // Stuck and wrong readings are not modelled.
        let is_off = match command.param(2) {
            Some(OK) => false,
            Some(OFF) => true,
            _ => return Some(Answer::UNSUPPORTED),
        };
        // 0 is all of a kind, and there is one of each.
        if !matches!(command.param(3), None | Some(0.0 | 1.0)) {
            return Some(Answer::DENIED);
        }
        let name = match command.param(1) {
            Some(GPS) => {
                let now_ns = core.now_ns;
                let since_ns = core.lost_sensors.gps_since_ns;
                core.lost_sensors.gps_since_ns = is_off.then(|| since_ns.unwrap_or(now_ns));
                "GPS"
            }
            Some(BAROMETER) => {
                core.lost_sensors.barometer = is_off;
                "barometer"
            }
            Some(MAGNETOMETER) => {
                core.lost_sensors.magnetometer = is_off;
                "compass"
            }
            _ => return Some(Answer::UNSUPPORTED),
        };
        let (severity, what) = if is_off {
            (MavSeverity::MAV_SEVERITY_WARNING, "lost")
        } else {
            (MavSeverity::MAV_SEVERITY_INFO, "back")
        };
        core.text(severity, &format!("{name} {what}"));
        Some(Answer::ACCEPTED)
    }
}
