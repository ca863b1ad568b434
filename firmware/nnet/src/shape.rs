//! What can be wrong with a caller's buffers or a network's description, and slices that are checked for it.

/// A buffer or a description that does not fit. Nothing was computed; the message says what to change.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the texts say what the fields are")]
pub enum ShapeError {
    /// A slice is not as long as the layer's description says.
    #[error("{what} holds {got} values, expected {expected}")]
    Length {
        what: &'static str,
        expected: usize,
        got: usize,
    },
    /// A layer's description is not usable (a zero size, a window larger than its padded input, an unknown node).
    #[error("{what} is not a usable layer description: {why}")]
    Description { what: &'static str, why: &'static str },
}

/// Checks a slice's length.
///
/// # Errors
/// [`ShapeError::Length`], with `what` it is.
pub fn expect(what: &'static str, slice: &[f32], expected: usize) -> Result<(), ShapeError> {
    expect_len(what, slice.len(), expected)
}

/// Checks the length of a slice of any type.
///
/// # Errors
/// [`ShapeError::Length`], with `what` it is.
pub(crate) fn expect_len(what: &'static str, got: usize, expected: usize) -> Result<(), ShapeError> {
    if got == expected {
        Ok(())
    } else {
        Err(ShapeError::Length { what, expected, got })
    }
}

/// `slice[offset..offset + len]`, or which slice is too short.
///
/// # Errors
/// [`ShapeError::Length`], with `what` it is.
pub fn part<'a>(what: &'static str, slice: &'a [f32], offset: usize, len: usize) -> Result<&'a [f32], ShapeError> {
    let (got, expected) = (slice.len(), offset + len);
    let error = ShapeError::Length { what, expected, got };
    slice.get(offset..expected).ok_or(error)
}

/// Like [`part`], writable.
///
/// # Errors
/// [`ShapeError::Length`], with `what` it is.
pub fn part_mut<'a>(
    what: &'static str,
    slice: &'a mut [f32],
    offset: usize,
    len: usize,
) -> Result<&'a mut [f32], ShapeError> {
    let (got, expected) = (slice.len(), offset + len);
    let error = ShapeError::Length { what, expected, got };
    slice.get_mut(offset..expected).ok_or(error)
}
