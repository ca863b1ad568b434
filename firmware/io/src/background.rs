//! Work that may wait for a disk or a terminal, done by a thread of its own: the loop may not wait.

use rtrb::{Producer, RingBuffer};
use std::thread::JoinHandle;
use std::time::Duration;

/// The loop's side of such a thread. What was offered before it is dropped is still done.
pub struct Background<J> {
    // Dropped before the thread is joined: it ends when nobody can offer any more.
    ring: Option<Producer<J>>,
    thread: Option<JoinHandle<()>>,
}

impl<J: Send + 'static> Background<J> {
    /// Starts a thread that hands what was offered, in order, to `work` each `pause`. At most `capacity` jobs wait.
    ///
    /// # Errors
    /// When the thread cannot be started.
    pub fn start(
        name: &str,
        capacity: usize,
        pause: Duration,
        mut work: impl FnMut(&mut dyn Iterator<Item = J>) + Send + 'static,
    ) -> std::io::Result<Self> {
        let (ring, mut offered) = RingBuffer::new(capacity);
        let thread = std::thread::Builder::new().name(name.to_owned()).spawn(move || {
            loop {
                let last_look = offered.is_abandoned();
                work(&mut std::iter::from_fn(|| offered.pop().ok()));
                if last_look {
                    return;
                }
                std::thread::sleep(pause);
            }
        })?;
        Ok(Self {
            ring: Some(ring),
            thread: Some(thread),
        })
    }

    /// Has a job done; `false` where too many wait. Never waits and allocates nothing.
    pub fn offer(&mut self, job: J) -> bool {
        self.ring.as_mut().is_some_and(|ring| ring.push(job).is_ok())
    }

    /// So many jobs may be offered now.
    pub fn room(&self) -> usize {
        self.ring.as_ref().map_or(0, Producer::slots)
    }
}

impl<J> Drop for Background<J> {
    fn drop(&mut self) {
        self.ring = None;
        if let Some(thread) = self.thread.take() {
            // It does not panic; if it did, what is on the disk stays.
            let _ = thread.join();
        }
    }
}
