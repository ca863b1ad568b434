//! Weights in files beside the model, as PyTorch's exporter writes them.

use crate::proto::{Graph, Tensor};
use std::collections::HashMap;
use std::path::{Component, Path};

/// Puts the data of all tensors that lie in other files into the model. `read` reads a file of the model's folder.
///
/// # Errors
/// A name that leads out of the folder, a file that cannot be read, a place that is not in it.
pub fn bring_in(graph: &mut Graph, read: &dyn Fn(&str) -> Result<Vec<u8>, String>) -> Result<(), String> {
    let mut files = HashMap::new();
    let of_nodes = graph.node.iter_mut().flat_map(|node| &mut node.attribute);
    let tensors = of_nodes.filter_map(|attribute| attribute.t.as_mut());
    for tensor in tensors.chain(&mut graph.initializer).filter(|t| t.data_location == 1) {
        let said = |e: String| format!("the tensor `{}`: {e}", tensor.name);
        let raw_data = data_of(tensor, &mut files, read).map_err(said)?;
        (tensor.raw_data, tensor.data_location) = (raw_data, 0);
    }
    Ok(())
}

fn data_of(
    tensor: &Tensor,
    files: &mut HashMap<String, Vec<u8>>,
    read: &dyn Fn(&str) -> Result<Vec<u8>, String>,
) -> Result<Vec<u8>, String> {
    let entry = |key: &str| tensor.external_data.iter().find(|entry| entry.key == key);
    let number = |key: &str| match entry(key).map(|entry| entry.value.parse::<usize>()) {
        None => Ok(None),
        Some(Ok(number)) => Ok(Some(number)),
        Some(Err(_)) => Err(format!("the {key} of its data is no number")),
    };
    let name = &entry("location")
        .ok_or("its data are in another file that is not named")?
        .value;
    let inside = Path::new(name)
        .components()
        .all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
    if name.is_empty() || !inside {
        return Err(format!("its data are in `{name}`, which is not in the model's folder"));
    }
    if !files.contains_key(name) {
        let content = read(name).map_err(|e| {
            format!("its data are in `{name}`, which has to lie beside the model: {e}; or save the model in one file")
        })?;
        files.insert(name.clone(), content);
    }
    let file = files.get(name).map_or(&[][..], Vec::as_slice);
    let from = number("offset")?.unwrap_or(0);
    let to = match number("length")? {
        Some(len) => from.saturating_add(len),
        None => file.len(),
    };
    let (data, len) = (file.get(from..to).map(<[u8]>::to_vec), file.len());
    data.ok_or_else(|| format!("its data are at {from} to {to} of `{name}`, which has {len} bytes"))
}
