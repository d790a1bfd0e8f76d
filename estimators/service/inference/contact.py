"""Contact: external torque above a threshold for longer than a while."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from limo_driver.errors import ConfigError, ShapeError
from limo_driver.network.contact_state import Touch
from limo_driver.runtime.compiled import compiled
from limo_driver.types import FloatArray

REPORT_PERIOD: Final = 0.1  # [s] of states, after which a report is due again, changed or not
_ROUNDING: Final = 1e-6  # [s], of stamps
SURE: Final = 2.0  # standard deviations that have to fit below a threshold, or an external torque
_TOUCHES: Final = (Touch.FREE, Touch.CONTACT, Touch.UNKNOWN)
_UNKNOWN: Final = 2  # of these
MARGIN: Final = 1.0  # [s] before and after a contact, in which something may lean on the arm


@dataclass(frozen=True)
class Contact:
    """A contact that began, or ended."""

    joint: int  # 1-based
    began: float  # [s], when the threshold was passed
    torque: float  # [N m], external, of the largest magnitude so far
    ended: float | None = None  # [s], when the torque fell, or was last known
    cut_off: bool = False  # ended because nothing more is known of the torque

    def __str__(self) -> str:
        """Say where it is, how hard, and how it ended."""
        where = f"contact on joint {self.joint}"
        if self.ended is None:
            return f"{where}: {self.torque:+.2f} N m"
        how = "was lost sight of" if self.cut_off else "ended"
        return (
            f"{where} {how} after {self.ended - self.began:.2f} s, at most {self.torque:+.2f} N m"
        )


class ContactWatchdog:
    """Says when something leans on a joint: |external torque| above a threshold for `duration`.

    A contact ends when the torque has been below `release` of the threshold, or not known, for as
    long. Both are told `duration` late, with the time at which they happened.

    Args:
        threshold: (n,) [N m].
        duration: (n,) [s].
        release: Part of the threshold.

    Raises:
        ConfigError: A threshold or duration is not above 0.
        ShapeError: There are not as many thresholds as durations.
    """

    def __init__(self, threshold: FloatArray, duration: FloatArray, release: float = 0.7) -> None:
        if threshold.shape != duration.shape:
            raise ShapeError("duration", duration.shape, f"{threshold.shape}")
        for name, values, unit in (("threshold", threshold, "N m"), ("duration", duration, "s")):
            if not (np.isfinite(values).all() and (values > 0).all()):
                raise ConfigError(f"contact {name} {values} {unit} has to be above 0 and finite")
        self.threshold, self.duration, self.release = threshold, duration, release
        self._since = np.full(threshold.shape, np.nan)  # [s], when it crossed the present bound
        self._contact: list[Contact | None] = [None] * threshold.size  # as they began
        self._peaks = np.zeros(threshold.shape)  # [N m], of those
        self.active = np.zeros(threshold.shape, dtype=bool)
        self._time = np.nan  # [s], of the latest step

    def step(self, time: float, external: FloatArray) -> list[Contact]:
        """Take the external torque, (n,) [N m], at `time` [s]; return what began or ended.

        NaN torque, which is not known, begins nothing.
        """
        self._time = time
        if external.shape != self._since.shape:
            raise ShapeError("external", external.shape, f"({self._since.size},)")
        if not _watch(
            time,
            external,
            self.threshold,
            self.duration,
            self.release,
            self.active,
            self._since,
            self._peaks,
        ):
            return []
        due = np.flatnonzero(time - self._since >= self.duration)
        return [self._turn(int(j), float(external[j])) for j in due]

    @property
    def present(self) -> tuple[Contact, ...]:
        """The contacts that have not ended."""
        return tuple(
            replace(contact, torque=float(peak))
            for contact, peak in zip(self._contact, self._peaks, strict=True)
            if contact is not None
        )

    def restart(self) -> list[Contact]:
        """Forget all, after a gap; return the contacts that this cuts off, ended when last seen."""
        lost = [replace(contact, ended=self._time, cut_off=True) for contact in self.present]
        self._since.fill(np.nan)
        self._contact = [None] * self.threshold.size
        self.active.fill(False)
        return lost

    def _turn(self, j: int, torque: float) -> Contact:
        since, self._since[j] = float(self._since[j]), np.nan
        contact = self._contact[j]
        if contact is None:
            self._contact[j] = contact = Contact(j + 1, since, torque)
            self.active[j], self._peaks[j] = True, torque
            return contact
        self._contact[j] = None
        self.active[j] = False
        peak, unknown = float(self._peaks[j]), bool(np.isnan(torque))
        return replace(contact, torque=peak, ended=since, cut_off=unknown)


class ContactReport:
    """What is known of contacts, for whoever must tell none from unknown.

    A joint without contact is free where its external torque is known, and two standard deviations
    of the estimate are below its threshold; else nobody knows.

    Args:
        watchdog: Whose contacts.
    """

    def __init__(self, watchdog: ContactWatchdog) -> None:
        self._watchdog = watchdog
        self._touch = np.full(watchdog.threshold.shape, _UNKNOWN)  # index of each touch
        self._since = np.full(watchdog.threshold.shape, np.nan)  # [s]
        self._due = -np.inf  # [s], when it is due again

    def step(self, time: float, external: FloatArray, std: FloatArray, *, known: bool) -> bool:
        """Take an answer, (n,) each [N m], at `time` [s]; say whether there is news.

        Args:
            time: Of the state that was answered.
            external: NaN where no torque was measured.
            std: NaN where the estimator does not know its errors.
            known: Whether velocities are known by now.
        """
        watchdog = self._watchdog
        changed = _touch(
            time,
            external,
            std,
            watchdog.threshold,
            watchdog.active,
            known,
            self._touch,
            self._since,
        )
        if time < self._due and not changed:
            return False
        self._due = time + REPORT_PERIOD - _ROUNDING
        return True

    @property
    def joints(self) -> tuple[Touch, ...]:
        """What is known of each joint."""
        return tuple(_TOUCHES[k] for k in self._touch.tolist())

    @property
    def since(self) -> list[float]:
        """When each joint came to be so, by the stamps of states [s]."""
        return self._since.tolist()


@compiled(reads=("external", "std", "threshold", "active"))
def _touch(
    time: float,
    external: FloatArray,
    std: FloatArray,
    threshold: FloatArray,
    active: NDArray[np.bool_],
    known: bool,
    touch: NDArray[np.int64],
    since: FloatArray,
) -> bool:
    """Write what is known of each joint, and since when; say whether that changed of any."""
    changed = False
    for j in range(external.size):
        now = _UNKNOWN
        if known and active[j]:
            now = 1
        elif known and SURE * std[j] < threshold[j] and np.isfinite(external[j]):
            now = 0
        if now != touch[j] or np.isnan(since[j]):
            changed = changed or now != touch[j]
            touch[j], since[j] = now, time
    return changed


@compiled(reads=("external", "threshold", "duration"))
def _watch(
    time: float,
    external: FloatArray,
    threshold: FloatArray,
    duration: FloatArray,
    release: float,
    active: NDArray[np.bool_],
    since: FloatArray,
    peaks: FloatArray,
) -> bool:
    """Note when joints crossed their bounds and how hard they are pushed; say whether one is due.

    `since` and `peaks` are written; a torque that is not known crosses the lower bound alone.
    """
    due = False
    for j in range(external.size):
        size = abs(external[j])
        if active[j]:
            crossed = not size >= release * threshold[j]
            if size > abs(peaks[j]):
                peaks[j] = external[j]
        else:
            crossed = size > threshold[j]
        if not crossed:
            since[j] = np.nan
        elif np.isnan(since[j]):
            since[j] = time
        due = due or time - since[j] >= duration[j]
    return due
