"""Attacks on what a policy sees (docs/adversary.md): pixels are altered along the policy's own gradient, so that it turns the wrong way.

ε is in 1/255 of the image's range: 1 is 0.39 m. Methods on our frames, whoever sees them: ``fgsm``, ``bim-clipped``,
``bim-accumulating`` (the paper's), ``pgd``, ``momentum``, ``l2``, ``patch``, ``spsa``, and without a gradient ``noise``, ``recede``,
``repaint``, ``blind``; on frames as they pass ``swell`` and ``replay`` too; on an imported policy's own frame the first four.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from vigil import _given, _vigil
from vigil._given import COLUMNS, CONTEXT, LOW_DIM, ROWS, Floats
from vigil.policy import Action, Actor, Policy

EFFECTIVE_YAW = 1.0
"""A change of the yaw by as much, 30 °/s, counts as effective."""


@dataclass(frozen=True)
class Attacked:
    """What an attack came to."""

    frames: Floats
    """The altered frames, of the shape that was given."""
    clean: Action
    """What the policy would have decided."""
    attacked: Action
    """What it decides on the altered frames."""

    @property
    def yaw_change(self) -> float:
        """Change of the yaw, units of 30 °/s."""
        return self.attacked.yaw - self.clean.yaw

    @property
    def is_effective(self) -> bool:
        """Whether the yaw moved by 30 °/s or more."""
        return abs(self.yaw_change) >= EFFECTIVE_YAW


def _checked(epsilon: float, iterations: int, towards: str, seed: int) -> tuple[float, int, str, int]:
    """What attacks are given besides the method."""
    if towards not in ("left", "right", "away"):
        raise ValueError(f"towards: left, right or away, got {towards!r}")
    return *_given.strength(epsilon, iterations), towards, _given.whole("seed", seed)


class StateAttack:
    """Alters the newest frame of a state of our actor, given what it remembers of the older ones: the paper's attack. Threads may share it
    (of a method that draws the calls' order then decides), but none may be in a call of it while the process forks.

    Args:
        actor: the actor attacked.
        method: how (see the module).
        epsilon: in 1/255 of the image's range, above 0 to 255.
        iterations: 1 or more.
        towards: ``left``, ``right``, or ``away`` from what it decides unattacked.
        seed: for the methods that draw.
    """

    def __init__(
        self,
        actor: Actor,
        method: str = "bim-accumulating",
        *,
        epsilon: float = 1.0,
        iterations: int = 20,
        towards: str = "away",
        seed: int = 0,
    ) -> None:
        if method in ("swell", "replay"):
            raise ValueError(f"method: {method} needs a flight's frames one after the other, as FrameAttack is shown them")
        _given.made("actor", actor, Actor)
        self.native = _vigil.StateAttack(actor.native, (method, *_checked(epsilon, iterations, towards, seed)))

    def attack(self, frame: Any, context: Any, low_dim: Any) -> Attacked:
        """Alters a copy of a frame ``[128, 256]`` in metres; ``context`` and ``low_dim`` are what the actor held beside it
        (:meth:`Actor.context`, :meth:`Actor.low_dim`)."""
        held = _given.floats("context", context, (CONTEXT,)), _given.floats("low_dim", low_dim, (LOW_DIM,)).tolist()
        altered, clean, attacked = self.native.attack(_given.frames_of("frame", frame, None), *held)
        return Attacked(altered.reshape(ROWS, COLUMNS), Action(*clean), Action(*attacked))


class FrameAttack:
    """Alters frames as they pass, the newest only, as an attacker in flight has to. Show it every frame of a flight.

    Its arguments are those of :class:`StateAttack`, but it attacks imported policies as well; pixels that such a policy does not look at
    stay as they are.
    """

    def __init__(
        self,
        actor: Actor | Policy,
        method: str = "bim-accumulating",
        *,
        epsilon: float = 1.0,
        iterations: int = 20,
        towards: str = "away",
        seed: int = 0,
    ) -> None:
        _given.made("actor", actor, Actor, Policy)
        self.native = _vigil.FrameAttack(actor.native, (method, *_checked(epsilon, iterations, towards, seed)))

    def pass_on(self, frame: Any, goal: Any) -> None:
        """A frame ``[128, 256]`` that passes as it is."""
        self.native.pass_on(_given.frames_of("frame", frame, None), _given.position(goal))

    def attack(self, frame: Any, goal: Any) -> Attacked:
        """Alters a copy of the frame ``[128, 256]`` in metres. ``clean``: had no frame been altered at all."""
        altered, clean, attacked = self.native.attack(_given.frames_of("frame", frame, None), _given.position(goal))
        return Attacked(altered.reshape(ROWS, COLUMNS), Action(*clean), Action(*attacked))

    def reset(self) -> None:
        """Forgets the frames: a new flight."""
        self.native.reset()


class PolicyAttack:
    """Alters the own frame of an imported policy (:meth:`Policy.own_frame`): every channel, so also what was seen before, as the paper does.

    Args:
        policy: the policy attacked.
        method: ``fgsm``, ``bim-clipped``, ``bim-accumulating`` or ``pgd``.
        epsilon, iterations, towards, seed: as for :class:`StateAttack`; ε in 1/255 of the policy's own range of pixels.
    """

    METHODS = ("fgsm", "bim-clipped", "bim-accumulating", "pgd")

    def __init__(
        self,
        policy: Policy,
        method: str = "bim-accumulating",
        *,
        epsilon: float = 1.0,
        iterations: int = 20,
        towards: str = "away",
        seed: int = 0,
    ) -> None:
        if method not in self.METHODS:
            raise ValueError(f"method: {method} is none of {', '.join(self.METHODS)}")
        self.policy: Policy = _given.made("policy", policy, Policy)
        self.epsilon, self.iterations, self.towards, seed = _checked(epsilon, iterations, towards, seed)
        self.method = method
        if method == "fgsm":
            self.iterations = 1
        self._random = np.random.default_rng(seed)

    def attack(self, own_frame: Any, goal: Any) -> Attacked:
        """Alters a copy of the policy's own frame ``[rows, columns, channels]``, whose pixels stay within its range."""
        clean_frame = _given.floats("own frame", own_frame, self.policy.frame_shape)
        low, high = min(0.0, self.policy.scale), max(0.0, self.policy.scale)
        epsilon = np.float32(self.epsilon / 255.0 * (high - low))
        clean = self.policy.outputs(clean_frame, goal)
        sign = {"left": -1.0, "right": 1.0}.get(self.towards) or (-1.0 if clean[1] >= 0.0 else 1.0)
        step = epsilon
        frame = clean_frame
        if self.method in ("bim-clipped", "pgd"):
            step = min(np.float32(2.5) * epsilon / np.float32(self.iterations), epsilon)
        if self.method == "pgd":
            start = self._random.uniform(-epsilon, epsilon, frame.shape).astype(np.float32)
            frame = np.clip(frame + start, low, high)
        for _ in range(self.iterations):
            # At a limit of its outputs the gradient of what they are is 0.
            gradient = self.policy._gradient(frame, goal, (0.0, 1.0), unsaturated=True)
            if not np.isfinite(gradient).all():
                raise ValueError("policy: its gradient here is not finite")
            frame = frame + step * (np.sign(gradient) * np.float32(sign))
            if self.method in ("bim-clipped", "pgd"):
                frame = np.clip(frame, clean_frame - epsilon, clean_frame + epsilon)
            frame = np.clip(frame, low, high).astype(np.float32)
        return Attacked(frame, _limited(clean), _limited(self.policy.outputs(frame, goal)))


def _limited(outputs: Floats) -> Action:
    forward, yaw = np.clip(outputs, -1.5, 1.5)
    return Action(float(forward), float(yaw))
