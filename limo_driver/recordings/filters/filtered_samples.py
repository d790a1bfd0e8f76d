"""FilteredSamples: motion and torque of samples, as zero-phase filters of a bandwidth see them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from limo_driver.errors import RecordingError, ShapeError
from limo_driver.recordings.checks import numbers
from limo_driver.recordings.filters.adaptive_smoothing import differentiate_adaptively
from limo_driver.recordings.filters.differentiation import (
    EDGE,
    SAFE_BANDWIDTH,
    differentiate,
    smooth,
)
from limo_driver.recordings.gate.held_values import contiguous
from limo_driver.types import FloatArray, Motion, readonly

SHARPER = 4.0  # times the bandwidth, for the velocity that friction depends on
LIVELIER = 1.25  # times the bandwidth, for the acceleration


class FilteredSamples(ABC):
    """What filters make of T samples of n joints; a subclass holds the samples."""

    time: FloatArray  # (T,) [s], strictly increasing
    position: FloatArray  # (T, n) [rad]
    torque: FloatArray  # (T, n) [N m], measured
    extras: Mapping[str, FloatArray]  # what else was measured of each joint, by name, (T, n) each
    source: str  # file, for messages

    @abstractmethod
    def check_torque(self) -> None:
        """Check that torques were measured.

        Raises:
            RecordingError: None was.
        """

    def __len__(self) -> int:
        return self.time.size

    @cached_property
    def segments(self) -> tuple[slice, ...]:
        """Stretches without a gap; history and filters start anew in each."""
        return contiguous(self.time)

    def motion(self, bandwidth: float) -> Motion:
        """Differentiate the positions without phase.

        Args:
            bandwidth: Frequency at which the zero-phase low-pass halves the amplitude [Hz]; motion
                up to a third of it keeps its amplitude within 2e-4.

        Returns:
            Filtered position, velocity and acceleration at the recorded instants.

        Raises:
            RecordingError: The bandwidth is too high for the sampling rate.
        """
        smoothed = differentiate(self.time, self.position, bandwidth, self.segments)
        return Motion(self.time, smoothed.value, smoothed.first, smoothed.second, self.temperature)

    def sharp_motion(self, bandwidth: float) -> Motion:
        """Differentiate the positions for a prediction that is filtered, if at all, afterwards.

        A velocity that lost its high frequencies changes its sign too gently: friction computed
        from it errs by several noise floors around every reversal, whatever is filtered later.
        So position and velocity keep `SHARPER` times the bandwidth, as far as the sampling rate
        allows. The acceleration would be nothing but noise there, and keeps `LIVELIER` times the
        bandwidth: with no more than the bandwidth itself, a prediction that is filtered like the
        measured torque would have lost there what that torque keeps.

        The filter is linear and one for all rows, as whatever is fitted to motion has to have it:
        one that follows the motion would look like physics.

        Args:
            bandwidth: As for `motion` [Hz].

        Returns:
            Position, velocity and acceleration at the recorded instants.

        Raises:
            RecordingError: The bandwidth is too high for the sampling rate.
        """
        highest = self._highest(bandwidth)
        lively = self.motion(min(LIVELIER * bandwidth, highest))
        sharp = differentiate(
            self.time, self.position, min(SHARPER * bandwidth, highest), self.segments
        )
        return replace(lively, position=sharp.value, velocity=sharp.first)

    def calm_motion(self, bandwidth: float) -> Motion:
        """Differentiate the positions as `sharp_motion` does where they move, and calmly at rest.

        For a prediction that is looked at on all rows. Position and velocity that keep all high
        frequencies are nothing but noise at rest, and friction with a sharp sign chatters there. So
        positions are smoothed at up to `SHARPER` times the bandwidth, and at less where they tell
        no more than noise, see `adaptive_smoothing`; the acceleration keeps at most `LIVELIER`
        times the bandwidth.

        Args:
            bandwidth: As for `motion` [Hz].

        Returns:
            Position, velocity and acceleration at the recorded instants.

        Raises:
            RecordingError: The bandwidth is too high for the sampling rate.
        """
        highest = self._highest(bandwidth)
        sharp = differentiate_adaptively(
            self.time, self.position, min(SHARPER * bandwidth, highest), self.segments
        )
        lively = self.filtered(sharp.second, min(LIVELIER * bandwidth, highest))
        return Motion(self.time, sharp.value, sharp.first, lively, self.temperature)

    def _highest(self, bandwidth: float) -> float:
        """Return the highest bandwidth that the sampling bears, or the given one [Hz]."""
        return max(SAFE_BANDWIDTH * self.slowest_rate, bandwidth)

    @property
    def slowest_rate(self) -> float:
        """Lowest mean sampling rate of a segment [Hz]; of none, infinite."""
        rates = (
            (part.stop - part.start - 1) / float(self.time[part.stop - 1] - self.time[part.start])
            for part in self.segments
            if part.stop - part.start > 1
        )
        return min(rates, default=float("inf"))

    @cached_property
    def temperature(self) -> FloatArray | None:
        """Temperature of every joint, (T, n) [°C], linear over holes; None if not measured.

        A joint without any reading stays NaN.
        """
        if (given := self.extras.get("temperature")) is None:
            return None
        filled = np.array(given)
        for column in filled.T:
            known = np.isfinite(column)
            if known.any():
                column[:] = np.interp(self.time, self.time[known], column[known])
        return readonly(filled)

    def filtered_torque(self, bandwidth: float) -> FloatArray:
        """Filter the torque as `motion` filters the positions.

        Args:
            bandwidth: As for `motion` [Hz].

        Returns:
            Filtered torques, (T, n) [N m].

        Raises:
            RecordingError: The bandwidth is too high for the sampling rate.
        """
        self.check_torque()
        return self.filtered(self.torque, bandwidth)

    def filtered(self, values: FloatArray, bandwidth: float) -> FloatArray:
        """Filter values of all samples, such as a prediction to compare with the torque.

        Args:
            values: (T, k), in any unit.
            bandwidth: As for `motion` [Hz].

        Returns:
            Filtered values, (T, k), in the same unit.

        Raises:
            ShapeError: The values are not those of all samples.
            RecordingError: They are no numbers, or the bandwidth is too high for the sampling rate.
        """
        columns = numbers("values", values)
        if columns.ndim != 2 or len(columns) != len(self):  # noqa: PLR2004  # (T, k)
            raise ShapeError("values", columns.shape, f"({len(self)}, k)")
        return smooth(self.time, columns, bandwidth, self.segments)

    def edges(self, bandwidth: float) -> NDArray[np.bool_]:
        """Mark samples so near to an end of a segment that their derivatives are unsure.

        Args:
            bandwidth: Of the filter [Hz].

        Returns:
            True where they are, (T,).
        """
        reach = EDGE / bandwidth
        near = np.zeros(len(self), dtype=bool)
        for rows in self.segments:
            time = self.time[rows]
            near[rows] = (time < time[0] + reach) | (time > time[-1] - reach)
        return near

    def scored(self, bandwidth: float) -> NDArray[np.bool_]:
        """Mark the samples whose torque can be compared with a prediction: all but `edges`.

        Args:
            bandwidth: Of the filter on both [Hz].

        Returns:
            True where they are, (T,).

        Raises:
            RecordingError: There is none.
        """
        scored = ~self.edges(bandwidth)
        if not scored.any():
            raise RecordingError(
                f"is too short to score: the filter of {bandwidth:g} Hz needs more than "
                f"{2 * EDGE / bandwidth:.2g} s without a gap",
                path=self.source or None,
            )
        return scored
