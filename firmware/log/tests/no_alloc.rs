//! The loop's side of recording allocates nothing.

mod common;
#[path = "../../nnet/tests/counting/mod.rs"]
mod counting;

use common::{drawn, info};
use counting::allocations;
use vigil_log::{LogPlace, Recorder, RecorderConfig};

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

    let before = allocations();
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
    assert_eq!(allocations() - before, 0);
    assert!(
        taken >= 8 && recorder.dropped() == 400 - taken && taken < 400,
        "{taken} taken"
    );
    assert_eq!(recorder.finish().records, taken);
}
