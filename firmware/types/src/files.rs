//! Files that are replaced whole or not at all, and read within a limit.
//!
//! Every file that Vigil writes at once goes through [`replace`], and every file that it reads at once through [`read`]:
//! a full disk, a kill or a power cut leaves the earlier content or the new one, and a file of 10 GB, `/dev/zero` or a
//! FIFO in the place of a configuration is an error that says so.
//!
//! ```
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("course.toml");
//! vigil_types::files::replace(&path, b"name = 'two columns'", vigil_types::files::Access::Shared)?;
//! assert_eq!(vigil_types::files::read_text(&path, 1 << 20)?, "name = 'two columns'");
//! assert!(vigil_types::files::read(&path, 10).is_err(), "longer than 10 bytes");
//! # Ok::<(), std::io::Error>(())
//! ```

use std::borrow::ToOwned;
use std::ffi::OsString;
use std::fs::{File, Metadata, OpenOptions, Permissions};
use std::io::{self, ErrorKind, Read, Write};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::string::String;
use std::vec::Vec;

/// A file that cannot be opened, read or written: its name, and what the system said.
#[derive(Debug, thiserror::Error)]
#[error("{}: {source}", path.display())]
pub struct FileError {
    /// The file or folder.
    pub path: PathBuf,
    /// What the system said.
    pub source: io::Error,
}

/// Names the file in what the system said of it.
pub fn at(path: &Path) -> impl Fn(io::Error) -> FileError + Copy + '_ {
    |source| FileError {
        path: path.to_owned(),
        source,
    }
}

/// Who may read a file that is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Access {
    /// Its user alone: mode 0600, whatever the file had before. For keys and the state of signing.
    Private,
    /// Whoever could read it before; whom the process's umask allows if it is new.
    Shared,
}

/// Replaces a file's content, or leaves the file as it was: writes a new file beside it, waits until that is on the disk,
/// renames it into place, and waits until the name is on the disk too. A symbolic link is followed. What is no regular
/// file (`/dev/stdout`, a FIFO) cannot be replaced and is written to.
///
/// # Errors
/// What the system said; nothing is left beside the file then.
pub fn replace(path: &Path, content: &[u8], access: Access) -> io::Result<()> {
    replace_with(path, access, |file| file.write_all(content))
}

/// As [`replace`], for content that is written piece by piece. Where `write` fails the file is as it was.
///
/// # Errors
/// What `write` said, or the system.
pub fn replace_with(path: &Path, access: Access, write: impl FnOnce(&mut File) -> io::Result<()>) -> io::Result<()> {
    let before = match std::fs::metadata(path) {
        Ok(metadata) if metadata.is_dir() => return Err(ErrorKind::IsADirectory.into()),
        Ok(metadata) if !metadata.is_file() || is_of_process(path) => {
            return write(&mut File::options().append(true).open(path)?);
        }
        Ok(metadata) => Some(metadata),
        Err(error) if error.kind() == ErrorKind::NotFound => None,
        Err(error) => return Err(error),
    };
    let path = match &before {
        Some(_) => std::fs::canonicalize(path)?,
        // A link may name a file that is not there yet.
        None => {
            let mut path = path.to_owned();
            while let Ok(named) = std::fs::read_link(&path) {
                path = path.parent().unwrap_or(Path::new("")).join(named);
            }
            path
        }
    };
    let (folder, name) = place(&path)?;
    let mut prefix = OsString::from(".");
    prefix.push(name);
    prefix.push(".");
    let mode = match access {
        Access::Private => 0o600,
        Access::Shared => 0o666,
    };
    let mut beside = tempfile::Builder::new()
        .prefix(&prefix)
        .suffix(".new")
        .permissions(Permissions::from_mode(mode))
        .tempfile_in(folder)?;
    if let (Some(before), Access::Shared) = (before, access) {
        beside.as_file().set_permissions(before.permissions())?;
    }
    write(beside.as_file_mut())?;
    // Before the rename: after a power cut the name must not be on the disk without what it names.
    beside.as_file().sync_all()?;
    beside.persist(&path)?;
    sync_folder(folder)
}

/// Whether it is a file that this process was started with: others write to it as well, and what they wrote stays.
fn is_of_process(path: &Path) -> bool {
    ["/dev/stdout", "/dev/stderr", "/dev/fd", "/proc/self/fd"]
        .iter()
        .any(|own| path.starts_with(own))
}

/// Waits until the names in a folder are on the disk.
///
/// # Errors
/// What the system said.
pub fn sync_folder(folder: &Path) -> io::Result<()> {
    match File::open(folder)?.sync_all() {
        // Some network file systems have no such request for folders.
        Err(error) if matches!(error.kind(), ErrorKind::InvalidInput | ErrorKind::Unsupported) => Ok(()),
        result => result,
    }
}

/// The folder that a file is in; `.` where its path names none.
pub fn folder_of(path: &Path) -> &Path {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    folder.unwrap_or(Path::new("."))
}

fn place(path: &Path) -> io::Result<(&Path, &std::ffi::OsStr)> {
    let name = path
        .file_name()
        .ok_or_else(|| io::Error::new(ErrorKind::InvalidInput, "it has no file name"))?;
    Ok((folder_of(path), name))
}

/// Opens a regular file for reading. Never waits for the other end of a FIFO, and never reads a device.
///
/// # Errors
/// What the system said, or what the file is instead.
pub fn open(path: &Path) -> io::Result<File> {
    // Looked at before as well: opening alone makes some devices do something.
    regular(&std::fs::metadata(path)?)?;
    let flags = rustix::fs::OFlags::NONBLOCK | rustix::fs::OFlags::NOCTTY;
    // The bits are the same, the types differ in their sign.
    let file = OpenOptions::new()
        .read(true)
        .custom_flags(flags.bits() as i32)
        .open(path)?;
    regular(&file.metadata()?)?;
    Ok(file)
}

fn regular(metadata: &Metadata) -> io::Result<()> {
    let kind = metadata.file_type();
    let what = if kind.is_file() {
        return Ok(());
    } else if kind.is_dir() {
        "a folder"
    } else if kind.is_fifo() {
        "a FIFO"
    } else if kind.is_socket() {
        "a socket"
    } else {
        "a device"
    };
    let message = format!("it is {what}, not a regular file");
    Err(io::Error::new(ErrorKind::InvalidInput, message))
}

/// Reads a regular file of at most `limit` bytes.
///
/// # Errors
/// What the system said, what the file is instead, or its size and the limit.
pub fn read(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    read_from(&mut open(path)?, limit)
}

/// Reads what an open file holds, at most `limit` bytes.
///
/// # Errors
/// What the system said, or the file's size and the limit.
pub fn read_from(file: &mut File, limit: u64) -> io::Result<Vec<u8>> {
    let size = file.metadata()?.len();
    if size > limit {
        return Err(too_large(size, limit));
    }
    let mut bytes = Vec::with_capacity(size as usize);
    // One byte more, for a file that grows while it is read.
    file.take(limit.saturating_add(1)).read_to_end(&mut bytes)?;
    match bytes.len() as u64 > limit {
        true => Err(too_large(bytes.len() as u64, limit)),
        false => Ok(bytes),
    }
}

/// Reads a regular file of at most `limit` bytes of UTF-8.
///
/// # Errors
/// As [`read`], and for text that is not UTF-8 the place of the first byte that is not.
pub fn read_text(path: &Path, limit: u64) -> io::Result<String> {
    String::from_utf8(read(path, limit)?).map_err(|error| {
        let valid = error.utf8_error().valid_up_to();
        let before = error.as_bytes().iter().take(valid);
        let line = 1 + before.filter(|byte| **byte == b'\n').count();
        io::Error::new(ErrorKind::InvalidData, format!("line {line} is not UTF-8 text"))
    })
}

fn too_large(size: u64, limit: u64) -> io::Error {
    let message = format!("it holds {}, the limit is {}", in_words(size), in_words(limit));
    io::Error::new(ErrorKind::FileTooLarge, message)
}

/// A number of bytes as people say it.
fn in_words(bytes: u64) -> String {
    const UNITS: [(u64, &str); 3] = [(1 << 30, "GiB"), (1 << 20, "MiB"), (1 << 10, "KiB")];
    match UNITS.into_iter().find(|(unit, _)| bytes >= *unit) {
        Some((unit, name)) if bytes.is_multiple_of(unit) => format!("{} {name}", bytes / unit),
        Some((unit, name)) => format!("{:.1} {name}", bytes as f64 / unit as f64),
        None => format!("{bytes} bytes"),
    }
}

/// Whether standard output was refused because nobody reads it any more (`… | head`, a terminal that hung up): no fault.
pub fn reader_has_gone(error: &io::Error) -> bool {
    let is_file =
        || rustix::fs::fstat(io::stdout()).is_ok_and(|s| rustix::fs::FileType::from_raw_mode(s.st_mode).is_file());
    let hung_up = error.raw_os_error() == Some(rustix::io::Errno::IO.raw_os_error());
    error.kind() == ErrorKind::BrokenPipe || hung_up && !is_file()
}

/// Writes a line to standard output at once. A reader that has gone is no fault.
///
/// # Errors
/// What the system said, a full disk for example.
pub fn print_line(text: &str) -> io::Result<()> {
    let mut out = io::stdout().lock();
    match writeln!(out, "{text}").and_then(|()| out.flush()) {
        Err(error) if !reader_has_gone(&error) => {
            let message = format!("cannot write standard output: {error}");
            Err(io::Error::new(error.kind(), message))
        }
        _ => Ok(()),
    }
}

/// Makes a new folder `parent/name`, or `parent/name-2`, `-3`, … if there is one of that name; `parent` is made as well.
///
/// # Errors
/// What the system said.
pub fn make_new_folder(parent: &Path, name: &str) -> io::Result<PathBuf> {
    std::fs::create_dir_all(parent)?;
    let mut folder = parent.join(name);
    for number in 2.. {
        match std::fs::create_dir(&folder) {
            Err(error) if error.kind() == ErrorKind::AlreadyExists => folder = parent.join(format!("{name}-{number}")),
            result => return result.map(|()| folder),
        }
    }
    Err(ErrorKind::AlreadyExists.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::MetadataExt;
    use std::string::ToString;

    fn names(folder: &Path) -> Vec<OsString> {
        let mut names: Vec<_> = std::fs::read_dir(folder)
            .unwrap()
            .map(|e| e.unwrap().file_name())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_is_replaced_by_another_one_and_keeps_who_may_read_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("state.toml");
        replace(&path, b"first", Access::Shared).unwrap();
        std::fs::set_permissions(&path, Permissions::from_mode(0o640)).unwrap();
        let before = std::fs::metadata(&path).unwrap().ino();
        replace(&path, b"second", Access::Shared).unwrap();
        let after = std::fs::metadata(&path).unwrap();
        assert_ne!(after.ino(), before, "a new file, not the old one written over");
        assert_eq!(after.permissions().mode() & 0o777, 0o640);
        replace(&path, b"secret", Access::Private).unwrap();
        assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
        assert_eq!(read(&path, 100).unwrap(), b"secret");
        assert_eq!(names(folder.path()), ["state.toml"], "nothing is left beside it");
    }

    #[test]
    fn what_others_wrote_to_a_file_that_the_process_was_started_with_stays() {
        use std::os::fd::AsRawFd;
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(b"earlier, ").unwrap();
        let own = std::format!("/proc/self/fd/{}", file.as_file().as_raw_fd());
        replace(Path::new(&own), b"then ours", Access::Shared).unwrap();
        assert_eq!(read(file.path(), 100).unwrap(), b"earlier, then ours");
    }

    #[test]
    fn what_cannot_be_replaced_is_kept_and_nothing_is_left_beside_it() {
        let folder = tempfile::tempdir().unwrap();
        let inner = folder.path().join("folder");
        std::fs::create_dir(&inner).unwrap();
        assert_eq!(
            replace(&inner, b"x", Access::Shared).unwrap_err().kind(),
            ErrorKind::IsADirectory
        );
        assert!(replace(&folder.path().join("no/such/file"), b"x", Access::Shared).is_err());
        assert_eq!(names(folder.path()), ["folder"]);
        let full = replace(Path::new("/dev/full"), b"x", Access::Shared).unwrap_err();
        assert_eq!(full.kind(), ErrorKind::StorageFull);
        assert!(std::fs::metadata("/dev/full").unwrap().file_type().is_char_device());
    }

    #[test]
    fn behind_a_link_the_file_that_it_names_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("file"), folder.path().join("link"));
        std::fs::write(&file, "old").unwrap();
        std::os::unix::fs::symlink("file", &link).unwrap();
        for content in ["new", "where none was"] {
            replace(&link, content.as_bytes(), Access::Shared).unwrap();
            assert!(std::fs::symlink_metadata(&link).unwrap().is_symlink());
            assert_eq!(std::fs::read_to_string(&file).unwrap(), content);
            std::fs::remove_file(&file).unwrap();
        }
        std::fs::remove_file(&link).unwrap();
        std::os::unix::fs::symlink("no/file", &link).unwrap();
        assert!(replace(&link, b"x", Access::Shared).is_err() && names(folder.path()) == ["link"]);
    }

    #[test]
    fn what_is_too_large_endless_or_no_file_is_refused_at_once_and_named_for_what_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let refusal = |path: &Path| read(path, 1 << 20).unwrap_err().to_string();
        let huge = folder.path().join("huge");
        File::create(&huge).unwrap().set_len(10 << 30).unwrap();
        assert_eq!(refusal(&huge), "it holds 10 GiB, the limit is 1 MiB");
        assert_eq!(refusal(Path::new("/dev/zero")), "it is a device, not a regular file");
        assert_eq!(refusal(folder.path()), "it is a folder, not a regular file");
        let fifo = folder.path().join("fifo");
        let mode = rustix::fs::Mode::from_raw_mode(0o600);
        rustix::fs::mknodat(rustix::fs::CWD, &fifo, rustix::fs::FileType::Fifo, mode, 0).unwrap();
        assert_eq!(refusal(&fifo), "it is a FIFO, not a regular file");
        let text = folder.path().join("text");
        std::fs::write(&text, b"one\ntwo \xFF\n").unwrap();
        let error = read_text(&text, 100).unwrap_err().to_string();
        assert_eq!(error, "line 2 is not UTF-8 text");
        assert_eq!(read(&text, 10).unwrap().len(), 10);
        assert!(read(&text, 9).is_err());
    }

    #[test]
    fn two_of_one_name_get_folders_of_their_own() {
        let folder = tempfile::tempdir().unwrap();
        let parent = folder.path().join("runs");
        let made = [(); 3].map(|()| make_new_folder(&parent, "fly-1-7").unwrap());
        assert_eq!(
            made,
            ["fly-1-7", "fly-1-7-2", "fly-1-7-3"].map(|name| parent.join(name))
        );
    }
}
