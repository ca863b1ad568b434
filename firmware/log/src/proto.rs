//! The log's own messages as they are on disk: protobuf, so that any viewer decodes them by the schema in the file.
//!
//! They are written down in `proto`; `tests/generated.rs` makes types and schemas of it, both committed in `generated`, so that a
//! build needs no compiler of protobuf. Protobuf gives what a record needs: explicit little-endian numbers, additive versions, a
//! decoder that answers corrupted bytes with an error.

include!("../generated/vigil.log.rs");

/// The messages that viewers know (`proto/foxglove/messages.proto`).
#[allow(missing_docs, clippy::all, clippy::pedantic, reason = "generated")]
pub(crate) mod foxglove {
    include!("../generated/foxglove.rs");
}

/// What they refer to.
#[allow(missing_docs, clippy::all, clippy::pedantic, reason = "generated")]
pub(crate) mod google {
    pub(crate) mod protobuf {
        include!("../generated/google.protobuf.rs");
    }
}

/// The schema of a kind of messages, by its full name: an encoded `FileDescriptorSet` of its whole package.
pub(crate) fn descriptors(kind: &str) -> &'static [u8] {
    if kind.starts_with("vigil.log.") {
        include_bytes!("../generated/log.descriptors")
    } else {
        include_bytes!("../generated/foxglove.descriptors")
    }
}
