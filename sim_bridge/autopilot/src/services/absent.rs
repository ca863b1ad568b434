//! Messages that PX4 knows and this vehicle has nothing to put into: there is no pilot's receiver, no range finder
//! and no transponder, the mixer's inputs are not modelled, and the estimator knows no wind. A client may set their rate, as it
//! may with PX4 where the sensor is missing; none is ever sent, and a request for one is DENIED.

use crate::service::prelude::*;

pub(super) const MESSAGES: &[Produced] = &[
    absent(RC_CHANNELS_DATA::ID),
    absent(DISTANCE_SENSOR_DATA::ID),
    absent(ACTUATOR_CONTROL_TARGET_DATA::ID),
    absent(WIND_COV_DATA::ID),
    absent(ADSB_VEHICLE_DATA::ID),
    absent(SCALED_IMU2_DATA::ID),
    absent(SCALED_IMU3_DATA::ID),
    absent(SCALED_PRESSURE2_DATA::ID),
    absent(SCALED_PRESSURE3_DATA::ID),
    absent(OPTICAL_FLOW_RAD_DATA::ID),
    absent(LANDING_TARGET_DATA::ID),
    absent(RAW_RPM_DATA::ID),
    absent(ESC_INFO_DATA::ID),
    absent(ESC_STATUS_DATA::ID),
];

const fn absent(id: u32) -> Produced {
    Produced::from(id, [0.0; 3], |_| None)
}
