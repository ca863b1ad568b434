//! Who can meet whom: the instance number and the user separate whole sets of processes.

use iceoryx2::prelude::*;
use rustix::fs::{FlockOperation, Mode, OFlags};
use rustix::io::Errno;
use std::os::fd::OwnedFd;
use std::os::unix::fs::{DirBuilderExt, MetadataExt};

/// Why a [`Domain`] could not be opened.
#[allow(missing_docs, reason = "the texts say what the fields are")]
#[derive(Debug, thiserror::Error)]
pub enum DomainError {
    /// The role is taken.
    #[error("another {role} already runs on instance {instance}: stop it, or use another --instance")]
    RoleTaken { role: &'static str, instance: u32 },
    /// The directory for the transport's files, or a file in it, could not be made.
    #[error("cannot make {path} for the transport's files: {source}")]
    Directory { path: String, source: std::io::Error },
    /// The directory is somebody else's, or others may write to it.
    #[error(
        "{path} must belong to user {uid} with mode 0700 but belongs to user {owner} with mode {mode:04o}: remove it or \
         fix its owner and mode, then start again"
    )]
    NotPrivate {
        path: String,
        uid: u32,
        owner: u32,
        mode: u32,
    },
    /// Too little memory is left: whoever touches more than there is ends without a word (SIGBUS).
    #[error("no room in {SHARED_MEMORY}: {free_kib} KiB are free, {needed_kib} are needed: free some")]
    NoRoom { free_kib: u64, needed_kib: u64 },
    /// The path does not suit the transport.
    #[error("{path} cannot hold the transport's files: {reason}")]
    Path { path: String, reason: String },
    /// iceoryx2 refused.
    #[error("cannot join instance {instance} as `{role}`: {reason}; the transport's files are {path}")]
    Node {
        instance: u32,
        role: String,
        reason: String,
        path: String,
    },
}

/// A process's membership in one instance. Instances share nothing: other directory, other shared-memory names.
///
/// Files lie in `vigil-<uid>/<instance>` of the system's shared-memory directory, which has mode 0700, and beside it
/// with mode 0600: only processes of the same user meet. At opening, what killed processes of this instance left is
/// removed.
pub struct Domain {
    node: Node<ipc::Service>,
    instance: u32,
    /// Locked while the role is this process's alone.
    _role: Option<OwnedFd>,
}

impl std::fmt::Debug for Domain {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Domain").field("instance", &self.instance).finish()
    }
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
        let node_error = |reason: String| DomainError::Node {
            instance,
            role: role.to_owned(),
            reason,
            path: format!("{shown}/{instance} and {SHARED_MEMORY}/{}*", config.global.prefix),
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
    /// [`DomainError::RoleTaken`] while another has it, and those of [`Domain::open`].
    pub fn open_alone(instance: u32, role: &'static str) -> Result<Self, DomainError> {
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
            Err(Errno::WOULDBLOCK) => Err(DomainError::RoleTaken { role, instance }),
            Err(e) => Err(DomainError::Directory { path, source: e.into() }),
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
        Some(free) if free < needed => Err(DomainError::NoRoom {
            free_kib: free >> 10,
            needed_kib: needed >> 10,
        }),
        _ => Ok(()),
    }
}

/// iceoryx2's configuration that keeps an instance apart, and the directory it lies in.
fn instance_config(instance: u32) -> Result<(Config, String), DomainError> {
    let uid = rustix::process::getuid().as_raw();
    let directory = format!("{SHARED_MEMORY}/vigil-{uid}");
    make_private(std::path::Path::new(&directory), uid)?;
    let path_error = |e: SemanticStringError| DomainError::Path {
        path: directory.clone(),
        reason: format!("{e:?}"),
    };
    let mut config = Config::default();
    let root = Path::new(format!("{directory}/{instance}").as_bytes()).map_err(path_error)?;
    config.global.set_root_path(&root);
    config.global.prefix = FileName::new(format!("vigil{uid}_{instance}_").as_bytes()).map_err(path_error)?;
    Ok((config, directory))
}

/// Makes the user's own directory if it is missing, and refuses one that anybody else could tamper with.
fn make_private(directory: &std::path::Path, uid: u32) -> Result<(), DomainError> {
    let shown = directory.display().to_string();
    let io_error = |source| DomainError::Directory {
        path: shown.clone(),
        source,
    };
    match std::fs::DirBuilder::new().mode(0o700).create(directory) {
        Ok(()) => {}
        Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => {}
        Err(e) => return Err(io_error(e)),
    }
    // Not following a link: it could be swapped for another directory later.
    let metadata = std::fs::symlink_metadata(directory).map_err(io_error)?;
    let mode = metadata.mode() & 0o7777;
    if !metadata.is_dir() || metadata.uid() != uid || mode & 0o077 != 0 {
        return Err(DomainError::NotPrivate {
            path: shown,
            uid,
            owner: metadata.uid(),
            mode,
        });
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

        let foreign = make_private(&directory, uid + 1).unwrap_err();
        assert!(matches!(foreign, DomainError::NotPrivate { .. }), "{foreign}");

        std::fs::set_permissions(&directory, std::fs::Permissions::from_mode(0o770)).unwrap();
        let open = make_private(&directory, uid).unwrap_err().to_string();
        assert!(open.contains("mode 0770") && open.contains("0700"), "{open}");

        let link = parent.path().join("link");
        let target = parent.path().join("target");
        make_private(&target, uid).unwrap();
        symlink(&target, &link).unwrap();
        assert!(matches!(make_private(&link, uid), Err(DomainError::NotPrivate { .. })));
    }
}
