//! Depth frames and lockstep exchanges over iceoryx2 shared memory.
//!
//! Everything hangs on a [`Domain`]: one simulator, one firmware and what listens to them, of one instance number and
//! one user. [`FramePublisher`] and [`FrameSubscriber`] carry depth frames, newest wins. [`LockstepClient`] (the
//! simulator) and [`LockstepServer`] (the firmware) exchange one step at a time.
//!
//! The ports are not `Send`: make them in the thread that uses them.

mod domain;
mod exchange;
mod frames;

pub use domain::{Domain, DomainError, remove_leftovers};
pub use exchange::{LockstepClient, LockstepError, LockstepServer, Served, StepRequest};
pub use frames::{BorrowedFrame, DEPTH_TOPIC, FrameError, FramePublisher, FrameSubscriber, is_timely};
