//! What a policy is given, and what is done with what it gives.

use vigil_policy::imported::{Channels, Depth, PolicyInputs};

/// How the policy is given what we have: see [`PolicyInputs`].
#[derive(Debug, Clone, PartialEq)]
pub struct Adapter {
    /// What its channels are.
    pub order: Channels,
    /// What a pixel is.
    pub depth: Depth,
    /// Every pixel is multiplied by it.
    pub scale: f32,
    /// Its outputs are multiplied by it.
    pub output_scale: f32,
    /// The row of values that it takes, if it takes no picture.
    pub flat: Option<Flat>,
    /// The output that is the action, where there are several.
    pub output: Option<String>,
    /// The node, or its output, whose values are explained; absent: the last layer with weights that can be.
    pub split: Option<String>,
}

impl Default for Adapter {
    fn default() -> Self {
        Self {
            order: Channels::default(),
            depth: Depth::default(),
            scale: 1.0,
            output_scale: 1.0,
            flat: None,
            output: None,
            split: None,
        }
    }
}

impl Adapter {
    /// How a policy is given a frame of so many rows, columns and channels as its input of this number, and the goal beside it or not.
    pub(crate) fn inputs(&self, size: [usize; 3], frame_input: usize, has_position: bool) -> PolicyInputs {
        let [rows, cols, channels] = size;
        PolicyInputs {
            rows,
            cols,
            channels,
            order: self.order,
            depth: self.depth,
            scale: self.scale,
            frame_input,
            has_position,
            output_scale: self.output_scale,
        }
    }
}

/// A frame that a policy takes as a row of values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Flat {
    /// Channels, rows and columns, or rows, columns and channels where the last number is less than the first; the last runs fastest.
    pub frame: [usize; 3],
    /// Whether the goal stands before the frame in the same row, or behind it; absent: it has none.
    pub goal_first: Option<bool>,
}

impl std::str::FromStr for Flat {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (frame, goal_first) = match (text.strip_prefix("goal+"), text.strip_suffix("+goal")) {
            (Some(frame), _) => (frame, Some(true)),
            (_, Some(frame)) => (frame, Some(false)),
            _ => (text, None),
        };
        let sizes: Option<Vec<usize>> = frame
            .split('x')
            .map(|size| size.parse().ok().filter(|n| *n > 0))
            .collect();
        match sizes.as_deref() {
            Some([a, b, c]) => Ok(Self {
                frame: [*a, *b, *c],
                goal_first,
            }),
            _ => Err("three sizes are wanted, as 1x24x32, 1x24x32+goal or goal+1x24x32".to_owned()),
        }
    }
}
