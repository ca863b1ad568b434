//! GRU and LSTM.

use super::importer::{Importer, Live, RecurrentWeights, Value};
use crate::constant::{Constant, len_of};
use crate::proto::Node;
use std::rc::Rc;
use vigil_nnet::{Activation, Gru, Lstm};
use vigil_policy::imported::Layer;

impl RecurrentWeights<'_> {
    /// The layer's parameters of ONNX's weights of the input `w`, of the state `r`, and both biases one after the other.
    fn params(&self, hidden: usize, w: &[f32], r: &[f32], bias: &[f32]) -> Result<Vec<f32>, String> {
        // ONNX's gates: z, r, h and i, o, f, c; ours: r, z, n and i, f, g, o.
        let order: &[usize] = if self.is_gru { &[1, 0, 2] } else { &[0, 2, 3, 1] };
        let (rows, inputs) = (order.len() * hidden, self.places.len());
        let row_of = |column: usize| order[column / hidden] * hidden + column % hidden;
        let mut params = vec![0.0; len_of(&[self.inputs, rows])?];
        for (i, place) in self.places.iter().enumerate() {
            for column in 0..rows {
                params[*place as usize * rows + column] += w[row_of(column) * inputs + i];
            }
        }
        for i in 0..hidden {
            params.extend((0..rows).map(|column| r[row_of(column) * hidden + i]));
        }
        let biases = |from: usize| (0..rows).map(move |column| bias[from + row_of(column)]);
        match self.is_gru {
            true => params.extend(biases(0).chain(biases(rows))),
            false => params.extend(biases(0).zip(biases(rows)).map(|(a, b)| a + b)),
        }
        Ok(params)
    }
}

impl<'a> Importer<'a> {
    /// The layer that holds the state before the first step: of a GRU `h`, of an LSTM `h`, then `c`.
    fn first_state(&mut self, node: &Node, is_gru: bool, hidden: usize) -> Result<usize, String> {
        let zero = |constant: &Constant| constant.real().is_ok_and(|all| all.iter().all(|value| *value == 0.0));
        let inputs = if is_gru { 5..6 } else { 5..7 };
        let mut given = Vec::new();
        for i in inputs.clone() {
            given.push(match node.input.get(i).is_none_or(String::is_empty) {
                true => None,
                false => match self.input(node, i)?.1 {
                    Value::Constant(constant) if zero(&constant) => None,
                    Value::Constant(_) => return Err("a first state of constants other than zeros".to_owned()),
                    Value::Live(live) => Some(live),
                },
            });
        }
        if given.iter().all(Option::is_none) {
            let len = inputs.len() * hidden;
            return self.push(Layer::Zeros { len }, Vec::new(), len);
        }
        let mut parts = Vec::new();
        for live in given {
            let Some(live) = live else {
                parts.push(self.push(Layer::Zeros { len: hidden }, Vec::new(), hidden)?);
                continue;
            };
            let part = self.narrowed(&live)?;
            if self.lens.get(part.layer) != Some(&hidden) || !part.places.iter().copied().eq(0..hidden as u32) {
                return Err(format!(
                    "a first state of shape {:?} that is not {hidden} values in a row",
                    live.shape
                ));
            }
            parts.push(part.layer);
        }
        match *parts.as_slice() {
            [only] => Ok(only),
            _ => self.push(Layer::Concat { parts }, Vec::new(), 2 * hidden),
        }
    }

    pub(super) fn recurrent(&mut self, node: &'a Node) -> Result<(), String> {
        let is_gru = node.op_type == "GRU";
        refuse_unknown_recurrence(node, is_gru)?;
        let x = self.live(node, 0)?;
        let (w, r) = (self.constant(node, 1)?, self.constant(node, 2)?);
        let ([steps, 1, inputs], [1, _, wide], [1, _, hidden]) =
            (x.shape.as_slice(), w.shape.as_slice(), r.shape.as_slice())
        else {
            return Err(format!("shapes {:?}, {:?}, {:?}", x.shape, w.shape, r.shape));
        };
        let (steps, inputs, hidden) = (*steps, *inputs, *hidden);
        let rows = (if is_gru { 3_usize } else { 4 }).saturating_mul(hidden);
        if *wide != inputs || w.shape[1] != rows || r.shape[1] != rows || steps > 256 || hidden == 0 {
            return Err(format!("shapes {:?}, {:?}, {:?}", x.shape, w.shape, r.shape));
        }
        if self.optional(node, 4)?.is_some() {
            return Err("sequence_lens is not supported".to_owned());
        }
        let bias = self.optional(node, 3)?;
        let bias = match &bias {
            Some(bias) if bias.len() == 2 * rows => bias.real()?.to_vec(),
            Some(bias) => return Err(format!("a bias of shape {:?}", bias.shape)),
            None => vec![0.0; 2 * rows],
        };
        let state_len = if is_gru { hidden } else { 2 * hidden };
        let mut state = self.first_state(node, is_gru, hidden)?;
        let names: Vec<&str> = (1..4).map(|i| node.input.get(i).map_or("", String::as_str)).collect();
        let mut outputs = Vec::new();
        for step in 0..steps {
            let places = Rc::new(x.places[step * inputs..(step + 1) * inputs].to_vec());
            let part = Live::of(x.layer, vec![1, inputs], places);
            let part = self.narrowed(&part)?;
            let inputs = self.lens.get(part.layer).copied().unwrap_or(0);
            let weights = RecurrentWeights {
                is_gru,
                names: names.clone(),
                places: part.places.clone(),
                inputs,
            };
            // The same weights, in this node or an earlier one, are kept once.
            let kept = self.recurrent_weights.iter().find(|(kept, _)| *kept == weights);
            let (x, number) = (part.layer, self.lens.len());
            let (params_of, params) = match kept {
                Some((_, layer)) => (*layer, Vec::new()),
                None => {
                    let params = weights.params(hidden, w.real()?, r.real()?, &bias)?;
                    self.recurrent_weights.push((weights, number));
                    (number, params)
                }
            };
            let layer = match is_gru {
                true => Layer::Gru {
                    x,
                    h: state,
                    layer: Gru { inputs, hidden },
                    params_of,
                },
                false => Layer::Lstm {
                    x,
                    state,
                    layer: Lstm {
                        inputs,
                        hidden,
                        cell: Activation::TANH,
                    },
                    params_of,
                },
            };
            state = self.push(layer, params, state_len)?;
            outputs.push(state);
        }
        self.recurrent_outputs(node, outputs, [steps, hidden, state_len])
    }

    /// All steps' states, the last one, and an LSTM's last cells: each where it is wanted.
    fn recurrent_outputs(
        &mut self,
        node: &'a Node,
        states: Vec<usize>,
        [steps, hidden, state_len]: [usize; 3],
    ) -> Result<(), String> {
        let wanted = |i: usize| node.output.get(i).is_some_and(|name| !name.is_empty());
        let state = states.last().copied().ok_or("it has no steps")?;
        if wanted(0) {
            // One after the other; of an LSTM with the cells between them.
            let all = self.push(Layer::Concat { parts: states }, Vec::new(), steps * state_len)?;
            let places = (0..steps).flat_map(|step| (0..hidden).map(move |i| (step * state_len + i) as u32));
            let value = Live::of(all, vec![steps, 1, 1, hidden], Rc::new(places.collect()));
            self.set(node, 0, Value::Live(value))?;
        }
        for from in (0..state_len).step_by(hidden) {
            let i = 1 + from / hidden;
            if wanted(i) {
                let places = Rc::new((from as u32..(from + hidden) as u32).collect());
                let last = Live::of(state, vec![1, 1, hidden], places);
                self.set(node, i, Value::Live(last.shared()))?;
            }
        }
        Ok(())
    }
}

/// Refuses what no layer here computes.
fn refuse_unknown_recurrence(node: &Node, is_gru: bool) -> Result<(), String> {
    if let Some(direction) = node.word("direction").filter(|word| word != "forward") {
        return Err(format!("direction = {direction} is not supported"));
    }
    node.only("layout", 0)?;
    node.only("input_forget", 0)?;
    let usual: &[&[u8]] = match is_gru {
        true => &[b"Sigmoid", b"Tanh"],
        false => &[b"Sigmoid", b"Tanh", b"Tanh"],
    };
    let activations = node.get("activations");
    if activations.is_some_and(|given| given.strings != usual) || node.get("clip").is_some() {
        return Err("other activations, or clipped ones, are not supported".to_owned());
    }
    if is_gru && node.whole("linear_before_reset", 0) != 1 {
        return Err("linear_before_reset = 0 is not supported; PyTorch exports 1".to_owned());
    }
    match node.input.get(7).is_some_and(|name| !name.is_empty()) {
        true => Err("peepholes are not supported".to_owned()),
        false => Ok(()),
    }
}
