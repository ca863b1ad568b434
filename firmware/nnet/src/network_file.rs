//! The file of a frozen network: safetensors whose metadata say what it is, and whose digest covers all of it.
//!
//! The metadata entry `sha256` is over all other entries (sorted by key; key, zero byte, value, zero byte) and then the
//! bytes of all tensors in the order of their kind.

use alloc::borrow::ToOwned;
use alloc::collections::BTreeMap;
use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;
use core::fmt;
use core::str::FromStr;
use safetensors::{Dtype, SafeTensors};
use sha2::{Digest, Sha256};
#[cfg(feature = "std")]
use {std::path::Path, vigil_types::files::Access};

const DIGEST: &str = "sha256";
/// The built-in networks have 0.3 to 1 MB, an imported policy up to 128 MiB.
#[cfg(feature = "std")]
const SIZE_LIMIT: u64 = 256 << 20;

/// What a file must be.
#[derive(Debug, Clone, Copy)]
pub struct Kind {
    /// What errors call it.
    pub noun: &'static str,
    /// Entries that must be this version's.
    pub identity: [(&'static str, &'static str); 3],
    /// Names and shapes of its tensors, in their order. A first size of 0 is any.
    pub tensors: fn() -> Vec<(String, Vec<usize>)>,
}

/// A tensor.
#[derive(Debug, Clone, PartialEq)]
pub struct Tensor {
    /// Its name.
    pub name: String,
    /// Its shape.
    pub shape: Vec<usize>,
    /// Its values.
    pub values: Vec<f32>,
}

/// Why a file is refused. Every message names the file.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the texts say what the fields are")]
pub enum FileError {
    /// It cannot be read or written.
    #[cfg(feature = "std")]
    #[error("cannot access {0}: {1}")]
    Access(String, #[source] std::io::Error),
    /// Another version, architecture or normalisation.
    #[error("{file} has {key} \"{found}\", this program takes \"{expected}\"")]
    Other {
        file: String,
        key: &'static str,
        found: String,
        expected: &'static str,
    },
    /// Truncated, altered, or without a valid entry or tensor of its kind.
    #[error("{0}")]
    Content(String),
}

impl Kind {
    fn name(&self, file: impl fmt::Display) -> String {
        format!("{} {file}", self.noun)
    }

    /// An error about what a file holds.
    pub fn content_error(&self, file: &str, message: impl fmt::Display) -> FileError {
        FileError::Content(format!("{} {message}", self.name(file)))
    }

    fn missing(&self, file: &str, key: &'static str) -> FileError {
        let message = format!("lacks a valid metadata entry `{key}`; it was not written by this program");
        self.content_error(file, message)
    }

    /// Reads a file of at most 256 MiB.
    ///
    /// # Errors
    /// [`FileError::Access`].
    #[cfg(feature = "std")]
    pub fn load(&self, path: &Path) -> Result<Vec<u8>, FileError> {
        vigil_types::files::read(path, SIZE_LIMIT).map_err(|source| self.access_error(path, source))
    }

    /// Replaces a file ([`vigil_types::files::replace`]).
    ///
    /// # Errors
    /// [`FileError::Access`].
    #[cfg(feature = "std")]
    pub fn save(&self, path: &Path, bytes: &[u8]) -> Result<(), FileError> {
        vigil_types::files::replace(path, bytes, Access::Shared).map_err(|source| self.access_error(path, source))
    }

    #[cfg(feature = "std")]
    fn access_error(&self, path: &Path, source: std::io::Error) -> FileError {
        FileError::Access(self.name(path.display()), source)
    }
}

/// What a file holds: metadata without the digest, and tensors.
#[derive(Debug, Clone, PartialEq)]
pub struct Contents {
    /// Metadata.
    pub entries: BTreeMap<String, String>,
    /// Tensors in the order of their kind.
    pub tensors: Vec<Tensor>,
}

impl Contents {
    /// The kind's own entries and these; tensors to be added.
    pub fn new(kind: &Kind, entries: impl IntoIterator<Item = (&'static str, String)>) -> Self {
        let identity = kind.identity.into_iter().map(|(key, value)| (key, value.to_owned()));
        Self {
            entries: identity.chain(entries).map(|(k, v)| (k.to_owned(), v)).collect(),
            tensors: Vec::new(),
        }
    }

    /// Adds a tensor.
    pub fn push(&mut self, name: &str, shape: &[usize], values: Vec<f32>) {
        self.tensors.push(Tensor {
            name: name.to_owned(),
            shape: shape.to_owned(),
            values,
        });
    }

    /// Adds tensors whose values lie one behind the other. The last one takes what is left over, so that a wrong length is
    /// found by [`Self::to_bytes`].
    pub fn push_all(&mut self, shapes: &[(String, Vec<usize>)], mut values: &[f32]) {
        for (i, (name, shape)) in shapes.iter().enumerate() {
            let len = if i + 1 == shapes.len() {
                values.len()
            } else {
                shape.iter().product::<usize>().min(values.len())
            };
            let (own, rest) = values.split_at_checked(len).unwrap_or((values, &[]));
            self.push(name, shape, own.to_owned());
            values = rest;
        }
    }

    /// SHA-256 over entries and tensors.
    pub fn sha256(&self) -> String {
        let mut hash = Sha256::new();
        for (key, value) in &self.entries {
            for part in [key.as_bytes(), &[0], value.as_bytes(), &[0]] {
                hash.update(part);
            }
        }
        for value in self.tensors.iter().flat_map(|tensor| &tensor.values) {
            hash.update(value.to_le_bytes());
        }
        hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// The file.
    ///
    /// # Errors
    /// A tensor whose values do not fill its shape or are not finite.
    #[cfg(feature = "std")]
    pub fn to_bytes(&self, kind: &Kind) -> Result<Vec<u8>, FileError> {
        self.check(kind, "to be written")?;
        let mut entries = self.entries.clone();
        entries.insert(DIGEST.to_owned(), self.sha256());
        // By hand: the library takes metadata in the order of a hash map, which is another in each process.
        let pair = |(key, value): (&String, &String)| format!("{}:{}", quoted(key), quoted(value));
        let entries: Vec<_> = entries.iter().map(pair).collect();
        let mut header = format!(r#"{{"__metadata__":{{{}}}"#, entries.join(","));
        let mut data = Vec::new();
        for Tensor { name, shape, values } in &self.tensors {
            let (name, from) = (quoted(name), data.len());
            data.extend(values.iter().flat_map(|x| x.to_le_bytes()));
            let to = data.len();
            header += &format!(r#",{name}:{{"dtype":"F32","shape":{shape:?},"data_offsets":[{from},{to}]}}"#);
        }
        header.push('}');
        header += &" ".repeat(header.len().next_multiple_of(8) - header.len());
        Ok([&(header.len() as u64).to_le_bytes(), header.as_bytes(), &data].concat())
    }

    fn check(&self, kind: &Kind, file: &str) -> Result<(), FileError> {
        for Tensor { name, shape, values } in &self.tensors {
            let (got, expected) = (values.len(), shape.iter().product::<usize>());
            if got != expected {
                let message = format!("has {got} values of tensor `{name}` instead of {expected}");
                return Err(kind.content_error(file, message));
            }
            if !values.iter().all(|x| x.is_finite()) {
                return Err(kind.content_error(file, format!("has a number in tensor `{name}` that is not finite")));
            }
        }
        Ok(())
    }
}

/// A text in JSON.
#[cfg(feature = "std")]
fn quoted(text: &str) -> String {
    let escaped = text.chars().map(|c| match c {
        '"' | '\\' | ..' ' => format!("\\u{:04x}", u32::from(c)),
        _ => String::from(c),
    });
    format!("\"{}\"", escaped.collect::<String>())
}

/// Digest, reading and writing of a type that is stored as a file of this kind: it has `contents` and `from_bytes`, and
/// may have a check of what a reader would refuse besides. Files come with the feature `std` of its own crate.
#[macro_export]
macro_rules! stored_network {
    ($type:ty, $kind:expr $(, $check:ident)?) => {
        impl $type {
            /// The file's content.
            ///
            /// # Errors
            /// [`FileError`]: what a reader would refuse, parameters of another length or not finite.
            #[cfg(feature = "std")]
            pub fn to_bytes(&self) -> Result<Vec<u8>, FileError> {
                $(self.$check("to be written")?;)?
                self.contents().to_bytes(&$kind)
            }

            /// The digest of the network and its metadata.
            pub fn sha256(&self) -> String {
                self.contents().sha256()
            }

            /// Reads and verifies a file.
            ///
            /// # Errors
            /// [`FileError`].
            #[cfg(feature = "std")]
            pub fn load(path: &std::path::Path) -> Result<Self, FileError> {
                Self::from_bytes(&path.display().to_string(), &$kind.load(path)?)
            }

            /// Writes a file beside and renames it, so that an earlier one survives a full disk.
            ///
            /// # Errors
            /// [`FileError`].
            #[cfg(feature = "std")]
            pub fn save(&self, path: &std::path::Path) -> Result<(), FileError> {
                $kind.save(path, &self.to_bytes()?)
            }
        }
    };
}

/// A file that was read and verified: of the kind, whole, unaltered, finite.
#[derive(Debug)]
pub struct Verified<'a> {
    kind: &'a Kind,
    file: &'a str,
    contents: Contents,
}

impl<'a> Verified<'a> {
    /// Reads and verifies a file's content; `file` names it in errors.
    ///
    /// # Errors
    /// [`FileError`]: anything but an unaltered file of the kind.
    pub fn from_bytes(kind: &'a Kind, file: &'a str, bytes: &[u8]) -> Result<Self, FileError> {
        let name = kind.name(file);
        let container = |e: safetensors::SafeTensorError| {
            FileError::Content(format!("{name} is truncated or not a safetensors file: {e}"))
        };
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(container)?;
        let content = SafeTensors::deserialize(bytes).map_err(container)?;
        let mut entries: BTreeMap<String, String> = header.metadata().clone().unwrap_or_default().into_iter().collect();
        for (key, expected) in kind.identity {
            let found = entries.get(key).ok_or_else(|| kind.missing(file, key))?;
            if found != expected {
                return Err(FileError::Other {
                    file: name,
                    key,
                    found: found.clone(),
                    expected,
                });
            }
        }
        let expected = entries.remove(DIGEST).ok_or_else(|| kind.missing(file, DIGEST))?;
        let mut tensors = Vec::new();
        for (tensor, shape) in (kind.tensors)() {
            let fits = |got: &[usize]| {
                got.len() == shape.len() && got.iter().zip(&shape).all(|(got, want)| *want == 0 || got == want)
            };
            let view = content.tensor(&tensor).ok();
            let Some(view) = view.filter(|view| view.dtype() == Dtype::F32 && fits(view.shape())) else {
                let shape = format!("{shape:?}").replace("[0,", "[any,");
                let message = format!("{name}: tensor `{tensor}` is missing or not float32 of shape {shape}");
                return Err(FileError::Content(message));
            };
            let values = view.data().as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b));
            tensors.push(Tensor {
                name: tensor,
                shape: view.shape().to_owned(),
                values: values.collect(),
            });
        }
        let contents = Contents { entries, tensors };
        let found = contents.sha256();
        if found != expected {
            let message = format!("{name} was altered: its content has SHA-256 {found}, its own entry says {expected}");
            return Err(FileError::Content(message));
        }
        contents.check(kind, file)?;
        Ok(Self { kind, file, contents })
    }

    /// An entry's text.
    ///
    /// # Errors
    /// [`FileError::Content`].
    pub fn text(&self, key: &'static str) -> Result<String, FileError> {
        self.optional(key).ok_or_else(|| self.kind.missing(self.file, key))
    }

    /// An entry's number.
    ///
    /// # Errors
    /// [`FileError::Content`].
    pub fn number<T: FromStr>(&self, key: &'static str) -> Result<T, FileError> {
        let number = self.text(key)?.parse();
        number.map_err(|_| self.kind.missing(self.file, key))
    }

    /// An entry that a file may lack.
    pub fn optional(&self, key: &str) -> Option<String> {
        self.contents.entries.get(key).cloned()
    }

    /// The tensors' values, in the order of the kind.
    pub fn into_values(self) -> impl Iterator<Item = Vec<f32>> {
        self.contents.tensors.into_iter().map(|tensor| tensor.values)
    }
}
