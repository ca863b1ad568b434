//! Up- and download of plans: mission, geofence, rally points; and starting, pausing and following a mission.
//! <https://mavlink.io/en/services/mission.html>
//!
//! An upload replaces the plan of its kind when its last item has come and the whole makes sense; until then, and when it
//! fails, the old plan stays in force. There is one upload at a time. A download has no state: any item can be asked for at
//! any time by anybody.

use crate::core::padded;
use crate::flight::FlightMode;
use crate::plan::mission::DO_CHANGE_SPEED;
use crate::plan::{Envelope, MissionItem, PlanDefect, PlanItem, PlanKind, Plans, is_empty_circle};
use crate::service::prelude::*;
use MavMissionResult::*;

pub(super) const COMMANDS: &[(u16, Handler)] = &[(DO_CHANGE_SPEED, change_speed), (MISSION_START, start)];

pub(super) const MESSAGES: &[Produced] = &[
    Produced::from(MISSION_CURRENT_DATA::ID, [0.0, 1.0, 1.0], current),
    Produced::from(MISSION_ITEM_REACHED_DATA::ID, [0.0, 1.0, 1.0], reached),
];

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
    /// The item with which the mission is to go on.
    current: Option<u16>,
    heard_ns: Nanos,
    retry_ns: Nanos,
    retries: u32,
}

#[derive(Debug, Default)]
pub(crate) struct PlanTransfer {
    upload: Option<Upload>,
    /// Of the last upload that ended with an answer, which may have been lost, the number of its items (0 unless it was taken) and when.
    finished: Option<(Source, PlanKind, u16, Nanos)>,
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
    acknowledge(core, source, kind as u8, result);
    core.warn_refused(&format!("{} refused: {reason}", kind.name()));
}

/// A mission goes on with the item `current`; without one, as in PX4, with its item of the number that the one before was at, on the
/// ground with its first.
fn replace(core: &mut Core, kind: PlanKind, items: Vec<PlanItem>, current: Option<u16>) -> Result<(), PlanDefect> {
    let (before, speed_m_s) = match core.commander.is_on_ground() {
        true => (0, None),
        false => (core.plans.mission.goes_on_with(), core.plans.mission.speed_m_s),
    };
    core.plans.replace(kind, items)?;
    match kind {
        PlanKind::Mission => {
            let mission = &mut core.plans.mission;
            let last = mission.len().saturating_sub(1);
            let index = last.min(current.unwrap_or(before).into());
            if mission.set_current(index) && index > 0 {
                // The item that set it is not flown again.
                mission.speed_m_s = speed_m_s;
            }
            core.mission_changed();
        }
        PlanKind::Fence if core.plans.wire(kind).items.iter().any(is_empty_circle) => {
            core.warn("geofence: a circle of radius 0 holds nothing");
        }
        PlanKind::Fence | PlanKind::Rally => {}
    }
    Ok(())
}

/// Whether a mission's item leads to where the vehicle may be.
fn inside_fence(item: &PlanItem, kind: PlanKind, core: &Core) -> Result<(), PlanDefect> {
    let outside = PlanDefect::new(MAV_MISSION_DENIED, "outside the geofence");
    match MissionItem::read(item) {
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
                if let Some(upload) = self.upload.take_if(|upload| gives_up && upload.source == source) {
                    self.finished = Some((source, upload.kind, 0, core.now_ns));
                }
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
        let payload = [low, high, to.system, to.component, self.kind as u8];
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
            current: None,
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
            upload.source == source && upload.kind as u8 == envelope.mission_type && !envelope.is_go_to()
        };
        let Some(upload) = self.upload.as_mut().filter(|upload| is_this(upload)) else {
            return self.answer_astray(envelope, source, core);
        };
        // A repetition of what came already waits for the retry; a gap is filled at once.
        let wanted = upload.items.len() as u16;
        if envelope.seq != wanted {
            if envelope.seq > wanted {
                upload.ask(core);
            }
            return;
        }
        let kind = upload.kind;
        let checked = Plans::check(kind, &item).and_then(|()| inside_fence(&item, kind, core));
        if let Err(defect) = checked {
            self.upload = None;
            self.finished = Some((source, kind, 0, core.now_ns));
            let reason = format!("item {wanted}: {}", defect.reason);
            return refuse(core, source, kind, defect.result, &reason);
        }
        upload.items.push(item);
        if envelope.current == 1 {
            upload.current = Some(wanted);
        }
        upload.heard_ns = core.now_ns;
        upload.retries = 0;
        if upload.items.len() < usize::from(upload.count) {
            upload.ask(core);
        } else if let Some(upload) = self.upload.take() {
            self.finish(upload, core);
        }
    }

    /// Answers an item that is not of the upload under way.
    fn answer_astray(&self, envelope: Envelope, source: Source, core: &mut Core) {
        let mission_type = envelope.mission_type;
        let is_recent = |ended_ns| core.now_ns.saturating_sub(ended_ns) < 2 * TIMEOUT_NS;
        let finished = self
            .finished
            .filter(|(by, kind, _, ended_ns)| *by == source && *kind as u8 == mission_type && is_recent(*ended_ns));
        let reason = match finished {
            _ if envelope.is_go_to() => "go-to by MISSION_ITEM is not flown, use DO_REPOSITION",
            Some((_, _, count, _)) if envelope.seq.saturating_add(1) == count => {
                return acknowledge(core, source, mission_type, MAV_MISSION_ACCEPTED);
            }
            None if self.upload.as_ref().is_none_or(|upload| upload.source != source) => {
                "no upload of yours is under way"
            }
            // Late, or of another kind of plan.
            _ => return core.refusals.plan += 1,
        };
        acknowledge(core, source, mission_type, MAV_MISSION_ERROR);
        core.warn_refused(&format!("mission item refused: {reason}"));
    }

    fn finish(&mut self, upload: Upload, core: &mut Core) {
        let (source, kind, count) = (upload.source, upload.kind, upload.count);
        let replaced = replace(core, kind, upload.items, upload.current);
        self.finished = Some((source, kind, if replaced.is_ok() { count } else { 0 }, core.now_ns));
        match replaced {
            Ok(()) => acknowledge(core, source, kind as u8, MAV_MISSION_ACCEPTED),
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
        if let Some(upload) = self.upload.take_if(|upload| kinds.contains(&upload.kind)) {
            self.finished = Some((source, upload.kind, 0, core.now_ns));
        }
        for kind in kinds {
            // An empty plan is always valid.
            if let Err(defect) = replace(core, kind, Vec::new(), None) {
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
    let (count, to) = ((wire.items.len() as u16).to_le_bytes(), source.id);
    let payload = [
        &count[..],
        &[to.system, to.component, mission_type],
        &wire.id.to_le_bytes(),
    ]
    .concat();
    core.outbox.send_payload(source.link, MISSION_COUNT_DATA::ID, &payload);
}

fn tell_item(seq: u16, mission_type: u8, as_int: bool, source: Source, core: &mut Core) {
    let Some(kind) = PlanKind::from_number(mission_type) else {
        return acknowledge(core, source, mission_type, MAV_MISSION_UNSUPPORTED);
    };
    let Some(item) = core.plans.wire(kind).items.get(usize::from(seq)) else {
        return acknowledge(core, source, mission_type, MAV_MISSION_INVALID_SEQUENCE);
    };
    let is_current = kind == PlanKind::Mission && core.plans.mission.goes_on_with() == seq;
    let envelope = Envelope {
        seq,
        current: u8::from(is_current),
        mission_type,
    };
    let payload = item.payload(envelope, (source.id.system, source.id.component), as_int);
    let id = [MISSION_ITEM_DATA::ID, MISSION_ITEM_INT_DATA::ID][usize::from(as_int)];
    core.outbox.send_payload(source.link, id, &payload);
}

const MISSION_START: u16 = 300;

pub(super) fn set_current(m: MISSION_SET_CURRENT_DATA, _source: Source, core: &mut Core) {
    if !make_current(usize::from(m.seq), core) {
        core.refusals.plan += 1;
        core.warn_refused(&format!("there is no mission item {}", m.seq));
    }
}

fn make_current(index: usize, core: &mut Core) -> bool {
    let is_set = core.plans.mission.set_current(index);
    if is_set {
        core.mission_changed();
    }
    is_set
}

fn change_speed(command: &Command, _source: Source, core: &mut Core) -> Answer {
    // Airspeed and ground speed are one without wind; rates of climb are parameters.
    let (Some(0.0 | 1.0), Some(speed_m_s)) = (command.param(1), command.param(2)) else {
        return Err(Refusal::DENIED);
    };
    // −1 changes nothing, −2 goes back to the default.
    match speed_m_s {
        -1.0 => {}
        -2.0 => core.change_speed(None),
        _ if speed_m_s > 0.0 => core.change_speed(Some(speed_m_s)),
        _ => return Err(Refusal::DENIED),
    }
    Ok(())
}

/// Starts with the item of parameter 1 (−1: the current one), and arms, as PX4 does.
fn start(command: &Command, source: Source, core: &mut Core) -> Answer {
    core.mission_check().map_err(|denial| Refusal::DENIED.saying(denial))?;
    match command.param(1) {
        None | Some(-1.0) => {}
        Some(first) if first >= 0.0 && make_current(first as usize, core) => {}
        Some(first) => return Err(Refusal::DENIED.saying(format!("mission denied: there is no item {first}"))),
    }
    core.change_mode(FlightMode::Mission, source)?;
    Ok(core.arm(source)?)
}

fn current(core: &Core) -> Option<MavMessage> {
    const IN_MISSION_MODE: u8 = 1;
    const SUSPENDED: u8 = 2;
    let is_flown = core.commander.mode == FlightMode::Mission;
    let mission = &core.plans.mission;
    let count = mission.len() as u16;
    Some(MavMessage::MISSION_CURRENT(MISSION_CURRENT_DATA {
        seq: mission.current(),
        total: if count == 0 { u16::MAX } else { count },
        mission_state: mission.state(is_flown),
        mission_mode: if is_flown { IN_MISSION_MODE } else { SUSPENDED },
        mission_id: core.plans.wire(PlanKind::Mission).id,
        fence_id: core.plans.wire(PlanKind::Fence).id,
        rally_points_id: core.plans.wire(PlanKind::Rally).id,
    }))
}

/// Sent when an item is reached, and again from time to time, because a packet may be lost.
fn reached(core: &Core) -> Option<MavMessage> {
    let seq = core.plans.mission.reached?;
    Some(MavMessage::MISSION_ITEM_REACHED(MISSION_ITEM_REACHED_DATA { seq }))
}
