//! FENCE_STATUS, and the watch over the geofence. <https://mavlink.io/en/messages/common.html#FENCE_STATUS>

use crate::plan::Breach;
use crate::service::prelude::*;

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
    let watch = &core.fence_watch;
    core.has_fence().then(|| {
        MavMessage::FENCE_STATUS(FENCE_STATUS_DATA {
            breach_time: watch.last_ms,
            breach_count: watch.count,
            breach_status: u8::from(watch.breach.is_some()),
            breach_type: match watch.breach {
                None => FenceBreach::FENCE_BREACH_NONE,
                Some(Breach::Height) => FenceBreach::FENCE_BREACH_MAXALT,
                Some(Breach::Boundary) => FenceBreach::FENCE_BREACH_BOUNDARY,
            },
            breach_mitigation: FenceMitigate::FENCE_MITIGATE_NONE,
        })
    })
}
