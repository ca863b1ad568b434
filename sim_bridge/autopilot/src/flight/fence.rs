//! What the geofence does in flight. <https://docs.px4.io/main/en/flying/geofence.html>

use crate::core::Core;
use crate::flight::mode::FlightMode;
use crate::flight::state::Failsafe;
use crate::plan::Breach;
use crate::vehicle_parameters::ParamId;
use vigil_mavlink::common::{FENCE_STATUS_DATA, MavSeverity};

/// GF_ACTION.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Action {
    Nothing,
    Warn,
    Hold,
    Return,
    Terminate,
    Land,
}

impl Core {
    fn fence_action(&self) -> Action {
        match self.param(ParamId::FenceAction) as i32 {
            0 => Action::Nothing,
            1 => Action::Warn,
            3 => Action::Return,
            4 => Action::Terminate,
            5 => Action::Land,
            _ => Action::Hold,
        }
    }

    /// Whether there is any limit.
    pub fn has_fence(&self) -> bool {
        !self.plans.fence.wire.items.is_empty()
            || self.param(ParamId::FenceRadiusM) > 0.0
            || self.param(ParamId::FenceHeightM) > 0.0
    }

    /// Which limit a place breaks: metres north and east of the local origin, metres above home.
    fn fence_breach(&self, place_m: (f32, f32), height_m: f32) -> Option<Breach> {
        let radius_m = self.param(ParamId::FenceRadiusM);
        let max_height_m = self.param(ParamId::FenceHeightM);
        let from_home_m = libm::hypotf(place_m.0 - self.home_m.0, place_m.1 - self.home_m.1);
        if max_height_m > 0.0 && height_m > max_height_m {
            Some(Breach::Height)
        } else if !self.plans.fence.allows(place_m) || (radius_m > 0.0 && from_home_m > radius_m) {
            Some(Breach::Boundary)
        } else {
            None
        }
    }

    /// Whether the vehicle may be sent to a place. Everything is allowed where a breach would have no consequence.
    pub fn fence_allows(&self, place_m: (f32, f32), height_m: f32) -> bool {
        matches!(self.fence_action(), Action::Nothing | Action::Warn) || self.fence_breach(place_m, height_m).is_none()
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
            Action::Nothing => None,
            _ => self.fence_breach((here.x, here.y), -here.z),
        };
        let before = std::mem::replace(&mut self.fence_watch.breach, breach);
        if before == breach {
            return;
        }
        self.announce::<FENCE_STATUS_DATA>();
        if breach.is_some() && before.is_none() {
            self.fence_watch.count = self.fence_watch.count.saturating_add(1);
            self.fence_watch.last_ms = self.time_boot_ms();
            if self.commander.is_armed() && !self.commander.is_on_ground() {
                self.act_on_breach(action);
            }
        }
    }

    fn act_on_breach(&mut self, action: Action) {
        let (name, mode) = match action {
            Action::Nothing | Action::Warn => ("warning", None),
            Action::Hold => ("hold", Some(FlightMode::Hold)),
            Action::Return => ("return", Some(FlightMode::Return)),
            Action::Land => ("land", Some(FlightMode::Land)),
            Action::Terminate => ("terminate", None),
        };
        self.text(
            MavSeverity::MAV_SEVERITY_CRITICAL,
            &format!("geofence breached: {name}"),
        );
        if action == Action::Terminate {
            self.terminate();
        }
        if let Some(mode) = mode {
            self.fail_over(mode, Failsafe::GeofenceBreached);
        }
    }
}
