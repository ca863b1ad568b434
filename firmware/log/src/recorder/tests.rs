use super::*;
use crate::{LogEnd, Reader};
use std::io::{Cursor, SeekFrom};
use std::sync::Mutex;

fn config(when_full: WhenFull, slots: usize) -> RecorderConfig {
    RecorderConfig {
        when_full,
        slots,
        ..RecorderConfig::new(LogPlace::File(PathBuf::new()), FlightInfo::default())
    }
}

fn start<W: Write + Seek + Send + 'static>(sink: W, config: RecorderConfig) -> Result<Recorder, StartError> {
    Recorder::start_on(sink, Vec::new(), PathBuf::from("flight.mcap"), config)
}

/// A disk that others can look at: full after `limit` bytes, and blocked while its gate is held.
#[derive(Clone)]
struct Disk {
    content: Arc<Mutex<Cursor<Vec<u8>>>>,
    gate: Arc<Mutex<()>>,
    limit: usize,
}

impl Disk {
    fn new(limit: usize) -> Self {
        Self {
            content: Arc::default(),
            gate: Arc::default(),
            limit,
        }
    }

    fn read_back(&self) -> (Vec<Box<TickRecord>>, Option<LogEnd>) {
        let bytes = self.content.lock().unwrap().get_ref().clone();
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("flight.mcap");
        std::fs::write(&path, bytes).unwrap();
        let mut reader = Reader::open(&path).unwrap();
        let records = reader.by_ref().map(Result::unwrap).collect();
        (records, reader.end())
    }
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let _open = self.gate.lock().unwrap();
        let mut content = self.content.lock().unwrap();
        let room = self.limit.saturating_sub(content.get_ref().len());
        match bytes.split_at_checked(room) {
            Some((_, rest)) if room == 0 && !rest.is_empty() => Err(io::ErrorKind::StorageFull.into()),
            Some((fits, _)) => content.write(fits),
            None => content.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for Disk {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.content.lock().unwrap().seek(to)
    }
}

fn step(recorder: &mut Recorder, step: u64, apart_ns: u64) -> bool {
    recorder.record(|slot| {
        slot.now_ns = step * apart_ns;
        slot.timing.step = step;
        slot.set_frame(None);
    })
}

#[test]
fn a_disk_that_is_full_at_start_is_a_clear_error() {
    let error = start(Disk::new(100), config(WhenFull::Drop, 4))
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("no storage space") && error.contains("free some space"),
        "{error}"
    );
}

#[test]
fn a_disk_that_fills_in_flight_costs_the_log_its_end_and_the_flight_nothing() {
    let disk = Disk::new(60_000);
    let mut recorder = start(disk.clone(), config(WhenFull::Wait, 4)).unwrap();
    let total = 3_000;
    for i in 0..total {
        assert!(step(&mut recorder, i, 50_000_000), "the loop is served on");
    }
    let summary = recorder.finish();
    let failure = summary.failure.unwrap();
    assert_eq!(
        failure.matches("no storage space").count(),
        1,
        "reported once: {failure}"
    );
    assert_eq!(summary.records + summary.dropped, total);
    assert!(summary.records > 0 && summary.dropped > 0);

    let (records, end) = disk.read_back();
    assert!(records.len() as u64 >= summary.records);
    assert!(records.iter().zip(0..).all(|(r, i)| r.timing.step == i));
    assert!(matches!(end, Some(LogEnd::Interrupted { .. })));
}

#[test]
fn a_stalled_disk_drops_records_and_the_log_says_how_many() {
    let disk = Disk::new(usize::MAX);
    let mut recorder = start(disk.clone(), config(WhenFull::Drop, 4)).unwrap();
    let stalled = disk.gate.lock().unwrap();
    // Two seconds apart: every record is flushed, and the first flush stalls.
    let mut taken = 0;
    for i in 0..50 {
        taken += u64::from(step(&mut recorder, i, 2_000_000_000));
    }
    // Four slots, and one that was written before the disk was needed.
    assert!((4..=5).contains(&taken), "{taken}");
    assert_eq!(recorder.dropped(), 50 - taken);
    drop(stalled);
    while !step(&mut recorder, 50, 2_000_000_000) {
        std::thread::yield_now();
    }
    let dropped = recorder.dropped();
    let summary = recorder.finish();
    assert_eq!(
        (summary.records, summary.dropped, summary.failure),
        (taken + 1, dropped, None)
    );

    let (records, end) = disk.read_back();
    assert_eq!(end, Some(LogEnd::Closed { dropped }));
    let last = records.last().unwrap();
    assert_eq!((last.timing.step, last.dropped_before), (50, dropped));
}

#[test]
fn what_recurs_comes_at_its_rate_whatever_the_jitter_of_the_steps() {
    let mut last = None;
    let jittery = |step: u64| step * 50_000_000 + step % 7 * 30_000;
    let due = (0..2000).filter(|step| crate::log_file::due(&mut last, jittery(*step), 200_000_000));
    assert_eq!(due.count(), 500);
}

#[test]
fn a_loop_that_falls_silent_has_its_last_records_on_disk() {
    let disk = Disk::new(usize::MAX);
    let mut recorder = start(disk.clone(), config(WhenFull::Drop, 4)).unwrap();
    assert!(step(&mut recorder, 0, 0) && step(&mut recorder, 1, 0));
    while recorder.flushed() < 2 {
        std::thread::sleep(Duration::from_millis(5));
    }
    assert_eq!(disk.read_back().0.len(), 2);
    drop(recorder);
}
