"""What changed on an arm since a model was trained: offset, friction and size of the errors.

From one day to the next, sensors drift and friction follows temperature and grease. No motion held
out from training shows that, so no interval of a model can have it. Where torque is measured, the
errors themselves tell it, slowly: of each joint

    e = o + f tanh(v / w) + noise,  noise ~ N(0, k s²),

with the offset o, the change f of dry friction, and the model's own standard deviation s, which is
off by a factor √k. All three are what the errors so far, weighed down by their age, say, with what
is believed before any: o and f are 0 within two standard deviations of the model, and k is 1 as if
ten independent errors had shown it. Errors are alike for about a second; so many rows count as one
error, which keeps all three slower than a push.

What is known for a row comes from errors at least `LAG` before it: no error explains itself.

Source: Kalman, "A new approach to linear filtering and prediction problems", 1960; Gelman et al.,
"Bayesian data analysis", 2013, sec. 3.3 (the factor); Gibbs and Candès, "Adaptive conformal
inference under distribution shift", NeurIPS 2021 (intervals that follow what they held so far).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.base import DEVIATIONS
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

LAG: Final = 0.5  # [s] between the last error that is known and the row it is used for
_ALIKE: Final = 1.0  # [s] for which errors are alike
_BEFORE: Final = 2.0  # [standard deviations of the model], of offset and friction before any error
_BELIEVED: Final = 10.0  # independent errors that the model's own deviation is worth
_FORGOTTEN: Final = 300.0  # [s] after which offset and friction may be any, as before
_MEMORY: Final = 30.0  # independent errors that the factor remembers
_SIGN_WIDTH: Final = 0.02  # [rad/s]
_LARGEST: Final = 4.0  # [standard deviations], as which a larger error counts: it is a push
_SURE: Final = 3.0  # standard deviations of a change that is reported
_LONGEST: Final = 0.1  # [s] between rows, that a gap counts as


@dataclass(frozen=True)
class SlowChange:
    """What the errors before each of T rows say of n joints."""

    torque: FloatArray  # (T, n) [N m], offset and friction at the motion of the row
    std: FloatArray  # (T, n) [N m], of the error that is left
    offset: FloatArray  # (n,) [N m], at the end
    friction: FloatArray  # (n,) [N m], likewise
    unsure: FloatArray  # (n, 2) [N m], one standard deviation of both
    usual: FloatArray  # (n,) [N m], the model's own, in the median

    @classmethod
    def of(
        cls, error: FloatArray, std: FloatArray, velocity: FloatArray, time: FloatArray
    ) -> SlowChange:
        """Follow the errors of a model.

        Args:
            error: Measured less predicted torque, both behind one filter, (T, n) [N m]; NaN where
                it is not known.
            std: The model's own standard deviation, (T, n) [N m], above 0.
            velocity: Of the joints, (T, n) [rad/s].
            time: Of the rows, rising, (T,) [s].
        """
        usual = np.median(std, axis=0)
        found, left, end, unsure = _follow(error, std, velocity, time, usual)
        return cls(found, left, end[:, 0], end[:, 1], unsure, usual)

    def describe(self, names: tuple[str, ...], units: tuple[str, ...]) -> tuple[str, ...]:
        """Say which joints surely changed by more than the model's own standard deviation.

        Args:
            names: Of the joints, (n,).
            units: Of their torques, (n,).
        """
        values = np.stack([self.offset, self.friction], axis=1)
        sure = np.abs(values) > np.maximum(_SURE * self.unsure, self.usual[:, None])
        return tuple(
            f"{what} since training: {values[j, k]:+.2g} {units[j]} at {name}"
            for j, name in enumerate(names)
            for k, what in enumerate(("offset", "friction"))
            if sure[j, k]
        )

    def held(self, error: FloatArray) -> FloatArray:
        """Return the part of errors (T, n) that is within the 95 % intervals, (n,)."""
        within = np.abs(error - self.torque) <= DEVIATIONS * self.std
        return np.asarray(np.mean(within, axis=0), dtype=np.float64)


@compiled(reads=("error", "std", "velocity", "time", "usual"), nogil=True)
def _follow(
    error: FloatArray,
    std: FloatArray,
    velocity: FloatArray,
    time: FloatArray,
    usual: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return torque and deviation of each row (T, n), and the end with its deviations (n, 2)."""
    T, n = error.shape
    torque, left = np.empty((T, n)), np.empty((T, n))
    end, unsure = np.empty((n, 2)), np.empty((n, 2))
    for j in range(n):
        prior = (_BEFORE * usual[j]) ** 2
        o, f, a, b, c = 0.0, 0.0, prior, 0.0, prior  # mean and covariance [[a, b], [b, c]]
        count, total = _BELIEVED, _BELIEVED
        known = 0  # rows whose errors are
        for t in range(T):
            while known < t and time[known] <= time[t] - LAG:
                step = min(time[known] - time[known - 1], _LONGEST) if known else 0.0
                own = error[known, j]
                if step > 0.0 and np.isfinite(own):
                    worth = step / _ALIKE
                    a, c = a + prior * step / _FORGOTTEN, c + prior * step / _FORGOTTEN
                    s = np.tanh(velocity[known, j] / _SIGN_WIDTH)
                    ah, ch = a + b * s, b + c * s
                    noise = std[known, j] ** 2 * total / count
                    spread = ah + s * ch
                    deviation = np.sqrt(noise + spread)
                    innovation = own - o - f * s
                    most = _LARGEST * deviation
                    innovation = min(max(innovation, -most), most)
                    gain = 1.0 / (spread + noise / worth)
                    o, f = o + ah * gain * innovation, f + ch * gain * innovation
                    a, b, c = a - ah * ah * gain, b - ah * ch * gain, c - ch * ch * gain
                    keep = 1.0 - worth / _MEMORY
                    square = innovation**2 / (std[known, j] ** 2 + spread)
                    count, total = keep * count + worth, keep * total + worth * square
                known += 1
            s = np.tanh(velocity[t, j] / _SIGN_WIDTH)
            torque[t, j] = o + f * s
            left[t, j] = np.sqrt(std[t, j] ** 2 * total / count + a + 2.0 * b * s + c * s * s)
        end[j, 0], end[j, 1] = o, f
        unsure[j, 0], unsure[j, 1] = np.sqrt(a), np.sqrt(c)
    return torque, left, end, unsure
