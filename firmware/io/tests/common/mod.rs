//! An instance number for each test.

/// An instance of a test's own, so that tests run side by side, with each other and with flights; dropped last.
pub struct Instance(pub u32);

impl Instance {
    pub fn own(number: u32) -> Self {
        Self(1_000_000 + std::process::id() * 16 + number)
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        let _ = vigil_io::shared_memory::remove_leftovers(self.0);
    }
}
