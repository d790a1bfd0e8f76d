"""Torque of live joint positions, a stated delay behind."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.causal_differentiation import RATE_TOLERANCE, CausalDifferentiator
from limo_driver.errors import RecordingError

if TYPE_CHECKING:
    from estimators.hybrid import HybridModel, HybridState
    from limo_driver.causal_differentiation import DelayLine
    from limo_driver.recording import Recording
    from limo_driver.types import FloatArray


@dataclass(frozen=True)
class StreamState:
    """Memory after a position."""

    positions: DelayLine
    model: HybridState


class Stream:
    """A trained model on positions as they come, with the motion differentiated causally.

    Each call answers for `delay` before the position it is given. Memory goes in and out, so that
    one stream serves several arms. After a gap it starts anew, as in `HybridModel.predict`.

    Args:
        model: Trained or loaded.
        rate: Of the positions [Hz].
        delay: Wanted delay [s]; the nearest number of samples is taken. A tenth of a second suits
            the usual bandwidth of 10 Hz, see `causal_differentiation` for what less costs.

    Raises:
        NotFittedError: The model was neither trained nor loaded.
        ConfigError: The delay is too short, or the model's bandwidth too high for the rate.
        ModelStoreError: The model has a memory whose rate this one is no multiple of.
    """

    def __init__(self, model: HybridModel, rate: float, delay: float = 0.1) -> None:
        fitted = model.fitted
        self.model, self.rate = model, rate
        self.differentiator = CausalDifferentiator(rate, fitted.bandwidth, delay)
        fitted.stride(rate)

    @property
    def delay(self) -> float:
        """Time by which a torque is late [s], a whole number of samples."""
        return self.differentiator.delay

    def init(self) -> StreamState:
        """Return the memory before the first position, at which the arm is taken to have rested."""
        n = self.model.fitted.features.n
        return StreamState(self.differentiator.init(n), self.model.init(self.rate))

    def step(
        self, state: StreamState, time: float, position: FloatArray
    ) -> tuple[FloatArray, StreamState]:
        """Take the next position and return the torque at `time - delay`.

        Args:
            state: Memory after the position before; not changed.
            time: Of the position [s].
            position: (n,) [rad].

        Returns:
            Joint torques (n,) [N m] at `time - delay`, and the memory after this position.

        Raises:
            ShapeError: The position has another number of joints.
            RecordingError: The time does not increase, or a value is not finite.
        """
        if self.differentiator.gap(state.positions, time):
            state = self.init()
        motion, positions = self.differentiator.advance(
            state.positions, np.array([time]), np.asarray(position, dtype=np.float64)[None]
        )
        parts, model = self.model.advance(state.model, motion)
        return parts.hybrid[0], StreamState(positions, model)

    def predict(self, recording: Recording) -> FloatArray:
        """Return what `step` returns along a recording, (T, n) [N m].

        Row t is the torque at `delay` before the time of row t; what the recording says of torque
        is not looked at.

        Raises:
            RecordingError: The recording has another rate.
            ShapeError: The recording has another number of joints.
        """
        if abs(recording.rate / self.rate - 1.0) > RATE_TOLERANCE:
            raise RecordingError(
                f"is sampled at {recording.rate:.5g} Hz, expected {self.rate:g} Hz, the rate of "
                "the stream",
                path=recording.source or None,
            )
        torque = np.empty(recording.position.shape)
        for rows in recording.segments:
            motion, _ = self.differentiator.advance(
                self.init().positions, recording.time[rows], recording.position[rows]
            )
            torque[rows] = self.model.predict_motion(motion, self.rate).hybrid
        return torque
