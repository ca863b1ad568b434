//! Explains a network of your own by DeepSHAP: which input moved the output, away from what is usual?
//!
//! `cargo run --release -p vigil-detector --example explain_your_network`

use vigil_detector::{DeepShap, ShapError};
use vigil_nnet::{Activation, Dense, Graph, GraphBuilder, Isa, Purpose, ShapeError};

/// Three inputs, four hidden units, one output.
fn network() -> Result<Graph, ShapeError> {
    let hidden = Dense { inputs: 3, outputs: 4 };
    let last = Dense { inputs: 4, outputs: 1 };
    let mut b = GraphBuilder::new();
    let (first, second) = (b.params(hidden.param_len()), b.params(last.param_len()));
    let x = b.input(3, true)?;
    let h = b.dense(x, hidden, Activation::Elu, first)?;
    let y = b.dense(h, last, Activation::TANH, second)?;
    b.finish(y, Purpose::Multipliers)
}

/// Weights `[inputs][outputs]` and biases, layer after layer: the second input counts twice as much as the first, the third not.
const PARAMS: [f32; 21] = [
    0.5, -0.5, 0.3, 0.1, 1.0, -1.0, 0.6, 0.2, 0.0, 0.0, 0.0, 0.0, 0.1, 0.1, 0.0, 0.0, // hidden
    0.6, -0.4, 0.5, 0.2, 0.0, // output
];

fn main() -> Result<(), ShapError> {
    // What is usual: the explanation counts from the mean output of these.
    let usual: [[&[f32]; 1]; 2] = [[&[0.0, 0.0, 0.0]], [&[0.2, -0.1, 0.5]]];
    let mut shap = DeepShap::new(Isa::detect(), network()?, &PARAMS, &usual)?;
    let output = shap.evaluate(&[&[0.8, 0.8, 3.0]])?[0];
    let mut phi = vec![0.0; shap.phi_len()];
    shap.attribute(0, &mut phi)?;
    println!("output {output:.4}, usually {:.4}", shap.expected()[0]);
    for (input, phi) in phi.iter().enumerate() {
        println!("input {input} moved it by {phi:+.4}");
    }
    let sum: f32 = phi.iter().sum();
    println!("all of them by {sum:+.4}, which is the difference");
    assert!((sum - (output - shap.expected()[0])).abs() < 1e-5 && phi[2].abs() < 1e-6);
    Ok(())
}
