"""Writes policies of many shapes as ONNX, with random weights, and what ONNX Runtime makes of random inputs.

Usage: onnx_models.py FOLDER. For each model NAME.onnx, NAME.inputs.json (frames as [row][column][channel]) and
NAME.outputs.json; and models that must be refused, in FOLDER/refused.
"""

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


def dense_after_convolutions():
    b = Build(frame=[1, 1, 64, 96])
    x = b.Relu(b.conv("frame", 1, 8, 3, strides=[2, 2], pads=[1] * 4))
    x = b.Relu(b.conv(x, 8, 12, 3, strides=[2, 2]))
    x = b.Flatten(x)
    x = b.Relu(b.gemm(x, 12 * 15 * 23, 32))
    return b.model(b.Tanh(b.gemm(x, 32, 2)))


def three_channels_last():
    b = Build(frame=[1, 64, 96, 3])
    x = b.Transpose("frame", perm=[0, 3, 1, 2])
    x = b.Relu(b.conv(x, 3, 8, 8, strides=[4, 4]))
    x = b.Relu(b.conv(x, 8, 8, 4, strides=[2, 2]))
    return b.model(b.gemm(b.Flatten(x), 8 * 6 * 10, 2))


def elu_with_padding():
    b = Build(frame=[1, 1, 33, 47])
    x = b.Elu(b.conv("frame", 1, 16, 5, strides=[2, 2], pads=[2] * 4))
    x = b.Elu(b.conv(x, 16, 5, 1))
    return b.model(b.gemm(b.Flatten(x), 5 * 17 * 24, 2))


def max_pooling():
    b = Build(frame=[1, 2, 30, 41])
    x = b.Relu(b.conv("frame", 2, 6, 3))
    x = b.MaxPool(x, kernel_shape=[2, 2], strides=[2, 2])
    return b.model(b.gemm(b.Flatten(x), 6 * 14 * 19, 2))


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
    return b.model(b.gemm(x, 10, 2))


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


def recurrent(operator, gates):
    b = Build(frame=[1, 1, 8, 16])
    x = b.Reshape("frame", np.array([8, 1, 16]))
    hidden = 12
    more = {"linear_before_reset": 1} if operator == "GRU" else {}
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
    x = b.Identity(b.Cast(x, to=TensorProto.FLOAT))
    return b.model(b.gemm(x, 3 * 12 * 16, 2))


def swapped_outputs():
    b = Build(frame=[1, 1, 6, 8])
    x = b.gemm(b.Flatten(b.Relu(b.Unsqueeze(b.Squeeze("frame"), np.array([0, 1])))), 48, 4)
    return b.model(b.Gather(x, np.array([3, 1]), axis=1))


MODELS = [
    dense_after_convolutions,
    three_channels_last,
    elu_with_padding,
    max_pooling,
    average_pooling,
    batch_norm_before_and_after_curves,
    products_and_sums,
    goal_beside_the_frame,
    gru,
    lstm,
    gru_over_columns_of_features,
    split_slice_and_concat,
    groups_of_channels,
    batches_of_any_size,
    swapped_outputs,
]


def refused():
    """Models that must be refused, by the words that have to be said."""

    def one(make, shape=(1, 1, 8, 8)):
        b = Build(frame=list(shape))
        return b.model(make(b))

    flat = lambda b: b.Flatten("frame")  # noqa: E731
    nan = np.full((64, 2), np.nan, np.float32)
    cases = {
        "node 2 `node_2` (Softmax)": one(lambda b: b.Softmax(b.MatMul(flat(b), b.weights(64, 2)))),
        "(Frobnicate): this operator is not supported": one(lambda b: b.Frobnicate("frame", domain="my.own")),
        "dynamic size `rows` at axis 2": one(flat, (1, 1, "rows", 8)),
        "that is not finite": one(lambda b: b.MatMul(flat(b), nan)),
        "has 3 values; an action has 2": one(lambda b: b.MatMul(flat(b), b.weights(64, 3))),
        "a kernel of 3 × 2": one(lambda b: b.Flatten(b.Conv("frame", b.weights(1, 1, 3, 2)))),
        "windows of 3 every 2": one(lambda b: b.MaxPool("frame", kernel_shape=[3, 3], strides=[2, 2])),
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
        "one has to be a constant": one(lambda b: b.Add(flat(b), flat(b))),
        "it divides by zero": one(lambda b: b.Div(flat(b), np.float32(0))),
        "none of shape [1, channels, rows, columns]": Build(goal=[1, 2]).model("goal"),
        "multiply-adds a decision": one(
            lambda b: b.gemm(b.Flatten(b.GlobalAveragePool(b.conv("frame", 1, 8, 65))), 8, 2), (1, 1, 128, 256)
        ),
        "nothing computes its input `lost`": one(lambda b: b.Relu("lost")),
        "the values of its image were put in another order": one(
            lambda b: b.conv(b.Transpose("frame", perm=[0, 1, 3, 2]), 1, 2, 3)
        ),
    }
    huge = one(lambda b: b.MatMul(flat(b), b.weights(64, 2)))
    huge.graph.input[0].type.tensor_type.shape.dim[2].dim_value = 2**62
    cases["more than 33554432 values"] = huge
    short = one(lambda b: b.MatMul(flat(b), b.weights(64, 2)))
    short.graph.initializer[0].dims[0] = 2**40
    cases["the tensor `c0`: the shape [1099511627776, 2]"] = short
    return cases


def main(folder):
    (folder / "refused").mkdir(parents=True)
    for make in MODELS:
        model = make()
        onnx.checker.check_model(model)
        name = folder / make.__name__
        onnx.save(model, f"{name}.onnx")
        session = onnxruntime.InferenceSession(f"{name}.onnx", providers=["CPUExecutionProvider"])
        given, ours = {}, []
        for info in session.get_inputs():
            shape = [size if isinstance(size, int) else 1 for size in info.shape]
            value = RNG.uniform(-0.5, 1.0, shape).astype(np.float32)
            given[info.name] = value
            last = shape[-1] == 3 or len(shape) == 2
            ours.append((value if last else value.transpose(0, 2, 3, 1)).ravel().tolist())
        (output,) = session.run(None, given)
        Path(f"{name}.inputs.json").write_text(json.dumps(ours))
        Path(f"{name}.outputs.json").write_text(json.dumps(output.ravel().tolist()))
    words = {}
    for i, (said, model) in enumerate(refused().items()):
        (folder / "refused" / f"{i}.onnx").write_bytes(model.SerializeToString())
        words[f"{i}.onnx"] = said
    whole = (folder / "dense_after_convolutions.onnx").read_bytes()
    for name, content in {"cut.onnx": whole[: len(whole) // 2], "text.onnx": b"this is no model", "empty.onnx": b""}.items():
        (folder / "refused" / name).write_bytes(content)
        words[name] = "it holds no graph" if not content else "truncated or not ONNX"
    (folder / "refused.json").write_text(json.dumps(words))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
