//! What the end-to-end tests share: the `vigil` program as child processes that never outlive their test.

pub mod ground;
pub mod mission;
mod pair;
#[path = "../../firmware/mavlink/tests/common/peer.rs"]
#[allow(missing_docs, reason = "the scripted vehicles of the MAVLink crate's tests")]
pub mod peer;

pub use mission::straight_course;
pub use pair::{Pair, airborne, fly_monitored, reasons, texts, without};

use std::cell::RefCell;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};
use vigil_log::{FlightInfo, Reader, Recorder, RecorderConfig, TickRecord};
use vigil_sim::program::Status;
use vigil_types::STEP_NS;

/// Longest wait for anything that happens within seconds on an idle machine.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// The `vigil` program that belongs to this build.
pub fn vigil() -> PathBuf {
    let mut folder = std::env::current_exe().expect("a test has a file");
    folder.pop();
    if folder.ends_with("deps") {
        folder.pop();
    }
    let program = folder.join("vigil");
    assert!(
        program.is_file(),
        "{} is missing: run `cargo build --release --workspace --bins`",
        program.display()
    );
    program
}

/// How many processes of this build's `vigil` run on an instance.
pub fn processes_of(instance: &str) -> usize {
    let program = format!("{}\0", vigil().display());
    let wanted = format!("\0--instance\0{instance}\0");
    let processes = std::fs::read_dir("/proc").into_iter().flatten().flatten();
    let commands = processes.filter_map(|process| std::fs::read_to_string(process.path().join("cmdline")).ok());
    commands
        .filter(|command| command.starts_with(&program) && command.contains(&wanted))
        .count()
}

/// Runs `vigil` to its end.
pub fn run(arguments: &[&str]) -> Output {
    let mut program = program();
    program.args(arguments).stdin(Stdio::null());
    program.output().expect("vigil starts")
}

/// The same with the arguments in a line, between spaces.
pub fn run_line(arguments: &str) -> Output {
    run(&arguments.split_whitespace().collect::<Vec<_>>())
}

/// The program as a user starts it: without the larger stacks that `.cargo/config.toml` gives the tests.
pub fn program() -> Command {
    let mut program = Command::new(vigil());
    program.env_remove("RUST_MIN_STACK");
    program
}

/// Both outputs of a finished program as text.
pub fn said(output: &Output) -> String {
    format!(
        "{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    )
}

/// What a program said that has to have ended well.
pub fn succeed(output: &Output) -> String {
    ended(output, 0, &[])
}

/// What a program said that has to have failed with these words in what it said.
pub fn refused(output: &Output, words: &[&str]) -> String {
    ended(output, 1, words)
}

/// The same with an exit code of its own.
pub fn ended(output: &Output, code: i32, words: &[&str]) -> String {
    let said = said(output);
    assert_eq!(output.status.code(), Some(code), "{said}");
    has(&said, words);
    said
}

/// Fails where a text lacks some of these words.
#[track_caller]
pub fn has(text: &str, words: &[&str]) {
    for words in words {
        assert!(text.contains(words), "not `{words}`: {text}");
    }
}

/// A JSON file.
pub fn json(path: &Path) -> serde_json::Value {
    let text = std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    serde_json::from_slice(&text).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// A path as an argument.
pub fn text(path: &Path) -> &str {
    path.to_str().expect("a UTF-8 path")
}

/// The pages of the documentation.
pub fn pages() -> Vec<PathBuf> {
    let mut pages = files_below(&root().join("docs"), &[".md"]);
    pages.push(root().join("README.md"));
    pages
}

/// The report of a campaign of the default stack with so many flights, into a file of this name.
pub fn evaluate(folder: &Path, name: &str, flights: &str, arguments: &[&str]) -> serde_json::Value {
    let file = folder.join(name);
    let common = ["evaluate", "--flights", flights, "--json", text(&file)];
    succeed(&run(&[&common[..], arguments].concat()));
    json(&file)
}

/// The repository's folder.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Files below a folder with one of these endings, without what is built, generated or hidden.
pub fn files_below(folder: &Path, endings: &[&str]) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display())) {
        let path = entry.expect("an entry").path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if path.is_dir() {
            if !["target", "runs", "generated"].contains(&&*name) && !name.starts_with('.') {
                found.extend(files_below(&path, endings));
            }
        } else if endings.iter().any(|ending| name.ends_with(ending)) {
            found.push(path);
        }
    }
    found
}

/// The only log below a folder.
pub fn only_log(folder: &Path) -> PathBuf {
    let mut logs = files_below(folder, &[".mcap"]);
    assert_eq!(logs.len(), 1, "{logs:?}");
    logs.remove(0)
}

/// A recorder of a new log that waits for room rather than drop a step.
fn recorder(log: &Path, info: FlightInfo) -> Recorder {
    Recorder::start(RecorderConfig::lossless(log, info)).expect("a new log")
}

/// A log of so many steps, each as `fill` makes it.
pub fn write_log(log: &Path, info: FlightInfo, steps: u64, mut fill: impl FnMut(&mut TickRecord)) {
    let mut recorder = recorder(log, info);
    for step in 0..steps {
        assert!(recorder.record(|slot| {
            (slot.now_ns, slot.timing.step) = (step * STEP_NS, step);
            fill(slot);
        }));
    }
    assert_eq!(recorder.finish().failure, None);
}

/// Shows every record of a log.
pub fn read_log(log: &Path, mut look: impl FnMut(&mut TickRecord)) {
    let mut reader = Reader::open(log).expect("a log");
    let mut record = Box::<TickRecord>::default();
    while reader.read_next(&mut record).expect("a readable log") {
        look(&mut record);
    }
}

/// Writes the records of one log into another, each after `alter` saw it.
pub fn copy_log(from: &Path, to: &Path, mut alter: impl FnMut(&mut TickRecord)) {
    let mut recorder = recorder(to, Reader::open(from).expect("a log").info().clone());
    read_log(from, |r| {
        alter(r);
        assert!(recorder.record(|slot| slot.fill(r.now_ns, r.timing, r.frame(), &r.received, &r.sent, &r.report)));
    });
    assert_eq!(recorder.finish().failure, None);
}

/// The log of an attacked flight of the actor in lockstep, in which the detector raises the alarm and the recovery pilot flies.
pub fn attacked_flight(folder: &Path) -> PathBuf {
    let logs = text(folder);
    let line = "evaluate --flights 1 --seed 3001 --apf off --attack bim-accumulating --burst 50";
    succeed(&run_line(&format!("{line} --logs {logs} -o {logs}/evaluate.json")));
    folder.join("3001.mcap")
}

/// Runs trials `0..count` on as many threads as there are instances; each thread has an instance of its own. In order of the trials.
pub fn side_by_side<T: Send + Sync>(
    count: usize,
    instances: &[u32],
    trial: impl Fn(usize, u32) -> Option<T> + Sync,
) -> Vec<T> {
    let next = AtomicUsize::new(0);
    let done: Vec<OnceLock<T>> = (0..count).map(|_| OnceLock::new()).collect();
    let another = |instance| {
        let number = next.fetch_add(1, Ordering::Relaxed);
        done.get(number)?.set(trial(number, instance)?).ok()
    };
    std::thread::scope(|scope| {
        for instance in instances {
            scope.spawn(|| while another(*instance).is_some() {});
        }
    });
    done.into_iter().filter_map(OnceLock::into_inner).collect()
}

/// A running `vigil` command; killed when dropped, by SIGKILL: it gets no chance to say good-bye.
pub struct Running {
    child: Child,
    lines: Receiver<String>,
    /// What [`Self::wait_for_words`] passed over.
    heard: RefCell<Vec<String>>,
}

impl Running {
    /// Starts `vigil` with arguments between spaces; its standard output is read line by line.
    pub fn start(arguments: &str) -> Self {
        Self::start_saying(arguments, Stdio::inherit())
    }

    /// The same with its diagnostics elsewhere; piped ones are read among the lines of its output.
    pub fn start_saying(arguments: &str, diagnostics: Stdio) -> Self {
        let mut child = program()
            .args(arguments.split_whitespace())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(diagnostics)
            .spawn()
            .expect("vigil starts");
        let (sender, lines) = channel();
        let output = child.stdout.take().map(|pipe| Box::new(pipe) as Box<dyn Read + Send>);
        let diagnostics = child.stderr.take().map(|pipe| Box::new(pipe) as Box<dyn Read + Send>);
        for pipe in output.into_iter().chain(diagnostics) {
            let sender = sender.clone();
            std::thread::spawn(move || {
                for line in BufReader::new(pipe).lines().map_while(Result::ok) {
                    if sender.send(line).is_err() {
                        break;
                    }
                }
            });
        }
        let heard = RefCell::default();
        Self { child, lines, heard }
    }

    /// Waits for a line that `wanted` accepts; the lines before it are passed over.
    ///
    /// # Panics
    /// When none comes within [`PATIENCE`], or the program ends; the message says what was awaited and what came last.
    pub fn wait_for<T>(&self, what: &str, mut wanted: impl FnMut(&str) -> Option<T>) -> T {
        let begun = Instant::now();
        let mut last = String::new();
        loop {
            match self.lines.recv_timeout(PATIENCE.saturating_sub(begun.elapsed())) {
                Ok(line) => {
                    if let Some(found) = wanted(&line) {
                        return found;
                    }
                    last = line;
                }
                Err(error) => panic!("waited for {what}: {error}; last line: {last}"),
            }
        }
    }

    /// Waits for a line with these words, if it was not passed over by an earlier such wait: piped diagnostics come in any order.
    pub fn wait_for_words(&self, words: &str) -> String {
        let mut heard = self.heard.borrow_mut();
        if let Some(at) = heard.iter().position(|line| line.contains(words)) {
            return heard.remove(at);
        }
        let begun = Instant::now();
        while let Some(line) = self.line(PATIENCE.saturating_sub(begun.elapsed())) {
            if line.contains(words) {
                return line;
            }
            heard.push(line);
        }
        panic!("never said `{words}`: {heard:#?}");
    }

    /// Waits for a status line of a simulator that `wanted` accepts.
    pub fn wait_for_status(&self, what: &str, mut wanted: impl FnMut(&Status) -> bool) -> Status {
        self.wait_for(what, |line| serde_json::from_str(line).ok().filter(|s| wanted(s)))
    }

    /// The next line, or `None` when none comes in time or the program closed its output.
    pub fn line(&self, patience: Duration) -> Option<String> {
        self.lines.recv_timeout(patience).ok()
    }

    /// The next status line of a simulator; `None` as in [`Self::line`].
    pub fn status(&self, patience: Duration) -> Option<Status> {
        serde_json::from_str(&self.line(patience)?).ok()
    }

    /// The lines up to the end of its output.
    pub fn rest(&self) -> Vec<String> {
        std::iter::from_fn(|| self.line(PATIENCE)).collect()
    }

    /// The process's number.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Whether it has not ended.
    pub fn is_running(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    /// Sends a signal.
    pub fn signal(&self, signal: rustix::process::Signal) {
        rustix::process::kill_process(rustix::process::Pid::from_child(&self.child), signal).expect("it is running");
    }

    /// Waits for the end; returns the exit code.
    pub fn wait(&mut self) -> Option<i32> {
        let begun = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().expect("it can be waited for") {
                return status.code();
            }
            assert!(
                begun.elapsed() < PATIENCE,
                "it did not end within {} s",
                PATIENCE.as_secs()
            );
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // Already ended is fine; nothing else can be done here.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
