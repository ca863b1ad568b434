"""Gymnasium environments over Vigil's simulator: a multicopter with a scanning LiDAR flies to a goal among obstacles.

A step is 50 ms. What an observation, an action and the reward are stands at :class:`VigilEnv`; :class:`VigilVectorEnv` flies several
at once on threads. ``gymnasium.make("Vigil-v0")`` works after ``import vigil.gym``, and ``"VigilNormalized-v0"`` with spaces of ±1.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from vigil._given import COLUMNS, FRAMES, FULL_SCALE_M, ROWS, Floats
from vigil._vigil import Flights
from vigil.policy import Actor

ACTION_LIMIT = 1.5
"""Largest forward speed, m/s, and largest yaw, units of 30 °/s."""
YAW_UNIT_RAD_S = math.radians(30.0)
"""Yaw rate of a yaw of 1."""
OUTCOMES = ("success", "collision", "out of bounds", "time-out")
"""How a flight can end."""
DEFAULT_REWARD: Mapping[str, float | str] = {
    "progress": "way",
    "success": 5.0,
    "dead": -6.0,
    "decision": -0.02,
    "checkpoint": 0.0,
    "near": 0.0,
}
"""The reward's terms and their defaults, those of ``vigil learn`` (docs/training.md)."""
# Frames of a block: the views handed out lie in it, and a new one is begun when it is full.
_BLOCK = 32
# Blocks kept to be written anew: memory that the system has just given costs as much as the flight itself.
_SPARE_BLOCKS = 3
_SEEDS = 2**48


_GOAL_SCALE_M = 20.0
"""Distance of the goal that is 1 in a normalised observation, and the most, as the networks take it."""


def spaces_of(
    frames: int, privileged: bool, actor: Actor | None = None, normalized: bool = False
) -> tuple[spaces.Dict, spaces.Box]:
    """Observation and action space of one flight."""
    shape = (FRAMES, ROWS, COLUMNS) if frames == FRAMES else (ROWS, COLUMNS)
    if normalized:
        if privileged or actor is not None:
            raise ValueError("normalized: the true state and an actor's position have no bounds; leave out privileged and actor")
        goal = spaces.Box(np.array([0.0, -1.0], np.float32), np.array([1.0, 1.0], np.float32), dtype=np.float32)
        seen = spaces.Dict({"frames": spaces.Box(0.0, 1.0, shape, np.float32), "goal": goal})
        return seen, spaces.Box(-1.0, 1.0, (2,), np.float32)
    parts: dict[str, spaces.Space[Any]] = {
        "frames": spaces.Box(0.0, FULL_SCALE_M, shape, np.float32),
        "goal": spaces.Box(
            np.array([0.0, -np.pi - 1e-3], np.float32), np.array([np.inf, np.pi + 1e-3], np.float32), dtype=np.float32
        ),
    }
    if actor is not None:
        parts["position"] = spaces.Box(-np.inf, np.inf, (Flights.POSITION,), np.float32)
    if privileged:
        parts["state"] = spaces.Box(-np.inf, np.inf, (Flights.TRUE_STATE,), np.float32)
    return spaces.Dict(parts), spaces.Box(-ACTION_LIMIT, ACTION_LIMIT, (2,), np.float32)


def _references(blocks: list[Floats], number: int) -> int:
    return sys.getrefcount(blocks[number])


# Of a block that nobody but the list holds: a view holds the block that it lies in.
_UNSEEN = _references([np.empty(1, np.float32)], 0)


class _Flown:
    """Flights and the memory of their frames. Rust writes each frame once; a block is written anew only when no view of it is left,
    so views stay true."""

    def __init__(self, count: int, frames: int, threads: int, options: Mapping[str, Any]) -> None:
        if frames not in (1, FRAMES):
            raise ValueError(f"frames: 1 (the newest only) or {FRAMES}, got {frames}")
        reward = dict(DEFAULT_REWARD)
        given = dict(options["reward"] or {})
        if unknown := set(given) - set(reward):
            raise ValueError(f"reward: no term is called {', '.join(sorted(unknown))}; there are {', '.join(reward)}")
        reward.update(given)
        if reward["progress"] not in ("way", "line"):
            raise ValueError(f"reward: progress is along the 'way' or the 'line', got {reward['progress']!r}")
        course = options["course"]
        self.count, self.frames, self.privileged = count, frames, bool(options["privileged"])
        self.share_frames = bool(options["share_frames"])
        self.normalized = bool(options["normalized"])
        actor: Actor | None = options["actor"]
        if actor is not None and not isinstance(actor, Actor):
            raise TypeError(f"actor: a vigil.policy.Actor, got {type(actor).__name__}")
        self.actor = actor
        self.flights = Flights(
            count,
            family=options["family"],
            course=None if course is None else Path(course).read_text(encoding="utf-8"),
            wind=float(options["wind"]),
            noise=float(options["noise"]),
            time_limit=options["time_limit"],
            success=float(reward["success"]),
            dead=float(reward["dead"]),
            decision=float(reward["decision"]),
            checkpoint=float(reward["checkpoint"]),
            near=float(reward["near"]),
            along_way=reward["progress"] == "way",
            privileged=self.privileged,
            actor=None if actor is None else actor.native,
            threads=threads,
        )
        self.back = frames - 1
        self.slot = -1
        self.block: Floats = np.empty((0,), np.float32)
        self._spare: list[Floats] = []

    def _next_slot(self, fresh: bool) -> None:
        """Where the next frames go. ``fresh``: a flight begins, whose older frames must not be written over those of the last."""
        if self.slot >= 0 and not fresh and self.slot + 1 < self.block.shape[1]:
            self.slot += 1
            return
        older, at = self.block, self.slot
        self.block = self._unseen_block()
        if at >= 0:
            self.block[:, : self.back] = older[:, at - self.back + 1 : at + 1]
            self._spare = [*self._spare, older][-_SPARE_BLOCKS:]
        self.slot = self.back

    def _unseen_block(self) -> Floats:
        for number in range(len(self._spare)):
            if _references(self._spare, number) == _UNSEEN:
                return self._spare.pop(number)
        # Pages that are not written take no memory.
        return np.empty((self.count, self.back + _BLOCK, ROWS, COLUMNS), np.float32)

    def reset(self, seeds: Sequence[int | None]) -> None:
        self._next_slot(fresh=True)
        self.flights.reset(list(seeds), self.block, self.slot, self.back)

    def reset_some(self, seeds: Sequence[int | None]) -> None:
        """Begins those flights anew that have a seed, here and now; the others are where they were."""
        older, at = self.block, self.slot
        self.block = self._unseen_block()
        self.block[:, : self.back + 1] = older[:, at - self.back : at + 1]
        self._spare = [*self._spare, older][-_SPARE_BLOCKS:]
        self.slot = self.back
        self.flights.reset(list(seeds), self.block, self.slot, self.back)

    def step(self, actions: Floats, seeds: Sequence[int | None]) -> tuple[Floats, NDArray[np.int8]]:
        begins = any(seed is not None for seed in seeds)
        self._next_slot(fresh=begins)
        if begins:
            self.flights.reset(list(seeds), self.block, self.slot, self.back)
        flies = [seed is None for seed in seeds]
        if self.normalized:
            actions = np.clip(actions, -1.0, 1.0) * np.float32(ACTION_LIMIT)
        return self.flights.step(actions, flies, self.block, self.slot)

    def observation(self) -> dict[str, Floats]:
        """Of all flights, ``[count, …]``. Views cannot be written to."""
        view = self.block[:, self.slot - self.back : self.slot + 1]
        view.flags.writeable = False
        # Five frames share four with the next five, which Gymnasium's check does not allow; the newest alone shares nothing.
        if self.frames == 1:
            view = view[:, 0]
        elif not self.share_frames:
            view = view.copy()
        goals = self.flights.goals().reshape(self.count, 2)
        if self.normalized:
            view = view / np.float32(FULL_SCALE_M)
            goals = np.stack([goals[:, 0] / _GOAL_SCALE_M, goals[:, 1] / np.pi], axis=1).clip(-1.0, 1.0).astype(np.float32)
        observation = {"frames": view, "goal": goals}
        if self.actor is not None:
            observation["position"] = self.flights.positions().reshape(self.count, -1)
        if self.privileged:
            observation["state"] = self.flights.true_states().reshape(self.count, -1)
        return observation

    def info(self, number: int) -> dict[str, Any]:
        time_s, goal_distance_m, passed, of, position, velocity, heading = self.flights.info(number)
        return {
            "time_s": time_s,
            "goal_distance_m": goal_distance_m,
            "checkpoints": passed,
            "checkpoints_of": of,
            "position_ned_m": np.array(position, np.float32),
            "velocity_ned_m_s": np.array(velocity, np.float32),
            "heading_rad": heading,
        }


def _actions(given: Any, count: int | None) -> Floats:
    shape = (2,) if count is None else (count, 2)
    array = np.asarray(given)
    if array.dtype.kind not in "fiu":
        raise TypeError(f"action: expected numbers, got dtype {array.dtype}")
    if array.shape != shape:
        raise ValueError(f"action: expected shape {shape} (forward speed, yaw), got {array.shape}")
    array = np.ascontiguousarray(array, np.float32).reshape(-1, 2)
    if not np.isfinite(array).all():
        raise ValueError("action: forward speed and yaw have to be finite numbers")
    return array


class VigilEnv(gymnasium.Env[dict[str, Floats], Floats]):
    """One flight over a generated course.

    **Observation**, a dict:

    ========  =====================  ==================================================================================
    frames    ``[5, 128, 256]``      ranges in metres, 0 to 100, oldest first; ``[128, 256]``, the newest, with ``frames=1``.
                                     The first frame stands for the missing ones. The newest alone is handed over without a
                                     copy, as a view that cannot be written to; so are five with ``share_frames=True``.
    goal      ``[2]``                distance in metres and bearing in radians, clockwise, as the vehicle believes
    position  ``[9]``                with ``actor=…``: what an actor decides from beside its frames, as in flight: distance (m) and bearing
                                     (rad) of the goal; north, east and height (m), heading (rad), velocity forward and right (m/s) as the
                                     vehicle believes; time (s). ``Actor.decide(frame, position)``.
    state     ``[75]``               with ``privileged=True``: the true state of ``vigil learn``: 48 ranges around, velocity, way …
    ========  =====================  ==================================================================================

    **Action**, ``[2]``: forward speed in m/s and yaw in units of 30 °/s, clockwise, each in ±1.5; beyond it is clipped. Height is held.

    **Reward**, the sum of these terms; ``reward={…}`` changes some of them:

    ==========  =======  ==========================================================================================
    progress    "way"    metres nearer to the goal along the shortest free way, or along the straight "line"
    success     5        at the goal
    dead        −6       for a collision or leaving the bounds
    decision    −0.02    for each step
    checkpoint  0        at checkpoint C of N, times (1 + C/N)
    near        0        for each step that ends less than 1 m from an obstacle, the share of that metre that is missing
    ==========  =======  ==========================================================================================

    A flight is terminated by success, collision and leaving the bounds, truncated by the course's time limit; ``info["outcome"]`` then
    says which, ``info["is_success"]`` whether it arrived. After a collision the frame is that of the step before.

    Args:
        family: ``training``, ``validation``, ``hard`` or ``dense`` (docs/courses.md).
        seeds: course seeds to draw from; absent: any. What is evaluated should not be trained on.
        course: a course file (TOML) that is flown instead of generated ones.
        frames: 5, or 1 for the newest only.
        share_frames: five frames are a view without a copy as well. It stays as it is while the flight goes on, but shares four frames with
            the next observation, which Gymnasium's ``check_env`` does not allow.
        privileged: the observation has the true state.
        actor: the observation has the position that an actor takes. It is not asked for decisions.
        wind: mean wind in m/s, 0 to 20, from a direction that the seed decides, with gusts a third as strong.
        noise: multiplies the LiDAR's range noise and dropouts; 0 to 100.
        time_limit: seconds after which a flight is cut off; absent: the course's.
        reward: terms of the reward that differ from the defaults.
        normalized: spaces of ±1 (``VigilNormalized-v0``): frames over 100 m, distance over 20 m and at most 1, bearing over π; actions of
            ±1 are the whole ±1.5. Not with ``privileged`` or ``actor``, which have no bounds.
        render_mode: ``rgb_array``: :meth:`render` gives the course from above with the way flown.

    ``reset(seed=…)`` decides all that is drawn after it; ``reset(options={"course_seed": 7})`` flies that very course. The same seed and
    actions give the same bits. A step releases the interpreter's lock.

    Raises:
        ValueError: an argument out of range, an action of another shape or not finite, a step without a reset.
        TypeError: an action that is no numbers.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}

    def __init__(
        self,
        family: str = "training",
        *,
        seeds: Sequence[int] | None = None,
        course: str | Path | None = None,
        frames: int = FRAMES,
        share_frames: bool = False,
        privileged: bool = False,
        actor: Actor | None = None,
        wind: float = 0.0,
        noise: float = 1.0,
        time_limit: float | None = None,
        reward: Mapping[str, float | str] | None = None,
        normalized: bool = False,
        render_mode: str | None = None,
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode: None or 'rgb_array', got {render_mode!r}")
        if seeds is not None and len(seeds) == 0:
            raise ValueError("seeds: is empty")
        options = dict(
            family=family,
            course=course,
            share_frames=share_frames,
            privileged=privileged,
            actor=actor,
            wind=wind,
            noise=noise,
            time_limit=time_limit,
            reward=reward,
            normalized=normalized,
        )
        self._flown = _Flown(1, frames, 1, options)
        self._seeds = seeds
        self._begun = False
        self.render_mode = render_mode
        self.course_seed: int | None = None
        """Seed of the course that is flown."""
        observed, acted = spaces_of(frames, privileged, actor, normalized)
        self.observation_space: spaces.Space[Any] = observed
        self.action_space: spaces.Space[Any] = acted

    def _observation(self) -> dict[str, Floats]:
        return {name: value[0] for name, value in self._flown.observation().items()}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Floats], dict[str, Any]]:
        """Begins a flight, hovering at the course's start. ``options``: ``course_seed``."""
        super().reset(seed=seed)
        self.course_seed = _drawn(self.np_random, self._seeds)
        if options:
            if unknown := set(options) - {"course_seed"}:
                raise ValueError(f"options: there is course_seed, not {', '.join(sorted(unknown))}")
            self.course_seed = int(options["course_seed"])
        self._flown.reset([self.course_seed])
        self._begun = True
        return self._observation(), {**self._flown.info(0), "course_seed": self.course_seed}

    def step(self, action: Any) -> tuple[dict[str, Floats], float, bool, bool, dict[str, Any]]:
        """Flies 50 ms."""
        actions = _actions(action, None)
        if not self._begun:
            raise ValueError("the flight has not begun: reset first")
        rewards, outcomes = self._flown.step(actions, [None])
        info = self._flown.info(0)
        outcome = int(outcomes[0])
        if outcome >= 0:
            info.update(outcome=OUTCOMES[outcome], is_success=outcome == 0)
        return self._observation(), float(rewards[0]), outcome in (0, 1, 2), outcome == 3, info

    def render(self) -> NDArray[np.uint8] | None:
        """The course from above with the way flown, ``[rows, columns, 3]``; ``None`` without ``render_mode``."""
        return self._flown.flights.map(0) if self.render_mode else None

    def potential_field(self, half_angle_rad: float = math.radians(60.0), range_m: float = 3.0) -> Floats:
        """The action ``[2]`` of the paper's potential field here and now, of the nearest surface within the angle and range."""
        return np.array(self._flown.flights.field(0, half_angle_rad, range_m), np.float32)


def _drawn(random: np.random.Generator, seeds: Sequence[int] | None) -> int:
    return int(random.integers(_SEEDS)) if seeds is None else int(seeds[int(random.integers(len(seeds)))])


class VigilVectorEnv(VectorEnv[dict[str, Floats], Floats, NDArray[Any]]):
    """Several flights at once, on threads of Rust: observations ``[num_envs, …]``, rewards and ends ``[num_envs]``.

    As :class:`VigilEnv` otherwise. What becomes of a flight that ended is Gymnasium's ``autoreset_mode``:

    ==============  ==============================================================================================================
    ``NextStep``    it begins anew in the next step, whose action is not flown
    ``SameStep``    it begins anew in the same step; ``info["final_obs"]`` and ``info["final_info"]`` are those of its end
    ``Disabled``    it waits for ``reset(options={"reset_mask": mask})``, ``mask`` an array ``[num_envs]`` of bool; the others fly on
    ==============  ==============================================================================================================

    The newest frames alone are a view without a copy, as for one flight.

    Args:
        num_envs: how many.
        threads: how many threads fly them; absent: as many as the machine has, at most ``num_envs``. The results do not depend on it.
        autoreset_mode: see above; a ``gymnasium.vector.AutoresetMode`` or its value.
        **options: those of :class:`VigilEnv`, but for ``render_mode``.
    """

    metadata = {"render_modes": [], "render_fps": 20, "autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(
        self,
        num_envs: int,
        family: str = "training",
        *,
        seeds: Sequence[int] | None = None,
        course: str | Path | None = None,
        frames: int = FRAMES,
        share_frames: bool = False,
        privileged: bool = False,
        actor: Actor | None = None,
        wind: float = 0.0,
        noise: float = 1.0,
        time_limit: float | None = None,
        reward: Mapping[str, float | str] | None = None,
        normalized: bool = False,
        threads: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        if num_envs < 1:
            raise ValueError(f"num_envs: 1 or more, got {num_envs}")
        if seeds is not None and len(seeds) == 0:
            raise ValueError("seeds: is empty")
        options = dict(
            family=family,
            course=course,
            share_frames=share_frames,
            privileged=privileged,
            actor=actor,
            wind=wind,
            noise=noise,
            time_limit=time_limit,
            reward=reward,
            normalized=normalized,
        )
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self._flown = _Flown(num_envs, frames, _threads(threads), options)
        self._seeds = seeds
        self._ended = np.zeros(num_envs, bool)
        self._begun = False
        self.num_envs = num_envs
        self.single_observation_space, self.single_action_space = spaces_of(frames, privileged, actor, normalized)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._random = [np.random.default_rng() for _ in range(num_envs)]
        self.course_seeds: list[int] = [0] * num_envs
        """Seeds of the courses that are flown."""

    def _draw(self, number: int) -> int:
        self.course_seeds[number] = _drawn(self._random[number], self._seeds)
        return self.course_seeds[number]

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Floats], dict[str, Any]]:
        """Begins all flights. A seed is that of the first flight, the others have the following; or one for each.

        ``options``: ``reset_mask``, an array ``[num_envs]`` of bool: only these begin anew, and only these take their seed.
        """
        mask = np.ones(self.num_envs, bool)
        if options:
            if unknown := set(options) - {"reset_mask"}:
                raise ValueError(f"options: there is reset_mask, not {', '.join(sorted(unknown))}")
            mask = np.asarray(options["reset_mask"])
            if mask.dtype != np.bool_ or mask.shape != (self.num_envs,) or not mask.any():
                raise ValueError(
                    f"reset_mask: {self.num_envs} of bool are needed, one at least true, got {mask.dtype} {list(mask.shape)}"
                )
        seeds = [seed + i for i in range(self.num_envs)] if isinstance(seed, int) else seed
        if seeds is not None:
            if len(seeds) != self.num_envs:
                raise ValueError(f"seed: one for each of {self.num_envs} flights, got {len(seeds)}")
            for number, own in enumerate(seeds):
                if own is not None and mask[number]:
                    self._random[number] = seeding.np_random(own)[0]
        if mask.all():
            self._flown.reset([self._draw(number) for number in range(self.num_envs)])
        elif not self._begun:
            raise ValueError("reset_mask: the flights have not begun: reset all of them first")
        else:
            self._begin_anew(mask)
        self._begun, self._ended = True, self._ended & ~mask
        return self._flown.observation(), {"course_seed": np.array(self.course_seeds)}

    def _begin_anew(self, mask: NDArray[np.bool_]) -> None:
        self._flown.reset_some([self._draw(number) if mask[number] else None for number in range(self.num_envs)])

    def step(
        self, actions: Any
    ) -> tuple[dict[str, Floats], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Flies 50 ms. ``info``: ``outcome`` and ``is_success`` of those that ended (``_outcome`` says which)."""
        given = _actions(actions, self.num_envs)
        if not self._begun:
            raise ValueError("the flights have not begun: reset first")
        if self.autoreset_mode is AutoresetMode.DISABLED and self._ended.any():
            ended = ", ".join(str(number) for number in np.flatnonzero(self._ended))
            raise ValueError(f'flights {ended} have ended: reset(options={{"reset_mask": …}}) begins them anew')
        seeds = [self._draw(number) if ended else None for number, ended in enumerate(self._ended)]
        rewards, outcomes = self._flown.step(given, seeds)
        self._ended = outcomes >= 0
        info: dict[str, Any] = {}
        if self._ended.any():
            names = np.array([OUTCOMES[o] if o >= 0 else None for o in outcomes], dtype=object)
            info = {"outcome": names, "_outcome": self._ended.copy(), "is_success": outcomes == 0}
            info["_is_success"] = info["_outcome"]
            if self.autoreset_mode is AutoresetMode.SAME_STEP:
                info = self._begun_in_the_same_step(info)
        terminated = (outcomes >= 0) & (outcomes != 3)
        return self._flown.observation(), rewards.astype(np.float64), terminated, outcomes == 3, info


    def _begun_in_the_same_step(self, info: dict[str, Any]) -> dict[str, Any]:
        """Begins those anew that have just ended; what they ended with goes into ``info``."""
        last, ended = self._flown.observation(), self._ended
        final = np.empty(self.num_envs, dtype=object)
        for number in np.flatnonzero(ended):
            final[number] = {name: value[number].copy() for name, value in last.items()}
        self._begin_anew(ended)
        self._ended = np.zeros(self.num_envs, bool)
        return {**info, "final_obs": final, "_final_obs": ended, "final_info": info, "_final_info": ended}


def _threads(given: int | None) -> int:
    if given is not None and given < 1:
        raise ValueError(f"threads: 1 or more, got {given}")
    return given or len(os.sched_getaffinity(0))


for _id, _options in (("Vigil-v0", {}), ("VigilNormalized-v0", {"normalized": True})):
    gymnasium.register(
        id=_id,
        entry_point="vigil.gym:VigilEnv",
        vector_entry_point="vigil.gym:VigilVectorEnv",
        order_enforce=False,
        kwargs=_options,
    )
