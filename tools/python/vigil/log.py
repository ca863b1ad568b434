"""Flight logs (docs/log.md) as arrays, or as a table of pandas."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vigil import _given, _vigil
from vigil._given import COLUMNS, ROWS, Floats

_WORDS = ("state", "reasons", "alarm", "verdict")


@dataclass(frozen=True, eq=False)
class Log:
    """A flight, step by step. What was not known in a step is nan."""

    step: NDArray[np.uint64]
    """Numbers of the steps, ``[T]``."""
    time_s: NDArray[np.float64]
    """Time since the first step, seconds, ``[T]``."""
    numbers: dict[str, Floats]
    """``[T, width]``; ``[T]`` where one number is told. Units are in the names; ``goal``: distance (m) and bearing (rad) as the pilot saw
    it; ``action``: forward speed (m/s) and yaw (30 °/s); ``score``: 0 to 1; ``contributions``: of image, bearing, distance, own motion (`told`), and the base;
    ``phi``: ``[T, 48]``; both of an imported policy before its ``--output-scale``."""
    words: dict[str, list[Any]]
    """``state`` of guidance, ``reasons`` present (divided by ``", "``), cause of the ``alarm`` or ``None``, ``verdict``."""
    frame_steps: NDArray[np.uint64]
    """Steps of the frames, ``[F]``."""
    frames: Floats
    """Depth frames in metres, ``[F, 128, 256]``, as the firmware got them; empty unless asked for."""
    info: dict[str, str | None]
    """Program, seed, digests, configuration; of a simulated flight ``course`` and ``outcome``."""
    end: str
    """How the log ends."""

    def __getitem__(self, name: str) -> Any:
        return self.numbers[name] if name in self.numbers else self.words[name]

    def table(self) -> Any:
        """A ``pandas.DataFrame`` with a row for each step, ``time_s`` as index, a column for each number (``action_0``, ``action_1``, …).

        Raises:
            ImportError: pandas is not installed.
        """
        try:
            import pandas  # type: ignore[import-untyped]
        except ImportError as e:
            raise ImportError("vigil.log.Log.table needs pandas: pip install pandas") from e
        columns: dict[str, Any] = {"step": self.step}
        for name, values in self.numbers.items():
            if values.ndim == 1:
                columns[name] = values
            else:
                columns.update({f"{name}_{i}": values[:, i] for i in range(values.shape[1])})
        columns.update({name: self.words[name] for name in _WORDS})
        return pandas.DataFrame(columns, index=pandas.Index(self.time_s, name="time_s"))


def read(path: str | PathLike[str], *, frames: bool = False) -> Log:
    """Reads a flight log (``.mcap``); one that was cut off as far as it is whole.

    Args:
        path: the log.
        frames: the depth frames too: 131 kB for each step.

    Raises:
        ValueError: a file that is missing, no log, of another version, or damaged: one damaged chunk refuses all of it, and ``vigil
            recover`` saves the others.
    """
    found = _vigil.read_log(_given.path("path", path), frames)
    steps = len(found["step"])
    numbers = {
        name: values if width == 1 else values.reshape(steps, width) for name, (width, values) in found["numbers"].items()
    }
    now_ns = found["now_ns"]
    return Log(
        step=found["step"],
        time_s=(now_ns - now_ns[0]) * 1e-9 if steps else np.empty(0),
        numbers=numbers,
        words=dict(zip(_WORDS, found["words"])),
        frame_steps=found["frame_steps"],
        frames=found["frames"].reshape(-1, ROWS, COLUMNS),
        info=found["info"],
        end=found["end"],
    )
