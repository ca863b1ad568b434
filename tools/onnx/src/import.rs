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
    let mut importer = Importer::new(graph, action).map_err(of_model)?;
    let inputs = importer.inputs(graph, action, adapter).map_err(of_model)?;
    for (number, node) in importer.needed.nodes.clone() {
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
    let flies = policy.pilot(Isa::PORTABLE);
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
