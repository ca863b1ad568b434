"""Gymnasium environments over Vigil's simulator: a multicopter with a scanning LiDAR flies to a goal among obstacles.

A step is 50 ms. What an observation, an action and the reward are stands at :class:`VigilEnv`; :class:`VigilVectorEnv` flies several
at once on threads. ``gymnasium.make("Vigil-v0")`` works after ``import vigil.gym``, ``"VigilNormalized-v0"`` with spaces of ±1, and
``"VigilImages-v0"`` with frames as images besides.
"""

from __future__ import annotations

import math
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

from vigil import _given
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
"""The reward's terms and their defaults, those of ``vigil learn`` (docs/training.md) but for ``near``."""
# Memory of frames that is kept to be written anew: what the system has just given costs as much as the flight itself.
_SPARE = 3
_SEEDS = 2**48
_MOST_FLIGHTS = 16_384
EVERY = (1, 2, 4, 8)
"""What ``every`` may be: one ring and one firing of so many of the LiDAR's."""


def spaces_of(
    frames: int, privileged: bool, actor: Actor | None = None, normalized: bool = False, every: int = 1, images: bool = False
) -> tuple[spaces.Dict, spaces.Box]:
    """Observation and action space of one flight."""
    shape: tuple[int, ...] = (ROWS, COLUMNS) if every == 1 else (ROWS // 2 // every, COLUMNS // every)
    if frames == FRAMES or images:
        shape = (frames, *shape)
    ranges = spaces.Box(0.0, 1.0 if normalized else FULL_SCALE_M, shape, np.float32)
    seen = spaces.Box(0, 255, shape, np.uint8) if images else ranges
    if normalized:
        if privileged or actor is not None:
            raise ValueError("normalized: the true state and an actor's position have no bounds; leave out privileged and actor")
        goal = spaces.Box(np.array([0.0, -1.0], np.float32), np.array([1.0, 1.0], np.float32), dtype=np.float32)
        return spaces.Dict({"frames": seen, "goal": goal}), spaces.Box(-1.0, 1.0, (2,), np.float32)
    parts: dict[str, spaces.Space[Any]] = {
        "frames": seen,
        "goal": spaces.Box(
            np.array([0.0, -np.pi - 1e-3], np.float32), np.array([np.inf, np.pi + 1e-3], np.float32), dtype=np.float32
        ),
    }
    if actor is not None:
        parts["position"] = spaces.Box(-np.inf, np.inf, (Flights.POSITION,), np.float32)
    if privileged:
        parts["state"] = spaces.Box(-np.inf, np.inf, (Flights.TRUE_STATE,), np.float32)
    return spaces.Dict(parts), spaces.Box(-ACTION_LIMIT, ACTION_LIMIT, (2,), np.float32)


def _references(spare: list[Floats], number: int) -> int:
    return sys.getrefcount(spare[number])


# Of memory that nobody but the list holds: a view holds what it lies in.
_UNSEEN = _references([np.empty(1, np.float32)], 0)


class _Flown:
    """Flights and the memory of what is observed. Rust writes each frame once, into the caller's buffers or into memory of which nobody
    holds a view, so views stay true."""

    def __init__(self, count: int, options: Mapping[str, Any], threads: int, buffers: Mapping[str, Any] | None = None) -> None:
        frames, every, actor = _given.whole("frames", options["frames"]), _given.whole("every", options["every"]), options["actor"]
        if frames not in (1, FRAMES):
            raise ValueError(f"frames: 1 (the newest only) or {FRAMES}, got {frames}")
        if every not in EVERY:
            raise ValueError(f"every: one of {', '.join(map(str, EVERY))}, got {every!r}")
        if actor is not None:
            _given.made("actor", actor, Actor)
        reward = dict(DEFAULT_REWARD)
        given = _given.made("reward", options["reward"] or {}, Mapping)
        if unknown := set(given) - set(reward):
            raise ValueError(f"reward: no term is called {', '.join(sorted(unknown))}; there are {', '.join(reward)}")
        reward.update(given)
        if reward["progress"] not in ("way", "line"):
            raise ValueError(f"reward: progress is along the 'way' or the 'line', got {reward['progress']!r}")
        weights = {
            name: _given.number(f"reward: {name}", weight, "a finite number", lambda x: abs(x) < 3e38)
            for name, weight in reward.items()
            if name != "progress"
        }
        seeds, course, limit = _given.seeds(options["seeds"]), options["course"], options["time_limit"]
        if limit is not None:
            limit = _given.number("time_limit", limit, "above 0 and at most 3600 s", lambda x: 1e-9 < x <= 3600.0)
        self.copied, self.images, normalized = bool(options["copy"]), bool(options["images"]), bool(options["normalized"])
        if self.images and buffers and "frames" in buffers:
            raise ValueError("buffers: frames are no ranges with images=True; leave out one of the two")
        self.observed, self.acted = spaces_of(frames, bool(options["privileged"]), actor, normalized, every, self.images)
        self.seeds, self.count, self.newest = seeds, count, frames == 1
        self.full_scale, self.action_unit = (1.0, ACTION_LIMIT) if normalized else (FULL_SCALE_M, 1.0)
        self.shape = (count, frames, *(self.observed["frames"].shape or ())[-2:])
        self.flights = Flights(
            count,
            {
                "family": _given.made("family", options["family"], str),
                "course": None if course is None else str(Path(_given.path("course", course)).resolve(strict=True)),
                "time_limit": limit,
                "along_way": reward["progress"] == "way",
                "privileged": bool(options["privileged"]),
                "normalized": normalized,
                "frames": frames,
                "every": every,
                **_given.conditions(options["wind"], options["noise"]),
                **weights,
            },
            threads,
        )
        self.rewards, self.ends = np.zeros(count, np.float32), np.full(count, -1, np.int8)
        self.flags = {name: np.zeros(count, bool) for name in ("terminated", "truncated")}
        self.buffers: Mapping[str, Any] = buffers or {}
        self._given = self._checked(self.buffers)
        self._frames: Floats | None = None
        self._spare: list[Floats] = []

    def _checked(self, buffers: Mapping[str, Any]) -> dict[str, Any]:
        """The caller's buffers of what is observed; rewards and ends are taken up as they are."""
        wanted: dict[str, tuple[tuple[int, ...], Any]] = {
            name: ((self.count, *(space.shape or ())), np.float32) for name, space in self.observed.items()
        }
        wanted |= {"rewards": ((self.count,), np.float32)} | {name: ((self.count,), np.bool_) for name in self.flags}
        if unknown := set(buffers) - set(wanted):
            raise ValueError(f"buffers: there is none called {', '.join(sorted(unknown))}; there are {', '.join(wanted)}")
        for name, buffer in buffers.items():
            shape, kind = wanted[name]
            if not isinstance(buffer, np.ndarray) or buffer.dtype != kind or buffer.shape != shape:
                got = f"{buffer.dtype} {buffer.shape}" if isinstance(buffer, np.ndarray) else type(buffer).__name__
                raise ValueError(f"buffers: {name} is an array of {np.dtype(kind)} {shape}, got {got}")
            if not buffer.flags.c_contiguous or not buffer.flags.writeable:
                raise ValueError(f"buffers: {name} has to lie in one piece in C's order and be writeable (numpy.zeros makes such an array)")
        self.rewards = buffers.get("rewards", self.rewards)
        self.flags = {name: buffers.get(name, flags) for name, flags in self.flags.items()}
        return {name: buffer for name, buffer in buffers.items() if name in self.observed.spaces}

    def _unseen(self) -> Floats:
        for number in range(len(self._spare)):
            if _references(self._spare, number) == _UNSEEN:
                return self._spare.pop(number)
        return np.empty(self.shape, np.float32)

    def advance(self, seeds: Sequence[int | None], actions: Floats | None = None, *, anew: bool = True) -> dict[str, NDArray[Any]]:
        """Begins the flights that have a seed, flies a step of the others where there are actions. Gives what is observed of all,
        ``[count, …]``; views that cannot be written to, but for the caller's buffers. ``anew``: not where the last observation lies."""
        older: Floats | None = None
        frames = self._frames
        if "frames" in self._given:
            frames = self._given["frames"].reshape(self.shape)
        elif anew or frames is None:
            older, frames = frames, self._unseen()
        parts = {
            name: self._given.get(name, np.empty((self.count, *(space.shape or ())), np.float32))
            for name, space in self.observed.items()
            if name != "frames"
        }
        self.flights.advance(
            seeds, actions, older, frames, parts["goal"], parts.get("position"), parts.get("state"), self.rewards, self.ends
        )
        self._frames = frames
        if older is not None:
            self._spare = [*self._spare, older][-_SPARE:]
        if actions is not None:
            np.logical_and(self.ends >= 0, self.ends != 3, out=self.flags["terminated"])
            np.equal(self.ends, 3, out=self.flags["truncated"])
        if self.images:
            return {"frames": as_images(frames, self.full_scale), **parts}
        given = self._given.get("frames")
        if given is not None:
            frames = given
        else:
            frames = frames[:, 0] if self.newest else frames[:]
            frames = frames.copy() if self.copied else frames
            frames.flags.writeable = self.copied
        return {"frames": frames, **parts}


def as_images(frames: Floats, full_scale: float = FULL_SCALE_M) -> NDArray[np.uint8]:
    """Ranges, of which ``full_scale`` is 100 m, as ``uint8``, near is bright: 255 / (1 + range / 3 m), in 255ths what ``vigil import --depth
    contrast`` gives a policy."""
    bright = np.multiply(frames, FULL_SCALE_M / full_scale / 3.0, dtype=np.float32)
    bright += np.float32(1.0)
    np.divide(np.float32(255.0), bright, out=bright)
    bright += np.float32(0.5)
    return bright.astype(np.uint8)


def _actions(given: Any, count: int | None) -> Floats:
    shape = (2,) if count is None else (count, 2)
    array = np.asarray(given)
    if array.dtype.kind not in "fiu":
        raise TypeError(f"action: expected numbers, got dtype {array.dtype}")
    if array.shape != shape:
        raise ValueError(f"action: expected shape {shape} (forward speed, yaw), got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError("action: forward speed and yaw have to be finite numbers")
    return np.ascontiguousarray(array.clip(-ACTION_LIMIT, ACTION_LIMIT), np.float32).reshape(-1, 2)


class VigilEnv(gymnasium.Env[dict[str, NDArray[Any]], Floats]):
    """One flight over a generated course.

    **Observation**, a dict:

    ========  =====================  ==================================================================================
    frames    ``[5, 128, 256]``      ranges in metres, 0 to 100, oldest first; ``[128, 256]``, the newest, with ``frames=1``.
                                     The first frame stands for the missing ones. An array that cannot be written to (see ``copy``)
                                     and stays as it is. ``every=2``, 4 or 8: fewer rows and columns, ``[64 / every, 256 / every]``.
    goal      ``[2]``                distance in metres and bearing in radians, clockwise, as the vehicle believes
    position  ``[9]``                with ``actor=…``: what an actor decides from beside its frames, as in flight: distance (m) and bearing
                                     (rad) of the goal; north, east and height (m), heading (rad), velocity forward and right (m/s) as the
                                     vehicle believes; time (s). ``Actor.decide(frame, position)``.
    state     ``[75]``               with ``privileged=True``: the true state of ``vigil learn``: 48 ranges around, velocity, way …
    ========  =====================  ==================================================================================

    **Action**, ``[2]``: forward speed in m/s and yaw in units of 30 °/s, clockwise, each in ±1.5; beyond it is clipped. Height is held.

    **Reward**, the sum of these terms; ``reward={…}`` changes some of them:

    ==========  =======  ==========================================================================================
    progress    "way"    metres nearer to the goal along the shortest free path, or along the straight "line"
    success     5        at the goal
    dead        −6       for a collision or leaving the bounds
    decision    −0.02    for each step
    checkpoint  0        at checkpoint C of N, times (1 + C/N)
    near        0        for each step that ends less than 1 m from an obstacle, the square of the share of that metre that is missing
    ==========  =======  ==========================================================================================

    A flight is terminated by success, collision and leaving the bounds, truncated by the course's time limit; ``info["outcome"]`` then
    says which, ``info["is_success"]`` whether it arrived. After a flight that is terminated the frame is that of the step before.

    Args:
        family: ``training``, ``validation``, ``hard``, ``dense`` or ``forest`` (docs/courses.md).
        seeds: course seeds to draw from; absent: any. What is evaluated should not be trained on.
        course: a course file (TOML) that is flown instead of generated ones.
        frames: 5, or 1 for the newest only.
        every: 2, 4 or 8: one ring and one firing of so many of the LiDAR's, for training that wants many steps: ``frames`` are then its ranges
            as measured, a row a ring, gaps not filled (100 m).
        privileged: the observation has the true state.
        actor: the observation has the position that an actor takes. It is not asked for decisions.
        wind: mean wind in m/s, 0 to 20, from a direction that the seed decides, with gusts a third as strong.
        noise: multiplies the LiDAR's range noise and dropouts, 0 to 100; not for :meth:`potential_field`, whose LiDAR has them as with 1.
        time_limit: seconds after which a flight is cut off (0.5: after 10 steps and the beginning of another); absent: the course's.
        reward: terms of the reward that differ from the defaults.
        normalized: spaces of ±1 (``VigilNormalized-v0``): frames over 100 m, distance over 20 m and at most 1, bearing over π; actions of
            ±1 are the whole ±1.5. Not with ``privileged`` or ``actor``, which have no bounds.
        images: frames as ``uint8`` images, ``[1 or 5, rows, columns]``, near is bright (:func:`as_images`): what Stable-Baselines3 convolves.
        copy: frames are copies that can be written to; PyTorch warns of arrays that cannot. ``VigilNormalized-v0`` gives such.
        render_mode: ``rgb_array``: :meth:`render` gives the course from above with the way flown.

    ``reset(seed=…)`` decides all that is drawn after it; ``reset(options={"course_seed": 7})`` flies that very course. The same seed and
    actions give the same bits. A step releases the interpreter's lock.

    Raises:
        ValueError: an argument out of range, an action of another shape or not finite, a step without a reset.
        TypeError: an action that is no numbers, a count or seed that is no whole number, an argument of another kind.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}

    def __init__(
        self,
        family: str = "training",
        *,
        seeds: Sequence[int] | None = None,
        course: str | Path | None = None,
        frames: int = FRAMES,
        every: int = 1,
        privileged: bool = False,
        actor: Actor | None = None,
        wind: float = 0.0,
        noise: float = 1.0,
        time_limit: float | None = None,
        reward: Mapping[str, float | str] | None = None,
        normalized: bool = False,
        images: bool = False,
        copy: bool = False,
        render_mode: str | None = None,
    ) -> None:
        options = dict(locals())
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode: None or 'rgb_array', got {render_mode!r}")
        self._flown = _Flown(1, options, 1)
        self._begun = False
        self.render_mode = render_mode
        self.course_seed: int | None = None
        """Seed of the course that is flown."""
        self.observation_space: spaces.Space[Any] = self._flown.observed
        self.action_space: spaces.Space[Any] = self._flown.acted

    def _advance(self, seed: int | None, actions: Floats | None = None) -> dict[str, NDArray[Any]]:
        return {name: value[0] for name, value in self._flown.advance([seed], actions).items()}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Begins a flight, hovering at the course's start, within a degree of its heading. ``options``: ``course_seed``."""
        wanted: int | None = None
        seed = None if seed is None else _given.whole("seed", seed, bits=128)
        if options:
            if unknown := set(options) - {"course_seed"}:
                raise ValueError(f"options: there is course_seed, not {', '.join(sorted(unknown))}")
            wanted = _given.whole("options: course_seed", options["course_seed"])
        super().reset(seed=seed)
        drawn = _drawn(self.np_random, self._flown.seeds)
        self.course_seed = drawn if wanted is None else wanted
        observation = self._advance(self.course_seed)
        self._begun = True
        return observation, {**self._flown.flights.info(0), "course_seed": self.course_seed}

    def step(self, action: Any) -> tuple[dict[str, NDArray[Any]], float, bool, bool, dict[str, Any]]:
        """Flies 50 ms."""
        actions = _actions(action, None)
        if not self._begun:
            raise ValueError("the flight has not begun: reset first")
        observation = self._advance(None, actions)
        info, outcome = {**self._flown.flights.info(0), "course_seed": self.course_seed}, int(self._flown.ends[0])
        if outcome >= 0:
            info.update(outcome=OUTCOMES[outcome], is_success=outcome == 0)
        return observation, float(self._flown.rewards[0]), outcome in (0, 1, 2), outcome == 3, info

    def render(self) -> NDArray[np.uint8] | None:
        """The course from above with the way flown, ``[rows, columns, 3]``; ``None`` without ``render_mode``."""
        return self._flown.flights.map(0) if self.render_mode else None

    def potential_field(self, half_angle_rad: float = math.radians(60.0), range_m: float = 3.0) -> Floats:
        """The action ``[2]`` of the paper's potential field here and now, of the nearest surface within the angle and range."""
        return np.array(self._flown.flights.field(0, half_angle_rad, range_m), np.float32) / np.float32(self._flown.action_unit)


def _drawn(random: np.random.Generator, seeds: Sequence[int] | None) -> int:
    if seeds is None:
        return int(random.integers(_SEEDS))
    return _given.whole("seeds", seeds[int(random.integers(len(seeds)))])


class VigilVectorEnv(VectorEnv[dict[str, NDArray[Any]], Floats, NDArray[Any]]):
    """Several flights at once, on threads of Rust: observations ``[num_envs, …]``, rewards and ends ``[num_envs]``.

    As :class:`VigilEnv` otherwise. What becomes of a flight that ended is Gymnasium's ``autoreset_mode``:

    ==============  ==============================================================================================================
    ``NextStep``    it begins anew in the next step, whose action is not flown
    ``SameStep``    it begins anew in the same step, on ``info["course_seed"]``; ``"final_obs"`` and ``"final_info"`` are those of its end
    ``Disabled``    it waits for ``reset(options={"reset_mask": mask})``, ``mask`` an array ``[num_envs]`` of bool; the others fly on
    ==============  ==============================================================================================================

    Args:
        num_envs: how many, at most 16 384.
        threads: how many threads fly them; absent: as many as the machine has, at most ``num_envs``. The results do not depend on it.
        buffers: arrays of the caller's that each step writes in place and that are what it returns: any of the observation's names, ``rewards``
            (float32), ``terminated``, ``truncated`` (bool), as the batched spaces have them. Nothing is copied, and the last step's are gone.
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
        every: int = 1,
        privileged: bool = False,
        actor: Actor | None = None,
        wind: float = 0.0,
        noise: float = 1.0,
        time_limit: float | None = None,
        reward: Mapping[str, float | str] | None = None,
        normalized: bool = False,
        images: bool = False,
        copy: bool = False,
        threads: int | None = None,
        buffers: Mapping[str, NDArray[Any]] | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        options = dict(locals())
        if not 1 <= _given.whole("num_envs", num_envs) <= _MOST_FLIGHTS:
            raise ValueError(f"num_envs: 1 to {_MOST_FLIGHTS}, whose frames are 2 GB, got {num_envs}")
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self._flown = _Flown(num_envs, options, _given.threads(threads), buffers)
        self._ended = np.zeros(num_envs, bool)
        self._begun = False
        self.num_envs = num_envs
        self.single_observation_space, self.single_action_space = self._flown.observed, self._flown.acted
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._random = [np.random.default_rng() for _ in range(num_envs)]
        self.course_seeds: list[int] = [0] * num_envs
        """Seeds of the courses that are flown."""

    def _draw(self, number: int) -> int:
        self.course_seeds[number] = _drawn(self._random[number], self._flown.seeds)
        return self.course_seeds[number]

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
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
        if not self._begun and not mask.all():
            raise ValueError("reset_mask: the flights have not begun: reset all of them first")
        if seed is not None:
            several: Any = seed
            if np.ndim(several) == 0:
                several = range(first := _given.whole("seed", seed, bits=128), first + self.num_envs)
            if len(several) != self.num_envs:
                raise ValueError(f"seed: one for each of {self.num_envs} flights, got {len(several)}")
            seeds = {i: _given.whole("seed", one, bits=128) for i, one in enumerate(several) if one is not None}
            own = {i: seeding.np_random(given)[0] for i, given in seeds.items() if mask[i]}
            self._random = [own.get(i, random) for i, random in enumerate(self._random)]
            super().reset(seed=next(iter(seeds.values()), None))
        observation = self._flown.advance(self._drawn_for(mask))
        self._begun, self._ended = True, self._ended & ~mask
        return observation, {"course_seed": np.array(self.course_seeds)}

    def _drawn_for(self, mask: NDArray[np.bool_]) -> list[int | None]:
        """Seeds of those flights, which begin anew."""
        seeds: list[int | None] = [None] * self.num_envs
        for number in np.flatnonzero(mask):
            seeds[number] = self._draw(int(number))
        return seeds

    def step(
        self, actions: Any
    ) -> tuple[dict[str, NDArray[Any]], NDArray[Any], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Flies 50 ms. ``info``: ``course_seed``; ``outcome`` and ``is_success`` of those that ended (``_outcome`` says which)."""
        given = _actions(actions, self.num_envs)
        if not self._begun:
            raise ValueError("the flights have not begun: reset first")
        if self.autoreset_mode is AutoresetMode.DISABLED and self._ended.any():
            ended = ", ".join(str(number) for number in np.flatnonzero(self._ended))
            raise ValueError(f'flights {ended} have ended: reset(options={{"reset_mask": …}}) begins them anew')
        flown = self._flown
        observation = flown.advance(self._drawn_for(self._ended), given)
        self._ended = flown.ends >= 0
        rewards: NDArray[Any] = flown.rewards if "rewards" in flown.buffers else flown.rewards.astype(np.float64)
        terminated, truncated = (flags if name in flown.buffers else flags.copy() for name, flags in flown.flags.items())
        info: dict[str, Any] = {"course_seed": np.array(self.course_seeds)}
        if self._ended.any():
            names = np.array([OUTCOMES[o] if o >= 0 else None for o in flown.ends], dtype=object)
            info |= {"outcome": names, "_outcome": self._ended.copy(), "is_success": flown.ends == 0}
            info["_is_success"] = info["_outcome"]
            if self.autoreset_mode is AutoresetMode.SAME_STEP:
                observation, info = self._begun_in_the_same_step(observation, info)
        return observation, rewards, terminated, truncated, info

    def _begun_in_the_same_step(
        self, last: dict[str, NDArray[Any]], info: dict[str, Any]
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Begins those anew that have just ended; what they ended with goes into ``info``."""
        ended, final = self._ended, np.empty(self.num_envs, dtype=object)
        for number in np.flatnonzero(ended):
            final[number] = {name: value[number].copy() for name, value in last.items()}
        observation = self._flown.advance(self._drawn_for(ended), anew=False)
        self._ended = np.zeros(self.num_envs, bool)
        begun = {"course_seed": np.array(self.course_seeds), "_course_seed": np.ones(self.num_envs, bool)}
        return observation, {**info, **begun, "final_obs": final, "_final_obs": ended, "final_info": info, "_final_info": ended}


for _id, _options in (
    ("Vigil-v0", {}),
    ("VigilNormalized-v0", {"normalized": True, "copy": True}),
    ("VigilImages-v0", {"normalized": True, "images": True}),
):
    gymnasium.register(
        id=_id,
        entry_point="vigil.gym:VigilEnv",
        vector_entry_point="vigil.gym:VigilVectorEnv",
        order_enforce=False,
        kwargs=_options,
    )
