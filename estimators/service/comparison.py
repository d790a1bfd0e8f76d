"""Champion and challenger compared: on recordings, and on live states.

Two models on the states that a service answers, without the stream feeling it.

Both take the same rows from the history of the service, a few at a time, on whatever thread calls;
what they leave of the measured torque is kept in pairs, outside of contact, while the arm moves.
"""

from __future__ import annotations

from math import ceil, inf
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.model_folder import load_model, provenance
from estimators.service.gate import BLOCK, LEVEL, accuracy, compare, plain
from estimators.service.inference.contact import MARGIN
from limo_driver.errors import RecordingError

if TYPE_CHECKING:
    import threading
    from pathlib import Path

    from matplotlib.figure import Figure

    from estimators.residual_model import ResidualModel
    from estimators.service.gate import Comparison
    from estimators.service.inference.arm_service import ArmService
    from estimators.service.inference.live_model import LiveModel, StateRows
    from estimators.service.store.version import Version
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import BoolArray, FloatArray

SECONDS: Final = 5.0  # of a block; longer than a slow motion takes to change its direction
MOVES: Final = 1e-3  # [rad] of travel within a second; less says of friction what one pose does
_MEMORY: Final = 60.0  # [s] of motion before the first judged error
_ROWS: Final = 50  # at once, between which the stream gets the interpreter
_RATE: Final = 50.0  # [Hz] of errors kept; torque is filtered far below that


def compare_versions(
    champion: Version, challenger: Version, recording: Recording, seconds: float = SECONDS
) -> Comparison:
    """Compare two versions on a recording.

    Both are held against the measured torque behind the filter of the model that keeps more of it:
    what the other does not follow is its error.

    Args:
        champion: The one to be beaten.
        challenger: The other one.
        recording: That neither was trained on.
        seconds: Length of a block [s].

    Raises:
        ModelStoreError: A file of a version differs, or the recording has a rate that it cannot
            take.
        RecordingError: The recording is of another robot, or too short.
    """
    models = [champion.load(), challenger.load()]
    first, second = _errors(models, recording)
    return compare(first, second, _block(recording, seconds, len(first)))


def metrics(folder: Path, recording: Recording, seconds: float = SECONDS) -> dict[str, Any]:
    """Return the RMSE of a model folder on a recording with its interval, as JSON values.

    Raises:
        ModelStoreError: The folder does not fit together, or cannot take the recording's rate.
        RecordingError: The recording is of another robot, or too short.
    """
    model = load_model(folder)
    (errors,) = _errors([model], recording)
    found = accuracy(errors, _block(recording, seconds, len(errors)))
    return {
        "recording": provenance(recording),
        "bandwidth": model.bandwidth,
        "rmse": plain(found.value),
        "low": plain(found.low),
        "high": plain(found.high),
        "level": LEVEL,
    }


def difference_figure(comparison: Comparison, joints: tuple[str, ...], names: list[str]) -> Figure:
    """Draw the change of each joint's RMSE, in per cent of the champion's, with its interval.

    Args:
        comparison: Of n joints.
        joints: Their names.
        names: Of champion and challenger.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 0.42 * len(joints) + 1.5), layout="constrained")
    FigureCanvasAgg(figure)
    ax = figure.subplots()
    scale = 100.0 / comparison.champion
    found = comparison.difference
    value, low, high = (v * scale for v in (found.value, found.low, found.high))
    rows = np.arange(len(joints))
    colours = np.where(low > 0, "#D55E00", np.where(high < 0, "#0072B2", "0.55"))
    ax.hlines(rows, low, high, color=colours.tolist(), linewidth=2.2)
    ax.scatter(value, rows, color=colours.tolist(), zorder=3)
    ax.axvline(0.0, color="0.3", linewidth=0.8)
    ax.set_yticks(rows, joints)
    ax.invert_yaxis()
    ax.set_xlabel(f"RMSE of {names[1]} less that of {names[0]} [% of {names[0]}]")
    ax.set_title(
        f"{LEVEL:.0%} intervals from {comparison.blocks} blocks; blue better, orange worse, "
        "grey undecided",
        fontsize="small",
        loc="left",
    )
    ax.grid(axis="x", linewidth=0.4, alpha=0.5)
    ax.spines[["top", "right"]].set_visible(False)
    return figure


def _errors(models: list[ResidualModel[Any]], recording: Recording) -> list[FloatArray]:
    """Return the errors of each model at the instants that all can be judged at, (T, n) [N m]."""
    for model in models:
        recording.check_robot(model.simulation.model)
    bandwidths = [model.bandwidth for model in models]
    measured = recording.filtered_torque(max(bandwidths))
    scored = ~recording.edges(min(bandwidths))
    return [(model.predict(recording) - measured)[scored] for model in models]


def _block(recording: Recording, seconds: float, scored: int) -> int:
    """Return the samples of a block.

    Raises:
        RecordingError: There is not one block.
    """
    block = max(1, round(seconds * recording.rate))
    if scored < block:
        raise RecordingError(
            f"has {scored} samples to judge by, expected at least a block of {seconds:g} s, "
            f"{block} samples",
            path=recording.source or None,
        )
    return block


class Shadow:
    """Errors of a challenger beside those of the champion, on the same live states.

    Args:
        service: Whose states they see.
        champion: With a memory of its own; the one that serves is not touched.
        challenger: Likewise.
    """

    def __init__(self, service: ArmService, champion: LiveModel, challenger: LiveModel) -> None:
        self._service, self._models = service, (champion, challenger)
        rate = service.arm.rate
        self._stride = max(1, int(rate / _RATE))
        self._errors: list[FloatArray] = []  # each (2, T, n) [N m], champion and challenger
        self._kept = 0  # rows of them
        self._first = max(service.history.first, service.history.count - round(_MEMORY * rate))
        self._judged_from = service.history.count
        self._begin(self._first)

    @property
    def seconds(self) -> float:
        """Motion judged so far [s]."""
        return self._kept * self._stride / self._service.arm.rate

    @property
    def block(self) -> int:
        """Kept errors in a block."""
        return max(1, round(BLOCK * self._service.arm.rate / self._stride))

    def take(self, stopped: threading.Event | None = None) -> None:
        """Take the states that came since, but for the latest, which may turn out to be a contact.

        Args:
            stopped: Ends it when it is set; there may be a minute of states to take.

        Raises:
            LimoError: A model cannot follow the states.
        """
        rate, history = self._service.arm.rate, self._service.history
        notice = MARGIN + float(self._service.watchdog.duration.max())
        while stopped is None or not stopped.is_set():
            if self._next < history.first:
                self._begin(history.first)
            stop = history.count - ceil(notice * rate)
            most = round(rate)  # a second
            if self._next + most > stop:
                return
            self._judge(history.since(self._next, most))

    def comparison(self, looks: int = 1) -> Comparison | None:
        """Compare what was judged so far; None before the first block.

        Args:
            looks: How often this is done, in all.

        Raises:
            DivergedError: An error is not finite.
        """
        if self._kept < self.block:
            return None
        champion, challenger = np.concatenate(self._errors, axis=1)
        return compare(champion, challenger, self.block, looks)

    def _begin(self, first: int) -> None:
        """Begin the memory of both anew at a row."""
        self._next = first
        self._settled = first + ceil(2 * self._models[0].stream.delay * self._service.arm.rate)
        for model in self._models:
            model.state = model.stream.init()

    def _judge(self, rows: StateRows) -> None:
        errors = [_live_errors(model, rows) for model in self._models]
        numbers = np.arange(self._next, self._next + len(rows.time))
        self._next += len(rows.time)
        if rows.torque is None or np.ptp(rows.position, axis=0).max() < MOVES:
            return
        good = self._free(rows.time) & (numbers >= max(self._settled, self._judged_from))
        good &= numbers % self._stride == 0
        if good.any():
            self._errors.append(np.stack([error[good] for error in errors]))
            self._kept += int(good.sum())

    def _free(self, time: FloatArray) -> BoolArray:
        """Return which states (T,) are farther than a margin from contact."""
        free = np.ones(time.shape, dtype=bool)
        for contact in (*self._service.contacts, *self._service.watchdog.present):
            last = inf if contact.ended is None else contact.ended
            free &= (time < contact.began - MARGIN) | (time > last + MARGIN)
        return free


def _live_errors(model: LiveModel, rows: StateRows) -> FloatArray:
    """Return what a model leaves of the measured torque of T rows, (T, n) [N m]."""
    parts = [
        model.errors(rows.part(first, first + _ROWS)) for first in range(0, len(rows.time), _ROWS)
    ]
    return np.concatenate(parts)
