//! The guidance state machine: a pure transition table.
