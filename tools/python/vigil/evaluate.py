"""Courses completed by the whole stack in lockstep, attacked or not: what ``vigil evaluate`` flies, as a function."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike

import numpy as np

from vigil import _given, _vigil


@dataclass(frozen=True)
class Flight:
    """A flight that has ended."""

    seed: int
    outcome: str
    """``success``, ``collision``, ``out of bounds``, ``time-out``, as `vigil evaluate` names them, or ``never took off``."""
    time_s: float
    """Simulated seconds from lift-off, or from the start in the air."""
    path_length_m: float
    closest_goal_m: float
    altered_frames: int
    """Frames that an attack altered."""
    first_alarm_step: int | None
    """Step of the first alarm."""


@dataclass(frozen=True)
class Completion:
    """How flights ended."""

    flights: list[Flight]

    @property
    def completed(self) -> int:
        """How many arrived."""
        return self.counts()["success"]

    @property
    def completion(self) -> float:
        """Share of them, 0 to 1."""
        return self.completed / len(self.flights)

    def counts(self) -> Counter[str]:
        """How many ended in each way."""
        return Counter(flight.outcome for flight in self.flights)

    def interval_95(self) -> tuple[float, float]:
        """Wilson's 95 % interval of the completion."""
        n, p, z = len(self.flights), self.completion, 1.959963984540054
        centre, half = p + z * z / (2 * n), z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
        return max(0.0, (centre - half) / (1 + z * z / n)), min(1.0, (centre + half) / (1 + z * z / n))


def completion(
    family: str = "validation",
    flights: int = 20,
    *,
    first_seed: int = 1,
    seeds: Sequence[int] | None = None,
    threads: int | None = None,
    pilot: str = "actor",
    actor: str | PathLike[str] | None = None,
    apf: bool = True,
    detector: bool | str | PathLike[str] | None = None,
    guard: bool | None = None,
    wind: float = 0.0,
    noise: float = 1.0,
    ground: bool = False,
    attack: str | None = None,
    epsilon: float = 1.0,
    iterations: int = 20,
    burst: int | str = 50,
) -> Completion:
    """Flies generated courses with the whole stack. The same arguments give the same flights, bit for bit. About 0.3 s of a core each.

    Args:
        family: ``training``, ``validation``, ``hard``, ``dense`` or ``forest``.
        flights, first_seed: seeds ``first_seed`` to ``first_seed + flights − 1``; or ``seeds`` themselves.
        threads: absent: as many as the machine has.
        pilot: ``actor`` or ``geometric``.
        actor: an actor's or imported policy's file; absent: the actor built in.
        apf: add the potential field to the actor's action.
        detector: whether the actor is watched, or the file of the detector that watches it (an imported policy has its own, or ``False``); absent:
            as in flight.
        guard: whether it is guarded; absent: as in flight.
        wind: mean wind, m/s.
        noise: multiplies the LiDAR's range noise and dropouts.
        ground: begin on the ground; otherwise hovering.
        attack: a method of :mod:`vigil.attack` on the frames as they pass, with ``epsilon``, ``iterations`` and ``burst`` (steps attacked once in a
            flight, or ``"continuous"``).

    Raises:
        ValueError: an argument out of range, a file that is refused.
        TypeError: an argument of another kind.
        KeyboardInterrupt: Ctrl-C, after at most four flights of each thread.
    """
    named = "first_seed" if seeds is None else "seeds"
    seeds = _given.seeds(seeds)
    if seeds is None:
        first = _given.whole(named, first_seed)
        seeds = range(first, first + _given.whole("flights", flights, 1))
    switched = detector is None or isinstance(detector, (bool, np.bool_))
    epsilon, iterations = _given.strength(epsilon, iterations)
    options = {
        **locals(),
        "actor": None if actor is None else _given.path("actor", actor),
        "detector": detector if switched else True,
        "detector_file": None if switched else _given.path("detector", detector),
        "burst": str(burst),
        **_given.conditions(wind, noise),
    }
    switch, absent = (bool, np.bool_), type(None)
    kinds = {"family": (str,), "pilot": (str,), "apf": switch, "guard": (*switch, absent), "ground": switch, "attack": (str, absent)}
    for name, expected in kinds.items():
        _given.made(name, options[name], *expected)
    rows = _vigil.fly([_given.whole(named, seed) for seed in seeds], _given.threads(threads), options)
    return Completion([Flight(*row) for row in rows])
