//! The vehicle's files: a small tree in memory.
//!
//! Never the machine's disk. Any client of the link may read, write and remove what is here, unauthenticated as MAVLink
//! mostly is; in memory, a path can end nowhere else, a client can fill no disk, and every run begins with the same
//! files. What clients store lasts as long as the endpoint.

use std::collections::BTreeMap;
use std::ops::Bound;

/// Bytes that clients may store in all.
pub(crate) const CLIENT_CAPACITY: usize = 4 * 1024 * 1024;
/// Size of one file that a client stores.
pub(crate) const MAX_FILE: usize = 2 * 1024 * 1024;
/// Files and directories that clients may create.
pub(crate) const MAX_CLIENT_ENTRIES: usize = 256;
/// Length of a name: an entry of a listing fits in one FTP packet.
const MAX_NAME: usize = 96;
/// Length of a whole path: what one FTP packet holds.
const MAX_PATH: usize = 239;

/// Why an operation was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(crate) enum FileError {
    #[error("no such file or directory")]
    NotFound,
    #[error("exists already")]
    Exists,
    #[error("read-only")]
    Protected,
    #[error("not a directory")]
    NotADirectory,
    #[error("is a directory")]
    IsADirectory,
    #[error("directory not empty")]
    NotEmpty,
    #[error("no space left")]
    NoSpace,
    #[error("invalid path")]
    BadPath,
}

#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Entry {
    /// A file's bytes; `None` for a directory.
    content: Option<Vec<u8>>,
    /// Unix time.
    pub modified_s: u64,
    /// The vehicle's own: clients may only read it.
    own: bool,
}

impl Entry {
    fn new(content: Option<Vec<u8>>, modified_s: u64, own: bool) -> Self {
        Self {
            content,
            modified_s,
            own,
        }
    }

    /// `None` for a directory.
    pub fn size(&self) -> Option<usize> {
        self.content.as_ref().map(Vec::len)
    }
}

/// The tree. Keys are paths without a leading slash; the root, which is not an entry, is the empty path.
#[derive(Debug, Clone, Default)]
pub(crate) struct FileSystem {
    entries: BTreeMap<String, Entry>,
}

/// A path without empty and `.` parts, `..` resolved within the tree.
fn normalised(path: &str) -> Result<String, FileError> {
    let mut parts: Vec<&str> = Vec::new();
    for part in path.split('/') {
        match part {
            "" | "." => {}
            ".." => {
                parts.pop();
            }
            // A control character would break listings.
            _ if part.len() > MAX_NAME || part.chars().any(char::is_control) => return Err(FileError::BadPath),
            _ => parts.push(part),
        }
    }
    let path = parts.join("/");
    if path.len() > MAX_PATH {
        return Err(FileError::BadPath);
    }
    Ok(path)
}

impl FileSystem {
    /// Puts a file of the vehicle's own in place, with the directories on the way.
    pub fn provide(&mut self, path: &str, content: Vec<u8>, now_s: u64) {
        self.own_directories(path, now_s);
        self.entries
            .insert(path.to_owned(), Entry::new(Some(content), now_s, true));
    }

    /// Puts the directories on the way to a path in place.
    pub fn own_directories(&mut self, path: &str, now_s: u64) {
        for (end, _) in path.match_indices('/') {
            let directory = path.get(..end).unwrap_or_default().to_owned();
            self.entries.entry(directory).or_insert(Entry::new(None, now_s, true));
        }
    }

    /// Appends to a file of the vehicle's own; nothing if it is not there.
    pub fn append_own(&mut self, path: &str, bytes: &[u8], now_s: u64) {
        if let Some(entry) = self.entries.get_mut(path).filter(|e| e.own)
            && let Some(content) = &mut entry.content
        {
            content.extend_from_slice(bytes);
            entry.modified_s = now_s;
        }
    }

    /// Removes a file of the vehicle's own.
    pub fn remove_own(&mut self, path: &str) {
        if self.entries.get(path).is_some_and(|e| e.own) {
            self.entries.remove(path);
        }
    }

    /// What clients stored.
    fn clients(&self) -> impl Iterator<Item = &Entry> {
        self.entries.values().filter(|entry| !entry.own)
    }

    fn entry(&self, path: &str) -> Result<&Entry, FileError> {
        self.entries.get(path).ok_or(FileError::NotFound)
    }

    /// A file's bytes.
    pub fn read(&self, path: &str) -> Result<&[u8], FileError> {
        let entry = self.entry(&normalised(path)?)?;
        entry.content.as_deref().ok_or(FileError::IsADirectory)
    }

    /// What a directory holds, sorted by name.
    pub fn list(&self, path: &str) -> Result<Vec<(&str, &Entry)>, FileError> {
        let path = normalised(path)?;
        if !path.is_empty() && self.entry(&path)?.content.is_some() {
            return Err(FileError::NotADirectory);
        }
        let prefix = if path.is_empty() { path } else { path + "/" };
        let behind = self
            .entries
            .range::<str, _>((Bound::Included(prefix.as_str()), Bound::Unbounded));
        let below = behind.map_while(|(key, entry)| Some((key.strip_prefix(prefix.as_str())?, entry)));
        Ok(below.filter(|(name, _)| !name.contains('/')).collect())
    }

    /// Whether a client may put something at `path`.
    fn check_place(&self, path: &str) -> Result<(), FileError> {
        if path.is_empty() {
            return Err(FileError::Exists);
        }
        let Some((parent, _)) = path.rsplit_once('/') else {
            return Ok(());
        };
        match self.entry(parent)? {
            Entry { content: Some(_), .. } => Err(FileError::NotADirectory),
            Entry { own: true, .. } => Err(FileError::Protected),
            _ => Ok(()),
        }
    }

    fn insert_new(&mut self, path: String, content: Option<Vec<u8>>, now_s: u64) -> Result<(), FileError> {
        self.check_place(&path)?;
        if self.clients().count() >= MAX_CLIENT_ENTRIES {
            return Err(FileError::NoSpace);
        }
        self.entries.insert(path, Entry::new(content, now_s, false));
        Ok(())
    }

    /// Makes sure that there is a file which can be written: creates it, or empties it unless `keep`.
    pub fn open_for_writing(&mut self, path: &str, keep: bool, now_s: u64) -> Result<(), FileError> {
        let path = normalised(path)?;
        if !self.entries.contains_key(&path) {
            return self.insert_new(path, Some(Vec::new()), now_s);
        }
        if keep {
            self.client_file(&path).map(|_| ())
        } else {
            self.truncate(&path, 0, now_s)
        }
    }

    /// The bytes of a client's file, and when they were modified.
    fn client_file(&mut self, path: &str) -> Result<(&mut Vec<u8>, &mut u64), FileError> {
        match self.entries.get_mut(path).ok_or(FileError::NotFound)? {
            Entry { own: true, .. } => Err(FileError::Protected),
            entry => {
                let content = entry.content.as_mut().ok_or(FileError::IsADirectory)?;
                Ok((content, &mut entry.modified_s))
            }
        }
    }

    /// Cuts a client's file, or lengthens it by zeros.
    pub fn truncate(&mut self, path: &str, len: usize, now_s: u64) -> Result<(), FileError> {
        let path = normalised(path)?;
        let stored: usize = self.clients().flat_map(|entry| &entry.content).map(Vec::len).sum();
        let (content, modified_s) = self.client_file(&path)?;
        let others = stored - content.len();
        if len > content.len() && (len > MAX_FILE || others + len > CLIENT_CAPACITY) {
            return Err(FileError::NoSpace);
        }
        content.resize(len, 0);
        *modified_s = now_s;
        Ok(())
    }

    /// Writes at an offset; a gap before it reads as zeros.
    pub fn write(&mut self, path: &str, offset: usize, bytes: &[u8], now_s: u64) -> Result<(), FileError> {
        let path = normalised(path)?;
        let end = offset.checked_add(bytes.len()).ok_or(FileError::NoSpace)?;
        let len = self.read(&path)?.len().max(end);
        self.truncate(&path, len, now_s)?;
        let (content, _) = self.client_file(&path)?;
        content[offset..end].copy_from_slice(bytes);
        Ok(())
    }

    /// Creates a directory.
    pub fn make_directory(&mut self, path: &str, now_s: u64) -> Result<(), FileError> {
        let path = normalised(path)?;
        if path.is_empty() || self.entries.contains_key(&path) {
            return Err(FileError::Exists);
        }
        self.insert_new(path, None, now_s)
    }

    /// Removes a file.
    pub fn remove_file(&mut self, path: &str) -> Result<(), FileError> {
        let path = normalised(path)?;
        self.client_file(&path)?;
        self.entries.remove(&path);
        Ok(())
    }

    /// Removes an empty directory.
    pub fn remove_directory(&mut self, path: &str) -> Result<(), FileError> {
        let path = normalised(path)?;
        if path.is_empty() {
            return Err(FileError::Protected);
        }
        match self.entry(&path)? {
            Entry { own: true, .. } => return Err(FileError::Protected),
            Entry { content: Some(_), .. } => return Err(FileError::NotADirectory),
            _ => {}
        }
        if !self.list(&path)?.is_empty() {
            return Err(FileError::NotEmpty);
        }
        self.entries.remove(&path);
        Ok(())
    }

    /// Renames or moves a file or a directory with all it holds. Nothing is overwritten.
    pub fn rename(&mut self, from: &str, to: &str) -> Result<(), FileError> {
        let (from, to) = (normalised(from)?, normalised(to)?);
        if self.entry(&from)?.own {
            return Err(FileError::Protected);
        }
        if self.entries.contains_key(&to) {
            return Err(FileError::Exists);
        }
        self.check_place(&to)?;
        let inside = format!("{from}/");
        if to.starts_with(&inside) {
            return Err(FileError::BadPath);
        }
        let keys = self.entries.range(from.clone()..).map(|(key, _)| key);
        let beginning_so = keys.take_while(|key| key.starts_with(&from));
        let is_moved = |key: &&String| **key == from || key.starts_with(&inside);
        let moved: Vec<String> = beginning_so.filter(is_moved).cloned().collect();
        let renamed = |key: &str| format!("{to}{}", key.get(from.len()..).unwrap_or_default());
        if moved.iter().any(|key| renamed(key).len() > MAX_PATH) {
            return Err(FileError::BadPath);
        }
        for key in moved {
            if let Some(entry) = self.entries.remove(&key) {
                self.entries.insert(renamed(&key), entry);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(files: &FileSystem, path: &str) -> Vec<String> {
        let listed = files.list(path).expect("a directory").into_iter();
        let name = |(name, entry): (&str, &Entry)| format!("{name}{}", if entry.size().is_none() { "/" } else { "" });
        listed.map(name).collect()
    }

    fn sample() -> FileSystem {
        let mut files = FileSystem::default();
        files.provide("etc/extras/a.json", b"{}".to_vec(), 7);
        files.make_directory("/mine", 8).expect("new");
        files.make_directory("mine/deep", 8).expect("new");
        files.open_for_writing("mine/deep/x", false, 8).expect("new");
        files.write("mine/deep/x", 0, b"hello", 9).expect("room");
        files.open_for_writing("mine-too", false, 8).expect("new");
        files
    }

    #[test]
    fn a_directory_lists_what_it_holds_and_nothing_below() {
        let files = sample();
        assert_eq!(names(&files, "/"), ["etc/", "mine/", "mine-too"]);
        assert_eq!(names(&files, "mine/"), ["deep/"]);
        assert_eq!(names(&files, "./mine/../mine//deep"), ["x"]);
        assert_eq!(names(&files, "/../../.."), names(&files, ""));
        assert_eq!(files.list("nowhere").err(), Some(FileError::NotFound));
        assert_eq!(files.list("mine-too").err(), Some(FileError::NotADirectory));
    }

    #[test]
    fn what_is_the_vehicles_own_can_only_be_read() {
        let mut files = sample();
        assert_eq!(files.read("/etc/extras/a.json"), Ok(&b"{}"[..]));
        let refused = Err(FileError::Protected);
        assert_eq!(files.write("etc/extras/a.json", 0, b"x", 1), refused);
        assert_eq!(files.open_for_writing("etc/extras/a.json", false, 1), refused);
        assert_eq!(files.open_for_writing("etc/extras/b.json", false, 1), refused);
        assert_eq!(files.remove_file("etc/extras/a.json"), refused);
        assert_eq!(files.remove_directory("etc"), refused);
        assert_eq!(files.make_directory("etc/new", 1), refused);
        assert_eq!(files.rename("etc", "other"), refused);
        assert_eq!(files.rename("mine-too", "etc/stolen"), refused);
        assert_eq!(files.read("etc/extras/a.json"), Ok(&b"{}"[..]));
    }

    #[test]
    fn a_directory_moves_with_all_it_holds_and_overwrites_nothing() {
        let mut files = sample();
        assert_eq!(files.rename("mine", "mine/deep/inside"), Err(FileError::BadPath));
        assert_eq!(files.rename("mine", "mine-too"), Err(FileError::Exists));
        files.rename("mine", "yours").expect("free name");
        assert_eq!(names(&files, "/"), ["etc/", "mine-too", "yours/"]);
        assert_eq!(files.read("yours/deep/x"), Ok(&b"hello"[..]));
        assert_eq!(files.remove_directory("yours"), Err(FileError::NotEmpty));
    }

    #[test]
    fn writing_past_the_end_leaves_zeros_and_size_is_bounded() {
        let mut files = sample();
        files.write("mine-too", 3, b"ab", 10).expect("room");
        assert_eq!(files.read("mine-too"), Ok(&b"\0\0\0ab"[..]));
        for offset in [MAX_FILE, usize::MAX, u32::MAX as usize] {
            assert_eq!(files.write("mine-too", offset, b"x", 1), Err(FileError::NoSpace));
        }
        assert_eq!(files.truncate("mine-too", MAX_FILE + 1, 1), Err(FileError::NoSpace));
        assert_eq!(files.read("mine-too").map(<[u8]>::len), Ok(5));
        // Two large files fill the room; removing one makes it again.
        files.truncate("mine-too", MAX_FILE, 1).expect("room");
        files.open_for_writing("second", false, 1).expect("new");
        assert_eq!(files.truncate("second", MAX_FILE, 1), Err(FileError::NoSpace));
        files.remove_file("mine-too").expect("mine");
        files.truncate("second", MAX_FILE, 1).expect("room again");
    }

    #[test]
    fn entries_and_names_are_bounded() {
        let mut files = FileSystem::default();
        let made = (0..1000)
            .filter(|i| files.make_directory(&format!("d{i}"), 0).is_ok())
            .count();
        assert_eq!(made, MAX_CLIENT_ENTRIES);
        files.remove_directory("d0").expect("empty");
        for bad in ["a\tb", "a\nb", &"n".repeat(97), &"n/".repeat(200)] {
            assert!(files.make_directory(bad, 0).is_err(), "{bad}");
        }
        files.make_directory("fine", 0).expect("one is free");
    }
}
