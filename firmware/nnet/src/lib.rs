//! Frozen and trainable network layers on caller-owned buffers.
