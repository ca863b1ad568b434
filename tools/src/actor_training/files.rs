//! Files of a run: a full disk or an interruption leaves the earlier one whole.

use std::io;
use std::path::{Path, PathBuf};
use vigil_files::Access;

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
    vigil_files::replace(path, content, Access::Shared).map_err(|source| WriteError {
        path: path.to_owned(),
        source,
    })
}
