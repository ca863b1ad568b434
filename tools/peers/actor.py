"""The frozen actor's file in the layouts of other frameworks (docs/nnet.md describes ours)."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from safetensors import safe_open

REPOSITORY = Path(__file__).resolve().parents[2]
ACTOR = REPOSITORY / "firmware/policy/actor/actor.safetensors"

FRAMES, ROWS, COLS, HIDDEN, FEATURES = 5, 128, 256, 48, 1024
LIMIT = 1.5
# 100 m of full scale over the 3 m at which the contrast is one half.
CONTRAST_GAIN = 100.0 / 3.0
CONVOLUTIONS = 5


@dataclass
class Actor:
    """Weights as PyTorch and ONNX have them, features in channel-first order, and what the file says of itself."""

    weights: dict[str, np.ndarray]
    metadata: dict[str, str]

    @property
    def positional_inputs(self) -> int:
        """2 of the goal, and 14 more where the actor is told of movers."""
        return self.weights["positional.weight"].shape[1]

    @property
    def sha256(self) -> str:
        """The digest that the file holds."""
        return self.metadata["sha256"]


def load(path: Path = ACTOR) -> Actor:
    """Reads the file and checks its digest."""
    with safe_open(path, framework="numpy") as file:
        metadata = dict(file.metadata() or {})
        if metadata.get("format") != "vigil actor 1":
            raise SystemExit(f"{path} is not a frozen actor of this version")
        ours = {name: file.get_tensor(name) for name in file.keys()}
    found = digest(metadata, ours)
    if found != metadata.get("sha256"):
        raise SystemExit(f"{path} was altered: its content has SHA-256 {found}")
    return Actor(channel_first(ours), metadata)


def digest(metadata: dict[str, str], ours: dict[str, np.ndarray]) -> str:
    """SHA-256 over metadata and tensors, as firmware/policy/src/actor/file.rs computes it."""
    hash_ = hashlib.sha256()
    for key, value in sorted(metadata.items()):
        if key != "sha256":
            hash_.update(key.encode() + b"\0" + value.encode() + b"\0")
    names = [f"convolution_{i}.{part}" for i in range(1, CONVOLUTIONS + 1) for part in ("weight", "bias")]
    names += ["gru.input_weight", "gru.recurrent_weight", "gru.input_bias", "gru.recurrent_bias"]
    names += [f"{layer}.{part}" for layer in ("positional", "dense", "output") for part in ("weight", "bias")]
    for name in names:
        hash_.update(np.ascontiguousarray(ours[name], dtype="<f4").tobytes())
    return hash_.hexdigest()


def channel_first(ours: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Our tensors in PyTorch's order: convolutions [out][in][row][column], matrices [out][in], features by channel."""
    theirs = {}
    for name, tensor in ours.items():
        if name.startswith("convolution") and tensor.ndim == 4:
            tensor = tensor.transpose(3, 2, 0, 1)
        elif name == "gru.input_weight":
            # [row][column][channel] to [channel][row][column]
            tensor = tensor.reshape(4, 8, 32, 3 * HIDDEN).transpose(3, 2, 0, 1).reshape(3 * HIDDEN, FEATURES)
        elif tensor.ndim == 2:
            tensor = tensor.T
        theirs[name] = np.ascontiguousarray(tensor, dtype=np.float32)
    return theirs


def pattern_frames(seed: int) -> np.ndarray:
    """Five depth frames that any language can make again, exactly: sums of two triangle waves in steps of 1/1024.

    firmware/policy/tests/onnx.rs has the same formula.
    """
    t, row, col = np.meshgrid(np.arange(FRAMES), np.arange(ROWS), np.arange(COLS), indexing="ij")

    def triangle(x: np.ndarray) -> np.ndarray:
        return np.abs(x % 512 - 256)

    value = triangle(7 * col + 3 * t + 40 * seed) + triangle(5 * row + 11 * t + 90 * seed)
    return (value.astype(np.float32) / np.float32(1024.0)).astype(np.float32)


def pattern_position(seed: int, inputs: int) -> np.ndarray:
    """Positional inputs to go with the pattern: of the goal, and what an actor is told beside it."""
    told = [0.125 * ((3 * i + seed) % 9 - 4) for i in range(2, inputs)]
    return np.array([0.125 * (seed + 1), 0.25 * (seed - 2), *told], dtype=np.float32)


def file_sha256(path: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
