"""Writes policies of many shapes as ONNX, with random weights, and what ONNX Runtime makes of random inputs.

Usage: onnx_models.py FOLDER. For each model NAME.onnx, NAME.inputs.json (frames as [row][column][channel]) and
NAME.outputs.json; and models that must be refused, in FOLDER/refused.
"""

import inspect
import json
import sys
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
from onnx import TensorProto, helper, numpy_helper

RNG = np.random.default_rng(7)


class Build:
    """A graph in the making: every call of an operator is a node, arrays are constants."""

    def __init__(self, **inputs):
        self.nodes, self.constants = [], []
        self.inputs = inputs

    def constant(self, array):
        name = f"c{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.asarray(array), name))
        return name

    def __getattr__(self, operator):
        def add(*inputs, outputs=1, domain="", **attributes):
            names = [i if isinstance(i, str) else self.constant(i) for i in inputs]
            results = [f"n{len(self.nodes)}_{i}" for i in range(outputs)]
            node = helper.make_node(operator, names, results, name=f"node_{len(self.nodes)}", domain=domain, **attributes)
            self.nodes.append(node)
            return results[0] if outputs == 1 else results

        return add

    def weights(self, *shape, gain=1.0):
        inputs = int(np.prod(shape[1:])) or 1
        return (gain * RNG.normal(size=shape) / np.sqrt(inputs)).astype(np.float32)

    def conv(self, x, channels, filters, kernel, **attributes):
        group = attributes.get("group", 1)
        w = self.weights(filters, channels // group, kernel, kernel)
        return self.Conv(x, w, self.weights(filters, 1)[:, 0], kernel_shape=[kernel] * 2, **attributes)

    def gemm(self, x, inputs, outputs):
        return self.Gemm(x, self.weights(outputs, inputs), self.weights(outputs, 1)[:, 0], transB=1)

    def model(self, *outputs):
        graph = helper.make_graph(
            self.nodes,
            "policy",
            [helper.make_tensor_value_info(n, TensorProto.FLOAT, s) for n, s in self.inputs.items()],
            [helper.make_tensor_value_info(o, TensorProto.FLOAT, ["rows", "values"]) for o in outputs],
            self.constants,
        )
        return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


def three_channels_last():
    b = Build(frame=[1, 64, 96, 3])
    x = b.Transpose("frame", perm=[0, 3, 1, 2])
    x = b.Relu(b.conv(x, 3, 8, 8, strides=[4, 4]))
    x = b.Relu(b.conv(x, 8, 8, 4, strides=[2, 2]))
    return b.model(b.gemm(b.Flatten(x), 8 * 6 * 10, 2))


def one_channel_last_by_tf2onnx():
    """Keras: a single channel is not transposed but reshaped."""
    b = Build(frame=["batch", 24, 32, 1])
    x = b.Relu(b.conv(b.Reshape("frame", np.array([-1, 1, 24, 32])), 1, 6, 4, strides=[4, 4]))
    return b.model(b.gemm(b.Flatten(x), 6 * 6 * 8, 2))


def average_pooling():
    b = Build(frame=[1, 1, 32, 48])
    x = b.AveragePool("frame", kernel_shape=[2, 2], strides=[2, 2])
    x = b.Sigmoid(b.conv(x, 1, 7, 3))
    x = b.AveragePool(x, kernel_shape=[3, 3], strides=[2, 2], pads=[1] * 4, count_include_pad=1)
    x = b.GlobalAveragePool(x)
    return b.model(b.gemm(b.Flatten(x), 7, 2))


def norm(b, x, channels):
    row = lambda: b.weights(channels, 1)[:, 0]  # noqa: E731
    return b.BatchNormalization(x, row(), row(), row(), np.abs(row()) + np.float32(0.3), epsilon=1e-4)


def batch_norm_before_and_after_curves():
    b = Build(frame=[1, 1, 20, 28])
    x = b.Relu(norm(b, b.conv("frame", 1, 6, 3), 6))
    x = norm(b, b.Relu(b.conv(x, 6, 4, 3)), 4)
    x = norm(b, b.gemm(b.Flatten(x), 4 * 16 * 24, 10), 10)
    x = norm(b, b.Tanh(x), 10)
    row = np.array([0.5, 2.0], np.float32)
    several_rows = b.BatchNormalization(b.Reshape(x, np.array([5, 2])), row, row, row, row)
    return b.model(b.gemm(b.Reshape(several_rows, np.array([1, 10])), 10, 2))


def products_and_sums():
    b = Build(frame=[1, 1, 16, 24])
    x = b.Reshape("frame", np.array([1, -1]))
    x = b.Add(b.MatMul(x, b.weights(384, 20)), b.weights(20, 1)[:, 0])
    x = b.Elu(x)
    x = b.Div(b.Sub(b.Mul(x, np.float32(1.7)), b.weights(1, 20)), np.float32(0.6))
    x = b.Sub(np.float32(0.3), x)
    x = b.Add(b.weights(2, 1)[:, 0], b.MatMul(x, b.weights(20, 2)))
    return b.model(b.Mul(b.Tanh(x), np.float32(1.5)))


def goal_beside_the_frame():
    b = Build(goal=[1, 2], frame=[1, 1, 24, 32])
    x = b.Relu(b.conv("frame", 1, 4, 4, strides=[4, 4]))
    g = b.Tanh(b.gemm("goal", 2, 6))
    x = b.Concat(b.Flatten(x), g, axis=1)
    x = b.Relu(b.gemm(x, 4 * 6 * 8 + 6, 16))
    return b.model(b.gemm(b.Concat(x, "goal", axis=-1), 18, 2))


def at_its_limit():
    b = Build(goal=[1, 2], frame=[1, 1, 24, 32])
    x = b.Mul(b.gemm(b.Flatten("frame"), 768, 2), b.Log(b.Abs("goal")))
    return b.model(b.Clip(b.Tanh(b.Mul(x, np.float32(1e4))), np.float32(-0.5), np.float32(0.5)))


def recurrent(operator, gates):
    b = Build(frame=[1, 1, 8, 16])
    x = b.Reshape("frame", np.array([8, 1, 16]))
    hidden = 12
    more = {"activations": ["Sigmoid", "Tanh", "Tanh"]}
    if operator == "GRU":
        more = {"activations": ["Sigmoid", "Tanh"], "linear_before_reset": 1}
    w = b.weights(1, gates * hidden, 16)
    r = b.weights(1, gates * hidden, hidden, gain=4.0)
    call = getattr(b, operator)
    zeros = np.zeros((1, 1, hidden), np.float32)
    y, last = call(x, w, r, b.weights(1, 2 * gates * hidden), "", zeros, outputs=2, hidden_size=hidden, **more)
    y = b.Squeeze(b.Gather(y, np.array(3), axis=0), np.array([0]))
    last = b.Squeeze(last, np.array([0]))
    return b.model(b.gemm(b.Concat(y, last, axis=1), 2 * hidden, 2))


def gru():
    return recurrent("GRU", 3)


def lstm():
    return recurrent("LSTM", 4)


def gru_over_columns_of_features():
    b = Build(frame=[1, 1, 10, 14])
    x = b.Relu(b.conv("frame", 1, 3, 3))
    x = b.Transpose(x, perm=[3, 0, 1, 2])
    x = b.Reshape(x, np.array([12, 1, -1]))
    w, r = b.weights(1, 15, 24), b.weights(1, 15, 5)
    _, last = b.GRU(x, w, r, outputs=2, hidden_size=5, linear_before_reset=1)
    return b.model(b.gemm(b.Reshape(last, np.array([1, 5])), 5, 2))


def split_slice_and_concat():
    b = Build(frame=[1, 4, 9, 12])
    left, right = b.Split("frame", axis=1, outputs=2)
    middle = b.Slice("frame", np.array([1, 2]), np.array([3, 2**31]), np.array([1, 3]), np.array([1, 3]))
    x = b.Concat(b.Flatten(right), b.Flatten(middle), b.Flatten(b.Relu(left)), axis=1)
    x = b.gemm(x, 2 * 108 + 2 * 9 * 4 + 2 * 108, 30)
    first, second, third = b.Split(x, np.array([5, 10, 15]), axis=1, outputs=3)
    x = b.Concat(b.Sigmoid(third), b.Tanh(first), b.Elu(second), axis=1)
    return b.model(b.gemm(x, 30, 2))


def groups_of_channels():
    b = Build(frame=[1, 4, 18, 22])
    x = b.Relu(b.conv("frame", 4, 8, 3, group=4, pads=[1] * 4))
    x = b.Relu(b.conv(x, 8, 6, 1, group=2))
    return b.model(b.gemm(b.Flatten(x), 6 * 18 * 22, 2))


def batches_of_any_size():
    b = Build(frame=["batch", 1, 12, 16])
    x = b.Relu(b.conv("frame", 1, 3, 3, pads=[1] * 4))
    size = b.Unsqueeze(b.Gather(b.Shape(x), np.array(0), axis=0), np.array([0]))
    x = b.Reshape(x, b.Concat(size, np.array([-1]), axis=0))
    # As PyTorch's default exporter asks for the batch, and for the last size.
    x = b.Reshape(x, b.Concat(b.Shape(x, start=0, end=1), b.Shape(x, start=-1), axis=0))
    x = b.Identity(b.Cast(b.Unsqueeze(b.Squeeze(x), np.array([0])), to=TensorProto.FLOAT))
    # The outputs are two of four, the other way round.
    return b.model(b.Gather(b.gemm(x, 3 * 12 * 16, 4), np.array([3, 1]), axis=1))


def sb3_log_probability_beside_the_action():
    """ActorCriticPolicy.forward as it is exported: the action, what the critic says and the probability, which nobody flies."""
    b = Build(frame=[1, 1, 24, 32], temperature=[1, 1])
    x = b.Relu(b.conv("frame", 1, 4, 4, strides=[4, 4]))
    x = b.Relu(b.gemm(b.Flatten(x), 4 * 6 * 8, 16))
    mean, value = b.gemm(x, 16, 2), b.gemm(x, 16, 1)
    spread = b.Exp(b.Add(b.gemm(x, 16, 2), "temperature"))
    away = b.Div(b.Sub(mean, b.RandomNormalLike(mean)), spread)
    probability = b.ReduceSum(b.Log(b.Mul(away, away)), np.array([1]), keepdims=0)
    b.ArgMax(x, axis=1)
    b.Softmax(x)
    return b.model(b.Tanh(mean), value, probability)


def constants_that_are_combined():
    """Bounds, epsilons and shapes made of constants."""
    b = Build(frame=[1, 1, 8, 12])
    x = b.Reshape("frame", b.Concat(np.array([1]), b.Mul(np.array([8]), np.array([12])), axis=0))
    mean, variance = b.weights(96, 1)[:, 0], np.abs(b.weights(96, 1)[:, 0]).astype(np.float64)
    x = b.Div(b.Sub(x, mean), b.Sqrt(b.Add(b.Cast(variance, to=TensorProto.FLOAT), np.float32(1e-8))))
    low, high = np.array([-1.5, -0.5], np.float32), np.array([1.5, 2.5], np.float32)
    y = b.Tanh(b.gemm(x, 96, 2))
    half = b.Div(b.Sub(high, low), np.float32(2))
    y = b.Add(b.Mul(y, half), b.Add(low, half))
    ones = b.ConstantOfShape(b.Shape(y), value=helper.make_tensor("one", TensorProto.FLOAT, [1], [1.0]))
    wanted = b.Where(b.Equal(b.Shape(y), np.array([-1, 2])), np.array([1, 1]), b.Shape(y))
    y = b.Mul(y, b.Expand(b.Add(ones, b.ReduceMean(ones, keepdims=1)), wanted))
    return b.model(b.Add(y, b.Concat(np.array([0.25], np.float32), b.Neg(np.array([0.5], np.float32)), axis=0)))


def sb3_with_vec_normalize():
    """PPO with VecNormalize: pixels less their mean over their deviation, clipped; SB3 clips the action to its space."""
    b = Build(frame=[1, 2, 20, 28])
    mean, variance = b.weights(2, 20 * 28).reshape(1, 2, 20, 28), np.abs(b.weights(2, 20 * 28)).reshape(1, 2, 20, 28)
    x = b.Div(b.Sub("frame", mean), b.Sqrt(b.Add(variance + np.float32(0.1), np.float32(1e-8))))
    x = b.Clip(x, np.float32(-10), np.float32(10))
    x = b.Relu(b.conv(x, 2, 6, 4, strides=[2, 2]))
    x = b.Tanh(b.gemm(b.Flatten(x), 6 * 9 * 13, 12))
    return b.model(b.Clip(b.gemm(x, 12, 2), np.float32(-1), np.float32(1)))


def rl_games_a2c_network():
    """rl_games: running statistics clamped to ±5, ELU, mu; sigma is a constant that goes nowhere."""
    b = Build(goal=[1, 2], frame=[1, 1, 16, 24])
    x = b.Concat(b.Flatten("frame"), "goal", axis=1)
    mean, variance = b.weights(386, 1)[:, 0], np.abs(b.weights(386, 1)[:, 0])
    x = b.Div(b.Sub(x, mean), b.Sqrt(b.Add(variance, np.float32(1e-1))))
    x = b.Min(b.Max(x, np.float32(-5)), np.float32(5))
    x = b.Elu(b.gemm(x, 386, 24))
    x = b.Elu(b.gemm(x, 24, 12))
    sigma = b.Exp(np.zeros(2, np.float32))
    return b.model(b.Max(b.Min(b.gemm(x, 12, 2), np.float32(1)), np.float32(-1)), sigma)


def rsl_rl_actor_critic():
    """rsl_rl: empirical normalisation, (x - mean) / (std + eps), then an ELU perceptron."""
    b = Build(frame=[1, 1, 12, 20])
    x = b.Flatten("frame")
    x = b.Div(b.Sub(x, b.weights(1, 240)), b.Add(np.abs(b.weights(1, 240)), np.float32(1e-2)))
    x = b.Elu(b.gemm(x, 240, 20), alpha=1.0)
    x = b.Elu(b.gemm(x, 20, 10), alpha=0.7)
    return b.model(b.gemm(x, 10, 2))


def clean_rl_sac_actor():
    """CleanRL's SAC: tanh(mean) * scale + bias; the deviation's branch ends beside it."""
    b = Build(frame=[1, 3, 24, 24])
    x = b.Div("frame", np.float32(255.0))
    x = b.Relu(b.conv(x, 3, 6, 3, strides=[2, 2]))
    x = b.Relu(b.gemm(b.Flatten(x), 6 * 11 * 11, 16))
    log_std = b.Tanh(b.gemm(x, 16, 2))
    std = b.Exp(b.Add(np.float32(-5), b.Mul(b.Add(log_std, np.float32(1)), np.float32(3.5))))
    scale, bias = np.array([[0.75, 1.0]], np.float32), np.array([[0.75, 0.0]], np.float32)
    return b.model(b.Add(b.Mul(b.Tanh(b.gemm(x, 16, 2)), scale), bias), std)


def curves_of_many_kinds():
    b = Build(frame=[1, 1, 8, 12])
    x = b.gemm(b.Flatten("frame"), 96, 24)
    parts = [
        b.LeakyRelu(x, alpha=0.2),
        b.Softplus(x),
        b.Mul(x, b.Sigmoid(x)),
        b.Neg(x),
        b.Pow(x, np.float32(2)),
        b.Pow(x, np.array(3)),
        b.Abs(x),
        b.Selu(x),
        b.Celu(x, alpha=0.5),
        b.PRelu(x, np.abs(b.weights(24, 1)[:, 0])),
        b.HardSigmoid(x, alpha=0.25),
        b.HardSwish(x),
        b.Softsign(x),
        b.Mul(x, b.Tanh(b.Softplus(x))),
        b.Mul(b.Mul(x, np.float32(0.5)), b.Add(b.Erf(b.Div(x, np.float32(2**0.5))), np.float32(1))),
        b.Sqrt(b.Add(b.Mul(x, x), np.float32(0.1))),
        b.Log(b.Add(b.Exp(x), np.float32(1))),
        b.Div(np.float32(1), b.Add(b.Abs(x), np.float32(1))),
        b.Pow(np.float32(2), x),
        b.Max(x, b.weights(24, 1)[:, 0]),
        b.Min(x, b.weights(24, 1)[:, 0], np.float32(0.4)),
        b.Clip(x, "", np.float32(0.3)),
        b.Max(x, b.Neg(x)),
        b.Min(x, b.Sigmoid(x)),
    ]
    return b.model(b.Tanh(b.gemm(b.Concat(*parts, axis=1), 24 * len(parts), 2)))


def residual_sums():
    """ResNet: what a block adds to its input, in pictures and in rows; a gate that multiplies."""
    b = Build(frame=[1, 1, 20, 28])
    x = b.LeakyRelu(b.conv("frame", 1, 6, 3, strides=[2, 2], pads=[1] * 4), alpha=0.01)
    y = b.conv(b.Relu(b.conv(x, 6, 6, 3, pads=[1] * 4)), 6, 6, 3, pads=[1] * 4)
    x = b.Relu(b.Add(x, y))
    gate = b.Sigmoid(b.conv(b.GlobalAveragePool(x), 6, 6, 1))
    x = b.Mul(x, gate)
    x = b.gemm(b.Flatten(x), 6 * 10 * 14, 16)
    x = b.Sum(x, b.gemm(b.Relu(b.gemm(x, 16, 8)), 8, 16), x)
    x = b.Sub(x, b.Tanh(x))
    return b.model(b.gemm(x, 16, 2))


def layer_normalisation():
    """As one node, and as older exporters write it out."""
    b = Build(frame=[1, 1, 10, 12])
    x = b.gemm(b.Flatten("frame"), 120, 32)
    x = b.LayerNormalization(x, b.weights(32, 1)[:, 0], b.weights(32, 1)[:, 0], epsilon=1e-3)
    x = b.gemm(b.Mul(x, b.Sigmoid(x)), 32, 16)
    centred = b.Sub(x, b.ReduceMean(x, axes=[-1], keepdims=1))
    variance = b.ReduceMean(b.Pow(centred, np.float32(2)), axes=[-1], keepdims=1)
    x = b.Div(centred, b.Sqrt(b.Add(variance, np.float32(1e-5))))
    x = b.Add(b.Mul(x, b.weights(16, 1)[:, 0]), b.weights(16, 1)[:, 0])
    return b.model(b.Clip(b.gemm(b.Elu(x), 16, 2), np.float32(-1.2), np.float32(1.2)))


def impala_of_rl_games():
    """rl_games' resnet, CleanRL's for Procgen, rsl_rl's max_pool: windows of 3 every 2, padded, and residual blocks behind them."""
    b = Build(frame=[1, 3, 22, 32])
    x = "frame"
    for channels, filters in [(3, 6), (6, 8)]:
        x = b.conv(x, channels, filters, 3, pads=[1] * 4)
        x = b.MaxPool(x, kernel_shape=[3, 3], strides=[2, 2], pads=[1] * 4)
        y = b.conv(b.Relu(x), filters, filters, 3, pads=[1] * 4)
        x = b.Add(b.conv(b.Relu(y), filters, filters, 3, pads=[1] * 4), x)
    x = b.Relu(b.gemm(b.Relu(b.Flatten(x)), 8 * 6 * 8, 16))
    return b.model(b.gemm(x, 16, 2))


def largest_of_each_channel():
    """rsl_rl's global_pool = max as both exporters write it; a dilated convolution."""
    b = Build(frame=[1, 1, 20, 30])
    x = b.Elu(b.conv("frame", 1, 10, 3, dilations=[2, 2], strides=[2, 2], pads=[2] * 4))
    y = b.Elu(b.conv(x, 10, 12, 3))
    first = b.Flatten(b.MaxPool(x, kernel_shape=[10, 15], strides=[10, 15]))
    second = b.ReduceMax(y, axes=[2, 3], keepdims=0)
    third = b.Flatten(b.GlobalMaxPool(y))
    x = b.Elu(b.gemm(b.Concat(first, second, third, axis=1), 34, 12))
    return b.model(b.gemm(x, 12, 2))


def channels_last_behind_their_normalisation():
    """rl_games' permute_input with running statistics, skrl's scaler over a flattened space."""
    b = Build(frame=[1, 16, 24, 3])
    x = b.Reshape("frame", np.array([1, -1]))
    x = b.Div(b.Sub(x, b.weights(1152, 1)[:, 0]), np.abs(b.weights(1152, 1)[:, 0]) + np.float32(0.1))
    x = b.Reshape(b.Clip(x, np.float32(-5), np.float32(5)), np.array([1, 16, 24, 3]))
    x = b.Relu(b.conv(b.Transpose(x, perm=[0, 3, 1, 2]), 3, 6, 4, strides=[2, 2]))
    return b.model(b.gemm(b.Flatten(x), 6 * 7 * 11, 2))


def layer_norm_of_images():
    """More values than can be put in another order, as one node and written out."""
    b = Build(frame=[1, 1, 40, 60])
    x = b.conv("frame", 1, 6, 3, strides=[2, 2], pads=[1] * 4)
    x = b.Elu(b.LayerNormalization(x, b.weights(6, 600).reshape(6, 20, 30), b.weights(6, 600).reshape(6, 20, 30), axis=1))
    x = b.conv(x, 6, 8, 3, pads=[1] * 4)
    centred = b.Sub(x, b.ReduceMean(x, axes=[1, 2, 3], keepdims=1))
    variance = b.ReduceMean(b.Mul(centred, centred), axes=[1, 2, 3], keepdims=1)
    x = b.Div(centred, b.Sqrt(b.Add(variance, np.float32(1e-5))))
    x = b.Add(b.Mul(x, b.weights(8, 1).reshape(1, 8, 1, 1)), b.weights(8, 1).reshape(1, 8, 1, 1))
    # rl_games': the mean of each channel, spread over its pixels, and its deviation.
    row = b.Reshape(b.Transpose(x, perm=[0, 3, 2, 1]), np.array([-1, 8]))
    mean = b.Expand(b.Unsqueeze(b.ReduceMean(row, axes=[0], keepdims=0), np.array([1, 2])), b.Shape(x))
    away = b.Sub(row, b.ReduceMean(row, axes=[0], keepdims=1))
    deviation = b.Sqrt(b.Div(b.Mul(b.ReduceMean(b.Mul(away, away), axes=[0], keepdims=0), np.float32(600)), np.float32(599)))
    spread = b.Expand(b.Unsqueeze(deviation, np.array([1, 2])), b.Shape(x))
    x = b.Elu(b.Div(b.Mul(b.Sub(x, mean), np.float32(0.7)), b.Add(spread, np.float32(1e-6))))
    return b.model(b.gemm(b.Relu(b.Flatten(b.MaxPool(x, kernel_shape=[4, 4], strides=[4, 4]))), 8 * 5 * 7, 2))


def softplus_in_two_pieces_and_bounds_without_an_end():
    """As PyTorch's newer exporter writes softplus; a shape that is computed backwards; a space of actions that is open to one side or both."""
    b = Build(frame=[1, 1, 8, 12])
    infinity, row = np.float32(np.inf), np.full((1, 2), np.inf, np.float32)
    backwards = b.Slice(np.array([96, 1]), np.array([-1]), np.array([-(2**62)]), np.array([0]), np.array([-1]))
    x = b.gemm(b.Reshape("frame", backwards), 96, 16)
    x = b.Clip(b.Where(b.Greater(x, np.float32(20)), x, b.Softplus(x)), -infinity, infinity)
    x = b.gemm(b.Clip(x, -infinity, np.float32(0.9)), 16, 2)
    return b.model(b.Min(b.Max(x, -row), row))


def rsl_rl_row_of_values():
    """rsl_rl's, rl_games' and skrl's perceptrons get their frame and the goal as one row."""
    b = Build(obs=[1, 3 * 8 * 12 + 2])
    x = b.Div(b.Sub("obs", b.weights(290, 1)[:, 0]), np.abs(b.weights(290, 1)[:, 0]) + np.float32(0.1))
    x = b.Elu(b.gemm(x, 290, 24))
    return b.model(b.gemm(b.Elu(b.gemm(x, 24, 12)), 12, 2))


# How a row of values is read.
FLAT = {"rsl_rl_row_of_values": ("3x8x12+goal", (3, 8, 12))}
# Weights in a file beside the model.
BESIDE = ["rsl_rl_actor_critic", "impala_of_rl_games"]

MODELS = [make for make in list(vars().values()) if inspect.isfunction(make) and not inspect.signature(make).parameters]


def refused():
    """Models that must be refused, by the words that have to be said."""

    def one(make, shape=(1, 1, 8, 8)):
        b = Build(frame=list(shape))
        return b.model(make(b))

    flat = lambda b: b.Flatten("frame")  # noqa: E731
    columns = lambda b, gates: (b.Reshape("frame", np.array([8, 1, 8])), b.weights(1, gates, 8), b.weights(1, gates, 1))  # noqa: E731
    def empty(b, *shape):
        b.constants.append(TensorProto(name=f"c{len(b.constants)}", dims=shape, data_type=TensorProto.FLOAT))
        return b.constants[-1].name

    nan = np.full((64, 2), np.nan, np.float32)
    two_pieces = lambda b, x, from_: b.Where(b.Greater(x, np.float32(from_)), x, b.Softplus(x))  # noqa: E731
    cases = {
        "node 2 `node_2` (Softmax)": one(lambda b: b.Softmax(b.MatMul(flat(b), b.weights(64, 2)))),
        "(Frobnicate): this operator is not supported": one(lambda b: b.Frobnicate("frame")),
        "(Gelu): operators of `com.microsoft` are not supported": one(lambda b: b.Gelu(flat(b), domain="com.microsoft")),
        "in training mode": one(lambda b: b.BatchNormalization("frame", *np.ones((4, 1), np.float32), outputs=3)[0]),
        "dynamic size `rows` at axis 2": one(flat, (1, 1, "rows", 8)),
        "that is not finite": one(lambda b: b.MatMul(flat(b), nan)),
        "holds a number that is not": one(lambda b: b.Clip(b.gemm(flat(b), 64, 2), nan[0, 0], np.float32(1))),
        "some are infinite and others are not": one(
            lambda b: b.Max(b.gemm(flat(b), 64, 2), np.array([[-np.inf, 0.5]], np.float32))
        ),
        "it has numbers of float16": one(lambda b: b.MatMul(flat(b), b.weights(64, 2).astype(np.float16))),
        "has 3 values; an action has 2": one(lambda b: b.MatMul(flat(b), b.weights(64, 3))),
        "a kernel of 3 × 2": one(lambda b: b.Flatten(b.Conv("frame", b.weights(1, 1, 3, 2)))),
        "a kernel of 3 × 2 is not": one(lambda b: b.MaxPool("frame", kernel_shape=[3, 2], strides=[2, 2])),
        "a state that goes from one decision to the next": (lambda b: b.model(b.Add(b.gemm(flat(b), 64, 2), "h")))(
            Build(frame=[1, 1, 8, 8], h=[1, 1, 2])
        ),
        "with --flat": (lambda b: b.model(b.gemm("obs", 64, 2)))(Build(obs=[1, 64])),
        "(Greater): this operator is not supported": one(lambda b: two_pieces(b, b.gemm(flat(b), 64, 2), 1.0)),
        "direction = bidirectional": one(
            lambda b: b.GRU(
                b.Reshape("frame", np.array([8, 1, 8])),
                b.weights(2, 3, 8),
                b.weights(2, 3, 1),
                hidden_size=1,
                direction="bidirectional",
                linear_before_reset=1,
            )
        ),
        "input_forget = 1 is not supported": one(lambda b: b.LSTM(*columns(b, 4), hidden_size=1, input_forget=1)),
        "other activations": one(
            lambda b: b.GRU(*columns(b, 3), hidden_size=1, linear_before_reset=1, activations=["Sigmoid", "Relu"])
        ),
        "(LSTM): shapes [8, 1, 8], [1, 0, 8]": one(
            lambda b: b.LSTM(columns(b, 4)[0], empty(b, 1, 0, 8), empty(b, 1, 0, 2**62), hidden_size=1)
        ),
        "in 1048576 groups": one(lambda b: b.Conv("frame", empty(b, 0, 2**50, 1, 1), kernel_shape=[1, 1], group=2**20)),
        "the shapes [1, 64] and [1] along axis 1": one(lambda b: b.Concat(flat(b), np.zeros(1, np.float32), axis=1)),
        "not finite (a division by zero": one(lambda b: b.Celu(b.gemm(flat(b), 64, 2), alpha=0.0)),
        "auto_pad = SAME_UPPER": one(lambda b: b.MaxPool("frame", kernel_shape=[8, 8], auto_pad="SAME_UPPER")),
        "(GlobalAveragePool): it has 33554464 parameters": one(
            lambda b: b.Add(b.GlobalAveragePool("frame"), b.GlobalAveragePool("frame")), (1, 16, 256, 256)
        ),
        "name the action's with --action": (lambda b: b.model(b.gemm(flat(b), 64, 2), flat(b)))(Build(frame=[1, 1, 8, 8])),
        "depends on no frame": (lambda b: b.model(b.gemm("goal", 2, 2)))(Build(goal=[1, 2], frame=[1, 1, 8, 8])),
        "both depend on the inputs": one(lambda b: b.Pow(b.gemm(flat(b), 64, 2), b.gemm(flat(b), 64, 2))),
        "several exponents": one(lambda b: b.Pow(b.gemm(flat(b), 64, 2), np.array([1, 2], np.float32))),
        "not finite": one(lambda b: b.Mul(b.gemm(flat(b), 64, 2), b.Log(np.zeros(2, np.float32)))),
        "do not fit each other": one(lambda b: b.Add(b.gemm(flat(b), 64, 2), b.gemm(flat(b), 64, 3))),
        "values as whole numbers": one(lambda b: b.Cast(b.Cast(flat(b), to=TensorProto.INT64), to=TensorProto.FLOAT)),
        "it divides by zero": one(lambda b: b.Div(flat(b), np.float32(0))),
        "none of shape [1, channels, rows, columns]": Build(goal=[1, 2]).model("goal"),
        "multiply-adds a decision": one(
            lambda b: b.gemm(b.Flatten(b.GlobalAveragePool(b.conv("frame", 1, 8, 65))), 8, 2), (1, 1, 128, 256)
        ),
        "nothing computes its input `lost`": one(lambda b: b.Add(flat(b), "lost")),
        "its image was cut, joined or reordered before": one(
            lambda b: b.conv(b.Transpose("frame", perm=[0, 1, 3, 2]), 1, 2, 3)
        ),
    }
    huge = one(lambda b: b.MatMul(flat(b), b.weights(64, 2)))
    huge.graph.input[0].type.tensor_type.shape.dim[2].dim_value = 2**62
    cases["more than 33554432 values"] = huge
    short = one(lambda b: b.MatMul(flat(b), b.weights(64, 2)))
    short.graph.initializer[0].dims[0] = 2**40
    cases["the tensor `c0`: the shape [1099511627776, 2]"] = short
    for place, said in {
        "nowhere.data": "has to lie beside the model",
        "../weights.data": "which is not in the model's folder",
        "0.onnx": "which has",
    }.items():
        elsewhere = one(lambda b: b.MatMul(flat(b), b.weights(64, 2)))
        tensor = elsewhere.graph.initializer[0]
        onnx.external_data_helper.set_external_data(tensor, place, offset=2**40, length=512)
        tensor.ClearField("raw_data")
        cases[said] = elsewhere
    return cases


def main(folder):
    (folder / "refused").mkdir(parents=True)
    for make in MODELS:
        # What one draws changes nothing of the others.
        RNG.bit_generator.state = np.random.PCG64(30).state
        model = make()
        onnx.checker.check_model(model)
        name = folder / make.__name__
        beside = {"save_as_external_data": True, "location": f"{name.name}.onnx.data", "size_threshold": 0}
        onnx.save(model, f"{name}.onnx", **(beside if name.name in BESIDE else {}))
        session = onnxruntime.InferenceSession(f"{name}.onnx", providers=["CPUExecutionProvider"])
        given, ours = {}, []
        for info in session.get_inputs():
            shape = [size if isinstance(size, int) else 1 for size in info.shape]
            value = given[info.name] = RNG.uniform(-0.5, 1.0, shape).astype(np.float32)
            if name.name in FLAT:
                _, frame = FLAT[name.name]
                picture, goal = np.split(value.ravel(), [np.prod(frame)])
                ours = [picture.reshape(frame).transpose(1, 2, 0).ravel().tolist(), goal.tolist()]
            # Only the action's ancestors count: `temperature` is none.
            elif info.name != "temperature":
                last = shape[-1] in (1, 3) or len(shape) == 2
                ours.append((value if last else value.transpose(0, 2, 3, 1)).ravel().tolist())
        # The first output is the action; where there are others, its name has to be told.
        action = session.get_outputs()[0].name
        options = ["--action", action] if len(session.get_outputs()) > 1 else []
        options += ["--flat", FLAT[name.name][0]] if name.name in FLAT else []
        Path(f"{name}.options.json").write_text(json.dumps(options))
        (output,) = session.run([action], given)
        Path(f"{name}.inputs.json").write_text(json.dumps(ours))
        Path(f"{name}.outputs.json").write_text(json.dumps(output.ravel().tolist()))
    words = {}
    for i, (said, model) in enumerate(refused().items()):
        (folder / "refused" / f"{i}.onnx").write_bytes(model.SerializeToString())
        words[f"{i}.onnx"] = said
    whole = (folder / "goal_beside_the_frame.onnx").read_bytes()
    for name, content in {"cut.onnx": whole[: len(whole) // 2], "text.onnx": b"this is no model", "empty.onnx": b""}.items():
        (folder / "refused" / name).write_bytes(content)
        words[name] = "it holds no graph" if not content else "truncated or not ONNX"
    (folder / "refused.json").write_text(json.dumps(words))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
