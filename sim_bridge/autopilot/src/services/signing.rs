//! SETUP_SIGNING: a new key for MAVLink signing. The links put it into force; it is never passed on.
//! <https://mavlink.io/en/messages/common.html#SETUP_SIGNING>

use crate::core::SigningSetup;
use crate::service::prelude::*;

pub(super) fn set_up(m: SETUP_SIGNING_DATA, _source: Source, core: &mut Core) {
    // To everybody or to another system: a key is given to one component.
    if (m.target_system, m.target_component) != (core.id.system, core.id.component) {
        return;
    }
    if m.secret_key == [0; 32] {
        return core.warn_refused("signing key refused: all zeros");
    }
    core.signing_setup = Some(SigningSetup {
        key: m.secret_key,
        initial_timestamp: m.initial_timestamp,
    });
    core.inform("signing key accepted");
}
