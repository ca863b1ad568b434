//! Policies of others: how they are given our frames, what their files may say, and what is refused.

use vigil_nnet::{Activation, Conv2d, Dense, Isa, Purpose};
use vigil_policy::imported::{Channels, Depth, FrozenPolicy, Head, ImportedPilot, Layer, Network, PolicyInputs};
use vigil_policy::{Pilot, PilotInput};
use vigil_types::{DEPTH_COLS, DEPTH_ROWS, DepthFrame, GoalRelative};

/// A policy whose outputs are two chosen pixels of its frame.
fn picking(inputs: PolicyInputs, pixels: [usize; 2]) -> FrozenPolicy {
    let len = inputs.rows * inputs.cols * inputs.channels;
    let mut params = vec![0.0; 2 * len + 2];
    for (output, pixel) in pixels.into_iter().enumerate() {
        params[2 * pixel + output] = 1.0;
    }
    let (x, layer, curve) = (0, Dense::new(len, 2), Activation::Identity);
    let layers = vec![Layer::Input { len }, Layer::Dense { x, layer, curve }];
    FrozenPolicy {
        network: Network { layers, output: 1 },
        params,
        inputs,
        split: None,
        source: "a test".to_owned(),
    }
}

const INPUTS: PolicyInputs = PolicyInputs {
    rows: 4,
    cols: 8,
    channels: 3,
    order: Channels::Stack,
    depth: Depth::Range,
    scale: 1.0,
    frame_input: 0,
    has_position: false,
    output_scale: 1.0,
};

/// A frame whose pixels are `level` plus their column over 1000.
fn frame(level: f32) -> Box<DepthFrame> {
    let mut frame = Box::new(DepthFrame::EMPTY);
    for (i, pixel) in frame.depth.iter_mut().enumerate() {
        *pixel = level + (i % DEPTH_COLS) as f32 / 1000.0;
    }
    frame
}

fn decide(pilot: &mut ImportedPilot, frame: &DepthFrame) -> [f32; 2] {
    let action = pilot.decide(&PilotInput {
        height_m: 2.5,
        ..PilotInput::at_rest(frame, GoalRelative::new(10.0, 0.5))
    });
    [action.forward_m_s, action.yaw]
}

fn near(found: [f32; 2], expected: [f32; 2]) {
    for (a, b) in found.into_iter().zip(expected) {
        assert!((a - b).abs() < 1e-6, "{found:?} instead of {expected:?}");
    }
}

#[test]
fn a_policy_sees_the_middle_of_each_of_its_pixels_the_newest_frame_last() {
    // Pixel (1, 2) of 4 × 8: our column (2 · 2 + 1) · 256 / 16 = 80.
    let pixel = (8 + 2) * 3;
    let mut pilot = picking(INPUTS, [pixel, pixel + 2]).pilot(Isa::detect()).unwrap();
    assert_eq!((DEPTH_ROWS, DEPTH_COLS), (128, 256));
    near(decide(&mut pilot, &frame(0.1)), [0.18, 0.18]);
    near(decide(&mut pilot, &frame(0.2)), [0.18, 0.28]);
    near(decide(&mut pilot, &frame(0.3)), [0.18, 0.38]);
    near(decide(&mut pilot, &frame(0.4)), [0.28, 0.48]);
    // After a gap nothing is remembered.
    pilot.reset();
    near(decide(&mut pilot, &frame(0.5)), [0.58, 0.58]);
}

#[test]
fn pixels_are_scaled_and_outputs_limited_as_the_file_says() {
    let inputs = PolicyInputs {
        order: Channels::Repeat,
        depth: Depth::Contrast,
        scale: 255.0,
        output_scale: 0.004,
        ..INPUTS
    };
    let policy = picking(inputs, [0, 93]);
    let policy = FrozenPolicy::from_bytes("the file", &policy.to_bytes().unwrap()).unwrap();
    let mut pilot = policy.pilot(Isa::detect()).unwrap();
    let contrast = |range: f32| 1.02 / (1.0 + 100.0 / 3.0 * range);
    near(decide(&mut pilot, &frame(0.0)), [contrast(0.016), contrast(0.240)]);
    let wild = PolicyInputs {
        output_scale: 100.0,
        ..inputs
    };
    let mut pilot = picking(wild, [0, 93]).pilot(Isa::detect()).unwrap();
    near(decide(&mut pilot, &frame(0.0)), [1.5, 1.5]);
    // A pixel that is no number is a decision that is none: the caller holds.
    let mut blind = frame(0.0);
    blind.depth.fill(f32::NAN);
    assert!(decide(&mut pilot, &blind).iter().all(|value| value.is_nan()));
}

#[test]
fn a_file_comes_back_as_it_was_and_its_text_is_read_as_it_was_written() {
    let policy = picking(INPUTS, [1, 2]);
    let again = FrozenPolicy::from_bytes("the file", &policy.to_bytes().unwrap()).unwrap();
    assert_eq!(policy, again);
    assert_eq!(policy.sha256(), again.sha256());
    let text = "input 96\nzeros 4\nslice 0 3 48\ncurve 2 tanh*1.5\nconv2d 0 4 8 3 2 3 1 1 elu\nconcat 3 4\nbatch_norm 5 1 \
                0.001\nmax_pool2d 4 4 8 2 2\ndense 7 16 2 relu\ngru 3 1 48 4 9\nlstm 8 1 2 2 10\noutput 8\n";
    let network: Network = text.parse().unwrap();
    assert_eq!(network.to_string(), text);
    assert!(network.graph(Purpose::Multipliers).is_ok());
}

#[test]
fn hostile_descriptions_are_refused_before_anything_is_made_of_them() {
    let refused = |text: &str| text.parse::<Network>().unwrap_err().to_string();
    let doublings: String = (0..30).map(|layer| format!("concat {layer} {layer}\n")).collect();
    let doubled = format!("input 32768\n{doublings}output 30\n");
    for (text, reason) in [
        ("", "lack an output"),
        ("input 4\n", "lack an output"),
        ("input 4\noutput 1\n", "number 1 is the output"),
        ("input 99999999999\noutput 0\n", "a size of 99999999999"),
        ("input 4\ndense 1 4 2 relu\noutput 1\n", "does not come before it"),
        ("input 4\ndense 0 16000000 16000000 relu\noutput 1\n", "parameters"),
        (
            "input 4\nconv2d 0 128 256 1 64 15 1 7 relu\noutput 1\n",
            "multiply-adds",
        ),
        ("input 4\ncurve 0 softmax\noutput 1\n", "line 2"),
        (&doubled, "values"),
        ("input 4\ncurve 0 tanh*nan\noutput 1\n", "line 2"),
        ("input 4\noutput 0\ninput 4\n", "line 3"),
        ("input four\noutput 0\n", "line 1"),
        ("gru 0 0 4 4 0\noutput 0\n", "does not come before it"),
        // A layer of many rows would make more values than it says.
        (
            "input 32768\ndense 0 1 4096 identity\nslice 1 0 8\ndense 2 8 2 identity\noutput 3\n",
            "layer 1: dense of 1 inputs reads 32768 values",
        ),
    ] {
        let error = refused(text);
        assert!(error.contains(reason), "{text:?}: {error}");
    }
    // What does not fit each other is found before take-off.
    let spoils: [fn(&mut FrozenPolicy); 5] = [
        |policy| {
            policy.params.pop();
        },
        |policy| policy.inputs.cols = 9,
        |policy| policy.inputs.has_position = true,
        |policy| policy.inputs.channels = 0,
        |policy| {
            let (x, layer, curve) = (0, Conv2d::new([4, 8, 3], 1, 3, 0, 1), Activation::Relu);
            policy.network.layers[1] = Layer::Conv2d { x, layer, curve };
        },
    ];
    for spoil in spoils {
        let mut policy = picking(INPUTS, [0, 1]);
        spoil(&mut policy);
        let error = FrozenPolicy::from_bytes("the file", &policy.to_bytes().unwrap()).unwrap_err();
        assert!(error.to_string().contains("the file cannot be flown"), "{error}");
    }
}

/// A policy with two ways through it: frame → 12 values → 9 values, and the goal beside them.
fn branched(split: Option<usize>) -> FrozenPolicy {
    let text = "input 96\nconv2d 0 4 8 3 6 3 2 1 elu\ncurve 1 tanh*0.9\ndense 2 48 12 relu\ninput 2\nconcat 3 4\n\
                dense 5 14 9 elu\nconcat 6 4\ndense 7 11 2 tanh*1.5\noutput 8\n";
    let network: Network = text.parse().unwrap();
    let len = network.graph(Purpose::Gradients).unwrap().param_len();
    let params = (0..len).map(|i| ((i * 37 % 101) as f32 - 50.0) / 90.0).collect();
    let mut policy = picking(INPUTS, [0, 1]);
    policy.inputs.has_position = true;
    FrozenPolicy {
        network,
        params,
        split,
        ..policy
    }
}

#[test]
fn what_lies_behind_a_split_point_decides_as_the_whole_policy_does() {
    for split in [1, 2, 3, 5, 6, 7] {
        let policy = branched(Some(split));
        let Head { network, params, width } = policy.head().unwrap();
        let graph = network.graph(Purpose::Multipliers).unwrap();
        let mut pilot = policy.pilot(Isa::detect()).unwrap();
        assert_eq!(pilot.state(), None, "nothing was decided");
        let mut tape = vec![0.0; graph.tape_len()];
        for level in [0.1, 0.5, 0.3] {
            let decided = decide(&mut pilot, &frame(level));
            let (state, low_dim) = (pilot.state().unwrap(), pilot.low_dim().unwrap());
            assert_eq!(state.len(), width);
            graph
                .forward(Isa::detect(), &params, &[state, &low_dim], &mut tape)
                .unwrap();
            assert_eq!(graph.output(&tape).unwrap(), decided, "split at layer {split}");
        }
    }
}

#[test]
fn the_split_point_proposed_is_the_last_one_of_a_size_that_is_explained() {
    let policy = branched(None);
    assert_eq!(policy.network.proposed_split(&policy.params, 0), Some(6));
    // A curve that is a layer of its own belongs to the weights before it.
    let leaky = "input 96\nconv2d 0 4 8 3 6 3 2 1 identity\nfunction 1 leaky_relu*0.1\ndense 2 48 12 identity\nfunction 3 leaky_relu*0.1\ndense 4 12 2 identity\noutput 5\n";
    let leaky: Network = leaky.parse().unwrap();
    let params = vec![0.1; leaky.graph(Purpose::Gradients).unwrap().param_len()];
    assert_eq!(leaky.proposed_split(&params, 0), Some(4));
    // Of the picking policy nothing lies between frame and action.
    let nothing = picking(INPUTS, [1, 2]);
    assert_eq!(nothing.network.proposed_split(&nothing.params, 0), None);
    assert!(nothing.head().unwrap_err().to_string().contains("no split point"));
}

#[test]
fn a_layer_that_cannot_be_the_split_point_is_refused_with_its_reason() {
    let policy = branched(None);
    let refused = |split| policy.network.head(&policy.params, split, 0).unwrap_err().to_string();
    for (split, reason) in [
        (0, "the frame itself"),
        (4, "2 values"),
        (8, "2 values"),
        (90, "there are 9 layers"),
    ] {
        let error = refused(split);
        assert!(error.contains(reason), "layer {split}: {error}");
    }
    // The frame goes around the first of these.
    let text = "input 96\ndense 0 96 8 relu\ndense 0 96 8 relu\nconcat 1 2\ndense 3 16 2 id\noutput 4\n";
    let network: Network = text.replace("id\n", "identity\n").parse().unwrap();
    let len = network.graph(Purpose::Gradients).unwrap().param_len();
    let around = network.head(&vec![0.1; len], 1, 0).unwrap_err().to_string();
    assert!(around.contains("by another way"), "{around}");
    assert!(network.head(&vec![0.1; len], 3, 0).is_ok());
    // And so is a file that names such a layer.
    let bytes = branched(Some(6)).to_bytes().unwrap();
    assert_eq!(FrozenPolicy::from_bytes("the file", &bytes).unwrap().split, Some(6));
    let file = branched(Some(4)).to_bytes();
    let refused = file.and_then(|bytes| FrozenPolicy::from_bytes("the file", &bytes));
    assert!(refused.unwrap_err().to_string().contains("cannot be the split point"));
}

#[test]
fn a_slope_that_vanishes_at_the_limit_is_there_without_the_last_curve() {
    let policy = branched(None);
    let shown = policy.network.unsaturated(&policy.params).to_string();
    assert!(shown.contains("dense 7 11 2 identity"), "{shown}");
    assert!(shown.contains("curve 1 tanh*0.9"), "only the last one: {shown}");
    // The curve of a hidden layer is no limit of an output; that of outputs of which two are picked is one.
    let text = "input 4\ndense 0 4 16 tanh*1\ndense 1 16 2 identity\noutput 2\n";
    let network: Network = text.parse().unwrap();
    assert_eq!(network.unsaturated(&[0.5; 114]).to_string(), text);
    let mut picking = vec![0.0; 114];
    (picking[80], picking[83]) = (1.0, 1.0);
    let shown = network.unsaturated(&picking).to_string();
    assert!(shown.contains("dense 0 4 16 identity"), "{shown}");
}
