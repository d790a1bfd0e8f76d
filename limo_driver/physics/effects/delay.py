"""Delay: a torque that arrives later than the position of the same sample."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from limo_driver.physics.description import Confusion, Description
from limo_driver.physics.effect import Hypothesis, SensorEffect, State
from limo_driver.runtime.compiled import compiled
from limo_driver.runtime.parameters import parameter

if TYPE_CHECKING:
    from collections.abc import Iterator

    from limo_driver.physics.effect import DiagnosisContext, SensedTorque
    from limo_driver.types import FloatArray

UNIT_DELAY = 1e-3  # [s]
LATE = (4e-3, 0.012, 0.03)  # [s], since within a sample all delays look alike
DELAYS = (2e-4, 0.5)  # [s]
DELAYED, LAGGING = "a pure delay", "a first-order lag"

_LAST = 3  # time, input and output of the lag stand before the samples still to come


@dataclass(frozen=True, kw_only=True)
class TimeDelay(SensorEffect):
    """Late torque: a pure delay, then a first-order lag, lag dy/dt = tau(t - delay) - y.

    Between samples the torque is linear, for which both are exact at any sampling. Before the
    first sample it was what it is there.

    Args:
        delay: Pure delay.
        lag: Time constant of the lag.

    Source: Khalil and Dombre, "Modeling, Identification and Control of Robots", 2002, ch. 12.
    """

    name: ClassVar[str] = "time_delay"
    sized_by: ClassVar[tuple[str, ...]] = ("delay", "lag")
    description: ClassVar[Description] = Description(
        signature="the measured torque lags behind the motion",
        shown_by="two_frequencies",
        confusions=(
            Confusion(
                "viscous_friction",
                "a delay's phase grows with the frequency at the same speed",
                "two_frequencies",
            ),
        ),
    )
    delay: float = parameter("s", lower=0.0, upper=1.0, default=0.0)
    lag: float = parameter("s", lower=0.0, upper=10.0, default=0.0)

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

    def late(self, time: FloatArray, torque: FloatArray) -> FloatArray:
        """Return torques as late as this makes them.

        Args:
            time: Increasing, (T,) [s].
            torque: (T, ...) [N m]; before the first sample each was what it is there.
        """
        at = np.ascontiguousarray(time)
        flat = torque.reshape(at.size, -1)
        result = np.empty_like(flat)
        for k, column in enumerate(flat.T):
            value = np.interp(at - self.delay, at, column)
            result[:, k] = _lagged(np.array([at[0], value[0], value[0]]), at, value, self.lag)
        return result.reshape(torque.shape)

    @classmethod
    def at_joint(cls, joint: int, recorded: DiagnosisContext) -> Iterator[Hypothesis]:  # noqa: ARG003
        """Yield a short delay, of which the torque is linear."""
        delay = cls(joint=joint, delay=UNIT_DELAY)
        yield Hypothesis.of_one(delay, "delay", positive=True, law=DELAYED)

    @classmethod
    def further_laws(cls, found: Hypothesis) -> Iterator[Hypothesis]:
        """Yield longer delays, and a lag."""
        joint = found.joints[0] + 1
        for time in LATE:
            yield cls.of_time(joint, "delay", DELAYED, time)
        yield cls.of_time(joint, "lag", LAGGING, LATE[0])

    @classmethod
    def of_time(cls, joint: int, name: str, law: str, time: float) -> Hypothesis:
        """Return a torque that comes late by `name`; how that acts on what is fast depends on it.

        Args:
            joint: 1-based.
            name: Of the parameter.
            law: In words.
            time: Of the parameter [s].
        """
        return Hypothesis.of_one(
            cls(joint=joint, **{name: time}),
            name,
            positive=True,
            settings=(time,),
            family=partial(cls.of_time, joint, name, law),
            law=law,
            bounds=(DELAYS,),
        )


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
