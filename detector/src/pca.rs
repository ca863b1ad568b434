//! The principal component detector: what unattacked explanations do not span is suspicious.

/// Principal components of unattacked explanations. A state's score is the length of what they do not explain of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Pca {
    /// Mean of the unattacked explanations.
    mean: Vec<f32>,
    /// Orthonormal directions, one after the other.
    components: Vec<f32>,
}

/// Passes of the subspace iteration.
const PASSES: usize = 30;

impl Pca {
    /// The first `count` components of `rows` `[row][width]` by subspace iteration from their own first rows: the same
    /// rows give the same bits. Fewer, if the rows span fewer.
    pub fn fit(rows: &[f32], width: usize, count: usize) -> Self {
        let width = width.max(1);
        let number = (rows.len() / width).max(1) as f32;
        let mut mean = vec![0.0f32; width];
        for row in rows.chunks_exact(width) {
            for (mean, x) in mean.iter_mut().zip(row) {
                *mean += x / number;
            }
        }
        let centred: Vec<f32> = rows
            .chunks_exact(width)
            .flat_map(|row| row.iter().zip(&mean).map(|(x, mean)| x - mean))
            .collect();
        let mut components: Vec<Vec<f32>> = centred.chunks_exact(width).take(count).map(<[f32]>::to_vec).collect();
        orthonormalise(&mut components);
        for _ in 0..PASSES {
            // Σ rowᵀ (row · component): the covariance times the component, but for a factor.
            let mut next = vec![vec![0.0f32; width]; components.len()];
            for row in centred.chunks_exact(width) {
                for (component, next) in components.iter().zip(&mut next) {
                    let along = dot(row, component);
                    for (next, x) in next.iter_mut().zip(row) {
                        *next += along * x;
                    }
                }
            }
            components = next;
            orthonormalise(&mut components);
        }
        Self {
            mean,
            components: components.concat(),
        }
    }

    /// Number of components.
    pub fn count(&self) -> usize {
        self.components.len() / self.mean.len().max(1)
    }

    /// Length of the part of an explanation `[width]` that the components do not span.
    pub fn score(&self, row: &[f32]) -> f32 {
        let mut rest: Vec<f32> = row.iter().zip(&self.mean).map(|(x, mean)| x - mean).collect();
        for component in self.components.chunks_exact(self.mean.len().max(1)) {
            let along = dot(&rest, component);
            for (rest, x) in rest.iter_mut().zip(component) {
                *rest -= along * x;
            }
        }
        dot(&rest, &rest).sqrt()
    }
}

fn dot(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Gram and Schmidt, twice for rounding's sake. What depends on the others is left out.
fn orthonormalise(vectors: &mut Vec<Vec<f32>>) {
    let mut done: Vec<Vec<f32>> = Vec::with_capacity(vectors.len());
    for mut vector in vectors.drain(..) {
        let before = dot(&vector, &vector).sqrt();
        for _ in 0..2 {
            for other in &done {
                let along = dot(&vector, other);
                for (x, other) in vector.iter_mut().zip(other) {
                    *x -= along * other;
                }
            }
        }
        let length = dot(&vector, &vector).sqrt();
        if length > 1e-4 * before && length > 0.0 {
            vector.iter_mut().for_each(|x| *x /= length);
            done.push(vector);
        }
    }
    *vectors = done;
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points on a plane through (1, 2, 3, 4), longer along one axis than along the other.
    fn plane() -> Vec<f32> {
        let points = (0..40).map(|i| ((i as f32 * 0.7).sin() * 5.0, (i as f32 * 1.3).cos()));
        points.flat_map(|(a, b)| [1.0 + a, 2.0 + b, 3.0 + a, 4.0 - b]).collect()
    }

    #[test]
    fn what_lies_in_the_span_is_not_suspicious() {
        let pca = Pca::fit(&plane(), 4, 2);
        assert_eq!(pca.count(), 2);
        for row in plane().chunks_exact(4) {
            assert!(pca.score(row) < 1e-4, "{}", pca.score(row));
        }
        // One step off the plane, at right angles to it.
        let off = [1.0 + 1.0, 2.0, 3.0 - 1.0, 4.0];
        assert!((pca.score(&off) - 2.0f32.sqrt()).abs() < 1e-3, "{}", pca.score(&off));
    }

    #[test]
    fn the_longest_axis_is_found_first() {
        let pca = Pca::fit(&plane(), 4, 1);
        let along = [1.0 + 3.0, 2.0, 3.0 + 3.0, 4.0];
        let across = [1.0, 2.0 + 3.0, 3.0, 4.0 - 3.0];
        assert!(pca.score(&along) < 0.5 && pca.score(&across) > 4.0);
    }

    #[test]
    fn more_components_than_the_rows_span_are_not_made_up() {
        assert_eq!(Pca::fit(&plane(), 4, 4).count(), 2);
    }
}
