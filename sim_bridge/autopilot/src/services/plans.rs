//! Up- and download of plans: mission, geofence, rally points. <https://mavlink.io/en/services/mission.html>
//!
//! An upload replaces the plan of its kind when its last item has come and the whole makes sense; until then, and when it
//! fails, the old plan stays in force. There is one upload at a time. A download has no state: any item can be asked for at
//! any time by anybody.

use crate::core::padded;
use crate::plan::{Envelope, MissionItem, PlanDefect, PlanItem, PlanKind, Plans};
use crate::service::prelude::*;
use MavMissionResult::*;

/// An item that does not come is asked for again after this time, as in PX4.
const RETRY_NS: Nanos = 250_000_000;
/// An upload ends when nothing came for this long, as in PX4.
const TIMEOUT_NS: Nanos = 5_000_000_000;
/// MAV_MISSION_TYPE_ALL.
const ALL_KINDS: u8 = MavMissionType::MAV_MISSION_TYPE_ALL as u8;

#[derive(Debug)]
struct Upload {
    source: Source,
    kind: PlanKind,
    count: u16,
    items: Vec<PlanItem>,
    heard_ns: Nanos,
    retry_ns: Nanos,
    retries: u32,
}

#[derive(Debug, Default)]
pub(crate) struct PlanTransfer {
    upload: Option<Upload>,
    /// Of the last upload that ended well, with the number of its items: its acknowledgement may have been lost.
    finished: Option<(Source, PlanKind, u16)>,
}

fn acknowledge(core: &mut Core, source: Source, mission_type: u8, result: MavMissionResult) {
    if result != MAV_MISSION_ACCEPTED {
        core.refusals.plan += 1;
    }
    let id = PlanKind::from_number(mission_type).map_or(0, |kind| core.plans.wire(kind).id);
    let mut payload = [0; 8];
    payload[..4].copy_from_slice(&[source.id.system, source.id.component, result as u8, mission_type]);
    payload[4..].copy_from_slice(&id.to_le_bytes());
    core.outbox.send_payload(source.link, MISSION_ACK_DATA::ID, &payload);
}

/// Refuses a plan with a reason.
fn refuse(core: &mut Core, source: Source, kind: PlanKind, result: MavMissionResult, reason: &str) {
    acknowledge(core, source, kind.wire() as u8, result);
    core.warn_refused(&format!("{} refused: {reason}", kind.name()));
}

fn replace(core: &mut Core, kind: PlanKind, items: Vec<PlanItem>) -> Result<(), PlanDefect> {
    core.plans.replace(kind, items, &core.home)?;
    match kind {
        PlanKind::Mission => core.mission_changed(),
        PlanKind::Fence if core.plans.fence.has_empty_circle() => {
            core.warn("geofence: a circle of radius 0 holds nothing");
        }
        PlanKind::Fence | PlanKind::Rally => {}
    }
    Ok(())
}

/// Whether a mission's item leads to where the vehicle may be.
fn inside_fence(item: &PlanItem, kind: PlanKind, core: &Core) -> Result<(), PlanDefect> {
    let outside = PlanDefect::new(MAV_MISSION_DENIED, "outside the geofence");
    match MissionItem::read(item, &core.home) {
        Ok(MissionItem::Leg(leg)) if kind == PlanKind::Mission && !core.fence_allows_leg(&leg) => Err(outside),
        _ => Ok(()),
    }
}

impl Service for PlanTransfer {
    fn receive(&mut self, packet: &Packet<'_>, source: Source, core: &mut Core) {
        // All messages of the protocol but the items fit.
        let f = padded::<16>(packet.payload());
        let first = u16::from_le_bytes([f[0], f[1]]);
        match packet.message_id() {
            MISSION_COUNT_DATA::ID => self.begin(first, f[4], source, core),
            id @ (MISSION_ITEM_DATA::ID | MISSION_ITEM_INT_DATA::ID) => {
                if let Some((item, envelope)) = PlanItem::read(id, packet.payload()) {
                    self.take(item, envelope, source, core);
                }
            }
            MISSION_REQUEST_LIST_DATA::ID => tell_count(f[2], source, core),
            id @ (MISSION_REQUEST_DATA::ID | MISSION_REQUEST_INT_DATA::ID) => {
                tell_item(first, f[4], id == MISSION_REQUEST_INT_DATA::ID, source, core);
            }
            MISSION_CLEAR_ALL_DATA::ID => self.clear(f[2], source, core),
            // The client gives up, or confirms a download.
            MISSION_ACK_DATA::ID => {
                let gives_up = f[2] != MAV_MISSION_ACCEPTED as u8;
                self.upload.take_if(|upload| gives_up && upload.source == source);
            }
            MISSION_REQUEST_PARTIAL_LIST_DATA::ID | MISSION_WRITE_PARTIAL_LIST_DATA::ID => {
                acknowledge(core, source, f[6], MAV_MISSION_UNSUPPORTED);
            }
            _ => {}
        }
    }

    fn due_ns(&self) -> Nanos {
        self.upload.as_ref().map_or(Nanos::MAX, |upload| upload.retry_ns)
    }

    fn step(&mut self, core: &mut Core) {
        let Some(upload) = &mut self.upload else {
            return;
        };
        if core.now_ns.saturating_sub(upload.heard_ns) < TIMEOUT_NS {
            upload.retries += 1;
            upload.ask(core);
            return;
        }
        let (source, kind) = (upload.source, upload.kind);
        self.upload = None;
        let result = MAV_MISSION_OPERATION_CANCELLED;
        refuse(core, source, kind, result, "upload timed out, the old one stays");
    }
}

impl Upload {
    /// Asks for the next item. Every second repetition uses the message of before the integer form, for clients that know
    /// only that.
    fn ask(&mut self, core: &mut Core) {
        self.retry_ns = core.now_ns + RETRY_NS;
        let id = match self.retries % 2 {
            1 => MISSION_REQUEST_DATA::ID,
            _ => MISSION_REQUEST_INT_DATA::ID,
        };
        let ([low, high], to) = ((self.items.len() as u16).to_le_bytes(), self.source.id);
        let payload = [low, high, to.system, to.component, self.kind.wire() as u8];
        core.outbox.send_payload(self.source.link, id, &payload);
    }
}

impl PlanTransfer {
    fn begin(&mut self, count: u16, mission_type: u8, source: Source, core: &mut Core) {
        let Some(kind) = PlanKind::from_number(mission_type) else {
            return acknowledge(core, source, mission_type, MAV_MISSION_UNSUPPORTED);
        };
        if self.upload.as_ref().is_some_and(|upload| upload.source != source) {
            return refuse(core, source, kind, MAV_MISSION_DENIED, "another upload is under way");
        }
        self.finished = None;
        self.upload = None;
        if count > kind.capacity() {
            let reason = format!("{count} items, at most {}", kind.capacity());
            return refuse(core, source, kind, MAV_MISSION_NO_SPACE, &reason);
        }
        let mut upload = Upload {
            source,
            kind,
            count,
            items: Vec::with_capacity(usize::from(count)),
            heard_ns: core.now_ns,
            retry_ns: 0,
            retries: 0,
        };
        if count == 0 {
            self.finish(upload, core);
        } else {
            upload.ask(core);
            self.upload = Some(upload);
        }
    }

    fn take(&mut self, item: PlanItem, envelope: Envelope, source: Source, core: &mut Core) {
        let is_this = |upload: &Upload| {
            upload.source == source
                && upload.kind.wire() as u8 == envelope.mission_type
                // 2 and 3 are ArduPilot's "go there now".
                && envelope.current < 2
        };
        let Some(mut upload) = self.upload.take_if(|upload| is_this(upload)) else {
            let again =
                PlanKind::from_number(envelope.mission_type).map(|kind| (source, kind, envelope.seq.saturating_add(1)));
            if again.is_some() && again == self.finished {
                acknowledge(core, source, envelope.mission_type, MAV_MISSION_ACCEPTED);
            } else {
                core.refusals.plan += 1;
            }
            return;
        };
        // A repetition of what came already waits for the retry; a gap is filled at once.
        let wanted = upload.items.len() as u16;
        if envelope.seq != wanted {
            if envelope.seq > wanted {
                upload.ask(core);
            }
            self.upload = Some(upload);
            return;
        }
        let checked =
            Plans::check(upload.kind, &item, &core.home).and_then(|()| inside_fence(&item, upload.kind, core));
        if let Err(defect) = checked {
            let reason = format!("item {wanted}: {}", defect.reason);
            return refuse(core, source, upload.kind, defect.result, &reason);
        }
        upload.items.push(item);
        upload.heard_ns = core.now_ns;
        upload.retries = 0;
        if upload.items.len() < usize::from(upload.count) {
            upload.ask(core);
            self.upload = Some(upload);
        } else {
            self.finish(upload, core);
        }
    }

    fn finish(&mut self, upload: Upload, core: &mut Core) {
        let Upload {
            source, kind, count, ..
        } = upload;
        match replace(core, kind, upload.items) {
            Ok(()) => {
                self.finished = Some((source, kind, count));
                acknowledge(core, source, kind.wire() as u8, MAV_MISSION_ACCEPTED);
            }
            Err(defect) => refuse(core, source, kind, defect.result, defect.reason),
        }
    }

    fn clear(&mut self, mission_type: u8, source: Source, core: &mut Core) {
        let kinds: Vec<PlanKind> = match PlanKind::from_number(mission_type) {
            Some(kind) => vec![kind],
            None if mission_type == ALL_KINDS => PlanKind::ALL.to_vec(),
            None => return acknowledge(core, source, mission_type, MAV_MISSION_UNSUPPORTED),
        };
        let is_anothers = |upload: &Upload| kinds.contains(&upload.kind) && upload.source != source;
        if self.upload.as_ref().is_some_and(is_anothers) {
            acknowledge(core, source, mission_type, MAV_MISSION_DENIED);
            return core.warn_refused("plan not cleared: another upload is under way");
        }
        self.upload.take_if(|upload| kinds.contains(&upload.kind));
        for kind in kinds {
            // An empty plan is always valid.
            if let Err(defect) = replace(core, kind, Vec::new()) {
                return refuse(core, source, kind, defect.result, defect.reason);
            }
        }
        acknowledge(core, source, mission_type, MAV_MISSION_ACCEPTED);
    }
}

fn tell_count(mission_type: u8, source: Source, core: &mut Core) {
    let Some(kind) = PlanKind::from_number(mission_type) else {
        return acknowledge(core, source, mission_type, MAV_MISSION_UNSUPPORTED);
    };
    let wire = core.plans.wire(kind);
    let (count, mission_type, opaque_id) = (wire.items.len() as u16, kind.wire(), wire.id);
    let message = message!(MISSION_COUNT, count, mission_type, opaque_id);
    core.outbox.send_to(source, message);
}

fn tell_item(seq: u16, mission_type: u8, as_int: bool, source: Source, core: &mut Core) {
    let Some(kind) = PlanKind::from_number(mission_type) else {
        return acknowledge(core, source, mission_type, MAV_MISSION_UNSUPPORTED);
    };
    let Some(item) = core.plans.wire(kind).items.get(usize::from(seq)) else {
        return acknowledge(core, source, mission_type, MAV_MISSION_INVALID_SEQUENCE);
    };
    let is_current = kind == PlanKind::Mission && core.plans.mission.current() == seq;
    let envelope = Envelope {
        seq,
        current: u8::from(is_current),
        mission_type,
    };
    let payload = item.payload(envelope, (source.id.system, source.id.component), as_int);
    let id = [MISSION_ITEM_DATA::ID, MISSION_ITEM_INT_DATA::ID][usize::from(as_int)];
    core.outbox.send_payload(source.link, id, &payload);
}
