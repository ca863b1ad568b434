//! What all commands share in talking to people: output, progress, interruption, exit codes, colours, tracing.

use crate::report::TextTable;
use anyhow::{Context, Result, ensure};
use indicatif::{HumanDuration, ProgressBar, ProgressState, ProgressStyle};
use std::fmt::Arguments;
use std::io::{self, IsTerminal, Write};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, OnceLock};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use tracing_subscriber::prelude::*;

/// The command could not do its work (bad arguments, missing file, port in use, full disk).
pub const EXIT_ERROR: u8 = 1;
/// A comparison or check failed (replay differs).
pub const EXIT_DIFFERS: u8 = 3;
/// Ctrl-C or SIGTERM ended it; what was done until then is kept.
pub const EXIT_INTERRUPTED: u8 = 130;
/// A terminal that closes and `timeout` send a signal twice; a person who presses Ctrl-C again is slower.
const TWICE: Duration = Duration::from_millis(500);

/// Why standard output took no more, the first time.
static OUTPUT_FAILURE: OnceLock<io::Error> = OnceLock::new();
/// Standard output carries a report, so what is for people goes to standard error.
static REPORT_ON_STDOUT: AtomicBool = AtomicBool::new(false);
/// A command runs as a part of another one, which says what came of it.
static QUIET: AtomicBool = AtomicBool::new(false);

/// Writes a line to standard output, as `println!` does, but survives a reader that has gone (`… | head`). Any other
/// failure is reported when the program ends ([`finish`]).
#[macro_export]
macro_rules! say {
    () => { $crate::put!("\n") };
    ($($text:tt)*) => { $crate::put!("{}\n", format_args!($($text)*)) };
}
pub use say;

/// [`say`] without the end of the line.
#[macro_export]
macro_rules! put {
    ($($text:tt)*) => { $crate::cli::output::put_text(format_args!($($text)*)) };
}
pub use put;

/// Writes a line to standard error, if anybody listens there.
#[macro_export]
macro_rules! tell {
    ($($text:tt)*) => { $crate::cli::output::tell_line(format_args!($($text)*)) };
}
pub use tell;

#[doc(hidden)]
pub fn put_text(text: Arguments<'_>) {
    if QUIET.load(Ordering::Relaxed) {
        return;
    }
    if REPORT_ON_STDOUT.load(Ordering::Relaxed) {
        let _ = io::stderr().write_fmt(text);
    } else if let Err(error) = io::stdout().write_fmt(text) {
        OUTPUT_FAILURE.get_or_init(|| error);
    }
}

/// Runs `work`, whose words to standard output are dropped; progress and warnings are not.
pub fn quietly<T>(work: impl FnOnce() -> T) -> T {
    QUIET.store(true, Ordering::Relaxed);
    let result = work();
    QUIET.store(false, Ordering::Relaxed);
    result
}

#[doc(hidden)]
pub fn tell_line(text: Arguments<'_>) {
    // Without a reader there is nothing to be said.
    let _ = io::stderr().write_fmt(format_args!("{text}\n"));
}

/// The program's exit code: that of the command, unless standard output took not all of it.
pub fn finish(result: Result<ExitCode>) -> ExitCode {
    let code = result.unwrap_or_else(|error| {
        tell!("vigil: {}", vigil_firmware::program::in_one_line(&error));
        ExitCode::from(EXIT_ERROR)
    });
    let failure = io::stdout().flush().err();
    match OUTPUT_FAILURE.get().or(failure.as_ref()) {
        Some(error) if !vigil_types::files::reader_has_gone(error) => {
            tell!("vigil: cannot write standard output: {error}");
            ExitCode::from(EXIT_ERROR)
        }
        _ => code,
    }
}

/// Whether a path means standard output.
pub fn is_stdout(path: &Path) -> bool {
    ["-", "/dev/stdout"].iter().any(|name| path == Path::new(name))
}

/// Whether a path is or will be a file, neither standard output nor a device.
pub fn is_file(path: &Path) -> bool {
    !is_stdout(path) && (path.is_file() || !path.exists())
}

/// Reserves standard output for the report that goes to `path`, if that is standard output, and otherwise makes the
/// folder of `path` before the work, so that the work is not lost.
///
/// # Errors
/// A folder in the place of the file, or one that cannot be made.
pub fn prepare(path: &Path) -> Result<()> {
    if is_stdout(path) {
        REPORT_ON_STDOUT.store(true, Ordering::Relaxed);
        return Ok(());
    }
    ensure!(
        !path.is_dir() && !path.as_os_str().as_encoded_bytes().ends_with(b"/"),
        "{} is a folder: name a file",
        path.display()
    );
    match path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        Some(folder) => std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display())),
        None => Ok(()),
    }
}

/// Replaces a file ([`vigil_types::files::replace`]), or writes to standard output ([`is_stdout`]).
///
/// # Errors
/// Whatever keeps it from being written whole, with the file's name. An earlier file is then kept.
pub fn write(path: &Path, content: impl AsRef<[u8]>) -> Result<()> {
    let content = content.as_ref();
    if is_stdout(path) {
        let mut out = io::stdout().lock();
        return match out.write_all(content).and_then(|()| out.flush()) {
            Err(error) if !vigil_types::files::reader_has_gone(&error) => {
                Err(error).context("cannot write standard output")
            }
            _ => Ok(()),
        };
    }
    vigil_types::files::replace(path, content, vigil_types::files::Access::Shared)
        .with_context(|| format!("cannot write {}", path.display()))
}

/// What is said when an interrupt comes to work that takes a while to end.
static ON_INTERRUPT: Mutex<Option<&str>> = Mutex::new(None);

/// Set by Ctrl-C, SIGTERM or SIGHUP; another one, at least half a second later, ends the program at once.
pub struct Interrupt(&'static AtomicBool);

impl Interrupt {
    /// Takes the signals from now on. Whoever asks for it after the first gets the same: a command may run others.
    pub fn on_ctrl_c() -> Result<Self> {
        static CAME: AtomicBool = AtomicBool::new(false);
        static IS_TAKEN: Mutex<bool> = Mutex::new(false);
        let mut is_taken = IS_TAKEN.lock().map_err(|_| anyhow::anyhow!("another thread failed"))?;
        let mut first = None;
        if !*is_taken {
            vigil_io::interrupt::on_interrupt(move || {
                CAME.store(true, Ordering::Relaxed);
                // The handler has a thread of its own.
                let text = ON_INTERRUPT.lock().ok().and_then(|text| *text);
                if let (None, Some(text)) = (first, text) {
                    tell!("{text}");
                }
                if first.get_or_insert_with(Instant::now).elapsed() > TWICE {
                    std::process::exit(EXIT_INTERRUPTED.into());
                }
            })?;
        }
        *is_taken = true;
        Ok(Self(&CAME))
    }

    /// Has it say this on standard error if it comes during the work.
    pub fn saying<T>(&self, text: &'static str, work: impl FnOnce() -> T) -> T {
        let say = |text| ON_INTERRUPT.lock().map(|mut said| *said = text).unwrap_or_default();
        say(Some(text));
        let done = work();
        say(None);
        done
    }

    /// Whether it came.
    pub fn came(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// For work that asks after each part of it whether to go on.
    pub fn flow(&self) -> ControlFlow<()> {
        match self.came() {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        }
    }

    /// For those that look for themselves.
    pub fn flag(&self) -> &AtomicBool {
        self.0
    }

    /// The exit code of a command that went as far as this let it.
    pub fn exit_code(&self) -> ExitCode {
        match self.came() {
            true => ExitCode::from(EXIT_INTERRUPTED),
            false => ExitCode::SUCCESS,
        }
    }
}

/// How far a command has come: a bar on a terminal, a line every few seconds anywhere else.
pub struct Progress {
    bar: ProgressBar,
    what: &'static str,
    /// `None` on a terminal.
    pace: Option<Mutex<Pace>>,
}

impl Progress {
    /// `length` of `what` are to be done.
    pub fn new(length: u64, what: &'static str) -> Result<Self> {
        let style = format!("{{bar:30}} {{pos}}/{{len}} {what}, {{elapsed}} gone{{left}}{{msg}}");
        // Before the first is done the estimate is 0.
        let left = |state: &ProgressState, to: &mut dyn std::fmt::Write| {
            if state.pos() > 0 {
                let _ = write!(to, ", {:#} left", HumanDuration(state.eta()));
            }
        };
        let style = ProgressStyle::with_template(&style)?.with_key("left", left);
        let bar = ProgressBar::new(length).with_style(style);
        Ok(Self {
            pace: bar.is_hidden().then(Mutex::default),
            bar,
            what,
        })
    }

    /// So many more are done.
    pub fn inc(&self, count: u64) {
        self.bar.inc(count);
        self.tick();
    }

    /// So many are done.
    pub fn set_position(&self, done: u64) {
        self.bar.set_position(done);
        self.tick();
    }

    /// What stands behind the numbers.
    pub fn set_message(&self, message: impl std::fmt::Display) {
        self.bar.set_message(format!(", {message}"));
    }

    /// Takes the bar away.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }

    fn tick(&self) {
        let Some(pace) = &self.pace else { return };
        let (done, length) = (self.bar.position(), self.bar.length().unwrap_or(0));
        let elapsed = self.bar.elapsed();
        // Another thread holds it and is telling.
        if let Ok(mut pace) = pace.try_lock()
            && pace.is_due(elapsed, done, length)
        {
            let left = match done {
                0 => String::new(),
                _ => format!(", {} s left", self.bar.eta().as_secs()),
            };
            let (what, gone_s, message) = (self.what, elapsed.as_secs(), self.bar.message());
            tell!("{done}/{length} {what}, {gone_s} s gone{left}{message}");
        }
    }
}

/// When the next line is due: 5 s after the last at the earliest, then with the next whole percent or after a minute.
#[derive(Default)]
struct Pace {
    told_at: Duration,
    told_percent: u64,
}

impl Pace {
    fn is_due(&mut self, elapsed: Duration, done: u64, length: u64) -> bool {
        const LEAST: Duration = Duration::from_secs(5);
        const MOST: Duration = Duration::from_secs(60);
        let since = elapsed.saturating_sub(self.told_at);
        let percent = (done as u128 * 100 / u128::from(length.max(1))) as u64;
        let due = since >= MOST || (since >= LEAST && percent != self.told_percent);
        if due {
            (self.told_at, self.told_percent) = (elapsed, percent);
        }
        due
    }
}

/// A number with its unit, or a dash where there is none.
pub fn or_dash(value: f64, decimals: usize, unit: &str) -> String {
    match value.is_finite() {
        true => format!("{value:.decimals$}{unit}"),
        false => "-".to_owned(),
    }
}

/// Starts diagnostics on standard error; `RUST_LOG` overrides `verbosity`.
pub fn start_tracing(verbosity: u8) {
    let default = ["warn", "info", "debug"][usize::from(verbosity.min(2))];
    let diagnostics = tracing_subscriber::fmt::layer()
        .with_writer(std::io::stderr)
        .with_ansi(vigil_firmware::program::colours(std::io::stderr().is_terminal()))
        .with_target(false)
        // Said on standard error, which is what could not be written.
        .log_internal_errors(false);
    tracing_subscriber::registry()
        .with(diagnostics)
        .with(vigil_firmware::program::diagnostics(default))
        .init();
}

/// Paints text where there are colours; plain text anywhere else.
pub struct Paint {
    on: bool,
}

impl Paint {
    /// Colours for standard output.
    pub fn stdout() -> Self {
        Self {
            on: vigil_firmware::program::colours(std::io::stdout().is_terminal()),
        }
    }

    /// Green when `good`, red otherwise.
    pub fn verdict(&self, good: bool, text: &str) -> String {
        match (self.on, good) {
            (false, _) => text.to_owned(),
            (true, true) => format!("\x1b[32m{text}\x1b[0m"),
            (true, false) => format!("\x1b[31m{text}\x1b[0m"),
        }
    }

    /// Prints a table, each row green when it is `good`, red otherwise.
    pub fn table(&self, table: &TextTable, good: &[bool]) {
        let lines = table.lines();
        for (number, line) in lines.iter().enumerate() {
            match number.checked_sub(1).and_then(|row| good.get(row)) {
                Some(good) => say!("{}", self.verdict(*good, line)),
                None => say!("{line}"),
            }
        }
    }
}

/// The exit code of a comparison or check.
pub fn checked(is_good: bool) -> ExitCode {
    ExitCode::from(if is_good { 0 } else { EXIT_DIFFERS })
}

/// Makes a folder for what a command does now with a seed.
///
/// # Errors
/// One that cannot be made, with where.
pub fn make_folder(parent: &Path, command: &str, seed: u64) -> Result<PathBuf> {
    let stamp = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
    vigil_types::files::make_new_folder(parent, &format!("{command}-{stamp}-{seed}"))
        .with_context(|| format!("cannot make a folder in {}", parent.display()))
}

/// The commit of our working tree around this program's file, or else around the current folder, if there is one and git is there.
pub fn git_commit() -> Option<String> {
    let program = std::env::current_exe().ok();
    let mut folders = program.iter().filter_map(|file| file.parent()).chain([Path::new(".")]);
    folders.find_map(commit_around)
}

/// Git in a folder, whatever repository the environment names.
fn git_in(folder: &Path) -> std::process::Command {
    let mut command = std::process::Command::new("git");
    command.arg("-C").arg(folder);
    for name in ["GIT_DIR", "GIT_WORK_TREE", "GIT_INDEX_FILE"] {
        command.env_remove(name);
    }
    command
}

fn commit_around(folder: &Path) -> Option<String> {
    let git = |arguments: &[&str]| {
        let output = git_in(folder).args(arguments).output().ok()?;
        let text = String::from_utf8(output.stdout).ok()?;
        (output.status.success() && !text.trim().is_empty()).then(|| text.trim().to_owned())
    };
    // Anybody's repository may be around them.
    let manifest = PathBuf::from(git(&["rev-parse", "--show-toplevel"])?).join("Cargo.toml");
    let manifest = vigil_types::files::read_text(&manifest, 1 << 20).ok()?;
    let is_ours = manifest.contains("\"firmware/guidance\"");
    is_ours.then(|| git(&["describe", "--always", "--dirty", "--abbrev=40"]))?
}

/// Colour of a range over full scale in pictures of frames: near is bright, as in the contrast that the actor sees.
pub fn range_grey(range: f32) -> [u8; 3] {
    [(255.0 / (1.0 + range * 100.0 / 3.0)) as u8; 3]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_progress_is_due_every_few_seconds_with_a_new_percent_and_every_minute_without() {
        let mut pace = Pace::default();
        let mut due = |seconds, done| pace.is_due(Duration::from_secs(seconds), done, 1000);
        let seconds = [4, 5, 9, 10, 20, 69, 70, 75];
        let done = [50, 50, 90, 90, 95, 96, 96, 110];
        let is_due: Vec<bool> = seconds.into_iter().zip(done).map(|(s, n)| due(s, n)).collect();
        assert_eq!(is_due, [false, true, false, true, false, false, true, true]);
    }

    #[test]
    fn a_program_in_another_repository_than_ours_is_of_no_commit() {
        let folder = tempfile::tempdir().expect("a folder");
        let git = |line: &str| {
            let done = git_in(folder.path()).args(line.split(' ')).status();
            assert!(done.expect("git").success(), "{line}");
        };
        git("init -q");
        git("-c user.name=a -c user.email=a commit -q --allow-empty -m a");
        assert_eq!(commit_around(folder.path()), None);
        let ours = folder.path().join("Cargo.toml");
        std::fs::write(ours, "members = [\"firmware/guidance\"]").expect("written");
        assert_eq!(commit_around(folder.path()).map(|commit| commit.len()), Some(40));
    }

    #[test]
    fn what_is_no_number_is_a_dash() {
        assert_eq!([or_dash(f64::NAN, 1, " s"), or_dash(0.25, 1, " %")], ["-", "0.2 %"]);
    }
}
