"""DeepSHAP (docs/deepshap.md): what each input contributed to an output, against a background sample.

The contributions of an :class:`Explanation` and its ``base`` add up to the network's output, but for rounding.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from vigil import _given, _vigil
from vigil._given import COLUMNS, FRAMES, FULL_SCALE_M, ROWS, Floats
from vigil.detect import Detector
from vigil.policy import Actor, Policy

FORWARD, YAW = 0, 1
"""Numbers of the outputs."""


@dataclass(frozen=True)
class Explanation:
    """What each input contributed to an output, in the units of the action."""

    phi: Floats
    """Contributions, of the shape of what was explained: ``[48]``, ``[5, 128, 256]``, or the policy's own frame."""
    distance: float
    """Contribution of the goal's distance."""
    bearing: float
    """Contribution of the goal's bearing."""
    told: float
    """Contribution of what an actor is told beside the goal: its own velocity, movers."""
    base: float
    """Mean output of the background sample."""
    output: float
    """The output."""


def _explanation(explainer: _vigil.Explainer, inputs: list[Floats], output: int, frame_at: int, scale: float) -> Explanation:
    if output not in (FORWARD, YAW):
        raise ValueError(f"output: 0 (forward speed) or 1 (yaw), got {output}")
    outputs, phi = explainer.explain(inputs, output)
    phi *= np.float32(scale)
    distance = bearing = told = 0.0
    frame = phi
    if len(phi) > len(inputs[frame_at]) and sum(map(len, inputs)) == len(phi):
        # The positional inputs, of which the goal's two values are the first, stand before the frame or after it.
        count = len(inputs[0 if frame_at == 1 else -1])
        position, frame = (phi[:count], phi[count:]) if frame_at == 1 else (phi[-count:], phi[:-count])
        distance, bearing, told = float(position[0]), float(position[1]), float(position[2:].sum())
    return Explanation(frame, distance, bearing, told, float(explainer.expected()[output]) * scale, float(outputs[output]) * scale)


class SplitPoint:
    """Explains a decision at the policy's split point, the values of its state: what the detector looks at in flight.

    Args:
        actor: the actor, or an imported policy that has a split point.
        backgrounds: states ``[B, values]`` and goals ``[B, 2]`` to compare with, or a detector, which has such a sample; absent: the
            built-in detector's thirty, of the built-in actor.
    """

    def __init__(self, actor: Actor | Policy, backgrounds: tuple[Any, Any] | Detector | None = None) -> None:
        self._scale = actor.native.output_scale if isinstance(actor, Policy) else 1.0
        if backgrounds is None or isinstance(backgrounds, Detector):
            states, positions = (backgrounds or Detector()).backgrounds()
        else:
            states = _given.floats("background states", backgrounds[0], (None, None))
            positions = np.array([_given.positional(goal, actor.native.positional_inputs) for goal in backgrounds[1]], np.float32)
            if len(states) != len(positions):
                raise ValueError(f"backgrounds: {len(states)} states, but {len(positions)} goals")
        self.native = _vigil.Explainer.split_point(actor.native, [[s, p] for s, p in zip(states, positions)])

    def explain(self, state: Any, goal: Any, output: int = YAW) -> Explanation:
        """Explains the decision made from a state ``[values]`` (:meth:`Actor.state`, :meth:`Policy.state`) and a goal."""
        inputs = [_given.floats("state", state, (self.native.input_lengths[0],)), _given.positional(goal, self.native.input_lengths[-1])]
        return _explanation(self.native, inputs, output, 0, self._scale)


def _pixel_inputs(frames: Any, goal: Any, positional: int) -> list[Floats]:
    given = _given.frames_of("frames", frames, FRAMES) / np.float32(FULL_SCALE_M)
    return [*given.reshape(FRAMES, -1), _given.positional(goal, positional)]


class Pixels:
    """Explains an actor's decision by all pixels of its five frames, exactly. A tenth of a second or so for thirty backgrounds.

    Args:
        actor: the actor.
        backgrounds: frames in metres ``[B, 5, 128, 256]`` and goals ``[B, 2]`` to compare with. Each takes 10 MB.
    """

    def __init__(self, actor: Actor, backgrounds: tuple[Any, Any]) -> None:
        width = actor.native.positional_inputs
        given = _given.floats("background frames", backgrounds[0], (None, FRAMES, ROWS, COLUMNS))
        if len(given) != len(backgrounds[1]):
            raise ValueError(f"backgrounds: {len(given)} states, but {len(backgrounds[1])} goals")
        self.native = _vigil.Explainer.pixels(actor.native, [_pixel_inputs(f, g, width) for f, g in zip(given, backgrounds[1])])

    def explain(self, frames: Any, goal: Any, output: int = YAW) -> Explanation:
        """Explains the decision on frames ``[5, 128, 256]`` in metres, oldest first. ``phi`` is ``[5, 128, 256]``."""
        found = _explanation(self.native, _pixel_inputs(frames, goal, self.native.input_lengths[-1]), output, 0, 1.0)
        phi = found.phi.reshape(FRAMES, ROWS, COLUMNS)
        return Explanation(phi, found.distance, found.bearing, found.told, found.base, found.output)


class PolicyPixels:
    """Explains an imported policy's decision by the pixels of its own frame.

    Args:
        policy: the policy.
        backgrounds: own frames (:meth:`Policy.own_frame`) with their goals to compare with.
    """

    def __init__(self, policy: Policy, backgrounds: Iterable[tuple[Any, Any]]) -> None:
        self.policy = policy
        self.native = _vigil.Explainer.policy(policy.native, [policy.inputs(f, g) for f, g in backgrounds])

    def explain(self, own_frame: Any, goal: Any, output: int = YAW) -> Explanation:
        """Explains the decision on its own frame. ``phi`` is ``[rows, columns, channels]``; outputs before they are limited."""
        native = self.policy.native
        inputs = self.policy.inputs(own_frame, goal)
        found = _explanation(self.native, inputs, output, native.frame_input, native.output_scale)
        phi = found.phi.reshape(self.policy.frame_shape)
        return Explanation(phi, found.distance, found.bearing, found.told, found.base, found.output)
