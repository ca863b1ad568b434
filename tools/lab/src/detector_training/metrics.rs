//! How well scores tell two classes apart.

use serde::{Deserialize, Serialize};

/// Points of the receiver operating characteristic, from (0, 0) to (1, 1): false positive rate, true positive rate.
pub fn roc(attacked: &[f32], unattacked: &[f32]) -> Vec<(f64, f64)> {
    let mut all: Vec<(f32, bool)> = attacked.iter().map(|s| (*s, true)).collect();
    all.extend(unattacked.iter().map(|s| (*s, false)));
    all.sort_by(|a, b| b.0.total_cmp(&a.0));
    let (mut hits, mut false_alarms) = (0usize, 0usize);
    let mut points = vec![(0.0, 0.0)];
    for (i, (score, is_attacked)) in all.iter().enumerate() {
        *if *is_attacked { &mut hits } else { &mut false_alarms } += 1;
        // Equal scores are passed by a threshold together.
        if all.get(i + 1).is_none_or(|(next, _)| next != score) {
            points.push((
                false_alarms as f64 / unattacked.len().max(1) as f64,
                hits as f64 / attacked.len().max(1) as f64,
            ));
        }
    }
    points
}

/// The same curve without the points that lie on a line between their neighbours.
pub fn corners(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut kept: Vec<(f64, f64)> = Vec::new();
    for point in points {
        if let [.., a, b] = kept[..]
            && ((b.0 - a.0) * (point.1 - a.1) - (b.1 - a.1) * (point.0 - a.0)).abs() < 1e-12
        {
            kept.pop();
        }
        kept.push(*point);
    }
    kept
}

/// Area under the curve: the chance that an attacked window scores higher than an unattacked one, ties counting half.
pub fn auc(points: &[(f64, f64)]) -> f64 {
    let trapezia = points.windows(2).map(|w| (w[1].0 - w[0].0) * 0.5 * (w[0].1 + w[1].1));
    trapezia.sum()
}

/// The most attacked windows found with at most this share of false alarms.
pub fn true_positives_at(points: &[(f64, f64)], false_positives: f64) -> f64 {
    let within = points.iter().filter(|(x, _)| *x <= false_positives);
    within.map(|(_, y)| *y).fold(0.0, f64::max)
}

/// Mean and variance of each column.
pub fn moments<R: Iterator<Item = f64>>(width: usize, rows: impl Iterator<Item = R>) -> Vec<(f64, f64)> {
    let (mut sums, mut count) = (vec![(0.0, 0.0); width], 0usize);
    for row in rows {
        count += 1;
        for ((sum, squares), x) in sums.iter_mut().zip(row) {
            *sum += x;
            *squares += x * x;
        }
    }
    let count = count.max(1) as f64;
    let of = |(sum, squares)| (sum / count, squares / count - (sum / count) * (sum / count));
    sums.into_iter().map(of).collect()
}

/// A share with its 95 % interval (Wilson).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Proportion {
    /// How many.
    pub count: usize,
    /// Of how many.
    pub of: usize,
    /// The share; `None` of nothing.
    pub share: Option<f64>,
    pub interval: (f64, f64),
}

impl Proportion {
    pub fn new(count: usize, of: usize) -> Self {
        Self {
            count,
            of,
            share: (of > 0).then(|| count as f64 / of as f64),
            interval: crate::statistics::wilson_95(count, of),
        }
    }

    /// How many of some scores lie above a threshold.
    pub fn above(threshold: f32, scores: impl IntoIterator<Item = f32>) -> Self {
        let (mut count, mut of) = (0, 0);
        for score in scores {
            of += 1;
            count += usize::from(score > threshold);
        }
        Self::new(count, of)
    }
}

/// What a set of scores is worth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Separation {
    /// Right verdicts at the threshold, on as many attacked as unattacked windows, evenly picked.
    pub accuracy: Proportion,
    /// Attacked windows above the threshold.
    pub detected: Proportion,
    /// Unattacked windows above it.
    pub false_alarms: Proportion,
    /// Area under the curve.
    pub auc: f64,
    /// Attacked windows found at 1 % false alarms.
    pub found_at_1_percent: f64,
    /// ... and at 0.1 %.
    pub found_at_0_1_percent: f64,
}

impl Separation {
    pub fn of(threshold: f32, attacked: &[f32], unattacked: &[f32]) -> Self {
        let points = roc(attacked, unattacked);
        let count = attacked.len().min(unattacked.len());
        let evenly = |scores: &[f32]| -> Vec<f32> { (0..count).map(|i| scores[i * scores.len() / count]).collect() };
        let hits = Proportion::above(threshold, evenly(attacked)).count;
        let passes = count - Proportion::above(threshold, evenly(unattacked)).count;
        Self {
            accuracy: Proportion::new(hits + passes, 2 * count),
            detected: Proportion::above(threshold, attacked.iter().copied()),
            false_alarms: Proportion::above(threshold, unattacked.iter().copied()),
            auc: auc(&points),
            found_at_1_percent: true_positives_at(&points, 0.01),
            found_at_0_1_percent: true_positives_at(&points, 0.001),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_area_is_the_chance_of_ranking_right() {
        let (a, u) = ([0.9f32, 0.8, 0.4, 0.4], [0.1f32, 0.4, 0.7, 0.2, 0.85]);
        let mut wins = 0.0;
        for x in a {
            for y in u {
                wins += f64::from(x > y) + 0.5 * f64::from(x == y);
            }
        }
        assert!((auc(&roc(&a, &u)) - wins / 20.0).abs() < 1e-12);
        assert_eq!(auc(&roc(&[1.0, 0.9], &[0.1])), 1.0);
        assert_eq!(auc(&roc(&[0.5; 3], &[0.5; 7])), 0.5, "scores that say nothing");
    }

    #[test]
    fn found_at_a_rate_of_false_alarms_is_counted_at_the_best_threshold_allowed() {
        let unattacked: Vec<f32> = (0..100).map(|i| i as f32 / 100.0).collect();
        let points = roc(&[0.985, 0.995, 0.5, 0.2], &unattacked);
        assert_eq!(true_positives_at(&points, 0.0), 0.25);
        assert_eq!(true_positives_at(&points, 0.01), 0.5);
        assert_eq!(true_positives_at(&points, 1.0), 1.0);
    }

    #[test]
    fn the_corners_of_a_curve_are_the_curve() {
        let stairs = [
            (0.0, 0.0),
            (0.0, 0.25),
            (0.0, 0.5),
            (0.25, 0.5),
            (0.5, 0.5),
            (0.5, 1.0),
            (1.0, 1.0),
        ];
        let kept = corners(&stairs);
        assert_eq!(kept, [(0.0, 0.0), (0.0, 0.5), (0.5, 0.5), (0.5, 1.0), (1.0, 1.0)]);
        assert_eq!(auc(&kept), auc(&stairs));
    }

    #[test]
    fn accuracy_weighs_both_classes_alike() {
        let s = Separation::of(0.5, &[0.9, 0.1], &[0.1; 100]);
        assert_eq!((s.accuracy.count, s.accuracy.of), (3, 4));
        assert_eq!((s.detected.count, s.false_alarms.of), (1, 100));
    }
}
