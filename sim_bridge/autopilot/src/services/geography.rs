//! HOME_POSITION, GPS_GLOBAL_ORIGIN and FENCE_STATUS, and the watch over the geofence.
//! <https://mavlink.io/en/services/home.html>, <https://mavlink.io/en/messages/common.html#FENCE_STATUS>
//!
//! Home and origin are both the local origin until DO_SET_HOME moves home, which changes where a return flies to and what
//! GF_MAX_HOR_DIST is counted from. Home keeps its height: the world is level, and heights are above it.

use crate::geo::{self, MAX_DISTANCE_M, ORIGIN, deg_e7};
use crate::plan::mission::DO_SET_HOME;
use crate::service::prelude::*;
use crate::services::actions::{latitude_longitude_deg, to_local};
use vigil_types::NedVector;

pub(super) const COMMANDS: &[(u16, Handler)] = &[(DO_SET_HOME, set_home)];

pub(super) const MESSAGES: &[Produced] = &[
    Produced::from(HOME_POSITION_DATA::ID, [0.5, 0.5, 0.5], home),
    Produced::from(GPS_GLOBAL_ORIGIN_DATA::ID, [0.5, 0.5, 0.5], origin),
];

/// How far the height of a place may be from home's that is still meant to be the same.
const SAME_HEIGHT_M: f64 = 1.0;

/// The origin is where the simulated world has it; whoever wants another is sent the one in force.
pub(super) fn set_origin(wanted: SET_GPS_GLOBAL_ORIGIN_DATA, _source: Source, core: &mut Core) {
    let off = [
        f64::from(wanted.latitude) - ORIGIN.latitude_deg * 1e7,
        f64::from(wanted.longitude) - ORIGIN.longitude_deg * 1e7,
        f64::from(wanted.altitude) - ORIGIN.altitude_m * 1e3,
    ];
    // Clients cut off what they cannot send.
    if off.iter().any(|off| off.abs() > 2.0) {
        core.warn_refused("origin denied: the simulated world has its own");
    }
    core.announce::<GPS_GLOBAL_ORIGIN_DATA>();
}

/// Parameter 1 says whether home is where the vehicle is now (1) or where parameters 5 to 7 say (0). The altitude is above
/// sea level whatever the frame, as PX4 reads it: MAVSDK sends it so in a frame that is relative to home.
fn set_home(command: &Command, _source: Source, core: &mut Core) -> Answer {
    let here = core.view.estimate.position_ned_m;
    let home_m = match (command.param(1), latitude_longitude_deg(command)) {
        (Some(1.0), _) => (here.x, here.y),
        (Some(0.0) | None, Some(place)) if geo::is_global(command.frame()) => {
            let altitude_m = command.param(7).map_or(ORIGIN.altitude_m, f64::from);
            // An infinite altitude is at no height.
            if (altitude_m - ORIGIN.altitude_m).abs() > SAME_HEIGHT_M {
                return Err(Refusal::DENIED.saying("denied: home keeps its height"));
            }
            to_local(place)?
        }
        _ => return Err(Refusal::DENIED),
    };
    if libm::hypotf(home_m.0 - here.x, home_m.1 - here.y) > MAX_DISTANCE_M {
        return Err(Refusal::DENIED.saying("denied: too far from the vehicle"));
    }
    core.home_m = home_m;
    core.announce::<HOME_POSITION_DATA>();
    Ok(())
}

fn home(core: &Core) -> Option<MavMessage> {
    let (x, y) = core.home_m;
    let (latitude, longitude, altitude_m) = geo::to_global(NedVector::new(x, y, 0.0));
    Some(message!(
        HOME_POSITION,
        latitude,
        longitude,
        altitude = (altitude_m * 1e3) as i32,
        x,
        y,
        q = [1.0, 0.0, 0.0, 0.0],
        time_usec = core.time_boot_us()
    ))
}

fn origin(core: &Core) -> Option<MavMessage> {
    Some(MavMessage::GPS_GLOBAL_ORIGIN(GPS_GLOBAL_ORIGIN_DATA {
        latitude: deg_e7(ORIGIN.latitude_deg),
        longitude: deg_e7(ORIGIN.longitude_deg),
        altitude: (ORIGIN.altitude_m * 1e3) as i32,
        time_usec: core.time_boot_us(),
    }))
}

/// How often the vehicle's place is compared with the geofence.
const PERIOD_NS: Nanos = 50_000_000;

#[derive(Debug, Default)]
pub(crate) struct Geofence {
    due_ns: Nanos,
}

impl Service for Geofence {
    fn messages(&self) -> &'static [Produced] {
        const { &[Produced::from(FENCE_STATUS_DATA::ID, [0.0, 1.0, 1.0], fence_status)] }
    }

    fn due_ns(&self) -> Nanos {
        self.due_ns
    }

    fn step(&mut self, core: &mut Core) {
        self.due_ns = core.now_ns + PERIOD_NS;
        core.watch_fence();
    }
}

/// Nothing while there is no geofence.
fn fence_status(core: &Core) -> Option<MavMessage> {
    core.has_fence().then(|| {
        MavMessage::FENCE_STATUS(FENCE_STATUS_DATA {
            breach_mitigation: FenceMitigate::FENCE_MITIGATE_NONE,
            ..core.fence_status.clone()
        })
    })
}
