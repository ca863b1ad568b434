//! Buffers whose vectors do not straddle cache lines.

use alloc::vec;
use alloc::vec::Vec;
use core::ops::{Deref, DerefMut};

/// Float32 of one cache line, which is the longest vector as well.
pub(crate) const LINE: usize = 16;

/// Float32 that begin at a cache line. An allocator promises less, and then each vector of 512 bits is two accesses: the
/// convolutions take a fifth longer.
#[derive(Debug)]
pub struct Aligned {
    /// With room to begin at a line; never grows, so it stays where it is.
    values: Vec<f32>,
    at: usize,
    len: usize,
}

impl Aligned {
    /// `len` zeros.
    pub fn zeros(len: usize) -> Self {
        let values = vec![0.0; len + LINE - 1];
        let at = values.as_ptr().align_offset(LINE * size_of::<f32>()).min(LINE - 1);
        Self { values, at, len }
    }
}

impl From<&[f32]> for Aligned {
    fn from(values: &[f32]) -> Self {
        let mut copy = Self::zeros(values.len());
        copy.copy_from_slice(values);
        copy
    }
}

impl Clone for Aligned {
    fn clone(&self) -> Self {
        Self::from(&**self)
    }
}

impl Deref for Aligned {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        self.values.get(self.at..self.at + self.len).unwrap_or_default()
    }
}

impl DerefMut for Aligned {
    fn deref_mut(&mut self) -> &mut [f32] {
        self.values.get_mut(self.at..self.at + self.len).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buffers_and_their_copies_begin_at_a_line_and_hold_what_they_were_given() {
        for len in 0..70 {
            let given: Vec<f32> = (0..len).map(|i| i as f32).collect();
            let mut one = Aligned::from(given.as_slice());
            let two = one.clone();
            one.fill(-1.0);
            assert_eq!(&*two, given);
            assert!(one.len() == len && one.iter().all(|x| *x == -1.0));
            for buffer in [one, two, Aligned::zeros(len)] {
                assert_eq!(buffer.as_ptr().align_offset(64), 0);
            }
        }
    }
}
