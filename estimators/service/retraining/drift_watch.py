"""Watch the residual of a service for drift, second by second, where it says something."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.service.comparison.shadow import MOVES
from estimators.service.retraining.drift import DriftDetector

if TYPE_CHECKING:
    from estimators.service.inference.arm_service import ArmService, Window

_KEPT: Final = 60  # windows that may wait to be looked at
_RECENT: Final = 2.0  # [s] in which a joint has to have moved
_OUTSIDE: Final = 0.02  # of a window, beyond which its motion is not what was learned
_ANSWERED: Final = 0.5  # [s] of states, below which a window says little


class DriftWatch:
    """Shows a detector the windows in which only the model can be to blame for the residual.

    A window counts for a joint that moved as the model learned to; not while something leans on the
    arm, nor in the windows before and after, in which it may do so unnoticed.

    Args:
        n: Number of joints.

    Raises:
        BackendUnavailableError: The package `river` is not installed.
    """

    def __init__(self, n: int) -> None:
        self._detector = DriftDetector(n)
        self._windows: deque[tuple[Window, bool]] = deque(maxlen=_KEPT)
        self._recent: deque[tuple[Window, bool]] = deque(maxlen=3)
        self._version = ""

    def take(self, window: Window, *, contact: bool) -> None:
        """Keep what a service summed up over the last second or so, and whether it saw contact."""
        self._windows.append((window, contact))

    def forget(self) -> None:
        """Forget the windows that wait."""
        self._windows.clear()
        self._recent.clear()

    def drifting(self, service: ArmService) -> tuple[int, ...]:
        """Look at the windows that came, and return the joints that drift, 1-based.

        Drift is told once; the detector then begins anew, as it does where another model serves.
        """
        if service.model.version != self._version:
            self._version = service.model.version
            self._detector.restart()
            self.forget()
        joints: set[int] = set()
        while self._windows:
            self._recent.append(self._windows.popleft())
            free = not any(contact for _, contact in self._recent)
            if free and len(self._recent) == self._recent.maxlen:
                joints.update(self._show(service, self._recent[1][0]))
        if joints:
            self._detector.restart()
        return tuple(sorted(joints))

    def _show(self, service: ArmService, window: Window) -> tuple[int, ...]:
        history, rate = service.history, service.arm.rate
        rows = history.since(max(history.first, history.count - round(_RECENT * rate)))
        if not len(rows.time):
            return ()
        usable = (window.samples >= _ANSWERED * rate) & (np.ptp(rows.position, axis=0) >= MOVES)
        usable &= window.outside <= _OUTSIDE * window.count
        return self._detector.step(window.squares / np.maximum(window.samples, 1), usable)
