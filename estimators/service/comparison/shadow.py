"""Two models on the states that a service answers, without the stream feeling it.

Both take the same rows from the history of the service, a few at a time, on whatever thread calls;
what they leave of the measured torque is kept in pairs, outside of contact, while the arm moves.
"""

from __future__ import annotations

from math import ceil, inf
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.service.comparison.gate import BLOCK, compare
from estimators.service.inference.contact import MARGIN

if TYPE_CHECKING:
    import threading

    from numpy.typing import NDArray

    from estimators.service.comparison.gate import Comparison
    from estimators.service.inference.arm_service import ArmService
    from estimators.service.inference.history import StateRows
    from estimators.service.inference.live_model import LiveModel
    from limo_driver.types import FloatArray

MOVES: Final = 1e-3  # [rad] of travel within a second; less says of friction what one pose does
_MEMORY: Final = 60.0  # [s] of motion before the first judged error
_ROWS: Final = 50  # at once, between which the stream gets the interpreter
_RATE: Final = 50.0  # [Hz] of errors kept; torque is filtered far below that


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
        errors = [_errors(model, rows) for model in self._models]
        numbers = np.arange(self._next, self._next + len(rows.time))
        self._next += len(rows.time)
        if rows.torque is None or np.ptp(rows.position, axis=0).max() < MOVES:
            return
        good = self._free(rows.time) & (numbers >= max(self._settled, self._judged_from))
        good &= numbers % self._stride == 0
        if good.any():
            self._errors.append(np.stack([error[good] for error in errors]))
            self._kept += int(good.sum())

    def _free(self, time: FloatArray) -> NDArray[np.bool_]:
        """Return which states (T,) are farther than a margin from contact."""
        free = np.ones(time.shape, dtype=bool)
        for contact in (*self._service.contacts, *self._service.watchdog.present):
            last = inf if contact.ended is None else contact.ended
            free &= (time < contact.began - MARGIN) | (time > last + MARGIN)
        return free


def _errors(model: LiveModel, rows: StateRows) -> FloatArray:
    """Return what a model leaves of the measured torque of T rows, (T, n) [N m]."""
    parts = [
        model.errors(rows.part(first, first + _ROWS)) for first in range(0, len(rows.time), _ROWS)
    ]
    return np.concatenate(parts)
