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

/// A folder in which no run can begin.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    /// It cannot be made.
    #[error("cannot make {path}: {source}")]
    Make {
        /// The folder.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// There is a run in it already.
    #[error("{path} holds a run already; resume it, or train in another folder")]
    Occupied {
        /// The folder.
        path: PathBuf,
    },
}

/// Makes a run's folder; gives the path of its checkpoint. Only a run that is resumed finds one there.
///
/// # Errors
/// [`FolderError`]: a folder that cannot be made, or that holds another run.
pub fn begin_run(folder: &Path, resume: bool) -> Result<PathBuf, FolderError> {
    std::fs::create_dir_all(folder).map_err(|source| FolderError::Make {
        path: folder.to_owned(),
        source,
    })?;
    let checkpoint = folder.join("checkpoint.safetensors");
    if !resume && checkpoint.exists() {
        return Err(FolderError::Occupied {
            path: folder.to_owned(),
        });
    }
    Ok(checkpoint)
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
