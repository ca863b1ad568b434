//! LSTM-AD: says from ten steps' explanations whether somebody is altering the actor's frames.

use alloc::borrow::ToOwned;
use alloc::string::String;
use alloc::vec::Vec;
use vigil_nnet::{Activation, Dense, Graph, GraphBuilder, Isa, Lstm, NodeId, Purpose, ShapeError, shape::expect};
use vigil_policy::actor::ACTOR_HIDDEN;

/// Rows of a window: SHAP values of the newest ten steps.
pub const WINDOW: usize = 10;

/// Values of a row: the yaw output's SHAP values of the actor's split point.
pub const ROW: usize = ACTOR_HIDDEN;

/// Largest magnitude of a normalised value.
pub const ROW_LIMIT: f32 = 10.0;

/// The paper's units; it leaves the dense layers' open.
const LSTM_UNITS: usize = 100;
const DENSE_UNITS: [usize; 3] = [64, 32, 16];

/// A row `[48]` of a split point's SHAP values, whatever their number: fewer are followed by zeros, of more each value is the sum of
/// neighbours, `ceil(n / 48)` of them, so that the row's sum stays the explanation's.
pub fn row_of(phi: &[f32]) -> [f32; ROW] {
    let mut row = [0.0; ROW];
    let neighbours = phi.len().div_ceil(ROW).max(1);
    for (to, group) in row.iter_mut().zip(phi.chunks(neighbours)) {
        *to = group.iter().sum();
    }
    row
}

/// Makes a row `[48]` comparable: `(phi - centre) / scale`, clipped to ±[`ROW_LIMIT`]. Not a number stays so.
pub fn normalise(phi: &[f32; ROW], centre: &[f32; ROW], scale: &[f32; ROW]) -> [f32; ROW] {
    let mut row = *phi;
    for (x, (centre, scale)) in row.iter_mut().zip(centre.iter().zip(scale)) {
        *x = ((*x - centre) / scale).clamp(-ROW_LIMIT, ROW_LIMIT);
    }
    row
}

/// Adds dense ReLU layers and a last one with `output`.
pub(crate) fn dense_layers(
    b: &mut GraphBuilder,
    mut x: NodeId,
    mut inputs: usize,
    units: &[usize],
    output: Activation,
) -> Result<NodeId, ShapeError> {
    let curves = units.iter().map(|units| (*units, Activation::Relu));
    for (outputs, curve) in curves.chain([(1, output)]) {
        let layer = Dense { inputs, outputs };
        let params = b.params(layer.param_len());
        x = b.dense(x, layer, curve, params)?;
        inputs = outputs;
    }
    Ok(x)
}

/// The network (docs/paper.md): LSTM(100) over the window's rows, three dense ReLU layers, one output.
#[derive(Debug, Clone)]
pub struct LstmAd {
    isa: Isa,
    graph: Graph,
    params: Vec<f32>,
    tape: Vec<f32>,
}

impl LstmAd {
    /// The network's graph: ten inputs of `[width]`, the window's rows, oldest first; the output is `[1]`. `cell` is the LSTM's curve, `output`
    /// the last layer's: the sigmoid to score, the identity to train through (its gradient does not vanish).
    ///
    /// Parameters, in this order: LSTM, then each dense layer.
    ///
    /// # Errors
    /// A zero width.
    pub fn graph(width: usize, cell: Activation, output: Activation) -> Result<Graph, ShapeError> {
        let mut b = GraphBuilder::new();
        let layer = Lstm {
            inputs: width,
            hidden: LSTM_UNITS,
            cell,
        };
        let params = b.params(layer.param_len());
        let rows: Result<Vec<_>, _> = (0..WINDOW).map(|_| b.input(width, true)).collect();
        let rows = rows?;
        let mut state = b.zeros(layer.state_len())?;
        for row in rows {
            state = b.lstm(row, state, layer, params)?;
        }
        let x = b.slice(state, 0, LSTM_UNITS)?;
        let x = dense_layers(&mut b, x, LSTM_UNITS, &DENSE_UNITS, output)?;
        b.finish(x, Purpose::Gradients)
    }

    /// The curve of the LSTM's candidate and cell.
    pub const CELL: Activation = Activation::Relu;

    /// Names and shapes of the parameters, in their order.
    pub fn tensors() -> Vec<(String, Vec<usize>)> {
        let gates = 4 * LSTM_UNITS;
        let mut tensors = vec![
            ("lstm.input_weight".to_owned(), vec![ROW, gates]),
            ("lstm.recurrent_weight".to_owned(), vec![LSTM_UNITS, gates]),
            ("lstm.bias".to_owned(), vec![gates]),
        ];
        let mut inputs = LSTM_UNITS;
        for (i, outputs) in DENSE_UNITS.into_iter().chain([1]).enumerate() {
            tensors.push((format!("dense_{}.weight", i + 1), vec![inputs, outputs]));
            tensors.push((format!("dense_{}.bias", i + 1), vec![outputs]));
            inputs = outputs;
        }
        tensors
    }

    /// Takes the parameters. Allocates; nothing after it does.
    ///
    /// # Errors
    /// A parameter slice of another length.
    pub fn new(isa: Isa, params: &[f32]) -> Result<Self, ShapeError> {
        let graph = Self::graph(ROW, Self::CELL, Activation::Sigmoid)?;
        expect("LSTM-AD parameters", params, graph.param_len())?;
        Ok(Self {
            isa,
            tape: vec![0.0; graph.tape_len()],
            params: params.to_vec(),
            graph,
        })
    }

    /// How much the window `[10][48]` looks like an attack, 0 to 1. Rows are normalised ([`normalise`]), oldest first. Not a number
    /// in a row makes the score so. No allocation.
    ///
    /// # Errors
    /// None for a network made by [`Self::new`].
    pub fn score(&mut self, rows: &[[f32; ROW]; WINDOW]) -> Result<f32, ShapeError> {
        let inputs = rows.each_ref().map(|row| row.as_slice());
        self.graph.forward(self.isa, &self.params, &inputs, &mut self.tape)?;
        Ok(self.graph.output(&self.tape)?.first().copied().unwrap_or(f32::NAN))
    }
}
