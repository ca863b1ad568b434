"""What the policies of this folder see and how they are trained on it: wrappers around ``vigil.gym`` and networks of PyTorch.

An observation is one row of numbers, since Stable-Baselines3 takes n-step returns of nothing else: the last ``STACK`` frames as contrast,
``1 / (1 + range / 3 m)``, each pooled by ``POOL`` (the nearest surface of 8 × 8 pixels), then distance and bearing of the goal.
"""

from __future__ import annotations

import math
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

import vigil.gym

STACK = 4
POOL = 8
PICTURE = (STACK, 128 // POOL, 256 // POOL)
# An action of ±1 is a forward speed of 0 to 1.5 m/s and a yaw of ±1.5: noise around 0 flies on instead of hovering.
SCALE = (0.75, 1.5)
OFFSET = (0.75, 0.0)


def contrast(range_m: np.ndarray) -> np.ndarray:
    """Near is bright: what ``vigil import --depth contrast`` gives a policy."""
    return np.asarray(1.0 / (1.0 + range_m / 3.0), np.float32)


def pooled(frame_m: np.ndarray) -> np.ndarray:
    """``[128, 256]`` metres to ``[16, 32]`` contrast, near is bright: the nearest of each 8 × 8 pixels."""
    rows, columns = frame_m.shape
    return contrast(frame_m.reshape(rows // POOL, POOL, columns // POOL, POOL).min(axis=(1, 3)))


def goal_inputs(goal: np.ndarray) -> np.ndarray:
    """Distance over 20 m, at most 1.05, and bearing: as an imported policy gets them in flight."""
    return np.array([min(float(goal[0]) / 20.0, 1.05), goal[1]], np.float32)


class Decisions(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Decides every ``hold`` steps of 50 ms, sees the last ``STACK`` frames (each step's, whatever ``hold`` is), acts in ±1.

    In flight the policy decides in every step; while it learns, an action has to last long enough to matter.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], hold: int = 4) -> None:
        super().__init__(env)
        self.hold = hold
        count = math.prod(PICTURE)
        most = np.array([1.0] * count + [1.05, math.pi + 1e-3], np.float32)
        least = np.array([0.0] * count + [0.0, -math.pi - 1e-3], np.float32)
        self.observation_space = spaces.Box(least, most, dtype=np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self._pictures: list[np.ndarray] = []

    def _observed(self, observation: dict[str, np.ndarray]) -> np.ndarray:
        return np.concatenate([*(picture.ravel() for picture in self._pictures), goal_inputs(observation["goal"])])

    def field(self) -> np.ndarray:
        """The action of the potential field here and now, m/s and yaw."""
        return self.env.unwrapped.potential_field()

    def reset(self, **given: Any) -> tuple[np.ndarray, dict[str, Any]]:
        observation, info = self.env.reset(**given)
        self._pictures = [pooled(observation["frames"])] * STACK
        return self._observed(observation), info

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        total = 0.0
        for _ in range(self.hold):
            observation, reward, ended, cut, info = self.env.step(np.asarray(action) * SCALE + OFFSET)
            self._pictures = [*self._pictures[1:], pooled(observation["frames"])]
            total += float(reward)
            if ended or cut:
                break
        return self._observed(observation), total, ended, cut, info
