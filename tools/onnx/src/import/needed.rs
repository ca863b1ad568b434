//! What an action is computed from.

use crate::constant::Constant;
use crate::proto::{Graph, Node};
use std::collections::{BTreeMap, HashMap, HashSet};

/// What the action is computed from: nothing else of a model is looked at.
#[derive(Default)]
pub(super) struct Needed<'a> {
    /// By their numbers, in the order of computation.
    pub(super) nodes: BTreeMap<usize, &'a Node>,
    pub(super) tensors: HashSet<&'a str>,
    /// Outputs of nodes that are [`is_softplus_in_pieces`]: their third input, the others are not computed.
    pub(super) pieces: HashSet<&'a str>,
}

impl<'a> Needed<'a> {
    pub(super) fn by(graph: &'a Graph, action: &'a str) -> Self {
        let mut producers = HashMap::new();
        for (number, node) in graph.node.iter().enumerate() {
            for output in node.output.iter().filter(|output| !output.is_empty()) {
                producers.entry(output.as_str()).or_insert(number);
            }
        }
        let (mut nodes, mut tensors, mut pieces) = (BTreeMap::new(), HashSet::new(), HashSet::new());
        let mut open = vec![action];
        while let Some(name) = open.pop() {
            if !tensors.insert(name) {
                continue;
            }
            if let Some(number) = producers.get(name)
                && let Some(node) = graph.node.get(*number)
                && nodes.insert(*number, node).is_none()
            {
                let in_pieces = is_softplus_in_pieces(graph, |name| producers.get(name).copied(), node);
                if in_pieces {
                    pieces.insert(name);
                }
                let read = node.input.iter().skip(if in_pieces { 2 } else { 0 });
                open.extend(read.map(String::as_str).filter(|input| !input.is_empty()));
            }
        }
        Self { nodes, tensors, pieces }
    }
}

/// Whether a node is `x > threshold ? x : softplus(x)`, as PyTorch's softplus is written out: from 15 on both are the same number.
fn is_softplus_in_pieces(graph: &Graph, producer: impl Fn(&str) -> Option<usize>, node: &Node) -> bool {
    let [condition, x, softplus] = node.input.as_slice() else {
        return false;
    };
    let made_by = |name: &str, operator: &str| {
        let node = graph.node.get(producer(name)?)?;
        (node.op_type == operator).then_some(node.input.as_slice())
    };
    let threshold = |name: &str| {
        let tensor = graph.initializer.iter().find(|tensor| tensor.name == name);
        let constant = tensor.and_then(|tensor| Constant::of(tensor).ok());
        constant.is_some_and(|constant| constant.real().is_ok_and(|all| all.iter().all(|value| *value >= 15.0)))
    };
    node.op_type == "Where"
        && matches!(made_by(softplus, "Softplus"), Some([of]) if of == x)
        && matches!(made_by(condition, "Greater"), Some([of, bound]) if of == x && threshold(bound))
}

/// Values that bound others and do nothing else: only these may be infinite.
pub(super) fn bounds(graph: &Graph) -> HashSet<&str> {
    let (mut bounds, mut others) = (HashSet::new(), HashSet::new());
    for node in &graph.node {
        let of = match node.op_type.as_str() {
            "Clip" | "Min" | "Max" => &mut bounds,
            _ => &mut others,
        };
        of.extend(node.input.iter().map(String::as_str));
    }
    bounds.retain(|name| !others.contains(name));
    bounds
}
