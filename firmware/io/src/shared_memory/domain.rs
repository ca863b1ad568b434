//! Who can meet whom: the instance number and the user separate whole sets of processes.

use iceoryx2::prelude::*;
use rustix::fs::{FlockOperation, Mode, OFlags};
use rustix::io::Errno;
use std::os::fd::OwnedFd;
use std::os::unix::fs::{DirBuilderExt, MetadataExt};

/// Why a [`Domain`] could not be opened, with what to do.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct DomainError(String);

/// The directory for the transport's files, or a file in it, could not be made.
fn not_made(path: &str, error: std::io::Error) -> DomainError {
    DomainError(format!("cannot make {path} for the transport's files: {error}"))
}

/// A process's membership in one instance. Instances share nothing: other directory, other shared-memory names.
///
/// Files lie in `vigil-<uid>/<instance>` of the system's shared-memory directory, which has mode 0700, and beside it
/// with mode 0600: only processes of the same user meet. At opening, what killed processes of this instance left is
/// removed.
#[derive(Debug)]
pub struct Domain {
    node: Node<ipc::Service>,
    instance: u32,
    /// Locked while the role is this process's alone.
    _role: Option<OwnedFd>,
}

impl Domain {
    /// Joins `instance`; `role` ("firmware", "simulator", …) names this process in the transport's own records.
    ///
    /// # Errors
    /// [`DomainError`], each telling what to do.
    pub fn open(instance: u32, role: &str) -> Result<Self, DomainError> {
        // iceoryx2 reports every refusal on the console as well; the errors here say it once. IOX2_LOG_LEVEL overrides.
        set_log_level_from_env_or(LogLevel::Fatal);
        let (config, shown) = instance_config(instance)?;
        let node_error = |reason: String| {
            let files = format!("{shown}/{instance} and {SHARED_MEMORY}/{}*", config.global.prefix);
            DomainError(format!(
                "cannot join instance {instance} as `{role}`: {reason}; the transport's files are {files}"
            ))
        };
        has_room(LEAST_ROOM)?;
        let name = NodeName::new(role).map_err(|e| node_error(format!("{e:?}")))?;
        let create = || {
            NodeBuilder::new()
                .name(&name)
                .config(&config)
                // Signals belong to the program.
                .signal_handling_mode(SignalHandlingMode::Disabled)
                .create::<ipc::Service>()
        };
        let node = create()
            // What a process left that ended while it joined keeps everybody out.
            .or_else(|refused| match remove_leftovers(instance) {
                Ok(true) => create(),
                _ => Err(refused),
            })
            .map_err(|e| node_error(e.to_string()))?;
        Ok(Self {
            node,
            instance,
            _role: None,
        })
    }

    /// The same for a role that one process at a time has, until this is dropped or the process ends, however it does.
    ///
    /// # Errors
    /// [`DomainError`], also while another has it.
    pub fn open_alone(instance: u32, role: &str) -> Result<Self, DomainError> {
        let domain = Self::open(instance, role)?;
        let path = format!("{}/{role}.lock", domain.node.config().global.root_path());
        let flags = OFlags::CREATE | OFlags::RDWR | OFlags::NOFOLLOW | OFlags::CLOEXEC;
        let locked = rustix::fs::open(&*path, flags, Mode::RUSR | Mode::WUSR)
            .and_then(|file| rustix::fs::flock(&file, FlockOperation::NonBlockingLockExclusive).map(|()| file));
        match locked {
            Ok(file) => Ok(Self {
                _role: Some(file),
                ..domain
            }),
            Err(Errno::WOULDBLOCK) => Err(DomainError(format!(
                "another {role} already runs on instance {instance}: stop it, or use another --instance"
            ))),
            Err(e) => Err(not_made(&path, e.into())),
        }
    }

    /// The instance number.
    pub fn instance(&self) -> u32 {
        self.instance
    }

    pub(crate) fn node(&self) -> &Node<ipc::Service> {
        &self.node
    }
}

/// Removes the files of an instance in which no process runs any more, for one-off instances such as those of tests.
/// Returns whether nothing is left; `false` means that a process still runs there, or may, and nothing was touched.
///
/// # Errors
/// [`DomainError`] when the directory cannot be used.
pub fn remove_leftovers(instance: u32) -> Result<bool, DomainError> {
    let (config, shown) = instance_config(instance)?;
    let mut alive = false;
    let listed = Node::<ipc::Service>::list(&config, |state| {
        alive |= matches!(state, NodeState::Alive(_) | NodeState::Inaccessible(_));
        CallbackProgression::Continue
    });
    if alive || listed.is_err() {
        return Ok(false);
    }
    let _ = std::fs::remove_dir_all(format!("{shown}/{instance}"));
    let prefix = config.global.prefix.to_string();
    for entry in std::fs::read_dir(SHARED_MEMORY).into_iter().flatten().flatten() {
        if entry.file_name().to_string_lossy().starts_with(&prefix) {
            let _ = std::fs::remove_file(entry.path());
        }
    }
    Ok(true)
}

/// Where Linux keeps POSIX shared memory.
const SHARED_MEMORY: &str = "/dev/shm";
/// What must be free there: joining and reading take a few KiB.
const LEAST_ROOM: u64 = 1 << 20;
/// The same for who publishes frames: 3.5 MiB.
pub(super) const PUBLISHERS_ROOM: u64 = 4 << 20;

pub(super) fn has_room(needed: u64) -> Result<(), DomainError> {
    // Where nothing limits it, it has no blocks.
    let room = rustix::fs::statvfs(SHARED_MEMORY).ok().filter(|room| room.f_blocks > 0);
    match room.map(|room| room.f_bavail.saturating_mul(room.f_frsize)) {
        // Whoever touches more than there is ends without a word (SIGBUS).
        Some(free) if free < needed => Err(DomainError(format!(
            "no room in {SHARED_MEMORY}: {} KiB are free, {} are needed: free some",
            free >> 10,
            needed >> 10
        ))),
        _ => Ok(()),
    }
}

/// iceoryx2's configuration that keeps an instance apart, and the directory it lies in.
fn instance_config(instance: u32) -> Result<(Config, String), DomainError> {
    let uid = rustix::process::getuid().as_raw();
    let directory = format!("{SHARED_MEMORY}/vigil-{uid}");
    make_private(std::path::Path::new(&directory), uid)?;
    let path_error =
        |e: SemanticStringError| DomainError(format!("{directory} cannot hold the transport's files: {e:?}"));
    let mut config = Config::default();
    let root = Path::new(format!("{directory}/{instance}").as_bytes()).map_err(path_error)?;
    config.global.set_root_path(&root);
    config.global.prefix = FileName::new(format!("vigil{uid}_{instance}_").as_bytes()).map_err(path_error)?;
    Ok((config, directory))
}

/// Makes the user's own directory if it is missing, and refuses one that anybody else could tamper with.
fn make_private(directory: &std::path::Path, uid: u32) -> Result<(), DomainError> {
    let shown = directory.display().to_string();
    let io_error = |error| not_made(&shown, error);
    match std::fs::DirBuilder::new().mode(0o700).create(directory) {
        Ok(()) => {}
        Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => {}
        Err(e) => return Err(io_error(e)),
    }
    // Not following a link: it could be swapped for another directory later.
    let metadata = std::fs::symlink_metadata(directory).map_err(io_error)?;
    let mode = metadata.mode() & 0o7777;
    let owner = metadata.uid();
    if !metadata.is_dir() || owner != uid || mode & 0o077 != 0 {
        return Err(DomainError(format!(
            "{shown} must belong to user {uid} with mode 0700 but belongs to user {owner} with mode {mode:04o}: remove \
             it or fix its owner and mode, then start again"
        )));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::{PermissionsExt, symlink};

    #[test]
    fn a_directory_that_others_could_tamper_with_is_refused() {
        let uid = rustix::process::getuid().as_raw();
        let parent = tempfile::tempdir().unwrap();
        let directory = parent.path().join("vigil");
        make_private(&directory, uid).unwrap();
        make_private(&directory, uid).unwrap();
        let mode = std::fs::metadata(&directory).unwrap().mode() & 0o777;
        assert_eq!(mode, 0o700);

        let refused = |directory, uid, why| {
            let text = make_private(directory, uid).unwrap_err().to_string();
            assert!(
                text.contains("with mode 0700 but belongs") && text.contains(why),
                "{text}"
            );
        };
        refused(&directory, uid + 1, "mode 0700: remove");
        std::fs::set_permissions(&directory, std::fs::Permissions::from_mode(0o770)).unwrap();
        refused(&directory, uid, "mode 0770: remove");

        let link = parent.path().join("link");
        let target = parent.path().join("target");
        make_private(&target, uid).unwrap();
        symlink(&target, &link).unwrap();
        refused(&link, uid, "mode 0777: remove");
    }
}
