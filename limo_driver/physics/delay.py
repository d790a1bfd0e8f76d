"""Delay: a torque that arrives later than the position of the same sample."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from limo_driver.compiled import compiled
from limo_driver.parameters import parameter
from limo_driver.physics.effect import SensorEffect, State

if TYPE_CHECKING:
    from limo_driver.physics.effect import SensedTorque
    from limo_driver.types import FloatArray

_LAST = 3  # time, input and output of the lag stand before the samples still to come


@dataclass(frozen=True, kw_only=True)
class TimeDelay(SensorEffect):
    """Late torque: a pure delay, then a first-order lag, lag dy/dt = tau(t - delay) - y.

    Between samples the torque is linear, for which both are exact at any sampling. Before the
    first sample it was what it is there.

    Source: Khalil and Dombre, "Modeling, Identification and Control of Robots", 2002, ch. 12.
    """

    name: ClassVar[str] = "time_delay"
    delay: float = parameter("s", "pure delay", lower=0.0, upper=1.0, default=0.0)
    lag: float = parameter("s", "time constant of the lag", lower=0.0, upper=10.0, default=0.0)

    def advance(self, state: State, sensed: SensedTorque) -> tuple[FloatArray, State]:
        """Return late minus present torque [N m], (T,).

        The state is (time, input, output of the lag; times and torques still to come), or empty.
        """
        torque = np.ascontiguousarray(sensed.torque[:, self.joint - 1])
        old_times, old_torques = np.split(state[_LAST:], 2)
        times = np.concatenate([old_times, sensed.time])
        torques = np.concatenate([old_torques, torque])
        late: FloatArray = np.interp(sensed.time - self.delay, times, torques)
        last = state[:_LAST] if state.size else np.array([sensed.time[0], late[0], late[0]])
        output = _lagged(np.ascontiguousarray(last), sensed.time, late, self.lag)
        # One sample before the delayed instant, so that the next can be interpolated.
        kept = max(int(np.searchsorted(times, times[-1] - self.delay, side="right")) - 1, 0)
        after = [[sensed.time[-1], late[-1], output[-1]], times[kept:], torques[kept:]]
        return output - torque, np.concatenate(after)


@compiled(reads=("time", "value"))
def _lagged(last: FloatArray, time: FloatArray, value: FloatArray, lag: float) -> FloatArray:
    """Return the first-order lag of a value that is linear between samples, (T,)."""
    t, x, y = last
    result = np.empty_like(value)
    for i in range(time.size):
        h = time[i] - t
        if lag <= 0.0:
            y = value[i]
        elif h > 0.0:
            fade = np.exp(-h / lag)
            slope = (value[i] - x) / h
            y = value[i] - lag * slope + (y - x + lag * slope) * fade
        t, x = time[i], value[i]
        result[i] = y
    return result
