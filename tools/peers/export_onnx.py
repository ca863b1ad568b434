"""Turns a frozen actor into ONNX and checks the result with ONNX Runtime.

Writes actor.onnx beside the actor (inputs `frame` [n, 1, 128, 256], range / 100 m, `context` [n, 328], what is remembered, and `low_dim` [n, 8];
output `action` [n, 2], forward speed and yaw in -1.5..1.5), and actor.onnx.json: what ONNX Runtime makes of five patterns.
firmware/policy/tests/onnx.rs compares our own actor with that.

Examples:
  tools/peers/export.sh                                    the built-in actor
  tools/peers/export.sh runs/mine/actor.safetensors        another one
"""

import argparse
import json
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
from onnx import TensorProto, helper, numpy_helper

import actor as frozen
from actor import CONTEXT, CONTRAST_GAIN, CONVOLUTIONS, EPSILON, LIMIT, LOW_DIM

# Read by ONNX Runtime since 1.15 and by tract.
OPSET = 17
IR_VERSION = 8
PATTERNS = 5


class Builder:
    """Nodes and constants of an ONNX graph."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []

    def constant(self, name: str, value: np.ndarray) -> str:
        """Adds a constant."""
        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(value), name))
        return name

    def add(self, op: str, inputs: list[str], output: str, **attributes: object) -> str:
        """Adds a node with one output."""
        self.nodes.append(helper.make_node(op, inputs, [output], name=output, **attributes))
        return output

    def dense(self, weights: dict[str, np.ndarray], x: str, name: str) -> str:
        """A dense layer."""
        parts = [self.constant(f"{name}.{part}", weights[f"{name}.{part}"]) for part in ("weight", "bias")]
        return self.add("Gemm", [x, *parts], f"{name}.dense", transB=1)

    def encoder(self, weights: dict[str, np.ndarray], frame: str, scan: str) -> None:
        """`frame` [m, 1, 128, 256] to `scan` [m, 64]."""
        scaled = self.add("Mul", [frame, self.constant("contrast_gain", np.float32(CONTRAST_GAIN))], "scaled")
        shifted = self.add("Add", [scaled, self.constant("one", np.float32(1.0))], "shifted")
        x = self.add("Reciprocal", [shifted], "contrast")
        for i in range(1, CONVOLUTIONS + 1):
            name = f"convolution_{i}"
            weight, bias = (self.constant(f"{name}.{part}", weights[f"{name}.{part}"]) for part in ("weight", "bias"))
            kernel = weights[f"{name}.weight"].shape[-1]
            sizes = {"kernel_shape": [kernel] * 2, "strides": [2, 2], "pads": [kernel // 2] * 4}
            x = self.add("Conv", [x, weight, bias], name, **sizes)
            x = self.add("Elu", [x], f"{name}.elu", alpha=1.0)
        x = self.add("Flatten", [x], "features", axis=1)
        self.add("Sigmoid", [self.dense(weights, x, "scan")], scan)

    def behind(self, weights: dict[str, np.ndarray], scan: str, context: str, low_dim: str, action: str) -> None:
        """`scan` [n, 64], `context` [n, 328] and `low_dim` [n, 8] to `action` [n, 2]."""
        x = self.add("Concat", [scan, context], "seen", axis=1)
        for name in ("trunk_1", "trunk_2"):
            x = self.dense(weights, x, name)
            parts = [self.constant(f"{name}.{part}", weights[f"{name}.{part}"]) for part in ("norm_scale", "norm_shift")]
            x = self.add("LayerNormalization", [x, *parts], f"{name}.norm", axis=-1, epsilon=EPSILON)
            x = self.add("Elu", [x], f"{name}.elu", alpha=1.0)
        state = self.add("Tanh", [self.dense(weights, x, "state")], "state.tanh")
        own = self.add("Tanh", [self.dense(weights, low_dim, "low_dim")], "low_dim.tanh")
        x = self.add("Concat", [state, own], "joined", axis=1)
        for name in ("head_1", "head_2"):
            x = self.add("Elu", [self.dense(weights, x, name)], f"{name}.elu", alpha=1.0)
        tanh = self.add("Tanh", [self.dense(weights, x, "output")], "output.tanh")
        self.add("Mul", [tanh, self.constant("limit", np.float32(LIMIT))], action)

    def model(self, name: str, inputs: list, outputs: list, metadata: dict[str, str]) -> onnx.ModelProto:
        """The checked model."""
        value = lambda io: helper.make_tensor_value_info(io[0], TensorProto.FLOAT, io[1])  # noqa: E731
        graph = helper.make_graph(self.nodes, name, list(map(value, inputs)), list(map(value, outputs)), self.constants)
        opset = [helper.make_opsetid("", OPSET)]
        model = helper.make_model(graph, opset_imports=opset, ir_version=IR_VERSION, producer_name="vigil")
        helper.set_model_props(model, metadata)
        onnx.checker.check_model(model, full_check=True)
        return model


def whole(actor: frozen.Actor, n: str | int = "n") -> onnx.ModelProto:
    """Frame, memory and low-dimensional observation to action."""
    b = Builder()
    b.encoder(actor.weights, "frame", "scanned")
    b.behind(actor.weights, "scanned", "context", "low_dim", "action")
    inputs = [("frame", [n, 1, frozen.ROWS, frozen.COLS]), ("context", [n, CONTEXT]), ("low_dim", [n, LOW_DIM])]
    return b.model("actor", inputs, [("action", [n, 2])], actor.metadata)


def session(model: onnx.ModelProto) -> onnxruntime.InferenceSession:
    """ONNX Runtime with one thread."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3
    return onnxruntime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("actor", type=Path, nargs="?", default=frozen.ACTOR, help="the actor; default: the built-in one")
    path: Path = parser.parse_args().actor
    actor = frozen.load(path)
    model = whole(actor)
    to = path.with_suffix(".onnx")
    to.write_bytes(model.SerializeToString())
    given = {"frame": np.stack([frozen.pattern_frame(seed) for seed in range(PATTERNS)])}
    for name, count in [("context", CONTEXT), ("low_dim", LOW_DIM)]:
        given[name] = np.stack([frozen.pattern_values(seed, count) for seed in range(PATTERNS)])
    (actions,) = session(model).run(["action"], given)
    if not np.isfinite(actions).all():
        raise SystemExit("ONNX Runtime's outputs are not finite")
    record = {
        "actor_sha256": actor.sha256,
        "onnx_runtime": onnxruntime.__version__,
        "actions": [[float(np.float32(x)) for x in action] for action in actions],
    }
    Path(f"{to}.json").write_text(json.dumps(record, indent=2) + "\n")
    print(f"{to}: {to.stat().st_size} bytes, ONNX Runtime's outputs in {to.name}.json")


if __name__ == "__main__":
    main()
