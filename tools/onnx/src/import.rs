//! From ONNX's nodes to layers.
//!
//! A tensor of the graph is a constant, or values of one layer: which, and where each of the tensor's values is there. Layers
//! keep images as `[row][column][channel]`, so reshaping, transposing, cutting and joining only change these places, and the
//! next layer's weights are put in their order.

mod elementwise;
mod importer;
mod inputs;
mod needed;
mod nodes;
mod places;
mod recurrent;
mod weighted;

use crate::adapter::Adapter;
use crate::beside;
use crate::proto::{Graph, Model};
use importer::Importer;
use needed::Needed;
use prost::Message;
use vigil_nnet::Isa;
use vigil_policy::FrozenPolicy;

/// Why a model is not imported: what cannot be read, is not known or does not fit, and where.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct ImportError(String);

/// Makes a policy of a model. `file` names it in errors; `beside` reads a file of weights that the model names, from its own folder.
///
/// # Errors
/// [`ImportError`]: what cannot be read, is not known, does not fit, or is too large for the step.
pub fn import(
    file: &str,
    bytes: &[u8],
    beside: &dyn Fn(&str) -> Result<Vec<u8>, String>,
    adapter: &Adapter,
) -> Result<FrozenPolicy, ImportError> {
    let mut model =
        Model::decode(bytes).map_err(|source| ImportError(format!("{file} is truncated or not ONNX: {source}")))?;
    let of_model = |message: String| ImportError(format!("{file}: {message}"));
    let graph = model
        .graph
        .as_mut()
        .ok_or_else(|| of_model("it holds no graph".to_owned()))?;
    beside::bring_in(graph, beside).map_err(of_model)?;
    let graph = &*graph;
    let action = action_name(graph, adapter.output.as_deref()).map_err(of_model)?;
    let needed = Needed::by(graph, action);
    let mut importer = Importer::new(graph, action, &needed).map_err(of_model)?;
    let inputs = importer.inputs(graph, action, &needed, adapter).map_err(of_model)?;
    let nodes = graph.node.iter().enumerate();
    for (number, node) in nodes.filter(|(number, _)| needed.nodes.get(*number) == Some(&true)) {
        importer.node(node).map_err(|message| {
            let output = node.output.first().filter(|_| node.name.is_empty());
            let (name, operator) = (output.unwrap_or(&node.name), &node.op_type);
            ImportError(format!("{file}, node {number} `{name}` ({operator}): {message}"))
        })?;
    }
    importer.output(action).map_err(of_model)?;
    let params = importer.params.concat();
    let frame = inputs.frame_input;
    let split = match adapter.split.as_deref() {
        None => importer.network.proposed_split(&params, frame),
        Some(name) => Some(importer.split_point(graph, name, &params, frame).map_err(of_model)?),
    };
    let policy = FrozenPolicy {
        network: importer.network,
        params,
        split,
        inputs,
        source: format!("{} {}", model.producer_name, graph.name).trim().to_owned(),
    };
    policy.network.check().map_err(|e| of_model(e.to_string()))?;
    let flies = policy.pilot(Isa::PORTABLE, false);
    flies.map_err(|e| ImportError(e.to_string()))?;
    Ok(policy)
}

/// The output that is the action.
fn action_name<'a>(graph: &'a Graph, wanted: Option<&str>) -> Result<&'a str, String> {
    let names: Vec<&str> = graph.output.iter().map(|output| output.name.as_str()).collect();
    match (wanted, names.as_slice()) {
        (Some(wanted), _) => {
            let found = names.iter().find(|name| **name == wanted).copied();
            found.ok_or_else(|| format!("there is no output `{wanted}`, only {}", names.join(", ")))
        }
        (None, [one]) => Ok(one),
        (None, _) => Err(format!(
            "it has {} outputs ({}); name the action's with --action",
            names.len(),
            names.join(", ")
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::importer::{Importer, Live, Value, identity};
    use crate::constant::{Constant, Data};
    use crate::proto::{Attribute, Node};
    use std::rc::Rc;
    use vigil_policy::imported::Layer;

    #[test]
    fn shapes_of_other_ranks_or_beyond_all_numbers_and_divisions_by_zero_are_refused() {
        for (operator, name, i, shapes, said) in [
            ("Concat", "axis", 1, vec![vec![1, 16], vec![1]], "shape"),
            (
                "Conv",
                "group",
                1 << 20,
                vec![vec![1, 1, 4, 4], vec![0, 1 << 50, 1, 1]],
                "shape",
            ),
            (
                "LSTM",
                "hidden_size",
                1,
                vec![vec![1, 1, 16], vec![1, 0, 16], vec![1, 0, 1 << 62]],
                "shape",
            ),
            // Its alpha is 0.
            ("Celu", "alpha", 0, vec![vec![1, 16]], "not finite (a division by zero"),
        ] {
            let name = name.to_owned();
            let node = Node {
                input: (0..shapes.len()).map(|i| i.to_string()).collect(),
                output: vec!["y".to_owned()],
                op_type: operator.to_owned(),
                attribute: vec![Attribute {
                    name,
                    i,
                    ..Attribute::default()
                }],
                ..Node::default()
            };
            let mut importer = Importer::default();
            importer.push(Layer::Input { len: 16 }, Vec::new(), 16).unwrap();
            for (name, shape) in node.input.iter().zip(shapes) {
                let data = Data::Real(vec![0.0; shape.iter().product()]);
                let value = match importer.tensors.is_empty() {
                    true => Value::Live(Live::of(0, shape, identity(16))),
                    false => Value::Constant(Rc::new(Constant { shape, data })),
                };
                importer.tensors.insert(name, value);
            }
            let refused = importer.node(&node).unwrap_err();
            assert!(refused.contains(said), "{operator}: {refused}");
        }
    }
}
