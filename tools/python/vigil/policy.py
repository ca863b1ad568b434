"""Policies deciding on frames: the frozen actor of Vigil's architecture, and imported policies of others (docs/import.md)."""

from __future__ import annotations

import os
from collections.abc import Mapping
from os import PathLike
from typing import Any, NamedTuple

import numpy as np

from vigil import _given, _vigil
from vigil._given import LOW_DIM, Floats


class Action(NamedTuple):
    """A decision."""

    forward_m_s: float
    """Forward speed, m/s, ±1.5."""
    yaw: float
    """Yaw in units of 30 °/s, clockwise, ±1.5."""


class _Frozen:
    """What is common to those that decide on frames, which they remember. A copy is made anew from the file."""

    native: _vigil.Actor | _vigil.Policy
    path: str | None
    positional_inputs: int
    """Values of what it is given beside the split point: its low-dimensional observation, or an imported policy's goal."""

    def __reduce__(self) -> tuple[type[_Frozen], tuple[str | None]]:
        return type(self), (self.path,)

    def state(self) -> Floats:
        """The values at the split point of the last decision, 48 of an actor: what is explained in flight.

        Raises:
            ValueError: an imported policy that has decided nothing, or has no split point.
        """
        return self.native.state()

    def reset(self) -> None:
        """Forgets the frames: a new flight."""
        self.native.reset()

    @property
    def sha256(self) -> str:
        """Its digest, which a detector's file names."""
        return self.native.sha256


class Actor(_Frozen):
    """A frozen actor: decides from the newest frame and from what it remembers of earlier ones. A copy, or one that was pickled, is made
    anew from the file and remembers nothing.

    Args:
        path: its file; absent: the one built in.

    Raises:
        ValueError: a file that is no unaltered actor of this architecture.
    """

    positional_inputs = LOW_DIM
    native: _vigil.Actor

    def __init__(self, path: str | PathLike[str] | None = None) -> None:
        given = None if path is None else _given.path("path", path)
        self.path = None if given is None else os.path.abspath(given)
        """Its file; ``None``: the one built in."""
        self.native = _vigil.Actor(given)

    def decide(self, frame: Any, goal: Any) -> Action:
        """Decides on the newest frame ``[128, 256]`` in metres, the goal and the vehicle's odometry. It remembers the frames, so every one of
        a flight has to be given.

        Args:
            frame: the frame.
            goal: ``observation["position"]`` of an environment (``VigilEnv(actor=…)``), as it is in flight: distance (m) and bearing (rad) of
                the goal; north, east and height (m), heading (rad), velocity forward and right (m/s) as the vehicle believes; time (s). Or
                the first two alone: the vehicle then stands where its flight began.
        """
        return Action(*self.native.decide(_given.frames_of("frame", frame, None), _given.position(goal)))

    def context(self) -> Floats:
        """What it remembered in the last decision, ``[328]``: older scans, surfaces out of view, its trail (docs/architecture.md)."""
        return self.native.context()

    def low_dim(self) -> Floats:
        """The low-dimensional observation of the last decision, ``[8]``: goal, own motion, last action (docs/architecture.md)."""
        return self.native.low_dim()

    def tensors(self) -> dict[str, Floats]:
        """Its parameters by the names that its file has (docs/architecture.md), in their order; copies."""
        return {name: values.reshape(shape) for name, shape, values in self.native.tensors()}


def freeze(
    path: str | PathLike[str],
    tensors: Mapping[str, Any],
    *,
    training_config: str = "",
    seed: int = 0,
    updates: int = 0,
) -> str:
    """Writes a frozen actor of Vigil's architecture, which flies (``--actor``).

    Args:
        path: the file.
        tensors: its parameters, of the names and shapes of :meth:`Actor.tensors`.
        training_config, seed, updates: what the file tells of its training; the configuration as TOML.

    Returns:
        Its SHA-256, as ``vigil`` and the detector's file name it.

    Raises:
        ValueError: a tensor that is missing, too many, of another shape or not finite; then nothing is written.
    """
    like = Actor()
    shapes = {name: tuple(shape) for name, shape, _ in like.native.tensors()}
    if missing := [name for name in shapes if name not in tensors]:
        raise ValueError(f"tensors: {', '.join(missing)} missing")
    if unknown := [name for name in tensors if name not in shapes]:
        raise ValueError(f"tensors: {', '.join(unknown)} unknown; there are {', '.join(shapes)}")
    flat = [_given.floats(name, tensors[name], shape).ravel() for name, shape in shapes.items()]
    numbers = _given.whole("seed", seed), _given.whole("updates", updates)
    return like.native.write(_given.path("path", path), np.concatenate(flat), training_config, *numbers)


class Policy(_Frozen):
    """An imported policy (``vigil import``): decides from frames of its own size, and remembers them if it has several channels. A copy
    remembers nothing.

    Args:
        path: its file.

    Raises:
        ValueError: a file that is no unaltered policy.
    """

    positional_inputs = 2
    native: _vigil.Policy
    path: str
    frame_shape: tuple[int, int, int]
    """Rows, columns and channels of its own frame."""
    scale: float
    """Its pixels are 0 to this."""
    output_scale: float
    """What its outputs are multiplied by."""
    frame_input: int
    """Place of the frame among its inputs."""
    has_goal: bool
    """The goal is one of them."""

    def __init__(self, path: str | PathLike[str]) -> None:
        given = _given.path("path", path)
        self.path = os.path.abspath(given)
        """Its file."""
        self.native = _vigil.Policy(given)
        self.frame_shape, self.scale, self.output_scale, self.frame_input, self.has_goal = self.native.inputs()

    def decide(self, frame: Any, goal: Any) -> Action:
        """As :meth:`Actor.decide`, exactly as in flight; of a position it takes the goal alone."""
        distance_m, bearing_rad, *_ = _given.position(goal)
        return Action(*self.native.decide(_given.frames_of("frame", frame, None), distance_m, bearing_rad))

    @property
    def source(self) -> str:
        """What it was made of."""
        return self.native.source

    def own_frame(self, frames: Any) -> Floats:
        """The policy's own frame ``[rows, columns, channels]`` of our frames ``[channels, 128, 256]`` in metres, the newest last.

        A policy whose channels are all the newest frame takes the last of them.
        """
        return self.native.own_frame(_given.frames_of("frames", frames, self.frame_shape[2])).reshape(self.frame_shape)

    def inputs(self, own_frame: Any, goal: Any) -> list[Floats]:
        """The network's inputs, in its order, of its own frame ``[rows, columns, channels]`` and a goal."""
        frame = _given.floats("own frame", own_frame, self.frame_shape).ravel()
        if not self.has_goal:
            return [frame]
        position = _given.beside(goal)
        return [frame, position] if self.frame_input == 0 else [position, frame]

    def outputs(self, own_frame: Any, goal: Any) -> Floats:
        """Forward speed and yaw ``[2]`` for its own frame, before they are limited to ±1.5."""
        return self.native.forward(self.inputs(own_frame, goal)) * np.float32(self.output_scale)

    def gradient(self, own_frame: Any, goal: Any, weights: tuple[float, float] = (0.0, 1.0)) -> Floats:
        """Gradient of ``weights · outputs`` at the pixels of its own frame, ``[rows, columns, channels]``."""
        return self._gradient(own_frame, goal, weights, unsaturated=False)

    def _gradient(self, own_frame: Any, goal: Any, weights: tuple[float, float], *, unsaturated: bool) -> Floats:
        scaled = [weight * self.output_scale for weight in weights]
        return self.native.gradient(self.inputs(own_frame, goal), scaled, unsaturated).reshape(self.frame_shape)
