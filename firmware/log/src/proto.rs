//! The log's own messages as they are on disk: protobuf, so that any viewer decodes them by the schema in the file.
//!
//! They are written down in `proto/vigil/log.proto`; `tests/generated.rs` makes the types and the schema of it, both committed in
//! `generated`, so that a build needs no compiler of protobuf. Protobuf gives what a record needs: explicit little-endian numbers,
//! additive versions, a decoder that answers corrupted bytes with an error.

include!("../generated/vigil.log.rs");

/// Package of the log's own messages.
const PACKAGE: &str = "vigil.log";

/// Full name of a message, as a schema's name in the file.
pub(crate) fn schema_name(message: &str) -> String {
    format!("{PACKAGE}.{message}")
}

/// The schema of all messages above: an encoded `FileDescriptorSet`.
pub(crate) const FILE_DESCRIPTOR_SET: &[u8] = include_bytes!("../generated/log.descriptors");
