"""The actor, its second half and LSTM-AD in PyTorch and ONNX, with our weights."""

import numpy as np
import onnx
import torch
from onnx import helper
from torch import nn

import actor as frozen
from actor import CONTRAST_GAIN, CONVOLUTIONS, EPSILON, LIMIT
from export_onnx import Builder

Weights = dict[str, np.ndarray]


def put(module: nn.Module, weights: Weights, name: str, parts: tuple[str, str] = ("weight", "bias")) -> nn.Module:
    """Sets a layer's two tensors."""
    with torch.no_grad():
        for own, part in zip((module.weight, module.bias), parts):
            own.copy_(torch.from_numpy(weights[f"{name}.{part}"]))
    return module


def linear(weights: Weights, name: str) -> nn.Linear:
    """A dense layer."""
    outputs, inputs = weights[f"{name}.weight"].shape
    return put(nn.Linear(inputs, outputs), weights, name)


class NearContrast(nn.Module):
    """1 / (1 + range / 3 m)."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return 1.0 / (1.0 + CONTRAST_GAIN * x)


class Encoder(nn.Sequential):
    """Contrast [m, 1, 128, 256] to the scan [m, 64]."""

    def __init__(self, weights: Weights) -> None:
        layers: list[nn.Module] = []
        for i in range(1, CONVOLUTIONS + 1):
            filters, channels, kernel, _ = weights[f"convolution_{i}.weight"].shape
            layer = nn.Conv2d(channels, filters, kernel, stride=2, padding=kernel // 2)
            layers += [put(layer, weights, f"convolution_{i}"), nn.ELU()]
        super().__init__(*layers, nn.Flatten(), linear(weights, "scan"), nn.Sigmoid())

class Head(nn.Module):
    """The second half: state [n, 48] and low-dimensional observation [n, 8] to the outputs before or after saturation."""

    def __init__(self, weights: Weights, saturated: bool = True, only: int | None = None) -> None:
        super().__init__()
        self.state_curve, self.low_curve = nn.Tanh(), nn.Tanh()
        self.low, self.output = linear(weights, "low_dim"), linear(weights, "output")
        self.layers = nn.Sequential(linear(weights, "head_1"), nn.ELU(), linear(weights, "head_2"), nn.ELU())
        self.saturation = nn.Tanh() if saturated else None
        self.only = only

    def forward(self, state: torch.Tensor, low_dim: torch.Tensor) -> torch.Tensor:
        own = self.low_curve(self.low(low_dim))
        y = self.output(self.layers(torch.cat([self.state_curve(state), own], dim=1)))
        if self.saturation is not None:
            y = LIMIT * self.saturation(y)
        return y if self.only is None else y[:, self.only : self.only + 1]


def layer_norm(weights: Weights, name: str) -> nn.LayerNorm:
    """The norm behind a layer of the trunk."""
    layer = nn.LayerNorm(len(weights[f"{name}.norm_scale"]), eps=EPSILON)
    return put(layer, weights, name, ("norm_scale", "norm_shift"))


class Actor(nn.Module):
    """A frame [n, 1, 128, 256] of normalised range, what is remembered [n, 328] and the low-dimensional observation [n, 8] to the outputs.

    With `explained` it is made for `shap` and `captum`: layer norms written out.
    """

    def __init__(self, weights: Weights, saturated: bool = True, only: int | None = None, explained: bool = False) -> None:
        super().__init__()
        self.contrast, self.encoder = NearContrast(), Encoder(weights)
        layers: list[nn.Module] = []
        for name in ("trunk_1", "trunk_2"):
            norm = layer_norm(weights, name)
            layers += [linear(weights, name), ExplainedNorm(norm) if explained else norm, nn.ELU()]
        self.trunk = nn.Sequential(*layers, linear(weights, "state"))
        self.head = Head(weights, saturated, only)

    def forward(self, frame: torch.Tensor, context: torch.Tensor, low_dim: torch.Tensor) -> torch.Tensor:
        scan = self.encoder(self.contrast(frame))
        return self.head(self.trunk(torch.cat([scan, context], dim=1)), low_dim)


class MidpointProduct(torch.autograd.Function):
    """a·b, backwards with the mean of explained input and background, which are the halves of the batch.

    `shap` and `captum` know no rule for products of two varying values; without one a layer norm's explanation does not add up.
    """

    @staticmethod
    def forward(ctx: object, a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
        ctx.save_for_backward(a, b)
        return a * b

    @staticmethod
    def backward(ctx: object, gradient: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        a, b = (sum(x.chunk(2)).repeat(2, 1) / 2 for x in ctx.saved_tensors)
        return gradient * b, gradient * a


class RescaledRoot(torch.autograd.Function):
    """1 / √v, backwards with the quotient of the differences between the halves of the batch, as for any curve."""

    @staticmethod
    def forward(ctx: object, v: torch.Tensor) -> torch.Tensor:
        s = v.rsqrt()
        ctx.save_for_backward(v, s)
        return s

    @staticmethod
    def backward(ctx: object, gradient: torch.Tensor) -> torch.Tensor:
        v, s = ctx.saved_tensors
        (v_0, v_1), (s_0, s_1) = v.chunk(2), s.chunk(2)
        near = (v_0 - v_1).abs() < 1e-4 * v_0
        slope = torch.where(near, -0.5 * s_0**3, (s_0 - s_1) / torch.where(near, torch.ones_like(v_0), v_0 - v_1))
        return gradient * slope.repeat(2, 1)


class ExplainedNorm(nn.Module):
    """A layer norm written out: deviation times factor, both with the other's mean."""

    def __init__(self, norm: nn.LayerNorm) -> None:
        super().__init__()
        self.norm = norm

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        c = x - x.mean(dim=1, keepdim=True)
        factor = RescaledRoot.apply(MidpointProduct.apply(c, c).mean(dim=1, keepdim=True) + self.norm.eps)
        return MidpointProduct.apply(c, factor.expand_as(c)) * self.norm.weight + self.norm.bias


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
