"""LSTM-AD (docs/detectors.md): does a flight's stream of explanations look like an attack's?

:class:`Detector` is the frozen one, :class:`Monitor` explains and judges step by step as in flight, :func:`train` makes a :class:`Lstm` of
rows of any width: explanations of an imported policy, or anything else that ten steps have.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np

from vigil import _given, _vigil
from vigil._given import Floats
from vigil.policy import Actor, Policy

WINDOW = 10
"""Steps that a verdict looks at."""


class Lstm:
    """A trained network over ten rows, with the shift and scale of its rows.

    Args:
        params: the network's parameters.
        centre: subtracted from a row, ``[width]``.
        scale: divides a row, ``[width]``, above 0.
    """

    def __init__(self, params: Any, centre: Any, scale: Any) -> None:
        self.centre = _given.floats("centre", centre, (None,))
        self.scale = _given.floats("scale", scale, (len(self.centre),))
        self.params = _given.floats("parameters", params, (None,))
        self.native_lstm = _vigil.Lstm(self.params, self.centre, self.scale)

    def __reduce__(self) -> tuple[type[Lstm], tuple[Any, ...]]:
        return type(self), (self.params, self.centre, self.scale)

    def scores(self, rows: Any) -> Floats:
        """Scores ``[steps]``, 0 (unattacked) to 1 (attacked), of a flight's rows ``[steps, width]``; nan for the first nine."""
        return self.native_lstm.scores(_given.floats("rows", rows, (None, len(self.centre))))

    def save(self, path: str | PathLike[str]) -> None:
        """Writes it as ``.npz``, under the very name that is given."""
        with open(_given.path("path", path), "wb") as file:
            np.savez(file, params=self.params, centre=self.centre, scale=self.scale)

    @staticmethod
    def load(path: str | PathLike[str]) -> Lstm:
        """Reads what :meth:`save` wrote; a ``ValueError`` names any other file."""
        path = _given.path("path", path)
        try:
            with np.load(path, allow_pickle=False) as file:
                return Lstm(file["params"], file["centre"], file["scale"])
        except OSError:
            raise
        except Exception as e:
            raise ValueError(f"{path}: not a file that Lstm.save has written") from e


class Detector(Lstm):
    """A frozen detector: judges explanations ``[steps, 48]`` of one actor or imported policy at its split point.

    Args:
        path: its file (``vigil detector train``); absent: the one built in, of the built-in actor.

    Raises:
        ValueError: a file that is no unaltered detector.
    """

    def __init__(self, path: str | PathLike[str] | None = None) -> None:
        given = None if path is None else _given.path("path", path)
        self.path = None if given is None else os.path.abspath(given)
        """Its file, of which a copy is made anew; ``None``: the one built in."""
        self.native = _vigil.Detector(given)
        super().__init__(*self.native.network())

    def __reduce__(self) -> tuple[type[Lstm], tuple[Any, ...]]:
        return type(self), (self.path,)

    @property
    def threshold(self) -> float:
        """A score above it is an attack."""
        return self.native.threshold

    @property
    def actor_sha256(self) -> str:
        """Digest of the actor that it judges."""
        return self.native.actor_sha256

    @property
    def sha256(self) -> str:
        """Its digest."""
        return self.native.sha256

    def backgrounds(self) -> tuple[Floats, Floats]:
        """DeepSHAP's background sample: states ``[B, values]`` and low-dimensional observations ``[B, 8]``, or an imported policy's
        ``[B, 2]`` (distance / 20 m, bearing / 1 rad)."""
        count, states, positions = self.native.backgrounds()
        return states.reshape(count, -1), positions.reshape(count, -1)


@dataclass(frozen=True)
class Judgement:
    """A decision explained and judged. ``base + image + bearing + distance + told`` is the policy's yaw output, but for rounding; of an
    imported policy all of them are before its ``--output-scale``."""

    attacked: bool | None
    """The verdict; ``None`` until ten decisions were explained."""
    score: float | None
    """0 (unattacked) to 1 (attacked)."""
    image: float
    """Contribution of the frames to the yaw."""
    bearing: float
    """Contribution of the goal's bearing."""
    distance: float
    """Contribution of the goal's distance."""
    told: float
    """Contribution of own motion and last action."""
    base: float
    """Mean yaw of the background sample."""
    phi: Floats
    """Contributions at the split point, ``[48]``: of a split point with more values sums of neighbours, with fewer zeros behind them."""


class Monitor:
    """Explains and judges a policy's decisions one after the other, bit for bit as in flight.

    Args:
        actor: the actor, or an imported policy that has a split point.
        detector: of this very policy; absent: the built-in one, of the built-in actor.

    Raises:
        ValueError: a detector that was trained for another policy.
    """

    def __init__(self, actor: Actor | Policy, detector: Detector | None = None) -> None:
        _given.made("actor", actor, Actor, Policy)
        detector = Detector() if detector is None else _given.made("detector", detector, Detector)
        self._native = _vigil.Monitor(actor.native, detector.native)
        self._beside = actor.positional_inputs

    def judge(self, state: Any, beside: Any) -> Judgement:
        """Judges the decision made from a state ``[values]`` (:meth:`Actor.state`, :meth:`Policy.state`) and what was beside it:
        :meth:`Actor.low_dim`, or an imported policy's goal."""
        given = _given.beside(beside, self._beside)
        return Judgement(*self._native.judge(_given.floats("state", state, (self._native.width,)), given.tolist()))

    def reset(self) -> None:
        """Forgets the explanations: a new flight."""
        self._native.reset()


def freeze(
    path: str | PathLike[str],
    lstm: Lstm,
    actor: Actor | Policy,
    backgrounds: tuple[Any, Any],
    *,
    threshold: float = 0.5,
    threshold_choice: str = "chosen in Python",
    training_config: str = "",
    seed: int = 0,
) -> str:
    """Writes a detector that flies (``--detector-file``): a network over explanations ``[48]`` (:attr:`Judgement.phi`) of a policy.

    Args:
        path: the file.
        lstm: the network.
        actor: whose explanations it judges; an imported policy needs a split point.
        backgrounds: DeepSHAP's background sample, states ``[B, values]`` and what was beside them ``[B, 8]``, an imported policy's
            goals ``[B, 2]``: the one that the explanations were made with.
        threshold: a score above it is an attack, above 0 and below 1.
        threshold_choice, training_config, seed: what the file tells of its making; the configuration as TOML.

    Returns:
        Its SHA-256.

    Raises:
        ValueError: what could not judge in flight; then nothing is written.
    """
    _given.made("actor", actor, Actor, Policy)
    _given.made("lstm", lstm, Lstm)
    sample = _given.backgrounds(backgrounds, actor.positional_inputs)
    about = threshold, threshold_choice, training_config, _given.whole("seed", seed)
    return _vigil.write_detector(_given.path("path", path), lstm.native_lstm, actor.native, *sample, about)


@dataclass(frozen=True)
class Trained:
    """What training came to."""

    lstm: Lstm
    """The network of the chosen epoch."""
    chosen: int
    """That epoch, from 1: the one with the least loss on what chooses."""
    epochs: list[tuple[float, float, float]]
    """Of each epoch: loss while training, loss and accuracy on what chooses."""


Flights = Sequence[tuple[Any, Any]]


def windows(flights: Flights) -> tuple[Floats, np.ndarray]:
    """All windows ``[N, 10, width]`` of flights, each ``(rows [steps, width], attacked [steps])``, and whether their newest row is attacked."""
    found, attacked = [], []
    width = None
    for rows, labels in flights:
        rows = _given.floats("rows", rows, (None, width))
        width = rows.shape[1]
        labels = np.asarray(labels)
        if labels.dtype != np.bool_ or labels.shape != rows.shape[:1]:
            raise ValueError(f"attacked: expected {len(rows)} booleans, got {labels.dtype} of shape {labels.shape}")
        if len(rows) >= WINDOW:
            found.append(np.lib.stride_tricks.sliding_window_view(rows, WINDOW, axis=0).transpose(0, 2, 1))
            attacked.append(labels[WINDOW - 1 :])
    if not found:
        raise ValueError(f"flights: none has {WINDOW} steps")
    return np.ascontiguousarray(np.concatenate(found), np.float32), np.concatenate(attacked)


def train(
    learn: Flights,
    choose: Flights,
    *,
    epochs: int = 5,
    batch: int = 64,
    rate: float = 1e-3,
    seed: int = 1,
    threads: int | None = None,
) -> Trained:
    """Trains LSTM-AD on flights, each ``(rows [steps, width], attacked [steps])``.

    The rows are shifted and scaled to the mean and deviation of the unattacked ones and clipped to ±10. The same arguments give the same
    bits on any number of threads. Releases the interpreter's lock.

    Args:
        learn: flights to learn from.
        choose: other flights, which choose the epoch.

    Raises:
        ValueError: flights without attacked or without unattacked windows, rows of different width or not finite, a number out of range.
        KeyboardInterrupt: Ctrl-C.
    """
    (rows, attacked), (choosing, choosing_attacked) = windows(learn), windows(choose)
    width = rows.shape[2]
    if choosing.shape[2] != width:
        raise ValueError(f"rows: {width} wide to learn from, {choosing.shape[2]} wide to choose")
    if attacked.all():
        raise ValueError("the windows to learn from have to hold attacked and unattacked ones")
    quiet = rows[~attacked][:, -1].astype(np.float64)
    centre = quiet.mean(axis=0).astype(np.float32)
    scale = np.maximum(quiet.std(axis=0), 1e-4).astype(np.float32)

    def normalised(of: Floats) -> Floats:
        return np.ascontiguousarray(np.clip((of - centre) / scale, -10.0, 10.0), np.float32).ravel()

    rate = _given.number("rate", rate, "above 0 and below 1", lambda x: 0.0 < x < 1.0)
    how = _given.whole("epochs", epochs, 1, 32), _given.whole("batch", batch, 1, 32), rate, _given.whole("seed", seed)
    learned_from, chosen_by = (normalised(rows), attacked), (normalised(choosing), choosing_attacked)
    params, chosen, rows_of_epochs = _vigil.train(learned_from, chosen_by, width, how, _given.threads(threads))
    return Trained(Lstm(params, centre, scale), chosen, rows_of_epochs)
