use super::*;
use crate::geometric::track::Whereabouts;
use std::vec::Vec;

/// One round thing before a wall that stands 8 m north: where it begins, and its velocity.
pub(crate) struct Scene {
    pub start_m: (f32, f32),
    pub velocity_m_s: (f32, f32),
}

/// The thing's radius, metres.
pub(crate) const RADIUS_M: f32 = 0.3;

impl Scene {
    pub(crate) fn of(start_m: (f32, f32), velocity_m_s: (f32, f32)) -> Self {
        Self { start_m, velocity_m_s }
    }

    pub(crate) fn at(&self, seconds: f32) -> (f32, f32) {
        (
            self.start_m.0 + self.velocity_m_s.0 * seconds,
            self.start_m.1 + self.velocity_m_s.1 * seconds,
        )
    }
}

/// What is seen from a place north of the origin, looking north, of a thing in its place and the wall.
fn seen(from: NedVector, (north_m, east_m): (f32, f32)) -> Scan {
    const WALL_M: f32 = 8.0;
    let mut scan = Scan::EMPTY;
    for i in 0..SECTORS {
        let bearing = (i as f32 - 63.5) * 0.016_36;
        let (dx, dy) = (libm::cosf(bearing), libm::sinf(bearing));
        let mut range_m = (WALL_M - from.x) / dx;
        let (n, e) = (north_m - from.x, east_m - from.y);
        let along = n * dx + e * dy;
        let beside = n * dy - e * dx;
        if along > 0.0 && beside.abs() < RADIUS_M {
            range_m = range_m.min(along - libm::sqrtf(RADIUS_M * RADIUS_M - beside * beside));
        }
        (scan.direction_forward[i], scan.direction_right[i]) = (dx, dy);
        (scan.forward_m[i], scan.right_m[i]) = (range_m * dx, range_m * dy);
        scan.range_m[i] = range_m;
    }
    scan
}

/// Watches a scene from the origin for so many frames.
pub(crate) fn track(scene: &Scene, frames: u64) -> MoverTracker {
    watch(frames, |at_s| scene.at(at_s))
}

/// Watches a thing, which is there after so many seconds, from the origin for so many frames.
fn watch(frames: u64, at: impl Fn(f32) -> (f32, f32)) -> MoverTracker {
    watch_and_look(frames, |frame| at(frame as f32 * 0.05), |_, _| {})
}

/// The same of a thing that is there in so many frames, looking at the tracker after each.
fn watch_and_look(frames: u64, at: impl Fn(u64) -> (f32, f32), look: impl Fn(u64, &MoverTracker)) -> MoverTracker {
    let mut tracker = MoverTracker::default();
    for frame in 0..frames {
        let scan = seen(NedVector::ZERO, at(frame));
        tracker.observe(&scan, NedVector::ZERO, 0.0, frame * 50_000_000);
        look(frame, &tracker);
    }
    tracker
}

/// Looks west for these frames: nothing of what is north is in view.
pub(crate) fn look_aside(tracker: &mut MoverTracker, frames: core::ops::Range<u64>) {
    let scan = seen(NedVector::ZERO, (50.0, 50.0));
    let west_rad = -core::f32::consts::FRAC_PI_2 - 0.6;
    for frame in frames {
        tracker.observe(&scan, NedVector::ZERO, west_rad, frame * 50_000_000);
    }
}

fn whereabouts(mover: &Track) -> Vec<Whereabouts> {
    let mut all = Vec::new();
    mover.for_each_whereabouts(0.0, |w| all.push(w));
    let sum: f32 = all.iter().map(|w| w.weight).sum();
    assert!(sum < 1.0, "{sum}");
    all
}

#[test]
fn what_left_the_view_has_not_come_back_unseen() {
    // It leaves the view, 60 degrees to the right, after 4.3 s, and is not seen for three seconds.
    let tracker = watch(150, |at_s| (1.5, 0.6 * at_s));
    let mover = tracker.movers().next().expect("it moves");
    assert!(!mover.is_located());
    let all = whereabouts(mover);
    let weight = |is: &dyn Fn(&Whereabouts) -> bool| all.iter().filter(|w| is(w)).map(|w| w.weight).sum::<f32>();
    let in_view = weight(&|w| mover.place_m(w.along_m).1 < 2.0);
    let gone_on = weight(&|w| w.direction > 0.0);
    assert!(in_view < 1e-6, "it would be seen there: {in_view}");
    assert!(gone_on > 0.3 && weight(&|w| w.direction < 0.0) > 0.1, "{gone_on}");
}

#[test]
fn what_was_seen_to_turn_at_both_ends_is_known_to_turn_there_again() {
    // To and fro between 1 m left and 1.4 m right, four seconds each way.
    let east_m = |at_s: f32| {
        let share = (at_s / 8.0) % 1.0;
        -1.0 + 2.4 * if share < 0.5 { 2.0 * share } else { 2.0 - 2.0 * share }
    };
    let tracker = watch(200, |at_s| (3.0, east_m(at_s)));
    // Two seconds after its second turn, on its way to the right.
    let mover = tracker.movers().next().expect("it moves");
    let all = whereabouts(mover);
    assert_eq!(all.len(), 1, "{all:?}");
    assert!(
        all[0].weight > 0.85 && (all[0].turns_after_m - 1.2).abs() < 0.25,
        "{all:?}"
    );
    // And three seconds on it has turned.
    let mut later = Vec::new();
    mover.for_each_whereabouts(3.0, |w| later.push(w));
    assert!(later[0].direction < 0.0, "{later:?}");
    let (_, expected_m) = mover.place_m(later[0].along_m);
    assert!((expected_m - east_m(199.0 * 0.05 + 3.0)).abs() < 0.4, "{expected_m}");
}

#[test]
fn what_is_followed_for_the_first_time_may_turn_anywhere_ahead() {
    let scene = Scene::of((4.0, -1.5), (0.0, 0.6));
    let tracker = track(&scene, 60);
    let mover = tracker.movers().next().expect("it moves");
    let all = whereabouts(mover);
    let turns_within = |m: f32| {
        let within = all.iter().filter(|w| w.turns_after_m < m);
        within.map(|w| w.weight).sum::<f32>()
    };
    let (one, two, five) = (turns_within(1.0), turns_within(2.0), turns_within(5.0));
    assert!(
        0.05 < one && one < two && two < five && five > 0.85,
        "{one} {two} {five}"
    );
    assert!(all.iter().all(|w| w.along_m.abs() < 1e-3), "it is where it is seen");
}

#[test]
fn what_moves_is_known_with_its_place_velocity_and_size() {
    let scene = Scene::of((4.0, -1.5), (0.1, 0.6));
    let tracker = track(&scene, 40);
    let mover = tracker.movers().next().expect("it moves");
    let (north_m, east_m) = scene.at(39.0 * 0.05);
    let off_m = libm::hypotf(mover.north_m - north_m, mover.east_m - east_m);
    assert!(off_m < 0.1 && (mover.radius_m - 0.3).abs() < 0.1, "{mover:?}");
    let (off_north_m_s, off_east_m_s) = (mover.north_m_s - 0.1, mover.east_m_s - 0.6);
    assert!(off_north_m_s.abs() < 0.1 && off_east_m_s.abs() < 0.1, "{mover:?}");
    assert_eq!(tracker.movers().count(), 1);
}

#[test]
fn what_stands_does_not_move_however_the_vehicle_does() {
    let mut tracker = MoverTracker::default();
    for frame in 0..80_u32 {
        let from = NedVector::new(0.04 * frame as f32, 0.3 * libm::sinf(0.1 * frame as f32), 0.0);
        tracker.observe(&seen(from, (5.0, 0.6)), from, 0.0, u64::from(frame) * 50_000_000);
    }
    assert_eq!(tracker.movers().count(), 0);
}

#[test]
fn one_that_turned_back_out_of_sight_is_the_same_when_it_is_seen_again() {
    // To the right for three seconds, away for two, then back from where it would not be had it gone on.
    let at = |frame| {
        let at_s = frame as f32 * 0.05;
        let east_m = match frame {
            0..60 => 0.6 * at_s,
            60..100 => 50.0,
            _ => 2.4 - 0.6 * (at_s - 5.0),
        };
        (3.0, east_m)
    };
    let tracker = watch_and_look(160, at, |frame, tracker| {
        let located = tracker.movers().filter(|m| m.is_located()).count();
        match frame {
            59 | 159 => assert_eq!(located, 1, "{frame}"),
            99 => assert_eq!(located, 0),
            _ => {}
        }
        if frame > 104 {
            assert_eq!(tracker.movers().count(), 1, "{frame}: no second one");
        }
    });
    let mover = tracker.movers().next().expect("it moves");
    assert!((mover.east_m_s + 0.6).abs() < 0.15, "{mover:?}");
}

#[test]
fn what_stands_on_the_lane_of_a_lost_mover_does_not_take_its_place() {
    // A mover goes to the right and is lost; a column comes into view beside its way, where the mover may be by then.
    let at = |frame| match frame {
        0..60 => (3.0, 0.6 * (frame as f32 * 0.05)),
        60..70 => (3.0, 50.0),
        _ => (3.0, 2.1),
    };
    let tracker = watch_and_look(120, at, |_, _| {});
    let lost: Vec<&Track> = tracker.movers().collect();
    assert_eq!(lost.len(), 1, "the column stands: {lost:?}");
    assert!(
        !lost[0].is_located() && lost[0].speed_m_s() > 0.4,
        "the mover is still out there: {lost:?}"
    );
}

#[test]
fn the_trace_of_a_mover_is_forgotten_once() {
    let scene = Scene::of((4.0, -1.5), (0.0, 0.6));
    assert_eq!(track(&scene, 12).traces().count(), 1, "just known to move");
    assert_eq!(track(&scene, 60).traces().count(), 0);
    assert_eq!(track(&scene, 60).movers().count(), 1);
}

#[test]
fn one_that_stays_is_an_obstacle_like_others() {
    let at = |frame: u64| (3.0, 0.03 * frame.min(40) as f32);
    let tracker = watch_and_look(120, at, |frame, tracker| {
        assert!(frame != 39 || tracker.movers().count() == 1);
    });
    assert_eq!(tracker.movers().count(), 0);
}

#[test]
fn its_lane_is_where_it_was_seen_and_may_be_by_now() {
    let scene = Scene::of((4.0, -1.5), (0.0, 0.6));
    let tracker = track(&scene, 60);
    let mover = tracker.movers().next().expect("it moves");
    assert!(mover.off_lane_m(4.0, 1.0, 0.0) < 0.9, "half a second ahead of it");
    assert!(mover.off_lane_m(4.0, 1.0, 2.0) < 0.1, "within two seconds' reach");
    assert!(mover.off_lane_m(5.0, 0.0, 2.0) > 0.8, "a metre beside");
}
