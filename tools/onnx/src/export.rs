//! From layers to ONNX's nodes.
//!
//! Every value is a row `[1, length]`, as our layers keep it; images are put into ONNX's order of channels, rows, columns before a
//! convolution and back after it, which runtimes do away with.

mod writer;

use crate::proto::{Entry, Graph, Model, Node, OperatorSet};
use prost::Message;
use vigil_nnet::{Activation, Dense, Params};
use vigil_policy::actor::{ACTOR_LIMIT, ActorSpec, CONTEXT, LOW_DIM};
use vigil_policy::imported::{Layer, Network, NetworkError};
use vigil_policy::{FrozenActor, FrozenPilot, FrozenPolicy};
use writer::{Input, Writer, value_info, value_of};

/// Operators as of ONNX 1.12 (2022), which every runtime in use knows.
const OPERATOR_SET: i64 = 17;
/// Of the same release.
const IR_VERSION: i64 = 8;

/// A pilot's network as a model of ONNX. Inputs of an actor of ours: `frame` `[1, 1, 128, 256]`, ranges over 100 m, `context` `[1, 328]`,
/// what it remembers ([`CONTEXT`]), and `low_dim` `[1, 8]` ([`LOW_DIM`]); of an imported policy `frame` `[1, channels, rows, columns]` and,
/// if it has one, `position` `[1, 2]`. Output: `action` `[1, 2]`, of an imported policy before its
/// factor. What is to be known beside it is in the model's metadata. With it comes the name of the imported policy's split point in the
/// model, if it has one.
pub fn export(pilot: &FrozenPilot) -> Result<(Vec<u8>, Option<String>), NetworkError> {
    let (network, params, inputs, about) = match pilot {
        FrozenPilot::Actor(actor) => (of_actor(), &actor.params, inputs_of_actor(), about_actor(actor)),
        FrozenPilot::Imported(policy) => {
            policy.network.check()?;
            let network = policy.network.clone();
            (network, &policy.params, inputs_of_policy(policy), about_policy(policy))
        }
    };
    let mut writer = Writer {
        params,
        graph: Graph {
            name: "vigil".to_owned(),
            ..Default::default()
        },
    };
    let mut values: Vec<(String, usize)> = Vec::new();
    let mut inputs = inputs.iter();
    let (mut placed, mut at): (Vec<Params>, usize) = (Vec::new(), 0);
    for (number, layer) in network.layers.iter().enumerate() {
        let own = Params {
            at,
            len: layer.param_len(),
        };
        // Those of an earlier layer, or its own.
        let params = layer
            .params_of(number)
            .and_then(|of| placed.get(of).copied())
            .unwrap_or(own);
        at += if params == own { own.len } else { 0 };
        placed.push(params);
        let value = writer.layer(layer, params, &values, &mut inputs)?;
        values.push(value);
    }
    let (output, len) = value_of(&values, network.output)?;
    writer.graph.node.push(Node {
        input: vec![output.to_owned()],
        output: vec!["action".to_owned()],
        name: "action".to_owned(),
        op_type: "Identity".to_owned(),
        ..Node::default()
    });
    writer.graph.output.push(value_info("action", &[1, len]));
    let entry = |(key, value): (&str, String)| Entry {
        key: key.to_owned(),
        value,
    };
    let model = Model {
        ir_version: IR_VERSION,
        producer_name: "vigil".to_owned(),
        producer_version: env!("CARGO_PKG_VERSION").to_owned(),
        graph: Some(writer.graph),
        opset_import: vec![OperatorSet {
            domain: String::new(),
            version: OPERATOR_SET,
        }],
        metadata_props: about.into_iter().map(entry).collect(),
    };
    let split = match pilot {
        FrozenPilot::Imported(policy) => policy.split.and_then(|layer| values.get(layer)),
        FrozenPilot::Actor(_) => None,
    };
    Ok((model.encode_to_vec(), split.map(|(name, _)| name.clone())))
}

fn inputs_of_policy(policy: &FrozenPolicy) -> Vec<Input> {
    let own = &policy.inputs;
    let mut inputs = vec![("frame", vec![1, own.channels, own.rows, own.cols])];
    if own.has_position {
        inputs.insert(1 - own.frame_input.min(1), ("position", vec![1, 2]));
    }
    inputs
}

fn inputs_of_actor() -> Vec<Input> {
    let spec = ActorSpec::FULL;
    vec![
        ("frame", vec![1, 1, spec.rows, spec.cols]),
        ("context", vec![1, CONTEXT]),
        ("low_dim", vec![1, LOW_DIM]),
    ]
}

/// An actor of ours as layers, whose parameters stand in the order of [`ActorSpec::reserve`].
fn of_actor() -> Network {
    let spec = ActorSpec::FULL;
    let mut layers: Vec<Layer> = Vec::new();
    let mut push = |layer: Layer| {
        layers.push(layer);
        layers.len() - 1
    };
    let [frame, context, low] = [spec.frame_len(), CONTEXT, LOW_DIM].map(|len| push(Layer::Input { len }));
    let curved = |x, curve| Layer::Curve { x, curve };
    let dense = |x, layer: Dense, curve| Layer::Dense { x, layer, curve };
    let joined = |parts: [usize; 2]| Layer::Concat { parts: parts.to_vec() };
    // The encoder.
    let mut x = push(curved(frame, Activation::NEAR_CONTRAST));
    for layer in spec.convolutions() {
        let curve = Activation::Elu;
        x = push(Layer::Conv2d { x, layer, curve });
    }
    let scan = push(dense(x, spec.scan(), Activation::Sigmoid));
    // The trunk.
    let mut x = push(joined([scan, context]));
    for layer in spec.trunk() {
        x = push(dense(x, layer, Activation::Identity));
        let layer = ActorSpec::norm(layer);
        x = push(Layer::LayerNorm { x, layer });
        x = push(curved(x, Activation::Elu));
    }
    let state = push(dense(x, spec.state(), Activation::Identity));
    // The second half.
    let state = push(curved(state, Activation::TANH));
    let low = push(dense(low, spec.low(), Activation::TANH));
    let mut x = push(joined([state, low]));
    for layer in spec.head() {
        x = push(dense(x, layer, Activation::Elu));
    }
    let scale = ACTOR_LIMIT;
    let output = push(dense(x, spec.output(), Activation::Tanh { scale }));
    Network { layers, output }
}

fn about_actor(actor: &FrozenActor) -> Vec<(&'static str, String)> {
    let context = "older scans moved to here, remembered surfaces, own trail: docs/architecture.md";
    let low_dim = "goal, own motion, last action: docs/architecture.md";
    let unit_m_s = actor.cruise_m_s / ACTOR_LIMIT;
    let action = format!("forward speed in units of {unit_m_s} m/s; yaw in units of 30 degrees/s, clockwise");
    vec![
        ("sha256", actor.sha256()),
        ("frame", "range / 100 m, 0 to 1".to_owned()),
        ("context", context.to_owned()),
        ("low_dim", low_dim.to_owned()),
        ("action", action),
    ]
}

fn about_policy(policy: &FrozenPolicy) -> Vec<(&'static str, String)> {
    let inputs = &policy.inputs;
    vec![
        ("sha256", policy.sha256()),
        ("source", policy.source.clone()),
        ("channels", inputs.order.name().to_owned()),
        ("depth", inputs.depth.name().to_owned()),
        ("scale", inputs.scale.to_string()),
        ("output_scale", inputs.output_scale.to_string()),
    ]
}
