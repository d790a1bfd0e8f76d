"""Torque of live joint positions, a stated delay behind.

What was learned, was learned of motion behind a filter, and is given such motion. Physics alone
needs no such care: dry friction changes its sign faster than any torque that was filtered. So a
simulation is given sharper motion early, by `EARLY` of the delay, in which joints that stand still
have no velocity (`standstill`), and its torque is filtered for the rest of the delay, as is the
measured one. Where the delay is too short for two filters, the motion has the torque's bandwidth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from estimators.base import Estimate, LiveEstimator, State
from estimators.residual_model import SimulationOnly
from limo_driver.errors import RecordingError, ShapeError
from limo_driver.physics import Simulation
from limo_driver.recordings.bandwidth import BANDWIDTH
from limo_driver.recordings.filters.causal_differentiation import (
    FEWEST_SAMPLES,
    RATE_TOLERANCE,
    CausalDifferentiator,
    CausalFilter,
    DelayLine,
)
from limo_driver.recordings.filters.differentiation import SAFE_BANDWIDTH
from limo_driver.recordings.filters.standstill import RestingDifferentiator
from limo_driver.recordings.recording import Recording
from limo_driver.types import BoolArray, FloatArray, Motion

EARLY: Final = (
    0.3  # of the delay; sharper motion hears more noise, a later one leaves less to filter
)
SHARPER: Final = 2.0  # times the bandwidth of the torque; by less delay than that, it hears no more
LEAST_DELAY: Final = 0.7  # [1/bandwidth] that two filters need to do better than one
_WITH: Final = {True: "with", False: "without"}


@dataclass(frozen=True, repr=False)
class LiveEstimate(Estimate):
    """Torque at `time`, of one sample (n,) or of T samples (T, n).

    The measured torque went through the same filter, so that what it is more than the estimate is
    the torque of something outside, like for like.
    """

    time: float | FloatArray  # [s], or (T,); `delay` before that of the position
    measured: FloatArray | None  # [N m], filtered; None where none was given


class StreamState(NamedTuple):
    """Memory after a position."""

    signals: DelayLine  # positions; below them torques, if they are measured
    model: State
    torques: DelayLine | None = None  # of the model, and measured ones, where they are filtered


class DelayedRows(NamedTuple):
    """Fields of a `LiveEstimate` of T samples, which a stream of single ones need not make."""

    simulation: FloatArray
    learned: FloatArray
    std: FloatArray
    outside: BoolArray
    time: FloatArray
    measured: FloatArray | None

    def first(self) -> LiveEstimate:
        """Return the first sample."""
        measured = self.measured
        return LiveEstimate(
            self.simulation[0],
            self.learned[0],
            self.std[0],
            self.outside[0],
            self.time[0],
            None if measured is None else measured[0],
        )


class Stream:
    """An estimator on positions as they come, with the motion differentiated causally.

    Each call answers for `delay` before the position it is given. Memory goes in and out, so that
    one stream serves several arms. After a gap memory is reset, as in `predict` of an estimator,
    and where time is set back by as much: a wrong time costs a start, not all that follow.

    Args:
        model: Fitted or loaded; a bare simulation is taken for one that has learned nothing,
            at its own bandwidth or the usual one.
        rate: Of the positions [Hz].
        delay: Wanted delay [s]; the nearest number of samples is taken. A tenth of a second suits
            the usual bandwidth of 10 Hz, see `causal_differentiation` for what less costs.

    Raises:
        NotFittedError: The model was neither fitted nor loaded.
        ConfigError: The delay is too short, or the model's bandwidth too high for the rate.
        ModelStoreError: The model has a memory whose rate this one is no multiple of.
    """

    def __init__(self, model: LiveEstimator | Simulation, rate: float, delay: float = 0.1) -> None:
        if isinstance(model, Simulation):
            model = SimulationOnly(model, model.bandwidth or BANDWIDTH)
        self.model = model
        self.rate, self.n = rate, self.model.n
        self.differentiator, self.smoother = _filters(self.model, rate, delay)
        after = self.smoother.samples if self.smoother else 0
        self.samples = self.differentiator.samples + after  # by which a torque is late
        self.delay = self.samples / self.rate  # [s], likewise
        self.longest_step = self.differentiator.longest_step  # [s], that is no gap yet
        self.longest_gap = self.differentiator.longest_gap  # [s], that memory outlives
        self.init()  # refuses a model that is not ready

    def remembers_like(self, other: Stream) -> bool:
        """Say whether another stream's memory is what this one's would be after the same states."""
        if type(self) is not type(other):
            return False
        own, its = self.differentiator, other.differentiator
        after, its_after = (one.smoother and one.smoother.samples for one in (self, other))
        return np.array_equal(own.taps, its.taps) and (
            (self.rate, after, self.model.memory) == (other.rate, its_after, other.model.memory)
        )

    def init(self) -> StreamState:
        """Return the memory before the first position, at which the arm is taken to have rested."""
        return StreamState(self.differentiator.init(self.n), self.model.init(self.rate))

    def copied(self, state: StreamState) -> StreamState:
        """Return memory that stays as it is while other streams go on from the same."""
        return state

    def step(
        self,
        state: StreamState,
        time: float,
        position: ArrayLike,
        torque: ArrayLike | None = None,
    ) -> tuple[LiveEstimate, StreamState]:
        """Take the next position and return the torque at `time - delay`.

        Args:
            state: Memory after the position before; not changed.
            time: Of the position [s].
            position: (n,) [rad].
            torque: Measured with it, (n,) [N m]: with each position or with none.

        Returns:
            Joint torques (n,) [N m] at `time - delay`, and the memory after this position.

        Raises:
            ShapeError: Position or torque has another number of joints.
            RecordingError: The time does not increase, a value is not finite, or torque comes with
                some positions only.
        """
        signals = self._signals((), position, torque)[None]
        moved = np.array([time - self.differentiator.delay])
        late, after = self._advance_stretch(state, np.array([time]), moved, signals)
        return late.first(), after

    def advance(
        self,
        state: StreamState,
        time: FloatArray,
        position: FloatArray,
        torque: FloatArray | None = None,
    ) -> tuple[LiveEstimate, StreamState]:
        """Take T positions: `step` for all of them in one.

        Args:
            state: Memory after the position before; not changed.
            time: (T,) [s], strictly increasing but for gaps, which may also go back.
            position: (T, n) [rad], T at least 1.
            torque: Measured with them, (T, n) [N m].

        Returns:
            Joint torques (T, n) [N m] at `time - delay`, and the memory after the last position.

        Raises:
            ShapeError: Position or torque has another shape, or there is none.
            RecordingError: As in `step`.
        """
        time = np.ascontiguousarray(time, dtype=np.float64)
        if time.ndim != 1 or not time.size:
            raise ShapeError("time", time.shape, "(T,) with T at least 1")
        signals = self._signals(time.shape, position, torque)
        moved = time - self.differentiator.delay
        gaps = np.flatnonzero(np.abs(np.diff(time)) > self.longest_gap) + 1
        parts: list[LiveEstimate] = []
        for first, last in pairwise((0, *gaps, time.size)):
            rows = slice(first, last)
            part, state = self._advance_stretch(state, time[rows], moved[rows], signals[rows])
            parts.append(LiveEstimate(*part))
        return _joined(parts), state

    def predict(self, recording: Recording) -> FloatArray:
        """Return the torque that `step` returns along a recording, (T, n) [N m].

        Row t is the torque at `delay` before the time of row t; what the recording says of torque
        is not looked at.

        Raises:
            RecordingError: The recording has another rate.
            ShapeError: The recording has another number of joints.
        """
        self.check_rate(recording)
        return self.advance(self.init(), recording.time, recording.position)[0].torque

    def check_rate(self, recording: Recording) -> None:
        """Check that a recording has the stream's rate.

        Raises:
            RecordingError: It has another.
        """
        if abs(recording.rate / self.rate - 1.0) > RATE_TOLERANCE:
            raise RecordingError(
                f"is sampled at {recording.rate:.5g} Hz, expected {self.rate:g} Hz, the rate of "
                "the stream",
                path=recording.source or None,
            )

    def _signals(
        self, shape: tuple[int, ...], position: ArrayLike, torque: ArrayLike | None
    ) -> FloatArray:
        """Return positions, and beside them torques if there are any, (*shape, n or 2 n)."""
        n = self.n
        signals = np.empty((*shape, n if torque is None else 2 * n))
        signals[..., :n] = self._checked("position", position, shape)
        if torque is not None:
            signals[..., n:] = self._checked("torque", torque, shape)
        return signals

    def _checked(self, name: str, given: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
        values = np.asarray(given)
        if values.shape != (*shape, self.n):
            raise ShapeError(name, values.shape, f"{(*shape, self.n)}")
        return values

    def _advance_stretch(
        self, state: StreamState, time: FloatArray, moved: FloatArray, signals: FloatArray
    ) -> tuple[DelayedRows, StreamState]:
        """Advance over T positions that follow each other without a gap.

        `moved` are the times of the motion that the filter makes of them, (T,) [s].
        """
        n, line = self.n, state.signals
        if self.differentiator.gap(line, time.item(0)):
            state = self.init()
            line = state.signals
        if math.isnan(line.time):
            line = self.differentiator.init(signals.shape[1])
        elif len(line.positions) != signals.shape[1]:
            now, before = _WITH[signals.shape[1] > n], _WITH[len(line.positions) > n]
            raise RecordingError(
                f"the position at {time[0]:.6g} s comes {now} torque, those before came {before}; "
                "give it with all or with none"
            )
        values, line = self.differentiator.filter(line, time, signals)
        measured, own = None, values
        if signals.shape[1] > n:
            measured, own = values[0, :, n:], np.ascontiguousarray(values[:3, :, :n])
        estimate, model = self.model.advance(
            state.model, Motion.trusted(moved, own[0], own[1], own[2])
        )
        torque, smoother = estimate.simulation, self.smoother
        learned, std, outside = estimate.learned, estimate.std, estimate.outside
        if smoother is None:
            late = DelayedRows(torque, learned, std, outside, moved, measured)
            return late, StreamState(line, model)
        both = torque if measured is None else np.concatenate((torque, measured), axis=1)
        torques, after = smoother.filter(state.torques or smoother.init(both.shape[1]), moved, both)
        if measured is not None:
            measured = torques[0, :, n:]
        moved = moved - smoother.delay
        late = DelayedRows(torques[0, :, :n], learned, std, outside, moved, measured)
        return late, StreamState(line, model, after)


def _filters(
    model: LiveEstimator, rate: float, delay: float
) -> tuple[CausalDifferentiator, CausalFilter | None]:
    """Return what motion goes through before a model, and what its torque goes through after."""
    bandwidth = model.bandwidth
    if not isinstance(model, SimulationOnly):
        return CausalDifferentiator(rate, bandwidth, delay), None
    whole = RestingDifferentiator(rate, bandwidth, delay)
    early = max(round(EARLY * whole.samples), FEWEST_SAMPLES)
    after = whole.samples - early
    if after < FEWEST_SAMPLES or whole.delay * bandwidth < LEAST_DELAY:
        return whole, None
    sharp = max(min(SHARPER * bandwidth, SAFE_BANDWIDTH * rate), bandwidth)
    return (
        RestingDifferentiator(rate, sharp, early / rate),
        CausalFilter.smoother(rate, bandwidth, after),
    )


def _joined(parts: list[LiveEstimate]) -> LiveEstimate:
    """Return estimates (T, n) that follow each other as one."""
    measured = [part.measured for part in parts if part.measured is not None]
    return LiveEstimate(
        **vars(Estimate.joined(parts)),
        time=np.concatenate([part.time for part in parts]),
        measured=np.concatenate(measured) if measured else None,
    )
