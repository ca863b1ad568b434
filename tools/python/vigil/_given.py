"""What callers give, checked: errors name the argument, what is expected and what came."""

from __future__ import annotations

from collections.abc import Sequence
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
    array = np.ascontiguousarray(array, dtype=np.float32)
    if not np.isfinite(array).all():
        raise ValueError(f"{what}: holds a value that is not a finite number")
    return array


def seed(what: str, given: int) -> int:
    """A course's seed."""
    if not 0 <= given < 1 << 64:
        raise ValueError(f"{what}: 0 or more, below 2^64, got {given}")
    return given


def goal(value: Any) -> tuple[float, float]:
    """Distance in metres and bearing in radians."""
    distance_m, bearing_rad = floats("goal", value, (2,))
    return float(distance_m), float(bearing_rad)


def position(value: Any) -> list[float]:
    """A goal, or all of an environment's ``position``."""
    given = floats("goal", value, (None,))
    if len(given) not in (2, POSITION):
        raise ValueError(f"goal: expected shape (2,) or ({POSITION},), got {given.shape}")
    return [float(x) for x in given]


def beside(value: Any, inputs: int = 2) -> Floats:
    """What a network takes beside the split point: an actor's low-dimensional observation ``[8]`` as it is, or, of an imported policy's goal,
    distance over 20 m, at most 1.05, and bearing over 1 rad."""
    if inputs == LOW_DIM:
        return floats("low_dim", value, (LOW_DIM,))
    distance_m, bearing_rad = goal(value)
    return np.array([min(distance_m, 21.0) / 20.0, bearing_rad], np.float32)


def frames_of(what: str, value: Any, count: int | None) -> Floats:
    """Frames in metres, ``[count, 128, 256]``, or one ``[128, 256]`` where ``count`` is ``None``."""
    shape = (ROWS, COLUMNS) if count is None else (count, ROWS, COLUMNS)
    return floats(what, value, shape)
