//! What the system counts for a thread, read from files that stay open: no memory is asked for after the start.

use super::machine::field;
use anyhow::{Context, Result};
use std::fs::File;
use std::os::unix::fs::FileExt as _;

/// Counted for a thread; as a difference, in a span of time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counters {
    /// Time on a processor.
    pub processor_ns: u64,
    /// Time ready to run, without a processor.
    pub queued_ns: u64,
    /// Times that it gave up the processor, to sleep or to wait.
    pub voluntary: u64,
    /// Times that the processor was taken from it.
    pub involuntary: u64,
    /// Pages mapped without the disk.
    pub minor_faults: u64,
    /// Pages read from the disk.
    pub major_faults: u64,
    /// Time that the hypervisor gave to others on any of this machine's processors, to a tick of 10 ms.
    pub stolen_ns: u64,
}

impl Counters {
    pub fn since(&self, earlier: &Self) -> Self {
        Self {
            processor_ns: self.processor_ns.saturating_sub(earlier.processor_ns),
            queued_ns: self.queued_ns.saturating_sub(earlier.queued_ns),
            voluntary: self.voluntary.saturating_sub(earlier.voluntary),
            involuntary: self.involuntary.saturating_sub(earlier.involuntary),
            minor_faults: self.minor_faults.saturating_sub(earlier.minor_faults),
            major_faults: self.major_faults.saturating_sub(earlier.major_faults),
            stolen_ns: self.stolen_ns.saturating_sub(earlier.stolen_ns),
        }
    }
}

/// The counters of the thread that opened them.
pub struct ThreadCounters {
    schedule: File,
    status: File,
    faults: File,
    machine: File,
    text: Box<[u8; 8192]>,
}

impl ThreadCounters {
    /// Of the calling thread.
    ///
    /// # Errors
    /// A system without `/proc`, or whose kernel counts no scheduling (`CONFIG_SCHED_INFO`).
    pub fn open() -> Result<Self> {
        let open =
            |path: &str| File::open(path).with_context(|| format!("cannot read {path}: the bench needs Linux' /proc"));
        Ok(Self {
            schedule: open("/proc/thread-self/schedstat")?,
            status: open("/proc/thread-self/status")?,
            faults: open("/proc/thread-self/stat")?,
            machine: open("/proc/stat")?,
            text: Box::new([0; 8192]),
        })
    }

    /// What was counted so far; a file that says nothing counts nothing.
    pub fn read(&mut self) -> Counters {
        let mut counters = Counters::default();
        let text = self.text.as_mut_slice();
        parse_schedule(read(&self.schedule, text), &mut counters);
        parse_status(read(&self.status, text), &mut counters);
        parse_faults(read(&self.faults, text), &mut counters);
        // The first line stands for all processors.
        counters.stolen_ns = parse_stolen(read(&self.machine, &mut text[..256]));
        counters
    }
}

fn read<'a>(file: &File, text: &'a mut [u8]) -> &'a str {
    let length = file.read_at(text, 0).unwrap_or(0);
    std::str::from_utf8(text.get(..length).unwrap_or_default()).unwrap_or_default()
}

/// The number in a place of a line; what is none counts nothing.
fn number(line: &str, place: usize) -> u64 {
    let word = line.split_ascii_whitespace().nth(place);
    word.and_then(|word| word.parse().ok()).unwrap_or(0)
}

/// `processor_ns queued_ns timeslices`
fn parse_schedule(text: &str, counters: &mut Counters) {
    (counters.processor_ns, counters.queued_ns) = (number(text, 0), number(text, 1));
}

fn parse_status(text: &str, counters: &mut Counters) {
    let count = |name| field(text, name).map_or(0, |count| number(count, 0));
    counters.voluntary = count("voluntary_ctxt_switches");
    counters.involuntary = count("nonvoluntary_ctxt_switches");
}

/// The name in brackets may hold anything; minor and major faults are the 8th and 10th field behind it.
fn parse_faults(text: &str, counters: &mut Counters) {
    let behind = text.rsplit_once(')').map_or("", |(_, rest)| rest);
    (counters.minor_faults, counters.major_faults) = (number(behind, 7), number(behind, 9));
}

/// Of all processors, in ticks of 10 ms.
fn parse_stolen(line: &str) -> u64 {
    number(line, 8).saturating_mul(10_000_000)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kernels_files_are_read_field_by_field() {
        let mut counters = Counters::default();
        parse_schedule("123456 789 12\n", &mut counters);
        parse_status(
            "Name:\tloop\nvoluntary_ctxt_switches:\t21\nnonvoluntary_ctxt_switches:\t3\n",
            &mut counters,
        );
        parse_faults("77 (a (b) c) S 1 2 3 4 5 6 31 0 2 0 9 9\n", &mut counters);
        counters.stolen_ns = parse_stolen("cpu  1 2 3 4 5 6 7 8 9 10");
        let expected = Counters {
            processor_ns: 123_456,
            queued_ns: 789,
            voluntary: 21,
            involuntary: 3,
            minor_faults: 31,
            major_faults: 2,
            stolen_ns: 80_000_000,
        };
        assert_eq!(counters, expected);
        let mut nothing = Counters::default();
        parse_schedule("", &mut nothing);
        parse_faults("", &mut nothing);
        assert_eq!(nothing, Counters::default());
    }

    #[test]
    fn a_thread_that_sleeps_and_touches_memory_is_counted() {
        let mut counters = ThreadCounters::open().expect("a /proc");
        let before = counters.read();
        for _ in 0..3 {
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        // More than an allocator keeps of what other tests gave back.
        let touched = std::hint::black_box(vec![1_u8; 64 << 20]);
        let counted = counters.read().since(&before);
        assert!(counted.voluntary >= 3, "{counted:?}");
        assert!(
            counted.minor_faults > 0 && counted.processor_ns > 0,
            "{counted:?} {}",
            touched.len()
        );
    }
}
