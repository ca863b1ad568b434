//! Checkpoints: one safetensors file that holds everything of a run, sealed with a SHA-256 over all tensors in the order of their names
//! (name, zero byte, type, zero byte, bytes).

use anyhow::{Context, Error, Result, anyhow, ensure};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use sha2::{Digest, Sha256};
use std::fmt::Display;
use std::path::{Path, PathBuf};

/// What a checkpoint's state says of itself.
pub const FORMAT: &str = "vigil learn checkpoint 2";
const DIGEST: &str = "sha256";
/// More than the largest replay memory of a run takes: what it writes it can go on with.
const SIZE_LIMIT: u64 = 128 << 30;

fn digest<S: AsRef<str>>(tensors: &[(S, TensorView<'_>)]) -> String {
    let mut sorted: Vec<_> = tensors.iter().map(|(name, view)| (name.as_ref(), view)).collect();
    sorted.sort_by_key(|(name, _)| *name);
    let mut hash = Sha256::new();
    for (name, view) in sorted {
        let kind = format!("{:?}", view.dtype());
        for part in [name.as_bytes(), &[0], kind.as_bytes(), &[0], view.data()] {
            hash.update(part);
        }
    }
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A tensor's name, type, length and bytes.
pub type Tensor = (String, Dtype, usize, Vec<u8>);

/// Of numbers of N bytes.
pub fn tensor<const N: usize, T: Copy>(name: String, dtype: Dtype, values: &[T], write: fn(T) -> [u8; N]) -> Tensor {
    let bytes = values.iter().flat_map(|x| write(*x)).collect();
    (name, dtype, values.len(), bytes)
}

/// Writes a description (JSON) and tensors beside and renames the file.
pub fn save<S: Serialize>(path: &Path, state: &S, mut all: Vec<Tensor>) -> Result<()> {
    let state = serde_json::to_vec(state)?;
    all.push(("state".into(), Dtype::U8, state.len(), state));
    let views = all
        .iter()
        .map(|(name, dtype, len, bytes)| Ok((name, TensorView::new(*dtype, vec![*len], bytes)?)))
        .collect::<Result<Vec<_>>>()?;
    let seal = [(DIGEST.to_owned(), digest(&views))];
    let file = safetensors::serialize(views, Some(seal.into()))?;
    replace(path, &file)
}

pub fn replace(path: &Path, content: &[u8]) -> Result<()> {
    vigil_types::files::replace(path, content, vigil_types::files::Access::Shared).map_err(|why| {
        let path = path.display();
        anyhow!("cannot write {path}: {why}; an earlier {path} is kept as it was")
    })
}

#[derive(Deserialize)]
struct Formatted {
    format: String,
}

pub struct Stored {
    path: PathBuf,
    bytes: Vec<u8>,
}

impl Stored {
    /// Reads a file and verifies its seal and its format.
    ///
    /// # Errors
    /// It cannot be read, is truncated, was altered or is of another version.
    pub fn read(path: &Path) -> Result<Self> {
        let path = path.to_owned();
        let bytes = vigil_types::files::read(&path, SIZE_LIMIT);
        let bytes = bytes.with_context(|| format!("cannot read checkpoint {}", path.display()))?;
        let read = Self { path, bytes };
        let file = SafeTensors::deserialize(&read.bytes).map_err(|e| read.none(e))?;
        let (_, header) = SafeTensors::read_metadata(&read.bytes).map_err(|e| read.none(e))?;
        let expected = header.metadata().as_ref().and_then(|entries| entries.get(DIGEST));
        let expected = expected.map_or("", String::as_str);
        let found = digest(&file.tensors());
        ensure!(
            found == expected,
            "checkpoint {} was altered: its content has SHA-256 {found}, its own entry says {expected}; it cannot be gone on with, \
             train anew in another folder",
            read.path.display()
        );
        // Before all else: another version's holds other things.
        let Formatted { format } = read.state()?;
        ensure!(
            format == FORMAT,
            "checkpoint {} has format \"{format}\", of another version; this program takes \"{FORMAT}\": train anew in another folder",
            read.path.display()
        );
        Ok(read)
    }

    fn none(&self, why: impl Display) -> Error {
        let path = self.path.display();
        anyhow!("checkpoint {path} is truncated or not a checkpoint: {why}")
    }

    fn tensor(&self, name: &str, dtype: Dtype) -> Result<Vec<u8>> {
        let file = SafeTensors::deserialize(&self.bytes).map_err(|e| self.none(e))?;
        let view = file.tensor(name).map_err(|e| self.none(e))?;
        if view.dtype() == dtype {
            Ok(view.data().to_vec())
        } else {
            Err(self.none(format!("tensor {name} is {:?}, not {dtype:?}", view.dtype())))
        }
    }

    pub fn state<S: DeserializeOwned>(&self) -> Result<S> {
        serde_json::from_slice(&self.tensor("state", Dtype::U8)?).map_err(|e| self.none(e))
    }

    /// Numbers of N bytes.
    pub fn numbers<const N: usize, T>(&self, name: &str, dtype: Dtype, read: fn([u8; N]) -> T) -> Result<Vec<T>> {
        let data = self.tensor(name, dtype)?;
        Ok(data.as_chunks().0.iter().map(|bytes| read(*bytes)).collect())
    }

    /// Numbers, of a length or of any.
    pub fn f32(&self, name: &str, expected: Option<usize>) -> Result<Vec<f32>> {
        let values = self.numbers(name, Dtype::F32, f32::from_le_bytes)?;
        if let Some(expected) = expected {
            let (path, found) = (self.path.display(), values.len());
            ensure!(
                expected == found,
                "checkpoint {path} is of another architecture: {name} holds {found} values, this program's has {expected}"
            );
        }
        Ok(values)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_checkpoint_of_another_version_is_refused_by_its_format_whatever_else_it_holds() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("checkpoint.safetensors");
        let state = serde_json::json!({"format": "vigil value checkpoint 3", "lanes": 7});
        save(&path, &state, Vec::new()).unwrap();
        let error = Stored::read(&path).err().unwrap().to_string();
        assert!(error.contains("has format \"vigil value checkpoint 3\""), "{error}");
    }
}
