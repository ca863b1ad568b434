//! What the geofence does in flight. <https://docs.px4.io/main/en/flying/geofence.html>

use crate::core::Core;
use crate::flight::commander::Response;
use crate::flight::mode::FlightMode;
use crate::flight::state::Failsafe;
use crate::plan::PlanKind;
use crate::vehicle_parameters::ParamId;
use vigil_mavlink::common::{FENCE_STATUS_DATA, FenceBreach, MavSeverity};

/// GF_ACTION; any other number holds.
const NOTHING: i32 = 0;
const WARN: i32 = 1;
const RETURN: i32 = 3;
const TERMINATE: i32 = 4;
const LAND: i32 = 5;
/// No limit is broken.
const INSIDE: FenceBreach = FenceBreach::FENCE_BREACH_NONE;

impl Core {
    fn fence_action(&self) -> i32 {
        self.param(ParamId::FenceAction) as i32
    }

    /// Whether there is any limit.
    pub fn has_fence(&self) -> bool {
        !self.plans.wire(PlanKind::Fence).items.is_empty()
            || self.param(ParamId::FenceRadiusM) > 0.0
            || self.param(ParamId::FenceHeightM) > 0.0
    }

    /// Which limit a place breaks: metres north and east of the local origin, metres above home.
    fn fence_breach(&self, place_m: (f32, f32), height_m: f32) -> FenceBreach {
        let radius_m = self.param(ParamId::FenceRadiusM);
        let max_height_m = self.param(ParamId::FenceHeightM);
        let from_home_m = libm::hypotf(place_m.0 - self.home_m.0, place_m.1 - self.home_m.1);
        if max_height_m > 0.0 && height_m > max_height_m {
            FenceBreach::FENCE_BREACH_MAXALT
        } else if !self.plans.fence.allows(place_m) || (radius_m > 0.0 && from_home_m > radius_m) {
            FenceBreach::FENCE_BREACH_BOUNDARY
        } else {
            INSIDE
        }
    }

    /// Whether the vehicle may be sent to a place. Everything is allowed where a breach would have no consequence.
    pub fn fence_allows(&self, place_m: (f32, f32), height_m: f32) -> bool {
        matches!(self.fence_action(), NOTHING | WARN) || self.fence_breach(place_m, height_m) == INSIDE
    }

    /// Whether the vehicle itself is where it may be.
    pub fn is_inside_fence(&self) -> bool {
        let here = self.view.estimate.position_ned_m;
        self.fence_allows((here.x, here.y), -here.z)
    }

    /// Looks whether the vehicle left its geofence, and acts when it just did. Acts once: a pilot may then take over.
    pub fn watch_fence(&mut self) {
        let action = self.fence_action();
        let here = self.view.estimate.position_ned_m;
        let breach = match action {
            NOTHING => INSIDE,
            _ => self.fence_breach((here.x, here.y), -here.z),
        };
        let before = std::mem::replace(&mut self.fence_status.breach_type, breach);
        if before == breach {
            return;
        }
        self.announce::<FENCE_STATUS_DATA>();
        self.fence_status.breach_status = u8::from(breach != INSIDE);
        if before == INSIDE {
            self.fence_status.breach_count = self.fence_status.breach_count.saturating_add(1);
            self.fence_status.breach_time = self.time_boot_ms();
            if self.commander.armed && !self.commander.is_on_ground() {
                self.act_on_breach(action);
            }
        }
    }

    fn act_on_breach(&mut self, action: i32) {
        let critical = MavSeverity::MAV_SEVERITY_CRITICAL;
        let mode = match action {
            NOTHING | WARN => return self.text(critical, "geofence breached: warning"),
            TERMINATE => {
                self.text(critical, "geofence breached: terminate");
                return self.terminate();
            }
            RETURN => FlightMode::Return,
            LAND => FlightMode::Land,
            _ => FlightMode::Hold,
        };
        self.respond(Response::Enter(mode), Failsafe::GeofenceBreached);
    }
}
