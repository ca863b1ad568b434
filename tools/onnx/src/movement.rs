//! Operators that compute nothing: which value goes where. They cost nothing in flight, for the layers behind them are given
//! their weights in another order.

use crate::constant::len_of;

/// Where each value of the result is in the source, and the result's shape.
pub type Moved = (Vec<usize>, Vec<usize>);

/// An axis counted from either end.
pub fn axis(given: i64, rank: usize) -> Result<usize, String> {
    let from_end = if given < 0 { given + rank as i64 } else { given };
    let axis = usize::try_from(from_end).ok().filter(|axis| *axis < rank);
    axis.ok_or_else(|| format!("axis {given} of {rank} axes"))
}

/// Places of the values of `shape`, whose axes go these steps in what they are taken from.
pub fn strided(shape: &[usize], steps: &[usize]) -> Result<Vec<usize>, String> {
    if len_of(shape)? == 0 {
        return Ok(Vec::new());
    }
    let axes = shape.iter().zip(steps);
    Ok(axes.fold(vec![0], |places, (size, step)| {
        let along = |place: usize| (0..*size).map(move |i| place + i * step);
        places.into_iter().flat_map(along).collect()
    }))
}

/// What a step along each axis of `shape` goes.
pub fn steps(shape: &[usize]) -> Vec<usize> {
    let mut steps = vec![1usize; shape.len()];
    for i in (1..shape.len()).rev() {
        // Beyond the largest where nothing is moved: another axis has no places.
        steps[i - 1] = steps[i].saturating_mul(shape[i]);
    }
    steps
}

/// The values of `shape` where axis `along` takes the indices `taken`.
pub fn take(shape: &[usize], along: usize, taken: &[usize]) -> Result<Moved, String> {
    let (Some(outer), Some(size), Some(inner)) = (shape.get(..along), shape.get(along), shape.get(along + 1..)) else {
        return Err(format!("axis {along} of the shape {shape:?}"));
    };
    if let Some(index) = taken.iter().find(|index| *index >= size) {
        return Err(format!("index {index} on an axis of {size}"));
    }
    let (outer_len, inner_len) = (len_of(outer)?, len_of(inner)?);
    let result = [outer, &[taken.len()], inner].concat();
    len_of(&result)?;
    let begins = (0..outer_len).flat_map(|o| taken.iter().map(move |index| (o * size + index) * inner_len));
    Ok((result, begins.flat_map(|begin| begin..begin + inner_len).collect()))
}

/// The axes in another order.
pub fn transpose(shape: &[usize], order: &[usize]) -> Result<Moved, String> {
    let mut sorted = order.to_vec();
    sorted.sort_unstable();
    if !sorted.into_iter().eq(0..shape.len()) {
        return Err(format!("the order {order:?} of {} axes", shape.len()));
    }
    let of_axes = |values: &[usize]| -> Vec<usize> { order.iter().map(|axis| values[*axis]).collect() };
    let result = of_axes(shape);
    let places = strided(&result, &of_axes(&steps(shape)))?;
    Ok((result, places))
}

/// A shape as `Reshape` is given it: 0 keeps a size, −1 is what is left over.
pub fn reshape(shape: &[usize], wanted: &[i64]) -> Result<Vec<usize>, String> {
    let total = len_of(shape)?;
    let wrong = || format!("{shape:?} in the shape {wanted:?}");
    let mut result = Vec::new();
    let mut open = None;
    for (i, size) in wanted.iter().enumerate() {
        result.push(match size {
            0 => *shape.get(i).ok_or_else(wrong)?,
            -1 if open.is_none() => {
                open = Some(i);
                1
            }
            _ => usize::try_from(*size).map_err(|_| wrong())?,
        });
    }
    let len = len_of(&result)?;
    if let Some(place) = open.and_then(|i| result.get_mut(i))
        && len > 0
    {
        *place = total / len;
    }
    match len_of(&result)? == total {
        true => Ok(result),
        false => Err(wrong()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_change_places() {
        let (shape, places) = transpose(&[2, 3], &[1, 0]).unwrap();
        assert_eq!((shape, places), (vec![3, 2], vec![0, 3, 1, 4, 2, 5]));
        assert!(transpose(&[2, 3], &[1, 1]).is_err() && transpose(&[2, 3], &[0]).is_err());
    }

    #[test]
    fn values_are_taken_along_an_axis() {
        let (shape, places) = take(&[2, 3, 2], 1, &[2, 0]).unwrap();
        assert_eq!((shape, places), (vec![2, 2, 2], vec![4, 5, 0, 1, 10, 11, 6, 7]));
        assert!(take(&[2], 0, &[2]).is_err() && take(&[2], 1, &[0]).is_err());
    }

    #[test]
    fn a_shape_is_completed_and_has_to_fit() {
        assert_eq!(reshape(&[1, 8, 4], &[0, -1]).unwrap(), [1, 32]);
        assert!(reshape(&[1, 8], &[3, -1]).is_err() && reshape(&[1, 8], &[-1, -1]).is_err());
        assert!(reshape(&[1, 8], &[i64::MAX, i64::MAX]).is_err() && reshape(&[4], &[-2]).is_err());
    }
}
