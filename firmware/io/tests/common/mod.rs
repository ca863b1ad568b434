//! An instance number for each test.

use vigil_io::shared_memory::{Domain, remove_leftovers};

/// An instance of a test's own, so that tests run side by side, with each other and with flights; dropped last.
pub struct Instance(pub u32);

impl Instance {
    pub fn own(number: u32) -> Self {
        Self(1_000_000 + std::process::id() * 16 + number)
    }

    /// One, and what the test has of it.
    pub fn joined(number: u32) -> (Self, Domain) {
        let instance = Self::own(number);
        let domain = Domain::open(instance.0, "test").unwrap();
        (instance, domain)
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        let _ = remove_leftovers(self.0);
    }
}
