//! Whether the vehicle says that it is ready: its estimator's flags, its pre-arm check, now and all the time before.

use super::Examination;
use crate::doctor::finding::Report;

/// ESTIMATOR_STATUS_FLAGS.
const EKF_ATTITUDE: u16 = 1;
const EKF_VELOCITY: u16 = 2 | 4;
const EKF_POSITION: u16 = 8 | 16;
const EKF_ABSOLUTE_POSITION: u16 = 16;
const EKF_HEIGHT: u16 = 32 | 64;
const EKF_CONSTANT_POSITION: u16 = 128;
const EKF_BAD: u16 = 1024 | 2048;

impl Examination {
    /// What an estimator with these flags lacks.
    pub(super) fn estimator_lacks(&self, flags: u16) -> Vec<&'static str> {
        // A PX4 at rest sets it beside an absolute position: it does stand still.
        let stands = flags & EKF_ABSOLUTE_POSITION != 0 && !self.vehicle.telemetry.is_airborne();
        [
            (flags & EKF_ATTITUDE == 0, "attitude"),
            (flags & EKF_POSITION == 0, "horizontal position"),
            (flags & EKF_HEIGHT == 0, "height"),
            (flags & EKF_VELOCITY != EKF_VELOCITY, "velocity"),
            (
                flags & EKF_CONSTANT_POSITION != 0 && !stands,
                "any source of position (it assumes to stand still)",
            ),
            (
                flags & EKF_BAD != 0,
                "trust in its sensors (GPS glitch, accelerometer error, or not yet started)",
            ),
        ]
        .into_iter()
        .filter_map(|(is_lacking, what)| is_lacking.then_some(what))
        .collect()
    }

    pub(super) fn estimator(&self, report: &mut Report) {
        const WANTED: &str = "attitude, velocity, position and height";
        let Some(flags) = self.estimator else {
            report.absent(
                "estimator",
                "ESTIMATOR_STATUS or EKF_STATUS_REPORT",
                "the vehicle does not say whether its position can be relied on",
            );
            return;
        };
        let lacks = self.estimator_lacks(flags);
        if !lacks.is_empty() {
            report.failure(
                "estimator",
                format!("not ready ({flags:#06x}): lacks {}", lacks.join(", ")),
                WANTED,
                "the vehicle refuses OFFBOARD or GUIDED, or flies by a wrong position: wait for GPS, or see its texts",
            );
        } else if let Some(before) = self.was_not_ready {
            let lacked = self.estimator_lacks(before).join(", ");
            report.warning(
                "estimator",
                format!("ready ({flags:#06x}), but for a while it was not ({before:#06x}): it lacked {lacked}"),
                WANTED,
                "in flight the vehicle leaves OFFBOARD or GUIDED then: did it just start, does GPS come and go?",
            );
        } else {
            report.good("estimator", format!("ready ({flags:#06x})"));
        }
    }

    pub(super) fn arming(&self, report: &mut Report) {
        let texts: Vec<&str> = self.prearm_texts.iter().map(String::as_str).collect();
        let said = |otherwise: &str| match texts.is_empty() {
            true => otherwise.to_owned(),
            false => texts.join("; "),
        };
        match self.is_armable {
            None => {}
            Some(false) => report.failure(
                "arming",
                said("the pre-arm check fails"),
                "the pre-arm check passes",
                "the vehicle will refuse to be armed",
            ),
            Some(true) if self.was_not_armable => report.warning(
                "arming",
                format!("for a while: {}", said("the pre-arm check failed")),
                "the pre-arm check passes",
                "did the vehicle just start? Else it will refuse now and then",
            ),
            Some(true) => report.good("arming", "the pre-arm check passes".to_owned()),
        }
    }
}
