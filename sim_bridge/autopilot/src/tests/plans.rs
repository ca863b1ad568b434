//! Up- and download of plans, as clients do it.

use crate::geo;
use crate::plan::{Envelope, PlanItem};
use crate::testing::*;

pub const MISSION: u8 = 0;
pub const FENCE: u8 = 1;
pub const RALLY: u8 = 2;

/// An item at metres north and east of home, in frame 3.
pub fn item(command: u16, params: [f32; 4], place: (f32, f32), z: f32) -> PlanItem {
    let (lat, lon) = on_globe(place);
    PlanItem {
        frame: 3,
        x: geo::deg_e7(lat),
        y: geo::deg_e7(lon),
        z,
        ..action(command, params)
    }
}

pub fn waypoint(place: (f32, f32), height_m: f32) -> PlanItem {
    item(16, [0.0, 1.0, 0.0, f32::NAN], place, height_m)
}

/// A command without a place (frame 2).
pub fn action(command: u16, params: [f32; 4]) -> PlanItem {
    PlanItem {
        command,
        frame: 2,
        autocontinue: 1,
        params,
        x: 0,
        y: 0,
        z: 0.0,
    }
}

fn at(mission_type: u8, seq: u16) -> Envelope {
    Envelope {
        seq,
        current: 0,
        mission_type,
    }
}

impl Bench {
    fn count_message(&mut self, link: LinkId, from: ComponentId, kind: u8, count: u16) {
        let [low, high] = count.to_le_bytes();
        let payload = [low, high, 1, 1, kind, 0, 0, 0, 0];
        self.send_raw(link, &raw(from, MISSION_COUNT_DATA::ID, &payload));
    }

    fn item_message(&mut self, link: LinkId, from: ComponentId, envelope: Envelope, item: &PlanItem, as_int: bool) {
        let id = [MISSION_ITEM_DATA::ID, MISSION_ITEM_INT_DATA::ID][usize::from(as_int)];
        self.send_raw(link, &raw(from, id, &item.payload(envelope, (1, 1), as_int)));
    }

    /// The sequence numbers that the vehicle asked for since the last `sent.clear()`.
    fn requests(&self, link: LinkId) -> Vec<u16> {
        self.messages(link)
            .filter_map(|m| match m {
                MavMessage::MISSION_REQUEST_INT(r) => Some(r.seq),
                MavMessage::MISSION_REQUEST(r) => Some(r.seq),
                _ => None,
            })
            .collect()
    }

    fn mission_acks(&self, link: LinkId) -> Vec<MavMissionResult> {
        let acks = self.all::<MISSION_ACK_DATA>(link).into_iter();
        acks.map(|ack| ack.mavtype).collect()
    }

    /// Uploads a plan in one go and returns the answer.
    pub fn upload(&mut self, kind: u8, items: &[PlanItem]) -> MavMissionResult {
        self.upload_as(kind, items, true, None)
    }

    /// Uploads a mission whose item `current` is marked.
    pub fn upload_marked(&mut self, items: &[PlanItem], current: u16) -> MavMissionResult {
        self.upload_as(MISSION, items, true, Some(current))
    }

    fn upload_as(&mut self, kind: u8, items: &[PlanItem], as_int: bool, current: Option<u16>) -> MavMissionResult {
        self.sent.clear();
        self.count_message(API, SCRIPT, kind, items.len() as u16);
        for (seq, item) in items.iter().enumerate() {
            if !self.mission_acks(API).is_empty() {
                break;
            }
            assert_eq!(self.requests(API).last(), Some(&(seq as u16)));
            let current = (Some(seq as u16) == current).into();
            let envelope = Envelope {
                current,
                ..at(kind, seq as u16)
            };
            self.item_message(API, SCRIPT, envelope, item, as_int);
        }
        let acks = self.mission_acks(API);
        assert_eq!(acks.len(), 1, "one answer: {acks:?}");
        acks[0]
    }

    /// Downloads a plan as MISSION_ITEM_INT.
    pub fn download(&mut self, kind: u8) -> Vec<MISSION_ITEM_INT_DATA> {
        self.sent.clear();
        self.send_raw(API, &raw(SCRIPT, MISSION_REQUEST_LIST_DATA::ID, &[1, 1, kind]));
        let answer = self.first::<MISSION_COUNT_DATA>(API).expect("a count");
        let to = (answer.target_system, answer.target_component, answer.mission_type as u8);
        assert_eq!(to, (SCRIPT.system, SCRIPT.component, kind));
        for seq in 0..answer.count {
            let [low, high] = seq.to_le_bytes();
            let request = raw(SCRIPT, MISSION_REQUEST_INT_DATA::ID, &[low, high, 1, 1, kind]);
            self.send_raw(API, &request);
        }
        self.all::<MISSION_ITEM_INT_DATA>(API)
    }

    fn clear_plan(&mut self, kind: u8) -> MavMissionResult {
        self.sent.clear();
        self.send_raw(API, &raw(SCRIPT, MISSION_CLEAR_ALL_DATA::ID, &[1, 1, kind]));
        self.mission_acks(API)[0]
    }
}

use MavMissionResult as R;

#[test]
fn every_kind_of_plan_comes_back_as_it_went_up() {
    let mut b = Bench::new();
    let mission = [
        item(22, [0.0, 0.0, 0.0, f32::NAN], (0.0, 0.0), 4.0),
        waypoint((10.0, 2.0), 5.0),
        action(93, [2.0, -1.0, -1.0, -1.0]),
        action(20, [0.0; 4]),
    ];
    let fence: Vec<_> = [(-20.0, -20.0), (-20.0, 30.0), (30.0, 30.0)]
        .map(|v| item(5001, [3.0, 0.0, 0.0, 0.0], v, 0.0))
        .to_vec();
    let rally = [item(5100, [0.0; 4], (9.0, 9.0), 12.0)];
    let plans: [(u8, &[PlanItem]); 3] = [(MISSION, &mission), (FENCE, &fence), (RALLY, &rally)];
    for (kind, items) in plans {
        assert_eq!(b.upload(kind, items), R::MAV_MISSION_ACCEPTED);
    }
    for (kind, items) in plans {
        let back = b.download(kind);
        assert_eq!(back.len(), items.len());
        for (seq, (back, item)) in back.iter().zip(items).enumerate() {
            assert_eq!(back.seq, seq as u16);
            assert_eq!((back.x, back.y, back.z), (item.x, item.y, item.z));
            let frame = if item.frame == 3 { 6 } else { item.frame };
            assert_eq!((back.command as u16, back.frame as u8), (item.command, frame));
            assert_eq!((back.param1, back.mission_type as u8), (item.params[0], kind));
            assert_eq!((back.target_system, back.target_component), (245, 190));
        }
    }
    assert_eq!(b.clear_plan(FENCE), R::MAV_MISSION_ACCEPTED);
    assert_eq!((b.download(FENCE).len(), b.download(RALLY).len()), (0, 1));
    assert_eq!(b.clear_plan(255), R::MAV_MISSION_ACCEPTED);
    assert_eq!((b.download(MISSION).len(), b.download(RALLY).len()), (0, 0));
    // A kind that there is not.
    b.send_raw(API, &raw(SCRIPT, MISSION_CLEAR_ALL_DATA::ID, &[1, 1, 7]));
    assert_eq!(b.status().refusals.plan, 1);
}

#[test]
fn a_client_that_knows_only_the_float_form_is_served() {
    let mut b = Bench::new();
    let items = [waypoint((10.0, 2.0), 5.0), waypoint((20.0, 2.0), 5.0)];
    assert_eq!(b.upload_as(MISSION, &items, false, None), R::MAV_MISSION_ACCEPTED);
    let back = b.download(MISSION);
    assert!((back[1].x - items[1].x).abs() < 40, "a float holds half a metre");
    b.sent.clear();
    b.send_raw(API, &raw(SCRIPT, MISSION_REQUEST_DATA::ID, &[1, 0, 1, 1]));
    let MISSION_ITEM_DATA { seq, x, frame, .. } = b.first(API).expect("sent");
    assert!(seq == 1 && (x - 47.4).abs() < 0.1);
    assert_eq!([frame as u8, back[1].frame as u8], [3, 6], "each form has its frames");
    // Frames 5 and 6 and degrees · 1e7 are not this form's, not even a landing's.
    let (no_frame, no_latitude) = (R::MAV_MISSION_UNSUPPORTED_FRAME, R::MAV_MISSION_INVALID_PARAM5_X);
    for (frame, result) in [(6, no_frame), (3, no_latitude)] {
        b.count_message(API, SCRIPT, MISSION, 1);
        let mut float = [0; 38];
        float[16..20].copy_from_slice(&473_977_420.0_f32.to_le_bytes());
        (float[30], float[32], float[33], float[34]) = (21, 1, 1, frame);
        b.send_raw(API, &raw(SCRIPT, MISSION_ITEM_DATA::ID, &float));
        assert_eq!(b.mission_acks(API).last(), Some(&result));
    }
}

#[test]
fn an_uploader_that_vanishes_leaves_the_old_mission() {
    let mut b = Bench::new();
    let old = [waypoint((10.0, 2.0), 5.0)];
    assert_eq!(b.upload(MISSION, &old), R::MAV_MISSION_ACCEPTED);
    b.sent.clear();
    b.count_message(API, SCRIPT, MISSION, 3);
    b.item_message(API, SCRIPT, at(MISSION, 0), &waypoint((50.0, 50.0), 9.0), true);
    b.run_ms(4_500);
    // Asked again and again, in both forms, but not for ever.
    let forms = [MISSION_REQUEST_INT_DATA::ID, MISSION_REQUEST_DATA::ID].map(|id| b.count(API, id));
    assert_eq!(forms, [11, 9], "{:?}", b.requests(API));
    assert_eq!(b.mission_acks(API), []);
    b.run_ms(1_000);
    assert_eq!(b.mission_acks(API), [R::MAV_MISSION_OPERATION_CANCELLED]);
    b.assert_said("timed out");
    let asked = b.requests(API).len();
    b.run_ms(5_000);
    assert_eq!(b.requests(API).len(), asked);
    assert_eq!(b.download(MISSION)[0].x, old[0].x);
    // What comes too late changes nothing; another upload works.
    b.item_message(API, SCRIPT, at(MISSION, 1), &waypoint((50.0, 50.0), 9.0), true);
    assert_eq!(b.status().refusals.plan, 2);
    assert_eq!(b.download(MISSION).len(), 1);
    assert_eq!(b.upload(MISSION, &[old[0], old[0]]), R::MAV_MISSION_ACCEPTED);
}

#[test]
fn a_lossy_link_repeats_and_reorders_and_the_plan_is_whole() {
    let mut b = Bench::new();
    let items = [1.0, 2.0, 3.0].map(|north| waypoint((north, 0.0), 5.0));
    // The count comes twice, an item twice, one too early, one only on the second request.
    b.count_message(API, SCRIPT, MISSION, 3);
    b.count_message(API, SCRIPT, MISSION, 3);
    b.item_message(API, SCRIPT, at(MISSION, 1), &items[1], true);
    b.item_message(API, SCRIPT, at(MISSION, 0), &items[0], true);
    b.item_message(API, SCRIPT, at(MISSION, 0), &items[0], true);
    b.run_ms(300);
    b.item_message(API, SCRIPT, at(MISSION, 1), &items[1], true);
    b.item_message(API, SCRIPT, at(MISSION, 2), &items[2], true);
    assert_eq!(b.requests(API), [0, 0, 0, 1, 1, 2]);
    assert_eq!(b.mission_acks(API), [R::MAV_MISSION_ACCEPTED]);
    // The acknowledgement was lost: the client repeats its last item.
    b.item_message(API, SCRIPT, at(MISSION, 2), &items[2], true);
    assert_eq!(b.mission_acks(API), [R::MAV_MISSION_ACCEPTED; 2]);
    let back = b.download(MISSION);
    assert!(back.iter().zip(&items).all(|(back, item)| back.x == item.x) && back.len() == 3);
}

/// As in PX4: DroneKit's go-to (2) and its altitude (3) would wait for an answer, as would an uploader whose count was lost.
#[test]
fn an_item_outside_an_upload_is_refused_and_a_late_one_is_not_answered() {
    let mut b = Bench::new();
    let there = waypoint((9.0, 9.0), 9.0);
    for (current, text) in [
        (0, "no upload of yours is under way"),
        (2, "go-to by MISSION_ITEM is not flown, use DO_REPOSITION"),
        (3, "go-to by MISSION_ITEM is not flown, use DO_REPOSITION"),
    ] {
        let envelope = Envelope {
            current,
            ..at(MISSION, 0)
        };
        b.sent.clear();
        b.item_message(API, SCRIPT, envelope, &there, false);
        assert_eq!(b.mission_acks(API), [R::MAV_MISSION_ERROR]);
        assert_eq!(b.texts().concat(), format!("mission item refused: {text}"));
    }
    assert_eq!(b.upload(MISSION, &[there; 3]), R::MAV_MISSION_ACCEPTED);
    b.item_message(API, SCRIPT, at(MISSION, 1), &there, true);
    assert_eq!(b.mission_acks(API), [R::MAV_MISSION_ACCEPTED]);
    // Nor is one of an upload that was refused; a minute later nothing is late any more.
    b.sent.clear();
    b.count_message(API, SCRIPT, MISSION, 2);
    for _ in 0..2 {
        b.item_message(API, SCRIPT, at(MISSION, 0), &item(113, [0.0; 4], (0.0, 0.0), 0.0), true);
    }
    assert_eq!(b.mission_acks(API).len(), 1);
    assert_eq!(b.upload(MISSION, &[there; 3]), R::MAV_MISSION_ACCEPTED);
    b.run_ms(60_000);
    b.sent.clear();
    b.item_message(API, SCRIPT, at(MISSION, 2), &there, true);
    assert_eq!(b.mission_acks(API), [R::MAV_MISSION_ERROR]);
}

#[test]
fn two_uploaders_do_not_mix_and_an_uploader_can_give_up() {
    let mut b = Bench::new();
    b.count_message(API, SCRIPT, MISSION, 2);
    b.count_message(GCS, STATION, MISSION, 1);
    assert_eq!(b.mission_acks(GCS), [R::MAV_MISSION_DENIED]);
    b.item_message(GCS, STATION, at(MISSION, 0), &waypoint((9.0, 9.0), 9.0), true);
    // An item of another kind of plan is none of this upload.
    b.item_message(API, SCRIPT, at(RALLY, 0), &item(5100, [0.0; 4], (1.0, 1.0), 0.0), true);
    assert_eq!(b.status().refusals.plan, 3);
    b.item_message(API, SCRIPT, at(MISSION, 0), &waypoint((1.0, 0.0), 5.0), true);
    // A stranger cannot end it, its sender can.
    let cancel = [1, 1, R::MAV_MISSION_OPERATION_CANCELLED as u8, MISSION];
    b.send_raw(GCS, &raw(STATION, MISSION_ACK_DATA::ID, &cancel));
    b.send_raw(GCS, &raw(STATION, MISSION_CLEAR_ALL_DATA::ID, &[1, 1, MISSION]));
    let (denied, error) = (R::MAV_MISSION_DENIED, R::MAV_MISSION_ERROR);
    assert_eq!(b.mission_acks(GCS), [denied, error, denied]);
    assert_eq!(b.requests(API), [0, 1]);
    b.run_ms(300);
    assert_eq!(b.requests(API), [0, 1, 1]);
    b.send_raw(API, &raw(SCRIPT, MISSION_ACK_DATA::ID, &cancel));
    b.run_ms(1_000);
    assert_eq!(b.requests(API), [0, 1, 1]);
    assert_eq!(b.download(MISSION).len(), 0);
    // So does clearing, of all kinds or of this one.
    for (cleared, goes_on) in [(255, false), (MISSION, false), (FENCE, true)] {
        b.count_message(API, SCRIPT, MISSION, 1);
        assert_eq!(b.clear_plan(cleared), R::MAV_MISSION_ACCEPTED);
        b.run_ms(300);
        assert_eq!(!b.requests(API).is_empty(), goes_on, "{cleared}");
    }
}

#[test]
fn a_plan_that_makes_no_sense_is_refused_with_a_reason_and_the_old_one_stays() {
    let mut b = Bench::new();
    let good = waypoint((10.0, 2.0), 5.0);
    assert_eq!(b.upload(MISSION, &[good]), R::MAV_MISSION_ACCEPTED);
    let with = |params| PlanItem { params, ..good };
    let (west, high) = (-2_000_000_000, f32::INFINITY);
    for (bad, result) in [
        (item(60_000, [0.0; 4], (0.0, 1.0), 5.0), R::MAV_MISSION_UNSUPPORTED),
        (action(84, [0.0; 4]), R::MAV_MISSION_UNSUPPORTED),
        (PlanItem { frame: 12, ..good }, R::MAV_MISSION_UNSUPPORTED_FRAME),
        (PlanItem { frame: 8, ..good }, R::MAV_MISSION_UNSUPPORTED_FRAME),
        (with([-1.0, 0.0, 0.0, 0.0]), R::MAV_MISSION_INVALID_PARAM1),
        (with([f32::INFINITY, 0.0, 0.0, 0.0]), R::MAV_MISSION_INVALID_PARAM1),
        (with([0.0, -2.0, 0.0, 0.0]), R::MAV_MISSION_INVALID_PARAM2),
        (with([0.0, 0.0, 0.0, 1e9]), R::MAV_MISSION_INVALID_PARAM4),
        (PlanItem { x: 0, y: 0, ..good }, R::MAV_MISSION_INVALID_PARAM5_X),
        (PlanItem { x: 100_000_000, ..good }, R::MAV_MISSION_INVALID_PARAM5_X),
        (PlanItem { x: 950_000_000, ..good }, R::MAV_MISSION_INVALID_PARAM5_X),
        (PlanItem { y: west, ..good }, R::MAV_MISSION_INVALID_PARAM6_Y),
        (PlanItem { z: 501.0, ..good }, R::MAV_MISSION_INVALID_PARAM7),
        (PlanItem { z: high, ..good }, R::MAV_MISSION_INVALID_PARAM7),
        (action(93, [-1.0, 0.0, 0.0, 0.0]), R::MAV_MISSION_INVALID_PARAM1),
        (action(177, [9.0, 1.0, 0.0, 0.0]), R::MAV_MISSION_INVALID_PARAM1),
        (action(177, [0.0, f32::NAN, 0.0, 0.0]), R::MAV_MISSION_INVALID_PARAM2),
        (action(178, [1.0, -7.0, 0.0, 0.0]), R::MAV_MISSION_INVALID_PARAM2),
    ] {
        assert_eq!(b.upload(MISSION, &[good, bad]), result);
        b.assert_said("mission refused");
        assert!(!b.texts().concat().contains("in this frame"), "{bad:?}");
        b.run_ms(250);
    }
    assert_eq!(b.download(MISSION).len(), 1);
    let at_its_height = PlanItem { z: f32::NAN, ..good };
    assert_eq!(b.upload(MISSION, &[at_its_height]), R::MAV_MISSION_ACCEPTED);
    b.sent.clear();
    b.count_message(API, SCRIPT, MISSION, 60_000);
    b.count_message(API, SCRIPT, 255, 1);
    b.send_raw(API, &raw(SCRIPT, MISSION_REQUEST_INT_DATA::ID, &[1, 0, 1, 1, 0]));
    let partial = raw(SCRIPT, MISSION_WRITE_PARTIAL_LIST_DATA::ID, &[0, 0, 1, 0, 1, 1, 0]);
    b.send_raw(API, &partial);
    let (unsupported, sequence) = (R::MAV_MISSION_UNSUPPORTED, R::MAV_MISSION_INVALID_SEQUENCE);
    let answers = [R::MAV_MISSION_NO_SPACE, unsupported, sequence, unsupported];
    assert_eq!(b.mission_acks(API), answers);
    let lone = item(5001, [4.0, 0.0, 0.0, 0.0], (1.0, 1.0), 0.0);
    assert_eq!(b.upload(FENCE, &[lone]), R::MAV_MISSION_INVALID_PARAM1);
    assert_eq!(b.upload(RALLY, &[good]), R::MAV_MISSION_UNSUPPORTED);
}

#[test]
fn ids_tell_which_plan_is_on_board() {
    let mut b = Bench::new();
    let current = |b: &mut Bench| b.fresh::<MISSION_CURRENT_DATA>(1_100);
    let none = current(&mut b);
    assert_eq!((none.mission_id, none.total), (0, u16::MAX));
    assert_eq!(none.mission_state, MissionState::MISSION_STATE_NO_MISSION);
    b.upload(MISSION, &[waypoint((10.0, 2.0), 5.0)]);
    let one = current(&mut b);
    b.upload(MISSION, &[waypoint((10.0, 2.0), 6.0)]);
    let other = current(&mut b);
    assert!(one.mission_id != 0 && one.mission_id != other.mission_id && one.total == 1);
    b.upload(MISSION, &[waypoint((10.0, 2.0), 5.0)]);
    assert_eq!(current(&mut b).mission_id, one.mission_id, "the same plan");
    assert_eq!(one.mission_state, MissionState::MISSION_STATE_NOT_STARTED);
    assert_eq!((one.fence_id, one.rally_points_id), (0, 0));
}

/// An altitude above the ground in a frame that counts from the sea, home being 488 m above it; a landing's altitude says nothing.
#[test]
fn a_mission_below_home_is_refused_with_its_item_and_a_landing_is_not() {
    let mut b = Bench::new();
    for (frame, z) in [(0, 5.0), (5, 5.0), (3, -5.0), (6, -5.0)] {
        let at = |command: u16| PlanItem {
            frame,
            ..item(command, [0.0; 4], (20.0, 0.0), z)
        };
        for command in [16, 17, 19, 22, 31] {
            let answer = b.upload(MISSION, &[waypoint((9.0, 0.0), 5.0), at(command)]);
            assert_eq!(answer, R::MAV_MISSION_INVALID_PARAM7, "{command} {frame}");
            let texts = b.texts().concat();
            assert!(texts.contains("item 1: below home"), "{texts}");
            b.run_ms(250);
        }
        assert_eq!(b.upload(MISSION, &[at(21)]), R::MAV_MISSION_ACCEPTED);
    }
}
