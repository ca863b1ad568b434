//! Tensors for the other side: a safetensors file.

use anyhow::{Context, Result};
use safetensors::{Dtype, tensor::TensorView};
use std::collections::HashMap;
use std::path::Path;

/// Named tensors being collected.
#[derive(Default)]
pub struct Record {
    tensors: Vec<(String, Vec<usize>, Vec<u8>)>,
    metadata: HashMap<String, String>,
}

impl Record {
    /// Adds numbers; the first dimension follows from the length.
    pub fn floats<'a>(&mut self, name: &str, inner: &[usize], values: impl IntoIterator<Item = &'a f32>) {
        let bytes: Vec<u8> = values.into_iter().flat_map(|x| x.to_le_bytes()).collect();
        let row = 4 * inner.iter().product::<usize>();
        let shape = [&[bytes.len() / row], inner].concat();
        self.tensors.push((name.to_owned(), shape, bytes));
    }

    /// Adds a line of metadata.
    pub fn note(&mut self, key: &str, value: impl ToString) {
        self.metadata.insert(key.to_owned(), value.to_string());
    }

    /// Writes the file.
    pub fn save(self, path: &Path) -> Result<()> {
        let views = self
            .tensors
            .iter()
            .map(|(name, shape, bytes)| Ok((name, TensorView::new(Dtype::F32, shape.clone(), bytes)?)))
            .collect::<Result<Vec<_>>>()?;
        let bytes = safetensors::serialize(views, Some(self.metadata))?;
        vigil_types::files::replace(path, &bytes, vigil_types::files::Access::Shared)
            .with_context(|| format!("cannot write {}", path.display()))
    }
}
