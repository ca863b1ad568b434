//! ESTIMATOR_STATUS: what the estimator believes it knows.

use crate::service::prelude::*;
use vigil_mavlink::common::EstimatorStatusFlags as Flags;

pub(super) const MESSAGES: &[Produced] = &[Produced::from(ESTIMATOR_STATUS_DATA::ID, [0.0, 1.0, 1.0], status)];

/// The flags of what is valid. The modelled estimator has errors but no innovations: test ratios and accuracies are not
/// known (NaN).
fn status(core: &Core) -> Option<MavMessage> {
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
