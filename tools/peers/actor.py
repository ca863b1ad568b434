"""The frozen actor's file in the layouts of other frameworks (docs/nnet.md describes ours)."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from safetensors import safe_open

REPOSITORY = Path(__file__).resolve().parents[2]
ACTOR = REPOSITORY / "firmware/policy/actor/actor.safetensors"

ROWS, COLS, CONTEXT, HIDDEN, LOW_DIM = 128, 256, 328, 48, 8
# Rows, columns and channels of the last convolution.
FEATURES = (4, 8, 32)
LIMIT = 1.5
# 100 m of full scale over the 3 m at which the contrast is one half.
CONTRAST_GAIN = 100.0 / 3.0
CONVOLUTIONS = 5
# Added to the variance of a layer norm.
EPSILON = 1e-5


@dataclass
class Actor:
    """Weights as PyTorch and ONNX have them, features in channel-first order, and what the file says of itself."""

    weights: dict[str, np.ndarray]
    metadata: dict[str, str]

    @property
    def sha256(self) -> str:
        """The digest that the file holds."""
        return self.metadata["sha256"]


def load(path: Path = ACTOR) -> Actor:
    """Reads the file and checks its digest."""
    with safe_open(path, framework="numpy") as file:
        metadata = dict(file.metadata() or {})
        if metadata.get("format") != "vigil actor 2":
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
    for layer in ("scan", "trunk_1", "trunk_2", "state", "low_dim", "head_1", "head_2", "output"):
        parts = ("weight", "bias", "norm_scale", "norm_shift") if layer.startswith("trunk") else ("weight", "bias")
        names += [f"{layer}.{part}" for part in parts]
    for name in names:
        hash_.update(np.ascontiguousarray(ours[name], dtype="<f4").tobytes())
    return hash_.hexdigest()


def channel_first(ours: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Our tensors in PyTorch's order: convolutions [out][in][row][column], matrices [out][in], features by channel."""
    theirs = {}
    for name, tensor in ours.items():
        if name.startswith("convolution") and tensor.ndim == 4:
            tensor = tensor.transpose(3, 2, 0, 1)
        elif name == "scan.weight":
            # [row][column][channel] to [channel][row][column]
            columns = tensor.shape[1]
            tensor = tensor.reshape(*FEATURES, columns).transpose(3, 2, 0, 1).reshape(columns, -1)
        elif tensor.ndim == 2:
            tensor = tensor.T
        theirs[name] = np.ascontiguousarray(tensor, dtype=np.float32)
    return theirs


def _triangle(x: np.ndarray) -> np.ndarray:
    return np.abs(x % 512 - 256)


def pattern_frame(seed: int) -> np.ndarray:
    """A depth frame [1, 128, 256] that any language can make again, exactly: sums of two triangle waves in steps of 1/1024.

    firmware/policy/tests/onnx.rs has the same formula.
    """
    row, col = np.meshgrid(np.arange(ROWS), np.arange(COLS), indexing="ij")
    value = _triangle(7 * col + 40 * seed) + _triangle(5 * row + 90 * seed)
    return (value.astype(np.float32) / np.float32(1024.0)).astype(np.float32)[None]


def pattern_values(seed: int, count: int) -> np.ndarray:
    """What is remembered, or low-dimensional, to go with the pattern: eighths within half."""
    return np.array([0.125 * ((3 * i + seed) % 9 - 4) for i in range(count)], dtype=np.float32)
