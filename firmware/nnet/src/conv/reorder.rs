//! Moving values between pixel-major and column-major order.

use crate::vectorised;

/// Four values from `at` on.
#[inline(always)]
fn four(values: &[f32], at: usize) -> [f32; 4] {
    let values = values.get(at..).and_then(|values| values.first_chunk());
    values.copied().unwrap_or([0.0; 4])
}

/// Turns rows of 16 values into 16 columns, four by four: one check of bounds for four values.
#[inline(always)]
fn sixteen(from: &[[f32; 16]], to: &mut [f32], to_row: usize) {
    let mut columns = to.chunks_mut(to_row);
    let mut columns: [&mut [f32]; 16] = core::array::from_fn(|_| columns.next().unwrap_or_default());
    let (squares, rest) = from.as_chunks::<4>();
    for (block, [a, b, c, d]) in squares.iter().enumerate() {
        let first = block * 4;
        let [a, b, c, d] = [a, b, c, d].map(|row| row.as_chunks::<4>().0);
        let fours = columns.as_chunks_mut::<4>().0.iter_mut();
        for ((((columns, a), b), c), d) in fours.zip(a).zip(b).zip(c).zip(d) {
            let ([a0, a1, a2, a3], [b0, b1, b2, b3]) = (*a, *b);
            let ([c0, c1, c2, c3], [d0, d1, d2, d3]) = (*c, *d);
            let lines = [[a0, b0, c0, d0], [a1, b1, c1, d1], [a2, b2, c2, d2], [a3, b3, c3, d3]];
            for (column, line) in columns.iter_mut().zip(lines) {
                if let Some(slot) = column.get_mut(first..first + 4) {
                    slot.copy_from_slice(&line);
                }
            }
        }
    }
    for (r, row) in rest.iter().enumerate() {
        for (column, value) in columns.iter_mut().zip(row) {
            if let Some(slot) = column.get_mut(squares.len() * 4 + r) {
                *slot = *value;
            }
        }
    }
}

vectorised! {
    /// Turns `from` (rows of `width` values) into columns: value `c` of row `r` goes to `to[c · to_row + r]`.
    pub(super) fn transpose<'a>(width: usize, from: &'a [f32], to: &'a mut [f32], to_row: usize) {
        if let (16, (rows, [])) = (width, from.as_chunks::<16>()) {
            return sixteen(rows, to, to_row);
        }
        for (block, rows) in from.chunks(4 * width).enumerate() {
            let first = block * 4;
            let square = if rows.len() == 4 * width { width / 4 * 4 } else { 0 };
            // Four by four, as in `sixteen`.
            for column in (0..square).step_by(4) {
                let [a0, a1, a2, a3] = four(rows, column);
                let [b0, b1, b2, b3] = four(rows, column + width);
                let [c0, c1, c2, c3] = four(rows, column + 2 * width);
                let [d0, d1, d2, d3] = four(rows, column + 3 * width);
                let lines = [[a0, b0, c0, d0], [a1, b1, c1, d1], [a2, b2, c2, d2], [a3, b3, c3, d3]];
                for (c, line) in lines.iter().enumerate() {
                    let at = (column + c) * to_row + first;
                    if let Some(slot) = to.get_mut(at..at + 4) {
                        slot.copy_from_slice(line);
                    }
                }
            }
            for column in square..width {
                for (r, line) in rows.chunks_exact(width).enumerate() {
                    let value = line.get(column).copied();
                    if let (Some(slot), Some(value)) = (to.get_mut(column * to_row + first + r), value) {
                        *slot = value;
                    }
                }
            }
        }
    }
}

vectorised! {
    /// Deals several lists of equal length out in turn: `to[i · lists + l] = from[l][i]`, as far as `to` reaches.
    pub(super) fn interleave<'a>(from: &'a [f32], lists: usize, to: &'a mut [f32]) {
        let len = from.len() / lists.max(1);
        if lists == 2
            && let Some((even, odd)) = from.split_at_checked(len)
        {
            let (pairs, last) = to.as_chunks_mut::<2>();
            for (pair, (even, odd)) in pairs.iter_mut().zip(even.iter().zip(odd)) {
                *pair = [*even, *odd];
            }
            if let ([last], Some(value)) = (last, even.last()) {
                *last = *value;
            }
            return;
        }
        for (l, list) in from.chunks_exact(len.max(1)).enumerate() {
            for (to, from) in to.iter_mut().skip(l).step_by(lists).zip(list) {
                *to = *from;
            }
        }
    }
}
