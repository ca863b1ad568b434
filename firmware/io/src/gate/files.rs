//! The files of signing: the key, and what replay protection needs over restarts.

use crate::background::Background;
use crate::key_file::{KeyFileError, read_secret};
use std::path::{Path, PathBuf};
use std::time::Duration;
use vigil_mavlink::signing::{LAST_TIMESTAMP, SigningKey, SigningMemory, StreamTime, Timestamp};
use vigil_types::files::{Access, FileError, at};

/// A line for each stream, of which there are a few dozen at most.
const STATE_SIZE_LIMIT: u64 = 64 << 10;
/// States that may wait to be written; the newest is offered again a second later.
const CAPACITY: usize = 8;
/// Places that states leave free: a new key must get through a slow disk as well.
const KEY_SLOTS: usize = 2;
/// How often the writer looks.
const PAUSE: Duration = Duration::from_millis(100);

/// Why signing cannot be switched on.
#[derive(Debug, thiserror::Error)]
pub enum SigningFileError {
    /// The key cannot be used.
    #[error(transparent)]
    Key(#[from] KeyFileError),
    /// The state cannot be read or written.
    #[error(
        "signing state {0}; without it packets could be replayed after a restart: the key's folder must be writable by this user"
    )]
    State(#[from] FileError),
    /// The state is not what was written in this line, from 1.
    #[error(
        "signing state {0}, line {1}, is damaged: delete the file, and make sure that no packets signed before are replayed"
    )]
    Damaged(PathBuf, usize),
}

/// Reads the key of signing, see [`read_secret`].
///
/// # Errors
/// [`KeyFileError`].
pub fn read_key(path: &Path) -> Result<SigningKey, KeyFileError> {
    read_secret(path, "signing key").map(SigningKey)
}

/// What is to be written.
enum Job {
    State(SigningMemory),
    /// Another key, and the state that begins with it.
    Key(SigningKey, SigningMemory),
}

/// Writes states and keys to their files, from a thread of its own: the loop must not wait for a disk.
pub(super) struct SigningStateWriter(Background<Job>);

impl SigningStateWriter {
    /// Reads what the last run left and makes sure that it can be written again, `ahead` of what was read, but no further than that ahead of
    /// `now`. Returns what was read, and what is stored now.
    pub fn start(
        key_file: &Path,
        name: &str,
        (now, ahead): (Timestamp, u64),
    ) -> Result<(Self, SigningMemory, SigningMemory), SigningFileError> {
        let mut path = key_file.as_os_str().to_owned();
        path.push(format!(".{name}.state"));
        let path = PathBuf::from(path);
        let memory = read_state(&path)?;
        let stored = memory.clone().ahead(&memory, now, ahead);
        write_state(&path, &stored).map_err(at(&path))?;
        let (key_file, target) = (key_file.to_owned(), path.clone());
        let mut failing = false;
        let writer = Background::start("signing", CAPACITY, PAUSE, move |jobs| {
            let mut newest = None;
            for job in jobs {
                newest = Some(match job {
                    Job::State(state) => state,
                    Job::Key(key, state) => {
                        if let Err(e) = write_key(&key_file, &key) {
                            let file = key_file.display();
                            tracing::warn!("signing key {file}: {e}; after a restart the old key is in force");
                        }
                        state
                    }
                });
            }
            let Some(newest) = newest else { return };
            let result = write_state(&target, &newest);
            if let Err(e) = &result
                && !failing
            {
                let file = target.display();
                tracing::warn!("signing state {file}: {e}; packets could be replayed after a restart");
            }
            failing = result.is_err();
        });
        Ok((Self(writer.map_err(at(&path))?), memory, stored))
    }

    /// Has a state written. Never waits; when too many wait, the ones offered later do.
    pub fn offer(&mut self, memory: SigningMemory) {
        if self.0.room() > KEY_SLOTS {
            // A state that is not written leaves an older one, which lies ahead of it.
            self.0.offer(Job::State(memory));
        }
    }

    /// Has the key replaced in its file, and the state that begins with it written. Never waits.
    pub fn replace_key(&mut self, key: SigningKey, memory: SigningMemory) {
        if !self.0.offer(Job::Key(key, memory)) {
            tracing::warn!("the new signing key could not be stored; after a restart the old one is in force");
        }
    }
}

/// One line with the newest timestamp, then one for each stream: link id, system, component, timestamp.
fn write_state(path: &Path, memory: &SigningMemory) -> std::io::Result<()> {
    let mut text = format!("{}\n", memory.newest);
    for s in &memory.streams {
        text += &format!("{} {} {} {}\n", s.link_id, s.system_id, s.component_id, s.timestamp);
    }
    vigil_types::files::replace(path, text.as_bytes(), Access::Private)
}

/// 64 hexadecimal digits, for nobody else to read.
fn write_key(path: &Path, key: &SigningKey) -> std::io::Result<()> {
    let digits: String = key.0.iter().map(|byte| format!("{byte:02x}")).collect();
    vigil_types::files::replace(path, digits.as_bytes(), Access::Private)
}

fn read_state(path: &Path) -> Result<SigningMemory, SigningFileError> {
    let text = match vigil_types::files::read_text(path, STATE_SIZE_LIMIT) {
        Ok(text) => text,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(SigningMemory::default()),
        Err(error) => return Err(at(path)(error).into()),
    };
    let mut memory = SigningMemory::default();
    let damaged = |line: usize| SigningFileError::Damaged(path.to_owned(), line);
    let mut lines = text.lines();
    memory.newest = lines.next().and_then(timestamp_of).ok_or_else(|| damaged(1))?;
    for (i, line) in lines.enumerate() {
        let stream = stream_of(line).ok_or_else(|| damaged(i + 2))?;
        memory.streams.push(stream).map_err(|_| damaged(i + 2))?;
    }
    Ok(memory)
}

fn timestamp_of(text: &str) -> Option<Timestamp> {
    text.parse().ok().filter(|timestamp| *timestamp <= LAST_TIMESTAMP)
}

fn stream_of(line: &str) -> Option<StreamTime> {
    let mut fields = line.split(' ');
    let stream = StreamTime {
        link_id: fields.next()?.parse().ok()?,
        system_id: fields.next()?.parse().ok()?,
        component_id: fields.next()?.parse().ok()?,
        timestamp: timestamp_of(fields.next()?)?,
    };
    fields.next().is_none().then_some(stream)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    fn memory() -> SigningMemory {
        let stream = |component_id: u8| StreamTime {
            link_id: 3,
            system_id: 255,
            component_id,
            timestamp: 100_000 + u64::from(component_id),
        };
        SigningMemory {
            newest: 123_456,
            streams: [1, 190].into_iter().map(stream).collect(),
        }
    }

    #[test]
    fn the_last_state_offered_is_read_by_the_next_run_and_a_killed_run_leaves_one_ahead() {
        let folder = tempfile::tempdir().unwrap();
        let key = folder.path().join("vigil.key");
        let start = |now| SigningStateWriter::start(&key, "3", (now, 50)).unwrap();
        let (mut writer, first, _) = start(200_000);
        assert_eq!(first, SigningMemory::default());
        let later = |units| memory().ahead(&first, 200_000, units);
        writer.offer(later(7));
        writer.offer(memory());
        drop(writer);
        let (_killed, second, stored) = start(200_000);
        assert_eq!((second, stored), (memory(), later(50)));
        // While that one runs, the file is ahead of what it knows; and no further ahead of the clock, however often it is killed.
        for _ in 0..3 {
            assert_eq!(start(100_000).1, later(50));
        }
        let state = folder.path().join("vigil.key.3.state");
        assert_eq!(std::fs::metadata(state).unwrap().permissions().mode() & 0o777, 0o600);
    }

    #[test]
    fn a_damaged_state_and_one_that_cannot_be_kept_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let key = folder.path().join("vigil.key");
        for (text, line) in [
            ("", "line 1"),
            ("18446744073709551615", "line 1"),
            ("5\n1 2 3", "line 2"),
            ("5\n1 2 3 4\n1 2 3 4 5\n", "line 3"),
        ] {
            std::fs::write(folder.path().join("vigil.key.0.state"), text).unwrap();
            let error = SigningStateWriter::start(&key, "0", (0, 0)).err().unwrap().to_string();
            assert!(error.contains(line) && error.contains("delete"), "{error}");
        }
        let error = SigningStateWriter::start(&folder.path().join("no/such.key"), "0", (0, 0))
            .err()
            .unwrap()
            .to_string();
        assert!(error.contains("replayed"), "{error}");
    }
}
