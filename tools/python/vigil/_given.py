"""What callers give, checked: errors name the argument, what is expected and what came."""

from __future__ import annotations

import operator
import os
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
ROWS, COLUMNS, FRAMES = 128, 256, 5
FULL_SCALE_M = 100.0
CONTEXT, LOW_DIM = 328, 8
"""Values of an actor's memory and of its low-dimensional observation."""
POSITION = 9
"""Values of a position as an environment gives it."""
LATEST_S = 1e9
"""Latest time of a decision: thirty years, whose nanoseconds leave room for those of a flight."""


def floats(what: str, values: Any, shape: Sequence[int | None]) -> Floats:
    """``values`` as ``float32`` in one piece, of ``shape`` (``None``: any size), all finite.

    Raises:
        TypeError: values that are no numbers, or integers and booleans where ranges in metres are meant.
        ValueError: another shape, or a value that is not finite.
    """
    array = np.asarray(values)
    if array.dtype.kind != "f":
        if array.dtype.kind not in "iu" or len(shape) > 1:
            raise TypeError(f"{what}: expected floating-point numbers, got dtype {array.dtype}")
    fits = array.ndim == len(shape) and all(s is None or s == n for s, n in zip(shape, array.shape))
    if not fits:
        expected = tuple("any" if s is None else s for s in shape)
        raise ValueError(f"{what}: expected shape {expected}, got {array.shape}")
    with np.errstate(over="ignore"):
        narrow = np.ascontiguousarray(array, dtype=np.float32)
    finite = np.isfinite(narrow)
    if not finite.all():
        wrong = array[~finite][0]
        raise ValueError(f"{what}: holds a value that is {'beyond float32' if np.isfinite(wrong) else 'not a finite number'}: {wrong}")
    return narrow


def number(what: str, value: Any, expected: str, fits: Callable[[float], bool]) -> float:
    """A number that ``fits`` what is ``expected``; what is not a number fits nothing."""
    try:
        given = np.nan if isinstance(value, (str, bytes)) else float(value)
    except (OverflowError, TypeError, ValueError):
        given = np.nan
    if not fits(given):
        raise ValueError(f"{what}: {expected}, got {value!r}")
    return given


def conditions(wind: Any, noise: Any) -> dict[str, float]:
    """Wind and noise that courses are flown in."""
    return {
        "wind": number("wind", wind, "0 to 20 m/s", lambda x: 0.0 <= x <= 20.0),
        "noise": number("noise", noise, "a factor from 0 to 100", lambda x: 0.0 <= x <= 100.0),
    }


def whole(what: str, value: Any, least: int = 0, bits: int = 64) -> int:
    """A whole number from ``least``, of at most so many bits."""
    try:
        given = operator.index(value)
    except TypeError:
        raise TypeError(f"{what}: expected a whole number, got {value!r}") from None
    if not least <= given < 1 << bits:
        raise ValueError(f"{what}: {least} or more, below 2^{bits}, got {given}")
    return given


def path(what: str, value: Any) -> str:
    """The name of a file, in whichever way Python gives one."""
    try:
        return os.fsdecode(value)
    except TypeError:
        raise TypeError(f"{what}: expected a path, got {type(value).__name__}") from None


def seeds(value: Any) -> Any:
    """Course seeds to draw from, each of which is checked when it is drawn; absent: any."""
    if value is not None and len(made("seeds", value, Sequence, np.ndarray)) == 0:
        raise ValueError("seeds: is empty")
    return value


def strength(epsilon: Any, iterations: Any) -> tuple[float, int]:
    """ε and iterations of an attack."""
    given = number("epsilon", epsilon, "above 0 and at most 255", lambda x: 0.0 < x <= 255.0)
    return given, whole("iterations", iterations, 1, 32)


def threads(value: Any) -> int:
    """How many threads; absent: as many as the machine has."""
    return len(os.sched_getaffinity(0)) if value is None else whole("threads", value, 1, 16)


def made(what: str, value: Any, *kinds: type) -> Any:
    """``value``, which has to be an object of one of these classes."""
    if not isinstance(value, kinds):
        expected = " or ".join(f"a {kind.__module__}.{kind.__name__}".replace(" builtins.", " ") for kind in kinds)
        raise TypeError(f"{what}: {expected}, got {type(value).__name__}")
    return value


def position(value: Any) -> list[float]:
    """A goal, or all of an environment's ``position``."""
    given = floats("goal", value, (None,))
    if len(given) not in (2, POSITION):
        raise ValueError(f"goal: expected shape (2,) or ({POSITION},), got {given.shape}")
    if given[0] < 0.0:
        raise ValueError(f"goal: a distance of 0 m or more, got {given[0]} m")
    if given[-1] > LATEST_S and len(given) == POSITION:
        raise ValueError(f"goal: a time of at most {LATEST_S:.0f} s, got {given[-1]} s")
    return [float(x) for x in given]


def beside(value: Any, inputs: int = 2) -> Floats:
    """What a network takes beside the split point: an actor's low-dimensional observation ``[8]`` as it is, or, of an imported policy's goal,
    distance over 20 m, at most 1.05, and bearing over 1 rad."""
    if inputs == LOW_DIM:
        return floats("low_dim", value, (LOW_DIM,))
    distance_m, bearing_rad = map(float, floats("goal", value, (2,)))
    return np.array([min(distance_m, 21.0) / 20.0, bearing_rad], np.float32)


def backgrounds(given: tuple[Any, Any], inputs: int) -> tuple[Floats, Floats]:
    """DeepSHAP's background sample: states ``[B, values]`` and what was beside them."""
    states = floats("background states", given[0], (None, None))
    others = np.array([beside(value, inputs) for value in given[1]], np.float32)
    if len(states) != len(others):
        raise ValueError(f"backgrounds: {len(states)} states, but {len(others)} of what was beside them")
    return states, others


def frames_of(what: str, value: Any, count: int | None) -> Floats:
    """Frames in metres, ``[count, 128, 256]``, or one ``[128, 256]`` where ``count`` is ``None``."""
    frames = floats(what, value, (ROWS, COLUMNS) if count is None else (count, ROWS, COLUMNS))
    low, high = frames.min(), frames.max()
    if low < 0.0 or high > FULL_SCALE_M:
        raise ValueError(f"{what}: ranges are 0 to 100 m, one is {low if low < 0.0 else high} m")
    return frames
