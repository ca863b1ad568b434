"""The actor, its second half and LSTM-AD in PyTorch and ONNX, with our weights."""

import numpy as np
import onnx
import torch
from onnx import helper
from torch import nn

import actor as frozen
from actor import CONTRAST_GAIN, CONVOLUTIONS, FEATURES, FRAMES, HIDDEN, LIMIT
from export_onnx import Builder

Weights = dict[str, np.ndarray]


def put(module: nn.Module, weight: str, bias: str, weights: Weights, name: str) -> None:
    """Sets a layer's two tensors."""
    with torch.no_grad():
        getattr(module, weight).copy_(torch.from_numpy(weights[f"{name}.weight"]))
        getattr(module, bias).copy_(torch.from_numpy(weights[f"{name}.bias"]))


def linear(weights: Weights, name: str) -> nn.Linear:
    """A dense layer."""
    outputs, inputs = weights[f"{name}.weight"].shape
    layer = nn.Linear(inputs, outputs)
    put(layer, "weight", "bias", weights, name)
    return layer


def gru(weights: Weights) -> nn.GRU:
    """The GRU over features."""
    layer = nn.GRU(FEATURES, HIDDEN, batch_first=True)
    with torch.no_grad():
        layer.weight_ih_l0.copy_(torch.from_numpy(weights["gru.input_weight"]))
        layer.weight_hh_l0.copy_(torch.from_numpy(weights["gru.recurrent_weight"]))
        layer.bias_ih_l0.copy_(torch.from_numpy(weights["gru.input_bias"]))
        layer.bias_hh_l0.copy_(torch.from_numpy(weights["gru.recurrent_bias"]))
    return layer


class NearContrast(nn.Module):
    """1 / (1 + range / 3 m)."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return 1.0 / (1.0 + CONTRAST_GAIN * x)


class Encoder(nn.Sequential):
    """Contrast [m, 1, 128, 256] to features [m, 1024]."""

    def __init__(self, weights: Weights) -> None:
        layers: list[nn.Module] = []
        for i in range(1, CONVOLUTIONS + 1):
            filters, channels, kernel, _ = weights[f"convolution_{i}.weight"].shape
            layer = nn.Conv2d(channels, filters, kernel, stride=2, padding=kernel // 2)
            put(layer, "weight", "bias", weights, f"convolution_{i}")
            layers += [layer, nn.ELU()]
        super().__init__(*layers, nn.Flatten())


class Head(nn.Module):
    """The second half model: GRU state [n, 48] and position [n, 2] to the outputs before or after saturation."""

    def __init__(self, weights: Weights, saturated: bool = True, only: int | None = None) -> None:
        super().__init__()
        self.state_curve, self.position_curve = nn.Tanh(), nn.Tanh()
        self.positional, self.dense = linear(weights, "positional"), linear(weights, "dense")
        self.elu, self.output = nn.ELU(), linear(weights, "output")
        self.saturation = nn.Tanh() if saturated else None
        self.only = only

    def forward(self, state: torch.Tensor, position: torch.Tensor) -> torch.Tensor:
        where = self.position_curve(self.positional(position))
        y = self.output(self.elu(self.dense(torch.cat([self.state_curve(state), where], dim=1))))
        if self.saturation is not None:
            y = LIMIT * self.saturation(y)
        return y if self.only is None else y[:, self.only : self.only + 1]


class Actor(nn.Module):
    """Five frames [n, 5, 128, 256] of normalised range and position [n, 2] to the outputs."""

    def __init__(self, weights: Weights, saturated: bool = True) -> None:
        super().__init__()
        self.contrast, self.encoder = NearContrast(), Encoder(weights)
        self.gru, self.head = gru(weights), Head(weights, saturated)

    def forward(self, frames: torch.Tensor, position: torch.Tensor) -> torch.Tensor:
        features = self.encoder(self.contrast(frames.reshape(-1, 1, frozen.ROWS, frozen.COLS)))
        _, last = self.gru(features.reshape(-1, FRAMES, FEATURES))
        return self.head(last[0], position)


class NewestFrame(nn.Module):
    """One new frame [1, 1, 128, 256], the older ones' features [4, 1024] and position to outputs and new features."""

    def __init__(self, actor: Actor) -> None:
        super().__init__()
        self.actor = actor

    def forward(
        self, frame: torch.Tensor, older: torch.Tensor, position: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        features = self.actor.encoder(self.actor.contrast(frame))
        _, last = self.actor.gru(torch.cat([older, features])[None])
        return self.actor.head(last[0], position), features


class MidpointProduct(torch.autograd.Function):
    """a·b, backwards with the mean of explained input and background, which are the halves of the batch.

    `shap` and `captum` know no rule for products of two varying values; without one a GRU's explanation does not add up.
    """

    @staticmethod
    def forward(ctx: object, a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
        ctx.save_for_backward(a, b)
        return a * b

    @staticmethod
    def backward(ctx: object, gradient: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        a, b = (sum(x.chunk(2)).repeat(2, 1) / 2 for x in ctx.saved_tensors)
        return gradient * b, gradient * a


class ExplainedActor(nn.Module):
    """The actor's yaw for `shap` and `captum`: the GRU written out, every curve a module of its own."""

    def __init__(self, weights: Weights) -> None:
        super().__init__()
        self.contrast, self.encoder, self.head = NearContrast(), Encoder(weights), Head(weights, only=1)
        for name in ("input_weight", "recurrent_weight", "input_bias", "recurrent_bias"):
            self.register_buffer(name, torch.from_numpy(weights[f"gru.{name}"]))
        self.r = nn.ModuleList(nn.Sigmoid() for _ in range(FRAMES))
        self.z = nn.ModuleList(nn.Sigmoid() for _ in range(FRAMES))
        self.n = nn.ModuleList(nn.Tanh() for _ in range(FRAMES))

    def forward(self, frames: torch.Tensor, position: torch.Tensor) -> torch.Tensor:
        x = self.encoder(self.contrast(frames.reshape(-1, 1, frozen.ROWS, frozen.COLS)))
        x = nn.functional.linear(x, self.input_weight, self.input_bias).reshape(-1, FRAMES, 3 * HIDDEN)
        h = torch.zeros(len(x), HIDDEN)
        for t in range(FRAMES):
            x_r, x_z, x_n = x[:, t].chunk(3, dim=1)
            u_r, u_z, u_n = nn.functional.linear(h, self.recurrent_weight, self.recurrent_bias).chunk(3, dim=1)
            r, z = self.r[t](x_r + u_r), self.z[t](x_z + u_z)
            n = self.n[t](x_n + MidpointProduct.apply(r, u_n))
            h = n + MidpointProduct.apply(z, h - n)
        return self.head(h, position)


def lstm_ad(ours: Weights) -> onnx.ModelProto:
    """LSTM-AD in ONNX: `window` [10, 1, 48] to `score` [1, 1]. `ours` are our tensors (detector/src/lstm_ad.rs)."""
    b, hidden = Builder(), ours["lstm.recurrent_weight"].shape[0]

    def iofc(tensor: np.ndarray) -> np.ndarray:
        # Ours: i, f, g, o in columns; ONNX: i, o, f, c in rows.
        i, f, g, o = np.split(tensor.T if tensor.ndim == 2 else tensor, 4)
        return np.concatenate([i, o, f, g])

    bias = np.concatenate([iofc(ours["lstm.bias"]), np.zeros(4 * hidden, dtype=np.float32)])
    inputs = [
        "window",
        b.constant("W", iofc(ours["lstm.input_weight"])[None]),
        b.constant("R", iofc(ours["lstm.recurrent_weight"])[None]),
        b.constant("B", bias[None]),
    ]
    curves = ["Sigmoid", "Relu", "Relu"]
    b.nodes.append(helper.make_node("LSTM", inputs, ["", "last"], name="lstm", hidden_size=hidden, activations=curves))
    x = b.add("Squeeze", ["last", b.constant("axis_0", np.array([0], dtype=np.int64))], "state")
    layers = sum(name.startswith("dense") for name in ours) // 2
    for i in range(1, layers + 1):
        parts = [b.constant(f"dense_{i}.{part}", ours[f"dense_{i}.{part}"]) for part in ("weight", "bias")]
        x = b.add("Gemm", [x, *parts], f"dense_{i}")
        x = b.add("Relu", [x], f"dense_{i}.relu") if i < layers else b.add("Sigmoid", [x], "score")
    width = ours["lstm.input_weight"].shape[0]
    return b.model("LSTM-AD", [("window", [10, 1, width])], [("score", [1, 1])], {})
