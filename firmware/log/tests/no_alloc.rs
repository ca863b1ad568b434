//! The loop's side of recording allocates nothing.

mod common;

use common::{drawn, info};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use vigil_log::{LogPlace, Recorder, RecorderConfig};

thread_local! {
    /// Allocations of this thread; the recorder thread may allocate as it likes.
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

struct Counting;

// SAFETY: hands everything on to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.with(|n| n.set(n.get() + 1));
        // SAFETY: the caller's promise is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise is passed on.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn recording_a_step_allocates_nothing_whether_taken_or_dropped() {
    let steps: Vec<_> = (0..16).map(drawn).collect();
    assert!(steps.iter().any(|s| s.frame().is_some()));
    let dir = tempfile::tempdir().unwrap();
    let mut recorder = Recorder::start(RecorderConfig {
        slots: 8,
        ..RecorderConfig::new(LogPlace::Directory(dir.path().to_owned()), info())
    })
    .unwrap();

    let before = ALLOCATIONS.get();
    assert!(before > 0, "the counter counts");
    // Far faster than the recorder thread writes: some are taken, some dropped.
    let mut taken = 0;
    for step in steps.iter().cycle().take(400) {
        taken += u64::from(recorder.record(|slot| {
            slot.fill(
                step.now_ns,
                step.timing,
                step.frame(),
                &step.received,
                &step.sent,
                &step.report,
            );
        }));
    }
    assert_eq!(ALLOCATIONS.get() - before, 0);
    assert!(
        taken >= 8 && recorder.status().dropped == 400 - taken && taken < 400,
        "{taken} taken"
    );
    assert_eq!(recorder.finish().records, taken);
}
