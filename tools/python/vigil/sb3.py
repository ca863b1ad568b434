"""The vectorised environment as Stable-Baselines3 wants it: ``vigil.sb3.VigilVecEnv``. Needs stable-baselines3 (``pip install`` with ``[sb3]``)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv  # type: ignore[import-not-found, unused-ignore]

from vigil.gym import VigilVectorEnv


class VigilVecEnv(VecEnv):  # type: ignore[misc, unused-ignore]
    """Flights side by side in this process, on threads of Rust, where Stable-Baselines3 would fly them one after another.

    What it gives is what ``DummyVecEnv`` over environments of ``VigilImages-v0`` gives, to the bit: a flight that ended begins anew in the
    same step, ``infos[i]["terminal_observation"]`` is the last of the old one. ``VecMonitor`` around it keeps returns and lengths.

    Args:
        num_envs, family: as of :class:`vigil.gym.VigilVectorEnv`.
        images: frames as ``uint8`` images for the convolutions of ``MultiInputPolicy``; ``False``: ranges over 100 m.
        **options: those of :class:`vigil.gym.VigilVectorEnv`; spaces are of ±1 always.
    """

    def __init__(self, num_envs: int, family: str = "training", *, images: bool = True, **options: Any) -> None:
        fixed: dict[str, Any] = {"normalized": True, "images": images, "copy": True, "autoreset_mode": "SameStep"}
        if taken := sorted((set(fixed) | {"buffers"}) & set(options)):
            raise ValueError(f"{', '.join(taken)}: Stable-Baselines3 decides this; VigilVectorEnv takes it")
        self.flights = VigilVectorEnv(num_envs, family, **fixed, **options)
        self._actions: Any = None
        super().__init__(num_envs, self.flights.single_observation_space, self.flights.single_action_space)

    def reset(self) -> dict[str, NDArray[Any]]:
        """Begins all flights, with the seeds of ``seed()`` where there were any."""
        if any(self._options):
            raise ValueError("options: this environment takes none; seed() decides the courses")
        observation, _ = self.flights.reset(seed=self._seeds)
        self._reset_seeds()
        self.reset_infos = [{"course_seed": seed} for seed in self.flights.course_seeds]
        return observation

    def step_async(self, actions: Any) -> None:
        """Keeps the actions for :meth:`step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[dict[str, NDArray[Any]], NDArray[Any], NDArray[np.bool_], list[dict[str, Any]]]:
        """Flies 50 ms: observation, rewards, ends and an info for each flight."""
        observation, rewards, terminated, truncated, given = self.flights.step(self._actions)
        ended = terminated | truncated
        infos: list[dict[str, Any]] = [{"TimeLimit.truncated": False} for _ in range(self.num_envs)]
        for i in np.flatnonzero(ended):
            infos[i] = {
                "TimeLimit.truncated": bool(truncated[i] and not terminated[i]),
                "terminal_observation": given["final_obs"][i],
                "outcome": given["outcome"][i],
                "is_success": bool(given["is_success"][i]),
            }
            self.reset_infos[i] = {"course_seed": self.flights.course_seeds[i]}
        return observation, rewards.astype(np.float32), ended, infos

    def close(self) -> None:
        """Ends the flights."""
        self.flights.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of the flights, which are one object, once for each of them."""
        return [getattr(self.flights, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refused: the flights are one object."""
        raise NotImplementedError(f"{attr_name}: the flights are one object; give options when making it, or use DummyVecEnv")

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Refused: the flights are one object."""
        raise NotImplementedError(f"{method_name}: the flights are one object; use DummyVecEnv over VigilEnv for methods of each")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """None of them is."""
        return [False] * len(list(self._get_indices(indices)))
