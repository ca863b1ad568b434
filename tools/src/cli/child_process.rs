//! Processes that this one starts, and that end with it, however it ends.

use crate::cli::output::tell;
use anyhow::{Context, Result, bail, ensure};
use rustix::process::{Signal, getppid, set_parent_process_death_signal};
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use vigil_sim::program::Status;

/// Diagnostics of a child beyond this are not shown.
const SIZE_LIMIT: u64 = 1 << 20;
/// A child that was asked to end gets this long before it is killed.
pub(super) const END_LIMIT: Duration = Duration::from_secs(5);
/// A status is waited for so long before other things are looked at.
pub(super) const LOOK: Duration = Duration::from_millis(200);

/// Has the system send SIGTERM to this process when its parent is gone, `kill -9` included. Called first of all.
///
/// # Errors
/// The parent is gone already, or the system knows no such signal.
pub fn end_with(parent: u32) -> Result<()> {
    set_parent_process_death_signal(Some(Signal::TERM)).context("cannot ask to be ended with the parent")?;
    // A parent that went before the line above is reported by nobody: the process then has another one.
    let now = getppid().map_or(0, |pid| pid.as_raw_nonzero().get());
    ensure!(
        u32::try_from(now) == Ok(parent),
        "the process {parent} that started this one has ended"
    );
    Ok(())
}

/// A child that is asked to end, and killed if it does not, however this program ends.
pub struct Process {
    pub(super) name: &'static str,
    child: Child,
    /// Its diagnostics.
    stderr_file: PathBuf,
    /// What it reports on standard output, read while it runs; the simulator's statuses are read elsewhere.
    report: Option<JoinHandle<String>>,
}

impl Process {
    /// Starts this program again as `name`, arranged; what it says on standard error goes to a file in the folder.
    pub fn start(name: &'static str, folder: &Path, arrange: impl FnOnce(&mut Command)) -> Result<Self> {
        let program = std::env::current_exe().context("cannot find this program's own file")?;
        let stderr_file = folder.join(format!("{name}.log"));
        let log = File::create(&stderr_file).with_context(|| format!("cannot write {}", stderr_file.display()))?;
        let mut command = Command::new(program);
        command.args(["--ends-with", &std::process::id().to_string()]);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(log);
        // Ctrl-C on the terminal reaches this process alone, which ends its children in order.
        command.process_group(0);
        arrange(&mut command);
        let child = command.spawn().with_context(|| format!("cannot start the {name}"))?;
        Ok(Self {
            name,
            child,
            stderr_file,
            report: None,
        })
    }

    /// Keeps what it reports until it ends.
    pub(super) fn listening(mut self) -> Self {
        self.report = self.child.stdout.take().map(|mut pipe| {
            std::thread::spawn(move || {
                let mut text = String::new();
                // What is no text, or comes after a failure, is no report.
                let _ = pipe.read_to_string(&mut text);
                text
            })
        });
        self
    }

    /// Looks whether the child still runs.
    ///
    /// # Errors
    /// It has ended, with the last of what it said.
    pub(super) fn check_when(&mut self, when: &str) -> Result<()> {
        if let Some(status) = self.child.try_wait()? {
            let said = vigil_types::files::read_text(&self.stderr_file, SIZE_LIMIT).unwrap_or_default();
            let lines: Vec<&str> = said.lines().collect();
            let tail = lines[lines.len().saturating_sub(6)..].join("\n  ");
            bail!("the {} ended {when} ({status}); it said last:\n  {tail}", self.name);
        }
        Ok(())
    }

    /// Ends the child and returns what it reported.
    pub fn end(&mut self) -> Result<String> {
        if self.child.try_wait()?.is_none() {
            let pid = rustix::process::Pid::from_child(&self.child);
            rustix::process::kill_process(pid, Signal::TERM)?;
            let asked = Instant::now();
            if wait_for(&mut self.child, || asked.elapsed() > END_LIMIT)?.is_none() {
                let (name, limit_s) = (self.name, END_LIMIT.as_secs());
                tell!("vigil: the {name} did not end within {limit_s} s and is killed");
            }
        }
        // The reader does not panic, and ends with the pipe.
        let report = self.report.take().and_then(|reader| reader.join().ok());
        Ok(report.unwrap_or_default())
    }
}

/// Waits until a child has ended; `None` where that was given up, and the child killed.
pub(super) fn wait_for(
    child: &mut Child,
    mut is_given_up: impl FnMut() -> bool,
) -> std::io::Result<Option<ExitStatus>> {
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(Some(status));
        }
        if is_given_up() {
            child.kill()?;
            child.wait()?;
            return Ok(None);
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if let Ok(None) = self.child.try_wait() {
            // Nothing can be done about a child that cannot be killed.
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}

/// The next status of the simulator, if one comes before it is time to look elsewhere.
///
/// # Errors
/// The simulator has ended, with the last of what it said.
pub fn next_status(simulator: &mut Process, statuses: &Receiver<Status>, when: &str) -> Result<Option<Status>> {
    match statuses.recv_timeout(LOOK) {
        Ok(status) => Ok(Some(status)),
        Err(RecvTimeoutError::Timeout) => Ok(None),
        Err(RecvTimeoutError::Disconnected) => {
            // Its pipe closes a moment before its exit status can be read.
            std::thread::sleep(LOOK);
            simulator.check_when(when)?;
            bail!("the {} closed its output", simulator.name);
        }
    }
}

/// The simulator's statuses, as they come.
pub fn read_statuses(simulator: &mut Process) -> Result<Receiver<Status>> {
    let pipe = simulator.child.stdout.take().context("the simulator has no output")?;
    let (sender, receiver) = channel();
    std::thread::spawn(move || {
        for line in BufReader::new(pipe).lines().map_while(Result::ok) {
            match serde_json::from_str(&line) {
                Ok(status) => {
                    if sender.send(status).is_err() {
                        break;
                    }
                }
                Err(error) => tracing::warn!("the simulator said something unreadable: {error}: {line}"),
            }
        }
    });
    Ok(receiver)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_child_is_in_a_group_of_its_own_which_a_terminal_does_not_interrupt() {
        let folder = tempfile::tempdir().expect("a folder");
        let mut started = Process::start("child", folder.path(), |_| {}).expect("a child");
        let pid = rustix::process::Pid::from_child(&started.child);
        assert_eq!(rustix::process::getpgid(Some(pid)), Ok(pid));
        // It is this test's program, which knows none of our arguments.
        started.child.wait().expect("its end");
        let ended = started
            .check_when("before the flight")
            .expect_err("it ended")
            .to_string();
        assert!(ended.contains("child ended before the flight (exit status"), "{ended}");
    }
}
