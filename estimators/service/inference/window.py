"""Sums over the answers of a service, taken each time that its status is."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from estimators.service.inference.live_model import Answer
    from limo_driver.types import FloatArray


class Window:
    """Sums over the answers since they were last looked at, of n joints."""

    def __init__(self, n: int) -> None:
        self.count = 0
        self.squares = np.zeros(n)  # [(N m)²], of external torque without contact
        self.samples = np.zeros(n)  # that went into `squares`
        self.outside = np.zeros(n)
        self.clipped = 0
        self.contacts = 0  # that began or ended

    def add(
        self,
        answer: Answer,
        in_contact: NDArray[np.bool_],
        unturned: NDArray[np.bool_],
        *,
        known: bool,
    ) -> None:
        """Add an answer.

        Args:
            answer: Of n joints.
            in_contact: Which of them are, (n,).
            unturned: Whose friction may stand anyhow, (n,).
            known: Whether velocities are; else nothing is said of the external torque.
        """
        self.count += 1
        self.clipped += answer.clipped
        _sum_up(
            answer.external,
            answer.outside,
            in_contact,
            unturned,
            known,
            self.squares,
            self.samples,
            self.outside,
        )

    @property
    def rms(self) -> FloatArray:
        """Of the external torque without contact, (n,) [N m]; NaN where there was none."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.sqrt(self.squares / self.samples)


@compiled(reads=("external", "outside", "in_contact", "unturned"))
def _sum_up(
    external: FloatArray,
    outside: NDArray[np.bool_],
    in_contact: NDArray[np.bool_],
    unturned: NDArray[np.bool_],
    known: bool,
    squares: FloatArray,
    samples: FloatArray,
    outsides: FloatArray,
) -> None:
    """Add the external torque of free joints, and the flags, to the sums of a window."""
    for j in range(external.size):
        outsides[j] += outside[j]
        if known and not (in_contact[j] or unturned[j]) and np.isfinite(external[j]):
            squares[j] += external[j] * external[j]
            samples[j] += 1.0
