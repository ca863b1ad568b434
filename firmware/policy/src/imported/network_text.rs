//! A network as text, a layer a line: how an imported policy's file holds it.

use super::network::{Layer, MOST_LAYERS, Network, NetworkError};
use alloc::borrow::ToOwned;
use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;
use core::fmt::{self, Write};
use core::str::FromStr;
use vigil_nnet::{Activation, BatchNorm, Conv2d, Dense, Function, Gru, LayerNorm, Lstm, MaxPool2d};

pub(super) fn name_of(curve: Activation) -> String {
    match curve {
        Activation::Identity => "identity".to_owned(),
        Activation::Relu => "relu".to_owned(),
        Activation::Elu => "elu".to_owned(),
        Activation::Tanh { scale } => format!("tanh*{scale}"),
        Activation::Sigmoid => "sigmoid".to_owned(),
        Activation::NearContrast { gain } => format!("contrast*{gain}"),
    }
}

fn curve_of(name: &str) -> Option<Activation> {
    let (name, factor) = match name.split_once('*') {
        Some((name, factor)) => (name, factor.parse::<f32>().ok().filter(|f| f.is_finite() && *f > 0.0)?),
        None => (name, 1.0),
    };
    match name {
        "identity" => Some(Activation::Identity),
        "relu" => Some(Activation::Relu),
        "elu" => Some(Activation::Elu),
        "tanh" => Some(Activation::Tanh { scale: factor }),
        "sigmoid" => Some(Activation::Sigmoid),
        "contrast" => Some(Activation::NearContrast { gain: factor }),
        _ => None,
    }
}

/// A function's name, and its numbers behind it.
pub(super) fn name_of_function(function: Function) -> String {
    match function {
        Function::LeakyRelu { alpha } => format!("leaky_relu*{alpha}"),
        Function::Elu { alpha } => format!("elu*{alpha}"),
        Function::Softplus => "softplus".to_owned(),
        Function::Clip { least, most } => format!("clip*{least}*{most}"),
        Function::Power { exponent } => format!("power*{exponent}"),
        Function::Exp => "exp".to_owned(),
        Function::Log => "log".to_owned(),
        Function::Abs => "abs".to_owned(),
        Function::Erf => "erf".to_owned(),
    }
}

fn function_of(text: &str) -> Option<Function> {
    let mut words = text.split('*');
    let name = words.next()?;
    let numbers: Option<Vec<f32>> = words
        .map(|word| word.parse().ok().filter(|x: &f32| !x.is_nan()))
        .collect();
    match (name, numbers?.as_slice()) {
        ("leaky_relu", [alpha]) => Some(Function::LeakyRelu { alpha: *alpha }),
        ("elu", [alpha]) => Some(Function::Elu { alpha: *alpha }),
        ("softplus", []) => Some(Function::Softplus),
        ("clip", [least, most]) => Some(Function::Clip {
            least: *least,
            most: *most,
        }),
        ("power", [exponent]) => Some(Function::Power { exponent: *exponent }),
        ("exp", []) => Some(Function::Exp),
        ("log", []) => Some(Function::Log),
        ("abs", []) => Some(Function::Abs),
        ("erf", []) => Some(Function::Erf),
        _ => None,
    }
}

impl fmt::Display for Network {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for layer in &self.layers {
            let line = layer.line();
            f.write_str(line.kind)?;
            for number in line.sources.iter().chain(&line.sizes).chain(&line.params_of) {
                write!(f, " {number}")?;
            }
            if !line.word.is_empty() {
                write!(f, " {}", line.word)?;
            }
            f.write_char('\n')?;
        }
        writeln!(f, "output {}", self.output)
    }
}

/// The layer of a line: its kind, its numbers, and the word behind them.
pub(super) fn layer_of(kind: &str, numbers: &[usize], word: Option<&str>) -> Option<Layer> {
    let curve = || word.and_then(curve_of);
    let epsilon = || word.and_then(|word| word.parse().ok());
    Some(match (kind, numbers) {
        ("input", &[len]) => Layer::Input { len },
        ("zeros", &[len]) => Layer::Zeros { len },
        ("slice", &[x, from, len]) => Layer::Slice { x, from, len },
        ("concat", parts @ [_, ..]) => Layer::Concat { parts: parts.to_vec() },
        ("curve", &[x]) => Layer::Curve { x, curve: curve()? },
        ("conv2d", &[x, rows, cols, channels, filters, kernel, stride, padding]) => {
            let layer = Conv2d::new([rows, cols, channels], filters, kernel, stride, padding);
            let curve = curve()?;
            Layer::Conv2d { x, layer, curve }
        }
        ("dense", &[x, inputs, outputs]) => {
            let (layer, curve) = (Dense { inputs, outputs }, curve()?);
            Layer::Dense { x, layer, curve }
        }
        ("max_pool2d", &[x, rows, cols, channels, side]) => {
            let layer = MaxPool2d::tiles(rows, cols, channels, side);
            Layer::MaxPool2d { x, layer }
        }
        ("max_pool2d", &[x, rows, cols, channels, height, width, stride, padding]) => {
            let layer = MaxPool2d {
                window: [height, width],
                stride,
                padding,
                ..MaxPool2d::tiles(rows, cols, channels, 1)
            };
            Layer::MaxPool2d { x, layer }
        }
        ("batch_norm", &[x, channels]) => {
            let epsilon = epsilon()?;
            let layer = BatchNorm { channels, epsilon };
            Layer::BatchNorm { x, layer }
        }
        ("function", &[x]) => {
            let function = word.and_then(function_of)?;
            Layer::Function { x, function }
        }
        ("sum", parts @ [_, ..]) => Layer::Sum { parts: parts.to_vec() },
        ("product", &[x, y]) => Layer::Product { x, y },
        ("layer_norm", &[x, width]) => {
            let epsilon = epsilon()?;
            let layer = LayerNorm { width, epsilon };
            Layer::LayerNorm { x, layer }
        }
        ("gru", &[x, h, inputs, hidden, params_of]) => {
            let layer = Gru { inputs, hidden };
            Layer::Gru { x, h, layer, params_of }
        }
        ("lstm", &[x, state, inputs, hidden, params_of]) => {
            let cell = Activation::TANH;
            let layer = Lstm { inputs, hidden, cell };
            Layer::Lstm {
                x,
                state,
                layer,
                params_of,
            }
        }
        _ => return None,
    })
}

impl FromStr for Network {
    type Err = NetworkError;

    fn from_str(text: &str) -> Result<Self, NetworkError> {
        let mut network = Self::default();
        let mut output = None;
        for (number, line) in text.lines().enumerate() {
            let wrong = || NetworkError(format!("line {} of its layers is not understood: {line:?}", number + 1));
            if network.layers.len() > MOST_LAYERS || output.is_some() {
                return Err(wrong());
            }
            let mut words = line.split(' ');
            let kind = words.next().ok_or_else(wrong)?;
            let (mut numbers, mut word): (Vec<usize>, Option<&str>) = (Vec::new(), None);
            for next in words {
                match (next.parse(), word) {
                    (Ok(value), None) if !kind.ends_with("_norm") || numbers.len() < 2 => numbers.push(value),
                    (_, None) => word = Some(next),
                    _ => return Err(wrong()),
                }
            }
            if let ("output", [of]) = (kind, numbers.as_slice()) {
                output = Some(*of);
                continue;
            }
            network.layers.push(layer_of(kind, &numbers, word).ok_or_else(wrong)?);
        }
        network.output = output.ok_or_else(|| NetworkError("its layers lack an output".to_owned()))?;
        network.check()?;
        Ok(network)
    }
}
