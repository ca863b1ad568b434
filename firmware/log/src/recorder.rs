//! The loop's side of the log: a handle that never waits, and the thread behind it that writes.

use crate::log_file::LogFile;
use crate::{FlightInfo, Scene, TickRecord, tlog};
use mcap::McapError;
use rtrb::{Consumer, Producer, RingBuffer};
use std::fs::File;
use std::io::{self, BufWriter, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use vigil_types::LogContent;
use vigil_types::files::{FileError, at};

/// Where the log goes. The tlog stands beside it, with the extension `tlog`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LogPlace {
    /// Exactly this file; it must not exist yet.
    File(PathBuf),
    /// The next free `flight-0001.mcap`, `flight-0002.mcap`, … in this directory, which is made if it is missing.
    Directory(PathBuf),
}

/// What to do when the recorder thread has fallen behind and no slot is free.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WhenFull {
    /// Drop the record and count it: for flying in real time, where the loop must never wait.
    Drop,
    /// Wait for a slot: for lockstep, where no record may be missing.
    Wait,
}

/// How to record.
#[derive(Debug, Clone)]
pub struct RecorderConfig {
    /// Where the log goes.
    pub place: LogPlace,
    /// What to do when no slot is free.
    pub when_full: WhenFull,
    /// Slots of about 200 kB each, at least one, all made at start; 100 of them bridge 5 s of a stalled disk at 20 Hz.
    pub slots: usize,
    /// Added to the loop's time to give nanoseconds since the UNIX epoch ([`epoch_offset_ns`]); 0 shows simulated time
    /// as it is.
    pub epoch_offset_ns: u64,
    /// What the log says about the flight.
    pub info: FlightInfo,
    /// Obstacles to show.
    pub scene: Option<Scene>,
    /// What the log holds. The configuration in `info` says the same, so that readers know.
    pub content: LogContent,
}

impl RecorderConfig {
    /// Records to `place` as in real time: drops when full, 100 slots, time shown as it is.
    pub fn new(place: LogPlace, info: FlightInfo) -> Self {
        Self {
            place,
            when_full: WhenFull::Drop,
            slots: 100,
            epoch_offset_ns: 0,
            info,
            scene: None,
            content: LogContent::Everything,
        }
    }

    /// Records to exactly this file and waits for a slot when all are full: no record is missing.
    pub fn lossless(file: &Path, info: FlightInfo) -> Self {
        Self {
            when_full: WhenFull::Wait,
            ..Self::new(LogPlace::File(file.to_owned()), info)
        }
    }
}

/// The present epoch offset of a clock that shows `now_ns`: reads the machine's wall clock, so it is for the start only.
pub fn epoch_offset_ns(now_ns: u64) -> u64 {
    let wall = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .map_or(0, |d| u64::try_from(d.as_nanos()).unwrap_or(0));
    wall.saturating_sub(now_ns)
}

/// Why recording could not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The directory cannot be made or read.
    #[error("log directory {0}; give a directory that can be written")]
    Directory(FileError),
    /// A log of that name is already there; nothing was touched.
    #[error("log file {0} already exists and is kept; give another name")]
    Exists(PathBuf),
    /// The file cannot be made.
    #[error("log file {0}; give a place that can be written")]
    Create(FileError),
    /// The file was made and its first bytes could not be written, for example on a full disk.
    #[error(
        "log file {} cannot be written: {}; free some space or give another place",
        .0.display(),
        describe(.1)
    )]
    Write(PathBuf, McapError),
    /// The recorder thread could not be started.
    #[error("the recorder thread could not be started: {0}")]
    Thread(io::Error),
}

/// How recording ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Summary {
    /// The log.
    pub path: PathBuf,
    /// Size of the log.
    pub bytes: u64,
    /// Records in the log.
    pub records: u64,
    /// Records that are missing, whether dropped or lost.
    pub dropped: u64,
    /// Why the log or the tlog is incomplete, if it is.
    pub failure: Option<String>,
}

#[derive(Debug, Default)]
struct Shared {
    dropped: AtomicU64,
    written: AtomicU64,
    flushed: AtomicU64,
    lost: AtomicU64,
}

/// The loop's handle. Start it before the loop's thread raises its priority: the recorder thread inherits the
/// scheduling of the thread that starts it.
#[derive(Debug)]
pub struct Recorder {
    free: Consumer<Box<TickRecord>>,
    /// `None` once finished; dropping it lets the thread finish.
    full: Option<Producer<Box<TickRecord>>>,
    when_full: WhenFull,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<Option<String>>>,
    /// Holds the log's lock until it is finished, so that nobody replaces it meanwhile; `None` where there are no locks.
    lock: Option<File>,
    path: PathBuf,
}

impl Recorder {
    /// Creates the files, writes their beginning and starts the recorder thread.
    ///
    /// # Errors
    /// [`StartError`] when nothing can be recorded there; the message says what to do.
    pub fn start(config: RecorderConfig) -> Result<Self, StartError> {
        let (file, path) = create_log(&config.place)?;
        let lock = file.try_clone().ok().filter(|file| file.try_lock().is_ok());
        let tlog_path = path.with_extension("tlog");
        let mut started = create_new(&tlog_path).and_then(|tlog| {
            let started = Self::start_on(file, tlog, path.clone(), config);
            if started.is_err() {
                // Made above and empty: no data is lost. A failure to remove leaves an empty file.
                let _ = std::fs::remove_file(&tlog_path);
            }
            started
        });
        match &mut started {
            Ok(recorder) => recorder.lock = lock,
            Err(_) => {
                let _ = std::fs::remove_file(&path);
            }
        }
        started
    }

    fn start_on<W, T>(log_sink: W, tlog_sink: T, path: PathBuf, config: RecorderConfig) -> Result<Self, StartError>
    where
        W: Write + Seek + Send + 'static,
        T: Write + Send + 'static,
    {
        let (slots, when_full, epoch_offset_ns) = (config.slots.max(1), config.when_full, config.epoch_offset_ns);
        let file = LogFile::create(BufWriter::new(log_sink), config);
        let file = file.map_err(|what| StartError::Write(path.clone(), what))?;
        let (mut free_in, free) = RingBuffer::new(slots);
        let (full, full_out) = RingBuffer::new(slots);
        while !free_in.is_full() {
            // The ring has room: that is the loop's condition.
            let _ = free_in.push(Box::default());
        }
        let shared = Arc::new(Shared::default());
        let scribe = Scribe {
            full: full_out,
            free: free_in,
            tlog: Some(BufWriter::new(tlog_sink)),
            file: Some(file),
            shared: Arc::clone(&shared),
            epoch_offset_ns,
            failure: None,
            path: path.clone(),
            pause: match when_full {
                WhenFull::Drop => Duration::from_millis(10),
                WhenFull::Wait => Duration::from_millis(1),
            },
            flushed_at: Instant::now(),
        };
        let thread = std::thread::Builder::new()
            .name("vigil-log".to_owned())
            .spawn(move || scribe.run())
            .map_err(StartError::Thread)?;
        Ok(Self {
            free,
            full: Some(full),
            when_full,
            shared,
            thread: Some(thread),
            lock: None,
            path,
        })
    }

    /// Has `fill` write one step into a free slot and hands it to the recorder thread; see [`TickRecord::fill`]. With
    /// [`WhenFull::Drop`] there is no wait, lock, allocation or system call, and `false` means that no slot was free:
    /// `fill` was not called and the record is counted as dropped.
    pub fn record(&mut self, fill: impl FnOnce(&mut TickRecord)) -> bool {
        let recorded = self.take_slot().is_some_and(|mut slot| {
            fill(&mut slot);
            slot.dropped_before = self.shared.dropped.load(Ordering::Relaxed);
            // There are as many places as slots, so this ring is never full.
            self.full.as_mut().is_some_and(|full| full.push(slot).is_ok())
        });
        if !recorded {
            self.shared.dropped.fetch_add(1, Ordering::Relaxed);
        }
        recorded
    }

    fn take_slot(&mut self) -> Option<Box<TickRecord>> {
        loop {
            match self.free.pop() {
                Ok(slot) => return Some(slot),
                // A recorder thread that ended gives no slot back any more.
                Err(_) if self.when_full == WhenFull::Drop || self.free.is_abandoned() => return None,
                Err(_) => std::thread::sleep(Duration::from_micros(200)),
            }
        }
    }

    /// Records that are in the file for certain: what a killed process leaves.
    pub fn flushed(&self) -> u64 {
        self.shared.flushed.load(Ordering::Relaxed)
    }

    /// Records dropped because no slot was free.
    pub fn dropped(&self) -> u64 {
        self.shared.dropped.load(Ordering::Relaxed)
    }

    /// The log's path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes what is still queued, closes the files and says what came of it. Waits for the disk.
    pub fn finish(mut self) -> Summary {
        let failure = self.close();
        Summary {
            path: self.path.clone(),
            bytes: std::fs::metadata(&self.path).map_or(0, |m| m.len()),
            records: self.shared.written.load(Ordering::Relaxed),
            dropped: self.dropped() + self.shared.lost.load(Ordering::Relaxed),
            failure,
        }
    }

    fn close(&mut self) -> Option<String> {
        // Dropping the producer publishes the count of what was dropped to the thread.
        self.full = None;
        let thread = self.thread.take()?;
        thread.thread().unpark();
        let ended = thread.join();
        // Not left to the closing: a process that is just being started holds the file a little longer.
        let _ = self.lock.take().map(|lock| lock.unlock());
        ended.unwrap_or_else(|_| Some("the recorder thread ended by itself".to_owned()))
    }
}

impl Drop for Recorder {
    /// Closes the log properly on every way out.
    fn drop(&mut self) {
        self.close();
    }
}

fn create_new(path: &Path) -> Result<File, StartError> {
    File::create_new(path).map_err(|source| match source.kind() {
        io::ErrorKind::AlreadyExists => StartError::Exists(path.to_owned()),
        _ => StartError::Create(at(path)(source)),
    })
}

fn create_log(place: &LogPlace) -> Result<(File, PathBuf), StartError> {
    let directory = match place {
        LogPlace::File(path) => return Ok((create_new(path)?, path.clone())),
        LogPlace::Directory(directory) => directory,
    };
    let error = |source| StartError::Directory(at(directory)(source));
    std::fs::create_dir_all(directory).map_err(error)?;
    let mut last = 0_u32;
    for entry in std::fs::read_dir(directory).map_err(error)? {
        let name = entry.map_err(error)?.file_name();
        let of_flight = name.to_str().and_then(|n| n.strip_prefix("flight-")?.split('.').next());
        last = last.max(of_flight.and_then(|number| number.parse().ok()).unwrap_or(0));
    }
    // Another instance may take the same number at the same time; the one that comes second goes on to the next.
    loop {
        last = last.saturating_add(1);
        let path = directory.join(format!("flight-{last:04}.mcap"));
        match create_new(&path) {
            Err(StartError::Exists(_)) if last < u32::MAX => (),
            result => return result.map(|file| (file, path)),
        }
    }
}

/// The recorder thread.
struct Scribe<W: Write + Seek, T: Write> {
    full: Consumer<Box<TickRecord>>,
    free: Producer<Box<TickRecord>>,
    /// `None` after a failure.
    file: Option<LogFile<W>>,
    /// `None` after a failure.
    tlog: Option<BufWriter<T>>,
    shared: Arc<Shared>,
    epoch_offset_ns: u64,
    failure: Option<String>,
    path: PathBuf,
    /// How long to sleep when there is nothing to do. The loop never wakes this thread: waking is a system call.
    pause: Duration,
    flushed_at: Instant,
}

impl<W: Write + Seek, T: Write> Scribe<W, T> {
    /// A quiet loop's records go to the file after this time.
    const IDLE_FLUSH: Duration = Duration::from_secs(1);

    fn run(mut self) -> Option<String> {
        loop {
            // Looked at before the queue: what was pushed before the end is then in the queue.
            let ended = self.full.is_abandoned();
            let mut idle = true;
            while let Ok(slot) = self.full.pop() {
                idle = false;
                self.write(&slot);
                // There are as many places as slots.
                let _ = self.free.push(slot);
            }
            if ended {
                return self.finish();
            }
            if idle {
                self.flush_when_quiet();
                std::thread::park_timeout(self.pause);
            }
        }
    }

    fn write(&mut self, record: &TickRecord) {
        if let Some(to) = &mut self.tlog {
            let at_ns = record.now_ns.saturating_add(self.epoch_offset_ns);
            let result = tlog::write(to, at_ns, &record.received);
            let result = result.and_then(|()| tlog::write(to, at_ns, &record.sent));
            self.check_tlog(result);
        }
        let Some(file) = &mut self.file else {
            self.shared.lost.fetch_add(1, Ordering::Relaxed);
            return;
        };
        match file.write(record) {
            Ok(flushed) => {
                self.shared.written.fetch_add(1, Ordering::Relaxed);
                if flushed {
                    self.note_flush();
                }
            }
            Err(error) => {
                self.shared.lost.fetch_add(1, Ordering::Relaxed);
                self.fail(&error);
            }
        }
    }

    fn flush_when_quiet(&mut self) {
        let behind = self.shared.flushed.load(Ordering::Relaxed) < self.shared.written.load(Ordering::Relaxed);
        if !behind || self.flushed_at.elapsed() < Self::IDLE_FLUSH {
            return;
        }
        if let Some(file) = &mut self.file {
            match file.sheet.writer.flush() {
                Ok(()) => self.note_flush(),
                Err(error) => self.fail(&error),
            }
        }
    }

    fn note_flush(&mut self) {
        let written = self.shared.written.load(Ordering::Relaxed);
        self.shared.flushed.store(written, Ordering::Relaxed);
        self.flushed_at = Instant::now();
        let result = self.tlog.as_mut().map_or(Ok(()), Write::flush);
        self.check_tlog(result);
    }

    fn check_tlog(&mut self, result: io::Result<()>) {
        if let Err(error) = result {
            self.tlog = None;
            self.report(format!(
                "the tlog beside {} cannot be written any more: {error}",
                self.path.display()
            ));
        }
    }

    /// The file is given up: what was not flushed is lost, the flight goes on.
    fn fail(&mut self, error: &McapError) {
        self.file = None;
        let written = self.shared.written.load(Ordering::Relaxed);
        let flushed = self.shared.flushed.load(Ordering::Relaxed);
        self.shared.lost.fetch_add(written - flushed, Ordering::Relaxed);
        self.shared.written.store(flushed, Ordering::Relaxed);
        self.report(format!(
            "log file {} cannot be written any more: {}; at least its first {flushed} records can be read; the flight goes on \
             without a log",
            self.path.display(),
            describe(error)
        ));
    }

    fn report(&mut self, message: String) {
        tracing::error!("{message}");
        self.failure = Some(match self.failure.take() {
            Some(before) => format!("{before}; {message}"),
            None => message,
        });
    }

    fn finish(mut self) -> Option<String> {
        if let Some(file) = self.file.take() {
            let dropped = self.shared.dropped.load(Ordering::Relaxed);
            let written = self.shared.written.load(Ordering::Relaxed);
            match file.finish(written, dropped) {
                Ok(_) => self.note_flush(),
                Err(error) => self.fail(&error),
            }
        }
        self.failure
    }
}

/// An error with its cause: MCAP's own text hides what the system said.
pub(crate) fn describe(error: &McapError) -> String {
    match error {
        McapError::Io(source) => source.to_string(),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests;
