//! Files of secrets: the key of MAVLink signing and those of depth frames.

use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use vigil_types::{FrameKey, FrameKeys};

/// A key file is longer than this only by mistake.
const SIZE_LIMIT: u64 = 4 << 10;
/// Where Linux says which boot of the machine this is.
const BOOT_ID: &str = "/proc/sys/kernel/random/boot_id";

/// Why a secret cannot be used, with what to do.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct KeyFileError(String);

/// Reads a secret of 32 bytes: 64 hexadecimal digits with white space around them, or the bytes themselves. The file must be the
/// user's or root's and closed to everybody else. `what` names the key in errors.
///
/// # Errors
/// [`KeyFileError`].
pub fn read_secret(path: &Path, what: &'static str) -> Result<[u8; 32], KeyFileError> {
    let file = path.display();
    let refused = |why: String| Err(KeyFileError(format!("{what} {file} {why}")));
    let unread = |error: std::io::Error| KeyFileError(format!("{what} {file}: {error}"));
    let mut open = vigil_types::files::open(path).map_err(unread)?;
    // Of the open file, so that nobody can exchange it in between.
    let metadata = open.metadata().map_err(unread)?;
    let mode = metadata.permissions().mode() & 0o7777;
    if mode & 0o077 != 0 {
        return refused(format!(
            "has mode {mode:04o}, so others can read or change it: chmod 600 {file}, and make a new key if they may have"
        ));
    }
    let owner = metadata.uid();
    if owner != 0 && owner != rustix::process::geteuid().as_raw() {
        return refused(format!("belongs to user {owner}: it must be yours or root's"));
    }
    let bytes = vigil_types::files::read_from(&mut open, SIZE_LIMIT).map_err(unread)?;
    match secret_of(&bytes) {
        None => refused(format!(
            "is not a key: write 64 hexadecimal digits or exactly 32 bytes, for example with: head -c 32 /dev/urandom > {file}"
        )),
        Some([0, rest @ ..]) if rest == [0; 31] => refused(format!(
            "is all zeros, which anybody would guess: make one with: head -c 32 /dev/urandom > {file}"
        )),
        Some(secret) => Ok(secret),
    }
}

fn secret_of(bytes: &[u8]) -> Option<[u8; 32]> {
    if let Ok(raw) = <[u8; 32]>::try_from(bytes) {
        return Some(raw);
    }
    let digits = std::str::from_utf8(bytes).ok()?.trim().as_bytes();
    if digits.len() != 64 {
        return None;
    }
    let mut secret = [0; 32];
    for (byte, pair) in secret.iter_mut().zip(digits.chunks_exact(2)) {
        let digit = |d: &u8| char::from(*d).to_digit(16);
        *byte = pair.iter().try_fold(0, |sum, d| Some(sum << 4 | digit(d)? as u8))?;
    }
    Some(secret)
}

/// The key of one sensor in this boot of the machine, as driver and firmware both derive it from the secret in a file.
///
/// # Errors
/// [`KeyFileError`].
pub fn frame_key(path: &Path, sensor_id: u32) -> Result<FrameKey, KeyFileError> {
    let secret = read_secret(path, "frame key")?;
    let unread = |error| KeyFileError(format!("identifier of this boot, {BOOT_ID}: {error}"));
    let boot = std::fs::read(BOOT_ID).map_err(unread)?;
    Ok(FrameKey::new(&secret, sensor_id, boot.trim_ascii()))
}

/// The keys that a receiver accepts: of no file, where frames are not authenticated; of one; or of the one in force and the next.
///
/// # Errors
/// [`KeyFileError`].
pub fn frame_keys(paths: &[PathBuf], sensor_id: u32) -> Result<FrameKeys, KeyFileError> {
    let key = |path: Option<&PathBuf>| path.map(|path| frame_key(path, sensor_id)).transpose();
    match paths.get(2) {
        Some(path) => Err(KeyFileError(format!(
            "at most two frame keys are accepted at a time, the one in force and the next: leave out {}",
            path.display()
        ))),
        None => Ok(FrameKeys {
            current: key(paths.first())?,
            other: key(paths.get(1))?,
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vigil_types::DepthFrame;

    fn key_file(folder: &Path, content: &[u8], mode: u32) -> PathBuf {
        let path = folder.join("vigil.key");
        std::fs::write(&path, content).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
        path
    }

    fn read(path: &Path) -> Result<[u8; 32], KeyFileError> {
        read_secret(path, "frame key")
    }

    #[test]
    fn a_key_is_32_bytes_or_64_digits_and_not_all_zeros() {
        let folder = tempfile::tempdir().unwrap();
        let key = std::array::from_fn::<u8, 32, _>(|i| i as u8 * 8);
        let hex: String = key.iter().map(|b| format!("{b:02X}")).collect();
        for content in [key.to_vec(), hex.clone().into_bytes(), format!(" {hex}\n").into_bytes()] {
            assert_eq!(read(&key_file(folder.path(), &content, 0o600)).unwrap(), key);
        }
        let no_key =
            [&key[..31], &hex.as_bytes()[..63], &[b'g'; 64], b""].map(|content| (content, "64 hexadecimal digits"));
        let zeros = [&[0; 32][..], &[b'0'; 64]].map(|content| (content, "all zeros"));
        for (content, why) in no_key.into_iter().chain(zeros) {
            let error = read(&key_file(folder.path(), content, 0o600)).unwrap_err();
            assert!(error.to_string().contains(why), "{error}");
        }
    }

    #[test]
    fn a_key_that_others_can_read_is_refused_with_what_to_do() {
        let folder = tempfile::tempdir().unwrap();
        for mode in [0o644, 0o640, 0o604, 0o660, 0o610] {
            let error = read(&key_file(folder.path(), &[1; 32], mode)).unwrap_err().to_string();
            assert!(
                error.contains(&format!("{mode:04o}")) && error.contains("chmod 600"),
                "{error}"
            );
        }
        assert!(read(&key_file(folder.path(), &[1; 32], 0o400)).is_ok());
        let error = read(&folder.path().join("none.key")).unwrap_err().to_string();
        assert!(error.contains("none.key"), "{error}");
    }

    #[test]
    fn driver_and_firmware_derive_the_same_key_from_a_file_and_another_sensor_another() {
        let folder = tempfile::tempdir().unwrap();
        let path = key_file(folder.path(), &[3; 32], 0o600);
        let mut frame = DepthFrame::EMPTY;
        frame.authenticate(&frame_key(&path, 1).unwrap());
        assert!(frame_keys(std::slice::from_ref(&path), 1).unwrap().accept(&frame));
        assert!(!frame_keys(std::slice::from_ref(&path), 2).unwrap().accept(&frame));
        assert!(!frame_keys(&[], 1).unwrap().is_required());
        let error = frame_keys(&[path.clone(), path.clone(), path], 1)
            .unwrap_err()
            .to_string();
        assert!(error.contains("at most two"), "{error}");
    }
}
