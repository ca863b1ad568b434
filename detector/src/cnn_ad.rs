//! CNN-AD and FCN-AD: networks that say from a state's SHAP image whether its frame was altered.

use crate::images::{IMAGE, IMAGE_CHANNELS, IMAGE_COLS, IMAGE_ROWS};
use crate::lstm_ad::dense_layers;
use vigil_nnet::{Activation, BatchNorm, Conv2d, Graph, GraphBuilder, MaxPool2d, Purpose, ShapeError};

/// Filters of each pair of convolutions; the paper leaves them open.
const FILTERS: [usize; 3] = [8, 16, 32];
/// Units of CNN-AD's dense layers before the last.
const CNN_UNITS: [usize; 4] = [64, 32, 16, 8];
/// Units of FCN-AD's.
const FCN_UNITS: [usize; 2] = [32, 16];
/// Added to batch norm's variance.
const EPSILON: f32 = 1e-5;

/// CNN-AD (docs/paper.md): batch norm, six convolutions of 3 × 3, max pooling after every second, five dense layers. One input of
/// [`IMAGE`] values in 0..=1, `[64][128][2]` (the paper's actor has five frames, ours one); one output, whose curve is `output`. Batch norm comes first, so its parameters do, too: scale, shift, running mean, running variance of both
/// channels. They are statistics of the training data and do not change while training.
///
/// # Errors
/// None.
pub fn cnn_ad(output: Activation) -> Result<Graph, ShapeError> {
    let mut b = GraphBuilder::new();
    let norm = BatchNorm {
        channels: IMAGE_CHANNELS,
        epsilon: EPSILON,
    };
    let norm_params = b.params(norm.param_len());
    let image = b.input(IMAGE, false)?;
    let mut x = b.batch_norm(image, norm, norm_params)?;
    let (mut channels, mut width) = (IMAGE_CHANNELS, IMAGE);
    for (k, filters) in FILTERS.into_iter().enumerate() {
        let (rows, cols) = (IMAGE_ROWS >> k, IMAGE_COLS >> k);
        for channels in [channels, filters] {
            let conv = Conv2d::new([rows, cols, channels], filters, 3, 1, 1);
            let params = b.params(conv.param_len());
            x = b.conv2d(x, conv, Activation::Relu, params)?;
        }
        let pool = MaxPool2d::tiles(rows, cols, filters, 2);
        x = b.max_pool2d(x, pool)?;
        (channels, width) = (filters, pool.output_len());
    }
    let x = dense_layers(&mut b, x, width, &CNN_UNITS, output)?;
    b.finish(x, Purpose::Gradients)
}

/// FCN-AD, the paper's fully connected baseline on the same image, `[64][128][2]` to `[1]`: three dense layers.
///
/// # Errors
/// None.
pub fn fcn_ad(output: Activation) -> Result<Graph, ShapeError> {
    let mut b = GraphBuilder::new();
    let image = b.input(IMAGE, false)?;
    let x = dense_layers(&mut b, image, IMAGE, &FCN_UNITS, output)?;
    b.finish(x, Purpose::Gradients)
}
