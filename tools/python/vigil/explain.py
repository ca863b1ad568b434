"""DeepSHAP (docs/deepshap.md): what each input contributed to an output, against a background sample.

The contributions of an :class:`Explanation` and its ``base`` add up to the network's output, but for rounding. Threads may share an
explainer, but none may be in a call of it while the process forks: in the child it would be waited for without end.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vigil import _given, _vigil
from vigil._given import COLUMNS, CONTEXT, FULL_SCALE_M, LOW_DIM, ROWS, Floats
from vigil.detect import Detector
from vigil.policy import Actor, Policy

FORWARD, YAW = 0, 1
"""Numbers of the outputs."""


@dataclass(frozen=True)
class Explanation:
    """What each input contributed to an output, in the units of the action."""

    phi: Floats
    """Contributions, of the shape of what was explained: ``[48]``, ``[128, 256]``, or the policy's own frame."""
    distance: float
    """Contribution of the goal's distance."""
    bearing: float
    """Contribution of the goal's bearing."""
    told: float
    """Contribution of own motion and last action."""
    memory: float
    """Contribution of what is remembered, where pixels are explained; else 0."""
    base: float
    """Mean output of the background sample."""
    output: float
    """The output."""


def _of_low_dim(phi: Floats) -> tuple[float, float, float]:
    """Distance, bearing and own motion of the contributions of an actor's 8 values, or of an imported policy's 2."""
    if len(phi) < LOW_DIM:
        return float(phi[0]), float(phi[1]), 0.0
    return float(phi[0]), float(phi[1:3].sum()), float(phi[3:].sum())


def _explanation(explainer: _vigil.Explainer, inputs: list[Floats], output: int, frame_at: int, scale: float) -> Explanation:
    if _given.whole("output", output) not in (FORWARD, YAW):
        raise ValueError(f"output: 0 (forward speed) or 1 (yaw), got {output}")
    made, base, phi = explainer.explain(inputs, output)
    phi *= np.float32(scale)
    distance = bearing = told = memory = 0.0
    frame = phi
    if len(phi) > len(inputs[frame_at]) and sum(map(len, inputs)) == len(phi):
        shares = np.split(phi, np.cumsum([len(given) for given in inputs[:-1]]))
        frame = shares.pop(frame_at)
        # What is low-dimensional is the last of the others; between it and the frame lies an actor's memory.
        distance, bearing, told = _of_low_dim(shares.pop())
        memory = float(sum(share.sum() for share in shares))
    return Explanation(frame, distance, bearing, told, memory, base * scale, made * scale)


class SplitPoint:
    """Explains a decision at the policy's split point, the values of its state, in units of the action; what the detector looks at in flight,
    ``Judgement.phi``, is this over an imported policy's ``--output-scale``.

    Args:
        actor: the actor, or an imported policy that has a split point.
        backgrounds: states ``[B, values]`` and what was beside them to compare with (``[B, 8]``, :meth:`Actor.low_dim`; an imported
            policy's goals ``[B, 2]``), or a detector, which has such a sample; absent: the
            built-in detector's thirty, of the built-in actor.
    """

    def __init__(self, actor: Actor | Policy, backgrounds: tuple[Any, Any] | Detector | None = None) -> None:
        _given.made("actor", actor, Actor, Policy)
        self._scale = actor.output_scale if isinstance(actor, Policy) else 1.0
        if backgrounds is None or isinstance(backgrounds, Detector):
            states, positions = (backgrounds or Detector()).backgrounds()
        else:
            states, positions = _given.backgrounds(backgrounds, actor.positional_inputs)
        self.native = _vigil.Explainer(actor.native, False, [[s, p] for s, p in zip(states, positions)])

    def explain(self, state: Any, beside: Any, output: int = YAW) -> Explanation:
        """Explains the decision made from a state ``[values]`` (:meth:`Actor.state`, :meth:`Policy.state`) and what was beside it:
        :meth:`Actor.low_dim`, or an imported policy's goal."""
        inputs = [_given.floats("state", state, (self.native.input_lengths[0],)), _given.beside(beside, self.native.input_lengths[-1])]
        return _explanation(self.native, inputs, output, 0, self._scale)


def _pixel_inputs(frame: Any, context: Any, low_dim: Any) -> list[Floats]:
    given = _given.frames_of("frame", frame, None) / np.float32(FULL_SCALE_M)
    return [given.ravel(), _given.floats("context", context, (CONTEXT,)), _given.floats("low_dim", low_dim, (LOW_DIM,))]


class Pixels:
    """Explains an actor's decision by all pixels of the newest frame, exactly, and by what it remembered.

    Args:
        actor: the actor.
        backgrounds: frames in metres ``[B, 128, 256]``, what was remembered ``[B, 328]`` and low-dimensional observations ``[B, 8]`` to
            compare with.
    """

    def __init__(self, actor: Actor, backgrounds: tuple[Any, Any, Any]) -> None:
        _given.made("actor", actor, Actor)
        frames, contexts, low_dims = backgrounds
        if not len(frames) == len(contexts) == len(low_dims):
            raise ValueError(f"backgrounds: {len(frames)} frames, {len(contexts)} contexts, {len(low_dims)} low-dimensional observations")
        self.native = _vigil.Explainer(actor.native, True, [_pixel_inputs(*given) for given in zip(frames, contexts, low_dims)])

    def explain(self, frame: Any, context: Any, low_dim: Any, output: int = YAW) -> Explanation:
        """Explains the decision on a frame ``[128, 256]`` in metres, beside which the actor held ``context`` and ``low_dim``
        (:meth:`Actor.context`, :meth:`Actor.low_dim`). ``phi`` is ``[128, 256]``."""
        found = _explanation(self.native, _pixel_inputs(frame, context, low_dim), output, 0, 1.0)
        return replace(found, phi=found.phi.reshape(ROWS, COLUMNS))


class PolicyPixels:
    """Explains an imported policy's decision by the pixels of its own frame.

    Args:
        policy: the policy.
        backgrounds: own frames (:meth:`Policy.own_frame`) with their goals to compare with.
    """

    def __init__(self, policy: Policy, backgrounds: Iterable[tuple[Any, Any]]) -> None:
        self.policy: Policy = _given.made("policy", policy, Policy)
        self.native = _vigil.Explainer(policy.native, True, [policy.inputs(f, g) for f, g in backgrounds])

    def explain(self, own_frame: Any, goal: Any, output: int = YAW) -> Explanation:
        """Explains the decision on its own frame. ``phi`` is ``[rows, columns, channels]``; outputs before they are limited."""
        policy = self.policy
        found = _explanation(self.native, policy.inputs(own_frame, goal), output, policy.frame_input, policy.output_scale)
        return replace(found, phi=found.phi.reshape(policy.frame_shape))
