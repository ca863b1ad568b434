//! What a step's record costs the loop, and how fast the recorder thread writes.

use divan::{Bencher, counter::ItemsCount};
use std::path::PathBuf;
use vigil_log::{FlightInfo, LogPlace, Recorder, RecorderConfig, TickRecord, WhenFull};
use vigil_types::{Datagrams, DepthFrame, STEP_NS};

fn main() {
    divan::main();
}

/// A frame of ranges with 2 cm of noise: such mantissas hardly compress.
fn noisy_frame() -> Box<DepthFrame> {
    let mut frame = Box::new(DepthFrame::EMPTY);
    let mut state = 1_u32;
    for value in &mut frame.depth {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        *value = 0.1 + (state >> 8) as f32 / (1 << 24) as f32 * 4e-4;
    }
    frame.seal();
    frame
}

fn traffic() -> Datagrams {
    let mut datagrams = Datagrams::default();
    for _ in 0..6 {
        datagrams.push(0, &[0xFD; 40]);
    }
    datagrams
}

/// Fills a slot as the loop does.
fn put(slot: &mut TickRecord, now_ns: u64, frame: &DepthFrame, traffic: &Datagrams) {
    let (timing, report) = Default::default();
    slot.fill(now_ns, timing, Some(frame), traffic, traffic, &report);
}

/// The copy into the slot: all that the loop pays.
#[divan::bench]
fn fill(bencher: Bencher<'_, '_>) {
    let (frame, traffic) = (noisy_frame(), traffic());
    let mut slot: Box<TickRecord> = Box::default();
    bencher.bench_local(|| put(divan::black_box(&mut slot), 0, &frame, &traffic));
}

/// A hundred steps with a frame each, from the first record to the closed file.
#[divan::bench(sample_count = 10)]
fn write_100_steps(bencher: Bencher<'_, '_>) {
    let (frame, traffic) = (noisy_frame(), traffic());
    let dir = tempfile::tempdir().expect("a temporary directory");
    let place = LogPlace::Directory(PathBuf::from(dir.path()));
    bencher
        .counter(ItemsCount::new(100_u32))
        .with_inputs(|| {
            Recorder::start(RecorderConfig {
                when_full: WhenFull::Wait,
                ..RecorderConfig::new(place.clone(), FlightInfo::default())
            })
            .expect("a recorder")
        })
        .bench_local_values(|mut recorder| {
            for step in 0..100 {
                recorder.record(|slot| put(slot, step * STEP_NS, &frame, &traffic));
            }
            recorder.finish()
        });
}
