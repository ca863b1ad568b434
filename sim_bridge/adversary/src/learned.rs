//! An adversary that was learned: by evolution, from how flights ended, without the gradient of anything ([`Method::Learned`]).
//!
//! It looks at a frame as everybody does, and shows what stands in each of eight sectors nearer or farther than it is, whole surfaces at a
//! time. `vigil attack learn` finds its weights (docs/adversary.md).
//!
//! [`Method::Learned`]: crate::Method::Learned

use crate::perturb::first_row_of_ground;
use serde::{Deserialize, Serialize};
use std::path::Path;
use vigil_policy::actor::PositionalInputs;

/// Sectors side by side over the frame's columns, for what is seen as well as for what is shown.
const SECTORS: usize = 8;
/// Contrast of the nearest return in each, the goal's distance / 20 m, and the bearing in radians that leads the actor.
const INPUTS: usize = SECTORS + 2;
const UNITS: usize = 12;
/// A range counts half as much as none at this distance, metres / 100 m: the contrast of the actor's own first layer.
const CONTRAST_RANGE: f32 = 0.03;
/// No pixel is brought nearer than this, as a normalised range: ranges of 0 would make a sensor look blind.
const FLOOR: f32 = 0.005;
const FORMAT: &str = "vigil learned adversary 1";
/// The largest file that is read, bytes.
const SIZE_LIMIT: u64 = 1 << 20;

/// Its weights: a layer of 12 tanh units and one of 8 tanh outputs, each row of weights followed by its bias.
#[derive(Debug, Clone, PartialEq)]
pub struct LearnedAdversary {
    weights: Vec<f32>,
}

/// Why there is no learned adversary.
#[derive(Debug, thiserror::Error)]
pub enum LearnedError {
    /// The file cannot be read or written.
    #[error("cannot read or write the learned adversary {path}: {error}")]
    Io {
        /// The file.
        path: String,
        /// What the system said.
        error: std::io::Error,
    },
    /// Not such a file, or of another version.
    #[error("{path} is no learned adversary of this version ({what}): `vigil attack learn` makes one")]
    Content {
        /// The file.
        path: String,
        /// What is wrong.
        what: String,
    },
    /// Weights of another number, or not finite.
    #[error("a learned adversary has {expected} finite weights, got {got}")]
    Weights {
        /// How many it has.
        expected: usize,
        /// How many finite ones were given.
        got: usize,
    },
}

#[derive(Serialize, Deserialize)]
struct File {
    format: String,
    /// How it was learned: for people.
    learned: serde_json::Value,
    weights: Vec<f32>,
}

impl LearnedAdversary {
    /// Number of its weights.
    pub const WEIGHTS: usize = UNITS * (INPUTS + 1) + SECTORS * (UNITS + 1);

    /// One that shows everything 0.96 of its reach farther away, whatever it sees: what [`Method::Recede`](crate::Method::Recede)
    /// does, to begin with.
    pub fn receding() -> Self {
        let mut weights = vec![0.0; Self::WEIGHTS];
        let outputs = UNITS * (INPUTS + 1);
        for row in weights[outputs..].chunks_exact_mut(UNITS + 1) {
            row[UNITS] = 2.0;
        }
        Self { weights }
    }

    /// From [`Self::WEIGHTS`] weights.
    ///
    /// # Errors
    /// Another number of them, or some that are not finite.
    pub fn new(weights: Vec<f32>) -> Result<Self, LearnedError> {
        let finite = weights.iter().filter(|w| w.is_finite()).count();
        if weights.len() == Self::WEIGHTS && finite == weights.len() {
            return Ok(Self { weights });
        }
        Err(LearnedError::Weights {
            expected: Self::WEIGHTS,
            got: finite,
        })
    }

    /// Its weights.
    pub fn weights(&self) -> &[f32] {
        &self.weights
    }

    /// Reads a file of [`Self::save`].
    ///
    /// # Errors
    /// A file that cannot be read, is longer than 1 MiB, or is none of these.
    pub fn load(path: &Path) -> Result<Self, LearnedError> {
        let name = path.display().to_string();
        let text = vigil_files::read_text(path, SIZE_LIMIT).map_err(|error| LearnedError::Io {
            path: name.clone(),
            error,
        })?;
        let refused = |what: String| LearnedError::Content {
            path: name.clone(),
            what,
        };
        let file: File = serde_json::from_str(&text).map_err(|e| refused(e.to_string()))?;
        if file.format != FORMAT {
            return Err(refused(format!("its format is {:?}", file.format)));
        }
        Self::new(file.weights).map_err(|e| refused(e.to_string()))
    }

    /// Writes it, with what is to be said of how it was learned.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn save(&self, path: &Path, learned: impl Serialize) -> Result<(), LearnedError> {
        let io = |error: std::io::Error| LearnedError::Io {
            path: path.display().to_string(),
            error,
        };
        let file = File {
            format: FORMAT.to_owned(),
            learned: serde_json::to_value(learned).map_err(|e| io(e.into()))?,
            weights: self.weights.clone(),
        };
        let text = serde_json::to_string_pretty(&file).map_err(|e| io(e.into()))?;
        vigil_files::replace(path, text.as_bytes(), vigil_files::Access::Shared).map_err(io)
    }

    /// How far what stands in each sector is moved, as a share of the reach: −1 is as near as it may, 1 as far.
    fn shifts(&self, nearest: [f32; SECTORS], position: &PositionalInputs) -> [f32; SECTORS] {
        let mut inputs = [0.0; INPUTS];
        for (input, range) in inputs.iter_mut().zip(nearest) {
            *input = 1.0 / (1.0 + range / CONTRAST_RANGE);
        }
        for (input, given) in inputs[SECTORS..].iter_mut().zip(position.iter()) {
            *input = *given;
        }
        let (first, second) = self.weights.split_at(UNITS * (INPUTS + 1));
        let layer = |rows: &[f32], x: &[f32], y: &mut [f32]| {
            for (y, row) in y.iter_mut().zip(rows.chunks_exact(x.len() + 1)) {
                let sum: f32 = row.iter().zip(x).map(|(w, x)| w * x).sum();
                *y = libm::tanhf(sum + row[x.len()]);
            }
        };
        let (mut hidden, mut shifts) = ([0.0; UNITS], [0.0; SECTORS]);
        layer(first, &inputs, &mut hidden);
        layer(second, &hidden, &mut shifts);
        shifts
    }

    /// Moves what stands above the ground in frames of `rows` × `cols` ranges, at the most by `reach`, from one sector's middle to the next
    /// linearly. What gives no return goes on giving none.
    pub(crate) fn alter(
        &self,
        frames: &mut [f32],
        (rows, cols): (usize, usize),
        position: &PositionalInputs,
        reach: f32,
    ) {
        let above_ground = first_row_of_ground(rows) * cols;
        for frame in frames.chunks_exact_mut(rows * cols) {
            let above = &mut frame[..above_ground];
            let mut nearest = [1.0_f32; SECTORS];
            for line in above.chunks_exact(cols) {
                for (col, range) in line.iter().enumerate() {
                    let sector = &mut nearest[col * SECTORS / cols];
                    *sector = sector.min(*range);
                }
            }
            let shifts = self.shifts(nearest, position);
            let by = |col: usize| {
                let at = ((col as f32 + 0.5) * SECTORS as f32 / cols as f32 - 0.5).clamp(0.0, (SECTORS - 1) as f32);
                let left = (at as usize).min(SECTORS - 2);
                let right_share = at - left as f32;
                reach * (shifts[left] + right_share * (shifts[left + 1] - shifts[left]))
            };
            for line in above.chunks_exact_mut(cols) {
                for (col, range) in line.iter_mut().enumerate().filter(|(_, range)| **range < 1.0) {
                    *range = (*range + by(col)).max(FLOOR.min(*range)).min(1.0);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vigil_policy::ActorInputs;

    const SHAPE: (usize, usize) = (32, 64);

    fn position() -> PositionalInputs {
        PositionalInputs::at_rest([1.0, 0.3], ActorInputs::default())
    }

    /// A wall at 8 m, with a hole in it on the right.
    fn frame() -> Vec<f32> {
        let (rows, cols) = SHAPE;
        let pixel = |i: usize| if i % cols >= 48 { 1.0 } else { 0.08 };
        (0..rows * cols).map(pixel).collect()
    }

    #[test]
    fn the_one_to_begin_with_shows_what_stands_farther_away_and_leaves_ground_and_sky() {
        let (clean, mut altered) = (frame(), frame());
        LearnedAdversary::receding().alter(&mut altered, SHAPE, &position(), 0.08);
        let ground = first_row_of_ground(SHAPE.0) * SHAPE.1;
        assert!(ground < clean.len(), "the frame shows ground");
        assert_eq!(altered[ground..], clean[ground..]);
        for (altered, clean) in altered[..ground].iter().zip(&clean) {
            let expected = if *clean < 1.0 {
                clean + 0.08 * libm::tanhf(2.0)
            } else {
                1.0
            };
            assert!(
                (altered - expected).abs() < 1e-6,
                "{altered} where {expected} was meant"
            );
        }
    }

    #[test]
    fn it_answers_what_it_sees_within_its_reach_and_moves_surfaces_as_one() {
        let mut weights = LearnedAdversary::receding().weights;
        // A unit for what is near in the leftmost sector, and an output that it drives.
        weights[0] = 4.0;
        let outputs = UNITS * (INPUTS + 1);
        weights[outputs] = -7.0;
        let adversary = LearnedAdversary::new(weights).unwrap();
        let shown = |clean: &[f32]| {
            let mut altered = clean.to_vec();
            adversary.alter(&mut altered, SHAPE, &position(), 0.05);
            altered[0]
        };
        let far = vec![0.9; SHAPE.0 * SHAPE.1];
        assert!(shown(&frame()) < 0.08 - 0.04, "near: shown nearer");
        assert!(shown(&far) > 0.9, "far: shown farther");
        let mut touching = vec![0.002; SHAPE.0 * SHAPE.1];
        adversary.alter(&mut touching, SHAPE, &position(), 0.05);
        assert!(touching[0] >= 0.002, "no nearer than it was below half a metre");
        let mut altered = frame();
        adversary.alter(&mut altered, SHAPE, &position(), 0.05);
        for pair in altered[..48].windows(2) {
            assert!((pair[1] - pair[0]).abs() < 0.014, "no step within a surface: {pair:?}");
        }
    }

    #[test]
    fn a_file_that_is_none_is_refused_with_what_is_wrong() {
        let folder = std::env::temp_dir().join(format!("vigil-learned-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("adversary.json");
        let adversary = LearnedAdversary::receding();
        adversary.save(&path, "by hand").unwrap();
        assert_eq!(LearnedAdversary::load(&path).unwrap(), adversary);
        let whole = std::fs::read_to_string(&path).unwrap();
        for (content, said) in [
            (whole[..whole.len() / 2].to_owned(), "EOF"),
            (whole.replace("adversary 1", "adversary 9"), "adversary 9"),
            (whole.replacen("2.0,", "", 1), "236 finite weights, got 235"),
        ] {
            std::fs::write(&path, content).unwrap();
            let error = LearnedAdversary::load(&path).unwrap_err().to_string();
            assert!(error.contains(said) && error.contains("vigil attack learn"), "{error}");
        }
        std::fs::remove_dir_all(&folder).unwrap();
        assert!(
            LearnedAdversary::load(&path)
                .unwrap_err()
                .to_string()
                .contains("adversary.json")
        );
        assert!(LearnedAdversary::new(vec![f32::NAN; LearnedAdversary::WEIGHTS]).is_err());
    }
}
