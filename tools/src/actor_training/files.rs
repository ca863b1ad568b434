//! Files that are written beside and renamed, so that a full disk or an interruption leaves the earlier one whole.

use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// A file that could not be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot write {path}: {source}; an earlier {path} is kept as it was")]
pub struct WriteError {
    /// The file.
    pub path: PathBuf,
    /// What the system said.
    pub source: io::Error,
}

/// Replaces a file's content, or leaves it as it was.
///
/// # Errors
/// [`WriteError`] names the file.
pub fn replace(path: &Path, content: &[u8]) -> Result<(), WriteError> {
    let beside = path.with_extension("new");
    let write = || {
        let mut file = File::create(&beside)?;
        file.write_all(content)?;
        file.sync_all()?;
        std::fs::rename(&beside, path)
    };
    write().map_err(|source| {
        // The half-written file would only fill the disk further.
        let _ = std::fs::remove_file(&beside);
        WriteError {
            path: path.to_owned(),
            source,
        }
    })
}
