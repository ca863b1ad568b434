//! The inputs of a policy: which is the frame, how it lies, and where the goal is.

use super::importer::{Importer, Live, Value, identity, image_places};
use crate::adapter::{Adapter, Flat};
use crate::constant::len_of;
use crate::proto::{Graph, ValueInfo};
use std::collections::HashSet;
use std::rc::Rc;
use vigil_policy::imported::{Layer, PolicyInputs};

impl<'a> Importer<'a> {
    pub(super) fn inputs(&mut self, graph: &'a Graph, action: &str, adapter: &Adapter) -> Result<PolicyInputs, String> {
        let mut found = None;
        let mut positions = 0;
        // Old exports list the weights among the inputs.
        let weights: HashSet<&str> = graph.initializer.iter().map(|tensor| tensor.name.as_str()).collect();
        let real = graph.input.iter().filter(|input| {
            let name = input.name.as_str();
            self.needed.tensors.contains(name) && !weights.contains(name)
        });
        let real: Vec<&ValueInfo> = real.collect();
        if let Some(flat) = adapter.flat {
            return match real.as_slice() {
                [info] => self.flat_input(info, adapter, flat),
                _ => Err(format!("it has {} inputs; --flat is for policies with one", real.len())),
            };
        }
        for (number, info) in real.into_iter().enumerate() {
            let shape = sizes_of(info)?;
            let len = len_of(&shape)?;
            let places = match *shape.as_slice() {
                [1, a, b, c] if found.is_none() => {
                    // A single channel may be reshaped instead of transposed; an image of width 1 is none.
                    let channels_last = c == 1 && a > 1 || self.is_channels_last(&info.name).unwrap_or(c < a);
                    let (rows, cols, channels) = if channels_last { (a, b, c) } else { (b, c, a) };
                    found = Some(([rows, cols, channels], number));
                    match channels_last {
                        true => identity(len),
                        false => Rc::new(image_places(channels, rows, cols)),
                    }
                }
                [1, 2] if positions == 0 => {
                    positions += 1;
                    identity(len)
                }
                _ => {
                    let more = match *shape.as_slice() {
                        [1, _] => "; if it is a frame's values in a row, say so with --flat",
                        _ => "; a state that goes from one decision to the next is not supported",
                    };
                    return Err(format!(
                        "the input `{}` has the shape {shape:?}; a policy gets one frame [1, channels, rows, columns] (or \
                         channels last, if it is transposed first), and beside it [1, 2], distance and bearing of the goal{more}",
                        info.name
                    ));
                }
            };
            let layer = self.push(Layer::Input { len }, Vec::new(), len)?;
            let value = Live::of(layer, shape, places);
            self.tensors.insert(&info.name, Value::Live(value));
        }
        let (size, number) = found.ok_or_else(|| {
            format!(
                "the action `{action}` depends on no frame: none of shape [1, channels, rows, columns] among the inputs that it is \
                 computed from"
            )
        })?;
        Ok(adapter.inputs(size, number, positions == 1))
    }

    /// The one input of a policy that takes its frame as a row of values.
    fn flat_input(&mut self, info: &'a ValueInfo, adapter: &Adapter, flat: Flat) -> Result<PolicyInputs, String> {
        let shape = sizes_of(info)?;
        let [a, b, c] = flat.frame;
        let (rows, cols, channels) = if c < a { (a, b, c) } else { (b, c, a) };
        let len = len_of(&flat.frame)?;
        let has_position = flat.goal_first.is_some();
        let wanted = len + if has_position { 2 } else { 0 };
        if shape != [1, wanted] {
            return Err(format!(
                "the input `{}` has the shape {shape:?}; --flat says [1, {wanted}], a frame of {rows} × {cols} with {channels} channels{}",
                info.name,
                if has_position { " and the goal" } else { "" }
            ));
        }
        let of_frame = match c < a {
            true => (0..len as u32).collect(),
            false => image_places(channels, rows, cols),
        };
        let mut layer = self.push(Layer::Input { len }, Vec::new(), len)?;
        let mut places = of_frame;
        if has_position {
            let goal = self.push(Layer::Input { len: 2 }, Vec::new(), 2)?;
            let parts = vec![layer, goal];
            layer = self.push(Layer::Concat { parts }, Vec::new(), wanted)?;
            let of_goal = [len as u32, len as u32 + 1];
            match flat.goal_first {
                Some(true) => places.splice(0..0, of_goal).for_each(drop),
                _ => places.extend(of_goal),
            }
        }
        let value = Live::of(layer, shape, Rc::new(places));
        self.tensors.insert(&info.name, Value::Live(value));
        Ok(adapter.inputs([rows, cols, channels], 0, has_position))
    }

    /// Whether a frame's channels are its last axis: it is transposed before a layer looks at it as an image; `None` where none does.
    fn is_channels_last(&self, frame: &str) -> Option<bool> {
        let mut of_frame = HashSet::from([frame]);
        for node in self.needed.nodes.values() {
            if !node.input.iter().any(|input| of_frame.contains(input.as_str())) {
                continue;
            }
            match node.op_type.as_str() {
                "Transpose" => return Some(node.list("perm") == Some(&[0, 3, 1, 2])),
                "Conv" | "MaxPool" | "AveragePool" => return Some(false),
                // What they give is no frame.
                "Gemm" | "MatMul" | "GlobalAveragePool" | "GlobalMaxPool" | "Concat" | "Shape" => {}
                _ => of_frame.extend(node.output.iter().map(String::as_str)),
            }
        }
        None
    }
}

fn sizes_of(info: &ValueInfo) -> Result<Vec<usize>, String> {
    let name = &info.name;
    let shape = info
        .r#type
        .as_ref()
        .and_then(|t| t.tensor_type.as_ref())
        .and_then(|t| t.shape.as_ref())
        .ok_or_else(|| format!("the input `{name}` has no shape"))?;
    let sizes = shape.dim.iter().enumerate().map(|(i, dim)| match dim.dim_value {
        1.. => usize::try_from(dim.dim_value).map_err(|e| e.to_string()),
        // Policies are exported for batches of any size; one decision is a batch of one.
        _ if i == 0 => Ok(1),
        _ => Err(format!(
            "the input `{name}` has a dynamic size `{}` at axis {i}: export the policy with fixed sizes",
            dim.dim_param
        )),
    });
    sizes.collect()
}
