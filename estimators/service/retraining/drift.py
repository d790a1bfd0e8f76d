"""Drift detection: a lasting increase of a model's residual.

Page and Hinkley's test on x, the logarithm of a joint's mean squared residual over a window of
about a second: it sums x - mean(x) - `STEP`, and reports drift where the sum has risen by
`THRESHOLD` above its minimum. Doubling the residual moves x by log 4 = 1.39, twice `STEP`.

On recordings of real arms (KUKA LWR4+ and UR10e, `joint-physics`, motion held out), x scatters by
0.6 to 1.35 from window to window, correlated by at most 0.5 with the next one. With that, printed
by `benchmarks/service/drift.py` for one joint:

    scatter   correlation   false alarms a day   doubled, told after: median, 95 %
     0.70        0.2               0.0               48 s, 71 s
     1.00        0.4               0.0               51 s, 94 s
     1.35        0.5               0.6               52 s, 121 s

Other motion has other residuals: the detector cannot distinguish a task that is harder to predict
from a joint that changed. A challenger trained for it has to beat the champion before it serves.

Source: E. S. Page, "Continuous inspection schemes", Biometrika 41, 1954; package `river`.

Watch the residual of a service for drift, second by second, where it says something.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.service.comparison import MOVES
from limo_driver.errors import ShapeError
from limo_driver.runtime.plugins import require_package

if TYPE_CHECKING:
    from estimators.service.inference.arm_service import ArmService
    from estimators.service.inference.live_model import Window
    from limo_driver.types import BoolArray, FloatArray

STEP: Final = 0.7  # of the logarithm, that does not count as a change
FEWEST: Final = 120  # windows, before which the mean is not known well enough, by default
THRESHOLD: Final = 30.0  # sum of the logarithm beyond it
_MOST: Final = 2.5  # above the mean, that one window may add; no single second makes a drift
_LEAST: Final = 1e-12  # [(N m)²], below which a residual is none
_KEPT: Final = 60  # windows that may wait to be looked at
_RECENT: Final = 2.0  # [s] in which a joint has to have moved
_OUTSIDE: Final = 0.02  # of a window, beyond which its motion is not what was learned
_ANSWERED: Final = 0.5  # [s] of states, below which a window says little


class DriftDetector:
    """Watches the residual of n joints, each by itself.

    Args:
        n: Number of joints.
        fewest: Windows, before which the mean is not known well enough.

    Raises:
        MissingPackageError: The package `river` is not installed.
    """

    def __init__(self, n: int, fewest: int = FEWEST) -> None:
        require_package("river", "detection of drift")
        from river.drift import PageHinkley

        self._test = PageHinkley
        self.n, self._fewest = n, fewest
        self.restart()

    def restart(self) -> None:
        """Forget everything: another model serves."""
        self._tests = [
            self._test(
                min_instances=self._fewest, delta=STEP, threshold=THRESHOLD, alpha=1.0, mode="up"
            )
            for _ in range(self.n)
        ]
        self._mean = np.zeros(self.n)  # of the logarithm
        self.windows = np.zeros(self.n, dtype=np.int64)  # taken

    def step(self, mean_square: FloatArray, usable: BoolArray) -> tuple[int, ...]:
        """Take the mean squared residual of a window, and return the joints that drift, 1-based.

        Args:
            mean_square: (n,) [(N m)²].
            usable: (n,), where it says something of the model: the joint moved as in training, and
                nothing leaned on the arm.

        Raises:
            ShapeError: Either has another shape.
        """
        for name, values in (("mean_square", mean_square), ("usable", usable)):
            if values.shape != (self.n,):
                raise ShapeError(name, values.shape, f"({self.n},)")
        known = usable & np.isfinite(mean_square)
        return tuple(j + 1 for j in np.flatnonzero(known).tolist() if self._take(j, mean_square[j]))

    def _take(self, j: int, mean_square: float) -> bool:
        value = float(np.log(max(mean_square, _LEAST)))
        if self.windows[j]:
            value = min(value, self._mean[j] + _MOST)
        self.windows[j] += 1
        self._mean[j] += (value - self._mean[j]) / self.windows[j]
        self._tests[j].update(value)
        return bool(self._tests[j].drift_detected)


class DriftWatch:
    """Shows a detector the windows in which only the model can be to blame for the residual.

    A window counts for a joint that moved as the model learned to; not while something leans on the
    arm, nor in the windows before and after, in which it may do so unnoticed.

    Args:
        n: Number of joints.
        fewest: Windows, before which none is reported.

    Raises:
        MissingPackageError: The package `river` is not installed.
    """

    def __init__(self, n: int, fewest: int = FEWEST) -> None:
        self._detector = DriftDetector(n, fewest)
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
