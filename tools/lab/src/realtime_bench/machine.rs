//! What the machine is, as far as punctuality depends on it.

use serde::{Deserialize, Serialize};
use std::fs;
use std::path::Path;

#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Machine {
    /// The processor's name.
    pub processor: String,
    /// Processors that this program may use.
    pub processors: usize,
    /// The kernel's release and build.
    pub kernel: String,
    /// A kernel with full preemption (PREEMPT_RT).
    pub preempt_rt: bool,
    pub virtual_machine: bool,
    /// How the clock is governed, each way once; empty where it is not known.
    pub governors: Vec<String>,
    /// Processors that the kernel keeps free of others' threads.
    pub isolated: String,
    /// Microseconds of each second that FIFO threads may have; -1 is all.
    pub realtime_us_per_s: Option<i64>,
}

impl Machine {
    pub fn here() -> Self {
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        Self::in_root(Path::new("/"), processors)
    }

    /// The machine whose `/proc` and `/sys` lie in `root`.
    fn in_root(root: &Path, processors: usize) -> Self {
        let read = |path: &str| fs::read_to_string(root.join(path)).unwrap_or_default();
        let line = |path: &str| read(path).trim_matches(['\n', '\0', ' ']).to_owned();
        let cpuinfo = read("proc/cpuinfo");
        let model = field(&cpuinfo, "model name").map(str::to_owned);
        let governors = (0..1024)
            .map(|cpu| line(&format!("sys/devices/system/cpu/cpu{cpu}/cpufreq/scaling_governor")))
            .take_while(|governor| !governor.is_empty())
            .collect::<std::collections::BTreeSet<_>>();
        let kernel = ["osrelease", "version"].map(|part| line(&format!("proc/sys/kernel/{part}")));
        let kernel = kernel.join(" ");
        Self {
            // Boards tell what they are in the device tree.
            processor: model.unwrap_or_else(|| line("proc/device-tree/model")),
            processors,
            preempt_rt: line("sys/kernel/realtime") == "1" || kernel.contains("PREEMPT_RT"),
            kernel,
            virtual_machine: field(&cpuinfo, "flags").is_some_and(|f| f.split(' ').any(|flag| flag == "hypervisor")),
            governors: governors.into_iter().collect(),
            isolated: line("sys/devices/system/cpu/isolated"),
            realtime_us_per_s: line("proc/sys/kernel/sched_rt_runtime_us").parse().ok(),
        }
    }
}

/// What stands behind a name and a colon.
pub(super) fn field<'a>(text: &'a str, name: &str) -> Option<&'a str> {
    text.lines().find_map(|line| {
        let (key, value) = line.split_once(':')?;
        (key.trim() == name).then(|| value.trim())
    })
}

/// Time of all processors since the machine's start, in ticks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ProcessorTime {
    idle: u64,
    all: u64,
}

impl ProcessorTime {
    pub fn now() -> Self {
        let text = fs::read_to_string("/proc/stat").unwrap_or_default();
        Self::from_line(text.lines().next().unwrap_or_default())
    }

    fn from_line(line: &str) -> Self {
        // Guests' time behind the eighth number is in the first already.
        let ticks = line.split_ascii_whitespace().skip(1).take(8);
        let ticks: Vec<u64> = ticks.map_while(|t| t.parse().ok()).collect();
        Self {
            idle: ticks.iter().skip(3).take(2).sum(),
            all: ticks.iter().sum(),
        }
    }

    /// Share of the time since `earlier` that the processors were busy.
    pub fn busy_since(&self, earlier: &Self) -> f64 {
        let all = self.all.saturating_sub(earlier.all);
        let idle = self.idle.saturating_sub(earlier.idle);
        1.0 - idle as f64 / all.max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn root(files: &[(&str, &str)]) -> tempfile::TempDir {
        let root = tempfile::tempdir().unwrap();
        for (path, text) in files {
            let path = root.path().join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        }
        root
    }

    #[test]
    fn a_board_is_known_by_its_device_tree_and_its_governors_once_each() {
        let board = root(&[
            (
                "proc/cpuinfo",
                "processor : 0\nBogoMIPS : 108.00\nFeatures : fp asimd\n",
            ),
            ("proc/device-tree/model", "Raspberry Pi 4 Model B Rev 1.4\0"),
            ("proc/sys/kernel/osrelease", "6.12.1-rt\n"),
            ("proc/sys/kernel/version", "#1 SMP PREEMPT_RT\n"),
            ("sys/kernel/realtime", "1\n"),
            ("sys/devices/system/cpu/isolated", "3\n"),
            ("sys/devices/system/cpu/cpu0/cpufreq/scaling_governor", "ondemand\n"),
            ("sys/devices/system/cpu/cpu1/cpufreq/scaling_governor", "ondemand\n"),
            ("proc/sys/kernel/sched_rt_runtime_us", "950000\n"),
        ]);
        let expected = Machine {
            processor: "Raspberry Pi 4 Model B Rev 1.4".to_owned(),
            processors: 4,
            kernel: "6.12.1-rt #1 SMP PREEMPT_RT".to_owned(),
            preempt_rt: true,
            virtual_machine: false,
            governors: vec!["ondemand".to_owned()],
            isolated: "3".to_owned(),
            realtime_us_per_s: Some(950_000),
        };
        assert_eq!(Machine::in_root(board.path(), 4), expected);
    }

    #[test]
    fn a_virtual_machine_is_known_by_its_flags_and_has_no_governor() {
        let machine = root(&[(
            "proc/cpuinfo",
            "model name\t: AMD EPYC\nflags\t\t: fpu hypervisor sse\n",
        )]);
        let machine = Machine::in_root(machine.path(), 2);
        assert!(machine.virtual_machine && machine.governors.is_empty() && !machine.preempt_rt);
        assert_eq!(machine.processor, "AMD EPYC");
    }

    #[test]
    fn processors_are_busy_when_they_neither_idle_nor_wait_for_the_disk() {
        let earlier = ProcessorTime::from_line("cpu  100 0 0 100 0 0 0 0 50 0");
        let later = ProcessorTime::from_line("cpu  160 0 10 120 10 0 0 0 99 0");
        assert!((later.busy_since(&earlier) - 0.7).abs() < 1e-12);
    }
}
