//! The whole tick without an operating system: flies a recorded flight again, compares every byte that it sends and every decision with
//! the log, and says what code, memory and stack it took (docs/boards.md).
#![no_std]
#![no_main]

extern crate alloc;

mod memory;
mod recording;

use alloc::boxed::Box;
use recording::{Digest, HAS_FRAME, KNOWN_ALTERED, MAGIC, Setup};
use semihosting::{println, process::exit};
use vigil_detector::{FrozenDetector, Monitor};
use vigil_firmware::pilots::Pilots;
use vigil_firmware::stack::{FlightStack, TickInput, TickOutput};
use vigil_nnet::{Isa, Purpose};
use vigil_policy::{FrozenActor, FrozenPilot};
use vigil_types::{Attitude, Datagrams, DepthFrame, NedVector, StepTiming};

core::arch::global_asm!(include_str!("boot.s"));

/// Where the recording is loaded, and how much memory there is for it.
const RECORDING: (usize, usize) = (0x4800_0000, 0x3800_0000);

/// Reads the recording from its begin.
struct Cursor(&'static [u8]);

impl Cursor {
    fn bytes(&mut self, len: usize) -> &'static [u8] {
        let (head, rest) = self
            .0
            .split_at_checked(len)
            .expect("the recording ends in the middle of a step");
        self.0 = rest;
        head
    }

    fn array<const N: usize>(&mut self) -> [u8; N] {
        self.bytes(N).try_into().expect("as long as asked for")
    }

    fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.array())
    }

    fn u64(&mut self) -> u64 {
        u64::from_le_bytes(self.array())
    }

    fn f32(&mut self) -> f32 {
        f32::from_le_bytes(self.array())
    }

    fn datagrams(&mut self, into: &mut Datagrams) {
        into.clear();
        for _ in 0..self.u32() {
            let [link] = self.array();
            let len = u16::from_le_bytes(self.array());
            assert!(
                into.push(link, self.bytes(len.into())),
                "more datagrams than a step can have"
            );
        }
    }

    fn frame(&mut self, into: &mut DepthFrame) {
        let header = &mut into.header;
        header.stamp_ns = self.u64();
        header.sequence = self.u64();
        header.sensor_id = self.u32();
        header.rows = u16::from_le_bytes(self.array());
        header.cols = u16::from_le_bytes(self.array());
        header.position_ned_m = NedVector::new(self.f32(), self.f32(), self.f32());
        header.attitude = Attitude {
            w: self.f32(),
            x: self.f32(),
            y: self.f32(),
            z: self.f32(),
        };
        header.reserved = self.u32();
        header.checksum = self.u64();
        header.tag = self.array();
        for value in &mut into.depth {
            *value = self.f32();
        }
    }
}

fn pilots(setup: &Setup) -> Pilots {
    let isa = Isa::detect();
    println!("kernels: {}", isa.name());
    let pilot = FrozenPilot::Actor(FrozenActor::built_in().expect("the built-in actor"));
    let detector = FrozenDetector::built_in().expect("the built-in detector");
    let head = pilot.head(Purpose::Multipliers).expect("the actor's head");
    let mut monitor = Monitor::new(isa, head, &pilot.sha256(), &detector).expect("the detector is the actor's");
    monitor.set_threshold(setup.threshold);
    Pilots::learned(isa, &pilot, setup.field, Some(Box::new(monitor)), true).expect("the built-in actor")
}

#[unsafe(no_mangle)]
extern "C" fn main() -> ! {
    memory::paint_stack();
    memory::give_heap();
    // SAFETY: the machine has this memory; nothing writes it.
    let mut recording = Cursor(unsafe { core::slice::from_raw_parts(RECORDING.0 as *const u8, RECORDING.1) });
    assert!(
        recording.array() == MAGIC,
        "no recorded flight is loaded at {:#x}",
        RECORDING.0
    );
    let mut setup = Setup {
        goal_ned_m: [recording.f32(), recording.f32(), recording.f32()],
        threshold: recording.f32(),
        field: recording.u32() != 0,
        steps: recording.u32(),
        config: 0,
    };
    setup.config = recording.u64();
    let config = setup.stack();
    assert!(
        Digest::of(&config) == setup.config,
        "this image's configuration is not the flight's: {config:?}"
    );

    let mut stack = FlightStack::with_pilots(&config, pilots(&setup)).expect("the configuration may fly");
    let mut received = Box::<Datagrams>::default();
    let mut recorded = Box::<Datagrams>::default();
    let mut output = Box::<TickOutput>::default();
    let mut frame = Box::new(DepthFrame::EMPTY);
    let (start_stack, start_heap) = (memory::deepest_stack(), memory::heap());

    memory::paint_stack();
    let (mut sent_bytes, mut frames, mut decisions, mut verdicts) = (0, 0, 0, 0);
    let mut tick_counts = (u64::MAX, 0, 0);
    for _ in 0..setup.steps {
        let now_ns = recording.u64();
        let timing = StepTiming {
            step: recording.u64(),
            previous_execution_ns: recording.u64(),
            wake_late_ns: recording.u64(),
            slips: recording.u64(),
        };
        let report = recording.u64();
        let flags = recording.u32();
        recording.datagrams(&mut received);
        recording.datagrams(&mut recorded);
        let has_frame = flags & HAS_FRAME != 0;
        if has_frame {
            recording.frame(&mut frame);
            frames += 1;
        }
        let input = TickInput {
            now_ns,
            timing,
            frame: has_frame.then_some(&*frame),
            frame_known_altered: flags & KNOWN_ALTERED != 0,
            received: &received,
        };
        let before = memory::count();
        stack.tick(&input, &mut output);
        let took = memory::count() - before;
        if output.report.judgement.is_some() {
            verdicts += 1;
            tick_counts = (took.min(tick_counts.0), took.max(tick_counts.1), tick_counts.2 + took);
        }
        decisions += u32::from(output.report.action.is_some());
        if let Some((datagram, byte)) = difference(&recorded, &output.sent) {
            println!(
                "step {}: datagram {datagram} differs from the log's at byte {byte}",
                timing.step
            );
            exit(1);
        }
        if Digest::of(&output.report) != report {
            println!(
                "step {}: the report differs from the log's: {:?}",
                timing.step, output.report
            );
            exit(1);
        }
        sent_bytes += output.sent.iter().map(|(_, bytes)| bytes.len()).sum::<usize>();
    }
    let (tick_stack, tick_heap) = (memory::deepest_stack(), memory::heap());

    println!(
        "all {} steps are equal to the log: {sent_bytes} bytes sent, {frames} frames, {decisions} actions, {verdicts} verdicts",
        setup.steps
    );
    let (text, constants, statics) = memory::image();
    println!("code {text} B; constants {constants} B, actor and detector among them; statics {statics} B");
    println!(
        "heap {} B in use in flight, {} B at most while starting",
        tick_heap.in_use, start_heap.most
    );
    println!("stack {start_stack} B at most while starting, {tick_stack} B in a step (whole loop)");
    println!("allocations in flight: {}", tick_heap.calls - start_heap.calls);
    if verdicts > 0 {
        let ((least, most, sum), hz) = (tick_counts, memory::count_hz());
        let mean = sum / verdicts;
        println!("counter in a step with a verdict: {least} to {most}, mean {mean} (Hz: {hz})");
    }
    assert!(tick_heap.calls == start_heap.calls, "a step allocated memory");
    exit(0)
}

/// Datagram and byte of the first difference.
fn difference(recorded: &Datagrams, sent: &Datagrams) -> Option<(usize, usize)> {
    for (index, (a, b)) in recorded.iter().zip(sent.iter()).enumerate() {
        if a != b {
            return Some((index, a.1.iter().zip(b.1).take_while(|(a, b)| a == b).count()));
        }
    }
    (recorded.len() != sent.len()).then(|| (recorded.len().min(sent.len()), 0))
}

#[unsafe(no_mangle)]
extern "C" fn fault(syndrome: u64, at: u64, address: u64) -> ! {
    println!("exception: syndrome {syndrome:#x} at {at:#x}, address {address:#x}");
    exit(102)
}

#[panic_handler]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    println!("{info}");
    exit(101)
}
