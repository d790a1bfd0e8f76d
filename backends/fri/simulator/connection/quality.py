"""Quality of the connection: limo's own model of it, with its parameters.

KUKA's thresholds stand in its manual only. Here every receive interval (send period times receive
multiplier) is answered in time or not, and the quality follows from the share that was, over a
window of the last intervals. A window that is not full yet counts what is missing as missed, so
that a session begins POOR and gets better, as real ones do. Many misses in a row are POOR at once.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from backends.fri.codec.messages import Quality
from limo_driver.errors import ConfigError
from limo_driver.runtime.parameters import Declared, parameter


@dataclass(frozen=True)
class QualityModel(Declared):
    """Parameters of the model (limo's, not KUKA's)."""

    fair: float = parameter(
        "", "share of intervals answered in time, from which on the quality is FAIR", default=0.5
    )
    good: float = 0.8
    excellent: float = 0.98
    window: float = parameter(
        "s", "over which the share is taken", lower=0, above=True, default=1.0
    )
    fewest: int = parameter("", "intervals, at least", lower=1, default=10)
    most: int = parameter("", "intervals, at most", lower=1, default=100)
    misses: int = parameter("", "in a row, which are POOR whatever the share", lower=1, default=10)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.fair < self.good < self.excellent <= 1:
            raise ConfigError(
                f"quality thresholds {self.fair:g}, {self.good:g}, {self.excellent:g} have to rise "
                "within 0 to 1"
            )
        if self.most < self.fewest:
            raise self._refused("most", f"{self.fewest} or more")

    def intervals(self, interval: float) -> int:
        """Return how many intervals [s] the window holds."""
        return min(max(round(self.window / interval), self.fewest), self.most)


class ConnectionQuality:
    """Follows the quality of one session.

    Args:
        model: Its parameters.
        interval: Time in which one answer is expected [s].
    """

    def __init__(self, model: QualityModel, interval: float) -> None:
        self.model = model
        self._size = model.intervals(interval)
        self.reset()

    def reset(self) -> None:
        """Begin anew, as for a session that is opened."""
        self._window: deque[bool] = deque([False] * self._size, maxlen=self._size)
        self._answered = 0
        self._missed_in_a_row = 0

    def count(self, *, answered: bool) -> None:
        """Take note of one receive interval."""
        self._answered += answered - self._window[0]
        self._window.append(answered)
        self._missed_in_a_row = 0 if answered else self._missed_in_a_row + 1

    @property
    def share(self) -> float:
        """Share of the intervals of the window that were answered in time."""
        return self._answered / self._size

    @property
    def level(self) -> Quality:
        """The quality."""
        model, share = self.model, self.share
        if self._missed_in_a_row >= model.misses or share < model.fair:
            return Quality.POOR
        if share < model.good:
            return Quality.FAIR
        return Quality.GOOD if share < model.excellent else Quality.EXCELLENT
