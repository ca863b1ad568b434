"""Turns a frozen actor into ONNX and checks the result with ONNX Runtime.

Writes actor.onnx beside the actor (inputs `frames` [n, 5, 128, 256], range / 100 m, oldest first, and `position` [n, 2] or [n, 16],
distance / 20 m, bearing / 1 rad and what the actor is told of movers; output `action` [n, 2], forward speed and yaw in -1.5..1.5), and actor.onnx.json: what ONNX
Runtime makes of five patterns. firmware/policy/tests/onnx.rs compares our own actor with that.

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
from actor import CONTRAST_GAIN, CONVOLUTIONS, FEATURES, FRAMES, HIDDEN, LIMIT

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

    def encoder(self, weights: dict[str, np.ndarray], frames: str, features: str) -> None:
        """`frames` [m, 1, 128, 256] to `features` [m, 1024], channel first."""
        scaled = self.add("Mul", [frames, self.constant("contrast_gain", np.float32(CONTRAST_GAIN))], "scaled")
        shifted = self.add("Add", [scaled, self.constant("one", np.float32(1.0))], "shifted")
        x = self.add("Reciprocal", [shifted], "contrast")
        for i in range(1, CONVOLUTIONS + 1):
            name = f"convolution_{i}"
            weight, bias = (self.constant(f"{name}.{part}", weights[f"{name}.{part}"]) for part in ("weight", "bias"))
            kernel = weights[f"{name}.weight"].shape[-1]
            sizes = {"kernel_shape": [kernel] * 2, "strides": [2, 2], "pads": [kernel // 2] * 4}
            x = self.add("Conv", [x, weight, bias], name, **sizes)
            x = self.add("Elu", [x], f"{name}.elu", alpha=1.0)
        self.add("Flatten", [x], features, axis=1)

    def behind(self, weights: dict[str, np.ndarray], sequence: str, position: str, action: str) -> None:
        """`sequence` [5, n, 1024] and `position` [n, 2 or 16] to `action` [n, 2]."""

        def zrh(tensor: np.ndarray) -> np.ndarray:
            # PyTorch's gates r, z, n; ONNX's z, r, h.
            r, z, n = np.split(tensor, 3)
            return np.concatenate([z, r, n])

        bias = np.concatenate([zrh(weights["gru.input_bias"]), zrh(weights["gru.recurrent_bias"])])
        inputs = [
            sequence,
            self.constant("gru.W", zrh(weights["gru.input_weight"])[None]),
            self.constant("gru.R", zrh(weights["gru.recurrent_weight"])[None]),
            self.constant("gru.B", bias[None]),
        ]
        gru = helper.make_node("GRU", inputs, ["", "last"], name="gru", hidden_size=HIDDEN, linear_before_reset=1)
        self.nodes.append(gru)
        state = self.add("Squeeze", ["last", self.constant("axis_0", np.array([0], dtype=np.int64))], "state")
        self.add("Tanh", [state], "state.tanh")

        def dense(x: str, name: str) -> str:
            parts = [self.constant(f"{name}.{part}", weights[f"{name}.{part}"]) for part in ("weight", "bias")]
            return self.add("Gemm", [x, *parts], name, transB=1)

        where = self.add("Tanh", [dense(position, "positional")], "positional.tanh")
        joined = self.add("Concat", ["state.tanh", where], "joined", axis=1)
        hidden = self.add("Elu", [dense(joined, "dense")], "dense.elu", alpha=1.0)
        tanh = self.add("Tanh", [dense(hidden, "output")], "output.tanh")
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


def whole(actor: frozen.Actor) -> onnx.ModelProto:
    """Five frames and position to action."""
    b = Builder()
    single = b.constant("frame_shape", np.array([-1, 1, frozen.ROWS, frozen.COLS], dtype=np.int64))
    b.add("Reshape", ["frames", single], "single_frames")
    b.encoder(actor.weights, "single_frames", "features")
    by_state = b.constant("sequence_shape", np.array([-1, FRAMES, FEATURES], dtype=np.int64))
    b.add("Reshape", ["features", by_state], "by_state")
    b.add("Transpose", ["by_state"], "sequence", perm=[1, 0, 2])
    b.behind(actor.weights, "sequence", "position", "action")
    inputs = [("frames", ["n", FRAMES, frozen.ROWS, frozen.COLS]), ("position", ["n", actor.positional_inputs])]
    return b.model("actor", inputs, [("action", ["n", 2])], actor.metadata)


def newest_frame(actor: frozen.Actor) -> onnx.ModelProto:
    """One new frame, the four older ones' features and position to action and the new features: what flies."""
    b = Builder()
    b.encoder(actor.weights, "frame", "features")
    b.add("Concat", ["older", "features"], "five", axis=0)
    b.add("Unsqueeze", ["five", b.constant("axis_1", np.array([1], dtype=np.int64))], "sequence")
    b.behind(actor.weights, "sequence", "position", "action")
    inputs = [("frame", [1, 1, frozen.ROWS, frozen.COLS]), ("older", [FRAMES - 1, FEATURES]), ("position", [1, actor.positional_inputs])]
    return b.model("actor, newest frame", inputs, [("action", [1, 2]), ("features", [1, FEATURES])], actor.metadata)


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
    frames = np.stack([frozen.pattern_frames(seed) for seed in range(PATTERNS)])
    positions = np.stack([frozen.pattern_position(seed, actor.positional_inputs) for seed in range(PATTERNS)])
    (actions,) = session(model).run(["action"], {"frames": frames, "position": positions})
    if not np.isfinite(actions).all():
        raise SystemExit("ONNX Runtime's outputs are not finite")
    record = {
        "actor_sha256": actor.sha256,
        "onnx_sha256": frozen.file_sha256(to),
        "onnx_runtime": onnxruntime.__version__,
        "actions": [[float(np.float32(x)) for x in action] for action in actions],
    }
    Path(f"{to}.json").write_text(json.dumps(record, indent=2) + "\n")
    print(f"{to}: {to.stat().st_size} bytes, ONNX Runtime's outputs in {to.name}.json")


if __name__ == "__main__":
    main()
